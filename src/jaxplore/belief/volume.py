"""How a robot comes to know a volume: the map, distances, information, guidance."""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Scalar, Vector
from jaxplore._xla import on_device
from jaxplore.belief.coarse_voxels import (
    align_window,
    coarse_room,
    coarse_shape,
    coarse_states,
    update_coarse,
)
from jaxplore.belief.exploration_field import information_sources
from jaxplore.belief.part import ERRAND_RADIUS, Errand, Part, as_parts
from jaxplore.belief.robot_cells import free_around
from jaxplore.belief.rolling_map import BLOCK, RollingMap, check_extents, shift_array, window_shape
from jaxplore.belief.view_field import ViewField, sectors_in_view, time_near, turn_shares
from jaxplore.belief.volume_belief import GoalKnowledge, VolumeBelief
from jaxplore.belief.volume_goal import (
    LOOKS_WITHIN,
    goal_roads,
    look_sources,
    resting_place,
    sees,
    unknown_around,
    way_ahead,
)
from jaxplore.belief.volume_information import update_information
from jaxplore.belief.volume_lattice import NODE, blank_field, points_of, volume_lattice
from jaxplore.belief.volume_roads import FAR, NARROWEST, VolumeRoads
from jaxplore.dynamics.goal import GOAL_RADIUS
from jaxplore.information.voxel_table import VoxelTable
from jaxplore.maps.volume_clearance import clearance_of_volume, update_clearance
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import CERTAIN, VoxelGrid
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
AHEAD = 1.5
"""Distance beyond the greatest range that a moving window keeps around the robot [m]."""


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
        window: extents (x, y, z) of the box around the robot of which map, distances and
            information are kept [m], rounded up to whole blocks; the whole volume when absent. It
            moves with the robot. What leaves it is kept with one byte for each voxel.
        goal: position (x, y, z) to which the robot flies, with z up [m]; it explores when absent.
        goal_heading: heading at the goal [rad]; any when absent.
        goal_radius: distance within which the goal is reached [m].
        unknown_factor: additional cost of a metre of the way to the goal where the robot is not
            known to fit, in metres.
        parts: what the robot knows beside its map, such as `jaxplore.parts.KeepOutBoxes`.

    Raises:
        ValueError: no sensor, a part of another class, a number outside its range, a window beside
            a goal.
    """

    sensors: tuple[VolumeSensor, ...]
    sensor_model: InverseSensorModel
    radius: Scalar
    required: Scalar
    decay_length: Scalar
    min_information: Scalar
    occupancy_prior: Scalar
    patience: Scalar
    memory: Scalar
    turning: Scalar
    goal: Float[Array, "3"] | None
    goal_heading: Scalar | None
    goal_radius: Scalar
    unknown_factor: Scalar
    parts: tuple[Part, ...]
    table: VoxelTable
    in_view: Float[Array, "A A"]
    towards: Float[Array, "A A"]
    rays: Float[Array, "3 R"]
    pool: int = eqx.field(static=True)
    reach: int = eqx.field(static=True)
    extent: int = eqx.field(static=True)
    extents: tuple[float, float, float] | None = eqx.field(static=True)

    @_kinds.check_arguments
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
        window: Vector | None = None,
        goal: Vector | None = None,
        goal_heading: ArrayLike | None = None,
        goal_radius: ArrayLike = GOAL_RADIUS,
        unknown_factor: ArrayLike = 0.5,
        parts: Sequence[Part] = (),
    ) -> None:
        _kinds.instance("sensors", sensors, list, tuple)
        for each in sensors:
            _kinds.instance("sensors", each, VolumeSensor)
        if not sensors:
            raise ValueError("sensors is empty; accepted: one sensor or more")
        self.sensors = tuple(sensors)
        self.sensor_model = InverseSensorModel() if sensor_model is None else sensor_model
        self.radius = _checks.scalar("radius", radius, above=0.0)
        self.required = self.radius + _checks.scalar("margin", margin, at_least=0.0)
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
        self.extents = None
        if window is not None:
            x, y, z = (round(float(each), 4) for each in _checks.vector("window", window, 3))
            if not min(x, y, z) > 0.0:
                raise ValueError(f"window is {[x, y, z]}; accepted: three lengths above 0")
            self.extents = (x, y, z)
        self.goal = None if goal is None else _checks.vector("goal", goal, 3)
        self.goal_heading = (
            None if goal_heading is None else _checks.scalar("goal_heading", goal_heading)
        )
        self.goal_radius = _checks.scalar("goal_radius", goal_radius, above=0.0)
        self.unknown_factor = _checks.scalar("unknown_factor", unknown_factor, at_least=0.0)
        self.parts = as_parts(parts, (), None, dimensions=3)
        if goal is None and goal_heading is not None:
            raise ValueError("goal_heading is given without a goal; accepted: with one")
        sent = [part.name for part in self.parts if part.has_errands]
        if self.extents is not None and (sent or goal is not None):
            beside = "a goal" if goal is not None else f"the part {sent[0]}"
            raise ValueError(
                f"window is {list(self.extents)} beside {beside}, whose way the whole map has; "
                "accepted: one of them"
            )

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
        grid = free_around(grid, position, self.required, self.sensor_model)
        shape, beyond = self.window_shape(grid.shape, grid.resolution), None
        if shape != grid.shape:
            beyond, grid = RollingMap.around(grid, position, shape, self._block, self.sensor_model)
        nothing = jnp.zeros((self.table.num_sectors, *volume_lattice(grid, self.pool)[0]))
        everywhere = jnp.ones(coarse_shape(grid.shape, self.pool)[1:], bool)
        return self._make_belief(position, grid, everywhere, nothing, nothing, beyond)

    def window_shape(self, shape: tuple[int, int, int], side: float) -> tuple[int, int, int]:
        """Return the numbers of voxels (D, H, W) of which the belief of a volume is.

        Args:
            shape: those of the volume.
            side: side of a voxel [m].

        Raises:
            ValueError: a window so small that the robot would see beyond it.
        """
        if self.extents is None:
            return shape
        check_extents(self.extents, shape, side, self._block, self._kept_ahead)
        return window_shape(shape, self.extents, side, self._block)

    @property
    def _block(self) -> int:
        """Voxels on a side of the blocks by which the window moves."""
        return self.pool * NODE * BLOCK

    @property
    def _kept_ahead(self) -> float:
        """Distance to a face of the window, inside the volume, at which the window moves [m]."""
        return max(each.max_range for each in self.sensors) + AHEAD

    def _make_belief(
        self,
        position: Float[Array, "3"],
        grid: VoxelGrid,
        changed: Bool[Array, "H2 W2"],
        sectors: Float[Array, "A D H W"],
        dwell: Float[Array, "A D H W"],
        beyond: RollingMap | None,
    ) -> VolumeBelief:
        """Return a belief with what follows from its grid, before the next fields."""
        states = {part.name: part.init(grid) for part in self.parts}
        barred = self._barred_by(states)
        errands = [part.errand(states[part.name]) for part in self.parts if part.has_errands]
        clearance = clearance_of_volume(grid, self.reach, _close(~grid.is_free, barred))
        goal = None
        if self.goal is not None:
            solid = _close(grid.is_occupied, barred)
            walls = clearance_of_volume(grid, self.reach, solid).values
            room, way = coarse_room(walls, self.pool), jnp.zeros(2)
            goal = GoalKnowledge(
                *(self.goal, self.goal_heading, self.goal_radius, walls, room, way),
                *(self.goal, jnp.array(False)),
            )
        guidance = blank_field(grid, self.pool)
        view = ViewField(jnp.zeros_like(sectors), guidance.origin, guidance.spacing)
        return VolumeBelief(
            position,
            grid,
            clearance,
            view,
            view,
            guidance,
            coarse_states(_see_through(grid, barred), self.pool),
            coarse_room(clearance.values, self.pool),
            changed,
            sectors,
            dwell,
            beyond,
            goal,
            states,
            errand=errands[0] if errands else None,
        )

    def part_named(self, name: str) -> Part | None:
        """Return the part with a name; None without it."""
        return next((part for part in self.parts if part.name == name), None)

    def barred_voxels(self, grid: VoxelGrid) -> Bool[Array, "D H W"] | None:
        """Return the voxels that the robot must not enter, or None if it may enter all.

        Args:
            grid: a map.
        """
        return self._barred_by({part.name: part.init(grid) for part in self.parts})

    def _barred_by(self, states: Mapping[str, Any]) -> Bool[Array, "D H W"] | None:
        """Return the voxels that the parts bar, given the states of these; None without any."""
        given = [part.closed_cells(states[part.name]) for part in self.parts]
        barred = [each for each in given if each is not None]
        return functools.reduce(jnp.logical_or, barred) if barred else None

    def update(
        self,
        belief: VolumeBelief,
        position: Float[Array, "3"],
        rotation: Rotation,
        scans: Sequence[VolumeScan],
    ) -> VolumeBelief:
        """Return the belief after scans: the map, and all that follows from it within reach."""
        window = self.scan_window(belief.grid, position, rotation)
        grid = belief.grid
        for sensor, scan in zip(self.sensors, scans, strict=True):
            grid = sensor.update(grid, position, rotation, scan, self.sensor_model, window)
        barred = self._barred_by(belief.parts)
        closed = None if barred is None else ~grid.is_free | barred
        clearance = update_clearance(grid, belief.clearance.values, window, self.reach, closed)
        seen = eqx.tree_at(lambda each: each.log_odds, grid, window.read(grid.log_odds))
        seen = _see_through(seen, None if barred is None else window.read(barred))
        states, rooms = (
            coarse_states(seen, self.pool),
            coarse_room(window.read(clearance), self.pool),
        )
        coarse, is_new, among = update_coarse(belief.coarse, states, window, self.pool)
        room, _, _ = update_coarse(belief.room, rooms, window, self.pool)
        columns = Window(among.corner[1:], among.shape[1:], among.map_shape[1:])
        before = columns.read(belief.changed)
        changed = columns.write(belief.changed, before | is_new.any(axis=0))
        goal = belief.goal
        if goal is not None:
            solid = _close(grid.is_occupied, barred)
            walls = update_clearance(grid, goal.walls, window, self.reach, solid)
            wide = coarse_room(window.read(walls), self.pool)
            wall_room, _, _ = update_coarse(goal.room, wide, window, self.pool)
            goal = dataclasses.replace(goal, walls=walls, room=wall_room)
        return dataclasses.replace(
            belief,
            position=position,
            grid=grid,
            clearance=dataclasses.replace(belief.clearance, values=clearance),
            coarse=coarse,
            room=room,
            changed=changed,
            goal=goal,
        )

    def scan_window(
        self, grid: VoxelGrid, position: Float[Array, "3"], rotation: Rotation
    ) -> Window:
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
        return align_window(first - margin, shape, grid.shape, self.pool)

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

        A window that moves is taken to be stored (`VolumeBelief.store_window`). Nodes at its inner
        faces are places s as well, with the cost of the straight way to what was left outside: see
        `RollingMap.toward_the_rest`.

        With a goal, the cost-to-go is that of `goal_roads` to the goal instead. On an errand that
        is due it is that to its place through known free space, and nothing has information.

        The attention at a heading h is the information in view, and of each sector, whether it is
        in view or not, `turning (1 + cos(h - h_a)) / 2`. Without it, a robot that looks away from
        the only information would not know which way to turn.

        Args:
            belief: the belief.
            position: position (x, y, z) of the robot [m].
            heading: its heading [rad].
            elapsed: time since the last update [s].
        """
        belief = self._roll_window(belief, position)
        every_sector = update_information(
            self.table,
            self.sensor_model,
            self.occupancy_prior,
            belief.coarse,
            belief.grid.resolution * self.pool,
            belief.changed,
            belief.sectors,
        )
        roads = self.roads(belief)
        distance = roads.distances(position)
        dwell = time_near(belief.dwell, distance, self.in_view, heading, elapsed, self.memory)
        sectors = every_sector * jnp.exp(-dwell / self.patience)
        worth = sectors.sum(axis=0)
        source = information_sources(worth, self.decay_length, self.min_information)
        if belief.beyond is not None:
            at_faces = belief.beyond.ends(
                belief.grid,
                roads,
                self._block,
                self.decay_length,
                self.min_information,
                self.reach * belief.grid.resolution,
            )
            source = jnp.minimum(source, at_faces)
        guidance, goal = roads.field(source), belief.goal
        if goal is not None:
            guidance, goal = self._guide_to(goal, belief, roads, dwell, position)
        views, attention = (
            jnp.einsum("ha,adrc->hdrc", shares, sectors)
            for shares in (self.in_view, self.in_view + self.turning * self.towards)
        )
        states, errand = belief.parts, belief.errand
        if errand is not None:
            states, errand, lengths = self._plan_errands(belief, roads, position)
            is_due, way = errand.is_due, roads.extend(lengths, roads.is_open)
            guidance = jax.tree.map(functools.partial(jnp.where, is_due), way, guidance)
            views, attention = (jnp.where(is_due, 0.0, each) for each in (views, attention))
            if goal is not None and self.goal is not None:
                ahead = jnp.where(is_due, way_ahead(lengths, roads, position), goal.way)
                goal = dataclasses.replace(
                    goal,
                    position=jnp.where(is_due, errand.place, self.goal),
                    way=ahead,
                    place=jnp.where(is_due, errand.place, goal.place),
                    fits=is_due | goal.fits,
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
        return dataclasses.replace(known, goal=goal, parts=states, errand=errand)

    def _plan_errands(
        self, belief: VolumeBelief, roads: VolumeRoads, position: Float[Array, "3"]
    ) -> tuple[dict[str, Any], Errand, Float[Array, "D H W"]]:
        """Return the states of parts with the decisions whether their errands are due, the errand
        of the first part for which one is, and the cost-to-go to its place [m]."""
        states: dict[str, Any] = dict(belief.parts)
        found: tuple[Errand, Float[Array, "D H W"]] | None = None
        for part in self.parts:
            errand = part.errand(states[part.name]) if part.has_errands else None
            if errand is None:
                continue
            lengths = roads.lengths_from(errand.place)
            cost = roads.extend(lengths)(position)
            # A node behind a wall is farther from a place at which the robot fits.
            is_known = (lengths.min() <= 2.0 * self.required) & (cost < FAR)
            own = part.plan_errand(states[part.name], jnp.where(is_known, cost, jnp.inf))
            states[part.name], planned = own, part.errand(own)
            assert planned is not None
            reach, field = jnp.asarray(ERRAND_RADIUS, jnp.float32), belief.clearance
            rest, _ = resting_place(field, field, planned.place, reach, self.radius)
            planned = planned._replace(place=rest)
            if found is None:
                found = planned, lengths
            else:
                first, ways = found
                place = jnp.where(first.is_due, first.place, planned.place)
                both = Errand(place, first.is_due | planned.is_due)
                found = both, jnp.where(first.is_due, ways, lengths)
        assert found is not None
        return states, *found

    def _guide_to(
        self,
        goal: GoalKnowledge,
        belief: VolumeBelief,
        roads: VolumeRoads,
        dwell: Float[Array, "A D H W"],
        position: Float[Array, "3"],
    ) -> tuple[VolumeField, GoalKnowledge]:
        """Return the cost-to-go to the goal, and the direction in which it leads.

        Near a goal where the robot is not known to fit, it is the cost-to-go to where the robot
        would see what is unknown there: from too near, it is out of the view.
        """
        near = dwell.max(axis=0) / self.patience
        room = points_of(goal.room, roads.slowness.shape)
        needed = self.required, self._least(belief.grid.resolution)
        ways = goal_roads(roads, room, *needed, near, self.unknown_factor)
        walls = dataclasses.replace(belief.clearance, values=goal.walls)
        # On an errand `goal.position` is its place.
        wanted = goal.position if self.goal is None else self.goal
        place, fits = resting_place(belief.clearance, walls, wanted, goal.radius, self.radius)
        ends = ways.around(place)
        first = self.sensors[0]
        view = belief.grid, first.elevations, first.max_range

        def look() -> tuple[Array, Array, Array]:
            point = unknown_around(belief.grid, place, self.radius)
            source = look_sources(view[0], roads, *view[1:], dwell / self.patience, point)
            is_seen = sees(*view, position[None], point)[0]
            gap = (point - position)[:2]
            facing = gap / jnp.maximum(jnp.sqrt(jnp.sum(gap * gap)), 1e-3)
            looks = jnp.isfinite(source).any()
            return jnp.where(looks, source, ends), looks & is_seen, facing

        away = place - position
        is_near = jnp.sum(away * away) < LOOKS_WITHIN * LOOKS_WITHIN
        nothing = jnp.array(False), jnp.zeros(2)
        source, faces, facing = jax.lax.cond(~fits & is_near, look, lambda: (ends, *nothing))
        costs = ways.lengths(source)
        way = jnp.where(faces, facing, way_ahead(costs, ways, position))
        guidance = ways.extend(costs, roads.is_open)
        return guidance, dataclasses.replace(goal, way=way, place=place, fits=fits)

    def _roll_window(self, belief: VolumeBelief, position: Float[Array, "3"]) -> VolumeBelief:
        """Return the belief with its window around the robot, if that is near a face of it."""
        beyond, grid = belief.beyond, belief.grid
        if beyond is None:
            return belief
        is_due, offset = beyond.next_offset(grid, position, self._kept_ahead, self._block)
        rest, stored = belief.split()

        def move() -> VolumeBelief:
            worth = jnp.sum(belief.sectors * jnp.exp(-belief.dwell / self.patience), axis=0)
            # Behind the walls of a building, too, there is much that is not known.
            worth = jnp.where(self.roads(belief).is_open, worth, 0.0)
            left = beyond.with_left(grid.shape, worth, self._block)
            there = eqx.tree_at(lambda each: (each.offset, each.left), beyond, (offset, left))
            shift = (offset - beyond.offset) // self.pool
            is_old = shift_array(jnp.ones_like(belief.coarse, bool), shift).all(axis=0)
            changed = shift_array(belief.changed[None], shift.at[0].set(0))[0]
            sectors, dwell = (
                shift_array(each, shift // NODE) for each in (belief.sectors, belief.dwell)
            )
            window = there.window(grid, grid.shape)
            made = self._make_belief(position, window, changed | ~is_old, sectors, dwell, there)
            return dataclasses.replace(made, obstacles=belief.obstacles).split()[0]

        known: VolumeBelief = eqx.combine(jax.lax.cond(is_due, move, lambda: rest), stored)
        return known

    def roads(self, belief: VolumeBelief) -> VolumeRoads:
        """Return the lattice of the places at which the robot fits; tight ones cost double."""
        shape, origin, spacing = volume_lattice(belief.grid, self.pool)
        # Half-way between the nodes, too, the robot must fit.
        half = points_of(belief.room, shape)
        tightness = jnp.clip(3.0 - half[::2, ::2, ::2] / self.required, 0.0, 2.0) / 2.0
        least = self._least(belief.grid.resolution)
        return VolumeRoads(half >= least, 1.0 + tightness, origin, spacing)

    def _least(self, side: float) -> Scalar:
        """Return the clearance of a place where a path may lead, with voxels of a side [m]."""
        # The tolerance counts a clearance of just that as a path that jumps.
        return jnp.maximum(self.required, (NARROWEST + 1e-3) * side)

    def blank_field(self, grid: VoxelGrid) -> VolumeField:
        """Return a cost-to-go that is 0 everywhere, on the lattice of a volume's viewpoints."""
        shape = self.window_shape(grid.shape, grid.resolution)
        window = eqx.tree_at(lambda each: each.log_odds, grid, jnp.zeros(shape))
        return blank_field(window, self.pool)


def _close(
    closed: Bool[Array, "D H W"], barred: Bool[Array, "D H W"] | None
) -> Bool[Array, "D H W"]:
    """Return the closed voxels with those that the robot must not enter."""
    return closed if barred is None else closed | barred


def _see_through(grid: VoxelGrid, barred: Bool[Array, "D H W"] | None) -> VoxelGrid:
    """Return a grid in which what the robot must not enter is free, unless it is known to be
    occupied: nothing is to be learned there."""
    if barred is None:
        return grid
    log_odds = jnp.where(barred & ~grid.is_occupied, -CERTAIN, grid.log_odds)
    clear: VoxelGrid = eqx.tree_at(lambda each: each.log_odds, grid, log_odds)
    return clear
