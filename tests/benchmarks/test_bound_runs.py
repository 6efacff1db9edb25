"""Runs beside the bounds: kinds of metres, ratios, the picture and the command."""

import dataclasses
import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from benchmarks.bound.__main__ import kind_rows, main, ratio_rows
from benchmarks.bound.floor import lower_bound
from benchmarks.bound.metres import KINDS, Split, Steps, slow_seconds, split_metres
from benchmarks.bound.picture import picture
from benchmarks.bound.problem import Problem
from benchmarks.bound.run import LEVELS, Bound, Driven
from benchmarks.bound.tour import Tour
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.report.compute import Timing
from jaxplore.report.drawing.figure import figure_bytes
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.tasks.registry import make_settings

PERIOD = 0.1


def split(
    places: np.ndarray, gain: np.ndarray, detour: Callable[[int, int], float] | None = None
) -> Split:
    """Split a path on open ground, where the shortest way is straight."""
    metres = np.hypot(*np.diff(places, axis=0).T)

    def straight(first: int, last: int) -> float:
        return math.dist(places[first], places[last])

    return split_metres(
        Steps(places, gain, metres, PERIOD), straight, detour or (lambda _, __: math.inf)
    )


def ahead(seconds: float) -> np.ndarray:
    """Places of a robot that drives ahead at 1 m/s."""
    along = np.arange(round(seconds / PERIOD) + 1) * PERIOD
    return np.stack([along, np.zeros_like(along)], axis=1)


@given(st.integers(0, 2**32 - 1))
def test_kinds_of_metres_sum_to_the_path(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 200))
    places = np.cumsum(rng.normal(0.0, 0.1, (count + 1, 2)), axis=0)
    places[rng.random(count + 1) < 0.1] = places[0]
    gain = np.where(rng.random(count + 1) < 0.3, rng.exponential(0.1, count + 1), 0.0)
    found = split(places, gain, lambda before, scan: float((before + scan) % 3))
    length = sum(math.dist(*pair) for pair in itertools.pairwise(places))
    assert sum(found.lengths().values()) == pytest.approx(length)
    assert all(each >= -1e-9 for each in found.lengths().values())
    half = count // 2
    parts = [found.lengths(0, half), found.lengths(half)]
    for name in KINDS:
        assert found.lengths()[name] == pytest.approx(parts[0][name] + parts[1][name])


def test_metres_that_see_are_gain_and_those_that_see_little_are_slivers() -> None:
    places = ahead(10.0)
    gain = np.full(101, 0.2)
    gain[51:] = 0.03
    assert split(places, gain).lengths() == pytest.approx(
        {"gain": 5.0, "sliver": 5.0, "return": 0.0, "transit": 0.0, "dithering": 0.0}
    )


@pytest.mark.parametrize(("aside", "kind", "price"), [(1.0, "return", 3.0), (2.6, "transit", 0.0)])
def test_a_dry_stretch_is_a_return_where_a_detour_had_been_shorter(
    aside: float, kind: str, price: float
) -> None:
    places, gain = ahead(20.0), np.full(201, 0.2)
    gain[101:151] = 0.0
    asked = []

    def detour(before: int, scan: int) -> float:
        asked.append((before, scan))
        return aside

    found = split(places, gain, detour)
    # Dry from 10 m to 15 m; the path counts up to 7 m, and scan 151 sees something again.
    assert asked == [(70, 151)]
    assert found.lengths()[kind] == pytest.approx(5.0)
    assert found.lengths()["gain"] == pytest.approx(15.0)
    assert found.price.sum() == pytest.approx(price)


def test_short_dry_pieces_are_slivers_and_the_last_stretch_is_a_transit() -> None:
    places, gain = ahead(20.0), np.full(201, 0.2)
    gain[101:106], gain[151:] = 0.0, 0.0
    found = split(places, gain, lambda _, __: 0.0).lengths()
    assert found == pytest.approx(
        {"gain": 14.5, "sliver": 0.5, "return": 0.0, "transit": 5.0, "dithering": 0.0}
    )


def test_ways_back_and_forth_are_dithering() -> None:
    there = ahead(1.5)
    places = np.concatenate([there, there[-2::-1]])
    assert split(places, np.full(31, 0.2)).lengths()["dithering"] == pytest.approx(3.0)
    # 3 m along one side and 3 m along another one, in windows of 3 s: no window sees the bend.
    corner = np.concatenate([ahead(3.0), np.array([3.0, 0.0]) + ahead(3.0)[1:, ::-1]])
    assert split(corner, np.full(61, 0.2)).lengths()["dithering"] == pytest.approx(0.0)


def test_slow_seconds() -> None:
    below, lost = slow_seconds(np.array([1.0, 0.95, 0.5, 0.0, 1.1]), 0.1, 1.0)
    assert below == pytest.approx(0.2)
    assert lost == pytest.approx(0.1 * (0.05 + 0.5 + 1.0))


@pytest.fixture
def driven(tmp_path: Path) -> Driven:
    """A drive along the corridor of a small office and back to its middle."""
    settings = make_settings({"map": "office", "office": {"width": 8.0, "height": 7.0}})
    problem = Problem.from_settings(settings)
    row, column = problem.start
    columns = problem.cells[problem.cells[:, 0] == int(row), 1]
    last = columns[np.append(np.diff(columns) > 1, True)].min() + 0.5
    there = np.arange(column, last, 0.2)
    along = np.concatenate([there, there[-2 : len(there) // 2 : -1]])
    places = problem.to_world(np.stack([np.full_like(along, row), along], axis=1))
    steps = len(places) - 1
    states = np.zeros((steps + 1, 5), np.float32)
    states[:, :2] = places
    blank = np.zeros(steps, np.float32)
    records = ExplorationRecord(
        state=states[1:],
        control=np.zeros((steps, 2), np.float32),
        coverage=blank,
        entropy=blank,
        unknown=blank,
        unknown_map=blank,
        clearance=blank,
        is_collision=blank > 0,
        is_untraversable=blank > 0,
        effective_sample_size=blank,
        is_finite=blank == 0,
        is_faulty=blank > 0,
        parts={},
        members=None,
    )
    world = np.asarray(problem.world.probability)
    origin = np.asarray(problem.world.frame.origin)
    recording = ExplorationRecording(
        records=records,
        frames=(),
        timing=Timing(2.0, 1.0, 100, np.array([0.01])),
        control_period=0.02,
        world=world,
        belief=world,
        reachable=problem.reachable,
        origin=origin,
        resolution=problem.resolution,
        field_origin=origin,
        field_resolution=problem.resolution,
        start=states[0],
        initial_coverage=0.0,
        initial_entropy=1.0,
        initial_unknown=1.0,
        goal=None,
        finished_step=None,
        control_half_range=np.ones(2, np.float32),
        state_names=("x", "y", "yaw", "v", "omega"),
        robot_radius=problem.radius,
        target_coverage=0.99,
        is_interrupted=False,
        footprint=np.zeros((0, 2)),
        elevation=None,
        traversable=None,
        mover_radii=np.zeros(0),
        member_names=(),
    )
    return Driven(tmp_path, settings, recording, recording.metrics(seed=0), problem)


@pytest.fixture
def bound(driven: Driven) -> Bound:
    problem = driven.problem
    line = np.stack([problem.start, problem.start + np.array([0.0, 8.0])])
    tour = Tour(line, 8.0 * problem.resolution, 0.99, 0.99)
    floors = {level: lower_bound(problem, level / 100.0) for level in LEVELS}
    return Bound(dict.fromkeys(LEVELS, tour), floors)


def test_a_report_divides_the_run_by_the_tour(driven: Driven, bound: Bound) -> None:
    length = driven.metrics.path_length
    assert sum(driven.split.lengths().values()) == pytest.approx(length, rel=1e-4)
    assert 0.0 < driven.coverage[0] < driven.coverage[-1]
    assert (np.diff(driven.coverage) >= 0.0).all()
    assert driven.steps.gain.sum() == pytest.approx(
        driven.coverage[-1] * driven.problem.num_cells * driven.problem.resolution**2
    )
    never = driven.report(bound)
    assert [row["to tour"] for row in ratio_rows([never])] == [None, None]
    assert list(never["phases"]) == ["to 90", "to the end, below 99"]
    reached = dataclasses.replace(
        driven.metrics, path_to={"90": 2.4, "99": 4.0}, time_to={"90": 3.0, "99": 5.0}
    )
    report = dataclasses.replace(driven, metrics=reached).report(bound)
    tour = bound.tours[90].metres
    assert [row["to tour"] for row in ratio_rows([report])] == pytest.approx(
        [2.4 / tour, 4.0 / tour]
    )
    total = sum(row[kind] for row in kind_rows([report]) for kind in KINDS)
    assert total == pytest.approx(length, rel=1e-4)
    assert json.loads(json.dumps(report))["map"] == "office"
    assert figure_bytes(picture(driven, bound)).startswith(b"\x89PNG")


def test_folders_that_hold_no_run_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "settings.yaml").write_text("path: track\n")
    for folder, reason in ((tmp_path / "none", "settings.yaml"), (tmp_path, "along a path")):
        with pytest.raises(SystemExit) as ended:
            main([str(folder)])
        assert ended.value.code == 2
        told = capsys.readouterr().err
        assert reason in told
        assert told.count("\n") == 1
    for option in (["--starts", "0"], ["--spacing", "nan"], ["--rounds", "many"]):
        with pytest.raises(SystemExit) as ended:
            main([str(tmp_path), *option])
        assert ended.value.code == 2
