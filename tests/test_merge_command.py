"""`jaxplore merge`: maps of one hall in frames that nobody knows, written here."""

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxplore.cli import main
from jaxplore.maps import OccupancyGrid

SIDE = 0.1


def hall() -> np.ndarray:
    """Draw a hall of 16 m x 9 m with walls and boxes that do not repeat."""
    world = np.full((90, 160), 0.02)
    world[[0, 1, -2, -1]] = world[:, [0, 1, -2, -1]] = 0.98
    for rows, columns in (
        ((0, 50), (40, 42)),
        ((60, 90), (75, 77)),
        ((30, 32), (75, 120)),
        ((10, 18), (55, 66)),
        ((70, 80), (20, 30)),
        ((50, 62), (130, 137)),
        ((12, 20), (140, 146)),
        ((66, 70), (100, 118)),
    ):
        world[slice(*rows), slice(*columns)] = 0.98
    return world


def write(path: Path, first: int, last: int, pose: tuple[float, float, float]) -> None:
    """Write columns of the hall, with the pose of the hall in the frame of the map.

    The grid is turned with the hall: the frames differ by the origin of the file.
    """
    world = hall()
    known = np.full(world.shape, 0.5)
    known[:, first:last] = world[:, first:last]
    OccupancyGrid(known, SIDE, pose).to_ros(path)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "one.yaml", 0, 110, (1.0, 2.0, 0.3))
    write(tmp_path / "two.yaml", 50, 160, (-3.0, 0.5, -1.2))
    write(tmp_path / "far.yaml", 118, 160, (7.0, 0.0, 2.0))
    return tmp_path


def refusal(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith("jaxplore: ")
    assert said.count("\n") == 1
    return said


def test_two_maps_become_one(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["merge", "one.yaml", "two.yaml", "--out", "all.yaml", "--picture", "all.png"])
    said = capsys.readouterr().out
    # The frame of the second file in that of the first: the hall's pose, and back.
    turn = 0.3 + 1.2
    there = np.exp(1j * turn) * (-3.0 + 0.5j)
    x, y = 1.0 - there.real, 2.0 - there.imag
    shown = [float(said.split(f"{name} ")[1].split()[0]) for name in ("x", "y", "yaw")]
    np.testing.assert_allclose(shown, [x, y, turn], atol=0.05)
    assert "certain: " in said
    merged = OccupancyGrid.from_ros(folder / "all.yaml", unknown=205)
    cos, sin = math.cos(0.3), math.sin(0.3)
    right = total = 0
    values = hall()
    for row in range(2, 88, 3):
        for column in range(2, 158, 3):
            around = values[row - 1 : row + 2, column - 1 : column + 2]
            if np.ptp(around) > 0.0:
                continue  # within a cell of a wall's face
            a, b = (column + 0.5) * SIDE, (row + 0.5) * SIDE
            at = np.array([cos * a - sin * b + 1.0, sin * a + cos * b + 2.0], np.float32)
            grid = (at - np.asarray(merged.frame.origin)[:2]) @ np.array([[cos, -sin], [sin, cos]])
            j, i = np.floor(grid / SIDE).astype(int)
            right += abs(float(merged.probability[i, j]) - around[1, 1]) < 0.1
            total += 1
    assert total > 1000
    assert right >= 0.99 * total
    with Image.open(folder / "all.png") as picture:
        assert len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)) > 3


def test_a_map_that_overlaps_with_none_is_refused_and_nothing_is_written(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(folder / "left.yaml", 0, 60, (0.0, 0.0, 0.0))
    before = sorted(folder.iterdir())
    said = refusal(["merge", "left.yaml", "far.yaml"], capsys)
    assert "where far.yaml lies on left.yaml is not certain: " in said
    assert sorted(folder.iterdir()) == before


def test_the_third_map_is_found_on_the_first_two(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(folder / "left.yaml", 0, 60, (0.0, 0.0, 0.0))
    main(["merge", "left.yaml", "far.yaml", "one.yaml", "two.yaml"])
    said = capsys.readouterr().out
    assert said.index("one.yaml in the frame of left.yaml") < said.index("far.yaml in the frame")
    merged = OccupancyGrid.from_ros(folder / "merged.yaml", unknown=205)
    known = float(np.mean(np.abs(np.asarray(merged.probability) - 0.5) > 0.1))
    assert known * merged.probability.size * SIDE**2 > 140.0


def test_files_are_not_replaced(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "all.pgm").write_text("mine")
    arguments = ["merge", "one.yaml", "two.yaml", "--out", "all.yaml"]
    assert "all.pgm exists; accepted: another --out, or --overwrite" in refusal(arguments, capsys)
    assert (folder / "all.pgm").read_text() == "mine"
    own = ["merge", "one.yaml", "two.yaml", "--out", "two.yaml", "--overwrite"]
    assert "two.yaml is merged and written; accepted: another --out" in refusal(own, capsys)
    assert "1 maps are given; accepted: two or more" in refusal(["merge", "one.yaml"], capsys)
    assert "nothing.yaml" in refusal(["merge", "one.yaml", "nothing.yaml"], capsys)


def test_maps_far_from_the_origin(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In coordinates of a survey, in which single precision does not resolve a cell."""
    write(folder / "near.yaml", 0, 110, (0.0, 0.0, 0.0))
    text = (
        (folder / "near.yaml").read_text().replace("[0.0, 0.0, 0.0]", "[690000.5, 5336000.25, 0.0]")
    )
    (folder / "near.yaml").write_text(text)
    main(["merge", "near.yaml", "two.yaml", "--out", "all.yaml"])
    said = capsys.readouterr().out
    there = np.exp(1.2j) * (-3.0 + 0.5j)
    shown = [float(said.split(f"{name} ")[1].split()[0]) for name in ("x", "y", "yaw")]
    np.testing.assert_allclose(
        shown, [690000.5 - there.real, 5336000.25 - there.imag, 1.2], rtol=0.0, atol=0.05
    )
