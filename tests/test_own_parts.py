"""Rules, controllers and robots of the user's own, by MODULE:NAME."""

import importlib
import itertools
import os
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
import yaml

import jaxplore as jx
from jaxplore.cli import main
from jaxplore.settings.readers import read_values
from jaxplore.settings.sections import read_settings
from jaxplore.study.comparison.episodes import make_episodes
from jaxplore.study.comparison.maps import maps_in
from jaxplore.study.comparison.row_task import RowTask
from jaxplore.study.runner import Runner
from jaxplore.tasks.registry import build, make_settings
from jaxplore.tasks.user_code import hash_user_code

MINE = """
    import jax.numpy as jnp
    import jaxplore as jx
    from jaxplore.tasks.registry import build, make_settings


    class Near(jx.planning.TargetRule):
        def candidates(self, frontiers):
            return frontiers.is_frontier

        def scores(self, frontiers, *, key):
            return -frontiers.distance


    class Reaching(Near):
        reach: float


    class Cart(jx.Unicycle):
        def __init__(self):
            super().__init__(max_speed=0.7, max_turn_rate=1.5, radius=0.15)


    def careful(scenario):
        return jx.explorer(scenario.robot, clearance=0.77, num_samples=16)


    def broken(scenario):
        return scenario.wings


    def silent(scenario):
        pass


    def tell(batch):
        (episode,) = batch
        rule = build(make_settings(episode.entries)).controller.rule
        raise ValueError(f"it is a {type(rule).__name__} of {type(rule).__module__}")


    class Wrong(Near):
        def scores(self, frontiers, *, key):
            return frontiers.distances


    near, cart, number = Near(), Cart(), 3
"""
SMALL = {"office": {"width": 9.0, "height": 8.0}, "controller": {"num_samples": 16}}
ROOM = ["--set", "office.width=9", "--set", "office.height=8"]
_numbers = itertools.count()


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], str]]:
    """Write a module into the current folder, and return what makes MODULE:NAME of its names.

    Every test has a module of its own: Python imports a module once.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [each for each in sys.path if each not in ("", os.getcwd())])
    module = f"mine{next(_numbers)}"
    Path(f"{module}.py").write_text(textwrap.dedent(MINE))
    yield lambda name: f"{module}:{name}"
    sys.modules.pop(module, None)


def office(**more: Any) -> Any:
    return build(make_settings({"map": "office", **SMALL, **more}))


@pytest.mark.parametrize("name", ["Near", "near"])
def test_a_rule_of_ones_own_drives_like_one_of_the_library(mine, name: str) -> None:
    own = office(architecture=mine(name)).controller
    assert type(own.rule).__name__ == "Near"
    theirs = office(architecture="nearest-frontier").controller
    # All but the rule is the same, settings included.
    assert jax.tree.structure(own.tracker) == jax.tree.structure(theirs.tracker)
    for ours, other in zip(*map(jax.tree.leaves, (own.tracker, theirs.tracker)), strict=True):
        np.testing.assert_array_equal(ours, other)


def test_a_function_makes_the_controller_of_a_scenario(mine) -> None:
    made = office(architecture=mine("careful"))
    assert isinstance(made.controller, jx.MPPI)
    found = jx.get_parameters(made.controller)
    assert np.float32(0.77) in [value for value in found.values() if np.ndim(value) == 0]


@pytest.mark.parametrize("name", ["Cart", "cart"])
def test_a_robot_of_ones_own_explores_and_follows_a_path(mine, name: str) -> None:
    made = office(robot={"model": mine(name)})
    along = build(make_settings({"path": "track", "robot": {"model": mine(name)}}))
    assert type(made.scenario.robot).__name__ == "Cart"
    assert float(made.scenario.robot.radius) == np.float32(0.15)
    np.testing.assert_allclose(made.controller.dynamics.control_max, [0.7, 1.5])
    assert along.scenario.robot.control_names[:2] == made.scenario.robot.control_names


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--architecture", "gone:Rule"), "there is no module gone; accepted: a module in the"),
        (("--architecture", "jaxplore.gone:Rule"), "there is no module jaxplore.gone"),
        (("--architecture", "MINE:Far"), "has no Far; accepted: a name in it, such as"),
        (("--architecture", "MINE:number"), "MINE:number, 3; accepted: a TargetRule, a class or"),
        (("--architecture", "MINE:Cart"), "the class Cart; accepted: a TargetRule, a class or"),
        (("--architecture", "MINE:Reaching"), "needs arguments (missing a required argument: 're"),
        (("--architecture", "MINE:broken"), "fails: AttributeError: 'ExplorationScenario' object"),
        (("--architecture", "MINE:silent"), "which returned None; accepted: a TargetRule, a class"),
        (("--architecture", "a:b:c"), "'goal' or MODULE:NAME of your own"),
        (("--architecture", "../mine:Near"), "'goal' or MODULE:NAME of your own"),
        (("--robot", "MINE:Near"), "the class Near; accepted: a Dynamics, a class or an instance"),
        (("--robot", "wrong:Cart"), "fails: SyntaxError: '[' was never closed (WRONG, line 1)\n"),
        (("--robot", "empty:Cart"), "fails: ZeroDivisionError: division by zero (EMPTY, line 2)"),
        (("--robot", "needy:Cart"), "ModuleNotFoundError: No module named 'gone_as_well' (NEEDY"),
    ],
)
def test_what_is_no_part_is_one_line(mine, fails, arguments: tuple[str, ...], reason: str) -> None:
    for name, text in {
        "wrong": "x = [1",
        "empty": "\n1 / 0",
        "needy": "import gone_as_well",
    }.items():
        Path(f"{name}.py").write_text(text)
        reason = reason.replace(name.upper(), str(Path(f"{name}.py").absolute()))
    module = mine("").removesuffix(":")
    option, value = arguments
    line = fails("run", "office", option, value.replace("MINE", module))
    assert reason.replace("MINE", module) in line


def test_a_mistake_in_a_rule_is_one_line_behind_the_progress(mine, capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["run", "office", "--architecture", mine("Wrong"), *ROOM])
    assert ended.value.code == 2
    assert capsys.readouterr().err.splitlines()[-1] == (
        "jaxplore: rule Wrong fails in scores: AttributeError: 'Frontiers' object has no attribute "
        "'distances'"
    )


def test_a_settings_file_names_code_only_if_it_is_trusted(mine, fails, asked: list[Any]) -> None:
    entries = {"architecture": mine("Near"), "robot": {"model": mine("Cart")}}
    scenario = {"world": {"size": [4.0, 3.0], "start": [1.0, 1.5, 0.0]}, **entries}
    Path("rule.yaml").write_text(yaml.safe_dump({"architecture": mine("Near")}))
    Path("robot.yaml").write_text(yaml.safe_dump({"robot": entries["robot"]}))
    Path("scenario.yaml").write_text(yaml.safe_dump(scenario))
    commands = {
        ("run", "office", "--settings", "rule.yaml"): "rule.yaml has the architecture",
        ("run", "office", "--settings", "robot.yaml"): "robot.yaml has the robot.model",
        ("run", "scenario.yaml"): "scenario.yaml has the architecture",
        ("compare", "office", "--variants", "rule.yaml,robot.yaml"): "rule.yaml has the arch",
        ("compare", "scenario.yaml"): "scenario.yaml has the architecture",
        ("tune", "office", "--also", "robot.yaml", "--tune", "x"): "robot.yaml has the robot.model",
    }
    for command, reason in commands.items():
        line = fails(*command)
        assert reason in line
        assert line.endswith(
            "whose code would run; accepted: with --trust, if you trust the file\n"
        )
    assert mine("").removesuffix(":") not in sys.modules
    assert not asked
    for command in list(commands)[:3]:
        assert "enough" in fails(*command, "--trust")
    assert [each.architecture for each in asked] == [mine("Near"), "explorer", mine("Near")]
    assert [each.robot.model for each in asked] == [
        "differential_drive",
        mine("Cart"),
        mine("Cart"),
    ]
    with pytest.raises(ValueError, match="whose code would run"):
        read_settings("rule.yaml")


def test_the_settings_of_a_run_repeat_it(mine, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[Any] = []
    monkeypatch.setattr("jaxplore.cli._run.simulate", lambda *_, **__: None)
    monkeypatch.setattr(
        "jaxplore.cli._run.save", lambda _, __, settings, *___, **____: kept.append(settings)
    )
    main(["run", "office", "--architecture", mine("Near"), "--robot", mine("Cart"), *ROOM])
    Path("settings.yaml").write_text(yaml.safe_dump(read_values(kept[0])))
    main(["run", "--settings", "settings.yaml", "--trust"])
    assert kept[0] == kept[1]
    assert (kept[0].architecture, kept[0].robot.model) == (mine("Near"), mine("Cart"))


def test_explorers_of_ones_own_are_compared(mine, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def compare(experiments: dict[str, Any], *_: Any, **__: Any) -> None:
        asked.update(experiments)
        raise ValueError("enough")

    monkeypatch.setattr("jaxplore.cli._comparison.compare", compare)
    names = f"{mine('Near')},{mine('careful')},explorer"
    with pytest.raises(SystemExit):
        main(["compare", "office", "--explorers", names, *ROOM])
    # Variants have short names, which name files.
    kinds = {name: type(controller).__name__ for name, (controller, *_) in asked.items()}
    assert kinds == {"Near": "TargetExplorer", "careful": "MPPI", "explorer": "MPPI"}


def test_processes_import_it_too(mine) -> None:
    Path("maps").mkdir()
    jx.OccupancyGrid(np.zeros((40, 40)), 0.1).to_ros(Path("maps/hall.yaml"))
    variants = {"a": {"architecture": mine("Near")}, "b": {"architecture": mine("near")}}
    episodes = make_episodes(maps_in("maps"), variants, (0,), {})
    module = importlib.import_module(mine("").removesuffix(":"))
    tasks = [RowTask.from_episodes((each,), module.tell) for each in episodes]
    reasons: list[str] = []
    with Runner(2) as runner:
        runner.run(tasks, lambda _, rows: reasons.append(rows[0].error))
    assert reasons == 2 * [f"it is a Near of {module.__name__}"]


def test_runs_on_maps_are_those_of_one_version_of_the_code(mine) -> None:
    Path("maps").mkdir()
    jx.OccupancyGrid(np.zeros((40, 40)), 0.1).to_ros(Path("maps/hall.yaml"))

    def ids() -> list[str]:
        names = (mine("Near"), "explorer")
        return [each.id for each in make_episodes(maps_in("maps"), names, (0,), {})]

    near, explorer = ids()
    assert [near, explorer] == ids()
    module = Path(f"{mine('').removesuffix(':')}.py")
    module.write_text(module.read_text().replace("-frontiers", "-2.0 * frontiers"))
    assert ids()[0] != near
    assert ids()[1] == explorer
    with pytest.raises(ValueError, match="has no Far"):
        make_episodes(maps_in("maps"), (mine("Far"),), (0,), {})
    assert hash_user_code(make_settings({"map": "office"})) == ""


def test_a_search_has_the_settings_that_ones_own_reads(mine) -> None:
    def searched(name: str) -> set[str]:
        entries = {"map": "office", "architecture": mine(name), **SMALL}
        episodes = jx.study.tuning.SettingsEpisodes({"office": entries})
        assert episodes.describe()["codes"]["office"]
        return {each.partition(".")[0] for each in episodes._known}

    assert "controller" in searched("Near")
    assert "controller" not in searched("careful")
