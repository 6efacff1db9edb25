"""How well a map is patrolled."""

from typing import ClassVar

import jax.numpy as jnp

from jaxplore._types import GridMask, GridValues, Pose, Scalar
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.parts.watch.report import WatchRecord, WatchReport
from jaxplore.parts.watch.robot import IdlenessMap
from jaxplore.simulation.exploration.part_truth import PartTruth, Site


class WatchTruth(PartTruth):
    """Judges how well a robot with an `IdlenessMap` patrols."""

    name: ClassVar[str] = IdlenessMap.name
    is_default: ClassVar[bool] = True
    objective: ClassVar[str | None] = "watch.mean_idleness"
    is_judging: ClassVar[bool] = True

    is_patrol: bool = True

    def bind(self, site: Site) -> "WatchTruth":
        """Return the judge; a search is judged by what ends it, and is no patrol."""
        return WatchTruth(not any(each.ends_task for each in site.truths))

    def init(self, pose: Pose) -> WatchRecord:
        """Return what is said at the start."""
        return WatchRecord(jnp.zeros(()), jnp.zeros(()))

    def judge(
        self,
        own: WatchRecord,
        known: GridValues,
        reachable: GridMask,
        number: Scalar,
        time: Scalar,
    ) -> WatchRecord:
        """Return the mean and the greatest idleness [s]."""
        return mean_and_worst(known, reachable, number, time)

    def record(self, own: WatchRecord) -> WatchRecord:
        """Return what the last scans have led to."""
        return own

    def report(
        self, part: IdlenessMap, known: GridValues, own: WatchRecord, grid: OccupancyGrid
    ) -> WatchReport:
        """Return the idleness at the end."""
        return WatchReport(grid.crop(known), is_patrol=self.is_patrol)


def mean_and_worst(
    idleness: GridValues, reachable: GridMask, number: Scalar, time: Scalar
) -> WatchRecord:
    """Return the mean and the greatest idleness of the `number` reachable cells [s].

    That of a cell that was never seen is infinite; here it counts from the start, for `time` [s].
    """
    idle = jnp.where(reachable, jnp.minimum(idleness, time), 0.0)
    return WatchRecord(jnp.sum(idle) / number, jnp.max(idle))
