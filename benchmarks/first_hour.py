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
from typing import Any

import jaxplore as jx

REPEATS = 3
COMMAND = [sys.executable, "-m", "jaxplore"]
RUN = ["--time-limit", "5", "--no-animation", "--overwrite"]


def measure() -> list[dict[str, Any]]:
    """Measure CPU and wall seconds of whole commands; medians of a few runs."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        maps = place / "maps"
        maps.mkdir()
        for seed, width in enumerate((12.0, 15.0, 18.0)):
            jx.office(seed, width=width, height=10.0).to_ros(maps / f"office{seed}.yaml")
        compare = [*COMMAND, "compare", "--maps", str(maps), "--architectures", "explorer"]
        compare += ["--seeds", "1", "--time-limit", "5", "--out", "compared"]
        return [
            _timed("import jax", [sys.executable, "-c", "import jax"], place),
            _timed("import jaxplore", [sys.executable, "-c", "import jaxplore"], place),
            _timed("jaxplore --help", [*COMMAND, "--help"], place),
            *(
                _timed(f"run {name}, 5 s, {start} start", command, place, start=start)
                for name in ("office", "zones", "warehouse")
                for command in ([*COMMAND, "run", name, "--out", name, *RUN],)
                for start in ("first", "second")
            ),
            _timed("compare three maps, 5 s, first", compare, place, start="first"),
        ]


def _timed(name: str, command: list[str], place: Path, *, start: str = "second") -> dict[str, Any]:
    """Time a command. A first start has an empty cache each time, a second one a warm cache."""
    rows = []
    for repeat in range(REPEATS):
        cache = place / (f"cache-{name}-{repeat}" if start == "first" else "cache")
        environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
        # The benchmark's own process must not hand its cache or its device to the command.
        for inherited in ("JAX_COMPILATION_CACHE_DIR", "JAXPLORE_CACHE", "XLA_FLAGS"):
            environment.pop(inherited, None)
        if start == "second" and repeat == 0:
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
    return {"command": name, "CPU s": round(cpu, 2), "wall s": round(wall, 2)}
