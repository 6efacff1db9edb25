"""`jaxplore map-log`: a small log, made here of a ring of corridors."""

import gzip
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxplore.cli import main
from jaxplore.maps import OccupancyGrid

pytest.importorskip("gtsam")


def block(low: tuple[float, float], high: tuple[float, float]) -> np.ndarray:
    points = np.array([low, (high[0], low[1]), high, (low[0], high[1])], float)
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


WALLS = np.concatenate(
    [
        block((0.0, 0.0), (7.0, 5.0)),
        block((2.0, 2.0), (5.0, 3.0)),
        block((2.6, 0.0), (3.0, 0.4)),
        block((6.5, 2.4), (7.0, 3.0)),
        block((0.0, 3.4), (0.4, 3.7)),
    ]
)
# Where the log has the robot: far from the origin.
PLACE = np.array([300.0, -200.0])


def ranges(pose: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Return the exact distances of the walls."""
    directions = np.stack([np.cos(pose[2] + angles), np.sin(pose[2] + angles)], axis=1)[:, None]
    start, along = WALLS[:, 0] - pose[:2], WALLS[:, 1] - WALLS[:, 0]
    cross = directions[..., 0] * along[:, 1] - directions[..., 1] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        away = (start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]) / cross
        share = (start[:, 0] * directions[..., 1] - start[:, 1] * directions[..., 0]) / cross
    return np.where((away > 0) & (share >= 0) & (share <= 1), away, 81.9).min(axis=1)


def written_log(path: Path, number: int = 60, *, laps: float = 1.5, has_truth: bool = True) -> Path:
    """Write scans along some laps, with an odometry that errs in its turns.

    Args:
        path: path of the log.
        number: number of scans.
        laps: number of laps.
        has_truth: whether the poses are the true ones; those of the odometry otherwise.
    """
    angles = np.radians(np.arange(-90.0, 91.0))
    rng = np.random.default_rng(0)
    lines = ["# made for a test", "PARAM robot_length 0.5"]
    wheels, before = np.array([9.0, 9.0, 0.3]), None
    for index, turn in enumerate(np.linspace(0.0, laps * math.tau, number)):
        at = np.array([3.5 + 2.5 * math.cos(turn), 2.5 + 1.6 * math.sin(turn)])
        pose = np.array([*at, math.atan2(1.6 * math.cos(turn), -2.5 * math.sin(turn))])
        found = np.maximum(ranges(pose, angles) + 0.01 * rng.standard_normal(181), 0.0)
        if before is not None:
            wheels = after(wheels, before, pose, rng.normal(0.0, [0.02, 0.02, 0.05]))
        before = pose
        given = [*(at + PLACE), pose[2]] if has_truth else wheels
        shown = " ".join(f"{each:.4f}" for each in [*found, *given, *wheels])
        lines.append(f"FLASER 181 {shown} {index} host {0.5 * index}")
    path.write_text("\n".join(lines) + "\n")
    return path


def after(wheels: np.ndarray, pose: np.ndarray, other: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Return the pose by an odometry after the motion from one pose to another, with an error."""
    ahead = (other[0] - pose[0] + 1j * (other[1] - pose[1])) * np.exp(-1j * pose[2])
    moved = (ahead + error[0] + 1j * error[1]) * np.exp(1j * wheels[2])
    turn = math.remainder(other[2] - pose[2], math.tau) + error[2]
    return wheels + np.array([moved.real, moved.imag, turn])


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a log in a folder of its own, which is the current one."""
    monkeypatch.chdir(tmp_path)
    return written_log(tmp_path / "ring.log")


def test_a_log_becomes_a_map(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["map-log", str(log), "--resolution", "0.1", "--drift-seed", "3", "--range", "10"])
    folder = Path("runs/ring-map")
    assert sorted(os.listdir(folder)) == [
        *("map.pgm", "map.png", "map.yaml", "metrics.json", "trajectories.npz")
    ]
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["num_scans"] == 60
    assert metrics["path_length"] == pytest.approx(1.5 * 13.0, rel=0.05)
    assert metrics["estimated"]["ate"] < 0.06
    assert metrics["estimated"]["ate"] < 0.6 * metrics["dead_reckoned"]["ate"]
    assert metrics["iou"] > 0.8
    assert f"{metrics['num_loops']} loops closed" in capsys.readouterr().out
    with np.load(folder / "trajectories.npz") as arrays:
        np.testing.assert_allclose(arrays["start"], PLACE + np.array([6.0, 2.5]), atol=1e-3)
        assert arrays["estimated"].shape == arrays["true"].shape == (60, 3)
    # The map is where the log has the robot, and its walls are those of the building.
    grid = OccupancyGrid.from_ros(folder / "map.yaml")
    points = PLACE + np.array([[6.0, 0.02], [0.02, 2.0], [3.5, 2.02], [1.0, 1.0], [3.5, 0.9]])
    cells = np.floor((points - np.asarray(grid.frame.origin)[:2]) / 0.1).astype(int)
    around = [np.asarray(grid.probability)[y - 1 : y + 2, x - 1 : x + 2] for x, y in cells]
    assert all(each.max() > 0.65 for each in around[:3])
    assert all(each.max() < 0.25 for each in around[3:])
    with Image.open(folder / "map.png") as image:
        assert min(image.size) > 300


def test_a_log_is_mapped_by_its_own_odometry(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With true poses beside it, and as a robot records it, packed and with a bad line."""
    written_log(log, laps=2.5)
    main(["map-log", str(log), "--resolution", "0.1", "--range", "10", "--out", "own"])
    metrics = json.loads(Path("own/metrics.json").read_text())
    assert metrics["estimated"]["ate"] < 0.06
    assert metrics["estimated"]["ate"] < 0.4 * metrics["dead_reckoned"]["ate"]
    assert metrics["iou"] > 0.8
    assert metrics["trust"]["warning"] == ""
    assert metrics["trust"]["num_places"] > 10
    assert 0.01 < metrics["odometry"]["turn_noise"] + metrics["odometry"]["turn_per_distance"] < 0.2
    assert "0 % of them look different" in capsys.readouterr().out
    raw = written_log(tmp_path / "raw.log", laps=2.5, has_truth=False).read_bytes()
    Path("raw.log.gz").write_bytes(gzip.compress(raw + b"FLASER 181 1.0 2"))
    main(["map-log", "raw.log.gz", "--resolution", "0.1", "--range", "10"])
    again = json.loads(Path("runs/raw-map/metrics.json").read_text())
    assert again["estimated"] is again["dead_reckoned"] is again["iou"] is None
    assert again["trust"]["warning"] == ""
    printed = capsys.readouterr()
    assert "The log has no other poses than its odometry" in printed.out
    assert "1 of 61 lines FLASER were left out: 1 by their columns (line 63 has" in printed.err
    with np.load("own/trajectories.npz") as one, np.load("runs/raw-map/trajectories.npz") as two:
        assert "true" not in two.files
        np.testing.assert_allclose(two["start"], [9.0, 9.0])
        # The same way, from another start.
        turn = two["estimated"][0, 2] - one["estimated"][0, 2]
        cos, sin = math.cos(turn), math.sin(turn)
        ahead = one["estimated"][:, :2] @ np.array([[cos, sin], [-sin, cos]])
        np.testing.assert_allclose(two["estimated"][:, :2], ahead, atol=0.05)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--resolution", "0"], "--resolution is 0"),
        (["--resolution", "nan"], "--resolution is nan"),
        (["--resolution", "3"], "--resolution is 3"),
        (["--range", "-1"], "max_range is -1"),
        (["--drift-seed", "-1"], "--drift-seed is -1"),
        (["--set", "distance_noise=-0.1"], "distance_noise is -0.1"),
        (["--set", "gyro=nan"], "gyro is nan"),
        (["--set", "gyro=much"], "--set gyro is 'much'"),
        (["--set", "speed=1"], "--set is 'speed=1'"),
        (["--out", "taken"], "exists and is not a folder"),
        (["--resolution", "0.001"], "resolution is 0.001, which makes a map of"),
    ],
)
def test_bad_options_are_one_line(log: Path, fails, options: list[str], message: str) -> None:
    Path("taken").write_text("mine")
    assert message in fails("map-log", str(log), *options)
    assert Path("taken").read_text() == "mine"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no scan"),
        ("scan 1 2 3\n", "has no scan"),
        ("FLASER 181 1 2 3\n", "has 5 columns"),
        ("FLASER 1 1.0 0 0 0 0 0 0 2 h 2\nFLASER 1 1.0 0 0 0 0 0 0 3 h 3\n", "has 1 beams"),
        (None, "missing.log"),
    ],
)
def test_bad_logs_are_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails, text: str | None, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "missing.log"
    if text is not None:
        file.write_text(text)
    assert message in fails("map-log", str(file), "--out", "new")


def test_scans_out_of_order_are_refused(log: Path, fails) -> None:
    lines = log.read_text().splitlines()
    log.write_text("\n".join([lines[0], *reversed(lines[1:])]))
    assert "has the time" in fails("map-log", str(log), "--out", "new")


def test_a_former_folder_is_kept(log: Path, fails) -> None:
    Path("former").mkdir()
    Path("former/metrics.json").write_text("{}")
    assert "holds a former run" in fails("map-log", str(log), "--out", "former")
    assert Path("former/metrics.json").read_text() == "{}"
