"""Fusion of plain actions, without plans and without a portfolio."""

from typing import Any

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._checks import array
from jaxplore._types import ArrayLike, ControlVector, Rows, Vector
from jaxplore.planning.portfolio.contextual import Contextual
from jaxplore.planning.portfolio.fusion import Candidates, Fusion, Situation
from jaxplore.planning.portfolio.information_density import InformationDensity
from jaxplore.planning.portfolio.safe_fusion import SafeFusion, fusion_by_name
from jaxplore.planning.portfolio.voting import TrustWeighted, WeightedVote


@_kinds.check_arguments
def fuse_actions(
    actions: Rows,
    costs: Vector,
    fusion: Fusion | str = "weighted-vote",
    *,
    temperature: ArrayLike | None = None,
    uncertainties: Vector | None = None,
    situation: Situation | None = None,
) -> ControlVector:
    """Fuse the actions of N controllers into one, by the fusions of a portfolio.

    The actions count as plans of one step. A fusion with a memory begins anew in each call; in a
    loop, call the fusion itself.

    Args:
        actions: (N, nu) actions of the controllers.
        costs: (N,) costs of the actions; not finite for one that must not count.
        fusion: fusion, or its name in `FUSIONS`.
        temperature: temperature of `WeightedVote`, given by name; its default when absent.
        uncertainties: (N,) uncertainties of the actions, which `TrustWeighted` needs.
        situation: state and belief of the robot, which fusions that evaluate or select by the
            situation need: "contextual", "safe" and "information-density".

    Returns:
        The fused action (nu,).

    Raises:
        ValueError: actions, costs or uncertainties of the wrong shape; an unknown name; a
            temperature beside another fusion; something missing that the fusion needs.
    """
    given = array("actions", actions, ("N", "nu"))
    number = given.shape[0]
    # Not `array`: a cost that is not finite keeps its action out.
    paid = jnp.asarray(_checks.of_shape("costs", costs, (number,)), jnp.float32)
    rule = fusion_by_name(fusion) if isinstance(fusion, str) else fusion
    if temperature is not None:
        if not isinstance(fusion, str) or not isinstance(rule, WeightedVote):
            raise ValueError(
                f"temperature is {temperature} beside the fusion {type(rule).__name__}; accepted: "
                "with the name 'weighted-vote'"
            )
        rule = WeightedVote(temperature)
    if isinstance(rule, TrustWeighted) and uncertainties is None:
        raise ValueError(f"uncertainties is None; accepted: {number} numbers, for trust-weighted")
    spread = jnp.zeros(number)
    if uncertainties is not None:
        spread = jnp.asarray(
            _checks.of_shape("uncertainties", uncertainties, (number,)), jnp.float32
        )
    if situation is None:
        if isinstance(rule, (SafeFusion, Contextual, InformationDensity)):
            raise ValueError(f"situation is None; accepted: a Situation, for {type(rule).__name__}")
        absent: Any = None
        situation = Situation(absent, absent, absent)
    candidates = Candidates(given[:, None], paid, jnp.zeros(number), spread)
    fused, _ = rule(rule.init(), candidates, situation)
    return fused.controls[0]
