"""Contextual fusion: select a member by the situation of the robot."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Scalar, Vector
from jaxplore.planning.portfolio.fusion import Candidates, Fused, Fusion, Situation, select_member

ROLES = ("explorer", "balanced", "exploiter", "cautious")
"""Names of the members that a contextual fusion selects from."""


class Contextual(Fusion):
    """Selects the plan of one member by rules on the situation. The first rule that holds counts:

    | situation | member |
    | --- | --- |
    | the goal is nearer than `near_goal` | exploiter |
    | the nearest obstacle is nearer than `near_obstacle` | cautious |
    | a scan from here has more information than `rich_information` | explorer |
    | otherwise | balanced |

    A rule that holds stops holding only when its quantity is `hysteresis` beyond the threshold.
    This keeps a robot near a threshold from switching at every step.

    Source: the design notes for ground vehicles, "contextual switching".

    Args:
        names: names of all members in their order; each of `ROLES` must be among them.
        goal: goal position (x, y) [m]; without one the first rule never holds.
        near_goal: distance to the goal below which it is near [m].
        near_obstacle: distance from the discs that cover the robot to the nearest cell not known to
            be free, below which an obstacle is near [m].
        rich_information: information of a scan above which the place is rich [nat per beam].
        hysteresis: width of the hysteresis, as a share of each threshold.

    Raises:
        ValueError: a role that is not among the names, a threshold that is not positive, a
            negative hysteresis.
    """

    goal: Float[Array, "2"] | None
    near_goal: Scalar
    near_obstacle: Scalar
    rich_information: Scalar
    hysteresis: Scalar
    members: tuple[int, ...] = eqx.field(static=True)

    def __init__(
        self,
        names: tuple[str, ...] = ROLES,
        *,
        goal: Vector | None = None,
        near_goal: ArrayLike = 2.0,
        near_obstacle: ArrayLike = 0.3,
        rich_information: ArrayLike = 0.2,
        hysteresis: ArrayLike = 0.2,
    ) -> None:
        if not isinstance(names, (list, tuple)):
            given = _kinds.described(names)
            raise ValueError(f"names is {given}; accepted: the names of the members")
        for role in ROLES:
            if role not in names:
                raise ValueError(
                    f"names is {tuple(names)}, without {role!r}; accepted: names that include "
                    f"{', '.join(ROLES)}"
                )
        self.members = tuple(names.index(role) for role in ROLES)
        self.goal = None if goal is None else _checks.vector("goal", goal, 2)
        self.near_goal = _checks.scalar("near_goal", near_goal, above=0.0)
        self.near_obstacle = _checks.scalar("near_obstacle", near_obstacle, above=0.0)
        self.rich_information = _checks.scalar("rich_information", rich_information, above=0.0)
        self.hysteresis = _checks.scalar("hysteresis", hysteresis, at_least=0.0)

    def init(self) -> Bool[Array, "3"]:
        """Return the initial memory: no rule holds."""
        return jnp.zeros(3, bool)

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Select the plan of the member whose rule holds first."""
        holds = self.situations(memory, situation)
        explorer, balanced, exploiter, cautious = self.members
        roles = jnp.asarray([exploiter, cautious, explorer, balanced])
        # The appended true selects `balanced` where no rule holds.
        first = jnp.argmax(jnp.append(holds, True))
        return select_member(candidates, roles[first]), holds

    def situations(self, held: Bool[Array, "3"], situation: Situation) -> Bool[Array, "3"]:
        """Evaluate the three rules: near the goal, near an obstacle, rich in information.

        Args:
            held: (3,) which rules held in the last step.
            situation: current state and belief of the robot.
        """
        state, belief = situation.state, situation.belief
        position, heading = state.position, state.heading
        footprint = state.dynamics.footprint
        distance = jnp.asarray(jnp.inf)
        if self.goal is not None:
            distance = jnp.linalg.norm(position - self.goal)
        ahead = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        # The discs of the footprint lie along the heading.
        centres = position + footprint.offsets[:, None] * ahead
        room = jnp.min(jax.vmap(belief.clearance)(centres)) - footprint.radius
        field = belief.information
        # Per beam, so that the threshold holds for sensors with any number of beams.
        information = field(position, heading) / field.num_beams
        # A rule that holds gets a threshold that is easier to meet.
        wider, narrower = 1.0 + self.hysteresis, 1.0 / (1.0 + self.hysteresis)
        near_goal = distance < self.near_goal * jnp.where(held[0], wider, 1.0)
        near_obstacle = room < self.near_obstacle * jnp.where(held[1], wider, 1.0)
        is_rich = information > self.rich_information * jnp.where(held[2], narrower, 1.0)
        return jnp.stack([near_goal, near_obstacle, is_rich])

    def check(self, names: tuple[str, ...]) -> None:
        """Raise a `ValueError` if the fusion was made for other member names."""
        chosen = [names[index] if index < len(names) else None for index in self.members]
        if chosen != list(ROLES):
            raise ValueError(
                f"names is {names}; accepted for this contextual fusion: those it was made for"
            )
