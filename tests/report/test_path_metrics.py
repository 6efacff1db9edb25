"""Metrics of runs along a path, by hand."""

import json

import numpy as np
import pytest

from jaxplore.report.compute import Timing
from jaxplore.report.following.data import PathRecord
from jaxplore.report.following.metrics import compute_path_metrics
from jaxplore.report.following.recording import PathRecording


def recording(steps: int = 6, **changes) -> PathRecording:
    """Return a drive straight ahead at 2 m/s, ten steps a second."""
    time = 0.1 * np.arange(1, steps + 1)
    records = {
        "state": np.stack([2.0 * time, 0 * time, 0 * time, 2.0 * time], -1),
        "control": np.zeros((steps, 1)),
        "contouring": np.zeros(steps),
        "lag": np.zeros(steps),
        "progress": 2.0 * time,
        "deviation": np.zeros(steps),
        "room": np.full(steps, np.inf),
        "gap": np.full(steps, np.inf),
        "acceleration": np.full((steps, 2), np.nan),
        "effective_sample_size": np.full(steps, 10.0),
        "is_finite": np.ones(steps, bool),
    }
    fields = {name: changes.pop(name) for name in list(changes) if name in records}
    given = {
        "records": PathRecord(**{**records, **fields}),
        "frames": (),
        "timing": Timing(1.0, 0.6, 300, np.array([0.001, 0.002, 0.003])),
        "control_period": 0.1,
        "start": np.zeros(4),
        "start_progress": 0.0,
        "centre": np.array([[0.0, 0.0], [9.0, 0.0]]),
        "edges": np.zeros((0, 2, 2)),
        "length": 9.0,
        "end": 8.5,
        "is_closed": False,
        "state_names": ("x", "y", "yaw", "phi"),
        "control_half_range": np.array([0.5]),
        "robot_radius": 0.3,
        "footprint": np.zeros((0, 2)),
        "obstacle_radii": np.zeros(0),
        "is_interrupted": False,
    }
    return PathRecording(**{**given, **changes})


def test_errors_speeds_and_accelerations() -> None:
    felt = np.array([[0.0, 3.0], [0.0, -4.0], [3.0, 0.0], [3.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    metrics = compute_path_metrics(
        recording(
            contouring=np.array([0.1, -0.5, 0.0, 0.0, 0.0, 0.0]),
            lag=np.array([-0.2, 0.2, -0.2, 0.2, -0.2, 0.2]),
            deviation=np.array([0.0, 0.0, 0.0, -0.6, 0.0, 0.0]),
            acceleration=felt,
            control=np.array([[0.0], [0.0], [0.1], [0.0], [0.0], [0.0]]),
        ),
        seed=7,
    )
    assert metrics.mean_contouring == pytest.approx(0.1)
    assert metrics.max_contouring == pytest.approx(0.5)
    assert (metrics.mean_lag, metrics.max_lag) == pytest.approx((0.2, 0.2))
    assert (metrics.mean_deviation, metrics.max_deviation) == pytest.approx((0.1, 0.6))
    assert metrics.mean_speed == pytest.approx(2.0)
    assert metrics.max_speed == pytest.approx(2.0)
    assert metrics.rms_lateral_acceleration == pytest.approx(np.sqrt(25.0 / 6.0))
    assert metrics.max_lateral_acceleration == pytest.approx(4.0)
    assert metrics.rms_longitudinal_acceleration == pytest.approx(np.sqrt(3.0))
    assert metrics.rms_jerk == pytest.approx(np.sqrt((49 + 25 + 0 + 9 + 0) / 5.0) / 0.1)
    # Second differences 0.1, -0.2, 0.1, 0 of half a range of 0.5, every 0.1 s.
    assert metrics.command_jerk == pytest.approx(np.sqrt(0.06 / 4.0) / (0.5 * 0.01))
    assert metrics.progress == pytest.approx(1.2)
    assert metrics.to_go == pytest.approx(7.3)
    assert not metrics.is_finished
    assert metrics.seed == 7


def test_violations_and_contacts_that_go_on_are_one() -> None:
    room = np.array([0.5, -0.1, -0.2, 0.1, -0.05, 0.2])
    gap = np.array([1.0, 0.5, -0.01, -0.02, 0.3, 1.0])
    metrics = compute_path_metrics(recording(room=room, gap=gap))
    assert (metrics.corridor_violations, metrics.corridor_violation_steps) == (2, 3)
    assert metrics.minimum_room == pytest.approx(-0.2)
    assert (metrics.collisions, metrics.collision_steps) == (1, 2)
    assert metrics.minimum_gap == pytest.approx(-0.02)
    free = compute_path_metrics(recording())
    assert free.minimum_room is free.minimum_gap is None
    assert free.collisions == free.corridor_violations == 0
    assert "obstacles" not in str(free)
    assert "1 contacts (2 steps)" in str(metrics)


def test_laps_and_the_end() -> None:
    metrics = compute_path_metrics(recording(60, is_closed=True, length=4.0, end=12.0))
    assert metrics.is_finished
    assert metrics.finished_at == pytest.approx(6.0)
    np.testing.assert_allclose(metrics.lap_times, [2.0, 2.0, 2.0], atol=1e-9)
    assert "3, the best in 2.00 s" in str(metrics)


@pytest.mark.parametrize("steps", [0, 1, 2, 6])
def test_everything_is_json_with_and_without_a_step(steps: int) -> None:
    metrics = compute_path_metrics(recording(steps))
    text = json.dumps(metrics.as_dict(), allow_nan=False)
    assert len(json.loads(text)["curves"]["time"]) == len(metrics.curves["gap"])
    assert (metrics.mean_contouring is None) == (steps == 0)
    assert metrics.rms_lateral_acceleration is None
    assert "progress" in str(metrics)
