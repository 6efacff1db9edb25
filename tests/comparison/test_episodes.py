import dataclasses
import re
from pathlib import Path
from typing import Any

import pytest

from jaxplore.settings.architectures import ARCHITECTURES
from jaxplore.study.comparison.episodes import (
    MapEpisode,
    common_settings,
    make_batches,
    make_episodes,
)
from jaxplore.study.comparison.maps import MapFile, maps_in

TASK = MapEpisode("hall", "/a/hall.yaml", "c0ffee", "explorer", 3, {"time_limit": 9.0, "seed": 1})


def test_the_id_is_the_same_wherever_and_whenever_it_is_made() -> None:
    # Written down: results of former versions are found by it.
    assert TASK.id == "042ced009ff0b8b9e3b6"
    turned = dict(reversed(TASK.settings.items()))
    assert dataclasses.replace(TASK, path="/b", copy="/c", settings=turned).id == TASK.id


@pytest.mark.parametrize(
    "other",
    [
        {"map": "house"},
        {"content": "c0ffe"},
        {"explorer": "portfolio"},
        {"seed": 4},
        {"settings": {"time_limit": 8.0, "seed": 1}},
        {"settings": {}},
        {"batch": 2},
    ],
)
def test_the_id_tells_runs_apart(other: dict[str, Any]) -> None:
    assert dataclasses.replace(TASK, **other).id != TASK.id


def test_there_is_a_task_for_each_map_explorer_and_seed(
    maps: tuple[MapFile, ...], small: dict[str, Any]
) -> None:
    episodes = make_episodes(
        maps, ("portfolio", "explorer"), (5, 2), {**small, "seed": 9, "map": "x"}
    )
    assert [(each.map, each.explorer, each.seed) for each in episodes] == [
        (name, explorer, seed)
        for name in ("east", "west")
        for explorer in ("portfolio", "explorer")
        for seed in (5, 2)
    ]
    assert len({each.id for each in episodes}) == 8
    first, last = episodes[0], episodes[-1]
    # A portfolio does not read the settings of the explorer's controller.
    read = {name: value for name, value in small.items() if name != "controller"}
    assert first.settings == {**read, "start": [1.0, 1.5, 0.5]}
    assert last.settings == small
    own = {"map": maps[1].path, "architecture": "explorer", "seed": 2}
    assert last.entries == {**small, **own}
    assert dataclasses.replace(last, copy="/there").entries["map"] == "/there"


def test_one_setting_can_be_written_in_several_ways(maps: tuple[MapFile, ...]) -> None:
    written: tuple[dict[str, Any], ...] = (
        {"time_limit": 9, "goal": (1, 2)},
        {"goal": [1.0, 2.0], "time_limit": 9.0},
    )
    ids = [[each.id for each in make_episodes(maps, ("explorer",), (0,), some)] for some in written]
    assert ids[0] == ids[1]
    assert common_settings(written[0]) == {"time_limit": 9.0, "goal": [1.0, 2.0]}


KNOWN = ", ".join(ARCHITECTURES)


@pytest.mark.parametrize(
    ("explorers", "seeds", "settings", "reason"),
    [
        (("explorer", "wanderer"), (0,), {}, f"'wanderer'; accepted: {KNOWN}"),
        (("",), (0,), {}, "architecture is ''; accepted"),
        ((), (0,), {}, "variants is []; accepted: different ones"),
        (("explorer", "explorer"), (0,), {}, "variants is ['explorer', 'explorer']; accepted"),
        (("explorer",), (), {}, "seeds is []"),
        (("explorer",), (1, 1), {}, "seeds is [1, 1]"),
        (("explorer",), (0,), {"wings": 2}, "unknown setting wings"),
        (("explorer",), (0,), {"robot": {"radius": -1}}, "setting robot.radius is -1"),
        (
            ("explorer", "two-layer"),
            (0,),
            {},
            "variants explorer and two-layer differ in the settings robot; accepted",
        ),
    ],
)
def test_what_cannot_be_asked_is_named(
    maps: tuple[MapFile, ...],
    explorers: tuple[str, ...],
    seeds: tuple[int, ...],
    settings: dict[str, Any],
    reason: str,
) -> None:
    with pytest.raises(ValueError, match=re.escape(reason)):
        make_episodes(maps, explorers, seeds, settings)


def test_a_batch_is_of_consecutive_seeds(maps: tuple[MapFile, ...], small: dict[str, Any]) -> None:
    episodes = make_episodes(maps, ("portfolio", "explorer"), (7, 2, 3, 4, 0), small, 3)
    batches = make_batches(episodes)
    assert [[episode.seed for episode in batch] for batch in batches] == [[0, 2], [3, 4], [7]] * 4
    groups = [(batch[0].map, batch[0].explorer) for batch in batches[::3]]
    assert groups == sorted({(each.map, each.explorer) for each in episodes})
    assert {tuple(batch[0].seeds) for batch in batches} == {(0, 1, 2), (3, 4, 5), (6, 7, 8)}
    assert all(episode.seeds == batch[0].seeds for batch in batches for episode in batch)
    assert [
        len(batch) for batch in make_batches(make_episodes(maps, ("explorer",), (1, 0), small))
    ] == [*[1] * 4]
    with pytest.raises(ValueError, match="batch is 0; accepted: a whole number >= 1"):
        make_episodes(maps, ("explorer",), (0,), small, 0)


def test_no_maps_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"maps is \[\]"):
        make_episodes((), ("explorer",), (0,), {})


def test_a_map_that_moves_keeps_its_ids(
    maps: tuple[MapFile, ...],
    episodes: tuple[MapEpisode, ...],
    tmp_path: Path,
    small: dict[str, Any],
) -> None:
    (tmp_path / "maps").rename(tmp_path / "moved")
    again = make_episodes(maps_in(tmp_path / "moved"), ("explorer",), (0, 1), small)
    assert [each.id for each in again] == [each.id for each in episodes]
    assert again[0].path != episodes[0].path


def test_variants_are_settings_with_a_name(
    maps: tuple[MapFile, ...], small: dict[str, Any]
) -> None:
    variants = {"explorer": {}, "few": {"controller": {"num_samples": 8}}}
    plain, few = make_episodes(maps[:1], variants, (0,), small)
    (same,) = make_episodes(maps[:1], ("explorer",), (0,), small)
    assert plain == same
    assert few.explorer == "few"
    assert few.entries["architecture"] == "explorer"
    assert few.entries["controller"] == {"num_samples": 8, "horizon": 8}
    assert few.id != plain.id
    with pytest.raises(ValueError, match="variants explorer and wide differ in the settings robot"):
        make_episodes(maps, {"explorer": {}, "wide": {"robot": {"radius": 0.4}}}, (0,), small)


def test_an_episode_in_a_volume_is_another_kind_of_run() -> None:
    forest = MapFile("forest", "forest", "", selector="volume")
    settings = {"generated": {"seed": 2}, "lidar": {"rings": 4}}
    (episode,) = make_episodes((forest,), ("explorer",), (3,), settings)
    own = {"volume": "forest", "architecture": "explorer", "seed": 3}
    assert episode.entries == {**settings, **own}
    assert episode.id != dataclasses.replace(episode, selector="map").id
    track = MapFile("track", "track", "", selector="path")
    fast = make_episodes((track,), {"fast": {"laps": 2}}, (0,), {})[0]
    assert fast.entries == {"path": "track", "laps": 2, "seed": 0}
    with pytest.raises(ValueError, match="maps are of the kinds volume, path; accepted: one of"):
        make_episodes((forest, track), ("explorer",), (0,), {})


@pytest.mark.parametrize(
    ("variants", "settings", "reason"),
    [
        (("explorer",), {"portfolio": {"decomposition": "roles"}}, "which architecture explorer"),
        (("explorer",), {"office": {"seed": 1}}, "setting office.seed is 1, which map"),
        (
            {"a": {"informative": {"horizon": 9}}, "b": {"time_limit": 5.0}},
            {},
            "setting informative.horizon is 9",
        ),
    ],
)
def test_what_no_run_reads_is_refused(
    maps: tuple[MapFile, ...], variants: Any, settings: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(reason)):
        make_episodes(maps, variants, (0,), settings)
    # What one of the variants reads is left out of the others.
    both = make_episodes(maps[:1], ("explorer", "portfolio"), (0,), {"controller": {"horizon": 9}})
    assert ["controller" in each.settings for each in both] == [True, False]
