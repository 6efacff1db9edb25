"""Runs along a path: what is recorded, traffic, and when they end."""

import operator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import AROUND, CAR, KEEP, NO_FAULTS, OTHER, RING, SHARED, TRAFFIC, mpcc

import jaxplore as jx
from jaxplore.costs.base import WeightedCost
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk
from jaxplore.simulation.run import record_run
from jaxplore.simulation.state import Moment

pytestmark = pytest.mark.long

ALONE, PASSING = mpcc(), mpcc(other=OTHER + AROUND)


@pytest.fixture(scope="module")
def lap():
    """Two laps with traffic."""
    scenario = jx.PathScenario(PASSING.model, RING, laps=2, **SHARED).with_disturbances([NO_FAULTS])
    key = jax.random.key(0)
    run = jx.simulate(PASSING.controller, scenario, 2000, key=key, num_trajectories=0)
    return run, scenario


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4, 0.6, 0.8, 0.95])
def test_a_start_anywhere_on_a_lap_has_the_parameter_of_its_place(share: float) -> None:
    """A quarter of a lap before the line counts as just behind it."""
    point = RING.at(share * RING.length)
    start = [float(point.x), float(point.y), float(point.heading)]
    scenario = jx.PathScenario(PASSING.model, RING, start=start)
    expected = share if share < 0.75 else share - 1.0
    phi = scenario.start[PASSING.model.state_names.index("phi")]
    assert float(phi) == pytest.approx(expected * float(RING.length), abs=1e-3)


def test_it_drives_its_laps_within_the_corridor_and_past_the_others(lap) -> None:
    run, scenario = lap
    metrics = run.metrics
    assert metrics.is_finished
    assert len(metrics.lap_times) == 2
    assert metrics.corridor_violations == metrics.collisions == 0
    assert metrics.progress == pytest.approx(2 * float(RING.length), abs=0.15)
    assert run.recording.progress[-1] >= float(scenario.end) > run.recording.progress[-2]
    assert metrics.non_finite_steps == 0


def test_what_is_recorded_is_what_geometry_says(lap) -> None:
    """On a ring around (0, 3), in double precision."""
    records = lap[0].recording.records
    x, y, yaw, v, steering, phi = records.state.T.astype(np.float64)
    radius = np.hypot(x, y - 3.0)
    np.testing.assert_allclose(records.deviation, radius - 3.0, atol=2e-4)
    angle = np.arctan2(x, 3.0 - y)
    off = np.mod(records.progress - 3.0 * angle + 1.0, 2 * np.pi * 3.0) - 1.0
    np.testing.assert_allclose(off, 0.0, atol=2e-3)
    assert (np.diff(records.progress) > -0.01).all()
    theta = phi / 3.0
    dx, dy = x - 3.0 * np.sin(theta), y - (3.0 - 3.0 * np.cos(theta))
    contouring = np.sin(theta) * dx - np.cos(theta) * dy
    lag = -np.cos(theta) * dx - np.sin(theta) * dy
    np.testing.assert_allclose(records.contouring, contouring, atol=2e-3)
    np.testing.assert_allclose(records.lag, lag, atol=2e-3)
    np.testing.assert_allclose(
        records.acceleration[:, 1], v**2 * np.tan(steering) / 0.33, rtol=1e-4
    )
    discs = [
        np.stack([x, y], -1) + a * np.stack([np.cos(yaw), np.sin(yaw)], -1)
        for a in np.asarray(CAR.footprint.offsets, np.float64)
    ]
    size = float(CAR.radius)
    room = np.min([0.8 - np.abs(np.hypot(c[:, 0], c[:, 1] - 3.0) - 3.0) for c in discs], 0) - size
    np.testing.assert_allclose(records.room, room, atol=0.02)  # across the path at the robot
    time = 0.02 * np.arange(1, len(x) + 1)
    gaps = []
    for start, side, rate in ((6.0, 0.3, 0.5), (12.0, -0.3, 0.8)):
        turn = (start + rate * time) / 3.0
        far = 3.0 - side
        place = np.stack([far * np.sin(turn), 3.0 - far * np.cos(turn)], -1)
        gaps += [np.hypot(*(c - place).T) - 0.15 - size for c in discs]
    np.testing.assert_allclose(records.gap, np.min(gaps, 0), atol=2e-3)


def test_the_same_key_gives_the_same_run_and_looking_changes_nothing(lap) -> None:
    scenario = lap[1]
    again = record_run(PASSING.controller, scenario, 100, key=jax.random.key(0))
    np.testing.assert_array_equal(again.records.state, lap[0].recording.records.state[:100])
    assert not np.array_equal(
        again.records.state,
        record_run(
            PASSING.controller, scenario, 100, key=jax.random.key(1), num_trajectories=0
        ).records.state,
    )


def test_a_resumed_run_equals_one_that_never_stopped(lap, check_equal) -> None:
    finished, scenario = lap
    given = {"key": jax.random.key(0), "num_trajectories": 0}
    whole, part = (jx.simulate(PASSING.controller, scenario, n, **given) for n in (160, 77))
    check_equal(jx.simulate(PASSING.controller, scenario, 160, resume=part, **given), whole)
    with pytest.raises(ValueError, match="resume is a finished run"):
        jx.simulate(PASSING.controller, scenario, 3000, resume=finished, **given)


def test_a_path_far_away_is_followed_by_the_same_steps_and_recorded_where_it_is(lap) -> None:
    here, datum = lap[0].recording, jx.maps.Datum(500_000.0, 4_649_776.0)
    scenario = jx.PathScenario(PASSING.model, RING, laps=2, **SHARED, datum=datum)
    scenario = scenario.with_disturbances([NO_FAULTS])
    before = run_chunk._cached._cache_size()
    key = jax.random.key(0)
    there = jx.simulate(PASSING.controller, scenario, 25, key=key, num_trajectories=0).recording
    assert run_chunk._cached._cache_size() == before
    np.testing.assert_array_equal(there.records.control, here.records.control[:25])
    for mine, theirs in (
        (here.positions[:26], there.positions),
        (here.centre, there.centre),
        (here.edges, there.edges),
        (here.frames[0].position, there.frames[0].position),
        (here.frames[0].corners, there.frames[0].corners),
    ):
        np.testing.assert_allclose(theirs, mine + datum.offset, rtol=0.0, atol=1e-8)


def test_another_start_traffic_or_weight_does_not_recompile(lap) -> None:
    controller = PASSING.controller.at_period(0.02)
    key, one = jax.random.key(0), jnp.asarray(1, jnp.int32)
    run_chunk((controller, lap[1], key, one), copy_tree(initial_loop_state(controller, lap[1])), 25)
    before = run_chunk._cached._cache_size()
    moved = jx.PathScenario(
        PASSING.model,
        RING,
        start=[0.5, 0.1, 0.2],
        control_rate=40.0,
        growth=0.3,
        traffic=jx.Traffic(RING, [5.0, 9.0], [0.1, 0.2], [0.3, -0.8], radii=[0.2, 0.3]),
    ).with_disturbances([NO_FAULTS])
    costs = 7.0 * jx.ComfortCost(), 50.0 * jx.MovingObstacleCost(clearance=0.6, **KEEP)
    heavier = mpcc(other=costs[0] + costs[1], contouring_weight=3.0).controller
    run_chunk((heavier, moved, key, one), copy_tree(initial_loop_state(heavier, moved)), 25)
    assert run_chunk._cached._cache_size() == before


def test_traffic_moves_as_its_velocities_and_turn_rates_say() -> None:
    """By central differences; the prediction of a ring is exact for as long as one likes."""
    bar = jx.geometry.Outlines.polygons([[[-0.3, -0.1], [0.3, -0.1], [0.3, 0.1], [-0.3, 0.1]]])
    traffic = jx.Traffic(RING, [2.0], [0.4], [1.2], bar)
    at = eqx.filter_jit(lambda time: traffic.at(time))
    now, h = at(jnp.asarray(1.5)), 0.05
    before, after = at(jnp.asarray(1.5 - h)), at(jnp.asarray(1.5 + h))
    np.testing.assert_allclose(
        now.velocities, (after.centres - before.centres) / (2 * h), atol=2e-3
    )
    for ahead in (0.5, 3.0):
        predicted, there = now.predict(jnp.asarray(ahead)), at(jnp.asarray(1.5 + ahead))
        np.testing.assert_allclose(predicted.corners, there.outlines.corners, atol=2e-3)


def test_what_the_robot_knows_of_obstacles() -> None:
    wall = jx.geometry.Outlines.polygons([[[5, 5], [6, 5], [6, 6]]])
    given = {"traffic": TRAFFIC, "standing": wall, "growth": 0.3, "tracking_noise": (0.0, 0.0)}
    turning = jx.PathScenario(PASSING.model, RING, **given)
    straight = jx.PathScenario(PASSING.model, RING, prediction="constant-velocity", **given)
    t, key = jnp.asarray(2.0), jax.random.key(0)
    truth = turning.true_obstacles(t)
    assert truth.outlines.number == 3
    known, less = turning.obstacles(t, key=key), straight.obstacles(t, key=key)
    np.testing.assert_allclose(known.centres, truth.centres, atol=1e-6)
    np.testing.assert_allclose(known.turn_rates, truth.turn_rates, atol=1e-6)
    np.testing.assert_array_equal(less.turn_rates, 0.0)
    np.testing.assert_allclose(known.growth, [0.3, 0.3, 0.0])
    noisy = eqx.tree_at(lambda s: s.tracking_noise, turning, jnp.asarray([0.1, 0.2]))
    many = eqx.filter_jit(jax.vmap(lambda each: noisy.obstacles(t, key=each).centres))
    off = np.asarray(many(jax.random.split(key, 300)) - truth.centres)
    assert off[:, :2].std() == pytest.approx(0.1, rel=0.1)
    np.testing.assert_array_equal(off[:, 2], 0.0)
    assert jx.PathScenario(ALONE.model, RING).obstacles(t, key=key) is None


def test_an_open_path_ends_where_it_ends_and_standing_obstacles_are_passed() -> None:
    line = jx.geometry.line_path([0, 0], [6, 0], half_widths=[1.0, 1.0])
    following = mpcc(line, other=AROUND)
    post = jx.geometry.Outlines.polygons([[[2.8, -0.2], [3.2, -0.2], [3.2, 0.1], [2.8, 0.1]]])
    scenario = jx.PathScenario(following.model, line, standing=post)
    run = jx.simulate(
        following.controller, scenario, 1000, key=jax.random.key(2), num_trajectories=0
    )
    metrics = run.metrics
    assert metrics.is_finished
    assert metrics.lap_times == []
    assert metrics.collisions == 0
    assert metrics.minimum_gap < 1.0
    # It stands at the end.
    x, y, _, v, *_ = run.recording.records.state[-1]
    assert np.hypot(x - 6.0, y) <= 0.15
    assert abs(v) <= 0.06


@pytest.mark.parametrize("reverses", [True, False])
def test_a_cusp_is_a_place_to_stand_before_the_path_goes_on(reverses: bool) -> None:
    """A car drives on backwards, and a robot that only drives forwards turns."""
    path = jx.path_through([(0, 0), (1, 0), (2, 0), (3, 0), (2, 0.6), (1, 1.2)])
    stop = float(path.stops[0])
    robot = jx.Ackermann(min_speed=-1.0, max_speed=1.5) if reverses else jx.DifferentialDrive()
    following = jx.mpcc(robot, path, num_samples=128)
    scenario = jx.PathScenario(following.model, path, control_rate=20.0)
    run = jx.simulate(
        following.controller, scenario, 800, key=jax.random.key(0), num_trajectories=0
    )
    assert run.metrics.is_finished
    states, progress = run.recording.records.state, run.recording.progress
    after = int(np.argmax(progress > stop + 1e-3)) - 1
    away = np.hypot(*(states[:after, :2] - [3.0, 0.0]).T)
    assert away.min() <= 0.15
    assert np.abs(states[:after, 3])[away <= 0.15].min() <= 0.05
    assert np.hypot(*(states[-1, :2] - [1.0, 1.2])) <= 0.15
    assert (states[after:, 3].min() < -0.3) == reverses


def test_a_controller_that_diverges_stands_and_says_so(lap) -> None:
    def weight_of(controller):
        cost = controller.cost
        while not isinstance(cost, WeightedCost):
            cost = cost.costs[0]
        return cost.weight

    lost = eqx.tree_at(weight_of, PASSING.controller, jnp.asarray(jnp.nan, jnp.float32))
    before = run_chunk._cached._cache_size()
    recording = record_run(lost, lap[1], 20, key=jax.random.key(0), num_trajectories=0)
    assert run_chunk._cached._cache_size() == before
    assert not recording.records.is_finite.any()
    assert np.isfinite(recording.records.state).all()


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"robot": jx.Augmented(CAR, jx.Pendulum())}, "robot has the states x, y"),
        ({"start": [0.0, 1.0]}, "start"),
    ],
)
def test_what_is_no_scenario_is_refused(given, named) -> None:
    with pytest.raises(ValueError, match=named):
        jx.PathScenario(**{"robot": ALONE.model, "path": RING, **given})


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: jx.Traffic(RING, [1.0, 2.0], [0.0, 0.0, 0.0], 1.0, radii=0.1), "offsets"),
        (lambda: jx.Traffic(RING, [1.0], 0.9, 1.0, radii=0.1), r"offsets\[0\] is 0.9; accepted"),
        (lambda: jx.Traffic(RING, [1.0], 0.0, 1.0), "outlines is None, radii is None"),
        (
            lambda: jx.Traffic.random(jx.geometry.line_path([0, 0], [9, 0]), 2, seed=0),
            "path has inf m on either side",
        ),
        (lambda: jx.Traffic.random(RING, 2, seed=0, clear=50.0), "clear"),
        (lambda: jx.Traffic.random(RING, -1, seed=0), "number"),
    ],
)
def test_what_is_no_traffic_is_refused(make, named) -> None:
    with pytest.raises(ValueError, match=named):
        make()


@pytest.mark.parametrize(
    "faults",
    [
        jx.Faults(scan_dropout=(0.2, 0.6)),
        jx.Faults(frozen_odometry=(0.2, 0.6)),
        jx.Faults(lost_odometry=(0.2, 0.6)),
    ],
)
def test_faults_are_those_of_any_task(lap, faults) -> None:
    scenario = jx.PathScenario(PASSING.model, RING, laps=2, **SHARED).with_disturbances([faults])
    before = run_chunk._cached._cache_size()
    run = record_run(PASSING.controller, scenario, 60, key=jax.random.key(0), num_trajectories=0)
    assert run_chunk._cached._cache_size() == before
    records, sound = run.records, lap[0].recording.records
    assert np.isfinite(records.state).all()
    assert run.metrics().fault_steps == 20
    np.testing.assert_array_equal(np.flatnonzero(records.is_faulty), np.arange(10, 30))
    # A fault changes nothing before it begins.
    np.testing.assert_array_equal(records.state[:10], sound.state[:10])
    # No obstacle is near yet, so that a tracker without measurements makes no difference.
    is_tracker = float(faults.scan_dropout[1]) > 0.0
    assert np.array_equal(records.state[10:], sound.state[10:60]) == is_tracker


def test_without_measurements_obstacles_are_predicted(lap) -> None:
    """What the robot knows in a dropout is the last measurement, moved on along its velocity."""
    faults = jx.Faults(scan_dropout=(0.1, 5.0))
    scenario = jx.PathScenario(PASSING.model, RING, **SHARED).with_disturbances([faults])

    @jax.jit
    def seen():
        """Return what is known at the last measurement, and ten steps later."""
        state, _ = scenario.init(None)

        def look(state, step):
            time = 0.02 * step.astype(jnp.float32)
            blind = faults.is_blind(time)
            moment = Moment(step, time, state.robot, blind, blind)
            state, belief = scenario.perceive(state, moment, jax.random.key(step))
            return state, belief.obstacles

        obstacles = jax.lax.scan(look, state, jnp.arange(15))[1]
        last, later = (jax.tree.map(operator.itemgetter(k), obstacles) for k in (4, 14))
        now = jnp.zeros(())
        predicted = last.predict_centres(jnp.asarray(0.2))
        return later.centres, predicted, later.deviation(now), last.deviation(now)

    centres, expected, less, more = seen()
    np.testing.assert_allclose(centres, expected, atol=1e-4)
    # And it is less certain of them.
    assert (less > more).all()
    walls = jx.Faults(walls=np.ones((2, 2), bool))
    with pytest.raises(ValueError, match="faults has walls without a map"):
        jx.PathScenario(PASSING.model, RING).with_disturbances([walls])


def test_an_agent_observes_the_path_ahead_in_the_frame_of_the_robot() -> None:
    scenario = jx.PathScenario(ALONE.model, RING)
    pose, time = np.array([0.0, -0.1, 0.2]), jnp.zeros(())
    told = ALONE.model.at_pose(*pose.tolist())
    state, _ = scenario.init(None)
    off = jnp.array(False)
    moment = Moment(jnp.zeros((), jnp.int32), time, told, off, off)
    view = scenario.agent_view(None)
    seen = eqx.filter_jit(view.observation)(state, moment, None)

    # The ring is a circle around (0, 3), to the left of the start.
    angles = np.arange(1.0, 13.0) / 3.0
    points = 3.0 * np.stack([np.sin(angles), 1.0 - np.cos(angles)], axis=-1) - pose[:2]
    sin, cos = np.sin(pose[2]), np.cos(pose[2])
    ahead = np.stack([points @ [cos, sin], points @ [-sin, cos]], axis=-1)
    np.testing.assert_allclose(seen["path"], ahead, atol=2e-3)
    np.testing.assert_allclose(seen["errors"], [0.1, -0.2], atol=2e-3)
    assert seen["obstacles"].shape == (0, 5)
    bounds = view.observation_bounds()
    assert {name: low.shape for name, (low, _) in bounds.items()} == {
        name: value.shape for name, value in seen.items()
    }
