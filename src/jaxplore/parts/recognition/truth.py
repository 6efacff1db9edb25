"""True objects of an exploration scenario, and what a detector says of them."""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplore import _kinds
from jaxplore._trees import HostOnly
from jaxplore._types import Key, Pose
from jaxplore._xla import on_device
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.world import LabelledObject
from jaxplore.parts.recognition.report import ObjectReport
from jaxplore.parts.recognition.robot import Look, ObjectClasses, Recognition
from jaxplore.parts.targets.truth import Targets
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.checks import check_spots
from jaxplore.simulation.exploration.part_truth import PartTruth, Site
from jaxplore.simulation.exploration.true_world import TrueWorld

DETECTION = 2**31 - 2
"""Number folded into the key of a step for what a detector draws. It is never the number of a step
or of a sensor, nor that of moving obstacles."""


class Objects(PartTruth):
    """Objects other than the targets, for a robot with a `Recognition`; the targets are its own.

    Args:
        objects: the objects; none by default.

    Raises:
        ValueError: something else than objects. In a scenario an object of an unknown class or of
            that of the targets, or not in free space.
    """

    name: ClassVar[str] = Recognition.name
    is_default: ClassVar[bool] = True

    given: HostOnly[tuple[LabelledObject, ...]]

    def __init__(self, objects: Sequence[LabelledObject] = ()) -> None:
        _kinds.instances("objects", objects, LabelledObject)
        self.given = HostOnly(tuple(objects))

    def bind(self, site: Site) -> PartTruth:
        """Check the objects, and return them behind the targets."""
        given, recognition = self.given.value, site.perception.part(Recognition)
        assert recognition is not None
        detector, target = recognition.detector, int(recognition.target)
        targets = site.truth(Targets)
        sought = np.zeros((0, 2), np.float32) if targets is None else np.asarray(targets.places)
        labels = [
            detector.index_of(f"objects[{index}].label", each.label)
            for index, each in enumerate(given)
        ]
        if target in labels:
            raise ValueError(
                f"objects[{labels.index(target)}].label is {detector.classes[target]!r}, the class "
                "of the targets; accepted: another class, or the position among the targets"
            )
        spots = np.array([each.position for each in given], np.float32).reshape(-1, 2)
        check_spots("objects", spots, site.world, site.datum)
        return TrueObjects(
            on_device(np.concatenate([sought, spots])),
            on_device(np.array([target] * len(sought) + labels, np.int32)),
        )


class TrueObjects(PartTruth):
    """Positions (N, 2) [m] and numbers of the classes (N,) of N objects; the targets come first."""

    name: ClassVar[str] = Recognition.name

    place: Float[Array, "N 2"]
    label: Int[Array, " N"]

    def init_part(self, part: Recognition, pose: Pose) -> ObjectClasses | None:
        """Return a slot for each object; None without any."""
        number = self.label.shape[0]
        return part.init_slots(number) if number else None

    def measure(
        self,
        part: Recognition,
        own: Any,
        truth: TrueWorld,
        sensors: Sequence[Sensor],
        pose: Pose,
        key: Key,
    ) -> Look | None:
        """Return what a detector says of the objects in an image of the first sensor.

        Positions and distances are measured without error.
        """
        if not self.label.shape[0]:
            return None
        detections = part.detector.detect(
            self.label,
            jnp.linalg.norm(self.place - pose[:2], axis=-1),
            sensors[0].sees(truth.grid, pose, self.place, truth.ground),
            key=jax.random.fold_in(key, DETECTION),
        )
        return Look(detections, self.place, pose[:2])

    def frame(self, known: ObjectClasses | None, own: Any) -> dict[str, Float[Array, "N C"]]:
        """Return the probability of each class of each object; NaN of those not detected."""
        assert known is not None  # It has no state of its own.
        return {"classes": jnp.where(known.is_known[:, None], known.probability, jnp.nan)}

    def report(
        self, part: Recognition, known: ObjectClasses, own: Any, grid: OccupancyGrid
    ) -> ObjectReport:
        """Return what is known of the objects beside what they are."""
        names = ("detected_at", "looks", "reported_at", "reported_probability")
        return ObjectReport(
            classes=part.detector.classes,
            target=int(part.target),
            place=np.asarray(self.place),
            label=np.asarray(self.label),
            probability=np.exp(np.asarray(known.log_probability)),
            **{name: np.asarray(getattr(known, name)) for name in names},
        )
