"""True objects of an exploration scenario, and what a detector says of them."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplore import _kinds
from jaxplore._types import Key, Pose
from jaxplore._xla import on_device
from jaxplore.maps.datum import Datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.world import LabelledObject
from jaxplore.parts.recognition import Look, Recognition
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.checks import check_spots
from jaxplore.simulation.exploration.true_world import TrueWorld

DETECTION = 2**31 - 2
"""Number folded into the key of a step for what a detector draws. It is never the number of a step
or of a sensor, nor that of moving obstacles."""


class TrueObjects(NamedTuple):
    """Positions (N, 2) [m] and numbers of the classes (N,) of N objects; the targets come first."""

    place: Float[Array, "N 2"]
    label: Int[Array, " N"]

    def look(
        self, recognition: Recognition, truth: TrueWorld, sensor: Sensor, pose: Pose, key: Key
    ) -> Look:
        """Return what a detector says of the objects in an image of a camera at the true pose.

        Positions and distances are measured without error.
        """
        detections = recognition.detector.detect(
            self.label,
            jnp.linalg.norm(self.place - pose[:2], axis=-1),
            sensor.sees(truth.grid, pose, self.place, truth.ground),
            key=jax.random.fold_in(key, DETECTION),
        )
        return Look(detections, self.place, pose[:2])


def true_objects(
    targets: Float[Array, "M 2"],
    objects: Sequence[LabelledObject] | None,
    recognition: Recognition | None,
    world: OccupancyGrid,
    datum: Datum,
) -> TrueObjects | None:
    """Check the objects of a scenario, and return them behind the targets (M, 2) [m].

    The result is None without any objects, or if the robot recognises none.

    Raises:
        ValueError: objects without a recognition, of an unknown class or of that of the targets,
            or not in free space.
    """
    given = () if objects is None else objects
    _kinds.instances("objects", given, LabelledObject)
    if recognition is None:
        if given:
            raise ValueError(
                f"objects has {len(given)} objects; accepted: none, without a recognition in the "
                "perception"
            )
        return None
    detector, target = recognition.detector, int(recognition.target)
    labels = [
        detector.index_of(f"objects[{index}].label", each.label) for index, each in enumerate(given)
    ]
    if target in labels:
        raise ValueError(
            f"objects[{labels.index(target)}].label is {detector.classes[target]!r}, the class of "
            "the targets; accepted: another class, or the position among the targets"
        )
    if not given and not targets.shape[0]:
        return None
    spots = np.array([each.position for each in given], np.float32).reshape(-1, 2)
    check_spots("objects", spots, world, datum)
    return TrueObjects(
        on_device(np.concatenate([np.asarray(targets), spots])),
        on_device(np.array([target] * targets.shape[0] + labels, np.int32)),
    )
