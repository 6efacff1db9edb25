"""Episodes of a comparison on maps: their settings and their ids."""

import dataclasses
import functools
import hashlib
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from jaxplore import _checks
from jaxplore._spelling import match_spelling
from jaxplore.settings.accepted_values import choices
from jaxplore.settings.code_names import is_own
from jaxplore.settings.sections import RunSettings
from jaxplore.study.comparison.maps import MapFile, kind_of_map
from jaxplore.study.seeds import check_number_of_runs, check_number_of_seeds
from jaxplore.tasks.exploration.settings import merge_entries
from jaxplore.tasks.kind import Kind
from jaxplore.tasks.registry import KINDS, default_kind, keep_read, without_unread
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
        path: path of the map's file, or the name of a generated one.
        content: hash of the map.
        explorer: name of the variant. It is the setting `architecture`, unless `settings` have one
            or there is no such setting.
        seed: the setting `seed`.
        settings: entries of all other settings, plain values for JSON. Without a `start` the robot
            begins where its kind of task says: on a ROS map at the position with the greatest
            clearance, heading along x.
        batch: number of runs of consecutive seeds that are computed together by `jax.vmap`: those
            with the same `seed // batch`. Rounding depends on it.
        code: hash of the user's modules that the settings name; empty if they name none.
        copy: path of the file on this machine; `path` when absent.
        selector: setting that names the map.
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
    selector: str = default_kind().selector

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
        if self.selector == default_kind().selector:
            del content["selector"]
        return hashlib.sha256(canonical(content).encode()).hexdigest()[:20]

    @property
    def entries(self) -> dict[str, Any]:
        """Entries of all settings."""
        own = {self.selector: self.copy or self.path, "seed": self.seed}
        named = {"architecture": self.explorer} if _architectures(self.kind) else {}
        return {**named, **self.settings, **own}

    @property
    def kind(self) -> Kind:
        """Kind of task."""
        return kind_of_map(self.selector)[0]

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
    *,
    asked: Entries | None = None,
) -> tuple[MapEpisode, ...]:
    """Make an episode for each map, variant and seed, in this order.

    Variants are architectures, or settings entries that differ, by name. Settings are the entries
    that all episodes share; see `common_settings`. An episode has those that its run reads. Those
    that were `asked` must be read by some run, all of them when absent; the others are defaults.

    Raises:
        ValueError: a batch < 1; no maps, variants or seeds, or one of them twice; maps of different
            kinds; an unknown architecture; settings that are not accepted or that no run reads;
            variants with different robots.
    """
    _checks.positive_int("batch", batch)
    check_number_of_seeds("seeds", seeds)
    check_number_of_runs(len(maps) * len(variants) * len(seeds))
    given: dict[str, list[Any]] = {
        "maps": [each.name for each in maps],
        "variants": list(variants),
        "seeds": list(seeds),
    }
    for name, values in given.items():
        if not values or len(set(values)) != len(values):
            raise ValueError(f"{name} is {values}; accepted: different ones, at least one")
    selectors = list(dict.fromkeys(each.selector for each in maps))
    if len(selectors) > 1:
        raise ValueError(f"maps are of the kinds {', '.join(selectors)}; accepted: one of them")
    kind, compared = kind_of_map(selectors[0])
    # The settings check the seeds; the least and the greatest stand for all.
    for seed in (min(seeds), max(seeds)):
        kind.make_settings({**next(iter(kind.places.values())), "seed": seed})
    everything, given_ones = (
        _runs(maps, variants, kind, common_settings(some, kind))
        for some in (settings, settings if asked is None else asked)
    )
    keep_read(given_ones)
    read = {name: without_unread(run) for name, run in everything.items()}
    # With what a variant does not read: its default there is no difference of robots.
    settings_of = {name: kind.make_settings(everything[name, maps[0].name]) for name, _ in read}
    _check_same_robot(settings_of, compared.shared)
    codes = {name: _code(each) for name, each in settings_of.items()}
    return tuple(
        MapEpisode(
            each.name,
            each.path,
            each.content,
            name,
            seed,
            {
                **_drop_own(read[name, each.name], name),
                **({} if each.start is None else {"start": list(each.start)}),
            },
            batch,
            codes[name],
            selector=each.selector,
        )
        for each in maps
        for name in settings_of
        for seed in seeds
    )


def _runs(
    maps: Sequence[MapFile],
    variants: Sequence[str] | Mapping[str, Entries],
    kind: Kind,
    common: Entries,
) -> dict[tuple[str, str], dict[str, Any]]:
    runs = {}
    for name, entries in variant_entries(variants, kind).items():
        # `common_settings` leaves out the architecture, which here belongs to the variant.
        shared = common_settings(merge_entries(dict(common), entries), kind)
        own = {"architecture": name} if _architectures(kind) else {}
        own |= {key: entries[key] for key in ("architecture",) if key in entries}
        for each in maps:
            runs[name, each.name] = {**shared, **own, kind.selector: each.path}
    return runs


def _drop_own(entries: Entries, variant: str) -> dict[str, Any]:
    """Return entries without the map, the seed, and an architecture by which a variant is named."""
    left = {"architecture"} if entries.get("architecture") == variant else set[str]()
    left |= {"seed"} | {kind.selector for kind in KINDS.values()}
    return {name: value for name, value in entries.items() if name not in left}


def _architectures(kind: Kind) -> tuple[str, ...]:
    """Return the architectures of a kind of task; none if it has no such setting."""
    has_some = "architecture" in kind.settings.model_fields
    return choices(kind.settings, "architecture") if has_some else ()


def variant_entries(
    variants: Sequence[str] | Mapping[str, Entries], kind: Kind
) -> dict[str, dict[str, Any]]:
    """Return the settings entries of each variant; empty for an architecture."""
    known = _architectures(kind)
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
            if known:
                entries["architecture"] = kind.settings.model_fields["architecture"].default
        found[name] = entries
    return found


def _code(settings: RunSettings) -> str:
    """Check what of the user's own settings name, and return the hash of its code."""
    architecture: Any = getattr(settings, "architecture", None)
    model: Any = getattr(getattr(settings, "robot", None), "model", None)
    if is_own(architecture):
        import_rule(architecture)
    if is_own(model):
        import_robot(model)
    return hash_user_code(settings)


def common_settings(settings: Mapping[str, Any], kind: Kind | None = None) -> dict[str, Any]:
    """Normalise the entries that all runs share: 900 and 900.0 are the same time limit.

    Map, architecture and seed belong to each run and are left out.
    """
    kind = default_kind() if kind is None else kind
    own = {kind.selector, "architecture", "seed"}
    shared = {name: value for name, value in settings.items() if name not in own}
    given = kind.make_settings({**shared, **next(iter(kind.places.values()))})
    return given.model_dump(mode="json", exclude_unset=True, exclude=own)


def _check_same_robot(settings: Mapping[str, RunSettings], sections: Sequence[str]) -> None:
    first, *others = settings
    for other in others:
        for section in sections:
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
