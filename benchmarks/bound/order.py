"""Order of stops of an open tour, by PyVRP."""

from typing import Any

import numpy as np

ITERATIONS = 500
"""Iterations of PyVRP's iterated local search."""
UNIT = 1000.0
"""PyVRP counts in whole numbers: millimetres."""
_EXACT = 3
"""Number of stops up to which there is nothing to search."""


def open_tour(lengths: np.ndarray, *, iterations: int = ITERATIONS, seed: int = 0) -> list[int]:
    """Return the order in which a tour visits all stops: the shortest that was found.

    The tour begins at stop 0 and ends at any stop (open travelling salesman problem). PyVRP's tours
    end at a depot, so one is added to which every stop is at the distance 0.

    Args:
        lengths: (n, n) lengths of the ways between the stops, symmetric and finite [m].
        iterations: iterations of the search.
        seed: seed of the search.

    Raises:
        ValueError: lengths that are not square or not finite; PyVRP is not installed.
    """
    if lengths.ndim != 2 or lengths.shape[0] != lengths.shape[1] or len(lengths) == 0:
        raise ValueError(f"lengths has shape {lengths.shape}; accepted: (n, n) with n >= 1")
    if not np.isfinite(lengths).all():
        raise ValueError("lengths has values that are not finite; accepted: connected stops")
    count = len(lengths)
    if count <= _EXACT - 1:
        return list(range(count))
    try:
        import pyvrp
        from pyvrp.stop import MaxIterations
    except ImportError:
        raise ValueError(
            "PyVRP is not installed; accepted: an installation with pip install '.[dev]'"
        ) from None
    # The last place is the added end.
    distance: Any = np.zeros((count + 1, count + 1), np.int64)
    distance[:count, :count] = np.rint(lengths * UNIT)
    # Nothing leads back from the end.
    distance[count, :count] = distance.max() * count
    # PyVRP minimises the distance alone.
    duration: Any = np.zeros_like(distance)
    places = [pyvrp.Location(0.0, 0.0) for _ in range(count + 1)]
    data = pyvrp.ProblemData(
        places,
        [pyvrp.Client(stop) for stop in range(1, count)],
        [pyvrp.Depot(0), pyvrp.Depot(count)],
        [pyvrp.VehicleType(start_depot=0, end_depot=1)],
        [distance],
        [duration],
    )
    found = pyvrp.solve(data, MaxIterations(iterations), seed, False, False)
    (route,) = found.best.routes()
    stops = [each.idx + 1 for each in route.schedule() if each.is_client()]
    return [0, *stops]
