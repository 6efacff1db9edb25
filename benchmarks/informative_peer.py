"""The process that runs jax_mppi's informative simulation, turn by turn."""

import contextlib
import json
import subprocess
from pathlib import Path
from typing import Any

from benchmarks.control_peers import PEERS, PYTHONS


class PeerError(Exception):
    """The peer does not run."""


class Peer:
    """`peers/jax_mppi_informative.py` in its own environment; it waits while ours is timed.

    Args:
        folder: for what it says.
        steps: of a turn.

    Raises:
        PeerError: it does not run; says why.
    """

    def __init__(self, folder: Path, steps: int) -> None:
        python, source = PYTHONS["jax_mppi"], PEERS / "jax_mppi"
        if not python.exists():
            raise PeerError(f"not installed at {python}")
        script = Path(__file__).parent / "peers" / "jax_mppi_informative.py"
        self._errors = folder / "errors.txt"
        with self._errors.open("w", encoding="utf-8") as errors:
            self._process = subprocess.Popen(
                [str(python), str(script), str(source), str(steps)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )
        self.about = self._answer()

    def turn(self) -> dict[str, Any]:
        """Have it take a turn, and return its times."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # Its last words say why.
            print(file=self._process.stdin, flush=True)
        return self._answer()

    def close(self) -> None:
        """End the process."""
        self._process.communicate()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            status = self._process.wait()
            said = self._errors.read_text(encoding="utf-8").splitlines()
            raise PeerError(said[-1] if said else f"it ended with status {status}")
        answer: dict[str, Any] = json.loads(line)
        return answer
