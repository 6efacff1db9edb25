"""Settings of a path-following run."""

from typing import Annotated, Any, Literal

from pydantic import Field

from jaxplore.dynamics.ackermann import Ackermann
from jaxplore.geometry.track import race_track
from jaxplore.maps.files.path_file import read_path
from jaxplore.planning.presets.path_following import avoidance_cost, mpcc
from jaxplore.settings.defaults import setting
from jaxplore.settings.own import WordsOrOwn
from jaxplore.settings.parameter_names import under_their_settings
from jaxplore.settings.robot import GROUND_ROBOTS, RobotSettings
from jaxplore.settings.sections import (
    Count,
    NonNegative,
    Number,
    ParameterisationName,
    Positive,
    RunSettings,
    Section,
    Share,
    Steering,
    WeightingName,
    checked_section,
)
from jaxplore.simulation.following.scenario import PathScenario
from jaxplore.simulation.following.traffic import Traffic

PATH = "path"
"""Name that selects path following in place of a map."""
TRACK = "track"
"""Name of the generated path."""

Point = tuple[float, float]
PathRobot = Annotated[str, WordsOrOwn(GROUND_ROBOTS)]


class TrackSettings(Section):
    """The generated track: see `jaxplore.race_track`."""

    seed: Number = setting(race_track, "seed")
    length: Positive = setting(race_track, "length")
    half_width: Positive = setting(race_track, "half_width")
    min_radius: Positive = setting(race_track, "min_radius")
    num_bends: Annotated[int, Field(ge=2)] = setting(race_track, "num_bends")


class PathRobotSettings(RobotSettings):
    """The robot, by default a race car of F1TENTH's size.

    Args:
        model: name of the robot's model; a `bicycle` has a radius and no steering dynamics. Or
            MODULE:NAME, a `jaxplore.Dynamics` of your own, which has its own numbers.
        length: length of a car [m].
        width: width of a car [m].
    """

    model: PathRobot = "ackermann"
    max_speed: Positive = setting(Ackermann, "max_speed")
    max_acceleration: Positive = setting(
        Ackermann, "max_acceleration", differs="path.robot.max_acceleration"
    )
    drag: NonNegative = setting(Ackermann, "drag")
    wheelbase: Positive = setting(Ackermann, "wheelbase", differs="path.robot.wheelbase")
    length: Positive = 0.58
    width: Positive = 0.31
    max_steering: Steering = setting(Ackermann, "max_steering", differs="path.robot.max_steering")
    max_steering_rate: Positive = setting(
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

    number: Number = 0
    radius: Positive = setting(Traffic.random, "radius")
    speeds: tuple[float, float] = setting(Traffic.random, "rates")
    seed: Number | None = None
    discs: tuple[tuple[float, float, Positive], ...] = ()
    polygons: tuple[tuple[Point, ...], ...] = ()
    clearance: Positive = setting(avoidance_cost, "clearance")
    margin: NonNegative = setting(avoidance_cost, "margin")
    caution: NonNegative = setting(avoidance_cost, "caution")
    weight: NonNegative = setting(avoidance_cost, "weight")
    prediction: Literal["constant-turn", "constant-velocity"] = setting(PathScenario, "prediction")
    growth: NonNegative = setting(PathScenario, "growth")
    turn_growth: NonNegative = setting(PathScenario, "turn_growth")


class ContouringNumbers(Section):
    """Contouring control along any path: see `jaxplore.mpcc`."""

    parameterisation: ParameterisationName = setting(mpcc, "parameterisation")
    noise: Literal["gaussian", "coloured"] = setting(mpcc, "noise")
    weighting: WeightingName = setting(mpcc, "weighting")
    effective_share: Share = setting(mpcc, "effective_share")
    horizon: Count = setting(mpcc, "horizon")
    num_samples: Count = setting(mpcc, "num_samples")
    dt: Positive = setting(mpcc, "dt")
    temperature: Positive = setting(mpcc, "temperature")
    contouring_weight: NonNegative = setting(mpcc, "contouring_weight")
    lag_weight: NonNegative = setting(mpcc, "lag_weight")
    progress_weight: NonNegative = setting(mpcc, "progress_weight")
    noise_share: Positive = setting(mpcc, "noise_share")
    progress_noise: Positive = setting(mpcc, "progress_noise")
    max_lateral: Positive = setting(mpcc, "max_lateral")
    max_longitudinal: Positive = setting(mpcc, "max_longitudinal")
    comfort_weight: NonNegative = setting(mpcc, "comfort_weight")


class ContouringSettings(ContouringNumbers):
    """Contouring control along a path with a corridor and obstacles: see `jaxplore.mpcc`.

    Args:
        risk_level: level of the conditional value at risk of the obstacle cost over `num_outcomes`
            sampled motions of the obstacles; the cost of the mean motion, with `caution`, when
            absent.
    """

    corridor_margin: NonNegative = setting(mpcc, "corridor_margin")
    risk_level: Annotated[float, Field(ge=0, lt=1)] | None = None
    num_outcomes: Count = setting(mpcc, "num_outcomes")


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
    method: Literal["cubic", "monotone", "akima"] = setting(read_path, "method")
    is_closed: bool | None = setting(read_path, "is_closed")
    half_width: Positive | None = None
    laps: Count = setting(PathScenario, "laps")
    time_limit: Positive = 120.0
    control_rate: Positive = setting(PathScenario, "control_rate")
    track: TrackSettings = TrackSettings()
    robot: PathRobotSettings = PathRobotSettings()
    obstacles: PathObstacleSettings = PathObstacleSettings()
    controller: ContouringSettings = ContouringSettings()


def make_path_settings(entries: dict[str, Any]) -> PathSettings:
    """Check settings entries of a path-following run, and fill in defaults.

    Raises:
        ValueError: an unknown name or a value that is not accepted; one line that names it.
    """
    return checked_section(PathSettings, under_their_settings(entries, ContouringSettings))
