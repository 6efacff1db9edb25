"""What differs from the known map in the true world, to judge the reports of a robot."""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from jaxplore._xla import on_device
from jaxplore.maps.files.world_entries import Row
from jaxplore.maps.shapes import Shapes
from jaxplore.maps.world import World
from jaxplore.parts.anomaly_reports import APPEARED, GONE, PERSON


class PlantedAnomalies(NamedTuple):
    """Boxes (P, 4) of anomalies (x_min, y_min, x_max, y_max) [m]; kinds (P,) as in `Reports`."""

    boxes: Float[Array, "P 4"]
    kinds: Int[Array, " P"]


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
    return PlantedAnomalies(
        on_device(np.array([box for _, box in found], np.float32)),
        on_device(np.array([kind for kind, _ in found], np.int32)),
    )


def _boxes(shapes: Shapes, reach: float) -> list[Row]:
    walls = [
        (min(a, c) - reach, min(b, d) - reach, max(a, c) + reach, max(b, d) + reach)
        for a, b, c, d in shapes.walls
    ]
    discs = [(x - r, y - r, x + r, y + r) for x, y, r in shapes.discs]
    return [*walls, *shapes.rectangles, *discs]
