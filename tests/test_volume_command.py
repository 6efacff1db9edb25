"""`jaxplore run` and `jaxplore compare` in volumes, and what they refuse."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import yaml

from jaxplore.cli import main
from jaxplore.maps.files.volume_file import open_volume
from jaxplore.tasks.registry import build, make_settings
from jaxplore.tasks.volume.build import build_sensors, build_world, volume_size
from jaxplore.tasks.volume.settings import GENERATED

# As in the tests of volumes elsewhere, which run these programs too.
FEW = (
    *("--samples", "128", "--set", "controller.horizon=20"),
    *("--set", "camera.columns=32", "--set", "camera.rows=24"),
)


@pytest.fixture
def room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a room of 8 m by 4 m by 2.4 m, and work beside it."""
    monkeypatch.chdir(tmp_path)
    solid = np.zeros((12, 20, 40), bool)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, :, [0, -1]] = True
    np.save("room.npy", solid)
    return tmp_path


def test_a_file_is_explored_from_where_the_user_says(room: Path, capsys) -> None:
    start = ("--start", "2.0", "1.5", "1.0", "0.3")
    main(["run", "room.npy", *start, "--resolution", "0.2", "--time-limit", "2", *FEW])
    shown = capsys.readouterr()
    folder = room / "runs" / "room"
    assert "coverage" in shown.out
    assert str(Path("runs/room/turntable.gif")) in shown.out
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["coverage"] > 0.3
    settings = yaml.safe_load((folder / "settings.yaml").read_text())
    assert settings["start"] == [2.0, 1.5, 1.0, 0.3]
    assert settings["volume"] == str(room / "room.npy")
    # The settings of a run are those of the next one.
    again = make_settings(settings)
    assert build(again).scenario.world.resolution == 0.2
    # Without a start the run begins where there is most room.
    main(["run", "room.npy", "--resolution", "0.2", "--time-limit", "0.1", "--no-animation", *FEW])
    told = capsys.readouterr().err
    assert "the position with the greatest clearance; another one: --start X Y Z YAW" in told


def test_architectures_are_compared_in_a_volume(room: Path, capsys) -> None:
    names = "explorer,nearest-cluster,two-layer,parallel"
    size = ("--resolution", "0.2", "--time-limit", "0.5", "--no-animation")
    main(["compare", "room.npy", "--architectures", names, "--seeds", "1", *size, *FEW])
    shown = capsys.readouterr().out
    assert all(name in shown for name in names.split(","))
    assert (room / "runs" / "room-comparison" / "table.md").exists()


@pytest.mark.parametrize("name", [*GENERATED, "volume"])
def test_words_name_volumes(name: str) -> None:
    settings = make_settings({"map": name})
    assert settings.volume == ("forest" if name == "volume" else name)
    assert settings == make_settings({"volume": name})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("forest", "--start", "2", "2", "1"), "setting start is (2.0, 2.0, 1.0); accepted: [num"),
        (("forest", "--start", "0", "0", "0", "0"), "start is (0, 0, 0), within 0.3 m of a solid"),
        (("forest", "--start", "99", "0", "0", "0"), "start is (99, 0, 0), off the volume; accep"),
        (("office", "--start", "2", "2", "1", "0"), "setting start is (2.0, 2.0, 1.0, 0.0); acce"),
        (("forest", "--beams", "20"), "lidar.num_beams is 20 in a volume; accepted: on a map"),
        (("forest", "--laps", "2"), "laps is 2 in a volume; accepted: along a path"),
        (("forest", "--architecture", "portfolio"), "setting architecture is 'portfolio'; accept"),
        (("forest", "--set", "camera=null"), "settings camera and lidar are null; accepted: one"),
        (
            ("forest", "--set", "generated.size=[400,400,40]", "--set", "resolution=0.05"),
            "GB of it for the voxels (800 x 8000 x 8000 voxels: generated.size",
        ),
        (("forest", "--set", "volume=hall"), "setting volume is 'hall'; accepted: forest, office"),
        (("missing.stl",), "missing.stl is not there; accepted"),
        (("room.txt",), "room.txt is not there; accepted"),
        (("damaged.stl",), "damaged.stl"),
        (("full.npy",), "full.npy has no place for a robot of 0.3 m radius"),
        (("room.npy", "--set", "map=office"), "settings have the map 'office' beside the volume"),
    ],
)
def test_what_is_not_possible_is_one_line(
    room: Path, capsys, arguments: tuple[str, ...], message: str
) -> None:
    (room / "damaged.stl").write_bytes(b"solid nothing\n")
    np.save(room / "full.npy", np.ones((9, 9, 9), bool))
    with pytest.raises(SystemExit) as ended:
        main(["run", *arguments, "--out", "out"])
    assert ended.value.code == 2
    text = capsys.readouterr().err
    assert message in text
    assert "Traceback" not in text
    assert not (room / "out").exists()


def test_a_file_is_read_once_until_it_changes(room: Path, monkeypatch) -> None:
    read = []

    def counted(*arguments: object, **more: object):
        read.append(arguments)
        return open_volume(*arguments, **more)

    monkeypatch.setattr("jaxplore.tasks.volume.build.open_volume", counted)
    settings = make_settings({"volume": str(room / "room.npy"), "resolution": 0.2})
    assert volume_size(settings) == volume_size(settings) == ((12, 20, 40), 0.2)
    worlds = [build_world(settings)[0] for _ in range(2)]
    assert worlds[0] is worlds[1]
    assert volume_size(settings)[0] == worlds[0].shape
    assert len(read) == 1
    np.save("room.npy", np.ones((4, 5, 6), bool))
    assert volume_size(settings)[0] == (4, 5, 6)
    # A finer grid of the same file is another volume.
    volume_size(make_settings({"volume": str(room / "room.npy"), "resolution": 0.1}))
    assert len(read) == 3


def test_memory_is_estimated_before_voxels_are_made(room: Path, fails, monkeypatch) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box(extents=(60.0, 20.0, 3.0)).export("hall.stl")
    monkeypatch.setattr(
        "jaxplore.maps.files.volume_file.find_touched_voxels",
        lambda *_: pytest.fail("voxels are made"),
    )
    told = fails("run", "hall.stl", "--resolution", "0.05", "--memory-limit", "2", "--out", "out")
    assert "3.46 GB of it for the voxels (60 x 400 x 1200 voxels" in told


def test_a_volume_in_utm_is_run_in_its_own_coordinates(room: Path, capsys) -> None:
    solid, corner = np.load("room.npy"), np.array([500_000.0, 4_649_776.0, 100.0])
    np.savez("utm.npz", solid=solid, resolution=0.2, origin=corner)
    start = corner + np.array([2.0, 1.5, 1.0])
    size = ("--time-limit", "0.5", "--no-animation", "--out", "out", *FEW)
    main(["run", "utm.npz", "--start", *map(str, start), "0.3", *size])
    found = np.load(room / "out" / "arrays.npz")
    np.testing.assert_allclose(found["origin"], corner, atol=1e-5)
    np.testing.assert_allclose(found["positions"][0], start, atol=1e-4)
    np.testing.assert_array_equal(found["world"], solid)
    main(
        [
            "run",
            "room.npy",
            "--resolution",
            "0.2",
            "--start",
            "2",
            "1.5",
            "1",
            "0.3",
            "--overwrite",
            *size,
        ]
    )
    near = np.load(room / "out" / "arrays.npz")
    # The run itself does not know of the datum: its height is another number in single precision.
    np.testing.assert_allclose(found["positions"] - corner, near["positions"], atol=1e-3)
    capsys.readouterr()
    with pytest.raises(SystemExit):
        main(["run", "utm.npz", "--start", "500001", "4649000", "101", "0"])
    assert "y 4649776 to 4649780" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("volume", "given", "degrees"),
    [("forest", {}, 0.0), ("maze3d", {}, 20.0), ("maze3d", {"tilt_degrees": 0.0}, 0.0)],
)
def test_the_camera_of_a_maze_looks_up_to_its_upper_storey(
    volume: str, given: dict[str, float], degrees: float
) -> None:
    settings = make_settings({"volume": volume, "camera": {"columns": 1, "rows": 1, **given}})
    x, _, z = build_sensors(settings)[0].directions[:, 0]
    assert np.degrees(np.arctan2(z, x)) == pytest.approx(degrees, abs=1e-3)


def test_a_warning_is_one_line(tmp_path: Path, monkeypatch, capsys) -> None:
    trimesh = pytest.importorskip("trimesh")
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box(extents=(3000.0, 2500.0, 2000.0)).export("building.stl")
    shown_by_python = warnings.showwarning
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with pytest.raises(SystemExit):
            main(["run", "building.stl", "--resolution", "0.1", "--start", "0", "0", "9000", "0"])
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith("warning: volume ")
    assert told[0].endswith("millimetres are taken for its unit, file.scale=0.001")
    # Only the error has the name of the program before it.
    assert [line.startswith("jaxplore: ") for line in told] == [False] * (len(told) - 1) + [True]
    assert warnings.showwarning is shown_by_python
