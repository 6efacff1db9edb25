"""A small closed loop of each kind of task: the files that use them share its compiled programs."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxplore as jx
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.fleet_controller import FleetController, same_for_all
from jaxplore.control.trajectory import Trajectory
from jaxplore.planning import InformativeMPPI
from jaxplore.planning.presets.flight import FieldNumbers, Flight
from jaxplore.planning.presets.path_following import PathFollowing
from jaxplore.simulation.fleet.scenario import Fleet

# A volume: a quadrotor with a depth camera in a room with half a wall across it.

SIDE = 0.2
"""Of a voxel [m]."""
QUADROTOR = jx.Quadrotor()
CAMERA = jx.DepthCamera(32, 24)


def room(has_wall: bool = True, column: int = 15) -> jx.VoxelGrid:
    """Return a room of 8 m by 4 m by 2.4 m with half a wall across it in a column of voxels."""
    solid = np.zeros((12, 20, 40), bool)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, :, [0, -1]] = True
    solid[:, :8, column] = has_wall
    return jx.VoxelGrid.solid(solid, SIDE)


def volume(
    has_wall: bool = True, start: tuple[float, ...] = (1.2, 2.0, 1.2, 0.3), **more: Any
) -> jx.VolumeScenario:
    """Return the exploration of the room."""
    more = {"target_coverage": 0.95, **more}
    return jx.VolumeScenario(room(has_wall), QUADROTOR, CAMERA, start, **more)


def volume_controller() -> jx.control.Controller:
    """Return its controller."""
    return jx.volume_explorer(QUADROTOR, horizon=20, num_samples=128)


# A flight: a quadrotor among zones, with each architecture of informative MPPI.

ZONES = dataclasses.replace(jx.three_zones(), resolution=0.2)
FLIGHT = Flight(horizon=10, num_samples=64, noise_std=(2.0, 1.0, 1.0, 1.0))
FIELDS = FieldNumbers(
    field_beams=4,
    field_range=3.0,
    field_noise=0.0,
    field_spacing=0.8,
    field_extent=3.2,
    local_beams=4,
    local_range=1.5,
)
SIGHT = jx.InverseSensorModel.line_of_sight()
SCANNER = jx.Lidar(36, 3.0, range_noise=0.0)


def flight_scenario(faults: jx.Faults | None = None) -> jx.ExplorationScenario:
    """Return the exploration of the zones, with or without a fault: they are one program."""
    world, goal = ZONES.truth(), ZONES.goal[:2]
    perception = jx.Perception(SCANNER, 0.2, 0.3, sensor_model=SIGHT, num_directions=8, goal=goal)
    return jx.ExplorationScenario(
        world, QUADROTOR, SCANNER, ZONES.start, perception=perception, prior=ZONES.prior(),
        goal=goal, altitude=-2.0, control_rate=20.0, sensing_rate=10.0, field_rate=5.0,
    ).with_disturbances(
        [jx.Faults(walls=np.zeros(world.shape, bool)) if faults is None else faults]
    )  # fmt: skip


def flight_controller(
    architecture: str, flight: Flight = FLIGHT, **changes: Any
) -> InformativeMPPI:
    """Return the controller of an architecture."""
    given = {"goal": ZONES.goal, "sensor_model": SIGHT, "fields": FIELDS, **changes}
    return jx.informative_mppi(QUADROTOR, architecture, resolution=0.2, flight=flight, **given)


# A hall: a robot whose commands are known beforehand, to see what happens to it.

HALL = np.full((30, 40), 0.01, np.float32)
HALL[0], HALL[-1], HALL[:, 0], HALL[:, -1] = 0.99, 0.99, 0.99, 0.99
WALKER, SHORT_LIDAR = jx.DifferentialDrive(max_speed=1.0), jx.Lidar(72, 1.0, range_noise=0.0)
HALL_GOAL, HALL_CHUNK = (2.5, 1.5), 10
"""The chunk is that of `record_run`, so that nothing is compiled twice."""
NO_WALLS = jx.Faults(walls=np.zeros(HALL.shape, bool))


class Script(Controller):
    """Gives its commands (N, nu) one after the other and remembers what it was told."""

    commands: jax.Array

    def init(self) -> Any:
        return jnp.zeros((), jnp.int32), jnp.zeros((len(self.commands), 5))

    def step(self, state: Any, observation: Any, belief: Any = None, *, key: Any) -> Any:
        count, told = state
        one = jnp.ones(())
        command = self.commands[count]
        info = Info(command[None], one[None], one[None], one, jnp.array(True))
        return command, (count + 1, told.at[count].set(observation)), info

    def inspect(
        self,
        state: Any,
        observation: Any,
        belief: Any = None,
        *,
        key: Any,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        alone = Trajectory(jnp.stack([observation] * 2), self.commands[:1], {})
        return SampledPlan(alone, alone, alone.states[None], jnp.ones(1))

    def at_period(self, control_period: Any) -> "Script":
        return self


FORWARD = np.tile(np.float32([1.0, 0.0]), (60, 1))
AHEAD = Script(jnp.asarray(FORWARD))


def hall(
    prior: np.ndarray | None = HALL,
    world: np.ndarray = HALL,
    *,
    goal: tuple[float, float] | None = HALL_GOAL,
    start: tuple[float, float, float] = (0.6, 1.5, 0.0),
    lidar: jx.Lidar = SHORT_LIDAR,
    faults: jx.Faults | None = NO_WALLS,
    **arguments: Any,
) -> jx.ExplorationScenario:
    """Return a robot at 20 Hz in a hall of 4 m x 3 m; one compiled loop for all with a goal."""
    perception = jx.Perception(lidar, 0.1, 0.2, sensor_model=SIGHT, num_directions=4, goal=goal)
    return jx.ExplorationScenario(
        jx.OccupancyGrid(world, 0.1), WALKER, lidar, start, perception=perception,
        prior=None if prior is None else jx.OccupancyGrid(prior, 0.1), goal=goal,
        control_rate=20.0, sensing_rate=10.0, field_rate=5.0, **arguments,
    ).with_disturbances([] if faults is None else [faults])  # fmt: skip


# A yard: the smallest task, for what the loop does in all.


class Place(NamedTuple):
    robot: jax.Array


class Yard(jx.Scenario):
    """A free yard; the state of the task is that of the robot."""

    robot: jx.Dynamics
    start: jax.Array = dataclasses.field(default_factory=lambda: jnp.zeros(5))
    control_period: jax.Array = dataclasses.field(default_factory=lambda: jnp.asarray(0.05))

    def init(self, key):
        return Place(self.start), None

    def perceive(self, state, moment, key):
        return state, None

    def advance(self, state, control, moment, info):
        after = self.robot.step(state.robot, control, self.control_period)
        return state._replace(robot=after), (after, moment.observed)

    def is_unfinished(self, state):
        return jnp.array(True)

    def recording(self, controller, before, run):
        raise NotImplementedError


# A path: a car on a closed ring, past two discs.

RING = jx.geometry.clothoid_path(
    [0, 0, 0], [(2 * np.pi * 3.0, 1 / 3.0, 1 / 3.0)], is_closed=True, half_widths=[0.8, 0.8]
)
CAR = jx.Ackermann(
    wheelbase=0.33,
    max_speed=4.0,
    max_acceleration=6.0,
    max_steering_rate=3.0,
    footprint=jx.Rectangle(0.45, 0.13, 0.3),
    integrator=jx.Euler(),
)
OTHER = 20.0 * jx.ComfortCost(lateral=1.0, free_lateral=6.0)
KEEP = {"nearness": None, "margin": 0.02, "caution": 1.0, "nearest_only": True}
AROUND = 100.0 * jx.MovingObstacleCost(clearance=0.4, collision=1.0, **KEEP)


def mpcc(path: Any = RING, *, other: Any = OTHER, **changes: Any) -> PathFollowing:
    """Return a follower of a path; a car's on the ring where nothing else is given."""
    given = {
        "noise_std": [2.4, 1.2],
        "progress_weight": 300.0,
        "comfort_weight": None,
        "temperature": 10.0,
        "num_samples": 128,
    }
    return jx.mpcc(CAR, path, other=other, **{**given, **changes})


TRAFFIC = jx.Traffic(RING, [6.0, 12.0], [0.3, -0.3], [0.5, 0.8], radii=0.15)
SHARED = {"control_rate": 50.0, "traffic": TRAFFIC}
NO_FAULTS = jx.Faults()
"""So that a run without a fault and those with one are the same program."""

# A fleet: equal robots in two rooms with a door.

STARTS = ((1.0, 1.0, 0.3), (1.0, 2.0, -0.4), (1.9, 1.5, 0.1))


def two_rooms() -> jx.OccupancyGrid:
    """Return 6 x 3 m: two rooms and a door."""
    world = np.zeros((30, 60), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    world[:, 30] = 1.0
    world[12:20, 30] = 0.0
    return jx.OccupancyGrid(world, 0.1)


def alone() -> jx.ExplorationScenario:
    """Return the exploration of one small robot; all fleets are made of it."""
    robot = jx.DifferentialDrive(max_speed=1.0, radius=0.15)
    lidar = jx.Lidar(num_beams=36, max_range=1.5, range_noise=0.01)
    perception = jx.Perception(lidar, 0.1, 0.15, num_directions=4, max_clearance=0.5)
    return jx.ExplorationScenario(
        two_rooms(), robot, lidar, STARTS[0], perception=perception, control_rate=20.0,
        field_rate=4.0,
    )  # fmt: skip


def fleet_explorer(robot: jx.dynamics.Dynamics, *, has_others: bool) -> jx.control.Controller:
    """Return the controller of one robot, among others or alone."""
    cost = jx.MovingObstacleCost(nearness=None, clearance=0.6)
    sizes = {"horizon": 10, "num_samples": 32}
    return jx.explorer(robot, has_moving_obstacles=has_others, moving_obstacle_cost=cost, **sizes)


def fleet(
    one: jx.ExplorationScenario, starts: Any = STARTS[:2], radio: Any = None, **options: Any
) -> tuple[FleetController, Fleet]:
    """Return a fleet of robots like one, and its controller."""
    scenario = Fleet(one, starts, radio=radio, plan_length=10, **options)
    controller = fleet_explorer(one.robot, has_others=scenario.num_robots > 1)
    return same_for_all(controller, scenario.robot), scenario


OFFICE = {"map": "office", "office": {"width": 9.0, "height": 8.0}}
"""Settings of a small office."""

# An environment of Gymnasium: two floors, so that all environments of controls share one compiled
# step.

SMALL_GYM: dict[str, Any] = {
    "office": {"seed": 1, "width": 8.0, "height": 7.0},
    "lidar": {"num_beams": 36, "max_range": 2.0},
    "fields": {"num_directions": 8},
    "num_floors": 2,
}
