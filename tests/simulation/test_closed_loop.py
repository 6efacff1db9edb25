import dataclasses
import itertools
import signal
import threading

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import AHEAD, HALL, HALL_CHUNK, HALL_GOAL, WALKER, Script, hall

from jaxplore import DifferentialDrive, ExplorationScenario, OccupancyGrid
from jaxplore.belief.belief import Belief
from jaxplore.belief.gain import Gain
from jaxplore.dynamics.goal_check import Motion
from jaxplore.report.exploration.animation import frame_image
from jaxplore.report.exploration.canvas import make_canvas
from jaxplore.report.exploration.data import MapProgress
from jaxplore.robot.robot import Knowledge, RobotState
from jaxplore.simulation.exploration.finish import default_give_up_after
from jaxplore.simulation.exploration.judge import Judged
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.loop import _initial_task, copy_tree, initial_loop_state, run_chunk
from jaxplore.simulation.run import Run, record_run, simulate

pytestmark = pytest.mark.long

PASSING = 10.0  # a speed at which the robot may pass by its goal [m/s]
CHUNK = 25  # record_run's own, so that nothing is compiled twice
ONE = jnp.asarray(1, jnp.int32)  # as record_run counts: a weak type would be another program


def run(experiment, steps: int, key: jax.Array, pieces: int = 1):
    controller, scenario = experiment
    controller = controller.at_period(scenario.control_period)
    state, rows = initial_loop_state(controller, scenario), []
    for _ in range(pieces):
        for _ in range(0, steps // pieces, CHUNK):
            count = min(CHUNK, steps // pieces)
            state, records, done = run_chunk(
                (controller, scenario, key, jnp.asarray(count, jnp.int32)), copy_tree(state), CHUNK
            )
            rows.append(jax.tree.map(lambda leaf, n=int(done): np.asarray(leaf)[:n], records))
    return state, jax.tree.map(lambda *parts: np.concatenate(parts), *rows)


@pytest.fixture(scope="session")
def explored(make):
    """One long run out of the U, shared by the tests that look at it."""
    controller, scenario = make()
    return record_run(controller, scenario, 6000, key=jax.random.key(0)), scenario


def test_gets_out_of_a_u_and_sees_everything_without_touching(explored) -> None:
    recording, _ = explored
    assert recording.records.coverage[-1] >= 0.9
    assert recording.num_steps < 6000
    assert not recording.records.is_collision.any()
    assert recording.records.clearance.min() > 0.0
    assert recording.records.is_finite.all()
    behind = recording.positions[:, 0] > 4.3
    assert behind.any()


def test_coverage_never_falls_much_and_entropy_drops(explored) -> None:
    recording, _ = explored
    records = recording.records
    assert np.diff(records.coverage).min() > -0.02
    assert records.entropy[-1] < 0.2 * recording.initial_entropy


def test_the_belief_agrees_with_the_world(explored) -> None:
    recording, scenario = explored
    reachable = np.asarray(scenario.reachable)
    known_free = recording.belief < 0.25
    assert (recording.world[known_free] >= 0.25).mean() < 0.01
    wrong = (recording.belief > 0.65) & reachable & (recording.world < 0.25)
    assert wrong.sum() < 0.01 * reachable.sum()


def test_recorded_states_follow_from_the_recorded_controls(explored) -> None:
    recording, scenario = explored
    states = np.concatenate([recording.start[None], recording.records.state])
    step = jax.jit(jax.vmap(scenario.robot.step, in_axes=(0, 0, None)))
    period = jnp.asarray(recording.control_period, jnp.float32)
    moved = step(states[:-1], recording.records.control, period)
    np.testing.assert_allclose(states[1:], moved, atol=1e-5)


def test_frames_cover_the_run(explored, check_frames) -> None:
    recording, _scenario = explored
    check_frames(recording)
    last = recording.frames[-1]
    assert last.samples.shape == (60, 31, 2)
    assert set(last.terms) == {"ObstacleCost", "InformationCost", "GuidanceCost", "ControlCost"}
    assert len(recording.timing.step_seconds) > 0


def test_the_same_key_gives_the_same_run_however_it_is_cut(make) -> None:
    whole = run(make(), 50, jax.random.key(7))
    pieces = run(make(), 50, jax.random.key(7), pieces=10)
    other = run(make(), 50, jax.random.key(8))
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(pieces), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not np.array_equal(whole[1].state, other[1].state)


def test_nothing_but_sizes_recompiles(make, other_world) -> None:
    run(make(), 5, jax.random.key(0))
    compiled = run_chunk._cached._cache_size()
    for experiment, seed in (
        (make(other_world), 0),
        (make(a_smaller_map()), 0),
        (make(start=(1.0, 1.0, 2.0)), 0),
        (make(guidance_weight=3.0, information_weight=0.5), 0),
        (make(temperature=1.0, noise_std=(0.3, 0.4)), 0),
        (make(target=0.5), 0),
        (make(rates={"control_rate": 40.0, "sensing_rate": 20.0, "field_rate": 4.0}), 0),
        (make(), 99),
    ):
        run(experiment, 5, jax.random.key(seed))
    assert run_chunk._cached._cache_size() == compiled


def a_smaller_map() -> OccupancyGrid:
    """Return a room of 5 m x 3.6 m, whose arrays have the shape of those of the others."""
    walls = np.pad(np.zeros((34, 48), np.float32), 1, constant_values=1.0)
    return OccupancyGrid(walls, 0.1)


def test_a_run_does_not_depend_on_the_shape_of_the_arrays(make) -> None:
    controller, scenario = make()
    wide = make(scenario.world.pad((96, 160)))[1]
    assert wide.map_arrays.world.shape == (96, 160)
    key = jax.random.key(5)
    (state, one), (padded, other) = (run((controller, each), 50, key) for each in (scenario, wide))
    for name in one._fields:
        # The entropy is a sum over the cells, which may be added in another order.
        if name == "entropy":
            np.testing.assert_allclose(one.entropy, other.entropy, rtol=1e-6)
        elif getattr(one, name) is not None:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    mine, theirs = (each.task.belief.grid.unpad().probability for each in (state, padded))
    np.testing.assert_array_equal(mine, theirs)


def test_senses_and_plans_at_the_rates_given(make) -> None:
    rates = {"control_rate": 50.0, "sensing_rate": 10.0, "field_rate": 5.0}
    controller, scenario = make(rates=rates)
    controller = controller.at_period(scenario.control_period)
    state, key = initial_loop_state(controller, scenario), jax.random.key(0)
    maps, guidances = [], []
    for _ in range(21):
        state, _, _ = run_chunk((controller, scenario, key, ONE), copy_tree(state), CHUNK)
        belief: Belief = state.task.belief
        maps.append(np.asarray(belief.grid.probability))
        guidances.append(np.asarray(belief.guidance.values))
    changed = [not np.array_equal(a, b) for a, b in itertools.pairwise(maps)]
    replanned = [not np.array_equal(a, b) for a, b in itertools.pairwise(guidances)]
    assert set(np.flatnonzero(changed) + 1) <= {5, 10, 15, 20}
    # At the end of each period; besides at the first step.
    assert set(np.flatnonzero(replanned) + 1) == {9, 19}


def test_stops_at_the_target(make) -> None:
    controller, scenario = make(target=0.3)
    recording = record_run(controller, scenario, 6000, key=jax.random.key(0))
    assert recording.records.coverage[-1] >= 0.3
    assert (recording.records.coverage[:-1] < 0.3).all()
    assert recording.num_steps < 1000


def test_a_wall_stops_the_robot_and_is_counted(make) -> None:
    controller, scenario = make(obstacle_weight=0.0, guidance_weight=0.0, information_weight=0.0)
    scenario = eqx.tree_at(lambda s: s.start, scenario, jnp.asarray([5.6, 2.0, 0.0, 1.0, 0.0]))
    _, records = run((controller, scenario), 25, jax.random.key(0))
    assert records.is_collision.any()
    assert (records.clearance >= 0.0).all()
    assert records.state[:, 0].max() < 5.9 - 0.2 + 1e-3
    first = int(np.argmax(records.is_collision))
    assert records.state[first, 3] == 0.0


def test_ctrl_c_keeps_what_was_done(make) -> None:
    controller, scenario = make()

    def stop(progress) -> None:
        if progress.time > 0.99:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    recording = record_run(controller, scenario, 6000, key=jax.random.key(0), on_progress=stop)
    assert recording.is_interrupted
    assert recording.num_steps == 50
    assert signal.getsignal(signal.SIGINT) is before
    whole = run(make(), 50, jax.random.key(0))[1]
    np.testing.assert_array_equal(recording.records.state, whole.state)


def test_a_resumed_run_equals_one_that_never_stopped(
    make, check_equal, monkeypatch, tmp_path
) -> None:
    """It is resumed twice: within a chunk and between frames, and from its folder after Ctrl-C."""
    controller, scenario = make()
    key = jax.random.key(4)
    whole = simulate(controller, scenario, 181, key=key)
    part = simulate(controller, scenario, 83, key=key)
    assert part.recording.frames[-1].step == 83
    presses = iter([None] * 3)
    show = ExplorationScenario.progress

    def press(self, state):
        if next(presses, 0) == 0:
            signal.raise_signal(signal.SIGINT)
        return show(self, state)

    with monkeypatch.context() as patch:
        patch.setattr(ExplorationScenario, "progress", press)
        part = simulate(controller, scenario, 181, key=key, resume=part)
    assert part.metrics.is_interrupted
    assert 83 < part.recording.num_steps < 181
    part.save(tmp_path / "run", animation=False)
    loaded = Run.load(tmp_path / "run")
    check_equal(loaded, part)
    before = run_chunk._cached._cache_size()
    part = simulate(controller, scenario, 181, key=key, resume=loaded)
    assert run_chunk._cached._cache_size() == before
    assert part.metrics.compute.compile_seconds > 0.0
    check_equal(part, whole)


def test_only_the_same_unfinished_run_can_be_resumed(make, other_world) -> None:
    controller, scenario = make()
    key = jax.random.key(0)
    run = simulate(controller, scenario, 5, key=key, num_trajectories=0)
    gone = run.checkpoint.loop.state.task._replace(finished=jnp.ones((), jnp.int32))
    state = run.checkpoint.loop.state._replace(task=gone)
    loop = dataclasses.replace(run.checkpoint.loop, state=state)
    finished = dataclasses.replace(run, checkpoint=dataclasses.replace(run.checkpoint, loop=loop))
    more = eqx.tree_at(lambda each: each.dt, controller, jnp.asarray(0.06))
    for expected, arguments in {
        "num_steps is 5; accepted: a whole number >= 6": (controller, scenario, 5, key, run),
        "key has the data": (controller, scenario, 9, jax.random.key(1), run),
        "scenario differs": (controller, make(other_world)[1], 9, key, run),
        "controller differs": (more, scenario, 9, key, run),
        "resume is a finished run": (controller, scenario, 9, key, finished),
        "without the state of its loop": (
            controller,
            scenario,
            9,
            key,
            dataclasses.replace(run, checkpoint=None),
        ),
    }.items():
        *given, key_, resume = arguments
        with pytest.raises(ValueError, match=expected):
            simulate(*given, key=key_, resume=resume, num_trajectories=0)


def test_frames_are_dense_at_first_and_thinned_out_evenly() -> None:
    """A film of five seconds has 60 frames, one of minutes not more than 120."""
    for num_steps, interval in ((150, 2), (350, 4)):
        scenario = hall(target_coverage=None, max_unknown=0.0)
        recording = record_run(AHEAD, scenario, num_steps, key=jax.random.key(0))
        steps = [frame.step for frame in recording.frames]
        assert 60 <= len(steps) <= 121
        assert set(np.diff(steps[:-1]).tolist()) == {interval}
        assert steps[-1] == recording.num_steps == num_steps


def test_runs_outside_the_main_thread(make) -> None:
    controller, scenario = make()
    results = []
    thread = threading.Thread(
        target=lambda: results.append(record_run(controller, scenario, 5, key=jax.random.key(0)))
    )
    thread.start()
    thread.join()
    assert results[0].num_steps == 5


def test_num_steps_must_be_positive(make) -> None:
    with pytest.raises(ValueError, match="num_steps is 0"):
        record_run(*make(), 0, key=jax.random.key(0))


def drive(scenario: ExplorationScenario, steps: int = 60):
    return record_run(AHEAD, scenario, steps, key=jax.random.key(0))


class Closed(Script):
    """Nobody can look into it."""

    def inspect(self, state, observation, belief=None, *, key, num_trajectories=50):
        raise AssertionError


def test_a_run_without_rollouts_is_the_same_and_does_not_look_into_the_controller() -> None:
    scenario, key = hall(), jax.random.key(0)
    seen = record_run(AHEAD, scenario, 20, key=key)
    unseen = record_run(Closed(AHEAD.commands), scenario, 20, key=key, num_trajectories=0)
    np.testing.assert_array_equal(seen.records.state, unseen.records.state)
    for with_plan, without in zip(seen.frames, unseen.frames, strict=True):
        np.testing.assert_array_equal(with_plan.information, without.information)
        np.testing.assert_array_equal(with_plan.scan, without.scan)
        assert len(with_plan.plan) == 2
        assert len(without.plan) == len(without.samples) == len(without.weights) == 0
    # It can still be drawn. This plan stays where the robot is, so that the maps are the same; the
    # legends below them differ.
    rows = make_canvas(seen, 320, 1.0).map.size[1]
    drawn = [np.asarray(frame_image(each, each.frames[-1], width=320)) for each in (seen, unseen)]
    np.testing.assert_array_equal(*(each[:rows] for each in drawn))
    with pytest.raises(ValueError, match="num_trajectories is -1; accepted: a whole number >= 0"):
        record_run(AHEAD, scenario, 20, key=key, num_trajectories=-1)


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize("is_known", [False, True])
@pytest.mark.parametrize("is_covered", [False, True])
@pytest.mark.parametrize(
    ("speed", "turn_rate", "idle"),
    [(0.0, 0.0, 0.0), (0.19, -0.39, 2.9), (0.21, 0.0, 0.0), (0.0, 0.41, 0.0), (0.0, 0.0, 3.1)],
)
def test_the_end_is_the_goal_and_a_known_map(
    is_there, is_known, is_covered, speed, turn_rate, idle
) -> None:
    scenario = hall(goal_radius=0.5, max_unknown=0.25, target_coverage=0.75, goal_speed=0.2)
    # Half a metre away is not within half a metre, a quarter is not less than a quarter; the target
    # coverage itself is enough.
    robot = WALKER.at_pose(2.0 + (0.01 if is_there else 0.0), 1.5, 0.0)
    nothing = jnp.zeros(())
    progress = MapProgress(
        coverage=jnp.asarray(0.75 if is_covered else 0.74),
        entropy=nothing,
        unknown=nothing,
        unknown_map=jnp.asarray(0.249 if is_known else 0.25),
    )
    state = ExplorationState(
        robot,
        RobotState(None, Knowledge(jnp.asarray(idle), nothing)),
        Judged(None, progress, jnp.zeros(0, bool), None),
        Gain(progress.coverage, nothing),
        finished=jnp.zeros((), int),
        ranges=jnp.zeros(0),
        motion=Motion(jnp.asarray(speed), jnp.asarray(turn_rate)),
        truths={},
    )
    found = bool(scenario.is_finished(state))
    # 0.4 rad/s move what is half a metre away by 0.2 m/s.
    is_still = speed <= 0.2 and abs(turn_rate) <= 0.4
    # A robot that has learnt all that it can goes home as well.
    assert found == (is_there and is_still and (is_known or is_covered or idle >= 3.0))
    aimless = hall(goal=None, target_coverage=0.75)
    assert bool(aimless.is_finished(state)) == is_covered


def test_the_prior_is_what_is_known_at_first() -> None:
    prior = np.random.default_rng(0).uniform(0.0, 1.0, HALL.shape).astype(np.float32)
    scenario = hall(prior, HALL)
    state = initial_loop_state(AHEAD, scenario)
    belief = np.asarray(state.task.belief.grid.unpad().probability)
    rows, columns = np.mgrid[:30, :40]
    away = np.hypot(columns * 0.1 + 0.05 - 0.6, rows * 0.1 + 0.05 - 1.5)
    np.testing.assert_array_equal(belief[away > 0.45], prior[away > 0.45])
    np.testing.assert_allclose(belief[away < 0.25], 0.01, rtol=1e-5)
    is_unknown = 4 * belief * (1 - belief) > 0.5
    progress, reachable = state.task.progress, np.asarray(scenario.reachable)
    assert float(progress.unknown_map) == pytest.approx(is_unknown.mean())
    assert float(progress.unknown) == pytest.approx(is_unknown[reachable].mean())
    np.testing.assert_array_equal(scenario.world.probability, HALL)


def test_what_is_known_at_first_is_compiled_once_for_all_controllers(make) -> None:
    controller, scenario = make()
    first = initial_loop_state(controller, scenario)
    compiled = _initial_task._cached._cache_size()
    other = initial_loop_state(AHEAD, scenario, jax.random.key(3))
    assert _initial_task._cached._cache_size() == compiled
    mine, theirs = jax.tree.structure(first.controller), jax.tree.structure(other.controller)
    assert mine != theirs
    pair = (state._replace(controller=()) for state in (first, other))
    for a, b in zip(*map(jax.tree.leaves, pair), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_wall_that_is_not_on_the_map_is_met_seen_and_solid() -> None:
    world = HALL.copy()
    world[1:-1, 28:30] = 0.99  # x from 2.8 to 3 m
    # It passes by its goal.
    scenario = hall(HALL, world, goal=(1.55, 2.45), goal_radius=0.1)
    state, key = initial_loop_state(AHEAD, scenario), jax.random.key(0)
    known = np.asarray(state.task.belief.grid.unpad().probability)
    np.testing.assert_allclose(known, HALL, rtol=1e-6)
    collisions = 0
    for _ in range(80):
        reach = float(state.task.robot[0]) + 1.0
        state, records, _ = run_chunk((AHEAD, scenario, key, ONE), copy_tree(state), HALL_CHUNK)
        known = np.asarray(state.task.belief.grid.unpad().probability)
        assert reach > 2.8 or (known[:, 28:30] == HALL[:, 28:30]).all()
        assert float(state.task.robot[0]) <= 2.8 - 0.2 + 1e-4
        collisions += int(records.is_collision[0])
    assert collisions > 10
    np.testing.assert_allclose(known[13:17, 28], 0.99, rtol=1e-5)
    np.testing.assert_array_equal(known[:, 30:], HALL[:, 30:])
    assert int(state.task.finished) == 0


def test_a_known_hall_ends_where_the_goal_begins_and_hovering_is_extra() -> None:
    recording = drive(hall(goal_radius=0.3, goal_speed=PASSING))
    distance = np.hypot(*(recording.positions[1:] - np.float32(HALL_GOAL)).T)
    last = int(np.argmax(distance < 0.3))
    assert 10 < last < 59
    assert recording.num_steps == recording.finished_step == last + 1
    assert recording.initial_unknown == 0.0
    np.testing.assert_allclose(recording.goal, HALL_GOAL)
    hovering = drive(hall(goal_radius=0.3, goal_speed=PASSING, hover_time=0.7))
    assert hovering.num_steps == last + 1 + 14
    assert hovering.finished_step == last + 1
    np.testing.assert_array_equal(hovering.records.state[: last + 1], recording.records.state)
    # A run that is cut off while it hovers was finished all the same.
    cut = drive(hall(goal_radius=0.3, goal_speed=PASSING, hover_time=0.7), last + 1 + 5)
    assert (cut.num_steps, cut.finished_step) == (last + 1 + 5, last + 1)
    short = drive(hall(goal_radius=0.3, goal_speed=PASSING), last)
    assert (short.num_steps, short.finished_step) == (last, None)
    # A robot that must stand there only passes by.
    assert drive(hall(goal_radius=0.3)).finished_step is None


def test_the_end_waits_for_the_map_and_the_map_for_the_goal() -> None:
    passing = drive(hall(None, max_unknown=0.0, target_coverage=1.0))
    unknown = passing.records.unknown_map
    distance = np.hypot(*(passing.positions[1:] - np.float32(HALL_GOAL)).T)
    assert (distance < 1.5).any()
    assert (passing.num_steps, passing.finished_step) == (60, None)
    assert passing.initial_unknown > 0.9
    for most, radius in ((0.7, 1.5), (0.6, 1.5), (0.6, 0.6), (0.95, 1.0)):
        is_over = (distance < radius) & (unknown < most)
        expected = int(np.argmax(is_over)) + 1 if is_over.any() else None
        ends = {"max_unknown": most, "goal_radius": radius, "goal_speed": PASSING}
        found = drive(hall(None, target_coverage=1.0, **ends))
        assert found.finished_step == expected
        assert found.num_steps == (60 if expected is None else expected)


def test_at_the_goal_with_all_known_one_step_is_the_run() -> None:
    recording = drive(hall(start=(2.5, 1.5, 0.0), goal_speed=PASSING))
    assert (recording.num_steps, recording.finished_step) == (1, 1)


def test_an_exploration_that_learns_nothing_is_given_up_and_says_what_is_left(make) -> None:
    # The robot stands nearly still, and what is around the corners stays unseen.
    still = {"information_weight": 0.0, "guidance_weight": 0.0, "noise_std": (1e-3, 1e-3)}

    def stand(num_steps: int, patience: float):
        controller, scenario = make(target=1.0, rates={"give_up_after": patience}, **still)
        return record_run(controller, scenario, num_steps, key=jax.random.key(0))

    recording = stand(200, 0.61)  # between two steps
    best, since, expected = recording.initial_coverage, 0.0, None
    for step, coverage in enumerate(recording.records.coverage, start=1):
        is_more = coverage >= np.float32(best) + np.float32(1e-3)
        best, since = (coverage, 0.0) if is_more else (best, since + 0.02)
        if since >= 0.61:
            expected = step
            break
    assert expected is not None
    assert recording.num_steps == recording.given_up_step == expected < 200
    assert recording.finished_step is None
    metrics = recording.metrics(seed=0)
    assert not metrics.is_finished
    assert metrics.given_up_at == pytest.approx(0.02 * expected)
    rows = dict(metrics.rows())
    left = f"{100.0 * (1.0 - metrics.coverage):.1f} %"
    assert rows["given up"] == f"nothing new to see; {left} unreachable or hidden"
    assert rows["coverage"].endswith("given up")
    # With more patience the same run goes on.
    longer = stand(expected + 5, 100.0)
    assert (longer.num_steps, longer.given_up_step) == (expected + 5, None)
    np.testing.assert_array_equal(longer.records.state[:expected], recording.records.state)


@pytest.mark.parametrize("kept", [{"goal": HALL_GOAL}, {"target": "never", "goal": None}])
def test_only_an_exploration_that_has_an_end_is_given_up(kept) -> None:
    state = initial_loop_state(AHEAD, hall()).task
    scenario = hall(give_up_after=0.6, **kept)
    state = state._replace(gain=state.gain._replace(since=jnp.asarray(1e6)))
    assert not bool(scenario.is_given_up(state))
    assert bool(hall(give_up_after=0.6, goal=None).is_given_up(state))


def test_walls_that_grow_for_ever_are_given_up_where_no_place_is_worth_a_visit() -> None:
    state = initial_loop_state(AHEAD, hall()).task
    for target, is_over in (("walls", True), ("information", False)):
        scenario = hall(give_up_after=5.0, goal=None, target=target, target_coverage=0.9)
        for idle in (4.9, 5.1):
            known = state.own.knowledge._replace(idle=jnp.asarray(idle))
            later = state._replace(own=state.own._replace(knowledge=known))
            found = bool(scenario.is_given_up(later))
            assert found == (is_over and idle > 5.0)


def test_the_patience_of_an_exploration_grows_with_the_map_and_falls_with_the_speed() -> None:
    for speed in (0.5, 2.0):
        robot = DifferentialDrive(max_speed=speed)
        world = OccupancyGrid(np.zeros((300, 400), np.float32), 0.1)
        assert default_give_up_after(world, robot) == pytest.approx(60.0 + 2.0 * 50.0 / speed)
