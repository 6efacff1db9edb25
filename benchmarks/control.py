"""The controller: against its peers, how it grows, its parts, two devices, a long run."""

import math
import os
import time
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array

from benchmarks import control_peers
from benchmarks.control_problems import (
    KEY,
    Problem,
    ToGoal,
    build,
    map_problem,
    quadrotor_problem,
    step,
    timed_step,
)
from benchmarks.tables import Rows
from benchmarks.timing import Timed, measure_cases, percentiles, timed
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


class Sizes(NamedTuple):
    """Samples, horizons and runs of the tables; the integrator of the models, of which Euler's has
    a fourth of the operations; and how many variants a table has, at most."""

    samples: int = 1000
    horizon: int = 40
    power_of_two: int = 1024
    map_samples: tuple[int, ...] = (1024, 2048)
    map_horizon: int = 100
    cell: float = 0.05
    grown_samples: tuple[int, ...] = (256, 1024, 4096, 16384)
    grown_horizons: tuple[int, ...] = (10, 20, 40, 80, 160)
    fleets: tuple[int, ...] = (1, 2, 4, 8, 16)
    commands: int = 1000
    device_samples: tuple[int, ...] = (1024, 4096, 16384)
    runs: int = 200
    variants: tuple[str, ...] = ("plain", "smooth", "kernel")
    endurance_steps: int = 100_000
    is_euler: bool = False
    most: int | None = None


FULL = Sizes()
SMOKE = Sizes(
    samples=8,
    horizon=4,
    power_of_two=8,
    map_samples=(8,),
    map_horizon=4,
    cell=0.2,
    grown_samples=(8,),
    grown_horizons=(4,),
    fleets=(2,),
    commands=3,
    device_samples=(8,),
    runs=4,
    variants=("plain",),
    endurance_steps=20,
    is_euler=True,
    most=2,
)
TITLES = {
    "peers": "A command, and its peers'",
    "on_a_map": "A differential drive on a map of costs",
    "growth": "Growth",
    "fleet": "Several controllers in one call",
    "noise": "Sources of noise",
    "weighting": "Weightings",
    "feedback": "Feedback",
    "devices": "Two CPU devices",
    "endurance": "Endurance",
}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the tables."""
    map_sizes = sizes.map_horizon, sizes.cell, sizes.is_euler
    on_maps = [map_problem(k, *map_sizes) for k in sizes.map_samples]
    quadrotor = quadrotor_problem(sizes.samples, sizes.horizon, sizes.is_euler)
    return {
        "peers": control_peers.measure(quadrotor, on_maps, sizes.variants, sizes.runs),
        "on_a_map": _on_a_map(on_maps, sizes),
        "growth": _growth(sizes),
        "fleet": _fleet(quadrotor, sizes),
        "noise": _noise(sizes),
        "weighting": _weighting(quadrotor, sizes),
        "feedback": _feedback(quadrotor, sizes),
        "devices": _devices(sizes),
        "endurance": _endurance(sizes.endurance_steps),
    }


def _on_a_map(problems: list[Problem], sizes: Sizes) -> Rows:
    """A differential drive on a cost map, with both integrators and two noises.

    For nav2 (C++, Euler steps) the paper on MPPI-Generic (arXiv 2409.07563) gives 3.4 and 6.7 ms,
    on its own problem and machine.
    """
    rows = []
    for problem in problems:
        variants: dict[str, dict[str, Any]] = {
            "Euler": {"integrator": Euler()},
            "Euler, Sobol noise": {
                "integrator": Euler(),
                "proposal": GaussianProposal(problem["noise_std"], noise=SobolNoise()),
            },
            "RK4": {"integrator": RK4()},
        }
        for name, changes in islice(variants.items(), sizes.most):
            took = timed_step(build(problem, **changes), problem["start"], sizes.runs)
            samples, horizon = problem["num_samples"], problem["horizon"]
            rows.append(
                _growth_row(f"K = {samples}, T = {horizon}, {name}", took, samples, horizon)
            )
    return rows


def _growth(sizes: Sizes) -> Rows:
    """A command of a quadrotor with more samples and with longer horizons."""
    rows = []
    with_more = [(samples, sizes.horizon) for samples in sizes.grown_samples]
    longer = [(sizes.power_of_two, horizon) for horizon in sizes.grown_horizons]
    for samples, horizon in with_more + longer:
        problem = quadrotor_problem(samples, horizon, sizes.is_euler)
        took = timed_step(build(problem), problem["start"], sizes.runs // 2)
        rows.append(_growth_row(f"K = {samples}, T = {horizon}", took, samples, horizon))
    return rows


def _growth_row(name: str, took: Timed, rollouts: int, horizon: int) -> dict[str, Any]:
    return {
        "": name,
        **took.row(),
        "thousand_rollouts_per_s": rollouts / took.p50_ms,
        "ns_per_step_of_a_rollout": 1e6 * took.p50_ms / (rollouts * horizon),
    }


def _fleet(problem: Problem, sizes: Sizes) -> Rows:
    """Commands of several controllers in one compiled call: all at once, and one after another."""
    controller, rows = build(problem), []
    samples, horizon = controller.num_samples, controller.horizon

    def one_by_one(controller: MPPI, *arguments: Any) -> Any:
        return jax.lax.map(lambda one: step(controller, *one), arguments)

    for count in sizes.fleets:
        states = jax.vmap(lambda _: controller.init())(jnp.arange(count))
        starts = problem["start"] + 0.1 * jnp.arange(count, dtype=jnp.float32)[:, None]
        arguments = (controller, states, starts, jax.random.split(KEY, count))
        together = jax.vmap(step, in_axes=(None, 0, 0, 0))
        for name, function in (("vmap", together), ("lax.map", one_by_one)):
            took = timed(function, *arguments, runs=sizes.runs // 4)
            title = f"{count} controllers by {name}, K = {samples}, T = {horizon}"
            rows.append(_growth_row(title, took, count * samples, horizon))
    return rows


def _noise(sizes: Sizes) -> Rows:
    """A command with noise from each source; K is a power of two, as Sobol points want it."""
    problem = quadrotor_problem(sizes.power_of_two, sizes.horizon, sizes.is_euler)
    shape = (problem["horizon"], len(problem["noise_std"]), problem["num_samples"])
    variants = {
        "white": WhiteNoise(),
        "antithetic": AntitheticNoise(),
        "coloured, exponent 1": ColouredNoise(1.0),
        "Sobol": SobolNoise(),
        "bank": NoiseBank(key=KEY),
    }
    rows = []
    for name, noise in islice(variants.items(), sizes.most):
        proposal = GaussianProposal(problem["noise_std"], noise=noise)
        took = timed_step(build(problem, proposal=proposal), problem["start"], sizes.runs)
        drawn = timed(lambda source, key: source.draw(shape, key=key), noise, KEY, runs=sizes.runs)
        rows.append({"": name, **took.row(), "draw_alone_ms": drawn.p50_ms})
    return rows


def _weighting(problem: Problem, sizes: Sizes) -> Rows:
    """A command with each way of weighing."""
    rows = []
    adapting = GaussianProposal(problem["noise_std"], adaptation=CovarianceAdaptation())
    variants: dict[str, dict[str, Any]] = {
        "softmax": {},
        "softmax at an effective sample size": {
            "weighting": AdaptiveSoftmax(max(1.0, sizes.samples / 10))
        },
        "elite": {"weighting": Elite()},
        "elite and adapting covariance (CEM)": {"weighting": Elite(), "proposal": adapting},
    }
    for name, changes in islice(variants.items(), sizes.most):
        took = timed_step(build(problem, **changes), problem["start"], sizes.runs)
        rows.append({"": name, **took.row()})
    return rows


def _feedback(problem: Problem, sizes: Sizes) -> Rows:
    """Plans with gains, and the commands between plans."""
    planner, start = build(problem), problem["start"]
    commands = sizes.commands
    controller = FeedbackMPPI(planner, commands_per_plan=1_000_000)
    _, planned, _ = eqx.filter_jit(step)(controller, controller.init(), start, KEY)

    def in_between(controller: FeedbackMPPI, state: Any, start: Array) -> Any:
        def advance(carry: Any, _: None) -> tuple[Any, Array]:
            state, observation = carry
            control, state, _info = controller.step(state, observation, key=KEY)
            return (state, observation + 1e-5), control

        return jax.lax.scan(advance, (state, start), None, length=commands)

    gains = timed(
        lambda c, s, x, k: step_with_gains(c, s, x, key=k),
        *(planner, planner.init(), start, KEY),
        runs=sizes.runs,
    )
    rows = {
        "plan": (timed_step(planner, start, sizes.runs), 1),
        "plan with gains": (gains, 1),
        "command in between, called from Python": (
            timed(step, controller, planned, start, KEY, runs=commands),
            1,
        ),
        "command in between, in a compiled loop": (
            timed(in_between, controller, planned, start, runs=sizes.runs // 4),
            commands,
        ),
    }
    return [
        {
            "": name,
            "commands": count,
            **took.row(),
            "hertz": 1e3 * count / took.p50_ms,
        }
        for name, (took, count) in rows.items()
    ]


def _devices(sizes: Sizes) -> Rows:
    """Samples spread over two CPU devices, in a process that has them, and in one as it comes."""
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"
    horizon, is_euler, runs = sizes.horizon, sizes.is_euler, sizes.runs // 4
    cases = [(samples, horizon, is_euler, runs) for samples in sizes.device_samples]
    rows = measure_cases(_over_devices, cases, environment={"XLA_FLAGS": flags})
    for row, samples in zip(rows, sizes.device_samples, strict=True):
        problem = quadrotor_problem(samples, horizon, is_euler)
        took = timed_step(build(problem), problem["start"], runs)
        row["process_of_one_device_ms"] = took.p50_ms
    return rows


def _over_devices(samples: int, horizon: int, is_euler: bool, runs: int) -> dict[str, Any]:
    mesh = Mesh(np.asarray(jax.devices()), ("samples",))
    problem = quadrotor_problem(samples, horizon, is_euler)
    start = problem["start"]
    one, spread = build(problem), build(problem, mesh=mesh)
    taken: dict[str, list[float]] = {"one": [], "all": []}
    for _ in range(3):
        taken["one"].append(timed_step(one, start, runs).p50_ms)
        taken["all"].append(timed_step(spread, start, runs).p50_ms)
    alone, together = (float(np.median(times)) for times in taken.values())
    controls = [eqx.filter_jit(step)(c, c.init(), start, KEY)[0] for c in (one, spread)]
    return {
        "": f"K = {samples}, T = {horizon}, {mesh.size} devices",
        "one_device_ms": alone,
        "all_devices_ms": together,
        "times_faster": alone / together,
        "controls_differ_by": float(jnp.abs(controls[0] - controls[1]).max()),
        "repeats": taken["all"],
    }


def _endurance(steps: int) -> Rows:
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
    before, each = _resident_mb(), []
    for _ in range(chunks):
        began = time.perf_counter()
        carry = run(controller, carry)
        carry[0].block_until_ready()
        each.append(time.perf_counter() - began)
    seconds, after = sum(each), _resident_mb()
    return [
        {
            "": f"{chunks * chunk} steps, K = 64, T = 10, point mass",
            "s": seconds,
            "steps_per_s": chunks * chunk / seconds,
            "us_per_step": 1e6 * seconds / (chunks * chunk),
            "traces": traces,
            "memory_before_mb": before,
            "memory_after_mb": after,
            "repeats": percentiles(each)["repeats"],
            "distance_from_goal": math.hypot(float(carry[0][0]) - 1.0, float(carry[0][1]) + 2.0),
        }
    ]


def _resident_mb() -> float:
    """Return the resident memory of this process, as Linux counts it [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
