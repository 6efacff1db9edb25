import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import scipy.spatial
import yaml
from PIL import Image

import jaxplore as jx
from jaxplore._locks import reserve_hidden_folder
from jaxplore.cli import _show, _streams, main
from jaxplore.cli._entries import option_entries
from jaxplore.report.folder import is_reserved
from jaxplore.tasks.exploration.build import choose_architectures
from jaxplore.tasks.registry import build, make_settings

pytestmark = pytest.mark.long

SMALL = ["--samples", "32", "--set", "controller.horizon=10", "--set", "fields.num_directions=8"]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def ros_map(tmp_path: Path) -> Path:
    """A map as large as the smallest offices: they share what is compiled."""
    world = np.zeros((80, 90), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    world[:, 30] = 0.5
    jx.OccupancyGrid(world, 0.1).to_ros(tmp_path / "map.yaml")
    return tmp_path / "map.yaml"


def test_run_writes_a_folder_that_repeats_itself(ros_map: Path, capsys) -> None:
    arguments = ["run", str(ros_map), "--start", "1.5", "2", "0", "--time-limit", "0.6", *SMALL]
    main([*arguments, "--seed", "3", "--range", "2.0", "--out", "first", "--no-animation"])
    shown = capsys.readouterr().out
    assert "coverage" in shown
    assert str(Path("first") / "map.png") in shown
    assert {path.name for path in Path("first").iterdir()} == {
        "metrics.json",
        "arrays.npz",
        "state.npz",
        "map.png",
        "coverage.png",
        "explored.yaml",
        "explored.pgm",
        "settings.yaml",
    }
    used = yaml.safe_load(Path("first/settings.yaml").read_text())
    assert used["seed"] == 3
    assert used["lidar"]["max_range"] == 2.0
    assert used["controller"]["num_samples"] == 32
    main(["run", "--settings", "first/settings.yaml", "--out", "again"])
    assert Path("again/exploration.gif").exists()
    first, again = (np.load(f"{name}/arrays.npz") for name in ("first", "again"))
    for name in first.files:
        np.testing.assert_array_equal(first[name], again[name])
    metrics = json.loads(Path("again/metrics.json").read_text())
    assert metrics["seed"] == 3
    assert 0 < metrics["num_steps"] == len(first["coverage"]) <= 30


def test_a_start_far_from_the_origin_is_shown_in_full(capsys: pytest.CaptureFixture[str]) -> None:
    _show.show_starts({"": {}}, {"": {"start": (499999.45, 4649774.25, 0.0)}})
    assert capsys.readouterr().err.startswith("Start: 499999.45 4649774.25 0, ")


def test_a_setting_that_the_run_does_not_read_is_refused(
    ros_map: Path, monkeypatch: pytest.MonkeyPatch, fails
) -> None:
    ran: list[Any] = []
    monkeypatch.setattr("jaxplore.cli._run.simulate", lambda *given, **_: ran.append(given))
    monkeypatch.setattr("jaxplore.cli._run.save", lambda *_, **__: None)
    given = ["run", str(ros_map), "--start", "1.5", "2", "0"]
    assert fails(*given, "--set", "adaptive_horizon.min_horizon=9") == (
        "jaxplore: setting adaptive_horizon.min_horizon is 9, which adaptive_horizon.rule None "
        "does not read; accepted: for runs with adaptive_horizon.rule\n"
    )
    assert fails(*given, "--set", "portfolio={horizon: 20, dt: 0.1}") == (
        "jaxplore: setting portfolio.horizon is 20, which architecture explorer does not read, "
        "like 1 others; accepted: for portfolio\n"
    )
    assert not ran
    main(
        [*given, "--set", "adaptive_horizon.min_horizon=9", "--set", "adaptive_horizon.rule=speed"]
    )
    assert len(ran) == 1


def test_a_map_without_a_start_gets_one_that_is_shown_and_kept(
    ros_map: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ran, kept = [], []

    def save(result: None, folder: Path, settings: Any, *_: Any, **__: Any) -> None:
        kept.append(settings)

    monkeypatch.setattr("jaxplore.cli._run.simulate", lambda *given, **_: ran.append(given))
    monkeypatch.setattr("jaxplore.cli._run.save", save)
    main(["run", str(ros_map)])
    x, y, yaw = kept[0].start
    assert capsys.readouterr().err == (
        f"Start: {x:g} {y:g} 0, the position with the greatest clearance; another one: "
        "--start X Y YAW\n"
    )
    np.testing.assert_array_equal(ran[0][1].start[:3], np.float32([x, y, yaw]))
    # The larger of the two rooms, from x = 3.1 m to 8.9 m: no place is further from what is solid.
    solid = np.argwhere(np.asarray(ran[0][1].world.probability) > 0.4) + 0.5
    centres = 0.1 * (np.argwhere(np.ones((80, 90))) + 0.5)[:, ::-1]
    clearance = scipy.spatial.KDTree(0.1 * solid[:, ::-1]).query([[x, y], *centres])[0]
    assert clearance[0] == pytest.approx(clearance.max(), abs=1e-4)
    # A start that is given is said no more. Neither is that of a map that has one.
    main(["run", str(ros_map), "--start", "1.5", "2", "0"])
    main(["run", "office", "--set", "office.width=9", "--set", "office.height=8"])
    assert capsys.readouterr().err == ""
    assert [each.start for each in kept[1:]] == [(1.5, 2.0, 0.0), None]
    # The same start without the command line.
    assert build(make_settings({"map": str(ros_map)})).scenario.start[:3].tolist() == [
        *np.float32([x, y, yaw])
    ]


def test_office_needs_no_file_and_names_its_folders(capsys) -> None:
    small = ["--set", "office.width=9", "--set", "office.height=8", *SMALL, "--no-animation"]
    for _ in range(2):
        main(["run", "office", "--time-limit", "0.5", "--range", "2.0", *small])
    assert Path("runs/office/metrics.json").exists()
    assert Path("runs/office-2/metrics.json").exists()
    assert "runs/office-2" in capsys.readouterr().out


def test_finer_maps_are_resampled_and_coarser_ones_kept(tmp_path: Path) -> None:
    jx.OccupancyGrid(np.zeros((80, 80)), 0.05).to_ros(tmp_path / "fine.yaml")
    jx.OccupancyGrid(np.zeros((20, 20)), 0.2).to_ros(tmp_path / "coarse.yaml")
    for name, expected in (("fine", 0.1), ("coarse", 0.2)):
        made = build(make_settings({"map": f"{name}.yaml", "start": (2.0, 2.0, 0.0)}))
        assert made.scenario.world.resolution == pytest.approx(expected)


def test_the_map_that_is_named_counts_not_that_of_the_settings_file() -> None:
    file = {"map": "other.yaml", "seed": 4, "office": {"width": 9.0}}
    Path("settings.yaml").write_text(yaml.safe_dump(file))
    given = {"settings_file": "settings.yaml", "map_": "office", "path_file": None}
    entries = option_entries({**given, "controller__num_samples": None, "assignments": ()})
    assert entries == {**file, "map": "office"}


def test_one_file_describes_a_run_and_a_drive(fails) -> None:
    run = {"map": "office", "seed": 4}
    Path("robot.yaml").write_text(yaml.safe_dump({**run, "node": {"latency": 0.1}}))
    given = {"settings_file": "robot.yaml", "map_": None, "path_file": None}
    entries = option_entries({**given, "controller__num_samples": None, "assignments": ()})
    assert entries == run
    Path("robot.yaml").write_text(yaml.safe_dump({"node": {"latency": -0.1}}))
    said = fails("run", "office", "--settings", "robot.yaml")
    assert "setting node.latency is -0.1; accepted: greater than or equal to 0" in said


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["run", "gone.yaml", "--start", "1", "1", "0"], "gone.yaml"),
        (["run"], "setting map is missing"),
        (["run", "MAP", "--radius", "3.5"], "the map has no place for a robot of radius 3.5 m"),
        (["run", "MAP", "--start", "9", "1", "0"], "off the map"),
        (["run", "MAP", "--start", "0.05", "1", "0"], "in a wall"),
        (["run", "MAP", "--start", "3.05", "1", "0"], "in unknown space"),
        (["run", "MAP", "--start", "0.25", "1", "0"], "touches something"),
        (["run", "MAP", "--start", "nan", "1", "0"], "start.0 is nan"),
        (["run", "MAP", "--start", "1", "1"], "--start"),
        (["run", "MAP", "--start", "a", "1", "0"], "--start"),
        (["run", "office", "--seed", "-1"], "setting seed is -1; accepted: greater than"),
        (["run", "office", "--time-limit", "0"], "setting time_limit is 0.0"),
        (["run", "office", "--resolution", "-0.1"], "setting resolution is -0.1"),
        (["run", "office", "--robot", "submarine"], "robot.model is 'submarine'; accepted: 'diff"),
        (["run", "office", "--set", "robot.wings=2"], "unknown setting robot.wings; accepted here"),
        (
            ["run", "office", "--set", "a\udcffb=1"],
            "a setting is named 'a\\udcffb'; accepted: text",
        ),
        (
            ["run", "office", "--set", "wings=2"],
            "unknown setting wings; accepted here: start, time_limit, seed, parameters, latency",
        ),
        (["run", "office", "--set", "robot"], "--set is 'robot'; accepted: NAME=VALUE"),
        (["run", "office", "--set", "seed=[1"], "accepted: a value in YAML"),
        (["run", "office", "--set", "lidar=3", "--set", "lidar.x=1"], "lidar is 3"),
        (["run", "office", "--set", "office.width=3"], "width is 3"),
        (["run", "office", "--set", "robot.radius=4"], "robot of radius 4 m"),
        (["run", "office", "--wings"], "--wings"),
        (["fly"], "fly"),
        (["run", "--settings", "gone.yaml"], "settings file gone.yaml cannot be read"),
        (["run", "--settings", "bad.yaml"], "settings file bad.yaml is not YAML"),
        (["run", "--settings", "list.yaml"], "accepted: a mapping of settings"),
        (["run", "--settings", "binary.yaml"], "settings file binary.yaml is not YAML"),
        (["run", "office", "--out", "taken"], "taken"),
        (["run", "office", "--out", "file/inside"], "file"),
    ],
)
def test_bad_input_is_one_line(ros_map: Path, fails, arguments, reason: str) -> None:
    Path("bad.yaml").write_text("seed: [1")
    Path("list.yaml").write_text("- 1")
    Path("binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    Path("taken").mkdir()
    Path("file").write_text("")
    before = sorted(os.listdir())
    arguments = [str(ros_map) if argument == "MAP" else argument for argument in arguments]
    assert reason in fails(*arguments)
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ({"resolution": 0}, "resolution is 0"),
        ({"resolution": -0.05}, "resolution is -0.05"),
        ({"occupied_thresh": 0.1, "free_thresh": 0.5}, "free_thresh is 0.5"),
        ({"mode": "quaternary"}, "mode is 'quaternary'; accepted: trinary, scale, raw"),
        ({"origin": [0, float("nan"), 0]}, "origin"),
        ({"image": "gone.pgm"}, "gone.pgm"),
        ({"image": "text.pgm"}, "text.pgm cannot be read"),
        ({"image": "huge.png"}, "huge.png is too large"),
        ({"image": "../map.pgm"}, "outside the map's folder"),
    ],
)
def test_bad_maps_are_one_line(ros_map: Path, fails, entry, reason: str) -> None:
    Path("text.pgm").write_text("this is not an image")
    Image.new("1", (9000, 9000)).save("huge.png")
    described = yaml.safe_load(ros_map.read_text())
    Path("other.yaml").write_text(yaml.safe_dump({**described, **entry}))
    error = fails("run", "other.yaml", "--start", "1", "1", "0", "--out", "out")
    assert reason in error
    assert not Path("out").exists()


def test_a_disk_that_fills_leaves_nothing(ros_map: Path, capsys, monkeypatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np, "savez_compressed", full)
    monkeypatch.setattr(np, "savez", full)
    before = sorted(os.listdir())
    arguments = ["run", str(ros_map), "--start", "1", "1", "0", "--time-limit", "0.1", *SMALL]
    with pytest.raises(SystemExit) as exit_:
        main([*arguments, "--range", "2.0", "--out", "out"])  # compiled before, above
    assert exit_.value.code == 2
    assert "No space left on device" in capsys.readouterr().err
    assert sorted(os.listdir()) == before


def test_version_help_and_settings(capsys) -> None:
    main(["--version"])
    assert capsys.readouterr().out == f"jaxplore, version {jx.__version__}\n"
    main(["run", "--help"])
    text = capsys.readouterr().out
    for word in ("--start X Y [Z] YAW", "--seed", "--settings", "runs/depot", "[default: 900.0]"):
        assert word in text
    main(["settings"])
    assert yaml.safe_load(capsys.readouterr().out)["controller"]["num_samples"] == 1000
    main([])
    assert "  tune " in capsys.readouterr().out


def test_a_real_map(ros_maps: Path) -> None:
    arguments = ["run", str(ros_maps / "nav2_depot" / "depot.yaml"), "--start", "4.62", "7.73", "0"]
    # Its threshold, 0.25, makes a map saver's grey of unknown cells free.
    main(
        [
            *arguments,
            "--time-limit",
            "3",
            *SMALL,
            "--set",
            "map_file.unknown=205",
            "--out",
            "depot",
            "--no-animation",
        ]
    )
    metrics = json.loads(Path("depot/metrics.json").read_text())
    assert 300 < metrics["reachable_area"] < 450
    assert metrics["coverage"] > 0.1
    assert metrics["collisions"] == 0


def test_importing_is_light_and_changes_nothing_global_and_the_command_runs() -> None:
    code = (
        "import jax, sys; before = dict(jax.config.values); import jaxplore; "
        "[getattr(jaxplore, name) for name in dir(jaxplore)]; "
        "assert dict(jax.config.values) == before; assert 'matplotlib' not in sys.modules; "
        "from jaxplore.cli import main; main(['--version'])"
    )
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "jaxplore, version" in done.stdout


def test_settings_are_there_without_docstrings() -> None:
    command = [sys.executable, "-OO", "-m", "jaxplore", "settings", "office"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "num_beams: 360" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "shown"),
    [
        ("--help", 0, "simulates one run"),
        ("--version", 0, jx.__version__),
        ("run --help", 0, "[default: 900.0]"),
        ("compare --help", 0, "--architectures"),
        ("tune --help", 0, "cma-es"),
        ("settings --help", 0, "robot.max_speed"),
        ("run office --sed 3", 2, "No such option '--sed'"),
        ("compare --seeds many", 2, "'many' is not a valid integer"),
        ("rnu", 2, "No such command 'rnu'"),
    ],
)
def test_help_and_wrong_options_need_nothing_slow(arguments: str, code: int, shown: str) -> None:
    program = (
        "import sys\n"
        "from jaxplore.__main__ import main\n"
        "try:\n"
        "    main()\n"
        "finally:\n"
        "    slow = {'jax', 'equinox', 'numpy', 'pydantic', 'matplotlib', 'scipy', 'yaml'}\n"
        "    print('SLOW', sorted(slow & set(sys.modules)))\n"
    )
    command = [sys.executable, "-c", program, *arguments.split()]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert shown in (done.stderr if code else done.stdout)
    assert done.stdout.splitlines()[-1] == "SLOW []"
    assert done.stderr.count("\n") == (1 if code else 0)


def test_a_shell_completes_settings_without_anything_slow() -> None:
    program = (
        "import sys\n"
        "from click.shell_completion import ShellComplete\n"
        "from jaxplore.cli import cli\n"
        "found = ShellComplete(cli, {}, 'jaxplore', 'X').get_completions(['run', '--set'], 'lid')\n"
        "print(found[0].value, 'jax' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "lidar.num_beams= False\n"


ALL = ["two-layer", "parallel", "sequential", "random-walk", "goal"]
ROOM = {"size": [4.0, 3.0], "resolution": 0.2, "start": [1.0, 1.5, 0.0]}
FEW = ["--samples", "8", "--beams", "8", "--range", "1", "--set", "fields.num_directions=4"]
for number in ("horizon=4", "field_range=1", "field_noise=0", "local_range=1", "local_extent=1"):
    FEW += ["--set", f"informative.{number}"]
ZONE, GOAL = {"zones": [[2.0, 0.0, 4.0, 3.0]]}, {"goal": [3.0, 1.5, -2.0]}


class Asked(NamedTuple):
    """What a command asked to be compared."""

    experiments: dict[str, tuple[Any, jx.Scenario, int]]
    seeds: list[int]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Asked]:
    """Compare nothing, as if it was interrupted at once, and return the list of what was asked."""
    asked: list[Asked] = []

    def compare(
        experiments: dict[str, Any], seeds: range, *, progress: bool, runner: Any
    ) -> jx.study.Comparison:
        assert progress
        asked.append(Asked(dict(experiments), list(seeds)))
        return jx.study.Comparison(dict.fromkeys(experiments, ()), {}, is_interrupted=True)

    monkeypatch.setattr("jaxplore.cli._comparison.compare", compare)
    return asked


def interrupted(*arguments: str) -> None:
    """Run a command that is interrupted; it keeps what is done and says so by its exit code."""
    with pytest.raises(SystemExit) as exit_:
        main(list(arguments))
    assert exit_.value.code == 130


@pytest.fixture
def chosen(asked: list[Asked], monkeypatch: pytest.MonkeyPatch) -> list[Asked]:
    """The same with settings in place of controllers: nothing is built."""
    monkeypatch.setattr(
        "jaxplore.cli._comparison.build", lambda settings: (settings, None, 1, None)
    )
    return asked


def test_a_chosen_start_of_a_comparison_and_of_a_search_is_kept(
    ros_map: Path, chosen: list[Asked], monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    interrupted("compare", str(ros_map), "--architectures", "explorer,wander", "--out", "it")
    starts = {settings.start for settings, *_ in chosen[0].experiments.values()}
    assert len(starts) == 1
    assert None not in starts
    assert yaml.safe_load(Path("it/settings.yaml").read_text())["start"] == [*starts.pop()]
    assert capsys.readouterr().err.startswith("Start: ")
    asked: list[Any] = []

    class Stopped:
        def __init__(self, scenarios: dict[str, Any], **given: Any) -> None:
            asked.extend([scenarios, given["common"]])
            raise ValueError("enough")

    monkeypatch.setattr("jaxplore.cli._tune.SettingsEpisodes", Stopped)
    with pytest.raises(SystemExit):
        main(["tune", str(ros_map), "--tune", "controller.temperature"])
    (scenario,) = asked[0].values()
    assert scenario["start"] == asked[1]["start"]


@pytest.fixture
def room() -> Path:
    Path("room.yaml").write_text(yaml.safe_dump(ROOM))
    return Path("room.yaml")


@pytest.mark.parametrize(
    ("entries", "more", "expected"),
    [
        (None, {"map": "zones"}, ALL),
        (None, {"map": "office"}, ["two-layer", "parallel", "random-walk"]),
        (None, {"map": "office", "goal": (3.0, 3.0)}, ["two-layer", "parallel", *ALL[3:]]),
        ({}, {}, ["two-layer", "parallel", "random-walk"]),
        (ZONE, {}, ["two-layer", "parallel", "random-walk"]),
        (GOAL, {}, ["two-layer", "parallel", "random-walk", "goal"]),
        (ZONE, {"goal": (3.0, 1.5)}, ALL),
        (ZONE | GOAL, {}, ALL),
    ],
)
def test_a_map_says_what_can_be_compared_on_it(
    entries: dict[str, Any] | None, more: dict[str, Any], expected: list[str]
) -> None:
    if entries is not None:
        Path("room.yaml").write_text(yaml.safe_dump(ROOM | entries))
        more = {"map": "room.yaml", **more}
    assert list(choose_architectures({"architecture": "two-layer", **more})) == expected


def test_compare_takes_all_that_the_map_allows_and_seeds_from_the_first(
    room: Path, asked: list[Asked], capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        interrupted("compare", str(room), "--seed", "7", "--seeds", "3", *FEW, "--time-limit", "2")
    captured = capsys.readouterr()
    for experiments, seeds in asked:
        assert list(experiments) == ["two-layer", "parallel", "random-walk"]
        assert seeds == [7, 8, 9]
        assert {num_steps for *_, num_steps in experiments.values()} == {100}
    assert "runs/room-comparison-2/table.md" in captured.out.splitlines()
    assert captured.err.count("-comparison holds the finished runs") == 1
    assert captured.err.count("-comparison-2 holds the finished runs") == 1
    names = {"metrics.json", "table.md", "curves.png", "settings.yaml"}
    for folder in ("room-comparison", "room-comparison-2"):
        assert {path.name for path in (Path("runs") / folder).iterdir()} == names
    assert json.loads(Path("runs/room-comparison/metrics.json").read_text())["is_interrupted"]


def test_samples_reach_every_controller_of_a_comparison(room: Path, asked: list[Asked]) -> None:
    interrupted(
        "compare", str(room), "--architectures", "random-walk,two-layer", *FEW, "--out", "it"
    )
    ((experiments, seeds),) = asked
    assert list(experiments) == ["random-walk", "two-layer"]
    assert seeds == list(range(20))
    for controller, *_ in experiments.values():
        assert (controller.mppi.num_samples, controller.mppi.horizon) == (8, 4)
    used = yaml.safe_load(Path("it/settings.yaml").read_text())
    # None of them reads the section of the explorer.
    assert used["informative"]["num_samples"] == 8
    assert "controller" not in used


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["compare"], "setting map is missing"),
        (["compare", "gone.yaml"], "gone.yaml"),
        (["compare", "MAP", "--radius", "3.5"], "the map has no place for a robot of radius 3.5 m"),
        (["compare", "ROOM", "--seeds", "0"], "--seeds is 0; accepted: a whole number >= 1"),
        (["compare", "ROOM", "--seeds", "-2"], "--seeds is -2; accepted: a whole number >= 1"),
        (["compare", "ROOM", "--seeds", "two"], "--seeds"),
        (
            ["compare", "ROOM", "--architectures", "two-layer,three-layer"],
            "setting architecture is 'three-layer'; accepted: 'explorer', 'portfolio', 'wander'",
        ),
        (["compare", "ROOM", "--architectures", ""], "setting architecture is ''; accepted"),
        (["compare", "ROOM", "--architectures", "goal"], "goal is missing; accepted: a position"),
        (["compare", "ROOM", "--architectures", "sequential"], "accepted: a world with both"),
        (["compare", "ROOM", "--samples", "0"], "num_samples is 0"),
        # It would be taken for a choice of what to compare.
        (["compare", "ROOM", "--architecture", "parallel"], "--architecture"),
        (
            ["compare", "ROOM", "--architectures", "random-walk,explorer"],
            "'random-walk,explorer', of which explorer drives another robot with another sensor",
        ),
        (["compare", "ROOM", "--out", "taken"], "taken' exists"),
        (["compare", "ROOM", "--out", "former"], "former' holds a former run"),
        (["compare", "ROOM", "--out", "taken", "--overwrite"], "taken' exists"),
        (["compare", "ROOM", "--out", "file/inside"], "file"),
    ],
)
def test_what_cannot_be_compared_is_one_line(
    ros_map: Path, room: Path, asked: list[Asked], fails, arguments: list[str], reason: str
) -> None:
    for name in ("taken", "former"):
        Path(name).mkdir()
    Path("former/metrics.json").write_text("{}")
    Path("file").write_text("")
    before = sorted(Path.cwd().rglob("*"))
    places = {"MAP": str(ros_map), "ROOM": str(room)}
    assert reason in fails(*(places.get(each, each) for each in arguments))
    assert asked == []
    assert sorted(Path.cwd().rglob("*")) == before


def test_the_table_of_a_comparison_keeps_its_units(
    room: Path, chosen: list[Asked], capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    interrupted("compare", str(room), "--architectures", "random-walk", "--out", "it")
    shown = capsys.readouterr().out
    header = Path("it/table.md").read_text().splitlines()[0]
    for cell in (each.strip() for each in header.split("|")):
        assert cell in shown
    assert "it: medians [quartiles]" in shown


def test_all_that_is_compared_differs_in_the_architecture_only(
    room: Path, chosen: list[Asked]
) -> None:
    interrupted("compare", str(room), "--architectures", "random-walk,parallel", "--out", "it")
    assert chosen
    for experiments, _ in chosen:
        first, second = (
            settings.model_dump(exclude={"architecture"}) for settings, *_ in experiments.values()
        )
        assert first == second


@pytest.mark.parametrize(
    ("given", "rule", "weight"),
    [
        ({}, jx.planning.RemainingInformation, 0.05),
        ({"target_choice": "occlusion"}, jx.planning.TrajectoryChoice, 1.0),
        ({"target_choice": "direct", "distance_weight": 0.3}, jx.planning.TrajectoryChoice, 0.3),
        ({"distance_weight": 0.2}, jx.planning.RemainingInformation, 0.2),
    ],
)
def test_zones_are_picked_by_the_rule_that_is_set(given: dict, rule: type, weight: float) -> None:
    entries = {"map": "zones", "architecture": "sequential"}
    controller: Any = build(make_settings({**entries, "informative": given})).controller
    choice = controller.reference.choice
    assert type(choice) is rule
    assert float(choice.weight) == pytest.approx(weight)
    assert choice.targets.zones.member.shape[0] == 3
    if rule is jx.planning.TrajectoryChoice:
        assert choice.information.method == given["target_choice"]


def test_a_map_that_is_no_file_is_answered_with_what_there_is(fails, tmp_path: Path) -> None:
    assert "zone is not there; accepted: the YAML file of a ROS map" in fails("run", "zone")
    names = "perimeter, path, forest, office3d, maze3d, cave3d, warehouse3d, fleet, volume"
    assert names in fails("run", "zone")
    (tmp_path / "maps").mkdir()
    assert "is a folder; accepted: a file" in fails("run", "maps")
    Path("maps/depot.yaml").write_text("")
    assert "such as maps/depot.yaml" in fails("run", "maps")
    # Files of other kinds are not read as YAML.
    for name in ("cloud.e57", "tree.vxl", "picture.jpg"):
        Path(name).write_bytes(b"\0\1")
        line = fails("run", name)
        assert f"{name} is of another kind; accepted: a file that ends with .yaml, .yml, .s" in line
    Path("maps/depot.pgm").write_bytes(b"P5")
    line = fails("run", "maps/depot.pgm")
    assert "accepted: maps/depot.yaml, which is beside it, or a file that ends with .yaml" in line


def test_a_run_that_is_interrupted_is_kept_and_ends_with_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    progress = jx.ExplorationScenario.progress

    def interrupt(self: jx.ExplorationScenario, state: Any) -> tuple[float, str]:
        os.kill(os.getpid(), signal.SIGINT)
        return progress(self, state)

    monkeypatch.setattr(jx.ExplorationScenario, "progress", interrupt)
    small = ["--set", "office.width=9", "--set", "office.height=8", *SMALL, "--no-animation"]
    interrupted("run", "office", "--time-limit", "5", "--range", "2.0", *small)
    assert "Interrupted: runs/office holds the run up to then." in capsys.readouterr().err
    metrics = json.loads(Path("runs/office/metrics.json").read_text())
    assert metrics["is_interrupted"]
    assert 0 < metrics["num_steps"] < 250


def test_a_folder_that_another_process_writes_is_refused_before_anything_runs(
    fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("jaxplore.cli._run.build", lambda _: pytest.fail("it runs"))
    Path("runs").mkdir()
    with reserve_hidden_folder(Path("runs").absolute() / "a") as hidden:
        assert is_reserved(Path("runs/a"))
        reason = fails("run", "office", "--out", "runs/a")
        assert f"is in use by another process, number {os.getpid()}; accepted" in reason
        assert _show.free_name(Path("runs/a")) == Path("runs/a-2")
    assert not hidden.exists()
    assert sorted(Path("runs").iterdir()) == []


def test_streams_that_cannot_be_written_are_told_once() -> None:
    """Standard output may be without a reader, or on a full disk."""
    reader, writer = os.pipe()
    os.close(reader)
    out = _streams._Output(writer, is_required=True)
    assert out.write(b"text") == 4
    full = _streams._Output(os.open("/dev/full", os.O_WRONLY), is_required=True)
    with pytest.raises(OSError, match="standard output cannot be written: No space left"):
        full.write(b"text")
    assert full.write(b"text") == 4
    progress = _streams._Output(os.open("/dev/full", os.O_WRONLY), is_required=False)
    assert progress.write(b"text") == 4
    for each in (out, full, progress):
        os.close(each.fileno())


def test_it_is_a_module_too() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "jaxplore", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith("jaxplore, version")
