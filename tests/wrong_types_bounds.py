"""Read the bounds that refusals state and try numbers on both sides, for `wrong_types_program.py`.

A refusal of a wrong value says what is accepted. Numbers just outside of it must be refused, with
the argument and the value, and numbers just inside must not.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

Call = Callable[..., Any]

SMALL = 1e-30
"""Distance from a bound of 0; a distance from any other is relative to it."""
WRONG_VALUES = ("wrong", math.nan, 10**30, -(10**30))
"""Values whose refusals state a bound: one of the first two if there is one."""

NUMBER = r"-?\d[\d.]*(?:e[+-]?\d+)?"
SIGNS = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}


@dataclass(frozen=True)
class Interval:
    """Numbers that are accepted."""

    is_whole: bool
    low: float = -math.inf
    high: float = math.inf
    is_low_open: bool = False
    is_high_open: bool = False
    hole: float | None = None

    def __str__(self) -> str:
        """Return what is accepted in words."""
        words = ["whole"] if self.is_whole else []
        if math.isfinite(self.low):
            words.append(f"{'>' if self.is_low_open else '>='} {self.low:.10g}")
        if math.isfinite(self.high):
            words.append(f"{'<' if self.is_high_open else '<='} {self.high:.10g}")
        if self.hole is not None:
            words.append(f"!= {self.hole:.10g}")
        return " ".join(words) or "finite"

    @property
    def inner(self) -> float:
        """Return a number that is far from the bounds."""
        if not math.isfinite(self.low):
            return min(1.0, self.high - 1.0)
        inner = min(2.0 * abs(self.low) + 1.0, 0.5 * (self.low + self.high))
        return math.ceil(inner) if self.is_whole else inner

    def __and__(self, other: "Interval") -> "Interval":
        low = max((self.low, self.is_low_open), (other.low, other.is_low_open))
        high = min((self.high, not self.is_high_open), (other.high, not other.is_high_open))
        is_whole = self.is_whole or other.is_whole
        hole = other.hole if self.hole is None else self.hole
        return Interval(is_whole, low[0], high[0], low[1], not high[1], hole)

    def holds(self, number: float) -> bool:
        """Return whether a number is accepted."""
        is_low = number > self.low or (number == self.low and not self.is_low_open)
        return is_low and (number < self.high or (number == self.high and not self.is_high_open))

    def outside(self) -> Iterator[float]:
        """Yield numbers that are not accepted, just beyond each bound."""
        yield from (math.nan, math.inf, -math.inf)
        if self.hole is not None:
            yield self.hole
        if self.is_whole:
            yield (self.low if math.isfinite(self.low) else self.high) + 0.5
        for bound, is_open, out in self._bounds():
            if self.is_whole:
                yield int(bound) + out * (not is_open)
            else:
                yield bound if is_open else _next(bound, out)

    def inside(self) -> Iterator[float]:
        """Yield numbers that are accepted, at each bound."""
        for bound, is_open, out in self._bounds():
            if self.is_whole:
                yield int(bound) - out * is_open
            else:
                yield _next(bound, -out) if is_open else bound

    def _bounds(self) -> list[tuple[float, bool, int]]:
        both = (self.low, self.is_low_open, -1), (self.high, self.is_high_open, 1)
        return [each for each in both if math.isfinite(each[0])]


def _next(bound: float, direction: int) -> float:
    if bound == 0.0:
        return direction * SMALL
    return float(np.nextafter(np.float32(bound), np.float32(direction * math.inf)))


def stated(said: str) -> Interval | None:
    """Return the interval of accepted numbers that a message states, None if it states none."""
    text = said.split("accepted: ")[-1]
    kinds = r"finite|whole number|positive number|numbers? [<>]|values|probabilit|less than|0 <="
    if not re.search(kinds, text) or re.search("tree|names|by the|function|different", text):
        return None
    result = Interval("whole" in text)
    if "positive number" in text:
        result &= Interval(False, 0.0, is_low_open=True)
    if "probabilit" in text:
        result &= Interval(False, 0.0, 1.0)
    for begin, low, high, end in re.findall(rf"in ([\[(])({NUMBER}), ({NUMBER})([\])])", text):
        result &= Interval(False, float(low), float(high), begin == "(", end == ")")
    for least in re.findall(rf"(?:within|less than) ({NUMBER}) m", text):
        is_open = "less" in text
        result &= Interval(False, -float(least), float(least), is_open, is_open)
    for hole in re.findall(rf"other than ({NUMBER})", text):
        result = replace(result, hole=float(hole))
    bounds = re.findall(rf"(?<!radius )([<>]=?) ({NUMBER})", text)
    bounds += [(SIGNS[sign], bound) for bound, sign in re.findall(rf"({NUMBER}) ([<>]=?)", text)]
    for sign, bound in bounds:
        is_open = len(sign) == 1
        if sign[0] == ">":
            result &= Interval(False, float(bound), is_low_open=is_open)
        else:
            result &= Interval(False, high=float(bound), is_high_open=is_open)
    return result


def places(value: object) -> Iterator[tuple[str, Callable[[Any], Any], object]]:
    """Yield the name of each place of numbers, what puts a number there, and the number there.

    Args:
        value: an accepted value of an argument.
    """
    yield "", lambda number: number, value
    if isinstance(value, Mapping) and value:
        first = next(iter(value))
        yield "[.]", lambda number: {**value, first: number}, value[first]
    if value is None or isinstance(value, (bool, int, float, str, Mapping)):
        return
    try:
        numbers = np.array(value)
    except (TypeError, ValueError):
        return
    if numbers.dtype.kind not in "iuf" or numbers.size == 0 or numbers.ndim == 0:
        return
    several = numbers.ndim == 1 and 1 < numbers.size <= 4
    for index in range(numbers.size if several else 1):

        def put(number: Any, index: int = index) -> Any:
            result = np.array(numbers, object)
            result.flat[index] = number
            return tuple(result.tolist()) if isinstance(value, tuple) else result.tolist()

        yield f"[{index}]" if several else "[.]", put, numbers.flat[index].item()


def message(call: Call, name: str, arguments: dict[str, Any]) -> tuple[bool, str]:
    """Return whether a call refuses an argument by its name, and its error; no text if none."""
    try:
        call(**arguments)
    except Exception as error:
        said = str(error).split("\n")[0]
        is_refusal = isinstance(error, (ValueError, TypeError)) and "accepted: " in said
        return is_refusal and name in said.split("accepted: ")[0], said
    return False, ""


def _shows(said: str, number: float) -> bool:
    shown = re.findall(rf"nan|-?inf|{NUMBER}", said.split("; accepted: ")[0])
    return any(
        math.isclose(float(each), number, rel_tol=1e-6, abs_tol=2 * SMALL)
        or (each == "nan" and math.isnan(number))
        for each in shown
    )


def bounds(
    call: Call, given: dict[str, Any], name: str, value: object, *, is_slow: bool
) -> dict[str, str]:
    """Return a line for each place of an argument whose refusals state a bound.

    A line is the bound, and what becomes of each number that ends in another way than its side of
    the bound says.

    Args:
        call: the call.
        given: accepted arguments.
        name: name of the argument.
        value: an accepted value of it.
        is_slow: whether numbers are not tried that are accepted.
    """
    lines: dict[str, str] = {}
    nowhere = ""
    for place, put, own in places(value):

        def said_of(number: Any, put: Callable[[Any], Any] = put) -> tuple[bool, str]:
            return message(call, name, given | {name: put(number)})

        found, texts = None, set()
        for index, wrong in enumerate(WRONG_VALUES):
            # In a trace no array is checked, so that only the text tells what is.
            if found is None and index == (1 if call.__name__ == "traced" else 2):
                break
            # It has no upper bound: a whole loop would run.
            if name == "num_trajectories" and index == 2:
                break
            is_refused, said = said_of(wrong)
            more = stated(said) if is_refused else None
            if more is not None:
                found = more if found is None else found & more
                texts.add(said.split("accepted: ")[-1])
        if found is None:
            continue
        is_own = isinstance(own, (int, float)) and not isinstance(own, bool) and found.holds(own)
        remarks = ["accepted numbers not tried"] if is_slow else []
        if not (is_slow and (is_own or value is None)):
            is_refused, said = said_of(own if is_own else found.inner)
            is_shape = said.startswith(f"{name} has shape ()")
            if is_shape or (is_refused and said.split("accepted: ")[-1] in texts):
                nowhere = said  # numbers of another shape are meant
                continue
            if said:
                remarks.append(f"{own if is_own else found.inner:.10g} inside: {said}")
        for number in () if is_slow else found.inside():
            if said := said_of(number)[1]:
                remarks.append(f"{number:.10g} inside: {said}")
        for number in found.outside():
            is_refused, said = said_of(number)
            if not (is_refused and _shows(said, number)):
                remarks.append(f"{number:.10g} outside: {said or 'accepted'}")
        lines[place] = "; ".join([str(found), *remarks])
    within = {line for place, line in lines.items() if place}
    if len(within) == 1:
        lines = ({"": lines[""]} if "" in lines else {}) | {"[.]": within.pop()}
    if lines.get("") == lines.get("[.]"):
        lines.pop("[.]", None)
    return {"": f"no example: {nowhere}"} if nowhere and not lines else lines
