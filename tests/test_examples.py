"""The example scripts for ground vehicles, shortened."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_waypoints_are_reached_one_after_the_other(capsys: pytest.CaptureFixture[str]) -> None:
    example = load("waypoints")
    states, legs = map(np.asarray, example.main(num_steps=200, num_samples=64))
    points = np.asarray(example.WAYPOINTS)
    nearest = np.linalg.norm(states[:, None, :2] - points, axis=-1).min(axis=0)
    assert (nearest < example.REACHED).all()
    assert (np.diff(legs) >= 0).all()
    assert legs[-1] == len(points) - 1
    away = np.linalg.norm(states[:, None, :2] - np.asarray(example.OBSTACLES), axis=-1)
    assert (away - np.asarray(example.RADII)).min() > 0.2
    assert "not reached" not in capsys.readouterr().out


def test_a_portfolio_explores(capsys: pytest.CaptureFixture[str]) -> None:
    run = load("portfolio").main(num_steps=25, num_samples=32)
    assert run.metrics.collisions == 0
    assert run.metrics.coverage > 0.1
    assert run.metrics.diversity > 0.05
    said = capsys.readouterr().out
    for name in ("explorer", "balanced", "exploiter", "cautious"):
        assert f"{name}: share" in said
