"""The recording of an exploration by one robot or several, from the arrays on the device."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxplore.belief.perception import Perception
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import (
    ExplorationFrame,
    ExplorationRecord,
    LocalisationData,
    MapProgress,
)
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.part import PartReport
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.exploration.finish import has_coverage_target
from jaxplore.simulation.exploration.part_truth import PartTruth, what_moves
from jaxplore.simulation.exploration.state import ExplorationState


def make_recording(
    one: Any,
    run: ChunkedRun[Any, ExplorationRecord, ExplorationFrame],
    before: MapProgress,
    after: ExplorationState,
    *,
    belief: np.ndarray,
    robots: Mapping[str, Any],
    parts: Mapping[str, PartReport],
    finished: int,
    is_given_up: bool,
    localisation: LocalisationData | tuple[LocalisationData, ...] | None,
    member_names: tuple[str, ...] = (),
) -> ExplorationRecording:
    """Make the recording of a run.

    `one` is the `ExplorationScenario` of the robot, or of the first one. `before` is what is said
    of its map before the first step, of several of what they know together; `after` its state at
    the end. `belief` (H, W) is what all know then, `robots` the fields of the robots, `parts` what
    the run shows of parts, by name. `finished` is the number of steps since the task was finished.
    `localisation` is where the robot took itself to be, or each one; None if they knew it.
    """
    arrays, field = one.map_arrays.crop(), after.belief.information
    moving = what_moves(one.truths, after.truths, jnp.zeros(()))
    world, ground, coverage = arrays.world, arrays.ground, one.target_coverage
    return ExplorationRecording(
        **run.common(one.period),
        **robots,
        # `finished` counts from the step that ended the task, that step included.
        finished_step=run.num_steps - finished + 1 if finished > 0 else None,
        given_up_step=run.num_steps if is_given_up else None,
        target=one.target,
        target_coverage=float(coverage) if has_coverage_target(coverage) else None,
        targets=np.asarray(one.targets),
        member_names=member_names,
        world=np.asarray(world.probability),
        belief=belief,
        reachable=np.asarray(arrays.reachable),
        origin=np.asarray(world.frame.origin),
        resolution=world.resolution,
        field_origin=np.asarray(field.frame.origin),
        field_resolution=field.frame.resolution,
        initial_coverage=float(before.coverage),
        initial_entropy=float(before.entropy),
        initial_unknown=float(before.unknown),
        goal=None if one.goal is None else np.asarray(one.goal),
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
