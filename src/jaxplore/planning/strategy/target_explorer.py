"""Target explorer: choose a target by a rule and drive to it."""

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Count, Flag, Key, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.belief.exploration_field import LEFTOVER_SHARE
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.roadmap import Locomotion, TurnsOnTheSpot
from jaxplore.control.base import Controller, Info, ModelBasedController, SampledPlan
from jaxplore.control.model_checks import checked_call
from jaxplore.maps.frame import GridFrame
from jaxplore.planning.strategy.frontiers import Frontiers, find_frontiers
from jaxplore.planning.strategy.target_rules import TargetRule


class TargetState(NamedTuple):
    """State of a `TargetExplorer`.

    Args:
        tracker: state of the controller that drives.
        node: (row, column) of the target on the guidance lattice.
        has_target: whether there is a target.
        guidance: cost to go to the target [m].
        since: number of commands so far.
    """

    tracker: Any
    node: Int[Array, "2"]
    has_target: Flag
    guidance: GuidanceField
    since: Count


class TargetExplorer(Controller):
    """Chooses a target by a rule, drives there, and chooses the next one.

    A target is kept until the robot is near it, no path leads to it, or it is no longer among the
    candidates of the rule, for instance because it was seen from afar. A rule with `hysteresis`
    replaces it earlier by a candidate that is better by as much. Without candidates, the
    nearest place with a little information left is the target. Without such a place the robot
    waits. Information that cannot be seen from a place after all is discounted while the robot is
    near it and recovers later (`Belief.dwell`), so no place is given up for ever.

    The tracker descends the cost to go to the target, which replaces the guidance in its belief.
    Motion, obstacles and limits are those of the tracker, the same for all rules.

    Args:
        tracker: controller that drives down `belief.guidance`, such as MPPI.
        rule: rule that chooses targets.
        frame: frame of the map.
        shape: rows and columns of the belief's arrays, those of `scenario.map_arrays.world`;
            static.
        stride: cells between the nodes of the fields of the belief; static.
        required_clearance: clearance that a path needs [m]. The distance between a frontier node
            and unknown space follows from it.
        min_information: discounted information below which a place is not visited [nat].
        leftover_share: share of `min_information` below which a place has nothing left.
        min_frontier: minimum length of a frontier, and of a cluster [m].
        near: length of the path to a target at which it counts as reached [m].
        every: number of commands between choices.
        stays: whether the robot stays at a target until its information is seen or discounted. This
            suits a robot with a limited field of view, whose tracker turns it towards the
            information; static.
        locomotion: paths that the robot can drive; those of a robot that turns on the spot when
            absent.

    Raises:
        ValueError: a number outside its range.
    """

    tracker: ModelBasedController
    rule: TargetRule
    frame: GridFrame
    locomotion: Locomotion
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
        tracker: ModelBasedController,
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
        locomotion: Locomotion | None = None,
    ) -> None:
        _kinds.instance("tracker", tracker, ModelBasedController)
        _kinds.instance("rule", rule, TargetRule)
        _kinds.instance("frame", frame, GridFrame)
        _kinds.instance("locomotion", locomotion, Locomotion, may_be_none=True)
        if not isinstance(shape, tuple) or len(shape) != 2:
            raise ValueError(f"shape is {_kinds.described(shape)}; accepted: (H, W)")
        self.tracker, self.rule, self.frame = tracker, rule, frame
        rows, columns = (_checks.positive_int("shape", side) for side in shape)
        self.shape = (rows, columns)
        self.stride = _checks.positive_int("stride", stride)
        self.required_clearance = _checks.scalar(
            "required_clearance", required_clearance, above=0.0
        )
        # The robot keeps its clearance from unknown cells, so a node from which a frontier is
        # visited is at least that far away from it.
        spacing = frame.resolution * self.stride
        self.locomotion = TurnsOnTheSpot() if locomotion is None else locomotion
        self.nodes_to_unknown = 1 + math.ceil(float(self.required_clearance) / spacing)
        self.min_information = _checks.scalar("min_information", min_information, above=0.0)
        self.leftover_share = _checks.scalar(
            "leftover_share", leftover_share, at_least=0.0, at_most=1.0
        )
        self.min_frontier = _checks.scalar("min_frontier", min_frontier, at_least=0.0)
        self.near = _checks.scalar("near", near, above=0.0)
        self.stays = _kinds.flag("stays", stays)
        self.every = jnp.asarray(_checks.positive_int("every", every), jnp.int32)

    def init(self) -> TargetState:
        """Return the initial state, without a target."""
        rows, columns = (-(-side // self.stride) for side in self.shape)
        lattice = self.frame.coarsen(self.stride, self.stride / 2.0)
        # The loop needs a state of fixed shapes; a flat cost to go attracts the robot nowhere.
        flat = self.locomotion.level_field(lattice, (rows, columns))
        return TargetState(
            self.tracker.init(),
            jnp.zeros(2, jnp.int32),
            jnp.array(False),
            flat,
            jnp.zeros((), jnp.int32),
        )

    def at_period(self, control_period: ArrayLike) -> "TargetExplorer":
        """Return a copy of this controller that is called every `control_period` seconds."""
        tracker = self.tracker.at_period(control_period)
        same: TargetExplorer = eqx.tree_at(lambda explorer: explorer.tracker, self, tracker)
        return same

    def step(
        self, state: TargetState, observation: StateVector, belief: Any = None, *, key: Key
    ) -> tuple[ControlVector, TargetState, Info]:
        """Choose a target if a choice is due, and plan towards it; see `Controller.step`."""
        model = self.tracker.dynamics
        observation = checked_call(model, state, TargetState, observation, key)
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
        observation = checked_call(model, state, TargetState, observation, key)
        state, known, control_key = self._prepare(state, observation, belief, key)
        plan = self.tracker.inspect(
            state.tracker, observation, known, key=control_key, num_trajectories=num_trajectories
        )
        here = self.tracker.dynamics.position(observation)
        there = state.guidance.frame.cell_centre(state.node)
        target = jnp.where(state.has_target, there, here)
        return plan._replace(reference=jnp.stack([target, target]))

    def _prepare(
        self, state: TargetState, observation: StateVector, belief: Belief, key: Key
    ) -> tuple[TargetState, Belief, Key]:
        """Return the state with its target, the belief that leads there, and the tracker's key."""
        _kinds.instance("belief", belief, Belief)
        choice_key, control_key = jax.random.split(key)
        state = self._choose_if_due(state, observation, belief, choice_key)
        return state, dataclasses.replace(belief, guidance=state.guidance), control_key

    def _choose_if_due(
        self, state: TargetState, observation: StateVector, belief: Belief, key: Key
    ) -> TargetState:
        """Return the state after a choice, if one is due."""
        is_due = state.since % self.every == 0

        def choose(state: TargetState) -> TargetState:
            if self.shape != belief.grid.shape:
                raise ValueError(
                    f"shape is {self.shape}; accepted: that of the belief's map, which has arrays "
                    f"of {belief.grid.shape} cells"
                )
            frontiers = find_frontiers(
                belief,
                self.tracker.dynamics.pose(observation),
                self.locomotion,
                required_clearance=self.required_clearance,
                min_information=self.min_information,
                leftover_share=self.leftover_share,
                min_frontier=self.min_frontier,
                stride=self.stride,
                near=self.nodes_to_unknown,
            )
            return self._choose(state, frontiers, key)

        state = jax.lax.cond(is_due, choose, lambda same: same, state)
        return state._replace(since=state.since + 1)

    def _choose(self, state: TargetState, frontiers: Frontiers, key: Key) -> TargetState:
        """Keep the target or choose a new one, and compute the cost to go to it."""
        candidates = self.rule.candidates(frontiers)
        # A target that is reached is dropped. A robot that stays keeps it while there is
        # information.
        away = frontiers.distance > self.near
        if self.stays:
            away |= frontiers.is_view
        row, column = state.node
        keeps = state.has_target & (candidates & away)[row, column]
        shape, lead = candidates.shape, self.rule.hysteresis()

        # Choosing may cost a search per frontier, so a rule without hysteresis is skipped while the
        # target is kept.
        def pick(_: None) -> tuple[Array, Flag]:
            may_be = candidates & away
            scores = self.rule.scores(frontiers, key=key)
            if lead is not None:
                scores = scores.at[row, column].add(jnp.where(keeps, lead, 0.0))
            scores = jnp.where(may_be, scores, -jnp.inf)
            leftover = jnp.where(frontiers.is_leftover & away, -frontiers.distance, -jnp.inf)
            best = jnp.where(may_be.any(), jnp.argmax(scores), jnp.argmax(leftover))
            is_any = may_be.any() | jnp.isfinite(leftover).any()
            return jnp.stack(jnp.unravel_index(best, shape)).astype(jnp.int32), is_any

        if lead is None:
            node, has_target = jax.lax.cond(keeps, lambda _: (state.node, keeps), pick, None)
        else:
            node, has_target = pick(None)
        # Without a target the cost to go is 0 everywhere, so that nothing attracts the robot.
        source = jnp.where(has_target, jnp.inf, 0.0) * jnp.ones(shape)
        source = source.at[node[0], node[1]].set(0.0)
        # The lattice is that of the state, whose frame a caller may have made without padding.
        guidance = dataclasses.replace(frontiers.roads.field(source), frame=state.guidance.frame)
        return state._replace(node=node, has_target=has_target, guidance=guidance)
