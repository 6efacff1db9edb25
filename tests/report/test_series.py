import numpy as np
import pytest

from jaxplore.report.drawing.series import running_mean


@pytest.mark.parametrize("width", [1, 2, 3, 4, 7, 40])
@pytest.mark.parametrize("shape", [(1,), (12,), (12, 3)])
def test_running_mean_equals_one_taken_window_by_window(width, shape):
    rng = np.random.default_rng(width)
    rows = rng.normal(size=shape)
    rows[rng.random(shape) < 0.3] = np.nan
    found = running_mean(rows, width)
    for k in range(len(rows)):
        window = rows[max(k - width // 2, 0) : max(k - width // 2 + width, 0)]
        for column in np.ndindex(shape[1:]):
            values = [each for each in window[(slice(None), *column)] if np.isfinite(each)]
            expected = sum(values) / len(values) if values else np.nan
            np.testing.assert_allclose(found[(k, *column)], expected, atol=1e-12)


def test_running_mean_of_nothing_is_nothing():
    assert running_mean(np.zeros((0, 3)), 5).shape == (0, 3)
