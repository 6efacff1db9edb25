"""Fleets of one and of two robots: equality with a robot alone, order, radio, and reports."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests import kinds

from jaxplore import Lidar, Perception, Unicycle, explorer
from jaxplore.control.fleet_controller import FleetController, same_for_all
from jaxplore.control.guard import MotionGuard
from jaxplore.control.stops import LOST
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.localisation import Localiser, Odometry
from jaxplore.maps.clearance import clearance_field
from jaxplore.parts import Faults, IdlenessMap, KeepOut, Variation
from jaxplore.parts.watch.report import WatchRecord, WatchReport
from jaxplore.parts.wheels.report import WheelRecord, WheelReport
from jaxplore.report.compute import Timing
from jaxplore.report.exploration.guard import guard_metrics
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.robot.localisation import Localisation
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.fleet.radio import NEVER, Radio
from jaxplore.simulation.fleet.scenario import Fleet
from jaxplore.simulation.fleet.starts import near_starts
from jaxplore.simulation.loop import initial_loop_state, moment_at, run_chunk
from jaxplore.simulation.run import Run

pytestmark = pytest.mark.long

STARTS = ((1.0, 1.0, 0.3), (1.0, 2.0, -0.4), (1.9, 1.5, 0.1))
FAR, NEAR = 100.0, 0.5
VARIATION = Variation(
    gain=(0.7, 0.9), control_delay=(0, 2), control_noise=(0.0, 0.1), position_noise=(0.0, 0.01)
)
LOCALISATION = Localisation(Odometry(turn_noise=0.05), Localiser(capacity=64))
TARGETS = ((2.8, 2.8), (5.5, 2.6))


def test_a_fleet_of_one_runs_as_the_robot_alone_to_the_bit(alone, drive, run) -> None:
    """It finds its pose, has other motors, a guard stops it while its odometry is lost, and it is
    carried away."""
    alone = ExplorationScenario(
        alone.world,
        alone.robot,
        alone.sensors,
        STARTS[0],
        perception=Perception(
            alone.sensors, 0.1, 0.15, num_directions=4, max_clearance=0.5, is_localising=True
        ),
        control_rate=20.0,
        field_rate=4.0,
        localisation=LOCALISATION,
        target_coverage=0.99,
    ).with_guard(MotionGuard())
    faults = Faults(lost_odometry=(2.0, 2.3), carried_at=3.0)
    alone = alone.with_disturbances([VARIATION, faults])
    _, single = run(drive(has_others=False), alone, 70)
    _, together = run(*kinds.fleet(alone, STARTS[:1]), 70)
    assert np.ptp(single.state[:, 0]) > 0.3
    for name in ("state", "control", "coverage", "effective_sample_size"):
        np.testing.assert_array_equal(getattr(single, name), getattr(together, name))
    np.testing.assert_array_equal(single.clearance, together.clearance[:, 0])
    np.testing.assert_array_equal(single.stop, together.stop[:, 0])
    np.testing.assert_array_equal(single.pose_error, together.pose_error[:, 0])
    assert single.pose_error.max() > 1e-3
    np.testing.assert_array_equal(single.is_carried, together.is_carried[:, 0])
    (step,) = np.flatnonzero(single.is_carried)
    assert step == 60
    # Its odometry does not notice where it was put down.
    away = np.hypot(*(single.state[60, :2] - single.state[59, :2]))
    assert away > 0.3
    assert single.pose_error[61] == pytest.approx(away, abs=0.1)
    assert (single.stop == LOST).sum() >= 6
    assert guard_metrics(together.stop) == guard_metrics(single.stop)
    assert not together.parts["team"].is_contact.any()
    assert not together.parts["team"].sent.any()


@pytest.fixture(scope="module")
def mixed(alone, drive, run):
    """Return what makes state and records of robots of two kinds, whose starts have an order.

    They are two differential drives, and between them a unicycle of another size with another
    lidar. They look for two targets, one in their room and one in the other, and keep watch.
    Each finds its pose and has a guard, and the unicycle differs from its model.
    """
    robot = Unicycle(max_speed=0.8, radius=0.12)
    lidar = Lidar(num_beams=24, max_range=1.2)
    area = [(5.2, 0.3), (5.6, 0.3), (5.6, 0.7), (5.2, 0.7)]
    numbers = {"num_directions": 4, "max_clearance": 0.5, "is_localising": True}
    numbers["parts"] = [IdlenessMap(20.0), KeepOut([area])]
    perception = Perception(lidar, 0.1, 0.12, **numbers)
    rates = {"control_rate": 20.0, "field_rate": 4.0, "localisation": LOCALISATION}
    other = ExplorationScenario(
        alone.world, robot, lidar, STARTS[1], perception=perception, targets=TARGETS, **rates
    ).with_guard(MotionGuard())
    other = other.with_disturbances([VARIATION])
    alone = ExplorationScenario(
        alone.world,
        alone.robot,
        alone.sensors,
        STARTS[0],
        perception=Perception(alone.sensors, 0.1, alone.robot.radius, **numbers),
        targets=TARGETS,
        **rates,
    ).with_guard(MotionGuard())
    one = drive(has_others=True)
    cost = MovingObstacleCost(nearness=None, clearance=0.6)
    two = explorer(
        robot, has_moving_obstacles=True, moving_obstacle_cost=cost, horizon=10, num_samples=32
    )

    @functools.cache
    def make(order: tuple[int, int, int]):
        starts = [STARTS[i] for i in order]
        fleet = Fleet([alone, other, alone], starts, radio=Radio(FAR), plan_length=10)
        assert fleet.explorations.kind_of == (0, 1, 0)
        return fleet, *run(FleetController([one, two, one], fleet.robot), fleet, 50)

    return make


def states_of(fleet, records) -> list[np.ndarray]:
    """Return the states of each robot, which has as many numbers in it as its model has."""
    sizes = [each.state_size for each in fleet.robot.robots]
    return np.split(records.state, np.cumsum(sizes)[:-1], axis=1)


def test_the_order_of_the_robots_does_not_matter(mixed) -> None:
    """Keys, maps and paths move with the robots, through two exchanges of maps."""
    order = (2, 1, 0)
    (fleet, one, records), (swapped, other, moved) = mixed((0, 1, 2)), mixed(order)
    assert (records.parts["team"].sent > 0.0).sum() >= 2
    states, there = states_of(fleet, records), states_of(swapped, moved)
    coverages = [each.parts["team"].coverages for each in (records, moved)]
    np.testing.assert_array_equal(coverages[0][:, order], coverages[1])
    for place, i in enumerate(order):
        np.testing.assert_array_equal(states[i], there[place])
        mine, theirs = one.task.members[i].belief, other.task.members[place].belief
        np.testing.assert_array_equal(mine.grid.probability, theirs.grid.probability)
        np.testing.assert_array_equal(mine.guidance.values, theirs.guidance.values)


def test_robots_of_different_kinds_explore_together(mixed) -> None:
    fleet, state, records = mixed((0, 1, 2))
    assert not records.is_collision.any()
    assert records.is_finite.all()
    for states in states_of(fleet, records):
        assert np.hypot(*np.ptp(states[:, :2], axis=0)) > 0.2
    # The last exchange was in step 38: what each had seen by then is on the map of all.
    merged = [np.asarray(each) for each in state.task.team.merged]
    for each in merged[1:]:
        np.testing.assert_allclose(each, merged[0], atol=2e-5)


def test_a_cell_that_one_robot_sees_is_seen_for_all(mixed) -> None:
    """The last exchange was in step 38 of 50, and the last scan in step 48."""
    fleet, state, records = mixed((0, 1, 2))
    idle = np.stack([each.belief.parts["watch"] for each in state.task.members])
    since = (48 - 38) * 0.05 + 1e-3
    # What nobody has seen since then is equally old for all.
    is_old = (idle > since).all(axis=0)
    assert (np.isfinite(idle[0]) & is_old).sum() > 20
    np.testing.assert_allclose(idle[:, is_old], idle[:1, is_old].repeat(3, 0), atol=1e-3)
    reachable = np.asarray(fleet.members[0].map_arrays.reachable)
    least = np.minimum(idle.min(axis=0), 48 * 0.05)[reachable]
    np.testing.assert_allclose(records.parts["watch"].mean_idleness[-1], least.mean(), rtol=1e-4)
    np.testing.assert_allclose(records.parts["watch"].worst_idleness[-1], least.max(), rtol=1e-4)


def test_an_area_stays_closed_for_all_when_maps_are_merged(mixed) -> None:
    fleet, state, records = mixed((0, 1, 2))
    assert (records.parts["team"].sent > 0.0).sum() >= 2
    for each in state.task.members:
        closed = np.asarray(each.belief.parts["keep_out"])
        assert closed.sum() >= 16
        assert (np.asarray(each.belief.clearance.values)[closed] == 0.0).all()
    assert not records.is_untraversable.any()
    assert not (np.asarray(fleet.members[0].map_arrays.reachable) & closed).any()


def test_a_target_counts_when_any_robot_has_it_in_sight(mixed) -> None:
    fleet, state, records = mixed((0, 1, 2))
    starts = np.asarray(fleet.start)[None]
    whole = [np.concatenate(each) for each in zip(
        np.split(starts, np.cumsum([each.state_size for each in fleet.robot.robots])[:-1], axis=1),
        states_of(fleet, records), strict=True,
    )]  # fmt: skip
    # Nothing stands between a robot and a target in its room. It scans in every second step.
    ranges = [each.sensors[0].max_range for each in fleet.members]
    away = [np.hypot(*(each[:-1, :2] - TARGETS[0]).T) for each in whole]
    is_near = np.stack([each < most for each, most in zip(away, ranges, strict=True)]).any(axis=0)
    first = next(k for k in range(0, 50, 2) if is_near[k])
    assert first > 0
    assert int(np.argmax(records.targets_seen >= 1)) == first
    # The other one is behind the wall.
    assert records.targets_seen.max() == 1
    assert state.task.is_seen.tolist() == [True, False]
    assert not bool(fleet.is_finished(state.task))
    assert bool(fleet.is_finished(state.task._replace(is_seen=jnp.ones(2, bool))))
    # It is not given up, however long nothing new is seen.
    gain = state.task.gain._replace(since=jnp.asarray(1e6))
    assert not bool(fleet.is_given_up(state.task._replace(gain=gain)))


def test_robots_look_for_the_same_targets(alone) -> None:
    other = eqx.tree_at(lambda each: each.targets, alone, jnp.ones((1, 2)))
    with pytest.raises(ValueError, match=r"targets of robots\[1\] differ; accepted: those of"):
        Fleet([alone, other], STARTS[:2])


def test_robots_in_range_know_the_same_and_those_out_of_range_do_not(paired) -> None:
    (heard, records), (deaf, apart) = paired(FAR), paired(NEAR)
    team = heard.task.team
    np.testing.assert_array_equal(team.heard.version >= 0, np.ones((2, 2), bool))
    assert records.parts["team"].sent.sum() > 1000.0
    assert (records.parts["team"].links[5:] == 1).all()
    maps = [each.belief.grid.probability for each in heard.task.members]
    merged = [np.asarray(each) for each in team.merged]
    np.testing.assert_allclose(merged[0], merged[1], atol=1e-5)
    # What one has seen since is all in which the maps differ.
    assert (np.abs(maps[0] - maps[1]) > 1e-3).mean() < 0.1
    gap = apart.state[:, :2] - apart.state[:, 5:7]
    distance = np.hypot(*gap.T)
    scans = np.arange(2, len(distance), 2)
    np.testing.assert_array_equal(apart.parts["team"].links[scans], distance[scans - 1] <= NEAR)
    is_out = distance[:-1] > NEAR
    assert is_out.mean() > 0.5
    assert apart.parts["team"].sent[1:][is_out].sum() == 0.0
    # What was never in range has never been heard, and what was heard may be old.
    others = np.asarray(deaf.task.team.heard.version)[[0, 1], [1, 0]]
    exchanged = np.flatnonzero(apart.parts["team"].sent)
    assert (others == (exchanged[-1] if len(exchanged) else NEVER)).all()


def test_together_they_know_more_than_each_and_everything_derived_fits_the_map(paired) -> None:
    state, records = paired(FAR)
    assert (records.coverage[:, None] >= records.parts["team"].coverages - 1e-6)[10:].all()
    for each in state.task.members:
        belief = each.belief
        exact = clearance_field(~belief.grid.is_free, belief.grid.frame, 1.0)
        np.testing.assert_allclose(belief.clearance.values, exact.values, atol=1e-6)


def test_a_robot_is_no_part_of_the_map_of_another(paired) -> None:
    """They start 1 m apart in sight of each other: no cell between the walls is occupied."""
    state, _ = paired(NEAR)
    for each in state.task.members:
        occupied = np.asarray(each.belief.grid.is_occupied)[3:27, 3:27]
        assert not occupied.any()
        assert np.asarray(each.belief.obstacles.is_known).shape == (1,)


def test_numbers_of_the_radio_do_not_recompile(paired) -> None:
    paired(FAR)
    before = run_chunk._cached._cache_size()
    paired(3.0)
    paired(NEAR)
    assert run_chunk._cached._cache_size() == before


@pytest.fixture(scope="module")
def recording(fleet, paired) -> ExplorationRecording:
    """Return the recording of two robots, made of the run of another test."""
    controller, scenario = fleet(STARTS[:2], Radio(FAR, uses_sight=False))
    state, records = paired(FAR)

    @eqx.filter_jit
    def arrays(scenario, state):
        key = jax.random.key(0)
        return scenario.frame(state.task, moment_at(scenario, state, key), inspect=None, key=key)

    begin = initial_loop_state(controller, scenario, jax.random.key(0))
    first = scenario.make_frame(0, arrays(scenario, begin))
    last = scenario.make_frame(100, arrays(scenario, state))
    done = ChunkedRun(state, records, (first, last), Timing(0.0, 0.0, 0, np.zeros(0)), 100, False)
    return scenario.recording(controller, begin.task, done)


def with_parts(recording, **parts):
    """Return the records with others of some parts."""
    return recording.records._replace(parts={**recording.records.parts, **parts})


def test_metrics_are_those_of_all_robots(recording) -> None:
    metrics = recording.metrics()
    team = metrics.parts["team"]
    assert team.num_robots == 2
    assert metrics.coverage == pytest.approx(recording.records.coverage[-1])
    trails = recording.trails
    assert trails.shape == (2, 101, 2)
    np.testing.assert_allclose(trails[:, 0], [each[:2] for each in STARTS[:2]], atol=1e-6)
    paths = [np.hypot(*np.diff(trail, axis=0).T).sum() for trail in trails]
    np.testing.assert_allclose(team.path_lengths, paths, rtol=1e-5)
    assert metrics.path_length == pytest.approx(sum(paths), rel=1e-5)
    sent = recording.records.parts["team"].sent
    assert team.exchanged == pytest.approx(sent.sum(), rel=1e-6)
    assert team.contacts == metrics.collisions == 0
    first = np.flatnonzero(recording.records.coverage >= 0.5)
    expected = None if not len(first) else first[0] * recording.control_period
    assert metrics.time_to["50"] == pytest.approx(expected)
    assert set(metrics.series()) >= {"time", "coverage", "robot 1", "robot 2"}
    assert "2, coordination: claims" in str(metrics)


def test_a_patrol_is_judged_by_its_idleness(recording, tmp_path) -> None:
    steps = recording.num_steps
    mean = np.linspace(0.0, 4.0, steps, dtype=np.float32)
    idle = np.where(recording.world > 0.5, np.inf, 2.0)
    patrol = dataclasses.replace(
        recording,
        records=with_parts(recording, watch=WatchRecord(mean, 3.0 * mean)),
        parts={**recording.parts, "watch": WatchReport(idle, is_patrol=True)},
        initial_unknown=0.0,
        target_coverage=None,
    )
    metrics = patrol.metrics()
    watch = metrics.parts["watch"]
    assert watch.mean_idleness == pytest.approx(mean[steps // 2 :].mean())
    assert watch.worst_idleness == pytest.approx(12.0)
    rows = dict(metrics.rows())
    assert rows["map"].endswith("m², known in advance")
    assert rows["idleness"] == "3.0 s, 12.0 s at worst, in the second half"
    assert rows["duration"] == "5.00 s, 100 steps"
    assert set(patrol.figures()) == {"map", "idleness"}
    figure = patrol.figures()["idleness"]()
    figure.savefig(tmp_path / "idleness.png")
    names = [each.get_text() for each in figure.legends[0].get_texts()]
    assert names[:2] == ["robot 1", "robot 2"]
    patrol.frame_image(patrol.frames[-1])
    assert patrol.metrics().series()["idleness"][-1] == pytest.approx(4.0)


def test_vehicles_that_tip_over_are_counted(recording) -> None:
    tipped = np.zeros((recording.num_steps, 2), bool)
    tipped[30:, 1] = True
    load = np.where(tipped, 1.5, 0.4).astype(np.float32)
    travel = np.zeros_like(load)
    travel[5:8, 0] = 1.2
    records = with_parts(recording, wheels=WheelRecord(load, travel, tipped))
    parts = {**recording.parts, "wheels": WheelReport()}
    wheeled = dataclasses.replace(recording, records=records, parts=parts)
    metrics = wheeled.metrics().parts["wheels"]
    assert metrics.num_tipped == 1
    assert metrics.tipped_at == pytest.approx(31 * recording.control_period)
    assert metrics.load_transfer == pytest.approx(1.5)
    assert metrics.hanging_steps == 3
    assert set(recording.metrics().parts) == {"team"}


def test_contacts_count_once_while_they_last(recording) -> None:
    team = recording.records.parts["team"]
    touched = np.array(team.is_contact)
    touched[10:20], touched[40, 1] = True, True
    records = with_parts(recording, team=team._replace(is_contact=touched))
    assert dataclasses.replace(recording, records=records).metrics().parts["team"].contacts == 2


def test_pictures_and_files_are_drawn(recording, tmp_path) -> None:
    for name, draw in recording.figures().items():
        draw().savefig(tmp_path / f"{name}.png")
    image = np.asarray(recording.frame_image(recording.frames[-1]).convert("RGB")).reshape(-1, 3)
    # Each robot has its colour.
    for colour in ((28, 100, 190), (209, 73, 91)):
        assert (image == colour).all(axis=1).sum() > 20
    recording.write_animation(tmp_path / "fleet.gif")


def test_a_run_folder_holds_the_whole_run(recording, tmp_path) -> None:
    Run(recording, recording.metrics()).save(tmp_path / "run", animation=False)
    loaded = Run.load(tmp_path / "run").recording
    assert isinstance(loaded, ExplorationRecording)
    np.testing.assert_array_equal(loaded.trails, recording.trails)
    np.testing.assert_array_equal(loaded.frames[-1].probability, recording.frames[-1].probability)
    arrays = np.load(tmp_path / "run" / "arrays.npz")
    assert arrays["positions"].shape == (2, 101, 2)


def test_positions_move_with_the_datum(recording) -> None:
    offset = np.array([1000.0, -500.0])
    moved = recording.move(offset)
    np.testing.assert_allclose(moved.trails, recording.trails + offset, rtol=1e-9)
    frame = recording.frames[-1]
    np.testing.assert_allclose(
        moved.places(frame.move(offset, recording.state_names)), recording.places(frame) + offset
    )


@pytest.mark.parametrize(
    ("starts", "message"),
    [
        ([(1.0, 1.0, 0.0), (1.1, 1.0, 0.0)], r"starts\[0\] and starts\[1\] are 0.10 m apart"),
        ([(1.0, 1.0, 0.0), (3.0, 0.5, 0.0)], r"starts\[1\] is \(3, 0.5\); accepted: free space"),
        ([(1.0, 1.0, 0.0), (9.0, 1.0, 0.0)], r"starts\[1\] is \(9, 1\); accepted: free space"),
        ([(1.0, 1.0), (2.0, 1.0)], r"starts is .*; accepted: \(2, 3\) finite numbers"),
    ],
)
def test_starts_that_are_not_possible_are_named(alone, starts, message) -> None:
    with pytest.raises(ValueError, match=message):
        Fleet(alone, starts)


def test_starts_are_chosen_near_one_another_and_always_the_same(alone) -> None:
    starts = near_starts(alone, 4)
    np.testing.assert_array_equal(starts, near_starts(alone, 4))
    np.testing.assert_allclose(starts[0], STARTS[0], atol=1e-6)
    away = np.linalg.norm(starts[:, None, :2] - starts[None, :, :2], axis=-1)
    assert (away + 9.0 * np.eye(4)).min() >= 0.7 - 1e-6
    assert Fleet(alone, starts).num_robots == 4
    with pytest.raises(ValueError, match=r"robots is 60; accepted: at most \d+, for which"):
        near_starts(alone, 60)


def test_what_a_fleet_does_not_support_is_named(alone, fleet) -> None:
    walls = eqx.tree_at(lambda each: each.ends_by, alone, jnp.int32(2))
    with pytest.raises(ValueError, match=r"target of robots\[0\] is 'walls'; accepted in a fleet"):
        Fleet(walls, STARTS[:2])
    watch = Perception(alone.sensors, 0.1, alone.robot.radius, parts=[IdlenessMap()])
    other = ExplorationScenario(
        alone.world, alone.robot, alone.sensors, STARTS[0], perception=watch, control_rate=20.0
    )
    with pytest.raises(ValueError, match=r"parts of robots\[1\] are \[\]; accepted: .*'watch'"):
        Fleet([other, alone], STARTS[:2])
    with pytest.raises(ValueError, match=r"exchange_rate is 7\.0; accepted: a whole fraction"):
        Fleet(alone, STARTS[:2], exchange_rate=7.0)
    controller, scenario = fleet()
    with pytest.raises(ValueError, match="controllers has 1 entries; accepted: 2"):
        FleetController(controller.controllers[:1], scenario.robot)


def test_a_fleet_without_a_target_coverage_ends_at_its_own(alone) -> None:
    """What a robot can still learn by its own map, another may know."""
    assert alone.target == "information"
    members = Fleet(alone, STARTS[:2]).members
    assert [each.target for each in members] == ["coverage"] * 2
    assert [float(each.target_coverage) for each in members] == [pytest.approx(0.99)] * 2
    assert members[0] is members[1]
    given = eqx.tree_at(
        lambda each: (each.target_coverage, each.ends_by), alone, (jnp.float32(0.9), jnp.int32(0))
    )
    assert Fleet(given, STARTS[:2]).members[0].target_coverage == jnp.float32(0.9)


def test_equal_robots_share_their_arrays(alone) -> None:
    members = Fleet(alone, STARTS[:2]).members
    assert isinstance(members[0], ExplorationScenario)
    assert members[0] is members[1]
    assert (
        len(
            same_for_all(
                object.__new__(FleetController), Fleet(alone, STARTS[:2]).robot
            ).controllers
        )
        == 2
    )


def test_bad_settings_of_a_fleet_get_one_line(fails) -> None:
    assert "fleet.robots is 0" in fails("run", "fleet", "--robots", "0")
    assert "fleet.radio_range is nan" in fails("run", "fleet", "--radio-range", "nan")
    assert "fleet.coordination is 'auction'" in fails("run", "fleet", "--coordination", "auction")
    line = fails("run", "fleet", "--set", "fleet.starts=[[1,6.6,0],[1.1,6.6,0]]", "--robots", "2")
    assert "starts[0] and starts[1]" in line
    assert "fleet.starts has 1 poses for 4 robots" in fails(
        "run", "fleet", "--set", "fleet.starts=[[1,6.6,0]]"
    )
    assert "fleet.robots is 3 along a path" in fails("run", "path", "--robots", "3")


@pytest.mark.parametrize("target", ["information", "walls"])
def test_a_fleet_says_that_it_ends_by_coverage_alone(target: str, fails, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    more = ["--set", "target_coverage=0.9"] if target == "walls" else []
    said = fails("run", "fleet", "--set", f"target={target}", *more)
    assert f"target is '{target}'; accepted in a fleet: coverage, never" in said
