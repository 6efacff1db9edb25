"""Result of a comparison in one scenario: a table, curves, animations."""

import contextlib
import dataclasses
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore._signals import is_ending
from jaxplore.report.drawing.figure import PNG, figure_formats, write_figure
from jaxplore.report.drawing.film import FilmOptions
from jaxplore.report.drawing.series import line_style, style_count
from jaxplore.report.folder import MARK, run_folder
from jaxplore.report.metrics import Metrics
from jaxplore.report.recording import Recording
from jaxplore.report.save import settings_document
from jaxplore.report.table import to_markdown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CURVE_POINTS = 400
"""Number of points of a curve."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Runs of several variants with the same seeds. `print` shows its table.

    Args:
        runs: metrics by variant, one for each seed; all variants have the same seeds, unless the
            comparison was interrupted.
        recordings: recordings of the first seed, by variant.
        is_interrupted: whether the user stopped it; finished runs are included.
    """

    runs: Mapping[str, tuple[Metrics, ...]]
    recordings: Mapping[str, Recording]
    is_interrupted: bool = False

    def summaries(self) -> dict[str, dict[str, Any]]:
        """Return the statistics over the runs of each variant, by the names of the columns."""
        return {
            name: {column.name: column.value(metrics) for column in metrics[0].list_columns()}
            for name, metrics in self.runs.items()
            if metrics
        }

    def rows(self) -> list[tuple[str, ...]]:
        """Return a table of medians [quartiles]: the header, then one row for each variant.

        A column without a meaningful value for any variant is left out.
        """
        summaries = self.summaries()
        metrics = next((each[0] for each in self.runs.values() if each), None)
        columns = [
            column
            for column in (() if metrics is None else metrics.list_columns())
            if any(column.applies(each[column.name]) for each in summaries.values())
        ]
        header = ("", *(column.header for column in columns))
        return [
            header,
            *(
                (name, *(column.text(each[column.name]) for column in columns))
                for name, each in summaries.items()
            ),
        ]

    def __str__(self) -> str:
        return to_markdown(self.rows())

    def as_dict(self) -> dict[str, Any]:
        """Return all data except the recordings as plain values for JSON.

        None stands for infinite values.
        """
        summaries = {
            name: {"num_runs": len(self.runs[name])}
            | {key: _plain(value) for key, value in each.items()}
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
        film: FilmOptions | None = None,
        figures: str | Sequence[str] = PNG,
        settings: Mapping[str, object] | None = None,
        variants: Mapping[str, Mapping[str, object]] | None = None,
        on_progress: Callable[[float], None] = lambda _: None,
    ) -> None:
        """Write a folder: metrics.json, table.md, curves.png, and an animation for each variant.

        The caption of an animation is the name of its variant. The folder is written completely or
        not at all.

        Args:
            path: the folder.
            overwrite: whether to replace a former run or comparison.
            animation: whether to draw the first seed of each variant, NAME.gif; Ctrl-C skips the
                rest.
            film: frames per second and size of the animations; the defaults when absent.
            figures: formats of the figures: png, pdf or svg, or several, "pdf,svg".
            settings: common settings, written to settings.yaml; plain values only.
            variants: all settings of variants, each written to NAME.yaml.
            on_progress: called with the share that is done, 0 to 1.

        Raises:
            ValueError: a folder that exists or cannot be written, a name that is not a file name,
                another format of figures.
        """
        check_names(self.runs)
        kinds = figure_formats(figures)
        documents = {name: settings_document(each) for name, each in (variants or {}).items()}
        if settings is not None:
            documents["settings"] = settings_document(settings)
        report = json.dumps(self.as_dict(), indent=2, allow_nan=False)
        with run_folder(path, overwrite=overwrite) as folder:
            (folder / MARK).write_text(report + "\n", encoding="utf-8")
            (folder / "table.md").write_text(f"{self}\n", encoding="utf-8")
            for name, document in documents.items():
                (folder / f"{name}.yaml").write_text(document, encoding="utf-8")
            write_figure(curves_figure(self.runs), folder, "curves", kinds)
            drawn = self.recordings if animation and not is_ending() else {}
            # Animations are optional: Ctrl-C skips them and still saves the comparison.
            with contextlib.suppress(KeyboardInterrupt):
                for number, (name, recording) in enumerate(drawn.items()):
                    recording.write_animation(
                        folder / f"{name}.gif",
                        film,
                        title=name,
                        on_progress=lambda share, done=number: on_progress(  # type: ignore[misc]
                            (done + share) / len(drawn)
                        ),
                    )
        on_progress(1.0)


def check_names(names: Iterable[str]) -> None:
    """Check that names of variants can be file names."""
    for name in names:
        if not re.fullmatch(r"\w[\w.+ -]*", name):
            raise ValueError(
                f"name is {name!r}; accepted: letters, digits, spaces and _ . + -, a letter or "
                "digit first"
            )


def curves_figure(runs: Mapping[str, tuple[Metrics, ...]]) -> "Figure":
    """Draw the curves of the metrics class: medians, and bands between the quartiles.

    A run that has ended keeps its last value.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = {name: metrics for name, metrics in runs.items() if metrics}
    first = next((metrics[0] for metrics in shown.values()), None)
    every = [each for metrics in shown.values() for each in metrics]
    curves = [
        curve
        for curve in (() if first is None else first.list_curves())
        if any(curve.applies(each) for each in every)
    ]
    figure = Figure(figsize=(5.0 * max(len(curves), 1), 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, max(len(curves), 1), sharex=True, squeeze=False)[0]
    longest = max((each.duration for metrics in shown.values() for each in metrics), default=0.0)
    time = np.linspace(0.0, max(longest, 1e-6), CURVE_POINTS)
    for panel, curve in zip(panels, curves, strict=False):
        for number, (name, metrics) in enumerate(shown.items()):
            style = line_style(number)
            low, median, high = np.percentile(
                [curve.scale * _curve(each, curve.name, time) for each in metrics],
                [25, 50, 75],
                axis=0,
            )
            panel.fill_between(time, low, high, color=style["color"], alpha=0.18, linewidth=0.0)
            panel.plot(time, median, **style, linewidth=1.8, label=name)
        panel.set(xlim=(0.0, time[-1]), xlabel="time [s]", ylabel=curve.label)
        panel.set_ylim(bottom=0.0 if curve.limit is not None else None, top=curve.limit)
        if curve.is_count:
            style_count(panel.yaxis)
        panel.grid(color="0.2", alpha=0.12, linewidth=0.6)
    if curves:
        most = max(len(metrics) for metrics in shown.values())
        figure.legend(
            *panels[0].get_legend_handles_labels(),
            loc="outside lower center",
            ncols=min(len(shown), 2 + 3 * len(curves)),
            frameon=False,
        )
        figure.suptitle(f"medians and quartiles, seeds: {most}", fontsize=11)
    return figure


def _curve(metrics: Metrics, name: str, time: np.ndarray) -> np.ndarray:
    """Sample a curve (T,) at given times [s]; NaN if it has no points."""
    series = metrics.series()
    points = [
        (at, value)
        for at, value in zip(series["time"], series[name], strict=True)
        if at is not None and value is not None
    ]
    if not points:
        return np.full(len(time), np.nan)
    at, values = np.asarray(points).T
    return np.asarray(np.interp(time, at, values))


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
