"""The command line."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import yaml

from jaxplore._version import __version__
from jaxplore.build.exploration import build, comparable
from jaxplore.cli._benchmark import benchmark_options, is_benchmark, run_benchmark
from jaxplore.cli._cache import cache_option
from jaxplore.cli._options import entries_of, with_options
from jaxplore.cli._path import is_path, path_options, run_path
from jaxplore.cli._show import free_name, save, show_comparison
from jaxplore.cli._tune import run_tune
from jaxplore.cli._tune_options import tune_options
from jaxplore.report.console import progress_bar
from jaxplore.report.folder import check_folder
from jaxplore.runs import compare as compare_runs
from jaxplore.settings.exploration import (
    GROUND,
    OFFICE,
    Settings,
    make_settings,
)
from jaxplore.simulation.run import NUM_TRAJECTORIES, simulate


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="jaxplore")
def cli() -> None:
    """Informative exploration with sampling-based control, on JAX."""


@cli.command()
@with_options()
@cache_option
@path_options
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Run folder.  [default: runs/MAP]"
)
@click.option("--animation/--no-animation", default=True, help="Draw exploration.gif.")
def run(
    out: Path | None,
    overwrite: bool,
    animation: bool,
    **options: Any,
) -> None:
    """Let a robot explore a ROS map, a world or scenario file, or one that has a name, or let it
    follow a path.

    Names: office (generated), zones (a quadrotor's), the ground vehicles' scenarios warehouse,
    search-rescue and perimeter, and path.

    Writes a run folder with metrics, arrays, pictures, an animation and the settings used:

    \b
      jaxplore run office
      jaxplore run warehouse
      jaxplore run zones --architecture parallel
      jaxplore run maps/depot.yaml --start 4.62 7.73 0 --out runs/depot
      jaxplore run --settings runs/depot/settings.yaml --out runs/again
      jaxplore run path --laps 3 --obstacles 5
      jaxplore run path --path centerline.csv --max-speed 8

    Ctrl-C ends the run and keeps what was done.
    """
    if is_path(options):
        run_path(options, out, overwrite=overwrite, animation=animation)
        return
    entries = entries_of(options)
    settings = make_settings(entries)
    folder = free_name(Path("runs") / Path(settings.map).stem) if out is None else out
    check_folder(folder, overwrite=overwrite)
    experiment = build(settings)
    result = simulate(
        *experiment[:3],
        key=experiment.key,
        progress=True,
        num_trajectories=NUM_TRAJECTORIES if animation else 0,
    )
    save(result, folder, settings, overwrite=overwrite, animation=animation)


@cli.command()
@with_options("architecture")
@cache_option
@click.option(
    "--architectures",
    metavar="NAME,NAME",
    help="What to compare.  [default: all that the map allows]",
)
@click.option("--seeds", type=int, default=20, show_default=True, help="Runs of each.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder.  [default: runs/MAP-comparison]",
)
@click.option("--animation/--no-animation", default=True, help="Draw the first run of each.")
@benchmark_options
def compare(
    architectures: str | None,
    seeds: int,
    out: Path | None,
    overwrite: bool,
    animation: bool,
    **options: Any,
) -> None:
    """Compare architectures on a map or in a scenario, with the same seeds for all.

    Writes a folder with a table, curves of coverage and of what is unknown, all metrics, and an
    animation of the first run of each:

    \b
      jaxplore compare zones
      jaxplore compare warehouse --seeds 5
      jaxplore compare zones --architectures two-layer,parallel --seeds 5
      jaxplore compare maps/depot.yaml --start 4.62 7.73 0 --range 5 --seeds 5 --time-limit 240

    Ctrl-C ends the comparison and keeps the runs that were done.

    With --maps it is a benchmark of explorers on all ROS maps of a folder. Its own folder, by
    default runs/DIR-benchmark, holds a file for each run and results.parquet, the table of all; the
    same command does what is missing:

    \b
      jaxplore compare --maps maps --explorers explorer,portfolio --workers 4
    """
    if is_benchmark(options, architectures):
        run_benchmark(options, seeds, out, overwrite=overwrite)
        return
    entries = entries_of(options)
    if seeds < 1:
        raise ValueError(f"--seeds is {seeds}; accepted: a whole number >= 1")
    if architectures is None and make_settings(entries).architecture == "portfolio":
        names: tuple[str, ...] = ("explorer", "portfolio")
    elif architectures is None:
        names = comparable(make_settings({**entries, "architecture": "two-layer"}))
    else:
        names = tuple(name.strip() for name in architectures.split(","))
    settings = {name: make_settings({**entries, "architecture": name}) for name in names}
    ground = [name for name in names if name in GROUND]
    if ground and len(ground) < len(names):
        raise ValueError(
            f"--architectures is {architectures!r}, of which {', '.join(ground)} drives another "
            f"robot with another sensor; accepted: {', '.join(GROUND)}, or of the others"
        )
    common = settings[names[0]]
    first = common.seed
    folder = out
    if folder is None:
        folder = free_name(Path("runs") / f"{Path(common.map).stem}-comparison")
    check_folder(folder, overwrite=overwrite)
    experiments = {str(name): build(each)[:3] for name, each in settings.items()}
    result = compare_runs(experiments, range(first, first + seeds), progress=True)
    kept = common.model_dump(mode="json", exclude={"architecture"})
    with progress_bar("drawing", enabled=animation) as advance:
        result.save(
            folder,
            overwrite=overwrite,
            animation=animation,
            settings=kept,
            on_progress=lambda share: advance(share, ""),
        )
    show_comparison(result, folder)


@cli.command()
@with_options()
@cache_option
@path_options
@tune_options
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder of the study.  [default: runs/MAP-tuned]",
)
@click.option("--animation/--no-animation", default=True, help="Draw a run before and after.")
def tune(out: Path | None, animation: bool, **options: Any) -> None:
    """Search the settings with which a robot does best in a scenario, and show what was won.

    Every candidate drives the same episodes. Then the best ones drive further ones, and the chosen
    one and the settings that there were are compared with seeds that nobody was tuned on:

    \b
      jaxplore tune office --tune controller.temperature --budget 100
      jaxplore tune path --tune controller.temperature=1:300:log --tune controller.horizon=20,30,40
      jaxplore tune warehouse --tune portfolio.temperature --budget 30min --workers 2
      jaxplore tune path --tune cost.progress.weight --tune cost.comfort.weight --optimizer cma-es

    Writes settings.yaml for jaxplore run --settings, a report with pictures, tables, and study.db,
    which optuna-dashboard shows. Ctrl-C keeps all that was done; the same command goes on.
    """
    run_tune(options, out, animation=animation)


@cli.command("settings")
def show_settings() -> None:
    """Print every setting with its default, as YAML."""
    click.echo(
        yaml.safe_dump(Settings(map=OFFICE).model_dump(mode="json"), sort_keys=False), nl=False
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line: what is wrong with the input is one line and exit code 2.

    Args:
        arguments: in place of the process's own.
    """
    try:
        cli.main(arguments, standalone_mode=False, prog_name="jaxplore")
    except click.ClickException as error:
        _fail(error.format_message())
    except (ValueError, OSError) as error:
        _fail(str(error))
    except (click.Abort, KeyboardInterrupt):
        click.echo("jaxplore: interrupted", err=True)
        sys.exit(130)


def _fail(message: str) -> None:
    click.echo("jaxplore: " + " ".join(message.split()), err=True)
    sys.exit(2)
