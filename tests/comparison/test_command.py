"""`jaxplore compare --maps`."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from jaxplore.cli import main
from jaxplore.settings.architectures import GROUND
from jaxplore.study.comparison import compare_maps as comparing
from jaxplore.study.comparison.episodes import MapEpisode
from jaxplore.study.comparison.maps import MapFile
from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.store import Store, open_store

pytestmark = pytest.mark.long

Timeless = Callable[[Store], list[Row]]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def arguments(maps: tuple[MapFile, ...], small: dict[str, Any]) -> list[str]:
    Path("small.yaml").write_text(yaml.safe_dump(small))
    begin = ["compare", "--maps", "maps", "--architectures", "explorer", "--seeds", "2"]
    return [*begin, "--settings", "small.yaml"]


def ends(arguments: list[str]) -> int:
    """Run a command that ends the process, and return its exit code."""
    with pytest.raises(SystemExit) as exit_:
        main(arguments)
    assert isinstance(exit_.value.code, int)
    return exit_.value.code


def test_it_writes_a_folder_and_prints_tables(
    arguments: list[str], small: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    main([*arguments, "--seed", "4"])
    shown = capsys.readouterr()
    folder = Path("runs/maps-comparison")
    lines = shown.out.splitlines()
    assert str(folder.absolute() / "results.parquet") in lines
    assert [line for line in lines if "medians" in line] == [
        f"{name}: medians [quartiles]" for name in ("east", "west")
    ]
    rows = [line for line in lines if "explorer" in line]
    assert all("0 of 2" in row for row in rows)
    assert len(rows) == 2
    assert "4 of 4, about 0 s left, done: west, explorer, seed 5" in shown.err
    plan = json.loads((folder / "comparison.json").read_text())
    assert plan["seeds"] == [4, 5]
    assert plan["explorers"] == ["explorer"]
    # Given settings win over those of the protocol, which win over the defaults.
    assert plan["settings"] == {
        **small,
        "rates": {"control": 20.0, "sensing": 10.0, "fields": 5.0},
        "resolution": 0.1,
        "target_coverage": 0.99,
    }
    (settings, *_) = [json.loads(row["settings"]) for row in open_store(folder).rows(["settings"])]
    assert settings["lidar"]["num_beams"] == 16
    assert settings["start"] == [1.0, 1.5, 0.5]


def test_the_same_command_goes_on(
    arguments: list[str],
    capsys: pytest.CaptureFixture[str],
    timeless: Timeless,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    original, calls = comparing.run_episodes, []

    def interrupted(*some: Any, **more: Any) -> Any:
        episodes, store, runner, on_done = some

        def press(done: Any) -> None:
            on_done(done)
            calls.append(done.episode)
            if len(calls) == 3:
                raise KeyboardInterrupt

        return original(episodes, store, runner, press, **more)

    monkeypatch.setattr(comparing, "run_episodes", interrupted)
    assert ends([*arguments, "--out", "out"]) == 130
    shown = capsys.readouterr()
    assert "Interrupted: 3 of 4 runs are done; the same command continues." in shown.err
    assert "0 of 1" in shown.out
    store = open_store("out")
    assert len(timeless(store)) == 3
    main([*arguments, "--out", "out"])
    assert len(calls) == 4
    main([*arguments, "--out", "whole"])
    assert timeless(store) == timeless(open_store("whole"))
    assert len(calls) == 8
    main([*arguments, "--out", "out", "--overwrite", "--set", "time_limit=0.5"])
    assert len(calls) == 12
    assert {row["time_limit"] for row in timeless(store)} == {0.5}


@pytest.mark.filterwarnings("ignore:.*read as unknown would be:UserWarning")
def test_runs_that_fail_are_told(
    arguments: list[str], write_map: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    write_map(Path("maps/broken.yaml"), image="gone.pgm")
    (Path("maps/full") / "full.yaml").parent.mkdir()
    write_map(Path("maps/full/full.yaml"), free_thresh=0.0, negate=1, occupied_thresh=0.001)
    assert ends([*arguments, "--seeds", "1"]) == 1
    shown = capsys.readouterr()
    assert "west: medians [quartiles]" in shown.out
    told = [line for line in shown.err.splitlines() if "1 run failed" in line]
    assert [line.partition(":")[0] for line in told] == ["broken, explorer", "full, explorer"]
    assert "image is 'gone.pgm', which is not there" in told[0]
    assert "the map has no place for a robot of radius 0.2 m" in told[1]


def test_a_comparison_on_maps_has_settings_of_its_own(
    maps: tuple[MapFile, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[MapEpisode, ...]] = []

    def nothing(episodes: tuple[MapEpisode, ...], store: Store, *_: Any, **__: Any) -> Any:
        made.append(episodes)
        store.write_results()
        return comparing.RunCounts(0, 0, 0, False)

    monkeypatch.setattr(comparing, "run_episodes", nothing)
    main(["compare", "--maps", "maps", "--out", "out"])
    assert len(made[0]) == 2 * len(GROUND) * 20
    assert {episode.explorer for episode in made[0]} == set(GROUND)
    assert made[0][-1].settings == {
        "rates": {"control": 20.0, "sensing": 10.0, "fields": 5.0},
        "lidar": {"num_beams": 180, "max_range": 5.0},
        "resolution": 0.1,
        "target_coverage": 0.99,
        "time_limit": 900.0,
    }
    Path("other.yaml").write_text("west: [1, 2, 3]")
    main(["compare", "--maps", "maps", "--starts", "other.yaml", "--time-limit", "60"])
    assert [made[1][at].settings["start"] for at in (0, -1)] == [[1.0, 1.5, 0.5], [1.0, 2.0, 3.0]]
    assert made[1][0].settings["time_limit"] == 60.0
    # A quadrotor sees ahead; its own architectures and those of ground vehicles compare.
    flight = ["--robot", "quadrotor", "--architectures", "explorer,nearest-frontier,two-layer"]
    main(["compare", "--maps", "maps", *flight, "--out", "flight", "--set", "robot.radius=0.25"])
    settings = made[2][0].settings
    # The explorer flies at the speed of the quadrotor's model.
    assert settings["robot"] == {"model": "quadrotor", "radius": 0.25}
    assert made[2][-1].settings["robot"] == {**settings["robot"], "max_speed": 2.0}
    assert settings["lidar"] == {
        "num_beams": 46,
        "max_range": 5.0,
        "field_of_view_degrees": 90.0,
        "range_noise": 0.02,
    }


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (
            ["--architectures", "explorer,wanderer"],
            "architecture is 'wanderer'; accepted: explorer, portf",
        ),
        (
            ["--architectures", "explorer,parallel"],
            "variants explorer and parallel differ in the settings rob",
        ),
        (["--architectures", ""], "architecture is ''; accepted"),
        (["--seeds", "0"], "--seeds is 0; accepted: a whole number >= 1"),
        (["--seed", "-1"], "setting seed is -1"),
        (["--workers", "0"], "--workers is 0; accepted: a whole number >= 1"),
        (["--maps", "gone"], "folder of maps 'gone' cannot be read: No such file"),
        (["--maps", "empty"], "folder of maps 'empty' holds no ROS map"),
        (["--starts", "gone.yaml"], "settings file gone.yaml cannot be read"),
        (["--starts", "wrong.yaml"], "wrong.yaml has a start on 'north'; accepted: the maps east"),
        (["--set", "wings=2"], "unknown setting wings"),
        (["--set", "rates=2"], "setting rates is 2"),
        (["--start", "1", "1", "0"], "--start is (1.0, 1.0, 0.0) beside --maps; accepted"),
        (["--goal", "1", "1"], "--goal is (1.0, 1.0) beside --maps"),
        (["--fps", "20"], "--fps or --film-scale is given beside --maps"),
        (["--figures", "jpg"], "figures is 'jpg'; accepted"),
        (["maps/east.yaml"], "the map is maps/east.yaml beside --maps"),
        (["--out", "empty/../taken"], "exists and holds no comparison.json"),
    ],
)
def test_bad_input_is_one_line_and_runs_nothing(
    arguments: list[str], capsys: pytest.CaptureFixture[str], more: list[str], reason: str
) -> None:
    Path("empty").mkdir()
    Path("taken").mkdir()
    Path("taken/mine.txt").write_text("mine")
    Path("wrong.yaml").write_text("north: [0, 0, 0]")
    before = sorted(Path.cwd().rglob("*"))
    assert ends([*arguments, *more]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("jaxplore: ")
    assert shown.err.count("\n") == 1
    assert reason in shown.err
    assert sorted(Path.cwd().rglob("*")) == before


@pytest.mark.parametrize(
    ("option", "reason"),
    [
        (["--starts", "s.yaml"], "--starts is s.yaml; accepted: with --maps"),
        (["--batch", "2"], "--batch is 2; accepted: with --maps"),
    ],
)
def test_options_of_several_maps_need_maps(
    capsys: pytest.CaptureFixture[str], option: list[str], reason: str
) -> None:
    assert ends(["compare", "zones", *option]) == 2
    assert reason in capsys.readouterr().err
