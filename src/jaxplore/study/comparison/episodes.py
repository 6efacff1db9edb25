"""Episodes of a comparison on maps: their settings and their ids."""

import dataclasses
import functools
import hashlib
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from jaxplore._spelling import match_spelling
from jaxplore.settings.architectures import ARCHITECTURES
from jaxplore.settings.code_names import is_own
from jaxplore.study.comparison.maps import MapFile
from jaxplore.study.seeds import check_number_of_runs, check_number_of_seeds
from jaxplore.tasks.exploration.settings import (
    OFFICE,
    Settings,
    make_exploration_settings,
    merge_entries,
)
from jaxplore.tasks.user_code import hash_user_code, import_robot, import_rule

FORMAT = 3
"""Version of the stored results. It is raised when former results are no longer comparable, also
when a default or an architecture has changed."""

Entries = Mapping[str, Any]
"""Settings as in a settings file."""


@dataclasses.dataclass(frozen=True)
class MapEpisode:
    """One run of a variant on a map with a seed.

    Args:
        map: name of the map.
        path: path of the map's YAML file.
        content: hash of the map.
        explorer: name of the variant: the setting `architecture`, unless `settings` have one.
        seed: the setting `seed`.
        settings: entries of all other settings, plain values for JSON. Without a `start` the robot
            begins at the position with the greatest clearance, heading along x.
        batch: number of runs of consecutive seeds that are computed together by `jax.vmap`: those
            with the same `seed // batch`. Rounding depends on it.
        code: hash of the user's modules that the settings name; empty if they name none.
        copy: path of the YAML file on this machine; `path` when absent.
        map_shape: rows and columns of the arrays of the map, which maps of similar size share;
            chosen for the map alone when absent.
    """

    map: str
    path: str
    content: str
    explorer: str
    seed: int
    settings: Entries
    batch: int = 1
    code: str = ""
    copy: str | None = None
    map_shape: tuple[int, int] | None = None

    @functools.cached_property
    def id(self) -> str:
        """Hash of all fields except the location and the shape of the map, 20 hexadecimal digits.

        So results stay valid if the folder of maps is moved, or maps are added to it.
        """
        content = {"format": FORMAT, **dataclasses.asdict(self)}
        del content["path"], content["copy"], content["map_shape"]
        if self.batch == 1:
            # A batch of 1 is left out of the hash: results of versions without batches stay valid.
            del content["batch"]
        if not self.code:
            del content["code"]
        return hashlib.sha256(canonical(content).encode()).hexdigest()[:20]

    @property
    def entries(self) -> dict[str, Any]:
        """Entries of all settings."""
        own = {"map": self.copy or self.path, "seed": self.seed}
        return {"architecture": self.explorer, **self.settings, **own}

    @property
    def seeds(self) -> range:
        """Seeds of its batch. All of them are run, even if fewer are missing: a run must not depend
        on which other runs are missing."""
        first = self.seed - self.seed % self.batch
        return range(first, first + self.batch)


EpisodeBatch = tuple[MapEpisode, ...]
"""Episodes that run together: same map, same variant and same `seeds`."""


def make_batches(episodes: Iterable[MapEpisode]) -> tuple[EpisodeBatch, ...]:
    """Group episodes into batches, sorted by map, variant and seed."""

    def together(each: MapEpisode) -> tuple[str, str, int]:
        return each.map, each.explorer, each.seeds.start

    in_order = sorted(episodes, key=lambda each: (each.map, each.explorer, each.seed))
    return tuple(tuple(each) for _, each in itertools.groupby(in_order, together))


def make_episodes(
    maps: Sequence[MapFile],
    variants: Sequence[str] | Mapping[str, Entries],
    seeds: Sequence[int],
    settings: Entries,
    batch: int = 1,
) -> tuple[MapEpisode, ...]:
    """Make an episode for each map, variant and seed, in this order.

    Variants are architectures, or settings entries that differ, by name. Settings are the entries
    that all episodes share; see `common_settings`.

    Raises:
        ValueError: a batch < 1; no maps, variants or seeds, or one of them twice; an unknown
            architecture; settings that are not accepted; variants with different robots.
    """
    if batch < 1:
        raise ValueError(f"batch is {batch}; accepted: a whole number >= 1")
    check_number_of_seeds("seeds", seeds)
    check_number_of_runs(len(maps) * len(variants) * len(seeds))
    kinds: dict[str, list[Any]] = {
        "maps": [each.name for each in maps],
        "variants": list(variants),
        "seeds": list(seeds),
    }
    for kind, values in kinds.items():
        if not values or len(set(values)) != len(values):
            raise ValueError(f"{kind} is {values}; accepted: different ones, at least one")
    common = common_settings(settings)
    own = {
        # `common_settings` leaves out the architecture, which here belongs to the variant.
        name: {**common_settings(merge_entries(common, entries)), **_architecture(entries)}
        for name, entries in variant_entries(variants).items()
    }
    # The settings check the seeds; the least and the greatest stand for all.
    for seed in (min(seeds), max(seeds)):
        make_exploration_settings({"map": OFFICE, "seed": seed})
    # The office stands in for the maps, which have no part in this check.
    settings_of = {
        name: make_exploration_settings({"architecture": name, **entries, "map": OFFICE})
        for name, entries in own.items()
    }
    _check_same_robot(settings_of)
    codes = {name: _code(each) for name, each in settings_of.items()}
    return tuple(
        MapEpisode(
            each.name,
            each.path,
            each.content,
            name,
            seed,
            {**own[name], **({} if each.start is None else {"start": list(each.start)})},
            batch,
            codes[name],
        )
        for each in maps
        for name in own
        for seed in seeds
    )


def variant_entries(
    variants: Sequence[str] | Mapping[str, Entries],
) -> dict[str, dict[str, Any]]:
    """Return the settings entries of each variant; empty for an architecture."""
    known = ARCHITECTURES
    found: dict[str, dict[str, Any]] = {}
    for given in variants:
        name = match_spelling(given, known)
        entries = {} if not isinstance(variants, Mapping) else dict(variants[given])
        # An architecture that repeats the name of its variant would change the id of its runs.
        if match_spelling(entries.get("architecture"), known) == name:
            del entries["architecture"]
        if name not in known and not is_own(name) and "architecture" not in entries:
            if not entries:
                raise ValueError(f"architecture is {name!r}; accepted: {', '.join(known)}")
            entries["architecture"] = Settings.model_fields["architecture"].default
        found[name] = entries
    return found


def _code(settings: Settings) -> str:
    """Check what of the user's own settings name, and return the hash of its code."""
    if is_own(settings.architecture):
        import_rule(settings.architecture)
    if is_own(settings.robot.model):
        import_robot(settings.robot.model)
    return hash_user_code(settings)


def _architecture(entries: Entries) -> dict[str, Any]:
    return {name: entries[name] for name in ("architecture",) if name in entries}


def common_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Normalise the entries that all runs share: 900 and 900.0 are the same time limit.

    Map, architecture and seed belong to each run and are left out.
    """
    shared = {name: value for name, value in settings.items() if name not in _OWN}
    given = make_exploration_settings({**shared, "map": OFFICE})
    return given.model_dump(mode="json", exclude_unset=True, exclude=set(_OWN))


_OWN = ("map", "architecture", "seed")
"""Settings that belong to each run."""
_ALIKE = ("robot", "lidar", "camera", "sensor_model", "rates")
"""Sections that all variants share, so that they are comparable."""


def _check_same_robot(settings: Mapping[str, Settings]) -> None:
    """Check that all variants have the same robot, sensors and rates."""
    first, *others = settings
    for other in others:
        for section in _ALIKE:
            if getattr(settings[first], section) != getattr(settings[other], section):
                raise ValueError(
                    f"variants {first} and {other} differ in the settings {section}; accepted: "
                    "variants that drive the same robot with the same sensor"
                )


def canonical(value: Any) -> str:
    """Format plain values as JSON; equal values give the same text."""
    try:
        return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"settings are no JSON: {error}; accepted: plain values") from None
