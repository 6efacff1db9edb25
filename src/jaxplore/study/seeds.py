"""Bounds of the numbers of seeds, runs and candidates of a study."""

from collections.abc import Sequence

from jaxplore._limits import MOST_CANDIDATES, MOST_SEEDS

LAST = 2**32 - 1
"""Last seed of a run."""


def check_number_of_seeds(name: str, seeds: Sequence[int]) -> None:
    """Check that there are at most `MOST_SEEDS` seeds, without looking at each of them.

    The last one of a range must fit into 32 bits. The name is that of the argument.
    """
    # `len` of a range of more than 2**63 numbers is an error.
    number = seeds[-1] - seeds[0] + 1 if isinstance(seeds, range) and seeds else len(seeds)
    if number > MOST_SEEDS:
        raise ValueError(f"{name} has {number} seeds; accepted: at most {MOST_SEEDS}")
    if isinstance(seeds, range) and seeds and seeds[-1] > LAST:
        raise ValueError(f"{name} end at {seeds[-1]}; accepted: up to {LAST}")


def check_number_of_runs(number: int) -> None:
    """Check that a comparison has at most `MOST_CANDIDATES` runs."""
    if number > MOST_CANDIDATES:
        raise ValueError(f"the comparison has {number} runs; accepted: at most {MOST_CANDIDATES}")
