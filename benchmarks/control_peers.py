"""Commands of ours and of the peers, each in its own environment, on the same problems."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.control_problems import Problem, build, timed_step
from benchmarks.timing import Timed, percentiles
from jaxplore import MPPI, State
from jaxplore.control import GaussianProposal, NoiseBank

PEERS = Path(__file__).parent / ".peers"
PYTHONS = {
    "jax_mppi": PEERS / "bin" / "python",
    "pytorch_mppi": PEERS / "torch" / "bin" / "python",
    "Faran": PEERS / "faran" / "bin" / "python",
}
"""What runs each peer, where `make bench` has set it up."""


def missing_peers() -> list[str]:
    """Return the peers that are not set up."""
    return [name for name, python in PYTHONS.items() if not python.exists()]


def measure(
    quadrotor: Problem, on_maps: list[Problem], variants: Sequence[str], runs: int
) -> list[dict[str, Any]]:
    """Commands of ours and of the peers, turn by turn.

    All drive the same models; jax_mppi's differential drive also goes backwards and wraps its
    heading.

    Args:
        quadrotor: problem that is solved with all variants.
        on_maps: problems that are solved with the plain variant.
        variants: plain, smooth or kernel.
        runs: number of timed commands, at most.
    """
    rows = []
    cases = [(f"quadrotor, {each}", quadrotor, each) for each in variants]
    cases += [("differential drive on a map", problem, "plain") for problem in on_maps]
    with tempfile.TemporaryDirectory() as folder:
        for name, problem, variant in cases:
            file = Path(folder) / "problem.npz"
            _save(file, {**problem, "runs": runs})
            controller = build(problem, variant)
            ours = [timed_step(controller, problem["start"], runs)]
            theirs: list[dict[str, Any]] = []
            if name == "quadrotor, plain":
                # What our quadrotors fly with: peers draw new numbers for each command.
                banked = build(problem, variant, proposal=_bank(problem))
                took = timed_step(banked, problem["start"], runs)
                theirs.append(_peer_row("jaxplore, bank of noise", _times([took])))
            paid = _probe(controller, problem)
            for peer, command in _commands(file, variant).items():
                result = run_peer(command, folder)
                ours.append(timed_step(controller, problem["start"], runs))
                # Those of our runs before and after it.
                beside = float(np.mean([one.p50_ms for one in ours[-2:]]))
                for suffix, times in _variants(result):
                    row = _peer_row(peer + suffix, times)
                    if result is not None and times is not None:
                        row["times_as_long_as_jaxplore"] = times["p50_ms"] / beside
                        row["problem_differs_by"] = abs(result["probe_cost"] - paid) / abs(paid)
                    theirs.append(row)
            title = f"{name}, K = {problem['num_samples']}, T = {problem['horizon']}"
            rows.append({"": title, **_peer_row("jaxplore", _times(ours))})
            rows.extend({"": title, **row} for row in theirs)
    return rows


def _times(ours: list[Timed]) -> dict[str, Any]:
    """Return the times of all turns of ours together."""
    together = percentiles([seconds for each in ours for seconds in each.seconds])
    return {**together, "compile_seconds": ours[0].compile_seconds}


def _bank(problem: Problem) -> GaussianProposal:
    """Return noise from a bank."""
    return GaussianProposal(problem["noise_std"], noise=NoiseBank(key=jax.random.key(0)))


def _variants(result: dict[str, Any] | None) -> list[tuple[str, dict[str, Any] | None]]:
    """Return a peer's times as it comes and, if it has that, compiled."""
    if result is None or "compiled" not in result:
        return [("", result)]
    return [("", result), (", compiled", result["compiled"])]


def _peer_row(library: str, times: dict[str, Any] | None) -> dict[str, Any]:
    names = {"p50_ms": "p50_ms", "p99_ms": "p99_ms", "first_call_s": "compile_seconds"}
    row = {short: None if times is None else times[name] for short, name in names.items()}
    return {
        "library": library,
        **row,
        "times_as_long_as_jaxplore": None,
        "problem_differs_by": None,
        **({} if times is None or "repeats" not in times else {"repeats": times["repeats"]}),
    }


def _save(file: Path, problem: Problem) -> None:
    arrays: dict[str, Any] = {}
    for name, value in problem.items():
        array = np.asarray(value)
        arrays[name] = array.astype(np.float32) if array.dtype.kind == "f" else array
    np.savez(file, **arrays)


def _commands(problem: Path, variant: str) -> dict[str, list[str]]:
    scripts = Path(__file__).parent / "peers"
    source = str(PEERS / "jax_mppi")
    return {
        "jax_mppi": [
            str(PYTHONS["jax_mppi"]),
            str(scripts / "jax_mppi_control.py"),
            source,
            str(problem),
            variant,
        ],
        "pytorch_mppi": [
            str(PYTHONS["pytorch_mppi"]),
            str(scripts / "pytorch_mppi_control.py"),
            str(problem),
            variant,
        ],
    }


def run_peer(command: list[str], folder: str) -> dict[str, Any] | None:
    """Run a peer on a problem; None where it is not set up, or fails, which is told."""
    if not Path(command[0]).exists():
        return None
    # What torch compiles is not kept: first calls are what they are for a newcomer.
    environment = {**os.environ, "TORCHINDUCTOR_CACHE_DIR": str(Path(folder) / "inductor")}
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False, env=environment)
    if done.returncode != 0:
        # Hours of other measurements are not lost because of it; its traceback is above.
        name = Path(command[1]).name
        print(f"Without {name}: it ended with status {done.returncode}", file=sys.stderr)
        return None
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def _probe(controller: MPPI, problem: Problem) -> float:
    """Return the stage costs of the problem's given controls."""
    model, total = controller.dynamics, 0.0
    state, cost = jnp.asarray(problem["start"]), build(problem).cost
    step = eqx.filter_jit(model.step)
    paid = eqx.filter_jit(lambda of, at, u: of.stage(State(at, model), u, jnp.zeros(()), None))
    for control in np.asarray(problem["probe"], np.float32):
        state = step(state, control, controller.dt)
        total += float(paid(cost, state, control))
    return total
