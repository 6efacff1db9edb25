import dataclasses

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch, Polygon

from jaxplore.report.following.plots import (
    course_box,
    errors_figure,
    path_figure,
    thick_outline,
    worst_steps,
)


def pixels(figure) -> np.ndarray:
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())


def of_kind(axes, kind) -> list:
    return [each for each in axes.get_children() if type(each) is kind]


def labels(figure) -> list[str]:
    return [entry.get_text() for entry in figure.legends[0].texts]


def marked(axes, label) -> np.ndarray:
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return np.stack(line.get_data(), axis=-1)


def test_the_trail_is_where_it_was_driven_and_as_fast(ring):
    axes = path_figure(ring).axes[0]
    (trail,) = of_kind(axes, LineCollection)
    segments = np.asarray(trail.get_segments())
    np.testing.assert_allclose(segments[:, 0], ring.positions[:-1], atol=1e-6)
    np.testing.assert_allclose(segments[:, 1], ring.positions[1:], atol=1e-6)
    # Chords of a twentieth of a turn, each in half a second; from rest in the first.
    speed = 2.0 * 2.0 * 5.0 * np.sin(np.pi / 20.0)
    np.testing.assert_allclose(trail.get_array(), [0.5 * speed] + [speed] * 39, rtol=1e-5)
    assert trail.get_clim() == pytest.approx((0.0, speed))


def test_everything_is_within_the_limits(ring, straight):
    for run in (ring, straight):
        axes = path_figure(run).axes[0]
        (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
        points = np.concatenate([run.positions, run.centre, *run.edges])
        assert (points > [left, bottom]).all()
        assert (points < [right, top]).all()
        assert axes.get_aspect() == 1.0
        low, high = course_box(run)
        np.testing.assert_allclose([low, high], [[left, bottom], [right, top]])


def test_a_robot_that_left_the_course_is_in_the_picture(straight):
    state = straight.records.state.copy()
    state[5, :2] = (-4.0, 30.0)
    far = dataclasses.replace(straight, records=straight.records._replace(state=state))
    low, high = course_box(far)
    assert low[0] < -4.3
    assert high[1] > 30.3


def test_the_title_has_the_numbers(ring, straight, path_start):
    title = path_figure(ring).get_suptitle()
    assert title == "20.00 s, laps 2 of 2\nmean |contouring| 0.200 m, violations 2, contacts 1"
    assert path_figure(straight).get_suptitle() == (
        "5.00 s, 10.0 of 10.0 m\nmean |contouring| 0.200 m"
    )
    assert path_figure(path_start).get_suptitle() == "0.00 s, 0.0 of 10.0 m\nmean |contouring| - m"


def test_a_run_that_was_stopped_in_its_second_lap(ring):
    rows = {name: values[:30] for name, values in ring.records._asdict().items()}
    stopped = dataclasses.replace(ring, records=type(ring.records)(**rows))
    assert "15.00 s, laps 1 of 2" in path_figure(stopped).get_suptitle()


def test_obstacles_are_dark_at_the_end_and_faint_before(ring):
    axes = path_figure(ring).axes[0]
    patches = of_kind(axes, PathPatch)
    last = [patch for patch in patches if patch.get_alpha() is None]
    faint = [patch for patch in patches if patch.get_alpha() is not None]
    assert len(last) == 3
    assert len(faint) == 3 * (len(ring.frames) - 1)
    boxes = [patch.get_path().get_extents() for patch in last]
    # The disc of 0.3 m, the square of 0.4 m and the bar of 1 m, thicker by 0.1 and 0.15 m.
    x = ring.frames[-1].corners[0, 0, 0]
    expected = [(x, 4.8, 0.6, 0.6), (-5.0, 0.0, 0.6, 0.6), (0.0, -5.0, 1.3, 0.3)]
    for box, (x, y, width, height) in zip(boxes, expected, strict=True):
        found = [0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1), box.width, box.height]
        np.testing.assert_allclose(found, [x, y, width, height], atol=1e-5)


def test_faint_obstacles_stay_few(make_ring):
    run = make_ring(steps=100, num_frames=100)
    patches = of_kind(path_figure(run).axes[0], PathPatch)
    assert len(patches) == 3 * 9


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize(
    ("corners", "radius", "area"),
    [
        ([(0, 0)], 1.0, np.pi),
        ([(0, 0)] * 3, 1.0, np.pi),
        ([(-1, 0), (1, 0), (1, 0)], 0.5, 2.0 + 0.25 * np.pi),
        ([(-1, -1), (1, -1), (1, 1), (-1, 1)], 0.0, 4.0),
        ([(-1, -1), (1, -1), (1, 1), (-1, 1)], 0.4, 4.0 + 8.0 * 0.4 + np.pi * 0.16),
        # An L, whose notch is filled along its two sides of 1 m and where they meet.
        (
            [(-1, -1), (1, -1), (1, 0), (0, 0), (0, 1), (-1, 1)],
            0.2,
            3.0 + 8.0 * 0.2 + 5.0 * 0.25 * np.pi * 0.04 - 0.04,
        ),
    ],
)
def test_an_outline_is_filled_once(corners, radius, area, turn):
    figure = Figure(figsize=(4.0, 4.0), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(-2.0, 2.0), ylim=(-2.0, 2.0))
    axes.axis("off")
    path = thick_outline(np.asarray(corners, float)[::turn], radius)
    axes.add_patch(PathPatch(path, facecolor="black", linewidth=0.0, alpha=0.5))
    level = pixels(figure)[..., 0].astype(float)
    # Half transparent: twice drawn would be darker.
    assert level.min() == pytest.approx(127.0, abs=1.0)
    covered = (255.0 - level).sum() / 128.0 / 100.0**2
    assert covered == pytest.approx(area, rel=0.01)


def test_what_went_wrong_is_marked(ring, straight):
    axes = path_figure(ring).axes[0]
    after = ring.positions[1:]
    np.testing.assert_allclose(marked(axes, "out of the corridor"), after[[4, 5, 7]], atol=1e-6)
    # One cross for the contact of two steps, where it was deepest.
    np.testing.assert_allclose(marked(axes, "contact"), after[[12]], atol=1e-6)
    assert labels(path_figure(straight)) == ["path", "start", "end", "robot"]


def test_the_worst_of_each_row_of_steps():
    assert worst_steps(np.array([])).tolist() == []
    assert worst_steps(np.array([0.0, np.inf, 1.0])).tolist() == []
    margins = [-1.0, 0.5, -0.1, -0.3, -0.2, 0.0, -0.1]
    assert worst_steps(np.array(margins)).tolist() == [0, 3, 6]


def test_start_end_and_the_robot(ring, straight):
    axes = path_figure(ring).axes[0]
    np.testing.assert_allclose(marked(axes, "start"), [[5.0, 0.0]], atol=1e-5)
    np.testing.assert_allclose(marked(axes, "end"), [[5.0, 0.0]], atol=1e-5)
    # A car that heads along y: its front, 0.4 m ahead, is up.
    (car,) = of_kind(axes, Polygon)
    expected = [[4.85, 0.4], [4.85, -0.2], [5.15, -0.2], [5.15, 0.4]]
    np.testing.assert_allclose(car.get_xy()[:4], expected, atol=1e-5)
    (disc,) = of_kind(path_figure(straight).axes[0], Circle)
    assert disc.center == pytest.approx((10.0, 0.0))
    assert disc.radius == 0.3


def test_a_corridor_has_a_floor_and_two_edges(ring, straight):
    axes = path_figure(ring).axes[0]
    (floor,) = of_kind(axes, PolyCollection)
    assert len(floor.get_paths()) == 72
    np.testing.assert_allclose(marked(axes, "corridor"), ring.edges[0], atol=1e-6)
    bare = path_figure(straight).axes[0]
    assert not of_kind(bare, PolyCollection)
    assert not of_kind(bare, PathPatch)


def test_a_corridor_that_is_open_on_one_side(ring):
    edges = ring.edges.copy()
    edges[1, 10:30] = np.inf
    run = dataclasses.replace(ring, edges=edges)
    figure = path_figure(run)
    pixels(figure)
    (floor,) = of_kind(figure.axes[0], PolyCollection)
    assert len(floor.get_paths()) == 72 - 21
    assert np.isfinite(course_box(run)).all()


@pytest.fixture
def tall(make_straight):
    """Up along y, with the longest legend: the slimmest picture."""
    run = make_straight()
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]], np.float32)
    state = run.records.state.copy()
    state[:, :2] = state[:, :2] @ turn
    margins = np.linspace(-0.1, 0.5, 10).astype(np.float32)
    centre, aside = run.centre @ turn, np.array([0.5, 0.0])
    frames = [
        dataclasses.replace(frame, corners=np.zeros((1, 1, 2), np.float32)) for frame in run.frames
    ]
    return dataclasses.replace(
        run,
        records=run.records._replace(state=state, room=margins, gap=margins),
        frames=tuple(frames),
        centre=centre,
        edges=np.stack([centre - aside, centre + aside]),
        obstacle_radii=np.array([0.2]),
    )


@pytest.fixture
def ring_start(ring):
    """Laps that ended before the first step."""
    rows = {name: values[:0] for name, values in ring.records._asdict().items()}
    return dataclasses.replace(ring, records=type(ring.records)(**rows), frames=ring.frames[:1])


@pytest.mark.parametrize("draw", [path_figure, errors_figure])
@pytest.mark.parametrize("name", ["ring", "straight", "path_start", "ring_start", "tall"])
def test_everything_is_inside_the_picture(draw, name, request, check_margins):
    check_margins(draw(request.getfixturevalue(name)))


def test_errors_of_laps_are_over_time(ring):
    errors, speed, felt, margins = errors_figure(ring).axes
    time = 0.5 * np.arange(1, 41)
    np.testing.assert_allclose(marked(errors, "contouring")[:, 0], time)
    np.testing.assert_allclose(marked(errors, "contouring")[:, 1], ring.records.contouring)
    np.testing.assert_allclose(marked(errors, "lag")[:, 1], 0.1, rtol=1e-6)
    np.testing.assert_allclose(speed.lines[0].get_xdata(), [0.0, *time])
    np.testing.assert_allclose(marked(felt, "lateral")[:, 1], ring.records.acceleration[:, 1])
    np.testing.assert_allclose(marked(felt, "longitudinal")[:, 1], ring.records.acceleration[:, 0])
    np.testing.assert_allclose(marked(margins, "room to the edge")[:, 1], ring.records.room)
    np.testing.assert_allclose(marked(margins, "gap to obstacles")[:, 1], ring.records.gap)
    assert margins.get_xlabel() == "time [s]"
    assert margins.get_xlim() == (0.0, 20.0)
    low, high = margins.get_ylim()
    assert low < -0.2
    assert high > 0.5


def test_laps_are_divided_and_named(ring, straight):
    figure = errors_figure(ring)
    for axes in figure.axes:
        upright = [line for line in axes.lines if len(set(line.get_xdata())) == 1]
        assert [line.get_xdata()[0] for line in upright] == pytest.approx([10.0, 20.0])
    names = [text.get_text() for text in figure.axes[0].texts]
    assert names == ["lap 1\n10.00 s", "lap 2\n10.00 s"]
    assert not errors_figure(straight).axes[0].texts


def test_errors_of_an_open_path_are_over_its_progress(straight):
    errors, speed, felt = errors_figure(straight).axes
    np.testing.assert_allclose(marked(errors, "lag")[:, 0], np.arange(1.0, 11.0))
    np.testing.assert_allclose(speed.lines[0].get_xdata(), np.arange(11.0))
    assert felt.get_xlabel() == "progress [m]"
    assert felt.get_xlim() == (0.0, 10.0)


@pytest.mark.parametrize("some", [True, False])
def test_accelerations_that_are_not_numbers(straight, some):
    values = straight.records.acceleration.copy()
    values[3 if some else slice(None)] = np.nan
    run = dataclasses.replace(straight, records=straight.records._replace(acceleration=values))
    figure = errors_figure(run)
    pixels(figure)
    # Without any number there is nothing to draw.
    assert len(figure.axes) == (3 if some else 2)
    assert figure.axes[-1].get_xlabel() == "progress [m]"


def test_one_of_room_and_gap_alone(ring):
    for name, gone in (("room to the edge", "gap"), ("gap to obstacles", "room")):
        never = np.full(40, np.inf, np.float32)
        run = dataclasses.replace(ring, records=ring.records._replace(**{gone: never}))
        figure = errors_figure(run)
        pixels(figure)
        shown = [text.get_text() for text in figure.axes[-1].get_legend().texts]
        assert shown == [name]
