"""Figures of maps and fields."""

import io

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

import jaxplore as jx
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame


def pixel(figure, point) -> np.ndarray:
    """Return the colour at a world point, as the axes of the figure place it."""
    figure.canvas.draw()
    picture = np.asarray(figure.canvas.buffer_rgba())
    x, y = figure.axes[0].transData.transform(point)
    return picture[picture.shape[0] - 1 - int(y), int(x), :3]


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (-3.0, 2.0, 0.5), (5.0, -1.0, 2.8)])
def test_a_cell_is_drawn_where_it_is_in_the_world(origin) -> None:
    probability = np.zeros((6, 10), np.float32)
    probability[1, 7] = 1.0
    grid = jx.OccupancyGrid(probability, 0.5, origin)
    figure = grid.plot()
    assert pixel(figure, grid.frame.cell_centre(jnp.array([1, 7]))).max() < 30
    for row, column in ((1, 6), (1, 8), (0, 7), (2, 7), (4, 2)):
        assert pixel(figure, grid.frame.cell_centre(jnp.array([row, column]))).min() > 220


def test_fields_name_their_unit_and_leave_out_what_is_not_finite() -> None:
    frame = GridFrame(1.0)
    values = jnp.array([[0.0, jnp.inf], [1.0, 2.0]])
    field = ScalarField(values, frame, jnp.zeros(()))
    figure = field.plot("clearance [m]")
    assert [each.get_ylabel() for each in figure.axes] == ["y [m]", "clearance [m]"]
    assert figure.axes[0].images[0].get_clim() == (0.0, 2.0)
    assert pixel(figure, (1.5, 0.5)).min() == 255
    with Image.open(io.BytesIO(figure._repr_png_())) as picture:  # what a notebook shows
        assert picture.format == "PNG"
        assert picture.getextrema()[0] == (0, 255)


def test_information_is_drawn_by_heading() -> None:
    values = jnp.stack([jnp.ones((3, 4)), 5.0 * jnp.eye(3, 4)], axis=-1)
    field = jx.information.HeadingField(values, GridFrame(0.5))
    best, ahead = field.plot(), field.plot(0.0)
    assert best.axes[0].images[0].get_clim() == (1.0, 5.0)
    np.testing.assert_array_equal(ahead.axes[0].images[0].get_array(), np.ones((3, 4)))
    assert ahead.axes[1].get_ylabel() == "information, heading 0.00 rad [nat]"
    with pytest.raises(ValueError, match="heading is nan"):
        field.plot(float("nan"))
