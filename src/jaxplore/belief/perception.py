"""Update the belief: the map from scans, and the fields that are derived from the map."""

import dataclasses
import functools
import math
import operator
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_DIRECTIONS
from jaxplore._trees import with_field
from jaxplore._types import ArrayLike, Flag, GridMask, GridValues, Pose, Position, Scalar, Vector
from jaxplore._xla import compute
from jaxplore.belief.belief import Belief
from jaxplore.belief.car import CarMotion
from jaxplore.belief.dwell import add_dwell, dwell_discount, with_given_up
from jaxplore.belief.exploration_field import (
    GOAL_DETOUR,
    exploration_field,
    goal_field,
    leads_to_goal,
)
from jaxplore.belief.gain import Gain
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.part import Errand, Observation, Part, as_parts
from jaxplore.belief.perception_checks import (
    as_scans,
    as_sensors,
    narrow_clearance,
    safe_stride,
)
from jaxplore.belief.roadmap import ROOMY, Locomotion, TurnsOnTheSpot
from jaxplore.belief.robot_cells import free_below
from jaxplore.belief.tracks import ObstacleTracker
from jaxplore.belief.zones import unknown_fraction
from jaxplore.information.field import InformationField
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.maps.clearance import clearance_field, find_closed_cells, update_clearance
from jaxplore.maps.field import ScalarField
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.window import Window
from jaxplore.sensing.base import Sensor, update_grid
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

LEFTOVER = 0.1
"""Default of `min_information` times the area of a cell [nat m^2]: the information of about one
square metre of unmeasured cells, of whatever size."""
BLUR = 3.0
"""Factor on `LEFTOVER` where the pose is estimated. Scans from poses with small errors contradict
one another at walls, whose cells stay uncertain however often they are seen."""
MAX_UNKNOWN = 0.05
"""Default share of unknown cells below which a map counts as explored (quadrotor design notes)."""
IGNORED = 1e-4
"""Probability of occupancy of what is unknown where the robot must not be: a beam through ten
metres of it loses one per cent, and has no information of it."""


class Perception(eqx.Module):
    """Builds and updates a `Belief` from scans.

    The guidance field is the cost-to-go of `jaxplore.belief.exploration_field`. Its sources are
    the places with information, and the goal if there is one. The goal is the only source once less
    than `max_unknown` of the map is unknown. If the ground is known, cells that it blocks are
    closed.

    An unmeasured cell has probability 1/2, which represents ignorance. If expected beams used this
    value, every second unknown cell would stop them: unknown space would be a rim of two cells, and
    a gap behind a shelf would have as much information as an unexplored hall. Therefore information
    is computed with the probability `occupancy_prior` for these cells, about the share of occupied
    cells in buildings.

    The robot may have `parts` beside its map, such as `jaxplore.parts.IdlenessMap`. They learn from
    the scans of the first sensor, and add to the information field, so that guidance leads to
    places that tell them something.

    Args:
        sensors: sensor of the robot, or several. All of them update the map. Information and
            idleness are those of the first.
        resolution: side of a map cell [m].
        robot_radius: radius of the robot's disc [m].
        sensor_model: inverse sensor model; `InverseSensorModel()` by default.
        num_directions: number of directions in which information is evaluated; at least 4.
        node_spacing: distance between the nodes of the fields [m]; rounded to whole cells, and
            reduced so that no path can jump a wall.
        max_clearance: upper bound of the clearance field [m]; raised if the robot needs more.
        margin: clearance that a path needs beyond the radius [m]. A robot
            takes passages with 40 % of it when little else is left (`NARROW_PRICE`).
        decay_length: additional distance that the robot travels for e times the information [m].
        min_information: information below which a place comes last [nat]; below 3 % of it, a place
            is ignored. By default it is that of about one square metre of unmeasured cells
            (`LEFTOVER`): 10 nat for cells of 0.1 m, 40 for those of 0.05 m. With `is_localising` it
            is three times as much (`BLUR`).
        occupancy_prior: probability of occupancy of an unmeasured cell in expected information, in
            (0, 1).
        patience: time near a place after which its weight has decayed to 1/e [s].
        memory: time constant with which `dwell` is forgotten [s].
        goal: position (x, y) to which the robot goes in the end [m]; no goal by default.
        goal_heading: heading at the goal [rad]; any when absent.
        max_unknown: share of cells with `4 p (1 - p) > 1/2` below which the map counts as explored;
            used only with a goal.
        ground: ground of the map's cells; level and traversable by default.
        is_goal_apart: whether the goal gets a cost-to-go of its own, `Belief.to_goal`, instead of
            being a source of the guidance field; static.
        unknown_factor: additional cost per metre of unknown space in that cost-to-go.
        car: how a robot moves that cannot turn on the spot; by default it can.
        parts: what the robot has beside its map (`jaxplore.parts`); nothing by default.
        is_localising: whether the robot estimates its pose. It decides the default of
            `min_information`. When the robot has seen nothing new for `memory`, each place that a
            look takes below `min_information` counts as one where it has stayed for twice
            `patience` more. Not so with parts for which places must be seen again.
        tracker: what finds and tracks moving obstacles in the scans; without it they are mapped
            like all else.

    Raises:
        ValueError: a size, rate or length out of its range; no sensors; `is_goal_apart` without a
            goal; two parts of one name, or a part without another that it needs or with a sensor or
            ground that it does not allow; a tracker with a ground, whose hills return beams like
            what moves.
    """

    sensors: tuple[Sensor, ...]
    sensor_model: InverseSensorModel
    field_sensor: FieldSensor
    locomotion: Locomotion
    max_clearance: float = eqx.field(static=True)
    required_clearance: Scalar
    decay_length: Scalar
    min_information: Scalar
    occupancy_prior: Scalar
    patience: Scalar
    memory: Scalar
    goal: Position | None
    goal_heading: Scalar | None
    max_unknown: Scalar
    ground: Ground | None
    parts: tuple[Part, ...]
    unknown_factor: Scalar
    is_goal_apart: bool = eqx.field(static=True)
    is_batched: bool = eqx.field(static=True)
    resolution: float = eqx.field(static=True)
    gives_up: bool = eqx.field(static=True)
    tracker: ObstacleTracker | None

    @_kinds.check_arguments
    def __init__(
        self,
        sensors: Sensor | Sequence[Sensor],
        resolution: float,
        robot_radius: ArrayLike,
        *,
        sensor_model: InverseSensorModel | None = None,
        num_directions: int = 32,
        node_spacing: float = 0.2,
        max_clearance: float = 1.0,
        margin: ArrayLike = 0.05,
        decay_length: ArrayLike = 8.0,
        min_information: ArrayLike | None = None,
        occupancy_prior: ArrayLike = 0.1,
        patience: ArrayLike = 3.0,
        memory: ArrayLike = 60.0,
        goal: Vector | None = None,
        goal_heading: ArrayLike | None = None,
        max_unknown: ArrayLike = MAX_UNKNOWN,
        ground: Ground | None = None,
        is_goal_apart: bool = False,
        unknown_factor: ArrayLike = 0.5,
        car: CarMotion | None = None,
        parts: Sequence[Part] = (),
        is_localising: bool = False,
        tracker: ObstacleTracker | None = None,
    ) -> None:
        _kinds.flag("is_localising", is_localising)
        _kinds.flag("is_goal_apart", is_goal_apart)
        radius = _checks.scalar("robot_radius", robot_radius, above=0.0)
        self.sensors = as_sensors(sensors)
        self.resolution = _checks.number("resolution", resolution, above=0.0)
        self.sensor_model = InverseSensorModel() if sensor_model is None else sensor_model
        _checks.whole_number("num_directions", num_directions, at_least=4, at_most=MOST_DIRECTIONS)
        spacing = _checks.number("node_spacing", node_spacing, above=0.0)
        margin = _checks.scalar("margin", margin, at_least=0.0)
        self.required_clearance = compute(lambda _, *each: each[0] + each[1], radius, margin)
        self.field_sensor = FieldSensor(
            self.sensors[0],
            resolution,
            num_directions,
            safe_stride(spacing, resolution, float(radius), float(self.required_clearance)),
        )
        nodes = self.field_sensor.stride * self.resolution
        narrow = narrow_clearance(
            radius, margin, self.field_sensor.stride, self.resolution, has_corners=car is None
        )
        self.locomotion = TurnsOnTheSpot(narrow) if car is None else car.lattice(nodes, narrow)
        # The clearance field must resolve the clearance at which paths have no extra cost. Whole
        # metres, because the bound is static: robots of similar radius share a compiled program.
        self.max_clearance = max(
            _checks.number("max_clearance", max_clearance, above=0.0),
            float(math.ceil(ROOMY * float(self.required_clearance))),
        )
        self.decay_length = _checks.scalar("decay_length", decay_length, above=0.0)
        if min_information is None:
            leftover = BLUR * LEFTOVER if is_localising else LEFTOVER
            min_information = leftover / self.resolution**2
        self.min_information = _checks.scalar("min_information", min_information, above=0.0)
        self.occupancy_prior = _checks.scalar(
            "occupancy_prior", occupancy_prior, above=0.0, below=1.0
        )
        self.patience = _checks.scalar("patience", patience, above=0.0)
        self.memory = _checks.scalar("memory", memory, above=0.0)
        self.goal = None if goal is None else _checks.vector("goal", goal, 2)
        self.goal_heading = (
            None if goal_heading is None else _checks.scalar("goal_heading", goal_heading)
        )
        self.max_unknown = _checks.scalar("max_unknown", max_unknown, at_least=0.0, at_most=1.0)
        self.ground, self.parts = ground, as_parts(parts, self.sensors, ground)
        self.unknown_factor = _checks.scalar("unknown_factor", unknown_factor, at_least=0.0)
        if is_goal_apart and goal is None:
            raise ValueError("goal is None; accepted: a position, for a goal apart")
        self.is_goal_apart = is_goal_apart
        self.is_batched = False
        if tracker is not None and ground is not None:
            raise ValueError("tracker is given beside a ground; accepted: one of them")
        self.tracker = tracker
        # What must be seen again is not given up.
        is_revisiting = any(each.is_revisiting for each in self.parts)
        self.gives_up = is_localising and not is_revisiting

    def closed_cells(self, grid: OccupancyGrid) -> GridMask | None:
        """Return the cells (H, W) of a map that parts forbid to enter; None if none does.

        Args:
            grid: the map.
        """
        return self._find_cells_closed_by_parts({part.name: part.init(grid) for part in self.parts})

    def part[P: Part](self, kind: type[P]) -> P | None:
        """Return the part of a class; None without it.

        Args:
            kind: the class, such as `jaxplore.parts.IdlenessMap`.
        """
        return next((each for each in self.parts if isinstance(each, kind)), None)

    def part_named(self, name: str) -> Part | None:
        """Return the part of a name; None without it.

        Args:
            name: the name, such as `watch`.
        """
        return next((each for each in self.parts if each.name == name), None)

    def for_batches(self) -> "Perception":
        """Return a copy for use under `jax.vmap`, which recomputes fields instead of updating them.

        The maps of a batch change in different places, and each iteration of a loop over these
        places would copy the fields of all maps. The beliefs are equal.
        """
        return with_field(self, "is_batched", True)

    @_kinds.check_arguments
    def init(self, grid: OccupancyGrid, pose: Pose) -> Belief:
        """Return the belief before the first scan, with the cells under the robot free.

        Args:
            grid: prior map; 0.5 everywhere if nothing is known.
            pose: pose (x, y, yaw) of the robot [m, m, rad].

        Raises:
            ValueError: something else than a grid or a pose.
        """
        pose = _checks.pose("pose", pose)
        grid = self.free_below_robot(grid, pose)
        begun = {part.name: part.init(grid) for part in self.parts}
        states = {name: own for name, own in begun.items() if own is not None}
        clearance = self._clearance(grid, states)
        information = self._cell_information(grid, states, None)
        dwell = jnp.zeros_like(information.total)
        nothing = jnp.zeros(())
        errand = self._errand(states)
        guidance, is_explored = self._make_guidance(
            grid, clearance, information, dwell, pose, errand=errand
        )
        tracks = None if self.tracker is None else self.tracker.init(clearance)
        return Belief(
            grid,
            clearance,
            information,
            guidance,
            dwell,
            is_explored,
            self.patience,
            pose,
            self.ground,
            self._to_goal(grid, states, pose),
            None if self.tracker is None or tracks is None else self.tracker.obstacles(tracks),
            states,
            gain=Gain(nothing, nothing) if self.gives_up else None,
            tracks=tracks,
            goal=self._next_goal(errand),
            goal_heading=self.goal_heading,
            is_sent=None if errand is None else errand.is_due,
        )

    def free_below_robot(self, grid: OccupancyGrid, pose: Pose) -> OccupancyGrid:
        """Return a map with the cells under the robot free.

        Args:
            grid: the map.
            pose: pose (x, y, yaw) of the robot [m, m, rad].
        """
        return free_below(grid, pose, self.required_clearance, self.sensor_model)

    def with_map(self, belief: Belief, grid: OccupancyGrid) -> Belief:
        """Return the belief with another map, and with the clearance of all of it.

        The information and guidance fields follow at their next update, which finds the cells that
        have changed by itself. A scan updates the clearance around the robot only, so here it is
        computed anew.

        Args:
            belief: belief with the former map.
            grid: the map, with the cells of the former one.
        """
        clearance, tracks = self._clearance(grid, belief.parts), belief.tracks
        if tracks is not None and tracks.former is not None:
            # Former maps have their walls at other places.
            tracks = tracks._replace(former=jnp.stack([clearance.values] * 2))
        return dataclasses.replace(belief, grid=grid, clearance=clearance, tracks=tracks)

    def remap(self, belief: Belief, grid: OccupancyGrid, pose: Pose) -> Belief:
        """Return the belief with another map, all of whose fields are made anew.

        The time that the robot spent at each place and what parts know stay as they are.

        Args:
            belief: belief with the former map.
            grid: the map, with the cells of the former one.
            pose: present pose (x, y, yaw) of the robot [m, m, rad].
        """
        changed = self.with_map(belief, grid)
        information = self._information(changed, None)
        return self._derive_fields(changed, information, belief.dwell, pose)

    @_kinds.check_arguments
    def observe(
        self,
        belief: Belief,
        scans: Scan | Sequence[Scan],
        pose: Pose,
        elapsed: ArrayLike = 0.1,
        time: ArrayLike | None = None,
    ) -> Belief:
        """Update the map, the clearance and the parts of the belief by a scan of each sensor.

        Clearances are updated around the robot only, where scans can change the map (`window`).
        Those of a belief with another map must be computed anew (`init`).

        Parts learn from the first scan. With a tracker, the scans update the tracks, and returns of
        what moves are not mapped.

        Args:
            belief: belief before the scans.
            scans: one for each sensor.
            pose: estimated pose (x, y, yaw) of the robot [m, m, rad].
            elapsed: time since the last scans [s].
            time: time since the start [s]; the sum of the times elapsed when absent.

        Raises:
            ValueError: another number of scans than there are sensors, an argument of another kind
                or shape.
        """
        pose = _checks.pose("pose", pose)
        _checks.of_shape("elapsed", elapsed, ())
        if time is not None:
            _checks.of_shape("time", time, ())
        scans = as_scans(scans, len(self.sensors))
        # Before the map: returns of what moves are taken out of the scans, so that people leave no
        # walls.
        belief, scans = self._track(belief, scans, pose, elapsed, time)
        grid, states = belief.grid, belief.parts
        passed = jnp.asarray(elapsed, jnp.float32)
        now = None if time is None else jnp.asarray(time, jnp.float32)
        for index, (sensor, scan) in enumerate(zip(self.sensors, scans, strict=True)):
            sighting = sensor.sight(grid, scan, pose, self.ground)
            grid = update_grid(grid, sighting, self.sensor_model)
            # Parts see the map after the first scan only: it is the sensor whose information they
            # add to.
            if index == 0:
                given = (sensor, grid, scan, sighting.is_seen, pose, passed, now)
                seen = Observation(*given, belief.obstacles)
                known = {
                    part.name: part.observe(own, seen) for part, own in self._list_active(states)
                }
                states = {**states, **known}
        # Last, because parts may close cells, which count as walls.
        clearance = update_clearance(
            belief.clearance,
            self.window(grid, pose),
            functools.partial(self._find_closed, grid, states),
            self.max_clearance,
        )
        return dataclasses.replace(belief, grid=grid, clearance=clearance, parts=states)

    def _track(
        self,
        belief: Belief,
        scans: Sequence[Scan],
        pose: Pose,
        elapsed: ArrayLike,
        time: ArrayLike | None,
    ) -> tuple[Belief, Sequence[Scan]]:
        """Update the tracks; return the scans without returns of what moves."""
        tracker, tracks = self.tracker, belief.tracks
        if tracker is None or tracks is None:
            return belief, scans
        # Scans may have been missing since the last one.
        passed = jnp.asarray(elapsed if time is None else time - tracks.time, jnp.float32)
        kept, edges = [], None
        for sensor, scan in zip(self.sensors, scans, strict=True):
            args = (sensor, scan, belief.clearance, pose, passed)
            tracks, is_moving = tracker.update(tracks, *args)
            kept.append(scan._replace(is_return=scan.is_return & ~is_moving))
            edges = tracks.edges if edges is None else edges
            passed = jnp.zeros(())
        assert edges is not None
        tracks = tracks._replace(edges=edges)
        known = tracker.obstacles(tracks)
        return dataclasses.replace(belief, tracks=tracks, obstacles=known), tuple(kept)

    def window(self, grid: OccupancyGrid, pose: Pose) -> Window:
        """Return the part of the map that scans from a pose may change.

        Args:
            grid: the robot's map.
            pose: pose (x, y, yaw) of the robot [m, m, rad].
        """
        reach = max(sensor.max_range for sensor in self.sensors)
        return Window.around(pose[:2], reach, grid.frame, grid.shape)

    def _find_closed(
        self, grid: OccupancyGrid, states: Mapping[str, Any], window: Window | None = None
    ) -> GridMask:
        """Return the cells that may not be entered, of the whole map or of a window of it."""
        closed = find_closed_cells(grid, self.ground, window)
        forbidden = self._find_cells_closed_by_parts(states)
        if forbidden is None:
            return closed
        return closed | (forbidden if window is None else window.read(forbidden))

    def _clearance(self, grid: OccupancyGrid, states: Mapping[str, Any]) -> ScalarField:
        closed = self._find_closed(grid, states)
        return clearance_field(closed, grid.frame, self.max_clearance)

    def update_fields(self, belief: Belief, pose: Pose, elapsed: Scalar) -> Belief:
        """Update the information and guidance fields of the belief.

        Args:
            belief: belief after the last scan.
            pose: present pose (x, y, yaw) of the robot [m, m, rad].
            elapsed: time since the last update [s].

        Raises:
            ValueError: an argument of another kind or shape.
        """
        return self.update_guidance(self.update_information(belief), pose, elapsed)

    @_kinds.check_arguments
    def update_information(self, belief: Belief) -> Belief:
        """Return the belief with the information field of its map; see `update_fields`.

        Places that looks take away are given up if nothing new was seen for `memory`, where the
        belief has a `gain`.

        Raises:
            ValueError: something else than a belief.
        """
        # What parts add is in the last field, and an update would keep it.
        is_added = any(part.adds_information for part, _ in self._list_active(belief.parts))
        before = None if is_added else belief.information
        information = self._information(belief, before)
        dwell = belief.dwell
        if belief.gain is not None:
            looks = belief.information.total, information.total
            left = with_given_up(dwell, *looks, self.min_information, self.patience)
            # Scans from poses with errors contradict each other at walls: from one place the robot
            # sees through a thin wall, from the next one it does not. It would forget each view at
            # the other, and go to and fro between both for ever.
            dwell = jnp.where(belief.gain.since >= self.memory, left, dwell)
        return dataclasses.replace(belief, information=information, dwell=dwell)

    @_kinds.check_arguments
    def update_guidance(self, belief: Belief, pose: Pose, elapsed: Scalar) -> Belief:
        """Return the belief with the fields that follow from its information; see `update_fields`.

        Args:
            belief: belief with the information field of its map.
            pose: present pose (x, y, yaw) of the robot [m, m, rad].
            elapsed: time since the last update [s].

        Raises:
            ValueError: an argument of another kind or shape.
        """
        pose = _checks.pose("pose", pose)
        _checks.of_shape("elapsed", elapsed, ())
        information = belief.information
        dwell = add_dwell(belief.dwell, information.frame, pose, elapsed, self.memory)
        if belief.gain is not None:
            known = 1.0 - unknown_fraction(belief.grid)
            gain = belief.gain.update(known, elapsed, belief.is_sent)
            belief = dataclasses.replace(belief, gain=gain)
        return self._derive_fields(belief, information, dwell, pose)

    def _derive_fields(
        self, belief: Belief, information: InformationField, dwell: GridValues, pose: Pose
    ) -> Belief:
        """Return the belief with the fields that follow from its map and the information."""
        states = self._plan_errands(belief, pose)
        errand = self._errand(states)
        guidance, is_explored = self._make_guidance(
            belief.grid,
            belief.clearance,
            information,
            dwell,
            pose,
            belief.claims,
            belief.revisit,
            errand,
        )
        return dataclasses.replace(
            belief,
            information=information,
            guidance=guidance,
            dwell=dwell,
            is_explored=is_explored,
            # A lost robot has no finite pose. Costs measure from the last finite one.
            pose=jnp.where(jnp.isfinite(pose).all(), pose, belief.pose),
            to_goal=self._to_goal(belief.grid, belief.parts, pose),
            parts=states,
            goal=self._next_goal(errand),
            is_sent=None if errand is None else errand.is_due,
        )

    def _plan_errands(self, belief: Belief, pose: Pose) -> dict[str, Any]:
        """Return the states of parts, with the decisions whether their errands are due."""
        states = dict(belief.parts)
        for part, own in self._list_active(belief.parts):
            errand = part.errand(own) if part.has_errands else None
            if errand is not None:
                way = exploration_field(
                    belief.clearance,
                    jnp.zeros_like(belief.dwell),
                    self.required_clearance,
                    self.locomotion,
                    decay_length=self.decay_length,
                    min_information=self.min_information,
                    stride=self.field_sensor.stride,
                    goal=errand.place,
                    is_explored=jnp.array(True),
                    start=pose[:2],
                    goal_detour=0.0,
                ).from_pose(pose)
                cost = way(pose[:2])
                cost = jnp.where(cost < way.outside, cost, jnp.inf)
                states[part.name] = part.plan_errand(own, cost)
        return states

    def _errand(self, states: Mapping[str, Any]) -> Errand | None:
        """Return the errand of the first part for which one is due; None without errands."""
        found: Errand | None = None
        for part, own in reversed(self._list_active(states)):
            errand = part.errand(own)
            if errand is not None and found is not None:
                place = jnp.where(errand.is_due, errand.place, found.place)
                errand = Errand(place, errand.is_due | found.is_due)
            found = found if errand is None else errand
        return found

    def _next_goal(self, errand: Errand | None) -> Position | None:
        """Return where the robot shall come to rest: the place of an errand that is due, or the
        goal; None without both."""
        if errand is None or self.goal is None:
            return self.goal if errand is None else errand.place
        return jnp.where(errand.is_due, errand.place, self.goal)

    def find_forbidden(self, belief: Belief) -> GridMask | None:
        """Return the cells (H, W) that parts of the robot forbid to enter; None if none does."""
        return self._find_cells_closed_by_parts(belief.parts)

    def _find_cells_closed_by_parts(self, states: Mapping[str, Any]) -> GridMask | None:
        """Return the cells (H, W) that parts forbid to enter; None if none does."""
        given = [part.closed_cells(own) for part, own in self._list_active(states)]
        masks = [each for each in given if each is not None]
        return functools.reduce(operator.or_, masks) if masks else None

    def _list_active(self, states: Mapping[str, Any]) -> list[tuple[Part, Any]]:
        """Return the parts that have a state, each with its own."""
        return [(part, states[part.name]) for part in self.parts if part.name in states]

    def _information(self, belief: Belief, before: InformationField | None) -> InformationField:
        """Return the information field, updated from the last one if that suffices."""
        field = self._cell_information(belief.grid, belief.parts, before)
        for part, own in self._list_active(belief.parts):
            field = part.add_information(own, field, belief.grid, self.sensors[0])
        return field

    def _cell_information(
        self, grid: OccupancyGrid, states: Mapping[str, Any], before: InformationField | None
    ) -> InformationField:
        """Return the information field without what parts add to it beside their interest."""
        prior, closed = self.occupancy_prior, self._find_cells_closed_by_parts(states)
        if closed is not None:
            # What is unknown where the robot must not be counts as free, so it sees through it.
            is_ignored = closed & ~(grid.is_free | grid.is_occupied)
            grid = grid.with_probability(jnp.where(is_ignored, IGNORED, grid.probability))
        given = [part.interest(own) for part, own in self._list_active(states)]
        interests = [each for each in given if each is not None]
        if interests:
            # The interest of every cell changes with time, so the whole field is recomputed.
            interest = functools.reduce(operator.add, interests)
            return self.field_sensor.field(grid, self.sensor_model, interest, prior=prior)
        if before is None or self.is_batched:
            return self.field_sensor.field(grid, self.sensor_model, prior=prior)
        return self.field_sensor.update(before, grid, self.sensor_model, prior=prior)

    def _to_goal(
        self, grid: OccupancyGrid, states: Mapping[str, Any], pose: Pose
    ) -> GuidanceField | None:
        if not self.is_goal_apart or self.goal is None:
            return None
        closed = self._find_cells_closed_by_parts(states)
        return self.way_to(self.goal, grid, pose, self.goal_heading, closed)

    def way_to(
        self,
        goal: Position,
        grid: OccupancyGrid,
        pose: Pose,
        heading: Scalar | None = None,
        closed: GridMask | None = None,
    ) -> GuidanceField:
        """Return the cost-to-go to a goal; see `jaxplore.belief.exploration_field`.

        Args:
            goal: goal position (x, y) [m].
            grid: the robot's map.
            pose: pose (x, y, yaw) of the robot [m, m, rad].
            heading: heading at the goal [rad]; any when absent.
            closed: (H, W) cells that may not be entered; none when absent.
        """
        if self.ground is not None:
            blocked = ~self.ground.is_traversable
            closed = blocked if closed is None else closed | blocked
        return goal_field(
            grid,
            closed,
            goal,
            self.required_clearance,
            self.locomotion,
            unknown_factor=self.unknown_factor,
            max_clearance=self.max_clearance,
            stride=self.field_sensor.stride,
            start=pose[:2],
            heading=heading,
        ).from_pose(pose)

    def _make_guidance(
        self,
        grid: OccupancyGrid,
        clearance: ScalarField,
        information: InformationField,
        dwell: GridValues,
        pose: Pose,
        claims: GridValues | None = None,
        revisit: GridValues | None = None,
        errand: Errand | None = None,
    ) -> tuple[GuidanceField, Flag]:
        """Return the guidance, and whether it leads to a goal: because the map counts as explored,
        or on an errand."""
        worth = information.total
        if revisit is not None:
            worth = worth + revisit
        # It gives up what it waits for in vain, information or a place that it does not recognise.
        worth = worth * dwell_discount(dwell, self.patience)
        is_known = is_goal_next = jnp.array(False)
        if self.goal is not None:
            is_known = unknown_fraction(grid) < self.max_unknown
        goal, detour = None if self.is_goal_apart else self.goal, jnp.asarray(GOAL_DETOUR)
        heading = None if self.is_goal_apart else self.goal_heading
        is_next = is_known
        if errand is not None:
            # Without a goal of its own, the place is no source while the robot explores.
            detour = detour if goal is not None else jnp.where(errand.is_due, detour, jnp.inf)
            goal = errand.place if goal is None else jnp.where(errand.is_due, errand.place, goal)
            is_next = is_known | errand.is_due
        guidance = exploration_field(
            clearance,
            worth,
            self.required_clearance,
            self.locomotion,
            decay_length=self.decay_length,
            min_information=self.min_information,
            stride=self.field_sensor.stride,
            goal=goal,
            goal_heading=heading,
            is_explored=is_next,
            start=pose[:2],
            claims=claims,
            goal_detour=detour,
        ).from_pose(pose)
        if self.goal is not None and not self.is_goal_apart:
            is_goal_next = leads_to_goal(guidance, pose[:2])
        return guidance, is_next | is_goal_next
