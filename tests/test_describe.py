"""`repr` of what users hold: short, and with values."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import OFFICE

import jaxplore as jx
from jaxplore._describe import describe
from jaxplore.tasks.registry import build, make_settings

WORLD = jx.OccupancyGrid(np.pad(np.zeros((58, 78)), 1, constant_values=1.0), 0.1)
ROBOT = jx.DifferentialDrive(max_speed=1.5, radius=0.25)
LIDAR = jx.Lidar(num_beams=24, max_range=4.0)


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.float32(0.1), "0.1"),
        (jnp.asarray([1.0, -2.5]), "[1, -2.5]"),
        (jnp.asarray([[1, 2], [3, 4]]), "[[1, 2], [3, 4]]"),
        (np.array([True, False]), "[True, False]"),
        (np.zeros((3, 4), np.float32), "float32[3, 4]"),
        (jax.random.key(0), "key<fry>"),
        ((1.0, "a", None), "[1, 'a', None]"),
        (jx.Softmax(0.5), "Softmax(temperature=0.5, importance=1)"),
    ],
)
def test_values_are_shown_unless_they_are_many(value: object, expected: str) -> None:
    assert describe(value) == expected


def test_a_traced_value_is_its_type() -> None:
    seen = []

    @jax.jit
    def trace(robot: jx.DifferentialDrive, world: jx.OccupancyGrid) -> None:
        seen.extend([repr(robot), repr(world)])

    trace(ROBOT, WORLD)
    assert "radius=float32" in seen[0]
    assert seen[1].startswith("OccupancyGrid(8 m x 6 m, cells of 0.1 m")


def test_a_cost_is_written_as_it_is_made() -> None:
    cost = 2.0 * jx.ObstacleCost(0.5) + jx.GoalCost([1.0, 2.0]).with_name("dock")
    text = repr(cost)
    assert text.startswith("2 * ObstacleCost(clearance=0.5")
    assert ".with_name('dock')" in text
    assert "goal=[1, 2]" in text
    both = repr(0.5 * (jx.ControlCost() + jx.ControlCost()))
    assert both == "0.5 * (ControlCost() + ControlCost())"


def test_robot_map_controller_and_scenario_are_short_and_have_values() -> None:
    assert "max_speed=1.5" in repr(ROBOT)
    assert repr(WORLD) == (
        "OccupancyGrid(8 m x 6 m, cells of 0.1 m, 94 % free, 6 % occupied, origin [0, 0, 0])"
    )
    controller = jx.explorer(ROBOT, horizon=8, num_samples=32)
    scenario = jx.ExplorationScenario(WORLD, ROBOT, LIDAR, start=(4.0, 3.0, 0.0))
    assert {"  horizon=8,", "  num_samples=32,"} <= set(repr(controller).splitlines())
    for shown in ("num_beams=24", "radius=0.25", "start=[4, 3, 0, 0, 0]", "8 m x 6 m"):
        assert shown in repr(scenario)
    for each in (ROBOT, WORLD, controller, scenario):
        assert len(repr(each)) < 1000


def test_a_run_is_one_line_and_a_picture_with_a_table() -> None:
    # That of the tests of commands: it is compiled for them all.
    entries = {
        **OFFICE,
        "lidar": {"max_range": 2.0},
        "controller": {"num_samples": 32, "horizon": 10},
        "fields": {"num_directions": 8},
    }
    controller, scenario, _, key = build(make_settings(entries))
    run = jx.simulate(controller, scenario, 10, key=key, num_trajectories=0)
    assert repr(run).startswith("Run(ExplorationRecording(10 steps of 0.02 s, ")
    assert "\n" not in repr(run)
    page = run._repr_html_()
    assert page.startswith('<img src="data:image/png;base64,')
    assert "<td>coverage</td>" in page
    assert run.plot("coverage").axes[0].get_ylabel() == "coverage [%]"
    assert run.plot().axes[0].get_xlabel() == "x [m]"
    with pytest.raises(ValueError, match=r"name is 'maps'; accepted: map, coverage"):
        run.plot("maps")
