"""Domain randomisation: a true robot that differs from episode to episode."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_DELAY
from jaxplore._types import ControlVector, Count, Key, Scalar, StateVector, Vector
from jaxplore.dynamics.base import Dynamics
from jaxplore.parameters import find_parameter, get_parameters, set_parameters, split_index
from jaxplore.parts.variation.plant import as_plant, physical_part
from jaxplore.simulation.disturbances import Disturbance, Place

SAME = (1.0, 1.0)
"""Interval of a factor without variation."""
NONE = (0.0, 0.0)
"""Interval of a loss or a deviation without variation."""
_EPISODE, _CONTROL_NOISE, _POSE_NOISE = 2**31 + 1, 2**31 + 2, 2**31 + 3
"""What is folded into a key; no step has such a number, so the loop's own draws stay the same."""


class Drawn(NamedTuple):
    """The variation of one episode.

    Args:
        parameters: value of each varied parameter of the model, by its path.
        gain: (nu,) factor on each control.
        slip: share of the displacement that is lost.
        turn_slip: share of the change of yaw that is lost.
        control_delay: number of control periods between a command and its effect.
        control_noise: standard deviation of each control, as a share of half its range.
        position_noise: standard deviation of the observed x and y [m].
        heading_noise: standard deviation of the observed yaw [rad].
    """

    parameters: dict[str, Scalar]
    gain: ControlVector
    slip: Scalar
    turn_slip: Scalar
    control_delay: Count
    control_noise: Scalar
    position_noise: Scalar
    heading_noise: Scalar


class Variation(Disturbance):
    """Distributions from which the true robot of each episode is drawn (domain randomisation).

    Every argument is an interval (low, high), from which an episode draws a number uniformly, by
    the key of its run. The controller keeps its model, so that it plans with a wrong one. The
    intervals are arrays and the draws part of the state: no episode compiles again, and `vmap`
    over keys has a robot in each run.

    Args:
        parameters: intervals of parameters of the robot's model by their path, such as `drag`,
            `mass` or `control_max[0]`: see `jaxplore.get_parameters`. The true robot clips commands
            to its own bounds.
        gain: factor on the effect of each control, drawn for each. Where controls are
            accelerations, a gain is one over the factor of the mass.
        slip: share of the displacement that is lost by slip.
        turn_slip: share of the turn that is lost by slip.
        control_delay: number of control periods between a command and its effect; static. It adds
            to that of `Faults`.
        control_noise: standard deviation of noise on each control, new in every control period, as
            a share of half its range.
        position_noise: standard deviation of the observed x and y, new in every control period
            [m].
        heading_noise: standard deviation of the observed yaw, likewise [rad].

    Source: Tobin et al., "Domain randomization for transferring deep neural networks from
    simulation to the real world", IROS 2017; of dynamics: Peng et al., "Sim-to-real transfer of
    robotic control with dynamics randomization", ICRA 2018.

    Raises:
        ValueError: an interval that is not two finite numbers, the low one first; a gain that is
            not positive, a slip outside [0, 1), a delay that is no whole number, a negative delay
            or deviation. In a scenario a parameter that the robot does not have, or an interval
            beyond zero.
    """

    name: ClassVar[str] = "variation"
    is_varying: ClassVar[bool] = True

    parameters: dict[str, Float[Array, "2"]]
    gain: Float[Array, "2"]
    slip: Float[Array, "2"]
    turn_slip: Float[Array, "2"]
    control_noise: Float[Array, "2"]
    position_noise: Float[Array, "2"]
    heading_noise: Float[Array, "2"]
    control_delay: tuple[int, int] = eqx.field(static=True)

    def __init__(
        self,
        parameters: Mapping[str, Vector] | None = None,
        *,
        gain: Vector = SAME,
        slip: Vector = NONE,
        turn_slip: Vector = NONE,
        control_delay: Sequence[int] = (0, 0),
        control_noise: Vector = NONE,
        position_noise: Vector = NONE,
        heading_noise: Vector = NONE,
    ) -> None:
        given = {} if parameters is None else parameters
        if not isinstance(given, Mapping):
            raise ValueError(
                f"parameters is {_kinds.describe(given)}; accepted: intervals (low, high) by the "
                "path of a parameter"
            )
        # Sorted, so that the order of a settings file changes no draw.
        self.parameters = {
            name: _interval(f"parameters[{name!r}]", given[name]) for name in sorted(given)
        }
        self.gain = _interval("gain", gain, least=0.0, is_open=True)
        self.slip = _interval("slip", slip, least=0.0, below=1.0)
        self.turn_slip = _interval("turn_slip", turn_slip, least=0.0, below=1.0)
        self.control_noise = _interval("control_noise", control_noise, least=0.0)
        self.position_noise = _interval("position_noise", position_noise, least=0.0)
        self.heading_noise = _interval("heading_noise", heading_noise, least=0.0)
        self.control_delay = _periods("control_delay", control_delay)

    def check(self, place: Place) -> None:
        """Check that the robot has the parameters, and that the intervals have their sign."""
        known = get_parameters(place.robot)
        for name, interval in self.parameters.items():
            path, index = split_index(name)
            value = known[find_parameter(place.robot, path)]
            accepted = f"{path}[0] to {path}[{value.size - 1}]"
            if index is None and value.size != 1:
                raise ValueError(
                    f"parameter {name} has {value.size} elements; accepted: {accepted}"
                )
            if index is not None and index >= value.size:
                raise ValueError(f"parameter {name} has no element {index}; accepted: {accepted}")
            if _kinds.is_traced(interval, value):
                continue
            nominal = float(np.asarray(value).reshape(-1)[index or 0])
            low, high = np.asarray(interval).tolist()
            if (nominal > 0.0 > low) or (nominal < 0.0 < high):
                raise ValueError(
                    f"parameters[{name!r}] is {[low, high]} for a robot with {nominal:g}; "
                    f"accepted: numbers {'>=' if nominal > 0.0 else '<='} 0"
                )

    @property
    def longest_delay(self) -> int:
        """Longest delay of commands in any episode [control periods]."""
        return self.control_delay[1]

    def draw(self, key: Key | None, model: Dynamics) -> Drawn:
        """Draw the variation of an episode."""
        number = physical_part(model).control_size
        scalars = {
            "slip": self.slip,
            "turn_slip": self.turn_slip,
            "control_noise": self.control_noise,
            "position_noise": self.position_noise,
            "heading_noise": self.heading_noise,
        }
        low, high = self.control_delay
        size = len(self.parameters) + len(scalars) + number + 1
        shares = jnp.full(size, 0.5)
        if key is not None:
            shares = jax.random.uniform(jax.random.fold_in(key, _EPISODE), (size,))
        # The numbers are drawn in this order: parameters come last, so that a further one leaves
        # the draws of the others as they are only if its name is the last.
        drawn = {
            name: _interpolate(interval, shares[i])
            for i, (name, interval) in enumerate(scalars.items())
        }
        rest = shares[len(scalars) :]
        periods = jnp.floor(rest[0] * (high - low + 1)).astype(jnp.int32)
        values = rest[1 + number :]
        return Drawn(
            parameters={
                name: _interpolate(interval, values[i])
                for i, (name, interval) in enumerate(self.parameters.items())
            },
            gain=self.gain[0] + (self.gain[1] - self.gain[0]) * rest[1 : 1 + number],
            control_delay=low + jnp.minimum(periods, high - low),
            **drawn,
        )

    def true_robot(self, model: Dynamics, drawn: Drawn, key: Key) -> Dynamics:
        """Return the true robot of a step."""
        known = get_parameters(model)
        values: dict[str, Array] = {}
        for name, value in drawn.parameters.items():
            path, index = split_index(name)
            full = find_parameter(model, path)
            array = values.get(full, known[full])
            flat = array.reshape(-1).at[index or 0].set(value)
            values[full] = flat.reshape(array.shape)
        varied = set_parameters(model, values) if values else model
        physical = physical_part(varied)
        normal = jax.random.normal(jax.random.fold_in(key, _CONTROL_NOISE), drawn.gain.shape)
        noise = drawn.control_noise * physical.control_half_range * normal
        return as_plant(varied, drawn.gain, noise, drawn.slip, drawn.turn_slip)

    def observe(
        self,
        model: Dynamics,
        state: StateVector,
        last: StateVector,
        drawn: Drawn,
        time: Scalar,
        period: Scalar,
        key: Key,
    ) -> StateVector:
        """Return a state (nx,) with noise of position and yaw."""
        stds = {"x": drawn.position_noise, "y": drawn.position_noise, "yaw": drawn.heading_noise}
        std = jnp.stack([stds.get(name, jnp.zeros(())) for name in model.state_names])
        normal = jax.random.normal(jax.random.fold_in(key, _POSE_NOISE), state.shape)
        return state + std * normal

    def delay(self, drawn: Drawn) -> Count:
        """Return the delay of commands in an episode [control periods]."""
        return drawn.control_delay


def _interpolate(interval: Float[Array, "2"], share: Scalar) -> Scalar:
    return interval[0] + (interval[1] - interval[0]) * share


def _interval(
    name: str,
    value: Any,
    *,
    least: float | None = None,
    is_open: bool = False,
    below: float | None = None,
) -> Float[Array, "2"]:
    """Return an interval (2,): the least and the greatest number of a distribution."""
    given = _checks.vector(name, value, 2)
    if _kinds.is_traced(given):
        return given
    low, high = np.asarray(given).tolist()
    is_low = least is not None and (low <= least if is_open else low < least)
    if low > high or is_low or (below is not None and high >= below):
        bounds = "" if least is None else f", {least:g} {'<' if is_open else '<='} low"
        bounds += "" if below is None else f", high < {below:g}"
        raise ValueError(
            f"{name} is [{low:.6g}, {high:.6g}]; accepted: two numbers, low <= high{bounds}"
        )
    return given


def _periods(name: str, value: Any) -> tuple[int, int]:
    """Return an interval of whole numbers."""
    given = tuple(value) if isinstance(value, (tuple, list)) else ()
    if len(given) == 2:
        low, high = (
            _checks.whole_number(name, each, at_least=0, at_most=MOST_DELAY) for each in given
        )
        if low <= high:
            return low, high
    raise ValueError(f"{name} is {value!r}; accepted: two whole numbers, 0 <= low <= high")
