"""What the commands print when they are done."""

from pathlib import Path

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from jaxplore.report.comparison import Comparison
from jaxplore.settings.sections import Section
from jaxplore.simulation.run import Run


def free_name(path: Path) -> Path:
    """Return a path that is not there yet: itself, or with a number."""
    candidate, number = path, 2
    while candidate.exists():
        candidate, number = path.with_name(f"{path.name}-{number}"), number + 1
    return candidate


def save(result: Run, folder: Path, settings: Section, *, overwrite: bool, animation: bool) -> None:
    """Write a run's folder, and print what it came to and its files."""
    result.save(
        folder,
        overwrite=overwrite,
        animation=animation,
        settings=settings.model_dump(mode="json"),
        progress=True,
    )
    table = Table(title=str(folder), show_header=False)
    for name, value in result.metrics.rows():
        table.add_row(name, value)
    Console().print(table)
    for pattern in ("*.png", "*.gif", "metrics.json"):
        for file in sorted(folder.glob(pattern)):
            click.echo(str(file))
    if result.metrics.is_interrupted:
        click.echo("Interrupted: what was done before is in the run folder.", err=True)


def show_comparison(comparison: Comparison, folder: Path) -> None:
    """Print the table of a comparison, and its files."""
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
