"""Frames and the recording of a run by several robots, from the arrays on the device."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxplore._types import GridValues, StateVector
from jaxplore.control.base import SampledPlan
from jaxplore.control.fleet_share import Share
from jaxplore.dynamics.formation import Formation
from jaxplore.report.exploration.data import TEAM, ExplorationFrame, ExplorationRecord
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.exploration.team import TeamReport
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.exploration.frames import part_frames
from jaxplore.simulation.exploration.recording import make_recording, part_reports
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.fleet.parts import gather_parts
from jaxplore.simulation.fleet.state import FleetState
from jaxplore.simulation.robot_fields import fleet_fields
from jaxplore.simulation.state import Moment


def merge_known(maps: Sequence[GridValues]) -> GridValues:
    """Return of each cell the probability (H, W) that is the farthest from 1/2 on any map."""
    known = maps[0]
    for other in maps[1:]:
        known = jnp.where(jnp.abs(other - 0.5) > jnp.abs(known - 0.5), other, known)
    return known


def fleet_frame(
    one: ExplorationScenario,
    robot: Formation,
    state: FleetState,
    moment: Moment,
    share: Share,
    plan: SampledPlan | None,
    links: Bool[Array, "N N"] | None,
) -> dict[str, Any]:
    """Return the arrays of an `ExplorationFrame`, by field; without a plan or links it shows none.

    `one` is the exploration of the first robot.
    """
    number, states = len(robot.robots), robot.split_state(state.robot)
    headings = [one.heading(each) for one, each in zip(robot.robots, states, strict=True)]
    plans, nowhere = jnp.zeros((number, 0, 2)), jnp.zeros((0, 2))
    if plan is not None:
        plans = jnp.swapaxes(jax.vmap(robot.positions)(plan.nominal.states), 0, 1)
    maps = share.gather([each.belief.grid.probability for each in state.members])
    known = gather_parts(one, share.gather([each.belief.parts for each in state.members]))
    movers = one.true_world(state.members[0], moment).discs
    heard = jnp.zeros((number, number), bool) if links is None else links
    return {
        "state": state.robot,
        "heading": jnp.stack(headings),
        "probability": jnp.round(255.0 * merge_known(maps)).astype(jnp.uint8),
        "information": jnp.zeros((0, 0)),
        "scan": nowhere,
        "samples": jnp.zeros((0, 1, 2)),
        "weights": jnp.zeros(0),
        "plan": plans,
        "reference": nowhere,
        "movers": nowhere if movers is None else movers[:, :2],
        "terms": {},
        "sample_terms": {},
        "tracks": jnp.zeros((0, 2, 2)),
        "parts": {**part_frames(one.truths, known, state.judged), TEAM: {"links": heard}},
    }


def make_fleet_recording(
    one: ExplorationScenario,
    share: Share,
    robot: Formation,
    start: StateVector,
    before: FleetState,
    run: ChunkedRun[Any, ExplorationRecord, ExplorationFrame],
    coordination: str,
    *,
    is_given_up: bool,
) -> ExplorationRecording:
    """Make the recording of a run; `before` is the state before the first step, `one` the
    exploration of the first robot."""
    after: FleetState = run.state.task
    grid = after.members[0].belief.grid
    maps = share.gather_on_host([grid.crop(each.belief.grid.probability) for each in after.members])
    rows = _gather_on_host(share, [each.belief.parts for each in after.members])
    states = _gather_on_host(share, [dict(each.truths) for each in after.members])
    stacked = jax.tree.map(lambda *each: jnp.stack(each), *states)
    known = gather_parts(one, rows)
    places = [each.localisation for each in after.members]
    found = tuple(each for each in places if each is not None)
    frames = None if after.team is None else after.team.frames
    merges: tuple[tuple[float, float], ...] = ()
    if frames is not None:
        pairs = np.argwhere(np.triu(np.asarray(frames.known), 1))
        merges = tuple(
            (float(frames.found_at[one, other]), float(frames.errors[one, other]))
            for one, other in pairs
        )
    beliefs = np.round(255.0 * np.stack(maps)).astype(np.uint8)
    team = TeamReport(coordination, beliefs, None if frames is None else merges)
    return make_recording(
        *(one, run, before.members[0].progress._replace(coverage=before.coverage)),
        after.members[0],
        belief=np.asarray(merge_known([jnp.asarray(each) for each in maps])),
        robots=fleet_fields(robot, start),
        parts={**part_reports(one.truths, one.perception, known, stacked, grid), TEAM: team},
        finished=int(after.finished),
        is_given_up=is_given_up,
        localisation=found or None,
    )


def _gather_on_host(share: Share, own: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the states of the parts of all robots, from those of this process."""
    leaves, structure = zip(*(jax.tree.flatten(each) for each in own), strict=True)
    columns = [
        share.gather_on_host([np.asarray(leaf) for leaf in column])
        for column in zip(*leaves, strict=True)
    ]
    return [
        jax.tree.unflatten(structure[0], [jnp.asarray(column[robot]) for column in columns])
        for robot in range(share.number)
    ]
