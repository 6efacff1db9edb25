"""The problem that the benchmarks run: a 0.4 m robot at 1 m/s with a 360-beam 5 m lidar."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxplore.simulation.experiment import Experiment
from jaxplore.tasks.registry import build, make_settings

MAPS = Path(
    os.environ.get("JAXPLORE_MAPS", Path(__file__).resolve().parents[2] / "shared" / "maps")
)


class Site(NamedTuple):
    """A map and an open spot on it."""

    name: str
    path: str
    start: tuple[float, float, float] | None


SITES = (
    Site("nav2_depot", "nav2_depot/depot.yaml", (4.62, 7.73, 0.0)),
    Site("aws_small_house", "aws_small_house/map.yaml", (4.68, -1.97, 0.0)),
    Site("aws_small_warehouse_005", "aws_small_warehouse_005/map.yaml", (-0.92, -2.47, 0.0)),
)
OFFICE = Site("office", "office", None)
SMALL_OFFICE = Site("small office", "office", None)
SMALL: dict[str, Any] = {
    "office": {"width": 8.0, "height": 7.0},
    "lidar": {"num_beams": 90, "max_range": 4.0},
    "controller": {"num_samples": 64},
    "guard": False,
    "time_limit": 0.5,
}
"""Changes of the default explorer that make it cheap: its loop is that of the documents for a first
run, which the suite compiles anyway, and that of the other sections in a small office."""


def available_sites() -> tuple[Site, ...]:
    """Return the real maps where they are, the generated office otherwise."""
    found = tuple(site for site in SITES if (MAPS / site.path).exists())
    return found or (OFFICE,)


def experiment(site: Site, seed: int = 0, **changes: object) -> Experiment:
    """Return the default explorer on a site."""
    path = site.path if site in (OFFICE, SMALL_OFFICE) else str(MAPS / site.path)
    entries = {"map": path, "start": site.start, "seed": seed, "time_limit": 400.0, **changes}
    return build(make_settings(entries))


def available_maps(files: Mapping[str, str]) -> dict[str, str]:
    """Return the real maps where they are, the generated office otherwise.

    Args:
        files: files of maps in the folder of maps, by name.
    """
    found = {name: str(MAPS / path) for name, path in files.items() if (MAPS / path).exists()}
    return found or {OFFICE.name: OFFICE.path}
