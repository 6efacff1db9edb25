"""Delayed commands in the closed loop, and a robot that drives in any direction."""

import numpy as np
import pytest

from jaxplore import LatencyCompensation, simulate
from jaxplore.tasks.registry import build, make_settings

pytestmark = pytest.mark.long

SMALL = {
    "map": "office",
    "office": {"width": 8.0, "height": 7.0},
    "resolution": 0.1,
    "fields": {"num_directions": 8, "node_spacing": 0.4},
    "lidar": {"num_beams": 36},
}


def test_an_omnidirectional_robot_explores_with_delayed_commands() -> None:
    settings = {
        **SMALL,
        "robot": {"model": "omnidirectional", "min_speed": -0.5, "max_deceleration": 2.0},
        "controller": {"num_samples": 64, "horizon": 20},
        "latency": 0.1,
        "faults": {"control_delay": 5},
    }
    experiment = build(make_settings(settings))
    assert isinstance(experiment.controller, LatencyCompensation)
    assert experiment.scenario.disturbances.longest_delay == 5
    run = simulate(
        experiment.controller, experiment.scenario, 250, key=experiment.key, num_trajectories=0
    )
    metrics = run.metrics
    assert metrics.collisions == 0
    assert metrics.coverage > 0.3
    # It does what only such a robot can: it drives sideways and backwards.
    vx, vy = run.recording.records.state[:, 3:5].T
    assert np.abs(vy).max() > 0.2
    assert vx.max() > 0.2
    # Commands that were computed take effect five periods later; until then nothing does.
    np.testing.assert_array_equal(run.recording.records.control[:5], 0.0)


@pytest.mark.parametrize(
    "entries",
    [
        {"map": "office", "architecture": "portfolio"},
        {"map": "office", "architecture": "wander"},
        {"map": "zones"},
        {"map": "zones", "architecture": "random-walk"},
        {"path": "track"},
        {"path": "track", "robot": {"model": "omnidirectional"}},
    ],
    ids=str,
)
def test_every_architecture_compensates_for_a_latency(entries) -> None:
    plain = build(make_settings(entries))
    late = build(make_settings({**entries, "latency": 0.15, "faults": {"control_delay": 2}}))
    assert not isinstance(plain.controller, LatencyCompensation)
    assert plain.scenario.disturbed_by == ()
    assert isinstance(late.controller, LatencyCompensation)
    assert type(late.controller.controller) is type(plain.controller)
    assert late.controller.robot is late.scenario.robot
    assert late.controller.num_pending == round(0.15 / late.scenario.period + 0.499)
    assert late.controller.member_names == plain.controller.member_names
