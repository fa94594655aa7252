"""Trajectory files: each is read back by the reader that it is written for, in the box that it comes from."""

import json
import shutil
import sys
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from fastcollide import cli, exports, run
from fastcollide.exports import Exports
from fastcollide.frames import FrameError, FrameFiles, read_frame
from fastcollide.ledger import read_ledger
from fastcollide.snapshots import cast_of
from fastcollide.trajectories import open_writer

gsd_hoomd = pytest.importorskip("gsd.hoomd")
h5py = pytest.importorskip("h5py")

pytestmark = pytest.mark.usefixtures("folder")

RUN = ["run", "--particles", "150", "--bounds", "-2", "-2", "1", "2", "2", "5", "--radius", "0.1", "0.25"]
RUN += ["--friction", "0.3", "--frames", "20", "--threads", "1", "--no-video", "--output", "out"]
BOTH = ["--trajectory", "out/run.gsd", "--trajectory", "out/run.vtkhdf"]
BOUNDARIES = {"wall": ["wall"], "periodic": ["periodic"], "mixed": ["periodic", "open", "wall"]}
COUNT = 150


def simulate(*arguments):
    assert cli.main([*RUN, *BOTH, *arguments]) == 0


class Kept:
    """A sink that keeps what comes."""

    def __init__(self):
        self.snapshots = []

    def write(self, snapshot):
        self.snapshots.append(snapshot)
        return Path("nowhere")

    def close(self):
        pass


@pytest.fixture(params=BOUNDARIES)
def recorded(request, monkeypatch):
    """A run in both formats, and what went into them."""
    kept = Kept()
    open_exports = run.Exports
    monkeypatch.setattr(run, "Exports", lambda cast, sinks: open_exports(cast, [*sinks, kept]))
    simulate("--boundary", *BOUNDARIES[request.param])
    return BOUNDARIES[request.param], kept.snapshots, read_frame("out/frame_00000002.txt").radii


# --- The readers of each format ---


def test_gsd_as_hoomd_reads_it(recorded):
    boundary, snapshots, radii = recorded
    periodic = np.array([name == "periodic" for name in (boundary * 3)[:3]])
    with gsd_hoomd.open("out/run.gsd") as trajectory:
        assert len(trajectory) == len(snapshots) == 10
        for frame, snapshot in zip(trajectory, snapshots, strict=True):
            frame.validate()
            assert frame.configuration.step == snapshot.frame
            assert frame.log["time"][0] == snapshot.time
            assert frame.configuration.box[3:].tolist() == [0, 0, 0]
            assert frame.log["is_periodic"].tolist() == periodic.tolist()
            edges = frame.configuration.box[:3]
            assert (edges[periodic] == 4).all()
            reach = 2 * (np.abs(frame.particles.position) + radii[:, None]).max(axis=0)
            assert (edges >= np.where(periodic, 4, reach - 1e-5)).all()
            assert (edges >= 4).all()
            assert (np.abs(frame.particles.position) <= edges / 2).all()
            np.testing.assert_allclose(frame.particles.position + [0, 0, 3], snapshot.positions, atol=1e-6)
            assert frame.particles.velocity.tobytes() == snapshot.velocities.tobytes()
            assert (frame.particles.diameter == 2 * radii).all()
            mass = 1000 * 4 / 3 * np.pi * radii**3
            np.testing.assert_allclose(frame.particles.mass, mass, rtol=1e-6)
            np.testing.assert_allclose(frame.particles.moment_inertia.T, [0.4 * mass * radii**2] * 3, rtol=1e-6)
            # HOOMD takes the angular momentum from its quaternion as half of q* p, and q is 1.
            angular = frame.particles.angmom[:, 1:] / 2 / frame.particles.moment_inertia
            np.testing.assert_allclose(angular, snapshot.spins, rtol=1e-6)
            assert (frame.particles.angmom[:, 0] == 0).all()
            assert frame.log["particles/angular_velocity"].tobytes() == snapshot.spins.tobytes()
    assert np.abs(snapshots[-1].spins).max() > 0.1


def test_a_box_without_walls_holds_what_has_flown_away():
    simulate("--boundary", "open", "--frames", "200")
    with gsd_hoomd.open("out/run.gsd") as trajectory, fc.open("out/run.vtkhdf") as exact:
        edges = np.array([frame.configuration.box[:3] for frame in trajectory])
        reach = 2 * (np.abs(exact[-1].positions - [0, 0, 3]) + exact[-1].radii[:, None]).max(axis=0)
    assert edges[-1].min() > 8
    np.testing.assert_allclose(edges[-1], reach, rtol=1e-6)
    assert (edges[-1] >= reach).all()


@pytest.mark.parametrize("boundary", ["wall", "periodic", "open"])
def test_freud_finds_the_contacts_of_the_engine(boundary):
    """All axes of a GSD box are periodic to freud, yet it finds no contact through a wall."""
    freud = pytest.importorskip("freud")
    world = fc.World(bounds=((-2, -2, 1), (2, 2, 5)), boundary=boundary, device="cpu")
    world.add(fc.random_spheres(400, bounds=world.bounds, radius=(0.2, 0.3)))
    cast = cast_of(world)
    with Exports(cast, [open_writer(Path("run.gsd"), cast, range(2, 11, 2))]) as trajectory:
        expected = []
        for _ in range(5):
            world.step(2)
            trajectory.add(world)
            contacts = world.contacts()
            expected.append({*zip(contacts.first.tolist(), contacts.second.tolist(), strict=True)})
    assert min(map(len, expected)) > 3
    with gsd_hoomd.open("run.gsd") as file:
        for frame, pairs in zip(file, expected, strict=True):
            radii = frame.particles.diameter / 2
            query = freud.locality.AABBQuery.from_system(frame)
            near = query.query(frame.particles.position, {"r_max": 0.61, "exclude_ii": True}).toNeighborList()
            first, second = near.query_point_indices, near.point_indices
            gaps = near.distances - radii[first] - radii[second]
            clear = np.abs(gaps) > 1e-5  # within rounding of the shift
            found = {*zip(first[clear & (gaps < 0)].tolist(), second[clear & (gaps < 0)].tolist(), strict=True)}
            unclear = {*zip(first[~clear].tolist(), second[~clear].tolist(), strict=True)}
            assert {pair for pair in found if pair[0] < pair[1]} - unclear == pairs - unclear


def test_vtkhdf_as_it_is_laid_out(recorded):
    """What the format's description asks for, without VTK."""
    _, snapshots, radii = recorded
    with h5py.File("out/run.vtkhdf") as file:
        root, steps = file["VTKHDF"], file["VTKHDF/Steps"]
        assert root.attrs["Type"] == b"PolyData"
        assert root.attrs["Version"].tolist() == [2, 2]
        assert steps.attrs["NSteps"] == len(steps["Values"]) == len(snapshots)
        for i, snapshot in enumerate(snapshots):
            first = steps["PointOffsets"][i]
            rows = slice(first, first + root["NumberOfPoints"][i])
            assert root["Points"][rows].tobytes() == snapshot.positions.tobytes()
            for name, array in (("velocity", snapshot.velocities), ("angular_velocity", snapshot.spins)):
                assert steps[f"PointDataOffsets/{name}"][i] == first
                assert root[f"PointData/{name}"][rows].tobytes() == array.tobytes()
            assert steps["PointDataOffsets/radius"][i] == 0
            assert root["FieldData/frame"][steps["FieldDataOffsets/frame"][i], 0] == snapshot.frame
        assert (root["PointData/radius"][:] == radii).all()
        assert root["Vertices/Offsets"][:].tolist() == list(range(COUNT + 1))
        assert steps["Values"][:].tolist() == [snapshot.time for snapshot in snapshots]


def test_vtkhdf_as_vtk_reads_it(recorded):
    vtk_hdf = pytest.importorskip("vtkmodules.vtkIOHDF")
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline

    _, snapshots, radii = recorded
    reader = vtk_hdf.vtkHDFReader()
    reader.SetFileName("out/run.vtkhdf")
    reader.UpdateInformation()
    information, key = reader.GetOutputInformation(0), vtkStreamingDemandDrivenPipeline.TIME_STEPS()
    times = [information.Get(key, i) for i in range(information.Length(key))]
    assert times == [snapshot.time for snapshot in snapshots]
    for step, snapshot in enumerate(snapshots):
        reader.SetStep(step)
        reader.Update()
        points = reader.GetOutputDataObject(0)
        data, fields = points.GetPointData(), points.GetFieldData()
        assert points.GetNumberOfVerts() == COUNT
        assert vtk_to_numpy(points.GetPoints().GetData()).astype("f4").tobytes() == snapshot.positions.tobytes()
        assert vtk_to_numpy(data.GetArray("velocity")).astype("f4").tobytes() == snapshot.velocities.tobytes()
        assert vtk_to_numpy(data.GetArray("angular_velocity")).astype("f4").tobytes() == snapshot.spins.tobytes()
        assert (vtk_to_numpy(data.GetArray("radius")).astype("f4") == radii).all()
        assert vtk_to_numpy(data.GetArray("id")).tolist() == list(range(COUNT))
        assert vtk_to_numpy(fields.GetArray("frame")).tolist() == [snapshot.frame]
        assert vtk_to_numpy(fields.GetArray("bounds")).tolist() == [[-2, -2, 1, 2, 2, 5]]


def test_gsd_as_ovito_reads_it(recorded):
    ovito = pytest.importorskip("ovito.io")
    _, snapshots, radii = recorded
    pipeline = ovito.import_file("out/run.gsd")
    assert pipeline.source.num_frames == len(snapshots)
    for i, snapshot in enumerate(snapshots):
        data = pipeline.compute(i)
        np.testing.assert_allclose(data.particles["Position"] + [0, 0, 3], snapshot.positions, atol=1e-6)
        np.testing.assert_allclose(data.particles["Velocity"], snapshot.velocities)
        np.testing.assert_allclose(data.particles["angular_velocity"], snapshot.spins)
        np.testing.assert_allclose(data.particles["Radius"], radii)
        assert data.attributes["Timestep"] == snapshot.frame
        assert data.attributes["time"] == snapshot.time
        np.testing.assert_allclose(data.cell[:, 3], -np.diag(data.cell[:, :3]) / 2)


def test_parquet_as_pyarrow_reads_it():
    parquet = pytest.importorskip("pyarrow.parquet")
    simulate("--parquet")
    table, ledger = parquet.read_table("out/ledger.parquet"), read_ledger("out")
    assert table.column_names == [*ledger]
    for name, values in ledger.items():
        assert table.column(name).to_numpy().tobytes() == values.tobytes()
    assert table.schema.field("total_J").metadata[b"meaning"] == b"the sum of the three"


def test_a_new_run_takes_an_older_parquet_away():
    pytest.importorskip("pyarrow")
    simulate("--parquet")
    simulate()
    assert not Path("out/ledger.parquet").exists()


# --- fc.open ---


@pytest.mark.parametrize("name", ["out", "out/run.gsd", "out/run.vtkhdf", "text"])
def test_open_gives_frames_times_ledger_and_settings(recorded, name):
    _, snapshots, radii = recorded
    if name == "text":
        for ending in ("gsd", "vtkhdf"):
            Path(f"out/run.{ending}").unlink()
    with fc.open("out" if name == "text" else name) as run:
        assert len(run) == 10
        np.testing.assert_allclose(run.times, [snapshot.time for snapshot in snapshots], rtol=1e-9)
        for frame, snapshot in zip(run, snapshots, strict=True):
            assert (frame.frame, frame.time) == (snapshot.frame, pytest.approx(snapshot.time))
            if name == "out/run.gsd":
                np.testing.assert_allclose(frame.positions, snapshot.positions, atol=1e-6)
            else:
                assert frame.positions.tobytes() == snapshot.positions.tobytes()
            assert frame.radii.tobytes() == radii.tobytes()
            assert frame.positions.dtype == frame.radii.dtype == np.float32
            if name == "text":
                assert frame.velocities is frame.spins is None
            else:
                assert frame.velocities.tobytes() == snapshot.velocities.tobytes()
                assert frame.spins.tobytes() == snapshot.spins.tobytes()
        assert [frame.frame for frame in run[-3:]] == [16, 18, 20]
        assert [frame.frame for frame in run[1:8:3][::-1]] == [16, 10, 4]
        assert run[1:8:3].times.tolist() == run.times[1:8:3].tolist()
        assert run[-1].frame == run[9].frame == 20
        with pytest.raises(IndexError, match="frame 10: found 10 frames"):
            run[10]
        assert run.bounds == ((-2, -2, 1), (2, 2, 5))
        assert run.world["solver"] == "substep"
        assert run.settings["frames"] == 20
        assert run.ledger["frame"].tolist() == read_ledger("out")["frame"].tolist()
    run.close()


def test_open_reads_a_frame_only_when_it_is_asked_for(monkeypatch):
    assert cli.main(RUN) == 0
    asked = []
    monkeypatch.setattr("fastcollide.recording.read_frame", lambda path: asked.append(path.name) or read_frame(path))
    with fc.open("out") as run:
        assert (len(run), len(run[2:4]), asked) == (10, 2, [])
        assert run[3].frame == 8
        assert asked == ["frame_00000008.txt"]


def test_open_takes_what_there_is(monkeypatch):
    """Without the library of a trajectory, its frame files; without those, a word on what to install."""
    simulate()
    monkeypatch.setitem(sys.modules, "h5py", None)
    monkeypatch.delitem(sys.modules, "fastcollide.vtkhdf_file", raising=False)
    assert fc.open("out").path == Path("out/run.gsd")
    Path("out/run.gsd").unlink()
    assert fc.open("out").path == Path("out")
    for path in Path("out").glob("*.txt"):
        path.unlink()
    with pytest.raises(fc.MissingLibrary, match=r'need h5py.*pip install "fastcollide\[files\]"'):
        fc.open("out")


def test_a_folder_of_frame_files_alone_opens():
    assert cli.main(RUN) == 0
    Path("out/run.json").unlink()
    with fc.open("out") as run:
        assert (len(run), run.bounds, run.settings, run.world) == (10, None, {}, {})


def test_what_cannot_be_opened_is_named():
    Path("empty").mkdir()
    with pytest.raises(FrameError, match="empty: found no frame file"):
        fc.open("empty")
    with pytest.raises(FileNotFoundError):
        fc.open("nothing.gsd")
    with pytest.raises(FileNotFoundError):
        fc.open("nothing.vtkhdf")
    for name in ("text.gsd", "text.vtkhdf"):
        Path(name).write_text("some text")
        with pytest.raises(FrameError, match=name):
            fc.open(name)
    Path("empty/run.json").write_text("{}")
    with pytest.raises(FrameError, match=r"run\.json: found another format"):
        fc.open("empty")


def test_a_file_beside_another_run_takes_nothing_from_it():
    simulate()
    assert cli.main([*RUN, "--output", "other", "--trajectory", "out/other.gsd", "--frames", "4"]) == 0
    with fc.open("out/run.gsd") as run:
        assert run.settings["frames"] == 20
    with fc.open("out/other.gsd") as run:
        assert (len(run), run.bounds, run.settings) == (2, None, {})


def test_a_moved_folder_opens():
    simulate()
    shutil.move("out", "elsewhere")
    with fc.open("elsewhere") as run:
        assert run.path == Path("elsewhere/run.vtkhdf")


# --- Settings and errors ---


def test_only_trajectories():
    simulate("--no-frame-files")
    names = {path.name for path in Path("out").iterdir()}
    assert names == {"ledger.csv", "run.gsd", "run.json", "run.vtkhdf"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--trajectory", "run.xyz"], "trajectory: found run.xyz; allowed: a path that ends in .gsd or .vtkhdf"),
        (["--trajectory", "a.gsd", "--trajectory", "a.gsd"], "trajectory: found one file twice"),
        (["--trajectory", "a.gsd", "--export-every", "0"], "export-every above 0"),
        (["--parquet", "--ledger-every", "0"], "parquet with a ledger to write"),
        (["--trajectory", "folder.gsd"], "trajectory: found the folder folder.gsd"),
    ],
)
def test_bad_settings_are_named(capsys, arguments, message):
    Path("folder.gsd").mkdir()
    assert cli.main([*RUN, *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not Path("out").exists()


def test_a_foreign_file_stays(capsys):
    with gsd_hoomd.open("theirs.gsd", "w") as file:
        file.append(gsd_hoomd.Frame())
    with h5py.File("theirs.vtkhdf", "w") as file:
        file["x"] = 1
    for name in ("theirs.gsd", "theirs.vtkhdf"):
        before = Path(name).read_bytes()
        assert cli.main([*RUN, "--trajectory", name]) == 1
        assert f"{name}: found" in capsys.readouterr().err
        assert Path(name).read_bytes() == before


def test_a_missing_library_is_named_before_the_run(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "gsd.fl", None)
    monkeypatch.delitem(sys.modules, "fastcollide.gsd_file", raising=False)
    assert cli.main([*RUN, "--trajectory", "run.gsd"]) == 1
    assert ".gsd files need gsd" in capsys.readouterr().err
    assert not Path("out").exists()


def test_a_scene_names_its_trajectories():
    Path("scene.toml").write_text("""
        [[spheres]]
        kind = "random"
        count = 20
        [run]
        frames = 4
        [output]
        make_video = false
        make_frame_files = false
        trajectory = ["one.gsd", "two.vtkhdf"]
    """)
    assert cli.main(["run", "scene.toml"]) == 0
    assert json.loads(Path("scene/run.json").read_text())["settings"]["trajectory"] == ["../one.gsd", "../two.vtkhdf"]
    for path in ("scene", "one.gsd", "two.vtkhdf"):
        with fc.open(path) as run:
            assert len(run) == 2
    assert cli.main(["run", "scene.toml", "--trajectory", "three.gsd"]) == 0
    with fc.open("scene") as run:
        assert run.path == Path("scene/../three.gsd")


def test_rounding_takes_nothing_out_of_a_periodic_box():
    lower, upper = np.float32(1.4), np.float32(273.4)  # 1.4 comes back as 1.3999939
    world = fc.World(bounds=((lower,) * 3, (upper,) * 3), boundary="periodic", gravity=(0, 0, 0), device="cpu")
    places = [lower, np.nextafter(lower, upper), np.nextafter(upper, lower)]
    world.add(position=[[place] * 3 for place in places], radius=0.4, mass=np.inf)
    cast = cast_of(world)
    with Exports(cast, [open_writer(Path("run.gsd"), cast, [1])]) as trajectory:
        world.step()
        trajectory.add(world)
    with gsd_hoomd.open("run.gsd") as file, fc.open("run.gsd") as run:
        box = file[0].configuration.box[:3]
        assert (np.abs(file[0].particles.position) <= box / 2).all()
        assert (run[0].positions >= lower).all()
        assert (run[0].positions < upper).all()
        difference = np.abs(run[0].positions - world.positions)
        assert np.minimum(difference, upper - lower - difference).max() < 4e-5
        fc.find_contacts(run[0].positions, run[0].radii, bounds=world.bounds, boundary="periodic")


def test_fixed_spheres_have_no_moment_to_turn():
    world = fc.World(device="cpu")
    world.add(position=[[0, 0, 5], [2, 0, 5]], radius=0.5, mass=[np.inf, 2.0], spin=[[0, 0, 3], [0, 0, 3]])
    cast = cast_of(world)
    with Exports(cast, [open_writer(Path("run.gsd"), cast, [1])]) as trajectory:
        world.step()
        trajectory.add(world)
    with gsd_hoomd.open("run.gsd") as file:
        assert file[0].particles.mass.tolist() == [np.inf, 2.0]
        assert file[0].particles.moment_inertia[0].tolist() == [0, 0, 0]
        assert file[0].particles.angmom.tolist() == [[0, 0, 0, 0], [0, 0, 0, pytest.approx(2 * 0.4 * 2 * 0.25 * 3)]]


# --- Beside the computation ---


def test_frames_are_copies():
    world = fc.World(device="cpu")
    world.add(fc.random_spheres(COUNT))
    kept = Kept()
    with Exports(cast_of(world), [kept]) as taken:
        expected = []
        for _ in range(5):
            world.step()
            taken.add(world)
            expected.append((world.positions.copy(), world.velocities.copy()))
    for snapshot, (positions, velocities) in zip(kept.snapshots, expected, strict=True):
        assert (snapshot.positions == positions).all()
        assert (snapshot.velocities == velocities).all()
    assert {id(snapshot.positions) for snapshot in kept.snapshots}.isdisjoint({id(world.positions)})


def test_a_world_without_spin_gets_none():
    world = fc.World(device="cpu")
    world.add(fc.random_spheres(10))
    cast = cast_of(world)
    with Exports(cast, [open_writer(Path(f"run.{ending}"), cast, [1]) for ending in ("gsd", "vtkhdf")]) as trajectory:
        world.step()
        trajectory.add(world)
    assert "spin" not in world._world.save()
    for ending in ("gsd", "vtkhdf"):
        with fc.open(f"run.{ending}") as run:
            assert run[0].spins is None


def test_a_frame_that_cannot_be_written_ends_the_run(monkeypatch, capsys):
    written = []

    class Full(FrameFiles):
        def write(self, snapshot):
            written.append(snapshot.frame)
            if snapshot.frame == 6:
                raise OSError(28, "No space left on device", "frame_00000006.txt")
            return super().write(snapshot)

    monkeypatch.setattr(run, "FrameFiles", Full)
    assert cli.main(RUN) == 1
    assert "frame_00000006.txt: No space left on device" in capsys.readouterr().err
    assert written == [2, 4, 6]  # none after it, or one would be missing in between


def test_no_more_than_a_few_frames_wait():
    world = fc.World(device="cpu")
    world.add(fc.random_spheres(10))
    most = 0
    with Exports(cast_of(world), [Kept()]) as taken:
        for _ in range(50):
            taken.add(world)
            most = max(most, len(taken._pending))
    assert 1 <= most <= exports._WAITING


@pytest.mark.parametrize("ending", ["gsd", "vtkhdf"])
def test_times_are_those_of_the_world(ending):
    """Frames of different lengths, which a loop of one's own can have."""
    world = fc.World(device="cpu")
    world.add(fc.random_spheres(10))
    cast = cast_of(world)
    expected = []
    with Exports(cast, [open_writer(Path(f"run.{ending}"), cast, [1, 2, 3])]) as trajectory:
        for dt in (0.01, 0.03, 0.02):
            world.step(dt=dt)
            trajectory.add(world)
            expected.append(world.time)
    with fc.open(f"run.{ending}") as run:
        assert run.times.tolist() == expected
