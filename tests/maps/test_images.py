import io
import os

import numpy as np
import pytest
from PIL import Image

from jaxplore.maps.files.images import HEADER_LIMIT, PIXEL_LIMIT, read_greys

GREYS = np.array([[0, 51, 102], [153, 204, 255]], np.uint8)
EIGHT = GREYS / 255
WIDE = GREYS.astype(np.uint16) * np.uint16(257) - np.array([[0, 1, 2], [3, 4, 0]], np.uint16)


def store(path, pixels, image_format, mode=None):
    image = Image.fromarray(pixels)
    (image.convert(mode) if mode else image).save(path, image_format)
    return path


@pytest.mark.parametrize(
    ("pixels", "image_format", "mode", "expected"),
    [
        (GREYS, "PNG", None, EIGHT),
        (GREYS, "PPM", None, EIGHT),
        (GREYS, "BMP", None, EIGHT),
        (GREYS, "PNG", "RGB", EIGHT),
        (GREYS, "PNG", "P", EIGHT),
        (WIDE, "PNG", None, WIDE / 65535),
        (WIDE, "PPM", None, WIDE / 65535),
    ],
)
def test_shade(tmp_path, pixels, image_format, mode, expected) -> None:
    greys = read_greys(store(tmp_path / "x", pixels, image_format, mode))
    assert greys.shade.dtype == np.float32
    assert np.array_equal(greys.shade, expected.astype(np.float32))
    assert greys.opaque is None


@pytest.mark.parametrize(("maxval", "values"), [(100, (0, 35, 100)), (1000, (0, 1, 999))])
def test_the_shade_is_over_the_images_own_greatest_value(tmp_path, maxval, values) -> None:
    path = tmp_path / "x.pgm"
    path.write_text(f"P2 3 1 {maxval} {' '.join(map(str, values))}")
    np.testing.assert_array_equal(read_greys(path).shade, np.float32([np.divide(values, maxval)]))


def test_colours_are_averaged(tmp_path) -> None:
    path = store(tmp_path / "x", np.array([[[255, 0, 30], [10, 20, 30]]], np.uint8), "PNG")
    np.testing.assert_allclose(read_greys(path).shade, [[95 / 255, 20 / 255]], rtol=1e-6)


def test_alpha(tmp_path) -> None:
    path = store(tmp_path / "x", np.array([[[102, 255], [102, 0]]], np.uint8), "PNG")
    apart, within = read_greys(path), read_greys(path, alpha_is_shade=True)
    np.testing.assert_allclose(apart.shade, [[0.4, 0.4]])
    np.testing.assert_array_equal(apart.opaque, [[True, False]])
    np.testing.assert_allclose(within.shade, [[0.55, 0.3]])


def truncated() -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (40, 40), np.uint8)).save(
        stream, "PNG"
    )
    return stream.getvalue()[:-400]


def without_palette(**options: object) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.eye(4, dtype=np.uint8)).convert("P").save(stream, "PNG", **options)
    data = stream.getvalue()
    start = data.index(b"PLTE") - 4
    return data[:start] + data[start + 12 + int.from_bytes(data[start : start + 4]) :]


@pytest.mark.parametrize(
    ("data", "culprit"),
    [
        (without_palette(), "it has no palette"),
        (without_palette(transparency=1), "it has no palette"),
        (b"", "none of these"),
        (b"P2 2 1 255 1", "cannot be read"),
        (b"GIF89a", "none of these"),
        (truncated(), "cannot be read"),
        (b"P5 9000 9000 255\n", f"too large; accepted: at most {PIXEL_LIMIT} pixels"),
        (b"P5 60000 60000 255\n", "too large"),
        (b"Pf 1 1 -1.0\n\0\0\0\0", "pixels of type F"),
    ],
)
def test_images_refused(tmp_path, data, culprit) -> None:
    path = tmp_path / "heights.png"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=culprit) as error:
        read_greys(path)
    assert str(path) in str(error.value)
    assert "accepted" in str(error.value)


@pytest.mark.parametrize("begin", [b"P5\n", b"P5 3\n", b"P5 3 2 ", b"P4 3 "])
@pytest.mark.parametrize("rest", [b"#" + b"x" * HEADER_LIMIT, b"# x\r\n" * HEADER_LIMIT])
def test_a_long_header_is_refused(tmp_path, begin, rest) -> None:
    (tmp_path / "x.pgm").write_bytes(begin + rest + b"\n3 2 255\n" + bytes(6))
    with pytest.raises(ValueError, match=f"its header has more than {HEADER_LIMIT} bytes"):
        read_greys(tmp_path / "x.pgm")


@pytest.mark.parametrize("value", [b"\n", b" ", b"#", b"7", b"\0"])
def test_pixels_are_no_header(tmp_path, value) -> None:
    comment = b"#" + b"x" * (HEADER_LIMIT // 2) + b"\n"
    header = b"P5 " + comment + b"300\n300 # rows\n255\n"
    (tmp_path / "x.pgm").write_bytes(header + value * 90_000)
    np.testing.assert_array_equal(
        read_greys(tmp_path / "x.pgm").shade, np.full((300, 300), np.float32(value[0] / 255))
    )


def test_what_is_no_file_is_refused(tmp_path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path, tmp_path / "absent.png", tmp_path / "pipe"):
        with pytest.raises(ValueError, match=r"not there or not a file\); accepted") as error:
            read_greys(path)
        assert str(path) in str(error.value)
