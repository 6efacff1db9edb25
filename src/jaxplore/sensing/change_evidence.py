"""Likelihood ratio of a change in a cell against a known map, from the range of each beam."""

import math
from typing import NamedTuple

import jax.numpy as jnp
from jax.scipy.special import erf
from jax.scipy.stats import norm
from jaxtyping import Array, Bool, Float

from jaxplore._types import Scalar
from jaxplore.geometry.rays import RayCells

SHORT = 1e-2
"""Length of a way through a cell below which its middle stands for all of it [standard
deviations]."""
REACH = 4.0
"""A beam that ends more than this many standard deviations before a cell says nothing about it."""


class BeamModel(NamedTuple):
    """Density of the range of a beam.

    With probability `1 - outliers` the beam meets what the map says, and the range has Gaussian
    noise. Otherwise the range is uniform up to the greatest one, or nothing returns, with equal
    shares.

    Source: the beam model of Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, section 6.3.

    Args:
        noise: standard deviation of a range [m].
        max_range: greatest range [m].
        outliers: probability that a range says nothing, in (0, 1).
    """

    noise: Scalar
    max_range: float
    outliers: Scalar

    @property
    def stray(self) -> Scalar:
        """Density of a stray range [1/m]."""
        return 0.5 * self.outliers / self.max_range

    def as_known(
        self,
        ranges: Float[Array, " B"],
        is_return: Bool[Array, " B"],
        expected: Float[Array, " B"],
        is_wall: Bool[Array, " B"],
    ) -> Float[Array, " B"]:
        """Return the log-density of each range if the world is as the map says.

        `expected` is the distance to the first cell that is not free on the map [m], infinite if
        there is none. `is_wall` tells whether that cell is occupied. One that is unknown, and all
        behind it, may hold anything: the density is that of what explains the range best, from a
        surface at the begin of the cell to nothing at all. So a change in front of it is never
        claimed for what the cell holds.
        """
        is_met = expected < self.max_range
        mean = jnp.where(is_met, expected, 0.0)
        mean = jnp.where(is_wall, mean, jnp.maximum(mean, ranges))
        hit = norm.pdf(ranges, mean, self.noise)
        density = jnp.where(is_met, (1.0 - self.outliers) * hit, 0.0) + self.stray
        none = jnp.where(is_met & is_wall, 0.0, 1.0 - self.outliers) + 0.5 * self.outliers
        return jnp.log(jnp.where(is_return, density, none))

    def with_obstacle(
        self,
        ranges: Float[Array, " B"],
        entry: Float[Array, "B N"],
        exit_: Float[Array, "B N"],
    ) -> Float[Array, "B N"]:
        """Return the log-density of each range, of a beam that ends somewhere in each cell.

        A beam enters a cell at `entry` [m], where it leaves the one before, and leaves at `exit_`.
        """
        # A cell is entered where the one before is left, so each edge is evaluated once.
        edges = jnp.concatenate([entry[:, :1], exit_], axis=1)
        below = erf((ranges[:, None] - edges) / (math.sqrt(2.0) * self.noise))
        # Rounding may give a difference below 0, of which the logarithm is not a number.
        inside = jnp.maximum(0.5 * (below[:, :-1] - below[:, 1:]), 0.0)
        length = exit_ - entry
        # Where a beam cuts a corner, the difference is too small for its rounding.
        is_short = length < SHORT * self.noise
        mean = inside / jnp.where(is_short, 1.0, length)
        within = jnp.where(
            is_short, norm.pdf(ranges[:, None], 0.5 * (entry + exit_), self.noise), mean
        )
        return jnp.log((1.0 - self.outliers) * within + self.stray)

    def without_wall(
        self,
        ranges: Float[Array, " B"],
        is_return: Bool[Array, " B"],
        expected: Float[Array, " B"],
    ) -> Float[Array, " B"]:
        """Return the log-density of each range if the expected wall is gone.

        The beam then returns from somewhere behind it or not at all, with equal shares. On the map
        the wall is at the distance `expected` [m].
        """
        share = 0.5 * (1.0 - self.outliers)
        density = share * self._beyond(ranges, expected) + self.stray
        return jnp.log(jnp.where(is_return, density, share + 0.5 * self.outliers))

    def _beyond(
        self, ranges: Float[Array, " B"], expected: Float[Array, " B"]
    ) -> Float[Array, " B"]:
        """Return the uniform density [1/m] of ranges between an expected and the greatest one."""
        room = jnp.maximum(self.max_range - expected, self.noise)
        return jnp.where(ranges > expected, 1.0 / room, 0.0)


class Evidence(NamedTuple):
    """Log-likelihood ratios (B, N) of each beam for each of its cells; 0 where it says nothing.

    Args:
        change: for a free cell, that something is in it; for the wall that a beam meets first,
            that it is gone.
        person: that somebody is in the cell.
    """

    change: Float[Array, "B N"]
    person: Float[Array, "B N"]


def beam_evidence(
    model: BeamModel,
    cells: RayCells,
    is_free: Bool[Array, "B N"],
    is_occupied: Bool[Array, "B N"],
    ranges: Float[Array, " B"],
    is_return: Bool[Array, " B"],
    resolution: float,
) -> Evidence:
    """Return the log-likelihood ratios of changes against a known map.

    The ratio of a cell is that of the range's density with the change to its density without. A
    beam that ended at a moving obstacle, before the greatest range and without a return, is
    evidence of a person alone. The cells of each beam are in order, nearest first.
    """
    entry, exit_ = cells.entry * resolution, cells.exit * resolution
    blocks = cells.is_crossed & ~is_free
    expected = jnp.where(blocks, entry, jnp.inf).min(axis=-1)
    is_first = blocks & (entry == expected[:, None])
    is_wall = (is_first & is_occupied).any(axis=-1)
    # An infinite distance would make the densities NaN.
    bounded = jnp.minimum(expected, model.max_range)
    # A range of 0 is no measurement.
    met_person = ~is_return & (ranges > 0.0) & (ranges < model.max_range)
    known = model.as_known(ranges, is_return, jnp.where(is_wall, bounded, expected), is_wall)
    present = model.with_obstacle(ranges, entry, exit_)
    gone = model.without_wall(ranges, is_return, bounded)
    # A beam that ended before a cell did not look into it. One without a return passed it.
    is_beyond = ranges[:, None] >= entry - REACH * model.noise
    is_open = cells.is_crossed & is_free & (entry < expected[:, None]) & is_beyond
    is_open &= entry < model.max_range
    is_gone = is_first & is_occupied & is_beyond
    nothing = jnp.log(0.5 * model.outliers)
    ratio = jnp.where(is_return[:, None], present, nothing) - known[:, None]
    ratio = jnp.where(is_open, ratio, 0.0)
    change = jnp.where(is_gone, (gone - known)[:, None], ratio)
    change = jnp.where(met_person[:, None], 0.0, change)
    # A person stands where a beam that a moving obstacle ended would be stray otherwise.
    stopped = jnp.where(is_open, present - jnp.log(model.stray), 0.0)
    passed = jnp.where(is_open, jnp.log(model.outliers), 0.0)
    person = jnp.where(met_person[:, None], stopped, passed)
    return Evidence(change, person)
