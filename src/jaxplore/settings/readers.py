"""Which runs read a setting.

The functions of `jaxplore.build` read settings. This module says on what condition they read each.
`tests/build/test_reference.py` builds runs and compares the settings that were read with it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxplore.geometry.track import race_track
from jaxplore.localisation.inertial import InertialOdometry
from jaxplore.localisation.odometry import Odometry
from jaxplore.maps.files.path_file import read_path
from jaxplore.maps.generators.office import office
from jaxplore.maps.ground import Ground
from jaxplore.maps.terrain import TerrainMap
from jaxplore.maps.world import is_world_file
from jaxplore.planning.portfolio.contextual import Contextual
from jaxplore.planning.portfolio.safe_fusion import SafeFusion
from jaxplore.planning.portfolio.voting import WeightedVote
from jaxplore.planning.presets.explorer import explorer
from jaxplore.planning.presets.flight import FieldNumbers, Flight
from jaxplore.planning.presets.ground_vehicle import ground_portfolio
from jaxplore.planning.presets.path_following import avoidance_cost
from jaxplore.planning.presets.quadrotor import informative_mppi, zone_choice
from jaxplore.planning.presets.volume import ARCHITECTURES as IN_VOLUMES
from jaxplore.planning.presets.volume import volume_informative_mppi, volume_target_explorer
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.settings.accepted_values import choices
from jaxplore.settings.code_names import is_own
from jaxplore.settings.defaults import Owner
from jaxplore.settings.exploration import (
    BASELINES,
    OFFICE,
    QUADROTOR,
    ZONES,
    Settings,
)
from jaxplore.settings.path import TRACK, PathRobotSettings, PathSettings
from jaxplore.settings.robot import CARS, RobotSettings
from jaxplore.settings.volume import GENERATED
from jaxplore.simulation.following.traffic import Traffic


class Reader(NamedTuple):
    """The runs that read a setting.

    Args:
        text: these runs in words.
        reads: function that says whether a run with these settings reads the setting.
    """

    text: str
    reads: Callable[[Any], bool]


EVERY = Reader("every run", lambda _: True)
NONE = Reader("no run", lambda _: False)

INFORMATIVE = ("two-layer", "parallel", "sequential")
"""Architectures of informative MPPI."""


def reader(task: str, name: str, owner: str | None) -> Reader:
    """Return the runs that read a setting.

    Args:
        task: kind of task, `exploration`, `path` or `volume`, or `drive`.
        name: dotted name of the setting.
        owner: qualified name of its owner; none for a setting without.
    """
    named = _BY_NAME[task]
    if name in named:
        return named[name]
    of_owner = {each.__qualname__: found for each, found in _BY_OWNER[task].items()}
    if owner in of_owner:
        return of_owner[owner]
    # The last resort is the section: `portfolio` for `portfolio.fusion`.
    return named.get(name.rpartition(".")[0], EVERY)


def _architectures(*names: str, text: str | None = None) -> Reader:
    return Reader(text or ", ".join(names), lambda settings: settings.architecture in names)


def _also(first: Reader, text: str, reads: Callable[[Any], bool]) -> Reader:
    """Return a reader with a further condition."""
    return Reader(
        f"{first.text} with {text}", lambda settings: first.reads(settings) and reads(settings)
    )


def _models(section: type[RobotSettings], *names: str) -> Reader:
    known = choices(section, "model")
    kept = [name for name in names if name in known]
    if not kept:
        return NONE
    word = "model" if len(kept) == 1 else "models"
    return Reader(f"{word} {', '.join(kept)}", lambda settings: settings.robot.model in kept)


def _of_robot(section: type[RobotSettings]) -> dict[str, Reader]:
    """Return the readers of the robot's settings: its model, which has some of them."""
    differential, omni = "differential_drive", "omnidirectional"
    models = {
        "max_speed": (differential, omni, "unicycle", *CARS),
        "max_turn_rate": (differential, omni, "unicycle"),
        "max_acceleration": (differential, omni, *CARS),
        "max_deceleration": (differential, omni, "ackermann"),
        "max_angular_acceleration": (differential, omni),
        "drag": (differential, omni, "ackermann"),
        "radius": (differential, omni, "unicycle", "bicycle", "quadrotor"),
        "mass": ("quadrotor",),
        "wheelbase": CARS,
        "length": ("ackermann",),
        "width": ("ackermann",),
        "max_steering": CARS,
        "max_steering_rate": ("ackermann",),
        "min_speed": (omni, "unicycle", *CARS),
        "max_lateral_speed": (omni,),
    }
    return {f"robot.{name}": _models(section, *names) for name, names in models.items()}


def _is_office(settings: Settings) -> bool:
    # Beside a `world`, the map is only a name.
    return settings.world is None and settings.map == OFFICE


def _is_world(settings: Settings) -> bool:
    if settings.world is not None or settings.map == ZONES:
        return True
    return settings.map != OFFICE and is_world_file(settings.map)


def _is_ros_map(settings: Settings) -> bool:
    return not _is_office(settings) and not _is_world(settings)


def _has_height_map(settings: Settings) -> bool:
    return settings.terrain.height_map is not None and not _is_office(settings)


def _has_obstacles(settings: PathSettings) -> bool:
    given = settings.obstacles
    return bool(given.number or given.discs or given.polygons)


_IN_THE_OFFICE = Reader("the map office", _is_office)
_PORTFOLIO = _architectures("portfolio")
_IN_ROBOT = _of_robot(RobotSettings)
_FLYING = _architectures(*QUADROTOR)
_LOG_ODDS = Reader(
    "sensor_model.kind log_odds", lambda settings: settings.sensor_model.kind == "log_odds"
)
_MATCHING, _FILTERING = (
    Reader(
        f"runs with localisation.method {method}",
        lambda settings, method=method: (  # type: ignore[misc]
            settings.localisation is not None and settings.localisation.method == method
        ),
    )
    for method in ("matching", "particles")
)
_WHEELS, _INERTIAL = (
    Reader(
        f"runs whose localisation has {words}",
        lambda settings, kind=kind: (  # type: ignore[misc]
            settings.localisation is not None
            and settings.localisation.odometry_of(settings.robot.model) == kind
        ),
    )
    for kind, words in (("wheels", "wheels"), ("imu", "an IMU"))
)
_CLOSING = Reader(
    "runs with a localisation that closes loops",
    lambda settings: _MATCHING.reads(settings) and settings.localisation.loops,
)
_FROM_A_FILE = Reader("paths from a file", lambda settings: settings.path != TRACK)
_AMONG_OBSTACLES = Reader("runs with obstacles", _has_obstacles)
_AMONG_PEOPLE = Reader("runs with people", lambda settings: settings.people.number > 0)
_IN_TRAFFIC = Reader("runs with moving obstacles", lambda settings: settings.obstacles.number > 0)

_DRIVING, _EXPLORING, _FOLLOWING, _CHOOSING = (
    Reader(text, lambda settings, modes=modes: settings.node.mode in modes)  # type: ignore[misc]
    for text, modes in (
        ("the modes control and follow", ("control", "follow")),
        ("the mode control", ("control",)),
        ("the mode follow", ("follow",)),
        ("the mode goal", ("goal",)),
    )
)
_ADAPTIVE = Reader(
    "runs with adaptive_horizon.rule", lambda settings: settings.adaptive_horizon.rule is not None
)
_GENERATED = Reader("generated volumes", lambda settings: settings.volume in GENERATED)
_ANY_MODE = Reader("every mode", lambda _: True)

_BY_NAME: dict[str, dict[str, Reader]] = {
    "drive": {
        "node": _DRIVING,
        "node.contouring": _FOLLOWING,
        "node.path_topic": _FOLLOWING,
        "node.returns": _EXPLORING,
        "node.map_topic": _CHOOSING,
        "node.goal_topic": _CHOOSING,
        "node.map_frame": Reader(
            "the pose internal", lambda settings: settings.node.pose == "internal"
        ),
        "node.done_after": Reader(
            "the modes control and goal", lambda settings: settings.node.mode != "follow"
        ),
        **{
            f"node.{name}": _ANY_MODE
            for name in (
                *("namespace", "mode", "pose", "pose_topic", "pose_type"),
                *("world_frame", "robot_frame"),
            )
        },
    },
    "exploration": {
        "resolution": Reader("the map office, ROS maps", lambda settings: not _is_world(settings)),
        "is_map_known": Reader(
            "the map office, ROS maps", lambda settings: not _is_world(settings)
        ),
        # Robots on the ground get it as well, and have no state for it.
        "altitude": EVERY,
        "adaptive_horizon": _ADAPTIVE,
        "adaptive_horizon.rule": EVERY,
        **_IN_ROBOT,
        # A quadrotor's speed is limited by a cost of its controller, not by its model.
        "robot.max_speed": Reader(
            f"{_IN_ROBOT['robot.max_speed'].text}; {_FLYING.text}",
            lambda settings: (
                _IN_ROBOT["robot.max_speed"].reads(settings) or _FLYING.reads(settings)
            ),
        ),
        "fleet": Reader("runs with a fleet", lambda settings: settings.fleet is not None),
        "chassis": Reader("runs with a chassis", lambda settings: settings.chassis is not None),
        "camera": Reader("runs with a camera", lambda settings: settings.camera is not None),
        "localisation": Reader(
            "runs with a localisation", lambda settings: settings.localisation is not None
        ),
        "localisation.uncertainty_weight": Reader(
            "the explorer with a localisation",
            lambda settings: (
                settings.localisation is not None and settings.architecture == "explorer"
            ),
        ),
        "localisation.loops": _MATCHING,
        "localisation.memory": _MATCHING,
        "localisation.num_particles": _FILTERING,
        "localisation.num_beams": _FILTERING,
        "localisation.is_start_known": _FILTERING,
        "localisation.closing_rate": _CLOSING,
        "localisation.reach": _CLOSING,
        "localisation.least_share": _CLOSING,
        "localisation.tolerance": _CLOSING,
        **dict.fromkeys(("people.speed", "people.radius", "people.seed"), _AMONG_PEOPLE),
        "watch": Reader("runs with a watch", lambda settings: settings.watch is not None),
        "keep_out": Reader(
            "runs with keep-out areas", lambda settings: settings.keep_out is not None
        ),
        "anomalies": Reader(
            "runs that test for anomalies", lambda settings: settings.anomalies is not None
        ),
        "detector": Reader("runs with a detector", lambda settings: settings.detector is not None),
        "map_file": Reader("ROS maps", _is_ros_map),
        "terrain.height_map": Reader("ROS maps, worlds", lambda settings: not _is_office(settings)),
        "portfolio": _PORTFOLIO,
        "portfolio.members": _also(
            _PORTFOLIO, "no portfolio.weights", lambda settings: settings.portfolio.weights is None
        ),
    },
    "path": {
        **_of_robot(PathRobotSettings),
        "half_width": _FROM_A_FILE,
        "adaptive_horizon": _ADAPTIVE,
        "adaptive_horizon.rule": EVERY,
        "obstacles.radius": _IN_TRAFFIC,
        # The order of the two speeds is checked in every run.
        "obstacles.speeds": EVERY,
        "obstacles.seed": _IN_TRAFFIC,
        "controller.risk_level": _AMONG_OBSTACLES,
    },
    "volume": {
        "adaptive_horizon": _ADAPTIVE,
        "adaptive_horizon.rule": EVERY,
        "camera": Reader("runs with a camera", lambda settings: settings.camera is not None),
        "lidar": Reader("runs with a lidar", lambda settings: settings.lidar is not None),
        "file": Reader("volumes from a file", lambda settings: settings.volume not in GENERATED),
        "generated": _GENERATED,
        **dict.fromkeys(("people.speed", "people.radius", "people.seed"), _AMONG_PEOPLE),
        "keep_out": Reader(
            "runs with keep-out boxes", lambda settings: settings.keep_out is not None
        ),
    },
}
"""Readers by the name of a setting, or of a section for all its settings that have no other. What
is in no table is read by every run."""

_BY_OWNER: dict[str, dict[Owner, Reader]] = {
    "drive": {},
    "exploration": {
        office: _IN_THE_OFFICE,
        TerrainMap.from_images: Reader("ROS maps with a height map", _has_height_map),
        Ground: Reader(
            "worlds, ROS maps with a height map",
            lambda settings: _is_world(settings) or _has_height_map(settings),
        ),
        InverseSensorModel: _LOG_ODDS,
        Odometry: _WHEELS,
        InertialOdometry: _INERTIAL,
        # A rule-based explorer drives to its target as `explorer` does.
        # So does one by a rule of the user's.
        explorer: Reader(
            "explorer, rule-based explorers",
            lambda settings: (
                settings.architecture in ("explorer", *BASELINES) or is_own(settings.architecture)
            ),
        ),
        ground_portfolio: _PORTFOLIO,
        SafeFusion: _also(
            _PORTFOLIO, "portfolio.is_safe", lambda settings: settings.portfolio.is_safe
        ),
        WeightedVote: _also(
            _PORTFOLIO,
            "portfolio.fusion weighted-vote",
            lambda settings: settings.portfolio.fusion == "weighted-vote",
        ),
        Contextual: _also(
            _PORTFOLIO,
            "portfolio.fusion contextual",
            lambda settings: settings.portfolio.fusion == "contextual",
        ),
        Flight: _FLYING,
        FieldNumbers: _architectures(*INFORMATIVE),
        informative_mppi: _architectures(*INFORMATIVE),
        zone_choice: _architectures("sequential"),
    },
    "path": {
        race_track: Reader("the path track", lambda settings: settings.path == TRACK),
        read_path: _FROM_A_FILE,
        Traffic.random: _IN_TRAFFIC,
        avoidance_cost: _AMONG_OBSTACLES,
    },
    "volume": {
        InverseSensorModel: _LOG_ODDS,
        volume_informative_mppi: _architectures(*IN_VOLUMES),
        volume_target_explorer: Reader(
            "rule-based explorers",
            lambda settings: settings.architecture in BASELINES or is_own(settings.architecture),
        ),
    },
}
"""Readers by the owner of a setting: who builds the owner reads its settings."""
