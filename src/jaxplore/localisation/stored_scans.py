"""The scans that were stored along the way of a robot, and the loops that were closed."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import Count, Flag, Pose, Scalar
from jaxplore.geometry.motion import Matrix
from jaxplore.sensing.beams import Beams, Scan


class StoredScans(NamedTuple):
    """Scans along the way, in arrays with room for K of them; the nodes of a pose graph.

    Args:
        poses: (K, 3) pose of each, as estimated now.
        motions: (K, 3) measured motion from the one before it, in the frame of that one.
        covariances: (K, 3, 3) covariance of that motion, in that frame.
        way: (K,) length of the robot's way up to it [m].
        ranges: (K, B) ranges of the beams of all sensors [m].
        is_return: (K, B) which of them returned.
        number: number of stored scans.
    """

    poses: Float[Array, "K 3"]
    motions: Float[Array, "K 3"]
    covariances: Float[Array, "K 3 3"]
    way: Float[Array, " K"]
    ranges: Float[Array, "K B"]
    is_return: Bool[Array, "K B"]
    number: Count

    @classmethod
    def none(cls, capacity: int, sensors: Sequence[Beams]) -> "StoredScans":
        """Return room for `capacity` scans of some sensors."""
        beams = sum(each.num_beams for each in sensors)
        poses = jnp.zeros((capacity, 3))
        return cls(
            poses,
            poses,
            jnp.zeros((capacity, 3, 3)),
            poses[:, 0],
            jnp.zeros((capacity, beams)),
            jnp.zeros((capacity, beams), bool),
            jnp.zeros((), jnp.int32),
        )

    @property
    def capacity(self) -> int:
        """Greatest number of scans."""
        return int(self.way.shape[0])

    @property
    def last(self) -> Count:
        """Index of the newest scan; 0 without any."""
        return jnp.maximum(self.number - 1, 0)

    def with_scan(
        self,
        is_due: Flag,
        pose: Pose,
        motion: Pose,
        covariance: Matrix,
        way: Scalar,
        scans: Sequence[Scan],
    ) -> "StoredScans":
        """Return the scans with another one if it is due; unchanged where there is no room.

        The motion is measured from the scan before it. `way` is the length of the robot's way [m].
        """
        # Written in place: a branch would copy the arrays.
        at = jnp.where(is_due, self.number, self.capacity)
        return StoredScans(
            self.poses.at[at].set(pose, mode="drop"),
            self.motions.at[at].set(motion, mode="drop"),
            self.covariances.at[at].set(covariance, mode="drop"),
            self.way.at[at].set(way, mode="drop"),
            self.ranges.at[at].set(jnp.concatenate([each.ranges for each in scans]), mode="drop"),
            self.is_return.at[at].set(
                jnp.concatenate([each.is_return for each in scans]), mode="drop"
            ),
            jnp.minimum(self.number + is_due.astype(jnp.int32), self.capacity),
        )

    def scan(self, index: Count, sensors: Sequence[Beams]) -> tuple[Scan, ...]:
        """Return a stored scan of each sensor."""
        scans, begin = [], 0
        for each in sensors:
            end = begin + each.num_beams
            scans.append(Scan(self.ranges[index, begin:end], self.is_return[index, begin:end]))
            begin = end
        return tuple(scans)


class Closures(NamedTuple):
    """Closed loops: pairs of scans that see the same place, in arrays with room for C of them.

    Args:
        pairs: (C, 2) indices of the older scan and of the newer one.
        motions: (C, 3) measured motion from the older to the newer, in the frame of the older.
        covariances: (C, 3, 3) its covariance, in that frame.
        number: number of closed loops.
        examined: number of scans for which loops were looked for.
    """

    pairs: Int[Array, "C 2"]
    motions: Float[Array, "C 3"]
    covariances: Float[Array, "C 3 3"]
    number: Count
    examined: Count

    @classmethod
    def none(cls, capacity: int) -> "Closures":
        """Return room for `capacity` closed loops."""
        nothing = jnp.zeros((), jnp.int32)
        return cls(
            jnp.zeros((capacity, 2), jnp.int32),
            jnp.zeros((capacity, 3)),
            jnp.zeros((capacity, 3, 3)),
            nothing,
            nothing,
        )

    def with_loop(self, older: Count, newer: Count, motion: Pose, covariance: Matrix) -> "Closures":
        """Return the closures with another one; unchanged where there is no room."""
        at = self.number
        return self._replace(
            pairs=self.pairs.at[at].set(jnp.stack([older, newer]), mode="drop"),
            motions=self.motions.at[at].set(motion, mode="drop"),
            covariances=self.covariances.at[at].set(covariance, mode="drop"),
            number=jnp.minimum(at + 1, self.pairs.shape[0]),
        )
