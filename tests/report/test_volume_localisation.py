"""Errors of flights in a volume: against a search over alignments, and by hand."""

import numpy as np
import pytest
from scipy.optimize import minimize

from jaxplore.report.volume.localisation import (
    ERRORS,
    absolute_error,
    flight_errors,
    relative_error,
)


def turned(yaw: float) -> np.ndarray:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def test_the_alignment_is_the_best_turn_about_the_vertical() -> None:
    rng = np.random.default_rng(0)
    true = np.cumsum(rng.normal(size=(60, 4)), axis=0)
    found = true + 0.3 * rng.normal(size=true.shape)
    found[:, :3] = found[:, :3] @ turned(0.7).T + [3.0, -1.0, 0.5]

    def rms(motion: np.ndarray) -> float:
        moved = found[:, :3] @ turned(motion[0]).T + motion[1:]
        return float(np.sqrt(((moved - true[:, :3]) ** 2).sum(axis=1).mean()))

    best = minimize(rms, [-0.7, 0.0, 0.0, 0.0], method="BFGS")
    assert absolute_error(true, found) == pytest.approx(best.fun, rel=1e-5)
    moved = true.copy()
    moved[:, :3] = true[:, :3] @ turned(0.7).T + [3.0, -1.0, 0.5]
    assert absolute_error(true, moved) == pytest.approx(0.0, abs=1e-9)


def test_the_relative_error_of_a_straight_flight() -> None:
    """It climbs by 3 m while it goes 4 m ahead: 5 m flown. The estimate has 2 % more of each."""
    steps = np.linspace(0.0, 2.0, 21)
    true = np.stack([4.0 * steps, 0.0 * steps, 3.0 * steps, 0.3 + 0.0 * steps], axis=1)
    found = true * [1.02, 1.0, 1.02, 1.0]
    assert relative_error(true, found, 5.0) == pytest.approx(0.1, rel=1e-9)
    # A turn at the start counts for all pieces that begin behind it with that yaw.
    found = true + np.array([0.0, 0.0, 0.0, 0.1])
    wanted = 4.0 * 2.0 * np.sin(0.05)
    assert relative_error(true, found, 5.0) == pytest.approx(wanted, rel=1e-9)
    assert relative_error(true, found, 11.0) is None


def test_a_constant_offset_is_no_error_of_the_trajectory() -> None:
    places, headings = np.cumsum(np.ones((20, 3)), axis=0), np.zeros(20)
    known = np.column_stack([places, headings])
    found = flight_errors(
        places, headings, known + np.array([0.3, 0.4, 0, 0]), known * [1, 1, 2, 1]
    )
    assert tuple(found) == ERRORS
    assert found["ate"] == pytest.approx(0.0, abs=1e-9)
    assert found["rpe"] == pytest.approx(0.0, abs=1e-9)
    assert found["greatest_error"] == pytest.approx(0.5)
    # A height that is doubled is off by its deviation from the mean.
    assert found["odometry_ate"] == pytest.approx(np.std(np.arange(20.0)))
