"""Model disturbances of the robot or its obstacles, for rollouts with several outcomes."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._trees import stack_trees
from jaxplore._types import ControlVector, Key, Scalar, StateVector, Vector
from jaxplore.belief.belief import part
from jaxplore.dynamics.base import Dynamics


class Disturbance(eqx.Module):
    """Distribution of outcomes of a model or of the belief; abstract.

    M outcomes are drawn in each planning step. All control sequences are evaluated with the same
    outcomes (common random numbers), so that their costs differ only by the sequences.
    """

    @property
    def moves_robot(self) -> bool:
        """Whether the robot's states differ between outcomes; if not, one rollout serves all."""
        return True

    @abc.abstractmethod
    def draw(self, dynamics: Dynamics, horizon: int, num_outcomes: int, *, key: Key) -> Any:
        """Draw a pytree whose leaves begin with the axes (T, M).

        Args:
            dynamics: model of the robot.
            horizon: number of steps, T.
            num_outcomes: number of outcomes, M.
            key: random key.
        """

    @abc.abstractmethod
    def step_at(
        self,
        dynamics: Dynamics,
        state: StateVector,
        control: ControlVector,
        t: Scalar,
        dt: Scalar,
        drawn: Any,
    ) -> StateVector:
        """Return the state (nx,) after a disturbed step.

        Args:
            dynamics: model of the robot.
            state: state (nx,) before the step.
            control: control (nu,) during the step.
            t: time at which the step begins [s].
            dt: length of the step [s].
            drawn: draw of one step of one outcome.
        """

    def belief(self, belief: Any, drawn: Any) -> Any:
        """Return the belief in a drawn outcome; by default the belief of the robot.

        Args:
            belief: belief of the robot.
            drawn: draw of one step of one outcome.
        """
        return belief

    def check(self, dynamics: Dynamics, num_outcomes: int) -> None:
        """Raise a `ValueError` if the disturbance does not fit the model; by default any does."""
        return


class StateNoise(Disturbance):
    """White noise on the state: `x' = step(x, u) + std sqrt(dt) w`, w ~ N(0, 1).

    Args:
        std: standard deviations (nx,) per square root of a second, so that the spread after a time
            does not depend on the time step.

    Raises:
        ValueError: a negative or infinite value; from `check`, another size than the state's.
    """

    std: StateVector

    def __init__(self, std: Vector) -> None:
        self.std = _deviations(std)

    def draw(
        self, dynamics: Dynamics, horizon: int, num_outcomes: int, *, key: Key
    ) -> Float[Array, "T M nx"]:
        """Draw standard normal noise for each state component."""
        return jax.random.normal(key, (horizon, num_outcomes, dynamics.state_size))

    def step_at(
        self,
        dynamics: Dynamics,
        state: StateVector,
        control: ControlVector,
        t: Scalar,
        dt: Scalar,
        drawn: StateVector,
    ) -> StateVector:
        """Return the state (nx,) after the step, with noise added."""
        reached = dynamics.step_at(state, control, t, dt)
        # Component by component: mapped over K samples, each component is one vector of K.
        spread = jnp.sqrt(dt) * self.std
        return jnp.stack([x + s * w for x, s, w in zip(reached, spread, drawn, strict=True)])

    def check(self, dynamics: Dynamics, num_outcomes: int) -> None:
        """Raise a `ValueError` if there is not one deviation per state component."""
        _check_size(self.std, dynamics.state_size, dynamics)


class ControlNoise(Disturbance):
    """White noise on the controls: `x' = step(x, clip(u + std w))`, w ~ N(0, 1).

    Args:
        std: standard deviations (nu,) of the controls.

    Raises:
        ValueError: a negative or infinite value; from `check`, another size than the control's.
    """

    std: ControlVector

    def __init__(self, std: Vector) -> None:
        self.std = _deviations(std)

    def draw(
        self, dynamics: Dynamics, horizon: int, num_outcomes: int, *, key: Key
    ) -> Float[Array, "T M nu"]:
        """Draw standard normal noise for each control."""
        return jax.random.normal(key, (horizon, num_outcomes, dynamics.control_size))

    def step_at(
        self,
        dynamics: Dynamics,
        state: StateVector,
        control: ControlVector,
        t: Scalar,
        dt: Scalar,
        drawn: ControlVector,
    ) -> StateVector:
        """Return the state (nx,) after a step with the disturbed control."""
        followed = jnp.clip(control + self.std * drawn, dynamics.control_min, dynamics.control_max)
        return dynamics.step_at(state, followed, t, dt)

    def check(self, dynamics: Dynamics, num_outcomes: int) -> None:
        """Raise a `ValueError` if there is not one deviation per control."""
        _check_size(self.std, dynamics.control_size, dynamics)


class ModelEnsemble(Disturbance):
    """Uncertain model parameters: outcome m follows model m of an ensemble.

    Args:
        models: M models of the same class and sizes with different parameters.

    Raises:
        ValueError: no model, models that differ in more than array values; from `check`, another
            number of outcomes than M.
    """

    models: Dynamics

    def __init__(self, *models: Dynamics) -> None:
        _kinds.instances("models", models, Dynamics)
        arrays, static = eqx.partition(models, eqx.is_array)
        structures = {jax.tree.structure(model) for model in arrays}
        if len(structures) != 1 or any(each != static[0] for each in static):
            raise ValueError(
                f"models have {len(structures)} structures; accepted: one or more models of one "
                "class that differ in numbers only"
            )
        # A leading axis of models lets rollouts map over them like over any other draw.
        stacked = stack_trees(arrays)
        self.models = eqx.combine(stacked, static[0])

    def draw(self, dynamics: Dynamics, horizon: int, num_outcomes: int, *, key: Key) -> Dynamics:
        """Return the M models, repeated for every step."""
        arrays, _ = eqx.partition(self.models, eqx.is_array)
        models: Dynamics = jax.tree.map(
            lambda leaf: jnp.broadcast_to(leaf, (horizon, *leaf.shape)), arrays
        )
        return models

    def step_at(
        self,
        dynamics: Dynamics,
        state: StateVector,
        control: ControlVector,
        t: Scalar,
        dt: Scalar,
        drawn: Dynamics,
    ) -> StateVector:
        """Return the state (nx,) after a step of the drawn model."""
        _, static = eqx.partition(self.models, eqx.is_array)
        model: Dynamics = eqx.combine(drawn, static)
        return model.step_at(state, control, t, dt)

    def check(self, dynamics: Dynamics, num_outcomes: int) -> None:
        """Raise a `ValueError` unless there is one model per outcome."""
        count = jax.tree.leaves(eqx.filter(self.models, eqx.is_array))[0].shape[0]
        if count != num_outcomes:
            raise ValueError(
                f"num_outcomes is {num_outcomes}; accepted: {count}, one per model of the ensemble"
            )


class UncertainObstacles(Disturbance):
    """Obstacles that deviate from their prediction: outcome m has the m-th draw of the `Obstacles`.

    In each outcome the drawn obstacles are known exactly. With a risk measure such as
    `ConditionalValueAtRisk`, this gives the collision risk of a whole control sequence. The robot's
    rollout is computed once for all outcomes, unless the robot is disturbed as well.

    Reads and replaces `belief.obstacles`.

    Args:
        robot: disturbance of the robot itself; none by default.
    """

    robot: Disturbance | None = None

    def __check_init__(self) -> None:
        _kinds.instance("robot", self.robot, Disturbance, may_be_none=True)

    @property
    def moves_robot(self) -> bool:
        """Whether the robot itself is disturbed."""
        return self.robot is not None

    def draw(self, dynamics: Dynamics, horizon: int, num_outcomes: int, *, key: Key) -> Any:
        """Return a random key per outcome, equal at every step, and the draws for the robot."""
        # One key per outcome keeps the obstacles of an outcome consistent over the horizon. Keys
        # instead of obstacles, because a draw is made without the belief.
        first, second = jax.random.split(key)
        keys = jnp.broadcast_to(jax.random.split(first, num_outcomes), (horizon, num_outcomes))
        if self.robot is None:
            return keys, ()
        return keys, self.robot.draw(dynamics, horizon, num_outcomes, key=second)

    def step_at(
        self,
        dynamics: Dynamics,
        state: StateVector,
        control: ControlVector,
        t: Scalar,
        dt: Scalar,
        drawn: Any,
    ) -> StateVector:
        """Return the state (nx,) after a step, disturbed if `robot` is given."""
        if self.robot is None:
            return dynamics.step_at(state, control, t, dt)
        return self.robot.step_at(dynamics, state, control, t, dt, drawn[1])

    def belief(self, belief: Any, drawn: Any) -> Any:
        """Return the belief with the drawn obstacles."""
        obstacles = part(belief, "obstacles").sample(drawn[0])
        return eqx.tree_at(lambda known: known.obstacles, belief, obstacles)

    def check(self, dynamics: Dynamics, num_outcomes: int) -> None:
        """Raise a `ValueError` if the disturbance of the robot does not fit the model."""
        if self.robot is not None:
            self.robot.check(dynamics, num_outcomes)


def _deviations(value: Vector) -> Array:
    if not isinstance(value, jax.core.Tracer):
        array = _checks.floats("std", value, "a vector of numbers >= 0")
        if array.ndim != 1 or not (np.isfinite(array) & (array >= 0)).all():
            raise ValueError(f"std is {value!r}; accepted: a vector of numbers >= 0")
        value = array
    return jnp.asarray(value, jnp.float32)


def _check_size(std: Array, size: int, dynamics: Dynamics) -> None:
    if std.shape != (size,):
        raise ValueError(
            f"std has shape {std.shape}; accepted: ({size},) for {type(dynamics).__name__}"
        )
