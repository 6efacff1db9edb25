"""Offline bounds of an exploration: what a robot that knows the map would drive.

`python -m benchmarks.bound RUN...` compares run folders with them.

Two numbers enclose the optimum, the shortest way on which the sensor sees a share of the reachable
cells:

- the **tour** (`tour`) is one such way, found with knowledge of the map. It is feasible, so it is
  an upper bound of the optimum. It is a good way, not a proven best one.
- the **floor** (`floor`) is a length that no way can be shorter than: a lower bound.

The length of a run divided by the tour is therefore at most what it is divided by the optimum.
Divided by the floor it is at least that.
"""
