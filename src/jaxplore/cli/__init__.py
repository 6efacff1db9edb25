"""The command line.

This module and those of the options import neither JAX nor what needs it, so that the help, the
completions of shells and errors in options come at once. A command imports what it runs.
"""

import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from jaxplore._exit import BAD_INPUT, INTERRUPTED
from jaxplore._signals import interrupt_on_end_signals
from jaxplore._text import one_line
from jaxplore._version import __version__
from jaxplore.cli._cache import cache_option
from jaxplore.cli._comparison_options import comparison_options
from jaxplore.cli._completion import complete_name
from jaxplore.cli._decorators import path_option
from jaxplore.cli._map_log_command import map_log
from jaxplore.cli._memory import memory_option
from jaxplore.cli._merge_command import merge
from jaxplore.cli._node_commands import controller, identify, node, replay, robot
from jaxplore.cli._options import path_options, with_options
from jaxplore.cli._picture_options import picture_options
from jaxplore.cli._runner import runner_options
from jaxplore.cli._terminal import say, warning_printer
from jaxplore.cli._tune_options import tune_options
from jaxplore.cli._view_options import host_option, view_options


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="jaxplore")
def cli() -> None:
    """Simulate robots that explore unknown maps or follow paths.

    The robots are controlled by model predictive path integral control (MPPI) on JAX. An exploring
    robot drives to where its sensors gain the most information. A path-following robot maximises
    its progress and avoids obstacles.

    `run` simulates one run, `compare` compares controllers or settings, `tune` searches for better
    settings. `node` drives a robot over ROS 2, `controller` drives it for nav2, and `robot`
    simulates one.
    """


@cli.command()
@with_options()
@memory_option
@cache_option
@path_options
@path_option("--out", metavar="DIR", text="Run folder.  [default: runs/MAP]")
@path_option(
    "--record", metavar="FILE.mcap", text="Also record the run for Foxglove (needs foxglove-sdk)."
)
@path_option(
    "--resume",
    metavar="DIR",
    text="Run folder to continue, with its settings; with --overwrite or another --out.",
)
@picture_options("Draw an animation.", video=True)
@view_options
def run(out: Path | None, overwrite: bool, **options: Any) -> None:
    """Simulate a robot that explores a map or follows a path, or a fleet of robots.

    The argument is a ROS map, a world or scenario file, or a name: office (a generated map), zones
    (for a quadrotor), warehouse, search-rescue or perimeter (for ground vehicles), path, or fleet
    (several robots in the office; on another map with --robots).

    Writes a run folder with metrics, arrays, figures, an animation and the settings:

    \b
      jaxplore run office
      jaxplore run warehouse
      jaxplore run zones --architecture parallel
      jaxplore run maps/depot.yaml --start 4.62 7.73 0 --out runs/depot
      jaxplore run --settings runs/depot/settings.yaml --out runs/again
      jaxplore run path --laps 3 --obstacles 5
      jaxplore run path --path centerline.csv --max-speed 8
      jaxplore run fleet --robots 4
      jaxplore run maps/depot.yaml --robots 3 --radio-range 10
      jaxplore run office --fps 30 --film-scale 2 --video office.mp4 --figures pdf,svg
      jaxplore run office --record office.mcap
      jaxplore run --resume runs/office --time-limit 1200 --overwrite
      jaxplore run office --view

    Ctrl-C ends the run and saves it up to then. --resume continues it.
    """
    from jaxplore.cli._run import run_one

    with interrupt_on_end_signals():
        run_one(options, out, overwrite=overwrite)


@cli.command()
@with_options("architecture")
@path_options
@comparison_options
@runner_options
@memory_option
@cache_option
@click.option(
    "--seeds", default=20, show_default=True, help="Number of seeds, the runs of each variant."
)
@path_option(
    "--out", metavar="DIR", text="Folder.  [default: runs/MAP-comparison, or runs/DIR-comparison]"
)
@picture_options("Draw the first run of each variant.")
def compare(seeds: int, out: Path | None, overwrite: bool, **options: Any) -> None:
    """Compare controllers or other settings in one scenario or on many maps.

    All variants run with the same seeds. Writes a folder with a table, curves, all metrics, and an
    animation of the first run of each variant:

    \b
      jaxplore compare zones
      jaxplore compare warehouse --seeds 5
      jaxplore compare zones --architectures two-layer,parallel --seeds 5
      jaxplore compare office --vary controller.temperature=0.1,0.3,1
      jaxplore compare path --vary cost.progress.weight=100,1000 --seeds 5
      jaxplore compare path --variants mild.yaml,fast.yaml

    Ctrl-C ends the comparison and keeps finished runs.

    With --maps it compares on all ROS maps, volumes or paths of a folder, or on several places,
    A,B; the words fleet, volume and path say of which kind. The folder of results has one file per
    run, a table of all runs, results.parquet, and a page, results.html. The same command continues
    an interrupted comparison:

    \b
      jaxplore compare --maps maps --architectures explorer,portfolio --workers 4
      jaxplore compare fleet --maps maps --vary fleet.coordination=claims,none
      jaxplore compare --maps forest,hall.ply --architectures explorer,nearest-cluster
    """
    from jaxplore.cli._comparison import run_comparison

    with interrupt_on_end_signals():
        run_comparison(options, seeds, out, overwrite=overwrite)


@cli.command()
@with_options()
@memory_option
@cache_option
@path_options
@tune_options
@runner_options
@path_option("--out", metavar="DIR", text="Folder of the study.  [default: runs/MAP-tuned]")
@picture_options("Draw runs before and after the search.")
def tune(out: Path | None, **options: Any) -> None:
    """Search for better settings of a scenario, and compare them with the current ones.

    Every candidate is evaluated on the same seeds, and the best ones on further seeds. The chosen
    candidate and the current settings are then compared on unseen seeds:

    \b
      jaxplore tune office --tune controller.temperature --budget 100
      jaxplore tune path --tune controller.temperature=1:300:log --tune controller.horizon=20,30,40
      jaxplore tune warehouse --tune portfolio.temperature --budget 30min --workers 2
      jaxplore tune path --tune cost.progress.weight --tune cost.comfort.weight --optimizer cma-es

    Writes settings.yaml for jaxplore run --settings, a report with figures, tables, and
    study.jsonl for optuna-dashboard. Ctrl-C keeps finished episodes; the same command continues.
    """
    from jaxplore.cli._tune import run_tune

    with interrupt_on_end_signals():
        run_tune(options, out)


@cli.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="RUNFOLDER")
@click.option("--port", default=0, help="Port of the page.  [default: a free one]")
@host_option
def view(folder: Path, port: int, host: str | None) -> None:
    """Show a finished run in the browser, with a slider of time.

    The argument is a run folder, as jaxplore run writes it:

    \b
      jaxplore view runs/office

    Ctrl-C ends it. Needs viser: pip install '.[view]' in a clone of jaxplore.
    """
    from jaxplore.cli._view import show_folder

    with interrupt_on_end_signals():
        show_folder(folder, port, host)


@cli.command("settings")
@click.argument("name", required=False, metavar="[NAME]", shell_complete=complete_name)
def print_settings(name: str | None) -> None:
    """Print settings with their defaults, meanings and accepted values.

    Without a name these are all settings of exploration, as YAML; with the name of a scenario, or
    path, those of that run. With a section or a setting it is a table, with the runs that read it:

    \b
      jaxplore settings
      jaxplore settings zones > zones.yaml
      jaxplore settings lidar
      jaxplore settings robot.max_speed

    The YAML is a settings file, for jaxplore run --settings.
    """
    from jaxplore.cli._settings import show_settings

    with interrupt_on_end_signals():
        show_settings(name)


@cli.command("import-nav2")
@click.argument("file", type=click.Path(path_type=Path), metavar="NAV2_PARAMS.yaml")
@path_option(
    "--out",
    "-o",
    metavar="FILE",
    text="Settings file to write.  [default: standard output]",
)
@click.option(
    "--task",
    type=click.Choice(["exploration", "path"]),
    default="exploration",
    show_default=True,
    help="Kind of run that the settings are for.",
)
@click.option("--controller", metavar="NAME", help="Name of the controller, if there are several.")
@click.option("--overwrite", is_flag=True, help="Replace an existing settings file.")
def import_nav2(
    file: Path, out: Path | None, task: str, controller: str | None, overwrite: bool
) -> None:
    """Make settings from the parameters of nav2.

    Reads the MPPI controller of controller_server and the robot of the costmaps. Names every
    parameter that has no counterpart, with the reason. Of another controller, such as DWB or
    regulated pure pursuit, it takes the robot and the rate:

    \b
      jaxplore import-nav2 nav2_params.yaml -o settings.yaml
      jaxplore run office --settings settings.yaml
    """
    from jaxplore.cli import _import_nav2

    with interrupt_on_end_signals():
        _import_nav2.import_nav2(file, out, task, controller, overwrite=overwrite)


for command in (controller, identify, map_log, merge, node, replay, robot):
    cli.add_command(command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line. Bad input gives one line on stderr and exit code 2."""
    shown_by_python = warnings.showwarning
    warnings.showwarning = warning_printer()
    try:
        cli.main(arguments, standalone_mode=False, prog_name="jaxplore")
        if sys.stdout is not None:
            sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as error:
        # Without arguments the help is what was asked for, and no error in one line.
        say(error.format_message())
    except click.ClickException as error:
        _fail(error.format_message())
    except (ValueError, OSError) as error:
        _fail(str(error))
    except (click.Abort, KeyboardInterrupt):
        _end_interrupted()
    except Exception as error:
        if not _is_interruption(error):
            raise
        _end_interrupted()
    finally:
        warnings.showwarning = shown_by_python


def _is_interruption(error: BaseException) -> bool:
    """Check whether an error stands for Ctrl-C.

    An interruption that comes up while a compiled library calls Python becomes an error of that
    library, with the interruption as its cause or in its text.
    """
    each: BaseException | None = error
    while each is not None:
        if isinstance(each, KeyboardInterrupt) or KeyboardInterrupt.__name__ in str(each):
            return True
        each = each.__cause__ or each.__context__
    return False


def _end_interrupted() -> None:
    say("jaxplore: interrupted", err=True)
    sys.exit(INTERRUPTED)


def _fail(message: str) -> None:
    say(one_line(f"jaxplore: {message}"), err=True)
    sys.exit(BAD_INPUT)
