"""Where the targets are, and which of them the robot has found."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._trees import with_field
from jaxplore._types import Flag, Rows
from jaxplore._xla import on_device
from jaxplore.parts.targets.report import TargetRecord, TargetReport
from jaxplore.simulation.exploration.part_truth import PartTruth, Site, Vantage


class Targets(PartTruth):
    """Targets that are to be found; the exploration is finished when all are.

    A target is found when it is in sight of the first sensor at a scan, in a volume of any sensor,
    or, by a robot with a `Recognition`, when it is reported as a target. Robots of a fleet look for
    them together.

    Args:
        places: (M, 2) positions, in a volume (M, 3) with z up, at least one [m].

    Raises:
        ValueError: another shape. In a scenario a target off the map or in a wall, in a volume one
            that no sensor can see, or all targets in keep-out areas.
    """

    name: ClassVar[str] = "targets"
    needs_part: ClassVar[bool] = False
    is_judging: ClassVar[bool] = True
    objective: ClassVar[str | None] = "targets.last_at"

    places: Float[Array, "M D"]
    is_reported: bool = eqx.field(static=True)

    def __init__(self, places: Rows) -> None:
        accepted = "(M, 2) with M >= 1, in a volume (M, 3)"
        given = _checks.floats("places", places, accepted)
        if given.ndim != 2 or given.shape[0] < 1 or given.shape[1] not in (2, 3):
            raise ValueError(f"places has shape {given.shape}; accepted: {accepted}")
        self.places = on_device(given.copy())
        self.is_reported = False

    @property
    def number(self) -> int:
        """Number of targets, M."""
        return int(self.places.shape[0])

    def bind(self, site: Site) -> "Targets":
        """Check where the targets are."""
        site.check_places("targets", np.asarray(self.places))
        is_reported = any(part.finds_things for part in site.perception.parts)
        return with_field(self, "is_reported", is_reported)

    def init(self, pose: Float[Array, " P"]) -> Bool[Array, " M"]:
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
        return own | vantage.sees(self.places)

    def unite(self, told: Bool[Array, "N M"], pose: Float[Array, " P"]) -> Bool[Array, " M"]:
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

    def report(self, part: Any, known: Any, own: Any, grid: Any) -> TargetReport:
        """Return where the targets are."""
        return TargetReport(np.asarray(self.places), "recognised" if self.is_reported else "seen")
