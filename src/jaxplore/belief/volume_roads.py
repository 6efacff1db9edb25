"""Road map of a volume: the lattice of the places at which a robot fits, and the paths on it."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore.belief.volume_geodesic import volume_geodesic
from jaxplore.maps.volume_field import VolumeField

FAR = 1e4
"""Cost-to-go where no path leads [m]."""
LAYERS = 4
"""Number of layers of closed nodes into which a field is extended."""
BEGIN_STEPS = 4
"""Steps of half the spacing to the nodes at which a path may begin."""
NARROWEST = 0.5
"""Clearance above which no path can jump a wall [voxels].

A step leads from a voxel to one of its 26 neighbours at most. Each voxel between the two shares a
face with one of them: in a wall, it leaves that one a clearance of half a voxel."""


class VolumeRoads(eqx.Module):
    """Lattice of the places in a volume at which a robot fits, with paths between 26 neighbours.

    Args:
        half_open: which points of the lattice with half the spacing the robot fits at, with the
            nodes at even indices.
        slowness: cost of a metre at each node.
        origin: position (x, y, z) of node (0, 0, 0) [m].
        spacing: distance between nodes [m]; static.
    """

    half_open: Bool[Array, "D2 H2 W2"]
    slowness: Float[Array, "D H W"]
    origin: Float[Array, "3"]
    spacing: float = eqx.field(static=True)

    @property
    def is_open(self) -> Bool[Array, "D H W"]:
        """Mask of the nodes at which the robot fits."""
        return self.half_open[::2, ::2, ::2]

    def lengths(self, source: Float[Array, "D H W"]) -> Float[Array, "D H W"]:
        """Return the cost-to-go of each node [m]; infinite where no path leads to a source.

        `source` is the cost at the nodes where paths may end [m]; infinite elsewhere.
        """
        return volume_geodesic(source / self.spacing, self.slowness, self.half_open) * self.spacing

    def lengths_from(self, position: Float[Array, "3"]) -> Float[Array, "D H W"]:
        """Return the cost of the path from a position (x, y, z) to each node [m]."""
        return self.lengths(self.around(position))

    def around(self, position: Float[Array, "3"]) -> Float[Array, "D H W"]:
        """Return the straight distance from a position to the nodes at which its paths begin and
        end [m]; infinite at others.

        These are the open nodes within a spacing of the nearest one. Only nodes count to which
        open points of half the spacing lead from the open one nearest to the position: a node on
        the other side of a wall may be as near as one on this side.
        """
        away = jnp.where(self.half_open, self._half_distances(position), jnp.inf)
        is_reached = self.half_open & (away <= away.min())
        for _ in range(BEGIN_STEPS):
            is_reached = self.half_open & _dilate(is_reached)
        gap = jnp.where(is_reached, away, jnp.inf)[::2, ::2, ::2]
        return jnp.where(gap <= gap.min() + self.spacing, gap, jnp.inf)

    def field(self, source: Float[Array, "D H W"]) -> VolumeField:
        """Return the cost-to-go of `lengths` as a field, extended into closed nodes."""
        return self.extend(self.lengths(source))

    def extend(
        self, lengths: Float[Array, "D H W"], known: Bool[Array, "D H W"] | None = None
    ) -> VolumeField:
        """Return the cost-to-go of `lengths` [m] as a field, extended into closed nodes.

        A closed node has the least cost beside it. With a mask of `known` nodes, at which the robot
        may be, those near these have the greatest cost of them instead: the other side of a thin
        wall may be much nearer to the goal, and a field that falls into a wall holds the robot.
        """
        if known is not None:
            lengths = _extend_known(lengths, known, self.spacing)
        values = _extend(lengths, self.spacing)
        return VolumeField(values, self.origin, self.spacing, jnp.asarray(FAR))

    def distances(self, position: Float[Array, "3"]) -> Float[Array, "D H W"]:
        """Return the straight distance of each node from a position (x, y, z) [m]."""
        return _distances(self.places, position)

    @property
    def places(self) -> tuple[Float[Array, "D H W"], Float[Array, "D H W"], Float[Array, "D H W"]]:
        """Positions x, y and z of the nodes [m]."""
        return self._places(self.slowness.shape, self.spacing)

    def _half_distances(self, position: Float[Array, "3"]) -> Float[Array, "D2 H2 W2"]:
        """Return the distance of each point of half the spacing from a position [m]."""
        return _distances(self._places(self.half_open.shape, 0.5 * self.spacing), position)

    def _places(self, shape: tuple[int, ...], spacing: float) -> tuple[Array, Array, Array]:
        """Return the positions x, y and z of the points of a lattice from the first node on [m]."""
        z, y, x = jnp.meshgrid(
            *(
                self.origin[axis] + spacing * jnp.arange(size, dtype=jnp.float32)
                for axis, size in zip((2, 1, 0), shape, strict=True)
            ),
            indexing="ij",
        )
        return x, y, z


def _distances(places: tuple[Array, Array, Array], position: Float[Array, "3"]) -> Array:
    gap = jnp.stack(places) - position[:, None, None, None]
    return jnp.sqrt(jnp.sum(gap * gap, axis=0))


def _dilate(mask: Bool[Array, "D H W"]) -> Bool[Array, "D H W"]:
    """Return the points of a mask and their 26 neighbours."""
    for axis in range(3):
        edges = [(1, 1) if each == axis else (0, 0) for each in range(3)]
        wide, size = jnp.pad(mask, edges), mask.shape[axis]
        parts = [jax.lax.slice_in_dim(wide, begin, begin + size, axis=axis) for begin in range(3)]
        mask = parts[0] | parts[1] | parts[2]
    return mask


def _extend(costs: Float[Array, "D H W"], spacing: float) -> Float[Array, "D H W"]:
    """Return costs with values in closed nodes near open ones, so that they can be interpolated."""
    for _ in range(LAYERS):
        near = _least_beside(costs)
        costs = jnp.where(jnp.isfinite(costs), costs, near + 2.0 * spacing)
    return jnp.where(jnp.isfinite(costs), jnp.minimum(costs, FAR), FAR)


def _extend_known(
    costs: Float[Array, "D H W"], known: Bool[Array, "D H W"], spacing: float
) -> Float[Array, "D H W"]:
    """Return costs with the greatest values of known nodes in the closed nodes near these."""
    is_closed = ~jnp.isfinite(costs)
    beside = jnp.where(known & ~is_closed, costs, -jnp.inf)
    for _ in range(LAYERS):
        near = -_least_beside(-beside)
        beside = jnp.where(is_closed & (beside == -jnp.inf), near + 2.0 * spacing, beside)
    return jnp.where(is_closed & (beside > -jnp.inf), beside, costs)


def _least_beside(costs: Float[Array, "D H W"]) -> Float[Array, "D H W"]:
    """Return the least cost of the six nodes beside each node."""
    wide = jnp.pad(costs, 1, constant_values=jnp.inf)
    near = jnp.full_like(costs, jnp.inf)
    for axis in range(3):
        for begin in (0, 2):
            index = [slice(1, 1 + n) for n in costs.shape]
            index[axis] = slice(begin, begin + costs.shape[axis])
            near = jnp.minimum(near, wide[tuple(index)])
    return near
