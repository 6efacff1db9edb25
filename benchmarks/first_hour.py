"""What a newcomer waits for: fresh processes, with an empty and with a warm compilation cache."""

import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import jaxplore as jx
from benchmarks.tables import Rows

PYTHON = [sys.executable, "-c"]
COMMAND = [sys.executable, "-m", "jaxplore"]
RUN = ["--time-limit", "5", "--no-animation", "--overwrite"]
COMPARE = ["compare", "--maps", "maps", "--architectures", "explorer"]
COMMANDS = {
    "import jax": [*PYTHON, "import jax"],
    "import jaxplore": [*PYTHON, "import jaxplore"],
    "jaxplore --help": [*COMMAND, "--help"],
    **{
        f"run {name}, 5 s, {start} start": [*COMMAND, "run", name, "--out", name, *RUN]
        for name in ("office", "zones", "warehouse")
        for start in ("first", "second")
    },
    "compare three maps, 5 s, first start": [
        *(*COMMAND, *COMPARE, "--seeds", "1", "--time-limit", "5", "--out", "compared"),
    ],
}


class Sizes(NamedTuple):
    """Names of commands, and how often each runs."""

    commands: tuple[str, ...] = tuple(COMMANDS)
    repeats: int = 2


FULL = Sizes()
SMOKE = Sizes(("jaxplore --help",), 1)
TITLES = {"commands": "First hour: whole commands in fresh processes"}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Measure CPU and wall seconds of whole commands; medians of a few runs."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        maps = place / "maps"
        maps.mkdir()
        for seed, width in enumerate((12.0, 15.0, 18.0)):
            jx.office(seed, width=width, height=10.0).to_ros(maps / f"office{seed}.yaml")
        return {"commands": [_timed(name, place, sizes.repeats) for name in sizes.commands]}


def _timed(name: str, place: Path, repeats: int) -> dict[str, Any]:
    """Time a command. A first start has an empty cache each time, a second one a warm cache."""
    command, is_first = COMMANDS[name], name.endswith("first start")
    rows = []
    for repeat in range(repeats):
        cache = place / (f"cache-{name}-{repeat}" if is_first else "cache")
        environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
        # The benchmark's own process must not hand its cache or its device to the command.
        for inherited in ("JAX_COMPILATION_CACHE_DIR", "JAXPLORE_CACHE", "XLA_FLAGS"):
            environment.pop(inherited, None)
        if not is_first and repeat == 0:
            subprocess.run(command, cwd=place, env=environment, check=True, capture_output=True)
        # A comparison continues its folder, so each starts without one.
        for former in place.glob("compared*"):
            shutil.rmtree(former)
        before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run(command, cwd=place, env=environment, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        rows.append((spent, time.perf_counter() - began))
    cpu, wall = (statistics.median(column) for column in zip(*rows, strict=True))
    repeated = [spent for spent, _ in rows]
    return {"command": name, "CPU_s": round(cpu, 2), "wall_s": round(wall, 2), "repeats": repeated}
