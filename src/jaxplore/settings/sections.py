"""Base classes of settings, and how they are read and checked."""

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

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
from jaxplore._spelling import match_spelling
from jaxplore._text import printable_path, short_repr
from jaxplore.settings.accepted_values import describe_accepted
from jaxplore.settings.code_names import check_trusted
from jaxplore.settings.readers import EVERY, Readers
from jaxplore.settings.readers import section_class as section_class


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
    readers: ClassVar[Readers] = EVERY
    """Runs that read the settings of the section that say nothing else."""

    @field_validator("*", mode="before")
    @classmethod
    def _match_spelling(cls, value: Any, info: Any) -> Any:
        """Accept words in either spelling, `weighted_vote` and `weighted-vote`."""
        annotation = cls.model_fields[str(info.field_name)].annotation
        return (
            match_spelling(value, get_args(annotation))
            if get_origin(annotation) is Literal
            else value
        )


ADAPTIVE = Readers(
    "runs with adaptive_horizon.rule",
    lambda settings: settings.adaptive_horizon.rule is not None,
    "adaptive_horizon.rule",
)


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

    readers = ADAPTIVE

    rule: Annotated[Literal["speed", "clearance", "information"] | None, EVERY] = None
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


def read_settings(path: str | os.PathLike[str], *, is_trusted: bool = False) -> dict[str, Any]:
    """Read settings from a YAML file, which names code (MODULE:NAME) only if it `is_trusted`, see
    `jaxplore.settings.code_names`. A file that is missing, unreadable, too large, not YAML, too
    intricate or not a mapping raises a `ValueError`."""
    where = f"settings file {printable_path(Path(path))}"
    data = read_bytes(Path(path), "a settings YAML", SETTINGS_LIMIT, f"{where} cannot be read: it")
    try:
        entries = parse_yaml(data.decode(), SETTINGS_LIMIT)
    except UnicodeDecodeError:
        raise ValueError(f"{where} is not YAML: it is no text in UTF-8") from None
    except ValueError as error:
        raise ValueError(f"{where} is not YAML: {error}") from None
    if not isinstance(entries, dict):
        raise ValueError(f"{where} holds {type(entries).__name__}; accepted: a mapping of settings")
    if not is_trusted:
        check_trusted(entries, path)
    return entries


def check_section[Checked: BaseModel](kind: type[Checked], entries: dict[str, Any]) -> Checked:
    """Check settings entries against a section."""
    try:
        return kind.model_validate(entries)
    except ValidationError as error:
        # Messages have one line, so only one error is reported. An unknown name comes first: in a
        # file that holds no settings at all, the missing map would explain nothing.
        errors = error.errors()
        unknown = (each for each in errors if each["type"] == "extra_forbidden")
        first = next(unknown, errors[0])
        raise ValueError(_one_line(kind, entries, first)) from None


def _one_line(settings: type[BaseModel], entries: dict[str, Any], error: ErrorDetails) -> str:
    where, kind, value, message = error["loc"], error["type"], error["input"], error["msg"]
    if not where or kind == "invalid_key":
        # A name that is no text, or no mapping at all.
        names = value if isinstance(value, dict) else {}
        wrong = next((each for each in names if not _is_text(each)), value)
        return f"a setting is named {short_repr(wrong)}; accepted: text in UTF-8"
    section, depth = _holder(settings, where)
    name = ".".join(map(str, where[:depth]))
    if kind == "extra_forbidden":
        # The accepted names are those of the section that holds the unknown one.
        return f"unknown setting {name}; accepted here: {', '.join(section.model_fields)}"
    accepted = describe_accepted(section, str(where[depth - 1]))
    if kind == "missing" and depth == len(where):
        accepted = "the YAML file of a ROS map, or office" if where == ("map",) else accepted
        return f"setting {name} is missing; accepted: {accepted}"
    # Behind the setting, a place has the keys and indices of its value. Where several types are
    # accepted, the name of the one that was tried comes first, which is none of them.
    found = _at(entries, where[:depth])
    for part in where[depth:]:
        if not _has(found, part):
            return f"setting {name} is {short_repr(found)}; accepted: {accepted}"
        found, name = found[part], f"{name}.{part}"
        accepted = accepted.removeprefix("mapping of names to ")
    if kind == "model_type":
        accepted = "a mapping of settings"
    elif kind == "too_long":
        most = re.search(r"at most (\d+)", message)
        accepted = f"at most {most[1]} entries" if most else message
    elif kind not in _OF_ANOTHER_TYPE or isinstance(where[-1], int):
        accepted = message.removeprefix("Input should be ").split(", unable to parse")[0]
    return f"setting {name} is {short_repr(value)}; accepted: {accepted}"


def _holder(section: type[BaseModel], where: tuple[int | str, ...]) -> tuple[type[BaseModel], int]:
    """Return the section that holds a setting, and how many parts of a place name the setting."""
    for depth, part in enumerate(where, start=1):
        field = section.model_fields.get(str(part))
        inner = None if field is None else section_class(field.annotation)
        if inner is None or depth == len(where):
            break
        section = inner
    return section, depth


_OF_ANOTHER_TYPE = (
    *("tuple_type", "list_type", "dict_type", "string_type"),
    *("float_parsing", "int_parsing", "bool_parsing"),
)
"""Errors of pydantic for a value that is no tuple, list, mapping or text, and for a text that is no
number or truth value."""


def _at(entries: Any, where: Iterable[int | str]) -> Any:
    """Return the entry at a place; None where the entries do not lead on, as below a section that
    was given as an object."""
    for part in where:
        if not _has(entries, part):
            return None
        entries = entries[part]
    return entries


def _has(entries: object, part: int | str) -> bool:
    """Check whether a mapping has a key, or a list or tuple an index."""
    if isinstance(part, int):
        return isinstance(entries, (list, tuple)) and part < len(entries)
    return isinstance(entries, dict) and part in entries


def _is_text(name: object) -> bool:
    """Check whether a name is text that can be encoded."""
    if not isinstance(name, str):
        return False
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def find_field(section: type[BaseModel], name: str) -> FieldInfo | None:
    """Return the field of a setting by its dotted name; None for an unknown name."""
    first, _, rest = name.partition(".")
    field = section.model_fields.get(first)
    if field is None or not rest:
        return field
    inner = section_class(field.annotation)
    return None if inner is None else find_field(inner, rest)
