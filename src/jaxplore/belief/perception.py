"""From scans to a belief: the map at the sensor's rate, the fields derived from it at theirs."""

import copy
import dataclasses
import math
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import Flag, GridValues, Pose, Position, Scalar, Vector
from jaxplore.belief.belief import Belief, remaining_pull
from jaxplore.belief.goal_field import goal_field
from jaxplore.belief.guidance import (
    ROOMY,
    GuidanceField,
    downhill,
    geodesic,
    near_point,
    roadmap,
)
from jaxplore.belief.idleness import IdlenessMap
from jaxplore.belief.zones import unknown_fraction
from jaxplore.information.field import InformationField
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Scan, Sensor, updated
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

LEFTOVER_DETOUR = 1e3
"""How much farther away a place with little information counts [m]."""
GOAL_DETOUR = 5e2
"""How much farther away the goal counts while there is more to see [m]; leftovers come later."""
LAYERS = 4
"""How many nodes deep into what is closed the guidance is continued."""
LEFTOVER_SHARE = 0.03
"""Share of the least worthwhile information below which a place is ignored."""
MAX_UNKNOWN = 0.05
"""Share of unknown cells below which a map counts as explored, unless another is given."""


class Perception(eqx.Module):
    """Builds and maintains a `Belief`.

    The guidance field is a cost to go, in metres,

        U(x) = min over s of [ d(x, s) - decay_length * ln W(s) ],
        W(s) = I(s) exp(-dwell(s) / patience)

    over poses s of known-free space, with I(s) the information of a full turn of beams: the
    geodesic spread of `W exp(-d / decay_length)`, in logarithms. d is the length of the shortest
    path that keeps the robot clear of whatever is not known to be free, up to double where it just
    fits. U has no local minimum but at places worth going to.

    `dwell` is the time recently spent near a place, so a place where the robot stays loses its pull
    and regains it later: what cannot be seen after all is given up, not waited for. Places with
    W below `min_information`, mostly cells near walls between which noise goes to and fro, count
    as a kilometre farther away: they come last, whatever is near.

    A goal is one more place worth going to: after all worthwhile information, before what is left
    over, and alone as soon as less than `max_unknown` of the map is unknown.

    Where the ground is known, cells that may not be entered are closed, whatever stands on them.

    A cell that was never measured has the probability 1/2 in the map, which stands for not knowing.
    Were beams to take it for a chance, every other unknown cell would stop them: all that is
    unknown would be a rim of two cells, and a slit behind a shelf worth as much as a dark hall. So
    for information such cells are occupied with the probability `occupancy_prior`, about the share
    of occupied cells in buildings.

    With a `watch` it also keeps how long ago each cell was seen, and what that makes a look worth
    is added to the information field, so that guidance leads there as well.

    Args:
        sensors: what the robot carries, one or several. All of them make the map; the first leads:
            information is what it would see, and it keeps the watch.
        resolution: side of a map cell [m].
        robot_radius: radius of the disc that must fit [m].
        sensor_model: the update that a measurement makes.
        num_directions: directions in which information is evaluated; at least 4.
        node_spacing: distance between the nodes of the fields [m]; rounded to whole cells, and
            kept so small that no path can jump a wall.
        max_clearance: bound of the clearance field [m]; raised for robots that need more.
        margin: room beyond the radius that a path needs [m].
        decay_length: how far the robot goes for e times the information [m].
        min_information: places with less are left for last [nat]; with less than 3 % of it, for
            good.
        occupancy_prior: probability with which beams are expected to meet something in a cell that
            was never measured, in (0, 1).
        patience: time near a place after which its pull has faded to 1/e [s].
        memory: time constant with which `dwell` is forgotten [s].
        goal: (x, y) to go to in the end [m]; none when absent.
        max_unknown: share of the map's cells with `4 p (1 - p) > 1/2` below which it counts as
            explored, if there is a goal.
        ground: of the map's cells; level and passable when absent.
        watch: what is looked for beside the map; nothing when absent.
        is_goal_apart: whether the goal gets a cost to go of its own, `Belief.to_goal`, instead of
            being the last place worth going to; static.
        unknown_factor: how much farther unknown space counts on the way to a goal apart.

    Raises:
        ValueError: a size, rate or length out of its range; no sensors; a goal apart that is not
            given.
    """

    sensors: tuple[Sensor, ...]
    sensor_model: InverseSensorModel
    field_sensor: FieldSensor
    resolution: float = eqx.field(static=True)
    max_clearance: float = eqx.field(static=True)
    required_clearance: Scalar
    decay_length: Scalar
    min_information: Scalar
    occupancy_prior: Scalar
    patience: Scalar
    memory: Scalar
    goal: Position | None
    max_unknown: Scalar
    ground: Ground | None
    watch: IdlenessMap | None
    unknown_factor: Scalar
    is_goal_apart: bool = eqx.field(static=True)
    is_batched: bool = eqx.field(static=True)

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
        min_information: ArrayLike = 10.0,
        occupancy_prior: ArrayLike = 0.1,
        patience: ArrayLike = 3.0,
        memory: ArrayLike = 60.0,
        goal: Vector | None = None,
        max_unknown: ArrayLike = MAX_UNKNOWN,
        ground: Ground | None = None,
        watch: IdlenessMap | None = None,
        is_goal_apart: bool = False,
        unknown_factor: ArrayLike = 0.5,
    ) -> None:
        radius = _checks.scalar("robot_radius", robot_radius, above=0.0)
        self.sensors = as_sensors(sensors)
        self.resolution = _checks.number("resolution", resolution, above=0.0)
        self.sensor_model = InverseSensorModel() if sensor_model is None else sensor_model
        if _checks.positive_int("num_directions", num_directions) < 4:
            raise ValueError(f"num_directions is {num_directions}; accepted: a whole number >= 4")
        spacing = _checks.number("node_spacing", node_spacing, above=0.0)
        self.field_sensor = FieldSensor(
            self.sensors[0],
            resolution,
            num_directions,
            safe_stride(spacing, resolution, float(radius)),
        )
        self.required_clearance = radius + _checks.scalar("margin", margin, at_least=0.0)
        self.max_clearance = max(
            _checks.number("max_clearance", max_clearance, above=0.0),
            float(math.ceil(ROOMY * float(self.required_clearance))),
        )
        self.decay_length = _checks.scalar("decay_length", decay_length, above=0.0)
        self.min_information = _checks.scalar("min_information", min_information, above=0.0)
        self.occupancy_prior = _checks.scalar(
            "occupancy_prior", occupancy_prior, above=0.0, below=1.0
        )
        self.patience = _checks.scalar("patience", patience, above=0.0)
        self.memory = _checks.scalar("memory", memory, above=0.0)
        self.goal = None if goal is None else _checks.vector("goal", goal, 2)
        self.max_unknown = _checks.scalar("max_unknown", max_unknown, at_least=0.0, at_most=1.0)
        self.ground, self.watch = ground, watch
        self.unknown_factor = _checks.scalar("unknown_factor", unknown_factor, at_least=0.0)
        if is_goal_apart and goal is None:
            raise ValueError("goal is None; accepted: a position, for a goal apart")
        self.is_goal_apart = is_goal_apart
        self.is_batched = False

    def for_batches(self) -> "Perception":
        """Return this perception to be mapped over by `jax.vmap`: it evaluates fields anew.

        The maps of a batch change in different places; a loop over those of any of them would copy
        the fields of all in each pass. Beliefs are the same.
        """
        same = copy.copy(self)
        object.__setattr__(same, "is_batched", True)
        return same

    def init(self, grid: OccupancyGrid, pose: Pose) -> Belief:
        """Return the belief of a robot that has seen nothing: free where it stands.

        Args:
            grid: what is known beforehand, all 0.5 if nothing.
            pose: the robot's pose (x, y, yaw) [m, m, rad].
        """
        height, width = grid.shape
        rows, columns = jnp.mgrid[:height, :width]
        centres = grid.frame.cell_centre(jnp.stack([rows, columns], axis=-1))
        distance = jnp.linalg.norm(centres - pose[:2], axis=-1)
        stands_on = distance <= self.required_clearance + 1.5 * grid.resolution
        freed = self.sensor_model.update(
            jnp.full(grid.shape, 0.5), jnp.where(stands_on, self.sensor_model.minimum, 0.0)
        )
        probability = jnp.where(stands_on, freed, grid.probability)
        grid = OccupancyGrid(probability, grid.resolution, grid.frame.origin)
        clearance = self._clearance(grid)
        idleness = None if self.watch is None else self.watch.init(grid.shape)
        information = self._information(grid, idleness, None)
        dwell = jnp.zeros_like(information.total)
        is_known = self._is_known(grid)
        guidance = self._guidance(clearance, information, dwell, is_known)
        is_explored = is_known | self._is_goal_next(guidance, pose)
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
            self._to_goal(grid),
            None,
            idleness,
        )

    def observe(
        self,
        belief: Belief,
        scans: Scan | Sequence[Scan],
        pose: Pose,
        elapsed: ArrayLike = 0.1,
    ) -> Belief:
        """Return the belief after a scan of each sensor: the map, the clearance, the idleness.

        Args:
            belief: before.
            scans: one for each sensor.
            pose: where the robot takes itself to be.
            elapsed: time since the last scans [s]; for the idleness.
        """
        scans = (scans,) if isinstance(scans, Scan) else tuple(scans)
        grid, idleness = belief.grid, belief.idleness
        for index, (sensor, scan) in enumerate(zip(self.sensors, scans, strict=True)):
            sighting = sensor.sight(grid, scan, pose, self.ground)
            grid = updated(grid, sighting, self.sensor_model)
            if index == 0 and self.watch is not None and idleness is not None:
                step = jnp.asarray(elapsed, jnp.float32)
                idleness = self.watch.seen(idleness, sighting.is_seen, step)
        clearance = self._clearance(grid)
        return dataclasses.replace(belief, grid=grid, clearance=clearance, idleness=idleness)

    def update_fields(self, belief: Belief, pose: Pose, elapsed: Scalar) -> Belief:
        """Return the belief with its information and guidance brought up to date.

        Args:
            belief: after the last scan.
            pose: where the robot is now.
            elapsed: time since the last update [s].
        """
        information = self._information(belief.grid, belief.idleness, belief.information)
        height, width = belief.dwell.shape
        rows, columns = jnp.mgrid[:height, :width]
        nodes = information.frame.cell_centre(jnp.stack([rows, columns], axis=-1))
        distance = jnp.linalg.norm(nodes - pose[:2], axis=-1)
        stay = elapsed * jnp.exp(-0.5 * (distance / 0.5) ** 2)
        dwell = belief.dwell * jnp.exp(-elapsed / self.memory)
        dwell = dwell + jnp.where(jnp.isfinite(stay), stay, 0.0)  # of a pose that is not known
        is_known = self._is_known(belief.grid)
        guidance = self._guidance(belief.clearance, information, dwell, is_known)
        is_explored = is_known | self._is_goal_next(guidance, pose)
        return dataclasses.replace(
            belief,
            information=information,
            guidance=guidance,
            dwell=dwell,
            is_explored=is_explored,
            pose=jnp.where(jnp.isfinite(pose).all(), pose, belief.pose),
            to_goal=self._to_goal(belief.grid),
        )

    def _information(
        self, grid: OccupancyGrid, idleness: GridValues | None, before: InformationField | None
    ) -> InformationField:
        """Return the information field, brought up to date where that is enough."""
        grid = grid.with_prior(self.occupancy_prior)
        if self.watch is not None and idleness is not None:
            # Time changes every cell's worth.
            interest = self.watch.interest(idleness)
            return self.field_sensor.field(grid, self.sensor_model, interest)
        if before is None or self.is_batched:
            return self.field_sensor.field(grid, self.sensor_model)
        return self.field_sensor.update(before, grid, self.sensor_model)

    def _to_goal(self, grid: OccupancyGrid) -> GuidanceField | None:
        if not self.is_goal_apart or self.goal is None:
            return None
        return goal_field(
            grid,
            None if self.ground is None else ~self.ground.is_traversable,
            self.goal,
            self.required_clearance,
            unknown_factor=self.unknown_factor,
            max_clearance=self.max_clearance,
            stride=self.field_sensor.stride,
            num_layers=LAYERS,
        )

    def _is_known(self, grid: OccupancyGrid) -> Flag:
        """Say whether the map counts as explored."""
        if self.goal is None:
            return jnp.array(False)
        return unknown_fraction(grid) < self.max_unknown

    def _is_goal_next(self, guidance: GuidanceField, pose: Pose) -> Flag:
        """Say whether nothing worthwhile can be reached any more, from a place on the map."""
        if self.goal is None or self.is_goal_apart:
            return jnp.array(False)
        cost = guidance(pose[:2])
        return (cost > 0.5 * GOAL_DETOUR) & (cost < guidance.outside)

    def _clearance(self, grid: OccupancyGrid) -> ScalarField:
        closed = ~grid.is_free
        if self.ground is not None:
            closed = closed | ~self.ground.is_traversable
        return clearance_field(closed, grid.frame, self.max_clearance)

    def _guidance(
        self, clearance: ScalarField, information: InformationField, dwell: Array, is_known: Flag
    ) -> GuidanceField:
        roads = roadmap(clearance, self.required_clearance, self.field_sensor.stride)
        frame, is_open = roads.frame, roads.is_open
        worth = information.total * remaining_pull(dwell, self.patience)
        pull = self.decay_length * jnp.log(jnp.maximum(worth, 1e-6))
        is_leftover = worth < self.min_information
        detour = jnp.where(is_leftover, LEFTOVER_DETOUR, 0.0)
        is_source = worth >= LEFTOVER_SHARE * self.min_information
        source = jnp.where(is_source, detour - pull, jnp.inf)
        if self.goal is not None and not self.is_goal_apart:
            source = self._with_goal(source, frame, is_open, is_known)
        distance = geodesic(source, roads.slowness, is_open)
        return downhill(distance, frame, LAYERS)

    def _with_goal(self, source: Array, frame: GridFrame, is_open: Array, is_known: Flag) -> Array:
        """Return the sources with the goal among them: the open nodes nearest to it."""
        assert self.goal is not None
        at_goal = near_point(self.goal, frame, is_open) + GOAL_DETOUR
        return jnp.minimum(jnp.where(is_known, jnp.inf, source), at_goal)


def as_sensors(sensors: Sensor | Sequence[Sensor]) -> tuple[Sensor, ...]:
    """Return one or several sensors as several.

    Raises:
        ValueError: none, or something else.
    """
    given = (sensors,) if isinstance(sensors, Sensor) else tuple(sensors)
    if not given or not all(isinstance(sensor, Sensor) for sensor in given):
        raise ValueError(f"sensors is {sensors!r}; accepted: a sensor, or several")
    return given


def safe_stride(node_spacing: float, resolution: float, radius: float) -> int:
    """Return the largest stride <= node_spacing / resolution at which no path jumps a wall.

    A node of the guidance is open if the robot fits at any cell of its block. Two such cells in
    touching blocks are at most `sqrt(2) (2 s - 1)` cells apart; on two sides of a wall one cell
    thick they are at least `2 radius` and a cell apart.
    """
    stride = max(1, round(node_spacing / resolution))
    while stride > 1 and math.sqrt(2.0) * (2 * stride - 1) * resolution >= 2 * radius + resolution:
        stride -= 1
    return stride
