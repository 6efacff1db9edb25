"""One controller for all robots of a fleet, each of which plans for itself."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxplore import _kinds
from jaxplore._equal_objects import Alike
from jaxplore._trees import with_field
from jaxplore._types import ArrayLike, ControlVector, Key, StateVector
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.fleet_share import Share, check_share
from jaxplore.control.trajectory import Trajectory
from jaxplore.dynamics.formation import Formation

OF_ROBOTS = 2**30
"""Number folded into a random key, with the identity of a robot added, for all that the robot
draws. It is above the number of every sensor."""


class FleetBelief(NamedTuple):
    """What the robots of a fleet know.

    Args:
        robots: belief of each of the N robots.
        identity: (N,) number of each robot that its random keys are derived from.
    """

    robots: tuple[Any, ...]
    identity: Int[Array, " N"]


def robot_keys(key: Key, identity: Int[Array, " N"]) -> tuple[Key, ...]:
    """Derive a random key for each robot of a fleet; that of a robot alone is the key itself.

    A key depends on the identity of the robot and not on its place in the fleet, so that the order
    of the robots does not matter. The identities (N,) are all different.
    """
    if identity.shape[0] == 1:
        return (key,)
    return tuple(jax.random.fold_in(key, OF_ROBOTS + number) for number in identity)


class FleetController(Controller):
    """Lets a controller of its own command each robot of a fleet.

        u = (u_1, ..., u_N),   u_i = step_i(x_i, belief_i)

    The belief is a `FleetBelief`. On a CPU the robots are not mapped by `jax.vmap` but stand one
    after the other in the program. So a robot's command is the same to the bit in a fleet of any
    size, and its maps are read where they lie. Measured with the default explorer on two CPU cores,
    the commands of four robots took 3.7 times as long as that of one; mapped they took 4.5 times as
    long, and in a loop over stacked beliefs, whose maps are copied, 5.8 times. The price is about
    1.7 s of compilation for each robot. On other devices equal controllers are mapped.

    Args:
        controllers: controller of each robot. Those that are one object are compiled together on
            an accelerator.
        formation: model of all robots.

    Raises:
        ValueError: another number of controllers than of robots, a part of another class.
    """

    own: Alike[Controller]
    formation: Formation
    share: Share

    @_kinds.check_arguments
    def __init__(self, controllers: Sequence[Controller], formation: Formation) -> None:
        if len(controllers) != len(formation.robots):
            raise ValueError(
                f"controllers has {len(controllers)} entries; accepted: "
                f"{len(formation.robots)}, one for each robot"
            )
        self.own, self.formation = Alike(controllers), formation
        self.share = Share.whole(len(controllers))

    def with_share(self, share: Share) -> "FleetController":
        """Return the controller in a process that computes some of the robots.

        Args:
            share: these robots, and how to hear of the others.

        Raises:
            ValueError: controllers that are not all equal, or one alone.
        """
        check_share(share, self.own.kinds, "controllers")
        return with_field(self, "share", share)

    @property
    def controllers(self) -> tuple[Controller, ...]:
        """Controller of each robot."""
        return self.own.all

    def init(self) -> tuple[Any, ...]:
        """Return the initial state of each controller."""
        return tuple(each.init() for each in self.share.select(self.controllers))

    def at_period(self, control_period: ArrayLike) -> "FleetController":
        """Return a copy of this controller that is called every `control_period` seconds."""
        own = self.own.map(lambda each: each.at_period(control_period))
        same: FleetController = eqx.tree_at(lambda at: at.own, self, own)
        return same

    def step(
        self,
        state: tuple[Any, ...],
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
    ) -> tuple[ControlVector, tuple[Any, ...], Info]:
        """Compute the commands of all robots; see `Controller.step`.

        The diagnostics are those of all robots: plans side by side as far as the shortest reaches,
        weights divided by N, the mean of the effective sample sizes, finite if all are.
        """
        _kinds.instance("belief", belief, FleetBelief)

        def control(own: Controller, *given: Any) -> tuple[ControlVector, Any, Info]:
            memory, observed, known, own_key = given
            return own.step(memory, observed, known, key=own_key)

        # Beliefs are large: copied in a loop, they would take longer than the control.
        rows = self.rows(state, observation, belief, key)
        here = self.own.at(self.share.mine)
        found = here.each(control, *rows, is_large=True)
        states = [memory for _, memory, _ in found]
        told = self.share.gather([(command, info) for command, _, info in found])
        controls, infos = zip(*told, strict=True)
        return jnp.concatenate(controls), tuple(states), join_infos(infos)

    def inspect(
        self,
        state: tuple[Any, ...],
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories of all robots side by side; see `Controller.inspect`.

        Costs of terms are added over the robots.
        """
        _kinds.instance("belief", belief, FleetBelief)

        def plan(own: Controller, *given: Any) -> SampledPlan:
            memory, observed, known, own_key = given
            return own.inspect(
                memory, observed, known, key=own_key, num_trajectories=num_trajectories
            )

        # A plan is inspected for a frame, which is rare: one body compiles sooner.
        here = self.own.at(self.share.mine)
        plans = self.share.gather(here.each(plan, *self.rows(state, observation, belief, key)))
        return SampledPlan(
            _side_by_side([each.nominal for each in plans]),
            _side_by_side([each.best for each in plans]),
            _cut_and_join([each.samples for each in plans], 1),
            jnp.mean(jnp.stack([each.weights for each in plans]), axis=0),
        )

    def rows(
        self, state: tuple[Any, ...], observation: StateVector, belief: FleetBelief, key: Key
    ) -> tuple[Sequence[Any], ...]:
        """Return the states, observations, beliefs and keys of the robots of this process.

        Args:
            state: states of their controllers.
            observation: (nx,) states of all robots.
            belief: what the robots know.
            key: random key of the step.
        """
        observed = self.share.select(self.formation.split_state(observation))
        keys = self.share.select(robot_keys(key, belief.identity))
        return state, observed, belief.robots, keys


def join_infos(infos: Sequence[Info]) -> Info:
    """Return the diagnostics of all robots, see `FleetController.step`."""
    if len(infos) == 1:
        return infos[0]._replace(members=None, log_ratio=None)
    number = len(infos)
    return Info(
        controls=_cut_and_join([each.controls for each in infos], 0),
        weights=jnp.concatenate([each.weights for each in infos]) / number,
        costs=jnp.concatenate([each.costs for each in infos]),
        effective_sample_size=jnp.mean(jnp.stack([each.effective_sample_size for each in infos])),
        is_finite=jnp.all(jnp.stack([each.is_finite for each in infos])),
    )


def _side_by_side(trajectories: Sequence[Trajectory]) -> Trajectory:
    terms: dict[str, Array] = {}
    for each in trajectories:
        for name, paid in each.terms.items():
            terms[name] = terms.get(name, jnp.zeros(())) + paid
    states = _cut_and_join([each.states for each in trajectories], 0)
    return Trajectory(states, _cut_and_join([each.controls for each in trajectories], 0), terms)


def _cut_and_join(arrays: Sequence[Array], time_axis: int) -> Array:
    """Join arrays of states or controls along their last axis, as far as the shortest reaches."""
    shortest = min(each.shape[time_axis] for each in arrays)
    cut = [jax.lax.slice_in_dim(each, 0, shortest, axis=time_axis) for each in arrays]
    return jnp.concatenate(cut, axis=-1)


def same_for_all(controller: Controller, formation: Formation) -> FleetController:
    """Return a fleet controller of equal controllers, for a formation of equal robots."""
    return FleetController([controller] * len(formation.robots), formation)
