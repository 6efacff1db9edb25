"""The command line."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import yaml
from rich.console import Console
from rich.table import Table

from jaxplore._version import __version__
from jaxplore.report.folder import check_folder
from jaxplore.report.metrics import Metrics
from jaxplore.runs import simulate
from jaxplore.settings import OFFICE, Settings, build, make_settings, read_settings

# Options that stand for a setting: option, dotted setting, type, help.
_OPTIONS: tuple[tuple[str, str, Any, str], ...] = (
    ("--seed", "seed", int, "Seed of everything random."),
    ("--time-limit", "time_limit", float, "Simulated time [s]."),
    ("--target-coverage", "target_coverage", float, "Share of reachable cells at which to stop."),
    ("--resolution", "resolution", float, "Side of a map cell [m]; finer maps are resampled."),
    ("--robot", "robot.model", str, "Model of the robot: differential_drive."),
    ("--radius", "robot.radius", float, "Radius of the robot [m]."),
    ("--max-speed", "robot.max_speed", float, "Speed of the robot [m/s]."),
    ("--beams", "lidar.num_beams", int, "Beams of the lidar."),
    ("--range", "lidar.max_range", float, "Reach of the lidar [m]."),
    ("--samples", "controller.num_samples", int, "Rollouts of MPPI."),
)


def _options(command: Any) -> Any:
    defaults = Settings(map=OFFICE).model_dump()
    for flag, setting, kind, text in reversed(_OPTIONS):
        value: Any = defaults
        for part in setting.split("."):
            value = value[part]
        command = click.option(
            flag, setting.replace(".", "__"), type=kind, help=f"{text}  [default: {value}]"
        )(command)
    return command


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="jaxplore")
def cli() -> None:
    """Informative exploration with sampling-based control, on JAX."""


@cli.command()
@click.argument("map_", metavar="[MAP.yaml | office]", required=False)
@click.option(
    "--start",
    nargs=3,
    type=float,
    metavar="X Y YAW",
    help="Where the robot starts [m, m, rad]; the office has a start of its own.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", help="Run folder.  [default: runs/MAP]"
)
@_options
@click.option(
    "--settings",
    "settings_file",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Settings in YAML, for example the settings.yaml of a run; options win over it.",
)
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="NAME=VALUE",
    help="Any other setting, for example --set fields.decay_length=3 (see 'jaxplore settings').",
)
@click.option("--overwrite", is_flag=True, help="Replace a run folder that is there.")
@click.option("--animation/--no-animation", default=True, help="Draw exploration.gif.")
def run(
    map_: str | None,
    start: tuple[float, float, float] | None,
    out: Path | None,
    settings_file: Path | None,
    assignments: tuple[str, ...],
    overwrite: bool,
    animation: bool,
    **options: Any,
) -> None:
    """Let a robot explore a ROS map (or a generated office) of which it knows nothing.

    Writes a run folder with metrics, arrays, pictures, an animation and the settings used:

    \b
      jaxplore run office
      jaxplore run maps/depot.yaml --start 4.62 7.73 0 --out runs/depot
      jaxplore run --settings runs/depot/settings.yaml --out runs/again

    Ctrl-C ends the run and keeps what was done.
    """
    entries = {} if settings_file is None else read_settings(settings_file)
    if map_ is not None:
        entries["map"] = map_ if map_ == OFFICE else str(Path(map_).absolute())
    if start is not None:
        entries["start"] = start
    for name, value in options.items():
        if value is not None:
            _assign(entries, name.replace("__", "."), value)
    for assignment in assignments:
        name, separator, text = assignment.partition("=")
        if not separator:
            raise ValueError(f"--set is {assignment!r}; accepted: NAME=VALUE")
        try:
            _assign(entries, name.strip(), yaml.safe_load(text))
        except yaml.YAMLError:
            raise ValueError(f"--set is {assignment!r}; accepted: a value in YAML") from None
    settings = make_settings(entries)
    folder = _free_name(Path("runs") / Path(settings.map).stem) if out is None else out
    check_folder(folder, overwrite=overwrite)
    experiment = build(settings)
    result = simulate(*experiment[:3], key=experiment.key, progress=True)
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
    for name in ("map.png", "coverage.png", "exploration.gif", "metrics.json"):
        if (folder / name).exists():
            click.echo(str(folder / name))


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
