"""The surfaces near a robot, as distances that scans are matched to."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import ArrayLike, GridMask, GridValues, Pose, Position, Scalar
from jaxplore.geometry.motion import transform_points
from jaxplore.maps.frame import GridFrame
from jaxplore.sensing.beams import Beams, Scan

BEHIND, AHEAD = 1.3, 2.0
"""Distances behind and before a surface up to which a scan says where it is [cells]. Behind it, it
is hardly more than a cell: there may be the other side of a thin wall."""
FADING = 0.5
"""Width at the back of this band over which the weight falls from 1 to 0 [cells]."""
ROUGH_WEIGHT = 0.3
"""Weight of an end point whose neighbours are on no line, so that its surface has no direction."""
MOST_WEIGHT = 100.0
"""Greatest weight of a cell, so that the map can change."""
LEAST_WEIGHT = 0.3
"""Weight of a cell below which its distance is not used."""
USUAL_NOISE = 0.015
"""Standard deviation of ranges for which `REACH` and `ROUGH` are [m]."""
REACH = 0.4
"""Distance of the neighbours that say how a surface lies [m]: more than the noise of ranges."""
NEIGHBOURS = 12
"""Greatest number of neighbours to either side. Where beams are denser, some are left out."""
ROUGH = 0.03
"""Standard deviation of the neighbours from their line above which there is a corner [m]."""
ALIGNED = 0.9
"""Cosine of the greatest angle between the normals of points of one line."""
LEAST_NOISE = 0.01
"""Least noise of a point that is taken for the error of its normal [m]."""
GLANCING = 0.1
"""Difference of ranges beyond which a point is behind one beside it [m]."""


class EndPoints(eqx.Module):
    """End points of the beams of a scan, in the frame of the robot.

    Args:
        points: (N, 2) positions [m].
        anchors: (N, 2) points on the line through the neighbours of each [m].
        normals: (N, 2) unit vectors across this line, towards the sensor.
        is_point: mask (N,) of the beams that returned, without those that touch a surface at such
            a glancing angle that no neighbour shows how it lies.
        is_flat: mask (N,) of those with neighbours on a line.
        tilt: (N,) variance of the direction of the normal [rad^2]; 0 where there is no line.
    """

    points: Float[Array, "N 2"]
    anchors: Float[Array, "N 2"]
    normals: Float[Array, "N 2"]
    is_point: Bool[Array, " N"]
    is_flat: Bool[Array, " N"]
    tilt: Float[Array, " N"]

    @classmethod
    def of(cls, sensor: Beams, scan: Scan, noise: ArrayLike = USUAL_NOISE) -> "EndPoints":
        """Return the end points of a scan.

        The line of a point is that of the least squares of distances through the points of its
        neighbours, the beams whose points are about `REACH` away if the surface faces the sensor.
        Where ranges have more noise than usual, the line is longer by as much, and may be rougher.

        Args:
            sensor: sensor of the scan, at the centre of the robot.
            scan: the scan.
            noise: standard deviation of its ranges [m].
        """
        wider = jnp.maximum(jnp.asarray(noise, jnp.float32) / USUAL_NOISE, 1.0)
        reach, rough = REACH * wider, ROUGH * wider
        angles = jnp.asarray(sensor.beam_angles)
        directions = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
        points, is_point = scan.ranges[:, None] * directions, scan.is_return
        shifts = jnp.arange(-NEIGHBOURS, NEIGHBOURS + 1)
        number = points.shape[0]
        # Beams apart by REACH on a surface that faces the sensor; on others points are rarer.
        wide = jnp.ceil(reach / (sensor.beam_spacing * jnp.maximum(scan.ranges, 1e-3)))
        most = jnp.clip(wide, 1, number // 2).astype(jnp.int32)
        stride = (most + NEIGHBOURS - 1) // NEIGHBOURS
        apart = shifts * stride[:, None]
        beside = jnp.arange(number)[:, None] + apart
        is_used = jnp.abs(apart) <= most[:, None]
        if not sensor.is_full_circle:
            # The first beam and the last are no neighbours.
            is_used &= (beside >= 0) & (beside < number)
        beside = beside % number
        others = points[beside]
        away = jnp.hypot(*jnp.unstack(others - points[:, None], axis=-1))
        is_used &= is_point[beside] & is_point[:, None] & (away <= 2.0 * reach)
        count = jnp.maximum(is_used.sum(axis=1, dtype=jnp.float32), 1.0)
        mask = is_used[..., None]
        anchors = jnp.where(mask, others, 0.0).sum(axis=1) / count[:, None]
        x, y = jnp.unstack(jnp.where(mask, others - anchors[:, None], 0.0), axis=-1)
        xx, xy, yy = ((u * v).sum(axis=1) / count for u, v in ((x, x), (x, y), (y, y)))
        # The eigenvectors of the covariance: along the line and across it.
        along = 0.5 * jnp.arctan2(2.0 * xy, xx - yy)
        across = jnp.stack([-jnp.sin(along), jnp.cos(along)], axis=1)
        spread = jnp.hypot(xx - yy, 2.0 * xy)
        thin, thick = 0.5 * (xx + yy - spread), 0.5 * (xx + yy + spread)
        is_flat = (count >= 3.0) & (thin <= rough**2) & (thick >= 4.0 * jnp.abs(thin))
        # Of the two directions the one towards the sensor.
        sign = jnp.where((across * directions).sum(axis=1) > 0.0, -1.0, 1.0)
        normals = jnp.where(is_flat[:, None], sign[:, None] * across, -directions)
        anchors = jnp.where(is_flat[:, None], anchors, points)
        noise = jnp.maximum(thin * count / jnp.maximum(count - 2.0, 1.0), LEAST_NOISE**2)
        tilt = jnp.where(is_flat, noise / (count * jnp.maximum(thick, 1e-6)), 0.0)
        # A thin object is before what is beside it. A lone point behind its neighbour is on a wall
        # far along it: it would pull the pose along the wall, where nothing was measured.
        before, behind = jnp.roll(scan.ranges, 1), jnp.roll(scan.ranges, -1)
        if not sensor.is_full_circle:
            before, behind = before.at[0].set(jnp.inf), behind.at[-1].set(jnp.inf)
        is_first = scan.ranges <= jnp.minimum(before, behind) + GLANCING
        is_point = is_point & ((count >= 3.0) | is_first)
        return cls(points, anchors, normals, is_point, is_flat & is_point, tilt)

    def fill(
        self, number: int, noise: ArrayLike = USUAL_NOISE, *, is_full_circle: bool
    ) -> "EndPoints":
        """Return the points with others between neighbours that are on one line.

        Beams far apart leave gaps of more than a cell between their points. Two neighbours are on
        one line if both have lines that pass through the other one, to within `ROUGH`, and they are
        at most twice `REACH` apart; with more noise than usual, as in `of`.

        Args:
            number: number of points for each one, itself counted; 1 for none between; static.
            noise: standard deviation of the ranges [m].
            is_full_circle: whether the first beam and the last are neighbours.
        """
        if number == 1:
            return self
        wider = jnp.maximum(jnp.asarray(noise, jnp.float32) / USUAL_NOISE, 1.0)
        following: EndPoints = jax.tree.map(lambda rows: jnp.roll(rows, -1, axis=0), self)
        apart = following.points - self.points
        # Both lines are asked: one of them alone would take the first point behind a corner for its
        # own.
        off = jnp.maximum(
            jnp.abs((apart * self.normals).sum(axis=1)),
            jnp.abs((apart * following.normals).sum(axis=1)),
        )
        facing = (self.normals * following.normals).sum(axis=1)
        is_one = self.is_flat & following.is_flat & (off <= ROUGH * wider) & (facing > ALIGNED)
        is_one &= jnp.hypot(*jnp.unstack(apart, axis=1)) <= 2.0 * REACH * wider
        # The neighbour of the last beam is the first one, which a lidar that does not look all
        # around sees elsewhere.
        if not is_full_circle:
            is_one = is_one.at[-1].set(False)
        share = jnp.arange(1, number, dtype=jnp.float32)[:, None, None] / number

        def interpolate(rows: Array, after: Array) -> Array:
            return (rows + share * (after - rows)).reshape(-1, 2)

        feet, feet_after = self._feet(), following._feet()
        normals = interpolate(self.normals, following.normals)
        normals = normals / jnp.maximum(jnp.hypot(normals[:, :1], normals[:, 1:]), 1e-6)
        is_between = jnp.tile(is_one, number - 1)
        more = EndPoints(
            interpolate(self.points, following.points),
            interpolate(feet, feet_after),
            normals,
            is_between,
            is_between,
            jnp.tile(self.tilt, number - 1),
        )
        both: EndPoints = jax.tree.map(lambda a, b: jnp.concatenate([a, b]), self, more)
        return both

    def _feet(self) -> Float[Array, "N 2"]:
        """Return the points on the lines nearest to the end points."""
        away = ((self.points - self.anchors) * self.normals).sum(axis=1, keepdims=True)
        return self.points - away * self.normals

    def move(self, motion: Pose, is_used: Bool[Array, ""]) -> "EndPoints":
        """Return the points in the frame from which a motion led to theirs; none unless used.

        Args:
            motion: pose (x, y, yaw) of their frame in the other one [m, m, rad].
            is_used: whether they count.
        """
        turn = motion * jnp.array([0.0, 0.0, 1.0])
        return EndPoints(
            transform_points(motion, self.points),
            transform_points(motion, self.anchors),
            transform_points(turn, self.normals),
            self.is_point & is_used,
            self.is_flat & is_used,
            self.tilt,
        )

    def every(self, step: int) -> "EndPoints":
        """Return every so many of the points."""
        same: EndPoints = jax.tree.map(lambda rows: rows[::step], self)
        return same


class SurfaceMap(eqx.Module):
    """Signed distance to the nearest surface, positive before it, in the cells around surfaces.

    A scan gives each cell on the normal of an end point p, at the distance
    `s = n . (c - p)` with c its centre and n the normal, if it is from 1.3 cells behind the surface
    to 2 cells before it. The value of a cell is the weighted mean over scans, so a surface is known
    to a fraction of a cell, and walls do not grow thicker with the number of scans.

    Cells that were last seen long ago do not count, and are written anew when they are seen again.
    So a scan is matched to what was mapped a short while before, and a drift over a long way shows
    as a difference of maps, which a pose graph repairs, instead of being hidden in a jump.

    Source: Curless and Levoy, "A volumetric method for building complex models from range images",
    SIGGRAPH 1996; along normals and in the plane: Daun et al., "Large scale 2D laser SLAM using
    truncated signed distance functions", SSRR 2019.

    Args:
        sums: (H, W) sum of weights times distances [m].
        weights: (H, W) sum of weights.
        seen_at: (H, W) way of the robot when the cell was last seen [m].
        frame: pose and cell size.
        memory: way after which a cell counts no more [m].
    """

    sums: GridValues
    weights: GridValues
    seen_at: GridValues
    frame: GridFrame
    memory: Scalar

    @classmethod
    def empty(cls, frame: GridFrame, shape: tuple[int, int], memory: Scalar) -> "SurfaceMap":
        """Return a map without surfaces.

        Args:
            frame: pose and cell size.
            shape: rows and columns.
            memory: way after which a cell counts no more [m].
        """
        blank = jnp.zeros(shape)
        return cls(blank, blank, blank, frame, memory)

    @property
    def band(self) -> float:
        """Greatest distance that the map holds [m]."""
        return AHEAD * self.frame.resolution

    @property
    def depth(self) -> float:
        """Greatest distance behind a surface that the map holds [m]."""
        return BEHIND * self.frame.resolution

    def with_scan(self, pose: Pose, ends: EndPoints, way: Scalar) -> "SurfaceMap":
        """Return the map after a scan.

        Args:
            pose: pose (x, y, yaw) of the sensor [m, m, rad].
            ends: end points of the scan.
            way: length of the robot's way so far [m].
        """
        side = self.frame.resolution
        points, anchors = transform_points(pose, ends.points), transform_points(pose, ends.anchors)
        normals = transform_points(pose * jnp.array([0.0, 0.0, 1.0]), ends.normals)
        # Half a cell apart, so that no cell on the normal is left out.
        shifts = jnp.arange(-round(2 * BEHIND), round(2 * AHEAD) + 1, dtype=jnp.float32)
        steps = shifts * (0.5 * side)
        on_normal = points[:, None] + steps[:, None] * normals[:, None]
        cells = jax.vmap(jax.vmap(self.frame.to_cell))(on_normal)
        centres = jax.vmap(jax.vmap(self.frame.to_world))(cells.astype(jnp.float32) + 0.5)
        away = ((centres - anchors[:, None]) * normals[:, None]).sum(axis=-1)
        weight = jnp.clip((away / side + BEHIND) / FADING, 0.0, 1.0)
        weight = jnp.where(ends.is_flat[:, None], weight, ROUGH_WEIGHT * weight)
        is_used = ends.is_point[:, None] & (weight > 0.0) & (away < AHEAD * side)
        index = self._index(cells, is_used)
        weight, away = jnp.where(is_used, weight, 0.0).reshape(-1), away.reshape(-1)
        sums, weights, seen_at = (
            each.reshape(-1) for each in (self.sums, self.weights, self.seen_at)
        )
        # What is stale goes, and what has its greatest weight makes room. A cell that several
        # points share is set to the same value several times.
        known = weights.at[index].get(mode="fill", fill_value=0.0)
        is_fresh = way - seen_at.at[index].get(mode="fill", fill_value=0.0) <= self.memory
        kept = jnp.where(is_fresh, jnp.minimum(1.0, MOST_WEIGHT / jnp.maximum(known, 1e-6)), 0.0)
        before = sums.at[index].get(mode="fill", fill_value=0.0)
        sums = (
            sums.at[index].set(kept * before, mode="drop").at[index].add(weight * away, mode="drop")
        )
        weights = (
            weights.at[index].set(kept * known, mode="drop").at[index].add(weight, mode="drop")
        )
        seen_at = seen_at.at[index].set(way, mode="drop")
        shape = self.sums.shape
        return SurfaceMap(
            sums.reshape(shape),
            weights.reshape(shape),
            seen_at.reshape(shape),
            self.frame,
            self.memory,
        )

    def is_known(self, way: Scalar) -> GridMask:
        """Return the mask (H, W) of the cells whose distance counts.

        Args:
            way: length of the robot's way so far [m].
        """
        return (self.weights >= LEAST_WEIGHT) & (way - self.seen_at <= self.memory)

    def at(
        self, position: Position, way: Scalar
    ) -> tuple[Scalar, Float[Array, "2"], Bool[Array, ""]]:
        """Return the distance at a position [m], its gradient, and whether they are known.

        They are those of the bilinear interpolation between four centres of cells, all of which
        must be known.

        Args:
            position: position (x, y) [m].
            way: length of the robot's way so far [m].
        """
        height, width = self.sums.shape
        grid = self.frame.to_grid(position) - 0.5
        corner = jnp.floor(grid)
        v, u = jnp.unstack(grid - corner)
        row, column = jnp.unstack(corner.astype(jnp.int32))
        is_inside = (row >= 0) & (row < height - 1) & (column >= 0) & (column < width - 1)
        first = jnp.where(is_inside, row * width + column, 0)
        nodes = first + jnp.array([0, 1, width, width + 1])
        weights = self.weights.reshape(-1)[nodes]
        is_known = is_inside & (weights >= LEAST_WEIGHT).all()
        is_known &= (way - self.seen_at.reshape(-1)[nodes] <= self.memory).all()
        near, right, down, across = jnp.unstack(
            self.sums.reshape(-1)[nodes] / jnp.where(is_known, weights, 1.0)
        )
        value = (1 - v) * ((1 - u) * near + u * right) + v * ((1 - u) * down + u * across)
        by_row = (1 - u) * (down - near) + u * (across - right)
        by_column = (1 - v) * (right - near) + v * (across - down)
        sin, cos = jnp.sin(self.frame.origin[2]), jnp.cos(self.frame.origin[2])
        slope = jnp.stack([cos * by_column - sin * by_row, sin * by_column + cos * by_row])
        slope = slope / self.frame.resolution
        return jnp.where(is_known, value, 0.0), jnp.where(is_known, slope, 0.0), is_known

    def nearest(self, cell: Int[Array, "2"], way: Scalar) -> Scalar:
        """Return the magnitude of the distance at the centre of a cell [m]; `band` if unknown.

        Args:
            cell: row and column.
            way: length of the robot's way so far [m].
        """
        height, width = self.sums.shape
        row, column = jnp.unstack(cell)
        is_inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        index = jnp.where(is_inside, row * width + column, 0)
        weight = self.weights.reshape(-1)[index]
        is_known = is_inside & (weight >= LEAST_WEIGHT)
        is_known &= way - self.seen_at.reshape(-1)[index] <= self.memory
        away = jnp.abs(self.sums.reshape(-1)[index]) / jnp.where(is_known, weight, 1.0)
        return jnp.where(is_known, away, self.band)

    def _index(self, cells: Int[Array, "N K 2"], is_used: Bool[Array, "N K"]) -> Int[Array, " NK"]:
        """Return flat indices of cells; one beyond the map for those that are not used."""
        height, width = self.sums.shape
        row, column = jnp.unstack(cells, axis=-1)
        is_inside = (row >= 0) & (row < height) & (column >= 0) & (column < width) & is_used
        return jnp.where(is_inside, row * width + column, height * width).reshape(-1)
