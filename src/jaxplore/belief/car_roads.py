"""Costs to go of a car over position, heading and direction of travel."""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

from jaxplore._types import Pose, Position, Scalar
from jaxplore.belief.car_paths import (
    CHANNEL_LENGTH,
    DescentTree,
    DrivenPath,
    find_join,
    motion_table,
    trace_path,
    with_channel,
    without_shortcuts,
)
from jaxplore.belief.guidance import LAYERS, GuidanceField, descent_field
from jaxplore.belief.roadmap import Roadmap, nearest_open
from jaxplore.belief.tiles import Part, Tiling, relax_costs
from jaxplore.geometry.state_lattice import HEADINGS, NUM_HEADINGS, motions
from jaxplore.maps.field import gather, stencil

HALF = NUM_HEADINGS // 2
HEADING_LAYERS = 2
"""Number of layers of closed poses into which a cost-to-go is extended."""
TILING = Tiling(side=12, sweeps=1)
"""Tiles of a car: prices of all motions from 12 x 12 nodes fit the CPU's cache."""
QUARTER = tuple(angle / (0.5 * math.pi) for angle in HEADINGS[: NUM_HEADINGS // 4 + 1])
"""Headings of the first quadrant [quarter turns]."""


class CarRoadmap(Roadmap):
    """Lattice of the poses in which a car fits, with the paths that it can drive.

    A state is a node, a heading of motion and a direction of travel: forwards, or backwards if the
    car can, with the body the other way round. Motions are those of `geometry.state_lattice`, which
    are closed where a pose that they pass is closed. The cost of a motion is its length times the
    mean price of a metre at its two ends, backwards times a penalty. A change of the direction of
    travel has a price. The values are those of Dijkstra's algorithm.

    `slowness` and `is_open` of the base class are the best of each node over headings.

    Args:
        slowness_at: cost (N, H, W) of a step of one node spacing by heading of the body [m].
        is_open_at: mask (N, H, W) of the poses in which the car fits, at the best cell of a node.
        is_clear_at: mask (N, H, W) of the poses in which it fits at the node itself.
        reversal_cost: price of a change between forwards and backwards [m].
        reverse_penalty: factor on the cost of what is driven backwards.
        radius: turning radius [node spacings]; static.
        can_reverse: whether the car can drive backwards; static.
    """

    slowness_at: Float[Array, "N H W"]
    is_open_at: Bool[Array, "N H W"]
    is_clear_at: Bool[Array, "N H W"]
    reversal_cost: Scalar
    reverse_penalty: Scalar
    radius: float = eqx.field(static=True)
    can_reverse: bool = eqx.field(static=True)

    def costs(
        self,
        source: Float[Array, "N H W"],
        *,
        is_from_source: bool = False,
    ) -> Float[Array, "D N H W"]:
        """Return the cost-to-go by direction of travel, forwards first, and heading of the body
        [m]. `source` is the cost of the poses where paths may end, or begin if `is_from_source`
        (static); infinite elsewhere [m]."""
        # A path from the source is a path to it that is driven in the other direction of travel.
        first = HALF if is_from_source and not self.can_reverse else 0
        bodies = (0, HALF) if self.can_reverse else (first,)
        reaches = [max(abs(each.down), abs(each.right)) for each in motions(self.radius)]
        margin = max(reaches)
        height, width = self.is_open.shape
        beside = [
            (margin, margin + -(length + 2 * margin) % TILING.side) for length in (height, width)
        ]

        def by_motion(values: Array, outside: float | bool) -> Array:
            """Return (N, D, h, w) by heading of motion from (N, H, W) by heading of the body.

            All arrays get the margin of a sweep and whole tiles once, here.
            """
            values = jnp.pad(values, ((0, 0), *beside), constant_values=outside)
            return jnp.stack([jnp.roll(values, -body, axis=0) for body in bodies], axis=1)

        is_closed = by_motion(~self.is_open_at, outside=True)
        # Backwards on the path from the source is forwards on that to it.
        penalties = jnp.stack([jnp.ones(()), self.reverse_penalty][: len(bodies)])
        penalties = penalties[::-1] if is_from_source else penalties
        slowness = penalties[:, None, None] * by_motion(self.slowness_at, jnp.inf)
        half = jnp.where(is_closed, jnp.inf, 0.5 * slowness)
        prices = self._prices(is_closed, half)
        value = relax_costs(
            jnp.where(is_closed, jnp.inf, by_motion(source, jnp.inf)),
            [Part(prices, jnp.inf, 0)],
            functools.partial(_relax, self.radius, margin),
            margin,
            [self.reversal_cost],
            TILING,
        )
        inside = value[..., margin : margin + height, margin : margin + width]
        found = [jnp.roll(inside[:, each], body, axis=0) for each, body in enumerate(bodies)]
        # What leads from the source was driven the other way round.
        return jnp.stack(found[::-1] if is_from_source else found)

    def _prices(
        self, is_closed: Bool[Array, "N D h w"], half: Float[Array, "N D h w"]
    ) -> Float[Array, "M D h w"]:
        """Return the cost of each motion from each node; infinite if it passes a closed pose."""
        table = motion_table(self.radius)
        reach = [np.abs(each).max() for each in (table.via[..., :2], table.down, table.right)]
        margin = int(max(reach))
        beside = ((0, 0), (0, 0), (margin, margin), (margin, margin))
        # Beyond the rim all is closed, so that a motion of any node is a slice at a fixed offset.
        closed = jnp.pad(is_closed, beside, constant_values=True)
        halves = jnp.pad(half, beside, constant_values=jnp.inf)
        _, directions, height, width = is_closed.shape

        def at(padded: Array, state: Array) -> Array:
            down, right, heading = state
            corner = (heading, 0, down + margin, right + margin)
            return jax.lax.dynamic_slice(padded, corner, (1, directions, height, width))[0]

        def of_motion(given: tuple[Array, Array, Array, Array]) -> Array:
            start, end, states, length = given
            price = length * (half[start] + at(halves, end))
            none = jnp.zeros((directions, height, width), bool)
            blocked, _ = jax.lax.scan(
                lambda any_, each: (any_ | at(closed, each), None), none, states
            )
            return jnp.where(blocked, jnp.inf, price)

        starts = jnp.asarray([each.start for each in motions(self.radius)], jnp.int32)
        ends = jnp.asarray(np.stack([table.down, table.right, table.end], axis=-1))
        rows = (starts, ends, jnp.asarray(table.via), jnp.asarray(table.length))
        # One motion after the other: all at once would need as many copies of the nodes as there
        # are motions.
        prices: Array = jax.lax.map(of_motion, rows)
        return prices

    def lengths(self, source: Float[Array, "H W"]) -> Float[Array, "H W"]:
        """Return the least cost-to-go of each node over headings and directions [m]."""
        return self.costs(self._at_all_headings(source)).min(axis=(0, 1))

    def lengths_from(self, pose: Pose) -> Float[Array, "H W"]:
        """Return the cost of the path from a pose (x, y, yaw) to each node [m]."""
        return self.costs(self.starts(pose), is_from_source=True).min(axis=(0, 1))

    def sources_at(
        self, point: Position, heading: Scalar | None = None
    ) -> Float[Array, "*headings H W"]:
        """Return the sources of `Roadmap.sources_at`, by heading for paths that end with one."""
        if heading is None:
            return super().sources_at(point)
        return self.starts(jnp.append(point, heading))

    def starts(self, pose: Pose) -> Float[Array, "N H W"]:
        """Return how far the open poses nearest to a pose (x, y, yaw) are from it [m].

        A turn counts as the arc that the car drives meanwhile. All other poses are infinite.
        """
        frame, spacing = self.frame, self.frame.resolution
        turn = jnp.asarray(HEADINGS, jnp.float32) - (pose[2] - frame.origin[2])
        turn = jnp.abs(jnp.mod(turn + math.pi, math.tau) - math.pi)
        away = frame.distances(pose[:2], self.is_open.shape)
        cost = away + self.radius * spacing * turn[:, None, None]
        cost = jnp.where(self.is_open_at, cost, jnp.inf)
        return nearest_open(cost, jnp.where(self.is_open, away, jnp.inf), spacing, self.corners)

    def field(
        self, source: Float[Array, "*headings H W"], start: Position | None = None
    ) -> "CarGuidance":
        """Return the cost-to-go as a field over positions and headings; the start is not read."""
        return self._field(source)[0]

    def field_and_cost(
        self, source: Float[Array, "H W"], pose: Pose
    ) -> tuple["CarGuidance", Scalar]:
        """Return the field, and the cost of the path from a pose [m]; infinite without a path."""
        field, costs = self._field(source)
        return field.from_pose(pose), (self.starts(pose) + costs.min(axis=0)).min()

    def _field(
        self, source: Float[Array, "*headings H W"]
    ) -> tuple["CarGuidance", Float[Array, "D N H W"]]:
        """Return the field, and the cost-to-go that it extends into closed poses."""
        costs = self.costs(self._at_all_headings(source))
        step = jnp.asarray(3.0 * self.frame.resolution)
        planar = descent_field(costs.min(axis=(0, 1)), self.frame, LAYERS, self.corners)
        return with_headings(planar, _extend(costs, step), self, costs), costs

    def _at_all_headings(self, source: Float[Array, "*headings H W"]) -> Float[Array, "N H W"]:
        return jnp.broadcast_to(source, self.is_open_at.shape)


class CarGuidance(GuidanceField):
    """Cost-to-go over position, heading and direction of travel, read in O(1).

    The fields of the base class are those of the best heading.

    Args:
        by_heading: cost-to-go (D, N, H, W) by direction of travel and heading of the body [m].
        roads: lattice of the poses in which the car fits.
        at_nodes: cost-to-go (D, N, H, W) of the motions that begin at the poses [m]; infinite where
            there is none.
        channelled: `by_heading` with a channel along the paths of a car; see `from_pose`.
    """

    by_heading: Float[Array, "D N H W"]
    roads: CarRoadmap
    at_nodes: Float[Array, "D N H W"]
    channelled: Float[Array, "D N H W"]

    def from_pose(self, pose: Pose) -> "CarGuidance":
        """Return the field with a channel along the paths of a car from its pose.

        Interpolated between poses of the lattice, the cost may have a ridge across a path: closed
        poses and those of other paths beside it count as much as its own. No rollout of MPPI
        crosses a ridge, so the car would stand before it. There are two paths, one for each
        direction of travel that the car may have. See `with_channel`.
        """
        roads, spacing = self.roads, self.frame.resolution

        def path_of(direction: Array) -> DrivenPath:
            speed = 1.0 - 2.0 * direction.astype(jnp.float32)
            path = self._path(pose, speed, jnp.full(2, spacing), CHANNEL_LENGTH)
            prices = (roads.radius * spacing, roads.reversal_cost)
            return without_shortcuts(path, pose, direction, *prices)

        paths = jax.vmap(path_of)(jnp.arange(self.by_heading.shape[0]))
        path = DrivenPath(*(each.reshape(-1, *each.shape[2:]) for each in paths))
        prices = (roads.radius, roads.reversal_cost)
        costs = with_channel(self.by_heading, path, self.frame, *prices)
        return dataclasses.replace(self, channelled=costs)

    def trace_path(
        self, pose: Pose, speed: Scalar, steps: Float[Array, "2"], num_steps: int
    ) -> Float[Array, "T 3"]:
        """Return the poses of the car along its motions on the lattice; see `GuidanceField`."""
        return self._path(pose, speed, steps, num_steps).poses

    def _path(
        self, pose: Pose, speed: Scalar, steps: Float[Array, "2"], num_steps: int
    ) -> DrivenPath:
        """Return the path of the car along its motions; see `trace_path`."""
        start = find_join(self.tree, self.frame, pose, speed)
        return trace_path(self.tree, self.frame, start, steps, num_steps)

    @property
    def tree(self) -> DescentTree:
        """The cost-to-go with what tells which motion it is the cost of."""
        roads = self.roads
        return DescentTree(
            roads.is_open_at,
            roads.is_clear_at,
            roads.slowness_at,
            self.at_nodes,
            roads.reversal_cost,
            roads.reverse_penalty,
            roads.radius,
        )

    def at_pose(
        self, position: Position, heading: Scalar, speed: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Return the cost-to-go of a car [m], and twice 1: the cost depends on the heading."""
        directions, count, height, width = self.channelled.shape
        around = stencil((height, width), self.frame.to_grid(position))
        angle = heading - self.frame.origin[2]
        # An angle that is not finite has no index; its cost is that off the lattice.
        is_finite = jnp.isfinite(angle)
        quarters = jnp.where(is_finite, angle, 0.0) / (0.5 * math.pi)
        whole = jnp.floor(quarters)
        rest = quarters - whole
        lower, index, gap = jnp.zeros(()), jnp.zeros((), jnp.int32), jnp.asarray(QUARTER[1])
        for number in range(1, count // 4):
            is_beyond = rest >= QUARTER[number]
            lower = jnp.where(is_beyond, QUARTER[number], lower)
            index = jnp.where(is_beyond, number, index)
            gap = jnp.where(is_beyond, QUARTER[number + 1] - QUARTER[number], gap)
        first = jnp.mod(whole.astype(jnp.int32) * (count // 4) + index, count)
        second = jnp.mod(first + 1, count)
        share = (rest - lower) / gap
        layer = jnp.where(speed < 0.0, count * (directions - 1), 0)
        values = self.channelled.reshape(directions * count, height, width)
        before, after = (
            gather(values, around, self.outside, layer + each) for each in (first, second)
        )
        cost = before + share * (after - before)
        return jnp.where(is_finite, cost, self.outside), jnp.ones(()), jnp.ones(())


def with_headings(
    planar: GuidanceField,
    costs: Float[Array, "D N H W"],
    roads: CarRoadmap,
    at_nodes: Float[Array, "D N H W"],
) -> CarGuidance:
    """Return a field with the costs by direction of travel and heading beside the planar ones."""
    parts = (planar.values, planar.descent, planar.frame, planar.outside)
    return CarGuidance(*parts, costs, roads, at_nodes, costs)


def _relax(radius: float, margin: int, value: Array, prices: Array, reversal: Array) -> Array:
    """Return the least cost-to-go (N, D, h, w) by a motion, in either direction of travel."""
    height, width = value.shape[-2] - 2 * margin, value.shape[-1] - 2 * margin
    least: list[list[Array]] = [[] for _ in range(NUM_HEADINGS)]
    for number, each in enumerate(motions(radius)):
        top, left = margin + each.down, margin + each.right
        beyond = value[each.end, :, top : top + height, left : left + width]
        least[each.start].append(beyond + prices[number])
    nearest = jnp.stack([functools.reduce(jnp.minimum, each) for each in least])
    return _turn_over(nearest, reversal)


def _turn_over(costs: Float[Array, "N D H W"], reversal: Scalar) -> Float[Array, "N D H W"]:
    """Return the least of the costs and those in the other direction of travel with its price."""
    if costs.shape[1] == 1:
        return costs
    # With the body as it is, the other direction of travel is the opposite heading of motion.
    return jnp.minimum(costs, jnp.roll(costs, HALF, axis=0)[:, ::-1] + reversal)


def _extend(costs: Float[Array, "D N H W"], step: Scalar) -> Float[Array, "D N H W"]:
    """Fill closed poses from the poses around them, so that interpolation stays finite.

    Each layer gets the greatest finite value around it plus `step`. Poses that are still infinite
    get the greatest finite value of all. Costs without a finite value become 0.
    """
    greatest = jnp.max(jnp.where(jnp.isfinite(costs), costs, -jnp.inf))

    def layer(_: Array, current: Array) -> Array:
        around = jnp.where(jnp.isfinite(current), current, -jnp.inf)
        for axis in (1, 2, 3):
            # Headings are a circle; positions are not, but a wall is at the end of every map.
            up, down = jnp.roll(around, 1, axis), jnp.roll(around, -1, axis)
            around = jnp.maximum(around, jnp.maximum(up, down))
        ridge = jnp.where(jnp.isfinite(around), around + step, jnp.inf)
        return jnp.where(jnp.isfinite(current), current, ridge)

    filled = jax.lax.fori_loop(0, HEADING_LAYERS, layer, costs)
    beyond = jnp.where(jnp.isfinite(greatest), greatest + HEADING_LAYERS * step, 0.0)
    return jnp.where(jnp.isfinite(filled), filled, beyond)
