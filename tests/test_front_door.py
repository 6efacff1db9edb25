"""What `import jaxplore` gives: few flat names, all others in packages, nothing slow."""

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import jaxplore

SOURCE = Path(jaxplore.__file__)
MOST_FLAT = 110
SLOW = "scipy matplotlib PIL rich pydantic click gymnasium optuna ray pyarrow optax evosax ribs"


def test_few_names_are_flat_and_all_are_there() -> None:
    assert len(jaxplore.__all__) == len(set(jaxplore.__all__)) <= MOST_FLAT
    for name in jaxplore.__all__:
        assert inspect.isclass(getattr(jaxplore, name)) or callable(getattr(jaxplore, name))
    assert set(jaxplore.__all__) | {"costs", "control", "study"} <= set(dir(jaxplore))


def test_type_checkers_see_what_python_gives() -> None:
    block = next(node for node in ast.parse(SOURCE.read_text()).body if isinstance(node, ast.If))
    seen = {}
    for statement in block.body:
        assert isinstance(statement, ast.ImportFrom)
        for alias in statement.names:
            assert alias.asname == alias.name
            seen[alias.name] = statement.module
    packages = {name for name, module in seen.items() if module == "jaxplore"}
    assert packages == set(jaxplore._PACKAGES)
    assert {name: module for name, module in seen.items() if name not in packages} == {
        name: f"jaxplore.{package}"
        for package, names in jaxplore._PACKAGES.items()
        for name in names
    }


def test_a_flat_name_is_that_of_its_package() -> None:
    for package, names in jaxplore._PACKAGES.items():
        module = importlib.import_module(f"jaxplore.{package}")
        assert getattr(jaxplore, package) is module
        for name in names:
            assert getattr(jaxplore, name) is getattr(module, name)


def run(code: str) -> None:
    command = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_importing_imports_no_other_package_and_a_controller_none_that_is_slow() -> None:
    run(
        "import sys\n"
        "before = {name.partition('.')[0] for name in sys.modules}\n"
        "import jaxplore\n"
        "after = {name.partition('.')[0] for name in sys.modules}\n"
        "added = after - before - set(sys.stdlib_module_names) - {'jaxplore'}\n"
        "assert not added, added\n"
        "assert set(jaxplore.__all__) <= set(dir(jaxplore))\n"
        "import jax, equinox\n"
        "before = {name.partition('.')[0] for name in sys.modules}\n"
        "jaxplore.MPPI, jaxplore.GoalCost, jaxplore.DifferentialDrive, jaxplore.path_through\n"
        "jaxplore.planning\n"
        "after = {name.partition('.')[0] for name in sys.modules}\n"
        f"slow = (after - before) & set({SLOW!r}.split())\n"
        "assert not slow, slow\n"
        "jaxplore.simulate\n"  # can draw frames, which are Pillow's
        "after = {name.partition('.')[0] for name in sys.modules}\n"
        f"slow = (after - before) & set({SLOW!r}.split()) - {{'PIL'}}\n"
        "assert not slow, slow\n"
    )


def test_a_name_that_there_never_was() -> None:
    with pytest.raises(AttributeError, match=r"^module 'jaxplore' has no attribute 'Teleporter'$"):
        jaxplore.Teleporter  # noqa: B018
