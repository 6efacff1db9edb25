"""Coverage, entropy and path length over a run, and its stalls."""

from collections import deque

import numpy as np

from jaxplore.report.coverage_levels import LEVELS, at_instants
from jaxplore.report.exploration.data import ExplorationData
from jaxplore.report.exploration.mission import MissionData

STALL_RADIUS = 0.25
"""Half the side of the square within which a robot counts as stalled [m]."""


def progress(
    recording: ExplorationData,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray]:
    """Compute time [s], coverage, entropy [nat] and path length [m] of all robots at the N + 1
    instants of a run, see `at_instants`. Of several robots the entropy is None."""
    records = recording.records
    coverage, entropy = (
        None if values is None else at_instants(values, initial).astype(np.float32)
        for values, initial in (
            (records.coverage, recording.initial_coverage),
            (records.entropy, recording.initial_entropy),
        )
    )
    assert coverage is not None
    path = np.sum([each.lengths for each in recording.robots], axis=0)
    return recording.time, coverage, entropy, path


def longest_stall(positions: np.ndarray, coverage: np.ndarray) -> int:
    """Return the number of steps of the longest stall, of N + 1 positions [m] and coverages.

    One pass with a sliding window: the later end advances, the earlier one follows as needed.
    Four monotonic queues keep the window's extremes, so the whole pass is O(N).
    """
    # Noise can lower the coverage, and a return to a former value is no rise.
    best = np.maximum.accumulate(coverage).tolist()
    # With each axis negated as well, all queues keep maxima: their sums are the window's extents.
    axes = [signed.tolist() for axis in positions.T for signed in (axis, -axis)]
    queues: list[deque[int]] = [deque() for _ in axes]
    first = longest = 0
    for last in range(len(positions)):
        for values, queue in zip(axes, queues, strict=True):
            while queue and values[queue[-1]] <= values[last]:
                queue.pop()
            queue.append(last)
        while best[first] != best[last] or any(
            axes[i][queues[i][0]] + axes[i + 1][queues[i + 1][0]] > 2.0 * STALL_RADIUS
            for i in (0, 2)
        ):
            first += 1
            for queue in queues:
                if queue[0] < first:
                    queue.popleft()
        longest = max(longest, last - first)
    return longest


def is_known_map(recording: MissionData) -> bool:
    """Return whether the map was known in advance, so that its coverage says nothing."""
    # Before the first scan: one scan may see all of a small room.
    return recording.initial_unknown <= 1.0 - LEVELS[-1] / 100
