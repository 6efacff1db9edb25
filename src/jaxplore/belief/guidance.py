"""Cost-to-go as a field over positions, which leads to remaining information or to a goal."""

from typing import TYPE_CHECKING

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Pose, Position, Scalar
from jaxplore.belief.descent import descent, extend
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import length
from jaxplore.maps.field import Stencil, gather, stencil
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.lattice_figure import lattice_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LAYERS = 4
"""Number of layers of closed nodes into which the fields of the robot are extended."""


class GuidanceField(eqx.Module):
    """Cost-to-go and its direction of descent, read by bilinear interpolation in O(1).

    Args:
        values: cost-to-go (H, W) [m]; only differences matter.
        descent: unit vectors (2, H, W) as (x, y) in the world along which it falls; 0 at a minimum.
        frame: pose and node spacing of the lattice.
        outside: cost-to-go off the lattice [m].
    """

    values: Float[Array, "H W"]
    descent: Float[Array, "2 H W"]
    frame: GridFrame
    outside: Scalar

    def __call__(self, position: Position) -> Scalar:
        """Return the cost-to-go at a world position (x, y) [m]."""
        return gather(self.values, self._around(position), self.outside)

    def at_pose(
        self, position: Position, heading: Scalar, speed: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Return the cost-to-go of a robot [m], its descent along the heading, and all of it.

        The descent is `direction`, of length 1 or shorter. A robot that faces it has as much along
        its heading as there is.

        Args:
            position: position of the robot (x, y) [m].
            heading: its heading [rad].
            speed: its forward speed [m/s].
        """
        direction = self.direction(position)
        sin, cos = sin_cos(heading)
        along = cos * direction[0] + sin * direction[1]
        return self(position), along, length(direction[0], direction[1])

    def from_pose(self, pose: Pose) -> "GuidanceField":
        """Return the field for a robot at a pose; it is the same one for any pose by default.

        Args:
            pose: pose of the robot (x, y, yaw) [m, m, rad].
        """
        return self

    def trace_path(
        self, pose: Pose, speed: Scalar, steps: Float[Array, "2"], num_steps: int
    ) -> Float[Array, "T 3"] | None:
        """Return the poses (x, y, yaw) of a robot that descends the cost-to-go (T, 3) [m, m, rad].

        It is None, by default, for a robot that can drive along any line.

        Args:
            pose: pose of the robot (x, y, yaw) [m, m, rad].
            speed: its forward speed [m/s]; negative if it drives backwards.
            steps: length of a step forwards and of a step backwards [m].
            num_steps: number of steps, T; static.
        """
        return None

    def plot(self) -> "Figure":
        """Draw the cost-to-go in the world, with a colour bar."""
        return lattice_figure(self.values, self.frame, "cost to go [m]")

    def direction(self, position: Position) -> Position:
        """Return the direction of descent (x, y) at a world position.

        Its length is at most 1: shorter where directions of neighbouring nodes differ, and 0 at a
        minimum.
        """
        around = self._around(position)
        return jnp.stack([gather(self.descent, around, 0.0, axis) for axis in (0, 1)])

    def _around(self, position: Position) -> Stencil:
        height, width = self.values.shape
        return stencil((height, width), self.frame.to_grid(position))


def descent_field(
    distance: Float[Array, "H W"],
    frame: GridFrame,
    num_layers: int,
    corners: Bool[Array, "H W"] | None = None,
) -> GuidanceField:
    """Return a cost-to-go on a lattice as a field, extended into closed nodes by `num_layers`.

    The cost-to-go is that of `geodesic` [m], infinite at closed nodes. A diagonal step may pass the
    `corners` of `clear_corners`; all when None.
    """
    # Rotate the descent from the axes of the lattice to those of the world.
    along_row, along_column = descent(distance, num_layers, corners)
    cos, sin = jnp.cos(frame.origin[2]), jnp.sin(frame.origin[2])
    direction = [cos * along_column - sin * along_row, sin * along_column + cos * along_row]
    return GuidanceField(
        values=extend(distance, num_layers, jnp.asarray(3.0 * frame.resolution), corners),
        descent=jnp.stack(direction),
        frame=frame,
        # Costlier than any place on the map, leftovers a kilometre away included.
        # With its type: a resumed run, whose arrays have theirs, would be another program.
        outside=jnp.asarray(1e4, jnp.float32),
    )
