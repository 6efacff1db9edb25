"""`jaxplore compare --maps`: the exploration benchmark."""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from jaxplore.cli._options import assign, entries_of
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.console import progress_bar
from jaxplore.settings.exploration import GROUND, OFFICE, make_exploration_settings
from jaxplore.study.comparison.execute import Done, Outcome, run_tasks
from jaxplore.study.comparison.maps import grids_of, maps_in, with_starts
from jaxplore.study.comparison.store import Asked, Store, open_store
from jaxplore.study.comparison.table import NEEDED, MapTable, failures, map_tables

PROTOCOL: dict[str, Any] = {
    "rates.control": 20.0,
    "rates.sensing": 10.0,
    "rates.fields": 5.0,
    "lidar.num_beams": 180,
    "lidar.max_range": 5.0,
    "resolution": 0.1,
    "target_coverage": 0.99,
    "time_limit": 900.0,
}
"""Settings of a benchmark where none are given."""
QUADROTOR: dict[str, Any] = {
    "lidar.field_of_view_degrees": 90.0,
    "lidar.num_beams": 46,
    "lidar.range_noise": 0.02,
    "sensor_model.kind": "log_odds",
    "robot.radius": 0.3,
    "robot.max_speed": 2.0,
}
"""Those that are a quadrotor's: it sees ahead, with beams as far apart. `two-layer` and `parallel`
have other defaults for these than the ground vehicles' explorers; here they are the same for all.
What they take for worth a look, `fields`, remains their own."""

_OWN = ("explorers", "starts", "workers", "batch", "ray", "address")
"""Options that only a benchmark takes."""
_OTHERS = {"map_": "the map", "start": "--start", "goal": "--goal"}
"""Options of a comparison on one map that say nothing about several."""

_FAILED, _INTERRUPTED = 1, 130


def benchmark_options(command: Any) -> Any:
    """Add the options that make a comparison a benchmark."""
    folder = click.Path(path_type=Path)
    for option in (
        click.option("--address", metavar="HOST:PORT", help="With --maps: a Ray cluster to join."),
        click.option(
            "--ray", is_flag=True, default=None, help="With --maps: run on a local Ray cluster."
        ),
        click.option(
            "--batch",
            type=int,
            help="With --maps: runs side by side in one program, for accelerators.  [default: 1]",
        ),
        click.option(
            "--workers",
            type=int,
            help="With --maps: processes, or workers of Ray.  [default: 1; all that Ray has]",
        ),
        click.option(
            "--starts",
            type=folder,
            metavar="FILE",
            help="With --maps: where to start, NAME: [x, y, yaw] in YAML.  [default: starts.yaml "
            "of the folder, else the most open spot]",
        ),
        click.option(
            "--explorers",
            metavar="NAME,NAME",
            help="With --maps: architectures to compare.  [default: all of ground vehicles]",
        ),
        click.option(
            "--maps",
            type=folder,
            metavar="DIR",
            help="Compare on all ROS maps of a folder; can be interrupted and continued.",
        ),
    ):
        command = option(command)
    return command


def is_benchmark(options: dict[str, Any], architectures: str | None) -> bool:
    """Say whether several maps are asked for.

    Raises:
        ValueError: options of a benchmark without maps, or of one map beside them.
    """
    if options["maps"] is None:
        for name in _OWN:
            if options[name] is not None:
                raise ValueError(f"--{name} is {options[name]}; accepted: with --maps")
        return False
    for name, shown in _OTHERS.items():
        if options[name] is not None:
            raise ValueError(
                f"{shown} is {options[name]} beside --maps; accepted: one of them, and --starts"
            )
    if architectures is not None:
        raise ValueError(f"--architectures is {architectures} beside --maps; accepted: --explorers")
    return True


def run_benchmark(
    options: dict[str, Any], seeds: int, out: Path | None, *, overwrite: bool
) -> None:
    """Run a benchmark, write its folder and print its tables.

    Ends the process with 1 if runs failed and with 130 if the user stopped it.

    Raises:
        ValueError: what is asked for is not possible.
    """
    if seeds < 1:
        raise ValueError(f"--seeds is {seeds}; accepted: a whole number >= 1")
    given = {name: options.pop(name) for name in ("maps", *_OWN)}
    entries = entries_of(options)
    robot = entries.get("robot")
    flies = isinstance(robot, dict) and robot.get("model") == "quadrotor"
    for name, value in {**PROTOCOL, **(QUADROTOR if flies else {})}.items():
        if not _has(entries, name):
            assign(entries, name, value)
    maps = maps_in(given["maps"])
    if given["starts"] is not None:
        maps = with_starts(maps, given["starts"])
    named = ",".join(GROUND) if given["explorers"] is None else given["explorers"]
    explorers = tuple(name.strip() for name in named.split(","))
    first = entries.get("seed", 0)
    if not isinstance(first, int):
        raise ValueError(f"setting seed is {first!r}; accepted: a whole number >= 0")
    batch = 1 if given["batch"] is None else given["batch"]
    asked = Asked(maps, explorers, tuple(range(first, first + seeds)), entries, batch)
    tasks = asked.tasks()
    workers, address, on_ray = given["workers"], given["address"], given["ray"]
    if workers is not None and workers < 1:
        raise ValueError(f"--workers is {workers}; accepted: a whole number >= 1")
    if workers is None and not on_ray and address is None:
        workers = 1
    name = os.path.basename(os.path.realpath(given["maps"]))
    store = open_store(
        Path("runs") / f"{name}-benchmark" if out is None else out, asked, overwrite=overwrite
    )
    with progress_bar("exploring", enabled=True) as advance:
        show = _progress(advance)
        advance(0.0, f"{len(tasks)} runs")
        outcome = run_tasks(tasks, store, workers, address, show, on_ray=on_ray)
    resolution = make_exploration_settings({**tasks[0].entries, "map": OFFICE}).resolution
    _show(store, outcome, len(tasks), grids_of(asked.maps, resolution))


def _has(entries: dict[str, Any], name: str) -> bool:
    inner: Any = entries
    for part in name.split("."):
        if not isinstance(inner, dict) or part not in inner:
            # What is no section is not this one's to say.
            return not isinstance(inner, dict)
        inner = inner[part]
    return True


def _progress(advance: Callable[[float, str], None]) -> Callable[[Done], None]:
    """Return what shows how far a benchmark is, and how long it will take."""
    began = time.perf_counter()

    def show(done: Done) -> None:
        left = (time.perf_counter() - began) * (done.num_left / done.num_done - 1.0)
        result = "done" if done.error is None else "failed"
        advance(
            done.num_done / done.num_left,
            f"{done.num_done} of {done.num_left}, about {_duration(left)} left, {result}: "
            f"{done.task.map}, {done.task.explorer}, seed {done.task.seed}",
        )

    return show


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"


def _show(store: Store, outcome: Outcome, num_tasks: int, grids: dict[str, OccupancyGrid]) -> None:
    """Print the tables, draw the page, and say where the results are and what is missing."""
    results = store.rows(NEEDED)
    for table in map_tables(results):
        _print(table)
    click.echo(str(store.results))
    click.echo(str(store.write_page(grids)))
    failed = failures(results)
    for line in failed:
        click.echo(line, err=True)
    if outcome.is_interrupted:
        done = outcome.num_former + outcome.num_done
        click.echo(
            f"Interrupted: {done} of {num_tasks} runs are done; the same command does the others.",
            err=True,
        )
        sys.exit(_INTERRUPTED)
    if outcome.num_failed:
        sys.exit(_FAILED)


def _print(results: MapTable) -> None:
    click.echo(f"{results.map}: medians [quartiles]")
    header, *rows = results.rows
    # As text: square brackets are units and quartiles here, not markup.
    table = Table(show_lines=True)
    for cell in header:
        table.add_column(Text(cell))
    for row in rows:
        table.add_row(*map(Text, row))
    console = Console()
    if not console.is_terminal:
        # A file has no width: nothing is broken there.
        console = Console(width=Console(width=1000).measure(table).maximum)
    console.print(table)
