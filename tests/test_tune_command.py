"""`jaxplore tune`, from the command line to its files."""

import base64
import csv
import io
import re
from pathlib import Path

import pytest
import yaml
from PIL import Image

from jaxplore.cli import main
from jaxplore.cli._tune import scenario_entries
from jaxplore.study.tuning.study import Study

QUICK = ("path", "--samples", "16", "--set", "controller.horizon=6", "--time-limit", "0.6")
SEARCH = (
    *("tune", *QUICK, "--tune", "controller.temperature=1:300:log"),
    *("--tune", "cost.progress.weight=1:100:log", "--set", "controller.progress_weight=20"),
    *("--objective", "-progress + 10*collisions", "--seeds", "1", "--unseen", "3"),
    *("--optimizer", "cma-es", "--population", "4", "--out", "out"),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a place in which a search was interrupted and taken up again."""
    place = tmp_path_factory.mktemp("tune")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        episodes = 0
        keep = Study.run

        def interrupted(self, *arguments, **options):
            run = self.episodes.run

            def some(asked, on_result):
                def done(episode, told):
                    nonlocal episodes
                    episodes += 1
                    if episodes == 6:
                        raise KeyboardInterrupt
                    on_result(episode, told)

                run(asked, done)

            patch.setattr(self.episodes, "run", some)
            return keep(self, *arguments, **options)

        with pytest.MonkeyPatch.context() as once:
            once.setattr(Study, "run", interrupted)
            with pytest.raises(SystemExit) as exit_:
                main([*SEARCH, "--budget", "8"])
        assert exit_.value.code == 130
        assert (place / "out" / "settings.yaml").is_file()
        main([*SEARCH, "--budget", "8"])
    # One episode was lost to the interrupt, none that was done ran again.
    assert episodes == 6
    return place


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))


def test_it_writes_settings_tables_pictures_and_a_page(folder) -> None:
    out = folder / "out"
    names = {path.name for path in out.iterdir()} - {".lock"}
    assert names == {
        *("study.jsonl", "settings.yaml", "record.yaml", "trials.csv", "unseen.csv", "report.html"),
        *("before_after.gif", "convergence.png", "slices.png"),
    }
    trials = rows(out / "trials.csv")
    assert [int(row["number"]) for row in trials] == list(range(8))
    assert {row["state"] for row in trials} <= {"done", "given up"}
    unseen = rows(out / "unseen.csv")
    # Seed 0 was searched with, 1 to 6 chose.
    assert [int(row["seed"]) for row in unseen] == [7, 8, 9]
    page = (out / "report.html").read_text(encoding="utf-8")
    images = re.findall(r'src="data:image/(png|gif);base64,([^"]+)"', page)
    assert [kind for kind, _ in images] == ["gif", "png", "png"]
    for _, code in images:
        with Image.open(io.BytesIO(base64.b64decode(code))) as picture:
            picture.verify()
    assert "http" not in page


def test_the_settings_are_the_chosen_ones_and_run(folder, monkeypatch) -> None:
    monkeypatch.chdir(folder)
    record = yaml.safe_load((folder / "out" / "record.yaml").read_text())
    chosen = record["chosen"]
    settings = yaml.safe_load((folder / "out" / "settings.yaml").read_text())
    temperature = chosen["values"]["controller.temperature"]
    assert settings["controller"]["temperature"] == pytest.approx(temperature, rel=1e-4)
    weight = chosen["values"]["cost.progress.weight"]
    assert settings["parameters"]["cost.progress.weight"] == pytest.approx(weight, rel=1e-4)
    main(["run", "--settings", "out/settings.yaml", "--out", "again", "--no-animation"])
    metrics = yaml.safe_load((folder / "again" / "metrics.json").read_text())
    trial = rows(folder / "out" / "trials.csv")[chosen["number"]]
    # The seed of the settings is the first of the search.
    assert -metrics["progress"] == pytest.approx(float(trial["-progress + 10*collisions"]))
    assert record["changes on unseen seeds"]["progress"]["after"] > 0.0


def test_the_same_command_does_nothing_again_and_another_is_refused(
    folder, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(folder)
    before = (folder / "out" / "trials.csv").read_text()

    def never(*_):
        raise AssertionError("an episode ran again")

    monkeypatch.setattr("jaxplore.study.runner.Runner.run", never)
    main([*SEARCH, "--budget", "8", "--no-animation"])
    assert (folder / "out" / "trials.csv").read_text() == before
    with pytest.raises(SystemExit) as exit_:
        main([*SEARCH, "--budget", "8", "--set", "control_rate=25"])
    assert exit_.value.code == 2
    assert "was made with episodes.scenarios.path.control_rate 50.0" in capsys.readouterr().err
    Path("wagon.yaml").write_text("robot: {model: differential_drive}", encoding="utf-8")
    with pytest.raises(SystemExit) as exit_:
        main([*SEARCH, "--budget", "8", "--also", "wagon.yaml"])
    assert exit_.value.code == 2
    assert "was made for path, asked is path, wagon; accepted: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "--tune is missing; accepted: a setting or a controller parameter"),
        (("--tune", "controller.temprature"), "accepted: such as controller.temperature"),
        (("--tune", "controller.temperature=3:1"), "are 3 and 1; accepted: finite ones, the lower"),
        (("--tune", "controller.temperature", "--budget", "soon"), "--budget is 'soon'; accepted"),
        (("--tune", "controller.temperature", "--seeds", "0"), "--seeds is 0; accepted"),
        (("--tune", "controller.temperature", "--objective", "speed"), "metric speed is not known"),
        (("--tune", "controller.temperature", "--measure", "x"), "--measure is 'x'; accepted"),
        (("--tune", "controller.temperature", "--workers", "0"), "workers is 0; accepted"),
        (
            ("--tune", "controller.temperature", "--also", "path.csv"),
            "--also is 'path.csv', which is",
        ),
        (("--tune", "controller.temperature", "--overwrite"), "--overwrite is given; accepted"),
        (
            ("--tune", "controller.temperature", "--batch", "2", "--workers", "2"),
            "batch is 2 with workers; accepted: one of them",
        ),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    fails, tmp_path, monkeypatch, arguments, message
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in fails("tune", *QUICK, *arguments)


def asked(**given):
    """Return the options of a scenario as the command line gives them."""
    names = ("map_", "path_file", "settings_file", "laps", "obstacles", "controller__num_samples")
    return {**dict.fromkeys(names), "assignments": (), **given}


def test_settings_of_another_robot_are_a_scenario(tmp_path) -> None:
    wagon = tmp_path / "wagon.yaml"
    wagon.write_text("robot: {model: differential_drive, max_speed: 3}", encoding="utf-8")
    track = tmp_path / "hall.csv"
    scenarios, common = scenario_entries(asked(map_="path", obstacles__number=5), [str(wagon)])
    assert scenarios["path"] == common == {"path": "track", "obstacles": {"number": 5}}
    assert scenarios["wagon"] == {
        **common,
        "robot": {"model": "differential_drive", "max_speed": 3},
    }
    # Of several places, only what they share is worth keeping.
    scenarios, common = scenario_entries(asked(map_="path", obstacles__number=5), [str(track)])
    assert scenarios["hall"] == {"path": str(track), "obstacles": {"number": 5}}
    assert common == {"obstacles": {"number": 5}}


def test_maps_worlds_and_settings_are_scenarios_beside_a_map(tmp_path) -> None:
    map_, world, wagon = (tmp_path / f"{name}.yaml" for name in ("lab", "yard", "wagon"))
    map_.write_text("image: lab.pgm", encoding="utf-8")
    world.write_text("world: {size: [4, 4]}\nseed: 3", encoding="utf-8")
    wagon.write_text("robot: {radius: 0.3}", encoding="utf-8")
    also = [str(map_), str(world), str(wagon)]
    options = asked(map_="office", assignments=("robot.max_speed=2",))
    scenarios, common = scenario_entries(options, also)
    fast = {"robot": {"max_speed": 2}}
    assert scenarios == {
        "office": {"map": "office", **fast},
        "lab": {"map": str(map_), **fast},
        "yard": {"map": str(world), "world": {"size": [4, 4]}, "seed": 3, **fast},
        "wagon": {"map": "office", "robot": {"max_speed": 2, "radius": 0.3}},
    }
    assert common == fast
