"""`jaxplore run path`, and its settings."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

import jaxplore as jx
from jaxplore.cli import main
from jaxplore.tasks.path.settings import make_path_settings
from jaxplore.tasks.registry import build

pytestmark = pytest.mark.long

SMALL = ["--samples", "16", "--set", "controller.horizon=6"]
ARC = np.linspace(0.0, np.pi, 9)
CENTRE = np.stack([4.0 * np.sin(ARC), 4.0 - 4.0 * np.cos(ARC)], axis=-1)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Half a circle with the widths of a track."""
    rows = np.column_stack([CENTRE, np.full(9, 0.9), np.full(9, 1.1)])
    np.savetxt(tmp_path / "half.csv", rows, delimiter=",", header="x,y,w_right,w_left")
    return tmp_path / "half.csv"


def test_a_run_along_a_file_writes_a_folder_that_repeats_itself(file: Path, capsys) -> None:
    given = ["--set", "is_closed=false", "--obstacles", "2", "--set", "obstacles.speeds=[0, 0.5]"]
    main(["run", "path", "--path", str(file), "--time-limit", "0.6", "--seed", "4", *SMALL, *given,
          "--no-animation"])  # fmt: skip
    shown = capsys.readouterr().out
    assert "contouring" in shown
    folder = Path("runs/half")
    assert str(folder / "path.png") in shown
    assert {path.name for path in folder.iterdir()} == {
        "metrics.json",
        "arrays.npz",
        "state.npz",
        "path.png",
        "errors.png",
        "settings.yaml",
    }
    used = yaml.safe_load((folder / "settings.yaml").read_text())
    assert used["path"] == str(file)
    assert used["obstacles"]["number"] == 2
    assert used["controller"]["num_samples"] == 16
    film = ["--fps", "20", "--film-scale", "0.5", "--video", "again.mp4", "--figures", "pdf,svg"]
    main(["run", "--settings", str(folder / "settings.yaml"), "--out", "again", *film])
    assert {"again/path.pdf", "again/errors.svg", "again.mp4"} <= set(
        capsys.readouterr().out.splitlines()
    )
    assert not list(Path("again").glob("*.png"))
    with Image.open("again/following.gif") as image:
        assert image.info["duration"] == 50
    assert Path("again.mp4").read_bytes()[4:8] == b"ftyp"
    with pytest.raises(SystemExit, match="2"):
        main(["run", "path", "--video", "again.mp4"])
    assert "'again.mp4', which exists; accepted" in capsys.readouterr().err
    first, again = (np.load(f"{name}/arrays.npz") for name in (folder, "again"))
    for name in first.files:
        np.testing.assert_array_equal(first[name], again[name])
    metrics = json.loads(Path("again/metrics.json").read_text())
    assert metrics["seed"] == 4
    assert metrics["num_steps"] == len(first["contouring"]) == 30


def test_without_a_file_it_drives_a_generated_track() -> None:
    main(["run", "path", "--time-limit", "0.1", *SMALL, "--no-animation"])
    lengths = [float(jx.race_track(seed).length) for seed in (0, 3)]
    assert lengths[0] != lengths[1]
    assert float(np.load("runs/path/arrays.npz")["length"]) == pytest.approx(lengths[0])
    other = build(make_path_settings({"track": {"seed": 3}})).scenario
    assert float(other.path.length) == pytest.approx(lengths[1])


def test_another_robot_follows() -> None:
    """With the default weights, and its own bounds."""
    settings = make_path_settings(
        {
            "robot": {"model": "bicycle", "max_speed": 2.0, "radius": 0.2},
            "track": {"length": 30.0, "half_width": 1.0, "num_bends": 3},
            "controller": {"num_samples": 64},
            "time_limit": 4.0,
        }
    )
    built = build(settings)
    run = jx.simulate(*built[:3], key=built.key, num_trajectories=0)
    assert run.metrics.progress > 4.0 * 5.0 / 6.0
    assert run.metrics.corridor_violations == 0


def test_settings_become_what_they_say(file: Path) -> None:
    settings = make_path_settings(
        {
            "path": str(file),
            "is_closed": False,
            "obstacles": {
                "discs": [[2.0, 1.0, 0.1]],
                "polygons": [[[3, 3], [3.2, 3], [3.2, 3.3]]],
                "prediction": "constant-velocity",
            },
            "controller": {"risk_level": 0.9, "num_outcomes": 4},
            "start": [0.1, 0.0, 0.2],
            "laps": 1,
        }
    )
    controller, scenario, num_steps, _ = build(settings)
    assert num_steps == 6000
    assert controller.num_outcomes == 4
    assert isinstance(controller.risk, jx.ConditionalValueAtRisk)
    assert isinstance(controller.disturbance, jx.control.UncertainObstacles)
    assert scenario.standing.number == 2
    assert scenario.prediction == "constant-velocity"
    np.testing.assert_allclose(scenario.start[:3], [0.1, 0.0, 0.2])
    widths = np.asarray(scenario.path.half_widths)
    np.testing.assert_allclose(widths[0], [1.1, 0.9], rtol=1e-6)
    plain = make_path_settings({"path": str(file), "half_width": 0.5, "is_closed": False})
    np.testing.assert_array_equal(build(plain).scenario.path.half_widths, widths)
    np.savetxt("bare.csv", CENTRE, delimiter=",")
    bare = make_path_settings({"path": "bare.csv", "half_width": 0.5})
    np.testing.assert_allclose(build(bare).scenario.path.half_widths, 0.5)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["run", "path", "--path", "no.csv"], "no.csv"),
        (["run", "office", "--path", "half.csv"], "--path is 'half.csv' beside the map 'office'"),
        (["run", "office", "--laps", "2"], "laps is 2 on a map; accepted: along a path"),
        (["run", "path", "--laps", "0"], "setting laps is 0"),
        (["run", "path", "--fps", "0"], "fps is 0.0; accepted"),
        (["run", "path", "--fps", "60"], "fps of a GIF is 60.0; accepted"),
        (["run", "path", "--film-scale", "9"], "scale is 9.0; accepted"),
        (["run", "path", "--no-animation", "--fps", "5"], "--fps is 5 beside --no-animation"),
        (["run", "path", "--video", "run.avi"], "--video is 'run.avi'; accepted: a file that ends"),
        (["run", "path", "--video", "no/run.mp4"], "--video is 'no/run.mp4'; accepted: a file in"),
        (["run", "path", "--figures", "jpg"], "figures is 'jpg'; accepted"),
        (["compare", "path", "--film-scale", "0"], "scale is 0.0; accepted"),
        (["tune", "path", "--figures", "jpg"], "figures is 'jpg'; accepted"),
        (
            ["run", "path", "--beams", "20"],
            "lidar.num_beams is 20 along a path; accepted: on a map",
        ),
        (
            ["run", "path", "--goal", "1", "2"],
            "goal is (1.0, 2.0) along a path; accepted: on a map",
        ),
        (["run", "path", "--robot", "quadrotor"], "setting robot.model is 'quadrotor'"),
        (["run", "path", "--set", "controller.speed=1"], "unknown setting controller.speed"),
        (["run", "path", "--obstacles", "-1"], "setting obstacles.number is -1"),
        (["run", "path", "--set", "track.half_width=0.1", "--set", "track.min_radius=1"], "wide"),
        (["run", "path", "--set", "obstacles.polygons=[[[0, 0], [1, 1]]]"], "polygons[0]"),
        (
            ["run", "path", "--obstacles", "1", "--set", "obstacles.speeds=[2, 1]"],
            "obstacles.speeds is (2.0, 1.0)",
        ),
    ],
)
def test_bad_input_is_one_line(file: Path, fails, arguments: list[str], reason: str) -> None:
    assert reason in fails(*arguments)
    assert not Path("runs").exists()


def test_two_waypoints_too_few_or_repeated_are_one_line(tmp_path: Path, fails) -> None:
    Path("one.csv").write_text("1.0,2.0\n")
    assert "one.csv" in fails("run", "path", "--path", "one.csv")
    Path("nan.csv").write_text("1.0,2.0\nnan,3.0\n")
    assert "nan.csv" in fails("run", "path", "--path", "nan.csv")
