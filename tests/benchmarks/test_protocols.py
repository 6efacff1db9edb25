"""Protocols of other projects: bad clones, and our rule on maps of their kind."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from benchmarks.protocols.distance_advantage import FILES, SEGMENTS, Guide, load, main, summarise


def clone_with(folder: Path, walls: np.ndarray) -> Path:
    """Make a folder with the files of a clone, which hold nothing but walls."""
    for name in FILES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    np.savetxt(folder / FILES[-1], walls, delimiter=",")
    return folder


@pytest.mark.parametrize(
    ("walls", "said"),
    [
        (None, r"has no da/main.py; accepted: a clone of lericson/da"),
        (np.ones((3, 4)), r"has 3 walls of 4 numbers; accepted: 2036 of 4"),
        (np.ones((SEGMENTS, 5)), r"has 2036 walls of 5 numbers; accepted: 2036 of 4"),
        (np.ones((SEGMENTS, 4)), r"are 0.0 m long; accepted: 3155.8 m, those of the published map"),
    ],
)
def test_other_data_is_refused(tmp_path: Path, walls: np.ndarray | None, said: str) -> None:
    clone = tmp_path if walls is None else clone_with(tmp_path, walls)
    with pytest.raises(ValueError, match=said):
        load(clone)


@pytest.mark.parametrize(
    "options",
    [["--rules", "fastest"], ["--starts", "11"], ["--starts", "0"], []],
)
def test_the_command_refuses_in_one_line(
    tmp_path: Path, options: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path), *options])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "accepted: " in line


def test_our_rule_leads_through_free_cells_to_what_is_unknown() -> None:
    """A room with a door; beyond it nothing is known. The first axis is x."""
    p = np.full((40, 24), 0.02, np.float32)
    p[[0, -1]] = p[:, [0, -1]] = p[20] = 0.98
    p[20, 10:13] = 0.02
    p[22:, :] = 0.5
    guide = Guide(0.25, num_directions=8)
    path = guide.path(p, (4, 18), 0.0)
    assert path[0] == (4, 18)
    assert path[-1][0] >= 15
    for one, other in itertools.pairwise(path):
        assert max(abs(one[0] - other[0]), abs(one[1] - other[1])) == 1
        # Both cells beside a diagonal step are free as well.
        assert all(p[x, y] < 0.1 for x in (one[0], other[0]) for y in (one[1], other[1]))


def test_our_rule_leaves_a_room_that_the_simulator_knows_alone() -> None:
    """Known cells at 0.02 once counted as information, and the robot went to look at them."""
    p = np.full((40, 24), 0.02, np.float32)
    p[[0, -1]] = p[:, [0, -1]] = 0.98
    assert Guide(0.25, num_directions=8).path(p, (4, 18), 0.0) == [(4, 18)]


def test_the_summary_is_the_mean_and_the_sample_deviation() -> None:
    rows = [{"rule": rule, "metres": m} for rule, m in (("a", 1.0), ("a", 4.0), ("b", 2.0))]
    one, other = summarise(rows)
    assert (one["rule"], one["starts"], one["mean"]) == ("a", 2, 2.5)
    assert one["standard deviation"] == pytest.approx(np.sqrt(4.5))
    assert (other["starts"], other["standard deviation"]) == (1, 0.0)
