"""The API page lists what there is."""

import inspect
import re
from collections import Counter
from pathlib import Path

import jaxplore

PAGE = Path(__file__).parents[1] / "docs" / "api.md"
DIRECTIVE = re.compile(r"^\.\. (?:autoclass|autofunction|py:data):: (\w+)$", re.MULTILINE)


def test_the_api_page_lists_every_public_name_once() -> None:
    public = {
        name
        for name, value in vars(jaxplore).items()
        if not name.startswith("_") and not inspect.ismodule(value)
    }
    listed = Counter(DIRECTIVE.findall(PAGE.read_text(encoding="utf-8")))
    assert set(listed) == public
    assert max(listed.values()) == 1
