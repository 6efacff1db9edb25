"""Locomotion of a robot that cannot turn on the spot."""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Scalar
from jaxplore.belief.car_roads import CarGuidance, CarRoadmap, with_headings
from jaxplore.belief.guidance import LAYERS, descent_field
from jaxplore.belief.roadmap import (
    NARROW_PRICE,
    Locomotion,
    Price,
    block_maximum,
    clear_corners,
    double_where_tight,
    fit,
    narrowest,
)
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.footprint import Footprint
from jaxplore.geometry.state_lattice import HEADINGS, NUM_HEADINGS, round_radius
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame

REVERSE_PENALTY = 1.25
"""Factor on the cost of what a car drives backwards.

It pays to turn around for a way of more than about ten metres. Nav2's Smac planner has 2. With 2 a
car stood for ever in one of eleven runs, before its cost had a channel (`with_channel`); 2 was not
measured again with it."""


class CarMotion(eqx.Module):
    """How a robot moves that cannot turn on the spot.

    Args:
        turning_radius: radius of the smallest circle that its position can drive [m].
        footprint: area that it covers.
        can_reverse: whether it can drive backwards; static.
        reversal_cost: price of a change between forwards and backwards [m].
        reverse_penalty: factor on the cost of what is driven backwards.

    Raises:
        ValueError: a radius that is not positive, a negative price, a factor below 1, an argument
            of another class.
    """

    turning_radius: Scalar
    footprint: Footprint
    reversal_cost: Scalar
    reverse_penalty: Scalar
    can_reverse: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        turning_radius: ArrayLike,
        footprint: Footprint,
        *,
        can_reverse: bool = True,
        reversal_cost: ArrayLike = 1.0,
        reverse_penalty: ArrayLike = REVERSE_PENALTY,
    ) -> None:
        self.turning_radius = _checks.scalar("turning_radius", turning_radius, above=0.0)
        self.footprint = footprint
        self.reversal_cost = _checks.scalar("reversal_cost", reversal_cost, at_least=0.0)
        self.reverse_penalty = _checks.scalar("reverse_penalty", reverse_penalty, at_least=1.0)
        self.can_reverse = _kinds.flag("can_reverse", can_reverse)

    def lattice(self, spacing: float, narrow: Scalar | None = None) -> "CarLattice":
        """Return the motions between nodes.

        Args:
            spacing: distance between nodes [m].
            narrow: clearance from which paths lead through narrow passages [m]; none when absent.

        Raises:
            ValueError: a turning radius that is too large for the distance.
        """
        radius = round_radius(float(self.turning_radius), spacing)
        # Whole metres, because the reach is static: similar cars share a compiled program.
        reach = math.ceil(float(np.abs(np.asarray(self.footprint.offsets)).max()))
        prices = (self.reversal_cost, self.reverse_penalty)
        return CarLattice(self.footprint, *prices, narrow, radius, reach, self.can_reverse)


def car_motion(robot: Dynamics) -> CarMotion | None:
    """Return how a robot moves that cannot turn on the spot; None for one that can."""
    radius = float(robot.turning_radius)
    if radius == 0.0:
        return None
    return CarMotion(radius, robot.footprint, can_reverse=robot.can_reverse)


class CarLattice(Locomotion):
    """Motions of a car between the nodes and headings of a lattice.

    Args:
        footprint: area that it covers.
        reversal_cost: price of a change between forwards and backwards [m].
        reverse_penalty: factor on the cost of what is driven backwards.
        narrow: clearance from which paths lead through passages that are too narrow for the
            required clearance, at `NARROW_PRICE` [m]; no such paths when absent. It must be at
            least `narrowest` without corners.
        radius: turning radius [node spacings]; static.
        reach: bound of the distance from its position to its discs [m]; static.
        can_reverse: whether it can drive backwards; static.
    """

    footprint: Footprint
    reversal_cost: Scalar
    reverse_penalty: Scalar
    narrow: Scalar | None
    radius: float = eqx.field(static=True)
    reach: int = eqx.field(static=True)
    can_reverse: bool = eqx.field(static=True)

    def roadmap(
        self,
        clearance: ScalarField,
        required: Scalar,
        stride: int,
        price: Price = double_where_tight,
        factor: Float[Array, "H W"] | None = None,
    ) -> CarRoadmap:
        """Build the lattice of poses in which the car fits; see `Locomotion`."""
        frame = clearance.frame.coarsen(stride, stride / 2.0)
        room, in_middle = self._room(clearance, stride)
        # Motions have no corners that are looked at: a car below half a cell would pass a wall.
        least = narrowest(stride, clearance.frame.resolution, has_corners=False)
        is_open, tightness = fit(room, jnp.maximum(required, least))
        slowness = frame.resolution * price(tightness)
        is_clear = in_middle >= (required if self.narrow is None else self.narrow)
        if self.narrow is not None:
            is_narrow = in_passage(is_open, fit(room, self.narrow)[0])
            slowness = jnp.where(is_narrow, frame.resolution * NARROW_PRICE, slowness)
            is_open = is_open | is_narrow
        slowness = slowness if factor is None else slowness * factor
        return CarRoadmap(
            frame,
            slowness.min(axis=0),
            is_open.any(axis=0),
            clear_corners(clearance, stride),
            slowness,
            is_open,
            is_clear,
            self.reversal_cost,
            self.reverse_penalty,
            self.radius,
            self.can_reverse,
        )

    def level_field(self, frame: GridFrame, shape: tuple[int, int]) -> CarGuidance:
        """Return a field that is 0 everywhere."""
        flat, open_everywhere = jnp.zeros((NUM_HEADINGS, *shape)), jnp.ones(shape, bool)
        roads = CarRoadmap(
            frame,
            flat[0],
            open_everywhere,
            None,
            flat,
            jnp.ones(flat.shape, bool),
            jnp.ones(flat.shape, bool),
            self.reversal_cost,
            self.reverse_penalty,
            self.radius,
            self.can_reverse,
        )
        costs = jnp.zeros((2 if self.can_reverse else 1, *flat.shape))
        return with_headings(descent_field(flat[0], frame, LAYERS), costs, roads, costs)

    def _room(
        self, clearance: ScalarField, stride: int
    ) -> tuple[Float[Array, "N H W"], Float[Array, "N H W"]]:
        """Return the least clearance of the discs by heading, at two places of each block [m]: the
        best cell, and the middle, between the best and the worst one."""
        cell = clearance.frame.resolution
        margin = math.ceil(self.reach / cell) + 1
        # Off the map everything is closed.
        padded = jnp.pad(clearance.values, margin)
        angles = jnp.asarray(HEADINGS, jnp.float32)
        along = jnp.stack([jnp.sin(angles), jnp.cos(angles)], axis=-1)

        def at_heading(direction: Array) -> tuple[Array, Array]:
            def at_disc(ahead: Array) -> Array:
                shift = jnp.round(ahead / cell * direction).astype(jnp.int32)
                return jax.lax.dynamic_slice(padded, shift + margin, clearance.values.shape)

            discs = [at_disc(ahead) for ahead in self.footprint.offsets]
            least = functools.reduce(jnp.minimum, discs)
            best = block_maximum(least, stride)
            return best, 0.5 * (best - block_maximum(-least, stride))

        room: tuple[Array, Array] = jax.lax.map(at_heading, along)
        return room


def in_passage(is_open: Bool[Array, "N H W"], fits: Bool[Array, "N H W"]) -> Bool[Array, "N H W"]:
    """Return the poses in narrow passages, where a car fits, but not with its margin (`is_open`).

    A pose is in a passage if the car fits ahead and behind as well, and if neither pose beside it
    is open and leads on. Along a wall there is such a pose, so a wall costs the same as without
    passages. Poses next to those in a passage count as well: the car turns where a passage begins.
    """
    height, width = is_open.shape[1:]
    angles = jnp.asarray(HEADINGS, jnp.float32)
    step = jnp.round(jnp.stack([jnp.sin(angles), jnp.cos(angles)], axis=-1)).astype(jnp.int32)

    def at_heading(each: tuple[Array, Array, Array]) -> Array:
        opened, fitting, ahead = jnp.pad(each[0], 2), jnp.pad(each[1], 2), each[2]

        def at(poses: Array, shift: Array) -> Array:
            return jax.lax.dynamic_slice(poses, 2 + shift, (height, width))

        def leads_on(shift: Array) -> Array:
            return at(fitting, shift + ahead) & at(fitting, shift - ahead)

        right = jnp.stack([-ahead[1], ahead[0]])
        has_room = [at(opened, side) & leads_on(side) for side in (right, -right)]
        return leads_on(jnp.zeros_like(ahead)) & ~functools.reduce(jnp.logical_or, has_room)

    is_tight = fits & ~is_open
    inside = is_tight & jax.lax.map(at_heading, (is_open, fits, step))
    # Headings go round; nodes do not.
    around = jnp.pad(inside, ((1, 1), (0, 0), (0, 0)), mode="wrap")
    padding = ((0, 0), (1, 1), (1, 1))
    near: Array = jax.lax.reduce_window(
        around, False, jax.lax.bitwise_or, (3, 3, 3), (1, 1, 1), padding
    )
    return is_tight & near
