import dataclasses
import functools
import math

import numpy as np
import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import ndimage
from tests.maps.refusals import refused

from jaxplore import _files
from jaxplore.belief.zones import Zones
from jaxplore.maps.world import LabelledObject, MovingObstacle, Shapes, World, three_zones

FREE, UNKNOWN, SOLID = np.float32([0.01, 0.5, 0.99])

ENTRIES = {
    "origin": [-1, 0.5],
    "size": [4.0, 3.0],
    "resolution": 0.25,
    "wall_reach": 0.2,
    "walls": [[0.5, 1.0, 2.5, 1.0]],
    "rectangles": [[1.0, 2.0, 1.5, 2.5]],
    "discs": [[2.0, 2.5, 0.4]],
    "zones": [[0.0, 0.5, 1.0, 3.5]],
    "hidden": {"walls": [[2.0, 0.5, 3.0, 1.5]], "discs": [[0.0, 3.0, 0.3]]},
    "start": [-0.5, 2.0, 1.5],
    "goal": [2.8, 3.2],
}

EXTRAS = {
    "hills": [[1, 2, 0.5, 1.0], [4.0, 4.0, -0.25, 1.5]],
    "targets": [[-0.5, 3.0], [2.8, 3.2]],
    "objects": [{"position": [-0.5, 3.0], "label": "door"}],
    "movers": [
        {"path": [[-0.7, 0.8], [-0.7, 1.8], [-0.2, 1.8]], "speed": 0, "radius": 0.2},
        {"path": [[2.7, 2.2]], "speed": 1.5, "radius": 0.1},
    ],
}


def centre(row, column):
    return -1 + 0.25 * (column + 0.5), 0.5 + 0.25 * (row + 0.5)


def is_wall(x, y):
    return math.dist((x, y), (min(max(x, 0.5), 2.5), 1.0)) <= 0.2


def is_known(x, y):
    is_in_rectangle = 1.0 <= x < 1.5 and 2.0 <= y < 2.5
    return is_wall(x, y) or is_in_rectangle or math.dist((x, y), (2.0, 2.5)) <= 0.4


def is_hidden(x, y):
    along = min(max((x - 2.0 + y - 0.5) / 2, 0.0), 1.0)  # of (2, 0.5) + along (1, 1)
    nearest = (2.0 + along, 0.5 + along)
    return math.dist((x, y), nearest) <= 0.2 or math.dist((x, y), (0.0, 3.0)) <= 0.3


def test_two_maps_of_one_world():
    world = World.from_dict(ENTRIES)
    truth, prior = world.truth(), world.prior()
    counts = {"wall over zone": 0, "hidden": 0}
    for row in range(12):
        for column in range(16):
            x, y = centre(row, column)
            known, hidden, zone = is_known(x, y), is_hidden(x, y), 0.0 <= x < 1.0
            assert values(truth)[row, column] == (SOLID if known or hidden else FREE)
            expected = SOLID if known else UNKNOWN if zone else FREE
            assert values(prior)[row, column] == expected
            counts["wall over zone"] += is_wall(x, y) and zone
            counts["hidden"] += hidden and not known
    assert min(counts.values()) > 0
    assert truth.shape == prior.shape == world.shape == (12, 16)
    for grid in (truth, prior):
        assert grid.resolution == 0.25
        np.testing.assert_array_equal(grid.frame.origin, [-1.0, 0.5, 0.0])


# Everything solid lies at x > 1.2, so that the start at (0.5, 2) is always free.
X = st.floats(1.5, 6.0)
Y = st.floats(0.0, 4.0)


@st.composite
def shapes(draw):
    walls = draw(st.lists(st.tuples(X, Y, X, Y), max_size=3))
    rectangles = draw(st.lists(st.tuples(X, Y, X, Y), max_size=2))
    discs = draw(st.lists(st.tuples(st.floats(2.5, 5.9), st.floats(0, 3.9), st.floats(0.1, 1.0))))
    assume(all(wall[:2] != wall[2:] for wall in walls))
    boxes = [
        (min(a, c) - 0.2, min(b, d) - 0.2, max(a, c) + 0.2, max(b, d) + 0.2)
        for a, b, c, d in rectangles
    ]
    return {"walls": walls, "rectangles": boxes, "discs": discs[:3]}


@st.composite
def worlds(draw):
    zones = [
        (x, y, x + 0.5 + draw(st.floats(0, 1.5)), y + 0.5 + draw(st.floats(0, 1.5)))
        for x, y in draw(st.lists(st.tuples(st.floats(0, 4), st.floats(0, 2)), max_size=3))
    ]
    return {
        "size": (6.0, 4.0),
        "start": (0.5, 2.0, draw(st.floats(-4, 4))),
        "goal": draw(st.sampled_from([None, (0.2, 0.3), (0.7, 3.5, -2.0)])),
        "resolution": draw(st.sampled_from([0.25, 0.4, 0.3])),
        **draw(shapes()),
        "zones": zones,
        "hidden": draw(shapes()),
    }


def values(grid):
    return np.asarray(grid.probability)


@settings(max_examples=15)
@given(worlds())
def test_what_is_hidden_is_in_the_true_world_only(entries):
    world = World.from_dict(entries)
    bare = dataclasses.replace(world, hidden=Shapes())
    np.testing.assert_array_equal(values(world.prior()), values(bare.prior()))
    revealed = dataclasses.replace(world, known=world.hidden, hidden=Shapes())
    both = np.maximum(values(bare.truth()), values(revealed.truth()))
    np.testing.assert_array_equal(values(world.truth()), both)


@settings(max_examples=15)
@given(worlds())
def test_prior_and_truth_agree_outside_zones_and_hidden_things(entries):
    world = World.from_dict(entries)
    truth, prior = values(world.truth()), values(world.prior())
    zones = values(dataclasses.replace(world, known=Shapes(), hidden=Shapes()).prior()) == UNKNOWN
    hidden = values(dataclasses.replace(world, known=Shapes()).truth()) == SOLID
    assert (truth == prior)[~zones & ~hidden].all()
    assert set(np.unique(truth)) <= {FREE, SOLID}
    # Painted last: nothing lies over a wall.
    known = values(dataclasses.replace(world, hidden=Shapes()).truth()) == SOLID
    np.testing.assert_array_equal(prior == SOLID, known)
    np.testing.assert_array_equal(prior == UNKNOWN, zones & ~known)


@settings(max_examples=15)
@given(worlds())
def test_every_solid_thing_is_there(entries):
    world = World.from_dict(entries)
    for kind in ("walls", "rectangles", "discs"):
        for row in getattr(world.hidden, kind):
            alone = dataclasses.replace(world, known=Shapes(), hidden=Shapes(**{kind: (row,)}))
            found = values(alone.truth()) == SOLID
            assert found.any()
            assert (values(world.truth())[found] == SOLID).all()


@settings(max_examples=15)
@given(worlds())
def test_dictionary_round_trip(entries):
    world = World.from_dict(entries)
    assert World.from_dict(yaml.safe_load(yaml.safe_dump(world.to_dict()))) == world


@settings(max_examples=15)
@given(st.integers(-4000, 4000), st.integers(-4000, 4000))
def test_a_world_elsewhere_is_the_same(right, up):
    # In steps of half a cell: the centres lie on edges and at exactly the reach from walls.
    def moved(x, y):
        def by(*row):
            return tuple(n + (x, y)[axis % 2] for axis, n in enumerate(row))

        return World(
            origin=by(0.05, 0.0),
            size=(3.0, 2.0),
            start=(*by(0.4, 0.4), 0.0),
            known=Shapes(
                walls=(by(1.0, 0.75, 2.0, 0.75),),
                rectangles=(by(0.7, 1.05, 1.2, 1.65),),
                discs=((*by(2.5, 1.25), 0.5),),
            ),
            zones=(by(1.6, 1.15, 2.9, 1.85),),
        )

    here, there = moved(0.0, 0.0), moved(right * 0.05, up * 0.05)
    np.testing.assert_array_equal(values(there.prior()), values(here.prior()))
    assert np.count_nonzero(values(here.prior()) == SOLID) == 63 + 30 + 81


def test_the_last_cells_reach_beyond_a_size_that_is_no_whole_number_of_cells():
    assert World(size=(1.0, 0.71), start=(0.0, 0.0, 0.0), resolution=0.1).shape == (8, 10)
    assert World(size=(0.3, 0.05), start=(0.0, 0.0, 0.0), resolution=0.1).shape == (1, 3)
    # 2.1 / 0.3 is 7.000000000000001.
    assert World(size=(2.1, 2.7), start=(0.0, 0.0, 0.0), resolution=0.3).shape == (9, 7)


def test_only_walls_need_the_reach_of_a_wall():
    coarse = {"size": [4, 4], "start": [0.2, 0.2, 0], "resolution": 0.5, "discs": [[2, 2, 1]]}
    assert World.from_dict(coarse).wall_reach == 0.2
    walls = {"walls": [[1, 2, 3, 2]]}
    for entries in ({**coarse, **walls}, {**coarse, "hidden": walls}):
        named = "wall_reach is 0.2; accepted: at least 0.25"
        refused(functools.partial(World.from_dict, entries), named)
        World.from_dict({**entries, "wall_reach": 0.25})


def test_yaml_round_trip(tmp_path):
    for world in (three_zones(), World.from_dict(ENTRIES)):
        world.to_yaml(tmp_path / "world.yaml")
        assert World.from_yaml(tmp_path / "world.yaml") == world
        assert [p.name for p in tmp_path.iterdir()] == ["world.yaml"]


def test_what_a_file_leaves_out_has_defaults(tmp_path):
    (tmp_path / "w.yaml").write_text("size: [2, 1]\nstart: [0.5, 0.5, 0]\ngoal:\n")
    world = World.from_yaml(tmp_path / "w.yaml")
    assert world == World(
        size=(2.0, 1.0),
        start=(0.5, 0.5, 0.0),
        goal=None,
        origin=(0.0, 0.0),
        resolution=0.1,
        wall_reach=0.2,
        known=Shapes(),
        zones=(),
        hidden=Shapes(),
    )
    assert (values(world.truth()) == FREE).all()
    assert (values(world.prior()) == FREE).all()


def test_lists_and_whole_numbers_become_tuples_of_floats():
    world = World.from_dict({**ENTRIES, "size": [4, 3]})
    assert world.size == (4.0, 3.0)
    assert all(type(number) is float for number in world.size + world.origin + world.start)
    assert world.known.walls == ((0.5, 1.0, 2.5, 1.0),)
    assert hash(world) == hash(World.from_dict(ENTRIES))


def test_hills_targets_and_movers_are_written_and_read(tmp_path):
    world = World.from_dict({**ENTRIES, **EXTRAS})
    assert world.hills == ((1.0, 2.0, 0.5, 1.0), (4.0, 4.0, -0.25, 1.5))
    assert world.targets == ((-0.5, 3.0), (2.8, 3.2))
    assert world.movers == (
        MovingObstacle(path=((-0.7, 0.8), (-0.7, 1.8), (-0.2, 1.8)), speed=0.0, radius=0.2),
        MovingObstacle(path=((2.7, 2.2),), speed=1.5, radius=0.1),
    )
    assert type(world.movers[0].speed) is float
    assert world.objects == (LabelledObject((-0.5, 3.0), "door"),)
    assert dataclasses.replace(world, targets=()) != world
    assert hash(dataclasses.replace(world)) == hash(world)
    world.to_yaml(tmp_path / "world.yaml")
    assert World.from_yaml(tmp_path / "world.yaml") == world
    assert World.from_dict(world.to_dict()) == world
    for name in EXTRAS:
        partial = {**ENTRIES, name: EXTRAS[name]}
        assert World.from_dict(partial).to_dict().keys() - World.from_dict(ENTRIES).to_dict() == {
            name
        }
        assert yaml.safe_load((tmp_path / "world.yaml").read_text())[name] == EXTRAS[name]


def test_the_maps_of_a_world_do_not_have_its_hills_targets_and_movers():
    world, bare = World.from_dict({**ENTRIES, **EXTRAS}), World.from_dict(ENTRIES)
    np.testing.assert_array_equal(values(world.truth()), values(bare.truth()))
    np.testing.assert_array_equal(values(world.prior()), values(bare.prior()))


def test_the_ground_of_a_world():
    world = World.from_dict({**ENTRIES, **EXTRAS})
    ground = world.ground(max_slope=0.8, threshold=0.2)
    assert ground.shape == world.shape
    assert ground.resolution == 0.25
    np.testing.assert_array_equal(ground.frame.origin, [-1.0, 0.5, 0.0])
    assert float(ground.threshold) == np.float32(0.2)
    assert float(ground.max_slope) == np.float32(0.8)
    for row in range(12):
        for column in range(16):
            expected = 0.0
            for *top, height, radius in world.hills:
                away = math.dist(centre(row, column), top)
                if away < radius:
                    expected += height * math.cos(math.pi * away / (2 * radius)) ** 2
            assert float(ground.elevation[row, column]) == pytest.approx(expected, abs=1e-7)
    assert float(ground.elevation.min()) < 0.0 < float(ground.elevation.max())
    assert World.from_dict(ENTRIES).ground() is None
    refused(lambda: world.ground(max_slope=0.0), "max_slope is 0.0", "accepted")


# The disc's distance from solid squares, by sampling its way much denser than a cell.
@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.floats(0, 2.999), st.floats(0, 1.999)), min_size=1, max_size=4),
    st.floats(0.01, 0.8),
    st.lists(st.tuples(st.integers(0, 19), st.integers(0, 29)), max_size=4),
)
def test_a_mover_touches_nothing_solid_anywhere_on_its_way(path, radius, cells):
    boxes = [
        [column * 0.1 + 0.01, row * 0.1 + 0.01, column * 0.1 + 0.09, row * 0.1 + 0.09]
        for row, column in cells
    ]
    entries = {"size": [3, 2], "start": [0, 0, 0], "rectangles": boxes}
    assume((0, 0) not in cells)
    world = World.from_dict(entries)
    gap = math.inf
    low = np.array([[column, row] for row, column in cells]).reshape(-1, 2) * 0.1
    share = np.linspace(0, 1, 501)[:, None]
    for a, b in zip(np.array(path), np.roll(np.array(path), -1, axis=0), strict=True):
        way = (a + share * (b - a))[:, None]
        outside = np.maximum(np.maximum(low - way, way - low - 0.1), 0.0)
        gap = min([gap, *np.hypot(*np.moveaxis(outside, -1, 0)).ravel().tolist()])
    assume(abs(gap - radius) > 0.005)  # the samples are at most 0.0073 m apart
    mover = MovingObstacle(tuple(path), 1.0, radius)
    if gap > radius:
        assert dataclasses.replace(world, movers=(mover,)).movers == (mover,)
    else:
        refused(
            lambda: dataclasses.replace(world, movers=(mover,)),
            "movers[0].path[",
            "something solid",
        )


def test_a_mover_may_reach_beyond_the_map_and_may_not_graze_a_wall():
    world = World(
        size=(3.0, 2.0),
        start=(0.0, 0.0, 0.0),
        known=Shapes(rectangles=((1.0, 1.0, 1.5, 1.5),)),
    )
    beyond = MovingObstacle(((0.1, 0.1), (2.9, 0.1)), 1.0, 0.4)
    grazing = MovingObstacle(((0.1, 0.5), (2.9, 0.5)), 1.0, 0.5)
    assert dataclasses.replace(world, movers=(beyond,)).movers == (beyond,)
    refused(lambda: dataclasses.replace(world, movers=(grazing,)), "the disc touches")
    near = dataclasses.replace(grazing, radius=0.499)
    assert dataclasses.replace(world, movers=(near,)).movers == (near,)


def test_a_mover_alone_is_checked():
    refused(lambda: MovingObstacle((), 1.0, 1.0), "path is ()", "accepted")
    refused(lambda: MovingObstacle(((0.0, 0.0), (0.0, NAN)), 1.0, 1.0), "path[1] is", "accepted")


@pytest.mark.parametrize("failing", ["rename", "folder"])
def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch, failing):
    path = tmp_path / "world.yaml"
    path.write_text("earlier") if failing == "rename" else path.mkdir()

    def denied(*args):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(_files.os, "replace", denied)
    with pytest.raises(OSError):  # noqa: PT011
        three_zones().to_yaml(path)
    assert list(tmp_path.iterdir()) == [path]
    assert path.is_dir() if failing == "folder" else path.read_text() == "earlier"


def test_a_world_that_could_not_be_read_back_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(_files, "YAML_LIMIT", 400)
    refused(lambda: three_zones().to_yaml(tmp_path / "w.yaml"), "accepted: at most 400")
    assert not list(tmp_path.iterdir())


def cell(place):
    """Return the cell of three_zones that holds a place."""
    return math.floor((place[1] + 1) * 10 + 1e-6), math.floor((place[0] + 1) * 10 + 1e-6)


def test_three_zones():
    world = three_zones()
    truth, prior = world.truth(), world.prior()
    assert truth.shape == (120, 140)
    assert truth.resolution == 0.1
    np.testing.assert_array_equal(truth.frame.origin, [-1.0, -1.0, 0.0])
    for place, real, believed in (
        ((2.0, 2.0), SOLID, SOLID),
        ((2.0, 2.25), FREE, FREE),
        ((2.0, 6.0), FREE, UNKNOWN),
        ((12.0, 6.0), SOLID, SOLID),  # a wall in a zone
        ((6.0, 5.0), FREE, FREE),
    ):
        assert values(truth)[cell(place)] == real
        assert values(prior)[cell(place)] == believed
    # Four rows of 4 m, and at each end a column of four cells and one of two.
    alone = dataclasses.replace(world, known=Shapes(walls=((0.0, 2.0, 4.0, 2.0),)), zones=())
    assert np.count_nonzero(values(alone.truth()) == SOLID) == 4 * 40 + 2 * (4 + 2)
    member = Zones.from_rectangles(world.zones, prior).member
    is_wall = values(truth) == SOLID
    np.testing.assert_array_equal(
        values(prior) == UNKNOWN, np.asarray(member.any(axis=0)) & ~is_wall
    )
    assert member.sum(axis=(1, 2)).tolist() == [30 * 40, 30 * 40, 30 * 20]


def test_the_start_of_three_zones_has_room_and_leads_to_all_of_it():
    world = three_zones()
    start = cell(world.start)
    assert values(world.prior())[start] == FREE
    free = values(world.truth()) == FREE
    # From the centre of a cell to the nearest corner of a solid one, at least.
    room = (ndimage.distance_transform_edt(free) - math.sqrt(2)) * 0.1
    assert room[start] >= 0.5
    places = ndimage.label(room >= 0.3)[0]
    home = places[start]
    assert home > 0
    assert places[cell(world.goal)] == home
    for x_min, y_min, x_max, y_max in world.zones:
        (bottom, left), (top, right) = cell((x_min, y_min)), cell((x_max, y_max))
        assert (places[bottom:top, left:right] == home).any()


NAN = math.nan
REFUSED = [
    ({"origin": [0.0]}, "origin is [0.0]"),
    ({"origin": [0.0, "0"]}, "origin is [0.0, '0']"),
    ({"origin": 3}, "origin is 3"),
    ({"size": [4.0, 3.0, 1.0]}, "size is [4.0, 3.0, 1.0]"),
    ({"size": [4.0, 0.0]}, "size is [4.0, 0.0]"),
    ({"size": [-4.0, 3.0]}, "size is [-4.0, 3.0]"),
    ({"size": [True, 3.0]}, "size is [True, 3.0]"),
    ({"size": [4.0, math.inf]}, "size is [4.0, inf]"),
    ({"resolution": 0}, "resolution is 0"),
    ({"resolution": -0.1}, "resolution is -0.1"),
    ({"resolution": True}, "resolution is True"),
    ({"resolution": "0.1"}, "resolution is '0.1'"),
    ({"resolution": None}, "resolution is None"),
    ({"resolution": 10**5000}, "resolution is"),
    ({"resolution": 1e-4}, "at most 64000000 cells"),
    ({"resolution": 1e-300}, "at most 64000000 cells"),
    ({"size": [1e38, 1e38]}, "at most 64000000 cells"),
    ({"wall_reach": 0.0}, "wall_reach is 0.0"),
    ({"wall_reach": 0.12}, "wall_reach is 0.12; accepted: at least 0.125"),
    ({"wall_reach": "thick"}, "wall_reach is 'thick'"),
    ({"walls": [[0, 1, 2, 1], [0, 1, 0, 1]]}, "walls[1] is [0.0, 1.0, 0.0, 1.0]"),
    ({"walls": [[0, 1, 2]]}, "walls[0] is [0, 1, 2]"),
    ({"walls": [[0, 1, 2, NAN]]}, "walls[0] is [0, 1, 2, nan]"),
    ({"walls": [[0, 1, 2, False]]}, "walls[0] is [0, 1, 2, False]"),
    ({"walls": [3]}, "walls[0] is 3"),
    ({"walls": None}, "walls is None; accepted: a list of 4 finite numbers"),
    ({"walls": {"a": 1}}, "walls is {'a': 1}"),
    ({"walls": [[5.0, 5.0, 6.0, 5.0]]}, "walls[0] is [5.0, 5.0, 6.0, 5.0], off the map"),
    ({"rectangles": [[1, 1, 1, 2]]}, "rectangles[0] is [1.0, 1.0, 1.0, 2.0]"),
    ({"rectangles": [[1, 2, 2, 1]]}, "rectangles[0] is [1.0, 2.0, 2.0, 1.0]"),
    ({"rectangles": [["a", 1, 2, 2]]}, "rectangles[0] is ['a', 1, 2, 2]"),
    ({"rectangles": [[3.0, 1, 9, 2]]}, "rectangles[0] is [3.0, 1.0, 9.0, 2.0], off the map"),
    ({"discs": [[1, 1, 0]]}, "discs[0] is [1.0, 1.0, 0.0]"),
    ({"discs": [[1, 1, -1]]}, "discs[0] is [1.0, 1.0, -1.0]"),
    ({"discs": [[1, 1]]}, "discs[0] is [1, 1]"),
    ({"discs": [[1, 1, 0.1], [-2, 1, 0.9]]}, "discs[1] is [-2.0, 1.0, 0.9], off the map"),
    ({"zones": [[2, 1, 1, 2]]}, "zones[0] is [2.0, 1.0, 1.0, 2.0]"),
    ({"zones": [[2, 1, 3.01, 2]]}, "accepted: a rectangle on the map, [-1, 3) x [0.5, 3.5)"),
    ({"zones": [[2, 0.4, 3, 2]]}, "zones[0] is [2.0, 0.4, 3.0, 2.0]"),
    ({"zones": [[0, 1, 1, 2], [2, 2, 2.1, 3]]}, "zones[1] is [2.0, 2.0, 2.1, 3.0]"),
    ({"zones": "all"}, "zones is 'all'"),
    ({"hidden": {"walls": [[0, 0, 0, 0]]}}, "hidden.walls[0] is [0.0, 0.0, 0.0, 0.0]"),
    ({"hidden": {"rectangles": [[1, 1, 2]]}}, "hidden.rectangles[0] is [1, 1, 2]"),
    ({"hidden": {"discs": [[9, 9, 1]]}}, "hidden.discs[0] is [9.0, 9.0, 1.0], off the map"),
    (
        {"hidden": {"zones": []}},
        "hidden: unknown entry 'zones'; accepted: walls, rectangles, discs",
    ),
    ({"hidden": None}, "hidden is None"),
    ({"hidden": [[1, 1, 2, 2]]}, "hidden is [[1, 1, 2, 2]]"),
    ({"start": [0.0, 0.0]}, "start is [0.0, 0.0]"),
    ({"start": [0.0, NAN, 0.0]}, "start is [0.0, nan, 0.0]"),
    ({"start": [3.0, 2.0, 0.0]}, "accepted: a point on the map, [-1, 3) x [0.5, 3.5)"),
    ({"start": [0.0, 0.4, 0.0]}, "start is [0.0, 0.4, 0.0]; accepted: a point on the map"),
    ({"start": [1.5, 1.1, 0.0]}, "start is [1.5, 1.1, 0.0], in something solid"),
    ({"start": [0.0, 3.0, 0.0]}, "start is [0.0, 3.0, 0.0], in something solid"),  # hidden
    ({"goal": [1.0]}, "goal is [1.0]"),
    ({"goal": [1.0, 2.0, 3.0, 4.0]}, "goal is [1.0, 2.0, 3.0, 4.0]"),
    ({"goal": [-1.1, 2.0]}, "goal is [-1.1, 2.0]; accepted: a point on the map"),
    ({"goal": [2.5, 1.0, -2.0]}, "goal is [2.5, 1.0, -2.0], in something solid"),
    ({"wall": []}, "unknown entry 'wall'; accepted: origin, size, resolution, wall_reach, zones"),
    ({3: 4, "a\nb": 1}, r"unknown entry 3, 'a\nb'"),
]


THING = {"position": [-0.5, 2.0], "label": "door"}
MOVER = {"path": [[-0.7, 0.8], [-0.7, 1.8]], "speed": 1.0, "radius": 0.2}
REFUSED += [
    ({"hills": None}, "hills is None; accepted: a list of 4 finite numbers"),
    ({"hills": [[1, 2, 1]]}, "hills[0] is [1, 2, 1]"),
    ({"hills": [[1, 2, 1, 1], [1, 2, NAN, 1]]}, "hills[1] is [1, 2, nan, 1]"),
    ({"hills": [[1, 2, 1, 0]]}, "hills[0] is [1.0, 2.0, 1.0, 0.0]"),
    ({"hills": [[1, 2, 6e5, 1], [1, 2, -6e5, 1]]}, "hills have heights of 1.2e+06 m in all"),
    ({"hills": [[1, 2, 1, 1], [5, 2, 1, 2.1]]}, "hills[1] is [5.0, 2.0, 1.0, 2.1]"),
    ({"hills": [[1, 2, 1, 0.17]]}, "accepted: a hill with the centre of a cell of the map within"),
    ({"targets": 3}, "targets is 3"),
    ({"targets": [[1, 2, 3]]}, "targets[0] is [1, 2, 3]"),
    ({"targets": [[-0.5, 3.0], [3.0, 2.0]]}, "targets[1] is [3.0, 2.0]; accepted: a point on the"),
    ({"targets": [[2.0, 2.5]]}, "targets[0] is [2.0, 2.5], in something solid"),
    ({"targets": [[0.0, 3.0]]}, "targets[0] is [0.0, 3.0], in something solid"),  # hidden
    ({"objects": [[1, 2]]}, "objects[0] is [1, 2]; accepted: a mapping with position, label"),
    ({"objects": [{"position": [1, 2]}]}, "objects[0].label is missing"),
    ({"objects": [{**THING, "label": 3}]}, "objects[0].label is 3; accepted: the name of a class"),
    ({"objects": [{**THING, "position": [9, 2]}]}, "objects[0] is [9.0, 2.0]; accepted: a point"),
    ({"movers": {}}, "movers is {}; accepted: a list of mappings with path, speed, radius"),
    ({"movers": [MOVER, [1, 2]]}, "movers[1] is [1, 2]; accepted: a mapping with path, speed"),
    ({"movers": [{**MOVER, "phase": 0}]}, "movers[0]: unknown entry 'phase'; accepted: path"),
    ({"movers": [{"path": [[0, 2]], "radius": 1}]}, "movers[0].speed is missing"),
    ({"movers": [{**MOVER, "speed": -1}]}, "movers[0].speed is -1"),
    ({"movers": [{**MOVER, "speed": math.inf}]}, "movers[0].speed is inf"),
    ({"movers": [{**MOVER, "speed": "fast"}]}, "movers[0].speed is 'fast'"),
    ({"movers": [MOVER, {**MOVER, "radius": 0}]}, "movers[1].radius is 0"),
    ({"movers": [{**MOVER, "path": []}]}, "movers[0].path is []; accepted: at least one point"),
    ({"movers": [{**MOVER, "path": 2}]}, "movers[0].path is 2"),
    ({"movers": [MOVER, {**MOVER, "path": [[0, 1], [0, 1], [0]]}]}, "movers[1].path[2] is [0]"),
    (
        {"movers": [{**MOVER, "path": [[-0.7, 0.8], [-1.1, 2]]}]},
        "movers[0].path[1] is [-1.1, 2.0]; accepted: a point on the map",
    ),
    (
        {"movers": [{**MOVER, "path": [[-0.7, 0.8], [1.0, 1.0]]}]},
        "movers[0].path[1] is [1.0, 1.0], in something solid",
    ),
    (
        {"movers": [{**MOVER, "path": [[-0.7, 0.8], [-0.2, 1.8], [0, 0.55], [2.8, 2.2]]}]},
        "movers[0].path[2] is [0.0, 0.55], and on the way to movers[0].path[3] the disc touches",
    ),
    (
        {"movers": [MOVER, {**MOVER, "path": [[-0.2, 2.5]], "radius": 0.4}]},
        "movers[1].path[0] is [-0.2, 2.5], and on the way to movers[1].path[0] the disc touches",
    ),
]


@pytest.mark.parametrize(("changes", "named"), REFUSED)
def test_entries_refused(changes, named):
    refused(lambda: World.from_dict({**ENTRIES, **changes}), named, "accepted")


@pytest.mark.parametrize("missing", ["size", "start"])
def test_what_must_be_given(missing):
    entries = {key: value for key, value in ENTRIES.items() if key != missing}
    refused(lambda: World.from_dict(entries), f"{missing} is missing", "accepted")


def test_shapes_alone_are_checked():
    refused(lambda: Shapes(walls=((1.0, 1.0, 1.0, 1.0),)), "walls[0] is [1.0", "accepted")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "holds None"),
        ("just words", "holds 'just words'"),
        ("- 1\n- 2\n", "holds [1, 2]"),
        ("walls: [1, 2", "is not a map's YAML"),
        ("a: &x [1]\nb: *x\n", "aliases"),
        ("size: [1, 1]\nstart: [0, 0, 0]\ndoors: []\n", "unknown entry 'doors'"),
        ("size: [1, 1]\nstart: [0, 0, 0]\nwalls: [[0, 0, 0, 0]]\n", "walls[0] is [0.0, 0.0"),
        ("size: [1, 1]\n", "start is missing"),
    ],
)
def test_files_refused(tmp_path, text, named):
    path = tmp_path / "world.yaml"
    path.write_text(text)
    refused(lambda: World.from_yaml(path), path, named)


def test_a_missing_file_is_named(tmp_path):
    refused(lambda: World.from_yaml(tmp_path / "absent.yaml"), tmp_path / "absent.yaml", "accepted")
