"""Beams against the definition: all 2^n maps, all readings, the map's own update of every cell."""

import functools
import itertools
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.special import expit, rel_entr

from jaxplore import InverseSensorModel
from jaxplore.information.beam import (
    beam_information,
    cauchy_schwarz_information,
    cell_information,
    contributions,
)
from jaxplore.information.gain import CellGains, CellSensor, IdealSensor, cell_gains
from jaxplore.information.noise import GaussianNoise, RangeNoise, ToeplitzNoise, UniformNoise

pytestmark = pytest.mark.long

Law = Callable[[int, np.ndarray], np.ndarray]
"""From the cell that was hit and the edges to the probability of a reading in each cell."""

SENSORS: dict[str, CellSensor] = {
    "literature": InverseSensorModel.from_odds(),
    "clamped": InverseSensorModel(),
    "clamped odds": InverseSensorModel.from_odds(3.0, 0.25, clamp=(-4.0, 4.0)),
    "ideal": IdealSensor(),
}
UNIT = np.arange(8.0)
UNEQUAL = np.asarray([0.3, 1.5, 1.8, 3.1, 3.2, 4.5, 5.0, 6.4], np.float32)


@functools.partial(jax.jit, static_argnames="no_return")
def total_and_parts(p, sensor, **kwargs):
    return beam_information(p, sensor, **kwargs), cell_information(p, sensor, **kwargs)


def information(p, sensor, **kwargs):
    return total_and_parts(p, sensor, **kwargs)[0]


gradient = jax.jit(jax.grad(beam_information))
quadratic = jax.jit(cauchy_schwarz_information)


def no_noise(hit: int, edges: np.ndarray) -> np.ndarray:
    return np.arange(len(edges) - 1) == hit


def uniform(half_width: int) -> Law:
    def law(hit: int, edges: np.ndarray) -> np.ndarray:
        near = np.abs(np.arange(len(edges) - 1) - hit) <= half_width
        return near / (2 * half_width + 1)

    return law


def normal(std: float, cells: float = math.inf) -> Law:
    """Integrate the normal density over each cell, numerically: 1000 readings in each."""

    def law(hit: int, edges: np.ndarray) -> np.ndarray:
        length = np.diff(edges)
        z = edges[:-1, None] + length[:, None] * (np.arange(1000) + 0.5) / 1000
        away = (z - 0.5 * (edges[hit] + edges[hit + 1])) / std
        share = (np.exp(-0.5 * away**2) / (std * math.sqrt(2 * math.pi))).mean(axis=1) * length
        return np.where(np.abs(np.arange(len(length)) - hit) <= cells, share, 0.0)

    return law


NOISES: dict[str, tuple[RangeNoise | None, np.ndarray | None, Law]] = {
    "none": (None, None, no_noise),
    "uniform 0": (UniformNoise(0), None, uniform(0)),
    "uniform 1": (UniformNoise(1), None, uniform(1)),
    "uniform 2": (UniformNoise(2), None, uniform(2)),
    "gaussian 0.3": (GaussianNoise(0.3), None, normal(0.3)),
    "gaussian 0.8": (GaussianNoise(0.8), None, normal(0.8)),
    "gaussian 0.3, unequal": (GaussianNoise(0.3), UNEQUAL, normal(0.3)),
    "gaussian 0.8, unequal": (GaussianNoise(0.8), UNEQUAL, normal(0.8)),
    "toeplitz": (ToeplitzNoise.gaussian(0.6), None, normal(0.6, cells=2)),
}
NOISE = pytest.mark.parametrize("noise", NOISES)
SENSOR = pytest.mark.parametrize("sensor", SENSORS)


def worth(p: np.ndarray, sensor: CellSensor, reading: int) -> float:
    """Update the map with one reading (n: no return) and add up KL(posterior || prior)."""
    free, occupied = np.arange(len(p)) < reading, np.arange(len(p)) == reading
    if isinstance(sensor, IdealSensor):
        before, after = p, np.where(free, 0.0, np.where(occupied, 1.0, p))
    else:
        with np.errstate(divide="ignore"):
            prior = np.clip(np.log(p) - np.log1p(-p), sensor.minimum, sensor.maximum)
        change = free * float(sensor.free) + occupied * float(sensor.occupied)
        posterior = np.clip(prior + change, sensor.minimum, sensor.maximum)
        before, after = expit(prior), expit(posterior)
    return float((rel_entr(after, before) + rel_entr(1 - after, 1 - before)).sum())


def chances(p: np.ndarray) -> list[tuple[int, float]]:
    """Return of each of the 2^n maps the first occupied cell (n: none) and the probability."""
    return [
        ((*cells, 1).index(1), float(np.prod(np.where(cells, p, 1 - p))))
        for cells in itertools.product((0, 1), repeat=len(p))
    ]


def enumerated(
    p: np.ndarray, sensor: CellSensor, law: Law, edges: np.ndarray, no_return: bool = True
) -> float:
    """Return the expectation over maps and readings of what the reading is worth."""
    n = len(p)
    worths = np.asarray([worth(p, sensor, reading) for reading in range(n + 1)])
    after_hit = [float(law(hit, edges) @ worths[:n]) for hit in range(n)]
    after_hit.append(worths[n] if no_return else 0.0)
    return sum(chance * after_hit[hit] for hit, chance in chances(p))


def as_input(p: np.ndarray | list[float], edges: np.ndarray | None = None) -> tuple:
    """Return p and edges rounded to single precision, for the library and for the oracle."""
    p = np.asarray(p, np.float32)
    given = None if edges is None else jnp.asarray(edges, jnp.float32)
    exact = np.arange(len(p) + 1.0) if edges is None else np.asarray(given, float)
    return jnp.asarray(p), p.astype(float), given, exact


def is_told(noise: str, sensor: str = "clamped") -> bool:
    """Return whether no return is counted: in every second pair, and of every noise and sensor."""
    return (list(NOISES).index(noise) + list(SENSORS).index(sensor)) % 2 == 0


@NOISE
@SENSOR
def test_value_is_the_expectation_over_all_maps_and_readings(noise: str, sensor: str) -> None:
    no_return = is_told(noise, sensor)
    model, edges, law = NOISES[noise]
    for seed in range(2):
        probability = np.random.default_rng(seed).uniform(0.02, 0.98, 7)
        p, exact_p, edges, exact_edges = as_input(probability, edges)
        found = information(p, SENSORS[sensor], noise=model, no_return=no_return, edges=edges)
        expected = enumerated(exact_p, SENSORS[sensor], law, exact_edges, no_return)
        assert float(found) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("noise", ["none", "uniform 1", "gaussian 0.8", "toeplitz"])
@pytest.mark.parametrize("sensor", ["clamped", "clamped odds"])
def test_certain_cells_count_as_cells_at_the_clamp(noise: str, sensor: str) -> None:
    model, _, law = NOISES[noise]
    p, exact_p, _, edges = as_input([0.3, 0.0, 0.5, 1e-5, 0.9999, 0.2, 1.0])
    expected = enumerated(exact_p, SENSORS[sensor], law, edges)
    assert float(information(p, SENSORS[sensor], noise=model)) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("noise", ["none", "uniform 2", "gaussian 0.8", "toeplitz"])
def test_beam_of_one_cell(noise: str) -> None:
    model, _, law = NOISES[noise]
    p, exact_p, _, edges = as_input([0.3])
    expected = enumerated(exact_p, SENSORS["literature"], law, edges)
    assert float(information(p, None, noise=model)) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("noise", ["none", "uniform 2", "gaussian 0.8", "toeplitz"])
def test_cells_out_of_range_only_fill_the_array(noise: str) -> None:
    no_return = noise != "uniform 2"
    model, sensor = NOISES[noise][0], SENSORS["clamped"]
    p = jnp.asarray([0.2, 0.4, 0.05, 0.6, 0.1, 0.0, 0.0])
    in_range = jnp.arange(7) < 5
    gains = CellGains(*(jnp.where(in_range, gain, 0.0) for gain in cell_gains(p, sensor)))
    edges = jnp.arange(8.0)
    found = jax.jit(contributions, static_argnums=(3, 5))(
        p, gains, model, no_return, edges, 1.0, in_range
    )
    expected = total_and_parts(p[:5], sensor, noise=model, no_return=no_return)[1]
    np.testing.assert_allclose(found, jnp.pad(expected, (0, 2)), rtol=1e-5)


@given(arrays(np.float32, 7, elements=st.floats(0.0, 1.0, width=32)))
@settings(max_examples=20)
def test_ideal_noise_free_value_is_shannons_mutual_information(probability: np.ndarray) -> None:
    """The reading is a function of the map, so I(M; Z) = H(Z)."""
    readings = np.zeros(8)
    for hit, chance in chances(probability.astype(float)):
        readings[hit] += chance
    entropy = -sum(q * math.log(q) for q in readings if q > 0)
    found = float(information(jnp.asarray(probability), IdealSensor()))
    assert found == pytest.approx(entropy, rel=1e-5, abs=1e-6)


# --- Cauchy-Schwarz ---------------------------------------------------------------------------


def enumerated_quadratic(p: np.ndarray, std: float, edges: np.ndarray) -> float:
    """Return the definition, by all maps m and a fine grid of readings z."""
    ends = np.append(0.5 * (edges[1:] + edges[:-1]), edges[-1])
    z = np.linspace(ends[0] - 9 * std, ends[-1] + 9 * std, 4001)
    density = np.exp(-0.5 * ((z - ends[:, None]) / std) ** 2)
    joint = np.asarray([chance * density[hit] for hit, chance in chances(p)])
    maps = np.asarray([chance for _, chance in chances(p)])[:, None]
    product = maps * joint.sum(axis=0)
    overlap = (joint * product).sum()
    return math.log((joint**2).sum() * (product**2).sum() / overlap**2)


@pytest.mark.parametrize("std", [0.2, 0.7, 2.0])
@pytest.mark.parametrize("edges", [None, UNEQUAL], ids=["equal", "unequal"])
def test_quadratic_information_is_its_definition(std: float, edges: np.ndarray | None) -> None:
    for seed in range(4):
        probability = np.random.default_rng(seed).uniform(0.0, 1.0, 7)
        p, exact_p, edges, exact_edges = as_input(probability, edges)
        expected = enumerated_quadratic(exact_p, std, exact_edges)
        found = float(quadratic(p, jnp.float32(std), edges=edges))
        assert found == pytest.approx(expected, rel=1e-4, abs=2e-6)


def test_quadratic_information_of_long_and_of_known_beams() -> None:
    std, none, whole = jnp.float32(0.5), jnp.zeros(300), jnp.ones(300)
    unknown = float(quadratic(0.5 * whole, std))
    assert unknown == pytest.approx(float(quadratic(jnp.full(40, 0.5), std)), rel=1e-4)
    assert 0.1 < unknown < 10.0
    for known in (none, whole, none.at[150].set(1.0)):
        assert float(quadratic(known, std)) == pytest.approx(0.0, abs=1e-6)
    rare = float(quadratic(jnp.full(300, 1e-6), std))
    assert rare == pytest.approx(0.0, abs=1e-4)


# --- Properties -------------------------------------------------------------------------------

beams = arrays(
    np.float32,
    7,
    elements=st.sampled_from([0.0, 1.0, 0.5]) | st.floats(0.0, 1.0, width=32),
)


@given(beams)
def test_parts_are_finite_and_not_negative_and_add_up(probability: np.ndarray) -> None:
    p = jnp.asarray(probability)
    for (noise, edges, _), sensor, no_return in itertools.product(
        NOISES.values(), (SENSORS["literature"], SENSORS["ideal"]), (True, False)
    ):
        given = None if edges is None else jnp.asarray(edges)
        total, parts = total_and_parts(p, sensor, noise=noise, no_return=no_return, edges=given)
        assert np.isfinite(parts).all()
        assert float(parts.min()) >= 0.0
        assert float(parts.sum()) == pytest.approx(float(total), rel=1e-5, abs=1e-12)


@given(beams)
def test_quadratic_information_is_finite_and_not_negative(probability: np.ndarray) -> None:
    for std in (0.01, 0.5, 30.0):
        assert 0.0 <= float(quadratic(jnp.asarray(probability), jnp.float32(std))) < math.inf


@given(st.lists(st.booleans(), min_size=50, max_size=50))
def test_a_known_map_is_worth_almost_nothing_through_the_clamp(walls: list[bool]) -> None:
    model = InverseSensorModel()
    known = jax.nn.sigmoid(jnp.where(jnp.asarray(walls), model.maximum, model.minimum))
    unknown = float(information(jnp.full(50, 0.5), model))
    assert float(information(known, model)) < 0.02 * unknown


@given(beams)
def test_an_unknown_cell_at_the_far_end_adds_what_reaches_it(probability: np.ndarray) -> None:
    p, exact_p, _, _ = as_input(probability)
    longer = jnp.append(p, 0.5)
    for sensor in SENSORS.values():
        alone = enumerated(np.asarray([0.5]), sensor, no_noise, np.arange(2.0))
        added = float(information(longer, sensor)) - float(information(p, sensor))
        assert added >= 0.0
        assert added == pytest.approx(np.prod(1 - exact_p) * alone, rel=1e-4, abs=2e-6)


@given(beams, beams, st.integers(0, 6))
def test_nothing_behind_a_wall_counts(first: np.ndarray, second: np.ndarray, wall: int) -> None:
    first[wall] = 1.0
    second[: wall + 1] = first[: wall + 1]
    for sensor, no_return in itertools.product(SENSORS.values(), (True, False)):
        found = [information(jnp.asarray(p), sensor, no_return=no_return) for p in (first, second)]
        assert float(found[0]) == float(found[1])


def test_figures_of_open_space() -> None:
    """Theory 1 and 1.4, with the odds of the literature. It gives 71 % where 70.06 % is found."""
    for n, p, loss in ((8, 0.05, 55), (50, 0.01, 70)):
        line = jnp.full(n, p)
        with_it, without = (float(information(line, None, no_return=b)) for b in (True, False))
        assert round(100 * (1 - without / with_it)) == loss
    assert with_it == pytest.approx(0.0264, abs=5e-5)


# --- Gradients --------------------------------------------------------------------------------


def finite_differences(p: np.ndarray, sensor: CellSensor, law: Law) -> list[float]:
    def value(p: np.ndarray) -> float:
        return enumerated(p, sensor, law, UNIT)

    return [(value(p + step) - value(p - step)) / 2e-5 for step in 1e-5 * np.eye(len(p))]


@SENSOR
@pytest.mark.parametrize("noise", ["uniform 1", "gaussian 0.8"])
def test_gradient_is_that_of_the_expectation(sensor: str, noise: str) -> None:
    model, _, law = NOISES[noise]
    p, exact_p, _, _ = as_input([0.2, 0.45, 0.03, 0.6, 0.1, 0.9, 0.7])
    expected = finite_differences(exact_p, SENSORS[sensor], law)
    found = gradient(p, SENSORS[sensor], noise=model)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("sensor", ["literature", "clamped"])
def test_gradient_at_unknown_cells(sensor: str) -> None:
    model, _, law = NOISES["uniform 1"]
    expected = finite_differences(np.full(7, 0.5), SENSORS[sensor], law)
    found = gradient(jnp.full(7, 0.5), SENSORS[sensor], noise=model)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4)


@given(arrays(np.float32, 7, elements=st.floats(np.float32(1e-6), np.float32(1 - 1e-6), width=32)))
def test_gradients_are_finite(probability: np.ndarray) -> None:
    for sensor, noise in itertools.product(SENSORS.values(), ("none", "gaussian 0.8")):
        found = gradient(jnp.asarray(probability), sensor, noise=NOISES[noise][0])
        assert np.isfinite(found).all()


@pytest.mark.parametrize("sensor", ["literature", "clamped"])
@pytest.mark.parametrize("certain", [0.0, 1.0])
def test_gradients_are_finite_at_certain_cells(sensor: str, certain: float) -> None:
    p = jnp.full(7, 0.3).at[2].set(certain)
    assert np.isfinite(gradient(p, SENSORS[sensor], noise=None)).all()


# --- Bad input --------------------------------------------------------------------------------


@pytest.fixture
def package_checks_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch off the type checks of the test run, which refuse wrong shapes with another error."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


@pytest.mark.usefixtures("package_checks_only")
@pytest.mark.parametrize(
    "function", [beam_information, functools.partial(cauchy_schwarz_information, std=0.5)]
)
@pytest.mark.parametrize(
    ("probability", "edges", "message"),
    [
        ([], None, r"probability has shape \(0,\); accepted"),
        ([[0.5]], None, r"probability has shape \(1, 1\); accepted"),
        ([0.5, 1.5], None, "probability spans 0.5 to 1.5; accepted"),
        ([-0.25, 0.5], None, "probability spans -0.25 to 0.5; accepted"),
        ([0.5, math.nan], None, "probability spans nan to nan; accepted"),
        ([0.5, 0.5], [0.0, 1.0], r"edges has shape \(2,\); accepted: \(3,\)"),
        ([0.5, 0.5], [0.0, 2.0, 1.0], r"edges is \[0. 2. 1.\]; accepted: increasing"),
        ([0.5, 0.5], [0.0, 1.0, 1.0], r"edges is \[0. 1. 1.\]; accepted: increasing"),
        ([0.5, 0.5], [0.0, math.nan, 1.0], r"edges is \[ 0. nan  1.\]; accepted: increasing"),
    ],
)
def test_bad_beams(function: Callable, probability: list, edges: list | None, message: str) -> None:
    edges = None if edges is None else jnp.asarray(edges, jnp.float32)
    with pytest.raises(ValueError, match=message):
        function(jnp.asarray(probability, jnp.float32), edges=edges)


@pytest.mark.parametrize("std", [0.0, -1.0, math.nan, math.inf])
def test_bad_deviation_of_the_quadratic_information(std: float) -> None:
    with pytest.raises(ValueError, match=f"std is {std}; accepted: a finite number > 0.0"):
        cauchy_schwarz_information(jnp.full(2, 0.5), std)
