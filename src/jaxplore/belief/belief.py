"""The belief: the robot's map, fields derived from it, and known moving obstacles."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Optional, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Flag, Pose, Position, Scalar
from jaxplore.belief.dwell import dwell_discount
from jaxplore.belief.gain import Gain
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.obstacles import Obstacles
from jaxplore.belief.timed_reference import TimedReference
from jaxplore.belief.tracks import Tracks
from jaxplore.information.field import InformationField
from jaxplore.information.heading_field import HeadingField
from jaxplore.maps.field import ScalarField
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid

if TYPE_CHECKING:
    # The parts are typed as present: exploration code always has a map and would otherwise have to
    # check for None at every use. `part` reports an absent one.
    _Present = TypeVar("_Present")
    Present = Annotated[_Present, "None where the belief has no such part"]
else:
    # At run time a part may be None, which checks of types at run time must accept.
    Present = Optional


class Belief(eqx.Module):
    """The robot's map, the fields derived from it and the known moving obstacles; costs read it.

    Any part may be absent, None. A robot that explores has the map and its fields (`Perception`
    makes them); one that follows a path has `Belief(obstacles=...)`. A cost that needs a part that
    is absent raises a `ValueError` when it is traced.

    Args:
        grid: occupancy, from the robot's own scans.
        clearance: distance to the nearest cell that is not known to be free [m].
        information: expected information of a scan at any pose [nat].
        guidance: cost to go to the remaining information [m], and the direction to it.
        dwell: (rows, columns) time recently spent near each node of the guidance field [s].
        is_explored: whether little of the map is unknown, or no scan within reach would gain enough
            information, so that the robot goes to its goal; false without a goal.
        patience: dwell time after which the information near a position counts 1/e [s].
        pose: pose (x, y, yaw) of the robot at the last update of the fields [m, m, rad].
        ground: terrain, known in advance; level and traversable when absent.
        to_goal: cost to go to the goal [m] through cells that are not known to be occupied, and
            the direction to it; absent if no cost needs it.
        goal: position (x, y) of the goal at which the robot shall come to rest [m]; none when
            absent.
        goal_heading: heading at the goal [rad]; any when absent.
        is_sent: whether a part sends the robot somewhere (`Part.errand`); absent without such
            parts.
        path_stop: arc length of the next point of a path at which the robot shall stand [m]; the
            end of an open path when absent.
        obstacles: known moving obstacles; none when absent.
        parts: state of each `Part` of the robot, by its name.
        certainty: information of a scan about the position, near the robot [1/m^2]; absent if the
            robot knows its pose, as are the two below.
        position_variance: variance of the position in the map [m^2].
        revisit: (rows, columns) worth of nodes where the robot was long before, and where a closed
            loop would tell it much of its position [nat].
        claims: (rows, columns) additional cost of each node as the end of a path, because other
            robots claim it [m]; absent for a robot without a fleet.
        gain: when the known share of the map last rose; absent if the robot knows its pose, or must
            see places again, as on a patrol.
        tracks: tracks of what moves, from which `obstacles` follow; absent without a tracker.
    """

    grid: Present[OccupancyGrid] = None  # type: ignore[assignment]
    clearance: Present[ScalarField] = None  # type: ignore[assignment]
    information: Present[InformationField] = None  # type: ignore[assignment]
    guidance: Present[GuidanceField] = None  # type: ignore[assignment]
    dwell: Present[Float[Array, "rows columns"]] = None  # type: ignore[assignment]
    is_explored: Flag = eqx.field(default_factory=lambda: jnp.array(False))
    patience: Scalar = eqx.field(default_factory=lambda: jnp.array(3.0))
    pose: Pose = eqx.field(default_factory=lambda: jnp.zeros(3))
    ground: Ground | None = None
    to_goal: GuidanceField | None = None
    obstacles: Obstacles | None = None
    parts: dict[str, Any] = eqx.field(default_factory=dict)
    certainty: ScalarField | None = None
    position_variance: Scalar | None = None
    revisit: Float[Array, "rows columns"] | None = None
    claims: Float[Array, "rows columns"] | None = None
    gain: Gain | None = None
    tracks: Tracks | None = None
    goal: Position | None = None
    goal_heading: Scalar | None = None
    is_sent: Flag | None = None
    path_stop: Scalar | None = None

    @property
    def pull(self) -> ScalarField:
        """Discount of the information near a position by the time spent there.

        It is `dwell_discount`; 1 off the map.
        """
        share = dwell_discount(self.dwell, self.patience)
        return ScalarField(share, self.information.frame, jnp.ones(()))

    @property
    def worth(self) -> Float[Array, "rows columns"]:
        """Information of a scan from each node, times `dwell_discount` [nat]."""
        return self.information.total * dwell_discount(self.dwell, self.patience)

    def with_parts[B: "Belief"](self: B, states: Mapping[str, Any]) -> B:
        """Return the belief with other states of some of its parts.

        Args:
            states: the states, by name of the part.
        """
        return dataclasses.replace(self, parts={**self.parts, **states})


class StrategicBelief(Belief, TimedReference):
    """A belief with the fields and the reference of a strategic layer, for informative MPPI.

    Args:
        potential: information of a scan by position and heading around the robot [nat], as of
            the last update of the strategic layer.
        best: greatest value of `potential` over headings [nat].
        local: information of a short-range scan by position and heading [nat], as of now.
        reference: (T, 3) reference positions [m]; row i is due in
            `(i + 1) reference_period - reference_age` seconds.
        reference_period: time between the rows of the reference [s].
        reference_age: time since the reference was made [s].
    """

    potential: HeadingField = eqx.field(kw_only=True)
    best: ScalarField = eqx.field(kw_only=True)
    local: HeadingField = eqx.field(kw_only=True)
    reference: Float[Array, "T 3"] = eqx.field(kw_only=True)
    reference_period: Scalar = eqx.field(kw_only=True)
    reference_age: Scalar = eqx.field(kw_only=True)


class MissingPartError(ValueError):
    """Error of a cost that needs an absent part of the belief."""


def part(belief: Any, name: str) -> Any:
    """Return a field of a `Belief` or the state of a part, or an attribute of any other object.

    If the part is absent, or the belief is None, the `MissingPartError` names its source.
    """
    found = getattr(belief, name, None)
    if found is None:
        found = getattr(belief, "parts", {}).get(name)
    if found is None:
        source = _SOURCES.get(name, _MAP)
        if belief is None:
            made = ", such as perception.init(grid, pose)" if source == _MAP else ""
            raise MissingPartError(
                f"belief is None, and a cost reads its {name}; accepted: step(state, observation, "
                f"belief, key=key) with {source}{made}"
            )
        raise MissingPartError(f"belief has no {name}; accepted: {source}")
    return found


_MAP = "the belief of a Perception"
_SOURCES = {
    "obstacles": "Belief(obstacles=...), or obstacles given to the cost",
    "tracks": "the belief of a Perception with a tracker",
    "to_goal": "the belief of a Perception with a goal apart",
    "goal": "the belief of a perception with a goal",
    **dict.fromkeys(
        ("certainty", "position_variance"), "the belief of a scenario with a localisation"
    ),
    **dict.fromkeys(
        ("potential", "best", "local", "reference"),
        "a StrategicBelief, in a volume a VolumeStrategicBelief",
    ),
}
"""Sources of parts for the error message; parts that are not listed derive from the map."""
