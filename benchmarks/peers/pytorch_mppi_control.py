"""Times of a command of pytorch_mppi, in the environment that `make bench` sets up.

    python pytorch_mppi_control.py PROBLEM.npz VARIANT

PROBLEM holds sizes, states and arrays: a quadrotor, or with a cost map a differential drive.
VARIANT is plain, smooth or kernel. The result is JSON on stdout: times of a command on two threads,
as the library comes and with its `compile()`, and what the given controls cost, to check that
everybody solves the same problem.
"""

import importlib
import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

# Not installed where the benchmarks are checked.
torch: Any = importlib.import_module("torch")
peer: Any = importlib.import_module("pytorch_mppi.mppi")

MASS, GRAVITY, RATE_TIME_CONSTANT = 1.0, 9.81, 0.05
MAX_SPEED, MAX_TURN_RATE, DRAG = 2.0, 2.0, 0.1
Model = Callable[[Any, Any], Any]


def main() -> None:
    """Time the variant on the problem given."""
    with np.load(sys.argv[1], allow_pickle=False) as file:
        problem = {name: torch.as_tensor(file[name]) for name in file.files}
    variant = sys.argv[2]
    model, cost = _drive(problem) if "cost_map" in problem else _quadrotor(problem)
    state, runs = problem["start"], int(problem["runs"])
    result: dict[str, Any] = _timed(_controller(variant, problem, model, cost), state, runs)
    compiled = _controller(variant, problem, model, cost)
    compiled.compile()
    try:
        result["compiled"] = _timed(compiled, state, runs)
    except Exception as error:  # There is no C++ compiler, for instance.
        print(f"pytorch_mppi does not compile: {error}", file=sys.stderr)
        result["compiled"] = None
    result["probe_cost"] = _probe(problem, model, cost)
    print(json.dumps(result))


def _controller(variant: str, problem: dict[str, Any], model: Model, cost: Model) -> Any:
    std, dt = problem["noise_std"], float(problem["dt"])
    low, high = problem["control_min"], problem["control_max"]
    shared = {
        "num_samples": int(problem["num_samples"]),
        "horizon": int(problem["horizon"]),
        "lambda_": float(problem["temperature"]),
        "U_init": problem["default_control"].repeat(int(problem["horizon"]), 1),
    }
    sizes = (model, cost, len(problem["start"]))
    if variant == "smooth":
        return peer.SMPPI(
            *sizes,
            torch.diag((std / dt) ** 2),
            delta_t=dt,
            w_action_seq_cost=float(problem["smoothness_weight"]),
            action_min=low,
            action_max=high,
            **shared,
        )
    shared.update(u_min=low, u_max=high, u_init=problem["default_control"])
    if variant == "kernel":
        kernel = peer.RBFKernel(float(problem["length_scale"]))
        knots = int(problem["num_knots"])
        return peer.KMPPI(
            *sizes, torch.diag(std**2), num_support_pts=knots, kernel=kernel, **shared
        )
    return peer.MPPI(*sizes, torch.diag(std**2), **shared)


def _timed(controller: Any, state: Any, runs: int) -> dict[str, float]:
    began = time.perf_counter()
    controller.command(state)
    first = time.perf_counter() - began
    for _ in range(3):
        controller.command(state)
    seconds: list[float] = []
    while len(seconds) < runs and (len(seconds) < 20 or sum(seconds) < 10.0):
        began = time.perf_counter()
        controller.command(state)
        seconds.append(time.perf_counter() - began)
    p50, p99 = 1e3 * np.percentile(seconds, [50, 99])
    return {"compile_seconds": first, "p50_ms": float(p50), "p99_ms": float(p99)}


def _probe(problem: dict[str, Any], model: Model, cost: Model) -> float:
    state, total = problem["start"][None], 0.0
    for control in problem["probe"]:
        state = model(state, control[None])
        total += float(cost(state, control[None]))
    return total


def _quadrotor(problem: dict[str, Any]) -> tuple[Model, Model]:
    dt, goal = float(problem["dt"]), problem["goal"]
    weight = torch.tensor([0.0, 0.0, GRAVITY])

    def derivative(state: Any, control: Any) -> Any:
        velocity, rates = state[:, 3:6], state[:, 10:13]
        qw, qx, qy, qz = state[:, 6:10].unbind(-1)
        wx, wy, wz = rates.unbind(-1)
        down = torch.stack(
            [
                2.0 * (qx * qz + qw * qy),
                2.0 * (qy * qz - qw * qx),
                1.0 - 2.0 * (qx * qx + qy * qy),
            ],
            dim=-1,
        )
        turn = torch.stack(
            [
                -qx * wx - qy * wy - qz * wz,
                qw * wx + qy * wz - qz * wy,
                qw * wy + qz * wx - qx * wz,
                qw * wz + qx * wy - qy * wx,
            ],
            dim=-1,
        )
        push = weight - (control[:, :1] / MASS) * down
        lag = (control[:, 1:] - rates) / RATE_TIME_CONSTANT
        return torch.cat([velocity, push, 0.5 * turn, lag], dim=-1)

    def model(state: Any, control: Any) -> Any:
        state = _rk4(derivative, state, control, dt)
        quaternion = state[:, 6:10]
        quaternion = quaternion / torch.linalg.vector_norm(quaternion, dim=-1, keepdim=True)
        return torch.cat([state[:, :6], quaternion, state[:, 10:]], dim=-1)

    def cost(state: Any, control: Any) -> Any:
        return ((state[:, :3] - goal) ** 2).sum(-1) + 0.01 * (control**2).sum(-1)

    return model, cost


def _drive(problem: dict[str, Any]) -> tuple[Model, Model]:
    dt, goal, origin = float(problem["dt"]), problem["goal"], problem["origin"]
    image = problem["cost_map"][None, None]
    rows, columns = image.shape[-2:]
    extent = float(problem["resolution"]) * torch.tensor([columns, rows])

    def derivative(state: Any, control: Any) -> Any:
        _, _, yaw, v, omega = state.unbind(-1)
        return torch.stack(
            [
                v * torch.cos(yaw),
                v * torch.sin(yaw),
                omega,
                control[:, 0] - DRAG * v,
                control[:, 1] - DRAG * omega,
            ],
            dim=-1,
        )

    def model(state: Any, control: Any) -> Any:
        x, y, yaw, v, omega = _rk4(derivative, state, control, dt).unbind(-1)
        v = torch.clamp(v, 0.0, MAX_SPEED)
        return torch.stack([x, y, yaw, v, torch.clamp(omega, -MAX_TURN_RATE, MAX_TURN_RATE)], -1)

    def cost(state: Any, control: Any) -> Any:
        position = state[:, :2]
        at = (2.0 * (position - origin) / extent - 1.0)[None, None]
        paid = torch.nn.functional.grid_sample(
            image, at, padding_mode="border", align_corners=False
        )
        return paid[0, 0, 0] + torch.linalg.vector_norm(position - goal, dim=-1)

    return model, cost


def _rk4(derivative: Model, state: Any, control: Any, dt: float) -> Any:
    first = derivative(state, control)
    second = derivative(state + 0.5 * dt * first, control)
    third = derivative(state + 0.5 * dt * second, control)
    fourth = derivative(state + dt * third, control)
    return state + (dt / 6.0) * (first + 2.0 * second + 2.0 * third + fourth)


if __name__ == "__main__":
    main()
