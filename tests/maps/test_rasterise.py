import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import ndimage

from jaxplore.maps.frame import GridFrame
from jaxplore.maps.rasterise import cell_at, disc_mask, rectangle_mask, segment_mask

# Half cells are the unit of the exact tests: with cells of 0.1 m the centre of cell i is at 2 i + 1
# units, and whether it lies in a shape whose numbers are whole units is a matter of integers,
# boundaries included.
UNIT = 0.05
FRAME = GridFrame(0.1)
SHAPE = (12, 17)
UNITS = st.integers(-6, 40)
LENGTHS = st.integers(1, 12)


def cells(is_inside):
    """Enumerate the cells of SHAPE whose centre (x, y), in units, is inside."""
    return np.array(
        [[is_inside(2 * c + 1, 2 * r + 1) for c in range(SHAPE[1])] for r in range(SHAPE[0])]
    )


def with_middle(mask, x, y):
    """Add the cell that holds (x, y) [cells] if there is no other."""
    row, column = math.floor(y), math.floor(x)
    if not mask.any() and 0 <= row < SHAPE[0] and 0 <= column < SHAPE[1]:
        mask[row, column] = True
    return mask


@given(UNITS, UNITS, LENGTHS, st.integers(1, 8))
def test_segments_along_an_axis_are_exact(x, y, length, reach):
    def is_inside(cx, cy):
        beyond = max(x - cx, 0, cx - x - length)
        return beyond**2 + (cy - y) ** 2 <= reach**2

    expected = with_middle(cells(is_inside), (x + length / 2) / 2, y / 2)
    row = (x * UNIT, y * UNIT, (x + length) * UNIT, y * UNIT)
    np.testing.assert_array_equal(segment_mask([row], FRAME, SHAPE, reach * UNIT), expected)
    backwards = [(*row[2:], *row[:2])]
    np.testing.assert_array_equal(segment_mask(backwards, FRAME, SHAPE, reach * UNIT), expected)
    upright = [(row[1], row[0], row[3], row[2])]
    np.testing.assert_array_equal(
        segment_mask(upright, FRAME, SHAPE[::-1], reach * UNIT), expected.T
    )


@given(UNITS, UNITS, st.integers(1, 15))
def test_discs_are_exact(x, y, radius):
    expected = with_middle(
        cells(lambda cx, cy: (cx - x) ** 2 + (cy - y) ** 2 <= radius**2), x / 2, y / 2
    )
    disc = (x * UNIT, y * UNIT, radius * UNIT)
    np.testing.assert_array_equal(disc_mask([disc], FRAME, SHAPE), expected)


@given(UNITS, UNITS, LENGTHS, LENGTHS)
def test_rectangles_are_exact_and_half_open(x, y, width, height):
    def of_axis(low, size, centre):
        if size > 1 or low % 2:
            return low <= centre < low + size
        return centre == low + 1  # half a cell without a centre: the cell it is half of

    row = (x * UNIT, y * UNIT, (x + width) * UNIT, (y + height) * UNIT)
    solid = cells(lambda cx, cy: of_axis(x, width, cx) and of_axis(y, height, cy))
    np.testing.assert_array_equal(rectangle_mask([row], FRAME, SHAPE), solid)
    plain = cells(lambda cx, cy: x <= cx < x + width and y <= cy < y + height)
    found = rectangle_mask([row], FRAME, SHAPE, is_solid=False)
    np.testing.assert_array_equal(found, plain)


# On a turned grid: complex numbers instead of vectors, in double precision.
TURNED = GridFrame(0.25, (1.0, -2.0, 0.6))
X0, Y0, YAW = np.asarray(TURNED.origin, np.float64)
CENTRES = complex(X0, Y0) + np.exp(1j * YAW) * 0.25 * (
    np.arange(SHAPE[1]) + 0.5 + 1j * (np.arange(SHAPE[0])[:, None] + 0.5)
)
METRES = st.floats(-4, 6)
SIZES = st.floats(0.01, 3.0)


def same(found, margin, middle):
    """Compare with the cells of positive margin, those on the boundary aside."""
    expected = margin > 0
    if not expected.any():
        at = (middle - complex(X0, Y0)) * np.exp(-1j * YAW) / 0.25
        assume(min(abs(at.real - round(at.real)), abs(at.imag - round(at.imag))) > 1e-6)
        expected = with_middle(expected, at.real, at.imag)
    assume(np.abs(margin).min() > 1e-6)
    np.testing.assert_array_equal(found, expected)


@given(METRES, METRES, METRES, METRES, SIZES)
def test_segments_on_a_turned_grid(x1, y1, x2, y2, reach):
    a, b = complex(x1, y1), complex(x2, y2)
    assume(abs(b - a) > 1e-6)
    # The axes of the segment: how far along, and how far to the side.
    local = (CENTRES - a) * np.conj(b - a) / abs(b - a)
    beyond = np.maximum(np.maximum(-local.real, local.real - abs(b - a)), 0.0)
    margin = reach - np.abs(beyond + 1j * local.imag)
    same(segment_mask([(x1, y1, x2, y2)], TURNED, SHAPE, reach), margin, (a + b) / 2)


@given(METRES, METRES, SIZES)
def test_discs_on_a_turned_grid(x, y, radius):
    margin = radius - np.abs(CENTRES - complex(x, y))
    same(disc_mask([(x, y, radius)], TURNED, SHAPE), margin, complex(x, y))


@given(METRES, METRES, SIZES, SIZES)
def test_rectangles_on_a_turned_grid(x, y, width, height):
    # A side below a cell counts as one cell, about the same middle.
    across, up = max(width, 0.25), max(height, 0.25)
    middle = complex(x + width / 2, y + height / 2)
    offset = CENTRES - middle
    margin = np.minimum(across / 2 - np.abs(offset.real), up / 2 - np.abs(offset.imag))
    found = rectangle_mask([(x, y, x + width, y + height)], TURNED, SHAPE)
    same(found, margin, middle)
    found = rectangle_mask([(x, y, x + width, y + height)], TURNED, SHAPE, is_solid=False)
    margin = np.minimum(width / 2 - np.abs(offset.real), height / 2 - np.abs(offset.imag))
    assume(np.abs(margin).min() > 1e-6)
    np.testing.assert_array_equal(found, margin > 0)


@given(*[st.floats(0.0, 1.7)] * 2, *[st.floats(0.0, 1.2)] * 2)
def test_a_segment_half_a_cell_thick_has_no_gaps(x1, x2, y1, y2):
    mask = segment_mask([(x1, y1, x2, y2)], FRAME, SHAPE, 0.05)
    touching = ndimage.label(mask, structure=np.ones((3, 3)))[1]
    assert touching == 1
    # It is in every column (or row, if it is steep) whose middle it passes.
    is_flat = abs(x2 - x1) >= abs(y2 - y1)
    low, high = sorted((x1, x2) if is_flat else (y1, y2))
    is_there = mask.any(axis=0 if is_flat else 1)
    middles = 0.1 * (np.arange(is_there.size) + 0.5)
    assert is_there[(low + 1e-6 < middles) & (middles < high - 1e-6)].all()


@given(st.floats(0.0, 1.1), st.floats(1e-6, 0.09))
def test_a_thin_rectangle_has_no_gaps(y, height):
    mask = rectangle_mask([(0.2, y, 1.5, y + height)], FRAME, SHAPE)
    np.testing.assert_array_equal(mask.any(axis=0), [2 <= column < 15 for column in range(17)])


def test_what_is_between_two_cells_is_in_both():
    frame = GridFrame(1.0)
    across = rectangle_mask([(0.2, 0.99, 2.8, 1.01)], frame, (3, 3))
    np.testing.assert_array_equal(across, [[1, 1, 1], [1, 1, 1], [0, 0, 0]])
    # Not so a side of a whole cell, though in binary 0.35 - 0.25 is less than 0.1.
    row = rectangle_mask([(0.25, 0.0, 0.35, 0.1)], FRAME, (1, 5))
    np.testing.assert_array_equal(row, [[0, 0, 1, 0, 0]])


@pytest.mark.parametrize(
    ("mask", "row"),
    [
        (lambda rows: segment_mask(rows, FRAME, SHAPE, 0.001), (0.31, 0.42, 0.33, 0.42)),
        (lambda rows: rectangle_mask(rows, FRAME, SHAPE), (0.31, 0.41, 0.33, 0.42)),
        (lambda rows: disc_mask(rows, FRAME, SHAPE), (0.32, 0.42, 0.001)),
    ],
)
def test_what_is_too_small_for_a_centre_marks_its_own_cell(mask, row):
    assert np.argwhere(mask([row])).tolist() == [[4, 3]]
    away = (row[0] - 9, row[1], row[2] - 9, *row[3:]) if len(row) == 4 else (-8.68, *row[1:])
    assert not mask([away]).any()
    # Next to something large it still does.
    large = (1.0, 0.0, 1.7, 0.05) if len(row) == 4 else (1.4, 0.2, 0.3)
    both = mask([large, row])
    assert both[4, 3]
    np.testing.assert_array_equal(both, mask([large]) | mask([row]))


def test_nothing_marks_nothing():
    for mask in (
        segment_mask((), FRAME, SHAPE, 0.2),
        rectangle_mask([], FRAME, SHAPE),
        disc_mask(np.zeros((0, 3)), FRAME, SHAPE),
    ):
        assert mask.shape == SHAPE
        assert mask.dtype == bool
        assert not mask.any()


def test_a_segment_without_length_is_a_disc():
    found = segment_mask([(0.8, 0.6, 0.8, 0.6)], FRAME, SHAPE, 0.33)
    np.testing.assert_array_equal(found, disc_mask([(0.8, 0.6, 0.33)], FRAME, SHAPE))


def test_the_cell_at_a_point():
    for row, column in np.ndindex(SHAPE):
        centre = CENTRES[row, column]
        assert cell_at((centre.real, centre.imag), TURNED) == (row, column)
    assert cell_at((0.3, 0.7), FRAME) == (7, 3)  # 0.3 / 0.1 is 2.9999999999999996
    assert cell_at((-0.05, 1.0), FRAME) == (10, -1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: segment_mask([(0.0, 0.0, 1.0)], FRAME, SHAPE, 0.1),
            r"segments has shape \(1, 3\)",
        ),
        (lambda: segment_mask([(0.0, 0.0, 1.0, math.nan)], FRAME, SHAPE, 0.1), r"segments\[0\] is"),
        (lambda: segment_mask([(0.0,) * 4], FRAME, SHAPE, -0.1), "reach is -0.1"),
        (lambda: rectangle_mask([(0.0, 0.0, 1.0, 0.0)], FRAME, SHAPE), r"rectangles\[0\] is"),
        (lambda: rectangle_mask([0.0, 0.0, 1.0, 1.0], FRAME, SHAPE), r"has shape \(4,\)"),
        (lambda: rectangle_mask([(0.0, 1.0), (2.0,)], FRAME, SHAPE), "rectangles is"),
        (lambda: disc_mask([(0.0, 0.0, 1.0), (0.0, 0.0, 0.0)], FRAME, SHAPE), r"discs\[1\] is"),
        (lambda: disc_mask([(math.inf, 0.0, 1.0)], FRAME, SHAPE), r"discs\[0\] is"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message) as error:
        call()
    assert "accepted" in str(error.value)
