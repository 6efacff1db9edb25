"""What a robot knows of a volume, and what follows from it: distances, information, guidance."""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Scalar
from jaxplore._xla import on_device
from jaxplore.belief.coarse_voxels import (
    OCCUPIED,
    UNKNOWN,
    aligned_window,
    coarse_room,
    coarse_states,
    renewed,
    within_reach,
)
from jaxplore.belief.exploration_field import information_sources
from jaxplore.belief.view_field import ViewField, sectors_in_view, turn_shares
from jaxplore.belief.volume_roads import FAR, VolumeRoads
from jaxplore.information.stale_tiles import first_group
from jaxplore.information.voxel_table import VoxelTable
from jaxplore.maps.volume_clearance import renewed_clearance
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.maps.window import Window
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.volume import (
    Rotation,
    VolumeScan,
    VolumeSensor,
    greatest_extent,
    ray_ends,
)

COARSE = 0.2
"""Side of the coarser voxels in which information is computed [m], where the map's are finer."""
NODE = 2
"""Coarser voxels between the nodes of the lattice."""
TILE = 24
"""Nodes along x and y that are computed at a time: their arrays fit the CPU's cache."""
BEYOND = 3
"""State of what is beyond the map."""
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
        coarse: states of the coarser voxels in which information is computed.
        room: least clearance in each of them [m].
        changed: columns of coarser voxels with one whose state has changed since the information
            was last computed.
        sectors: (A, D, H, W) information of each sector from each node, without the discount of the
            time spent [nat m^3].
        dwell: (A, D, H, W) time spent near each node with each sector in view, recent time counting
            more [s].
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
    rays: Float[Array, "3 R"]
    pool: int = eqx.field(static=True)
    reach: int = eqx.field(static=True)
    extent: int = eqx.field(static=True)

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
        self.rays = on_device(ray_ends(self.sensors))
        self.extent = math.ceil(greatest_extent(self.sensors) / side)

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
        whole = Window.at(jnp.zeros(3, jnp.int32), grid.shape, grid.shape)
        clearance = eqx.tree_at(
            lambda each: each.values,
            field,
            renewed_clearance(grid, field.values, whole, self.reach),
        )
        guidance = self.blank_field(grid)
        nothing = jnp.zeros((self.table.num_sectors, *guidance.values.shape))
        coarse = coarse_states(grid, self.pool)
        return VolumeBelief(
            position,
            grid,
            clearance,
            ViewField(nothing, guidance.origin, guidance.spacing),
            ViewField(nothing, guidance.origin, guidance.spacing),
            guidance,
            coarse,
            coarse_room(clearance.values, self.pool),
            jnp.ones(coarse.shape[1:], bool),
            nothing,
            nothing,
        )

    def update(
        self,
        belief: VolumeBelief,
        position: Float[Array, "3"],
        rotation: Rotation,
        scans: Sequence[VolumeScan],
    ) -> VolumeBelief:
        """Return the belief after scans: the map, and all that follows from it within reach."""
        window = self.window(belief.grid, position, rotation)
        grid = belief.grid
        for sensor, scan in zip(self.sensors, scans, strict=True):
            grid = sensor.updated(grid, position, rotation, scan, self.sensor_model, window)
        clearance = renewed_clearance(grid, belief.clearance.values, window, self.reach)
        seen = eqx.tree_at(lambda each: each.log_odds, grid, window.read(grid.log_odds))
        coarse, among = renewed(belief.coarse, coarse_states(seen, self.pool), window, self.pool)
        room, _ = renewed(
            belief.room, coarse_room(window.read(clearance), self.pool), window, self.pool
        )
        is_new = jnp.any(among.read(coarse) != among.read(belief.coarse), axis=0)
        columns = Window(among.corner[1:], among.shape[1:], among.map_shape[1:])
        changed = columns.write(belief.changed, columns.read(belief.changed) | is_new)
        known: VolumeBelief = eqx.tree_at(
            lambda each: (
                each.position,
                each.grid,
                each.clearance.values,
                each.coarse,
                each.room,
                each.changed,
            ),
            belief,
            (position, grid, clearance, coarse, room, changed),
        )
        return known

    def window(self, grid: VoxelGrid, position: Float[Array, "3"], rotation: Rotation) -> Window:
        """Return the box of voxels in which scans may change the map and the clearance.

        Args:
            grid: the map.
            position: position (x, y, z) of the robot [m].
            rotation: rotation from the body to the world.
        """
        ends = position[:, None] + rotation @ self.rays
        low = grid.to_grid(jnp.minimum(position, ends.min(axis=1)))
        # Converting NaN to an integer is undefined: it depends on the machine.
        first = jnp.floor(jnp.where(jnp.isfinite(low), low, 0.0)).astype(jnp.int32)
        # The clearance changes within reach of what is seen, and is computed from what is within
        # reach of that. A return lies up to half a voxel behind its reading.
        margin = 2 * self.reach + 1
        shape = [self.extent + 2 + 2 * margin] * 3
        return aligned_window(first - margin, shape, grid.shape, self.pool)

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
        every_sector = self._information(belief)
        roads = self.roads(belief)
        dwell = self._dwelt(belief, roads.distances(position), heading, elapsed)
        sectors = every_sector * jnp.exp(-dwell / self.patience)
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
                each.changed,
                each.sectors,
                each.dwell,
            ),
            belief,
            (
                views,
                attention,
                guidance,
                jnp.zeros_like(belief.changed),
                every_sector,
                dwell,
            ),
        )
        return known

    def _information(self, belief: VolumeBelief) -> Float[Array, "A D H W"]:
        """Return the information of each sector from each node [nat m^3].

        Only nodes within reach of what has changed are computed, tile by tile.
        """
        depth, rows, columns = belief.sectors.shape[1:]
        tile, reach = (min(TILE, rows), min(TILE, columns)), self.table.reach
        stale = within_reach(belief.changed, reach, 1, NODE, (rows, columns))
        # Beyond the map nothing passes and nothing is learned: that of certainly occupied voxels.
        margin = (reach, reach + NODE)
        states = jnp.pad(belief.coarse, ((0, 0), margin, margin), constant_values=BEYOND)
        cut = (states.shape[0], *(NODE * (size - 1) + 1 + 2 * reach for size in tile))

        def renew(state: tuple[Array, Array]) -> tuple[Array, Array]:
            is_stale, sectors = state
            node = first_group(is_stale, tile)
            begin = NODE * node + 1
            part = jax.lax.dynamic_slice(states, (0, begin[0], begin[1]), cut)
            found = self.table.information(
                self._probability(part), (1, reach, reach), (depth, *tile), self.sensor_model
            )
            # By volume, so that the information does not depend on the resolution.
            found = found * (belief.grid.resolution * self.pool) ** 3
            at = Window(node, tile, (rows, columns))
            return at.write(is_stale, jnp.zeros(tile, bool)), at.write(sectors, found)

        _, sectors = jax.lax.while_loop(
            lambda state: jnp.any(state[0]), renew, (stale, belief.sectors)
        )
        return sectors

    def _probability(self, states: Int[Array, "*N"]) -> Float[Array, "*N"]:
        """Return the probability of occupancy of coarser voxels; unknown ones have the prior."""
        low, high = self.sensor_model.minimum, self.sensor_model.maximum
        known = jnp.where(states == OCCUPIED, jax.nn.sigmoid(high), jax.nn.sigmoid(low))
        probability = jnp.where(states == UNKNOWN, self.occupancy_prior, known)
        return jnp.where(states == BEYOND, 1.0, probability)

    def roads(self, belief: VolumeBelief) -> VolumeRoads:
        """Return the lattice of the places at which the robot fits; tight ones cost double."""
        shape, origin, spacing = self._lattice(belief.grid)
        # Half-way between the nodes, too, the robot must fit.
        half = belief.room[1:, 1:, 1:][: 2 * shape[0] - 1, : 2 * shape[1] - 1, : 2 * shape[2] - 1]
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
