"""Names and defaults that the help and the completions of shells show.

Settings belong to modules that import JAX, which takes more than a second. So the help reads what
it shows of them from a file beside this module. `python docs/settings_page.py` writes that file
from the settings, and a test compares the two.
"""

import functools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

FILE = Path(__file__).with_name("known.json")
"""File with the names and defaults."""


class Known(NamedTuple):
    """What the help and the completions show of settings and pictures.

    `settings` has the dotted names of all settings. Those of exploration that have a default have
    that of ground robots and that of quadrotors. `words` has the accepted words of the settings
    that accept some. `places` are names that stand for a map, a scenario or a path. `baselines` are
    the rule-based explorers. `population`, `fps`, `film_scale` and the first of `figures` are
    defaults.
    """

    settings: dict[str, list[Any]]
    words: dict[str, list[str]]
    sections: list[str]
    places: list[str]
    baselines: list[str]
    optimizers: list[str]
    population: int
    fps: float
    film_scale: float
    figures: list[str]

    @property
    def names(self) -> tuple[str, ...]:
        """All names that `jaxplore settings` accepts, each once."""
        return tuple(dict.fromkeys((*self.places, *self.sections, *self.settings)))


@functools.cache
def load_known() -> Known:
    """Return what the file says, or what it would say where it is missing."""
    if not FILE.exists():
        return from_settings()
    return Known(**json.loads(FILE.read_text(encoding="utf-8")))


def from_settings() -> Known:
    """Return what the file must say, from the settings themselves."""
    from jaxplore.report.drawing.figure import FORMATS
    from jaxplore.report.drawing.film import FPS, SCALE
    from jaxplore.settings.architectures import BASELINES
    from jaxplore.settings.fleet import FLEET
    from jaxplore.study.tuning.optimizers import NAMES
    from jaxplore.study.tuning.search import POPULATION
    from jaxplore.tasks.exploration.settings import OFFICE, make_exploration_settings
    from jaxplore.tasks.reference import rows, section_names, setting_names
    from jaxplore.tasks.registry import places

    ground, flying = (
        dict(
            _flat(
                make_exploration_settings({"map": OFFICE, FLEET: {}, **kind}).model_dump(
                    mode="json"
                )
            )
        )
        for kind in ({}, {"architecture": "two-layer"})
    )
    words: dict[str, list[str]] = {}
    for row in rows():
        if row.choices:
            # Exploration and path following may accept different words for one name.
            words[row.name] = list(dict.fromkeys((*words.get(row.name, ()), *row.choices)))
    return Known(
        {each: [ground[each], flying[each]] if each in ground else [] for each in setting_names()},
        words,
        list(section_names()),
        list(places()),
        list(BASELINES),
        list(NAMES),
        POPULATION,
        FPS,
        SCALE,
        list(FORMATS),
    )


def as_text(found: Known) -> str:
    """Return the text of the file: a line for each name with a value of its own."""
    lines = []
    for name, value in found._asdict().items():
        inner = json.dumps(value)
        if isinstance(value, dict):
            items = (f"  {json.dumps(key)}: {json.dumps(each)}" for key, each in value.items())
            inner = "{\n" + ",\n".join(items) + "\n }"
        lines.append(f" {json.dumps(name)}: {inner}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _flat(entries: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield dotted names and values of settings."""
    for name, value in entries.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
