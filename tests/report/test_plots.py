import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from jaxplore.parts.watch.report import WatchRecord, WatchReport, idleness_figure
from jaxplore.report.drawing.colours import MISSED, UNKNOWN, belief_colours
from jaxplore.report.exploration.map_axes import true_outline
from jaxplore.report.exploration.plots import coverage_figure, map_figure
from jaxplore.report.exploration.window import Window

POSE = (3.0, -2.0, 0.7)


def test_without_reachable_cells_the_grid_is_drawn(recording):
    empty = dataclasses.replace(recording, reachable=np.zeros_like(recording.reachable))
    assert Window.around_reachable(empty).shape == (40, 50)
    map_figure(empty).canvas.draw()


def test_a_turned_grid_is_drawn_along_its_own_axes(make_recording):
    route = [(0.5, 1.0), (1.0, 1.2), (1.5, 0.7)]
    straight, turned = (
        make_recording(route, [0.2, 0.4], origin=origin) for origin in ((0.0, 0.0, 0.0), POSE)
    )
    placed = [Window.around_reachable(each).place(each.positions) for each in (straight, turned)]
    assert placed[0] == pytest.approx(np.array(route) + 0.9, abs=1e-5)
    assert placed[1] == pytest.approx(placed[0], abs=1e-5)
    figures = [map_figure(each) for each in (straight, turned)]
    assert figures[0].axes[0].get_xlabel() == "x [m]"
    assert figures[1].axes[0].get_xlabel() == "grid x [m]"
    tracks = [figure.axes[0].collections[0].get_segments() for figure in figures]
    assert np.asarray(tracks[1]) == pytest.approx(np.asarray(tracks[0]), abs=1e-5)


def test_the_belief_and_the_track_are_where_they_belong(recording):
    figure = map_figure(recording)
    axes = figure.axes[0]
    assert axes.images[0].get_extent() == pytest.approx([-0.9, 3.9, -0.9, 2.9])
    track = axes.collections[0].get_segments()
    assert track[0][0] == pytest.approx([0.5, 1.0])
    assert track[-1][1] == pytest.approx([2.5, 1.0])
    assert "99.0 % covered, 5.0 s, 2.0 m" in figure.get_suptitle()


def test_walls_that_were_not_seen_are_marked(recording):
    belief = recording.belief.copy()
    belief[0, 5:9] = 0.5
    colours = map_figure(dataclasses.replace(recording, belief=belief)).axes[0].images[0]
    marked = (np.asarray(colours.get_array()) == MISSED).all(axis=-1)
    expected = np.zeros_like(marked)
    expected[9, 14:18] = True
    assert (marked == expected).all()


def test_the_colours_of_a_belief_run_from_free_over_unknown_to_occupied():
    colours = belief_colours().astype(int)
    assert (np.diff(colours.sum(axis=1)) <= 0).all()
    assert np.abs(colours[128] - UNKNOWN).max() <= 1


@pytest.mark.parametrize(
    ("shape", "position"), [((1, 40), (1.0, 0.05)), ((40, 1), (0.05, 1.0)), ((1, 1), (0.05, 0.05))]
)
def test_thin_maps(make_recording, shape, position):
    recording = make_recording([position] * 3, [0.5, 0.5], shape=shape)
    map_figure(recording).canvas.draw()
    coverage_figure(recording).canvas.draw()


@pytest.fixture
def narrow(make_recording, make_vehicle):
    """A vehicle in a lane, with a goal: the longest legend below the slimmest picture."""
    lane = make_recording([(0.5, 1.0 + k) for k in range(11)], [0.5] * 10, shape=(140, 12))
    return dataclasses.replace(make_vehicle(lane), goal=np.array([0.5, 12.0]))


@pytest.mark.parametrize("draw", [map_figure, coverage_figure])
@pytest.mark.parametrize("name", ["recording", "no_step", "vehicle", "narrow"])
def test_everything_is_inside_the_picture(draw, name, request, check_margins):
    check_margins(draw(request.getfixturevalue(name)))


def test_the_curve_names_the_levels(recording, make_recording):
    def names(run):
        (legend,) = coverage_figure(run).legends
        return [text.get_text() for text in legend.get_texts()]

    assert names(recording)[:4] == ["coverage", "entropy", "target: 99 %", "50 %: 1.5 s, 0.6 m"]
    never = make_recording([(1.0, 1.0)] * 3, [0.1, 0.2])
    assert names(never)[3:] == [f"{level} %: not reached" for level in (50, 90, 95, 99)]


@pytest.mark.parametrize("name", ["recording", "vehicle", "narrow"])
def test_no_legend_covers_a_curve(name, request):
    run = request.getfixturevalue(name)
    idle = np.zeros(run.num_steps, np.float32)
    records = run.records._replace(parts={"watch": WatchRecord(idle, idle)})
    watched = dataclasses.replace(run, records=records)
    idleness = idleness_figure(watched, WatchReport(np.zeros_like(run.world), is_patrol=True))
    for figure in (map_figure(run), coverage_figure(run), idleness):
        figure.canvas.draw()
        (legend,) = figure.legends
        assert not any(axes.get_legend() for axes in figure.axes)
        for axes in figure.axes:
            assert not legend.get_window_extent().overlaps(axes.get_window_extent())


def test_walls_that_were_not_seen_have_a_line_of_the_same_width_on_any_map(recording):
    belief = recording.belief.copy()
    belief[0, 5:9] = 0.5
    missed = map_figure(dataclasses.replace(recording, belief=belief)).axes[0].collections[2]
    # The lower wall is 0.1 m thick; its upper face is what could be seen.
    expected = {((0.1 * k, 0.1), (0.1 * (k + 1), 0.1)) for k in range(5, 9)}

    def rounded(edges):
        return {tuple(map(tuple, np.round(each, 3).tolist())) for each in edges}

    assert rounded(missed.get_segments()) == rounded(expected)
    assert missed.get_linewidths()[0] > 2.0


@pytest.mark.parametrize(("width", "length"), [(30, 1.0), (300, 5.0), (60, 1.0)])
def test_the_scale_bar_is_as_long_as_it_says(make_recording, width, length):
    run = make_recording([(0.5, 1.0)] * 3, [0.1, 0.2], shape=(20, width))
    axes = map_figure(run).axes[0]
    bar = next(line for line in axes.lines if line.get_marker() == "|")
    assert np.ptp(bar.get_xdata()) == pytest.approx(length)
    assert f"{length:g} m\n" in [text.get_text() for text in axes.texts]


def test_a_known_map_has_no_coverage_in_its_title(vehicle):
    covered = np.ones_like(vehicle.records.coverage)
    seen_at_once = dataclasses.replace(vehicle, records=vehicle.records._replace(coverage=covered))
    assert "covered" in map_figure(seen_at_once).get_suptitle()
    known = dataclasses.replace(seen_at_once, initial_unknown=0.0)
    assert "covered" in map_figure(vehicle).get_suptitle()
    assert map_figure(known).get_suptitle() == "5.0 s, 2.0 m, targets 3 of 3"


def test_importing_is_light():
    program = (
        "import sys, jaxplore.report.exploration.recording, jaxplore.report.save; "
        "import jaxplore.report.following.plots, jaxplore.report.following.animation; "
        "assert not any(name.startswith('matplotlib') for name in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_the_true_outline_is_every_edge_between_free_and_solid(recording):
    world = np.ones((12, 20), np.float32)
    world[2:9, 3:15] = 0.0
    world[4:6, 7] = 1.0  # a pillar
    world[10, 17] = 0.0  # free, but no part of the room
    reachable = np.zeros_like(world, bool)
    reachable[7, 5] = True
    known = dataclasses.replace(recording, world=world, belief=world, reachable=reachable)
    window = Window(first=(0, 0), shape=(12, 20), resolution=0.5, origin=np.zeros(3))
    edges = {
        tuple(sorted(map(tuple, edge.tolist())))
        for edge in true_outline(dataclasses.replace(known, resolution=0.5), window)
    }
    expected = set()
    room = world == 0.0
    room[10, 17] = False
    for row, column in np.argwhere(room).tolist():
        for down, right, edge in (
            (-1, 0, ((column, row), (column + 1, row))),
            (1, 0, ((column, row + 1), (column + 1, row + 1))),
            (0, -1, ((column, row), (column, row + 1))),
            (0, 1, ((column + 1, row), (column + 1, row + 1))),
        ):
            if not room[row + down, column + right]:
                expected.add(tuple((0.5 * x, 0.5 * y) for x, y in edge))
    assert edges == expected


def dashed(axes) -> list:
    return [line for line in axes.lines if line.get_linestyle() == "--"]


def test_a_target_coverage_is_a_dashed_line_and_none_is_none(recording):
    (line,) = dashed(coverage_figure(recording).axes[0])
    assert line.get_ydata()[0] == pytest.approx(99.0)
    endless = dataclasses.replace(recording, target_coverage=None)
    assert not dashed(coverage_figure(endless).axes[0])


def test_targets_seen_are_steps_below_the_coverage(recording, vehicle):
    assert not any("targets" in axes.get_ylabel() for axes in coverage_figure(recording).axes)
    figure = coverage_figure(vehicle)
    (below,) = [axes for axes in figure.axes if "targets" in axes.get_ylabel()]
    steps = below.lines[0]
    assert steps.get_drawstyle() == "steps-post"
    np.testing.assert_allclose(steps.get_xdata(), 0.5 * np.arange(11))
    assert steps.get_ydata().tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3]
    assert below.get_xlim() == figure.axes[0].get_xlim() == (0.0, 5.0)
    assert below.get_xlabel() == "time [s]"
    assert below.get_ylim()[1] > 3.0
