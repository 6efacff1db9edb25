import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from jaxplore.control import SavitzkyGolay

HORIZON, SIZE = 12, 2


@eqx.filter_jit
def smooth(part, past, planned):
    return part.smooth(past, planned)


def sequences(part: SavitzkyGolay, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    shapes = ((part.history, SIZE), (HORIZON, SIZE))
    past, planned = (rng.normal(size=shape).astype(np.float32) for shape in shapes)
    return past, planned


def smoothed(part: SavitzkyGolay, past: np.ndarray, planned: np.ndarray) -> np.ndarray:
    return np.asarray(smooth(part, jnp.asarray(past), jnp.asarray(planned)))


@pytest.mark.parametrize(
    ("window", "order"), [(9, 2), (1, 0), (3, 0), (3, 2), (5, 3), (7, 4), (23, 2), (21, 5)]
)
def test_equals_scipy_on_past_and_planned_controls(window: int, order: int) -> None:
    part = SavitzkyGolay(window, order)
    assert part.history == (window - 1) / 2
    part.check(HORIZON)
    past, planned = sequences(part)
    both = np.concatenate([past, planned]).astype(np.float64)
    expected = scipy.signal.savgol_filter(both, window, order, axis=0)[part.history :]
    np.testing.assert_allclose(smoothed(part, past, planned), expected, atol=2e-5)


@pytest.mark.parametrize(("window", "order"), [(5, 1), (9, 2), (7, 3)])
def test_the_first_control_is_the_middle_of_a_window(window: int, order: int) -> None:
    part = SavitzkyGolay(window, order)
    past, planned = sequences(part)
    seen = np.concatenate([past, planned[: part.history + 1]]).astype(np.float64)
    times = np.arange(-part.history, part.history + 1)
    expected = [np.polyval(np.polyfit(times, column, order), 0.0) for column in seen.T]
    np.testing.assert_allclose(smoothed(part, past, planned)[0], expected, atol=1e-5)


@pytest.mark.parametrize(("window", "order"), [(9, 2), (5, 3), (7, 0)])
def test_polynomials_of_its_order_stay_as_they_are(window: int, order: int) -> None:
    part = SavitzkyGolay(window, order)
    times = np.arange(-part.history, HORIZON) / HORIZON
    rng = np.random.default_rng(1)
    both = np.stack([np.polyval(rng.normal(size=order + 1), times) for _ in range(SIZE)], axis=-1)
    past, planned = np.split(both.astype(np.float32), [part.history])
    np.testing.assert_allclose(smoothed(part, past, planned), planned, atol=2e-5)


def test_noise_is_less_afterwards() -> None:
    part = SavitzkyGolay(9, 2)
    past, planned = sequences(part)
    rough, calm = (
        np.abs(np.diff(x, axis=0)).sum() for x in (planned, smoothed(part, past, planned))
    )
    assert calm < 0.5 * rough


def test_the_window_must_fit_the_horizon() -> None:
    SavitzkyGolay(9, 2).check(5)
    with pytest.raises(ValueError, match=r"window is 9; accepted: at most 7 for a horizon of 4"):
        SavitzkyGolay(9, 2).check(4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ((8, 2), r"window is 8; accepted: an odd number of controls"),
        ((5, 5), r"order is 5; accepted: less than the window, 5"),
    ],
)
def test_bad_input_is_named(settings, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SavitzkyGolay(*settings)
