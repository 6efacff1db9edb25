"""What a look is worth: of cells by how long ago they were seen, of beams by what they pass."""

import math
from collections.abc import Callable

import equinox as eqx
import hypothesis.extra.numpy as hnp
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import InverseSensorModel, Lidar, OccupancyGrid
from jaxplore.information import InformationField
from jaxplore.information.beam_table import BeamTable
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.information.gain import IdealSensor
from jaxplore.parts import IdlenessMap

SMALL = OccupancyGrid(np.full((2, 3), 0.5), 1.0)
LONG = hnp.arrays(np.float32, (2, 3), elements=st.floats(0, 1e6, width=32))
interest = eqx.filter_jit(lambda watch, idleness: watch.interest(idleness))


def worth(idleness: float, memory: float) -> float:
    """Return the entropy of what has come back after a time [nat], double precision."""
    q = 0.5 * -math.expm1(-idleness / memory)
    return -q * math.log(q) - (1.0 - q) * math.log1p(-q) if q > 0.0 else 0.0


@given(LONG, st.floats(0.5, 1e4, width=32), st.floats(0, 5, width=32))
def test_interest_is_the_entropy_of_what_came_back(idleness, memory: float, weight: float) -> None:
    found = interest(IdlenessMap(memory, weight), jnp.asarray(idleness))
    expected = [[weight * worth(float(t), memory) for t in row] for row in idleness]
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


@given(LONG, st.floats(0.5, 1e4, width=32), st.floats(0, 5, width=32))
def test_the_longer_unseen_the_more_up_to_one_bit(idleness, memory: float, weight: float) -> None:
    watch = IdlenessMap(memory, weight)
    later = np.sort(idleness.reshape(-1)).reshape(2, 3)
    found = np.asarray(interest(watch, jnp.asarray(later))).reshape(-1)
    assert (np.diff(found) >= -1e-6 * weight).all()
    assert (found >= 0.0).all()
    assert (found <= weight * math.log(2.0) * (1.0 + 1e-6)).all()


@pytest.mark.parametrize("memory", [None, 0.5, 60.0])
def test_what_was_never_seen_is_worth_one_bit_and_what_is_seen_nothing(memory) -> None:
    watch = IdlenessMap(memory, 2.0)
    never = watch.init(SMALL)
    assert never.shape == (2, 3)
    assert np.isinf(never).all()
    np.testing.assert_allclose(interest(watch, never), 2.0 * math.log(2.0), rtol=1e-6)
    np.testing.assert_array_equal(interest(watch, jnp.zeros((2, 3))), 0.0)


def test_with_a_time_of_doubling_the_interest_grows_up_to_32_times() -> None:
    plain, growing = IdlenessMap(60.0, 2.0), IdlenessMap(60.0, 2.0, 20.0)
    idleness = jnp.asarray([[0.0, 10.0, 20.0], [60.0, 100.0, 1e4]])
    factor = [[1.0, math.sqrt(2.0), 2.0], [8.0, 32.0, 32.0]]
    expected = np.asarray(interest(plain, idleness)) * factor
    np.testing.assert_allclose(interest(growing, idleness), expected, rtol=1e-5)
    np.testing.assert_array_equal(growing.init(SMALL), 60.0)


def test_with_an_infinite_memory_one_look_is_enough() -> None:
    idleness = jnp.asarray([[0.0, 1e-3, 1.0], [1e3, 1e30, jnp.inf]])
    found = np.asarray(interest(IdlenessMap(None, 3.0), idleness))
    np.testing.assert_array_equal(found[idleness < jnp.inf], 0.0)
    assert found[1, 2] == pytest.approx(3.0 * math.log(2.0))


def test_after_the_memory_times_ln_2_the_chance_is_a_quarter() -> None:
    found = interest(IdlenessMap(10.0), jnp.full((2, 3), 10.0 * math.log(2.0)))
    expected = 0.25 * math.log(4.0) + 0.75 * math.log(4.0 / 3.0)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@given(st.lists(st.tuples(hnp.arrays(bool, (2, 3)), st.floats(0.0, 9.0, width=32)), max_size=6))
def test_a_look_resets_what_is_seen_and_the_rest_grows_older(looks) -> None:
    watch, never = IdlenessMap(5.0), np.full((2, 3), np.inf)
    found, expected = watch.init(SMALL), never
    for is_seen, elapsed in looks:
        found = watch.update(found, jnp.asarray(is_seen), jnp.asarray(elapsed, jnp.float32))
        expected = np.where(is_seen, 0.0, expected + float(elapsed))
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-30)


def test_numbers_do_not_recompile() -> None:
    traces = []

    @eqx.filter_jit
    def price(watch, idleness):
        traces.append("traced")
        return watch.interest(idleness)

    values = [float(price(IdlenessMap(memory, weight), jnp.ones((1, 1)))[0, 0])
              for memory, weight in ((1.0, 1.0), (2.0, 1.0), (2.0, 3.0))]  # fmt: skip
    assert len(traces) == 1
    assert values[0] > values[1] == pytest.approx(values[2] / 3.0)


# In the information field

RESOLUTION, STRIDE, SHAPE = 0.1, 2, (20, 25)
LIDAR, DIRECTIONS, MAX_RANGE = Lidar(40, 1.13), 10, 1.13
SPACING, SHARE = 2 * math.pi / 40, 4.0
RNG = np.random.default_rng(3)
PROBABILITY = RNG.choice([0.01, 0.1, 0.5, 0.9], SHAPE, p=[0.6, 0.2, 0.1, 0.1])
GRID = OccupancyGrid(PROBABILITY.astype(np.float32), RESOLUTION, (1.0, -2.0, 0.7))
INTEREST = RNG.uniform(0.0, 0.7, SHAPE)
Field = Callable[..., InformationField]


@pytest.fixture(scope="module")
def field() -> Field:
    @eqx.filter_jit
    def evaluate(sensor, grid, model, interest=None):
        return sensor.field(grid, model, interest)

    return evaluate


def nodes() -> np.ndarray:
    """Return some nodes of the lattice (n, 2), of which the robot can be at all."""
    rows, columns = (-(-size // STRIDE) for size in SHAPE)
    some = np.random.default_rng(5).integers(0, (rows, columns - 1), (14, 2))
    cells = STRIDE * some + STRIDE // 2
    return some[PROBABILITY[cells[:, 0], cells[:, 1]] <= 0.65]


def seen_by_beam(cells_of_a_ray, node, angle: float, spacing: float | None, returns: bool) -> float:
    """Return what a beam's look is worth: the chance that it passes each cell, times the interest.

    With `returns` only beams that come back count: they are stopped later, within reach.
    """
    start = STRIDE * node + STRIDE // 2 + 0.5
    cells, spans = cells_of_a_ray(start, angle, MAX_RANGE / RESOLUTION)
    through = np.ones(len(cells) + 1)
    gained = np.zeros(len(cells))
    for n, (cell, span) in enumerate(zip(cells, spans, strict=True)):
        is_inside = ((cell >= 0) & (cell < SHAPE)).all()
        p = PROBABILITY[tuple(cell)] if is_inside else 1.0
        through[n + 1] = through[n] * (1.0 - p)
        weight = 1.0 if spacing is None else min(1.0, span.mean() * spacing)
        gained[n] = weight * INTEREST[tuple(cell)] if is_inside else 0.0
    end = through[-1] if returns else 0.0
    return float((gained * (through[1:] - end)).sum())


@pytest.mark.parametrize("model", [InverseSensorModel(), IdealSensor()], ids=["log odds", "ideal"])
@pytest.mark.parametrize("near_weight", [True, False])
def test_a_scan_is_worth_what_its_beams_pass(
    field: Field, cells_of_a_ray, model, near_weight: bool
) -> None:
    sensor = FieldSensor(
        LIDAR, RESOLUTION, DIRECTIONS, STRIDE, near_weight=near_weight, method="scan"
    )
    assert sensor.doubling is None
    known = field(sensor, GRID, model).sectors
    found = field(sensor, GRID, model, jnp.asarray(INTEREST, jnp.float32)).sectors
    difference = np.asarray(found, np.float64) - np.asarray(known, np.float64)
    spacing, total = SPACING if near_weight else None, 0.0
    for node in nodes():
        for direction, angle in enumerate(np.asarray(sensor.angles, np.float64)):
            expected = SHARE * seen_by_beam(cells_of_a_ray, node, angle, spacing, False)
            assert difference[direction, *node] == pytest.approx(expected, rel=1e-4, abs=1e-4)
            total += expected
    assert total > 10.0


def test_beams_that_must_come_back_look_only_then(field: Field, cells_of_a_ray) -> None:
    sensor = FieldSensor(LIDAR, RESOLUTION, DIRECTIONS, STRIDE, no_return=False)
    known = field(sensor, GRID, InverseSensorModel()).sectors
    found = field(sensor, GRID, InverseSensorModel(), jnp.asarray(INTEREST, jnp.float32)).sectors
    for node in nodes():
        for direction, angle in enumerate(np.asarray(sensor.angles, np.float64)):
            expected = SHARE * seen_by_beam(cells_of_a_ray, node, angle, SPACING, True)
            difference = float(found[direction, *node]) - float(known[direction, *node])
            assert difference == pytest.approx(expected, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("method", ["scan", "doubling"])
def test_without_any_interest_a_field_is_the_same(field: Field, method) -> None:
    sensor = FieldSensor(LIDAR, RESOLUTION, DIRECTIONS, STRIDE, method=method)
    model = InverseSensorModel()
    alone, found = field(sensor, GRID, model), field(sensor, GRID, model, jnp.zeros(SHAPE))
    np.testing.assert_array_equal(found.sectors, alone.sectors)
    np.testing.assert_array_equal(found.cumulative, alone.cumulative)


def test_without_interest_a_field_is_the_one_brought_up_to_date(field: Field) -> None:
    """To the bit: a map that changed, by the path that reads no interest."""
    sensor, model = FieldSensor(LIDAR, RESOLUTION, DIRECTIONS, STRIDE), InverseSensorModel()
    before = OccupancyGrid(np.full(SHAPE, 0.5), RESOLUTION, (1.0, -2.0, 0.7))
    update = eqx.filter_jit(lambda *arguments: sensor.update(*arguments))
    updated = update(field(sensor, before, model), GRID, model)
    np.testing.assert_array_equal(updated.sectors, field(sensor, GRID, model, None).sectors)


@pytest.mark.parametrize("near_weight", [True, False])
def test_doubling_is_the_scan_of_the_same_beams(field: Field, near_weight: bool) -> None:
    numbers = LIDAR, RESOLUTION, DIRECTIONS, STRIDE
    doubling, scan = (
        FieldSensor(*numbers, near_weight=near_weight, method=method)
        for method in ("doubling", "scan")
    )
    table = BeamTable(
        np.asarray(doubling.angles, np.float64),
        MAX_RANGE / RESOLUTION,
        STRIDE,
        share=SHARE,
        spacing=SPACING if near_weight else None,
    )
    scan = eqx.tree_at(lambda sensor: sensor.table, scan, table)
    given = jnp.asarray(INTEREST, jnp.float32)
    one, other = (field(each, GRID, InverseSensorModel(), given) for each in (doubling, scan))
    np.testing.assert_allclose(one.sectors, other.sectors, rtol=1e-5, atol=1e-5)
    assert float(jnp.abs(one.sectors).max()) > 1.0
