"""Explore an unknown yard with a portfolio: explorer, balanced, exploiter and cautious in parallel.

Each period all members plan in one compiled call, and their plans are fused into one. The loop of
the library, `simulate`, moves the robot, scans and updates the map.
"""

import sys

import jax
import numpy as np

import jaxplore as jx
from jaxplore.planning import SafeFusion, WeightedVote

SIZE, CELL = (30, 40), 0.2  # 6 x 8 m


def make_world() -> jx.OccupancyGrid:
    """Return a yard with an outer wall, a pillar and a wall with a gap."""
    cells = np.zeros(SIZE, np.float32)
    cells[0], cells[-1], cells[:, 0], cells[:, -1] = 1.0, 1.0, 1.0, 1.0
    cells[14:17, 12:15] = cells[:18, 26:28] = 1.0
    return jx.OccupancyGrid(cells, CELL)


def make_parts(num_samples: int) -> tuple[jx.Portfolio, jx.ExplorationScenario]:
    """Return the portfolio and its task."""
    world, robot = make_world(), jx.DifferentialDrive(max_speed=1.0)
    lidar = jx.Lidar(num_beams=60, max_range=3.0)
    perception = jx.Perception(lidar, CELL, robot.radius, num_directions=8)
    scenario = jx.ExplorationScenario(
        world, robot, lidar, (1.0, 1.0, 0.0), perception=perception, target_coverage=0.95
    )
    portfolio = jx.ground_portfolio(
        robot, fusion=SafeFusion(WeightedVote(0.1)), num_samples=num_samples
    )
    return portfolio, scenario


def main(num_steps: int = 1500, num_samples: int = 256) -> jx.Run:
    """Explore, and say what each member did for it."""
    portfolio, scenario = make_parts(num_samples)
    run = jx.simulate(portfolio, scenario, num_steps, key=jax.random.key(0))
    sys.stdout.write(f"known after {run.metrics.duration:.1f} s: {run.metrics.coverage:.0%}\n")
    for name, numbers in run.metrics.members.items():
        sys.stdout.write(f"{name}: share {numbers['share']:.2f} of the fused plans\n")
    sys.stdout.write(f"diversity of their controls: {run.metrics.diversity:.2f} half ranges\n")
    return run


if __name__ == "__main__":
    main()
