import dataclasses

import numpy as np
import pytest
from matplotlib.contour import QuadContourSet
from matplotlib.patches import Circle, Polygon

from jaxplore.report.exploration.overlays import find_closed_cells
from jaxplore.report.exploration.plots import map_figure
from jaxplore.report.exploration.window import Window

POSE = (3.0, -2.0, 0.7)
ADDED = {"height [m]", "not traversable", "target", "target found", "moving obstacle", "robot"}


def labels(figure) -> list[str]:
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def line(axes, label):
    (found,) = [each for each in axes.lines if each.get_label() == label]
    return found


def contours(figure, *, is_filled):
    sets = [each for each in figure.axes[0].collections if isinstance(each, QuadContourSet)]
    (found,) = [each for each in sets if each.filled == is_filled]
    return found


def patches(axes, kind) -> list:
    # The legend's sample of hatched ground has no place.
    return [each for each in axes.patches if isinstance(each, kind) and not each.get_hatch()]


def test_a_run_without_any_of_it_has_the_picture_that_it_had(recording):
    figure = map_figure(recording)
    assert labels(figure) == ["start", "end", "true outline"]
    assert not figure.axes[0].patches
    assert len(figure.axes[0].collections) == 3
    assert "targets" not in figure.get_suptitle()


def test_what_there_is_has_a_name_and_the_title_counts_targets(recording, vehicle):
    figure = map_figure(vehicle)
    # All targets are found in this run, so none is left as a star.
    assert set(labels(figure)) - set(labels(map_figure(recording))) == ADDED - {"target"}
    assert figure.get_suptitle().endswith(", targets 3 of 3")


@pytest.mark.parametrize(
    ("field", "value", "label"),
    [
        ("elevation", None, "height [m]"),
        ("traversable", None, "not traversable"),
        ("parts", {}, "target"),
        ("mover_radii", np.zeros(0), "moving obstacle"),
    ],
)
def test_what_there_is_not_has_no_name(vehicle, field, value, label):
    named = labels(map_figure(dataclasses.replace(vehicle, **{field: value})))
    gone = {label, "target found"} if label == "target" else {label}
    assert ADDED - set(named) == gone | {"target"}


def test_open_ground_that_may_not_be_entered_is_tinted_and_hatched(vehicle, recording):
    window = Window.around_reachable(vehicle)
    closed = find_closed_cells(vehicle, window)
    # 30 by 20 cells, walls around; from column 18 and row 12 on. The margin is 9 cells wide.
    expected = np.zeros(window.shape, bool)
    expected[9 + 12 : 9 + 19, 9 + 18 : 9 + 29] = True
    np.testing.assert_array_equal(closed, expected)
    images = [map_figure(each).axes[0].images[0].get_array() for each in (recording, vehicle)]
    differs = (np.asarray(images[0]) != np.asarray(images[1])).any(axis=-1)
    np.testing.assert_array_equal(differs, expected)
    hatched = contours(map_figure(vehicle), is_filled=True)
    assert hatched.hatches == ["////"]
    corners = np.concatenate([path.vertices for path in hatched.get_paths()])
    # Half a cell beyond the middles of the outermost cells.
    np.testing.assert_allclose(corners.min(axis=0), [1.8, 1.2], atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), [2.9, 1.9], atol=1e-6)


def test_contour_lines_are_where_the_ground_has_their_height(vehicle):
    lines = contours(map_figure(vehicle), is_filled=False)
    assert len(lines.levels) > 3
    for level, path in zip(lines.levels, lines.get_paths(), strict=True):
        x, y = path.vertices.T
        # 0.05 m a column and 0.02 m a row, the first middle at 0.05 m.
        height = 0.05 * (x / 0.1 - 0.5) + 0.02 * (y / 0.1 - 0.5)
        np.testing.assert_allclose(height, level, atol=1e-4)
    assert lines.labelTexts


@pytest.mark.parametrize("height", [0.0, 3.0, np.nan])
def test_level_ground_has_no_contour_lines(vehicle, height):
    level = np.full_like(vehicle.elevation, height)
    level[0, 0] += 0.01
    assert "height [m]" not in labels(map_figure(dataclasses.replace(vehicle, elevation=level)))


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), POSE])
def test_movers_targets_and_the_robot_are_where_they_belong(make_recording, make_vehicle, origin):
    route = [(0.5, 1.0), (1.0, 1.0), (1.5, 1.0)]
    run = make_vehicle(make_recording(route, [0.2, 0.4], origin=origin))
    axes = map_figure(run).axes[0]
    # The map is 3 m by 2 m.
    spots = np.array([[0.6, 1.6], [1.5, 0.6], [2.7, 1.2]])
    np.testing.assert_allclose(line(axes, "target").get_xydata(), spots, atol=1e-5)
    assert "target found" not in [each.get_label() for each in axes.lines]
    is_found = np.array([True, False, True])
    last = dataclasses.replace(run.frames[-1], parts={"targets": {"is_found": is_found}})
    drawn = map_figure(dataclasses.replace(run, frames=(*run.frames[:-1], last))).axes[0]
    for label, some in (("target", ~is_found), ("target found", is_found)):
        np.testing.assert_allclose(line(drawn, label).get_xydata(), spots[some], atol=1e-5)
    discs = patches(axes, Circle)
    places = [each.center for each in discs]
    np.testing.assert_allclose(places, [[1.8, 1.5], [2.1, 0.5]], atol=1e-5)
    assert [each.radius for each in discs] == pytest.approx([0.2, 0.3])
    trails = [each for each in axes.lines if each.get_linestyle() == ":" and len(each.get_xdata())]
    first = trails[0].get_xydata()
    np.testing.assert_allclose(first, [[0.9, 1.5], [1.35, 1.5], [1.8, 1.5]], atol=1e-5)
    outlines = [each.get_xy()[:4] for each in patches(axes, Polygon)]
    expected = np.array([[0.4, 0.15], [-0.2, 0.15], [-0.2, -0.15], [0.4, -0.15]])
    np.testing.assert_allclose(outlines[0], expected + route[0], atol=1e-5)
    np.testing.assert_allclose(outlines[1], expected + route[-1], atol=1e-5)


def test_the_outline_follows_the_heading(vehicle):
    state = np.array(vehicle.records.state)
    state[-1, 2] = 0.5 * np.pi
    turned = dataclasses.replace(vehicle, records=vehicle.records._replace(state=state))
    start, end = (each.get_xy()[:4] for each in patches(map_figure(turned).axes[0], Polygon))
    np.testing.assert_allclose(np.ptp(start, axis=0), [0.6, 0.3], atol=1e-6)
    np.testing.assert_allclose(np.ptp(end, axis=0), [0.3, 0.6], atol=1e-6)
    assert not patches(
        map_figure(dataclasses.replace(vehicle, footprint=np.zeros((0, 2)))).axes[0], Polygon
    )
