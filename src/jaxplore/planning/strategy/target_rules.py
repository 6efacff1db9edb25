"""Rules by which robots choose where to look next: the explorers that people use."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import Key, Scalar
from jaxplore.belief.guidance import geodesic
from jaxplore.planning.strategy.frontiers import Frontiers

Scores = Float[Array, "H W"]
Mask = Bool[Array, "H W"]


class TargetRule(eqx.Module):
    """Says which nodes may be a target and how good each is."""

    @abc.abstractmethod
    def candidates(self, prospects: Frontiers) -> Mask:
        """Return the nodes (H, W) that may be chosen. A target is kept while it is one of them."""

    @abc.abstractmethod
    def scores(self, prospects: Frontiers, *, key: Key) -> Scores:
        """Return how good each node is (H, W); the greatest of the candidates is chosen."""


class Wander(TargetRule):
    """Anywhere within reach, whatever is known of it: each place is as good as another.

    Args:
        reach: length of the way at most [m].

    Raises:
        ValueError: a reach that is not positive.
    """

    reach: Scalar

    def __init__(self, reach: ArrayLike = 5.0) -> None:
        self.reach = _checks.scalar("reach", reach, above=0.0)

    def candidates(self, prospects: Frontiers) -> Mask:
        """Return the open nodes within reach."""
        return prospects.roads.is_open & (prospects.distance <= self.reach)

    def scores(self, prospects: Frontiers, *, key: Key) -> Scores:
        """Return random numbers."""
        return jax.random.uniform(key, prospects.distance.shape)


class RandomFrontier(TargetRule):
    """Some frontier, each node of them with the same probability."""

    def candidates(self, prospects: Frontiers) -> Mask:
        """Return the frontiers."""
        return prospects.is_frontier

    def scores(self, prospects: Frontiers, *, key: Key) -> Scores:
        """Return random numbers."""
        return jax.random.uniform(key, prospects.distance.shape)


class NearestFrontier(TargetRule):
    """The frontier to which the way is shortest.

    Source: Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997.
    """

    def candidates(self, prospects: Frontiers) -> Mask:
        """Return the frontiers."""
        return prospects.is_frontier

    def scores(self, prospects: Frontiers, *, key: Key) -> Scores:
        """Return minus the length of the way [m]."""
        return -prospects.distance


class GainPerCost(TargetRule):
    """The frontier with the most information for each metre of the way there: `I / d`."""

    def candidates(self, prospects: Frontiers) -> Mask:
        """Return the frontiers."""
        return prospects.is_frontier

    def scores(self, prospects: Frontiers, *, key: Key) -> Scores:
        """Return the information per metre [nat/m]."""
        return prospects.worth / jnp.maximum(prospects.distance, prospects.roads.frame.resolution)


class NextBestView(TargetRule):
    """The place from which a scan tells most, however far it is.

    Source: Connolly, "The determination of next best views", ICRA 1985.
    """

    def candidates(self, prospects: Frontiers) -> Mask:
        """Return all places worth a look."""
        return prospects.is_view

    def scores(self, prospects: Frontiers, *, key: Key) -> Scores:
        """Return the information [nat]."""
        return prospects.worth


class DiscountedInformation(TargetRule):
    """The place with the most information, discounted by the way: `I exp(-rate d)`.

    Source: González-Baños and Latombe, "Navigation strategies for exploring indoor environments",
    IJRR 2002, eq. 1, whose rate is 0.2 per metre.

    Args:
        rate: [1/m].

    Raises:
        ValueError: a negative rate.
    """

    rate: Scalar

    def __init__(self, rate: ArrayLike = 0.2) -> None:
        self.rate = _checks.scalar("rate", rate, at_least=0.0)

    def candidates(self, prospects: Frontiers) -> Mask:
        """Return all places worth a look."""
        return prospects.is_view

    def scores(self, prospects: Frontiers, *, key: Key) -> Scores:
        """Return the discounted information [nat]."""
        return prospects.worth * jnp.exp(-self.rate * prospects.distance)


class DistanceAdvantage(TargetRule):
    """The frontier that is near to the robot and far from the other frontiers:

        mean over other frontiers of the way between the two - way from the robot [m]

    What lies apart would have to be come back for. The mean is over frontiers drawn at random.

    Source: Ericson, Pedro and Jensfelt, "Information gain is not all you need", arXiv 2504.01980:
    remoteness from other frontiers against proximity.

    Args:
        num_others: frontiers drawn; static.

    Raises:
        ValueError: fewer than one.
    """

    num_others: int = eqx.field(static=True)

    def __init__(self, num_others: int = 12) -> None:
        self.num_others = _checks.positive_int("num_others", num_others)

    def candidates(self, prospects: Frontiers) -> Mask:
        """Return the frontiers."""
        return prospects.is_frontier

    def scores(self, prospects: Frontiers, *, key: Key) -> Scores:
        """Return the advantage [m]."""
        roads, is_frontier = prospects.roads, prospects.is_frontier
        # The greatest of uniform numbers: so many different ones, or all there are.
        drawn = jnp.where(is_frontier, jax.random.uniform(key, is_frontier.shape), -1.0)
        value, index = jax.lax.top_k(drawn.reshape(-1), min(self.num_others, drawn.size))

        def way(node: Array) -> Array:
            source = jnp.full(is_frontier.size, jnp.inf).at[node].set(0.0)
            return geodesic(source.reshape(is_frontier.shape), roads.slowness, roads.is_open)

        ways = jax.lax.map(way, index)
        # The way to itself is none to another.
        counts = ((value >= 0.0)[:, None, None]) & jnp.isfinite(ways) & (ways > 0.0)
        total = jnp.sum(jnp.where(counts, ways, 0.0), axis=0)
        remoteness = total / jnp.maximum(jnp.sum(counts, axis=0, dtype=jnp.float32), 1.0)
        return remoteness - prospects.distance


RULES: dict[str, type[TargetRule]] = {
    "wander": Wander,
    "random-frontier": RandomFrontier,
    "nearest-frontier": NearestFrontier,
    "gain-per-cost": GainPerCost,
    "next-best-view": NextBestView,
    "discounted-information": DiscountedInformation,
    "distance-advantage": DistanceAdvantage,
}
"""By name, to be called for their default numbers."""
