"""Path following as a reinforcement-learning agent sees it."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxplore._types import Flag, Scalar
from jaxplore.geometry.path import Path
from jaxplore.report.following.data import PathRecord
from jaxplore.simulation.following.state import PathState
from jaxplore.simulation.scenario import AgentView, state_bounds
from jaxplore.simulation.state import Moment

AHEAD, NUM_AHEAD = 1.0, 12
"""Distance between the path points that an agent observes [m], and their number."""


class PathView(AgentView):
    """Path following as an agent sees it: the path ahead in, the progress along it out.

    There is no map, so `view_cells` is None. `num_obstacles` counts moving and static ones.
    """

    path: Path
    num_obstacles: int = eqx.field(static=True)

    def observation(self, state: PathState, moment: Moment, belief: Any) -> dict[str, Array]:
        """Return the state, the path ahead and the obstacles, both in the robot's frame.

        `state` (nx,); `path` (12, 2) points of the path ahead, 1 m apart [m]; `errors` (2,) signed
        distance from the path, and angle of the path relative to the heading [m, rad];
        `obstacles` (N, 5) position [m], velocity [m/s] and radius of the enclosing disc [m].
        """
        robot, observed = self.scenario.robot, moment.observed
        position, heading = robot.position(observed), robot.heading(observed)
        sin, cos = jnp.sin(heading), jnp.cos(heading)
        to_robot = jnp.stack([jnp.stack([cos, sin]), jnp.stack([-sin, cos])])
        # Only the path around the last progress is searched: where the path crosses itself, the
        # other branch may be nearer.
        near = self.path.nearest(position, near=state.progress)
        distances = near + AHEAD * jnp.arange(1.0, NUM_AHEAD + 1.0)
        points = jax.vmap(lambda phi: self.path.at(phi).position)(distances)
        ahead = (points - position) @ to_robot.T
        here = self.path.at(near)
        turn = here.heading - heading
        errors = jnp.stack(
            [
                self.path.errors(position, near).contouring,
                jnp.arctan2(jnp.sin(turn), jnp.cos(turn)),
            ]
        )
        obstacles = jnp.zeros((0, 5))
        if state.known is not None:
            known = state.known
            reach = jnp.max(
                jnp.linalg.norm(known.outlines.corners - known.centres[:, None], axis=-1), axis=-1
            )
            obstacles = jnp.concatenate(
                [
                    (known.centres - position) @ to_robot.T,
                    known.velocities @ to_robot.T,
                    (reach + known.outlines.radii)[:, None],
                ],
                axis=-1,
            )
        return {"state": observed, "path": ahead, "errors": errors, "obstacles": obstacles}

    def observation_bounds(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Return the bounds of `observation`; only those of the state may be finite."""
        shapes = {"path": (NUM_AHEAD, 2), "errors": (2,), "obstacles": (self.num_obstacles, 5)}
        free = {
            name: (np.full(shape, -np.inf, np.float32), np.full(shape, np.inf, np.float32))
            for name, shape in shapes.items()
        }
        return {"state": state_bounds(self.scenario.robot), **free}

    def reward(self, before: PathState, after: PathState) -> Scalar:
        """Return the progress along the path [m]."""
        return after.progress - before.progress

    def is_contact(self, record: PathRecord) -> Flag:
        """Check whether the robot touched an obstacle, or part of it left the corridor."""
        return (record.gap < 0.0) | (record.room < 0.0)

    def facts(self, state: PathState) -> dict[str, Scalar]:
        """Return the progress, the arc length passed [m]."""
        return {"progress": state.progress}
