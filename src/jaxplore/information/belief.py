"""What the robot knows."""

import equinox as eqx

from jaxplore._types import GridValues
from jaxplore.information.field import InformationField
from jaxplore.information.guidance import GuidanceField
from jaxplore.maps.field import ScalarField
from jaxplore.maps.occupancy_grid import OccupancyGrid


class Belief(eqx.Module):
    """The robot's map and the fields derived from it: all that a cost may read.

    Args:
        grid: occupancy, from the robot's own scans.
        clearance: distance to the nearest cell not known to be free [m].
        information: expected information of a scan at any pose [nat].
        guidance: cost to go to the remaining information [m], and the way there.
        dwell: (rows, columns) of the guidance's nodes: time recently spent near each [s].
    """

    grid: OccupancyGrid
    clearance: ScalarField
    information: InformationField
    guidance: GuidanceField
    dwell: GridValues
