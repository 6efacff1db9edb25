"""Merge the maps of several robots in log-odds, without counting a measurement twice.

Each robot keeps, for each robot of its fleet, the newest sum of log-odds changes by that robot's
own scans that it has heard of: a contribution. A contribution replaces an older one of the same
robot, so it does not matter how often, over which robots or in which order it arrives: the
contributions are a state-based replicated data type (Shapiro et al., "Conflict-free replicated data
types", SSS 2011). The map is a function of them alone:

    l = clip(l_prior + sum_k c_k, minimum, maximum)

The sum itself is not clamped. What a robot has seen often, and another one as well, takes more
contrary scans to change than on the map of one robot.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import GridMask, GridValues
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

SAME = 5e-6
"""Difference of two probabilities that is no more than the rounding of sums of log-odds."""


def log_odds_change(model: InverseSensorModel, before: GridValues, now: GridValues) -> GridValues:
    """Return the change of the log-odds between two maps of one robot, given as probabilities.

    `before` is the map after the last merge, `now` that after scans of its own since then. The
    change is exactly 0 in cells that have not changed.
    """
    return jnp.where(now == before, 0.0, model.log_odds(now) - model.log_odds(before))


def merge_maps(
    model: InverseSensorModel,
    prior: GridValues,
    contributions: Float[Array, "K H W"],
    now: GridValues,
    is_new: GridMask,
) -> GridValues:
    """Return the map of the prior and of all contributions, from probabilities `prior` and `now`,
    the map before. Contributions are sums of log-odds changes, and the clamp of the sensor model
    applies to their total. Cells that are not `is_new`, and those that change by less than `SAME`,
    keep their probability to the bit: what is derived from them stays as it is."""
    total = model.log_odds(prior) + jnp.sum(contributions, axis=0)
    merged = jax.nn.sigmoid(jnp.clip(total, model.minimum, model.maximum))
    return jnp.where(is_new & (jnp.abs(merged - now) > SAME), merged, now)
