"""What differs from the known map: the test of a scan, suspicions, second looks and reports."""

import dataclasses
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from jaxplore import Camera, InverseSensorModel, Lidar, OccupancyGrid, Perception
from jaxplore.belief import Observation
from jaxplore.geometry.rays import RayCells
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.maps import Ground
from jaxplore.parts import AnomalyTest, IdlenessMap
from jaxplore.parts.anomalies.reports import APPEARED, GONE, MAX_REPORTS, PERSON, Reports
from jaxplore.parts.anomalies.robot import Anomalies
from jaxplore.sensing.change_evidence import BeamModel, beam_evidence

SHAPE, RESOLUTION = (40, 60), 0.1  # 6 m x 4 m
SENSOR = Lidar(90, 4.0, range_noise=0.05)
ZONE = (4.0, 0.5, 5.5, 1.5)
BLOCK = (slice(24, 30), slice(30, 36))  # x from 3.0 to 3.6 m, y from 2.4 to 3.0 m
TEST = AnomalyTest(false_alarms=1e-3, near=3.0, baseline=0.5, looks=10, stay=0.0, forbidden=[ZONE])


def hall(*blocks) -> OccupancyGrid:
    world = np.full(SHAPE, 0.01, np.float32)
    world[:2], world[-2:], world[:, :2], world[:, -2:] = 0.99, 0.99, 0.99, 0.99
    for block in blocks:
        world[block] = 0.99
    return OccupancyGrid(world, RESOLUTION)


# The densities

with_obstacle = jax.jit(BeamModel.with_obstacle)


def slow_evidence(model, cells, is_free, is_occupied, ranges, is_return):
    """Return the ratios beam by beam and cell by cell, in double precision."""
    noise, longest, outliers = (float(each) for each in model)
    stray, none = outliers / 2 / longest, outliers / 2
    entry, exit_ = np.asarray(cells.entry) * RESOLUTION, np.asarray(cells.exit) * RESOLUTION
    change, person = np.zeros(entry.shape), np.zeros(entry.shape)
    for beam in range(len(ranges)):
        blocked = np.nonzero(np.asarray(cells.is_crossed)[beam] & ~is_free[beam])[0]
        first = blocked[0] if len(blocked) else None
        wall = entry[beam, first] if first is not None else np.inf
        z, returns = float(ranges[beam]), bool(is_return[beam])
        by_mover = not returns and z < longest

        def behind(z, wall=wall):
            return 0.5 * (z > wall) / max(longest - wall, noise)

        if wall >= longest:
            known = stray if returns else 1 - none
        elif is_occupied[beam, first]:
            known = (1 - outliers) * norm.pdf(z, wall, noise) + stray if returns else none
        else:
            # Whatever explains the reading best: the nearest surface from the cell's begin on.
            at_best = norm.pdf(z, max(z, wall), noise) if returns else 1.0
            known = (1 - outliers) * at_best + (stray if returns else none)
        for cell in range(entry.shape[1]):
            begin, end = entry[beam, cell], exit_[beam, cell]
            if not np.asarray(cells.is_crossed)[beam, cell] or z < begin - 4 * noise:
                continue
            if cell == first and is_occupied[beam, cell] and not by_mover:
                other = (1 - outliers) * (behind(z) if returns else 0.5)
                change[beam, cell] = np.log((other + (stray if returns else none)) / known)
            if begin >= min(wall, longest):
                continue
            inside = (norm.cdf(z, begin, noise) - norm.cdf(z, end, noise)) / (end - begin)
            hit = (1 - outliers) * inside + stray
            if by_mover:
                person[beam, cell] = np.log(hit / stray)
            else:
                change[beam, cell] = np.log((hit if returns else none) / known)
                person[beam, cell] = np.log(outliers)
    return change, person


def test_ratios_are_those_of_the_densities() -> None:
    model = BeamModel(jnp.float32(0.05), 4.0, jnp.float32(0.02))
    rng = np.random.default_rng(0)
    lengths = rng.uniform(0.2, 1.4, (60, 45))
    exits = np.cumsum(lengths, axis=1)
    entries = np.concatenate([np.zeros((60, 1)), exits[:, :-1]], axis=1)
    crossed = rng.random(exits.shape) < 0.95
    cells = RayCells(
        jnp.zeros((*exits.shape, 2), jnp.int32),
        jnp.asarray(entries, jnp.float32),
        jnp.asarray(exits, jnp.float32),
        jnp.asarray(crossed),
    )
    value = rng.choice([0.0, 0.5, 1.0], exits.shape, p=[0.95, 0.01, 0.04])
    ranges = rng.uniform(0.1, 4.0, 60).astype(np.float32)
    # Some readings are at the walls, where the densities of the map matter.
    walls = np.where((value > 0) & crossed, entries * RESOLUTION, 4.0).min(axis=1)
    ranges[::2] = np.clip(walls[::2] + 0.05 * rng.normal(size=30), 0.0, 4.0)
    returns = rng.random(60) < 0.7
    ranges[~returns & (rng.random(60) < 0.5)] = 4.0
    found = jax.jit(beam_evidence, static_argnums=6)(
        BeamModel(model.noise, 4.0, model.outliers),
        cells,
        jnp.asarray(value == 0.0),
        jnp.asarray(value == 1.0),
        jnp.asarray(ranges),
        jnp.asarray(returns),
        RESOLUTION,
    )
    change, person = slow_evidence(model, cells, value == 0.0, value == 1.0, ranges, returns)
    np.testing.assert_allclose(found.change, change, rtol=2e-3, atol=2e-3)
    np.testing.assert_allclose(found.person, person, rtol=2e-3, atol=2e-3)
    assert (change > 1.0).sum() > 10
    assert (person > 1.0).sum() > 10


# Scans in a row


LEVELS = jnp.array([1.0, 2.0, 3.0, 4.0, 5.0])
FEW = Lidar(24, 2.0, range_noise=0.05)


class Sums(NamedTuple):
    """Number of cells with evidence at each level, and whether one raises an alarm, per scan."""

    exceeded: jax.Array
    has_alarm: jax.Array


@jax.jit
def gathered(test, known, truth, poses, person, keys) -> Sums:
    """Gather evidence in R runs of T scans at poses (T, R, 3)."""

    def one(state, pose, key):
        scan = FEW.scan(truth, pose, key=key, movers=person[None])
        after = test.add_evidence(state, *test.evidence(state, FEW, known, scan, pose))
        sums = jnp.stack([after.change, after.person])[..., None]
        return after, Sums((sums >= LEVELS).sum(axis=(0, 1, 2)), after.has_alarm)

    def step(states, inputs):
        return jax.vmap(one)(states, *inputs)

    runs = poses.shape[1]
    begin = jax.tree.map(lambda leaf: jnp.stack([leaf] * runs), test.init(known))
    return jax.lax.scan(step, begin, (poses, keys))[1]


@jax.jit
def watched(test, truths, known, poses, person, key) -> Anomalies:
    """Scan from one pose after another, with a person, a disc (x, y, radius), in the hall.

    `truths` (T, H, W) are the true maps at the scans.
    """

    def step(state, inputs):
        index, pose, probability = inputs
        truth = known.with_probability(probability)
        now = jax.random.fold_in(key, index)
        scan = SENSOR.scan(truth, pose, key=now, movers=person[None])
        seen = SENSOR.sight(known, scan, pose).is_seen
        time = 0.1 * index.astype(jnp.float32)
        observation = Observation(SENSOR, known, scan, seen, pose, jnp.zeros(()), time)
        return test.observe(state, observation), None

    return jax.lax.scan(step, test.init(known), (jnp.arange(len(poses)), poses, truths))[0]


def always(grid: OccupancyGrid, scans: int) -> np.ndarray:
    return np.repeat(np.asarray(grid.probability)[None], scans, axis=0)


WALK = jnp.array([2.5, 3.2, 0.25])
"""Somebody where people may be."""


def rows_of(poses) -> jax.Array:
    return jnp.asarray(poses, jnp.float32)


def test_false_alarms_keep_the_stated_rate_over_ten_thousand_scans() -> None:
    runs, scans, rate = 100, 100, 0.2
    test = AnomalyTest(false_alarms=rate, forbidden=[ZONE])
    rng = np.random.default_rng(1)
    ends = rng.uniform([0.8, 0.8, -3.0], [5.2, 2.2, 3.0], (2, runs, 3))
    share = np.linspace(0.0, 1.0, scans)[:, None, None]
    poses = rows_of(ends[0] * (1 - share) + ends[1] * share)
    world = hall((slice(26, 30), slice(16, 24)))
    keys = jax.random.split(jax.random.key(0), (scans, runs))
    done = gathered(test, world, world, poses, WALK, keys)
    assert done.has_alarm.size == 10_000
    assert float(done.has_alarm.mean()) <= rate
    # For each cell the bound is exp(-h). It is no empty one: there are cells beyond all levels.
    per_scan = np.asarray(done.exceeded).mean(axis=(0, 1))
    tested = math.exp(float(test.init(world).threshold)) * rate
    assert (per_scan <= tested * np.exp(-np.asarray(LEVELS))).all()
    assert (per_scan > 1e-3).all()


def test_what_unknown_cells_hold_raises_no_more_alarms() -> None:
    """A solid block, nothing, and a block further in."""
    runs, scans, rate = 100, 100, 0.2
    test = AnomalyTest(false_alarms=rate, forbidden=[ZONE])
    rows, inner = slice(26, 32), slice(28, 31)
    values = np.array(hall().probability)
    for columns in (slice(8, 16), slice(20, 28), slice(32, 40)):
        values[rows, columns] = 0.5
    known = OccupancyGrid(values, RESOLUTION)
    truth = hall((rows, slice(8, 16)), (inner, slice(32, 40)))
    rng = np.random.default_rng(2)
    poses = rows_of(rng.uniform([0.8, 1.0, -3.0], [4.2, 2.3, 3.0], (scans, runs, 3)))
    keys = jax.random.split(jax.random.key(3), (scans, runs))
    done = gathered(test, known, truth, poses, WALK, keys)
    assert float(done.has_alarm.mean()) <= rate
    per_scan = np.asarray(done.exceeded).mean(axis=(0, 1))
    tested = math.exp(float(test.init(known).threshold)) * rate
    assert (per_scan <= tested * np.exp(-np.asarray(LEVELS))).all()


def test_every_range_has_a_density() -> None:
    """Rounding gives no logarithm of what is below 0, and a corner that is cut its middle."""
    rng = np.random.default_rng(4)
    beams, cells = 500, 400
    entry = rng.uniform(0.0, 4.0, (beams, 1)).astype(np.float32)
    length = np.exp(rng.uniform(math.log(1e-7), 0.0, (beams, cells)))
    edges = np.concatenate([entry, entry + np.cumsum(length, axis=1)], axis=1).astype(np.float32)
    ranges = rng.uniform(0.0, 6.0, beams).astype(np.float32)
    model = BeamModel(jnp.float32(0.05), 4.0, jnp.float32(0.02))
    found = np.asarray(with_obstacle(model, ranges, edges[:, :-1], edges[:, 1:]))
    assert np.isfinite(found).all()
    begin, end = (each.astype(float) for each in (edges[:, :-1], edges[:, 1:]))
    away = ranges[:, None].astype(float)
    inside = norm.cdf(away, begin, 0.05) - norm.cdf(away, end, 0.05)
    middle = norm.pdf(away, 0.5 * (begin + end), 0.05)
    is_long = end - begin > 5e-4
    density = np.where(is_long, inside / np.where(is_long, end - begin, 1.0), middle)
    np.testing.assert_allclose(np.exp(found), 0.98 * density + 0.0025, rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("zones", [[], [ZONE], [ZONE, (0.0, 0.0, 1.02, 0.92)]])
def test_the_threshold_counts_every_test(zones) -> None:
    """One test a cell, and one more a free cell of a forbidden zone: log(tests / false_alarms)."""
    world = hall((slice(26, 30), slice(16, 24)))
    probability = np.asarray(world.probability)
    rows, columns = np.indices(probability.shape)
    x, y = (columns + 0.5) * world.resolution, (rows + 0.5) * world.resolution
    is_forbidden = np.zeros(probability.shape, bool)
    for left, bottom, right, top in zones:
        is_forbidden |= (x >= left) & (x <= right) & (y >= bottom) & (y <= top)
    tests = probability.size + int((is_forbidden & (probability < 0.5)).sum())
    assert tests > probability.size or not zones
    threshold = AnomalyTest(false_alarms=1e-3, forbidden=zones).init(world).threshold
    assert float(threshold) == pytest.approx(math.log(tests / 1e-3), rel=1e-6)


TRACK = rows_of([(1.0 + 0.02 * k, 1.2, 0.0) for k in range(60)])
AWAY = jnp.array([1.0, 3.2, 0.0])
"""Nobody: a disc of radius 0 is ignored."""


def of(done: Anomalies) -> list[np.ndarray]:
    reports = jax.tree.map(np.asarray, done.reports)
    used = reports.kind > 0
    return [each[used] for each in reports]


@pytest.mark.parametrize(("kind", "person"), [(APPEARED, AWAY), (GONE, AWAY), (PERSON, None)])
def test_what_differs_is_suspected_looked_at_again_and_reported(kind: int, person) -> None:
    empty, filled = hall(), hall(BLOCK)
    truth = filled if kind == APPEARED else empty
    known = filled if kind == GONE else empty
    person = jnp.array([4.7, 1.0, 0.25]) if person is None else person
    done = watched(TEST, always(truth, len(TRACK)), known, TRACK, person, jax.random.key(3))
    place, kinds, suspected, reported, seen_from, *_ = of(done)
    assert kinds.tolist() == [kind] * len(kinds)
    assert 1 <= len(kinds) <= 2
    box = (4.45, 0.75, 4.95, 1.25) if kind == PERSON else (3.0, 2.4, 3.6, 3.0)
    beside = np.maximum(np.maximum(box[:2] - place, place - np.array(box[2:])), 0.0)
    assert np.hypot(*beside.T).max() < 0.2
    is_reported = np.isfinite(reported)
    assert is_reported.any()
    # The second look is from another place.
    later = TRACK[np.round(10 * reported[is_reported]).astype(int), :2]
    assert (np.hypot(*(later - seen_from[is_reported]).T) >= 0.5 - 1e-6).all()
    assert (reported > suspected).all()
    assert int(done.num_cleared) == 0


def test_as_known_there_is_nothing_to_report() -> None:
    known = hall(BLOCK)
    for person in (AWAY, WALK):
        done = watched(TEST, always(known, len(TRACK)), known, TRACK, person, jax.random.key(4))
        assert not (np.asarray(done.reports.kind) > 0).any()
        assert int(done.num_cleared) == 0


@jax.jit
def look(state: Anomalies, pose, time) -> Anomalies:
    """Look around in an empty hall that is as known."""
    key = jax.random.fold_in(jax.random.key(0), (10.0 * time).astype(jnp.int32))
    scan = SENSOR.scan(hall(), pose, key=key)
    seen = SENSOR.sight(hall(), scan, pose).is_seen
    return TEST.observe(state, Observation(SENSOR, hall(), scan, seen, pose, jnp.zeros(()), time))


def test_a_suspicion_without_confirmation_is_dropped() -> None:
    state = TEST.init(hall())
    place = jnp.array([3.0, 2.0])
    begin = jnp.array([1.0, 1.2, 0.0])
    # Nobody looks into the corner of the wall, so nothing there can leave.
    reports = state.reports.open_suspicion(
        jnp.array(True), place, jnp.full(2, 0.05), jnp.int32(APPEARED), jnp.zeros(()), begin
    )
    state = dataclasses.replace(state, reports=reports)

    there, beside = jnp.array([1.2, 1.2, 0.0]), jnp.array([2.0, 1.2, 0.0])
    # These looks are from where it was suspected.
    for k in range(5):
        state = look(state, there, jnp.float32(0.1 * k))
    assert int(state.reports.looks[0]) == 0
    for k in range(10):
        assert bool(state.reports.is_open[0])
        state = look(state, beside, jnp.float32(2.0 + 0.1 * k))
    assert not bool(state.reports.is_open.any())
    assert int(state.num_cleared) == 1
    late = look(dataclasses.replace(state, reports=reports), there, jnp.float32(60.0))
    assert not bool(late.reports.is_open.any())
    assert int(late.num_cleared) == 2


def test_who_passes_untracked_is_no_anomaly_and_what_stands_is() -> None:
    poses = rows_of([(1.0 + 0.03 * k, 1.2, 0.0) for k in range(60)])
    y, x = (np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5) * RESOLUTION
    empty = always(hall(), len(poses))
    passes, stands = empty.copy(), empty.copy()
    for k in range(len(poses)):
        passes[k][np.hypot(x - 1.2 - 0.06 * k, y - 2.6) <= 0.3] = 0.99
        stands[k][np.hypot(x - 2.4, y - 2.6) <= 0.3] = 0.99
    test = eqx.tree_at(lambda each: each.stay, TEST, jnp.float32(1.0))
    for seed in range(3):
        key = jax.random.key(seed)
        there = watched(test, stands, hall(), poses, AWAY, key)
        assert np.isfinite(np.asarray(there.reports.reported)).any()
        assert float(there.reports.absent.max()) < float(there.threshold)
        gone = watched(test, passes, hall(), poses, AWAY, key)
        assert not np.isfinite(np.asarray(gone.reports.reported)).any()
        assert int(gone.num_cleared) > 0


def test_absence_is_the_test_turned_round() -> None:
    rng = np.random.default_rng(0)
    reports = Reports.none()._replace(spot=jnp.asarray(rng.uniform(0.0, 6.0, (MAX_REPORTS, 2))))
    expected = np.zeros(MAX_REPORTS)
    for _ in range(4):
        evidence = rng.normal(-6.0, 3.0, SHAPE).astype(np.float32)
        evidence[rng.uniform(size=SHAPE) < 0.5] = 0.0
        evidence[:20, :20] = 0.0
        reports = reports.add_absence(hall(), jnp.asarray(evidence))
        for row, (across, along) in enumerate(np.asarray(reports.spot)):
            i = min(int(along / RESOLUTION), SHAPE[0] - 1)
            j = min(int(across / RESOLUTION), SHAPE[1] - 1)
            looked = [
                float(evidence[a, b])
                for a in range(max(i - 1, 0), min(i + 2, SHAPE[0]))
                for b in range(max(j - 1, 0), min(j + 2, SHAPE[1]))
                if evidence[a, b] != 0.0
            ]
            if looked and along < SHAPE[0] * RESOLUTION:
                expected[row] = max(0.0, expected[row] - max(looked))
    inside = np.asarray(reports.spot)[:, 1] < SHAPE[0] * RESOLUTION
    assert inside.sum() > 1
    np.testing.assert_allclose(np.asarray(reports.absent)[inside], expected[inside], atol=1e-4)
    assert (expected > 0.0).any()


def test_a_full_list_takes_no_more() -> None:
    reports, pose = Reports.none(), jnp.zeros(3)
    for number in range(MAX_REPORTS + 2):
        spot = jnp.full(2, jnp.float32(number))
        reports = reports.open_suspicion(
            jnp.array(True), spot, spot, jnp.int32(GONE), jnp.zeros(()), pose
        )
    np.testing.assert_array_equal(reports.place[:, 0], np.arange(MAX_REPORTS))


# Where the robot goes


def test_information_leads_to_where_a_second_look_is_possible() -> None:
    known = hall((slice(2, 30), slice(28, 32)))
    sensor, model = FieldSensor(SENSOR, RESOLUTION, 8, 2), InverseSensorModel.line_of_sight()
    field = eqx.filter_jit(sensor.field)(known, model, np.ones(SHAPE, np.float32))
    state, attended = TEST.init(known), eqx.filter_jit(TEST.add_information)
    same = attended(state, field, known, SENSOR)
    np.testing.assert_array_equal(same.cumulative, field.cumulative)
    place, pose = jnp.array([4.5, 1.0]), jnp.array([4.5, 3.5, 0.0])
    reports = state.reports.open_suspicion(
        jnp.array(True), place, place, jnp.int32(GONE), jnp.zeros(()), pose
    )
    state = dataclasses.replace(state, reports=reports)
    led = attended(state, field, known, SENSOR)
    rows, columns = np.mgrid[: led.total.shape[0], : led.total.shape[1]]
    x, y = 0.2 * columns + 0.15, 0.2 * rows + 0.15
    raised = np.asarray(led.total) > 0.5 * float(field.total.max())
    # Within 0.9 of three metres, apart from where it was suspected, and not behind the wall.
    assert (np.hypot(x - 4.5, y - 1.0)[raised] <= 2.7 + 1e-5).all()
    assert (np.hypot(x - 4.5, y - 3.5)[raised] > 0.5).all()
    assert not raised[(x < 2.8) & (y < 2.5)].any()
    assert raised[(np.abs(x - 4.5) < 0.8) & (y < 2.0) & (y > 0.3)].all()
    np.testing.assert_allclose(
        np.asarray(led.total)[~raised], 0.1 * np.asarray(field.total)[~raised], rtol=1e-4
    )
    np.testing.assert_allclose(led.sectors.sum(axis=0), led.total, rtol=1e-3, atol=1e-3)


def test_what_a_test_does_not_accept() -> None:
    with pytest.raises(ValueError, match=r"forbidden has shape \(1, 2\); accepted: \(F, 4\)"):
        AnomalyTest(forbidden=[(1.0, 2.0)])


def test_a_perception_needs_a_watch_level_ground_and_a_lidar() -> None:
    with pytest.raises(ValueError, match="parts has no 'watch' before 'anomalies'; accepted: both"):
        Perception(SENSOR, RESOLUTION, 0.2, parts=[TEST, IdlenessMap(60.0)])
    with pytest.raises(ValueError, match=r"parts\[1\] is a second 'watch'; accepted: one part"):
        Perception(SENSOR, RESOLUTION, 0.2, parts=[IdlenessMap(60.0), IdlenessMap()])
    more = {"parts": [IdlenessMap(60.0), TEST]}
    with pytest.raises(ValueError, match="sensors begin with a Camera"):
        Perception(Camera(8, 4.0, math.radians(60.0)), RESOLUTION, 0.2, **more)
    level = Ground(np.zeros(SHAPE), RESOLUTION)
    with pytest.raises(ValueError, match="ground is given"):
        Perception(SENSOR, RESOLUTION, 0.2, ground=level, **more)
