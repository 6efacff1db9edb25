"""What a robot knows of a volume, and what follows from it: distances, information, guidance."""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Scalar
from jaxplore._xla import on_device
from jaxplore.belief.exploration_field import information_sources
from jaxplore.belief.view_field import ViewField, sectors_in_view, turn_shares
from jaxplore.belief.volume_roads import FAR, VolumeRoads
from jaxplore.information.voxel_table import VoxelTable
from jaxplore.maps.volume_clearance import squared_distance
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.volume import Rotation, VolumeScan, VolumeSensor

COARSE = 0.2
"""Side of the coarser voxels in which information is computed [m], where the map's are finer."""
NODE = 2
"""Coarser voxels between the nodes of the lattice."""
NEAR = 0.6
"""Distance within which time counts in full as time near a viewpoint, and not at all at twice that
[m]."""
ASIDE = 0.1
"""Share of the time near a viewpoint that counts for sectors out of view."""


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
        guidance: cost-to-go to the remaining information [m].
        dwell: (A, D, H, W) time spent near each node with each sector in view, recent time counting
            more [s].
    """

    position: Float[Array, "3"]
    grid: VoxelGrid
    clearance: VolumeField
    information: ViewField
    attention: ViewField
    guidance: VolumeField
    dwell: Float[Array, "A D H W"]


class VolumePerception(eqx.Module):
    """Update of the belief of a volume from scans.

    Args:
        sensors: the sensors; the information is that of the first one.
        resolution: side of a voxel [m].
        radius: radius of the robot [m].
        margin: clearance beyond the radius that paths keep [m].
        sensor_model: inverse sensor model; the default one when absent.
        decay_length: additional distance that the robot travels for e times the information [m].
        min_information: information below which a viewpoint comes last [nat m^3].
        occupancy_prior: probability of occupancy of an unknown voxel in expected information.
        patience: time near a viewpoint, looking into a sector, after which the information there
            counts 1/e [s]: what was not seen by then is not seen from there.
        memory: time constant with which that time is forgotten [s].
        turning: share of the information that counts towards turning to it.
        num_sectors: number of headings of the field.
        num_elevations: rays of each heading, one above the other.
        max_clearance: reach of the clearance [m].

    Raises:
        ValueError: no sensor, a part of another class, a number outside its range.
    """

    sensors: tuple[VolumeSensor, ...]
    sensor_model: InverseSensorModel
    required: Scalar
    decay_length: Scalar
    min_information: Scalar
    occupancy_prior: Scalar
    patience: Scalar
    memory: Scalar
    turning: Scalar
    table: VoxelTable
    in_view: Float[Array, "A A"]
    towards: Float[Array, "A A"]
    pool: int = eqx.field(static=True)
    reach: int = eqx.field(static=True)
    box: int = eqx.field(static=True)

    def __init__(
        self,
        sensors: Sequence[VolumeSensor],
        resolution: float,
        radius: ArrayLike,
        *,
        margin: ArrayLike = 0.1,
        sensor_model: InverseSensorModel | None = None,
        decay_length: ArrayLike = 8.0,
        min_information: ArrayLike = 0.2,
        occupancy_prior: ArrayLike = 0.1,
        patience: ArrayLike = 1.0,
        memory: ArrayLike = 60.0,
        turning: ArrayLike = 0.2,
        num_sectors: int = 16,
        num_elevations: int = 5,
        max_clearance: float = 1.2,
    ) -> None:
        _kinds.instance("sensors", sensors, list, tuple)
        for each in sensors:
            _kinds.instance("sensors", each, VolumeSensor)
        if not sensors:
            raise ValueError("sensors is empty; accepted: one sensor or more")
        _kinds.instance("sensor_model", sensor_model, InverseSensorModel, may_be_none=True)
        self.sensors = tuple(sensors)
        self.sensor_model = InverseSensorModel() if sensor_model is None else sensor_model
        self.required = _checks.scalar("radius", radius, above=0.0) + _checks.scalar(
            "margin", margin, at_least=0.0
        )
        self.decay_length = _checks.scalar("decay_length", decay_length, above=0.0)
        self.min_information = _checks.scalar("min_information", min_information, above=0.0)
        self.occupancy_prior = _checks.scalar(
            "occupancy_prior", occupancy_prior, above=0.0, below=1.0
        )
        self.patience = _checks.scalar("patience", patience, above=0.0)
        self.memory = _checks.scalar("memory", memory, above=0.0)
        self.turning = _checks.scalar("turning", turning, at_least=0.0)
        side = _checks.number("resolution", resolution, above=0.0)
        leading = self.sensors[0]
        self.pool = max(1, round(COARSE / side))
        length = leading.max_range / (self.pool * side)
        self.table = VoxelTable(num_sectors, num_elevations, *leading.elevations, length, NODE)
        self.in_view = on_device(sectors_in_view(num_sectors, leading.field_of_view))
        self.towards = on_device(turn_shares(num_sectors))
        self.reach = math.ceil(_checks.number("max_clearance", max_clearance, above=0.0) / side)
        farthest = max(each.max_range for each in self.sensors)
        self.box = 2 * (math.ceil(farthest / side) + self.reach + 1)

    @property
    def needs_turning(self) -> bool:
        """Whether the first sensor sees less than a full circle, so that the robot must turn it."""
        return self.sensors[0].field_of_view < 2.0 * math.pi

    def init(self, grid: VoxelGrid, position: Float[Array, "3"]) -> VolumeBelief:
        """Return the belief before the first scan.

        No sensor sees where the robot itself is, so the ball that it needs is known to be free.

        Args:
            grid: log-odds of the voxels that are known in advance.
            position: position (x, y, z) of the robot [m].
        """
        side = grid.resolution
        depth, height, width = grid.shape
        z, y, x = jnp.meshgrid(
            *(jnp.arange(n, dtype=jnp.float32) + 0.5 for n in (depth, height, width)),
            indexing="ij",
        )
        gap = jnp.stack([z, y, x]) - grid.to_grid(position)[:, None, None, None]
        is_in = jnp.sum(gap * gap, axis=0) * side**2 <= (self.required + 2.0 * side) ** 2
        is_new = is_in & grid.is_unknown
        known = jnp.where(is_new, self.sensor_model.free, grid.log_odds)
        grid = eqx.tree_at(lambda each: each.log_odds, grid, known)
        field = VolumeField(jnp.zeros(grid.shape), grid.origin + 0.5 * side, side, jnp.zeros(()))
        clearance = eqx.tree_at(
            lambda each: each.values, field, self._clearance(grid, field.values, position)
        )
        guidance = self.blank_field(grid)
        nothing = jnp.zeros((self.table.num_sectors, *guidance.values.shape))
        return VolumeBelief(
            position,
            grid,
            clearance,
            ViewField(nothing, guidance.origin, guidance.spacing),
            ViewField(nothing, guidance.origin, guidance.spacing),
            guidance,
            nothing,
        )

    def update(
        self,
        belief: VolumeBelief,
        position: Float[Array, "3"],
        rotation: Rotation,
        scans: Sequence[VolumeScan],
    ) -> VolumeBelief:
        """Return the belief after scans: the map, and the clearance where it may have changed."""
        grid = belief.grid
        for sensor, scan in zip(self.sensors, scans, strict=True):
            grid = sensor.updated(grid, position, rotation, scan, self.sensor_model)
        clearance = self._clearance(grid, belief.clearance.values, position)
        known: VolumeBelief = eqx.tree_at(
            lambda each: (each.position, each.grid, each.clearance.values),
            belief,
            (position, grid, clearance),
        )
        return known

    def update_fields(
        self,
        belief: VolumeBelief,
        position: Float[Array, "3"],
        heading: Scalar,
        elapsed: Scalar,
    ) -> VolumeBelief:
        """Return the belief with new fields of information and guidance.

        With I_a the information of sector a at a node s, d the length of the path to it, and D_a
        the time spent near it with the sector in view, and a tenth of the other time near it, the
        cost-to-go is

            U(x) = min over s of d(x, s) - decay_length ln W(s)
            W(s) = sum over a of I_a(s) exp(-D_a(s) / patience)

        The attention at a heading h is the information in view, and of each sector, whether it is
        in view or not, `turning (1 + cos(h - h_a)) / 2`. Without it, a robot that looks away from
        the only information would not know which way to turn.

        Args:
            belief: the belief.
            position: position (x, y, z) of the robot [m].
            heading: its heading [rad].
            elapsed: time since the last update [s].
        """
        grid = belief.grid
        shape, *_ = self._lattice(grid)
        sectors = self.table.information(self.pooled(grid), (1, 1, 1), shape, self.sensor_model)
        # By volume, so that the information does not depend on the resolution.
        sectors = sectors * (grid.resolution * self.pool) ** 3
        roads = self.roads(belief)
        dwell = self._dwelt(belief, roads.distances(position), heading, elapsed)
        sectors = sectors * jnp.exp(-dwell / self.patience)
        guidance = roads.field(
            information_sources(sectors.sum(axis=0), self.decay_length, self.min_information)
        )
        views, attention = (
            jnp.einsum("ha,adrc->hdrc", shares, sectors)
            for shares in (self.in_view, self.in_view + self.turning * self.towards)
        )
        known: VolumeBelief = eqx.tree_at(
            lambda each: (
                each.information.values,
                each.attention.values,
                each.guidance,
                each.dwell,
            ),
            belief,
            (views, attention, guidance, dwell),
        )
        return known

    def roads(self, belief: VolumeBelief) -> VolumeRoads:
        """Return the lattice of the places at which the robot fits; tight ones cost double."""
        shape, origin, spacing = self._lattice(belief.grid)
        # Half-way between the nodes, too, the robot must fit.
        room = blocks(belief.clearance.values, self.pool).min(axis=-1)
        half = room[1:, 1:, 1:][: 2 * shape[0] - 1, : 2 * shape[1] - 1, : 2 * shape[2] - 1]
        tightness = jnp.clip(3.0 - half[::2, ::2, ::2] / self.required, 0.0, 2.0) / 2.0
        return VolumeRoads(half >= self.required, 1.0 + tightness, origin, spacing)

    def _dwelt(
        self,
        belief: VolumeBelief,
        distance: Float[Array, "D H W"],
        heading: Scalar,
        elapsed: Scalar,
    ) -> Float[Array, "A D H W"]:
        """Return the time near each node with each sector in view, with the last one added [s]."""
        near = jnp.clip(2.0 - distance / NEAR, 0.0, 1.0)
        number = self.table.num_sectors
        angle = jnp.where(jnp.isfinite(heading), heading, 0.0)
        index = jnp.round(angle * (number / (2.0 * math.pi))).astype(jnp.int32) % number
        # Also where the robot does not look, so that it leaves a place at which it need not turn.
        shares = jnp.maximum(self.in_view[index], ASIDE)[:, None, None, None]
        is_known = jnp.isfinite(distance) & jnp.isfinite(heading)
        more = jnp.where(is_known, elapsed * shares * near, 0.0)
        return belief.dwell * jnp.exp(-elapsed / self.memory) + more

    def blank_field(self, grid: VoxelGrid) -> VolumeField:
        """Return a cost-to-go that is 0 everywhere, on the lattice of the viewpoints."""
        shape, origin, spacing = self._lattice(grid)
        return VolumeField(jnp.zeros(shape), origin, spacing, jnp.asarray(FAR))

    def _lattice(self, grid: VoxelGrid) -> tuple[tuple[int, int, int], Float[Array, "3"], float]:
        """Return the numbers of nodes along z, y and x, the first node, and the spacing [m]."""
        coarse = [-(-size // self.pool) for size in grid.shape]
        depth, height, width = (max(1, (size - 2) // NODE + 1) for size in coarse)
        side = grid.resolution * self.pool
        return (depth, height, width), grid.origin + 1.5 * side, NODE * side

    def _clearance(
        self, grid: VoxelGrid, before: Float[Array, "D H W"], position: Float[Array, "3"]
    ) -> Float[Array, "D H W"]:
        """Return the clearance with what is new in a box around the robot [m]."""
        sizes = [min(self.box, size) for size in grid.shape]
        here = grid.to_grid(position)
        # Converting NaN to an integer is undefined: it depends on the machine.
        centre = jnp.floor(jnp.where(jnp.isfinite(here), here, 0.0)).astype(jnp.int32)
        most = jnp.asarray([n - m for n, m in zip(grid.shape, sizes, strict=True)])
        corner = list(jnp.clip(centre - jnp.asarray(sizes) // 2, 0, most))
        part = jax.lax.dynamic_slice(grid.log_odds, corner, sizes)
        is_free = eqx.tree_at(lambda each: each.log_odds, grid, part).is_free
        # Beyond the box of the map all is closed.
        squared = squared_distance(_walled(~is_free, corner, grid.shape), self.reach)
        squared = squared[1:-1, 1:-1, 1:-1]
        # From the centre of the nearest closed voxel to its face is half a voxel.
        metres = jnp.maximum(jnp.sqrt(squared) - 0.5, 0.0) * grid.resolution
        # Near the rim of the box, what lies outside could be nearer: there the old value counts, if
        # it is smaller.
        old = jax.lax.dynamic_slice(before, corner, sizes)
        rim = _near_rim(sizes, corner, grid.shape, self.reach)
        metres = jnp.where(rim, jnp.minimum(old, metres), metres)
        return jax.lax.dynamic_update_slice(before, metres, corner)

    def pooled(self, grid: VoxelGrid) -> Float[Array, "D2 H2 W2"]:
        """Return the probability of occupancy of the coarser voxels; unknown ones have the
        prior."""
        is_free, is_occupied = self.pooled_states(grid)
        low, high = self.sensor_model.minimum, self.sensor_model.maximum
        known = jnp.where(is_occupied, jax.nn.sigmoid(high), jax.nn.sigmoid(low))
        return jnp.where(is_occupied | is_free, known, self.occupancy_prior)

    def pooled_states(
        self, grid: VoxelGrid
    ) -> tuple[Bool[Array, "D2 H2 W2"], Bool[Array, "D2 H2 W2"]]:
        """Return the masks of the coarser voxels that are free and occupied.

        One is occupied if any of its voxels is, and free if all of them are.
        """
        return (
            blocks(grid.is_free, self.pool).all(axis=-1),
            blocks(grid.is_occupied, self.pool).any(axis=-1),
        )


def blocks(values: Array, side: int) -> Array:
    """Return the blocks of some voxels on a side along the last axis; an incomplete block repeats
    its last voxels."""
    widths = [(0, -size % side) for size in values.shape]
    padded = jnp.pad(values, widths, mode="edge")
    depth, height, width = (size // side for size in padded.shape)
    split = padded.reshape(depth, side, height, side, width, side).transpose(0, 2, 4, 1, 3, 5)
    return split.reshape(depth, height, width, side**3)


def _walled(closed: Array, corner: list[Array], shape: tuple[int, int, int]) -> Array:
    """Return a box with one more layer around, closed where the map ends."""
    walled = jnp.pad(closed, 1)
    for axis, (begin, size) in enumerate(zip(corner, shape, strict=True)):
        index: list[slice | int] = [slice(None)] * 3
        for side, ends in ((0, begin == 0), (-1, begin + closed.shape[axis] == size)):
            index[axis] = side
            walled = walled.at[tuple(index)].max(ends)
    return walled


def _near_rim(
    sizes: list[int], corner: list[Array], shape: tuple[int, int, int], reach: int
) -> Bool[Array, "d h w"]:
    """Return the mask of the voxels within reach of a rim of a box inside the map."""
    near = jnp.zeros(sizes, bool)
    for axis, (size, begin, most) in enumerate(zip(sizes, corner, shape, strict=True)):
        along = jnp.arange(size)
        low = (along < reach) & (begin > 0)
        high = (along >= size - reach) & (begin + size < most)
        near = near | jnp.expand_dims(low | high, [a for a in range(3) if a != axis])
    return near
