"""A live view: how much of the loop's speed it costs."""

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.setting import SMALL, SMALL_OFFICE, Site, available_sites, experiment
from benchmarks.tables import Rows
from benchmarks.timing import percentiles
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.monitor import Monitor, Update
from jaxplore.simulation.run import simulate
from jaxplore.tasks.registry import build, make_settings
from jaxplore.view import LiveView

TRACK: dict[str, Any] = {"path": "track", "laps": 5, "obstacles": {"number": 5}}


class Sizes(NamedTuple):
    """A site, changes of its explorer, entries of further tasks by name, numbers of pages, steps of
    a run, and how often one with a view and one without take turns."""

    site: Site = available_sites()[0]
    changes: Mapping[str, Any] = {}
    others: Mapping[str, dict[str, Any]] = {"track, 5 obstacles": TRACK}
    pages: tuple[int, ...] = (0, 1)
    run_steps: int = 1500
    pairs: int = 3


FULL = Sizes()
SMOKE = Sizes(SMALL_OFFICE, SMALL, {}, (1,), 10, 1)
TITLES = {"runs": "A live view, in times as long as a run without one"}


class Counted(LiveView):
    """A live view that counts its frames."""

    frames = 0

    def show(self, update: Update) -> None:
        """Take an update."""
        super().show(update)
        self.frames += 1


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the time of a step with a view as a multiple of that without, for two tasks.

    Runs with and without a view take turns in one process, and the ratio is the median over pairs:
    what else the machine does slows both.
    """
    tasks = {sizes.site.name: experiment(sizes.site, **sizes.changes)}
    tasks |= {name: build(make_settings(entries)) for name, entries in sizes.others.items()}
    rows = []
    for name, made in tasks.items():
        for number in sizes.pages:
            times = _ratio(made, sizes.run_steps, sizes.pairs, number)
            rows.append({"run": name, "view": f"pages: {number}", **times})
    return {"runs": rows}


def _ratio(made: Experiment, steps: int, pairs: int, number: int) -> dict[str, Any]:
    view = Counted()
    with contextlib.closing(view), _pages(view, number):
        # The first run compiles.
        _seconds(made, steps, [view])
        with_view, without, frames = [], [], []
        for _ in range(pairs):
            without.append(_seconds(made, steps, []))
            view.frames = 0
            with_view.append(_seconds(made, steps, [view]))
            frames.append(view.frames / with_view[-1])
        ratios = np.divide(with_view, without)
    return {
        "step_ms": 1e3 * float(np.median(without)) / steps,
        "times_as_long": float(np.median(ratios)),
        "least": float(ratios.min()),
        "greatest": float(ratios.max()),
        "frames_per_second": float(np.median(frames)),
        "repeats": percentiles(with_view)["repeats"],
    }


def _seconds(made: Experiment, steps: int, monitors: Sequence[Monitor]) -> float:
    """Return the wall-clock time of a run [s]."""
    began = time.perf_counter()
    simulate(made.controller, made.scenario, steps, key=made.key, monitors=monitors)
    return time.perf_counter() - began


@contextlib.contextmanager
def _pages(view: LiveView, number: int) -> Iterator[None]:
    """Open pages in processes of their own, as a browser's are."""
    command = [sys.executable, "-m", "benchmarks.view_page", view.link]
    folder = Path(__file__).parents[1]
    processes = [subprocess.Popen(command, cwd=folder) for _ in range(number)]
    try:
        while view.num_pages < number:
            if not all(each.poll() is None for each in processes):
                raise RuntimeError("a page has ended before the view has shown it")
            time.sleep(0.01)
        yield
    finally:
        for each in processes:
            each.kill()
            each.wait()
