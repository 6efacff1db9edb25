"""The surfaces of a volume near a robot, as distances that scans are matched to."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore.geometry.level_motion import LevelPose, turn
from jaxplore.localisation.surface import (
    AHEAD,
    BEHIND,
    FADING,
    LEAST_WEIGHT,
    MOST_WEIGHT,
    ROUGH_WEIGHT,
)
from jaxplore.maps.voxel_grid import VoxelGrid, contains, flat_index
from jaxplore.sensing.volume import Rotation, VolumeScan, VolumeSensor

REACH = 0.1
"""Distance of the neighbours that say how a surface lies [m]. Small faces are known as well."""
BESIDE = 2
"""Number of neighbours to either side, across and along."""
FLAT = 0.2
"""Greatest spread of neighbours across a plane, as a share of that along it."""
LEAST_NOISE = 0.01
"""Standard deviation of the error of a mapped surface that more scans do not lessen [m]."""
TILT_NOISE = 0.003
"""Least noise of a point that is taken for the error of its normal [m]."""
FEWEST = 6
"""Fewest neighbours that make a plane."""


class VolumePoints(eqx.Module):
    """End points of the rays of a scan, in a level frame at the robot, turned as it is.

    Args:
        points: (N, 3) positions [m].
        anchors: (N, 3) points on the plane through the neighbours of each [m].
        normals: (N, 3) unit vectors across this plane, towards the sensor.
        is_point: mask (N,) of the rays that count.
        tilt: (N,) variance of the direction of the normal, in each of two directions [rad^2].
        variance: (N,) variance of the point along its normal [m^2].
    """

    points: Float[Array, "N 3"]
    anchors: Float[Array, "N 3"]
    normals: Float[Array, "N 3"]
    is_point: Bool[Array, " N"]
    is_flat: Bool[Array, " N"]
    tilt: Float[Array, " N"]
    variance: Float[Array, " N"]

    @classmethod
    def of(
        cls, sensors: Sequence[VolumeSensor], scans: Sequence[VolumeScan], level: Rotation
    ) -> "VolumePoints":
        """Return the end points of scans with planes through their neighbours.

        Args:
            sensors: the sensors.
            scans: a scan of each.
            level: rotation from the body to the level frame: roll and pitch.
        """
        each = [cls._of(*pair, level) for pair in zip(sensors, scans, strict=True)]
        joined: VolumePoints = jax.tree.map(lambda *rows: jnp.concatenate(rows), *each)
        return joined

    @classmethod
    def _of(cls, sensor: VolumeSensor, scan: VolumeScan, level: Rotation) -> "VolumePoints":
        rows, columns = sensor.lattice
        across, along = sensor.spacing
        ways = (level @ jnp.asarray(sensor.directions)).T
        ranges = scan.ranges
        noise = sensor.noise_std(ranges)
        is_return = scan.is_return & jnp.isfinite(ranges) & (ranges > 0.0)
        # A noisy range at the end of the range was cut off there, and would be too short.
        is_return &= ranges < sensor.max_range - 2.0 * noise
        points = jnp.where(is_return, ranges, 0.0)[:, None] * ways
        number = rows * columns
        row, column = jnp.divmod(jnp.arange(number), columns)
        shift = jnp.arange(-BESIDE, BESIDE + 1)
        down, right = (each.reshape(-1) for each in jnp.meshgrid(shift, shift, indexing="ij"))

        def stride(spacing: float, most: int) -> Int[Array, " N"]:
            wide = jnp.round(REACH / (BESIDE * spacing * jnp.maximum(ranges, 1e-3)))
            return jnp.clip(wide, 1, max(1, most // (2 * BESIDE + 1))).astype(jnp.int32)

        other_row = row[:, None] + down * stride(across, rows)[:, None]
        other_column = column[:, None] + right * stride(along, columns)[:, None]
        is_used = (other_row >= 0) & (other_row < rows)
        if sensor.is_full_circle:
            other_column = other_column % columns
        else:
            is_used &= (other_column >= 0) & (other_column < columns)
        index = jnp.where(is_used, other_row * columns + other_column, 0)
        others = points[index]
        away = jnp.linalg.norm(others - points[:, None], axis=-1)
        is_used &= is_return[index] & is_return[:, None] & (away <= 2.0 * REACH)
        count = is_used.sum(axis=1, dtype=jnp.float32)
        share = jnp.where(is_used, 1.0, 0.0) / jnp.maximum(count, 1.0)[:, None]
        anchors = jnp.einsum("nk,nkd->nd", share, others)
        off = others - anchors[:, None]
        spread = jnp.einsum("nk,nkd,nke->nde", share, off, off)
        normal, thin, thick = smallest_axis(spread)
        towards = jnp.where((normal * ways).sum(axis=1) > 0.0, -1.0, 1.0)
        normals = towards[:, None] * normal
        is_flat = (count >= FEWEST) & (thin <= FLAT**2 * thick)
        glancing = jnp.abs((normals * ways).sum(axis=1))
        variance = (noise * jnp.where(is_flat, glancing, 1.0)) ** 2
        # Of the noise and what the neighbours show the greater one.
        seen = jnp.maximum(thin * count / jnp.maximum(count - 3.0, 1.0), TILT_NOISE**2)
        tilt = seen / (jnp.maximum(count, 1.0) * jnp.maximum(thick, 1e-6))
        normals = jnp.where(is_flat[:, None], normals, -ways)
        anchors = jnp.where(is_flat[:, None], anchors, points)
        tilt = jnp.where(is_flat, tilt, 0.0)
        return cls(points, anchors, normals, is_return, is_flat & is_return, tilt, variance)

    def every(self, step: int) -> "VolumePoints":
        """Return every so many of the points."""
        same: VolumePoints = jax.tree.map(lambda rows: rows[::step], self)
        return same


def smallest_axis(
    spread: Float[Array, "N 3 3"],
) -> tuple[Float[Array, "N 3"], Float[Array, " N"], Float[Array, " N"]]:
    """Return the axis (N, 3) of the smallest variance, that variance, and the middle one.

    The adjugate of a symmetric matrix has the same eigenvectors, and for the smallest eigenvalue
    its own greatest one. Squared a few times only this one is left.
    """
    xx, xy, xz = spread[:, 0, 0], spread[:, 0, 1], spread[:, 0, 2]
    yy, yz, zz = spread[:, 1, 1], spread[:, 1, 2], spread[:, 2, 2]
    scale = jnp.maximum(xx + yy + zz, 1e-12)
    xx, xy, xz, yy, yz, zz = (each / scale for each in (xx, xy, xz, yy, yz, zz))
    upper = (
        (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy),
        (xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz),
        (xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy),
    )
    adjugate = jnp.stack([jnp.stack(row, axis=-1) for row in upper], axis=-2)
    power = adjugate
    for _ in range(4):
        power = power / jnp.maximum(jnp.trace(power, axis1=1, axis2=2), 1e-20)[:, None, None]
        power = jnp.einsum("nij,njk->nik", power, power)
    # Of its columns, which all point along the axis, the longest one.
    longest = jnp.argmax(jnp.diagonal(power, axis1=1, axis2=2), axis=1)
    axis = jnp.take_along_axis(power, longest[:, None, None], axis=2)[..., 0]
    axis = axis / jnp.maximum(jnp.linalg.norm(axis, axis=1, keepdims=True), 1e-20)
    thin = jnp.maximum(jnp.einsum("ni,nij,nj->n", axis, spread, axis), 0.0)
    # With the trace and the sum of the principal minors the other two variances are known.
    rest = scale - thin
    minors = jnp.trace(adjugate, axis1=1, axis2=2) * scale**2
    product = jnp.maximum(minors - thin * rest, 0.0)
    root = jnp.sqrt(jnp.maximum(0.25 * rest * rest - product, 0.0))
    return axis, thin, jnp.maximum(0.5 * rest - root, 0.0)


class VolumeSurface(eqx.Module):
    """Signed distance to the nearest surface of a volume, positive before it.

    As `SurfaceMap` in the plane, in voxels: a scan gives each voxel on the normal of an end point
    its distance to the plane there, from 1.3 voxels behind the surface to 2 before it, and the
    value of a voxel is the weighted mean over scans.

    Source: Curless and Levoy, "A volumetric method for building complex models from range images",
    SIGGRAPH 1996; to track a depth camera: Bylow et al., "Real-time camera tracking and 3D
    reconstruction using signed distance functions", RSS 2013.

    Args:
        sums: (D, H, W) sum of weights times distances [m].
        weights: (D, H, W) sum of weights.
        origin: corner (x, y, z) of voxel (0, 0, 0) [m].
        resolution: side of a voxel [m]; static.
    """

    sums: Float[Array, "D H W"]
    weights: Float[Array, "D H W"]
    origin: Float[Array, "3"]
    resolution: float = eqx.field(static=True)

    @classmethod
    def empty(cls, grid: VoxelGrid) -> "VolumeSurface":
        """Return a map without surfaces, of the voxels of a grid."""
        blank = jnp.zeros(grid.shape)
        return cls(blank, blank, grid.origin, grid.resolution)

    @property
    def shift(self) -> float:
        """Middle of the band, before the surface [m]."""
        return 0.5 * (AHEAD - BEHIND) * self.resolution

    def with_scan(self, pose: LevelPose, ends: VolumePoints) -> "VolumeSurface":
        """Return the map after a scan from a pose."""
        side = self.resolution
        turned = turn(pose[3])
        points, anchors = (each @ turned.T + pose[:3] for each in (ends.points, ends.anchors))
        normals = ends.normals @ turned.T
        # Half a voxel apart, so that hardly a voxel on the normal is left out.
        steps = jnp.arange(-round(2 * BEHIND), round(2 * AHEAD) + 1, dtype=jnp.float32) * 0.5 * side
        on_normal = points[:, None] + steps[:, None] * normals[:, None]
        voxels = jnp.floor((on_normal - self.origin) / side)
        centres = (voxels + 0.5) * side + self.origin
        away = ((centres - anchors[:, None]) * normals[:, None]).sum(axis=-1)
        weight = jnp.clip((away / side + BEHIND) / FADING, 0.0, 1.0)
        trust = LEAST_NOISE**2 / (LEAST_NOISE**2 + ends.variance)
        weight = trust[:, None] * weight * jnp.where(ends.is_flat, 1.0, ROUGH_WEIGHT)[:, None]
        at = jnp.flip(voxels, axis=-1).astype(jnp.int32).reshape(-1, 3).T
        is_used = ends.is_point[:, None] & (weight > 0.0) & (away < AHEAD * side)
        is_used = is_used.reshape(-1) & contains(at, self.sums.shape)
        index = jnp.where(is_used, flat_index(at, self.sums.shape), self.sums.size)
        weight, away = weight.reshape(-1), away.reshape(-1)
        sums, weights = self.sums.reshape(-1), self.weights.reshape(-1)
        # What has its greatest weight makes room.
        known = weights.at[index].get(mode="fill", fill_value=0.0)
        kept = jnp.minimum(1.0, MOST_WEIGHT / jnp.maximum(known, 1e-6))
        before = sums.at[index].get(mode="fill", fill_value=0.0)
        sums = sums.at[index].set(kept * before, mode="drop")
        sums = sums.at[index].add(weight * away, mode="drop")
        weights = weights.at[index].set(kept * known, mode="drop")
        weights = weights.at[index].add(weight, mode="drop")
        shape = self.sums.shape
        return VolumeSurface(
            sums.reshape(shape), weights.reshape(shape), self.origin, self.resolution
        )

    def at(
        self, points: Float[Array, "N 3"]
    ) -> tuple[Float[Array, " N"], Float[Array, "N 3"], Bool[Array, " N"]]:
        """Return the distances at positions (N, 3) [m], their gradients, and which are known.

        They are those of the trilinear interpolation between eight centres of voxels, all of which
        must be known.
        """
        shape = self.sums.shape
        grid = jnp.flip(points - self.origin, axis=1).T / self.resolution - 0.5
        corner = jnp.floor(grid)
        part = grid - corner
        low = corner.astype(jnp.int32)
        is_inside = contains(low, shape) & contains(low + 1, shape)
        first = jnp.where(is_inside, flat_index(low, shape), 0)
        _, height, width = shape
        nodes = jnp.array([z * height * width + y * width + x for z, y, x in _CORNERS])
        index = first[:, None] + nodes
        weights = self.weights.reshape(-1)[index]
        is_known = is_inside & (weights >= LEAST_WEIGHT).all(axis=1)
        values = self.sums.reshape(-1)[index] / jnp.where(is_known[:, None], weights, 1.0)
        values = jnp.moveaxis(values.reshape(-1, 2, 2, 2), 0, -1)
        w, v, u = part
        flat = values[:, :, 0] * (1 - u) + values[:, :, 1] * u
        line = flat[:, 0] * (1 - v) + flat[:, 1] * v
        value = line[0] * (1 - w) + line[1] * w
        by_z = line[1] - line[0]
        rows = flat[:, 1] - flat[:, 0]
        by_y = rows[0] * (1 - w) + rows[1] * w
        steps = values[:, :, 1] - values[:, :, 0]
        by_x = steps[:, 0] * (1 - v) + steps[:, 1] * v
        by_x = by_x[0] * (1 - w) + by_x[1] * w
        slope = jnp.stack([by_x, by_y, by_z], axis=1) / self.resolution
        known = is_known[:, None]
        return jnp.where(is_known, value, 0.0), jnp.where(known, slope, 0.0), is_known


_CORNERS = [(z, y, x) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
