"""The controller: against its peers, how it grows, its parts, two devices, a million steps."""

import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array

from benchmarks import control_peers
from benchmarks.control_problems import (
    KEY,
    ToGoal,
    build,
    map_problem,
    quadrotor_problem,
    step,
    timed_step,
)
from benchmarks.timing import Timed, timed
from jaxplore import (
    MPPI,
    RK4,
    ColouredNoise,
    Elite,
    Euler,
    FeedbackMPPI,
    GaussianProposal,
    PointMass,
)
from jaxplore.control import (
    AdaptiveSoftmax,
    AntitheticNoise,
    CovarianceAdaptation,
    NoiseBank,
    SobolNoise,
    WhiteNoise,
    step_with_gains,
)


def measure(endurance_steps: int = 1_000_000) -> dict[str, Any]:
    """Return tables of times.

    Args:
        endurance_steps: control steps of the run that memory is watched over.
    """
    return {
        "peers": control_peers.measure(),
        "on_a_map": _on_a_map(),
        "growth": _growth(),
        "fleet": _fleet(),
        "noise": _noise(),
        "weighting": _weighting(),
        "feedback": _feedback(),
        "devices": _devices(),
        "endurance": _endurance(endurance_steps),
    }


def _on_a_map() -> list[dict[str, Any]]:
    """A differential drive on a cost map, 100 steps, with both integrators and two noises.

    For nav2 (C++, Euler steps) the paper on MPPI-Generic (arXiv 2409.07563) gives 3.4 and 6.7 ms,
    on its own problem and machine.
    """
    rows = []
    for samples in (1024, 2048):
        problem = map_problem(samples)
        variants: dict[str, dict[str, Any]] = {
            "Euler": {"integrator": Euler()},
            "Euler, Sobol noise": {
                "integrator": Euler(),
                "proposal": GaussianProposal(problem["noise_std"], noise=SobolNoise()),
            },
            "RK4": {"integrator": RK4()},
        }
        for name, changes in variants.items():
            took = timed_step(build(problem, **changes), problem["start"])
            rows.append(_growth_row(f"K = {samples}, T = 100, {name}", took, samples, 100))
    return rows


def _growth() -> list[dict[str, Any]]:
    """A command of a quadrotor with more samples and with longer horizons."""
    rows = []
    sizes = [(samples, 40) for samples in (256, 1024, 4096, 16384)]
    for samples, horizon in [*sizes, *((1024, horizon) for horizon in (10, 20, 40, 80, 160))]:
        problem = quadrotor_problem(samples, horizon)
        took = timed_step(build(problem), problem["start"], runs=100)
        rows.append(_growth_row(f"K = {samples}, T = {horizon}", took, samples, horizon))
    return rows


def _growth_row(name: str, took: Timed, rollouts: int, horizon: int) -> dict[str, Any]:
    return {
        "": name,
        "ms": took.p50_ms,
        "p99_ms": took.p99_ms,
        "thousand_rollouts_per_s": rollouts / took.p50_ms,
        "ns_per_step_of_a_rollout": 1e6 * took.p50_ms / (rollouts * horizon),
    }


def _fleet() -> list[dict[str, Any]]:
    """Commands of several controllers in one compiled call: all at once, and one after another."""
    problem = quadrotor_problem()
    controller, rows = build(problem), []
    samples, horizon = controller.num_samples, controller.horizon

    def one_by_one(controller: MPPI, *arguments: Any) -> Any:
        return jax.lax.map(lambda one: step(controller, *one), arguments)

    for count in (1, 2, 4, 8, 16):
        states = jax.vmap(lambda _: controller.init())(jnp.arange(count))
        starts = problem["start"] + 0.1 * jnp.arange(count, dtype=jnp.float32)[:, None]
        arguments = (controller, states, starts, jax.random.split(KEY, count))
        together = jax.vmap(step, in_axes=(None, 0, 0, 0))
        for name, function in (("vmap", together), ("lax.map", one_by_one)):
            took = timed(function, *arguments, runs=50)
            title = f"{count} controllers by {name}, K = {samples}, T = {horizon}"
            rows.append(_growth_row(title, took, count * samples, horizon))
    return rows


def _noise() -> list[dict[str, Any]]:
    """A command with noise from each source; K is a power of two, as Sobol points want it."""
    problem = quadrotor_problem(1024)
    shape = (problem["horizon"], len(problem["noise_std"]), problem["num_samples"])
    rows = []
    for name, noise in {
        "white": WhiteNoise(),
        "antithetic": AntitheticNoise(),
        "coloured, exponent 1": ColouredNoise(1.0),
        "Sobol": SobolNoise(),
        "bank of 16 draws": NoiseBank(shape, key=KEY),
    }.items():
        proposal = GaussianProposal(problem["noise_std"], noise=noise)
        took = timed_step(build(problem, proposal=proposal), problem["start"])
        drawn = timed(lambda source, key: source.draw(shape, key=key), noise, KEY)
        rows.append(
            {"": name, "ms": took.p50_ms, "p99_ms": took.p99_ms, "draw_alone_ms": drawn.p50_ms}
        )
    return rows


def _weighting() -> list[dict[str, Any]]:
    """A command with each way of weighing."""
    problem, rows = quadrotor_problem(), []
    adapting = GaussianProposal(problem["noise_std"], adaptation=CovarianceAdaptation())
    variants: dict[str, dict[str, Any]] = {
        "softmax": {},
        "softmax at an effective sample size": {"weighting": AdaptiveSoftmax(100.0)},
        "elite": {"weighting": Elite()},
        "elite and adapting covariance (CEM)": {"weighting": Elite(), "proposal": adapting},
    }
    for name, changes in variants.items():
        took = timed_step(build(problem, **changes), problem["start"])
        rows.append({"": name, "ms": took.p50_ms, "p99_ms": took.p99_ms})
    return rows


def _feedback() -> list[dict[str, Any]]:
    """Plans with gains, and the commands between plans."""
    problem = quadrotor_problem()
    planner, start = build(problem), problem["start"]
    commands = 1000
    controller = FeedbackMPPI(planner, commands_per_plan=1_000_000)
    _, planned, _ = eqx.filter_jit(step)(controller, controller.init(), start, KEY)

    def in_between(controller: FeedbackMPPI, state: Any, start: Array) -> Any:
        def advance(carry: Any, _: None) -> tuple[Any, Array]:
            state, observation = carry
            control, state, _info = controller.step(state, observation, key=KEY)
            return (state, observation + 1e-5), control

        return jax.lax.scan(advance, (state, start), None, length=commands)

    gains = timed(
        lambda c, s, x, k: step_with_gains(c, s, x, key=k), planner, planner.init(), start, KEY
    )
    rows = {
        "plan": (timed_step(planner, start), 1),
        "plan with gains": (gains, 1),
        "command in between, called from Python": (
            timed(step, controller, planned, start, KEY, runs=1000),
            1,
        ),
        "command in between, in a compiled loop": (
            timed(in_between, controller, planned, start, runs=50),
            commands,
        ),
    }
    return [
        {
            "": name,
            "us": 1e3 * took.p50_ms / count,
            "p99_us": 1e3 * took.p99_ms / count,
            "hertz": 1e3 * count / took.p50_ms,
        }
        for name, (took, count) in rows.items()
    ]


def _devices() -> list[dict[str, Any]]:
    """Samples spread over two CPU devices, in a process that has them, and in one as it comes."""
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.control"],
        cwd=Path(__file__).parents[1],
        env={**os.environ, "XLA_FLAGS": flags},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    rows: list[dict[str, Any]] = json.loads(done.stdout.splitlines()[-1])
    for row in rows:
        problem = quadrotor_problem(row.pop("samples"))
        took = timed_step(build(problem), problem["start"], runs=50)
        row["process_of_one_device_ms"] = took.p50_ms
    return rows


def _over_devices() -> list[dict[str, Any]]:
    rows = []
    mesh = Mesh(np.asarray(jax.devices()), ("samples",))
    for samples in (1024, 4096, 16384):
        problem = quadrotor_problem(samples)
        start = problem["start"]
        one, spread = build(problem), build(problem, mesh=mesh)
        taken: dict[str, list[float]] = {"one": [], "all": []}
        for _ in range(3):
            taken["one"].append(timed_step(one, start, runs=30).p50_ms)
            taken["all"].append(timed_step(spread, start, runs=30).p50_ms)
        alone, together = (float(np.median(times)) for times in taken.values())
        controls = [eqx.filter_jit(step)(c, c.init(), start, KEY)[0] for c in (one, spread)]
        rows.append(
            {
                "": f"K = {samples}, T = 40, {mesh.size} devices",
                "samples": samples,
                "one_device_ms": alone,
                "all_devices_ms": together,
                "times_faster": alone / together,
                "controls_differ_by": float(jnp.abs(controls[0] - controls[1]).max()),
            }
        )
    return rows


def _endurance(steps: int) -> list[dict[str, Any]]:
    """A closed loop in chunks inside compiled loops: memory must not grow, nor traces."""
    chunk = min(10_000, steps)
    chunks, traces = math.ceil(steps / chunk), 0
    model = PointMass(2)
    controller = MPPI(
        model,
        ToGoal(jnp.asarray([1.0, -2.0])),
        horizon=10,
        num_samples=64,
        dt=0.1,
        noise_std=[0.5, 0.5],
    )

    @eqx.filter_jit
    def run(controller: MPPI, carry: Any) -> Any:
        nonlocal traces
        traces += 1

        def advance(_: int, carry: Any) -> Any:
            observation, state, key = carry
            key, step_key = jax.random.split(key)
            control, state, _info = controller.step(state, observation, key=step_key)
            return controller.dynamics.step(observation, control, controller.dt), state, key

        return jax.lax.fori_loop(0, chunk, advance, carry)

    carry = run(controller, (jnp.zeros(model.state_size), controller.init(), jax.random.key(1)))
    carry[0].block_until_ready()
    before, began = _resident_mb(), time.perf_counter()
    for _ in range(chunks):
        carry = run(controller, carry)
        carry[0].block_until_ready()
    seconds, after = time.perf_counter() - began, _resident_mb()
    return [
        {
            "": f"{chunks * chunk} steps, K = 64, T = 10, point mass",
            "s": seconds,
            "steps_per_s": chunks * chunk / seconds,
            "us_per_step": 1e6 * seconds / (chunks * chunk),
            "traces": traces,
            "memory_before_mb": before,
            "memory_after_mb": after,
            "distance_from_goal": math.hypot(float(carry[0][0]) - 1.0, float(carry[0][1]) + 2.0),
        }
    ]


def _resident_mb() -> float:
    """Return the resident memory of this process, as Linux counts it [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    print(json.dumps(_over_devices()))
