"""Explorers that go from target to target, by a rule."""

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Int

from jaxplore import _checks
from jaxplore._types import ControlVector, Count, Flag, Key, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField, descent_field, geodesic
from jaxplore.belief.perception import LAYERS, LEFTOVER_SHARE
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.mppi import MPPI
from jaxplore.maps.frame import GridFrame
from jaxplore.planning.strategy.frontiers import Frontiers, prospects
from jaxplore.planning.strategy.target_rules import TargetRule


class TargetState(NamedTuple):
    """What a `TargetExplorer` remembers.

    Args:
        tracker: state of the controller that drives.
        node: (row, column) of the target on the guidance's lattice.
        has_target: whether there is one.
        guidance: cost to go to it [m].
        since: commands since the first choice.
    """

    tracker: Any
    node: Int[Array, "2"]
    has_target: Flag
    guidance: GuidanceField
    since: Count


class TargetExplorer(Controller):
    """Chooses a place by a rule, drives there, and chooses again.

    A target is kept until the robot is near it, it is no longer among the rule's candidates,
    because it was seen from afar, or no way leads there. Where no candidate is left, the nearest
    place with a little information is the target; where there is none either, the robot waits.
    What cannot be seen after all fades while the robot is near it, and comes back later
    (`Belief.dwell`), so that nothing is given up for ever.

    The tracker drives down a cost to go to the target, which stands in the belief in place of the
    guidance: whatever the rule, motion, obstacles and limits are those of the tracker.

    Args:
        tracker: MPPI that reads `belief.guidance`.
        rule: how to choose.
        frame: of the map.
        shape: rows and columns of the map; static.
        stride: cells between the nodes of the belief's fields; static.
        required_clearance: that a way needs [m]; how near to unknown space a frontier is follows
            from it.
        min_information: below which a place is not worth a look [nat].
        leftover_share: of that, below which it is worth nothing.
        min_frontier: length of a frontier at least [m].
        near: way to a target that counts as there [m].
        every: commands between choices.
        stays: whether a robot that is there stays until it has seen what there is, or it has faded;
            for one that does not see all around, whose tracker turns it to what there is; static.

    Raises:
        ValueError: a number out of its range.
    """

    tracker: MPPI
    rule: TargetRule
    frame: GridFrame
    required_clearance: Scalar
    min_information: Scalar
    leftover_share: Scalar
    min_frontier: Scalar
    near: Scalar
    every: Count
    shape: tuple[int, int] = eqx.field(static=True)
    stride: int = eqx.field(static=True)
    nodes_to_unknown: int = eqx.field(static=True)
    stays: bool = eqx.field(static=True)

    def __init__(
        self,
        tracker: MPPI,
        rule: TargetRule,
        frame: GridFrame,
        shape: tuple[int, int],
        stride: int,
        *,
        required_clearance: ArrayLike,
        min_information: ArrayLike,
        leftover_share: ArrayLike = LEFTOVER_SHARE,
        min_frontier: ArrayLike = 0.75,
        near: ArrayLike = 0.4,
        every: int,
        stays: bool = False,
    ) -> None:
        self.tracker, self.rule, self.frame = tracker, rule, frame
        rows, columns = (_checks.positive_int("shape", side) for side in shape)
        self.shape = (rows, columns)
        self.stride = _checks.positive_int("stride", stride)
        self.required_clearance = _checks.scalar(
            "required_clearance", required_clearance, above=0.0
        )
        spacing = frame.resolution * self.stride
        self.nodes_to_unknown = 1 + math.ceil(float(self.required_clearance) / spacing)
        self.min_information = _checks.scalar("min_information", min_information, above=0.0)
        self.leftover_share = _checks.scalar(
            "leftover_share", leftover_share, at_least=0.0, at_most=1.0
        )
        self.min_frontier = _checks.scalar("min_frontier", min_frontier, at_least=0.0)
        self.near = _checks.scalar("near", near, above=0.0)
        self.stays = stays
        self.every = jnp.asarray(_checks.positive_int("every", every), jnp.int32)

    def init(self) -> TargetState:
        """Return the state before the first step, without a target."""
        rows, columns = (-(-side // self.stride) for side in self.shape)
        lattice = self.frame.coarsen(self.stride, self.stride / 2.0)
        nowhere = descent_field(jnp.zeros((rows, columns)), lattice, LAYERS)
        return TargetState(
            self.tracker.init(),
            jnp.zeros(2, jnp.int32),
            jnp.array(False),
            nowhere,
            jnp.zeros((), jnp.int32),
        )

    def at_period(self, control_period: ArrayLike) -> "TargetExplorer":
        """Return this controller for commands that are `control_period` seconds apart."""
        same: TargetExplorer = eqx.tree_at(
            lambda one: one.tracker, self, self.tracker.at_period(control_period)
        )
        return same

    def step(
        self, state: TargetState, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, TargetState, Info]:
        """Choose where it is due, and drive; see `Controller.step`."""
        choice_key, control_key = jax.random.split(key)
        state = self._chosen(state, observation, belief, choice_key)
        known = dataclasses.replace(belief, guidance=state.guidance)
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
        """Return what the tracker sees, and the target as its reference."""
        choice_key, control_key = jax.random.split(key)
        state = self._chosen(state, observation, belief, choice_key)
        known = dataclasses.replace(belief, guidance=state.guidance)
        plan = self.tracker.inspect(
            state.tracker, observation, known, key=control_key, num_trajectories=num_trajectories
        )
        here = self.tracker.dynamics.position(observation)
        there = state.guidance.frame.cell_centre(state.node)
        target = jnp.where(state.has_target, there, here)
        return plan._replace(reference=jnp.stack([target, target]))

    def _chosen(
        self, state: TargetState, observation: StateVector, belief: Belief, key: Key
    ) -> TargetState:
        """Return the state with a target, after a look where one is due."""
        is_due = state.since % self.every == 0

        def choose(state: TargetState) -> TargetState:
            position = self.tracker.dynamics.position(observation)
            found = prospects(
                belief,
                position,
                required_clearance=self.required_clearance,
                min_information=self.min_information,
                leftover_share=self.leftover_share,
                min_frontier=self.min_frontier,
                stride=self.stride,
                near=self.nodes_to_unknown,
            )
            return self._target(state, found, key)

        state = jax.lax.cond(is_due, choose, lambda same: same, state)
        return state._replace(since=state.since + 1)

    def _target(self, state: TargetState, found: Frontiers, key: Key) -> TargetState:
        candidates = self.rule.candidates(found)
        away = found.distance > self.near
        if self.stays:
            away |= found.is_view
        row, column = state.node
        keeps = state.has_target & (candidates & away)[row, column]
        shape = candidates.shape

        def pick(_: None) -> tuple[Array, Flag]:
            may_be = candidates & away
            scores = jnp.where(may_be, self.rule.scores(found, key=key), -jnp.inf)
            leftover = jnp.where(found.is_leftover & away, -found.distance, -jnp.inf)
            best = jnp.where(may_be.any(), jnp.argmax(scores), jnp.argmax(leftover))
            is_any = may_be.any() | jnp.isfinite(leftover).any()
            return jnp.stack(jnp.unravel_index(best, shape)).astype(jnp.int32), is_any

        node, has_target = jax.lax.cond(keeps, lambda _: (state.node, keeps), pick, None)
        # Without a target nothing pulls anywhere: all places are as far.
        source = jnp.where(has_target, jnp.inf, 0.0) * jnp.ones(shape)
        source = source.at[node[0], node[1]].set(0.0)
        distance = geodesic(source, found.roads.slowness, found.roads.is_open)
        guidance = descent_field(distance, found.roads.frame, LAYERS)
        return state._replace(node=node, has_target=has_target, guidance=guidance)
