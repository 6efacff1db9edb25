"""Maps, worlds and paths far from the origin give the programs and numbers of those at it."""

import re

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxplore import OccupancyGrid
from jaxplore.maps import Datum, World, relative_world
from jaxplore.parts.registry import CAPABILITIES
from jaxplore.tasks.exploration.build import with_start
from jaxplore.tasks.registry import build, make_settings

UTM = (500_000.0, 4_649_776.0)
SMALL = {
    "fields": {"num_directions": 8},
    "lidar": {"num_beams": 36, "max_range": 2.0},
    "controller": {"num_samples": 16, "horizon": 5},
}


def check_equal(here, there, datum) -> None:
    """Check that two experiments are equal to the bit, but for where they are.

    The compiled programs read nothing else, so the runs are equal as well.
    """
    assert here.scenario.datum == Datum()
    assert there.scenario.datum == datum
    for one, other in ((here.scenario, there.scenario), (here.controller, there.controller)):
        leaves, structures = zip(*(jax.tree.flatten(each) for each in (one, other)), strict=True)
        # Equal structures share a compiled program.
        assert structures[0] == structures[1]
        assert hash(structures[0]) == hash(structures[1])
        for mine, theirs in zip(*leaves, strict=True):
            if eqx.is_array(mine):
                np.testing.assert_array_equal(mine, theirs)


@pytest.fixture
def ros_map(tmp_path):
    """Return what writes a room with a wall as a ROS map, and returns its path."""
    room = np.zeros((40, 52), np.float32)
    room[0], room[-1], room[:, 0], room[:, -1], room[:25, 25] = 1.0, 1.0, 1.0, 1.0, 1.0

    def write(name, origin, datum):
        OccupancyGrid(room, 0.1, origin).to_ros(tmp_path / name, datum=datum)
        return str(tmp_path / name)

    return write


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.5])
def test_the_experiment_on_a_map_far_away_is_that_at_the_origin(ros_map, yaw) -> None:
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    start, goal = np.round(turn @ [1.3, 1.2], 3), np.round(turn @ [4.1, 2.9], 3)
    found = [
        build(
            make_settings(
                {
                    "map": ros_map(f"{datum.x:.0f}.yaml", (0.0, 0.0, yaw), datum),
                    "start": (*datum.to_map(start).tolist(), yaw),
                    "goal": datum.to_map(goal).tolist(),
                    **SMALL,
                }
            )
        )
        for datum in (Datum(), Datum(*UTM))
    ]
    check_equal(*found, Datum(*UTM))


def test_a_start_that_is_chosen_or_proposed_is_that_of_the_map(ros_map) -> None:
    """At 1e9 m the place that was proposed was the wall that it was about."""
    for datum in (Datum(1e6, 1e6), Datum(1e9, -1e9)):
        entries = {"map": ros_map("map.yaml", (0.0, 0.0, 0.0), datum), **SMALL}
        x, y, _ = with_start(entries)["start"]
        assert 0.5 < x - datum.x < 4.7
        assert 0.5 < y - datum.y < 3.5
        assert build(make_settings({**entries, "start": (x, y, 0.0)})).scenario.datum == datum
        wall = (datum.x + 2.55, datum.y + 1.05, 0.0)
        with pytest.raises(ValueError, match="in a wall; accepted: free space") as error:
            build(make_settings({**entries, "start": wall}))
        told, place = re.findall(r"\(([-0-9.]+), ([-0-9.]+)\)", str(error.value))
        np.testing.assert_allclose(np.array(told, float), wall[:2], rtol=0, atol=2e-3)
        build(make_settings({**entries, "start": (*map(float, place), 0.0)}))
        outside = {**entries, "start": (0.0, 0.0, 0.0)}
        with pytest.raises(ValueError, match=rf"within x {datum.x:.3f} to {datum.x + 5.2:.3f}, y"):
            build(make_settings(outside))
        astray = {**entries, "goal": (datum.x + 2.55, datum.y + 1.05), "start": (x, y, 0.0)}
        with pytest.raises(ValueError, match=rf"goal is \[{datum.x + 2.55}.*a place in free"):
            build(make_settings(astray))


SECTIONS = {
    "variation": {},
    "faults": {"scan_dropout": [1.0, 2.0]},
    "people": {"number": 2},
    "watch": {},
    "anomalies": {},
    "keep_out": {"areas": [[[0.4, 0.4], [2.2, 0.4], [2.2, 3.6], [0.4, 3.6]]]},
    "detector": {"classes": ["box", "door"], "confusion": [[0.9, 0.1], [0.1, 0.9]]},
    "chassis": {},
    "battery": {},
    "localisation": {},
}


@pytest.mark.parametrize(
    "name",
    [row.name for row in CAPABILITIES if row.settings is not None and row.dimensions in (None, 2)],
)
def test_a_start_is_chosen_beside_every_capability(ros_map, name) -> None:
    """With the localisation it failed: its part was built from less than a run has."""
    entries = {"map": ros_map("map.yaml", (0.0, 0.0, 0.0), Datum()), **SMALL}
    entries[name] = SECTIONS[name]
    if name == "anomalies":
        entries["watch"] = {}
    given = with_start(entries)
    build(make_settings(given))
    x, y, _ = given["start"]
    if name == "keep_out":
        assert x > 2.2
    assert 0.3 < x < 4.9
    assert 0.3 < y < 3.7


def test_everything_in_a_world_is_moved(tmp_path) -> None:
    world = World.from_dict(
        {
            "size": [6.1, 5.3],
            "start": [1.3, 1.2, 0.4],
            "walls": [[0, 0, 6.1, 0], [3.05, 0, 3.05, 2.5]],
            "hidden": {"discs": [[4.1, 1.3, 0.2]]},
            "gone": {"rectangles": [[0.5, 4.1, 0.9, 4.7]]},
            "zones": [[3.5, 0.0, 6.1, 5.3]],
            "forbidden": [[1.0, 3.0, 2.0, 5.0]],
            "targets": [[5.3, 0.8]],
            "movers": [{"path": [[1.1, 4.4], [1.9, 4.6]], "speed": 0.3, "radius": 0.2}],
        }
    )
    found = []
    for datum in (Datum(), Datum(*UTM)):
        file = tmp_path / f"{datum.x:.0f}.yaml"
        relative_world(world, Datum(-datum.x, -datum.y)).to_yaml(file)
        own = {"map": str(file), "watch": {}, "anomalies": {}}
        found.append(build(make_settings({**own, **SMALL})))
    check_equal(*found, Datum(*UTM))


def test_a_path_far_away_is_that_at_the_origin(tmp_path) -> None:
    points = np.array([[0.0, 0.0], [4.5, 0.3], [8.2, 3.1], [12.4, 3.3]])
    found = []
    for datum in (Datum(), Datum(*UTM)):
        file = tmp_path / f"{datum.x:.0f}.csv"
        file.write_text("\n".join(f"{x:.6f}, {y:.6f}" for x, y in datum.to_map(points)))
        disc = [*datum.to_map([6.0, 3.5]).tolist(), 0.2]
        corners = datum.to_map(np.array([[9.0, 1.0], [9.5, 1.0], [9.2, 1.6]])).tolist()
        start = [*datum.to_map([0.1, 0.2]).tolist(), 0.05]
        entries = {"path": str(file), "half_width": 1.0, "start": start, "controller": {}}
        entries["obstacles"] = {"number": 1, "discs": [disc], "polygons": [corners]}
        entries["controller"] = {"num_samples": 16, "horizon": 5}
        found.append(build(make_settings(entries)))
    check_equal(*found, Datum(*UTM))
