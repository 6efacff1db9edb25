"""What a robot that follows a path is put into."""

import functools
import operator

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Key, Scalar, StateVector, Vector
from jaxplore.belief.obstacles import Obstacles
from jaxplore.dynamics.augmented import Augmented
from jaxplore.geometry.outlines import Outlines
from jaxplore.geometry.path import Path
from jaxplore.simulation.following.traffic import Traffic

PREDICTIONS = ("constant-turn", "constant-velocity")


class PathScenario(eqx.Module):
    """A path, a robot on it, and what else moves there.

    It is finished when the robot itself, not the phi that it plans with, has come to the end of an
    open path, or round a closed one so many times.

    Contact with an obstacle and leaving the corridor are counted and do not stop the robot.

    Args:
        model: of the robot with its path parameter, as `mpcc` returns it; the plant.
        path: to follow.
        start: pose (x, y, yaw) [m, m, rad]; standing at the start of the path, along it, when
            absent.
        laps: of a closed path.
        traffic: what else moves; nothing when absent.
        standing: what stands in the way, known beforehand; nothing when absent.
        control_rate: [Hz].
        finish: how near to an open path's end is there [m].
        tracking_noise: standard deviations of the obstacles' positions [m] and velocities [m/s] as
            the robot measures them.
        prediction: what the robot takes for known of how they go on: their turn rates too
            ("constant-turn"), or not ("constant-velocity"); static.
        growth: standard deviation of their velocity that it reckons with [m/s].
        turn_growth: of their turn rate [rad/s].

    Raises:
        ValueError: a model without a path parameter, a start that is no pose, laps or rates that
            are not positive, more than one lap of an open path, a negative deviation, another
            prediction.
    """

    model: Augmented
    path: Path
    start: StateVector
    end: Scalar
    traffic: Traffic | None
    standing: Outlines | None
    control_period: Scalar
    tracking_noise: Float[Array, "2"]
    growth: Scalar
    turn_growth: Scalar
    prediction: str = eqx.field(static=True)

    def __init__(
        self,
        model: Augmented,
        path: Path,
        *,
        start: Vector | None = None,
        laps: int = 1,
        traffic: Traffic | None = None,
        standing: Outlines | None = None,
        control_rate: float = 50.0,
        finish: ArrayLike = 0.5,
        tracking_noise: Vector = (0.02, 0.05),
        prediction: str = "constant-turn",
        growth: ArrayLike = 0.1,
        turn_growth: ArrayLike = 0.1,
    ) -> None:
        if "phi" not in model.state_names:
            raise ValueError(
                f"model has the states {', '.join(model.state_names)}; accepted: one with phi, "
                "such as mpcc returns"
            )
        rounds = _checks.positive_int("laps", laps)
        if rounds > 1 and not path.is_closed:
            raise ValueError(f"laps is {laps!r} of an open path; accepted: 1")
        self.model, self.path = model, path
        self.traffic = None if traffic is None or traffic.number == 0 else traffic
        self.standing = None if standing is None or standing.number == 0 else standing
        near = _checks.scalar("finish", finish, at_least=0.0)
        self.end = rounds * path.length if path.is_closed else path.length - near
        if start is None:
            point = path.at(jnp.zeros(()))
            pose = [float(value) for value in (point.x, point.y, point.heading)]
        else:
            pose = np.asarray(_checks.vector("start", start, 3), np.float64).tolist()
        state = model.at_pose(*pose)
        phi = path.nearest(model.position(state), near=jnp.zeros(()) if path.is_closed else None)
        self.start = state.at[model.state_names.index("phi")].set(phi)
        rate = _checks.number("control_rate", control_rate, above=0.0)
        self.control_period = jnp.asarray(1.0 / rate, jnp.float32)
        self.tracking_noise = _checks.vector("tracking_noise", tracking_noise, 2)
        if (np.asarray(self.tracking_noise) < 0.0).any():
            raise ValueError(
                f"tracking_noise is {self.tracking_noise.tolist()}; accepted: 2 numbers >= 0"
            )
        if prediction not in PREDICTIONS:
            raise ValueError(f"prediction is {prediction!r}; accepted: {', '.join(PREDICTIONS)}")
        self.prediction = prediction
        self.growth = _checks.scalar("growth", growth, at_least=0.0)
        self.turn_growth = _checks.scalar("turn_growth", turn_growth, at_least=0.0)

    def true_obstacles(self, time: Scalar) -> Obstacles | None:
        """Return what truly moves and stands there at a time since the start [s]; None: nothing."""
        parts = [] if self.traffic is None else [self.traffic.at(time)]
        if self.standing is not None:
            parts.append(Obstacles(self.standing))
        return functools.reduce(operator.add, parts) if parts else None

    def obstacles(self, time: Scalar, *, key: Key) -> Obstacles | None:
        """Return what the robot knows of it."""
        known = [] if self.traffic is None else [self._tracked(self.traffic.at(time), key)]
        if self.standing is not None:
            known.append(Obstacles(self.standing))
        return functools.reduce(operator.add, known) if known else None

    def _tracked(self, truth: Obstacles, key: Key) -> Obstacles:
        """Return what the robot measures of obstacles that move, and what it reckons with."""
        keys, size = jax.random.split(key), truth.velocities.shape
        position_std, velocity_std = self.tracking_noise
        off = position_std * jax.random.normal(keys[0], size)
        faster = velocity_std * jax.random.normal(keys[1], size)
        is_turning = self.prediction == "constant-turn"
        moved = eqx.tree_at(
            lambda known: known.corners, truth.outlines, truth.outlines.corners + off[:, None]
        )
        return Obstacles(
            moved,
            truth.velocities + faster,
            truth.turn_rates if is_turning else 0.0,
            centres=truth.centres + off,
            std=position_std,
            growth=self.growth,
            turn_growth=self.turn_growth if is_turning else 0.0,
        )
