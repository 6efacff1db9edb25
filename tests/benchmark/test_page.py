"""The page of results: what is on it, and that it needs nothing else."""

import base64
import io
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from jaxplore import OccupancyGrid
from jaxplore.benchmark.page import curves_figure, page, paths_figure
from jaxplore.benchmark.table import map_tables


def row(map_: str, explorer: str, seed: int, **changes) -> dict:
    """Return a run that covers the map evenly in ten seconds and a bit for each seed."""
    time = np.arange(0.0, 10.5 + seed, 0.5)
    return {
        "map": map_,
        "explorer": explorer,
        "seed": seed,
        "error": None,
        "is_finished": True,
        "time_to_90": 9.0 + seed,
        "path_to_90": 4.0,
        "time_to_99": 10.0 + seed,
        "path_to_99": 5.0,
        "coverage": 1.0,
        "collisions_per_100m": 0.0,
        "curve_time": time.tolist(),
        "curve_coverage": (time / time[-1]).tolist(),
        "duration": float(time[-1]),
        "positions_x": (0.5 + 0.1 * time).tolist(),
        "positions_y": np.full_like(time, 0.8).tolist(),
        "time_limit": 60.0,
        **changes,
    }


ROWS = [
    *(row("room", name, seed) for name in ("explorer", "nearest-frontier") for seed in (0, 1)),
    row("a <b>& c", "explorer", 0),
    row("broken", "explorer", 0, error="map <x> cannot be read"),
]
GRID = OccupancyGrid(np.pad(np.zeros((14, 28), np.float32), 1, constant_values=1.0), 0.1)


class Reader(HTMLParser):
    """Keeps headings, cells and images, and checks that what is opened is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: dict[str, list[str]] = {name: [] for name in ("h1", "h2", "th", "td", "p")}
        self.images: list[dict] = []

    def handle_starttag(self, tag, attrs) -> None:
        if tag == "img":
            self.images.append(dict(attrs))
        elif tag != "meta":
            self.open.append(tag)
            if tag in self.texts:
                self.texts[tag].append("")

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        if self.open and self.open[-1] in self.texts:
            self.texts[self.open[-1]][-1] += data


@pytest.fixture(scope="module")
def read() -> Reader:
    text = page(ROWS, {"room": GRID}, "Explorers on <maps>")
    reader = Reader()
    reader.feed(text)
    assert not reader.open
    # Nothing is loaded from anywhere.
    assert "http" not in text
    assert "<script" not in text
    return reader


def test_it_has_every_map_and_every_number_of_the_tables(read: Reader) -> None:
    assert read.texts["h1"] == ["Explorers on <maps>"]
    tables = map_tables(ROWS)
    assert read.texts["h2"] == [table.map for table in tables] == ["room", "a <b>& c"]
    rows = [cells for table in tables for cells in table.rows[1:]]
    assert read.texts["td"] == [cell for cells in rows for cell in cells]
    assert any("broken, explorer: 1 run failed: map <x>" in text for text in read.texts["p"])


def test_pictures_are_in_it_and_can_be_read(read: Reader) -> None:
    # Curves of both maps, paths of the one whose map is there.
    assert len(read.images) == 3
    for image in read.images:
        kind, _, data = image["src"].partition(",")
        assert kind == "data:image/png;base64"
        picture = Image.open(io.BytesIO(base64.b64decode(data)))
        assert min(picture.size) > 100
        assert image["alt"]


def test_curves_are_medians_over_seeds() -> None:
    figure = curves_figure([each for each in ROWS if each["map"] == "room"])
    lines = figure.axes[0].get_lines()
    assert [line.get_label() for line in lines] == ["explorer", "nearest-frontier"]
    time, median = lines[0].get_data()
    expected = 50.0 * (np.minimum(time / 10.0, 1.0) + np.minimum(time / 11.0, 1.0))
    np.testing.assert_allclose(median, expected, atol=1e-6)


def test_paths_are_where_the_robot_was_on_a_turned_map() -> None:
    turned = OccupancyGrid(GRID.probability, 0.1, (2.0, -1.0, np.pi / 2))
    # 0.5 m along the map's rows, 0.3 m across them, from its corner.
    moved = row("room", "explorer", 0, positions_x=[1.7, 1.7], positions_y=[-0.5, 0.0])
    (axes,) = paths_figure([moved], turned).axes
    across, along = axes.get_lines()[0].get_data()
    np.testing.assert_allclose(across, [4.5, 9.5], atol=1e-6)
    np.testing.assert_allclose(along, [2.5, 2.5], atol=1e-6)
