"""Figures of a search: convergence, importances, candidates by parameter, fronts, archives."""

import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore._optional import import_optional
from jaxplore.report.drawing.colours import SERIES
from jaxplore.report.drawing.series import style_count
from jaxplore.study.tuning.optimizers import RibsOptimizer
from jaxplore.study.tuning.study import Study
from jaxplore.study.tuning.trials import Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FEW_DECADES = 300.0
"""Greatest ratio of values for which labels at 1, 2, 5, 10, 20 ... have room."""


def importances(study: Study) -> dict[str, float]:
    """Compute the importance of each parameter for the first objective by PED-ANOVA (Watanabe,
    Bansal, Hutter, IJCAI 2023). They add up to 1; empty if too few candidates have a value."""
    module = import_optional("optuna.importance", "tuning")
    done = [each for each in study.trials() if each.state == "done"]
    if len(done) < 10 or len({each.values[0] for each in done}) < 2:
        return {}
    target = None
    # Optuna requires a target for several objectives.
    if len(study.search.objectives) > 1:

        def target(trial: Any) -> float:
            return float(trial.values[0])

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the importances are experimental
        try:
            found = module.get_param_importances(study.optuna, target=target)
        except (RuntimeError, ValueError):
            return {}
    return {name: float(share) for name, share in found.items() if math.isfinite(share)}


def figures(study: Study, chosen: Trial) -> dict[str, "Figure"]:
    """Draw the figures of a search with the chosen candidate, by file name without suffix."""
    found = {"convergence": _convergence(study), "slices": _slices(study, chosen, 0)}
    for number in range(1, len(study.search.objectives)):
        found[f"slices-{number + 1}"] = _slices(study, chosen, number)
    shares = importances(study)
    if shares:
        found["importance"] = _bars(shares)
    if len(study.search.objectives) > 1:
        found["front"] = _front(study, chosen)
    if isinstance(study.optimizer, RibsOptimizer) and len(study.search.measures) <= 2:
        found["archive"] = _archive(study, study.optimizer)
    return found


_DONE, _GIVEN_UP, _CHOSEN = SERIES[0], "0.45", SERIES[1]


def _convergence(study: Study) -> "Figure":
    figure, axes = _axes(1)
    trials = study.trials()
    done = [each for each in trials if each.state == "done"]
    numbers, values = [each.number for each in done], [each.values[0] for each in done]
    axes[0].scatter(numbers, values, s=14, color=_DONE, label="evaluated")
    # A candidate that was not evaluated to its end has no value to compare: it is a mark on the
    # upper edge.
    edge = axes[0].get_xaxis_transform()
    for state, marker, label in (("given up", "|", "given up early"), ("failed", "x", "failed")):
        numbers = [each.number for each in trials if each.state == state]
        if numbers:
            axes[0].scatter(
                numbers,
                np.ones(len(numbers)),
                s=30,
                color=_GIVEN_UP,
                marker=marker,
                label=label,
                transform=edge,
                clip_on=False,
            )
    least = np.minimum.accumulate([each.values[0] for each in done])
    axes[0].step([each.number for each in done], least, where="post", color=_CHOSEN, label="best")
    axes[0].set_xlabel("candidate")
    style_count(axes[0].xaxis)
    _scale(axes[0], "y", [each.values[0] for each in done])
    axes[0].set_ylabel(_label(study))
    figure.legend(loc="outside upper center", ncols=4, frameon=False)
    return figure


def _slices(study: Study, chosen: Trial, number: int) -> "Figure":
    """Draw one of the objectives, counted from 0, over each parameter."""
    parameters = study.search.space.parameters
    figure, axes = _axes(len(parameters))
    trials = [each for each in study.trials() if each.state == "done"]
    values = [each.values[number] for each in trials]
    for each, at in zip(parameters, axes, strict=True):
        places = [trial.candidate[each.name] for trial in trials]
        star: Any = chosen.candidate[each.name]
        if each.choices is not None:
            names = [str(choice) for choice in each.choices]
            places, star = [names.index(str(place)) for place in places], names.index(str(star))
            at.set_xticks(range(len(names)), names)
        elif each.is_log:
            assert each.low is not None
            assert each.high is not None
            _logarithmic(at, "x", each.high / each.low)
        elif each.is_whole:
            style_count(at.xaxis)
        at.scatter(places, values, s=14, color=_DONE)
        at.scatter([star], [chosen.values[number]], s=60, marker="*", color=_CHOSEN, zorder=3)
        at.set_xlabel(each.name)
        _scale(at, "y", values)
    axes[0].set_ylabel(_label(study, number))
    return figure


def _bars(shares: dict[str, float]) -> "Figure":
    figure, axes = _axes(1)
    names = list(shares)[::-1]
    axes[0].barh(names, [shares[name] for name in names], color=_DONE)
    axes[0].set_xlabel("importance (PED-ANOVA), shares of 1")
    return figure


def _front(study: Study, chosen: Trial) -> "Figure":
    first, second, *_ = study.search.objectives
    figure, axes = _axes(1)
    done = [each for each in study.trials() if each.state == "done"]
    front = sorted(study.front(), key=lambda each: each.values)
    for some, colour, marker, label in (
        (done, _GIVEN_UP, "o", "evaluated"),
        (front, _DONE, "D", "front"),
    ):
        across, up = [each.values[0] for each in some], [each.values[1] for each in some]
        axes[0].scatter(across, up, s=18, color=colour, marker=marker, label=label)
    axes[0].scatter(*chosen.values[:2], s=80, marker="*", color=_CHOSEN, label="chosen", zorder=3)
    axes[0].set_xlabel(str(first))
    axes[0].set_ylabel(str(second))
    figure.legend(loc="outside upper center", ncols=3, frameon=False)
    return figure


def _axes(number: int) -> tuple["Figure", list[Any]]:
    """Make a figure with several axes side by side that share the vertical scale."""
    from matplotlib.figure import Figure

    columns = min(number, 4)
    rows = -(-number // columns)
    figure = Figure(figsize=(max(6.4, 3.0 * columns), 3.6 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False).reshape(-1)
    for each in axes:
        each.grid(alpha=0.3)
    for each in axes[number:]:
        each.set_visible(False)
    return figure, list(axes[:number])


def _scale(axes: Any, which: str, values: list[float]) -> None:
    """Use a logarithmic scale if the values span a large range, so that the best are separable."""
    if values and min(values) > 0.0 and max(values) > 4.0 * min(values):
        _logarithmic(axes, which, max(values) / min(values))


def _logarithmic(axes: Any, which: str, ratio: float) -> None:
    """Use a logarithmic scale with plain labels.

    Matplotlib's default labels, 2 x 10^0, 3 x 10^0, overlap.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    getattr(axes, f"set_{which}scale")("log")
    axis = getattr(axes, f"{which}axis")
    subs = (1.0, 2.0, 5.0) if ratio < _FEW_DECADES else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=9))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _label(study: Study, number: int = 0) -> str:
    label = str(study.search.objectives[number])
    # A long sum does not fit beside the axis.
    return label if len(label) <= 36 else "objective"


def _archive(study: Study, optimizer: RibsOptimizer) -> "Figure":
    archive, measures = optimizer.archive, study.search.measures
    found = archive.data(["index", "objective"])
    best = np.full(archive.cells, np.nan)
    best[found["index"]] = -found["objective"]
    label = f"best {_label(study)}"
    figure, axes = _axes(1)
    axes[0].set_xlabel(measures[0].metric)
    if len(measures) == 1:
        axes[0].stairs(best, archive.boundaries[0], baseline=None, color=_DONE, linewidth=3)
        axes[0].set_ylabel(label)
        return figure
    # Rows of a mesh are along y, but the archive's first axis is the measure along x.
    cells = axes[0].pcolormesh(*archive.boundaries, best.reshape(archive.dims).T, cmap="viridis_r")
    axes[0].set_ylabel(measures[1].metric)
    figure.colorbar(cells, label=label)
    return figure
