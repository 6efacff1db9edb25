import dataclasses
import json

import numpy as np
import pytest

from jaxplore.control.stops import REASONS
from jaxplore.parts.watch.report import WatchRecord, WatchReport
from jaxplore.report.drawing.colours import TARGET
from jaxplore.report.exploration.data import LocalisationData
from jaxplore.report.exploration.evaluation import compute_metrics
from jaxplore.report.exploration.guard import guard_metrics
from jaxplore.report.exploration.progress import progress
from jaxplore.report.recording_arrays import pack_recording, unpack_recording


def test_levels_are_timed_at_the_beginning_of_the_step_that_records_them(recording):
    metrics = compute_metrics(recording)
    assert metrics.time_to == {"50": 1.5, "90": 3.0, "95": 3.5, "99": 4.5}
    assert metrics.path_to == pytest.approx({"50": 0.6, "90": 1.2, "95": 1.4, "99": 1.8})
    assert metrics.duration == 5.0
    assert metrics.num_steps == 10
    assert metrics.path_length == pytest.approx(2.0)
    assert metrics.coverage == pytest.approx(0.99)
    assert metrics.is_finished
    assert metrics.initial_entropy == 100.0
    assert metrics.final_entropy == 10.0
    assert metrics.reachable_area == pytest.approx(18 * 28 * 0.01)


def test_a_search_by_a_fleet_counts_its_targets(fleet_run, make_search):
    seen, places = np.array([0, 0, 1, 1, 2, 2]), np.array([[0.5, 0.5], [1.5, 1.0]])
    searched = make_search(fleet_run, places, seen, lambda step: np.array([step > 2, step > 4]))
    metrics = searched.metrics()
    own = metrics.parts["targets"]
    assert (own.number, own.seen) == (2, 2)
    # The record of step 4 has what was seen at its beginning.
    assert own.last_at == pytest.approx(0.4)
    assert ("targets", "2 of 2 seen, the last at 0.40 s") in metrics.rows()
    curves = searched.live_curves
    assert curves.names == ("robot 1", "robot 2", "together", "targets found")
    np.testing.assert_allclose(curves.values[-1], seen / 2)
    plain, marked = (
        np.asarray(each.frame_image(each.frames[-1])) for each in (fleet_run, searched)
    )
    assert (marked == TARGET).all(axis=-1).sum() > 20 > (plain == TARGET).all(axis=-1).sum()
    labels = searched.figures()["map"]().axes[0].get_legend_handles_labels()[1]
    assert "target found" in labels
    moved = searched.move(np.array([10.0, 20.0]))
    np.testing.assert_allclose(moved.parts["targets"].places, places + np.array([10.0, 20.0]))
    without = fleet_run.metrics()
    assert "targets" not in without.parts
    assert "targets" not in dict(without.rows())


def test_levels_never_reached_are_none(make_recording):
    metrics = compute_metrics(make_recording([(1.0, 1.0)] * 4, [0.2, 0.6, 0.6]))
    assert metrics.time_to == {"50": 0.5, "90": None, "95": None, "99": None}
    assert metrics.path_to == {"50": 0.0, "90": None, "95": None, "99": None}
    assert not metrics.is_finished


def test_contacts_are_runs_of_steps(recording):
    contact = np.array([1, 1, 0, 0, 1, 0, 1, 1, 1, 0], bool)
    records = recording.records._replace(is_collision=contact)
    metrics = compute_metrics(dataclasses.replace(recording, records=records))
    assert (metrics.collisions, metrics.collision_steps) == (3, 6)


@pytest.mark.parametrize(
    ("positions", "coverage", "seconds"),
    [
        # It stands still for four periods, and the map does not grow.
        ([0, 1, 1, 1, 1, 1, 2], [0.1, 0.2, 0.2, 0.2, 0.2, 0.2], 2.0),
        # The map grows in the middle of it: two instants before, three from then on.
        ([0, 1, 1, 1, 1, 1, 2], [0.1, 0.2, 0.2, 0.3, 0.3, 0.3], 1.0),
        # A loss of coverage and its return are no progress.
        ([0, 1, 1, 1, 1, 1, 2], [0.1, 0.2, 0.1, 0.2, 0.15, 0.2], 2.0),
        # To and fro within half a metre counts, one centimetre more does not.
        ([0.0, 0.5, 0.0, 0.5, 0.0], [0.2] * 4, 2.0),
        ([0.0, 0.51, 0.0, 0.51, 0.0], [0.2] * 4, 0.0),
        # Slow drift: three steps of 0.2 m are too many.
        ([0.0, 0.2, 0.4, 0.6, 0.8], [0.2] * 4, 1.0),
    ],
)
@pytest.mark.parametrize("axis", [0, 1])
def test_longest_stall(make_recording, positions, coverage, seconds, axis):
    route = [(x, 0.0) if axis == 0 else (0.0, x) for x in positions]
    assert compute_metrics(make_recording(route, coverage)).longest_stall == seconds


def test_longest_stall_equals_that_of_an_exhaustive_search(make_recording):
    rng = np.random.default_rng(0)
    route = np.cumsum(rng.normal(0.0, 0.08, (120, 2)), axis=0).astype(np.float32)
    coverage = np.round(np.sort(rng.uniform(0.0, 1.0, 119)), 1)
    recording = make_recording(route.tolist(), coverage.tolist())
    best = np.maximum.accumulate(progress(recording)[1])
    positions = recording.positions.astype(float)
    expected = max(
        last - first
        for first in range(120)
        for last in range(first, 120)
        if best[first] == best[last] and (np.ptp(positions[first : last + 1], axis=0) <= 0.5).all()
    )
    assert compute_metrics(recording).longest_stall == expected * 0.5
    assert expected > 3


def test_compute(recording):
    compute = compute_metrics(recording).compute
    assert compute.step_ms_p50 == pytest.approx(20.0)
    assert compute.step_ms_p99 == pytest.approx(29.8)
    assert compute.loop_step_ms == pytest.approx(10.0)
    assert compute.steps_per_second == pytest.approx(100.0)
    assert compute.real_time_factor == pytest.approx(50.0)
    assert compute.compile_seconds == 2.0


def test_without_a_step(no_step):
    timing = dataclasses.replace(
        no_step.timing, loop_seconds=0.0, loop_steps=0, step_seconds=np.zeros(0)
    )
    metrics = compute_metrics(dataclasses.replace(no_step, timing=timing))
    assert (metrics.duration, metrics.num_steps, metrics.path_length) == (0.0, 0, 0.0)
    assert metrics.coverage == pytest.approx(0.01)
    assert metrics.final_entropy == metrics.initial_entropy == 100.0
    assert metrics.minimum_clearance is None
    assert metrics.mean_effective_sample_size is None
    assert metrics.compute.step_ms_p50 is metrics.compute.loop_step_ms is None
    assert metrics.coverage_curve["time"] == [0.0]
    assert "coverage" in str(metrics)
    json.dumps(metrics.as_dict(), allow_nan=False)


def test_values_that_are_not_finite_become_none_or_are_left_out(recording):
    sizes = np.array([np.nan, 4.0, 6.0] + [np.inf] * 7, np.float32)
    records = recording.records._replace(
        effective_sample_size=sizes,
        clearance=np.full(10, np.nan, np.float32),
        is_finite=np.arange(10) > 2,
        entropy=np.full(10, np.nan, np.float32),
    )
    metrics = compute_metrics(dataclasses.replace(recording, records=records))
    assert metrics.mean_effective_sample_size == 5.0
    assert metrics.minimum_effective_sample_size == 4.0
    assert metrics.minimum_clearance is None
    assert metrics.final_entropy is None
    assert metrics.non_finite_steps == 3
    json.dumps(metrics.as_dict(), allow_nan=False)
    str(metrics)


def test_curve_has_a_point_every_half_second_and_the_end(make_recording):
    route = [(0.1 * k, 0.0) for k in range(8)]
    recording = make_recording(route, [0.1 * k for k in range(7)], control_period=0.2)
    curve = compute_metrics(recording).coverage_curve
    assert curve["time"] == pytest.approx([0.0, 0.4, 0.8, 1.2, 1.4])
    assert curve["coverage"] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.6], abs=1e-5)
    assert curve["path"] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.7], abs=1e-5)


def test_text_is_aligned_and_names_the_run(recording):
    metrics = compute_metrics(recording, seed=7)
    lines = str(metrics).splitlines()
    column = lines[0].index("99.0")
    assert all(line[column - 1] == " " != line[column] for line in lines)
    assert metrics.seed == 7
    assert metrics.versions["device"]
    interrupted = compute_metrics(dataclasses.replace(recording, is_interrupted=True))
    assert "interrupted" in str(interrupted)


def test_unknown_is_what_the_step_begins_with_and_stays_after_the_last(recording) -> None:
    metrics = compute_metrics(recording)
    assert metrics.coverage_curve["time"] == [0.5 * k for k in range(11)]
    # The records say 0.9 to 0.1 in ten steps; nothing is sensed after the last one.
    expected = [0.9 - 0.8 * k / 9 for k in range(10)] + [0.1]
    assert metrics.coverage_curve["unknown"] == pytest.approx(expected, abs=1e-5)
    assert metrics.final_unknown == pytest.approx(0.1)


def test_unknown_has_the_points_of_the_other_curves(make_recording) -> None:
    recording = make_recording([(0.1, 0.0)] * 8, [0.5] * 7, control_period=0.2)
    unknown = np.array([0.75, 0.5, 0.25, 0.5, 1 / 3, 0.0, 0.125], np.float32)
    records = recording.records._replace(unknown=unknown)
    curve = compute_metrics(dataclasses.replace(recording, records=records)).coverage_curve
    assert curve["unknown"] == [0.75, 0.25, 0.33333, 0.125, 0.125]
    assert {len(values) for values in curve.values()} == {5}


def test_unknown_without_a_step_is_what_it_was_at_the_start(no_step) -> None:
    changed = dataclasses.replace(no_step, initial_unknown=0.375)
    metrics = compute_metrics(changed)
    assert metrics.coverage_curve["unknown"] == [0.375]
    assert metrics.final_unknown == metrics.initial_unknown == 0.375


def test_targets_are_counted_and_the_last_of_all_is_timed(vehicle) -> None:
    # One more is seen at the beginning of steps 3, 6 and 9, half a second each.
    own = compute_metrics(vehicle).parts["targets"]
    assert (own.number, own.seen, own.last_at) == (3, 3, 4.5)
    record = vehicle.records.parts["targets"]
    fewer = record._replace(targets_seen=np.minimum(record.targets_seen, 2))
    records = vehicle.records._replace(parts={**vehicle.records.parts, "targets": fewer})
    metrics = compute_metrics(dataclasses.replace(vehicle, records=records))
    own = metrics.parts["targets"]
    assert (own.number, own.seen, own.last_at) == (3, 2, None)
    assert ("targets", "2 of 3 seen") in metrics.rows()


@pytest.mark.parametrize(
    ("steps", "mean", "worst"),
    [(1, 1.0, 9.0), (2, 2.0, 8.0), (3, 2.5, 8.0), (4, 3.5, 7.0), (5, 4.0, 7.0)],
)
def test_idleness_counts_in_the_second_half(make_recording, steps, mean, worst) -> None:
    recording = make_recording([(1.0, 1.0)] * (steps + 1), [0.5] * steps)
    k = np.arange(steps, dtype=np.float32)
    records = recording.records._replace(parts={"watch": WatchRecord(1.0 + k, 9.0 - k)})
    parts = {"watch": WatchReport(recording.belief, is_patrol=True)}
    watched = dataclasses.replace(recording, records=records, parts=parts)
    metrics = compute_metrics(watched).parts["watch"]
    assert (metrics.mean_idleness, metrics.worst_idleness) == (mean, worst)
    assert compute_metrics(dataclasses.replace(watched, parts={})).parts == {}


def test_members_are_judged_by_what_is_finite(vehicle) -> None:
    metrics = compute_metrics(vehicle)
    assert metrics.members == {
        "bold": pytest.approx(
            {"share": 0.275, "uncertainty": 0.125, "effective_sample_size": 5.5, "cost": 4.5}
        ),
        "careful": pytest.approx(
            {"share": 0.225, "uncertainty": 0.25, "effective_sample_size": 10.0, "cost": 9.0}
        ),
        "slow": {"share": 0.5, "uncertainty": 0.5, "effective_sample_size": 0.0, "cost": None},
    }
    assert (metrics.diversity, metrics.replaced) == (0.25, 0.2)
    assert metrics.untraversable_steps == 2
    wheels = metrics.parts["wheels"]
    assert wheels.load_transfer == pytest.approx(1.1)
    assert (wheels.tipped_at, wheels.num_tipped) == (pytest.approx(metrics.duration), 1)
    assert wheels.hanging_steps == sum(k % 4 == 3 for k in range(vehicle.num_steps))


def test_what_a_run_does_not_have_is_not_in_its_table(recording, vehicle, make_patrol) -> None:
    def rows(each):
        return dict(compute_metrics(each).rows())

    names = {"targets", "untraversable", "members", "  bold", "  careful", "  slow"}
    names |= {"load transfer", "wheel in the air", "tipped over"}
    plain, full = rows(recording), rows(vehicle)
    assert set(full) - set(plain) == names
    assert set(plain) <= set(full)
    assert full["targets"] == "3 of 3 seen, the last at 4.50 s"
    watching = rows(make_patrol(vehicle))
    assert watching["idleness"] == "7.0 s, 10.0 s at worst, in the second half"
    assert full["untraversable"] == "2 steps"
    assert full["load transfer"] == "110.0 % at most"
    assert full["wheel in the air"].endswith(" steps")
    assert full["tipped over"] == f"after {compute_metrics(vehicle).duration:.2f} s"
    assert full["members"] == "0.250 apart, replaced in 20.0 % of the steps"
    assert full["  bold"] == "27.5 %, 5.5 effective, uncertainty 0.125"
    metrics = compute_metrics(recording)
    assert metrics.untraversable_steps == 0
    assert metrics.parts == {}
    for name in ("members", "diversity"):
        assert getattr(metrics, name) is None
    assert metrics.replaced is None


def test_a_run_is_reported_by_what_it_is_judged_by(
    recording, vehicle, no_step, make_patrol
) -> None:
    patrol = dataclasses.replace(
        make_patrol(vehicle),
        initial_coverage=1.0,
        initial_unknown=0.0,
        records=vehicle.records._replace(coverage=np.ones_like(vehicle.records.coverage)),
        target_coverage=None,
        finished_step=None,
    )
    rows = dict(compute_metrics(patrol).rows())
    assert rows["map"].endswith("m², known in advance")
    assert not {"coverage", "  to 50 %", "entropy", "unknown", "information"} & set(rows)
    assert "idleness" in rows
    assert set(patrol.figures()) == {"map", "members", "idleness"}
    assert set(vehicle.figures()) == {"map", "coverage", "members"}
    for each in (recording, vehicle, patrol, no_step):
        assert [row for row in compute_metrics(each).rows() if row[1].startswith("- ")] == []
        assert [row for row in compute_metrics(each).rows() if row[1] in ("-", "")] == []
    assert dict(compute_metrics(no_step).rows())["  to 99 %"] == "not reached"


def test_a_run_that_has_no_end_is_neither_finished_nor_unfinished(recording, make_search) -> None:
    patrol = dataclasses.replace(recording, target_coverage=None, finished_step=None)
    metrics = compute_metrics(patrol)
    assert metrics.target_coverage is None
    assert not metrics.is_finished
    assert "finished" not in str(metrics)
    searching = make_search(patrol, np.ones((2, 2)), np.zeros(10), lambda _: np.zeros(2, bool))
    assert "not finished" in str(compute_metrics(searching))
    found = compute_metrics(dataclasses.replace(searching, finished_step=8))
    assert (found.is_finished, found.finished_at) == (True, 4.0)


def test_a_search_without_a_step_is_not_over_because_the_map_is_known(no_step, make_search) -> None:
    known = dataclasses.replace(no_step, initial_coverage=1.0)
    assert compute_metrics(known).finished_at == 0.0
    searching = make_search(known, np.ones((1, 2)), np.zeros(0), lambda _: np.zeros(1, bool))
    assert compute_metrics(searching).finished_at is None


def test_everything_is_json_with_and_without_a_step(vehicle, no_step, make_vehicle) -> None:
    for run in (vehicle, make_vehicle(no_step)):
        metrics = compute_metrics(run)
        plain = metrics.as_dict()
        assert json.loads(json.dumps(plain, allow_nan=False)) == plain
        str(metrics)
    own = metrics.parts["targets"]
    assert metrics.members is metrics.parts["watch"].mean_idleness is own.last_at is None
    assert (own.number, own.seen) == (3, 0)


def test_stops_are_counted_for_each_robot() -> None:
    lost, frozen = REASONS[1], REASONS[2]
    assert guard_metrics(None) == {"stops": {}, "stopped_steps": 0}
    alone = np.array([0, 1, 1, 0, 2, 1])
    assert guard_metrics(alone) == {"stops": {lost: 2, frozen: 1}, "stopped_steps": 4}
    # Of two robots: the second is stopped in the same steps, and once more.
    both = np.stack([alone, [1, 1, 1, 0, 0, 0]], axis=1)
    assert guard_metrics(both) == {"stops": {lost: 3, frozen: 1}, "stopped_steps": 7}
    for nothing in (np.zeros(0, int), np.zeros((0, 3), int)):
        assert guard_metrics(nothing) == {"stops": {}, "stopped_steps": 0}


def test_a_fleet_that_finds_its_poses_tells_their_errors(fleet_run):
    """The first robot takes itself to be 0.3 m beside its way, the second shakes by 0.1 m."""
    along = np.linspace(0.0, 12.0, 41)
    true = np.stack([along, 0.1 * along**2, np.zeros(41)], axis=1)
    shaken = true + np.where(np.arange(41) % 2, 0.1, -0.1)[:, None] * [0.0, 1.0, 0.0]
    world, beside = np.asarray(fleet_run.world), np.add(true, [0.3, 0.0, 0.0])
    places = tuple(
        LocalisationData(true, poses, true, along, world, loops)
        for poses, loops in ((beside, 2), (shaken, 1))
    )
    steps = fleet_run.num_steps
    errors = np.stack([np.full(steps, 0.3), np.linspace(0.0, 0.2, steps)], axis=1)
    goal = np.array([1.5, 1.0])
    located = dataclasses.replace(
        fleet_run,
        records=fleet_run.records._replace(pose_error=errors, uncertainty=errors),
        localisation=places,
        goal=goal,
    )
    metrics = located.metrics()
    team = metrics.parts["team"]
    # An offset of a whole way is no error of its form.
    assert team.ates == pytest.approx((0.0, 0.1), abs=2e-3)
    assert metrics.ate == max(team.ates)
    assert team.odometry_ates == pytest.approx((0.0, 0.0), abs=1e-6)
    expected = np.sqrt(np.mean(np.linspace(0.0, 0.2, steps) ** 2))
    assert team.position_errors == pytest.approx((0.3, expected))
    assert metrics.num_loops == 3
    away = np.hypot(*(fleet_run.last_positions - goal).T)
    assert metrics.goal_distance == pytest.approx(away.min())
    assert {"position errors", "trajectory errors", "goal"} <= dict(metrics.rows()).keys()
    labels = located.figures()["map"]().axes[0].get_legend_handles_labels()[1]
    assert {"estimated way", "goal"} <= set(labels)
    assert {"true_poses_2", "estimated_poses_2"} <= located.arrays().keys()
    # It is read from a file as it was, and moves to the coordinates of a map.
    again = unpack_recording(pack_recording(located)).move(np.array([10.0, 20.0]))
    assert again.metrics().parts["team"].ates == pytest.approx(team.ates, abs=1e-6)
    np.testing.assert_allclose(again.localisation[1].poses[:, :2], shaken[:, :2] + [10.0, 20.0])
    np.testing.assert_allclose(again.goal, np.add(goal, [10.0, 20.0]))
    plain = fleet_run.metrics()
    assert (plain.ate, plain.goal_distance, plain.num_loops) == (None, None, None)
    assert plain.parts["team"].ates == ()
