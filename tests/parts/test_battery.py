"""A battery: what it consumes, and when the robot returns to its dock."""

import heapq
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxplore as jx
from jaxplore.maps.datum import ORIGIN
from jaxplore.parts.battery.robot import JOULES, Battery, Charge
from jaxplore.parts.battery.truth import DOCK_RADIUS, BatteryState, TrueBattery, drive_length
from jaxplore.simulation.exploration.part_truth import Drive, Site
from jaxplore.tasks.registry import build, make_settings

SIDE = 0.1
ROBOT = jx.DifferentialDrive(max_speed=1.0, radius=0.15)
LIDAR = jx.Lidar(36, 1.5, range_noise=0.0)
NUMBERS = {"idle": 20.0, "per_metre": 5.0, "mass": 4.0, "cruise": 0.6}


def rooms() -> np.ndarray:
    """Return two rooms of 3 m by 3 m with a door of 0.8 m."""
    cells = np.full((30, 60), 0.01, np.float32)
    cells[[0, -1]], cells[:, [0, -1]], cells[:, 30] = 0.99, 0.99, 0.99
    cells[11:19, 30] = 0.01
    return cells


def scenario(
    battery: Battery, world: np.ndarray | None = None, *, start=(0.8, 1.5, 0.0), **more
) -> jx.ExplorationScenario:
    """Return a patrol of the rooms, so that a run has no end of its own."""
    parts = [jx.parts.IdlenessMap(20.0), battery]
    perception = jx.Perception(LIDAR, SIDE, 0.15, num_directions=4, node_spacing=0.2, parts=parts)
    return jx.ExplorationScenario(
        jx.OccupancyGrid(rooms() if world is None else world, SIDE),
        ROBOT,
        LIDAR,
        start,
        perception=perception,
        control_rate=20.0,
        sensing_rate=10.0,
        field_rate=5.0,
        truths=[TrueBattery(battery, **{"power": 400.0, **more})],
    )


numbers = st.floats(0.0, 50.0, width=32)


@given(numbers, numbers, numbers, st.floats(0.0, 5.0, width=32), st.floats(0.0, 5.0, width=32))
def test_energy_is_that_of_time_way_and_load(idle, per_metre, mass, before, after) -> None:
    battery = Battery((0.0, 0.0), idle=idle, per_metre=per_metre, mass=mass)
    period, way = 0.05, 0.5 * (before + after) * 0.05
    given_ = (jnp.float32(each) for each in (period, way, before, after))
    used = float(battery.consumption.energy(*given_))
    gained = max(0.0, 0.5 * mass * (after**2 - before**2))
    assert used == pytest.approx(idle * period + per_metre * way + gained, rel=1e-4, abs=1e-4)


@pytest.mark.long
@settings(max_examples=20)
@given(st.floats(1.0, 1e5), st.floats(1.0, 1e3), st.floats(0.1, 0.9))
def test_a_battery_of_any_size_runs_down_and_is_charged_by_what_passes(capacity, idle, charge):
    """Against float64: the energy of a period is small beside that of the battery."""
    battery = Battery(capacity=capacity, idle=idle)
    power, steps = 3.0 * idle, 5000
    truth = TrueBattery(battery, power=power, charge=charge)
    first = truth.init(jnp.zeros(3))
    for dock, gained in ((first.dock, power), (first.dock + 9.0, 0.0)):
        last = rest_for(truth, first._replace(dock=dock), steps)
        wanted = charge * capacity * JOULES + steps * 0.05 * (gained - idle)
        wanted = np.clip(wanted, 0.0, capacity * JOULES)
        passed = steps * 0.05 * power
        assert float(last.energy) == pytest.approx(wanted, rel=3e-7, abs=2e-4 * passed)


@jax.jit
def rest_for(truth: TrueBattery, state: BatteryState, steps: int) -> BatteryState:
    """Return the battery of a robot that stands at (0, 0) for some periods."""
    pose, control = jnp.zeros(ROBOT.state_size), jnp.zeros(2)
    drive = Drive(ROBOT, pose, pose, control, None, jnp.float32(0.05))
    return jax.lax.fori_loop(0, steps, lambda _, before: truth.update(before, drive), state)


@given(st.floats(0.0, 1.0, width=32), st.floats(0.0, 60.0, width=32), st.booleans(), st.booleans())
def test_it_returns_while_the_charge_reaches_and_goes_on_when_full(
    charge, metres, was_returning, has_way
) -> None:
    battery = Battery((0.0, 0.0), capacity=1.0, reserve=0.2, enough=0.9, **NUMBERS)
    energy, way = jnp.float32(charge * JOULES), jnp.float32(metres if has_way else np.inf)
    after = battery.plan_errand(Charge(energy, jnp.zeros(2), jnp.array(was_returning)), way)
    needed = 0.2 * JOULES + metres * (5.0 + 20.0 / 0.6)
    if has_way and charge * JOULES < needed - 1.0:
        assert bool(after.is_returning)
    elif (charge > 0.901 or not was_returning) and (not has_way or charge * JOULES > needed + 1.0):
        assert not bool(after.is_returning)
    elif was_returning and charge < 0.899:
        assert bool(after.is_returning)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_the_way_over_the_reachable_cells_is_the_shortest(seed) -> None:
    """Against Dijkstra's algorithm, written out."""
    rng = np.random.default_rng(seed)
    open_ = rng.random((9, 12)) < 0.7
    grid = jx.OccupancyGrid(np.where(open_, 0.01, 0.99).astype(np.float32), 0.5, (1.0, -2.0, 0.6))
    cells = np.argwhere(open_)
    first, last = cells[rng.integers(len(cells), size=2)]
    places = np.asarray(grid.frame.cell_centre(jnp.asarray([first, last])))
    if np.hypot(*(places[0] - places[1])) < 1.0:
        return
    away, queue = {tuple(first): 0.0}, [(0.0, tuple(first))]
    while queue:
        so_far, (row, column) = heapq.heappop(queue)
        if so_far > away[row, column]:
            continue
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                beside = row + down, column + right
                if not (0 <= beside[0] < 9 and 0 <= beside[1] < 12 and open_[beside]):
                    continue
                length = so_far + 0.5 * math.hypot(down, right)
                if length < away.get(beside, math.inf):
                    away[beside] = length
                    heapq.heappush(queue, (length, beside))
    nowhere = np.zeros((0, 2), np.float32)
    site = Site(grid, ROBOT, None, np.append(places[0], 0.0), nowhere, open_, ORIGIN)
    found = drive_length(site, places[0], places[1])
    assert found == pytest.approx(away.get(tuple(last), math.inf))


@pytest.mark.long
@pytest.mark.parametrize("dock", [(0.8, 1.5), (1.5, 0.6)])
def test_a_robot_returns_is_charged_and_goes_on(dock) -> None:
    """Twice; and a battery that is charged too slowly runs empty, by the same program."""
    battery = Battery(dock, capacity=0.5, reserve=0.3, enough=0.9, **NUMBERS)
    controller = jx.explorer(ROBOT, horizon=30, num_samples=256, dt=0.05)
    run = jx.simulate(
        controller, scenario(battery), 2600, key=jax.random.key(0), num_trajectories=0
    )
    recording = run.recording
    record = recording.records.parts["battery"]
    charge = np.asarray(record.charge)
    metrics = run.metrics.parts["battery"]
    assert metrics.recharges >= 2
    assert metrics.empty_at is None
    # Of the reserve it takes what it has not foreseen: to turn round, and to come to rest, takes
    # this small controller some seconds.
    assert charge.min() > 0.1
    away = np.hypot(*(recording.positions[1:] - np.asarray(dock)).T)
    assert (away[np.asarray(record.is_docked)] <= DOCK_RADIUS + 1e-3).all()
    # It leaves when it is full as far as is wanted, and sees the other room before and after.
    stays = np.flatnonzero(np.diff(np.asarray(record.is_docked).astype(int)) < 0)
    assert (charge[stays] >= 0.88).all()
    first = int(np.flatnonzero(np.asarray(record.is_docked) & (charge < 0.5))[0])
    far = recording.positions[:, 0] > 3.2
    assert far[:first].any()
    assert far[first:].any()
    assert not np.asarray(recording.records.is_collision).any()
    # The energy of the record is that of time, way and speeds, in float64.
    moved = np.hypot(*np.diff(recording.positions.astype(np.float64), axis=0).T)
    speed = np.concatenate([[0.0], np.asarray(recording.records.state)[:, 3]]).astype(np.float64)
    gained = np.maximum(np.diff(speed**2), 0.0)
    used = 20.0 * 0.05 + 5.0 * moved + 0.5 * 4.0 * gained
    before = np.concatenate([[1.0], charge[:-1]])
    power = np.where(record.is_docked, 400.0 * 0.05, 0.0)
    expected = np.clip(before * 0.5 * JOULES - used + power, 0.0, 0.5 * JOULES)
    np.testing.assert_allclose(charge * 0.5 * JOULES, expected, atol=0.05)

    slow = scenario(battery, power=1e-3, charge=0.4)
    run = jx.simulate(controller, slow, 2000, key=jax.random.key(0), num_trajectories=0)
    metrics = run.metrics.parts["battery"]
    assert metrics.empty_at == pytest.approx(run.metrics.duration)
    assert run.metrics.num_steps < 2000
    assert "battery empty" in dict(run.metrics.rows())


def test_a_dock_must_be_reached_with_the_charge() -> None:
    where = "accepted: a place in free space"
    with pytest.raises(ValueError, match=rf"dock is \[3.0.*, 0.5\]; {where}"):
        scenario(Battery((3.05, 0.5)))
    walled = rooms()
    walled[:, 30] = 0.99
    with pytest.raises(ValueError, match=r"dock is \[4.5, 1.5\], which a robot of radius 0.15 m"):
        scenario(Battery((4.5, 1.5)), walled)
    small = Battery((4.5, 1.5), capacity=0.03, **NUMBERS)
    message = r"dock is \(4.5, 1.5\), 3.7 m from the start, for which the battery of 0.03 Wh needs"
    with pytest.raises(ValueError, match=message):
        scenario(small)
    with pytest.raises(ValueError, match=r"enough is 0.1; accepted: a finite number > 0.2"):
        Battery((0.0, 0.0), enough=0.1)


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"dock": [1.0]}, "battery.dock is"),
        ({"capacity": 0.0}, "battery.capacity is 0.0; accepted: greater than 0"),
        ({"reserve": 1.0}, "battery.reserve is 1.0; accepted: less than 1"),
        ({"charge": 2.0}, "battery.charge is 2.0; accepted: less than or equal to 1"),
    ],
)
def test_settings_of_a_battery_that_make_no_sense(entries, message) -> None:
    with pytest.raises(ValueError, match=f"setting {message}"):
        make_settings({"map": "office", "battery": entries})


def test_an_architecture_that_does_not_go_where_it_is_sent_has_no_battery() -> None:
    entries = {"map": "zones", "battery": {}}
    with pytest.raises(ValueError, match="battery is given beside the architecture two-layer"):
        build(make_settings(entries))
    entries = {"map": "office", "architecture": "portfolio", "goal": [3.0, 3.0], "battery": {}}
    with pytest.raises(ValueError, match="battery is given beside a goal in a portfolio"):
        build(make_settings(entries))
