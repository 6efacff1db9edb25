"""Loops that a robot of a fleet closes, by which its map and what it has told of it move."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxplore._types import Count, GridValues, Pose
from jaxplore.belief.belief import Belief
from jaxplore.belief.merging import log_odds_change, merge_maps
from jaxplore.dynamics.formation import Formation
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.fleet.radio import Heard
from jaxplore.simulation.fleet.rows import by_identity
from jaxplore.simulation.fleet.state import FleetState
from jaxplore.simulation.state import LoopState


def close_loops(
    scenarios: Sequence[ExplorationScenario],
    formation: Formation,
    identity: Int[Array, " N"],
    state: LoopState,
    index: int,
) -> LoopState:
    """Return the state of the loop after a robot has looked for loops, on the host.

    Where it has closed one, it maps its scans anew. That map takes the place of what it had told of
    its scans, and what it has heard of the others is merged with it again.
    """
    task: FleetState = state.task
    one, before = scenarios[index], task.members[index]
    after = one.close_loops(before)
    if after.belief is not before.belief and task.team is not None:
        assert after.own.place is not None
        given = task.team.heard, after.belief, after.own.place.known.pose, identity
        heard, belief = _merge_again(one, *given, jnp.int32(index))
        after = after.with_belief(belief)
        merged = list(task.team.merged)
        # Of its own memory: the loop gives that of its state to the next one.
        merged[index] = jnp.array(belief.grid.probability, copy=True)
        task = task._replace(team=task.team._replace(heard=heard, merged=tuple(merged)))
    members = (*task.members[:index], after, *task.members[index + 1 :])
    moved, guard = one.correction(before, after), state.guard
    observed = list(formation.split_state(state.observed))
    observed[index] = moved(observed[index])
    if guard is not None:
        # The correction is no jump of the robot.
        robots = list(guard.robots)
        robots[index] = robots[index]._replace(expected=moved(robots[index].expected))
        guard = guard._replace(robots=tuple(robots))
    return state._replace(
        task=task._replace(members=members), observed=jnp.concatenate(observed), guard=guard
    )


@eqx.filter_jit
def _merge_again(
    one: ExplorationScenario,
    heard: Heard,
    belief: Belief,
    pose: Pose,
    identity: Int[Array, " N"],
    index: Count,
) -> tuple[Heard, Belief]:
    """Return what is told, and the belief, of a robot at a pose whose map is that of its own scans
    alone."""
    perception, prior = one.perception, one.map_arrays.prior.probability
    own: GridValues = belief.grid.probability
    change = log_odds_change(perception.sensor_model, prior, own)
    log_odds = heard.log_odds.at[index, index].set(change)
    rows = by_identity(log_odds[index], identity)
    merged = merge_maps(perception.sensor_model, prior, rows, own, jnp.ones(own.shape, bool))
    grid = belief.grid.with_probability(merged)
    return heard._replace(log_odds=log_odds), perception.remap(belief, grid, pose)
