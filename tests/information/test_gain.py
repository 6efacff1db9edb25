import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import FieldSensor, InverseSensorModel, Lidar, OccupancyGrid, PoseInformation
from jaxplore.information import expected_gain, update_gain
from jaxplore.information.gain import IdealSensor, cell_gains
from jaxplore.information.noise import GaussianNoise

pytestmark = pytest.mark.long

WIDE = InverseSensorModel(occupied=0.85, free=-0.4, minimum=-30.0, maximum=30.0)


@given(st.floats(0.01, 0.99), st.sampled_from([0.85, -0.4, 2.0, -2.0]))
def test_gain_is_the_formula_of_fsmi(p: float, change: float) -> None:
    # theory 1: f(d, r) with r the odds, d the factor of the update, checked in double precision.
    r, d = p / (1 - p), math.exp(change)
    expected = math.log((r + 1) / (r + 1 / d)) - math.log(d) / (r * d + 1)
    found = float(update_gain(jnp.float32(p), jnp.float32(change), WIDE))
    assert found == pytest.approx(expected, abs=2e-6, rel=1e-4)


def test_gain_is_accurate_for_nearly_certain_cells_too() -> None:
    margins = np.geomspace(1e-6, 0.5, 200)
    p = np.concatenate([margins, 1 - margins]).astype(np.float32)
    odds = p.astype(float) / (1 - p.astype(float))
    model = InverseSensorModel.from_odds()
    # Of a tiny update only the absolute error is small: the terms of the gain are not.
    for change, rtol, atol in (
        *((change, 2e-5, 1e-11) for change in (0.85, -0.4, 2.0, -2.0, 10.0, -10.0)),
        *((change, 0.0, 2e-7) for change in (0.01, -0.01)),
    ):
        d = math.exp(float(np.float32(change)))
        expected = np.log((odds + 1) / (odds + 1 / d)) - math.log(d) / (odds * d + 1)
        found = update_gain(jnp.asarray(p), jnp.float32(change), model)
        np.testing.assert_allclose(found, expected, rtol=rtol, atol=atol)


def test_an_ideal_look_gains_the_cells_entropy() -> None:
    p = np.asarray([0.0, 1e-6, 0.2, 0.5, 0.9, 1 - 1e-6, 1.0], np.float32)
    inner, free = p[1:-1].astype(float), 1 - p[1:-1].astype(float)
    gains = cell_gains(jnp.asarray(p), IdealSensor())
    # An impossible measurement gains 0, not infinity.
    np.testing.assert_allclose(gains.occupied, [0, *-np.log(inner), 0], rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(gains.free, [0, *-np.log(free), 0], rtol=1e-5, atol=1e-7)
    entropy = [0, *(-inner * np.log(inner) - free * np.log(free)), 0]
    found = expected_gain(jnp.asarray(p), IdealSensor())
    np.testing.assert_allclose(found, entropy, rtol=1e-5, atol=1e-7)


def test_cell_gains_are_those_of_either_update() -> None:
    p = jnp.linspace(0.0, 1.0, 11)
    for model in (InverseSensorModel(), InverseSensorModel.from_odds(3.0, 0.25, clamp=(-2.0, 3.0))):
        gains = cell_gains(p, model)
        np.testing.assert_array_equal(gains.occupied, update_gain(p, model.occupied, model))
        np.testing.assert_array_equal(gains.free, update_gain(p, model.free, model))


@pytest.mark.parametrize("p", [0.02, 0.49, 0.5, 0.51, 0.98])
@pytest.mark.parametrize("change", [0.85, -0.4, 2.0, -2.0])
def test_derivative_of_the_gain(p: float, change: float) -> None:
    """Against central differences of FSMI's formula."""

    def gain(p: float) -> float:
        r, d = p / (1 - p), math.exp(change)
        return math.log((r + 1) / (r + 1 / d)) - math.log(d) / (r * d + 1)

    expected = (gain(p + 1e-6) - gain(p - 1e-6)) / 2e-6
    found = float(jax.grad(update_gain)(jnp.float32(p), jnp.float32(change), WIDE))
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"occupied": 1.0}, "occupied is 1.0; accepted: a finite number > 1.0"),
        ({"occupied": 0.5}, "occupied is 0.5; accepted: a finite number > 1.0"),
        ({"occupied": math.inf}, "occupied is inf; accepted"),
        ({"free": 1.0}, "free is 1.0; accepted: a finite number > 0.0 and < 1.0"),
        ({"free": 0.0}, "free is 0.0; accepted: a finite number > 0.0 and < 1.0"),
        ({"free": math.nan}, "free is nan; accepted"),
        ({"clamp": (0.5, 3.0)}, "minimum is 0.5; accepted: a finite number < 0.0"),
        ({"clamp": (-2.0, 0.0)}, "maximum is 0.0; accepted: a finite number > 0.0"),
    ],
)
def test_bad_odds(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        InverseSensorModel.from_odds(**arguments)


@given(st.floats(0.002, 0.99), st.sampled_from([2.0, -2.0]))
def test_gain_through_the_clamp_is_the_divergence_of_what_the_map_does(
    p: float, change: float
) -> None:
    model = InverseSensorModel()
    q = float(model.update(jnp.float32(p), jnp.float32(change)))
    expected = q * math.log(q / p) + (1 - q) * math.log((1 - q) / (1 - p))
    found = float(update_gain(jnp.float32(p), jnp.float32(change), model))
    assert found == pytest.approx(expected, abs=2e-6, rel=1e-3)


def test_a_saturated_cell_gains_nothing_from_more_of_the_same() -> None:
    model = InverseSensorModel()
    low, high = 1 / (1 + math.exp(7)), 1 / (1 + math.exp(-5))
    assert float(update_gain(jnp.float32(low), model.free, model)) == pytest.approx(0.0, abs=1e-6)
    assert float(update_gain(jnp.float32(high), model.occupied, model)) == pytest.approx(
        0, abs=1e-6
    )


def test_certain_cells_give_finite_gains() -> None:
    gain = expected_gain(jnp.asarray([0.0, 1.0, 0.5]), InverseSensorModel())
    assert np.isfinite(gain).all()
    assert (np.asarray(gain) >= 0).all()
    assert float(gain[2]) > 100 * float(gain[0])


def test_scan_recursion_is_the_expectation_over_all_maps() -> None:
    """V = sum over maps m of P(m) sum_i KL(posterior_i || prior_i), by enumeration of 2^n maps."""
    rng = np.random.default_rng(3)
    for _ in range(5):
        p = rng.uniform(0.02, 0.98, 7)
        r = p / (1 - p)

        def gain(change: float, odds: np.ndarray = r) -> np.ndarray:
            d = math.exp(change)
            return np.log((odds + 1) / (odds + 1 / d)) - math.log(d) / (odds * d + 1)

        occupied, free = gain(0.85), gain(-0.4)
        total = 0.0
        for cells in itertools.product([0, 1], repeat=7):
            probability = np.prod(np.where(cells, p, 1 - p))
            first = cells.index(1) if 1 in cells else 7
            total += probability * (free[:first].sum() + (occupied[first] if first < 7 else 0.0))
        b = np.asarray(expected_gain(jnp.asarray(p, jnp.float32), WIDE), float)
        value = 0.0
        for i in reversed(range(7)):
            value = b[i] + (1 - p[i]) * value
        assert value == pytest.approx(total, rel=1e-5)


DECISIVE = InverseSensorModel.line_of_sight()
# The same numbers, taken at their word.
LITERAL = InverseSensorModel(
    DECISIVE.occupied, DECISIVE.free, DECISIVE.minimum, DECISIVE.maximum, is_decisive=False
)
LIDAR = Lidar(num_beams=16, max_range=2.0, range_noise=0.0)
HALL = np.full((16, 20), 0.01, np.float32)
HALL[0] = HALL[-1] = HALL[:, 0] = HALL[:, -1] = HALL[4:7, 12] = 0.99


def divergence(after: float, before: float) -> float:
    """KL(after || before) of two Bernoulli variables."""
    return after * math.log(after / before) + (1 - after) * math.log((1 - after) / (1 - before))


def test_what_a_decisive_look_is_worth() -> None:
    p = jnp.asarray([0.5, 0.3, 0.01, 0.64])
    free = np.asarray(update_gain(p, DECISIVE.free, DECISIVE))
    expected = [divergence(0.01, before) for before in (0.5, 0.3, 0.01, 0.64)]
    np.testing.assert_allclose(free, expected, rtol=1e-5, atol=1e-7)
    occupied = np.asarray(update_gain(p, DECISIVE.occupied, DECISIVE))
    # A settled cell is certain: a hit there is noise, not news.
    expected = [divergence(0.99, 0.5), divergence(0.99, 0.3), 0.0, divergence(0.99, 0.64)]
    np.testing.assert_allclose(occupied, expected, rtol=1e-5, atol=1e-7)


def test_walls_that_a_beam_passes_gain_nothing() -> None:
    p = jnp.asarray([0.66, 0.8, 0.99, 1.0])
    np.testing.assert_array_equal(update_gain(p, DECISIVE.free, DECISIVE), 0.0)
    np.testing.assert_array_equal(cell_gains(p, DECISIVE).free, 0.0)
    assert (np.asarray(update_gain(p, LITERAL.free, LITERAL)) > 0.5).all()
    # Being hit still tells something of a wall that is in doubt.
    hit = float(update_gain(p[1], DECISIVE.occupied, DECISIVE))
    assert hit == pytest.approx(divergence(0.99, 0.8), rel=1e-5)


def field_sensor(method: str) -> FieldSensor:
    return FieldSensor(LIDAR, 0.2, 16, method=method)


@pytest.fixture(scope="module")
def everywhere():
    """Return what gives the information of a full turn from the middle of every cell, by hall,
    sensor and way to compute it; compiled once for each kind of sensor."""
    rows, columns = np.mgrid[:16, :20]
    centres = jnp.asarray(np.stack([columns, rows], -1).reshape(-1, 2) * 0.2 + 0.1, jnp.float32)
    headings = jnp.full(len(centres), 0.5 * LIDAR.beam_spacing)
    sensors = {method: field_sensor(method) for method in ("scan", "doubling")}
    cast = eqx.filter_jit(lambda pose, grid: pose(grid, centres, headings))
    spread = eqx.filter_jit(lambda sensor, grid, model: sensor.field(grid, model).total)

    def evaluate(hall: np.ndarray, model: InverseSensorModel, way: str) -> np.ndarray:
        grid = OccupancyGrid(hall, 0.2)
        if way == "pose":
            return np.asarray(cast(PoseInformation(LIDAR, model), grid)).reshape(16, 20)
        return np.asarray(spread(sensors[way], grid, model))

    return evaluate


WAYS = pytest.mark.parametrize("way", ["pose", "scan", "doubling"])


@WAYS
def test_a_known_hall_tells_nothing_to_who_takes_one_look_for_certain(everywhere, way: str) -> None:
    np.testing.assert_array_equal(everywhere(HALL, DECISIVE, way), 0.0)
    literal = everywhere(HALL, LITERAL, way)
    assert (literal[HALL < 0.5] > 0.01).all()


def test_noise_makes_no_news_of_a_known_hall() -> None:
    """A range that ends in front of a known wall would be, if what is free were in doubt."""
    grid, noise = OccupancyGrid(HALL, 0.2), GaussianNoise(0.2, truncation=3.0)
    places, headings = jnp.asarray([[1.9, 1.3], [0.5, 0.5], [2.9, 2.7]]), jnp.zeros(3)
    cast = eqx.filter_jit(lambda scan: scan(grid, places, headings))
    for model, expects_news in ((DECISIVE, False), (LITERAL, True)):
        found = np.asarray(cast(PoseInformation(LIDAR, model, noise=noise)))
        assert (found > 1.0).all() if expects_news else (found == 0.0).all()


@WAYS
def test_beside_a_known_hall_only_the_unknown_counts(
    everywhere, scan_by_definition, way: str
) -> None:
    """As if what is settled were 0 and 1 in the map."""
    hall, certain = HALL.copy(), np.where(HALL < 0.5, 0.0, 1.0).astype(np.float32)
    hall[10:14, 2:5] = certain[10:14, 2:5] = 0.5
    found = everywhere(hall, DECISIVE, way)
    grid = OccupancyGrid(certain, 0.2)
    for row, column in ((8, 6), (12, 3), (8, 3), (2, 2), (3, 17)):
        place = np.array([column, row]) * 0.2 + 0.1
        expected = scan_by_definition(grid, place, 0.5 * LIDAR.beam_spacing, LIDAR, LITERAL)
        # Doubling takes directions that are nearly those of the beams.
        rtol = 0.15 if way == "doubling" else 2e-4
        assert found[row, column] == pytest.approx(expected, rel=rtol, abs=1e-5)
    assert found[8, 6] > 0.5
    assert found[3, 17] == 0.0
