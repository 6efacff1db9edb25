"""Comparison of variants on all maps of a folder, which can be interrupted and continued."""

import dataclasses
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from jaxplore.maps.datum import Datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.padding import common_shapes
from jaxplore.report.console import progress_bar
from jaxplore.report.drawing.figure import PNG, figure_formats
from jaxplore.report.folder import lock_folder
from jaxplore.report.table import to_markdown
from jaxplore.study.comparison.episodes import MapEpisode, canonical, make_batches
from jaxplore.study.comparison.maps import MapFile, read_plans
from jaxplore.study.comparison.row_task import MakeRows, RowTask, make_rows
from jaxplore.study.comparison.rows import StoredRow
from jaxplore.study.comparison.store import Plan, Store, open_store
from jaxplore.study.comparison.table import NEEDED, MapTable, list_failures, map_tables
from jaxplore.study.runner import Runner

MOST_SHAPES = 4
"""Greatest number of different shapes of maps, each with a compiled program for each variant."""


class EpisodeDone(NamedTuple):
    """Progress after an episode, with the reason if it failed.

    `num_done` counts the episodes of this call so far, `num_left` those left before this call.
    """

    episode: MapEpisode
    error: str | None
    num_done: int
    num_left: int


class RunCounts(NamedTuple):
    """Numbers of runs of a comparison, and whether the user stopped it.

    Former calls have run `num_former`, this call `num_done`, failed ones included.
    """

    num_done: int
    num_failed: int
    num_former: int
    is_interrupted: bool


@dataclasses.dataclass(frozen=True)
class MapComparison:
    """Result of a comparison on maps. `print` shows its tables, one for each map.

    `failures` has a line for each reason of failed runs. `num_episodes` counts the planned runs.
    `results` is the path of the table of all rows (Parquet), `page` that of the page (HTML).
    """

    tables: tuple[MapTable, ...]
    failures: tuple[str, ...]
    counts: RunCounts
    num_episodes: int
    results: Path
    page: Path

    def __str__(self) -> str:
        return "\n\n".join(
            f"{table.title}\n\n{to_markdown(_in_lines(table.rows))}" for table in self.tables
        )


def compare_maps(
    plan: Plan,
    folder: str | os.PathLike[str],
    *,
    runner: Runner | None = None,
    overwrite: bool = False,
    figures: str | Sequence[str] = PNG,
    progress: bool = False,
) -> MapComparison:
    """Compare variants on maps: run each on each map with each seed, and write tables and a page.

    Runs that are in the folder are not repeated, except failed ones. Settings that the plan does
    not give are those of the protocol of their kind of task. Ctrl-C ends the call and keeps
    finished runs; the same call continues.

    Args:
        plan: maps, variants, seeds and settings; see `maps_in` for the maps of a folder.
        folder: folder for one file per run, `results.parquet` and `results.html`.
        runner: runs them in other processes or on a cluster; this process when absent. It is closed
            at the end.
        overwrite: whether to remove a former comparison in the folder first.
        figures: formats of the figures: png, pdf or svg, or several, "pdf,svg". The page holds
            them as PNG; pdf and svg are written into the folder `figures`.
        progress: show a progress bar.

    Raises:
        ValueError: a plan or folder that is not accepted, or that another process uses; Ray or
            pyarrow is not installed; a cluster that cannot be reached.
        ChildProcessError: workers that do not start.
    """
    kinds = [kind for kind in figure_formats(figures) if kind != PNG]
    plan = plan.with_protocol()
    episodes = plan.episodes()
    # Before the folder is made: a start or a map may be refused.
    episodes, plans = _with_shapes(episodes, plan.maps)
    grids = {name: grid for name, (grid, _) in plans.items()}
    datums = {name: datum for name, (_, datum) in plans.items()}
    # A second comparison would run the same runs, and `overwrite` would remove those of the first.
    with lock_folder(Path(os.path.realpath(folder)), "comparison folder"):
        store = open_store(folder, plan, overwrite=overwrite)
        with progress_bar("exploring", enabled=progress) as advance:
            advance(0.0, f"{len(episodes)} runs")
            counts = run_episodes(episodes, store, runner, _show(advance))
        page = store.write_page(grids, datums)
        if kinds:
            store.write_figures(grids, kinds, datums)
        rows = store.rows(NEEDED)
    return MapComparison(
        tuple(map_tables(rows)),
        tuple(list_failures(rows)),
        counts,
        len(episodes),
        store.results,
        page,
    )


def _with_shapes(
    episodes: Sequence[MapEpisode], maps: Sequence[MapFile]
) -> tuple[tuple[MapEpisode, ...], dict[str, tuple[OccupancyGrid, Datum]]]:
    """Give the episodes common shapes of maps; return them, and the plans of the first variant.

    Similar maps share a compiled program, so time and memory do not grow with their number.
    """
    variants = {each.explorer: each for each in reversed(episodes)}
    read: dict[str, dict[str, tuple[OccupancyGrid, Datum]]] = {}
    plans = {}
    for name, each in variants.items():
        # Variants that read a map alike share what was read.
        how = canonical({part: each.settings.get(part) for part in ("resolution", "map_file")})
        plans[name] = read[how] = read.get(how) or read_plans(maps, each.entries)
    shapes = {
        name: common_shapes({one: grid.shape for one, (grid, _) in found.items()}, MOST_SHAPES)
        for name, found in plans.items()
    }
    # A map that cannot be read has no shape: its episodes fail with the reason.
    placed = tuple(
        dataclasses.replace(each, map_shape=shapes[each.explorer].get(each.map))
        for each in episodes
    )
    return placed, plans[episodes[0].explorer]


def run_episodes(
    episodes: Sequence[MapEpisode],
    store: Store,
    runner: Runner | None = None,
    on_done: Callable[[EpisodeDone], None] = lambda _: None,
    *,
    make: MakeRows = make_rows,
) -> RunCounts:
    """Run the episodes that are missing in a store, and write its table of results.

    Failed ones are run again. Those of one map and variant run one after the other if possible,
    because they share a compiled program. Ctrl-C keeps finished runs. Only this process writes to
    the store, and it calls `on_done` after each episode.

    The runner is this process when None, and is closed at the end. Other processes import `make`,
    which runs a batch, by name.
    """
    left = make_batches(each for each in episodes if not store.is_done(each.id))
    num_left = sum(map(len, left))
    num_done = num_failed = 0
    is_interrupted = False

    def finish(task: RowTask, rows: Sequence[StoredRow]) -> None:
        nonlocal num_done, num_failed
        for episode, row in zip(task.episodes, rows, strict=True):
            store.put(row)
            num_done += 1
            num_failed += row.error is not None
            on_done(EpisodeDone(episode, row.error, num_done, num_left))

    try:
        with Runner() if runner is None else runner as active:
            active.run([RowTask.from_episodes(batch, make) for batch in left], finish)
    except KeyboardInterrupt:
        is_interrupted = True
    finally:
        # Finished runs are in the table after an error too.
        store.write_results()
    return RunCounts(num_done, num_failed, len(episodes) - num_left, is_interrupted)


def _in_lines(rows: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    """Join the lines of each cell."""
    return [tuple(" ".join(cell.split("\n")) for cell in row) for row in rows]


def _show(advance: Callable[[float, str], None]) -> Callable[[EpisodeDone], None]:
    """Return a function that updates the progress bar with the finished runs and the time left."""
    began = time.perf_counter()

    def show(done: EpisodeDone) -> None:
        left = (time.perf_counter() - began) * (done.num_left / done.num_done - 1.0)
        result = "done" if done.error is None else "failed"
        episode = done.episode
        advance(
            done.num_done / done.num_left,
            f"{done.num_done} of {done.num_left}, about {_duration(left)} left, {result}: "
            f"{episode.map}, {episode.explorer}, seed {episode.seed}",
        )

    return show


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60} min"
