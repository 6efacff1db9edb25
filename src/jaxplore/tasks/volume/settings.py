"""Settings of the exploration of a volume by a quadrotor."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from jaxplore._limits import LONGEST, MOST_BEAMS, MOST_NAMES
from jaxplore.belief.volume import VolumePerception
from jaxplore.dynamics.goal import Goal
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.maps.files.volume_file import SUFFIXES, read_volume
from jaxplore.maps.generators.volumes import generate_volume
from jaxplore.parts.registry import with_capabilities
from jaxplore.planning.presets.volume import ARCHITECTURES as INFORMATIVE
from jaxplore.planning.presets.volume import (
    volume_explorer,
    volume_informative_mppi,
    volume_target_explorer,
)
from jaxplore.sensing.volume import DepthCamera, RingLidar
from jaxplore.settings.architectures import BASELINES, BY_RULE
from jaxplore.settings.code_names import WordsOrOwn
from jaxplore.settings.defaults import in_degrees, setting
from jaxplore.settings.readers import Readers, architectures
from jaxplore.settings.robot import SensorModelSettings, ViewDegrees
from jaxplore.settings.sections import (
    Body,
    Duration,
    Headings,
    Length,
    Margin,
    NonNegative,
    Positive,
    Probability,
    Range,
    Rate,
    Real,
    RunSettings,
    Samples,
    Section,
    Seed,
    Share,
    Spacing,
    Step,
    StepsAhead,
    check_section,
)
from jaxplore.simulation.volume.scenario import VolumeScenario

VOLUME = "volume"
"""Name that selects the exploration of a volume in place of a map."""
GENERATED = {
    "forest": "forest",
    "office3d": "office",
    "maze3d": "maze",
    "cave3d": "cave",
    "warehouse3d": "warehouse",
}
"""Kinds of generated volumes by the word that selects one. The ends keep them apart from maps."""
ARCHITECTURES = ("explorer", *INFORMATIVE, *BASELINES)
"""Architectures of the library for volumes."""

Pixels = Annotated[int, Field(ge=1, le=MOST_BEAMS)]
Extent = Annotated[float, Field(ge=1.0, le=LONGEST)]


def names_volume(name: object) -> bool:
    """Check whether a name on the command line is that of a volume: a word or a file."""
    if not isinstance(name, str):
        return False
    return name in (VOLUME, *GENERATED) or Path(name).suffix.lower() in SUFFIXES


GENERATED_ONLY = Readers(
    "generated volumes", lambda settings: settings.volume in GENERATED, "volume"
)
FROM_FILE = Readers(
    "volumes from a file", lambda settings: settings.volume not in GENERATED, "volume"
)
INFORMED = architectures(*INFORMATIVE)


class GeneratedSettings(Section):
    """The generated volume: see `jaxplore.generate_volume`.

    Args:
        size: extents (x, y, z) [m]; 20 m by 15 m by 3 m when absent, and 5.6 m high for a maze,
            which has then two storeys.
    """

    readers = GENERATED_ONLY

    seed: Seed = setting(generate_volume, "seed")
    size: tuple[Extent, Extent, Extent] | None = None


class VolumeFileSettings(Section):
    """The file of a volume: see `jaxplore.maps.read_volume`."""

    readers = FROM_FILE

    scale: Positive | None = setting(read_volume, "scale")
    up: Literal["x", "y", "z"] | None = setting(read_volume, "up")
    is_open: bool = setting(read_volume, "is_open")
    min_points: Samples = setting(read_volume, "min_points")


class VolumeRobotSettings(Section):
    """The quadrotor: see `jaxplore.Quadrotor`."""

    mass: Positive = setting(Quadrotor, "mass")
    radius: Body = setting(Quadrotor, "radius")
    max_speed: Positive = setting(volume_explorer, "max_speed")


class DepthCameraSettings(Section):
    """The depth camera: see `jaxplore.DepthCamera`.

    Args:
        tilt_degrees: pitch of the middle of the view, negative downwards [degrees]; level when
            absent, and 20 degrees upwards in a generated maze, where a level camera would not see
            enough of the storey above to fly there.
    """

    columns: Pixels = setting(DepthCamera, "columns")
    rows: Pixels = setting(DepthCamera, "rows")
    max_range: Range = setting(DepthCamera, "max_range")
    field_of_view_degrees: ViewDegrees = setting(DepthCamera, "field_of_view", in_degrees)
    vertical_view_degrees: ViewDegrees = setting(DepthCamera, "vertical_view", in_degrees)
    tilt_degrees: Annotated[float, Field(ge=-90, le=90)] | None = None
    range_noise: NonNegative = setting(DepthCamera, "range_noise")
    quadratic_noise: NonNegative = setting(DepthCamera, "quadratic_noise")


class RingLidarSettings(Section):
    """The lidar: see `jaxplore.RingLidar`."""

    rings: Pixels = setting(RingLidar, "rings")
    columns: Pixels = setting(RingLidar, "columns")
    max_range: Range = setting(RingLidar, "max_range")
    field_of_view_degrees: Annotated[float, Field(gt=0, le=360)] = setting(
        RingLidar, "field_of_view", in_degrees
    )
    lowest_degrees: Annotated[float, Field(ge=-90, le=90)] = setting(
        RingLidar, "lowest", in_degrees
    )
    highest_degrees: Annotated[float, Field(ge=-90, le=90)] = setting(
        RingLidar, "highest", in_degrees
    )
    range_noise: NonNegative = setting(RingLidar, "range_noise")
    quadratic_noise: NonNegative = setting(RingLidar, "quadratic_noise")


class VolumeFieldSettings(Section):
    """The information and guidance fields: see `jaxplore.belief.VolumePerception`."""

    margin: Margin = setting(VolumePerception, "margin")
    decay_length: Positive = setting(VolumePerception, "decay_length")
    min_information: Positive = setting(VolumePerception, "min_information")
    occupancy_prior: Probability = setting(VolumePerception, "occupancy_prior")
    patience: Positive = setting(VolumePerception, "patience")
    memory: Positive = setting(VolumePerception, "memory")
    turning: NonNegative = setting(VolumePerception, "turning")
    num_sectors: Headings = setting(VolumePerception, "num_sectors")
    num_elevations: Headings = setting(VolumePerception, "num_elevations")
    max_clearance: Body = setting(VolumePerception, "max_clearance")
    window: tuple[Extent, Extent, Extent] | None = setting(VolumePerception, "window")
    unknown_factor: NonNegative = setting(VolumePerception, "unknown_factor")


class VolumeControllerSettings(Section):
    """MPPI and its costs: see `jaxplore.volume_explorer`, and
    `jaxplore.planning.volume_informative_mppi` for two-layer and parallel."""

    horizon: StepsAhead = setting(volume_explorer, "horizon")
    num_samples: Samples = setting(volume_explorer, "num_samples")
    dt: Step = setting(volume_explorer, "dt")
    temperature: Positive = setting(volume_explorer, "temperature")
    clearance: Body = setting(volume_explorer, "clearance")
    obstacle_weight: NonNegative = setting(volume_explorer, "obstacle_weight")
    guidance_weight: NonNegative = setting(volume_explorer, "guidance_weight")
    information_weight: NonNegative = setting(volume_explorer, "information_weight")
    blind_weight: NonNegative = setting(volume_explorer, "blind_weight")
    attitude_weight: NonNegative = setting(volume_explorer, "attitude_weight")
    speed_weight: NonNegative = setting(volume_explorer, "speed_weight")
    control_weight: NonNegative = setting(volume_explorer, "control_weight")
    bias_fraction: Annotated[Share, INFORMED] = setting(volume_informative_mppi, "bias_fraction")
    likelihood_ratio: Annotated[bool, INFORMED] = setting(
        volume_informative_mppi, "likelihood_ratio"
    )
    reference_speed: Annotated[Positive, INFORMED] = setting(
        volume_informative_mppi, "reference_speed"
    )
    reference_steps: Annotated[StepsAhead, INFORMED] = setting(
        volume_informative_mppi, "reference_steps"
    )
    reference_weight: Annotated[NonNegative, INFORMED] = setting(
        volume_informative_mppi, "reference_weight"
    )
    field_weight: Annotated[NonNegative, INFORMED] = setting(
        volume_informative_mppi, "field_weight"
    )


class VolumeTargetSettings(Section):
    """Targets of rule-based explorers: see `jaxplore.planning.VolumeTargetExplorer`."""

    readers = BY_RULE

    min_information: Positive = setting(volume_target_explorer, "min_information")
    min_frontier: NonNegative = setting(volume_target_explorer, "min_frontier")
    near: Length = setting(volume_target_explorer, "near")


class VolumeRatesSettings(Section):
    """Rates of control, sensing and fields: see `jaxplore.VolumeScenario`."""

    control: Rate = setting(VolumeScenario, "control_rate")
    sensing: Rate = setting(VolumeScenario, "sensing_rate")
    fields: Rate = setting(VolumeScenario, "field_rate")


class VolumeSettings(RunSettings):
    """Settings of the exploration of a volume; a setting that is not given has its default.

    Args:
        volume: `forest`, `office3d`, `maze3d`, `cave3d` or `warehouse3d`, which are generated, or a
            file: a mesh (STL, OBJ, PLY, GLB, GLTF, DAE), a point cloud (PLY, PCD, LAS, LAZ), an
            OctoMap (BT, OT) or an array (NPY, NPZ).
        start: start (x, y, z, yaw) with z up [m, m, m, rad]; generated volumes have their own.
        architecture: `explorer`, `two-layer`, `parallel`, or a rule-based explorer by the name of
            its rule, such as `nearest-cluster`. Or MODULE:NAME of your own, a rule
            (`jaxplore.planning.TargetRule`) or a function from a scenario to a controller.
        search: targets to find, a list of places (x, y, z) with z up [m]; the run then ends when
            all have been seen.
        goal: goal (x, y, z) with z up [m]; the run then ends when the robot has come to rest there.
        guard: whether the robot brakes while its pose, its scan or its motion cannot be true, and
            where a command would bring it too close to what its sensors meet or do not know.
        time_limit: simulated time [s].
        generated: the generated volume.
        file: the file of a volume.
        robot: the robot.
        camera: the depth camera, which is the primary sensor; null for none.
        lidar: the lidar; none when absent.
        sensor_model: inverse sensor model, the update of a voxel by a measurement.
        fields: the information and guidance fields.
        controller: MPPI of all architectures.
        targets: places to which rule-based explorers fly.
        rates: rates of control, sensing and fields.
    """

    volume: str = "forest"
    start: tuple[Real, Real, Real, Real] | None = None  # type: ignore[assignment]
    architecture: Annotated[str, WordsOrOwn(ARCHITECTURES)] = "explorer"
    resolution: Spacing = setting(generate_volume, "resolution")
    search: Annotated[tuple[tuple[Real, Real, Real], ...], Field(max_length=MOST_NAMES)] = ()
    goal: tuple[Real, Real, Real] | None = None
    goal_radius: Length = setting(Goal, "radius")
    goal_heading: Real | None = setting(Goal, "heading")
    goal_tolerance: Positive = setting(Goal, "tolerance")
    goal_speed: Positive = setting(Goal, "speed")
    tracking_noise: tuple[NonNegative, NonNegative] = setting(VolumeScenario, "tracking_noise")
    guard: bool = False
    time_limit: Duration = 300.0
    target_coverage: Share = setting(VolumeScenario, "target_coverage")
    give_up_after: Duration | None = setting(VolumeScenario, "give_up_after")
    generated: GeneratedSettings = GeneratedSettings()
    file: VolumeFileSettings = VolumeFileSettings()
    robot: VolumeRobotSettings = VolumeRobotSettings()
    camera: DepthCameraSettings | None = DepthCameraSettings()
    lidar: RingLidarSettings | None = None
    sensor_model: SensorModelSettings = SensorModelSettings()
    fields: VolumeFieldSettings = VolumeFieldSettings()
    controller: VolumeControllerSettings = VolumeControllerSettings()
    targets: VolumeTargetSettings = VolumeTargetSettings()
    rates: VolumeRatesSettings = VolumeRatesSettings()


VolumeExplorationSettings = with_capabilities(VolumeSettings, dimensions=3)
"""The settings with a section for each capability of a robot in a volume."""


def make_volume_settings(entries: dict[str, Any]) -> VolumeSettings:
    """Check settings entries of the exploration of a volume, and fill in defaults."""
    if entries.get(VOLUME) == VOLUME:
        entries = {name: value for name, value in entries.items() if name != VOLUME}
    settings = check_section(VolumeExplorationSettings, entries)
    if not names_volume(settings.volume):
        raise ValueError(
            f"setting volume is {settings.volume!r}; accepted: {', '.join(GENERATED)}, or a file "
            f"that ends with {', '.join(SUFFIXES)}"
        )
    return settings
