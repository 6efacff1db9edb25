import dataclasses
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import jaxplore as jx
from jaxplore.report.exploration.evaluation import compute_metrics
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.simulation.exploration.reachability import open_spot
from jaxplore.simulation.run import record_run
from jaxplore.study.comparison.episodes import EpisodeBatch, MapEpisode, make_episodes
from jaxplore.study.comparison.maps import MapFile
from jaxplore.study.comparison.replay import NEVER
from jaxplore.study.comparison.row_task import RowTask, make_rows
from jaxplore.study.comparison.rows import (
    COLUMNS,
    TIMING,
    Row,
    make_failed_row,
    make_row,
    store_row,
)
from jaxplore.tasks.registry import build, make_settings

pytestmark = pytest.mark.long


def read(data: bytes) -> list[Row]:
    import pyarrow.parquet

    return pyarrow.parquet.read_table(io.BytesIO(data)).to_pylist()


def _check_replay(row: Row, recording: ExplorationRecording) -> None:
    """Each cell is there at the instant at which it was first known."""
    assert row["seen_time"] == [frame.time for frame in recording.frames]
    assert len(recording.frames) > 2
    picture = np.asarray(Image.open(io.BytesIO(row["seen"])))[::-1]
    assert picture.shape == recording.world.shape
    known = [np.abs(frame.probability / 127.5 - 1.0) >= 0.5**0.5 for frame in recording.frames]
    ever = np.logical_or.accumulate(known)
    for index, seen in enumerate(ever):
        np.testing.assert_array_equal(picture <= index, seen)
    np.testing.assert_array_equal(picture == NEVER, ~ever[-1])
    assert (picture == 0).any()
    assert len(np.unique(picture[picture != NEVER])) > 2
    assert (picture == NEVER).any()


def test_a_row_says_what_the_run_was(episodes: tuple[MapEpisode, ...]) -> None:
    episode = episodes[1]
    (row,) = make_rows((episode,))
    assert list(row) == list(COLUMNS)
    settings = make_settings(episode.entries)
    controller, scenario, num_steps, key = build(settings)
    recording = record_run(controller, scenario, num_steps, key=key)
    metrics = compute_metrics(recording, seed=episode.seed)
    named = {
        "format": 3,
        "id": episode.id,
        "map": "east",
        "explorer": "explorer",
        "seed": 1,
        "error": None,
        "time_to_50": metrics.time_to["50"],
        "path_to_50": metrics.path_to["50"],
        "time_to_99": None,
        "path_to_99": None,
        "time_limit": 1.5,
    }
    same = ("is_finished", "coverage", "path_length", "duration", "final_entropy", "collisions")
    same += ("minimum_clearance", "information_per_metre", "command_jerk")
    assert {name: row[name] for name in named} == named
    assert {name: row[name] for name in same} == {name: getattr(metrics, name) for name in same}
    assert 0.2 < row["coverage"] < 0.99
    assert row["path_length"] > 0.02
    assert row["collisions_per_100m"] == 100.0 * row["collisions"] / row["path_length"]
    # What is seen at the beginning of a step counts for that step.
    assert row["area_under_curve"] == pytest.approx(
        sum(0.05 * float(each) for each in recording.records.coverage) / 1.5
    )
    assert row["curve_time"] == [0.0, 0.5, 1.0, 1.5]
    for name in ("coverage", "path", "entropy"):
        assert row[f"curve_{name}"] == metrics.coverage_curve[name]
    positions = [recording.start, *recording.records.state[[9, 19, 29]]]
    assert row["positions_x"] == [float(each[0]) for each in positions]
    assert row["positions_y"] == [float(each[1]) for each in positions]
    _check_replay(row, recording)
    assert json.loads(row["settings"]) == settings.model_dump(mode="json")
    assert json.loads(row["versions"]) == metrics.versions
    (again,) = make_rows((episode,))
    different = {name for name in row if row[name] != again[name]}
    assert {"loop_step_ms"} <= different <= set(TIMING)
    assert read(store_row(row).data) == [row]
    assert make_rows(episodes[:1])[0]["positions_x"] != row["positions_x"]


def test_a_run_that_ends_keeps_its_coverage_to_the_time_limit(
    episodes: tuple[MapEpisode, ...],
) -> None:
    entries = {**episodes[0].entries, "target_coverage": 0.3, "time_limit": 3.0}
    settings = make_settings(entries)
    controller, scenario, num_steps, key = build(settings)
    recording = record_run(controller, scenario, num_steps, key=key, num_trajectories=0)
    row = make_row(episodes[0], recording, compute_metrics(recording), settings=settings)
    assert row["is_finished"]
    steps = recording.num_steps
    assert row["duration"] == pytest.approx(0.05 * steps)
    assert 0 < steps < 59
    seen = [float(each) for each in recording.records.coverage]
    seen += [seen[-1]] * (60 - steps)
    assert row["area_under_curve"] == pytest.approx(np.mean(seen))
    assert row["curve_time"][-1] == round(row["duration"], 5)
    assert len(row["positions_x"]) == len(row["curve_time"])
    assert row["positions_x"][-1] == float(recording.positions[-1, 0])


def test_without_a_start_it_is_the_most_open_spot(episodes: tuple[MapEpisode, ...]) -> None:
    west = episodes[2]
    (row,) = make_rows((west,))
    x, y = open_spot(jx.OccupancyGrid.from_ros(west.path), 0.2)
    assert json.loads(row["settings"])["start"] == [x, y, 0.0]
    assert (row["positions_x"][0], row["positions_y"][0]) == tuple(np.float32([x, y]))
    assert row["id"] == west.id


def test_a_copy_of_the_map_leaves_no_trace(
    maps: tuple[MapFile, ...], small: dict[str, object], tmp_path: Path
) -> None:
    (episode,) = make_episodes(maps[1:], ("explorer",), (0,), small)
    Path(episode.path).rename(tmp_path / "copy.yaml")
    Path(episode.path).with_suffix(".pgm").rename(tmp_path / "west.pgm")
    elsewhere = dataclasses.replace(
        RowTask.from_episodes((episode,)), copy=str(tmp_path / "copy.yaml")
    )
    (result,) = elsewhere.run()
    (row,) = read(result.data)
    assert row["error"] is None
    assert json.loads(row["settings"])["map"] == episode.path
    (tmp_path / "west.pgm").unlink()
    (result,) = elsewhere.run()
    (row,) = read(result.data)
    assert row["error"].startswith(f"{episode.path}: image is 'west.pgm', which is not there")
    assert json.loads(row["settings"])["map"] == episode.path


def test_what_fails_is_a_row_of_one_line(episodes: tuple[MapEpisode, ...]) -> None:
    def wrong(batch: EpisodeBatch) -> list[Row]:
        raise ValueError("this\n  is wrong")

    def broken(batch: EpisodeBatch) -> list[Row]:
        raise TypeError("a bug")

    def stopped(batch: EpisodeBatch) -> list[Row]:
        raise KeyboardInterrupt

    results = [
        result
        for each in (wrong, broken)
        for result in RowTask.from_episodes(episodes[:1], each).run()
    ]
    assert [each.error for each in results] == ["this is wrong", "TypeError: a bug"]
    assert [each[:2] for each in results] == [(episodes[0].id, "east")] * 2
    (row,) = read(results[0].data)
    own = {name: row[name] for name in row if row[name] is not None}
    assert list(own) == [
        *("format", "id", "map", "explorer", "seed", "error"),
        *("time_limit", "settings"),
    ]
    assert row == make_failed_row(episodes[0], "this is wrong")
    assert json.loads(row["settings"]) == episodes[0].entries
    with pytest.raises(KeyboardInterrupt):
        RowTask.from_episodes(episodes[:1], stopped).run()
    assert [each.id for each in RowTask.from_episodes(episodes[:2], wrong).run()] == [
        each.id for each in episodes[:2]
    ]


def test_runs_side_by_side_are_the_same_whichever_are_asked_for(
    maps: tuple[MapFile, ...], small: dict[str, object]
) -> None:
    episodes = make_episodes(maps[:1], ("explorer",), range(4), small, 2)
    (alone,) = make_rows(make_episodes(maps[:1], ("explorer",), (1,), small))
    both = make_rows(episodes[:2])
    (second,) = make_rows((episodes[1],))
    assert [row["id"] for row in both] == [episode.id for episode in episodes[:2]]
    assert [row["seed"] for row in both] == [0, 1]
    assert [json.loads(row["settings"])["seed"] for row in both] == [0, 1]
    assert {name for name in second if second[name] != both[1][name]} <= set(TIMING)
    assert both[0]["positions_x"] != both[1]["positions_x"]
    # As if it were alone, but for rounding: so it is another run by name.
    assert second["id"] != alone["id"]
    np.testing.assert_allclose(second["positions_x"], alone["positions_x"], atol=1e-3)
    assert second["coverage"] == pytest.approx(alone["coverage"], abs=0.02)
    assert second["seen_time"] == alone["seen_time"]
