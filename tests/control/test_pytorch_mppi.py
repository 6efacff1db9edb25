"""Ten commands in a row, number for number against pytorch_mppi 0.9.1.

Its results are stored, computed in double precision by `peers/record_pytorch_mppi.py`. Both get the
same noise, states and settings; from then on each follows its own plan.
"""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    MPPI,
    ControlRateCost,
    Cost,
    DifferentialDrive,
    GaussianProposal,
    InjectedProposal,
    Knots,
    RBFKernel,
    Smooth,
    Softmax,
)
from jaxplore.control import Disturbance, MeanVariance, ModelEnsemble

pytestmark = pytest.mark.long

with np.load(Path(__file__).parent / "peers" / "pytorch_mppi.npz", allow_pickle=False) as stored:
    RECORD = dict(stored)

SETTING = {
    name.removeprefix("setting/"): value
    for name, value in RECORD.items()
    if name.startswith("setting/")
}
TEMPERATURE, STD, RATE_STD = (SETTING[name] for name in ("temperature", "noise_std", "rate_std"))
COVARIANCE, MEAN = SETTING["noise_covariance"], SETTING["noise_mean"]
COMMANDS, SAMPLES, HORIZON, _ = RECORD["unit_noise"].shape
CLOSE = {"rtol": 1e-5, "atol": 1e-5}


def robot(drag=SETTING["drag"], bounds=SETTING["control_max"]) -> DifferentialDrive:
    return DifferentialDrive(
        max_speed=SETTING["max_speed"],
        max_turn_rate=SETTING["max_turn_rate"],
        max_acceleration=bounds[0],
        max_angular_acceleration=bounds[1],
        drag=drag,
    )


class ToTarget(Cost):
    at_end: jax.Array
    target: jax.Array = eqx.field(
        default_factory=lambda: jnp.asarray(SETTING["target"], jnp.float32)
    )

    def stage(self, state, control, t, belief):
        error = state.position - self.target
        return jnp.sum(error * error) * (1.0 + t) + 0.1 * jnp.sum(control * control)

    def terminal(self, state, belief):
        return self.at_end * jnp.abs(state.speed - 0.2)


RUNNING, WITH_TERMINAL = ToTarget(jnp.asarray(0.0)), ToTarget(jnp.asarray(3.0))


class Recorded(Disturbance):
    """State noise that was drawn before: (T, M, nx) unit normal."""

    drawn: jax.Array

    def draw(self, dynamics, horizon, num_outcomes, *, key):
        return self.drawn

    def step_at(self, dynamics, state, control, t, dt, drawn):
        std = jnp.asarray(SETTING["state_noise_std"], jnp.float32)
        return dynamics.step_at(state, control, t, dt) + jnp.sqrt(dt) * std * drawn


def make(model=None, cost=RUNNING, **changes) -> MPPI:
    settings = {
        "horizon": HORIZON,
        "num_samples": SAMPLES,
        "dt": SETTING["dt"],
        "proposal": GaussianProposal(STD),
        "weighting": Softmax(TEMPERATURE),
    }
    return MPPI(robot() if model is None else model, cost, **{**settings, **changes})


def cases() -> dict[str, tuple[MPPI, np.ndarray]]:
    """Each with its noise (commands, K, P, nu), the mean included."""
    unit = RECORD["unit_noise"].astype(np.float64)
    white = unit * STD
    dispersion = MeanVariance(SETTING["variance_weight"], SETTING["variance_discount"])
    correlated = GaussianProposal(noise_covariance=COVARIANCE, mean=MEAN)
    rates = GaussianProposal(RATE_STD)
    roughness = SETTING["smoothness_weight"] * ControlRateCost(np.ones(2), include_applied=False)
    return {
        "diagonal": (make(robot(bounds=(1e6, 1e6))), white),
        "bounded": (
            make(cost=WITH_TERMINAL, proposal=InjectedProposal(correlated, null_action=True)),
            unit @ np.linalg.cholesky(COVARIANCE).T + MEAN,
        ),
        "per_command": (make(), white),
        "injected": (
            make(proposal=InjectedProposal(GaussianProposal(STD), RECORD["sequences"])),
            white,
        ),
        "ensemble": (
            make(
                cost=WITH_TERMINAL,
                disturbance=ModelEnsemble(*map(robot, SETTING["ensemble_drags"])),
                num_outcomes=3,
                risk=dispersion,
            ),
            white,
        ),
        "disturbed": (
            make(disturbance=Recorded(RECORD["draws"][0]), num_outcomes=4, risk=dispersion),
            white,
        ),
        "smooth": (
            make(
                cost=WITH_TERMINAL + roughness,
                parameterisation=Smooth(),
                proposal=InjectedProposal(rates, null_action=True),
            ),
            unit * RATE_STD,
        ),
        "bounded_rates": (
            make(
                cost=RUNNING + roughness,
                parameterisation=Smooth(SETTING["max_rate"]),
                proposal=rates,
            ),
            unit * RATE_STD,
        ),
        # Of kernel MPPI the record has no cost of the perturbation: see there.
        "kernel": (
            make(
                cost=WITH_TERMINAL,
                parameterisation=Knots(
                    int(SETTING["num_knots"]), RBFKernel(float(SETTING["length_scale"]))
                ),
                weighting=Softmax(TEMPERATURE, importance=0.0),
            ),
            white[:, :, : int(SETTING["num_knots"])],
        ),
    }


CASES = cases()


@pytest.mark.parametrize("case", CASES)
def test_ten_commands_equal_those_of_pytorch_mppi(case: str) -> None:
    mppi, noise = CASES[case]
    expected = {
        name.removeprefix(f"{case}/"): value
        for name, value in RECORD.items()
        if name.startswith(f"{case}/")
    }
    traces = 0

    @eqx.filter_jit
    def step(mppi, state, observation, perturbations):
        nonlocal traces
        traces += 1
        return mppi.step(state, observation, key=jax.random.key(0), perturbations=perturbations)

    # Kernel MPPI of the peer begins with knots of 0, whatever it is given.
    state = mppi.init(None if case == "kernel" else jnp.asarray(RECORD["nominal"]))
    for command in range(COMMANDS):
        if case == "disturbed":
            drawn = jnp.asarray(RECORD["draws"][command])
            mppi = eqx.tree_at(lambda m: m.disturbance.drawn, mppi, drawn)
        perturbations = jnp.asarray(noise[command].transpose(1, 2, 0), jnp.float32)
        control, state, info = step(
            mppi, state, jnp.asarray(RECORD["states"][command]), perturbations
        )
        now = {name: value[command] for name, value in expected.items()}
        np.testing.assert_allclose(info.costs, now["costs"], rtol=1e-5)
        np.testing.assert_allclose(info.weights, now["weights"], **CLOSE)
        np.testing.assert_allclose(info.controls, now["controls"], **CLOSE)
        rows = np.atleast_2d(now["action"])
        np.testing.assert_allclose(control, rows[0], **CLOSE)
        np.testing.assert_allclose(info.controls[: len(rows)], rows, **CLOSE)
        if "rates" in now:
            np.testing.assert_allclose(state.nominal.rates, now["rates"], **CLOSE)
        if "knots" in now:
            np.testing.assert_allclose(state.nominal, now["knots"], **CLOSE)
            continue
        # The ratio is given up to a constant; differences of costs of 20 lose a digit.
        total = info.costs + float(TEMPERATURE) * info.log_ratio
        np.testing.assert_allclose(
            total - total[0], now["total"] - now["total"][0], rtol=1e-5, atol=2e-5
        )
    assert traces == 1
