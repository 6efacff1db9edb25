"""`python -m benchmarks`: measure, print tables, write JSON."""

import argparse
import platform
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import jax
from rich.console import Console

from benchmarks import (
    control,
    control_step,
    exploration,
    first_hour,
    gpu,
    history,
    information,
    informative,
    large_maps,
    localisation,
    map_matching,
    page,
    path_following,
    portfolio_step,
    robot,
    tuning,
    view,
    volumes,
)
from benchmarks.control_peers import missing_peers
from benchmarks.tables import Rows, table
from jaxplore import __version__


class Section(Protocol):
    """A module that measures something.

    A `NamedTuple` with all that makes it long: `FULL` is what `make bench` runs, and `SMOKE` walks
    the same code in seconds. `measure` returns tables, and `TITLES` has those that are printed.
    """

    FULL: Any
    SMOKE: Any
    TITLES: dict[str, str]

    def measure(self, sizes: Any) -> dict[str, Rows]:
        """Measure, and return tables by name."""


SECTIONS: dict[str, Section] = {
    "control": control,
    "information": information,
    "control_step": control_step,
    "large_maps": large_maps,
    "volumes": volumes,
    "localisation": localisation,
    "map_matching": map_matching,
    "informative": informative,
    "path_following": path_following,
    "portfolio": portfolio_step,
    "tuning": tuning,
    "exploration": exploration,
    "first_hour": first_hour,
    "view": view,
    "robot": robot,
    "gpu": gpu,
}


def main() -> None:
    """Run the benchmarks, compare results, or write the page of them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--smoke", action="store_true", help="tiny sizes: does everything run?")
    parser.add_argument("--seeds", type=int, help="runs on each map of the section exploration")
    parser.add_argument("--steps", type=int, help="steps of closed loops timed one by one")
    parser.add_argument("--endurance-steps", type=int, help="control steps while memory is watched")
    parser.add_argument("--only", nargs="+", choices=list(SECTIONS), help="run these")
    parser.add_argument(
        "--out",
        type=history.results_file,
        help="where the numbers go [default: a file in benchmarks/history, "
        "nowhere with --smoke or --only]",
    )
    parser.add_argument(
        "--compare",
        nargs="*",
        type=Path,
        metavar="FILE",
        help="tell what became slower or faster from an OLD to a NEW file, and measure nothing "
        "[default: the two newest of this machine]",
    )
    parser.add_argument(
        "--page",
        action="store_true",
        help="write the tables of docs/performance.md from the newest file of each section, and "
        "measure nothing",
    )
    given = parser.parse_args()
    console = Console(width=180)
    try:
        if given.compare is not None:
            _compare(given.compare, console)
        elif given.page:
            _page()
        else:
            _run(given, console)
    except ValueError as error:
        parser.error(str(error))


def _run(given: argparse.Namespace, console: Console) -> None:
    missing = missing_peers()
    if missing:
        console.print(f"Without peers that are not installed: {', '.join(missing)}")
    results: history.Results = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": history.commit(),
        "machine": history.machine(),
        "jaxplore": __version__,
        "jax": jax.__version__,
        "python": platform.python_version(),
        "device": jax.devices()[0].device_kind,
        "without_peers": missing,
        "sections": {},
    }
    out = given.out
    if out is None and given.only is None and not given.smoke:
        out = history.default_path(results)
    for name, section in SECTIONS.items():
        if given.only is not None and name not in given.only:
            continue
        sizes = section.SMOKE if given.smoke else section.FULL
        flags = {each: getattr(given, each, None) for each in sizes._fields}
        sizes = sizes._replace(**{each: n for each, n in flags.items() if n is not None})
        results["sections"][name] = tables = section.measure(sizes)
        for key, title in section.TITLES.items():
            if tables[key]:
                console.print(table(title, tables[key]))
        if out is not None:
            # After each section: what is measured is kept, whatever comes after it.
            history.save(results, out)
    if out is not None:
        console.print(f"Written to {out}")


def _compare(files: list[Path], console: Console) -> None:
    if len(files) not in (0, 2):
        raise ValueError(f"--compare takes two files or none, not {len(files)}")
    here = history.machine()
    found = [history.load(path) for path in files] or history.newest(on=here)[1::-1]
    if len(found) < 2:
        raise ValueError(f"{history.FOLDER} has fewer than two results of this machine, {here}")
    rows, said = history.compare(*found)
    if rows:
        console.print(table("Beyond noise", rows))
    console.print(said)


def _page() -> None:
    found = history.newest()
    if not found:
        raise ValueError(f"{history.FOLDER} has no results")
    text = page.PAGE.read_text(encoding="utf-8")
    page.PAGE.write_text(page.rewritten(text, history.merged(found)), encoding="utf-8")


if __name__ == "__main__":
    main()
