"""`python -m benchmarks.bound RUN...`: compare run folders with the bounds of their maps.

Prints how many times as far each run drove as the tour and the floor, and where its metres went,
and writes `bound.json` and a picture of each run. It is no part of `make bench`.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.bound.metres import KINDS
from benchmarks.bound.picture import picture
from benchmarks.bound.run import STARTS, Bound, Driven, find_bound
from benchmarks.bound.tour import ROUNDS, SPACING
from benchmarks.tables import table
from jaxplore._files import replace_files
from jaxplore.report.drawing.figure import figure_bytes


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the comparison."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.bound",
        description="Compare runs of an exploration with bounds of the shortest way on their map.",
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="run folders")
    parser.add_argument(
        "--out", type=Path, help="folder of bound.json and the pictures [default: none is written]"
    )
    parser.add_argument(
        "--starts", type=_count, default=STARTS, help=f"searches for a tour [default: {STARTS}]"
    )
    parser.add_argument(
        "--rounds", type=_count, default=ROUNDS, help=f"rounds of a search [default: {ROUNDS}]"
    )
    parser.add_argument(
        "--spacing",
        type=_length,
        default=SPACING,
        help=f"spacing of the places of a tour in metres [default: {SPACING}]",
    )
    options = parser.parse_args(arguments)
    console = Console(width=180)
    try:
        reports, files = [], []
        bounds: dict[tuple[object, ...], Bound] = {}
        for folder in options.runs:
            driven = Driven.load(folder)
            if driven.key not in bounds:
                bounds[driven.key] = find_bound(
                    driven.problem,
                    starts=options.starts,
                    rounds=options.rounds,
                    spacing=options.spacing,
                )
            bound = bounds[driven.key]
            reports.append(driven.report(bound))
            if options.out is not None:
                name = f"{len(reports)}-{driven.map_name}-{driven.settings.architecture}.png"
                files.append((options.out / name, figure_bytes(picture(driven, bound))))
        console.print(table("Ratio to a tour with knowledge of the map", ratio_rows(reports)))
        console.print(table("Where the metres went", kind_rows(reports)))
        if options.out is not None:
            options.out.mkdir(parents=True, exist_ok=True)
            text = json.dumps(reports, indent=2) + "\n"
            replace_files([*files, (options.out / "bound.json", text.encode())])
            console.print(f"Written to {options.out}")
    except (ValueError, OSError) as error:
        print(f"python -m benchmarks.bound: {error}", file=sys.stderr)
        sys.exit(2)


def ratio_rows(reports: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per run and level: its metres and seconds beside those of the bounds."""
    return [
        {
            "map": report["map"],
            "explorer": report["explorer"],
            "%": level,
            "metres": found["metres"],
            "tour": found["tour_metres"],
            "floor": found["floor_metres"],
            "to tour": found["ratio"],
            "to floor": found["ratio_to_floor"],
            "seconds": found["seconds"],
            "of tour": found["tour_seconds"],
            "s to tour": found["ratio_seconds"],
        }
        for report in reports
        for level, found in report["levels"].items()
    ]


def kind_rows(reports: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per run and phase: the metres of each kind."""
    return [
        {
            "map": report["map"],
            "explorer": report["explorer"],
            "phase": phase,
            **{kind: found[kind] for kind in KINDS},
            "price of returns": found["price_of_returns"],
            "s slow": found.get("slow_seconds"),
            "s lost": found.get("lost_seconds"),
        }
        for report in reports
        for phase, found in report["phases"].items()
    ]


def _count(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 1_000_000:
        raise argparse.ArgumentTypeError(f"{text} is not accepted; accepted: 1 to 1000000")
    return value


def _length(text: str) -> float:
    value = float(text)
    if not 0.01 <= value <= 100.0:
        raise argparse.ArgumentTypeError(f"{text} is not accepted; accepted: 0.01 to 100")
    return value


if __name__ == "__main__":
    main()
