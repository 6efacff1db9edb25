"""Several controllers in the same place with the same seeds: a table, curves, animations."""

import contextlib
import dataclasses
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.report.animation import write_animation
from jaxplore.report.folder import MARK, run_folder
from jaxplore.report.metrics import Metrics
from jaxplore.report.save import DOTS_PER_INCH, settings_document
from jaxplore.simulation.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#1f6fb2", "#d1495b", "#2a7f5f", "#b5651d", "#7a5195", "#4a4e57")
"""Of the curves, in turn."""
CURVE_POINTS = 400
"""Points of a curve."""

Spread = tuple[float, float, float]
"""Lower quartile, median and upper quartile; infinite where too few runs have a value."""


@dataclasses.dataclass(frozen=True)
class Summary:
    """What the runs of one controller come to.

    Quartiles are over runs; one that did not finish counts as infinitely late, so no controller
    gains by failing where it is slow.

    Args:
        num_runs: how many there are.
        num_finished: that reached the end.
        finished_at: time of the end [s].
        time_to_90: until 90 % coverage [s].
        path_length: [m].
        information_per_metre: [nat/m]; 0 of a robot that did not move.
        final_unknown: share of the map's cells.
        coverage: at the end.
        collisions: in all runs together.
        minimum_clearance: the least of all runs [m]; infinite if nothing was near.
        command_jerk: [ranges/s^2].
        fault_steps: in all runs together.
    """

    num_runs: int
    num_finished: int
    finished_at: Spread
    time_to_90: Spread
    path_length: Spread
    information_per_metre: Spread
    final_unknown: Spread
    coverage: Spread
    collisions: int
    minimum_clearance: float
    command_jerk: Spread
    fault_steps: int


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Runs of several controllers, seed by seed.

    Args:
        runs: metrics by controller, one for each seed; the same seeds for all, unless the
            comparison was interrupted.
        recordings: of each controller's first seed.
        is_interrupted: the user stopped it; what is here was done before.
    """

    runs: Mapping[str, tuple[Metrics, ...]]
    recordings: Mapping[str, Recording]
    is_interrupted: bool = False

    def summaries(self) -> dict[str, Summary]:
        """Return what the runs of each controller come to."""
        return {name: summarise(metrics) for name, metrics in self.runs.items() if metrics}

    def rows(self) -> list[tuple[str, ...]]:
        """Return a table: its header, then one row for each controller; median [quartiles]."""
        header = (
            "",
            "finished",
            "after [s]",
            "90 % after [s]",
            "path [m]",
            "nat/m",
            "unknown [%]",
            "collisions",
            "clearance [m]",
            "jerk [1/s²]",
        )
        rows: list[tuple[str, ...]] = [header]
        for name, each in self.summaries().items():
            rows.append(
                (
                    name,
                    f"{each.num_finished} of {each.num_runs}",
                    _spread(each.finished_at, 1),
                    _spread(each.time_to_90, 1),
                    _spread(each.path_length, 1),
                    _spread(each.information_per_metre, 1),
                    _spread(tuple(100.0 * share for share in each.final_unknown), 1),
                    str(each.collisions),
                    _number(each.minimum_clearance, 2),
                    _spread(each.command_jerk, 0),
                )
            )
        return rows

    def __str__(self) -> str:
        return markdown(self.rows())

    def as_dict(self) -> dict[str, Any]:
        """Return everything but the recordings as plain values that JSON can hold.

        None stands for what is infinite.
        """
        summaries = {
            name: {key: _plain(value) for key, value in dataclasses.asdict(each).items()}
            for name, each in self.summaries().items()
        }
        runs = {name: [each.as_dict() for each in metrics] for name, metrics in self.runs.items()}
        return {"is_interrupted": self.is_interrupted, "summaries": summaries, "runs": runs}

    def save(
        self,
        path: str | PathLike[str],
        *,
        overwrite: bool = False,
        animation: bool = True,
        settings: Mapping[str, object] | None = None,
        on_progress: Callable[[float], None] = lambda _: None,
    ) -> None:
        """Write a folder: metrics.json, table.md, curves.png, and an animation for each controller.

        It appears complete or not at all.

        Args:
            path: the folder.
            overwrite: replace a former run or comparison.
            animation: draw the first seed of each controller, NAME.gif; Ctrl-C leaves out the rest.
            settings: written to settings.yaml: plain values only.
            on_progress: called with the share that is done, 0 to 1.

        Raises:
            ValueError: a folder that exists or cannot be written, a name that is no file's.
        """
        check_names(self.runs)
        document = None if settings is None else settings_document(settings)
        report = json.dumps(self.as_dict(), indent=2, allow_nan=False)
        with run_folder(path, overwrite=overwrite) as folder:
            (folder / MARK).write_text(report + "\n", encoding="utf-8")
            (folder / "table.md").write_text(f"{self}\n", encoding="utf-8")
            if document is not None:
                (folder / "settings.yaml").write_text(document, encoding="utf-8")
            curves_figure(self.runs).savefig(folder / "curves.png", dpi=DOTS_PER_INCH)
            drawn = self.recordings if animation else {}
            # Ctrl-C leaves out animations, not what was compared.
            with contextlib.suppress(KeyboardInterrupt):
                for number, (name, recording) in enumerate(drawn.items()):
                    write_animation(
                        recording,
                        folder / f"{name}.gif",
                        on_progress=lambda share, done=number: on_progress(  # type: ignore[misc]
                            (done + share) / len(drawn)
                        ),
                    )
        on_progress(1.0)


def check_names(names: Iterable[str]) -> None:
    """Find out whether controllers' names can be names of files.

    Raises:
        ValueError: a name that cannot.
    """
    for name in names:
        if not re.fullmatch(r"\w[\w.+ -]*", name):
            raise ValueError(
                f"name is {name!r}; accepted: letters, digits, spaces and _ . + -, a letter or "
                "digit first"
            )


def summarise(metrics: tuple[Metrics, ...]) -> Summary:
    """Return what the runs of one controller come to.

    Args:
        metrics: of the runs; at least one.

    Raises:
        ValueError: no runs.
    """
    if not metrics:
        raise ValueError("metrics is empty; accepted: at least one run")
    information = [each.information_per_metre for each in metrics]
    clearances = [each.minimum_clearance for each in metrics]
    return Summary(
        num_runs=len(metrics),
        num_finished=sum(each.is_finished for each in metrics),
        finished_at=_quartiles([each.finished_at for each in metrics]),
        time_to_90=_quartiles([each.time_to["90"] for each in metrics]),
        path_length=_quartiles([each.path_length for each in metrics]),
        information_per_metre=_quartiles([0.0 if each is None else each for each in information]),
        final_unknown=_quartiles([each.final_unknown for each in metrics]),
        coverage=_quartiles([each.coverage for each in metrics]),
        collisions=sum(each.collisions for each in metrics),
        minimum_clearance=min(math.inf if each is None else each for each in clearances),
        command_jerk=_quartiles([each.command_jerk for each in metrics]),
        fault_steps=sum(each.fault_steps for each in metrics),
    )


def curves_figure(runs: Mapping[str, tuple[Metrics, ...]]) -> "Figure":
    """Return coverage and unknown share over time: medians, and bands between the quartiles.

    A run that has ended keeps its last value.

    Args:
        runs: metrics by controller.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, sharex=True)
    longest = max((each.duration for metrics in runs.values() for each in metrics), default=0.0)
    time = np.linspace(0.0, max(longest, 1e-6), CURVE_POINTS)
    shown = {name: metrics for name, metrics in runs.items() if metrics}
    for panel, curve in zip(panels, ("coverage", "unknown"), strict=True):
        for number, (name, metrics) in enumerate(shown.items()):
            colour = COLOURS[number % len(COLOURS)]
            low, median, high = np.percentile(
                [100.0 * _curve(each, curve, time) for each in metrics], [25, 50, 75], axis=0
            )
            panel.fill_between(time, low, high, color=colour, alpha=0.18, linewidth=0.0)
            panel.plot(time, median, color=colour, linewidth=1.8, label=name)
        panel.set(xlim=(0.0, time[-1]), xlabel="time [s]")
        panel.grid(color="0.2", alpha=0.12, linewidth=0.6)
    panels[0].set(ylim=(0.0, 104.0), ylabel="coverage of reachable cells [%]")
    panels[1].set(ylabel="unknown cells of the map [%]")
    panels[1].set_ylim(bottom=0.0)
    if shown:
        most = max(len(metrics) for metrics in shown.values())
        figure.legend(
            *panels[0].get_legend_handles_labels(),
            loc="outside lower center",
            ncols=len(shown),
            frameon=False,
        )
        figure.suptitle(f"medians and quartiles, seeds: {most}", fontsize=11)
    return figure


def markdown(rows: list[tuple[str, ...]]) -> str:
    """Return a table, header first, in Markdown."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]

    def line(cells: tuple[str, ...]) -> str:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
        return f"| {' | '.join(padded)} |"

    rule = line(tuple("-" * width for width in widths))
    return "\n".join([line(rows[0]), rule, *(line(row) for row in rows[1:])])


def _curve(metrics: Metrics, name: str, time: np.ndarray) -> np.ndarray:
    points = [
        (at, value)
        for at, value in zip(
            metrics.coverage_curve["time"], metrics.coverage_curve[name], strict=True
        )
        if at is not None and value is not None
    ]
    at, values = np.asarray(points).T
    return np.asarray(np.interp(time, at, values))


def _quartiles(values: list[float | None]) -> Spread:
    """Return the quartiles, nothing interpolated between a value and infinity."""
    numbers = np.sort([math.inf if value is None else value for value in values])
    low, median, high = np.percentile(numbers, [25, 50, 75], method="higher")
    if np.isfinite(numbers).all():
        low, median, high = np.percentile(numbers, [25, 50, 75])
    return float(low), float(median), float(high)


def _spread(values: tuple[float, ...], digits: int) -> str:
    low, median, high = (_number(value, digits) for value in values)
    return median if low == high else f"{median} [{low}, {high}]"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
