import dataclasses

import numpy as np
import pytest

from jaxplore.parts.watch.report import idleness_figure as draw_idleness


def idleness_figure(run):
    return draw_idleness(run, run.parts["watch"])


def test_the_map_shows_reachable_cells_and_nothing_longer_than_the_run(vehicle):
    place, _, *_ = idleness_figure(vehicle).axes
    shown = place.images[-1].get_array()
    # 9 cells of margin around 20 by 30; walls around.
    expected = np.ones(shown.shape, bool)
    expected[9 + 1 : 9 + 19, 9 + 1 : 9 + 29] = False
    np.testing.assert_array_equal(np.ma.getmaskarray(shown), expected)
    row = shown[15, 10:38]
    # 0.1 s more a column as far as the middle; never seen behind it: since the start, 5 s ago.
    columns = np.arange(1, 29)
    np.testing.assert_allclose(row, np.where(columns < 15, 0.1 * columns, 5.0), atol=1e-6)
    assert place.get_xlim() == pytest.approx((-0.9, 3.9))


def test_curves_are_those_of_the_records_kept_to_the_end(vehicle):
    figure = idleness_figure(vehicle)
    (curve,) = [axes for axes in figure.axes if axes.get_xlabel() == "time [s]"]
    worst, mean = curve.lines
    time, k = 0.5 * np.arange(11), np.minimum(np.arange(11), 9)
    np.testing.assert_allclose(mean.get_xdata(), time)
    np.testing.assert_allclose(mean.get_ydata(), k)
    np.testing.assert_allclose(worst.get_ydata(), np.where(k < 5, 20.0, 10.0 - np.abs(k - 6.0)))
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["robot", "worst", "mean", "not counted"]
    (shaded,) = curve.patches
    box = shaded.get_extents().transformed(curve.transData.inverted())
    assert (box.x0, box.x1) == pytest.approx((0.0, 2.5))


def test_a_colour_bar_has_seconds_and_a_turned_map_its_own_axes(make_recording, make_vehicle):
    route = [(0.5, 1.0), (1.0, 1.2), (1.5, 0.7)]
    turned = make_vehicle(make_recording(route, [0.2, 0.4], origin=(3.0, -2.0, 0.7)))
    figure = idleness_figure(turned)
    assert figure.axes[0].get_xlabel() == "grid x [m]"
    np.testing.assert_allclose(figure.axes[0].lines[0].get_xydata()[0], route[-1], atol=1e-5)
    assert sum(axes.get_ylabel() == "not seen for [s]" for axes in figure.axes) == 2


@pytest.mark.parametrize("shape", [(1, 40), (40, 1)])
def test_thin_maps_and_runs_without_a_step(make_recording, make_vehicle, shape):
    middle = (0.05 * shape[1], 0.05 * shape[0])
    idleness_figure(make_vehicle(make_recording([middle], [], shape=shape))).canvas.draw()


def test_without_reachable_cells_the_grid_is_drawn(vehicle):
    empty = dataclasses.replace(vehicle, reachable=np.zeros_like(vehicle.reachable))
    idleness_figure(empty).canvas.draw()
