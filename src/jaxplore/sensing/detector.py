"""Detect objects and tell their class: a confusion matrix and a recall that falls with range."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._describe import describe_fields
from jaxplore._types import ArrayLike, Key, Rows, Scalar
from jaxplore._xla import on_device

LEAST_LIKELIHOOD = 1e-6
"""Lower bound of a likelihood in the belief: no single look is proof. Logarithms stay finite."""


ROUNDING = 1e-4
"""Accepted difference of a sum of probabilities from 1: three times 0.3333 is a third each."""


class Detections(NamedTuple):
    """What a detector says of each of N objects in one image.

    Args:
        label: (N,) number of the class that was reported; the number of classes, C, for an object
            that was missed.
        is_viewed: (N,) whether the object was in view; the label of others says nothing.
        distance: (N,) distance of each object [m].
    """

    label: Int[Array, " N"]
    is_viewed: Bool[Array, " N"]
    distance: Float[Array, " N"]


class Detector(eqx.Module):
    """Object detector of a camera, by what its confusion matrix and its recall say.

    An object of class c at the distance r in view has one of C + 1 outcomes: a label k, or a miss.

        recall_c(r) = recall_c exp(-(r / reach)^2)
        P(label k | c, r) = recall_c(r) confusion[c, k],    P(miss | c, r) = 1 - recall_c(r)

    A detector reports nothing where nothing is: what looks like a target is an object of another
    class.

    Args:
        classes: names of the C classes, at least two.
        confusion: (C, C) matrix; row c has the probability of each label for an object of class c
            that is detected.
        recall: probability that an object close by is detected, in (0, 1]; one for all classes, or
            (C,).
        reach: distance at which the recall has fallen to 1/e of that [m].

    Raises:
        ValueError: fewer than two classes, or one twice; a matrix of another shape, or a row that
            is no probabilities that sum to 1; a recall or a reach out of its range.
    """

    classes: tuple[str, ...] = eqx.field(static=True)
    confusion: Float[Array, "C C"]
    recall: Float[Array, " C"]
    reach: Scalar

    def __init__(
        self,
        classes: Sequence[str],
        confusion: Rows,
        *,
        recall: ArrayLike | Sequence[float] = 0.9,
        reach: ArrayLike = 8.0,
    ) -> None:
        self.classes = check_classes(classes)
        count = len(self.classes)
        self.confusion = check_distributions("confusion", confusion, (count, count))
        self.recall = _recalls(recall, count)
        self.reach = _checks.scalar("reach", reach, above=0.0)

    def __repr__(self) -> str:
        return describe_fields(self)

    @property
    def num_classes(self) -> int:
        """Number of classes, C."""
        return len(self.classes)

    def index_of(self, name: str, label: object) -> int:
        """Return the number of a class.

        Args:
            name: name of the argument, for the error.
            label: name of the class.

        Raises:
            ValueError: an unknown class.
        """
        if not isinstance(label, str) or label not in self.classes:
            raise ValueError(
                f"{name} is {_kinds.describe(label)}; accepted: {', '.join(self.classes)}"
            )
        return self.classes.index(label)

    def recall_at(self, distance: Scalar) -> Float[Array, " C"]:
        """Return the probability that an object of each class is detected (C,).

        Args:
            distance: distance of the object [m].
        """
        ratio = distance / self.reach
        return self.recall * jnp.exp(-ratio * ratio)

    def likelihood(self, distance: Scalar) -> Float[Array, "C C+1"]:
        """Return the probability of each outcome for each class (C, C + 1); the last is a miss.

        Args:
            distance: distance of the object [m].
        """
        recall = self.recall_at(distance)[:, None]
        return jnp.concatenate([recall * self.confusion, 1.0 - recall], axis=-1)

    def log_likelihood(self, distance: Scalar) -> Float[Array, "C C+1"]:
        """Return the logarithm of `likelihood`, with likelihoods of at least `LEAST_LIKELIHOOD`."""
        return jnp.log(jnp.maximum(self.likelihood(distance), LEAST_LIKELIHOOD))

    def detect(
        self,
        label: Int[Array, " N"],
        distance: Float[Array, " N"],
        is_viewed: Bool[Array, " N"],
        *,
        key: Key,
    ) -> Detections:
        """Simulate what the detector says of objects.

        Args:
            label: (N,) numbers of their true classes.
            distance: (N,) their distances [m].
            is_viewed: (N,) whether each is in view.
            key: random key.

        Raises:
            ValueError: an argument of another kind or shape.
        """
        _kinds.key("key", key)
        label = _checks.of_shape("label", label, ("N",), dtype=jnp.int32)
        distance = _checks.of_shape("distance", distance, label.shape)
        is_viewed = _checks.of_shape("is_viewed", is_viewed, label.shape, dtype=jnp.bool_)

        def outcome(own: Array, away: Array, key: Key) -> Array:
            # A probability of 0 has the logarithm -inf, which is never drawn.
            return jax.random.categorical(key, jnp.log(self.likelihood(away)[own]))

        keys = jax.random.split(key, label.shape[0])
        drawn = jax.vmap(outcome)(label, distance, keys).astype(jnp.int32)
        return Detections(drawn, is_viewed, distance)


def check_classes(classes: object) -> tuple[str, ...]:
    """Return the names of classes as a tuple; refuse fewer than two, and equal ones."""
    accepted = "a list of at least two different names"
    if not isinstance(classes, (list, tuple)) or not all(isinstance(each, str) for each in classes):
        raise ValueError(f"classes is {_kinds.describe(classes)}; accepted: {accepted}")
    if len(classes) < 2 or len(set(classes)) < len(classes) or "" in classes:
        raise ValueError(f"classes is {list(classes)}; accepted: {accepted}")
    return tuple(classes)


def check_distributions(name: str, value: object, shape: tuple[int, ...]) -> Array:
    """Return `value` as a float32 array whose rows are probabilities that sum to 1.

    A traced value is not checked. Another shape, a value outside [0, 1] or a row with another sum
    raises a `ValueError`.
    """
    if _kinds.is_traced(value):
        return jnp.asarray(value, jnp.float32)
    given = _checks.floats(name, value, f"{shape} probabilities")
    if given.shape != shape:
        raise ValueError(f"{name} has shape {given.shape}; accepted: {shape}")
    for index, row in enumerate(given.reshape(-1, shape[-1]).astype(np.float64)):
        where = name if len(shape) == 1 else f"{name}[{index}]"
        # The negated comparisons also refuse NaN.
        if not ((row >= 0.0) & (row <= 1.0)).all():
            shown = [round(each, 6) for each in row.tolist()]
            raise ValueError(f"{where} is {shown}; accepted: values in [0, 1]")
        if not abs(row.sum() - 1.0) <= ROUNDING:
            raise ValueError(
                f"{where} sums to {row.sum():.6g}; accepted: probabilities that sum to 1"
            )
    return on_device(given.copy())


def _recalls(recall: ArrayLike | Sequence[float], count: int) -> Float[Array, " C"]:
    if _kinds.is_traced(recall):
        return jnp.broadcast_to(jnp.asarray(recall, jnp.float32), (count,))
    accepted = f"one probability in (0, 1], or {count}, one for each class"
    given = _checks.floats("recall", recall, accepted)
    # The negated comparison also refuses NaN.
    if given.shape not in ((), (count,)) or not ((given > 0.0) & (given <= 1.0)).all():
        raise ValueError(f"recall is {np.asarray(given).tolist()}; accepted: {accepted}")
    return on_device(np.broadcast_to(given, (count,)).copy())
