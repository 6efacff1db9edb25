"""Record what pytorch_mppi computes, on small problems and for given noise.

    python3.11 -m venv peer
    peer/bin/pip install torch==2.13.0 pytorch_mppi==0.9.1 numpy
    peer/bin/python record_pytorch_mppi.py

writes pytorch_mppi.npz beside this file, which `test_pytorch_mppi.py` reads. Everything is computed
in float64. The noise itself is stored, as float32: NumPy does not promise the same stream of normal
numbers for ever. All settings are stored as well, so that nothing is said twice.

Three things of the peer are replaced:

- the noise;
- smooth MPPI clips rates to its bounds and then goes on with those that it did not clip: here the
  noise that it is given stays within the bounds;
- the cost of the perturbation in kernel MPPI multiplies controls that were shifted row by row with
  noise of controls that were interpolated between knots, which is not the likelihood ratio of what
  is sampled: it is left out.
"""

from pathlib import Path

import numpy as np
import torch
from pytorch_mppi.mppi import KMPPI, MPPI, SMPPI, RBFKernel, SpecificActionSampler

COMMANDS, SAMPLES, HORIZON, KNOTS = 10, 32, 8, 4
SETTING = {
    "dt": 0.1,
    "temperature": 0.5,
    "noise_std": np.array([0.6, 1.1]),
    "noise_covariance": np.array([[0.4, 0.25], [0.25, 0.9]]),
    "noise_mean": np.array([0.1, -0.15]),
    "rate_std": np.array([2.0, 3.0]),
    "max_rate": 2.5,
    "control_max": np.array([0.7, 1.0]),
    "max_speed": 1.0,
    "max_turn_rate": 2.0,
    "drag": 0.1,
    "target": np.array([1.2, 0.6]),
    "ensemble_drags": np.array([0.1, 0.6, 1.5]),
    "state_noise_std": np.array([0.02, 0.02, 0.05, 0.1, 0.1]),
    "variance_weight": 2.0,
    "variance_discount": 0.9,
    "smoothness_weight": 0.4,
    "length_scale": 2.0,
    "num_knots": KNOTS,
    "per_command": 3,
}


class Recorded:
    """Given noise instead of fresh; and what a command computed on its way is kept."""

    def _sample_noise(self, shape):
        assert self.given.shape[:2] == tuple(shape)
        return self.given

    def _compute_total_cost_batch(self):
        total = super()._compute_total_cost_batch()
        perturbation = torch.sum(self.U * self._compute_action_cost(self.noise), dim=(1, 2))
        self.costs = total - perturbation
        return total


class RecordedMPPI(Recorded, MPPI):
    pass


class RecordedSMPPI(Recorded, SMPPI):
    def _sample_noise(self, shape):
        return self._bound_d_action(self.U + super()._sample_noise(shape)) - self.U


class RecordedKMPPI(Recorded, KMPPI):
    def _setup_action_cost_fn(self):
        self._compute_action_cost = torch.zeros_like


class Given(SpecificActionSampler):
    def __init__(self, sequences):
        super().__init__()
        self.sequences = torch.as_tensor(sequences)

    def sample_trajectories(self, state, info):
        return self.sequences


def drive(state, control, drag):
    """Differential drive, Euler: jaxplore's own default model."""
    x, y, yaw, v, omega = state.unbind(-1)
    a, alpha = control.unbind(-1)
    dt, turn = SETTING["dt"], SETTING["max_turn_rate"]
    return torch.stack(
        [
            x + dt * v * torch.cos(yaw),
            y + dt * v * torch.sin(yaw),
            yaw + dt * omega,
            torch.clamp(v + dt * (a - drag * v), 0.0, SETTING["max_speed"]),
            torch.clamp(omega + dt * (alpha - drag * omega), -turn, turn),
        ],
        dim=-1,
    )


def one_model(state, control, t):
    return drive(state, control, SETTING["drag"])


def ensemble(state, control, t):
    """Row m K + k is control sequence k under model m."""
    drags = torch.as_tensor(SETTING["ensemble_drags"])
    return drive(state, control, drags.repeat_interleave(SAMPLES))


class Disturbed:
    """Adds the noise of this command, step and outcome, the same for all control sequences."""

    def __call__(self, state, control, t):
        reached = drive(state, control, SETTING["drag"])
        spread = np.sqrt(SETTING["dt"]) * SETTING["state_noise_std"]
        added = torch.as_tensor(self.draws[t] * spread)
        return reached + added.repeat_interleave(SAMPLES, dim=0)


def running_cost(state, control, t):
    error = state[:, :2] - torch.as_tensor(SETTING["target"])
    late = 1.0 + (t + 1) * SETTING["dt"]
    return (error**2).sum(-1) * late + 0.1 * (control**2).sum(-1)


def terminal_cost(states, actions):
    """Of states (M, K, T, nx)."""
    return 3.0 * torch.abs(states[:, :, -1, 3] - 0.2)


def main():
    rng = np.random.default_rng(0)
    unit = rng.standard_normal((COMMANDS, SAMPLES, HORIZON, 2)).astype(np.float32)
    draws = rng.standard_normal((COMMANDS, HORIZON, 4, 5)).astype(np.float32)
    start = np.array([0.1, -0.2, 0.3, 0.4, -0.5])
    states = start + np.cumsum(rng.uniform(-0.06, 0.1, (COMMANDS, 5)), axis=0)
    states = states.astype(np.float32)
    nominal = rng.uniform(-0.6, 0.6, (HORIZON, 2)).astype(np.float32)
    sequences = rng.uniform(-0.7, 0.7, (2, HORIZON, 2)).astype(np.float32)

    std, covariance = SETTING["noise_std"], SETTING["noise_covariance"]
    mean, bound = SETTING["noise_mean"], torch.as_tensor(SETTING["control_max"])
    white = torch.as_tensor(unit * std)
    correlated = torch.as_tensor(unit @ np.linalg.cholesky(covariance).T + mean)
    bounds = {"u_min": -bound, "u_max": bound}
    dispersion = {
        "rollout_var_cost": SETTING["variance_weight"],
        "rollout_var_discount": SETTING["variance_discount"],
    }
    disturbed = Disturbed()

    def make(kind, variance, model=one_model, **changes):
        return kind(
            model,
            running_cost,
            5,
            torch.as_tensor(variance),
            num_samples=SAMPLES,
            horizon=HORIZON,
            lambda_=SETTING["temperature"],
            step_dependent_dynamics=True,
            U_init=torch.as_tensor(nominal, dtype=torch.float64),
            **changes,
        )

    diagonal = np.diag(std**2)
    cases = {
        "diagonal": (make(RecordedMPPI, diagonal), white),
        "bounded": (
            make(
                RecordedMPPI,
                covariance,
                noise_mu=torch.as_tensor(mean),
                sample_null_action=True,
                terminal_state_cost=terminal_cost,
                **bounds,
            ),
            correlated,
        ),
        "per_command": (
            make(RecordedMPPI, diagonal, u_per_command=SETTING["per_command"], **bounds),
            white,
        ),
        "injected": (
            make(
                RecordedMPPI,
                diagonal,
                specific_action_sampler=Given(sequences.astype(np.float64)),
                **bounds,
            ),
            white,
        ),
        "ensemble": (
            make(
                RecordedMPPI,
                diagonal,
                ensemble,
                rollout_samples=3,
                terminal_state_cost=terminal_cost,
                **dispersion,
                **bounds,
            ),
            white,
        ),
        "disturbed": (
            make(
                RecordedMPPI,
                diagonal,
                disturbed,
                rollout_samples=4,
                **dispersion,
                **bounds,
            ),
            white,
        ),
        "smooth": (
            make(
                RecordedSMPPI,
                np.diag(SETTING["rate_std"] ** 2),
                delta_t=SETTING["dt"],
                w_action_seq_cost=SETTING["smoothness_weight"],
                action_min=-bound,
                action_max=bound,
                sample_null_action=True,
                terminal_state_cost=terminal_cost,
            ),
            torch.as_tensor(unit * SETTING["rate_std"]),
        ),
        "bounded_rates": (
            make(
                RecordedSMPPI,
                np.diag(SETTING["rate_std"] ** 2),
                delta_t=SETTING["dt"],
                w_action_seq_cost=SETTING["smoothness_weight"],
                u_min=torch.as_tensor(-SETTING["max_rate"]),
                u_max=torch.as_tensor(SETTING["max_rate"]),
                action_min=-bound,
                action_max=bound,
            ),
            torch.as_tensor(unit * SETTING["rate_std"]),
        ),
        "kernel": (
            make(
                RecordedKMPPI,
                diagonal,
                num_support_pts=KNOTS,
                kernel=RBFKernel(SETTING["length_scale"]),
                terminal_state_cost=terminal_cost,
                **bounds,
            ),
            white[:, :, :KNOTS],
        ),
    }
    stored = {
        "unit_noise": unit,
        "draws": draws,
        "states": states,
        "nominal": nominal,
        "sequences": sequences,
        **{f"setting/{name}": value for name, value in SETTING.items()},
    }
    for name, (controller, noise) in cases.items():
        rows = []
        for command in range(COMMANDS):
            controller.given, disturbed.draws = noise[command], draws[command]
            action = controller.command(torch.as_tensor(states[command]))
            row = {
                "action": action,
                "controls": controller.get_action_sequence(),
                "costs": controller.costs,
                "total": controller.cost_total,
                "weights": controller.omega,
            }
            if isinstance(controller, SMPPI):
                row["rates"] = controller.U
            if isinstance(controller, KMPPI):
                row["knots"] = controller.theta
            # A copy: smooth MPPI adds to its action sequence in place.
            rows.append({key: value.numpy().copy() for key, value in row.items()})
        for key in rows[0]:
            stored[f"{name}/{key}"] = np.stack([row[key] for row in rows])
    np.savez_compressed(Path(__file__).with_name("pytorch_mppi.npz"), **stored)


if __name__ == "__main__":
    main()
