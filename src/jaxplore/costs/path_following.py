"""Costs of following a path whose arc length is part of the state: contouring control.

    J = sum over t of w_c e_c^2 + w_l e_l^2 - w_p dt phi_rate

(Lam, Manzie and Good, "Model predictive contouring control", CDC 2010; Liniger, Domahidi and
Morari, "Optimization-based autonomous racing of 1:43 scale RC cars", OCAM 2015.) The robot chooses
phi as it chooses its controls: `ContouringCost` keeps it beside the point at phi, `LagCost` keeps
that point beside the robot, and `ProgressCost` pulls the point ahead. Without the lag the point
would run away, and the robot would be measured against where it is not.

The objects that plan are the ones that measure: `errors` of a trajectory.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar
from jaxplore.costs import extract
from jaxplore.costs._contact import levers, shifted
from jaxplore.costs.base import Cost
from jaxplore.costs.extract import Extractor
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import Dynamics, State
from jaxplore.dynamics.path_parameter import PathParameter
from jaxplore.geometry.path import Path, PathErrors, errors_at

PHI = extract.component("phi")


class PathErrorCost(Cost):
    """Square of one of the errors of a position beside a path [m^2].

    Args:
        path: to follow.
        position: reads (x, y) of a state; the model's position when absent.
        parameter: reads phi; the component of that name when absent.

    Raises:
        ValueError: when traced, an extractor that returns another shape, a model without phi, one
            whose phi ends before the path does.
    """

    path: Path
    position: Extractor = eqx.field(static=True, default=extract.position)
    parameter: Extractor = eqx.field(static=True, default=PHI)

    @abc.abstractmethod
    def chosen(self, errors: PathErrors) -> Scalar:
        """Return the error that is paid for."""

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the squared error."""
        error = self.error(state)
        return error * error

    def error(self, state: State) -> Scalar:
        """Return the error of a state, with its sign [m]."""
        _check_reach(self.path, state.dynamics)
        phi = extract.extract("parameter", self.parameter, state, ())
        where = extract.extract("position", self.position, state, (2,))
        return self.chosen(self.path.errors(where, phi))

    def errors(self, states: Float[Array, "T nx"], dynamics: Dynamics) -> Float[Array, " T"]:
        """Return the error of each of many states (T,) [m]."""
        return jax.vmap(lambda values: self.error(State(values, dynamics)))(states)


class ContouringCost(PathErrorCost):
    """Square of the distance from a path, measured across it at phi [m^2]:

        e_c = sin(theta) (x - x_phi) - cos(theta) (y - y_phi)

    positive to the right of the path. Arguments and errors are those of `PathErrorCost`.
    """

    def chosen(self, errors: PathErrors) -> Scalar:
        """Return the contouring error [m]."""
        return errors.contouring


class LagCost(PathErrorCost):
    """Square of how far a robot is behind the point of a path at phi, along the path [m^2]:

        e_l = -cos(theta) (x - x_phi) - sin(theta) (y - y_phi)

    positive behind the point. Arguments and errors are those of `PathErrorCost`.
    """

    def chosen(self, errors: PathErrors) -> Scalar:
        """Return the lag error [m]."""
        return errors.lag


class ProgressCost(Cost):
    """What is gained by moving on along the path, negative: `-rate`, the control of that name.

    The rate is the one that is applied, within its bounds: see `PathParameter`.

    Args:
        rate: name of the control [m/s]; static.

    Raises:
        ValueError: when traced, a model without that control.
    """

    rate: str = eqx.field(static=True, default="phi_rate")

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return minus the rate [m/s]."""
        names = state.dynamics.control_names
        if self.rate not in names:
            raise ValueError(
                f"rate is {self.rate!r}, no control of {type(state.dynamics).__name__}; accepted: "
                f"{', '.join(names)}"
            )
        return -control[names.index(self.rate)]


class CorridorCost(Cost):
    """How far a robot is out of the room beside a path:

        ((margin - a)_+ / scale)^2,  a = min over its discs of min(left + e_c, right - e_c) - r

    with r the discs' radius, `left` and `right` the path's half widths at phi and e_c the
    contouring error of a disc's centre. Nothing is paid inside. At a wall that may not be touched
    a small scale makes it steep.

    Args:
        path: with half widths.
        margin: kept beyond the radius [m].
        scale: that costs 1 [m].
        parameter: reads phi; the component of that name when absent.

    Raises:
        ValueError: a negative margin, a scale that is not positive, a path without half widths.
    """

    path: Path
    margin: Scalar
    scale: Scalar
    parameter: Extractor = eqx.field(static=True)

    def __init__(
        self,
        path: Path,
        margin: ArrayLike = 0.0,
        scale: ArrayLike = 0.05,
        parameter: Extractor | None = None,
    ) -> None:
        if not path.has_room:
            raise ValueError("path has no half_widths; accepted: a path with room to keep to")
        self.path = path
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.scale = _checks.scalar("scale", scale, above=0.0)
        self.parameter = PHI if parameter is None else parameter

    def check(self, dynamics: Dynamics) -> None:
        """Raise a `ValueError` if the robot does not fit between the edges."""
        radius, widths = dynamics.footprint.radius, self.path.half_widths
        if _checks.is_traced(radius, self.margin, widths):
            return
        least, needed = float(widths.sum(axis=1).min()), 2.0 * float(radius + self.margin)
        if least < needed:
            raise ValueError(
                f"path is {least:.3g} m wide where it is narrowest; accepted: {needed:.3g} m or "
                f"more, for {type(dynamics).__name__}"
            )

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the squared depth beyond the room."""
        deep = jnp.maximum(self.margin - self.clearance(state), 0.0) / self.scale
        return deep * deep

    def clearance(self, state: State) -> Scalar:
        """Return the least distance of the robot's discs from the edge, negative beyond it [m]."""
        phi = extract.extract("parameter", self.parameter, state, ())
        point, (left, right) = self.path.at(phi), self.path.room(phi)
        room = jnp.full((), jnp.inf)
        for lever in levers(state):
            centre = jnp.stack(shifted(tuple(state.position), lever))
            error = errors_at(point, centre).contouring
            room = jnp.minimum(room, jnp.minimum(left + error, right - error))
        return room - state.dynamics.footprint.radius

    def clearances(self, states: Float[Array, "T nx"], dynamics: Dynamics) -> Float[Array, " T"]:
        """Return the clearance of each of many states (T,) [m]; negative is a violation."""
        return jax.vmap(lambda values: self.clearance(State(values, dynamics)))(states)


def _check_reach(path: Path, dynamics: Dynamics) -> None:
    """Raise a `ValueError` if a model's path parameter cannot reach the end of the path."""
    virtual = dynamics.virtual if isinstance(dynamics, Augmented) else None
    if not isinstance(virtual, PathParameter) or virtual.end is None:
        return
    if _checks.is_traced(virtual.end, path.length):
        return
    end, length = float(virtual.end), float(path.length)
    if length > end * (1.0 + 1e-5):
        raise ValueError(
            f"path is {length:.4g} m long, beyond the bound of its PathParameter; accepted: at "
            f"most {end:.4g} m, its end, or PathParameter.along(path, ...)"
        )
