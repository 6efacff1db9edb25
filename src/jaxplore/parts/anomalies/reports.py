"""The list of what looked different from the known map: suspicions and reports."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import Flag, GridMask, GridValues, Pose, Position, Scalar
from jaxplore.maps.occupancy_grid import OccupancyGrid

MAX_REPORTS = 8
"""Number of suspicions and reports that a robot keeps. Shapes in a compiled loop are fixed."""
APPEARED, GONE, PERSON = 1, 2, 3
"""Kinds of an anomaly; 0 marks an unused row."""
KIND_NAMES = {APPEARED: "appeared", GONE: "gone", PERSON: "person"}
"""Names of the kinds."""
SIGHT = 0.5
"""A place counts as looked at if a cell within this distance was observed [m]."""


class Reports(NamedTuple):
    """Suspicions and reports, K rows in the order in which they were filled.

    Args:
        place: (K, 2) position [m].
        kind: (K,) kind; 0 for an unused row.
        suspected: (K,) time of the suspicion [s]; infinite in an unused row.
        reported: (K,) time of the report [s]; infinite until a second look has confirmed it.
        seen_from: (K, 2) position of the robot at the suspicion [m].
        looks: (K,) number of scans of the second look.
        spot: (K, 2) centre of the cell with the greatest evidence at the suspicion [m].
        absent: (K,) evidence that this cell is again as the map says [nat].
    """

    place: Float[Array, "K 2"]
    kind: Int[Array, " K"]
    suspected: Float[Array, " K"]
    reported: Float[Array, " K"]
    seen_from: Float[Array, "K 2"]
    looks: Int[Array, " K"]
    spot: Float[Array, "K 2"]
    absent: Float[Array, " K"]

    @classmethod
    def none(cls) -> "Reports":
        """Return a list without entries."""
        count = MAX_REPORTS
        nowhere, never = jnp.zeros((count, 2)), jnp.full(count, jnp.inf)
        zeros = jnp.zeros(count, jnp.int32)
        return cls(nowhere, zeros, never, never, nowhere, zeros, nowhere, jnp.zeros(count))

    @property
    def is_open(self) -> Bool[Array, " K"]:
        """Mask (K,) of the suspicions that wait for a second look."""
        return (self.kind > 0) & jnp.isinf(self.reported)

    def away(self, centres: Float[Array, "H W 2"]) -> Float[Array, "K H W"]:
        """Return the square of the distance from each place to the centre of each cell [m^2]."""
        return jax.vmap(square_distance, (None, 0))(centres, self.place)

    def open_suspicion(
        self, is_new: Flag, place: Position, spot: Position, kind: Array, time: Scalar, pose: Pose
    ) -> "Reports":
        """Return the list with one more suspicion if `is_new`; a full list stays unchanged."""
        row = jnp.argmin(self.kind)
        is_put = is_new & (self.kind[row] == 0) & (jnp.arange(MAX_REPORTS) == row)
        return self._replace(
            place=jnp.where(is_put[:, None], place, self.place),
            kind=jnp.where(is_put, kind, self.kind),
            suspected=jnp.where(is_put, time, self.suspected),
            seen_from=jnp.where(is_put[:, None], pose[:2], self.seen_from),
            looks=jnp.where(is_put, 0, self.looks),
            spot=jnp.where(is_put[:, None], spot, self.spot),
            absent=jnp.where(is_put, 0.0, self.absent),
        )

    def add_absence(self, grid: OccupancyGrid, evidence: GridValues) -> "Reports":
        """Return the list with the evidence of a scan that what was suspected has left.

        It is the test of a change turned round: with w the evidence of a change in a cell [nat],

            A <- max(0, A - max over the cells of the spot that beams looked into of w)

        The cells of the spot are its own and the eight around it, as noise may have put the
        greatest evidence beside the surface. As long as one of them differs, A >= h has at most the
        probability exp(-h) at any scan.
        """
        height, width = grid.shape
        steps = jnp.arange(-1, 2)
        row, column = jnp.moveaxis(grid.frame.to_cell(self.spot), -1, 0)
        rows = jnp.clip(row[:, None, None] + steps[:, None], 0, height - 1)
        columns = jnp.clip(column[:, None, None] + steps, 0, width - 1)
        found = evidence[rows, columns]
        best = jnp.where(found != 0.0, found, -jnp.inf).max(axis=(1, 2))
        more = jnp.where(jnp.isfinite(best), -best, 0.0)
        return self._replace(absent=jnp.maximum(0.0, self.absent + more))

    def record_look(
        self, is_sighted: Bool[Array, " K"], is_confirmed: Bool[Array, " K"], time: Scalar
    ) -> "Reports":
        """Return the list after a scan of the second look.

        `is_sighted` are the places that the scan observed, `is_confirmed` those with an anomaly.
        """
        return self._replace(
            reported=jnp.where(is_confirmed, time, self.reported),
            looks=self.looks + is_sighted.astype(jnp.int32),
        )

    def add_report(self, other: "Reports", is_new: Flag, radius: Scalar) -> "Reports":
        """Return the list with one row of another robot's list, its report of an anomaly.

        What the list has of that kind within `radius` [m] becomes the same report, with the earlier
        time. Else the report gets an unused row, if there is one.
        """
        away = jnp.linalg.norm(self.place - other.place, axis=-1)
        is_same = is_new & (self.kind == other.kind) & (away <= radius)
        merged = self._replace(
            reported=jnp.where(is_same, jnp.minimum(self.reported, other.reported), self.reported)
        )
        row = jnp.argmin(merged.kind)
        is_put = is_new & ~is_same.any() & (merged.kind[row] == 0)
        at = is_put & (jnp.arange(MAX_REPORTS) == row)

        def put(mine: Array, theirs: Array) -> Array:
            return jnp.where(at.reshape(-1, *([1] * (mine.ndim - 1))), theirs, mine)

        added: Reports = jax.tree.map(put, merged, other)
        return added

    def drop(self, is_dropped: Bool[Array, " K"]) -> "Reports":
        """Return the list without some of its rows (K,)."""
        return self._replace(
            kind=jnp.where(is_dropped, 0, self.kind),
            suspected=jnp.where(is_dropped, jnp.inf, self.suspected),
        )


def cell_centres(grid: OccupancyGrid) -> Float[Array, "H W 2"]:
    """Return the centres (x, y) of the cells of a grid [m]."""
    height, width = grid.shape
    rows, columns = jnp.mgrid[:height, :width]
    return grid.frame.cell_centre(jnp.stack([rows, columns], axis=-1))


def square_distance(centres: Float[Array, "H W 2"], place: Position) -> GridValues:
    """Return the square of the distance of each centre from a place [m^2]."""
    return jnp.square(centres[..., 0] - place[0]) + jnp.square(centres[..., 1] - place[1])


class Channel(NamedTuple):
    """Evidence of one sort of anomaly in each cell.

    Args:
        evidence: (H, W) cumulative sums of log-likelihood ratios [nat].
        kinds: (H, W) kind that an alarm in each cell has.
        is_people: whether it is the evidence of persons.
    """

    evidence: GridValues
    kinds: Int[Array, "H W"]
    is_people: bool

    def owns(self, kind: Int[Array, " K"]) -> Bool[Array, " K"]:
        """Return which rows of a list (K,) with these kinds are of this sort."""
        return (kind > 0) & ((kind == PERSON) == self.is_people)

    def wait(
        self,
        former: GridValues,
        is_waiting: Bool[Array, " K"],
        kind: Int[Array, " K"],
        around: Bool[Array, "K H W"],
    ) -> "Channel":
        """Return the channel with `former` evidence around its suspicions that wait for a look.

        `is_waiting` are rows of a list with these kinds, and `around` the cells around each. A
        suspicion of the other sort does not keep a person from being found, nor a thing.
        """
        waits = (around & (is_waiting & self.owns(kind))[:, None, None]).any(axis=0)
        return self._replace(evidence=jnp.where(waits, former, self.evidence))

    def peak(
        self, threshold: Scalar, is_closed: GridMask, centres: Float[Array, "H W 2"], radius: Scalar
    ) -> tuple[Flag, Position, Position, Array]:
        """Return whether a cell has crossed the threshold [nat], and the place of the alarm, its
        spot, the cell with the greatest evidence, and its kind.

        The place is the mean of the cells that have crossed it, with the same kind, within `radius`
        [m] of the greatest evidence. The cells `is_closed` raise no alarm.
        """
        crossed = (self.evidence >= threshold) & ~is_closed
        best = jnp.argmax(jnp.where(crossed, self.evidence, -jnp.inf))
        row, column = jnp.unravel_index(best, crossed.shape)
        kind = self.kinds[row, column]
        near = square_distance(centres, centres[row, column]) <= radius**2
        near = near & crossed & (self.kinds == kind)
        weight = near.astype(jnp.float32)
        place = jnp.einsum("hw,hwc->c", weight, centres) / jnp.maximum(jnp.sum(weight), 1.0)
        return crossed.any(), place, centres[row, column], kind
