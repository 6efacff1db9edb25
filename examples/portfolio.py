"""Explore an unknown office with a portfolio of explorer, balanced, exploiter and cautious.

Each period all members plan in one compiled call, and their plans are fused into one. The loop of
the library, `simulate`, moves the robot, scans and updates the map.
"""

import sys

import jax

import jaxplore as jx
from jaxplore.planning import SafeFusion, WeightedVote


def make_parts(num_samples: int) -> tuple[jx.Portfolio, jx.ExplorationScenario]:
    """Return the portfolio and its task."""
    world = jx.office(seed=1, width=8.0, height=7.0)
    robot = jx.DifferentialDrive(max_speed=1.0)
    lidar = jx.Lidar(num_beams=60, max_range=4.0)
    scenario = jx.ExplorationScenario(
        world, robot, lidar, jx.start_pose(world), target_coverage=0.95
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
