"""Explorations of volumes, from settings."""

import functools
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxplore._text import printable_path
from jaxplore.belief.volume import VolumePerception
from jaxplore.control.base import Controller
from jaxplore.control.guard import WALL_MARGIN, MotionGuard
from jaxplore.control.validation import StopCheck
from jaxplore.dynamics.goal import Goal
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.files.volume_file import MEMORY, VolumeFile, open_volume, read_volume
from jaxplore.maps.generators.volumes import START, generate_volume
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.parameters import set_parameters
from jaxplore.parts.capability import Surroundings
from jaxplore.parts.registry import build_parts, control_arguments
from jaxplore.parts.targets.truth import Targets
from jaxplore.planning.presets.volume import ARCHITECTURES as INFORMATIVE
from jaxplore.planning.presets.volume import (
    volume_explorer,
    volume_informative_mppi,
    volume_target_explorer,
)
from jaxplore.planning.strategy.volume_approach import GoalApproach
from jaxplore.sensing.volume import DepthCamera, RingLidar, VolumeSensor
from jaxplore.settings.code_names import is_own
from jaxplore.settings.defaults import arguments, parameter_default
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.volume.observable import room_around
from jaxplore.simulation.volume.scenario import VolumeScenario
from jaxplore.tasks.robot import (
    build_sensor_model,
    with_adaptive_horizon,
    with_latency,
)
from jaxplore.tasks.user_code import import_controller, import_rule
from jaxplore.tasks.volume.settings import (
    GENERATED,
    VolumeSettings,
    make_volume_settings,
)

GUIDED = ("explorer", *INFORMATIVE)
"""Architectures that follow the cost-to-go, so that a goal or a part can lead them somewhere."""
_HIGH = 5.6
"""Height of a generated maze, which has two storeys [m]."""
_LOOKING_UP = 20.0
"""Tilt of the camera in a generated maze, whose storeys are joined by holes in the floor [deg]."""
_YAW = 0.6
"""Heading at the start of a generated volume [rad]."""


def build_volume(settings: VolumeSettings) -> Experiment:
    """Build the experiment that settings describe."""
    world, datum = build_world(settings)
    robot = Quadrotor(**arguments(settings.robot, Quadrotor))
    sensors = build_sensors(settings)
    goal = None if settings.goal is None else datum.to_local(settings.goal)
    around = Surroundings(datum, radius=float(robot.radius), grid=world, seed=settings.seed)
    equipment = build_parts(settings, around)
    perception = VolumePerception(
        sensors,
        world.resolution,
        robot.radius,
        goal=goal,
        goal_heading=None if goal is None else settings.goal_heading,
        goal_radius=settings.goal_radius,
        parts=equipment.parts,
        sensor_model=build_sensor_model(settings.sensor_model),
        **arguments(settings.fields, VolumePerception),
    )
    numbers = arguments(settings, Goal)
    search = [datum.to_local(each) for each in settings.search]
    scenario = VolumeScenario(
        world,
        robot,
        sensors,
        _start(settings, world, robot, datum),
        perception=perception,
        goal=None if goal is None else Goal(goal, **numbers),
        truths=(*equipment.truths, *([Targets(search)] if search else [])),
        datum=datum,
        **equipment.scenario,
        **arguments(settings, VolumeScenario),
        **arguments(settings.rates, VolumeScenario),
    ).with_disturbances(equipment.disturbances)
    scenario = scenario.with_guard(_guard() if settings.guard else None)
    controller = set_parameters(_controller(settings, scenario, around), settings.parameters)
    controller = with_adaptive_horizon(controller, settings.adaptive_horizon)
    sent = [part.name for part in equipment.parts if part.has_errands]
    if sent and settings.architecture not in GUIDED and not is_own(settings.architecture):
        raise ValueError(
            f"setting {sent[0]} is given beside the architecture {settings.architecture}; "
            f"accepted: with {', '.join(GUIDED)}, which follow the cost-to-go"
        )
    if goal is not None or sent:
        controller = GoalApproach(controller, robot)
    return Experiment(
        with_latency(controller, settings, scenario),
        scenario,
        max(1, round(settings.time_limit * settings.rates.control)),
        jax.random.key(settings.seed),
    )


def _guard() -> MotionGuard:
    """Build the guard of a quadrotor, which can make way to all sides."""
    return MotionGuard(check=StopCheck(WALL_MARGIN, evades=True))


def build_world(settings: VolumeSettings) -> tuple[VoxelGrid, Datum]:
    """Build the true world of a run, and return it with the datum to which it is relative."""
    kind = GENERATED.get(settings.volume)
    if kind is None:
        # A file is read for the estimate of the memory, for the start, and for the run: once.
        return _make_voxels(*_key(settings))
    world = generate_volume(
        kind,
        size=_volume_size(settings),
        **arguments(settings.generated, generate_volume),
        **arguments(settings, generate_volume),
    )
    return world, ORIGIN


type _Key = tuple[str, float, tuple[tuple[str, Any], ...], tuple[int, int, int]]
"""Name, resolution and settings of a file, and what changes with it."""


def _key(settings: VolumeSettings) -> _Key:
    given = tuple(arguments(settings.file, read_volume).items())
    return settings.volume, settings.resolution, given, _stamp(settings.volume)


_opened: dict[_Key, VolumeFile] = {}
"""The last file that was read, until its voxels are made."""


def _open(key: _Key, memory: float = MEMORY) -> VolumeFile:
    """Read a file, or return the last one."""
    if key not in _opened:
        _opened.clear()
        name, resolution, given, _ = key
        _opened[key] = open_volume(name, resolution=resolution, memory=memory, **dict(given))
    return _opened[key]


@functools.lru_cache(maxsize=1)
def _make_voxels(*key: Any) -> tuple[VoxelGrid, Datum]:
    """Make the voxels of a file, or return the last ones."""
    opened = _open(key)
    datum = opened.datum
    _opened.clear()
    return opened.grid(datum), datum


@functools.lru_cache(maxsize=1)
def _size(memory: float, *key: Any) -> tuple[tuple[int, int, int], float]:
    """Return the voxels along z, y and x of a file, and their side [m]."""
    opened = _open(key, memory)
    return opened.shape, opened.resolution


def _stamp(name: str) -> tuple[int, int, int]:
    """Return what changes with a file; zeros where it is not there, which the reader says."""
    try:
        status = Path(name).stat()
    except OSError:
        return 0, 0, 0
    return status.st_mtime_ns, status.st_size, status.st_ino


def volume_size(
    settings: VolumeSettings, memory: float = MEMORY
) -> tuple[tuple[int, int, int], float]:
    """Return the numbers of voxels of a run's volume along z, y and x, and their side [m].

    A file is read for them with at most `memory` [bytes], and no voxels are made.
    """
    if settings.volume not in GENERATED:
        return _size(min(memory, MEMORY), *_key(settings))
    width, height, depth = (
        max(3, round(each / settings.resolution)) for each in _volume_size(settings)
    )
    return (depth, height, width), settings.resolution


def _volume_size(settings: VolumeSettings) -> tuple[float, float, float]:
    """Return the extents (x, y, z) of a generated volume [m]."""
    if settings.generated.size is not None:
        return settings.generated.size
    size: tuple[float, float, float] = parameter_default(generate_volume, "size")
    return (*size[:2], _HIGH) if GENERATED[settings.volume] == "maze" else size


def build_sensors(settings: VolumeSettings) -> tuple[VolumeSensor, ...]:
    """Build the sensors, at least one; the camera is the first one."""
    sensors: list[VolumeSensor] = []
    camera, lidar = settings.camera, settings.lidar
    # `arguments` returns angles in degrees, as settings have them.
    if camera is not None:
        given = arguments(camera, DepthCamera)
        angles = ["field_of_view", "vertical_view"]
        tilt = camera.tilt_degrees
        if tilt is None and GENERATED.get(settings.volume) == "maze":
            tilt = _LOOKING_UP
        if tilt is not None:
            given["tilt"] = tilt
            angles.append("tilt")
        sensors.append(DepthCamera(**_in_radians(given, angles)))
    if lidar is not None:
        given = arguments(lidar, RingLidar)
        sensors.append(RingLidar(**_in_radians(given, ("field_of_view", "lowest", "highest"))))
    if not sensors:
        raise ValueError("settings camera and lidar are null; accepted: one of them, or both")
    return tuple(sensors)


def _in_radians(given: dict[str, Any], names: Iterable[str]) -> dict[str, Any]:
    return {**given, **{name: math.radians(given[name]) for name in names}}


def _controller(
    settings: VolumeSettings, scenario: VolumeScenario, around: Surroundings
) -> Controller:
    flying = {
        **arguments(settings.controller, volume_explorer),
        **arguments(settings.robot, volume_explorer),
        "control_period": 1.0 / settings.rates.control,
        **control_arguments(settings, around),
        "has_goal": scenario.goal is not None,
    }
    name = settings.architecture
    if name == "explorer":
        return volume_explorer(scenario.robot, **flying)
    if name in INFORMATIVE:
        return volume_informative_mppi(
            scenario.robot,
            name,
            perception=scenario.perception,
            grid=scenario.world,
            # The strategic layer is due when the fields that it reads are new.
            strategy_period=1.0 / settings.rates.fields,
            **arguments(settings.controller, volume_informative_mppi),
            **flying,
        )
    own = import_rule(name) if is_own(name) else None
    if own is None and is_own(name):
        return import_controller(name, scenario)
    if settings.goal is not None:
        raise ValueError(
            f"architecture is {name!r} beside a goal, and its rule chooses places of its own; "
            f"accepted: {', '.join(GUIDED)}"
        )
    return volume_target_explorer(
        scenario.robot,
        name if own is None else own,
        scenario.perception,
        scenario.world,
        # A choice is due when the fields that it reads are new.
        every=max(1, round(settings.rates.control / settings.rates.fields)),
        **arguments(settings.targets, volume_target_explorer),
        **flying,
    )


def _start(
    settings: VolumeSettings, world: VoxelGrid, robot: Quadrotor, datum: Datum
) -> tuple[float, float, float, float]:
    """Return the start (x, y, z, yaw) of a run, relative to a datum [m, m, m, rad]."""
    if settings.start is not None:
        x, y, z, yaw = datum.to_local(settings.start).tolist()
        return x, y, z, yaw
    if settings.volume in GENERATED:
        return (*START, _YAW)
    room = room_around(~np.asarray(world.is_free)) * world.resolution
    if room.max() < float(robot.radius):
        raise ValueError(
            f"volume {printable_path(Path(settings.volume))} has no place for a robot of "
            f"{float(robot.radius):g} m radius; accepted: one with such a place"
        )
    voxel = np.unravel_index(np.argmax(room), room.shape)
    x, y, z = (
        float(low + (index + 0.5) * world.resolution)
        for low, index in zip(np.asarray(world.origin), voxel[::-1], strict=True)
    )
    return x, y, z, 0.0


def with_start(entries: dict[str, Any]) -> dict[str, Any]:
    """Return settings entries with a start, where neither they nor the volume have one.

    It is the position with the greatest clearance, heading along x. A volume without a place for
    the robot raises a ValueError.
    """
    settings = make_volume_settings(entries)
    if settings.start is not None or settings.volume in GENERATED:
        return entries
    robot = Quadrotor(**arguments(settings.robot, Quadrotor))
    world, datum = build_world(settings)
    start = datum.round_to_map(_start(settings, world, robot, datum))
    return {**entries, "start": tuple(start.tolist())}
