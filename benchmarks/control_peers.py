"""Commands of ours and of the peers, each in its own environment, on the same problems."""

import dataclasses
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.control_problems import Problem, build, map_problem, quadrotor_problem, timed_step
from jaxplore import MPPI, State
from jaxplore.control import GaussianProposal, NoiseBank

PEERS = Path(__file__).parent / ".peers"
TORCH_PEER = PEERS / "torch"


def measure() -> list[dict[str, Any]]:
    """Commands of ours and of the peers, turn by turn.

    All drive the same models; jax_mppi's differential drive also goes backwards and wraps its
    heading.
    """
    quadrotor = quadrotor_problem()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, problem, variant in (
            ("quadrotor, plain", quadrotor, "plain"),
            ("quadrotor, smooth", quadrotor, "smooth"),
            ("quadrotor, 10 knots and a kernel", quadrotor, "kernel"),
            ("differential drive on a map", map_problem(1024), "plain"),
            ("differential drive on a map", map_problem(2048), "plain"),
        ):
            file = Path(folder) / "problem.npz"
            _save(file, problem)
            controller = build(problem, variant)
            ours = [timed_step(controller, problem["start"])]
            theirs: list[dict[str, Any]] = []
            if name == "quadrotor, plain":
                # What our quadrotors fly with: peers draw new numbers for each command.
                banked = build(problem, variant, proposal=_bank(problem))
                took = timed_step(banked, problem["start"])
                theirs.append(_peer_row("jaxplore, bank of noise", dataclasses.asdict(took)))
            paid = _probe(controller, problem)
            for peer, command in _commands(file, variant).items():
                result = run_peer(peer, command, folder)
                ours.append(timed_step(controller, problem["start"]))
                # Those of our runs before and after it.
                beside = float(np.mean([one.p50_ms for one in ours[-2:]]))
                for suffix, times in _variants(result):
                    row = _peer_row(peer + suffix, times)
                    if result is not None and times is not None:
                        row["times_as_long_as_jaxplore"] = times["p50_ms"] / beside
                        row["problem_differs_by"] = abs(result["probe_cost"] - paid) / abs(paid)
                    theirs.append(row)
            times = {
                "p50_ms": float(np.median([one.p50_ms for one in ours])),
                "p99_ms": float(np.median([one.p99_ms for one in ours])),
                "compile_seconds": ours[0].compile_seconds,
            }
            title = f"{name}, K = {problem['num_samples']}, T = {problem['horizon']}"
            rows.append({"": title, **_peer_row("jaxplore", times)})
            rows.extend({"": title, **row} for row in theirs)
    return rows


def _bank(problem: Problem) -> GaussianProposal:
    """Return noise from a bank of draws."""
    shape = (problem["horizon"], len(problem["noise_std"]), problem["num_samples"])
    return GaussianProposal(problem["noise_std"], noise=NoiseBank(shape, key=jax.random.key(0)))


def _variants(result: dict[str, Any] | None) -> list[tuple[str, dict[str, Any] | None]]:
    """Return a peer's times as it comes and, if it has that, compiled."""
    if result is None or "compiled" not in result:
        return [("", result)]
    return [("", result), (", compiled", result["compiled"])]


def _peer_row(library: str, times: dict[str, Any] | None) -> dict[str, Any]:
    names = {"ms": "p50_ms", "p99_ms": "p99_ms", "first_call_s": "compile_seconds"}
    row = {short: None if times is None else times[name] for short, name in names.items()}
    return {
        "library": library,
        **row,
        "times_as_long_as_jaxplore": None,
        "problem_differs_by": None,
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
            str(PEERS / "bin" / "python"),
            str(scripts / "jax_mppi_control.py"),
            source,
            str(problem),
            variant,
        ],
        "pytorch_mppi": [
            str(TORCH_PEER / "bin" / "python"),
            str(scripts / "pytorch_mppi_control.py"),
            str(problem),
            variant,
        ],
    }


def run_peer(name: str, command: list[str], folder: str) -> dict[str, Any] | None:
    """Run a peer on a problem, where `make bench` has set it up."""
    if not Path(command[0]).exists():
        print(f"{name} is not installed at {command[0]}: left out", file=sys.stderr)
        return None
    # What torch compiles is not kept: first calls are what they are for a newcomer.
    environment = {**os.environ, "TORCHINDUCTOR_CACHE_DIR": str(Path(folder) / "inductor")}
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=environment)
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


def _probe(controller: MPPI, problem: Problem) -> float:
    """Return the stage costs of the problem's given controls."""
    model, total = controller.dynamics, 0.0
    state, cost = jnp.asarray(problem["start"]), build(problem).cost
    step = eqx.filter_jit(model.step)
    for control in jnp.asarray(problem["probe"], jnp.float32):
        state = step(state, control, controller.dt)
        total += float(cost.stage(State(state, model), control, jnp.zeros(()), None))
    return total
