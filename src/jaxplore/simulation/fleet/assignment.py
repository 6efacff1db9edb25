"""Assignment of clusters of frontier cells to robots, by the shortest sum of paths; host code."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from jaxplore._xla import on_device
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.fleet.radio import NEVER, Heard

ELSEWHERE = 100.0
"""Cost of places that are not nearest to the assigned cluster [m]: a robot leaves its cluster for
nothing nearer than that, and still before the places with little information."""
SMALLEST_CLUSTER = 0.5
"""Least length of a cluster of frontier cells [m]; smaller ones are mostly noise at walls."""
NO_WAY = 1e6
"""Cost of a path where there is none [m]: the optimisation needs finite numbers."""


def frontier_clusters(probability: np.ndarray, resolution: float) -> list[np.ndarray]:
    """Find the clusters of frontier cells of a map: free cells beside an unknown one.

    Cells that touch, also at a corner, are in one cluster (Yamauchi, "A frontier-based approach for
    autonomous exploration", CIRA 1997). A cluster is its cells (n, 2) as (row, column). The largest
    one is first, and those shorter than `SMALLEST_CLUSTER` are left out.
    """
    import scipy.ndimage  # slow to import, and few need it

    # A cell counts as unknown above half of the greatest variance, p between 0.15 and 0.85.
    unknown = np.pad(4.0 * probability * (1.0 - probability) > 0.5, 1)
    beside = unknown[2:, 1:-1] | unknown[:-2, 1:-1] | unknown[1:-1, 2:] | unknown[1:-1, :-2]
    labels, count = scipy.ndimage.label((probability < FREE_THRESHOLD) & beside, np.ones((3, 3)))
    cells = np.argwhere(labels)
    order = np.argsort(labels[tuple(cells.T)], kind="stable")
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    clusters = np.split(cells[order], np.cumsum(sizes)[:-1]) if count else []
    large = [each for each in clusters if len(each) * resolution >= SMALLEST_CLUSTER]
    return sorted(large, key=len, reverse=True)


def cluster_costs(lengths: np.ndarray, clusters: Sequence[np.ndarray], stride: int) -> np.ndarray:
    """Return the length of the shortest path of each robot to each cluster (N, C) [m].

    A robot keeps clear of unknown space, so paths end at a node near the cluster: the length is the
    least over nodes up to three nodes away. `lengths` (N, rows, columns) are those of the paths to
    the nodes [m], which are `stride` cells apart.
    """
    import scipy.ndimage  # slow to import, and few need it

    near = scipy.ndimage.minimum_filter(lengths, size=(1, 7, 7), mode="nearest")
    costs = [near[:, *(each // stride).T].min(axis=1) for each in clusters]
    return np.stack(costs, axis=1) if costs else np.zeros((len(lengths), 0))


def assign_clusters(costs: np.ndarray) -> np.ndarray:
    """Assign a cluster to each robot (N,), such that the sum of the costs is least; -1 for none.

    With C clusters, C robots get one each if there are more robots, and no cluster goes to two
    robots (Kuhn, "The Hungarian method for the assignment problem", 1955). A cost (N, C) is
    infinite where there is no path.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import, and few need it

    chosen = np.full(len(costs), -1)
    rows, columns = linear_sum_assignment(np.minimum(costs, NO_WAY))
    has_way = np.isfinite(costs[rows, columns])
    chosen[rows[has_way]] = columns[has_way]
    return chosen


def with_assignments(
    scenarios: Sequence[ExplorationScenario],
    members: Sequence[ExplorationState],
    places: Sequence[int],
    heard: Heard,
) -> tuple[ExplorationState, ...]:
    """Return the robots' states with claims that lead each one to the cluster assigned to it.

    Every robot computes the assignment by itself, from its own map and from the lengths of paths
    that it has heard. Robots that have heard the same agree. A robot without a cluster is free to
    go anywhere. `places` are those of the robots in the fleet.
    """
    version, lengths = np.asarray(heard.version), np.asarray(heard.lengths)
    after = []
    for i, one, state in zip(places, scenarios, members, strict=True):
        grid, stride = state.belief.grid, one.perception.field_sensor.stride
        clusters = frontier_clusters(np.asarray(grid.probability), grid.resolution)
        is_heard = version[i] != NEVER
        costs = cluster_costs(lengths[i][is_heard], clusters, stride)
        # The place of this robot among those that it has heard.
        own = int(np.sum(is_heard[:i]))
        chosen = assign_clusters(costs)[own] if is_heard[i] and costs.size else -1
        claims = np.zeros(lengths.shape[2:], np.float32)
        if chosen >= 0:
            claims = ELSEWHERE * (_nearest_cluster(clusters, claims.shape, stride) != chosen)
        belief = dataclasses.replace(state.belief, claims=on_device(claims.astype(np.float32)))
        after.append(state.with_belief(belief))
    return tuple(after)


def _nearest_cluster(
    clusters: Sequence[np.ndarray], shape: tuple[int, ...], stride: int
) -> np.ndarray:
    """Return the number of the cluster that is nearest to each node (rows, columns)."""
    import scipy.ndimage  # slow to import, and few need it

    number = np.full(shape, -1)
    # The largest come first; where two share a node, the larger one has it.
    for index, each in reversed(list(enumerate(clusters))):
        number[tuple((each // stride).T)] = index
    _, nearest = scipy.ndimage.distance_transform_edt(number < 0, return_indices=True)
    return np.asarray(number[tuple(nearest)])
