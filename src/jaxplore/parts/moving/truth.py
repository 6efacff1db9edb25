"""True obstacles that move on paths."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Key, Pose, Position, Scalar
from jaxplore.maps.world import MovingObstacle
from jaxplore.simulation.exploration.moving_discs import START_OF_MOVING, MovingDiscs
from jaxplore.simulation.exploration.part_truth import PartTruth


class MovingObstacles(PartTruth):
    """Discs on closed paths at constant speed; in a volume cylinders, see `VolumeScenario`.

    A disc moves along the closed polyline through its corners. With L the length of a lap, at time
    t it has travelled

        s(t) = (phase * L + speed * t) mod L

    along the path. Its velocity has the direction of its segment; at a corner, of the segment that
    begins there. On a path of length 0 it stands still. The phases of a run are drawn from its key.

    All fields are array leaves: other paths with the same number of corners do not recompile.

    Args:
        movers: the discs; an empty sequence is accepted.
        phase: (M,) fraction of a lap at time 0, in [0, 1); 0, the first corner, when absent.

    Raises:
        ValueError: a phase that is not M numbers in [0, 1).
    """

    name: ClassVar[str] = "moving_obstacles"
    needs_part: ClassVar[bool] = False

    corners: Float[Array, "M P 2"]
    """Corners of the paths [m]; the last one is repeated where a path has fewer than the
    longest."""
    arc: Float[Array, "M P+1"]
    """Length of the path up to each corner, and of the whole lap [m]."""
    speed: Float[Array, " M"]
    radius: Float[Array, " M"]
    phase: Float[Array, " M"]

    @_kinds.check_arguments
    def __init__(
        self, movers: Sequence[MovingObstacle], phase: ArrayLike | Sequence[float] | None = None
    ):
        most = max((len(mover.path) for mover in movers), default=1)
        rows = [[*mover.path, *mover.path[-1:] * (most - len(mover.path))] for mover in movers]
        corners = np.array(rows, np.float64).reshape(-1, most, 2)
        steps = np.roll(corners, -1, axis=1) - corners
        arc = np.zeros((len(movers), most + 1))
        arc[:, 1:] = np.cumsum(np.hypot(steps[..., 0], steps[..., 1]), axis=1)
        self.corners = jnp.asarray(corners, jnp.float32)
        self.arc = jnp.asarray(arc, jnp.float32)
        self.speed = jnp.asarray([mover.speed for mover in movers], jnp.float32)
        self.radius = jnp.asarray([mover.radius for mover in movers], jnp.float32)
        self.phase = _phases(np.zeros(len(movers)) if phase is None else phase, len(movers))

    def with_phase(self, phase: ArrayLike | Sequence[float]) -> "MovingObstacles":
        """Return the same obstacles with another phase (M,) in [0, 1).

        Raises:
            ValueError: not M numbers in [0, 1).
        """
        checked = _phases(phase, self.phase.shape[0])
        same: MovingObstacles = eqx.tree_at(lambda movers: movers.phase, self, checked)
        return same

    def at(self, time: Scalar) -> MovingDiscs:
        """Return where the discs truly are at a time since the start [s]."""
        travelled = self.phase * self.arc[:, -1] + self.speed * time
        positions, directions = jax.vmap(_place)(self.corners, self.arc, travelled)
        return MovingDiscs(positions, self.speed[:, None] * directions, self.radius)

    def init(self, pose: Pose) -> Float[Array, " M"] | None:
        """Return the phases; None without a disc."""
        return self.phase if self.phase.shape[0] else None

    def draw(self, own: Float[Array, " M"], key: Key) -> Float[Array, " M"]:
        """Return the phases of a run."""
        return jax.random.uniform(jax.random.fold_in(key, START_OF_MOVING), self.phase.shape)

    def discs(self, own: Float[Array, " M"] | None, time: Scalar) -> MovingDiscs | None:
        """Return where the discs are in a run."""
        return None if own is None else self.with_phase(own).at(time)


def _place(
    corners: Float[Array, "P 2"], arc: Float[Array, " P+1"], travelled: Scalar
) -> tuple[Position, Position]:
    """Return the position of a disc, and its unit direction (0 on a path of length 0)."""
    length = arc[-1]
    # A path of length 0 would make the modulo NaN.
    rest = jnp.mod(travelled, jnp.where(length > 0.0, length, 1.0))
    rest = jnp.where(rest < length, rest, 0.0)  # rounding may leave a whole round
    # Searched from the right, so that a segment of length 0, such as padding, is never found.
    found = jnp.searchsorted(arc, rest, side="right") - 1
    index = jnp.clip(found, 0, len(corners) - 1)
    start, end = corners[index], corners[(index + 1) % len(corners)]
    along = end - start
    squared = along @ along
    is_point = squared <= 0.0
    direction = along / jnp.sqrt(jnp.where(is_point, 1.0, squared))
    position = start + (rest - arc[index]) * direction
    return jnp.where(is_point, start, position), jnp.where(is_point, 0.0, direction)


def _phases(value: ArrayLike | Sequence[float], size: int) -> Array:
    phase = _checks.vector("phase", value, size)
    if not _kinds.is_traced(phase):
        given = np.asarray(value, np.float64)
        if not ((given >= 0.0) & (given < 1.0)).all():
            raise ValueError(f"phase is {given.tolist()}; accepted: numbers in [0, 1)")
    return phase
