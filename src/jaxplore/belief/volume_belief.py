"""What a robot knows of a volume."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import Flag, Scalar
from jaxplore.belief.obstacles import Obstacles
from jaxplore.belief.part import Errand
from jaxplore.belief.rolling_map import RollingMap
from jaxplore.belief.view_field import ViewField
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.maps.window import Window


class GoalKnowledge(eqx.Module):
    """What a robot knows of the way to its goal.

    Args:
        position: position (x, y, z) of the goal [m].
        heading: heading at the goal [rad]; any when None.
        radius: distance from it within which the goal is reached [m].
        walls: distance to the nearest voxel that is known to be occupied, up to the reach of the
            perception [m].
        room: least of it in each coarser voxel [m].
        way: level direction (x, y) in which the way to the goal leads from the robot, of length 1
            or, where it leads up or down, shorter.
        place: where the robot comes to rest: the place near the goal that has room [m].
        fits: whether the robot is known to fit there.
    """

    position: Float[Array, "3"]
    heading: Scalar | None
    radius: Scalar
    walls: Float[Array, "D H W"]
    room: Float[Array, "D2 H2 W2"]
    way: Float[Array, "2"]
    place: Float[Array, "3"]
    fits: Flag


class VolumeBelief(eqx.Module):
    """What a robot knows of a volume.

    Args:
        position: position (x, y, z) of the robot at the last update [m].
        grid: log-odds of the voxels.
        clearance: distance to the nearest voxel that is not known to be free, up to the reach of
            the perception [m].
        information: information of a scan by position and heading.
        attention: the same, with a share of what lies out of view, so that it rises as the robot
            turns to it.
        guidance: cost-to-go to the remaining information, or to the goal if there is one [m].
        coarse: states of the coarser voxels in which information is computed.
        room: least clearance in each of them [m].
        changed: columns of coarser voxels with one whose state has changed since the information
            was last computed.
        sectors: (A, D, H, W) information of each sector from each node, without the discount of the
            time spent [nat m^3].
        dwell: (A, D, H, W) time spent near each node with each sector in view, recent time counting
            more [s].
        beyond: what is known beyond the window; None where the belief is of the whole volume.
        goal: what is known of the way to the goal; None without a goal.
        parts: state of each part of the perception, by its name.
        obstacles: moving obstacles that the robot knows; None where nothing moves.
        errand: where the robot comes to rest for the part that sends it somewhere; None without
            parts that do. While it is due, `guidance` leads there, and nothing is worth a look.
    """

    position: Float[Array, "3"]
    grid: VoxelGrid
    clearance: VolumeField
    information: ViewField
    attention: ViewField
    guidance: VolumeField
    coarse: Int[Array, "D2 H2 W2"]
    room: Float[Array, "D2 H2 W2"]
    changed: Bool[Array, "H2 W2"]
    sectors: Float[Array, "A D H W"]
    dwell: Float[Array, "A D H W"]
    beyond: RollingMap | None = None
    goal: GoalKnowledge | None = None
    parts: dict[str, Any] = eqx.field(default_factory=dict)
    obstacles: Obstacles | None = None
    errand: Errand | None = None

    @property
    def whole(self) -> VoxelGrid:
        """Log-odds of the whole volume, of which `grid` may be a window."""
        return self.grid if self.beyond is None else self.beyond.whole(self.grid)

    def with_parts(self, states: Mapping[str, Any]) -> "VolumeBelief":
        """Return the belief with other states of some parts, by name."""
        return dataclasses.replace(self, parts={**self.parts, **states})

    def split(self) -> tuple["VolumeBelief", "VolumeBelief"]:
        """Return the belief without what is stored beyond the window, and the latter alone, for
        `eqx.combine`.

        What passes through a condition is copied, and what is stored may be large.
        """
        everything = jax.tree.map(lambda _: True, self)
        if self.beyond is not None:
            everything = eqx.tree_at(lambda each: each.beyond.stored, everything, False)
        rest, stored = eqx.partition(self, everything)
        return rest, stored

    def store_window(self) -> "VolumeBelief":
        """Return the belief with its window stored in the whole volume."""
        if self.beyond is None:
            return self
        kept: VolumeBelief = eqx.tree_at(
            lambda each: each.beyond.stored, self, self.beyond.with_window(self.grid)
        )
        return kept

    def place_window(self, window: Window) -> Window:
        """Return a window of `grid` as one of the whole volume."""
        if self.beyond is None:
            return window
        return Window(window.corner + self.beyond.offset, window.shape, self.beyond.shape)
