"""Drive a differential drive robot from waypoint to waypoint, around known obstacles.

One MPPI controller drives all legs: the waypoint is a number of its cost, so another one needs no
other program. The whole drive is one compiled loop.
"""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

import jaxplore as jx

WAYPOINTS = [[2.0, 0.0], [3.5, 1.5], [2.0, 3.0], [0.0, 2.0]]
OBSTACLES, RADII = [[1.0, 0.1], [2.6, 1.6], [1.0, 2.4]], [0.25, 0.3, 0.2]
REACHED = 0.25  # distance at which the next waypoint is due [m]


def make_controller(num_samples: int = 256) -> jx.MPPI:
    """Return MPPI that drives to the first waypoint."""
    cost = (
        2.0 * jx.WaypointCost(WAYPOINTS[0], decay=0.5)
        + jx.DiscObstacleCost(OBSTACLES, RADII)
        + 0.05 * jx.ControlRateCost()
    )
    return jx.MPPI(
        jx.DifferentialDrive(max_speed=1.0),
        cost,
        horizon=30,
        num_samples=num_samples,
        dt=0.1,
        noise_std=[0.5, 1.0],
        temperature=1.0,
    )


@eqx.filter_jit
def drive(controller: jx.MPPI, key: Array, num_steps: int) -> tuple[Array, Array]:
    """Return the states (T, nx) of a drive and the index of the waypoint at each step (T,)."""
    robot, points = controller.dynamics, jnp.asarray(WAYPOINTS)

    def advance(carry, key):
        x, memory, leg = carry
        here = jnp.linalg.norm(robot.position(x) - points[leg])
        leg = jnp.where(here < REACHED, jnp.minimum(leg + 1, len(WAYPOINTS) - 1), leg)
        now = jx.set_parameters(controller, {"cost.waypoint.waypoint": points[leg]})
        control, memory, _ = now.step(memory, x, key=key)
        x = robot.step(x, control, controller.dt)
        return (x, memory, leg), (x, leg)

    start = robot.at_pose(0.0, 0.0, 0.0), controller.init(), jnp.asarray(0)
    return jax.lax.scan(advance, start, jax.random.split(key, num_steps))[1]


def gap(states: Array) -> Array:
    """Return the least distance of the robot's edge from an obstacle [m]; negative inside one."""
    away = jnp.linalg.norm(states[:, None, :2] - jnp.asarray(OBSTACLES), axis=-1)
    return jnp.min(away - jnp.asarray(RADII)) - make_controller().dynamics.radius


def main(num_steps: int = 200, num_samples: int = 256) -> tuple[Array, Array]:
    """Drive all legs, and say when each waypoint was reached."""
    states, legs = drive(make_controller(num_samples), jax.random.key(0), num_steps)
    for index, point in enumerate(WAYPOINTS):
        near = jnp.linalg.norm(states[:, :2] - jnp.asarray(point), axis=-1) < REACHED
        when = f"{0.1 * (int(jnp.argmax(near)) + 1):.1f} s" if bool(near.any()) else "not reached"
        sys.stdout.write(f"waypoint {index + 1} at {point}: {when}\n")
    sys.stdout.write(f"nearest to an obstacle: {float(gap(states)):.2f} m\n")
    return states, legs


if __name__ == "__main__":
    main()
