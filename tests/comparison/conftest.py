"""One small room twice, and settings that are quick: all runs share one compiled loop."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import jaxplore as jx
from jaxplore.study.comparison.episodes import EpisodeBatch, MapEpisode, make_episodes
from jaxplore.study.comparison.maps import MapFile, maps_in
from jaxplore.study.comparison.rows import TIMING, Row, make_failed_row
from jaxplore.study.comparison.store import Plan, Store, open_store

SMALL: dict[str, Any] = {
    "time_limit": 1.5,
    "rates": {"control": 20.0},
    "lidar": {"num_beams": 16, "max_range": 1.0},
    "controller": {"num_samples": 16, "horizon": 8},
    "fields": {"num_directions": 8},
}


@pytest.fixture
def small() -> dict[str, Any]:
    return SMALL


@pytest.fixture
def write_map() -> Callable[..., Path]:
    def write(path: Path, pillar: int = 20, **entries: object) -> Path:
        """Write a room of 4 m x 3 m with a pillar; entries replace those of the YAML file."""
        world = np.zeros((30, 40), np.float32)
        world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
        world[12:16, pillar : pillar + 3] = 1.0
        path.parent.mkdir(parents=True, exist_ok=True)
        jx.OccupancyGrid(world, 0.1).to_ros(path)
        written = yaml.safe_load(path.read_text()) | entries
        path.write_text(yaml.safe_dump(written))
        return path

    return write


@pytest.fixture
def maps(tmp_path: Path, write_map: Callable[..., Path]) -> tuple[MapFile, ...]:
    """Two maps, and where to start on one of them."""
    write_map(tmp_path / "maps" / "east.yaml", 26)
    write_map(tmp_path / "maps" / "west.yaml", 12)
    (tmp_path / "maps" / "starts.yaml").write_text("east: [1.0, 1.5, 0.5]")
    return maps_in(tmp_path / "maps")


@pytest.fixture
def plan(maps: tuple[MapFile, ...]) -> Plan:
    return Plan(maps, ("explorer",), (0, 1), SMALL)


@pytest.fixture
def episodes(plan: Plan) -> tuple[MapEpisode, ...]:
    return make_episodes(plan.maps, plan.variants, plan.seeds, plan.settings)


@pytest.fixture
def store(tmp_path: Path, plan: Plan) -> Store:
    return open_store(tmp_path / "out", plan)


@pytest.fixture
def timeless() -> Callable[[Store], list[Row]]:
    def read(store: Store) -> list[Row]:
        """Return the table of all results without wall-clock times."""
        import pyarrow.parquet

        rows = pyarrow.parquet.read_table(store.results).to_pylist()
        return [{k: v for k, v in row.items() if k not in TIMING} for row in rows]

    return read


@pytest.fixture
def pretend() -> Callable[[EpisodeBatch], list[Row]]:
    def make(batch: EpisodeBatch) -> list[Row]:
        """Return rows that say how they were made, without a run."""
        return [
            {**make_failed_row(episode, "none"), "error": None, "coverage": episode.seed / 100.0}
            for episode in batch
        ]

    return make
