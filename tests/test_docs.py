"""The pages list what there is."""

import ast
import importlib
import re
import runpy
from collections import Counter
from pathlib import Path

import jax
import jax.numpy as jnp

import jaxplore
from jaxplore.cli import _known

PAGE = Path(__file__).parents[1] / "docs" / "api.md"
DIRECTIVE = re.compile(
    r"^\.\. (currentmodule|autoclass|autofunction|automodule|py:data):: ([\w.]+)$", re.MULTILINE
)


def public_names(package: str) -> set[str]:
    """Return what a package gives out, or the flat names of a module."""
    file = Path(str(importlib.import_module(f"jaxplore.{package}").__file__))
    if file.name != "__init__.py":
        return set(jaxplore._PACKAGES[package])
    # Names that are imported when they are used stand under TYPE_CHECKING.
    tree = ast.walk(ast.parse(file.read_text()))
    imports = [node for node in tree if isinstance(node, ast.ImportFrom)]
    return {alias.name for node in imports for alias in node.names if alias.asname == alias.name}


def test_the_api_page_lists_every_public_name_once() -> None:
    listed: Counter[str] = Counter()
    module = ""
    for kind, name in DIRECTIVE.findall(PAGE.read_text(encoding="utf-8")):
        if kind == "currentmodule":
            module = name
        else:
            listed[name if name.startswith("jaxplore.") else f"{module}.{name}"] += 1
    packages = [*jaxplore._PACKAGES, "gym", "onboard", "view"]
    public = {f"jaxplore.{each}.{name}" for each in packages for name in public_names(each)}
    further = {"jaxplore.report.compute.Compute"}  # what a field of Metrics holds
    assert set(listed) == public | further
    assert max(listed.values()) == 1


def test_the_code_beside_the_names_of_the_design_notes_runs() -> None:
    """Each line of the tables, in the names that the section defines."""
    page = (PAGE.parent / "coming_from.md").read_text(encoding="utf-8")
    section = page.split("\n## The design notes\n")[1].split("\n## ")[0]
    names = {"jx": jaxplore, "jnp": jnp}
    exec(section.split("```python\n")[1].split("```")[0], names)
    lines = re.findall(r"^\| .* \| `([^`]*)` \|$", section, re.MULTILINE)
    lines = [line for line in lines if line.startswith(("jx.", "grid.", "lidar.", "10.", "2."))]
    assert len(lines) > 55
    for line in lines:
        assert eval(line, names) is not None, line
    # To compile the information of a scan takes as long as all of the others.
    traced = re.findall(r"`(information\([^`]*)`", section)
    assert len(traced) == 2
    for line in traced:
        assert jax.eval_shape(lambda line=line: eval(line, names)).ndim <= 1


def test_the_page_of_settings_is_up_to_date() -> None:
    script = PAGE.parent / "settings_page.py"
    written = runpy.run_path(str(script))
    is_current = written["PAGE"].read_text(encoding="utf-8") == written["page"]()
    assert is_current, "docs/settings.md is out of date: python docs/settings_page.py renews it"


def test_what_the_help_shows_of_settings_is_up_to_date() -> None:
    is_current = _known.FILE.read_text(encoding="utf-8") == _known.as_text(_known.from_settings())
    assert is_current, "cli/known.json is out of date: python docs/settings_page.py renews it"
