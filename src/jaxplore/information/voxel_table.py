"""Compute the information of scans from a whole lattice of viewpoints in a volume.

In one direction, the rays from all voxels cross the same offsets, as in
`jaxplore.information.beam_table`. So the information of a ray is computed for all viewpoints
together by a recursion over shifted volumes, from the far end of the rays to their near end:

    V_s = w_s b_s + (1 - o_s) V_{s+1},        b = o f_occ + (1 - o) f_emp

o is the probability of occupancy, b the expected gain of a voxel that is measured, and w the volume
that the ray stands for, in voxels: with the solid angle dO of a ray that is in the voxel between
the distances r and r',

    w = dO (r'^3 - r^3) / 3

so that a voxel near by, which many rays cross, counts once, and one far away, which no ray may
cross, counts through its neighbours.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplore import _checks
from jaxplore._limits import MOST_DIRECTIONS
from jaxplore._xla import on_device
from jaxplore.geometry.rays import direction_offsets
from jaxplore.information.beam_table import UNROLL, in_blocks, parts_from
from jaxplore.information.gain import CellSensor, expected_gain, settle


class VoxelTable(eqx.Module):
    """Table of the voxels that rays from a voxel's centre cross, with the weight of each.

    The rays cover a band around the horizon: A equal sectors of azimuth, with E rays each of equal
    solid angle, one above the other.

    Args:
        num_sectors: number of sectors, A; static.
        num_elevations: number of rays of a sector, E; static.
        lowest: elevation of the lower edge of the band [rad].
        highest: elevation of its upper edge [rad].
        length: length of a ray [voxels].
        stride: number of voxels between viewpoints; static.

    Raises:
        ValueError: no sectors or rays, edges that are not in order within a right angle, a length
            or a stride that is not positive.
    """

    offset: Int[Array, "R N 3"]
    weight: Float[Array, "R N"]
    count: Int[Array, " R"]
    num_sectors: int = eqx.field(static=True)
    reach: int = eqx.field(static=True)
    stride: int = eqx.field(static=True)

    def __init__(
        self,
        num_sectors: int,
        num_elevations: int,
        lowest: float,
        highest: float,
        length: float,
        stride: int,
    ) -> None:
        self.num_sectors = _checks.positive_int("num_sectors", num_sectors, at_most=MOST_DIRECTIONS)
        number = _checks.positive_int("num_elevations", num_elevations, at_most=MOST_DIRECTIONS)
        quarter = 0.5 * math.pi
        low = _checks.number("lowest", lowest, at_least=-quarter, below=quarter)
        high = _checks.number("highest", highest, above=low, at_most=quarter)
        self.stride = _checks.positive_int("stride", stride)
        ways, solid_angle = band(self.num_sectors, number, low, high)
        rays = direction_offsets(ways[::-1], _checks.number("length", length, above=0.0))
        is_crossed = rays.is_crossed
        near, far = (np.where(is_crossed, each, 0.0) for each in (rays.entry, rays.exit))
        self.offset = on_device(rays.offset)
        self.weight = on_device((solid_angle * (far**3 - near**3) / 3.0).astype(np.float32))
        self.count = on_device(is_crossed.sum(axis=1).astype(np.int32))
        self.reach = int(np.abs(rays.offset).max())

    def information(
        self,
        probability: Float[Array, "D H W"],
        first: tuple[int, int, int],
        shape: tuple[int, int, int],
        sensor: CellSensor,
    ) -> Float[Array, "A d h w"]:
        """Return the information of each sector from every viewpoint of a lattice [nat].

        Beyond the array nothing passes and nothing is learned. `first` is the voxel (k, j, i) of
        viewpoint (0, 0, 0), and `shape` the numbers of viewpoints along z, y and x; both static.
        """
        probability = settle(probability, sensor)
        passing, gains = 1.0 - probability, expected_gain(probability, sensor)
        step, reach = self.stride, self.reach
        widths = []
        for begins, number, size in zip(first, shape, probability.shape, strict=True):
            last = begins + (number - 1) * step
            low, high = max(0, reach - begins), max(0, last + reach + 1 - size)
            # The phases have equal sizes only if the sides are multiples of the stride. One more of
            # each keeps slices within the array.
            widths.append((low, high + step + -(low + size + high + step) % step))

        def split(values: Array) -> Array:
            padded = jnp.pad(values, widths)
            depth, height, width = (side // step for side in padded.shape)
            phases = padded.reshape(depth, step, height, step, width, step)
            return phases.transpose(1, 3, 5, 0, 2, 4).reshape(step**3, depth, height, width)

        barrier = jax.lax.optimization_barrier
        maps = [split(each) for each in barrier((passing, gains))]  # type: ignore[no-untyped-call]
        origin = jnp.asarray([begin + low for begin, (low, _) in zip(first, widths, strict=True)])
        cells = origin + self.offset
        phase, node = cells % step, cells // step
        index = (phase[..., 0] * step + phase[..., 1]) * step + phase[..., 2]
        starts = jnp.concatenate([index[..., None], node], axis=-1)

        def read(values: Array, start: Array) -> Array:
            sizes = (1, *shape)
            part = jax.lax.dynamic_slice(values, list(start), sizes, allow_negative_indices=False)
            return part[0]

        def ray(given: tuple[Array, Array, Array]) -> Array:
            start, weight = in_blocks(given[0]), in_blocks(given[1])
            blocks = -(-given[2] // UNROLL)

            def nearer(block: Array, value: Array) -> Array:
                nearest = (blocks - 1 - block) * UNROLL
                places, shares = (
                    parts_from(start, nearest, UNROLL),
                    parts_from(weight, nearest, UNROLL),
                )
                for place, share in zip(reversed(places), reversed(shares), strict=True):
                    value = share * read(maps[1], place) + read(maps[0], place) * value
                return value

            value: Array = jax.lax.fori_loop(0, blocks, nearer, jnp.zeros(shape))
            return value

        values: Array = jax.lax.map(ray, (starts, self.weight, self.count))
        return jnp.sum(values.reshape(self.num_sectors, -1, *shape), axis=1)


def band(
    num_sectors: int, num_elevations: int, lowest: float, highest: float
) -> tuple[np.ndarray, float]:
    """Return unit vectors (3, A E) (x, y, z) in the middles of equal solid angles, and their size.

    Each of A sectors has E rays between the edges of the band, two elevations [rad]. Sector a is
    around the azimuth `(a + 1/2) 2 pi / A`.
    """
    azimuth = (np.arange(num_sectors) + 0.5) * 2.0 * math.pi / num_sectors
    # Zones of equal height on the unit sphere have equal areas (Archimedes).
    low, high = math.sin(lowest), math.sin(highest)
    height = low + (np.arange(num_elevations) + 0.5) * (high - low) / num_elevations
    azimuth, height = np.meshgrid(azimuth, height, indexing="ij")
    level = np.sqrt(1.0 - height**2)
    ways = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height]).reshape(3, -1)
    return ways, 2.0 * math.pi / num_sectors * (high - low) / num_elevations
