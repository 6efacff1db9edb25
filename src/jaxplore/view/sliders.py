"""Sliders for the parameters of a controller."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxplore.view.history import plain

if TYPE_CHECKING:
    import viser

CHOSEN = (
    "weight",
    "weights",
    "temperature",
    "max_speed",
    "max_turn_rate",
    "speed",
    "limit",
    "clearance",
    "noise_std",
)
"""Last names of parameters that have a slider: what the robot wants, how bold and fast it is."""
POSITIVE = ("temperature", "max_speed", "max_turn_rate", "speed", "limit", "noise_std")
"""Those that must not be 0."""
LIMITS = ("max_speed", "max_turn_rate")
"""Limits of the robot: a slider may lower them only, because the robot cannot do more."""
MOST_ELEMENTS = 4
"""Largest number of elements of an array whose elements have sliders."""
REACH = 4.0
"""Upper end of a slider, as a multiple of the value at the start."""
STEPS = 200
"""Number of steps of a slider."""


class Range(NamedTuple):
    """Range of a slider: lower end, upper end, step and value at the start."""

    low: float
    high: float
    step: float
    initial: float


class Knob(NamedTuple):
    """A slider of a parameter, whose path is one of `get_parameters`.

    `element` is the index of the element that it sets; None for a parameter that is one number. The
    group is the cost term or the part of the controller, and the label the name within it.
    """

    path: str
    element: int | None
    group: str
    label: str
    range: Range


def choose_knobs(parameters: Mapping[str, Any]) -> tuple[Knob, ...]:
    """Choose the parameters, by path, that get sliders, in the order of the controller's parts."""
    knobs = []
    for path, value in parameters.items():
        group, name = _split(path)
        kind = name.partition("-")[0]
        values = np.asarray(value, np.float64)
        if kind not in CHOSEN or values.ndim > 1 or values.size > MOST_ELEMENTS:
            continue
        for index, each in enumerate(values.reshape(-1).tolist()):
            element = index if values.ndim else None
            label = name if element is None else f"{name} {element + 1}"
            knobs.append(Knob(path, element, group, label, slider_range(each, kind)))
    return tuple(knobs)


def _split(path: str) -> tuple[str, str]:
    """Return the group and the name of a parameter: `a.cost.obstacle.weight` is of `obstacle`."""
    *parts, name = path.split(".")
    if "cost" in parts:
        after = parts[parts.index("cost") + 1 :]
        return ".".join(after) or "all costs", name
    return ".".join(parts) or "controller", name


def slider_range(value: float, kind: str) -> Range:
    """Return the range of a slider around a value."""
    # Single precision has no more digits.
    initial = float(f"{value:.6g}")
    if kind in LIMITS:
        step = initial / STEPS
        return Range(step, initial, step, initial)
    high = _round_up(REACH * abs(initial)) if initial else 1.0
    step = high / STEPS
    if initial < 0.0:
        return Range(-high, high, step, initial)
    return Range(min(step, initial) if kind in POSITIVE else 0.0, high, step, initial)


def _round_up(value: float) -> float:
    """Return the least number of 1, 2 or 5 times a power of ten that is not below a value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(each * power for each in (1.0, 2.0, 5.0, 10.0) if each * power >= value * 0.999999)


class Sliders:
    """The sliders in an element of a page, and the parameters by path that they ask for."""

    def __init__(
        self, server: "viser.ViserServer", container: Any, parameters: Mapping[str, Any]
    ) -> None:
        self.knobs = choose_knobs(parameters)
        self._initial = {
            knob.path: np.asarray(parameters[knob.path], np.float64) for knob in self.knobs
        }
        self._asked: set[str] = set()
        self._handles: list[Any] = []
        self._folders: list[Any] = []
        groups = dict.fromkeys(knob.group for knob in self.knobs)
        for group in groups:
            with container:
                folder = server.gui.add_folder(plain(group))
            self._folders.append(folder)
        by_group = dict(zip(groups, self._folders, strict=True))
        for knob in self.knobs:
            with by_group[knob.group]:
                low, high, step, initial = knob.range
                handle = server.gui.add_slider(
                    plain(knob.label),
                    min=low,
                    max=high,
                    step=step,
                    initial_value=initial,
                    hint=plain(knob.path),
                )
            self._handles.append(handle)

    def values(self) -> dict[str, Any]:
        """Return the parameters that were moved, by path.

        Only the values of the page are read, so that a call costs little.
        """
        values: dict[str, np.ndarray] = {}
        for knob, handle in zip(self.knobs, self._handles, strict=True):
            low, high, _, initial = knob.range
            value = float(handle.value)
            if not math.isfinite(value):
                continue
            # A page could send anything.
            value = min(max(value, low), high)
            if value != initial:
                self._asked.add(knob.path)
            if knob.path not in self._asked:
                continue
            known = values.setdefault(knob.path, self._initial[knob.path].copy())
            if value != initial:
                known[() if knob.element is None else knob.element] = value
        return values

    def fit(self, parameters: Mapping[str, Any]) -> bool:
        """Return whether these are the sliders of a controller with such parameters."""
        names = [(knob.path, knob.element) for knob in self.knobs]
        return names == [(knob.path, knob.element) for knob in choose_knobs(parameters)]

    def reset(self) -> None:
        """Move all sliders back."""
        for knob, handle in zip(self.knobs, self._handles, strict=True):
            handle.value = knob.range.initial

    def remove(self) -> None:
        """Remove the sliders from the page."""
        for folder in self._folders:
            folder.remove()
