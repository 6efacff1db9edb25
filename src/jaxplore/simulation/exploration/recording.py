"""The recording of an exploration run, from the arrays on the device."""

from typing import Any

import numpy as np
from jaxtyping import Array, Float

from jaxplore._types import Position, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.parts.anomalies import Anomalies, AnomalyTest
from jaxplore.parts.recognition import ObjectClasses, Recognition
from jaxplore.parts.watch import IdlenessMap
from jaxplore.report.exploration.data import (
    ExplorationFrame,
    ExplorationRecord,
    LocalisationData,
)
from jaxplore.report.exploration.mission import AnomalyData, ObjectData
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.simulation.chunks import ChunkedRun
from jaxplore.simulation.exploration.finish import has_coverage_target
from jaxplore.simulation.exploration.map_arrays import MapArrays
from jaxplore.simulation.exploration.planted_anomalies import PlantedAnomalies
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.exploration.true_objects import TrueObjects
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
    planted: PlantedAnomalies | None = None,
    objects: TrueObjects | None = None,
    recognition: Recognition | None = None,
    localisation: LocalisationData | None = None,
    *,
    is_given_up: bool = False,
) -> ExplorationRecording:
    """Make the recording of a run.

    `before` is the state before the first step; `run` has that at the end. `arrays` have the map's
    own shape. `target_coverage` is above 1 for none. `planted` is what differs from the prior map.
    `localisation` is where the robot took itself to be; None if it knew its pose.
    """
    after: ExplorationState = run.state.task
    world, ground = arrays.world, arrays.ground
    belief, moving, cropped = after.belief, after.moving_obstacles, after.belief.grid.crop
    idleness = belief.parts.get(IdlenessMap.name)
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
        idleness=None if idleness is None else cropped(idleness),
        anomalies=anomaly_data(belief.parts.get(AnomalyTest.name), planted),
        objects=object_data(belief.parts.get(Recognition.name), objects, recognition),
        localisation=localisation,
        mover_radii=np.zeros(0) if moving is None else np.asarray(moving.radius),
    )


def anomaly_data(found: Anomalies | None, planted: PlantedAnomalies | None) -> AnomalyData | None:
    """Return the reports beside what differs from the prior map; None without a test."""
    if found is None:
        return None
    is_used = np.asarray(found.reports.kind) > 0
    rows = {name: np.asarray(values)[is_used] for name, values in found.reports._asdict().items()}
    return AnomalyData(
        boxes=np.zeros((0, 4)) if planted is None else np.asarray(planted.boxes, np.float64),
        kinds=np.zeros(0, np.int32) if planted is None else np.asarray(planted.kinds),
        place=rows["place"],
        kind=rows["kind"],
        suspected=rows["suspected"],
        reported=rows["reported"],
        num_cleared=int(found.num_cleared),
    )


def object_data(
    known: ObjectClasses | None, objects: TrueObjects | None, recognition: Recognition | None
) -> ObjectData | None:
    """Return what is known of the objects beside what they are; None without a detector."""
    if known is None or objects is None or recognition is None:
        return None
    names = ("detected_at", "looks", "reported_at", "reported_probability")
    return ObjectData(
        classes=recognition.detector.classes,
        target=int(recognition.target),
        place=np.asarray(objects.place),
        label=np.asarray(objects.label),
        probability=np.exp(np.asarray(known.log_probability)),
        **{name: np.asarray(getattr(known, name)) for name in names},
    )
