"""A live view: how much of the loop's speed it costs."""

import contextlib
import multiprocessing
import time
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import numpy as np
import viser
from websockets.sync.client import connect

from benchmarks.setting import available_sites, experiment
from jaxplore.build.tasks import build, make_settings
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.monitor import Monitor, Update
from jaxplore.simulation.run import simulate
from jaxplore.view import LiveView

STEPS = 1500
"""Number of steps of a run."""
PAIRS = 11
"""Number of runs with a view and without one, in turn."""


class Counted(LiveView):
    """A live view that counts its frames."""

    frames = 0

    def show(self, update: Update) -> None:
        """Take an update."""
        super().show(update)
        self.frames += 1


def measure(steps: int = STEPS) -> list[dict[str, Any]]:
    """Return the time of a step with a view as a multiple of that without, for two tasks.

    Runs with and without a view take turns in one process, and the ratio is the median over pairs:
    what else the machine does slows both.
    """
    site = available_sites()[0]
    track = build(make_settings({"path": "track", "laps": 5, "obstacles": {"number": 5}}))
    rows = []
    for name, made in ((site.name, experiment(site)), ("track, 5 obstacles", track)):
        for title, number in (("no page", 0), ("one page", 1)):
            rows.append({"run": name, "view": title, **_ratio(made, steps, number)})
    return rows


def _ratio(made: Experiment, steps: int, number: int) -> dict[str, Any]:
    view = Counted()
    with contextlib.closing(view), _pages(view, number):
        # The first run compiles.
        _seconds(made, steps, [view])
        with_view, without, frames = [], [], []
        for _ in range(PAIRS):
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
    }


def _seconds(made: Experiment, steps: int, monitors: Sequence[Monitor]) -> float:
    """Return the wall-clock time of a run [s]."""
    began = time.perf_counter()
    simulate(made.controller, made.scenario, steps, key=made.key, monitors=monitors)
    return time.perf_counter() - began


@contextlib.contextmanager
def _pages(view: LiveView, number: int) -> Iterator[None]:
    """Open pages in processes of their own, as a browser's are."""
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=take, args=[view.link], daemon=True) for _ in range(number)]
    try:
        for each in processes:
            each.start()
        while view.num_pages < number:
            if not all(each.is_alive() for each in processes):
                raise RuntimeError("a page has ended before the view has shown it")
            time.sleep(0.01)
        yield
    finally:
        for each in processes:
            each.terminate()


def take(address: str) -> None:
    """Take what a page would, without drawing it, until the view is closed.

    Args:
        address: link of the view.
    """
    camera = {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (0.0, 0.0, 1.0),
        "look_at": (0.0, 0.0, 0.0),
        "up_direction": (0.0, 0.0, 1.0),
        **dict.fromkeys(("fov", "near", "far"), 1.0),
        **dict.fromkeys(("image_height", "image_width"), 100),
    }
    with connect(
        address.replace("http", "ws"),
        subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
        max_size=2**26,
    ) as connection:
        connection.send(msgspec.msgpack.encode(camera))
        for _ in connection:
            pass
