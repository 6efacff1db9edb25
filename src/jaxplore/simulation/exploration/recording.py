"""The recording of an exploration run, from the arrays on the device."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxplore._types import Position
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.simulation.exploration.map_arrays import MapArrays
from jaxplore.simulation.exploration.state import ExplorationState


def make_recording(
    before: ExplorationState,
    after: ExplorationState,
    arrays: MapArrays,
    goal: Position | None,
    common: Mapping[str, Any],
) -> ExplorationRecording:
    """Make the recording of a run.

    Args:
        before: state before the first step.
        after: state at the end.
        arrays: the map, in arrays of its own shape.
        goal: goal position (x, y) [m]; None without one.
        common: all other fields of the recording.
    """
    world, ground = arrays.world, arrays.ground
    belief, moving, cropped = after.belief, after.moving_obstacles, after.belief.grid.cropped
    return ExplorationRecording(
        **common,
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
        traversable=None if ground is None else np.asarray(ground.is_traversable),
        idleness=None if belief.idleness is None else cropped(belief.idleness),
        mover_radii=np.zeros(0) if moving is None else np.asarray(moving.radius),
    )
