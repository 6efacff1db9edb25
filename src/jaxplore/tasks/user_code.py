"""Robots, rules and controllers of the user's own, which settings name as MODULE:NAME."""

import hashlib
import importlib
import inspect
import os
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from jaxplore._kinds import describe
from jaxplore.control.base import Controller
from jaxplore.dynamics.base import Dynamics
from jaxplore.planning.strategy.target_rules import TargetRule
from jaxplore.settings.code_names import is_own
from jaxplore.settings.sections import RunSettings
from jaxplore.simulation.scenario import Scenario

_RULE = "a TargetRule, a class or an instance, or a function from a scenario to a controller"
_ROBOT = "a Dynamics, a class or an instance"


def import_robot(name: str) -> Dynamics:
    """Return the robot that the setting `robot.model` names.

    `name` is MODULE:NAME of a `jaxplore.Dynamics`, a class or an instance.
    """
    found = _instantiate("robot.model", name, Dynamics)
    if not isinstance(found, Dynamics):
        raise ValueError(f"robot.model is {name}, {describe(found)}; accepted: {_ROBOT}")
    return found


def import_rule(name: str) -> TargetRule | None:
    """Return the rule that the setting `architecture` names; None if it names a function.

    `name` is MODULE:NAME of a function or of a `jaxplore.planning.TargetRule`, class or instance.
    """
    found = _instantiate("architecture", name, TargetRule)
    if isinstance(found, TargetRule):
        return found
    if isinstance(found, type) or not callable(found) or isinstance(found, Controller):
        raise ValueError(f"architecture is {name}, {describe(found)}; accepted: {_RULE}")
    return None


def import_controller(name: str, scenario: Scenario) -> Controller:
    """Return the controller that the function makes which the setting `architecture` names.

    A function that fails, or that returns something else, raises a ValueError.
    """
    controller = _call("architecture", name, _find("architecture", name), scenario)
    if not isinstance(controller, Controller):
        raise ValueError(
            f"architecture is {name}, which returned {describe(controller)}; accepted: {_RULE}"
        )
    return controller


def hash_user_code(settings: RunSettings) -> str:
    """Return a hash of the files of the modules that settings name; empty if they name none."""
    values: dict[str, Any] = {
        "architecture": getattr(settings, "architecture", None),
        "robot.model": getattr(getattr(settings, "robot", None), "model", None),
    }
    whole = hashlib.sha256()
    for setting, value in values.items():
        if is_own(value):
            file = _module(setting, value).__file__
            whole.update(value.encode() + (b"" if file is None else Path(file).read_bytes()))
    return whole.hexdigest()[:20] if any(map(is_own, values.values())) else ""


def _instantiate(setting: str, name: str, kind: type) -> Any:
    """Return what a name names; of a class of a kind, an instance."""
    found = _find(setting, name)
    if not isinstance(found, type) or not issubclass(found, kind):
        return found
    try:
        inspect.signature(found).bind()
    except TypeError as error:
        raise ValueError(
            f"{setting} is {name}, whose constructor needs arguments ({error}); accepted: defaults "
            f"for them, or an instance in the module, such as mine = {found.__name__}(...)"
        ) from error
    return _call(setting, name, found)


def _call(setting: str, name: str, function: Any, *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except Exception as error:
        raise ValueError(f"{setting} is {name}, which fails: {_reason(error)}") from error


def _find(setting: str, name: str) -> Any:
    module, own = _module(setting, name), name.partition(":")[2]
    if not hasattr(module, own):
        there = [
            each
            for each, value in vars(module).items()
            if not each.startswith("_") and not isinstance(value, ModuleType)
        ]
        raise ValueError(
            f"{setting} is {name}, but {module.__file__} has no {own}; accepted: a name in it, "
            f"such as {', '.join(there[-5:]) or 'one that you define'}"
        )
    return getattr(module, own)


def _module(setting: str, name: str) -> ModuleType:
    # A program like `jaxplore` has the folder of the program on its path and not the current one.
    # Last, so that no file of the user's takes the place of an installed module. Processes of this
    # one get the same path.
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    module = name.partition(":")[0]
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise ValueError(f"{setting} is {name}: {_reason(error)}") from error
        raise ValueError(
            f"{setting} is {name}, but there is no module {error.name}; accepted: a module in the "
            "current folder or on the Python path"
        ) from error
    except Exception as error:
        raise ValueError(f"{setting} is {name}, whose module fails: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Return an error of the user's code with its place, in one line."""
    if isinstance(error, SyntaxError):
        text, file, line = error.msg, error.filename, error.lineno
    else:
        last = traceback.extract_tb(error.__traceback__)[-1]
        text, file, line = str(error), last.filename, last.lineno
    return f"{type(error).__name__}: {text} ({file}, line {line})"
