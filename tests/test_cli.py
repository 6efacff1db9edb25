import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

import jaxplore as jx
from jaxplore.cli import main

SMALL = ["--samples", "32", "--set", "controller.horizon=10", "--set", "fields.num_directions=8"]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def ros_map(tmp_path: Path) -> Path:
    world = np.zeros((40, 60), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    world[:, 30] = 0.5
    jx.OccupancyGrid(world, 0.1).to_ros(tmp_path / "map.yaml")
    return tmp_path / "map.yaml"


def fails(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must fail as users' mistakes do: one line, exit code 2."""
    with pytest.raises(SystemExit) as exit_:
        main(arguments)
    captured = capsys.readouterr()
    assert exit_.value.code == 2
    assert captured.out == ""
    assert captured.err.startswith("jaxplore: ")
    assert captured.err.count("\n") == 1
    return captured.err


def test_run_writes_a_folder_that_repeats_itself(ros_map: Path, capsys) -> None:
    arguments = ["run", str(ros_map), "--start", "1.5", "2", "0", "--time-limit", "2", *SMALL]
    main([*arguments, "--seed", "3", "--range", "2.0", "--out", "first", "--no-animation"])
    shown = capsys.readouterr().out
    assert "coverage" in shown
    assert str(Path("first") / "map.png") in shown
    assert {path.name for path in Path("first").iterdir()} == {
        "metrics.json",
        "arrays.npz",
        "map.png",
        "coverage.png",
        "settings.yaml",
    }
    used = yaml.safe_load(Path("first/settings.yaml").read_text())
    assert used["seed"] == 3
    assert used["lidar"]["max_range"] == 2.0
    assert used["controller"]["num_samples"] == 32
    main(["run", "--settings", "first/settings.yaml", "--out", "again"])
    assert Path("again/exploration.gif").exists()
    first, again = (np.load(f"{name}/arrays.npz") for name in ("first", "again"))
    for name in first.files:
        np.testing.assert_array_equal(first[name], again[name])
    metrics = json.loads(Path("again/metrics.json").read_text())
    assert metrics["seed"] == 3
    assert 0 < metrics["num_steps"] == len(first["coverage"]) <= 100


def test_office_needs_no_file_and_names_its_folders(capsys) -> None:
    small = ["--set", "office.width=9", "--set", "office.height=8", *SMALL, "--no-animation"]
    for _ in range(2):
        main(["run", "office", "--time-limit", "0.5", *small])
    assert Path("runs/office/metrics.json").exists()
    assert Path("runs/office-2/metrics.json").exists()
    assert "runs/office-2" in capsys.readouterr().out


def test_finer_maps_are_resampled_and_coarser_ones_kept(tmp_path: Path) -> None:
    jx.OccupancyGrid(np.zeros((80, 80)), 0.05).to_ros(tmp_path / "fine.yaml")
    jx.OccupancyGrid(np.zeros((20, 20)), 0.2).to_ros(tmp_path / "coarse.yaml")
    for name, expected in (("fine", 0.1), ("coarse", 0.2)):
        arguments = ["run", f"{name}.yaml", "--start", "2", "2", "0", "--time-limit", "0.1"]
        main([*arguments, *SMALL, "--out", name, "--no-animation"])
        assert np.load(f"{name}/arrays.npz")["resolution"] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["run", "gone.yaml", "--start", "1", "1", "0"], "gone.yaml"),
        (["run"], "setting map is missing"),
        (["run", "MAP"], "start is missing; accepted: a pose in free space, for example"),
        (["run", "MAP", "--start", "9", "1", "0"], "off the map"),
        (["run", "MAP", "--start", "0.05", "1", "0"], "in a wall"),
        (["run", "MAP", "--start", "3.05", "1", "0"], "in unknown space"),
        (["run", "MAP", "--start", "0.25", "1", "0"], "touches something"),
        (["run", "MAP", "--start", "nan", "1", "0"], "start.0 is nan"),
        (["run", "MAP", "--start", "1", "1"], "--start"),
        (["run", "MAP", "--start", "a", "1", "0"], "--start"),
        (["run", "office", "--seed", "-1"], "setting seed is -1; accepted: greater than"),
        (["run", "office", "--time-limit", "0"], "setting time_limit is 0.0"),
        (["run", "office", "--resolution", "-0.1"], "setting resolution is -0.1"),
        (["run", "office", "--robot", "submarine"], "robot.model is 'submarine'; accepted: 'diff"),
        (["run", "office", "--set", "robot.wings=2"], "unknown setting robot.wings; accepted here"),
        (["run", "office", "--set", "wings=2"], "unknown setting wings; accepted here: map, start"),
        (["run", "office", "--set", "robot"], "--set is 'robot'; accepted: NAME=VALUE"),
        (["run", "office", "--set", "seed=[1"], "accepted: a value in YAML"),
        (["run", "office", "--set", "lidar=3", "--set", "lidar.x=1"], "lidar is 3"),
        (["run", "office", "--set", "office.width=3"], "width is 3"),
        (["run", "office", "--set", "robot.radius=4"], "robot of radius 4 m"),
        (["run", "office", "--wings"], "--wings"),
        (["fly"], "fly"),
        (["run", "--settings", "gone.yaml"], "settings file gone.yaml cannot be read"),
        (["run", "--settings", "bad.yaml"], "settings file bad.yaml is not YAML"),
        (["run", "--settings", "list.yaml"], "accepted: a mapping of settings"),
        (["run", "--settings", "binary.yaml"], "settings file binary.yaml is not YAML"),
        (["run", "office", "--out", "taken"], "taken"),
        (["run", "office", "--out", "file/inside"], "file"),
    ],
)
def test_bad_input_is_one_line(ros_map: Path, capsys, arguments, reason: str) -> None:
    Path("bad.yaml").write_text("seed: [1")
    Path("list.yaml").write_text("- 1")
    Path("binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    Path("taken").mkdir()
    Path("file").write_text("")
    before = sorted(os.listdir())
    arguments = [str(ros_map) if argument == "MAP" else argument for argument in arguments]
    assert reason in fails(capsys, *arguments)
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ({"resolution": 0}, "resolution is 0"),
        ({"resolution": -0.05}, "resolution is -0.05"),
        ({"occupied_thresh": 0.1, "free_thresh": 0.5}, "free_thresh is 0.5"),
        ({"mode": "quaternary"}, "mode is 'quaternary'; accepted: trinary, scale, raw"),
        ({"origin": [0, float("nan"), 0]}, "origin"),
        ({"image": "gone.pgm"}, "gone.pgm"),
        ({"image": "text.pgm"}, "text.pgm cannot be read"),
        ({"image": "huge.png"}, "huge.png is too large"),
        ({"image": "../map.pgm"}, "outside the map's folder"),
    ],
)
def test_bad_maps_are_one_line(ros_map: Path, capsys, entry, reason: str) -> None:
    Path("text.pgm").write_text("this is not an image")
    Image.new("1", (9000, 9000)).save("huge.png")
    described = yaml.safe_load(ros_map.read_text())
    Path("other.yaml").write_text(yaml.safe_dump({**described, **entry}))
    error = fails(capsys, "run", "other.yaml", "--start", "1", "1", "0", "--out", "out")
    assert reason in error
    assert not Path("out").exists()


def test_a_disk_that_fills_leaves_nothing(ros_map: Path, capsys, monkeypatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np, "savez_compressed", full)
    monkeypatch.setattr(np, "savez", full)
    before = sorted(os.listdir())
    arguments = ["run", str(ros_map), "--start", "1", "1", "0", "--time-limit", "0.1", *SMALL]
    with pytest.raises(SystemExit) as exit_:
        main([*arguments, "--out", "out"])
    assert exit_.value.code == 2
    assert "No space left on device" in capsys.readouterr().err
    assert sorted(os.listdir()) == before


def test_version_help_and_settings(capsys) -> None:
    main(["--version"])
    assert capsys.readouterr().out == f"jaxplore, version {jx.__version__}\n"
    main(["run", "--help"])
    text = capsys.readouterr().out
    for word in ("--start X Y YAW", "--seed", "--settings", "runs/depot", "[default: 900.0]"):
        assert word in text
    main(["settings"])
    assert yaml.safe_load(capsys.readouterr().out)["controller"]["num_samples"] == 1000


def test_a_real_map(ros_maps: Path) -> None:
    arguments = ["run", str(ros_maps / "nav2_depot" / "depot.yaml"), "--start", "4.62", "7.73", "0"]
    main([*arguments, "--time-limit", "3", *SMALL, "--out", "depot", "--no-animation"])
    metrics = json.loads(Path("depot/metrics.json").read_text())
    assert 300 < metrics["reachable_area"] < 450
    assert metrics["coverage"] > 0.1
    assert metrics["collisions"] == 0


def test_it_is_installed_as_a_command() -> None:
    command = [sys.executable, "-c", "from jaxplore.cli import main; main(['--version'])"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "jaxplore, version" in done.stdout


def test_importing_is_light_and_changes_nothing_global() -> None:
    code = (
        "import jax, sys; before = dict(jax.config.values); import jaxplore; "
        "assert dict(jax.config.values) == before; assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
