"""What a recording holds of the robot."""

from typing import Any

import numpy as np

from jaxplore._types import StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.formation import Formation
from jaxplore.geometry.footprint import Footprint, Rectangle


def robot_fields(robot: Dynamics, start: StateVector) -> dict[str, Any]:
    """Return the fields of a robot that the recordings of all tasks with one share."""
    return {
        "start": np.asarray(start),
        "state_names": robot.state_names,
        "control_half_range": np.asarray(robot.control_half_range),
        "robot_radius": float(robot.radius),
        "footprint": footprint_corners(robot.footprint),
    }


def fleet_fields(formation: Formation, start: StateVector) -> dict[str, Any]:
    """Return the same fields of several robots, with an entry for each."""
    prints = tuple(footprint_corners(each.footprint) for each in formation.robots)
    radii = np.array([float(each.radius) for each in formation.robots])
    return {**robot_fields(formation, start), "robot_radius": radii, "footprint": prints}


def footprint_corners(footprint: Footprint) -> np.ndarray:
    """Return the corners (4, 2) of a rectangle in the robot's frame [m]; (0, 2) otherwise."""
    if not isinstance(footprint, Rectangle):
        return np.zeros((0, 2))
    front, rear, half = (
        float(footprint.front),
        -float(footprint.rear),
        0.5 * float(footprint.width),
    )
    return np.array([[front, half], [rear, half], [rear, -half], [front, -half]])
