"""The ROS package: its launch files start commands that exist, with settings that are accepted.

`launch` is no wheel, so that its classes are stood in for here by what they are told.
"""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import click
import pytest

import jaxplore
from jaxplore.cli import cli
from jaxplore.cli._entries import assign_all
from jaxplore.settings.sections import read_settings
from jaxplore.tasks.exploration.pilot import make_node_settings

PACKAGE = Path(__file__).parents[2] / "ros"


class Configuration:
    """Stands in for `LaunchConfiguration`."""

    def __init__(self, name: str) -> None:
        self.name = name

    def perform(self, context: dict[str, str]) -> str:
        return context[self.name]


def condition(is_wanted: bool):
    def make(value: Configuration):
        return lambda context: (value.perform(context) == "true") is is_wanted

    return make


def kept(kind: str):
    return lambda *arguments, **named: SimpleNamespace(kind=kind, arguments=arguments, **named)


MODULES = {
    "launch": {"LaunchDescription": list},
    "launch.actions": {
        name: kept(name) for name in ("DeclareLaunchArgument", "ExecuteProcess", "OpaqueFunction")
    },
    "launch.conditions": {"IfCondition": condition(True), "UnlessCondition": condition(False)},
    "launch.substitutions": {"LaunchConfiguration": Configuration},
    "launch_ros": {},
    "launch_ros.actions": {"Node": kept("Node")},
}


@pytest.fixture
def launched(monkeypatch):
    """Return a function that returns the commands and the nodes of a launch file."""
    for name, content in MODULES.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)

    def launched(name: str, **given: str) -> tuple[list[list[str]], list]:
        path = PACKAGE / "launch" / f"{name}.launch.py"
        spec = importlib.util.spec_from_file_location(name, path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        actions = module.generate_launch_description()
        values = {
            each.arguments[0]: each.default_value
            for each in actions
            if each.kind == "DeclareLaunchArgument"
        }
        assert set(given) <= set(values)
        values |= given
        for each in [each for each in actions if each.kind == "OpaqueFunction"]:
            actions += each.function(values)
        commands = [
            [part.perform(values) if isinstance(part, Configuration) else part for part in each.cmd]
            for each in actions
            if each.kind == "ExecuteProcess" and getattr(each, "condition", lambda _: True)(values)
        ]
        return commands, [each for each in actions if each.kind == "Node"]

    return launched


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("explore", {}, ["robot", "node"]),
        ("explore", {"simulated": "false", "view": "true"}, ["node"]),
        ("nav2", {}, ["controller"]),
        ("nav2", {"explore": "true"}, ["controller", "node"]),
        ("fleet", {"robots": "3"}, ["robot", "node"] * 3),
        ("fleet", {"simulated": "false"}, ["node", "node"]),
    ],
)
def test_what_is_launched_is_a_command_with_known_options(launched, name, given, expected) -> None:
    commands, nodes = launched(name, command="/opt/jaxplore", **given)
    assert [each[1] for each in commands] == expected
    for program, command, *arguments in commands:
        assert program == "/opt/jaxplore"
        # Parsing refuses what is not known.
        with click.Context(cli):
            parsed = cli.commands[command].make_context(command, list(arguments))
        if command == "robot":
            continue
        entries = read_settings(Path(parsed.params["settings_file"]))
        assign_all(entries, parsed.params["assignments"])
        mode = "controller" if command == "controller" else parsed.params["mode"]
        assign_all(entries, [f"node.mode={mode or 'control'}"])
        _, node = make_node_settings(entries)
        assert node.latency == 0.1
    assert bool(nodes) == (name == "nav2")
    for each in nodes:
        # The node that the manager looks for is that of the server.
        assert each.parameters[0]["node_names"] == [node.server.name]
    spaces = [each[each.index("--namespace") + 1] for each in commands if "--namespace" in each]
    robots = expected.count("node") if name == "fleet" else 0
    assert sorted(set(spaces)) == [f"robot{number + 1}" for number in range(robots)]


def test_the_package_has_the_version_of_the_program() -> None:
    for name, pattern in (("package.xml", "<version>(.*)<"), ("setup.py", 'version="(.*)"')):
        (found,) = re.findall(pattern, (PACKAGE / name).read_text())
        assert found == jaxplore.__version__
