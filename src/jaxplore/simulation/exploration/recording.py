"""The recording of an exploration run, from the arrays on the device."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from jaxplore._types import Position, Scalar, StateVector
from jaxplore.belief.perception import Perception
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import (
    ExplorationFrame,
    ExplorationRecord,
    LocalisationData,
)
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.part import PartReport
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.exploration.finish import has_coverage_target
from jaxplore.simulation.exploration.map_arrays import MapArrays
from jaxplore.simulation.exploration.part_truth import PartTruth
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.robot_fields import robot_fields


def make_recording(
    before: ExplorationState,
    run: ChunkedRun[Any, ExplorationRecord, ExplorationFrame],
    arrays: MapArrays,
    robot: Dynamics,
    start: StateVector,
    period: float,
    goal: Position | None,
    target: str,
    target_coverage: Scalar,
    targets: Float[Array, "M 2"],
    member_names: tuple[str, ...],
    parts: Mapping[str, PartReport],
    localisation: LocalisationData | None = None,
    *,
    is_given_up: bool = False,
) -> ExplorationRecording:
    """Make the recording of a run.

    `before` is the state before the first step; `run` has that at the end. `arrays` have the map's
    own shape. `target_coverage` is above 1 for none. `parts` is what it shows of parts, by name.
    `localisation` is where the robot took itself to be; None if it knew its pose.
    """
    after: ExplorationState = run.state.task
    world, ground = arrays.world, arrays.ground
    belief, moving, cropped = after.belief, after.moving_obstacles, after.belief.grid.crop
    return ExplorationRecording(
        **run.common(period),
        **robot_fields(robot, start),
        # `finished` counts from the step that ended the task, that step included.
        finished_step=run.num_steps - int(after.finished) + 1 if after.finished > 0 else None,
        given_up_step=run.num_steps if is_given_up else None,
        target=target,
        target_coverage=float(target_coverage) if has_coverage_target(target_coverage) else None,
        targets=np.asarray(targets),
        member_names=member_names,
        world=np.asarray(world.probability),
        belief=cropped(belief.grid.probability),
        reachable=np.asarray(arrays.reachable),
        origin=np.asarray(world.frame.origin),
        resolution=world.resolution,
        field_origin=np.asarray(belief.information.frame.origin),
        field_resolution=belief.information.frame.resolution,
        initial_coverage=float(before.progress.coverage),
        initial_entropy=float(before.progress.entropy),
        initial_unknown=float(before.progress.unknown),
        goal=None if goal is None else np.asarray(goal),
        elevation=None if ground is None else np.asarray(ground.elevation),
        traversable=None if arrays.traversable is None else np.asarray(arrays.traversable),
        parts=parts,
        localisation=localisation,
        mover_radii=np.zeros(0) if moving is None else np.asarray(moving.radius),
    )


def part_reports(
    truths: Sequence[PartTruth],
    perception: Perception,
    known: Mapping[str, Any],
    states: Mapping[str, Any],
    grid: OccupancyGrid,
) -> dict[str, PartReport]:
    """Return what a run shows of parts, by name.

    `known` are the states of the robot's parts, `states` those of their truths, and `grid` its map.
    """
    found = {}
    for each in truths:
        part, knows = perception.part_named(each.name), known.get(each.name)
        # A part without a state has nothing to do in this world.
        if part is None or knows is not None:
            report = each.report(part, knows, states.get(each.name), grid)
            if report is not None:
                found[each.name] = report
    return found
