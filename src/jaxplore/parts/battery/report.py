"""Metrics and pictures of a battery and its dock."""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from PIL import ImageDraw

from jaxplore._types import Flag, Scalar
from jaxplore.maps.datum import move_points
from jaxplore.parts.battery.robot import Battery
from jaxplore.report._numbers import percent
from jaxplore.report.drawing.colours import SERIES, shade
from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.palette import PAPER, Colour
from jaxplore.report.drawing.series import line_style, style_time
from jaxplore.report.drawing.shapes import Surface
from jaxplore.report.exploration.window import Window
from jaxplore.report.metrics import Column, Curve
from jaxplore.report.of_parts import PartsData
from jaxplore.report.part import PartMetrics, PartReport

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DOCK: tuple[int, int, int] = (22, 128, 92)
"""Colour of a dock."""
RECHARGE = 0.05
"""Share of the capacity that a stay at the dock must add to count as a recharge."""


class BatteryRecord(NamedTuple):
    """The battery after a step.

    Args:
        charge: energy that is left, as a share of the capacity.
        is_docked: whether the robot is being charged.
    """

    charge: Scalar
    is_docked: Flag


@dataclasses.dataclass(frozen=True, kw_only=True)
class BatteryMetrics(PartMetrics):
    """Metrics of a battery; those of a fleet are of all its batteries.

    Args:
        recharges: number of stays at the dock that added 5 % of the capacity or more.
        charging_time: time at the dock [s].
        least_charge: least charge of the run, as a share of the capacity.
        final_charge: charge at the end.
        empty_at: time at which a battery was empty [s]; None if none was.
    """

    recharges: int
    charging_time: float
    least_charge: float
    final_charge: float
    empty_at: float | None

    columns = (
        Column.quartiles("recharges", "recharges"),
        Column.quartiles("least_charge", "least charge [%]", scale=100.0),
    )
    plotted = (Curve("charge", "charge [%]", 100.0, 104.0),)

    def rows(self) -> list[tuple[str, str]]:
        """Return the charge, the recharges, and whether the battery was empty."""
        charge = f"{percent(self.final_charge)} at the end, {percent(self.least_charge)} at least"
        rows = [("battery", charge)]
        if self.recharges:
            rows.append(("recharges", f"{self.recharges}, {self.charging_time:.1f} s at the dock"))
        if self.empty_at is not None:
            rows.append(("battery empty", f"after {self.empty_at:.2f} s"))
        return rows


@dataclasses.dataclass(frozen=True)
class BatteryReport(PartReport):
    """A battery and its dock; those of N robots of a fleet.

    Args:
        docks: (N, 2) positions of the docks [m].
        capacity: energy of the full battery [Wh].
        reserve: share of it that is to be left at the dock.
        charge: share of it at the start.
    """

    name: ClassVar[str] = Battery.name
    record_type: ClassVar[type | None] = BatteryRecord

    docks: np.ndarray
    capacity: float
    reserve: float
    charge: float

    def move(self, offset: np.ndarray) -> "BatteryReport":
        """Return the report with an offset (2,) [m] added to the docks."""
        return dataclasses.replace(self, docks=move_points(self.docks, offset))

    def charges(self, run: PartsData) -> np.ndarray:
        """Return the charge of each robot (N + 1, R) at all instants of a run."""
        rows = np.asarray(run.records.parts[self.name].charge).reshape(run.num_steps, -1)
        # The record of a step holds what is true at its end.
        return np.concatenate([np.full((1, len(self.docks)), self.charge), rows])

    def metrics(self, run: PartsData) -> BatteryMetrics:
        """Compute the metrics."""
        charges, period = self.charges(run), run.control_period
        is_docked = np.asarray(run.records.parts[self.name].is_docked, bool)
        stays = is_docked.reshape(run.num_steps, -1)
        empty = np.flatnonzero((charges <= 0.0).any(axis=1))
        return BatteryMetrics(
            recharges=sum(
                count_recharges(one, row) for one, row in zip(stays.T, charges.T, strict=True)
            ),
            charging_time=float(stays.sum()) * period,
            least_charge=float(charges.min()),
            final_charge=float(charges[-1].min()),
            empty_at=float(empty[0]) * period if len(empty) else None,
        )

    def series(self, run: PartsData) -> dict[str, np.ndarray]:
        """Return the charge at each instant, in a fleet the least one."""
        return {"charge": self.charges(run).min(axis=1)}

    def figures(self, run: PartsData) -> dict[str, Callable[[], "Figure"]]:
        """Return the figure of the charge."""
        return {"battery": partial(battery_figure, run, self)}

    def add_to_map(self, axes: "Axes", run: PartsData, window: Window) -> None:
        """Draw the docks."""
        places = window.place(self.docks) + window.corner
        axes.plot(
            *places.T,
            marker="P",
            markersize=11.0,
            color=shade(DOCK),
            markeredgecolor="white",
            linestyle="none",
            label="dock",
            zorder=4.8,
        )

    def add_to_space(self, axes: "Axes", frame: Any) -> None:
        """Draw the docks."""
        look: dict[str, Any] = {"color": shade(DOCK), "marker": "P", "s": 70, "label": "dock"}
        axes.scatter(*self.docks.T, **look)

    def draw(self, surface: Surface, draw: ImageDraw.ImageDraw, run: Any, frame: Any) -> None:
        """Draw the docks: a green square with a plus."""
        reach, unit = 7.0 * surface.unit, surface.unit
        for x, y in surface.pixels(self.docks).tolist():
            draw.rectangle((x - reach, y - reach, x + reach, y + reach), DOCK, PAPER, round(unit))
            for dx, dy in ((0.55 * reach, 0.0), (0.0, 0.55 * reach)):
                draw.line((x - dx, y - dy, x + dx, y + dy), PAPER, round(2.0 * unit))

    def footer(self, run: PartsData, frame: Any) -> str:
        """Return the charge in a frame, in a fleet the least one."""
        charges = self.charges(run).min(axis=1)
        return f"battery {100.0 * charges[min(frame.step, len(charges) - 1)]:.0f} %"

    def marks(self, frame: Any) -> list[tuple[np.ndarray, Colour]]:
        """Return the docks."""
        return [(place, DOCK) for place in self.docks]

    def legend(self) -> list[Entry]:
        """Return the entry of the dock."""
        return [Entry("dock", DOCK)]

    def colours(self) -> list[Colour]:
        """Return the colour of docks."""
        return [DOCK]


def count_recharges(is_docked: np.ndarray, charge: np.ndarray) -> int:
    """Return the number of stays at the dock (N,) that add `RECHARGE` to the charge (N + 1,)."""
    edges = np.diff(np.concatenate([[False], is_docked, [False]]).astype(int))
    begins, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    return int((charge[ends] - charge[begins] >= RECHARGE).sum())


def battery_figure(run: PartsData, report: BatteryReport) -> "Figure":
    """Draw the charge over time, the reserve, and when a robot was charged."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    charges = report.charges(run)
    for number, charge in enumerate(charges.T):
        name = "charge" if charges.shape[1] == 1 else f"robot {number + 1}"
        axes.plot(run.time, 100.0 * charge, linewidth=1.8, label=name, **line_style(number))
    record = run.records.parts[report.name]
    is_docked = np.asarray(record.is_docked, bool).reshape(run.num_steps, -1).any(axis=1)
    axes.fill_between(
        run.time[1:],
        0.0,
        1.0,
        where=is_docked.tolist(),
        transform=axes.get_xaxis_transform(),
        color=shade(DOCK),
        alpha=0.18,
        linewidth=0.0,
        label="at the dock",
    )
    level = 100.0 * report.reserve
    axes.axhline(level, color=SERIES[1], linewidth=1.0, linestyle="--", label="reserve")
    style_time(axes, max(float(run.time[-1]), run.control_period))
    axes.set(ylim=(0.0, 104.0), ylabel=f"charge of {report.capacity:g} Wh [%]")
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure
