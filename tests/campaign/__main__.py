"""The whole campaign: `make campaign`, or `python -m tests.campaign --help`."""

import argparse
import collections
import importlib.util
import itertools
import json
import math
import os
import shlex
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis

from . import cases, kills, machines
from .mutations import FORMATS, MUTATIONS
from .outcomes import GOOD, Judged, Outcome
from .trials import Trials

_KEPT = 400
"""Greatest number of bad outcomes that the report lists."""

_AT_ONCE = 1000
"""Number of mutations of a format with one seed."""
_WRITTEN_EVERY = 10.0
"""Period in which the report is written [s]."""
_LONGEST_NAME = 300
"""Length to which the name of a call is cut [characters]."""


class Report:
    """Counts of outcomes by category, and the calls whose outcomes are not accepted.

    Args:
        path: the report, in JSON.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._counts: dict[str, collections.Counter[Outcome]] = {}
        self._bad: list[dict[str, str]] = []
        self._seconds: collections.Counter[str] = collections.Counter()
        self._written = -math.inf

    def add(self, category: str, name: str, judged: Judged, seconds: float) -> None:
        """Count an outcome, and keep it if it is bad."""
        self._counts.setdefault(category, collections.Counter())[judged.outcome] += 1
        self._seconds[category] += seconds
        if judged.outcome not in GOOD:
            bad = {"category": category, "name": name}
            self._bad.append({**bad, "outcome": judged.outcome, "reason": judged.reason})
            print(f"{judged.outcome}: {category}: {name}: {judged.reason}"[:300], flush=True)

    @property
    def num_bad(self) -> int:
        """Number of outcomes that are not accepted."""
        return len(self._bad)

    def write(self, every: float = 0.0) -> None:
        """Write the report, unless that was done within some seconds."""
        now = time.monotonic()
        if now - self._written < every:
            return
        self._written = now
        document = {
            "counts": {name: dict(counts) for name, counts in self._counts.items()},
            "seconds": {name: round(seconds, 1) for name, seconds in self._seconds.items()},
            "bad": self._bad[:_KEPT],
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text(json.dumps(document, indent=1) + "\n")

    def table(self) -> str:
        """Return the counts as a table in Markdown."""
        outcomes = [each for each in Outcome if any(each in c for c in self._counts.values())]
        lines = [["category", *outcomes, "in all"]]
        for name, counts in self._counts.items():
            shown = [str(counts[each] or "") for each in outcomes]
            lines.append([name, *shown, str(counts.total())])
        lines.insert(1, ["---"] * len(lines[0]))
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def mutate(trials: Trials, name: str, number: int, seed: int) -> list[tuple[str, Judged]]:
    """Mutate the file of a format by hypothesis; return each mutation and its outcome.

    Args:
        trials: runs the mutations.
        name: name of the format.
        number: number of mutations.
        seed: seed of hypothesis.
    """
    found = []

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=number,
        deadline=None,
        database=None,
        phases=[hypothesis.Phase.generate],
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    @hypothesis.given(MUTATIONS)
    def run(mutation: Any) -> None:
        found.append((repr(mutation)[:_LONGEST_NAME], trials.mutate(name, mutation)))

    run()
    return found


def everything(
    options: argparse.Namespace, trials: Trials, root: Path
) -> Iterator[tuple[str, str, Judged]]:
    """Yield the category, the name and the outcome of everything that the options ask for."""
    if "cases" in options.only:
        for category in cases.CATEGORIES:
            for case in cases.all_cases(category)[:: options.every]:
                name = f"{case.name}: {shlex.join(case.arguments)}"[:_LONGEST_NAME]
                yield category, name, trials.run(case)
    if "mutations" in options.only:
        # In parts, so that the report grows.
        each = math.ceil(options.mutations / sum(form.share for form in FORMATS.values()))
        for part, name in itertools.product(range(-(-each // _AT_ONCE)), FORMATS):
            number = min(_AT_ONCE, round(each * FORMATS[name].share) - part * _AT_ONCE)
            if number < 1:
                continue
            for mutation, judged in mutate(trials, name, number, options.seed + part):
                yield f"mutations: {name}", f"seed {options.seed + part}: {mutation}", judged
    if "kills" in options.only:
        has_ros = importlib.util.find_spec("rclpy") is not None
        killed = kills.kills(
            options.kills, trials.base, root / "kills", seed=options.seed, has_ros=has_ros
        )
        for name, judged in killed:
            yield f"kills: {name.partition(':')[0]}", name, judged
    if "machines" in options.only:
        yield from machines.machines(trials.base, root)


def main() -> int:
    """Run the campaign, write its report and print its table; 1 if an outcome is not accepted."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaign", description=__doc__)
    parser.add_argument("--mutations", type=int, default=100_000)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=["cases", "mutations", "kills", "machines"])
    parser.add_argument("--every", type=int, default=1, help="run each N-th case only")
    parser.add_argument("--report", type=Path, default=Path("runs/campaign.json"))
    options = parser.parse_args()
    report = Report(options.report.resolve())
    root = Path(tempfile.mkdtemp(prefix="campaign-"))
    # Compiled once, and read by every command that is started.
    os.environ["JAXPLORE_CACHE"] = str(root / "cache")
    os.environ.setdefault("ROS_DOMAIN_ID", "87")
    warnings.simplefilter("ignore")
    try:
        trials = Trials(root / "cases")
        began = time.perf_counter()
        for category, name, judged in everything(options, trials, root):
            now = time.perf_counter()
            report.add(category, name, judged, now - began)
            began = now
            report.write(_WRITTEN_EVERY)
    finally:
        report.write()
        shutil.rmtree(root, ignore_errors=True)
    print(report.table())
    print(f"{report.num_bad} outcomes are not accepted: {report.path}")
    return int(report.num_bad > 0)


if __name__ == "__main__":
    sys.exit(main())
