"""Contouring control with Faran, in the environment that `make bench` sets up.

    python faran_mpcc.py BACKEND PROBLEM.json

BACKEND is numpy or jax. PROBLEM holds what `benchmarks/path_following.py` writes. The result is
JSON on stdout: times of `planner.step` in its closed loop, and for each seed where every step led.
The errors are those of the objects that Faran's factory returns, as its README has them: in metres,
as the waypoints are, whatever length its path parameter is rescaled to.
"""

import importlib
import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

Problem = dict[str, Any]
WARM_UP = 20


def main() -> None:
    """Time the step, and follow the path once for each seed."""
    backend = importlib.import_module(f"faran.{sys.argv[1]}")
    problem: Problem = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))
    times = _times(backend, problem)
    runs = [_follow(backend, problem, seed) for seed in range(problem["seeds"])]
    print(json.dumps({**times, "runs": runs}))


def _times(backend: Any, problem: Problem) -> dict[str, float]:
    """Time steps along the path, which begins anew when a run is over."""
    seconds: list[float] = []
    seed = 0
    while len(seconds) < WARM_UP + problem["timed_steps"]:
        seconds += [spent for _, spent in _steps(backend, problem, seed)[1]]
        seed += 1
    p50, p99 = 1e3 * np.percentile(seconds[WARM_UP:], [50, 99])
    return {"compile_seconds": seconds[0], "p50_ms": float(p50), "p99_ms": float(p99)}


def _follow(backend: Any, problem: Problem, seed: int) -> dict[str, Any]:
    """Return positions, the way along the path as a share of it, and errors, after each step."""
    types = backend.types
    setup, steps = _steps(backend, problem, seed)
    sequence = types.augmented.state_sequence.of_states(
        physical=types.bicycle.state_sequence.of_states,
        virtual=types.simple.state_sequence.of_states,
    )([state for state, _ in steps])
    states = sequence.batched()
    rows = np.asarray(sequence)
    return {
        "positions": rows[:, :2].tolist(),
        "share": (rows[:, -1] / problem["path_length"]).tolist(),
        "contouring": np.asarray(setup.contouring_cost.error(states=states))[:, 0].tolist(),
        "lag": np.asarray(setup.lag_cost.error(states=states))[:, 0].tolist(),
    }


def _steps(backend: Any, problem: Problem, seed: int) -> tuple[Any, Iterator[tuple[Any, float]]]:
    """Return Faran's planner and all with it, and of each step the state and the time it took."""
    setup = _setup(backend, problem, seed)
    return setup, _drive(backend, problem, setup)


def _drive(backend: Any, problem: Problem, setup: Any) -> Iterator[tuple[Any, float]]:
    types, horizon = backend.types, problem["horizon"]
    state = types.augmented.state.of(
        physical=types.bicycle.state.create(x=0.0, y=0.0, heading=0.0, speed=0.0),
        virtual=types.simple.state.zeroes(dimension=1),
    )
    nominal = types.augmented.control_input_sequence.of(
        physical=types.bicycle.control_input_sequence.zeroes(horizon=horizon),
        virtual=types.simple.control_input_sequence.zeroes(horizon=horizon, dimension=1),
    )
    for _ in range(problem["steps"]):
        _wait(state, nominal)
        began = time.perf_counter()
        control = setup.mppi.step(
            temperature=problem["temperature"], nominal_input=nominal, initial_state=state
        )
        _wait(control.optimal)
        spent = time.perf_counter() - began
        state, nominal = setup.model.step(inputs=control.optimal, state=state), control.nominal
        yield state, spent


def _wait(*parts: Any) -> None:
    """Wait for the arrays of both halves, which the NumPy backend has at once."""
    for part in parts:
        jax.block_until_ready(  # type: ignore[no-untyped-call]
            (part.physical.array, part.virtual.array)
        )


def _setup(backend: Any, problem: Problem, seed: int) -> Any:
    acceleration, steering = problem["max_acceleration"], problem["max_steering"]
    speeds = (0.0, problem["max_speed"])
    return backend.mppi.mpcc(
        model=backend.model.bicycle.dynamical(
            time_step_size=problem["dt"],
            wheelbase=problem["wheelbase"],
            speed_limits=speeds,
            steering_limits=(-steering, steering),
            acceleration_limits=(-acceleration, acceleration),
        ),
        sampler=backend.sampler.gaussian(
            standard_deviation=problem["noise_std"],
            rollout_count=problem["rollouts"],
            to_batch=backend.types.bicycle.control_input_batch.create,
            seed=seed,
        ),
        reference=backend.trajectory.waypoints(
            points=problem["waypoints"], path_length=problem["path_length"]
        ),
        position_extractor=backend.extract.from_physical(lambda states: states.positions),
        config={
            "weights": {
                "contouring": problem["contouring_weight"],
                "lag": problem["lag_weight"],
                "progress": problem["progress_weight"],
            },
            # With the sampler's own seed, both would draw from the same stream of numbers.
            "virtual": {"velocity_limits": speeds, "sampling_seed": 1000 + seed},
        },
    )


if __name__ == "__main__":
    main()
