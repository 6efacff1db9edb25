"""How well a scan would tell the position of the robot, near it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Position, Scalar
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.sensing.beams import Beams

LEAST_TURN = 1.0
"""Information about the yaw below which it does not help the position [1/rad^2]."""


class CertaintyField(eqx.Module):
    """Makes the field of the information that a scan holds about the position of the robot.

    A beam that ends at a known wall with the normal n, at the arm r from the robot, measures one
    coordinate of the pose p = (x, y, yaw) with the standard deviation s:

        J = (n_x, n_y, r x n),   Lambda = sum over beams of J' J / s^2

    The value at a place is the least eigenvalue of the part of Lambda for the position after the
    yaw is eliminated (Schur complement) [1/m^2]: a scan corrects the position at least as well in
    every direction. In the middle of a long corridor it is 0, in a room it is hundreds. The normals
    are the gradients of the clearance, one cell before the walls.

    Source: Censi, "On achievable accuracy for range-finder localization", ICRA 2007.

    Args:
        sensor: the sensor.
        resolution: side of a cell of the map [m]; static.
        num_directions: number of rays, D; static.
        extent: distance from the robot up to which the field reaches [m]; static.
        spacing: distance between its nodes [m]; static.
        std: standard deviation of a beam against the map [m].

    Raises:
        ValueError: a number that is not positive.
    """

    std: Scalar
    num_beams: float = eqx.field(static=True)
    max_range: float = eqx.field(static=True)
    resolution: float = eqx.field(static=True)
    num_directions: int = eqx.field(static=True)
    extent: float = eqx.field(static=True)
    spacing: float = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        sensor: Beams,
        resolution: float,
        *,
        num_directions: int = 32,
        extent: float = 3.2,
        spacing: float = 0.4,
        std: ArrayLike = 0.05,
    ) -> None:
        # Beams per direction, as if the field of view were the whole circle.
        self.num_beams = 2.0 * np.pi / sensor.beam_spacing
        self.max_range = sensor.max_range
        self.resolution = _checks.number("resolution", resolution, above=0.0)
        self.num_directions = _checks.positive_int("num_directions", num_directions)
        self.extent = _checks.number("extent", extent, above=0.0)
        self.spacing = _checks.number("spacing", spacing, above=0.0)
        self.std = _checks.scalar("std", std, above=0.0)

    def blank(self) -> ScalarField:
        """Return a field of the same shape without information."""
        number = 2 * round(self.extent / self.spacing) + 1
        # Beyond the field nothing is known about places; the margin takes its edge there.
        return ScalarField(
            jnp.zeros((number, number)), GridFrame(self.spacing), jnp.zeros(()), margin=1e6
        )

    def __call__(
        self, grid: OccupancyGrid, clearance: ScalarField, position: Position
    ) -> ScalarField:
        """Return the field around the robot's position; off it the value is that of its edge.

        `clearance` is the distance to the nearest cell that is not known to be free [m].
        """
        blank = self.blank()
        number = blank.values.shape[0]
        half = number // 2
        # Nodes stay in place while the robot moves on.
        middle = jnp.round(position / self.spacing)
        low = (middle - half) * self.spacing
        steps = self.spacing * jnp.arange(number, dtype=jnp.float32)
        x, y = jnp.meshgrid(low[0] + steps, low[1] + steps)
        nodes = jnp.stack([x, y], axis=-1).reshape(-1, 2)
        values = jax.vmap(lambda at: self.at(grid, clearance, at))(nodes).reshape(number, number)
        origin = jnp.append(low - 0.5 * self.spacing, 0.0)
        field: ScalarField = eqx.tree_at(
            lambda each: (each.values, each.frame.origin), blank, (values, origin)
        )
        return field

    def at(self, grid: OccupancyGrid, clearance: ScalarField, position: Position) -> Scalar:
        """Return the information of a scan at a position [1/m^2].

        Args:
            grid: the robot's map.
            clearance: distance to the nearest cell that is not known to be free [m].
            position: position (x, y) [m].
        """
        side = self.resolution
        turn = 2.0 * np.pi / self.num_directions
        angles = turn * jnp.arange(self.num_directions, dtype=jnp.float32)
        directions = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
        reach = side * jnp.arange(1.0, self.max_range / side, dtype=jnp.float32)
        points = position + reach[:, None] * directions[:, None]
        cells = jax.vmap(jax.vmap(grid.frame.to_cell))(points)
        probability = grid.at_cell(cells)
        is_end = ~(probability < FREE_THRESHOLD)
        end = jnp.argmax(is_end, axis=1)
        rays = jnp.arange(self.num_directions)
        is_wall = is_end.any(axis=1) & (probability[rays, end] > OCCUPIED_THRESHOLD)
        before = position + jnp.maximum(reach[end] - 1.5 * side, 0.0)[:, None] * directions
        normals = jax.vmap(jax.grad(clearance))(before)
        size = jnp.sqrt((normals**2).sum(axis=1))
        is_wall &= size > 0.1
        normals = normals / jnp.where(is_wall, size, 1.0)[:, None]
        arms = reach[end][:, None] * directions
        lever = arms[:, 0] * normals[:, 1] - arms[:, 1] * normals[:, 0]
        rows = jnp.concatenate([normals, lever[:, None]], axis=1)
        weight = self.num_beams / self.num_directions / self.std**2
        total = weight * jnp.einsum("n,ni,nj->ij", is_wall.astype(jnp.float32), rows, rows)
        return _least(total)


def _least(total: Float[Array, "3 3"]) -> Scalar:
    """Return the least eigenvalue for the position after the yaw is eliminated."""
    across = total[:2, 2]
    left = total[:2, :2] - jnp.outer(across, across) / (total[2, 2] + LEAST_TURN)
    mean, half = 0.5 * (left[0, 0] + left[1, 1]), 0.5 * (left[0, 0] - left[1, 1])
    return jnp.maximum(mean - jnp.hypot(half, left[0, 1]), 0.0)
