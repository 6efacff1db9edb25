import dataclasses

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from jaxplore.report.exploration.members import members_figure


def test_three_panels_name_every_member_once(vehicle):
    figure = members_figure(vehicle)
    assert len(figure.axes) == 3
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["bold", "careful", "slow"]
    assert [axes.get_xlim() for axes in figure.axes] == [(0.0, 5.0)] * 3
    assert figure.axes[2].get_yscale() == "log"
    assert figure.axes[2].get_xlabel() == "time [s]"
    # A member has one colour in all panels.
    lines = [to_rgb(line.get_color()) for line in figure.axes[2].lines]
    areas = [to_rgb(area.get_facecolor()[0]) for area in figure.axes[0].collections]
    assert len(set(lines)) == 3
    np.testing.assert_allclose(areas, lines, atol=1e-6)


def test_shares_are_stacked_to_a_whole_and_averaged_over_a_second(vehicle):
    areas = members_figure(vehicle).axes[0].collections
    tops = []
    for area in areas:
        (path,) = area.get_paths()
        tops.append([path.vertices[path.vertices[:, 0] == 0.5 * k, 1].max() for k in range(10)])
    # Two steps a second: 25 and 30 % in turn are 27.5 % but in the first window, of one step.
    np.testing.assert_allclose(tops[0], [25.0] + [27.5] * 9, atol=1e-4)
    np.testing.assert_allclose(tops[1], [50.0] * 10, atol=1e-4)
    np.testing.assert_allclose(tops[2], [100.0] * 10, atol=1e-4)


def test_curves_hold_diversity_and_sample_sizes(vehicle):
    _, diversity, sizes = members_figure(vehicle).axes
    np.testing.assert_allclose(diversity.lines[0].get_ydata(), 0.25)
    bold, careful, slow = (line.get_ydata() for line in sizes.lines)
    np.testing.assert_allclose(bold, [1.0] + [k + 0.5 for k in range(1, 10)])
    np.testing.assert_allclose(careful, 10.0)
    # No finite rollout: there is nothing to draw on an axis without 0.
    assert np.isnan(slow).all()


def test_many_steps_are_thinned(vehicle):
    members = vehicle.records.members
    many = type(members)(*(np.repeat(np.asarray(rows), 500, axis=0) for rows in members))
    records = vehicle.records._replace(
        members=many,
        state=np.zeros((5000, 5), np.float32),
        coverage=np.zeros(5000, np.float32),
        entropy=np.zeros(5000, np.float32),
    )
    line = members_figure(dataclasses.replace(vehicle, records=records)).axes[1].lines[0]
    assert 1000 < len(line.get_xdata()) <= 2000
    assert line.get_xdata()[-1] > 2490.0


def test_a_run_without_a_step_is_an_empty_picture(no_step, make_vehicle):
    members_figure(make_vehicle(no_step)).canvas.draw()


def test_a_controller_without_members_has_no_picture(recording):
    with pytest.raises(ValueError, match="no members; accepted"):
        members_figure(recording)
