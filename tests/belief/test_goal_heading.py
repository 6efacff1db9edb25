"""A car's cost-to-go to a goal with a heading ends at poses with about that heading."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.belief.car import car_motion
from jaxplore.geometry.state_lattice import HEADINGS

ROBOT = jx.Ackermann(max_speed=1.0, min_speed=-0.5)
LIDAR = jx.Lidar(num_beams=8, max_range=2.0)
GOAL = (4.0, 3.0)


@pytest.fixture(scope="module", params=[False, True], ids=["explores", "apart"])
def field_for(request):
    """Return what computes the field of a goal with a heading."""
    perception = jx.Perception(
        LIDAR, 0.2, ROBOT.radius, goal=GOAL, goal_heading=0.0, max_unknown=1.0,
        is_goal_apart=request.param, num_directions=4, car=car_motion(ROBOT),
    )  # fmt: skip
    grid = jx.OccupancyGrid(np.zeros((30, 40)), 0.2)

    @eqx.filter_jit
    def compute(heading):
        turned = eqx.tree_at(lambda each: each.goal_heading, perception, heading)
        belief = turned.init(grid, jnp.asarray([2.0, 3.0, 0.0]))
        return belief.to_goal if request.param else belief.guidance

    return lambda heading: compute(jnp.asarray(heading))


@pytest.mark.parametrize("heading", [0.0, 1.2, -2.9])
def test_only_poses_that_face_the_heading_are_at_the_goal(heading: float, field_for) -> None:
    field = field_for(heading)
    row, column = (int(each) for each in field.frame.to_cell(jnp.asarray(GOAL)))
    at_goal = np.asarray(field.by_heading)[:, :, row, column].min(axis=0)
    away = np.abs(np.angle(np.exp(1j * (np.array(HEADINGS) - heading))))
    # A car that stands there another way round must drive: at least an arc of the turn.
    least = at_goal.min()
    assert away[at_goal.argmin()] == away.min()
    radius = float(ROBOT.turning_radius)
    for each, turn in zip(at_goal, away, strict=True):
        if turn > math.pi / 4:
            assert each - least > 0.8 * radius * (turn - math.pi / 8)
