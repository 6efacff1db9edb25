"""The controller: against its peers, how it grows, its parts, two devices, a million steps."""

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float

from benchmarks.timing import Timed, timed
from jaxplore import (
    MPPI,
    RK4,
    AdaptiveSoftmax,
    AntitheticNoise,
    ColouredNoise,
    Controller,
    ControlRateCost,
    Cost,
    CovarianceAdaptation,
    DifferentialDrive,
    Dynamics,
    Elite,
    FeedbackMPPI,
    GaussianProposal,
    Knots,
    NoiseBank,
    PointMass,
    Quadrotor,
    RBFKernel,
    Smooth,
    SobolNoise,
    Softmax,
    State,
    WhiteNoise,
    clearance_field,
    office,
    start_pose,
)
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame

PEERS = Path(__file__).parent / ".peers"
TORCH_PEER = PEERS / "torch"
KEY = jax.random.key(0)
Problem = dict[str, Any]


def measure(endurance_steps: int = 1_000_000) -> dict[str, Any]:
    """Return tables of times.

    Args:
        endurance_steps: control steps of the run that memory is watched over.
    """
    return {
        "peers": _peers(),
        "growth": _growth(),
        "fleet": _fleet(),
        "noise": _noise(),
        "weighting": _weighting(),
        "feedback": _feedback(),
        "devices": _devices(),
        "endurance": _endurance(endurance_steps),
    }


class ToGoal(Cost):
    """Squared distance from a goal plus effort, in plain sums.

    `jnp.sum` over a handful of numbers is a reduction, which XLA's CPU back end does slowly.
    """

    goal: Float[Array, " n"]

    def stage(self, state: State, control: Array, t: Array, belief: Any) -> Array:
        """Return it."""
        total = 0.01 * sum((u * u for u in control), jnp.zeros(()))
        for name, wanted in zip("xyz", self.goal, strict=False):
            total = total + (state[name] - wanted) ** 2
        return total


class OnMap(Cost):
    """What a map says of the position, plus the distance from a goal."""

    field: ScalarField
    goal: Float[Array, "2"]

    def stage(self, state: State, control: Array, t: Array, belief: Any) -> Array:
        """Return it."""
        position = state.position
        x, y = position[0] - self.goal[0], position[1] - self.goal[1]
        return self.field(position) + jnp.sqrt(x * x + y * y)


def _quadrotor_problem(num_samples: int = 1000, horizon: int = 40) -> Problem:
    model = Quadrotor()
    probe = np.tile([10.0, 0.3, -0.2, 0.1], (horizon, 1))
    return {
        "start": model.at_pose(0.0, 0.0, 0.0),
        "goal": [5.0, 5.0, -2.0],
        "noise_std": [2.0, 0.5, 0.5, 0.5],
        "probe": probe,
        "dt": 0.05,
        **_shared(model, num_samples, horizon),
    }


def _map_problem(num_samples: int) -> Problem:
    """A robot among the walls and the furniture of an office, 20 x 20 m in cells of 5 cm."""
    world = office(seed=5, width=20.0, height=20.0, resolution=0.05)
    clearance = clearance_field(~world.is_free, world.frame, 1.0)
    model, horizon = DifferentialDrive(), 100
    return {
        "start": model.at_pose(*start_pose(world)),
        "goal": [15.0, 12.0],
        "noise_std": [0.5, 1.0],
        "probe": np.tile([0.8, -0.2], (horizon, 1)),
        "dt": 0.02,
        "cost_map": 10.0 * jnp.exp(-clearance.values / 0.2),
        "resolution": world.resolution,
        "origin": world.frame.origin[:2],
        **_shared(model, num_samples, horizon),
    }


def _shared(model: Dynamics, num_samples: int, horizon: int) -> Problem:
    return {
        "control_min": model.control_min,
        "control_max": model.control_max,
        "default_control": model.default_control,
        "num_samples": num_samples,
        "horizon": horizon,
        "temperature": 1.0,
        "smoothness_weight": 1.0,
        "num_knots": 10,
        "length_scale": 4.0,
    }


def _controller(problem: Problem, variant: str = "plain", **changes: Any) -> MPPI:
    model: Dynamics = Quadrotor()
    goal = jnp.asarray(problem["goal"])
    cost: Cost = ToGoal(goal)
    if "cost_map" in problem:
        model = DifferentialDrive(integrator=RK4())
        frame = GridFrame(problem["resolution"], (*map(float, problem["origin"]), 0.0))
        field = ScalarField(problem["cost_map"], frame, jnp.max(problem["cost_map"]))
        cost = OnMap(field, goal)
    std = np.asarray(problem["noise_std"])
    parts: dict[str, Any] = {}
    if variant == "smooth":
        # Rates whose effect in one command is that of the plain variant's noise.
        std = std / problem["dt"]
        rate = ControlRateCost(np.ones(std.shape), include_applied=False)
        cost = cost + problem["smoothness_weight"] * rate
        parts["parameterisation"] = Smooth()
    if variant == "kernel":
        kernel = RBFKernel(problem["length_scale"])
        parts["parameterisation"] = Knots(problem["num_knots"], kernel)
    parts |= {"weighting": Softmax(problem["temperature"]), "proposal": GaussianProposal(std)}
    parts |= {name: problem[name] for name in ("dt", "num_samples", "horizon")}
    return MPPI(model, cost, **{**parts, **changes})


def _step(controller: Controller, state: Any, observation: Array, key: Array) -> Any:
    return controller.step(state, observation, key=key)


def _timed_step(controller: MPPI, start: Array, runs: int = 200) -> Timed:
    return timed(_step, controller, controller.init(), start, KEY, runs=runs)


def _peers() -> list[dict[str, Any]]:
    """Commands of ours and of the peers, turn by turn.

    All drive the same models; jax_mppi's differential drive also goes backwards and wraps its
    heading.
    """
    quadrotor = _quadrotor_problem()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, problem, variant in (
            ("quadrotor, plain", quadrotor, "plain"),
            ("quadrotor, smooth", quadrotor, "smooth"),
            ("quadrotor, 10 knots and a kernel", quadrotor, "kernel"),
            ("differential drive on a map", _map_problem(1024), "plain"),
            ("differential drive on a map", _map_problem(2048), "plain"),
        ):
            file = Path(folder) / "problem.npz"
            _save(file, problem)
            controller = _controller(problem, variant)
            ours = [_timed_step(controller, problem["start"])]
            theirs: list[dict[str, Any]] = []
            paid = _probe(controller, problem)
            for peer, command in _commands(file, variant).items():
                result = _run_peer(peer, command, folder)
                ours.append(_timed_step(controller, problem["start"]))
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


def _run_peer(name: str, command: list[str], folder: str) -> dict[str, Any] | None:
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
    state, cost = jnp.asarray(problem["start"]), _controller(problem).cost
    step = eqx.filter_jit(model.step)
    for control in jnp.asarray(problem["probe"], jnp.float32):
        state = step(state, control, controller.dt)
        total += float(cost.stage(State(state, model), control, jnp.zeros(()), None))
    return total


def _growth() -> list[dict[str, Any]]:
    """A command of a quadrotor with more samples and with longer horizons."""
    rows = []
    sizes = [(samples, 40) for samples in (256, 1024, 4096, 16384)]
    for samples, horizon in [*sizes, *((1024, horizon) for horizon in (10, 20, 40, 80, 160))]:
        problem = _quadrotor_problem(samples, horizon)
        took = _timed_step(_controller(problem), problem["start"], runs=100)
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
    problem = _quadrotor_problem()
    controller, rows = _controller(problem), []
    samples, horizon = controller.num_samples, controller.horizon

    def one_by_one(controller: MPPI, *arguments: Any) -> Any:
        return jax.lax.map(lambda one: _step(controller, *one), arguments)

    for count in (1, 2, 4, 8, 16):
        states = jax.vmap(lambda _: controller.init())(jnp.arange(count))
        starts = problem["start"] + 0.1 * jnp.arange(count, dtype=jnp.float32)[:, None]
        arguments = (controller, states, starts, jax.random.split(KEY, count))
        together = jax.vmap(_step, in_axes=(None, 0, 0, 0))
        for name, function in (("vmap", together), ("lax.map", one_by_one)):
            took = timed(function, *arguments, runs=50)
            title = f"{count} controllers by {name}, K = {samples}, T = {horizon}"
            rows.append(_growth_row(title, took, count * samples, horizon))
    return rows


def _noise() -> list[dict[str, Any]]:
    """A command with noise from each source; K is a power of two, as Sobol points want it."""
    problem = _quadrotor_problem(1024)
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
        took = _timed_step(_controller(problem, proposal=proposal), problem["start"])
        drawn = timed(lambda source, key: source.draw(shape, key=key), noise, KEY)
        rows.append(
            {"": name, "ms": took.p50_ms, "p99_ms": took.p99_ms, "draw_alone_ms": drawn.p50_ms}
        )
    return rows


def _weighting() -> list[dict[str, Any]]:
    """A command with each way of weighing."""
    problem, rows = _quadrotor_problem(), []
    adapting = GaussianProposal(problem["noise_std"], adaptation=CovarianceAdaptation())
    variants: dict[str, dict[str, Any]] = {
        "softmax": {},
        "softmax at an effective sample size": {"weighting": AdaptiveSoftmax(100.0)},
        "elite": {"weighting": Elite()},
        "elite and adapting covariance (CEM)": {"weighting": Elite(), "proposal": adapting},
    }
    for name, changes in variants.items():
        took = _timed_step(_controller(problem, **changes), problem["start"])
        rows.append({"": name, "ms": took.p50_ms, "p99_ms": took.p99_ms})
    return rows


def _feedback() -> list[dict[str, Any]]:
    """Plans with gains, and the commands between plans."""
    problem = _quadrotor_problem()
    planner, start = _controller(problem), problem["start"]
    commands = 1000
    controller = FeedbackMPPI(planner, commands_per_plan=1_000_000)
    _, planned, _ = eqx.filter_jit(_step)(controller, controller.init(), start, KEY)

    def in_between(controller: FeedbackMPPI, state: Any, start: Array) -> Any:
        def advance(carry: Any, _: None) -> tuple[Any, Array]:
            state, observation = carry
            control, state, _info = controller.step(state, observation, key=KEY)
            return (state, observation + 1e-5), control

        return jax.lax.scan(advance, (state, start), None, length=commands)

    gains = timed(
        lambda c, s, x, k: c.step_with_gains(s, x, key=k), planner, planner.init(), start, KEY
    )
    rows = {
        "plan": (_timed_step(planner, start), 1),
        "plan with gains": (gains, 1),
        "command in between, called from Python": (
            timed(_step, controller, planned, start, KEY, runs=1000),
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
        problem = _quadrotor_problem(row.pop("samples"))
        took = _timed_step(_controller(problem), problem["start"], runs=50)
        row["process_of_one_device_ms"] = took.p50_ms
    return rows


def _over_devices() -> list[dict[str, Any]]:
    rows = []
    mesh = Mesh(np.asarray(jax.devices()), ("samples",))
    for samples in (1024, 4096, 16384):
        problem = _quadrotor_problem(samples)
        start = problem["start"]
        one, spread = _controller(problem), _controller(problem, mesh=mesh)
        taken: dict[str, list[float]] = {"one": [], "all": []}
        for _ in range(3):
            taken["one"].append(_timed_step(one, start, runs=30).p50_ms)
            taken["all"].append(_timed_step(spread, start, runs=30).p50_ms)
        alone, together = (float(np.median(times)) for times in taken.values())
        controls = [eqx.filter_jit(_step)(c, c.init(), start, KEY)[0] for c in (one, spread)]
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
