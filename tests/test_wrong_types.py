"""Wrong types, numbers out of bounds and swapped arguments: one line that names the argument.

The program runs without beartype.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

A_COST = "a Cost, such as A() + 2.0 * B(), or an instance of your own subclass of jaxplore.Cost"
ORDER = "in the order simulate(controller, scenario, num_steps)"
FIVE = "5 numbers: x, y, yaw, v, omega"

SAID = {
    "a list of costs": f"ValueError: cost is a list; accepted: {A_COST}",
    "a function as cost": f"ValueError: cost is the function <lambda>; accepted: {A_COST}",
    "a number as cost": f"ValueError: cost is 3.0; accepted: {A_COST}",
    "a class as cost": (
        "ValueError: cost is the class ControlCost; accepted: an instance, such as ControlCost()"
    ),
    "the sum of a list": "works",
    "cost + 3": f"TypeError: summand is 3; accepted: {A_COST}",
    "3 + cost": f"TypeError: summand is 3; accepted: {A_COST}",
    "a text times a cost": "ValueError: weight is '2'; accepted: a finite number",
    "a cost times a cost": "ValueError: weight is a GoalCost; accepted: a finite number",
    "a named list": f"ValueError: cost is a list; accepted: {A_COST}",
    "a class as model": (
        "ValueError: dynamics is the class DifferentialDrive; accepted: an instance, such as "
        "DifferentialDrive()"
    ),
    "swapped model and cost": "ValueError: dynamics is a GoalCost; accepted: a Dynamics",
    "swapped scenario and controller": (
        f"ValueError: controller is an ExplorationScenario; accepted: a Controller, {ORDER}"
    ),
    "swapped steps and scenario": f"ValueError: scenario is 1; accepted: a Scenario, {ORDER}",
    "swapped lidar and robot": "ValueError: robot is a Lidar; accepted: a Dynamics",
    "a class as sensor": (
        "ValueError: sensors is the class Lidar; accepted: an instance, such as Lidar()"
    ),
    "one of two sensors": "ValueError: sensors[1] is a DifferentialDrive; accepted: a Sensor",
    "an array as world": (
        "ValueError: world is an array of shape (9, 9); accepted: an OccupancyGrid or a TerrainMap"
    ),
    "the seed as key of simulate": "ValueError: key is 0; accepted: jax.random.key(0)",
    "a folder to resume": "ValueError: resume is 'runs/1'; accepted: a Run or None",
    "the seed as key of step": "ValueError: key is 0; accepted: jax.random.key(0)",
    "several keys": "ValueError: key is an array of shape (2,); accepted: jax.random.key(0)",
    "a raw key": "works",
    "a list as state": "works",
    "a tuple as state": "works",
    "float64 as state": "works",
    "a short state": f"ValueError: observation has shape (3,); accepted: {FIVE}",
    "a short array as state": f"ValueError: observation has shape (3,); accepted: {FIVE}",
    "a text as state": f"ValueError: observation is 'here'; accepted: {FIVE}",
    "the robot's state as the controller's": (
        "ValueError: state is an array of shape (5,); accepted: an MPPIState, from init() or the "
        "last step"
    ),
    "no belief": (
        "MissingPartError: belief is None, and a cost reads its clearance; accepted: step(state, "
        "observation, belief, key=key) with the belief of a Perception, such as "
        "perception.init(grid, pose)"
    ),
    "no belief for one's own cost": (
        "ValueError: belief is None, and Height reads it ('NoneType' object has no attribute "
        "'height'); accepted: step(state, observation, belief, key=key)"
    ),
    "jax.jit": (
        "TypeError: MPPI holds arrays, which have no hash; accepted: "
        "equinox.filter_jit(controller.step) instead of jax.jit"
    ),
    "no annotations": (
        "ValueError: control_min is no field of WithoutAnnotations; accepted: names that the class "
        "annotates, such as control_min: jax.Array"
    ),
    "a list as bound": (
        "ValueError: control_min of WithList is a list; accepted: an array of shape (2,), such as "
        "jax.numpy.array([...])"
    ),
    "a step that returns a list": (
        "ValueError: step of WithList returns a list; accepted: an array of shape (2,), such as "
        "jax.numpy.stack([...])"
    ),
    "a step that returns a tuple": (
        "ValueError: step of WithTuple returns a tuple; accepted: an array of shape (2,), such as "
        "jax.numpy.stack([...])"
    ),
    "a text as names": (
        "ValueError: state_names of WithoutNames is 'xy'; accepted: a tuple or a list, such as "
        "('x', 'y')"
    ),
    "a text as horizon": "ValueError: horizon is '30'; accepted: a whole number >= 1",
    "a text as speed": "ValueError: max_speed is '1'; accepted: a finite number > 0.0",
    "None as speed": "ValueError: max_speed is None; accepted: a finite number > 0.0",
    "texts as noise": (
        "ValueError: noise_std is ['1', '1']; accepted: one positive number per control"
    ),
    "NumPy integers": "works",
    "a yaw in degrees": ("UserWarning: yaw of start is 90; a yaw is in radians, not in degrees"),
    "a view in degrees": (
        "ValueError: field_of_view is 90.0; accepted: a finite number > 0.0 and <= "
        "6.283186307179586"
    ),
    "a radius in centimetres": (
        "UserWarning: radius is 200; a radius is in metres, not in centimetres"
    ),
    "a range in millimetres": (
        "UserWarning: max_range is 5000; a range is in metres, not in millimetres"
    ),
    "a text as shape": "ValueError: shape is '40'; accepted: (rows, columns)",
    "one number as shape": "ValueError: shape is a tuple; accepted: (rows, columns)",
    "half a row": "ValueError: shape is 40.5; accepted: a whole number >= 1",
    "fewer rows than there are": "ValueError: shape is (5, 60); accepted: at least (12, 12)",
}

RIGHT = {
    "LabelledObject(label=text)",
    "MovingObstacleCost(collision=None)",
    "MovingObstacleCost(nearness=None)",
    "NamedCost(name=text)",
    "OccupancyGrid.from_ros(path=text)",  # refused, as a file that is not there
    "Path.with_room(half_widths=None)",
    "ProgressCost(rate=text)",
    "Run.animate(path=text)",
    "Run.load(path=text)",  # refused, as a folder that is not there
    "Run.save(path=text)",
    "avoidance_cost(caution=None)",
    "avoidance_cost(clearance=None)",
    "enable_compilation_cache(path=text)",
    "find_parameter(path=text)",  # refused, as a path that is not known
    "get_parameters(controller=None)",  # any pytree: these have no parameters
    "get_parameters(controller=class)",
    "get_parameters(controller=list)",
    "get_parameters(controller=object)",
    "get_parameters(controller=text)",
    "map_datum(path=text)",  # refused, as a file that is not there
    "mpcc(comfort_weight=None)",
    "read_laser_log(path=text)",  # refused, as a file that is not there
}
"""Calls of the walk whose argument is of an accepted type."""


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """Return what the program prints."""
    folder = tmp_path_factory.mktemp("wrong_types")
    tests = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": str(tests.parent / "src")}
    done = subprocess.run(
        [sys.executable, str(tests / "wrong_types_program.py"), str(folder)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result: dict[str, dict[str, str]] = json.loads(done.stdout)
    return result


def test_a_mistake_gets_one_line(told: dict[str, dict[str, str]]) -> None:
    assert told["mistakes"] == SAID


def test_every_wrong_type_is_refused_by_name(told: dict[str, dict[str, str]]) -> None:
    assert {call: said for call, said in told["walk"].items() if call not in RIGHT} == {}
    assert set(told["walk"]) == RIGHT


def test_what_is_refused_is_what_refusals_state(told: dict[str, dict[str, str]]) -> None:
    """Compare with the table of bounds.

    A line is an argument, the bound that its refusals state, and each number that ends in another
    way than its side of the bound says. A new argument or bound is a new line.
    """
    table = (Path(__file__).parent / "bounds.txt").read_text().splitlines()
    found = sorted(f"{argument}: {line}" for argument, line in told["bounds"].items())
    assert found == table
