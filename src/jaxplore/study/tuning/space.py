"""The search space: real numbers, whole numbers and choices."""

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxplore._files import parse_yaml
from jaxplore._optional import import_optional

type Value = float | int | str | bool
type Candidate = dict[str, Value]
"""Value of each parameter by name; the values are hashable and plain for JSON."""

AROUND = 10.0
"""Default bounds of a positive number: its value divided by this, and multiplied by this."""


@dataclasses.dataclass(frozen=True)
class Parameter:
    """A parameter of the search.

    Args:
        name: name of a setting, or path of a controller parameter; `name[i]` for one element.
        low: least value.
        high: greatest value.
        is_log: whether the scale is logarithmic.
        is_whole: whether values are whole numbers.
        choices: possible values, in place of bounds.

    Raises:
        ValueError: bounds that are missing, not finite or reversed; a logarithmic scale with a
                bound <= 0; no whole number between the bounds; fewer than two choices, or a
                repeated one.
    """

    name: str
    low: float | None = None
    high: float | None = None
    is_log: bool = False
    is_whole: bool = False
    choices: tuple[Value, ...] | None = None

    def __post_init__(self) -> None:
        if self.choices is not None:
            # 1, 1.0 and True are equal but different choices, so their texts are compared.
            if len(self.choices) < 2 or len(set(map(repr, self.choices))) != len(self.choices):
                raise ValueError(
                    f"choices of {self.name} are {list(self.choices)}; accepted: different values, "
                    "at least two"
                )
            return
        if self.low is None or self.high is None:
            raise ValueError(
                f"bounds of {self.name} are {self.low} and {self.high}; accepted: two numbers"
            )
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ValueError(
                f"bounds of {self.name} are {self.low:g} and {self.high:g}; accepted: finite ones, "
                "the lower first"
            )
        if self.is_whole and math.ceil(self.low) > math.floor(self.high):
            raise ValueError(
                f"bounds of {self.name} are {self.low:g} and {self.high:g}; accepted: some with a "
                "whole number between them"
            )
        if self.is_log and self.low <= 0.0:
            raise ValueError(
                f"lower bound of {self.name} is {self.low:g} on a logarithmic scale; accepted: a "
                "number > 0"
            )

    @property
    def size(self) -> int:
        """Number of choices; 0 for a number."""
        return 0 if self.choices is None else len(self.choices)

    def value(self, place: float) -> Value:
        """Map a number in [0, 1] to a value: `low` at 0, `high` at 1; choices have equal parts.

        A number is `low + u (high - low)`, on a logarithmic scale `low (high / low)^u`.
        """
        place = min(max(float(place), 0.0), 1.0)
        if self.choices is not None:
            # A place of 1 would be one past the last choice.
            return self.choices[min(int(place * self.size), self.size - 1)]
        low, high = self._ends()
        value = low + place * (high - low)
        return self.clip(math.exp(value) if self.is_log else value)

    def place(self, value: Value) -> float:
        """Map a value to [0, 1], the inverse of `value`. Values out of bounds are clipped."""
        if self.choices is not None:
            index = self.choices.index(value) if value in self.choices else 0
            return (index + 0.5) / self.size
        low, high = self._ends()
        number = float(value)
        if self.is_log:
            # The logarithm of a value <= 0 is guarded; such a value lies below every bound.
            number = math.log(max(number, 1e-300))
        return min(max((number - low) / (high - low), 0.0), 1.0)

    def _ends(self) -> tuple[float, float]:
        """Return the values at 0 and 1, or their logarithms on a logarithmic scale."""
        assert self.low is not None
        assert self.high is not None
        low, high = self.low, self.high
        if self.is_whole:
            # Every whole number gets an interval of length 1, the first and the last included.
            low, high = math.ceil(low) - 0.5, math.floor(high) + 0.5
        return (math.log(low), math.log(high)) if self.is_log else (low, high)

    def clip(self, value: Value) -> Value:
        """Return the nearest value within the bounds."""
        if self.choices is not None:
            return value if value in self.choices else self.choices[0]
        assert self.low is not None
        assert self.high is not None
        if self.is_whole:
            return min(max(round(float(value)), math.ceil(self.low)), math.floor(self.high))
        return min(max(float(value), self.low), self.high)

    def as_dict(self) -> dict[str, Any]:
        """Return the parameter as plain values for JSON."""
        if self.choices is not None:
            return {"choices": list(self.choices)}
        scale = {"log": True} if self.is_log else {}
        return {
            "low": self.low,
            "high": self.high,
            **scale,
            **({"whole": True} if self.is_whole else {}),
        }


@dataclasses.dataclass(frozen=True)
class Space:
    """The parameters of a search, mapped to a unit cube.

    Args:
        parameters: parameters with different names, at least one.

    Raises:
        ValueError: no parameters, or a repeated name.
    """

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        names = [each.name for each in self.parameters]
        if not names or len(set(names)) != len(names):
            raise ValueError(f"parameters are {names}; accepted: different names, at least one")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(each.name for each in self.parameters)

    def candidate(self, places: Sequence[float] | np.ndarray) -> Candidate:
        """Return the values at a point (N,) of the unit cube."""
        return {
            each.name: each.value(float(place))
            for each, place in zip(self.parameters, places, strict=True)
        }

    def places(self, candidate: Mapping[str, Value]) -> np.ndarray:
        """Return the point (N,) of the unit cube that corresponds to the values."""
        return np.array([each.place(candidate[each.name]) for each in self.parameters])


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER}):({_NUMBER})(:log|:whole|:log:whole)?")


def parse_parameter(text: str, start: Value | None = None) -> Parameter:
    """Parse a parameter: `NAME=LOW:HIGH`, `NAME=LOW:HIGH:log` or `NAME=A,B,C`.

    `NAME` alone is the range from a tenth to ten times its current value `start`. If that is a
    whole number, only whole numbers are searched.
    """
    name, separator, rest = (part.strip() for part in text.partition("="))
    # A bool is an int in Python, but no number to search between bounds.
    is_whole = isinstance(start, int) and not isinstance(start, bool)
    if not separator:
        if isinstance(start, bool | str | None) or not start > 0:
            raise ValueError(
                f"{name} is {start!r} now and has no bounds; accepted: {name}=LOW:HIGH, or "
                f"{name}=A,B for choices"
            )
        low, high = start / AROUND, start * AROUND
        if is_whole:
            # The logarithmic scale needs a lower bound above 0.
            low = max(1, round(low))
        return Parameter(name, low, high, is_log=True, is_whole=is_whole)
    found = _RANGE.fullmatch(rest)
    if found is not None:
        scale = found[3] or ""
        return Parameter(
            name,
            float(found[1]),
            float(found[2]),
            is_log="log" in scale,
            is_whole=is_whole or "whole" in scale,
        )
    if "," not in rest:
        raise ValueError(
            f"--tune is {text!r}; accepted: NAME=LOW:HIGH, NAME=LOW:HIGH:log, NAME=A,B,C or NAME"
        )
    try:
        values = tuple(parse_yaml(part) for part in rest.split(","))
    except ValueError:
        values = ()
    if not all(isinstance(value, float | int | str) for value in values) or not values:
        raise ValueError(f"--tune is {text!r}; accepted: numbers or words between commas")
    return Parameter(name, choices=values)


def distribution(parameter: Parameter) -> Any:
    """Convert a parameter to a distribution of Optuna."""
    distributions = import_optional("optuna.distributions", "tuning")
    if parameter.choices is not None:
        return distributions.CategoricalDistribution(parameter.choices)
    assert parameter.low is not None
    assert parameter.high is not None
    if parameter.is_whole:
        low, high = math.ceil(parameter.low), math.floor(parameter.high)
        return distributions.IntDistribution(low, high, log=parameter.is_log)
    return distributions.FloatDistribution(parameter.low, parameter.high, log=parameter.is_log)
