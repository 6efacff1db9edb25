"""Every setting of a run along a path, from a YAML file or the command line."""

from typing import Annotated, Any, Literal

from pydantic import Field

from jaxplore.settings.exploration import RobotSettings
from jaxplore.settings.sections import Count, NonNegative, Parameters, Positive, Section, validated

PATH = "path"
"""In place of a map: the run is along a path."""
TRACK = "track"
"""The path that is generated instead of read."""

Number = Annotated[int, Field(ge=0)]
Point = tuple[float, float]
PathRobot = Literal["ackermann", "bicycle", "differential_drive", "unicycle"]


class TrackSettings(Section):
    """The generated track: seed of its shape, length, half width and least radius [m], bends."""

    seed: Number = 0
    length: Positive = 60.0
    half_width: Positive = 1.1
    min_radius: Positive = 1.5
    num_bends: Annotated[int, Field(ge=2)] = 6


class PathRobotSettings(RobotSettings):
    """The robot, by default a car of F1TENTH's size; `bicycle` has a radius and steers at once."""

    model: PathRobot = "ackermann"  # type: ignore[assignment]
    max_speed: Positive = 5.0
    max_acceleration: Positive = 6.0
    drag: NonNegative = 0.0
    wheelbase: Positive = 0.33
    length: Positive = 0.58
    width: Positive = 0.31
    max_steering: Annotated[float, Field(gt=0, lt=1.57)] = 0.42
    max_steering_rate: Positive = 3.2


class PathObstacleSettings(Section):
    """What is in the way. Moving: how many discs along the path, their radius [m], least and
    greatest speed [m/s], the seed of where they are (the run's when absent). Standing: discs
    (x, y, radius) and polygons, lists of corners [m]. And how far the robot keeps away: see
    `jaxplore.ObstacleDistanceCost`; what it knows: see `jaxplore.PathScenario`."""

    number: Number = 0
    radius: Positive = 0.2
    speeds: tuple[float, float] = (0.5, 1.5)
    seed: Number | None = None
    discs: tuple[tuple[float, float, Positive], ...] = ()
    polygons: tuple[tuple[Point, ...], ...] = ()
    clearance: Positive = 0.5
    margin: NonNegative = 0.05
    caution: NonNegative = 1.0
    weight: NonNegative = 100.0
    prediction: Literal["constant-turn", "constant-velocity"] = "constant-turn"
    growth: NonNegative = 0.1
    turn_growth: NonNegative = 0.1


class ContouringSettings(Section):
    """Contouring control: see `jaxplore.mpcc`. Noise of the controls is a share of half their
    range; `max_lateral` and `max_longitudinal` accelerations are free, beyond costs [m/s^2]."""

    horizon: Count = 30
    num_samples: Count = 512
    dt: Positive = 0.05
    temperature: Positive = 30.0
    contouring_weight: NonNegative = 10.0
    lag_weight: NonNegative = 50.0
    progress_weight: NonNegative = 500.0
    noise_share: Positive = 0.2
    progress_noise: Positive = 0.5
    corridor_margin: NonNegative = 0.05
    max_lateral: Positive = 7.0
    max_longitudinal: Positive = 7.0
    comfort_weight: NonNegative = 20.0
    risk_level: Annotated[float, Field(ge=0, lt=1)] | None = None
    num_outcomes: Count = 16


class PathSettings(Section):
    """Everything that a run along a path depends on.

    `path` is a file (see `jaxplore.read_path`) or track; `half_width` is the room on either side of
    one that says nothing about it [m]. With a `risk_level`, obstacles are weighed by the
    conditional value at risk over `num_outcomes` of where they may go. `parameters` are numbers of
    the controller by path, in place of what the settings come to: see `jaxplore.get_parameters`.
    """

    path: str = TRACK
    method: Literal["cubic", "monotone", "akima"] = "cubic"
    is_closed: bool | None = None
    half_width: Positive | None = None
    start: tuple[float, float, float] | None = None
    laps: Count = 1
    time_limit: Positive = 120.0
    control_rate: Positive = 50.0
    seed: Number = 0
    track: TrackSettings = TrackSettings()
    robot: PathRobotSettings = PathRobotSettings()
    obstacles: PathObstacleSettings = PathObstacleSettings()
    controller: ContouringSettings = ContouringSettings()
    parameters: Parameters = Field(default_factory=dict)


def make_path_settings(entries: dict[str, Any]) -> PathSettings:
    """Return checked settings.

    Raises:
        ValueError: an unknown name or a value that is not accepted; one line that names it.
    """
    return validated(PathSettings, entries)
