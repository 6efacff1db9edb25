"""Frames and the recording of a run of a fleet, from the arrays on the device."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxplore._types import GridValues
from jaxplore.control.base import SampledPlan
from jaxplore.control.fleet_share import Share
from jaxplore.dynamics.formation import Formation, extent
from jaxplore.report.exploration.data import LocalisationData
from jaxplore.report.fleet.data import FleetFrame, FleetRecord
from jaxplore.report.fleet.recording import FleetRecording
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.exploration.finish import has_coverage_target
from jaxplore.simulation.exploration.frames import part_frames
from jaxplore.simulation.exploration.recording import part_reports
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.fleet.parts import gather_parts
from jaxplore.simulation.fleet.state import FleetState


def merge_known(maps: Sequence[GridValues]) -> GridValues:
    """Return of each cell the probability (H, W) that is the farthest from 1/2 on any map."""
    known = maps[0]
    for other in maps[1:]:
        known = jnp.where(jnp.abs(other - 0.5) > jnp.abs(known - 0.5), other, known)
    return known


def fleet_frame(
    robot: Formation,
    state: FleetState,
    share: Share,
    plan: SampledPlan | None,
    links: Bool[Array, "N N"] | None,
    one: ExplorationScenario,
) -> dict[str, Any]:
    """Return the arrays of a `FleetFrame`, by field; without a plan or links it shows none.

    `one` is the exploration of the first robot.
    """
    number, states = len(robot.robots), robot.split_state(state.robot)
    headings = [one.heading(each) for one, each in zip(robot.robots, states, strict=True)]
    plans = jnp.zeros((number, 0, 2))
    if plan is not None:
        plans = jnp.swapaxes(jax.vmap(robot.positions)(plan.nominal.states), 0, 1)
    maps = share.gather([each.belief.grid.probability for each in state.members])
    told = share.gather([each.belief.parts for each in state.members])
    known = gather_parts(one, told)
    return {
        "positions": robot.positions(state.robot),
        "headings": jnp.stack(headings),
        "probability": jnp.round(255.0 * merge_known(maps)).astype(jnp.uint8),
        "plans": plans,
        "links": jnp.zeros((number, number), bool) if links is None else links,
        "is_found": state.is_seen,
        "parts": part_frames(one.truths, known),
    }


def make_recording(
    scenarios: Sequence[ExplorationScenario],
    share: Share,
    robot: Formation,
    start: np.ndarray,
    before: FleetState,
    run: ChunkedRun[Any, FleetRecord, FleetFrame],
    period: float,
    coordination: str,
    *,
    is_given_up: bool,
) -> FleetRecording:
    """Make the recording of a run; `before` is the state before the first step."""
    after: FleetState = run.state.task
    arrays = scenarios[0].map_arrays.crop()
    grid, first = after.members[0].belief.grid, scenarios[0]
    own = [grid.crop(each.belief.grid.probability) for each in after.members]
    maps = share.gather_on_host(own)
    rows = _gather_on_host(share, [each.belief.parts for each in after.members])
    known = gather_parts(first, rows)
    states = [dict(each.truths) for each in after.members]
    stacked = jax.tree.map(lambda *each: jnp.stack(each), *_gather_on_host(share, states))
    reports = part_reports(first.truths, first.perception, known, stacked, grid)
    return FleetRecording(
        **run.common(period),
        world=np.asarray(arrays.world.probability),
        belief=np.asarray(merge_known([jnp.asarray(each) for each in maps])),
        beliefs=np.round(255.0 * np.stack(maps)).astype(np.uint8),
        reachable=np.asarray(arrays.reachable),
        origin=np.asarray(arrays.world.frame.origin),
        resolution=arrays.world.resolution,
        start=start,
        state_names=robot.state_names,
        initial_coverage=float(before.coverage),
        target_coverage=(
            float(first.target_coverage) if has_coverage_target(first.target_coverage) else None
        ),
        # `finished` counts from the step that ended the task, that step included.
        finished_step=run.num_steps - int(after.finished) + 1 if after.finished > 0 else None,
        given_up_step=run.num_steps if is_given_up else None,
        radii=np.array([extent(each.robot.footprint) for each in scenarios]),
        coordination=coordination,
        targets=np.asarray(first.targets),
        traversable=None if arrays.traversable is None else np.asarray(arrays.traversable),
        elevation=None if arrays.ground is None else np.asarray(arrays.ground.elevation),
        parts=reports,
        initial_unknown=float(before.members[0].progress.unknown),
        localisation=_localisation_data(after),
        goal=None if first.goal is None else np.asarray(first.goal),
    )


def _localisation_data(after: FleetState) -> tuple[LocalisationData, ...] | None:
    """Return where each robot took itself to be; None if they knew their poses."""
    found = []
    for each in after.members:
        place, track = each.own.place, each.judged.track
        if place is None or track is None:
            return None
        found.append(track.data(place, each.belief.grid))
    return tuple(found)


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
