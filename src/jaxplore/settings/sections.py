"""Base classes of settings, and how they are read and checked."""

import os
import re
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from pydantic_core import PydanticCustomError

from jaxplore._files import parse_yaml, read_bytes
from jaxplore._limits import (
    BROADEST,
    FINEST,
    HIGHEST_RATE,
    LARGEST,
    LONGEST,
    LONGEST_LATENCY,
    LONGEST_RANGE,
    LONGEST_TIME,
    LOWEST_RATE,
    MOST_BEAMS,
    MOST_BENDS,
    MOST_DELAY,
    MOST_DIRECTIONS,
    MOST_LAPS,
    MOST_LOOKS,
    MOST_NAMES,
    MOST_OBSTACLES,
    MOST_OUTCOMES,
    MOST_SAMPLES,
    MOST_STEPS_AHEAD,
    SHORTEST_TIME,
    SMALLEST,
    WIDEST,
)
from jaxplore._spelling import spelled
from jaxplore._text import printable_path, short_repr
from jaxplore.settings.defaults import setting
from jaxplore.settings.own import check_trusted
from jaxplore.simulation.faults import Faults
from jaxplore.simulation.variation import Variation


def _not_tiny(value: float) -> float:
    # Smaller numbers, or their squares, are zero in float32.
    if value < SMALLEST:
        raise PydanticCustomError("too_small", "at least {least}", {"least": SMALLEST})
    return value


Real = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(gt=0, le=LARGEST), AfterValidator(_not_tiny)]
NonNegative = Annotated[float, Field(ge=0, le=LARGEST)]
Negative = Annotated[float, Field(lt=0, ge=-LARGEST)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Share = Annotated[float, Field(gt=0, le=1), AfterValidator(_not_tiny)]
Seed = Annotated[int, Field(ge=0, lt=2**32)]
Probability = Annotated[float, Field(gt=0, lt=1)]
Steering = Annotated[float, Field(gt=0, lt=1.57), AfterValidator(_not_tiny)]

# Sizes: what the memory or the time of a run grows with.
Length = Annotated[float, Field(gt=0, le=LONGEST), AfterValidator(_not_tiny)]
Body = Annotated[float, Field(gt=0, le=BROADEST), AfterValidator(_not_tiny)]
Margin = Annotated[float, Field(ge=0, le=BROADEST)]
Range = Annotated[float, Field(gt=0, le=LONGEST_RANGE), AfterValidator(_not_tiny)]
Width = Annotated[float, Field(gt=0, le=WIDEST)]
Spacing = Annotated[float, Field(ge=FINEST, le=LONGEST)]
Duration = Annotated[float, Field(gt=0, le=LONGEST_TIME), AfterValidator(_not_tiny)]
Wait = Annotated[float, Field(ge=0, le=LONGEST_TIME)]
Latency = Annotated[float, Field(ge=0, le=LONGEST_LATENCY)]
Step = Annotated[float, Field(ge=SHORTEST_TIME, le=LONGEST_TIME)]
Rate = Annotated[float, Field(ge=LOWEST_RATE, le=HIGHEST_RATE)]
Samples = Annotated[int, Field(ge=1, le=MOST_SAMPLES)]
StepsAhead = Annotated[int, Field(ge=1, le=MOST_STEPS_AHEAD)]
Outcomes = Annotated[int, Field(ge=1, le=MOST_OUTCOMES)]
Beams = Annotated[int, Field(ge=1, le=MOST_BEAMS)]
Headings = Annotated[int, Field(ge=1, le=MOST_DIRECTIONS)]
Directions = Annotated[int, Field(ge=4, le=MOST_DIRECTIONS)]
Looks = Annotated[int, Field(ge=1, le=MOST_LOOKS)]
Delay = Annotated[int, Field(ge=0, le=MOST_DELAY)]
Obstacles = Annotated[int, Field(ge=0, le=MOST_OBSTACLES)]
Bends = Annotated[int, Field(ge=2, le=MOST_BENDS)]
Laps = Annotated[int, Field(ge=1, le=MOST_LAPS)]

Interval = tuple[NonNegative, NonNegative]
Positives = tuple[Positive, Positive]
Delays = tuple[Delay, Delay]
ParameterisationName = Literal["direct", "smooth", "knots"]
NoiseName = Literal["gaussian", "coloured", "sobol", "bank"]
WeightingName = Literal["softmax", "adaptive", "elite"]
SETTINGS_LIMIT = 1_000_000
"""Largest settings file that is read [bytes]."""
Parameters = Annotated[
    dict[str, Real | Annotated[list[Real], Field(max_length=MOST_NAMES)]],
    Field(max_length=MOST_NAMES),
]
"""Controller parameters by path; a list for an array."""


class Section(BaseModel):
    """A section of settings. It rejects unknown names and values that are not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _spelled(cls, value: Any, info: ValidationInfo) -> Any:
        """Accept words in either spelling, `weighted_vote` and `weighted-vote`."""
        annotation = cls.model_fields[str(info.field_name)].annotation
        return spelled(value, get_args(annotation)) if get_origin(annotation) is Literal else value


class FaultSettings(Section):
    """Injected faults: see `jaxplore.Faults`."""

    scan_dropout: Interval = setting(Faults, "scan_dropout")
    lost_odometry: Interval = setting(Faults, "lost_odometry")
    frozen_odometry: Interval = setting(Faults, "frozen_odometry")
    control_delay: Delay = setting(Faults, "control_delay")


class VariationSettings(Section):
    """The variation of the true robot from episode to episode: see `jaxplore.Variation`.

    Args:
        parameters: intervals of parameters of the robot's model by their path, such as `drag`.
    """

    parameters: Annotated[dict[str, tuple[Real, Real]], Field(max_length=MOST_NAMES)] = Field(
        default_factory=dict
    )
    gain: Positives = setting(Variation, "gain")
    slip: Interval = setting(Variation, "slip")
    turn_slip: Interval = setting(Variation, "turn_slip")
    control_delay: Delays = setting(Variation, "control_delay")
    control_noise: Interval = setting(Variation, "control_noise")
    position_noise: Interval = setting(Variation, "position_noise")
    heading_noise: Interval = setting(Variation, "heading_noise")


class AdaptiveHorizonSettings(Section):
    """A horizon that each step chooses anew: see `jaxplore.control.AdaptiveHorizon`.

    Args:
        rule: what the horizon depends on; none for a fixed horizon. The greatest number of steps is
            the horizon of the controller.
        min_horizon: least number of steps.
        at_shortest: speed [m/s], clearance [m] or information [nat/beam] at which the horizon is
            the shortest; the default of the rule when absent.
        at_longest: value at which it is the longest, likewise.
    """

    rule: Literal["speed", "clearance", "information"] | None = None
    min_horizon: StepsAhead = 20
    at_shortest: Real | None = None
    at_longest: Real | None = None


class RunSettings(Section):
    """Settings that all kinds of runs share.

    Args:
        start: start pose (x, y, yaw) [m, m, rad]; some maps and worlds define their own.
        latency: time between an observation and the effect of its command, for which the
            controller plans: see `jaxplore.LatencyCompensation` [s].
        adaptive_horizon: a horizon that each step chooses anew.
        faults: injected faults.
        variation: variation of the true robot from episode to episode.
        time_limit: simulated time after which the run ends [s].
        seed: seed of all random numbers of the run.
        parameters: controller parameters by path, which override those that follow from the other
            settings: see `jaxplore.get_parameters`. A list sets each element of an array.
    """

    start: tuple[Real, Real, Real] | None = None
    time_limit: Duration
    seed: Seed = 0
    parameters: Parameters = Field(default_factory=dict)
    latency: Latency = 0.0
    adaptive_horizon: AdaptiveHorizonSettings = AdaptiveHorizonSettings()
    faults: FaultSettings = FaultSettings()
    variation: VariationSettings = VariationSettings()


def read_settings(path: str | os.PathLike[str], *, is_trusted: bool = False) -> dict[str, Any]:
    """Read settings from a YAML file.

    Args:
        path: path of the file.
        is_trusted: whether the file may name code, MODULE:NAME, see `jaxplore.settings.own`.

    Raises:
        ValueError: a file that is missing, unreadable, too large, not YAML, too intricate or not a
            mapping, or that names code and is not trusted.
    """
    where = f"settings file {printable_path(Path(path))}"
    data = read_bytes(Path(path), "a settings YAML", SETTINGS_LIMIT, f"{where} cannot be read: it")
    try:
        entries = parse_yaml(data.decode(), SETTINGS_LIMIT)
    except ValueError as error:
        raise ValueError(f"{where} is not YAML: {error}") from None
    if not isinstance(entries, dict):
        raise ValueError(f"{where} holds {type(entries).__name__}; accepted: a mapping of settings")
    if not is_trusted:
        check_trusted(entries, path)
    return entries


def checked_section[Checked: BaseModel](kind: type[Checked], entries: dict[str, Any]) -> Checked:
    """Check settings entries against a section.

    Raises:
        ValueError: an unknown name or a value that is not accepted; one line that names it.
    """
    try:
        return kind.model_validate(entries)
    except ValidationError as error:
        # Messages have one line, so only one error is reported. An unknown name comes first: in a
        # file that holds no settings at all, the missing map would explain nothing.
        errors = error.errors()
        unknown = (each for each in errors if each["type"] == "extra_forbidden")
        first = next(unknown, errors[0])
        where, given = first["loc"], (first["type"], first["input"], first["msg"])
        raise ValueError(_one_line(kind, where, *given)) from None


def _one_line(
    settings: type[BaseModel],
    where: tuple[int | str, ...],
    kind: str,
    value: object,
    message: str,
) -> str:
    if not where:
        # A name that is no text, or no mapping at all.
        names = value if isinstance(value, dict) else {}
        wrong = next((each for each in names if not _is_text(each)), value)
        return f"a setting is named {short_repr(wrong)}; accepted: text in UTF-8"
    if where[0] == "parameters" and len(where) > 2:
        # Behind the path of a parameter there is the type that was tried, one of two.
        where, message = where[:2], "a number or a list of numbers"
    name = ".".join(str(part) for part in where)
    if kind == "extra_forbidden":
        # The accepted names are those of the section that holds the unknown one.
        section = settings
        for part in where[:-1]:
            inner = section_class(section.model_fields[str(part)].annotation)
            assert inner is not None
            section = inner
        return f"unknown setting {name}; accepted here: {', '.join(section.model_fields)}"
    if kind == "missing":
        return f"setting {name} is missing; accepted: the YAML file of a ROS map, or office"
    if kind == "too_long":
        most = re.search(r"at most (\d+)", message)
        message = f"at most {most[1]} entries" if most else message
    accepted = "a list" if kind == "tuple_type" else message.removeprefix("Input should be ")
    return f"setting {name} is {short_repr(value)}; accepted: {accepted}"


def _is_text(name: object) -> bool:
    """Check whether a name is text that can be encoded."""
    if not isinstance(name, str):
        return False
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def section_class(annotation: Any) -> type[BaseModel] | None:
    """Return the section class of a field, optional ones included; None for other fields."""
    for each in (annotation, *get_args(annotation)):
        if isinstance(each, type) and issubclass(each, BaseModel):
            return each
    return None
