"""The same coverage over time has the same times in the plane, in a volume and by a fleet."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.parts.targets.report import TargetRecord, TargetReport
from jaxplore.report.compute import Timing
from jaxplore.report.coverage_levels import (
    LEVELS,
    at_instants,
    describe_levels,
    find_first,
    reach_levels,
)
from jaxplore.report.volume.data import VolumeRecord
from jaxplore.report.volume.recording import VolumeRecording

SHARES = st.lists(st.floats(0.0, 1.0, width=32), max_size=12)
ON_LEVELS = st.lists(st.sampled_from([0.2, *(np.float32(each / 100) for each in LEVELS)]))


@given(SHARES | ON_LEVELS, st.floats(0.0, 1.0, width=32))
def test_a_level_is_reached_at_the_first_instant_that_has_it(shares: list, initial: float) -> None:
    coverage = at_instants(np.asarray(shares, np.float32), initial)
    assert len(coverage) == len(shares) + 1
    path = np.arange(len(coverage)) * 0.25
    found = reach_levels(coverage, path, 0.5)
    # Instant k is the beginning of step k, whose record has what was known then.
    rows = [*shares, shares[-1] if shares else initial]
    for level in LEVELS:
        # Single precision has no number for some shares: the nearest one counts.
        least = Fraction(float(np.float32(level / 100)))
        first = next((k for k, row in enumerate(rows) if Fraction(float(row)) >= least), None)
        assert found["time_to"][str(level)] == (None if first is None else 0.5 * first)
        assert found["path_to"][str(level)] == (None if first is None else 0.25 * first)


def test_levels_in_words() -> None:
    assert (
        describe_levels({"50": 2.0, "90": 31.25, "95": None})
        == "50 % after 2.0 s, 90 % after 31.2 s"
    )
    assert describe_levels({"50": None, "90": None}) == "less than 50 %"
    assert find_first(np.array([0.2, 0.7]), 0.8) is None


def fly(coverage: list[float], target: float = 0.99, **changes: object) -> VolumeRecording:
    """Return a flight along x, 0.1 m a step, with a coverage at each step."""
    steps = len(coverage)
    states = np.zeros((steps + 1, 3), np.float32)
    states[:, 0] = 0.1 * np.arange(steps + 1)
    ones = np.ones(steps, np.float32)
    return VolumeRecording(
        records=VolumeRecord(
            states[1:],
            np.zeros((steps, 4), np.float32),
            np.asarray(coverage, np.float32),
            ones,
            np.zeros(steps, bool),
            ones,
            np.ones(steps, bool),
        ),
        frames=(),
        timing=Timing(0.0, 0.0, 0, np.zeros(0)),
        control_period=0.5,
        is_interrupted=False,
        world=np.zeros((2, 2, 2), bool),
        belief=np.zeros((2, 2, 2), np.uint8),
        observable=np.ones((2, 2, 2), bool),
        resolution=0.5,
        origin=np.zeros(3),
        start=states[0],
        state_names=("x", "y", "z"),
        initial_coverage=0.1,
        target_coverage=target,
        robot_radius=0.3,
        **changes,
    )


def test_a_search_in_a_volume_is_judged_by_its_targets() -> None:
    run = fly([0.2, 0.5, 0.6, 0.7], parts={"targets": TargetReport(np.zeros((2, 3)))})
    for seen, last, end in (([0, 1, 2, 2], 1.0, 1.5), ([0, 1, 1, 1], None, None)):
        record = {"targets": TargetRecord(np.asarray(seen, np.int32))}
        records = run.records._replace(parts=record)
        found = dataclasses.replace(run, records=records)
        metrics = found.metrics()
        targets = metrics.parts["targets"]
        assert (targets.number, targets.seen, targets.last_at) == (2, seen[-1], last)
        assert metrics.finished_at == end
        assert metrics.series()["targets"][-1] == seen[-1]
        text = "2 of 2 seen, the last at 1.00 s" if last else "1 of 2 seen"
        assert ("targets", text) in metrics.rows()
        assert found.live_curves.names == ("coverage", "targets found")
        np.testing.assert_array_equal(found.live_curves.values[1], np.asarray(seen) / 2)
    moved = run.move(np.array([5.0, -3.0]))
    np.testing.assert_array_equal(moved.parts["targets"].places, [[5.0, -3.0, 0.0]] * 2)


SHARE = [0.2, float(np.float32(0.5)), 0.7, float(np.float32(0.9)), float(np.float32(0.95)), 0.97]


def test_all_kinds_tell_the_same_times(make_recording, fleet_run) -> None:
    alone = make_recording([(0.1 * k, 0.5) for k in range(7)], SHARE)
    known = fleet_run.records._replace(coverage=np.asarray(SHARE, np.float32))
    team = dataclasses.replace(fleet_run, records=known, control_period=0.5)
    wanted = {"50": 0.5, "90": 1.5, "95": 2.0, "99": None}
    for each in (alone, team, fly(SHARE)):
        metrics = each.metrics()
        assert metrics.time_to == wanted, type(each)
        assert metrics.levels == LEVELS
        (curve, *_) = metrics.plotted
        assert curve.label.endswith("[%]")
        assert curve.scale == 100.0
        np.testing.assert_allclose(metrics.series()["coverage"][0], 0.2)


@pytest.mark.parametrize(
    ("coverage", "target", "end"),
    [
        (SHARE, 0.97, 3.0),
        (SHARE, 0.98, None),
        # A run that begins at its target takes no step.
        ([], 0.05, 0.0),
    ],
)
def test_a_flight_ends_with_the_step_that_reaches_its_target(coverage, target, end) -> None:
    metrics = fly(coverage, target).metrics()
    assert metrics.finished_at == end
    assert metrics.is_finished == (end is not None)


def test_a_flight_that_was_given_up_says_so() -> None:
    rows = dict(fly(SHARE, given_up_step=6).metrics().rows())
    assert rows["duration"] == "3.00 s, 6 steps, given up after 3.00 s"
    assert rows["coverage"] == (
        "97.0 % of 1.0 m³, 50 % after 0.5 s, 90 % after 1.5 s, 95 % after 2.0 s"
    )
    assert rows["path"] == "0.6 m, 0.20 m/s in the mean"
