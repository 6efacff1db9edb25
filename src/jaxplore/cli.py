"""The command line."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import yaml
from rich.console import Console
from rich.table import Table
from rich.text import Text

from jaxplore._version import __version__
from jaxplore.experiment.assembly import build, comparable
from jaxplore.report.comparison import Comparison
from jaxplore.report.folder import check_folder
from jaxplore.report.metrics import Metrics
from jaxplore.runs import compare as compare_runs
from jaxplore.runs import progress_bar, simulate
from jaxplore.settings import (
    GROUND,
    OFFICE,
    SCENARIOS,
    ZONES,
    Settings,
    is_scenario_file,
    make_settings,
    read_settings,
)
from jaxplore.simulation.simulate import NUM_TRAJECTORIES

# Options that stand for a setting: option, dotted setting, type, help.
_OPTIONS: tuple[tuple[str, str, Any, str], ...] = (
    ("--seed", "seed", int, "Seed of everything random."),
    ("--time-limit", "time_limit", float, "Simulated time [s]."),
    ("--target-coverage", "target_coverage", float, "Share of reachable cells at which to stop."),
    ("--resolution", "resolution", float, "Side of a map cell [m]; finer maps are resampled."),
    (
        "--robot",
        "robot.model",
        str,
        "Model of the robot: differential_drive, unicycle, ackermann or quadrotor.",
    ),
    (
        "--architecture",
        "architecture",
        str,
        "explorer or portfolio; for quadrotors two-layer, parallel, sequential, random-walk, goal.",
    ),
    ("--radius", "robot.radius", float, "Radius of the robot [m]."),
    ("--max-speed", "robot.max_speed", float, "Speed of the robot [m/s]."),
    ("--beams", "lidar.num_beams", int, "Beams of the lidar."),
    ("--range", "lidar.max_range", float, "Reach of the lidar [m]."),
    ("--samples", "controller.num_samples", int, "Rollouts of MPPI."),
)


DEFAULTS = tuple(
    make_settings({"map": OFFICE, "architecture": name}).model_dump()
    for name in ("explorer", "two-layer")
)
"""Of ground robots and of quadrotors."""


def _default(defaults: dict[str, Any], setting: str) -> Any:
    value: Any = defaults
    for part in setting.split("."):
        value = value[part]
    return value


def _options(*without: str) -> Callable[[Any], Any]:
    """Return a decorator that adds what says what is run: the map, where, and every setting."""
    options = [
        click.argument("map_", metavar="[MAP.yaml | NAME]", required=False),
        click.option(
            "--start",
            nargs=3,
            type=float,
            metavar="X Y YAW",
            help="Where the robot starts [m, m, rad]; office and zones have a start of their own.",
        ),
        click.option(
            "--goal",
            nargs=2,
            type=float,
            metavar="X Y",
            help="Where the robot is to be in the end [m]; zones have a goal of their own.",
        ),
    ]
    for flag, setting, kind, text in _OPTIONS:
        if setting in without:
            continue
        ground, flying = (_default(each, setting) for each in DEFAULTS)
        value = f"{ground}" if ground == flying else f"{ground}; {flying} for quadrotors"
        name, text = setting.replace(".", "__"), f"{text}  [default: {value}]"
        options.append(click.option(flag, name, type=kind, help=text))
    options += [
        click.option(
            "--settings",
            "settings_file",
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="Settings in YAML, for example the settings.yaml of a run; options win over it.",
        ),
        click.option(
            "--set",
            "assignments",
            multiple=True,
            metavar="NAME=VALUE",
            help="Any other setting, for example --set fields.decay_length=3 (see 'jaxplore "
            "settings').",
        ),
        click.option("--overwrite", is_flag=True, help="Replace a run folder that is there."),
    ]

    def add(command: Any) -> Any:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def _entries(options: dict[str, Any]) -> dict[str, Any]:
    """Return the settings given by what `_options` adds."""
    settings_file, assignments = options.pop("settings_file"), options.pop("assignments")
    entries = {} if settings_file is None else read_settings(settings_file)
    map_ = options.pop("map_")
    if map_ is not None:
        entries = {**_place(map_), **entries}
    for name, value in options.items():
        if value is not None:
            _assign(entries, name.replace("__", "."), value)
    if options["controller__num_samples"] is not None:
        for section in ("informative", "portfolio"):
            _assign(entries, f"{section}.num_samples", options["controller__num_samples"])
    for assignment in assignments:
        name, separator, text = assignment.partition("=")
        if not separator:
            raise ValueError(f"--set is {assignment!r}; accepted: NAME=VALUE")
        try:
            _assign(entries, name.strip(), yaml.safe_load(text))
        except yaml.YAMLError:
            raise ValueError(f"--set is {assignment!r}; accepted: a value in YAML") from None
    return entries


def _place(name: str) -> dict[str, Any]:
    """Return the settings that a map, a world, a scenario or the name of one stands for."""
    if name in (OFFICE, ZONES, *SCENARIOS):
        return {"map": name}
    if is_scenario_file(name):
        return {"map": str(Path(name).absolute()), **read_settings(name)}
    return {"map": str(Path(name).absolute())}


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="jaxplore")
def cli() -> None:
    """Informative exploration with sampling-based control, on JAX."""


@cli.command()
@_options()
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
    """Let a robot explore a ROS map, a world or scenario file, or one that has a name.

    Names: office (generated), zones (a quadrotor's), and the ground vehicles' scenarios
    warehouse, search-rescue and perimeter.

    Writes a run folder with metrics, arrays, pictures, an animation and the settings used:

    \b
      jaxplore run office
      jaxplore run warehouse
      jaxplore run zones --architecture parallel
      jaxplore run maps/depot.yaml --start 4.62 7.73 0 --out runs/depot
      jaxplore run --settings runs/depot/settings.yaml --out runs/again

    Ctrl-C ends the run and keeps what was done.
    """
    entries = _entries(options)
    settings = make_settings(entries)
    folder = _free_name(Path("runs") / Path(settings.map).stem) if out is None else out
    check_folder(folder, overwrite=overwrite)
    experiment = build(settings)
    result = simulate(
        *experiment[:3],
        key=experiment.key,
        progress=True,
        num_trajectories=NUM_TRAJECTORIES if animation else 0,
    )
    result.save(
        folder,
        overwrite=overwrite,
        animation=animation,
        settings=settings.model_dump(mode="json"),
        progress=True,
    )
    _show(result.metrics, folder)
    if result.metrics.is_interrupted:
        click.echo("Interrupted: what was done before is in the run folder.", err=True)


@cli.command()
@_options("architecture")
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
    """
    entries = _entries(options)
    if seeds < 1:
        raise ValueError(f"--seeds is {seeds}; accepted: a whole number >= 1")
    if architectures is None and make_settings(entries).architecture == "portfolio":
        names: tuple[str, ...] = GROUND
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
        folder = _free_name(Path("runs") / f"{Path(common.map).stem}-comparison")
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
    _show_comparison(result, folder)


@cli.command("settings")
def show_settings() -> None:
    """Print every setting with its default, as YAML."""
    click.echo(
        yaml.safe_dump(Settings(map=OFFICE).model_dump(mode="json"), sort_keys=False), nl=False
    )


def _assign(entries: dict[str, Any], name: str, value: Any) -> None:
    *sections, last = name.split(".")
    for section in sections:
        inner = entries.setdefault(section, {})
        if not isinstance(inner, dict):
            raise ValueError(f"setting {section} is {inner!r}; accepted: a mapping")
        entries = inner
    entries[last] = value


def _free_name(path: Path) -> Path:
    candidate, number = path, 2
    while candidate.exists():
        candidate, number = path.with_name(f"{path.name}-{number}"), number + 1
    return candidate


def _show(metrics: Metrics, folder: Path) -> None:
    table = Table(title=str(folder), show_header=False)
    for name, value in metrics.rows():
        table.add_row(name, value)
    Console().print(table)
    names = ("map", "coverage", "members", "idleness")
    for name in (*(f"{name}.png" for name in names), "exploration.gif", "metrics.json"):
        if (folder / name).exists():
            click.echo(str(folder / name))


def _show_comparison(comparison: Comparison, folder: Path) -> None:
    # A column for each controller: a row would not fit on a terminal.
    header, *rows = zip(*comparison.rows(), strict=True)
    click.echo(f"{folder}: medians [quartiles]")
    # As text: square brackets are units and quartiles here, not markup.
    table = Table()
    for cell in header:
        table.add_column(Text(cell))
    for row in rows:
        table.add_row(*map(Text, row))
    Console().print(table)
    for path in sorted(folder.iterdir()):
        click.echo(str(path))
    if comparison.is_interrupted:
        click.echo("Interrupted: the runs that were done before are in the folder.", err=True)


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
