"""Settings of a path-following run."""

from typing import Annotated, Any, Literal

from pydantic import Field

from jaxplore._limits import MOST_OBSTACLES
from jaxplore.dynamics.ackermann import Ackermann
from jaxplore.geometry.track import race_track
from jaxplore.maps.files.path_file import read_path
from jaxplore.parts.registry import with_capabilities
from jaxplore.planning.presets.path_following import avoidance_cost, mpcc
from jaxplore.settings.code_names import WordsOrOwn
from jaxplore.settings.controllers import ContouringNumbers
from jaxplore.settings.defaults import setting
from jaxplore.settings.parameter_names import under_their_settings
from jaxplore.settings.readers import Readers
from jaxplore.settings.robot import (
    A_CAR,
    ACCELERATING,
    BRAKING,
    DRIVING,
    GROUND_ROBOTS,
    SHAPED,
    RobotSettings,
)
from jaxplore.settings.sections import (
    Bends,
    Body,
    Duration,
    Laps,
    Length,
    Margin,
    NonNegative,
    Obstacles,
    Outcomes,
    Positive,
    Rate,
    Real,
    RunSettings,
    Section,
    Seed,
    Steering,
    check_section,
)
from jaxplore.simulation.following.scenario import PathScenario
from jaxplore.simulation.following.traffic import Traffic

PATH = "path"
"""Name that selects path following in place of a map."""
TRACK = "track"
"""Name of the generated path."""

Point = tuple[Real, Real]
PathRobot = Annotated[str, WordsOrOwn(GROUND_ROBOTS)]


def _has_obstacles(settings: Any) -> bool:
    given = settings.obstacles
    return bool(given.number or given.discs or given.polygons)


ON_TRACK = Readers("the path track", lambda settings: settings.path == TRACK, "path")
FROM_FILE = Readers("paths from a file", lambda settings: settings.path != TRACK, "path")
AMONG_OBSTACLES = Readers("runs with obstacles", _has_obstacles)
IN_TRAFFIC = Readers(
    "runs with moving obstacles", lambda settings: settings.obstacles.number > 0, "obstacles.number"
)


class TrackSettings(Section):
    """The generated track: see `jaxplore.race_track`."""

    readers = ON_TRACK

    seed: Seed = setting(race_track, "seed")
    length: Length = setting(race_track, "length")
    half_width: Length = setting(race_track, "half_width")
    min_radius: Length = setting(race_track, "min_radius")
    num_bends: Bends = setting(race_track, "num_bends")


class PathRobotSettings(RobotSettings):
    """The robot, by default a race car of F1TENTH's size.

    Args:
        model: name of the robot's model; a `bicycle` has a radius and no steering dynamics. Or
            MODULE:NAME, a `jaxplore.Dynamics` of your own, which has its own numbers.
        length: length of a car [m].
        width: width of a car [m].
    """

    model: PathRobot = "ackermann"
    max_speed: Annotated[Positive, DRIVING] = setting(Ackermann, "max_speed")
    max_acceleration: Annotated[Positive, ACCELERATING] = setting(
        Ackermann, "max_acceleration", differs="path.robot.max_acceleration"
    )
    drag: Annotated[NonNegative, BRAKING] = setting(Ackermann, "drag")
    wheelbase: Annotated[Body, A_CAR] = setting(
        Ackermann, "wheelbase", differs="path.robot.wheelbase"
    )
    length: Annotated[Body, SHAPED] = 0.58
    width: Annotated[Body, SHAPED] = 0.31
    max_steering: Annotated[Steering, A_CAR] = setting(
        Ackermann, "max_steering", differs="path.robot.max_steering"
    )
    max_steering_rate: Annotated[Positive, SHAPED] = setting(
        Ackermann, "max_steering_rate", differs="path.robot.max_steering_rate"
    )


class PathObstacleSettings(Section):
    """Obstacles on the path, their prediction by the robot, and the cost of avoiding them: see
    `jaxplore.Traffic`, `jaxplore.PathScenario` and `jaxplore.planning.avoidance_cost`.

    Args:
        number: number of discs that move along the path.
        seed: seed of the obstacles' positions; the run's when absent.
        discs: (x, y, radius) of static discs [m].
        polygons: lists of corners of static polygons [m].
    """

    number: Obstacles = 0
    radius: Annotated[Length, IN_TRAFFIC] = setting(Traffic.random, "radius")
    speeds: Annotated[tuple[Real, Real], IN_TRAFFIC] = setting(Traffic.random, "rates")
    seed: Annotated[Seed | None, IN_TRAFFIC] = None
    discs: Annotated[tuple[tuple[Real, Real, Positive], ...], Field(max_length=MOST_OBSTACLES)] = ()
    polygons: Annotated[
        tuple[Annotated[tuple[Point, ...], Field(max_length=MOST_OBSTACLES)], ...],
        Field(max_length=MOST_OBSTACLES),
    ] = ()
    clearance: Annotated[Body, AMONG_OBSTACLES] = setting(avoidance_cost, "clearance")
    margin: Annotated[Margin, AMONG_OBSTACLES] = setting(avoidance_cost, "margin")
    caution: Annotated[NonNegative, AMONG_OBSTACLES] = setting(avoidance_cost, "caution")
    weight: Annotated[NonNegative, AMONG_OBSTACLES] = setting(avoidance_cost, "weight")
    prediction: Literal["constant-turn", "constant-velocity"] = setting(PathScenario, "prediction")
    growth: NonNegative = setting(PathScenario, "growth")
    turn_growth: NonNegative = setting(PathScenario, "turn_growth")


class ContouringSettings(ContouringNumbers):
    """Contouring control along a path with a corridor and obstacles: see `jaxplore.mpcc`.

    Args:
        risk_level: level of the conditional value at risk of the obstacle cost over `num_outcomes`
            sampled motions of the obstacles; the cost of the mean motion, with `caution`, when
            absent.
    """

    corridor_margin: Margin = setting(mpcc, "corridor_margin")
    risk_level: Annotated[Annotated[float, Field(ge=0, lt=1)] | None, AMONG_OBSTACLES] = None
    num_outcomes: Outcomes = setting(mpcc, "num_outcomes")


class PathSettings(RunSettings):
    """Settings of a path-following run; a setting that is not given has its default.

    Args:
        path: a file, see `jaxplore.maps.read_path`, or `track`.
        half_width: half width of the corridor if the path file does not define one [m].
        time_limit: simulated time [s].
        track: the generated track, for the path `track`.
        robot: the robot.
        obstacles: obstacles on the path.
        controller: settings of contouring control.
    """

    path: str = TRACK
    method: Annotated[Literal["cubic", "monotone", "akima"], FROM_FILE] = setting(
        read_path, "method"
    )
    is_closed: Annotated[bool | None, FROM_FILE] = setting(read_path, "is_closed")
    half_width: Annotated[Length | None, FROM_FILE] = None
    laps: Laps = setting(PathScenario, "laps")
    goal_radius: Length = setting(PathScenario, "goal_radius")
    goal_speed: Positive = setting(PathScenario, "goal_speed")
    time_limit: Duration = 120.0
    control_rate: Rate = setting(PathScenario, "control_rate")
    track: TrackSettings = TrackSettings()
    robot: PathRobotSettings = PathRobotSettings()
    obstacles: PathObstacleSettings = PathObstacleSettings()
    controller: ContouringSettings = ContouringSettings()


PathFollowingSettings = with_capabilities(PathSettings, dimensions=1)
"""The settings with a section for each capability of a robot along a path."""


def make_path_settings(entries: dict[str, Any]) -> PathSettings:
    """Check settings entries of a path-following run, and fill in defaults."""
    return check_section(PathFollowingSettings, under_their_settings(entries, ContouringSettings))
