"""What differs from the known map in the true world, to judge the reports of a robot."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._types import Rows
from jaxplore._xla import on_device
from jaxplore.maps.files.world_entries import Row
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.shapes import Shapes
from jaxplore.maps.world import World
from jaxplore.parts.anomalies.report import AnomalyReport
from jaxplore.parts.anomalies.reports import APPEARED, GONE, PERSON
from jaxplore.parts.anomalies.robot import Anomalies, AnomalyTest
from jaxplore.simulation.exploration.part_truth import PartTruth


class PlantedAnomalies(PartTruth):
    """What differs from the known map, to judge the reports of a robot with an `AnomalyTest`.

    Args:
        boxes: (P, 4) boxes (x_min, y_min, x_max, y_max) [m]; none by default.
        kinds: (P,) kinds: 1 for what has appeared, 2 for what is gone, 3 for a person.

    Raises:
        ValueError: other shapes, something else than finite numbers, an unknown kind.
    """

    name: ClassVar[str] = AnomalyTest.name
    is_default: ClassVar[bool] = True

    boxes: Float[Array, "P 4"]
    kinds: Int[Array, " P"]

    def __init__(self, boxes: Rows = (), kinds: Sequence[int] = ()) -> None:
        accepted = "(P, 4), finite numbers (x_min, y_min, x_max, y_max)"
        given = _checks.floats("boxes", boxes, accepted)
        given = given if given.size else np.zeros((0, 4), np.float32)
        self.boxes = _checks.array("boxes", given, ("P", 4), may_be_empty=True)
        _kinds.instance("kinds", kinds, list, tuple, np.ndarray)
        if len(kinds) != self.boxes.shape[0]:
            raise ValueError(f"kinds has {len(kinds)}; accepted: one for each of the boxes")
        for index, each in enumerate(kinds):
            _checks.whole_number(f"kinds[{index}]", each, at_least=APPEARED, at_most=PERSON)
        self.kinds = on_device(np.asarray(kinds, np.int32).reshape(-1))

    def gather(self, part: AnomalyTest, told: Anomalies) -> Anomalies:
        """Return the reports of all robots of a fleet; each has dropped suspicions of its own."""
        total = jnp.sum(told.num_cleared, dtype=jnp.int32)
        found: Anomalies = super().gather(part, told)
        return dataclasses.replace(found, num_cleared=total)

    def report(
        self, part: AnomalyTest, known: Anomalies, own: Any, grid: OccupancyGrid
    ) -> AnomalyReport:
        """Return the reports beside what differs."""
        is_used = np.asarray(known.reports.kind) > 0
        rows = {
            name: np.asarray(getattr(known.reports, name))[is_used]
            for name in ("place", "kind", "suspected", "reported")
        }
        return AnomalyReport(
            boxes=np.asarray(self.boxes, np.float64),
            kinds=np.asarray(self.kinds),
            **rows,
            num_cleared=int(known.num_cleared),
        )


def find_anomalies(world: World) -> PlantedAnomalies | None:
    """Return the anomalies of a world: hidden and gone obstacles, and who walks where nobody may.

    A person's box holds the part of the path within the forbidden rectangle, and the radius.
    """
    reach = world.wall_reach
    found = [(APPEARED, box) for box in _boxes(world.hidden, reach)]
    found += [(GONE, box) for box in _boxes(world.gone, reach)]
    for mover in world.movers:
        path = np.array([*mover.path, mover.path[0]])
        # Points 5 cm apart along the path, ends included.
        steps = [
            np.linspace(a, b, max(2, int(20.0 * np.hypot(*(b - a)))))
            for a, b in itertools.pairwise(path)
        ]
        points = np.concatenate(steps)
        for box in np.reshape(world.forbidden, (-1, 4)):
            inside = points[((points >= box[:2]) & (points <= box[2:])).all(axis=-1)]
            if len(inside):
                low, high = inside.min(axis=0) - mover.radius, inside.max(axis=0) + mover.radius
                found.append((PERSON, (*low.tolist(), *high.tolist())))
    if not found:
        return None
    return PlantedAnomalies([box for _, box in found], [kind for kind, _ in found])


def _boxes(shapes: Shapes, reach: float) -> list[Row]:
    walls = [
        (min(a, c) - reach, min(b, d) - reach, max(a, c) + reach, max(b, d) + reach)
        for a, b, c, d in shapes.walls
    ]
    discs = [(x - r, y - r, x + r, y + r) for x, y, r in shapes.discs]
    return [*walls, *shapes.rectangles, *discs]
