"""Kills at random moments, and whether what the commands keep is whole afterwards."""

import hashlib
import json
import random
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

from jaxplore.report.folder import MARK

from . import places
from .command import call
from .outcomes import Judged, Outcome, judge_stop
from .processes import hidden, started

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
LONGEST = 25.0
"""Latest moment of a kill of a command that does not end by itself [s]."""
PATIENCE = 300.0
"""Longest wait for the end of a command after a signal [s]."""
_MORE = 4
"""Number of runs of each variant, or of candidates, that a command adds to those of the last."""

State = dict[str, str]
"""What is kept, by name, as text that is compared."""


class Subject(NamedTuple):
    """A command that is killed.

    Args:
        name: short name.
        arguments: command-line arguments; `{more}` is a number that grows with every kill, so that
            there is something left to do.
        keeps: what there is before the command, a folder of the valid files; None for nothing.
        state: function of the working directory that returns what is kept; it raises if something
            is half-written.
        only_grows: whether the command adds to what is kept, and does not replace it.
        has_robot: whether it needs a simulated robot on ROS 2.
    """

    name: str
    arguments: list[str]
    keeps: str | None
    state: Callable[[Path], State]
    only_grows: bool = False
    has_robot: bool = False


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def state_of_run(folder: Path) -> State:
    """Return the hash of every file of a run folder, which must load."""
    from jaxplore.simulation.run import Run

    if not (folder / "run").exists():
        return {}
    Run.load(folder / "run")
    return {path.name: _digest(path) for path in (folder / "run").iterdir()}


def state_of_recording(folder: Path) -> State:
    """Return the numbers of messages of a recording, which must be complete."""
    from mcap.reader import make_reader

    found = {}
    for path in folder.glob("*.mcap"):
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        if summary is None or summary.statistics is None:
            raise ValueError(f"{path.name} has no end")
        found[path.name] = _digest(path)
    return found | state_of_run(folder)


def state_of_study(folder: Path) -> State:
    """Return the whole lines of a study, each of which must be readable."""
    file = folder / "study" / "study.jsonl"
    if not file.exists():
        return {}
    # A kill may leave the beginning of the last line.
    lines = file.read_bytes().split(b"\n")[:-1]
    for line in lines:
        json.loads(line)
    return {f"line {number}": str(line) for number, line in enumerate(lines)}


def state_of_comparison(folder: Path) -> State:
    """Return the hash of the file of every run of a comparison, which must be readable."""
    import pyarrow.parquet

    top = folder / "comparison"
    if not top.exists():
        return {}
    if (top / "comparison.json").exists():
        json.loads((top / "comparison.json").read_text())
    found = {}
    for path in (top / "runs").glob("*.parquet"):
        if not path.name.startswith("."):
            pyarrow.parquet.read_table(path)
            found[path.name] = _digest(path)
    if (top / "results.parquet").exists():
        pyarrow.parquet.read_table(top / "results.parquet")
    return found


_RUN = ["run", "{base}/room.yaml", *places.FEW, "--time-limit", "3", "--overwrite", "--out", "run"]
_NODE = ["node", *places.FEW[6:], "--set", "controller.num_samples=8"]
SUBJECTS = (
    Subject("run", _RUN, "run", state_of_run),
    Subject("record", [*_RUN, "--record", "r.mcap", "--no-animation"], "run", state_of_recording),
    Subject(
        "tune", [*places.STUDY, "--budget", "{more}"], "study", state_of_study, only_grows=True
    ),
    Subject(
        "compare",
        [*places.COMPARISON, "--seeds", "{more}", "--time-limit", "5"],
        None,
        state_of_comparison,
        only_grows=True,
    ),
    Subject(
        "node",
        [*_NODE, "--record", "r.mcap", "--out", "run", "--overwrite", "--no-animation"],
        "run",
        state_of_recording,
        has_robot=True,
    ),
)


def kills(
    number: int, base: Path, root: Path, *, seed: int = 0, has_ros: bool = True
) -> Iterator[tuple[str, Judged]]:
    """Kill commands at random moments; yield what each kill was, and its outcome.

    Args:
        number: number of kills, spread over the commands and the signals.
        base: folder of the valid files.
        root: folder for the working directories of the commands.
        seed: seed of the moments.
        has_ros: whether the packages of ROS 2 are there, for the node.
    """
    chance = random.Random(seed)
    subjects = [each for each in SUBJECTS if has_ros or not each.has_robot]
    longest: dict[str, float] = {}
    for index in range(number):
        subject = subjects[index % len(subjects)]
        folder = root / subject.name
        if subject.name not in longest:
            # Once without a kill: it compiles, and tells how long the command takes.
            _renew(folder, subject, base)
            longest[subject.name], judged = _whole_time(subject, base, folder)
            yield f"{subject.name}: no kill", judged
        # What grows, grows over the kills: nothing of it may be lost.
        if not subject.only_grows or index < len(subjects):
            _renew(folder, subject, base)
        sent = SIGNALS[index // len(subjects) % len(SIGNALS)]
        moment = chance.uniform(0.05, longest[subject.name])
        label = f"{subject.name}: {sent.name} after {moment:.1f} s"
        more = str(_MORE * (2 + index // len(subjects)))
        arguments = [each.replace("{more}", more) for each in subject.arguments]
        chosen = subject._replace(arguments=arguments)
        yield label, kill(chosen, sent, moment, base, folder)


def _whole_time(subject: Subject, base: Path, folder: Path) -> tuple[float, Judged]:
    """Run a command without a kill, and return how long it takes once it is compiled."""
    if subject.has_robot:
        return LONGEST, Judged(Outcome.ACCEPTED)
    seconds = 0.0
    for _ in range(2):
        _renew(folder, subject, base)
        arguments = [each.replace("{more}", str(_MORE)) for each in subject.arguments]
        with started(places.filled(arguments, base), folder) as (_, finish):
            ended = finish(PATIENCE)
        seconds = ended.seconds
        judged = judge_stop(ended, is_whole=bool(subject.state(folder)), leftovers=())
    return seconds, judged


def kill(
    subject: Subject, number: signal.Signals, moment: float, base: Path, folder: Path
) -> Judged:
    """Kill a command once, and compare what it keeps before and after."""
    before, there = subject.state(folder), set(hidden(folder))
    arguments = places.filled(subject.arguments, base)
    with ExitStack() as stack:
        if subject.has_robot:
            robot = ["robot", str(base / "room.yaml"), *places.FEW, "--out", "robot"]
            away = folder.parent / "robot"
            shutil.rmtree(away, ignore_errors=True)
            away.mkdir()
            stack.enter_context(started([*robot, "--time-limit", "600"], away))
        process, finish = stack.enter_context(started(arguments, folder))
        try:
            process.wait(moment)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        ended = finish(PATIENCE)
    if ended.code == -signal.SIGKILL:
        # The next start cleans up, up to the moment where its work would begin.
        call(arguments, folder, folder)
    try:
        after = subject.state(folder)
    except Exception as error:
        return Judged(Outcome.LOST, f"{type(error).__name__}: {error}"[:200])
    leftovers = tuple(sorted(set(hidden(folder)) - there))
    is_whole = _is_whole(subject, before, after)
    return judge_stop(ended, is_whole=is_whole, leftovers=leftovers)


def _is_whole(subject: Subject, before: State, after: State) -> bool:
    if subject.only_grows:
        return before.items() <= after.items()
    # The times in its metrics tell one run from another.
    is_new = before.get(MARK) != after.get(MARK, before.get(MARK))
    return is_new or before.items() <= after.items()


def _renew(folder: Path, subject: Subject, base: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if subject.keeps is not None:
        shutil.copytree(base / subject.keeps, folder / subject.keeps)
