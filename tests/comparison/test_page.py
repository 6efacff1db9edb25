"""The page of results: what is on it, and that it needs nothing else."""

import base64
import io
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxplore import OccupancyGrid
from jaxplore.maps import Datum
from jaxplore.study.comparison.page import RIM, curves_figure, find_known_part, page, path_figure
from jaxplore.study.comparison.replay import NEVER
from jaxplore.study.comparison.store import Store
from jaxplore.study.comparison.table import map_tables

SEEN = np.repeat(np.arange(2, dtype=np.uint8), 15) * np.ones((16, 1), np.uint8)
SEEN[0] = NEVER
"""Of a map whose left half was seen at first, its right half then, its uppermost row never."""


def png(picture: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(picture).save(file, format="PNG")
    return file.getvalue()


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
        "seen_time": [0.0, 5.0],
        "seen": png(SEEN),
        "settings": json.dumps({"robot": {"radius": 0.2}}),
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
        elif tag not in ("meta", "input"):
            self.open.append(tag)
            if tag in self.texts:
                self.texts[tag].append("")

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        if self.open and self.open[-1] in self.texts:
            self.texts[self.open[-1]][-1] += data


def test_runs_on_a_map_far_away_are_drawn_on_their_map() -> None:
    datum = Datum(500_000.0, 4_649_776.0)
    far = [
        each
        if each["error"] is not None
        else {
            **each,
            "positions_x": [x + datum.x for x in each["positions_x"]],
            "positions_y": [y + datum.y for y in each["positions_y"]],
        }
        for each in ROWS
    ]
    shown = [
        re.search(r'<script type="application/json" id="runs">(.*)</script>', text).group(1)
        for text in (
            page(ROWS, {"room": GRID}, "x"),
            page(far, {"room": GRID}, "x", dict.fromkeys(("room", "a <b>& c"), datum)),
        )
    ]
    assert shown[0] == shown[1]


@pytest.fixture(scope="module")
def read() -> Reader:
    text = page(ROWS, {"room": GRID}, "Explorers on <maps>")
    reader = Reader()
    reader.feed(text)
    assert not reader.open
    # Nothing is loaded from anywhere, and the browser would not let it.
    assert "://" not in text
    assert "default-src 'none'" in text
    assert text.count("<script") == 2
    return reader


def test_it_has_every_map_and_every_number_of_the_tables(read: Reader) -> None:
    assert read.texts["h1"] == ["Explorers on <maps>"]
    tables = map_tables(ROWS)
    assert read.texts["h2"] == [table.map for table in tables] == ["room", "a <b>& c"]
    rows = [cells for table in tables for cells in table.rows[1:]]
    assert read.texts["td"] == [cell for cells in rows for cell in cells]
    assert any("broken, explorer: 1 run failed: map <x>" in text for text in read.texts["p"])


def test_pictures_are_in_it_and_can_be_read(read: Reader) -> None:
    # Curves of both maps, two paths on the one whose map is there.
    assert len(read.images) == 4
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
    places = {"positions_x": [1.7, 1.7], "positions_y": [-0.5, 0.0]}
    moved = row("room", "explorer", 0, curve_time=[0.0, 0.5], curve_coverage=[0.1, 0.2], **places)
    (axes,) = path_figure(moved, turned, find_known_part(turned)).axes
    across, along = axes.get_lines()[0].get_data()
    np.testing.assert_allclose(across, [4.5, 9.5], atol=1e-6)
    np.testing.assert_allclose(along, [2.5, 2.5], atol=1e-6)


def test_each_robot_of_a_fleet_has_its_way() -> None:
    first = row("room", "claims", 0)
    second = [2.5 - x for x in first["positions_x"]], [1.0] * len(first["positions_y"])
    fleet = row(
        "room",
        "claims",
        0,
        positions_x=[*first["positions_x"], *second[0]],
        positions_y=[*first["positions_y"], *second[1]],
    )
    (axes,) = path_figure(fleet, GRID, find_known_part(GRID)).axes
    # Of each robot its way, its start and its end.
    ways = axes.get_lines()[::3]
    assert len(axes.get_lines()) == 6
    np.testing.assert_allclose(ways[0].get_xdata()[0], 4.5)
    np.testing.assert_allclose(ways[1].get_data()[0], 10.0 * np.array(second[0]) - 0.5)
    np.testing.assert_allclose(ways[1].get_data()[1], 9.5)
    assert ways[0].get_color() != ways[1].get_color()
    text = page([fleet], {"room": GRID}, "Fleet")
    data = json.loads(re.search(r'id="runs">(.*)</script>', text).group(1))
    (run,) = data["runs"]
    assert [len(each) for each in (run["across"], run["down"], run["inks"])] == [2, 2, 2]
    assert run["down"][1][0] == pytest.approx(16 - 10.0)


def test_what_was_known_from_the_beginning_is_replayed_at_once() -> None:
    text = page([row("room", "path", 0, seen=None, seen_time=[])], {"room": GRID}, "Path")
    data = json.loads(re.search(r'id="runs">(.*)</script>', text).group(1))
    (run,) = data["runs"]
    picture = Image.open(io.BytesIO(base64.b64decode(run["seen"].partition(",")[2])))
    assert not np.asarray(picture).any()
    assert run["seen_time"] == [0.0]


def test_a_run_without_a_whole_picture_has_a_path_and_no_replay() -> None:
    """Pictures that are damaged, or of a smaller map; a row without curves is not drawn."""
    rows = [
        row("room", "explorer", 0, seen=png(SEEN)[:40]),
        row("room", "wander", 0, seen=png(SEEN[2:])),
        row("room", "bare", 0, curve_time=None, seen=None),
    ]
    text = page(rows, {"room": GRID}, "Damaged")
    assert "data-run" not in text
    assert text.count("<figure>") == 2


def in_the_unknown(grid: OccupancyGrid, margin: int = 5) -> OccupancyGrid:
    """Return a map with unknown cells all around."""
    corner = -margin * grid.resolution
    probability = np.pad(np.asarray(grid.probability), margin, constant_values=0.5)
    return OccupancyGrid(probability, grid.resolution, (corner, corner, 0.0))


def test_only_what_is_known_of_a_map_is_drawn() -> None:
    assert find_known_part(GRID) == (slice(0, 16), slice(0, 30))
    roomy = in_the_unknown(GRID)
    part = find_known_part(roomy)
    assert roomy.probability[part].shape == (16 + 2 * RIM, 30 + 2 * RIM)
    (axes,) = path_figure(ROWS[0], roomy, part).axes
    assert axes.get_images()[0].get_array().shape[:2] == (16 + 2 * RIM, 30 + 2 * RIM)
    across, along = axes.get_lines()[0].get_data()
    assert (across[0], along[0]) == (pytest.approx(4.5 + RIM), pytest.approx(7.5 + RIM))
    nothing = OccupancyGrid.unknown((4, 6), GRID.frame)
    assert nothing.probability[find_known_part(nothing)].shape == (4, 6)


def test_curves_end_when_most_runs_have() -> None:
    late = row("room", "wander", 0, duration=400.0, curve_time=[0.0, 400.0], curve_coverage=[0, 1])
    figure = curves_figure([*ROWS[:4], late])
    assert figure.axes[0].get_xlim() == (0.0, 11.0)
    assert curves_figure(ROWS[:1]).axes[0].get_xlim() == (0.0, 10.0)


PRESS = """
<script>
addEventListener("load", async () => {
  const part = (name) => document.querySelector(`#replay [data-part="${name}"]`);
  const wait = (seconds) => new Promise((done) => setTimeout(done, 1000 * seconds));
  const told = [];
  const tell = (what) => {
    const canvas = part("map"), scale = canvas.width / 34;
    const colour = (column, row) => [...canvas.getContext("2d").getImageData(
      scale * (column + 2.5), scale * (row + 2.5), 1, 1).data.slice(0, 3)].join(" ");
    told.push([what, document.getElementById("replay").open, part("title").textContent,
      part("told").textContent, canvas.width, canvas.height,
      colour(2, 12), colour(27, 12), colour(2, 0), colour(2, 15)].join("|"));
  };
  tell("before");
  document.querySelectorAll("button[data-run]")[1].click();
  // Pictures are decoded beside the page's clock: on a busy machine seconds of it go by.
  while (!document.getElementById("replay").open) await wait(0.1);
  part("toggle").click();
  for (const instant of [2.0, 7.0]) {
    part("time").value = instant;
    part("time").dispatchEvent(new Event("input"));
    tell(`at ${instant}`);
  }
  part("toggle").click();
  await wait(20);
  tell("end");
  document.querySelector("#replay form button:last-child").click();
  await wait(1);
  tell("closed");
  document.body.dataset.told = told.join(";");
});
</script>
"""
"""Clicks on the second run, looks at two instants, lets it play to its end and closes it."""


@pytest.mark.skipif(
    shutil.which("chromium") is None, reason="no Chromium: apt-get install chromium"
)
def test_a_click_replays_a_run_in_a_browser(tmp_path: Path) -> None:
    roomy = [
        {**each, "seen": png(np.pad(SEEN, 5, constant_values=NEVER))}
        for each in ROWS
        if each["map"] == "room"
    ]
    text = page(roomy, {"room": in_the_unknown(GRID)}, "Explorers")
    file = tmp_path / "page.html"
    file.write_text(text.replace("</body>", PRESS + "</body>"), encoding="utf-8")
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=3600000"]
    done = subprocess.run(
        [*command, file.as_uri()], capture_output=True, text=True, timeout=120, check=True
    )
    (told,) = re.findall(r'data-told="([^"]*)"', done.stdout)
    looks = dict(look.split("|", 1) for look in told.split(";"))
    assert looks["before"].startswith("false|")
    assert looks["closed"].startswith("false|")
    unknown, free, wall = ("190 195 203", "252 252 250", "43 48 58")
    opened = "true|nearest-frontier on room, seed 0"
    size = "884|520"
    assert looks["at 2"] == f"{opened}|2.0 s, 20.0 %|{size}|{free}|{unknown}|{unknown}|{wall}"
    assert looks["at 7"] == f"{opened}|7.0 s, 70.0 %|{size}|{free}|{free}|{unknown}|{wall}"
    assert looks["end"] == f"{opened}|10.0 s, 100.0 %|{size}|{free}|{free}|{unknown}|{wall}"


def test_figures_of_the_page_are_written_as_vectors(tmp_path: Path) -> None:
    store = Store(tmp_path)
    rows = [{**row, "map": row["map"].replace("room", "house/room")} for row in ROWS]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Store, "rows", lambda *_: rows)
        store.write_figures({"house/room": GRID}, ["svg", "pdf"])
    runs = [row for row in rows if row["error"] is None and row["map"] == "house/room"]
    names = {f"house_room-{row['explorer']}-path" for row in runs} | {"house_room-curves"}
    found = {path.name for path in (tmp_path / "figures").iterdir()}
    expected = {f"{name}.{kind}" for name in names for kind in ("svg", "pdf")}
    assert {name for name in found if name.startswith("house_room")} == expected
