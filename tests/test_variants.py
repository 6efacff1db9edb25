"""Variants, and `jaxplore compare` along a path."""

import json
from pathlib import Path

import pytest
import yaml

import jaxplore as jx
from jaxplore.cli import main
from jaxplore.study.comparison.compare import compare
from jaxplore.study.runner import Runner
from jaxplore.study.variants import make_variants
from jaxplore.tasks.registry import build, make_settings

pytestmark = pytest.mark.long

QUICK = {"path": "track", "time_limit": 0.6, "controller": {"num_samples": 16, "horizon": 6}}
VARIED = ["--vary", "controller.temperature=10,300"]
COMMAND = ["compare", "path", "--samples", "16", "--set", "controller.horizon=6"]
COMMAND += ["--time-limit", "0.6", "--seeds", "2", "--no-animation"]


def test_dimensions_are_combined(tmp_path: Path) -> None:
    mild = tmp_path / "mild.yaml"
    mild.write_text("robot: {max_speed: 2}", encoding="utf-8")
    assert make_variants() == {}
    assert make_variants(["explorer"]) == {"explorer": {"architecture": "explorer"}}
    assert make_variants(files=[str(mild)], varied=["robot.radius=0.2,0.3", "laps=1"]) == {
        "mild radius 0.2 laps 1": {"robot": {"max_speed": 2, "radius": 0.2}, "laps": 1},
        "mild radius 0.3 laps 1": {"robot": {"max_speed": 2, "radius": 0.3}, "laps": 1},
    }
    # What is no setting is a number of the controller.
    assert make_variants(varied=["cost.progress.weight=1e2"]) == {
        "weight 100.0": {"parameters": {"cost.progress.weight": 100.0}}
    }


@pytest.mark.parametrize(
    ("varied", "reason"),
    [
        (["a"], r"--vary is 'a'; accepted: NAME=A,B,C with numbers or words"),
        (["a=[1,2"], r"--vary is 'a=\[1,2'; accepted"),
        (["a=1,1"], r"variant a 1 is there twice; accepted: different ones"),
    ],
)
def test_bad_variants_are_named(varied: list[str], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        make_variants(varied=varied)


def test_two_path_planners_compare(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    main([*COMMAND, *VARIED])
    out = Path("runs/path-comparison")
    report = json.loads((out / "metrics.json").read_text())
    assert list(report["runs"]) == ["temperature 10", "temperature 300"]
    assert "progress [m]" in capsys.readouterr().out
    for name, runs in report["runs"].items():
        settings = yaml.safe_load((out / f"{name}.yaml").read_text())
        assert settings["controller"]["temperature"] == float(name.split()[1])
        for found in runs:
            *experiment, key = build(make_settings({**settings, "seed": found["seed"]}))
            alone = jx.simulate(*experiment, key=key, num_trajectories=0).metrics
            assert found["progress"] == alone.progress
            assert found["command_jerk"] == alone.command_jerk
    assert len({each["progress"] for runs in report["runs"].values() for each in runs}) == 4


def test_along_a_path_something_must_vary(fails, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "--vary is missing; accepted here: --vary NAME=A,B" in fails(*COMMAND)
    assert "unknown setting architecture" in fails(*COMMAND, "--architectures", "explorer")


def test_workers_come_to_the_same_as_this_process(posted) -> None:
    experiments = {
        name: build(make_settings({**QUICK, "laps": laps}))[:3]
        for name, laps in (("one", 1), ("two", 2))
    }
    here = compare(experiments, (4, 1))
    there = compare(experiments, (4, 1), runner=Runner(2))
    assert posted.started == 2
    assert list(there.runs) == ["one", "two"]
    for name, runs in here.runs.items():
        assert [each.seed for each in there.runs[name]] == [4, 1]
        assert [each.progress for each in there.runs[name]] == [each.progress for each in runs]
        assert (there.recordings[name].arrays()["state"] == _states(here, name)).all()


def _states(comparison: jx.study.Comparison, name: str):
    return comparison.recordings[name].arrays()["state"]
