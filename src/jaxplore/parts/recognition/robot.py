"""Recognise objects: the probability of each class, and the information of one more look."""

import dataclasses
import math
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import entr, logsumexp
from jaxtyping import Array, Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Position, Scalar
from jaxplore._xla import on_device
from jaxplore.belief.part import Part
from jaxplore.belief.sight import is_in_sight
from jaxplore.information.field import InformationField
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.detector import Detections, Detector, check_distributions

LEAST_ENTROPY = 1e-3
"""Entropy of an object's class below which the object adds nothing to the field [nat]."""


class ObjectClasses(eqx.Module):
    """What the robot knows of N objects, one slot each.

    A slot is empty until its object was detected once. Which detection belongs to which slot is
    given, as by a tracker.

    Args:
        log_probability: (N, C) logarithm of the probability of each class.
        place: (N, 2) positions [m]; 0 in an empty slot.
        detected_at: (N,) time of the first detection [s]; infinite in an empty slot.
        viewed_from: (N, 2) position of the robot at the last look that counted [m]; infinite
            before.
        looks: (N,) number of looks that counted since the first detection, that one included.
        reported_at: (N, C) time at which each class was first certain [s]; infinite if it never
            was.
        reported_probability: (N, C) its probability then; 0 if it never was.
    """

    log_probability: Float[Array, "N C"]
    place: Float[Array, "N 2"]
    detected_at: Float[Array, " N"]
    viewed_from: Float[Array, "N 2"]
    looks: Int[Array, " N"]
    reported_at: Float[Array, "N C"]
    reported_probability: Float[Array, "N C"]

    @property
    def probability(self) -> Float[Array, "N C"]:
        """Probability of each class (N, C)."""
        return jnp.exp(self.log_probability)

    @property
    def is_known(self) -> Bool[Array, " N"]:
        """Whether each object was detected (N,)."""
        return jnp.isfinite(self.detected_at)

    @property
    def entropy(self) -> Float[Array, " N"]:
        """Entropy of the class of each object (N,), `-sum of p ln p` [nat]."""
        return jnp.sum(entr(self.probability), axis=-1)


class Look(NamedTuple):
    """What the detector says of N objects, measured (N, 2) and robot position (2,) [m]."""

    detections: Detections
    places: Float[Array, "N 2"]
    position: Position


class Recognition(Part):
    """Update of the classes of objects by a detector, and the information of one more look.

    A look at an object has an outcome z of `Detector`: a label, or a miss. Bayes' rule gives

        p(c | z) = P(z | c, r) p(c) / sum over c' of P(z | c', r) p(c')

    with r the distance. A miss counts as well, once the object was detected. The object is
    *reported* as c when p(c) reaches `certainty`.

    Images from one place show the same view, so their errors are not independent. A look counts if
    the robot has moved by `baseline` since the last one.

    The expected information of one more look is the mutual information of class and outcome:

        I(C; Z | r) = sum over z of P(z) KL(p(c | z) || p(c))
                    = H(Z) - sum over c of p(c) H(Z | c)                                     [nat]

    `add_information` adds `weight I` to the information field at each node from which the object
    would be in sight, in the sector that points to it. The robot then goes near what it does not
    recognise, and looks again from another place. Rollouts look the sum up in O(1).

    Sources: Bajcsy, "Active perception", Proceedings of the IEEE 1988; Denzler and Brown,
    "Information theoretic sensor data selection for active object recognition and state
    estimation", IEEE PAMI 2002; Atanasov, Sankaran, Le Ny, Pappas and Daniilidis, "Nonmyopic view
    planning for active object classification and pose estimation", IEEE T-RO 2014.

    Args:
        detector: the detector.
        prior: (C,) probability of each class of a new object; uniform when absent.
        certainty: probability at which a class is reported, in (1/2, 1).
        baseline: distance between two looks at an object that count [m].
        weight: weight of this information, relative to information on the occupancy.
        target: class of the targets; the first one when absent.

    Raises:
        ValueError: a prior that is not C probabilities that sum to 1, a class that is none of the
            detector's, a number out of its range.
    """

    name: ClassVar[str] = "detector"

    detector: Detector
    log_prior: Float[Array, " C"]
    certainty: Scalar
    baseline: Scalar
    weight: Scalar
    target: Array

    @_kinds.check_arguments
    def __init__(
        self,
        detector: Detector,
        *,
        prior: ArrayLike | Sequence[float] | None = None,
        certainty: ArrayLike = 0.95,
        baseline: ArrayLike = 0.5,
        weight: ArrayLike = 100.0,
        target: str | None = None,
    ) -> None:
        self.detector = detector
        count = detector.num_classes
        shares = np.full(count, 1.0 / count, np.float32) if prior is None else prior
        given = check_distributions("prior", shares, (count,))
        # A class whose prior is 0 stays impossible: its logarithm is -inf, which Bayes' rule keeps.
        self.log_prior = jnp.log(given)
        self.certainty = _checks.scalar("certainty", certainty, above=0.5, below=1.0)
        self.baseline = _checks.scalar("baseline", baseline, at_least=0.0)
        self.weight = _checks.scalar("weight", weight, at_least=0.0)
        label = detector.classes[0] if target is None else target
        self.target = on_device(np.asarray(detector.index_of("target", label), np.int32))

    def init_slots(self, num_objects: int) -> ObjectClasses:
        """Return the state before the first look, which the task gives for its objects.

        Args:
            num_objects: number of slots, N.

        Raises:
            ValueError: no slots.
        """
        number = _checks.positive_int("num_objects", num_objects)
        never, count = jnp.full(number, jnp.inf), self.detector.num_classes
        return ObjectClasses(
            log_probability=jnp.broadcast_to(self.log_prior, (number, count)),
            place=jnp.zeros((number, 2)),
            detected_at=never,
            viewed_from=jnp.full((number, 2), jnp.inf),
            looks=jnp.zeros(number, jnp.int32),
            reported_at=jnp.full((number, count), jnp.inf),
            reported_probability=jnp.zeros((number, count)),
        )

    def look(self, own: ObjectClasses, measured: Look, time: Scalar) -> ObjectClasses:
        """Return the state after an image.

        Args:
            own: the state before.
            measured: what the detector says; of the places those of detected objects are read.
            time: time since the start [s].
        """
        state, (detections, places, position) = own, measured
        moved = jnp.linalg.norm(position - state.viewed_from, axis=-1)
        is_look = detections.is_viewed & (moved >= self.baseline)
        is_hit = is_look & (detections.label < self.detector.num_classes)
        is_new = is_hit & ~state.is_known
        # A miss says nothing of an object that the robot does not know of.
        is_counted = is_look & (state.is_known | is_hit)
        posterior = jax.vmap(self.posterior)(
            state.log_probability, detections.label, detections.distance
        )
        log_probability = jnp.where(is_counted[:, None], posterior, state.log_probability)
        probability = jnp.exp(log_probability)
        is_report = is_counted[:, None] & (probability >= self.certainty)
        is_report = is_report & jnp.isinf(state.reported_at)
        return ObjectClasses(
            log_probability=log_probability,
            place=jnp.where(is_new[:, None], places, state.place),
            detected_at=jnp.where(is_new, time, state.detected_at),
            viewed_from=jnp.where(is_look[:, None], position, state.viewed_from),
            looks=state.looks + is_counted.astype(jnp.int32),
            reported_at=jnp.where(is_report, time, state.reported_at),
            reported_probability=jnp.where(is_report, probability, state.reported_probability),
        )

    def found(self, own: ObjectClasses) -> Bool[Array, " N"]:
        """Return which objects the robot has reported as targets."""
        return jnp.isfinite(own.reported_at[:, self.target])

    def merge(
        self, own: ObjectClasses, told: ObjectClasses, is_heard: Bool[Array, " N"]
    ) -> ObjectClasses:
        """Return the classes by the robot that has looked most often, of each object.

        The probabilities of two robots are not multiplied: each may hold looks of the other. First
        detections and reports are the earliest of all.
        """
        heard = is_heard[:, None]
        looks = jnp.where(heard, told.looks, -1)
        best, slots = jnp.argmax(looks, axis=0), jnp.arange(own.looks.shape[0])
        is_better = looks.max(axis=0) > own.looks

        def choose(mine: Array, theirs: Array) -> Array:
            mask = is_better.reshape(-1, *([1] * (mine.ndim - 1)))
            return jnp.where(mask, theirs[best, slots], mine)

        merged: ObjectClasses = jax.tree.map(choose, own, told)
        at = jnp.where(heard[..., None], told.reported_at, jnp.inf)
        first = jnp.argmin(at, axis=0)[None]
        probability = jnp.take_along_axis(told.reported_probability, first, axis=0)[0]
        is_earlier = at.min(axis=0) < own.reported_at
        detected_at = jnp.where(heard, told.detected_at, jnp.inf).min(axis=0)
        return dataclasses.replace(
            merged,
            detected_at=jnp.minimum(own.detected_at, detected_at),
            reported_at=jnp.minimum(own.reported_at, at.min(axis=0)),
            reported_probability=jnp.where(is_earlier, probability, own.reported_probability),
        )

    def posterior(
        self, log_probability: Float[Array, " C"], outcome: Array, distance: Scalar
    ) -> Float[Array, " C"]:
        """Return the logarithm of the probability of each class (C,) after a look.

        Args:
            log_probability: (C,) before the look.
            outcome: number of the label; C for a miss.
            distance: distance of the object [m].
        """
        joint = log_probability + self.detector.log_likelihood(distance)[:, outcome]
        return joint - logsumexp(joint)

    def expected_information(self, probability: Float[Array, " C"], distance: Scalar) -> Scalar:
        """Return the mutual information of class and outcome of a look, I(C; Z | r) [nat].

        Args:
            probability: (C,) probability of each class.
            distance: distance of the object [m].
        """
        likelihood = self.detector.likelihood(distance)
        given_class = jnp.sum(entr(likelihood), axis=-1)
        outcome = jnp.sum(probability[:, None] * likelihood, axis=0)
        # Rounding may make the difference of two equal entropies negative.
        return jnp.maximum(jnp.sum(entr(outcome)) - jnp.sum(probability * given_class), 0.0)

    def add_information(
        self, own: ObjectClasses, field: InformationField, grid: OccupancyGrid, sensor: Sensor
    ) -> InformationField:
        """Return an information field with the information of looks at the objects."""
        state, max_range = own, sensor.max_range
        shape, reach = field.total.shape, math.ceil(max_range / field.frame.resolution)
        # Only these nodes around an object can be in range of it.
        size = tuple(min(side, 2 * reach + 1) for side in shape)
        last = np.subtract(shape, size)
        around = jnp.stack(jnp.mgrid[: size[0], : size[1]], axis=-1)
        numbers = jnp.arange(field.sectors.shape[0])[:, None, None]
        # Most objects are either unknown or recognised: only the others cost time.
        is_open = state.is_known & (state.entropy > LEAST_ENTROPY)
        order = jnp.argsort(~is_open)

        def add(number: Array, added: Array) -> Array:
            index = order[number]
            middle = field.frame.to_cell(state.place[index])
            row, column = jnp.clip(middle - reach, 0, last)
            nodes = field.frame.cell_centre(around + jnp.stack([row, column]))
            gain, sector = self._gains(state, index, nodes, field, grid, max_range)
            before = jax.lax.dynamic_slice(added, (0, row, column), (len(numbers), *size))
            after = before + jnp.where(numbers == sector, gain, 0.0)
            return jax.lax.dynamic_update_slice(added, after, (0, row, column))

        count = jnp.sum(is_open, dtype=jnp.int32)
        added = jax.lax.fori_loop(0, count, add, jnp.zeros_like(field.sectors))
        return dataclasses.replace(
            field,
            sectors=field.sectors + added,
            cumulative=field.cumulative.at[1:].add(jnp.cumsum(added, axis=0)),
        )

    def _gains(
        self,
        state: ObjectClasses,
        index: Array,
        nodes: Float[Array, "rows columns 2"],
        field: InformationField,
        grid: OccupancyGrid,
        max_range: float,
    ) -> tuple[Float[Array, "rows columns"], Int[Array, "rows columns"]]:
        """Return the weighted information of a look at an object from each node, and the sector
        that points to it."""
        place, probability = state.place[index], state.probability[index]
        offset = place - nodes
        distance = jnp.linalg.norm(offset, axis=-1)
        look = jax.vmap(jax.vmap(self.expected_information, (None, 0)), (None, 0))
        # A look from where the last one was does not count.
        is_apart = jnp.linalg.norm(nodes - state.viewed_from[index], axis=-1) >= self.baseline
        is_looking = is_apart & (distance <= max_range)
        is_looking = is_looking & is_in_sight(grid, nodes, place, grid.resolution)
        gain = jnp.where(is_looking, self.weight * look(probability, distance), 0.0)
        turn = (jnp.arctan2(offset[..., 1], offset[..., 0]) - field.frame.origin[2]) / (2 * jnp.pi)
        count = field.sectors.shape[0]
        sector = ((turn - jnp.floor(turn)) * count).astype(jnp.int32)
        return gain, jnp.minimum(sector, count - 1)
