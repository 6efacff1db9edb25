"""Worlds relative to a datum."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxplore import _kinds
from jaxplore.maps.datum import Datum
from jaxplore.maps.files.world_entries import Row
from jaxplore.maps.shapes import Shapes
from jaxplore.maps.world import World


@_kinds.check_arguments
def relative_world(world: World, datum: Datum) -> World:
    """Return the same world with all its positions relative to a datum.

    Args:
        world: the world.
        datum: point of the world's coordinates; `Datum.near(*world.origin)` suits it.

    Raises:
        ValueError: something else than a world and a datum.
    """
    if not datum:
        return world

    def rows(given: Sequence[Row], points: int = 1) -> tuple[Row, ...]:
        """Move the points with which rows begin; what is behind them stays."""
        if not given:
            return ()
        made = np.array(given, np.float64)
        for first in range(0, 2 * points, 2):
            made[:, first : first + 2] = datum.to_local(made[:, first : first + 2])
        return tuple(tuple(row) for row in made.tolist())

    def shapes(given: Shapes) -> Shapes:
        return Shapes(rows(given.walls, 2), rows(given.rectangles, 2), rows(given.discs))

    changed: dict[str, Any] = {
        name: rows([given])[0]
        for name in ("origin", "start", "goal")
        if (given := getattr(world, name)) is not None
    }
    return dataclasses.replace(
        world,
        **changed,
        known=shapes(world.known),
        hidden=shapes(world.hidden),
        gone=shapes(world.gone),
        zones=rows(world.zones, 2),
        forbidden=rows(world.forbidden, 2),
        hills=rows(world.hills),
        targets=rows(world.targets),
        objects=tuple(
            dataclasses.replace(each, position=rows([each.position])[0]) for each in world.objects
        ),
        movers=tuple(dataclasses.replace(each, path=rows(each.path)) for each in world.movers),
    )
