"""Contextual fusion: select a member by the situation of the robot."""

import abc
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Flag, Scalar, Vector
from jaxplore.planning.portfolio.fusion import Candidates, Fused, Fusion, Situation, select_member

ROLES = ("explorer", "balanced", "exploiter", "cautious")
"""Roles of the members that a contextual fusion selects from."""


class ContextRule(eqx.Module):
    """A rule of one's own for `Contextual`; abstract."""

    @abc.abstractmethod
    def __call__(self, situation: Situation, held: Flag) -> Flag:
        """Return whether the rule holds now.

        `held` says whether it did in the last step, for a hysteresis.
        """


class Contextual(Fusion):
    """Selects the plan of one member by rules on the situation. The first rule that holds counts:

    | situation | member |
    | --- | --- |
    | the goal is nearer than `near_goal` | exploiter |
    | the nearest obstacle is nearer than `near_obstacle` | cautious |
    | a scan from here has more information than `rich_information` | explorer |
    | otherwise | balanced |

    Rules of one's own come before these. `roles` says which member plays each role; the rule of a
    role that nobody plays is left out.

    A rule that holds stops holding only when its quantity is `hysteresis` beyond the threshold.
    This keeps a robot near a threshold from switching at every step.

    Source: the design notes for ground vehicles, "contextual switching".

    Args:
        names: names of all members in their order.
        roles: member by role, of which "balanced" must be given; when absent each role is played by
            the member of its name.
        rules: rules of one's own by the name of the member that they select, in the order in which
            they are asked.
        goal: goal position (x, y) [m]; without one the first rule never holds.
        near_goal: distance to the goal below which it is near [m].
        near_obstacle: distance from the discs that cover the robot to the nearest cell not known to
            be free, below which an obstacle is near [m].
        rich_information: information of a scan above which the place is rich [nat per beam].
        hysteresis: width of the hysteresis, as a share of each threshold.

    Raises:
        ValueError: a role or a rule of a member that is not among the names, a threshold that is
            not positive, a negative hysteresis.
    """

    goal: Float[Array, "2"] | None
    near_goal: Scalar
    near_obstacle: Scalar
    rich_information: Scalar
    hysteresis: Scalar
    rules: tuple[ContextRule, ...]
    members: tuple[int | None, ...] = eqx.field(static=True)
    rule_members: tuple[int, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        names: tuple[str, ...] = ROLES,
        *,
        roles: Mapping[str, str] | None = None,
        rules: Mapping[str, ContextRule] | None = None,
        goal: Vector | None = None,
        near_goal: ArrayLike = 2.0,
        near_obstacle: ArrayLike = 0.3,
        rich_information: ArrayLike = 0.2,
        hysteresis: ArrayLike = 0.2,
    ) -> None:
        if not isinstance(names, (list, tuple)):
            given = _kinds.describe(names)
            raise ValueError(f"names is {given}; accepted: the names of the members")
        self.names = tuple(names)
        self.members = _members(self.names, roles)
        self.rules, self.rule_members = _rules(self.names, rules)
        self.goal = None if goal is None else _checks.vector("goal", goal, 2)
        self.near_goal = _checks.scalar("near_goal", near_goal, above=0.0)
        self.near_obstacle = _checks.scalar("near_obstacle", near_obstacle, above=0.0)
        self.rich_information = _checks.scalar("rich_information", rich_information, above=0.0)
        self.hysteresis = _checks.scalar("hysteresis", hysteresis, at_least=0.0)

    def init(self) -> Bool[Array, " R"]:
        """Return the initial memory: no rule holds."""
        return jnp.zeros(len(self.rules) + len(self._active), bool)

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Select the plan of the member whose rule holds first."""
        holds = self.situations(memory, situation)
        played = [self._of_rules[rule] for rule in self._active]
        chosen = jnp.asarray([*self.rule_members, *played, self.members[ROLES.index("balanced")]])
        # The appended true selects `balanced` where no rule holds.
        first = jnp.argmax(jnp.append(holds, True))
        return select_member(candidates, chosen[first]), holds

    @property
    def _of_rules(self) -> tuple[int | None, ...]:
        """Member of each of the three rules of the library: near goal, near obstacle, rich."""
        explorer, _, exploiter, cautious = self.members
        return exploiter, cautious, explorer

    @property
    def _active(self) -> tuple[int, ...]:
        """Rules of the library whose role somebody plays."""
        return tuple(rule for rule, member in enumerate(self._of_rules) if member is not None)

    def situations(self, held: Bool[Array, " R"], situation: Situation) -> Bool[Array, " R"]:
        """Evaluate the rules: one's own, near the goal, near an obstacle, rich in information.

        Args:
            held: (R,) which rules held in the last step.
            situation: current state and belief of the robot.
        """
        own = [rule(situation, held[number]) for number, rule in enumerate(self.rules)]
        known = (self._near_goal, self._near_obstacle, self._is_rich)
        rest = [
            known[rule](situation, held[len(own) + number])
            for number, rule in enumerate(self._active)
        ]
        return jnp.stack([*own, *rest]) if own or rest else jnp.zeros(0, bool)

    def _near_goal(self, situation: Situation, held: Flag) -> Flag:
        if self.goal is None:
            return jnp.asarray(False)
        distance = jnp.linalg.norm(situation.state.position - self.goal)
        is_near: Flag = distance < self.near_goal * jnp.where(held, 1.0 + self.hysteresis, 1.0)
        return is_near

    def _near_obstacle(self, situation: Situation, held: Flag) -> Flag:
        state, belief = situation.state, situation.belief
        position, heading = state.position, state.heading
        footprint = state.dynamics.footprint
        ahead = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        # The discs of the footprint lie along the heading.
        centres = position + footprint.offsets[:, None] * ahead
        room = jnp.min(jax.vmap(belief.clearance)(centres)) - footprint.radius
        # A rule that holds gets a threshold that is easier to meet.
        is_near: Flag = room < self.near_obstacle * jnp.where(held, 1.0 + self.hysteresis, 1.0)
        return is_near

    def _is_rich(self, situation: Situation, held: Flag) -> Flag:
        field, state = situation.belief.information, situation.state
        # Per beam, so that the threshold holds for sensors with any number of beams.
        information = field(state.position, state.heading) / field.num_beams
        least = self.rich_information * jnp.where(held, 1.0 / (1.0 + self.hysteresis), 1.0)
        is_rich: Flag = information > least
        return is_rich

    def check(self, names: tuple[str, ...]) -> None:
        """Raise a `ValueError` if the fusion was made for other member names."""
        used = [index for index in (*self.members, *self.rule_members) if index is not None]
        if any(index >= len(names) or names[index] != self.names[index] for index in used):
            raise ValueError(
                f"names is {names}; accepted for this contextual fusion: those it was made for"
            )


def _members(names: tuple[str, ...], roles: Mapping[str, str] | None) -> tuple[int | None, ...]:
    """Return the index of the member of each of `ROLES`; None for one that nobody plays."""
    if roles is None:
        for role in ROLES:
            if role not in names:
                raise ValueError(
                    f"names is {names}, without {role!r}; accepted: names that include "
                    f"{', '.join(ROLES)}, or roles, which say who plays them"
                )
        return tuple(names.index(role) for role in ROLES)
    if not isinstance(roles, Mapping) or "balanced" not in roles:
        raise ValueError(
            f"roles is {_kinds.describe(roles)}; accepted: members by role, with 'balanced' for "
            "where no rule holds"
        )
    for role, name in roles.items():
        if role not in ROLES:
            raise ValueError(f"roles has {role!r}; accepted: {', '.join(ROLES)}")
        if name not in names:
            raise ValueError(f"roles[{role!r}] is {name!r}; accepted: {', '.join(names)}")
    return tuple(names.index(roles[role]) if role in roles else None for role in ROLES)


def _rules(
    names: tuple[str, ...], rules: Mapping[str, ContextRule] | None
) -> tuple[tuple[ContextRule, ...], tuple[int, ...]]:
    """Return rules of one's own and the index of the member of each."""
    given = {} if rules is None else rules
    if not isinstance(given, Mapping):
        raise ValueError(f"rules is {_kinds.describe(rules)}; accepted: rules by member")
    for name, rule in given.items():
        if name not in names:
            raise ValueError(f"rules has {name!r}; accepted: {', '.join(names)}")
        _kinds.instance(f"rules[{name!r}]", rule, ContextRule)
    return tuple(given.values()), tuple(names.index(name) for name in given)
