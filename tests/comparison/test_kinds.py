"""`jaxplore compare --maps` of fleets, in volumes and along paths."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxplore.cli import main
from jaxplore.report.coverage_levels import LEVELS
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.following.recording import PathRecording
from jaxplore.report.volume.recording import VolumeRecording
from jaxplore.simulation.run import record_run
from jaxplore.study.comparison.maps import MapFile, read_plans
from jaxplore.study.comparison.replay import decode_cells
from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.store import Store, open_store
from jaxplore.tasks.registry import build, make_settings, without_unread

pytestmark = pytest.mark.long

SHORT = ["--seeds", "2", "--samples", "16", "--out", "out"]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def compared(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[Store, list[Row]]:
    """Compare twice: the second time nothing is left to run. Return the store and its rows."""
    main(["compare", *arguments, *SHORT])
    assert "8 of 8" in capsys.readouterr().err
    main(["compare", *arguments, *SHORT])
    shown = capsys.readouterr()
    assert ", done:" not in shown.err
    store = open_store("out")
    rows = store.rows()
    assert all(row["error"] is None for row in rows)
    maps = {row["map"] for row in rows}
    text = (store.folder / "results.html").read_text()
    assert text.count("<h2>") == shown.out.count("medians") == len(maps)
    assert text.count("data-run=") == 2 * len(maps)
    return store, rows


def recorded(row: Row) -> Any:
    """Run again what a row is of, by its settings alone."""
    settings = make_settings(without_unread(json.loads(row["settings"])))
    controller, scenario, num_steps, key = build(settings)
    return record_run(controller, scenario, num_steps, key=key, num_trajectories=0)


def _check_levels(row: Row, done: np.ndarray, path: np.ndarray, period: float) -> None:
    assert row["coverage"] == pytest.approx(float(done[-1]), abs=1e-6)
    assert row["path_length"] == pytest.approx(float(path[-1]), rel=1e-5)
    for level in LEVELS:
        there = [k for k in range(len(done)) if np.float32(done[k]) >= np.float32(level / 100)]
        assert row[f"time_to_{level}"] == (pytest.approx(there[0] * period) if there else None)


def test_fleets_are_compared(maps: tuple[MapFile, ...], capsys: pytest.CaptureFixture[str]) -> None:
    fleet = ["fleet", "--maps", "maps", "--robots", "2", "--vary", "fleet.coordination=claims,none"]
    fleet += ["--time-limit", "1.5", "--beams", "16", "--range", "1"]
    store, rows = compared([*fleet, "--set", "controller.horizon=8"], capsys)
    assert {row["explorer"] for row in rows} == {"coordination claims", "coordination none"}
    assert len(rows) == 8
    row = rows[1]
    recording = recorded(row)
    assert isinstance(recording, ExplorationRecording)
    metrics = recording.metrics()
    robots = np.stack([np.asarray(recording.start), *np.asarray(recording.records.state)])
    names = recording.state_names
    ways = [robots[:, [names.index(f"x_{n}"), names.index(f"y_{n}")]] for n in (1, 2)]
    kept = [0, 10, 20, 30]
    expected = np.concatenate([way[kept, 0] for way in ways])
    np.testing.assert_array_equal(row["positions_x"], expected)
    lengths = [np.hypot(*np.diff(way.astype(float), axis=0).T).sum() for way in ways]
    assert row["path_length"] == pytest.approx(sum(lengths), rel=1e-4)
    assert row["coverage"] == pytest.approx(metrics.coverage)
    assert {str(level): row[f"time_to_{level}"] for level in LEVELS} == metrics.time_to
    assert row["collisions"] == metrics.collisions + metrics.contacts
    seen = decode_cells(row["seen"], recording.world.shape)
    assert seen is not None
    for index, frame in enumerate(recording.frames):
        known = np.abs(frame.probability / 127.5 - 1.0) >= 0.5**0.5
        assert (seen[known] <= index).all()
    assert json.loads((store.folder / "comparison.json").read_text())["settings"]["fleet"] == {
        "robots": 2
    }


def test_volumes_are_compared(capsys: pytest.CaptureFixture[str]) -> None:
    hall = np.zeros((10, 20, 25), bool)
    hall[[0, -1]] = hall[:, [0, -1]] = hall[:, :, [0, -1]] = True
    for name, column in (("narrow", 8), ("wide", 18)):
        block = hall.copy()
        block[:6, 10:14, column : column + 3] = True
        np.save(f"{name}.npy", block)
    volumes = ["--maps", "narrow.npy,wide.npy", "--architectures", "explorer"]
    volumes += ["--vary", "controller.temperature=1,5", "--time-limit", "1"]
    volumes += ["--set", "resolution=0.2", "--set", "camera.columns=12", "--set", "camera.rows=8"]
    store, rows = compared(volumes, capsys)
    assert len(rows) == 8
    assert json.loads((store.folder / "comparison.json").read_text())["kind"] == "volume"
    row = rows[0]
    recording = recorded(row)
    assert isinstance(recording, VolumeRecording)
    done = np.append(recording.records.coverage, recording.records.coverage[-1])
    steps = np.linalg.norm(np.diff(recording.positions, axis=0), axis=1)
    _check_levels(row, done, np.concatenate([[0.0], np.cumsum(steps)]), recording.control_period)
    seen = decode_cells(row["seen"], (20, 25))
    assert seen is not None
    for index, frame in enumerate(recording.frames):
        columns = frame.find_occupied((10, 20, 25)).any(axis=0)
        assert (seen[columns] <= index).all()
        assert not (seen == index)[~columns].any()
    maps = (MapFile("narrow", str(Path("narrow.npy").resolve()), "x", selector="volume"),)
    ((plan, datum),) = read_plans(maps, {"resolution": 0.2}).values()
    assert not datum
    # The block is as high as five of the eight layers between floor and ceiling.
    assert float(plan.probability[11, 9]) == pytest.approx(5 / 8)
    assert float(plan.probability[5, 5]) == 0.0
    assert float(plan.probability[0, 5]) == 1.0


def test_paths_are_compared(capsys: pytest.CaptureFixture[str]) -> None:
    Path("ways").mkdir()
    turn = np.linspace(0.0, np.pi / 2, 20)
    for name, radius in (("bend", 4.0), ("long", 6.0)):
        points = radius * np.stack([np.sin(turn), 1.0 - np.cos(turn)], axis=1)
        np.savetxt(f"ways/{name}.csv", points, delimiter=",")
    paths = ["--maps", "ways", "--vary", "cost.progress.weight=100,1000", "--time-limit", "1"]
    _, rows = compared(paths, capsys)
    assert [row["map"] for row in rows] == ["bend"] * 4 + ["long"] * 4
    row = rows[0]
    recording = recorded(row)
    assert isinstance(recording, PathRecording)
    # The quarter of a circle is as long as its angle times its radius.
    length = 4.0 * np.pi / 2
    driven = np.concatenate([[0.0], recording.records.progress])
    assert row["coverage"] == pytest.approx(driven[-1] / length, abs=0.02)
    assert row["seen"] is None
    maps = (MapFile("bend", str(Path("ways/bend.csv").resolve()), "x", selector="path"),)
    ((plan, _),) = read_plans(maps, {"half_width": 0.5}).values()
    rows_, columns = np.mgrid[: plan.shape[0], : plan.shape[1]]
    centres = np.asarray(plan.frame.origin)[:2] + plan.resolution * (
        np.stack([columns, rows_], axis=-1) + 0.5
    )
    away = np.abs(np.hypot(centres[..., 0], centres[..., 1] - 4.0) - 4.0)
    on_arc = (centres[..., 0] > 0.1) & (centres[..., 1] < 3.9)
    is_free = np.asarray(plan.probability) == 0.0
    assert is_free[on_arc & (away < 0.49)].all()
    assert not is_free[on_arc & (away > 0.51)].any()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--maps", "forest", "--beams", "16"], "lidar.num_beams is 16 in a volume; accepted"),
        (["--maps", "forest", "--robots", "2"], "fleet.robots is 2 in a volume; accepted: on a"),
        (["--maps", "track"], "--vary is missing; accepted here: --vary NAME=A,B"),
        (["--maps", "forest,track"], "'forest' is no path; accepted: "),
        (["volume", "--maps", "maps"], "folder of maps 'maps' holds no volume, neither do the"),
        (["--maps", "forest,gone.npy"], "folder of maps 'gone.npy' cannot be read"),
        (["--maps", "forest", "--set", "file.scale=2"], "setting file.scale is 2.0, which volume"),
        (["--maps", "forest", "--vary", "robot.radius=0.2,0.3"], "differ in the settings robot"),
        (["--maps", "forest", "--architectures", "wander,portfolio"], "architecture is 'portfoli"),
        (["--maps", "maps", "--set", "portfolio.decomposition=roles", "--architectures",
          "explorer"], "setting portfolio.decomposition is 'roles', which architecture"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_is_one_line(
    maps: tuple[MapFile, ...],
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    reason: str,
) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["compare", *arguments, *SHORT])
    assert exit_.value.code == 2
    shown = capsys.readouterr()
    assert shown.err.startswith("jaxplore: ")
    assert shown.err.count("\n") == 1
    assert reason in shown.err
    assert not Path("out").exists()
