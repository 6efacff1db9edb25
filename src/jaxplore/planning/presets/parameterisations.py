"""Parameterisations by name, as presets and settings give them."""

from jaxplore import _checks
from jaxplore.control.knots import Knots
from jaxplore.control.parameterisations import Direct, Parameterisation
from jaxplore.control.smooth import Smooth

NUM_KNOTS = 8
"""Knots of the parameterisation "knots"; fewer where the horizon has fewer steps."""


def parameterisation_by_name(given: Parameterisation | str, horizon: int) -> Parameterisation:
    """Return the parameterisation with a name, or the given parameterisation unchanged.

    | name | parameterisation |
    | --- | --- |
    | "direct" | `Direct()` |
    | "smooth" | `Smooth()` |
    | "knots" | `Knots(8)`, cubic splines |

    Args:
        given: a parameterisation, or the name of one.
        horizon: model steps ahead, T.

    Raises:
        ValueError: another name, a horizon that is not positive.
    """
    if isinstance(given, Parameterisation):
        return given
    steps = _checks.positive_int("horizon", horizon)
    if given == "direct":
        return Direct()
    if given == "smooth":
        return Smooth()
    if given == "knots":
        return Knots(min(NUM_KNOTS, steps))
    raise ValueError(f"parameterisation is {given!r}; accepted: direct, smooth, knots")
