"""Fusion by situation: the role that suits where the robot is."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import Scalar, Vector
from jaxplore.planning.portfolio.fusion import Candidates, Fused, Fusion, Situation, one_of

ROLES = ("explorer", "balanced", "exploiter", "cautious")
"""What a contextual fusion chooses among."""


class Contextual(Fusion):
    """The plan of the role that the situation asks for, the first of these that holds:

    | situation | role |
    | --- | --- |
    | the goal is nearer than `near_goal` | exploiter |
    | the nearest obstacle is nearer than `near_obstacle` | cautious |
    | a scan from here tells more than `rich_information` | explorer |
    | otherwise | balanced |

    A situation that has begun ends only when its quantity is `hysteresis` beyond the threshold, so
    that a robot on the edge of one does not change its mind at every step.

    Source: the design notes for ground vehicles, "contextual switching".

    Args:
        names: of the members, in their order; each role must be one of them.
        goal: (x, y) [m]; never near it when absent.
        near_goal: [m].
        near_obstacle: from the robot's covering discs to the nearest cell not known to be free [m].
        rich_information: [nat per beam].
        hysteresis: share of each threshold.

    Raises:
        ValueError: a role that is no member's name, a threshold that is not positive, a negative
            hysteresis.
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
        """Return which situations hold: none."""
        return jnp.zeros(3, bool)

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the plan of the role that is asked for."""
        holds = self.situations(memory, situation)
        explorer, balanced, exploiter, cautious = self.members
        roles = jnp.asarray([exploiter, cautious, explorer, balanced])
        first = jnp.argmax(jnp.append(holds, True))
        return one_of(candidates, roles[first]), holds

    def situations(self, held: Bool[Array, "3"], situation: Situation) -> Bool[Array, "3"]:
        """Say whether the robot is near its goal, near an obstacle, and where a scan is rich.

        Args:
            held: which of them held before.
            situation: as it is now.
        """
        state, belief = situation.state, situation.belief
        position, heading = state.position, state.heading
        footprint = state.dynamics.footprint
        distance = jnp.asarray(jnp.inf)
        if self.goal is not None:
            distance = jnp.linalg.norm(position - self.goal)
        ahead = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        centres = position + footprint.offsets[:, None] * ahead
        room = jnp.min(jax.vmap(belief.clearance)(centres)) - footprint.radius
        field = belief.information
        information = field(position, heading) / field.num_beams
        wider, narrower = 1.0 + self.hysteresis, 1.0 / (1.0 + self.hysteresis)
        near_goal = distance < self.near_goal * jnp.where(held[0], wider, 1.0)
        near_obstacle = room < self.near_obstacle * jnp.where(held[1], wider, 1.0)
        is_rich = information > self.rich_information * jnp.where(held[2], narrower, 1.0)
        return jnp.stack([near_goal, near_obstacle, is_rich])

    def check(self, names: tuple[str, ...]) -> None:
        """Raise a `ValueError` if the fusion was made for members of other names."""
        chosen = [names[index] if index < len(names) else None for index in self.members]
        if chosen != list(ROLES):
            raise ValueError(
                f"names is {names}; accepted for this contextual fusion: those it was made for"
            )
