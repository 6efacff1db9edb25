"""Settings of the documentation: `make docs`."""

import re
from typing import Any

import jaxplore
from jaxplore import __version__

project = "jaxplore"
author = "The jaxplore authors"
copyright = author
version = release = __version__

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"jaxplore {version}"

myst_heading_anchors = 3

# Every build runs the notebooks: what they show depends on the library too. An error in one is an
# error of the build.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say shapes and units
napoleon_numpy_docstring = False
napoleon_use_rtype = False

_SECTION = re.compile(r"(Args|Returns|Yields|Raises):")
_LITERAL = re.compile(r"`([^`]+)`")
_MARKUP = re.compile(r"([\\*|]|(?<=\w)_(?!\w))")


def _to_rest(app: Any, what: str, name: str, obj: Any, options: object, lines: list[str]) -> None:
    """Turn a docstring, written to be read in the source, into reST.

    Indented formulas become literal blocks and `code` becomes a literal; what reST would take for
    markup elsewhere is escaped.
    """
    text = "\n".join(lines).strip("\n")
    if what == "property":
        text = text.replace(": ", ", ", 1)  # napoleon takes what is before a colon for the type
    paragraphs: list[str] = []
    in_section = False
    for paragraph in text.split("\n\n"):
        is_indented = paragraph.startswith("    ")
        in_section = bool(_SECTION.fullmatch(paragraph.split("\n")[0])) or (
            in_section and is_indented
        )
        if is_indented and not in_section:
            paragraphs.append("::\n\n" + paragraph)
        else:
            paragraphs.append(_inline(paragraph))
    also = [f"Flat: ``jaxplore.{obj.__name__}``.", ""] if _is_flat(name, obj) else []
    lines[:] = ["", *also, *"\n\n".join(paragraphs).split("\n"), ""]


def _is_flat(name: str, obj: Any) -> bool:
    """Say whether a documented object, not a member of one, is also a name of `jaxplore` itself."""
    flat = name.rpartition(".")[2]
    return flat in jaxplore.__all__ and getattr(jaxplore, flat) is obj


def _inline(text: str) -> str:
    pieces = _LITERAL.split(text)
    for index, piece in enumerate(pieces):
        pieces[index] = f"``{piece}``" if index % 2 else _MARKUP.sub(r"\\\1", piece)
    return "".join(pieces)


def _skip(app: Any, what: str, name: str, obj: object, skip: bool, options: object) -> bool:
    """Leave out the fields of a NamedTuple, whose class docstring describes them."""
    return skip or type(obj).__name__ == "_tuplegetter"


def setup(app: Any) -> None:
    """Connect the hooks; before napoleon, which reads the sections."""
    app.connect("autodoc-process-docstring", _to_rest, priority=400)
    app.connect("autodoc-skip-member", _skip)
