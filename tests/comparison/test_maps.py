from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from jaxplore.study.comparison.maps import MapFile, maps_in, with_starts
from jaxplore.tasks.registry import KINDS

WriteMap = Callable[..., Path]


def test_maps_are_found_in_a_folder_and_the_folders_in_it(
    tmp_path: Path, write_map: WriteMap
) -> None:
    write_map(tmp_path / "hall.yaml")
    write_map(tmp_path / "depot" / "depot_v2.yml")
    write_map(tmp_path / "house" / "map.yaml")
    write_map(tmp_path / "deep" / "deeper" / "lost.yaml")
    write_map(tmp_path / ".hidden" / "hidden.yaml")
    (tmp_path / "house" / "params.yaml").write_text("image: no resolution")
    (tmp_path / "broken.yaml").write_text("image: [")
    (tmp_path / "notes.txt").write_text("image: a\nresolution: 1")
    found = maps_in(tmp_path)
    assert [each.name for each in found] == ["depot_v2", "hall", "house"]
    assert [Path(each.path) for each in found] == [
        tmp_path / "depot" / "depot_v2.yml",
        tmp_path / "hall.yaml",
        tmp_path / "house" / "map.yaml",
    ]
    assert all(each.start is None for each in found)


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["map.yaml"], ["top"]),
        (["a/map.yaml", "b/map.yaml"], ["a", "b"]),
        (["a/x.yaml", "b/x.yaml", "b/y.yaml"], ["a", "b", "y"]),
        (["a/x.yaml", "b/x.yaml", "a.yaml"], ["a-x", "b", "top-a"]),
        (["a/x.yaml", "b/x.yaml", "a/y.yaml", "b/y.yaml"], ["a-x", "a-y", "b-x", "b-y"]),
    ],
)
def test_names_tell_maps_apart(
    tmp_path: Path, write_map: WriteMap, files: list[str], names: list[str]
) -> None:
    for file in files:
        write_map(tmp_path / "top" / file)
    assert [each.name for each in maps_in(tmp_path / "top")] == names


def test_two_endings_of_one_name_are_refused(tmp_path: Path, write_map: WriteMap) -> None:
    for ending in ("yaml", "yml"):
        write_map(tmp_path / f"hall.{ending}")
    with pytest.raises(ValueError, match=r"two maps have the name .*-hall: .*hall\.yaml.*accepted"):
        maps_in(tmp_path)


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no ROS map, neither do the folders in it; accept"):
        maps_in(tmp_path)
    with pytest.raises(ValueError, match=r"gone' cannot be read: No such file.*accepted: a folder"):
        maps_in(tmp_path / "gone")


def test_content_is_that_of_both_files(tmp_path: Path, write_map: WriteMap) -> None:
    def content() -> str:
        (one,) = maps_in(tmp_path)
        return one.content

    path = write_map(tmp_path / "hall.yaml")
    seen = [content()]
    write_map(tmp_path / "hall.yaml")
    assert content() == seen[0]
    write_map(tmp_path / "hall.yaml", 12)
    seen.append(content())
    write_map(path, negate=1)
    seen.append(content())
    path.with_suffix(".pgm").unlink()
    seen.append(content())
    assert len(set(seen)) == 4


def test_starts(maps: tuple[MapFile, ...], tmp_path: Path) -> None:
    assert {each.name: each.start for each in maps} == {"east": (1.0, 1.5, 0.5), "west": None}
    (tmp_path / "other.yaml").write_text("west: [2, 1, 0]")
    other = with_starts(maps, tmp_path / "other.yaml")
    assert {each.name: each.start for each in other} == {
        "east": (1.0, 1.5, 0.5),
        "west": (2.0, 1.0, 0.0),
    }


@pytest.mark.parametrize(
    ("starts", "reason"),
    [
        ({"north": [1, 1, 0]}, r"has a start on 'north'; accepted: the maps east, west"),
        ({"west": [1, 1]}, r"the start on west is \[1, 1\]; accepted: \[x, y, yaw\]"),
        ({"west": [1, 1, float("nan")]}, "nan"),
        ({"west": [1, True, 0]}, "True"),
        ({"west": "here"}, "'here'"),
        ([1], "accepted: a mapping"),
    ],
)
def test_starts_that_are_none_are_named(
    maps: tuple[MapFile, ...], tmp_path: Path, starts: object, reason: str
) -> None:
    (tmp_path / "other.yaml").write_text(yaml.safe_dump(starts))
    with pytest.raises(ValueError, match=reason):
        with_starts(maps, tmp_path / "other.yaml")


def test_volumes_and_paths_are_found_by_their_kind(tmp_path: Path, write_map: WriteMap) -> None:
    top = tmp_path / "places"
    (top / "inner").mkdir(parents=True)
    (top / "inner" / "hall.npy").write_bytes(b"one")
    (top / "round.csv").write_text("0,0\n1,1\n")
    (top / "starts.yaml").write_text("hall: [1, 2, 0.5, 0]")
    (hall,) = maps_in(top, KINDS["volume"])
    assert (hall.name, hall.selector, hall.start) == ("hall", "volume", (1.0, 2.0, 0.5, 0.0))
    # The first kind that has files there, in the order of the registry.
    (alone,) = maps_in(tmp_path / "places" / "round.csv")
    assert (alone.name, alone.selector) == ("round", "path")
    with pytest.raises(ValueError, match=r"has a start on 'hall'; accepted: the maps round"):
        maps_in(top)
    both = maps_in(f"office3d, {top}/inner,forest")
    assert [(each.name, each.path) for each in both] == [
        ("forest", "forest"),
        ("hall", str(top / "inner" / "hall.npy")),
        ("office3d", "office3d"),
    ]
    assert [bool(each.content) for each in both] == [False, True, False]
    write_map(top / "inner" / "plan.yaml")
    assert [each.name for each in maps_in(top / "inner")] == ["plan"]
    with pytest.raises(ValueError, match=r"'forest' is no ROS map; accepted: YAML files with an"):
        maps_in("forest", KINDS["exploration"])
    (top / "starts.yaml").write_text("hall: [1, 2, 0]")
    with pytest.raises(ValueError, match=r"hall is \[1, 2, 0\]; accepted: \[x, y, z, yaw\]"):
        maps_in(top, KINDS["volume"])
