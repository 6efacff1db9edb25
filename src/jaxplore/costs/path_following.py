"""Costs of contouring control: follow a path whose parameter is part of the state.

    J = sum over t of w_c e_c^2 + w_l e_l^2 - w_p dt phi_rate

(Lam, Manzie and Good, "Model predictive contouring control", CDC 2010; Liniger, Domahidi and
Morari, "Optimization-based autonomous racing of 1:43 scale RC cars", OCAM 2015.) The path parameter
phi is a state with a control of its own. `ContouringCost` keeps the robot close to the path,
`LagCost` keeps the point at phi close to the robot, and `ProgressCost` moves that point forward.
Without the lag the point would run ahead, and the error would be measured at the wrong place.
`StopCost` brings the robot to rest at the end of the path and in its cusps.

The same objects evaluate a finished trajectory: see `errors`.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.costs import extract
from jaxplore.costs._arrival import OVERRUN, overrun
from jaxplore.costs._contact import add_lever, levers, offset
from jaxplore.costs.base import Cost
from jaxplore.costs.extract import Extractor
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import Dynamics, State
from jaxplore.dynamics.path_parameter import PathParameter
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.path import Path, PathErrors, errors_at
from jaxplore.geometry.vectors import length

PHI = extract.component("phi")
NEAR = 1.0
"""Distance from a stop below which it attracts the robot [m]."""
FACING = 0.5
"""Half the cost of facing away from the path, for a robot that does not drive backwards [m]."""
TURNING_REACH = 0.4
"""Distance from the end at which the heading there counts as 1/e of what it does there [m]."""


class PathErrorCost(Cost):
    """Square of one component of the position error relative to a path [m^2].

    Args:
        path: path to follow.
        position: extractor of (x, y); the position of the model when absent.
        parameter: extractor of phi; the state component `phi` when absent.

    Raises:
        ValueError: when traced, an extractor that returns the wrong shape, a model without phi, or
            a model whose phi ends before the path does.
    """

    path: Path
    position: Extractor = eqx.field(static=True, default=extract.position)
    parameter: Extractor = eqx.field(static=True, default=PHI)

    def __check_init__(self) -> None:
        _kinds.instance("path", self.path, Path)
        accepted = "a function of a State"
        _kinds.function("position", self.position, accepted)
        _kinds.function("parameter", self.parameter, accepted)

    @abc.abstractmethod
    def select_error(self, errors: PathErrors) -> Scalar:
        """Select the error component that the cost squares."""

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the squared error."""
        error = self.error(state)
        return error * error

    def error(self, state: State) -> Scalar:
        """Compute the signed error of a state [m]."""
        _check_reach(self.path, state.dynamics)
        phi = extract.extract("parameter", self.parameter, state, ())
        where = extract.extract("position", self.position, state, (2,))
        return self.select_error(self.path.errors(where, phi))

    def errors(self, states: Float[Array, "T nx"], dynamics: Dynamics) -> Float[Array, " T"]:
        """Compute the signed error of each of T states (T,) [m]."""
        return jax.vmap(lambda values: self.error(State(values, dynamics)))(states)


class ContouringCost(PathErrorCost):
    """Square of the distance from a path, measured perpendicular to it at phi [m^2]:

        e_c = sin(theta) (x - x_phi) - cos(theta) (y - y_phi)

    with (x_phi, y_phi) the point of the path at phi and theta its direction there. The error is
    positive to the right of the path. See `PathErrorCost` for arguments and errors.
    """

    def select_error(self, errors: PathErrors) -> Scalar:
        """Return the contouring error [m]."""
        return errors.contouring


class LagCost(PathErrorCost):
    """Square of the distance behind the point of a path at phi, measured along the path [m^2]:

        e_l = -cos(theta) (x - x_phi) - sin(theta) (y - y_phi)

    with (x_phi, y_phi) the point of the path at phi and theta its direction there. The error is
    positive behind the point. See `PathErrorCost` for arguments and errors.
    """

    def select_error(self, errors: PathErrors) -> Scalar:
        """Return the lag error [m]."""
        return errors.lag


class ProgressCost(Cost):
    """Reward for progress along the path, the negative of the control `rate` [m/s].

    The rate is read as applied, within its bounds: see `PathParameter`.

    Args:
        rate: name of the control that moves phi [m/s]; static.

    Raises:
        ValueError: when traced, a model without that control.
    """

    rate: str = eqx.field(static=True, default="phi_rate")

    def __check_init__(self) -> None:
        if not isinstance(self.rate, str):
            given = _kinds.describe(self.rate)
            raise ValueError(f"rate is {given}; accepted: the name of a control")

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the negative rate [m/s]."""
        names = state.dynamics.control_names
        if self.rate not in names:
            raise ValueError(
                f"rate is {self.rate!r}, no control of {type(state.dynamics).__name__}; accepted: "
                f"{', '.join(names)}"
            )
        return -control[names.index(self.rate)]


class StopCost(Cost):
    """Cost of not coming to rest where a path has a stop: at its end, and in its cusps [m].

        min(d, 1 m) + 2 max(s - d, 0) + 2 max(phi - stop, 0)

    d is the distance to the next stop, the greater one of the straight line and of the way of phi,
    and s the distance in which the robot comes to rest with half of its deceleration. So the robot
    brakes in time, also where its braking distance is longer than the horizon. The next stop is
    `Belief.path_stop`, or the end of the path.

    A robot that shall turn after a cusp, `faces`, also pays 0.5 m (1 - cos) of its angle to the
    path. With a heading at the end of the path it pays instead, the more the nearer it is to the
    end,

        n |turn| / pi,   n = exp(-(d / 0.4 m)^2)

    with d the distance to the end and `turn` the angle to that heading, and n is the share of it.

    Args:
        path: path to follow, an open one.
        faces: whether the robot turns to the path, and does not drive backwards along it; static.
        heading: heading at the end of the path [rad]; any when absent.

    Raises:
        ValueError: a closed path, a heading that is not finite.
    """

    path: Path
    faces: bool = eqx.field(static=True)
    heading: Scalar | None

    def __init__(self, path: Path, faces: bool = True, heading: ArrayLike | None = None) -> None:
        self.path, self.faces = path, faces
        self.heading = None if heading is None else _checks.scalar("heading", heading)

    def __check_init__(self) -> None:
        _kinds.instance("path", self.path, Path)
        _kinds.flag("faces", self.faces)
        if self.path.is_closed:
            raise ValueError("path is closed; accepted: an open path, which has an end")

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the cost of the distance, of what is overrun, and of what is skipped."""
        given = getattr(belief, "path_stop", None)
        stop = self.path.length if given is None else given
        phi = PHI(state)
        away = length(*offset(state, self.path.at(stop).position))
        to_go = jnp.maximum(stop - phi, away)
        beyond = overrun(state, to_go) + jnp.maximum(phi - stop, 0.0)
        total = jnp.minimum(to_go, NEAR) + OVERRUN * beyond
        if not self.faces and self.heading is None:
            return total
        facing = self._cost_of_facing(state, phi) if self.faces else jnp.zeros(())
        if self.heading is None:
            return total + facing
        end = self.path.length
        away = jnp.maximum(end - phi, length(*offset(state, self.path.at(end).position)))
        near = jnp.exp(-((away / TURNING_REACH) ** 2))
        turn = jnp.abs(jnp.arctan2(*sin_cos(state.heading - self.heading))) / jnp.pi
        return total + facing + near * (turn - facing)

    def _cost_of_facing(self, state: State, phi: Scalar) -> Scalar:
        point, (sin, cos) = self.path.at(phi), sin_cos(state.heading)
        return FACING * (1.0 - (cos * point.cos + sin * point.sin))


class CorridorCost(Cost):
    """Squared distance of a robot beyond the edges of the corridor around a path:

        ((margin - a)_+ / scale)^2,  a = min over its discs of min(left + e_c, right - e_c) - r

    with a the clearance, r the radius of the discs, `left` and `right` the half widths of the path
    at phi, and e_c the contouring error of a disc's centre. The cost is 0 inside the corridor. At
    walls that must not be touched, a small scale makes the cost steep.

    Args:
        path: path with half widths.
        margin: distance to keep beyond the radius [m].
        scale: distance beyond the edge that costs 1 [m].
        parameter: extractor of phi; the state component `phi` when absent.

    Raises:
        ValueError: a negative margin, a scale that is not positive, a path without half widths.
    """

    path: Path
    margin: Scalar
    scale: Scalar
    parameter: Extractor = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        path: Path,
        margin: ArrayLike = 0.0,
        scale: ArrayLike = 0.05,
        parameter: Extractor | None = None,
    ) -> None:
        if parameter is not None:
            _kinds.function("parameter", parameter, "a function of a State")
        if not path.has_room:
            raise ValueError("path has no half_widths; accepted: a path with room to keep to")
        self.path = path
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.scale = _checks.scalar("scale", scale, above=0.0)
        self.parameter = PHI if parameter is None else parameter

    def check(self, dynamics: Dynamics) -> None:
        """Raise a `ValueError` if the robot does not fit into the corridor."""
        radius, widths = dynamics.footprint.radius, self.path.half_widths
        if _kinds.is_traced(radius, self.margin, widths):
            return
        least, needed = float(widths.sum(axis=1).min()), 2.0 * float(radius + self.margin)
        if least < needed:
            raise ValueError(
                f"path is {least:.3g} m wide where it is narrowest; accepted: {needed:.3g} m or "
                f"more, for {type(dynamics).__name__}"
            )

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the squared distance beyond the edge."""
        deep = jnp.maximum(self.margin - self.clearance(state), 0.0) / self.scale
        return deep * deep

    def clearance(self, state: State) -> Scalar:
        """Compute the least distance of the robot's discs from the edge, negative beyond it [m]."""
        phi = extract.extract("parameter", self.parameter, state, ())
        # The path is read once at phi; all discs are measured against the same point.
        point, (left, right) = self.path.at(phi), self.path.room(phi)
        room = jnp.full((), jnp.inf)
        for lever in levers(state):
            centre = jnp.stack(add_lever(tuple(state.position), lever))
            error = errors_at(point, centre).contouring
            room = jnp.minimum(room, jnp.minimum(left + error, right - error))
        return room - state.dynamics.footprint.radius

    def clearances(self, states: Float[Array, "T nx"], dynamics: Dynamics) -> Float[Array, " T"]:
        """Compute the clearance of each of T states (T,) [m]; negative is a violation."""
        return jax.vmap(lambda values: self.clearance(State(values, dynamics)))(states)


def _check_reach(path: Path, dynamics: Dynamics) -> None:
    """Raise a `ValueError` if a model's path parameter cannot reach the end of the path."""
    virtual = dynamics.virtual if isinstance(dynamics, Augmented) else None
    if not isinstance(virtual, PathParameter) or virtual.end is None:
        return
    if _kinds.is_traced(virtual.end, path.length):
        return
    end, length = float(virtual.end), float(path.length)
    # The tolerance absorbs the rounding of both lengths to float32.
    if length > end * (1.0 + 1e-5):
        raise ValueError(
            f"path is {length:.4g} m long, beyond the bound of its PathParameter; accepted: at "
            f"most {end:.4g} m, its end, or PathParameter.along(path, ...)"
        )
