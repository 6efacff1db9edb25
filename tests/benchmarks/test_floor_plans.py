"""Floor plans of other projects: our reading of their data, and the end of each protocol.

All plans have one padded shape and one lidar, so that all runs share a compiled program.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.protocols.floor_plans import (
    GRID_END,
    PROTOCOLS,
    Protocol,
    explore,
    main,
    read_plans,
    summarise,
    unseen_target,
)
from benchmarks.protocols.plan_files import CELL, FRAME, Plan
from PIL import Image

from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.simulation.loop import run_chunk
from jaxplore.simulation.run import Run

pytestmark = pytest.mark.long

SHAPE = (60, 90)
OPEN = np.zeros(SHAPE, bool)
"""Free cells of three rooms, and of a fourth one without a door."""
OPEN[3:28, 3:40] = OPEN[3:28, 43:70] = OPEN[32:57, 3:70] = OPEN[10:18, 40:43] = True
OPEN[28:32, 55:62] = OPEN[3:57, 74:87] = True
NUM_APART = 54 * 13


def small(name: str, monkeypatch: pytest.MonkeyPatch) -> Protocol:
    """Let a protocol have small images and a short lidar, for the command as well."""
    given = PROTOCOLS[name]
    shape = None if given.shape is None else SHAPE
    made = given._replace(shape=shape, max_range=2.0, num_beams=180, cells_per_step=2)
    monkeypatch.setitem(PROTOCOLS, name, made)
    return made


@pytest.fixture
def ariadne(monkeypatch: pytest.MonkeyPatch) -> Protocol:
    return small("ariadne", monkeypatch)


@pytest.fixture
def mapex(monkeypatch: pytest.MonkeyPatch) -> Protocol:
    return small("mapex", monkeypatch)._replace(cells_per_step=3, num_steps=20)


@pytest.fixture
def grids(monkeypatch: pytest.MonkeyPatch) -> Protocol:
    return small("explore-bench", monkeypatch)


def dungeon(marked: int = 144) -> np.ndarray:
    """Return an image of a dungeon with a start of some pixels in the first room."""
    grey = np.where(OPEN, 255, 100).astype(np.uint8)
    rows, columns = np.divmod(np.arange(marked), 12)
    grey[rows + 5, columns + 8] = 208
    return grey


def grid() -> np.ndarray:
    """Return an image of a grid of Explore-Bench, with walls around what is free."""
    near = np.zeros_like(OPEN)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            near |= np.roll(OPEN, (down, right), (0, 1))
    return np.where(OPEN, 254, np.where(near, 0, 205)).astype(np.uint8)


def save(image: np.ndarray, path: Path) -> Path:
    Image.fromarray(image).save(path)
    return path


def save_kth(folder: Path, name: str = "50010535") -> Path:
    """Write a plan of MapEx at twice the resolution, with valid space in the first three rooms."""
    (folder / name).mkdir()
    twice = OPEN.repeat(2, axis=0).repeat(2, axis=1)
    np.save(folder / name / "occ_map.npy", np.where(twice, 254, 0).astype(np.uint8))
    valid = np.zeros_like(twice)
    valid[:, : 2 * 72] = True
    np.save(folder / name / "valid_space.npy", valid.astype(np.uint8))
    return folder / name


def recording(run: Run) -> ExplorationRecording:
    assert isinstance(run.recording, ExplorationRecording)
    return run.recording


def num_programs() -> int:
    """Return the number of closed loops that were compiled."""
    program: Any = run_chunk
    return int(program._cached._cache_size())


def reached(run: Run, level: float) -> int:
    """Return the first step whose record has a coverage."""
    coverage = np.asarray(recording(run).records.coverage, np.float64)
    assert coverage[-1] >= level
    return int(np.argmax(coverage >= level))


def test_a_dungeon_ends_at_250_unseen_cells_with_the_travel_until_then(
    ariadne: Protocol, tmp_path: Path
) -> None:
    save(np.stack([dungeon()] * 3, axis=-1), tmp_path / "one.png")
    (plan,) = read_plans(ariadne, tmp_path)
    # Pixel 127 of rows of 12: row 10, column 7 of the mark.
    assert plan.start == (5 + 10, 8 + 7)
    np.testing.assert_array_equal(plan.is_free, OPEN)
    run, row = explore(ariadne, plan, "explorer")
    done = recording(run)
    cells = int(OPEN.sum()) - NUM_APART
    assert (row["cells"], row["cells_apart"]) == (cells, NUM_APART)
    unseen = np.rint(cells * (1.0 - np.asarray(done.records.coverage, np.float64)))
    assert (unseen[:-1] > 250).all()
    assert unseen[-1] <= 250
    assert row["is_done"]
    # What is known at the end is what the record says: nothing is scanned after the last step.
    seen = (done.belief < 0.25) & done.reachable
    assert cells - seen.sum() == unseen[-1]
    # The last step begins where the rule is met. What it moves does not count.
    moves = np.hypot(*np.diff(done.positions, axis=0).T)
    assert row["travel_px"] == pytest.approx(moves[:-1].sum() / CELL, rel=1e-6)
    assert moves[-1] > 0.0
    np.testing.assert_allclose(done.positions[0] / CELL, (15.5, 15.5), rtol=1e-6)
    assert row["collisions"] == 0


def test_a_grid_has_the_times_to_90_and_98_percent(grids: Protocol, tmp_path: Path) -> None:
    (plan,) = read_plans(grids, save(grid(), tmp_path / "room.pgm"))
    run, row = explore(grids, plan, "explorer")
    assert row["t90_s"] == pytest.approx(reached(run, 0.9) * 0.2)
    assert row["total_s"] == pytest.approx(reached(run, GRID_END) * 0.2)
    assert 0.0 < row["t90_s"] < row["total_s"]
    assert row["is_done"]


def test_the_grid_start_is_the_free_cell_nearest_to_theirs(grids: Protocol, tmp_path: Path) -> None:
    image = np.zeros(SHAPE, np.uint8)
    image[50, 20] = image[20, 89] = image[44, 88] = 254
    (plan,) = read_plans(grids, save(image, tmp_path / "room.pgm"))
    assert plan.start == (44, 88)


def test_mapex_counts_known_valid_cells_after_its_steps(mapex: Protocol, tmp_path: Path) -> None:
    save_kth(tmp_path)
    (tmp_path / "starts.csv").write_text(f"50010535,{FRAME + 15},{FRAME + 15}\nother,1,2\n")
    (plan,) = read_plans(mapex, tmp_path)
    assert plan.start == (15, 15)
    np.testing.assert_array_equal(plan.is_free, OPEN)
    before = num_programs()
    run, row = explore(mapex, plan, "explorer")
    done = recording(run)
    valid = np.zeros(SHAPE, bool)
    valid[:, :72] = True
    odds = 4.0 * done.belief * (1.0 - done.belief)
    assert row["coverage"] == pytest.approx(((odds <= 0.5) & valid).sum() / valid.sum())
    assert 0.1 < row["coverage"] < 0.9
    # Walls are known cells too, which the coverage of the library leaves out.
    assert ((done.belief > 0.65) & valid).sum() > 50
    assert done.num_steps == mapex.num_steps
    assert row["is_done"]
    # Three cells per step, less in bends.
    moves = np.hypot(*np.diff(done.positions, axis=0).T) / CELL
    assert moves.max() <= 3.0 + 1e-4
    assert np.median(moves) > 2.9
    # Other plans, steps and ends: whichever test ran first has compiled the loop.
    assert num_programs() - before <= (before == 0)


def test_a_kth_plan_is_halved_to_its_walls_and_starts_inside(
    mapex: Protocol, tmp_path: Path
) -> None:
    folder = save_kth(tmp_path)
    occupancy = np.load(folder / "occ_map.npy")
    occupancy[21, 21] = 0
    np.save(folder / "occ_map.npy", occupancy[:-1])
    np.save(folder / "valid_space.npy", np.load(folder / "valid_space.npy")[:-1])
    (plan,) = read_plans(mapex, tmp_path)
    expected = OPEN.copy()
    expected[10, 10] = False
    np.testing.assert_array_equal(plan.is_free, expected)
    assert plan.is_valid is not None
    assert plan.is_free[plan.start]
    assert plan.is_valid[plan.start]


def test_the_command_writes_the_rows_and_shows_their_means(
    ariadne: Protocol, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, image in (("b", dungeon()[::-1]), ("a", dungeon()), ("c", dungeon())):
        save(image.copy(), tmp_path / f"{name}.png")
    out = tmp_path / "out.json"
    main(["ariadne", str(tmp_path), "--explorers", "explorer", "--limit", "2", "--out", str(out)])
    rows = json.loads(out.read_text())
    assert [row["map"] for row in rows] == ["a", "b"]
    mean = np.mean([row["travel_px"] for row in rows])
    assert f"{mean:.2f}" in capsys.readouterr().out


def test_the_summary_divides_by_n_and_leaves_out_what_was_not_reached() -> None:
    rest = {"map": "a", "cells": 9, "cells_apart": 0, "collisions": 0, "explorer": "explorer"}
    rows = [
        {**rest, "t90_s": 1.0, "total_s": 2.0, "is_done": True},
        {**rest, "t90_s": 4.0, "total_s": None, "is_done": False},
        {**rest, "t90_s": 4.0, "total_s": None, "is_done": False, "explorer": "nearest-frontier"},
    ]
    one, other = summarise(rows)
    assert one == {
        "explorer": "explorer",
        "runs": 2,
        "not done": 1,
        "t90_s, mean": 2.5,
        "t90_s, deviation": 1.5,
        "total_s, mean": 2.0,
        "total_s, deviation": 0.0,
    }
    assert (other["not done"], other["total_s, mean"]) == (1, None)


def test_the_target_leaves_exactly_250_cells() -> None:
    for number in (251, 8508, 100_052, 307_200):
        target = np.float32(unseen_target(number))
        seen = np.array([number - 251, number - 250], np.float32) / np.float32(number)
        assert (seen >= target).tolist() == [False, True]


def closed(path: Path) -> Path:
    """Write a dungeon of fewer cells than may stay unseen."""
    grey = np.full(SHAPE, 100, np.uint8)
    grey[5:17, 8:20] = 208
    return save(grey, path)


def no_start(folder: Path) -> str:
    save(dungeon(100), folder / "one.png")
    return "one.png has 100 pixels of grey 208, which mark the start; accepted: at least 128"


def other_size(folder: Path) -> str:
    save(dungeon()[:-1], folder / "one.png")
    return "has 59 x 90 pixels; accepted: 60 x 90, rows x columns"


def too_small(folder: Path) -> str:
    closed(folder / "one.png")
    return "one: 144 free cells are connected to the start; accepted: more than 250"


def no_image(folder: Path) -> str:
    (folder / "one.png").write_text("no image")
    return "one.png cannot be read"


def other_grey(folder: Path) -> str:
    save(dungeon(), folder / "one.pgm")
    return "has pixels of grey 100; accepted: 0 occupied, 205 unknown, 254 free"


def nothing_free(folder: Path) -> str:
    save(np.zeros(SHAPE, np.uint8), folder / "one.pgm")
    return "has no free cell; accepted: some of grey 254"


def no_valid_space(folder: Path) -> str:
    (save_kth(folder) / "valid_space.npy").unlink()
    return "valid_space.npy cannot be read"


def no_array(folder: Path) -> str:
    (save_kth(folder) / "occ_map.npy").write_bytes(b"no array")
    return "occ_map.npy cannot be read"


def other_shapes(folder: Path) -> str:
    np.save(save_kth(folder) / "valid_space.npy", np.ones((4, 4)))
    return "has arrays of (120, 180) and (4, 4); accepted: one shape for both"


def other_values(folder: Path) -> str:
    np.save(save_kth(folder) / "occ_map.npy", np.ones((120, 180)))
    return "accepted: 0 and 254 only"


def nothing_valid(folder: Path) -> str:
    np.save(save_kth(folder) / "valid_space.npy", np.zeros((120, 180)))
    return "has no free cell that is valid; accepted: some"


def start_in_wall(folder: Path) -> str:
    save_kth(folder)
    (folder / "starts.csv").write_text(f"50010535,{FRAME},{FRAME}\n")
    return "50010535,500,500 is no free cell; accepted: one, counted from a frame of 500 cells"


def start_off_map(folder: Path) -> str:
    save_kth(folder)
    (folder / "starts.csv").write_text("50010535,15,15\n")
    return "50010535,15,15 is no free cell"


def other_starts(folder: Path) -> str:
    save_kth(folder)
    (folder / "starts.csv").write_text("50010535 515 515\n")
    return "line 1 is '50010535 515 515'; accepted: plan,row,column"


@pytest.mark.parametrize(
    ("protocol", "prepare"),
    [
        *(("ariadne", each) for each in (no_start, other_size, too_small, no_image)),
        *(("explore-bench", each) for each in (other_grey, nothing_free)),
        *(
            ("mapex", each)
            for each in (
                no_valid_space,
                no_array,
                other_shapes,
                other_values,
                nothing_valid,
                start_in_wall,
                start_off_map,
                other_starts,
            )
        ),
    ],
)
def test_other_data_is_refused_in_one_line(
    protocol: str,
    prepare: object,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    small(protocol, monkeypatch)
    assert callable(prepare)
    said = prepare(tmp_path)
    assert said in refusal([protocol, str(tmp_path)], capsys)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["dungeons", "."], "protocol is 'dungeons'; accepted: ariadne, mapex, explore-bench"),
        (["ariadne", ".", "--explorers", "explorer,fastest"], "explorers has 'fastest'; accepted"),
        (["ariadne", ".", "--limit", "0"], "limit is 0; accepted: at least 1"),
        (["ariadne", ".", "--out", "missing/out.json"], "accepted: a file in a folder that exists"),
        (["ariadne", "missing"], "missing is not there; accepted: a folder with PNG images"),
        (["ariadne", "."], ". has none; accepted: a folder with PNG images"),
        (["mapex", "missing"], "missing is not there; accepted: a folder with folders of occ_map"),
        (["mapex", "."], ". has none; accepted: a folder with folders of occ_map.npy"),
        (["explore-bench", "missing.pgm"], "missing.pgm is not there; accepted: a PGM image"),
        (["explore-bench", "."], ". has none; accepted: a PGM image"),
    ],
)
def test_other_arguments_are_refused_in_one_line(
    arguments: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert said in refusal(arguments, capsys)


def refusal(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run the command, and return the one line that it says."""
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_a_run_that_is_not_done_says_so(ariadne: Protocol) -> None:
    plan = Plan("one", OPEN, (15, 15))
    run, row = explore(ariadne._replace(num_steps=4), plan, "explorer")
    assert not row["is_done"]
    assert recording(run).num_steps == 4
    assert row["travel_px"] == pytest.approx(run.metrics.as_dict()["path_length"] / CELL)
