"""`fastcollide info`: what this build is and what it can compute on here."""

from __future__ import annotations

import fastcollide as fc
from fastcollide.console import EXIT_FINE, say


def print_info() -> int:
    """Prints the build and the devices; returns the exit code."""
    build = fc.build_info()
    say("version", build.version)
    say("compiler", build.compiler + (", debug build" if build.is_debug else ""))
    cuda = f"{build.cuda}, for {build.cuda_architectures}" if build.cuda else "built without"
    say("CUDA", cuda)
    devices = fc.devices()
    for device in devices:
        say(device.name, f"{device.description}, {device.memory_bytes / 2**30:.1f} GiB")
    if build.cuda and all(device.name == "cpu" for device in devices):
        say("", "no CUDA device found")
    limits = fc.limits()
    say("spheres", f"at most {limits.spheres:,} in one world")
    by_cells = f'{limits.bytes_by_cells} with method="cells"'
    say("memory", f"{limits.bytes_per_sphere} bytes a sphere, {by_cells}, and {limits.bytes_per_cell} a grid cell")
    say("", f"{limits.bytes_for_spin} bytes a sphere more with friction or spin")
    say("coordinates", f"up to {limits.reach_in_radii:,} times the smallest radius")
    return EXIT_FINE
