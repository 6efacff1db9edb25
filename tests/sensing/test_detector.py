"""The detector: what it says as often as its confusion matrix and its recall say."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.sensing import Detector

CLASSES = ("person", "barrel", "door")
CONFUSION = ((0.7, 0.2, 0.1), (0.05, 0.9, 0.05), (0.0, 0.3, 0.7))
DETECTOR = Detector(CLASSES, CONFUSION, recall=(0.9, 0.6, 1.0), reach=4.0)
DRAWS, DISTANCES = 20000, (0.0, 2.0, 5.0)


def slow_likelihood(distance: float) -> np.ndarray:
    """Return P(outcome | class), class by class, in double precision."""
    table = np.zeros((3, 4))
    for own, most in enumerate((0.9, 0.6, 1.0)):
        recall = most * np.exp(-((distance / 4.0) ** 2))
        for label in range(3):
            table[own, label] = recall * CONFUSION[own][label]
        table[own, 3] = 1.0 - recall
    return table


def test_outcomes_are_as_frequent_as_the_matrix_and_the_recall_say() -> None:
    label = np.repeat(np.arange(3), len(DISTANCES) * DRAWS).astype(np.int32)
    distance = np.tile(np.repeat(np.float32(DISTANCES), DRAWS), 3)
    found = jax.jit(Detector.detect)(
        DETECTOR, label, distance, np.ones(len(label), bool), key=jax.random.key(3)
    )
    outcome = np.asarray(found.label).reshape(3, len(DISTANCES), DRAWS)
    for own in range(3):
        for column, away in enumerate(DISTANCES):
            wanted = slow_likelihood(away)[own]
            share = np.bincount(outcome[own, column], minlength=4) / DRAWS
            # Five standard deviations of a binomial share: 36 shares, one in 40000 such tests.
            bound = 5.0 * np.sqrt(wanted * (1.0 - wanted) / DRAWS)
            assert (np.abs(share - wanted) <= bound + 1e-9).all()


def test_likelihoods_are_those_of_the_enumeration() -> None:
    found = jax.jit(jax.vmap(DETECTOR.likelihood))(jnp.asarray(DISTANCES))
    wanted = np.stack([slow_likelihood(away) for away in DISTANCES])
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    np.testing.assert_allclose(np.asarray(found).sum(axis=-1), 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"confusion": ((0.7, 0.2, 0.2), *CONFUSION[1:])}, r"confusion\[0\] sums to 1.1; accepted"),
        ({"confusion": CONFUSION[:2]}, r"confusion has shape \(2, 3\); accepted: \(3, 3\)"),
        ({"classes": ("person", "person", "door")}, "classes is .* at least two different names"),
        ({"classes": ("person",)}, "classes is .* at least two different names"),
        ({"recall": (0.5, 1.5, 0.5)}, r"recall is \[0.5, 1.5, 0.5\]; accepted"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments, message) -> None:
    with pytest.raises(ValueError, match=message):
        Detector(**{"classes": CLASSES, "confusion": CONFUSION} | arguments)
