"""Rules for choosing the next target: the explorers of the literature."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Key, Scalar
from jaxplore.planning.strategy.frontiers import Frontiers

Scores = Float[Array, "*nodes"]
Mask = Bool[Array, "*nodes"]


class TargetRule(eqx.Module):
    """A rule that selects candidate nodes and scores them."""

    @abc.abstractmethod
    def candidates(self, frontiers: Frontiers) -> Mask:
        """Return the nodes that may be chosen. A target is kept while it is a candidate."""

    @abc.abstractmethod
    def scores(self, frontiers: Frontiers, *, key: Key) -> Scores:
        """Score each node; the candidate with the highest score is chosen."""

    def hysteresis(self) -> Scalar | None:
        """Return the lead in score that another candidate needs to replace the target.

        It is None by default: a target is kept while it is a candidate.
        """
        return None


def ask(rule: TargetRule, method: str, frontiers: Frontiers, **options: Key) -> Array:
    """Return what a rule, perhaps a user's own, says of the nodes: `candidates` or `scores`."""
    name, shape = f"rule {type(rule).__name__}", frontiers.distance.shape
    try:
        found = getattr(rule, method)(frontiers, **options)
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"{name} fails in {method}: {type(error).__name__}: {reason}") from error
    kind, accepted = (jnp.bool_, "a mask") if method == "candidates" else (jnp.floating, "numbers")
    is_right = hasattr(found, "dtype") and jnp.issubdtype(found.dtype, kind)
    if not is_right or found.shape != shape:
        raise ValueError(
            f"{method} of {name} are {_kinds.describe(found)}; accepted: {accepted} of shape "
            f"{shape}, such as frontiers.{'is_view' if method == 'candidates' else 'worth'}"
        )
    return jnp.asarray(found)


class Wander(TargetRule):
    """A random place within reach, whatever is known of it.

    Args:
        reach: greatest length of the path to it [m].

    Raises:
        ValueError: a reach that is not positive.
    """

    reach: Scalar

    def __init__(self, reach: ArrayLike = 5.0) -> None:
        self.reach = _checks.scalar("reach", reach, above=0.0)

    def candidates(self, frontiers: Frontiers) -> Mask:
        """Return the open nodes within reach."""
        return frontiers.roads.is_open & (frontiers.distance <= self.reach)

    def scores(self, frontiers: Frontiers, *, key: Key) -> Scores:
        """Return uniform random numbers."""
        return jax.random.uniform(key, frontiers.distance.shape)


class RandomFrontier(TargetRule):
    """A random frontier node, each with the same probability."""

    def candidates(self, frontiers: Frontiers) -> Mask:
        """Return the frontiers."""
        return frontiers.is_frontier

    def scores(self, frontiers: Frontiers, *, key: Key) -> Scores:
        """Return uniform random numbers."""
        return jax.random.uniform(key, frontiers.distance.shape)


class NearestFrontier(TargetRule):
    """The frontier with the shortest path.

    Source: Yamauchi, "A frontier-based approach for autonomous exploration", CIRA 1997.
    """

    def candidates(self, frontiers: Frontiers) -> Mask:
        """Return the frontiers."""
        return frontiers.is_frontier

    def scores(self, frontiers: Frontiers, *, key: Key) -> Scores:
        """Return the negative length of the path [m]."""
        return -frontiers.distance


class NearestCluster(TargetRule):
    """The cluster of frontier cells with the shortest path.

    The rule looks at every choice whether another cluster is nearer than the target by more than
    `lead`. Without such a lead the robot could turn back and forth between two clusters. It needs
    fewer metres than `NearestFrontier`, and a robot that must turn needs more time for them.

    Args:
        lead: by how much nearer another cluster must be to replace the target [m].

    Raises:
        ValueError: a negative lead.
    """

    lead: Scalar

    def __init__(self, lead: ArrayLike = 0.5) -> None:
        self.lead = _checks.scalar("lead", lead, at_least=0.0)

    def candidates(self, frontiers: Frontiers) -> Mask:
        """Return the nodes beside clusters."""
        return frontiers.is_cluster

    def scores(self, frontiers: Frontiers, *, key: Key) -> Scores:
        """Return the negative length of the path [m]."""
        return -frontiers.distance

    def hysteresis(self) -> Scalar:
        """Return the lead [m]."""
        return self.lead


class GainPerCost(TargetRule):
    """The frontier with the most information per metre of path, `I / d`."""

    def candidates(self, frontiers: Frontiers) -> Mask:
        """Return the frontiers."""
        return frontiers.is_frontier

    def scores(self, frontiers: Frontiers, *, key: Key) -> Scores:
        """Return the information per metre [nat/m]."""
        # At the node of the robot the distance may be 0: at least a node spacing keeps the ratio
        # finite.
        return frontiers.worth / jnp.maximum(frontiers.distance, frontiers.roads.spacing)


class NextBestView(TargetRule):
    """The place whose scan has the most information, at any distance.

    Source: Connolly, "The determination of next best views", ICRA 1985.
    """

    def candidates(self, frontiers: Frontiers) -> Mask:
        """Return all places worth a visit."""
        return frontiers.is_view

    def scores(self, frontiers: Frontiers, *, key: Key) -> Scores:
        """Return the information [nat]."""
        return frontiers.worth


class DiscountedInformation(TargetRule):
    """The place with the most information discounted by the length of the path, `I exp(-rate d)`.

    Source: González-Baños and Latombe, "Navigation strategies for exploring indoor environments",
    IJRR 2002, eq. 1, whose rate is 0.2 per metre.

    Args:
        rate: discount rate [1/m].

    Raises:
        ValueError: a negative rate.
    """

    rate: Scalar

    def __init__(self, rate: ArrayLike = 0.2) -> None:
        self.rate = _checks.scalar("rate", rate, at_least=0.0)

    def candidates(self, frontiers: Frontiers) -> Mask:
        """Return all places worth a visit."""
        return frontiers.is_view

    def scores(self, frontiers: Frontiers, *, key: Key) -> Scores:
        """Return the discounted information [nat]."""
        return frontiers.worth * jnp.exp(-self.rate * frontiers.distance)


class DistanceAdvantage(TargetRule):
    """The frontier that is near the robot and far from the other frontiers:

        score = mean over other frontiers of the path length between the two
                - path length from the robot [m]

    A remote frontier that is left behind costs a long way back. The mean is over a random sample of
    frontiers.

    Source: Ericson, Pedro and Jensfelt, "Information gain is not all you need", arXiv 2504.01980:
    remoteness from the other frontiers against proximity.

    Args:
        num_others: number of frontiers in the sample; static.

    Raises:
        ValueError: fewer than one.
    """

    num_others: int = eqx.field(static=True)

    def __init__(self, num_others: int = 12) -> None:
        self.num_others = _checks.positive_int("num_others", num_others)

    def candidates(self, frontiers: Frontiers) -> Mask:
        """Return the frontiers."""
        return frontiers.is_frontier

    def scores(self, frontiers: Frontiers, *, key: Key) -> Scores:
        """Return the advantage [m]."""
        roads, is_frontier = frontiers.roads, frontiers.is_frontier
        # The highest of independent uniform numbers are a sample without replacement, of a fixed
        # size although the number of frontiers is not known at compile time.
        drawn = jnp.where(is_frontier, jax.random.uniform(key, is_frontier.shape), -1.0)
        value, index = jax.lax.top_k(drawn.reshape(-1), min(self.num_others, drawn.size))

        def path_lengths(node: Array) -> Array:
            source = jnp.full(is_frontier.size, jnp.inf).at[node].set(0.0)
            return roads.lengths(source.reshape(is_frontier.shape))

        lengths = jax.lax.map(path_lengths, index)
        # Places in the sample that are no frontier do not count, nor does a frontier for itself.
        counts = (
            (value >= 0.0).reshape(-1, *[1] * is_frontier.ndim)
            & jnp.isfinite(lengths)
            & (lengths > 0.0)
        )
        total = jnp.sum(jnp.where(counts, lengths, 0.0), axis=0)
        remoteness = total / jnp.maximum(jnp.sum(counts, axis=0, dtype=jnp.float32), 1.0)
        return remoteness - frontiers.distance


RULES: dict[str, type[TargetRule]] = {
    "wander": Wander,
    "random-frontier": RandomFrontier,
    "nearest-frontier": NearestFrontier,
    "nearest-cluster": NearestCluster,
    "gain-per-cost": GainPerCost,
    "next-best-view": NextBestView,
    "discounted-information": DiscountedInformation,
    "distance-advantage": DistanceAdvantage,
}
"""Rules by name; call one for its default parameters."""
