"""Controllers that choose a target by a rule and go there; what they share in all spaces."""

import abc
import dataclasses
import functools
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore import _kinds
from jaxplore._types import (
    ArrayLike,
    ControlVector,
    Count,
    Flag,
    Key,
    Position,
    Scalar,
    StateVector,
)
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField
from jaxplore.control.base import Controller, Info, ModelBasedController, SampledPlan
from jaxplore.control.model_checks import check_call
from jaxplore.maps.volume_field import VolumeField
from jaxplore.planning.strategy.frontiers import Frontiers
from jaxplore.planning.strategy.target_rules import TargetRule, ask

LEAST = 0.2
"""Distance by which the robot must come nearer for it to count [m]."""
PATIENCE = 75
"""Choices without coming nearer after which a target is given up: 15 s of choices at 5 Hz."""
MEMORY = 600
"""Choices for which a target that was given up is avoided: two minutes."""
RADIUS, MOST_DOUBLINGS = 1.0, 4
"""Distance around such a target within which all places are avoided [m], and how often it doubles
with one target after another given up."""


class TargetProgress(NamedTuple):
    """How near a robot has come to its target, and where it could not get.

    A passage that the robot fits in on the map may be one that it cannot take, because of noise or
    of something that the map does not show. A target to which it comes no nearer is then avoided
    for two minutes, with all places within 1 m. If it comes no nearer to the next one either, the
    distance doubles, up to 16 m: what lies beyond one passage is avoided together.

    Args:
        best: least distance from the target so far [m].
        waiting: number of choices since.
        stalls: number of targets that were given up one after another.
        avoided: number of choices for which each place is still avoided.
    """

    best: Scalar
    waiting: Count
    stalls: Count
    avoided: Int[Array, "*nodes"]

    @classmethod
    def begin(cls, shape: tuple[int, ...]) -> "TargetProgress":
        """Return the progress before the first choice, on a lattice of places of this shape."""
        nothing = jnp.zeros((), jnp.int32)
        return cls(jnp.asarray(jnp.inf), nothing, nothing, jnp.zeros(shape, jnp.int32))

    @property
    def may_be(self) -> Bool[Array, "*nodes"]:
        """Mask of the places that are not avoided."""
        return self.avoided == 0

    def update(
        self,
        distance: Float[Array, "*nodes"],
        node: Int[Array, " n"],
        is_on_the_way: Flag,
        spacing: float,
    ) -> "TargetProgress":
        """Return the progress at the time of a choice.

        `distance` is the length of the path to each place [m], and `spacing` the distance between
        places [m]. `is_on_the_way` is whether there is a target, `node`, that the robot has not
        reached yet.
        """
        here = distance[tuple(node)]
        is_nearer = here < self.best - LEAST
        waiting = jnp.where(is_on_the_way & ~is_nearer, self.waiting + 1, 0)
        gives_up = waiting >= PATIENCE
        radius = RADIUS * 2.0 ** jnp.minimum(self.stalls, MOST_DOUBLINGS).astype(jnp.float32)
        index = jnp.stack(jnp.meshgrid(*map(jnp.arange, distance.shape), indexing="ij"))
        gap = (index - node.reshape(-1, *[1] * distance.ndim)).astype(jnp.float32) * spacing
        is_near = jnp.sum(gap * gap, axis=0) <= radius * radius
        left = jnp.maximum(self.avoided - 1, 0)
        stalls = jnp.where(gives_up, self.stalls + 1, jnp.where(is_nearer, 0, self.stalls))
        return TargetProgress(
            jnp.where(is_nearer, here, self.best),
            jnp.where(gives_up, 0, waiting),
            stalls,
            jnp.where(gives_up & is_near, MEMORY, left),
        )

    def towards(self, distance: Scalar, is_new: Flag) -> "TargetProgress":
        """Return the progress after a choice of a target; the path to it is `distance` [m] long.

        `is_new` is whether it is another target than before.
        """
        return self._replace(
            best=jnp.where(is_new, distance, self.best),
            waiting=jnp.where(is_new, 0, self.waiting),
        )


class TargetState(NamedTuple):
    """State of a `TargetController`.

    `tracker` is the state of the controller that drives. `node` is the index of the target on the
    guidance lattice: (row, column), or (k, j, i) in a volume. `guidance` is the cost to go to it
    [m]. `since` is the number of commands so far.
    """

    tracker: Any
    node: Int[Array, " n"]
    has_target: Flag
    guidance: GuidanceField | VolumeField
    since: Count
    progress: TargetProgress


class TargetController(Controller):
    """Chooses a target by a rule, goes there, and chooses the next one.

    A target is kept until the robot is near it, no path leads to it, or it is no longer among the
    candidates of the rule, for instance because it was seen from afar. A rule with `hysteresis`
    replaces it earlier by a candidate that is better by as much. Without candidates, the
    nearest place with a little information left is the target. Without such a place the robot
    waits. Information that cannot be seen from a place after all is discounted while the robot is
    near it and recovers later (`Belief.dwell`), so no place is given up for ever. A target to which
    the robot comes no nearer is avoided for a while (`TargetProgress`).

    The tracker descends the cost to go to the target, which replaces the guidance in its belief.
    Motion, obstacles and limits are those of the tracker, the same for all rules.

    A target counts as reached at a path length of `near` [m]. `every` is the number of commands
    between choices. With `stays` the robot stays at a target until its information is seen or
    discounted.
    """

    belief_type: ClassVar[type]

    tracker: eqx.AbstractVar[ModelBasedController]
    rule: eqx.AbstractVar[TargetRule]
    near: eqx.AbstractVar[Scalar]
    every: eqx.AbstractVar[Count]
    stays: eqx.AbstractVar[bool]

    @abc.abstractmethod
    def find(self, belief: Any, observation: StateVector) -> Frontiers:
        """Return the places where the robot could go."""

    @abc.abstractmethod
    def guidance(
        self,
        frontiers: Frontiers,
        source: Float[Array, "*nodes"],
        state: TargetState,
        observation: StateVector,
    ) -> GuidanceField | VolumeField:
        """Return the cost to go to a source as a field, in the form of that of the state."""

    @abc.abstractmethod
    def target(self, state: TargetState) -> Position:
        """Return the position (x, y) of the target of a state [m]."""

    @abc.abstractmethod
    def spacing(self, state: TargetState) -> float:
        """Return the distance between the nodes of the lattice [m]."""

    def at_period(self, control_period: ArrayLike) -> "TargetController":
        """Return a copy of this controller that is called every `control_period` seconds."""
        tracker = self.tracker.at_period(control_period)
        same: TargetController = eqx.tree_at(lambda explorer: explorer.tracker, self, tracker)
        return same

    def step(
        self, state: TargetState, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, TargetState, Info]:
        """Choose a target if a choice is due, and plan towards it; see `Controller.step`."""
        model = self.tracker.dynamics
        observation = check_call(model, state, TargetState, observation, key)
        state, known, control_key = self._prepare(state, observation, belief, key)
        control, tracker, info = self.tracker.step(
            state.tracker, observation, known, key=control_key
        )
        return control, state._replace(tracker=tracker), info

    def inspect(
        self,
        state: TargetState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories of the tracker, with the target as the reference."""
        model = self.tracker.dynamics
        observation = check_call(model, state, TargetState, observation, key)
        state, known, control_key = self._prepare(state, observation, belief, key)
        plan = self.tracker.inspect(
            state.tracker, observation, known, key=control_key, num_trajectories=num_trajectories
        )
        here = self.tracker.dynamics.position(observation)
        target = jnp.where(state.has_target, self.target(state), here)
        return plan._replace(reference=jnp.stack([target, target]))

    def _prepare(
        self, state: TargetState, observation: StateVector, belief: Any, key: Key
    ) -> tuple[TargetState, Any, Key]:
        """Return the state with its target, the belief that leads there, and the tracker's key."""
        _kinds.instance("belief", belief, self.belief_type)
        choice_key, control_key = jax.random.split(key)
        state = self._choose_if_due(state, observation, belief, choice_key)
        guidance = state.guidance
        if isinstance(belief, Belief) and belief.goal is not None and belief.to_goal is None:
            # Where only the goal is left, the way there counts, not a target of the rule.
            guidance = jax.tree.map(
                functools.partial(jnp.where, belief.is_explored), belief.guidance, guidance
            )
        return state, dataclasses.replace(belief, guidance=guidance), control_key

    def _choose_if_due(
        self, state: TargetState, observation: StateVector, belief: Any, key: Key
    ) -> TargetState:
        """Return the state after a choice, if one is due."""
        is_due = state.since % self.every == 0

        def choose(state: TargetState) -> TargetState:
            return self._choose(state, self.find(belief, observation), observation, key)

        state = jax.lax.cond(is_due, choose, lambda same: same, state)
        return state._replace(since=state.since + 1)

    def _choose(
        self, state: TargetState, frontiers: Frontiers, observation: StateVector, key: Key
    ) -> TargetState:
        """Keep the target or choose a new one, and compute the cost to go to it."""
        on_the_way = state.has_target & (frontiers.distance[tuple(state.node)] > self.near)
        progress = state.progress.update(
            frontiers.distance, state.node, on_the_way, self.spacing(state)
        )
        candidates = ask(self.rule, "candidates", frontiers) & progress.may_be
        leftovers = frontiers.is_leftover & progress.may_be
        # A target that is reached is dropped. A robot that stays keeps it while there is
        # information.
        away = frontiers.distance > self.near
        if self.stays:
            away |= frontiers.is_view
        node = tuple(state.node)
        keeps = state.has_target & (candidates & away)[node]
        shape, lead = candidates.shape, self.rule.hysteresis()

        # Choosing may cost a search per frontier, so a rule without hysteresis is skipped while the
        # target is kept.
        def pick(_: None) -> tuple[Array, Flag]:
            may_be = candidates & away
            scores = ask(self.rule, "scores", frontiers, key=key)
            if lead is not None:
                scores = scores.at[node].add(jnp.where(keeps, lead, 0.0))
            scores = jnp.where(may_be, scores, -jnp.inf)
            leftover = jnp.where(leftovers & away, -frontiers.distance, -jnp.inf)
            best = jnp.where(may_be.any(), jnp.argmax(scores), jnp.argmax(leftover))
            is_any = may_be.any() | jnp.isfinite(leftover).any()
            return jnp.stack(jnp.unravel_index(best, shape)).astype(jnp.int32), is_any

        if lead is None:
            chosen, has_target = jax.lax.cond(keeps, lambda _: (state.node, keeps), pick, None)
        else:
            chosen, has_target = pick(None)
        # Without a target the cost to go is 0 everywhere, so that nothing attracts the robot.
        source = jnp.where(has_target, jnp.inf, 0.0) * jnp.ones(shape)
        source = source.at[tuple(chosen)].set(0.0)
        guidance = self.guidance(frontiers, source, state, observation)
        is_new = ~state.has_target | jnp.any(chosen != state.node)
        progress = progress.towards(frontiers.distance[tuple(chosen)], is_new)
        return state._replace(
            node=chosen, has_target=has_target, guidance=guidance, progress=progress
        )
