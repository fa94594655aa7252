"""FastCollide: many colliding spheres on CPU and GPU, with the same bits on both."""

from fastcollide.cameras import Camera, Orbit
from fastcollide.contacts import ContactFinder, Neighbors, Pairs, find_contacts, find_neighbors
from fastcollide.device_array import DeviceArray
from fastcollide.devices import BuildInfo, Device, Limits, build_info, devices, limits
from fastcollide.errors import CheckpointError, DeviceError, InvalidValue, MissingLibrary, OutOfMemory, SimulationError
from fastcollide.frames import Frame, FrameError, read_frame, write_frame
from fastcollide.ledger import LedgerError, LedgerWriter, read_ledger
from fastcollide.recording import Recording, open
from fastcollide.render import Renderer
from fastcollide.spheres import Spheres, drag_from_damping, lattice_spheres, random_spheres
from fastcollide.world import Contacts, Energy, Measurements, World, to_numpy

__version__ = build_info().version

__all__ = [
    "BuildInfo",
    "Camera",
    "CheckpointError",
    "ContactFinder",
    "Contacts",
    "Device",
    "DeviceArray",
    "DeviceError",
    "Energy",
    "Frame",
    "FrameError",
    "InvalidValue",
    "LedgerError",
    "LedgerWriter",
    "Limits",
    "Measurements",
    "MissingLibrary",
    "Neighbors",
    "Orbit",
    "OutOfMemory",
    "Pairs",
    "Recording",
    "Renderer",
    "SimulationError",
    "Spheres",
    "World",
    "build_info",
    "devices",
    "drag_from_damping",
    "find_contacts",
    "find_neighbors",
    "lattice_spheres",
    "limits",
    "open",
    "random_spheres",
    "read_frame",
    "read_ledger",
    "to_numpy",
    "write_frame",
]
