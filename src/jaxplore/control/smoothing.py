"""Smoothing of the controls that are given out."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.signal
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore.control.parameterisations import Sequence


class SavitzkyGolay(eqx.Module):
    """Fits a polynomial to every window of the control sequence and takes its middle value.

    The window reaches back over controls already applied, so that the first planned control is the
    middle of one too and is smooth with what went before. It smooths what is given out; the nominal
    that the next step starts from stays as it was, so that smoothing does not pile up. Static.

    Source: Savitzky and Golay, Analytical Chemistry 1964; nav2's MPPI controller smooths so.

    Args:
        window: number of controls, odd.
        order: of the polynomial.

    Raises:
        ValueError: an even window, an order that is not below it.
    """

    window: int = eqx.field(static=True)
    order: int = eqx.field(static=True)

    def __init__(self, window: int = 9, order: int = 2) -> None:
        self.window = _checks.positive_int("window", window)
        self.order = _checks.whole_number("order", order, at_least=0)
        if self.window % 2 == 0:
            raise ValueError(f"window is {window}; accepted: an odd number of controls")
        if self.order >= self.window:
            raise ValueError(f"order is {order}; accepted: less than the window, {window}")

    @property
    def history(self) -> int:
        """How many applied controls it looks back on."""
        return self.window // 2

    def check(self, horizon: int) -> None:
        """Raise a `ValueError` if the window is longer than the controls that there are."""
        if self.window > horizon + self.history:
            raise ValueError(
                f"window is {self.window}; accepted: at most {2 * horizon - 1} for a horizon of "
                f"{horizon}"
            )

    def smooth(self, past: Float[Array, "H nu"], planned: Sequence) -> Sequence:
        """Return planned controls (T, nu), smoothed together with the past ones, oldest first."""
        length = past.shape[0] + planned.shape[0]
        unit = scipy.signal.savgol_filter(np.eye(length), self.window, self.order, axis=0)
        matrix = jnp.asarray(unit[past.shape[0] :], jnp.float32)
        return matrix @ jnp.concatenate([past, planned])
