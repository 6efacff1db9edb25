"""Smooth the control sequence that is applied."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore.control.parameterisations import Sequence


class SavitzkyGolay(eqx.Module):
    """Savitzky-Golay filter: the middle of a polynomial fitted to a window around each control.

    The window reaches back over applied controls, so that the first planned control has a full
    window and continues the applied ones smoothly. Only the applied controls are smoothed, not the
    nominal of the next step: otherwise smoothing would accumulate over the steps. All sizes are
    static.

    Source: Savitzky and Golay, Analytical Chemistry 1964; used by nav2's MPPI controller.

    Args:
        window: number of controls in a window, odd.
        order: order of the polynomial, below the window.

    Raises:
        ValueError: an even window, an order that is not below the window.
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
        """Number of applied controls that the window reaches back."""
        return self.window // 2

    def check(self, horizon: int) -> None:
        """Raise a `ValueError` if the window is longer than the applied and planned controls."""
        if self.window > horizon + self.history:
            raise ValueError(
                f"window is {self.window}; accepted: at most {2 * horizon - 1} for a horizon of "
                f"{horizon}"
            )

    def smooth(self, past: Float[Array, "H nu"], planned: Sequence) -> Sequence:
        """Return the smoothed planned controls (T, nu).

        Args:
            past: applied controls (H, nu), oldest first.
            planned: planned controls (T, nu).
        """
        import scipy.signal  # slow to import, and few need it

        # The filter is linear: filter the identity at compile time, then multiply by the matrix.
        length = past.shape[0] + planned.shape[0]
        unit = scipy.signal.savgol_filter(np.eye(length), self.window, self.order, axis=0)
        matrix = jnp.asarray(unit[past.shape[0] :], jnp.float32)
        return matrix @ jnp.concatenate([past, planned])
