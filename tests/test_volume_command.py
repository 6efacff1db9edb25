"""`jaxplore run` and `jaxplore compare` in volumes, and what they refuse."""

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
import yaml

from jaxplore.build.tasks import build, make_settings
from jaxplore.build.volume import build_sensors, volume_shape
from jaxplore.cli import main
from jaxplore.maps.files.volume_file import read_volume
from jaxplore.settings.volume import GENERATED

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
        (("forest", "--beams", "20"), "lidar.num_beams is 20 beside a volume; accepted: with a m"),
        (("forest", "--laps", "2"), "laps is 2 beside a volume"),
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
        return read_volume(*arguments, **more)

    monkeypatch.setattr("jaxplore.build.volume.read_volume", counted)
    settings = make_settings({"volume": str(room / "room.npy"), "resolution": 0.2})
    assert volume_shape(settings) == volume_shape(settings) == (12, 20, 40)
    assert len(read) == 1
    np.save("room.npy", np.ones((4, 5, 6), bool))
    assert volume_shape(settings) == (4, 5, 6)
    # A finer grid of the same file is another volume.
    volume_shape(make_settings({"volume": str(room / "room.npy"), "resolution": 0.1}))
    assert len(read) == 3


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
            main(["run", "building.stl", "--resolution", "50", "--start", "0", "0", "9000", "0"])
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith("warning: volume ")
    assert told[0].endswith("if its unit is the millimetre, file.scale=0.001")
    # Only the error has the name of the program before it.
    assert [line.startswith("jaxplore: ") for line in told] == [False] * (len(told) - 1) + [True]
    assert warnings.showwarning is shown_by_python
