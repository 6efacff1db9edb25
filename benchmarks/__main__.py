"""`python -m benchmarks`: measure, print tables, write JSON."""

import argparse
import json
import os
import platform
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jax
from rich.console import Console
from rich.table import Table

from benchmarks import (
    control,
    control_step,
    exploration,
    first_hour,
    information,
    informative,
    large_maps,
    localisation,
    path_following,
    portfolio_step,
    robot,
    sensitivity,
    tuning,
    view,
    volumes,
)
from benchmarks.tables import table
from jaxplore import __version__


def main() -> None:
    """Run the benchmarks."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--seeds", type=int, default=5, help="runs on each map [default: 5]")
    parser.add_argument("--steps", type=int, default=2000, help="steps timed [default: 2000]")
    parser.add_argument(
        "--endurance-steps",
        type=int,
        default=1_000_000,
        help="control steps while memory is watched [default: 1000000]",
    )
    parser.add_argument("--only", choices=list(SECTIONS), help="run this one [default: all]")
    parser.add_argument(
        "--out",
        type=Path,
        help="where the numbers go [default: benchmarks/results.json, nowhere with --only]",
    )
    arguments = parser.parse_args()
    out = arguments.out
    if out is None and arguments.only is None:
        out = Path("benchmarks/results.json")
    console = Console(width=180)
    results = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "jaxplore": __version__,
        "jax": jax.__version__,
        "python": platform.python_version(),
        "device": jax.devices()[0].device_kind,
        "cpu_count": os.cpu_count(),
    }
    for name, section in SECTIONS.items():
        if arguments.only in (None, name):
            results.update(section(arguments, console))
    if out is not None:
        out.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
        console.print(f"Written to {out}")


def _control(arguments: argparse.Namespace, console: Console) -> dict[str, Any]:
    controller = control.measure(arguments.endurance_steps)
    for title, name in (
        ("A command, and its peers'", "peers"),
        ("A differential drive on a map of costs", "on_a_map"),
        ("Growth", "growth"),
        ("Several controllers in one call", "fleet"),
        ("Sources of noise, K = 1024", "noise"),
        ("Weightings", "weighting"),
        ("Feedback", "feedback"),
        ("Two CPU devices", "devices"),
        ("Endurance", "endurance"),
    ):
        console.print(table(title, controller[name]))
    return {"control": controller}


def _information(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    engine = information.measure()
    for title, rows in (
        ("Local field: 20 x 20 nodes, 8 yaws, 12 beams, 10 m", engine["local_field"]),
        (
            "Fields of all headings, 5 m; an update after each scan of an exploration",
            engine["fields"],
        ),
        ("Growth: 16 directions, 64 beams", engine["growth"]),
        ("Information of a trajectory: 50 poses, 16 beams, 5 m", engine["trajectories"]),
    ):
        console.print(table(title, rows))
    return {"information": engine}


def _control_step(arguments: argparse.Namespace, console: Console) -> dict[str, Any]:
    step = control_step.measure(arguments.steps)
    console.print(_step_table(step))
    return {"control_step": step}


def _informative(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    times = informative.measure()
    sizes = f"K = {times['samples']}, T = {times['horizon']}, {times['cells']} cells"
    for title, name in (
        (f"Informative MPPI, a control step of the closed loop: {sizes}", "loop"),
        ("The same, times as long as jaxplore", "ratios"),
        ("Informative MPPI, part by part", "parts"),
    ):
        if times[name]:
            console.print(table(title, times[name]))
    return {"informative": times}


def _path_following(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    following = path_following.measure()
    for title, name in (
        ("Contouring control along an S-curve, a step, and Faran's", "step"),
        ("How well it follows: K = 256, T = 30, at most 10 s", "tracking"),
    ):
        console.print(table(title, following[name]))
    return {"path_following": following}


def _portfolio(arguments: argparse.Namespace, console: Console) -> dict[str, Any]:
    times = portfolio_step.measure(arguments.steps)
    for title, name in (
        ("A portfolio's step in the warehouse by members: K = 1000, T = 30, 360 beams", "members"),
        ("The same, part by part, four members", "parts"),
    ):
        console.print(table(title, times[name]))
    return {"portfolio": times}


def _tuning(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    rows = tuning.measure()
    console.print(table("Episodes of a search, a population side by side and one by one", rows))
    settings = sensitivity.measure()
    console.print(table("One setting at a time, times as long as with the default", settings))
    return {"tuning": rows, "sensitivity": settings}


def _exploration(arguments: argparse.Namespace, console: Console) -> dict[str, Any]:
    rows = exploration.measure(arguments.seeds)
    summary = exploration.summarise(rows)
    console.print(table("Exploration, medians over seeds", summary))
    return {"exploration": summary, "runs": rows}


def _view(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    rows = view.measure()
    console.print(table("A live view, in times as long as a run without one", rows))
    return {"view": rows}


def _robot(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    found = robot.measure()
    console.print(table("The node with a simulated robot in another process", found["drives"]))
    console.print(table("Memory of the node while it follows paths", found["memory"]))
    return {"robot": found}


def _first_hour(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    rows = first_hour.measure()
    console.print(table("First hour: whole commands in fresh processes", rows))
    return {"first_hour": rows}


def _large_maps(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    rows = large_maps.measure()
    console.print(table("Large maps: half known, 360 beams of 5 m, K = 1000, T = 40", rows))
    return {"large_maps": rows}


def _localisation(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    rows = localisation.measure_times()
    console.print(table("Parts of a localisation, scans of 360 beams", rows))
    return {"localisation": rows}


def _volumes(_: argparse.Namespace, console: Console) -> dict[str, Any]:
    rows = volumes.measure()
    console.print(table("Volumes: camera of 64 x 48 rays, K = 512, T = 30", rows))
    return {"volumes": rows}


SECTIONS: dict[str, Callable[[argparse.Namespace, Console], dict[str, Any]]] = {
    "control": _control,
    "information": _information,
    "control_step": _control_step,
    "large_maps": _large_maps,
    "volumes": _volumes,
    "localisation": _localisation,
    "informative": _informative,
    "path_following": _path_following,
    "portfolio": _portfolio,
    "tuning": _tuning,
    "exploration": _exploration,
    "first_hour": _first_hour,
    "view": _view,
    "robot": _robot,
}


def _step_table(step: dict[str, Any]) -> Table:
    rows = [
        {"": "closed-loop step, one at a time", "p50 ms": step["p50_ms"], "p99 ms": step["p99_ms"]},
        {"": "the same in chunks, mean", "p50 ms": step["loop_mean_ms"], "p99 ms": None},
        *(
            {"": f"  {name}", "p50 ms": part["p50_ms"], "p99 ms": part["p99_ms"]}
            for name, part in step["parts"].items()
        ),
    ]
    sizes = f"K = {step['samples']}, T = {step['horizon']}, {step['cells']} cells"
    return table(f"{step['map']}: {sizes}; compiled in {step['compile_seconds']:.1f} s", rows)


if __name__ == "__main__":
    main()
