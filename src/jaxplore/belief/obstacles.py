"""Known moving obstacles, their uncertainty and their prediction."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _kinds
from jaxplore._checks import array, one_each, scalar
from jaxplore._covariances import covariances
from jaxplore._types import ArrayLike, Key, Rows, Scalar, Vector
from jaxplore.geometry.outlines import Outlines
from jaxplore.geometry.vectors import root

FRESH = 0.5
"""Age at which a plan is no longer believed [s]: its sender has planned anew many times since."""
FAR = 1e9
"""Predicted x and y of an obstacle that is not known: far beyond any cost's reach [m]."""


class Plans(NamedTuple):
    """Positions that N obstacles plan to pass, each at equal steps of time.

    Args:
        positions: (N, T, 2) planned positions; row i is due `i * period` after the plan was made
            [m].
        period: time between the rows [s].
        age: (N,) time since each plan was made [s]; infinite without a plan.
    """

    positions: Float[Array, "N T 2"]
    period: Scalar
    age: Float[Array, " N"]

    @classmethod
    def unknown(cls, number: int, steps: int, period: Scalar) -> "Plans":
        """Return no plans, of so many rows, for so many obstacles."""
        return cls(jnp.zeros((number, steps, 2)), period, jnp.full(number, jnp.inf, jnp.float32))

    @property
    def is_fresh(self) -> Bool[Array, " N"]:
        """Whether each plan is young enough to be believed."""
        return self.age < FRESH

    def shift(self, t: Scalar) -> Float[Array, "N 2"]:
        """Return how far each obstacle moves within `t` seconds from now [m].

        The difference of two planned positions, not a position: what was measured since the plan
        was made corrects where it begins. At its end an obstacle stays.
        """
        return self._at(self.age + t) - self._at(self.age)

    def advance(self, elapsed: Scalar) -> "Plans":
        """Return the plans `elapsed` seconds later."""
        return self._replace(age=self.age + elapsed)

    def update(self, positions: Float[Array, "N T 2"], is_heard: Bool[Array, " N"]) -> "Plans":
        """Return the plans with new positions [m], made now, of the obstacles that are heard."""
        return self._replace(
            positions=jnp.where(is_heard[:, None, None], positions, self.positions),
            age=jnp.where(is_heard, 0.0, self.age),
        )

    def _at(self, time: Float[Array, " N"]) -> Float[Array, "N 2"]:
        """Return the planned positions (N, 2) a time after each plan was made [m]."""
        size = self.positions.shape[1]
        row = jnp.clip(jnp.where(self.is_fresh, time, 0.0) / self.period, 0.0, size - 1.0)
        # The weights of linear interpolation, of which two are not 0. A sum over all rows is one
        # short loop in a compiled rollout, where reading two rows by their number is several.
        weight = jnp.maximum(1.0 - jnp.abs(row[:, None] - jnp.arange(size, dtype=jnp.float32)), 0.0)
        return jnp.sum(weight[:, :, None] * self.positions, axis=1)


class Obstacles(eqx.Module):
    """Positions, velocities, turn rates and uncertainty of N moving obstacles.

    Each moves with constant velocity and constant turn rate. The n-th turns with the rate w about
    its centre p, whose velocity v turns with it. At time t

        p(t) = p + t (s v + c J v),   s = sin(w t) / (w t),   c = (1 - cos(w t)) / (w t)

    with J a quarter turn to the left: an arc, or for w = 0 a line; it stands still where v = 0 as
    well. Its position becomes less certain with the time a since it was measured, to first order in
    the errors of p, v and w:

        C(t) = C + (growth (a + t))^2 I + turn_growth^2 d d^T,   d = dp / dw over the time a + t

    (The constant-turn model with known rate of Li and Jilkov, "Survey of maneuvering target
    tracking. Part I: dynamic models", IEEE TAES 2003, section V.B.1. Its errors here are unknown
    constants, not white noise: they do not average out over time.)

    An unknown obstacle, one that was never seen or is forgotten, is predicted far away (`FAR`),
    without uncertainty or extent. So it costs nothing, whatever its numbers are.

    One that has told its plan moves along it instead, as long as the plan is fresh (`Plans`).

    A tracker starts with `unseen` and calls `update`.

    All fields are array leaves: other obstacles of the same number do not recompile.

    Args:
        outlines: present outlines.
        velocities: (N, 2) velocities of the centres [m/s]; 0 when absent.
        turn_rates: (N,) turn rates, or one number [rad/s], positive to the left. When this and
            `turn_growth` are absent, all move straight, which is faster to predict.
        centres: (N, 2) about which they turn [m]; the middles of their bounding boxes when absent.
        std: standard deviation of the measured positions along either axis, (N,) or one number [m];
            0, exact, when absent.
        covariance: (N, 2, 2) covariances of the positions, or one (2, 2) for all [m^2]; instead of
            `std`.
        growth: standard deviation of the velocity along either axis, (N,) or one number [m/s].
        turn_growth: standard deviation of the turn rate, (N,) or one number [rad/s]; 0 when absent.
        age: time since the last measurement, (N,) or one number [s]; 0 when absent.
        is_known: (N,) whether each obstacle is known: false if never seen, or forgotten; all are
            known when absent.
        memory: time without a measurement after which `update` forgets an obstacle [s].
        plans: plans that the obstacles have told; none when absent.

    Raises:
        ValueError: shapes that do not fit, numbers that are not finite, a negative deviation or
            age, a covariance that is not symmetric and positive semidefinite, `std` beside it, a
            memory that is not positive.
    """

    outlines: Outlines
    velocities: Float[Array, "N 2"]
    turn_rates: Float[Array, " N"] | None
    centres: Float[Array, "N 2"]
    covariance: Float[Array, "N 2 2"]
    growth: Float[Array, " N"]
    turn_growth: Float[Array, " N"] | None
    age: Float[Array, " N"] | None
    is_known: Bool[Array, " N"] | None
    memory: Scalar
    plans: Plans | None

    @_kinds.check_arguments
    def __init__(
        self,
        outlines: Outlines,
        velocities: Rows | None = None,
        turn_rates: Vector | None = None,
        *,
        centres: Rows | None = None,
        std: Vector | None = None,
        covariance: Rows | None = None,
        growth: Vector = 0.0,
        turn_growth: Vector | None = None,
        age: Vector | None = None,
        is_known: ArrayLike | None = None,
        memory: ArrayLike = 3.0,
        plans: Plans | None = None,
    ) -> None:
        number = outlines.number
        rows: dict[str, Any] = {"may_be_empty": number == 0}
        self.outlines = outlines
        self.velocities = (
            jnp.zeros((number, 2))
            if velocities is None
            else array("velocities", velocities, (number, 2), **rows)
        )
        # Both are given or both are absent, so that one static fact tells whether predictions turn.
        self.turn_rates = self.turn_growth = None
        if turn_rates is not None or turn_growth is not None:
            turn_rates = 0.0 if turn_rates is None else turn_rates
            turn_growth = 0.0 if turn_growth is None else turn_growth
            self.turn_rates = one_each("turn_rates", turn_rates, number)
            self.turn_growth = one_each("turn_growth", turn_growth, number, at_least=0.0)
        self.centres = (
            outlines.centres if centres is None else array("centres", centres, (number, 2), **rows)
        )
        std = 0.0 if std is None and covariance is None else std
        self.covariance = covariances(std, covariance, number, may_be_zero=True)
        self.growth = one_each("growth", growth, number, at_least=0.0)
        self.age = None if age is None else one_each("age", age, number, at_least=0.0)
        if isinstance(is_known, (list, tuple)):
            for known in is_known:
                _kinds.flag("is_known", known)
        self.is_known = None if is_known is None else jnp.array(is_known, bool)
        if self.is_known is not None and self.is_known.shape != (number,):
            raise ValueError(f"is_known has shape {self.is_known.shape}; accepted: ({number},)")
        self.memory, self.plans = scalar("memory", memory, above=0.0), plans

    @classmethod
    def unseen(cls, radii: Vector, growth: Vector = 0.2, memory: ArrayLike = 3.0) -> "Obstacles":
        """Return the initial obstacles of a tracker: discs that have not been seen yet.

        Args:
            radii: (N,) radii [m]; N = 0 is accepted.
            growth: standard deviation of the velocity along either axis, (N,) or one number [m/s].
            memory: time without a measurement after which an obstacle is forgotten [s]. It may be
                anywhere by then, and a robot that avoids all of its possible positions would be
                driven into walls.

        Raises:
            ValueError: radii that are not N finite numbers >= 0, a negative growth, a memory that
                is not positive.
        """
        sizes = array("radii", radii, ("N",), at_least=0.0, may_be_empty=True)
        number = sizes.shape[0]
        # With arrays for `age` and `is_known`, `update` does not change the pytree's structure.
        return cls(
            Outlines.discs(jnp.zeros((number, 2)), sizes),
            growth=growth,
            age=0.0,
            is_known=jnp.zeros(number, bool),
            memory=memory,
        )

    def __add__(self, other: "Obstacles") -> "Obstacles":
        """Concatenate two sets of obstacles; `memory` is that of `self`."""
        both = (self, other)
        names = ("velocities", "centres", "covariance", "growth")
        merged: dict[str, Any] = {
            name: jnp.concatenate([getattr(each, name) for each in both]) for name in names
        }
        if self.turn_rates is not None or other.turn_rates is not None:
            turns = zip(self._turns, other._turns, strict=True)
            merged["turn_rates"], merged["turn_growth"] = map(jnp.concatenate, turns)
        if self.is_known is not None or other.is_known is not None:
            merged["is_known"] = jnp.concatenate([each._known for each in both])
        if self.age is not None or other.age is not None:
            merged["age"] = jnp.concatenate([each._age for each in both])
        return dataclasses.replace(self, outlines=self.outlines + other.outlines, **merged)

    @property
    def extents(self) -> Float[Array, " N"]:
        """Radii of the circles about the centres that hold the outlines [m]."""
        away = self.outlines.corners - self.centres[:, None]
        square = jnp.max(jnp.sum(away * away, axis=-1), axis=-1)
        # The root is of 0 at the centre of a disc.
        return self._if_known(root(square) + self.outlines.radii, 0.0)

    @property
    def speeds(self) -> Float[Array, " N"]:
        """Speeds of the centres (N,) [m/s]; 0 of those that are not known."""
        return self._if_known(jnp.hypot(*self.velocities.T), 0.0)

    def predict_centres(self, t: Scalar) -> Float[Array, "N 2"]:
        """Predict the centres `t` seconds from now (N, 2) [m]."""
        return self._if_known(self._centres_at(t), FAR)

    def predict(self, t: Scalar) -> Outlines:
        """Predict the outlines `t` seconds from now."""
        corners = self._corners_at(t, self._centres_at(t))
        radii = self._if_known(self.outlines.radii, 0.0)
        return Outlines(self._if_known(corners, FAR), radii)

    def predict_covariance(self, t: Scalar) -> Float[Array, "N 2 2"]:
        """Predict the covariance of the centres `t` seconds from now (N, 2, 2) [m^2]."""
        drift = (self.growth * self._time_at(t)) ** 2
        covariance = self.covariance + drift[:, None, None] * jnp.eye(2)
        if self.turn_growth is not None:
            per_turn = self._slope_at(t)
            square = (self.turn_growth**2)[:, None, None]
            covariance = covariance + square * per_turn[:, :, None] * per_turn[:, None, :]
        return self._if_known(covariance, 0.0)

    def deviation(self, t: Scalar) -> Float[Array, " N"]:
        """Predict the standard deviation (N,) of the centres `t` seconds from now [m].

        It is the greatest over all directions: the root of the greatest eigenvalue of C(t).
        """
        covariance = self.predict_covariance(t)
        a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
        return jnp.sqrt(0.5 * (a + c) + jnp.hypot(0.5 * (a - c), b))

    def advance(self, elapsed: Scalar) -> "Obstacles":
        """Advance the obstacles by `elapsed` seconds without a measurement.

        They move as predicted and their age grows by `elapsed`. Those that were seen by a tracker
        are forgotten when their age exceeds `memory`.
        """
        centres, age = self._centres_at(elapsed), self._age + elapsed
        velocities = self.velocities
        if self.turn_rates is not None:
            velocities = _rotate(velocities, elapsed * self.turn_rates)
        return dataclasses.replace(
            self,
            outlines=Outlines(self._corners_at(elapsed, centres), self.outlines.radii),
            centres=centres,
            velocities=velocities,
            age=age,
            plans=None if self.plans is None else self.plans.advance(elapsed),
            is_known=None if self.is_known is None else self.is_known & (age <= self.memory),
        )

    def update(
        self,
        measured_positions: Float[Array, "N 2"],
        measured_velocities: Float[Array, "N 2"],
        is_seen: Bool[Array, " N"],
        position_std: Scalar,
        elapsed: Scalar,
    ) -> "Obstacles":
        """Advance the obstacles by `elapsed` seconds and apply a tracker's measurements.

        A measured obstacle takes the measured position and velocity. The others move as
        predicted and are forgotten when their age exceeds `memory`. A measurement that is not
        finite is ignored.

        Args:
            measured_positions: (N, 2) measured positions of the centres [m].
            measured_velocities: (N, 2) measured velocities of the centres [m/s].
            is_seen: (N,) whether each obstacle is measured.
            position_std: standard deviation of a measured position along either axis [m].
            elapsed: time since the last update [s].
        """
        measured = jnp.concatenate([measured_positions, measured_velocities], axis=-1)
        is_measured = is_seen & jnp.isfinite(measured).all(axis=-1)
        takes = is_measured[:, None]
        later = self.advance(elapsed)
        centres = jnp.where(takes, measured_positions, later.centres)
        age = jnp.where(is_measured, 0.0, later._age)
        exactness = position_std * position_std * jnp.eye(2)
        return dataclasses.replace(
            self,
            outlines=Outlines(self._corners_at(elapsed, centres), self.outlines.radii),
            centres=centres,
            velocities=jnp.where(takes, measured_velocities, later.velocities),
            # As of the last measurement: `predict_covariance` adds the growth since then.
            covariance=jnp.where(takes[:, None], exactness, self.covariance),
            age=age,
            is_known=(self._known | is_measured) & (age <= self.memory),
            plans=later.plans,
        )

    def sample(self, key: Key) -> "Obstacles":
        """Sample one possible truth: positions, velocities and turn rates without uncertainty."""
        number = self.outlines.number
        first, second, third = jax.random.split(key, 3)
        shift = jax.random.normal(first, (number, 2))
        faster = self.growth[:, None] * jax.random.normal(second, (number, 2))
        rates, turn_growth = self._turns
        turn = turn_growth * jax.random.normal(third, (number,))
        off = jnp.einsum("nij,nj->ni", _root(self.covariance), shift)
        velocities = self.velocities
        if self.age is not None:
            # The errors of velocity and turn rate are constants: they have acted since the
            # measurement, `age` ago.
            off = off + self.age[:, None] * faster
            if self.turn_rates is not None:
                off = off + turn[:, None] * self._slope_at(jnp.zeros(()))
                velocities = _rotate(velocities, self.age * turn)
        return dataclasses.replace(
            self,
            outlines=Outlines(self.outlines.corners + off[:, None], self.outlines.radii),
            velocities=velocities + faster,
            turn_rates=rates + turn,
            centres=self.centres + off,
            covariance=jnp.zeros_like(self.covariance),
            growth=jnp.zeros(number),
            turn_growth=jnp.zeros(number),
            age=None,
        )

    def _if_known(self, values: Array, otherwise: float) -> Array:
        """Return values (N, ...), with `otherwise` for unknown obstacles."""
        if self.is_known is None:
            return values
        rows = self.is_known.reshape(-1, *[1] * (values.ndim - 1))
        return jnp.where(rows, values, otherwise)

    @property
    def _turns(self) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
        """Turn rates and their standard deviations (N,) [rad/s]."""
        if self.turn_rates is None or self.turn_growth is None:
            return jnp.zeros_like(self.growth), jnp.zeros_like(self.growth)
        return self.turn_rates, self.turn_growth

    @property
    def _known(self) -> Bool[Array, " N"]:
        return jnp.ones_like(self.growth, bool) if self.is_known is None else self.is_known

    @property
    def _age(self) -> Float[Array, " N"]:
        return jnp.zeros_like(self.growth) if self.age is None else self.age

    def _time_at(self, t: Scalar) -> Float[Array, "*N"]:
        """Return the time between the measurement and `t` seconds from now [s]."""
        return t if self.age is None else self.age + t

    def _centres_at(self, t: Scalar) -> Float[Array, "N 2"]:
        """Predict the centres (N, 2), those of unknown obstacles included [m]."""
        if self.plans is not None:
            shift = jnp.where(
                self.plans.is_fresh[:, None], self.plans.shift(t), t * self.velocities
            )
            return self.centres + shift
        if self.turn_rates is None:
            return self.centres + t * self.velocities
        # The chord of the arc has the length v t sinc(w t / 2), which has no pole at w = 0, and is
        # rotated by w t / 2 from the present velocity.
        half = 0.5 * t * self.turn_rates
        chord = t * jnp.sinc(half / jnp.pi)
        return self.centres + chord[:, None] * _rotate(self.velocities, half)

    def _corners_at(self, t: Scalar, centres: Float[Array, "N 2"]) -> Float[Array, "N V 2"]:
        """Rotate the corners (N, V, 2) by the predicted turn and place them around centres [m]."""
        corners = self.outlines.corners - self.centres[:, None]
        if self.turn_rates is not None:
            turn = jax.vmap(_rotate, in_axes=(1, None), out_axes=1)
            corners = turn(corners, t * self.turn_rates)
        return corners + centres[:, None]

    def _slope_at(self, t: Scalar) -> Float[Array, "N 2"]:
        """Return d, the derivative of the predicted centres by the turn rates (N, 2) [m s]."""
        time = self._time_at(t)
        rates, _ = self._turns
        half = 0.5 * time * rates
        # The chord of the arc since the measurement has the length v t sinc(w t / 2) and is
        # rotated by w t / 2 from the measured velocity. `velocities` holds the present one, which
        # has turned since by w times the age.
        stretch = 0.5 * time * time * _sinc_slope(half)
        swing = 0.5 * time * time * jnp.sinc(half / jnp.pi)
        along = half if self.age is None else half - self.age * rates
        ahead, beside = (
            _rotate(self.velocities, along),
            _rotate(self.velocities, along + 0.5 * jnp.pi),
        )
        return stretch[:, None] * ahead + swing[:, None] * beside


def _rotate(vectors: Float[Array, "N 2"], angles: Float[Array, " N"]) -> Float[Array, "N 2"]:
    cos, sin = jnp.cos(angles), jnp.sin(angles)
    x, y = vectors[:, 0], vectors[:, 1]
    return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _sinc_slope(angle: Float[Array, " N"]) -> Float[Array, " N"]:
    """Return the derivative of sin(a) / a."""
    is_small = jnp.abs(angle) < 0.1
    safe = jnp.where(is_small, 1.0, angle)
    square = angle * angle
    # Near 0 the two terms cancel. The series has an error below 1e-10 there.
    series = angle * (-1.0 / 3.0 + square * (1.0 / 30.0 - square / 840.0))
    return jnp.where(is_small, series, (jnp.cos(safe) - jnp.sin(safe) / safe) / safe)


def _root(covariance: Float[Array, "N 2 2"]) -> Float[Array, "N 2 2"]:
    """Return the symmetric square roots (N, 2, 2), (C + s I) / sqrt(tr C + 2 s), s^2 = det C."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    # Rounding can make the determinant of a singular covariance negative.
    root = jnp.sqrt(jnp.maximum(a * c - b * b, 0.0))
    size = a + c + 2.0 * root
    scale = jnp.where(size > 0.0, 1.0 / jnp.sqrt(jnp.where(size > 0.0, size, 1.0)), 0.0)
    return scale[:, None, None] * (covariance + root[:, None, None] * jnp.eye(2))
