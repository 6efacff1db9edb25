"""Progress bars on a terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from jaxplore._text import printable


@contextmanager
def progress_bar(label: str, *, enabled: bool) -> Iterator[Callable[[float, str], None]]:
    """Show a progress bar on a terminal; yield a function that updates its share and text."""
    # Slow to import, and few need it.
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, SpinnerColumn, TextColumn

    if not enabled:
        yield lambda share, text: None
        return
    console = Console(stderr=True)
    columns: list[ProgressColumn] = [
        SpinnerColumn(),
        # Names and messages may hold square brackets, which are no markup.
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[text]}", markup=False),
    ]
    with Progress(*columns, console=console) as bars:
        task = bars.add_task(printable(label), total=1.0, text="")
        yield lambda share, text: bars.update(task, completed=share, text=printable(text))
