"""Where the targets are, and which of them the robot has found."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._trees import with_field
from jaxplore._types import Flag, Pose, Rows
from jaxplore._xla import on_device
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.parts.targets.report import TargetRecord, TargetReport
from jaxplore.simulation.exploration.checks import check_spots, is_closed
from jaxplore.simulation.exploration.part_truth import PartTruth, Site, Vantage


class Targets(PartTruth):
    """Targets that are to be found; the exploration is finished when all are.

    A target is found when it is in sight of the first sensor at a scan, or, by a robot with a
    `Recognition`, when it is reported as a target. Robots of a fleet look for them together.

    Args:
        places: (M, 2) positions, at least one [m].

    Raises:
        ValueError: another shape. In a scenario a target off the map or in a wall, or all targets
            in keep-out areas.
    """

    name: ClassVar[str] = "targets"
    needs_part: ClassVar[bool] = False
    is_judging: ClassVar[bool] = True
    objective: ClassVar[str | None] = "targets.last_at"

    places: Float[Array, "M 2"]
    is_reported: bool = eqx.field(static=True)

    def __init__(self, places: Rows) -> None:
        given = _checks.floats("places", places, "(M, 2) with M >= 1")
        if given.ndim != 2 or given.shape[0] < 1 or given.shape[1] != 2:
            raise ValueError(f"places has shape {given.shape}; accepted: (M, 2) with M >= 1")
        self.places = on_device(given.copy())
        self.is_reported = False

    @property
    def number(self) -> int:
        """Number of targets, M."""
        return int(self.places.shape[0])

    def bind(self, site: Site) -> "Targets":
        """Check where the targets are."""
        places = np.asarray(self.places)
        check_spots("targets", places, site.world, site.datum)
        closed = site.perception.closed_cells(site.world)
        if closed is not None and is_closed(closed, site.world, places).all():
            raise ValueError(
                f"targets are {self.number}, all in keep-out areas; accepted: one outside at least"
            )
        is_reported = any(part.finds_things for part in site.perception.parts)
        return with_field(self, "is_reported", is_reported)

    def init(self, pose: Pose) -> Bool[Array, " M"]:
        """Return that no target was found."""
        return jnp.zeros(self.number, bool)

    def witness(self, own: Bool[Array, " M"], vantage: Vantage) -> Bool[Array, " M"]:
        """Return which targets were found, those that are in sight now or are reported included."""
        for part in vantage.parts:
            known = vantage.known.get(part.name)
            found = None if known is None else part.found(known)
            if found is not None:
                # Of the things that are looked for the targets come first.
                return found[: self.number]
        world, sensor = vantage.truth, vantage.sensors[0]
        is_in_sight: Bool[Array, " M"] = sensor.sees(
            world.grid, vantage.pose, self.places, world.ground
        )
        return own | is_in_sight

    def unite(self, told: Bool[Array, "N M"], pose: Pose) -> Bool[Array, " M"]:
        """Return which targets some robot has found."""
        return told.any(axis=0)

    def is_finished(self, own: Bool[Array, " M"]) -> Flag:
        """Return whether all targets were found."""
        return own.all()

    def record(self, own: Bool[Array, " M"]) -> TargetRecord:
        """Return how many were found."""
        return TargetRecord(jnp.sum(own, dtype=jnp.int32))

    def frame(self, known: Any, own: Bool[Array, " M"] | None) -> dict[str, Bool[Array, " M"]]:
        """Return which were found, on a real robot none."""
        return {"is_found": jnp.zeros(self.number, bool) if own is None else own}

    def report(self, part: Any, known: Any, own: Any, grid: OccupancyGrid) -> TargetReport:
        """Return where the targets are."""
        return TargetReport(np.asarray(self.places), "recognised" if self.is_reported else "seen")
