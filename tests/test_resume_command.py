"""`jaxplore run --resume` and `--record`."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

import jaxplore as jx
from jaxplore.cli import main
from jaxplore.simulation.loop import run_chunk

pytestmark = pytest.mark.long

SMALL = ["--samples", "32", "--set", "controller.horizon=10", "--set", "fields.num_directions=8"]


@pytest.fixture(scope="module")
def part(tmp_path_factory) -> Path:
    """A run folder of half a second, on a map as large as the smallest offices."""
    folder = tmp_path_factory.mktemp("part")
    world = np.zeros((80, 90), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    jx.OccupancyGrid(world, 0.1).to_ros(folder / "map.yaml")
    place = [str(folder / "map.yaml"), "--start", "1.5", "2", "0", "--out", str(folder / "run")]
    main(["run", *place, *SMALL, "--range", "2.0", "--time-limit", "0.5", "--no-animation"])
    return folder / "run"


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_run_goes_on_where_it_ended(part: Path, capsys) -> None:
    longer = ["--time-limit", "1", "--no-animation"]
    main(["run", "--settings", str(part / "settings.yaml"), *longer, "--out", "whole"])
    compiled = run_chunk._cached._cache_size()
    main(["run", "--resume", str(part), *longer, "--out", "rest", "--record", "rest.mcap"])
    # A state of a file has the types of one from a start.
    assert run_chunk._cached._cache_size() == compiled
    assert "rest.mcap" in capsys.readouterr().out.splitlines()
    whole, rest = (np.load(f"{name}/arrays.npz") for name in ("whole", "rest"))
    assert len(rest["coverage"]) == 50
    for name in whole.files:
        np.testing.assert_array_equal(whole[name], rest[name])
    assert yaml.safe_load(Path("rest/settings.yaml").read_text())["time_limit"] == 1.0
    with Path("rest.mcap").open("rb") as file:
        statistics = make_reader(file).get_summary().statistics
    assert statistics.message_start_time == 500_000_000
    assert statistics.message_end_time == 1_000_000_000
    # The folder itself is replaced only when asked for.
    main(["run", "--resume", "rest", "--time-limit", "1.1", "--overwrite", "--no-animation"])
    assert len(np.load("rest/arrays.npz")["coverage"]) == 55


def test_a_finished_run_does_not_go_on(part: Path, fails, capsys) -> None:
    settings = str(part / "settings.yaml")
    few = ["--target-coverage", "0.01", "--no-animation"]
    main(["run", "--settings", settings, *few, "--out", "done"])
    capsys.readouterr()
    reason = "resume is a finished run; accepted: one that is not finished"
    assert reason in fails("run", "--resume", "done", "--time-limit", "2", "--out", "it")


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--resume", "PART"], "holds a former run; accepted: a new folder, or overwrite"),
        (["--resume", "PART", "--out", "it"], "a run of 0.5 s, beside a time limit of 0.5 s"),
        (["--resume", "bare", "--out", "it"], "holds no settings.yaml; accepted: a run folder"),
        (["--resume", "empty", "--out", "it"], "metrics.json"),
        (
            ["--resume", "PART", "--time-limit", "1", "--samples", "16", "--out", "it"],
            "controller differs from that of the run to resume",
        ),
        (
            ["--resume", "PART", "--time-limit", "1", "--seed", "7", "--out", "it"],
            "accepted: [0, 0], that of the run to resume",
        ),
        (["--resume", "PART", "--settings", "a.yaml", "--out", "it"], "beside --resume"),
        (["office", "--record", "office.bag"], "--record is 'office.bag'; accepted: a file that"),
        (["office", "--record", "taken.mcap"], "--record is 'taken.mcap', which exists; accepted"),
    ],
)
def test_what_cannot_be_continued_or_recorded_is_one_line(
    part: Path, fails, arguments: list[str], reason: str
) -> None:
    for name in ("bare", "empty"):
        Path(name).mkdir()
    Path("empty/settings.yaml").write_bytes((part / "settings.yaml").read_bytes())
    Path("taken.mcap").write_text("")
    given = [str(part) if each == "PART" else each for each in arguments]
    assert reason in fails("run", *given)
