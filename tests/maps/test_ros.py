import io
import math
import os
import struct
import warnings
import zlib

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image
from tests.maps.refusals import refused

from jaxplore import _files
from jaxplore.maps.files import ros
from jaxplore.maps.files.ros import read_map, write_map
from jaxplore.maps.occupancy_grid import OccupancyGrid

# Most maps here are of a few cells at the thresholds; what is said of them has tests of its own.
DOUBT = ".*(lie at (free|occupied)_thresh|which map savers write|are not opaque)"
pytestmark = pytest.mark.filterwarnings(f"ignore:{DOUBT}:UserWarning")

ENTRIES = {
    "image": "map.pgm",
    "resolution": 0.05,
    "origin": [-1.0, 2.5, 0.25],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
PIXEL = b"P5 1 1 255\n\x00"


def store(folder, picture=PIXEL, /, drop=(), **entries):
    """Write a map of `ENTRIES`, changed by `entries`, and return its YAML's path."""
    settings = {k: v for k, v in {**ENTRIES, **entries}.items() if k not in drop}
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(settings))
    if picture is not None:
        (folder / "map.pgm").write_bytes(picture)
    return path


def encoded(pixels, mode=None, image_format="PNG", **options):
    image = pixels if isinstance(pixels, Image.Image) else Image.fromarray(np.asarray(pixels))
    stream = io.BytesIO()
    (image.convert(mode) if mode else image).save(stream, image_format, **options)
    return stream.getvalue()


def grey_png(depth, width, rows, chunks=()):
    """Return a grey PNG of any bit depth, each row given as bytes."""

    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", width, len(rows), depth, 0, 0, 0, 0)
    pixels = zlib.compress(b"".join(b"\0" + row for row in rows))
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + b"".join(chunk(*c) for c in chunks)
        + chunk(b"IDAT", pixels)
        + chunk(b"IEND", b"")
    )


def values(path):
    probability, _, _ = read_map(path)
    assert probability.dtype == np.float32
    return probability


# Top row of the image first: row 0 of the map is the last one. With the thresholds of ENTRIES,
# occ = 1 - v / 255: 0 -> 1, 89 -> 0.651 (occupied), 90 -> 0.647 (unknown),
# 205 -> 0.19608 (unknown), 206 -> 0.192 (free), 255 -> 0.
GREYS = np.array([[0, 89, 90], [205, 206, 255]], np.uint8)
TRINARY = np.array([[0.5, 0, 0], [1, 1, 0.5]], np.float32)
# occ = v / 255: 165 -> 0.647 (unknown), 166 -> 0.651; 50 -> 0.19608 (unknown), 49 -> 0.192.
NEGATED_GREYS = np.array([[255, 166, 165], [50, 49, 0]], np.uint8)
IMAGES = {
    "pgm": encoded(GREYS, image_format="PPM"),
    "plain_pgm": b"P2\n# made by hand\n3 2 # size\n255\n0 89 90\n# second row\n205 206\n255\n",
    "grey_png": encoded(GREYS),
    "rgb_png": encoded(GREYS, "RGB"),
    "bmp": encoded(GREYS, image_format="BMP"),
    "rgb_bmp": encoded(GREYS, "RGB", "BMP"),
    "palette_png": encoded(Image.fromarray(GREYS).convert("RGB").quantize(8)),
    "wide_pgm": b"P5\n# 16 bits\n3 2\n65535\n" + (GREYS.astype(">u2") * 257).tobytes(),
    "wide_plain_pgm": b"P2 3 2 65535 0 22873 23130 52685 52942 65535",
    "webp": encoded(GREYS, "RGB", "WEBP", lossless=True),
    "wide_png": encoded(GREYS.astype(np.uint16) * np.uint16(257)),
}


@pytest.mark.parametrize("image", IMAGES.values(), ids=IMAGES)
def test_every_image_format_gives_the_same_map(tmp_path, image):
    probability, resolution, origin = read_map(store(tmp_path, image))
    np.testing.assert_array_equal(probability, TRINARY)
    assert probability.flags.c_contiguous
    assert resolution == 0.05
    assert origin == (-1.0, 2.5, 0.25)


@pytest.mark.parametrize("negate", [1, True, "1", "True"])
def test_trinary_negated(tmp_path, negate):
    image = encoded(NEGATED_GREYS)
    np.testing.assert_array_equal(values(store(tmp_path, image, negate=negate)), TRINARY)


@pytest.mark.parametrize(
    ("negate", "expected"),
    [
        # (occ - 0.2) / 0.4 with occ = 1 - v / 255: 128 -> 0.49804 -> 74.5 %; 179 -> 24.5 %.
        (0, [0.75, 0.25, 0, 1, 1, 0.0]),
        # occ = v / 255: 128 -> 0.50196 -> 75.5 %; 179 -> 0.70196 -> 1; 153 -> 0.6 -> 1.
        (1, [0.75, 1, 1, 0, 0, 1]),
    ],
)
def test_scale(tmp_path, negate, expected):
    image = encoded(np.array([[128, 179, 255, 0, 51, 205]], np.uint8))
    path = store(tmp_path, image, mode="scale", negate=negate, free_thresh=0.2, occupied_thresh=0.6)
    np.testing.assert_array_equal(values(path), [np.float32(expected)])


@pytest.mark.parametrize("negate", [0, 1])
def test_raw_ignores_negate(tmp_path, negate):
    image = encoded(np.array([[0, 1, 65, 100, 101, 255]], np.uint8))
    path = store(tmp_path, image, mode="raw", negate=negate)
    np.testing.assert_array_equal(values(path), np.float32([[0, 0.01, 0.65, 1, 0.5, 0.5]]))


# Red, green, blue, alpha. Trinary averages all four: 150 / 255 -> occ 0.412, unknown;
# 63.75 / 255 -> occ 0.75, occupied; 255 -> free; (3 x 200 + 255) / 4 = 213.75 -> 0.162, free;
# the same colour made transparent: 150 -> unknown.
RGBA = np.array(
    [[[100, 150, 95, 255], [0, 0, 0, 255], [255] * 4, [200, 200, 200, 255], [200, 200, 200, 0]]],
    np.uint8,
)


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        ("trinary", [0.5, 1, 0, 0, 0.5]),
        # occ = 1 - 115 / 255 = 0.549 -> (0.549 - 0.196) / 0.454 = 77.8 %; 0.2157 -> 4.3 %.
        ("scale", [0.78, 1, 0, 0.04, 0.5]),
        ("raw", [0.5, 0, 0.5, 0.5, 0.5]),
    ],
)
def test_alpha(tmp_path, mode, expected):
    path = store(tmp_path, encoded(RGBA), mode=mode)
    np.testing.assert_array_equal(values(path), np.float32([expected]))


def nav2_of_2025(pixels, mode, low, high, negate):
    """Read pixels (H, W, 4) as `map_io.cpp` of 2025 does, one at a time; -1 is unknown."""
    cells = []
    for red, green, blue, alpha in pixels.reshape(-1, 4).tolist():
        grey = math.floor(0.212656 * red + 0.715158 * green + 0.072186 * blue + 0.5)
        if mode == "raw":
            cells.append(grey if grey <= 100 else -1)
            continue
        occ = np.float32(grey) / np.float32(255)
        occ = occ if negate else np.float32(1) - occ
        if alpha < 255:
            cells.append(-1)
        elif occ <= np.float32(low):
            cells.append(0)
        elif occ >= np.float32(high):
            cells.append(100)
        elif mode == "trinary":
            cells.append(-1)
        else:
            cells.append(round(100 * (float(occ) - low) / (high - low)))
    return np.array(cells).reshape(pixels.shape[:2])[::-1]


@pytest.mark.parametrize("mode", ["trinary", "Scale", "RAW"])
def test_the_rules_of_2025(tmp_path_factory, mode):
    folder = tmp_path_factory.mktemp("rules")
    greys = st.sampled_from([0, 50, 51, 89, 90, 127, 204, 205, 206, 254, 255])
    pixels = hnp.arrays(np.uint8, (3, 4, 4), elements=greys)
    # 51 / 255 is 0.2 and 204 / 255 is 0.8, where single and double precision differ.
    thresholds = st.sampled_from([(0.196, 0.65), (0.2, 0.8), (0.25, 0.65), (0.0, 1.0)])

    @given(pixels, thresholds, st.booleans(), st.booleans())
    def agrees(picture, bounds, negate, is_grey):
        if is_grey:
            picture = np.concatenate([picture[..., :1]] * 3 + [picture[..., 3:]], axis=-1)
        low, high = bounds
        path = store(
            folder,
            encoded(picture),
            mode=mode,
            negate=negate,
            free_thresh=low,
            occupied_thresh=high,
        )
        expected = nav2_of_2025(picture, mode.lower(), low, high, negate)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found, _, _ = read_map(path, rules="nav2_2025")
        np.testing.assert_array_equal(np.rint(100 * found), np.where(expected < 0, 50, expected))

    agrees()


def test_images_that_lose_detail_keep_walls_and_what_is_free(tmp_path):
    picture = np.full((40, 60), 254, np.uint8)
    picture[:8], picture[-16:] = 0, 205
    for kind in ("JPEG", "WEBP"):
        found = values(store(tmp_path, encoded(picture, "RGB", kind, quality=95)))
        np.testing.assert_array_equal(np.unique(found[-7:]), [1.0])
        np.testing.assert_array_equal(np.unique(found[18:-9]), [0.0])
        np.testing.assert_array_equal(np.unique(found[:14]), [0.5])


def test_comments_in_another_encoding_are_comments(tmp_path):
    path = store(tmp_path)
    text = path.read_bytes()
    path.write_bytes("# cartographié à Zürich\n".encode("latin-1") + text)
    assert values(path).shape == (1, 1)
    path.write_bytes(text.replace(b"map.pgm", "pièce.pgm".encode("latin-1")))
    refused(lambda: read_map(path), path, "a value in it is no text in UTF-8")


GREY_205 = np.full((10, 10), 254, np.uint8)
GREY_205[:4] = 205


@pytest.mark.parametrize(
    ("picture", "entries", "said"),
    [
        (
            GREY_205,
            {"free_thresh": 0.25},
            "40.0 % of the cells have grey 205, .* read as free; unk",
        ),
        (GREY_205, {"negate": 1}, "40.0 % of the cells have grey 205, .* are read as occupied"),
        # Opaque, with the alpha channel as a fourth colour: (3 x 205 + 255) / 4 is 217.5.
        (
            np.stack([GREY_205] * 3 + [np.full_like(GREY_205, 255)], axis=-1),
            {},
            "40.0 % of the cells have grey 205, .* are read as free",
        ),
        # (3 x 254 + 0) / 4 is 190.5, and black stays black.
        (
            np.stack([np.where(GREY_205 == 205, 0, 254)] * 3 + [GREY_205], -1).astype(np.uint8),
            {"free_thresh": 0.3},
            "100.0 % of the cells are not opaque .* rules=nav2_2025, in settings map_file.rules",
        ),
        (
            np.where(GREY_205 == 205, 206, 254).astype(np.uint8),
            {},
            "40.0 % read as free would be unknown one grey level further: they lie at free_thresh "
            "0.196, most of them of grey 206",
        ),
        (
            np.where(np.arange(100).reshape(10, 10) < 3, 89, np.where(GREY_205 == 205, 90, 254)),
            {},
            "3.0 % read as occupied would be unknown and 37.0 % read as unknown would be occupied",
        ),
    ],
)
def test_what_is_read_doubtfully_is_told_in_one_line(tmp_path, picture, entries, said):
    path = store(tmp_path, encoded(picture.astype(np.uint8)), **entries)
    with pytest.warns(UserWarning, match=said) as told:
        read_map(path)
    assert len(told) == 1
    assert str(told[0].message).startswith(str(path))


def test_what_is_meant_is_not_told(tmp_path):
    path = store(tmp_path, encoded(GREY_205))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.unique(values(path)).tolist() == [0.0, 0.5]
        path = store(tmp_path, encoded(GREY_205), free_thresh=0.25)
        found, _, _ = read_map(path, unknown=205)
        np.testing.assert_array_equal(found, np.where(GREY_205[::-1] == 205, 0.5, 0.0))
    for bad in (-1, 256):
        with pytest.raises(ValueError, match=r"unknown is .*; accepted: "):
            read_map(path, unknown=bad)


def test_grey_with_alpha_and_transparent_colours(tmp_path):
    pairs = np.array([[[0, 255], [0, 254], [230, 255]]], np.uint8)
    path = store(tmp_path, encoded(pairs), mode="scale")
    np.testing.assert_array_equal(values(path), np.float32([[1, 0.5, 0]]))
    grey = np.array([[0, 7, 230]], np.uint8)
    palette = Image.fromarray(grey).convert("P")
    transparent = [
        encoded(grey, transparency=7),
        encoded(palette, transparency=7),
        encoded(grey.astype(np.uint16) * np.uint16(257), transparency=7 * 257),
        grey_png(16, 3, [struct.pack(">3H", 0, 7, 60000)], [(b"tRNS", struct.pack(">H", 7))]),
    ]
    for image in transparent:
        path = store(tmp_path, image, mode="scale")
        np.testing.assert_array_equal(values(path), np.float32([[1, 0.5, 0]]))
        # Transparent black: (3 x 7 + 0) / 4. Opaque black: (0 + 255) / 4, occ 0.75 > 0.65.
        path = store(tmp_path, image, mode="trinary", free_thresh=0.3)
        np.testing.assert_array_equal(values(path), np.float32([[1, 1, 0]]))


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (grey_png(1, 4, [b"\x50"]), [[1, 0, 1, 0]]),
        (grey_png(2, 4, [b"\x1b"]), [[1, 1, 0.5, 0]]),
        (encoded(np.array([[0, 255]], np.uint8), "1"), [[1, 0]]),
        (b"P4 4 1\n\xa0", [[1, 0, 1, 0]]),
        (b"P1 4 1\n1 0 1 0\n", [[1, 0, 1, 0]]),
        (b"P6 2 1 255\n" + bytes([0, 0, 90, 255, 255, 90]), [[1, 0.5]]),
        # maxval 100: occ = 1 - v / 100; 35 -> 0.65 exactly, not above; 34 -> 0.66.
        (b"P2 4 1 100 100 35 34 81", [[0, 0.5, 1, 0]]),
        (b"P5 4 1 100\n" + bytes([100, 35, 34, 81]), [[0, 0.5, 1, 0]]),
        (b"P5 3 1 1000\n" + struct.pack(">3H", 1000, 350, 349), [[0, 0.5, 1]]),
        (b"P2 3 1 1000\n1000 350 349", [[0, 0.5, 1]]),
        (b"P5 2 1 1\n\x00\x01", [[1, 0]]),
    ],
)
def test_bit_depths_and_maxval(tmp_path, image, expected):
    np.testing.assert_array_equal(values(store(tmp_path, image)), np.float32(expected))


def test_raw_rounds_half_up(tmp_path):
    # 3 / 10 x 255 = 76.5, which nav2's std::round takes to 77.
    path = store(tmp_path, b"P2 2 1 10 3 0", mode="raw")
    np.testing.assert_array_equal(values(path), np.float32([[0.77, 0]]))


def test_defaults(tmp_path):
    left_out = ("negate", "occupied_thresh", "free_thresh")
    image = encoded(np.array([[0, 89, 90, 191, 192]], np.uint8))
    path = store(tmp_path, image, drop=left_out)
    np.testing.assert_array_equal(values(path), np.float32([[1, 1, 0.5, 0.5, 0]]))


def test_numbers_that_yaml_1_1_reads_as_text(tmp_path):
    path = store(tmp_path)
    path.write_text("image: map.pgm\nresolution: 5e-2\norigin: [1e0, -2, 0]\n")
    assert read_map(path)[1:] == (0.05, (1.0, -2.0, 0.0))


def test_an_absolute_image_may_be_anywhere(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    image = tmp_path / "elsewhere" / "x.pgm"
    image.write_bytes(PIXEL)
    path = store(tmp_path, None, image=str(image))
    assert read_map(path)[0] == 1.0
    path = store(tmp_path, None, image="elsewhere/../elsewhere/x.pgm")
    assert read_map(path)[0] == 1.0


TRINARY_MAPS = hnp.arrays(
    np.float32,
    hnp.array_shapes(min_dims=2, max_dims=2, max_side=6),
    elements=st.sampled_from([0.0, 0.5, 1.0]),
)
ANY_MAPS = hnp.arrays(
    np.float32,
    hnp.array_shapes(min_dims=2, max_dims=2, max_side=6),
    elements=st.floats(0.0, 1.0, width=32),
)
METRES = st.floats(-1e6, 1e6)


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_round_trip(tmp_path_factory, mode):
    folder = tmp_path_factory.mktemp("round_trip")

    @given(TRINARY_MAPS, st.floats(1e-6, 1e6), st.tuples(METRES, METRES, METRES))
    def trips(probability, resolution, origin):
        write_map(folder / "a map.v2.yaml", probability, resolution, origin, mode=mode)
        read, *frame = read_map(folder / "a map.v2.yaml")
        np.testing.assert_array_equal(read, probability)
        assert frame == [resolution, origin]

    trips()


@pytest.mark.parametrize("mode", ["scale", "raw"])
def test_round_trip_to_hundredths(tmp_path_factory, mode):
    path = tmp_path_factory.mktemp("hundredths") / "map.yml"

    @given(ANY_MAPS)
    def trips(probability):
        write_map(path, probability, 0.1, (0.0, 0.0, 0.0), mode=mode)
        assert np.abs(read_map(path)[0] - probability).max() <= 0.005 + 1e-6

    trips()
    percents = np.linspace(0, 1, 101, dtype=np.float32)[None]
    write_map(path, percents, 0.1, (0.0, 0.0, 0.0), mode=mode)
    np.testing.assert_allclose(read_map(path)[0], percents, atol=1e-7)


def test_what_is_written(tmp_path):
    probability = np.array([[0.0, 0.24, 0.25], [0.65, 0.66, 1.0]], np.float32)
    write_map(tmp_path / "map.yaml", probability, 0.05, (1.0, 2.0, 0.5))
    header = yaml.safe_load((tmp_path / "map.yaml").read_text())
    assert header == {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": 0.05,
        "origin": [1.0, 2.0, 0.5],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    image = (tmp_path / "map.pgm").read_bytes()
    assert image.startswith(b"P5")
    assert image.endswith(bytes([205, 0, 0, 254, 254, 205]))
    assert sorted(os.listdir(tmp_path)) == ["map.pgm", "map.yaml"]


def test_the_grid_reads_and_writes(tmp_path):
    grid = OccupancyGrid(TRINARY, 0.05, (1.0, 2.0, 0.5))
    grid.to_ros(tmp_path / "map.yaml")
    again = OccupancyGrid.from_ros(tmp_path / "map.yaml")
    np.testing.assert_array_equal(again.probability, TRINARY)
    np.testing.assert_array_equal(again.frame.origin, grid.frame.origin)


@pytest.mark.parametrize("failing", ["second write", "folder"])
def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch, failing):
    path = tmp_path / "map.yaml"
    if failing == "folder":
        path.mkdir()
    else:
        write_map(path, TRINARY, 0.05, (0.0, 0.0, 0.0))
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.is_file()}
    calls = []

    def fail_second(real):
        def call(*args, **kwargs):
            calls.append(args)
            if len(calls) == 2:
                raise OSError("disk full")
            return real(*args, **kwargs)

        return call

    if failing == "second write":
        monkeypatch.setattr(type(path), "open", fail_second(type(path).open))
    with pytest.raises(OSError):  # noqa: PT011
        write_map(path, 1 - TRINARY, 0.05, (0.0, 0.0, 0.0))
    monkeypatch.undo()
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.is_file()} == before


def test_a_failed_rename_leaves_no_temporary_files(tmp_path, monkeypatch):
    def denied(*args):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(ros.os, "replace", denied)
    with pytest.raises(PermissionError):
        write_map(tmp_path / "map.yaml", TRINARY, 0.05, (0.0, 0.0, 0.0))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"drop": ["image"]}, "image is missing"),
        ({"drop": ["resolution"]}, "resolution is missing"),
        ({"drop": ["origin"]}, "origin is missing"),
        ({"resolution": 0}, "resolution is 0"),
        ({"resolution": -0.05}, "resolution is -0.05"),
        ({"resolution": math.nan}, "resolution is nan"),
        ({"resolution": math.inf}, "resolution is inf"),
        ({"resolution": "fine\nor so"}, "resolution is 'fine"),
        ({"resolution": True}, "resolution is True"),
        ({"resolution": None}, "resolution is None"),
        ({"resolution": 10**400}, "resolution is"),
        ({"resolution": [0.05]}, "resolution is [0.05]"),
        ({"origin": [0.0, 0.0]}, "origin is [0.0, 0.0]"),
        ({"origin": [0.0] * 4}, "origin is [0.0"),
        ({"origin": [0.0, "a", 0.0]}, "origin[1] is 'a'"),
        ({"origin": [0.0, 0.0, math.inf]}, "origin[2] is inf"),
        ({"origin": 3}, "origin is 3"),
        ({"origin": "123"}, "origin is '123'"),
        ({"occupied_thresh": 1.1}, "occupied_thresh is 1.1"),
        ({"free_thresh": -0.1}, "free_thresh is -0.1"),
        ({"free_thresh": math.nan}, "free_thresh is nan"),
        ({"free_thresh": "low"}, "free_thresh is 'low'"),
        ({"free_thresh": 0.65}, "free_thresh is 0.65"),
        ({"free_thresh": 0.9}, "free_thresh is 0.9"),
        ({"mode": "binary"}, "mode is 'binary'"),
        ({"mode": 3}, "mode is 3"),
        ({"mode": ["raw"]}, "mode is ['raw']"),
        ({"negate": 2}, "negate is 2"),
        ({"negate": -1}, "negate is -1"),
        ({"negate": "yes please"}, "negate is 'yes please'"),
        ({"negate": 0.0}, "negate is 0.0"),
        ({"image": None}, "image is None"),
        ({"image": ""}, "image is ''"),
        ({"image": 7}, "image is 7"),
        ({"image": "a\0b"}, "image is"),
        ({"image": "absent.pgm"}, "image is 'absent.pgm'"),
        ({"image": "x" * 5000}, "image is 'xxx"),
        ({"image": "."}, "image is '.'"),
        ({"image": "../map.pgm"}, "outside the map's folder"),
        ({"image": "a/../../map.pgm"}, "outside the map's folder"),
    ],
)
def test_entries_refused(tmp_path, changes, named):
    folder = tmp_path / "maps"
    folder.mkdir()
    (tmp_path / "map.pgm").write_bytes(PIXEL)
    path = store(folder, **changes)
    refused(lambda: read_map(path), path, named, "accepted")


def test_a_link_out_of_the_folder_is_refused(tmp_path):
    folder = tmp_path / "maps"
    folder.mkdir()
    (tmp_path / "secret.pgm").write_bytes(PIXEL)
    (folder / "map.pgm").symlink_to(tmp_path / "secret.pgm")
    refused(lambda: read_map(store(folder, None)), "'map.pgm'", "outside the map's folder")
    (folder / "loop.pgm").symlink_to("loop.pgm")
    refused(lambda: read_map(store(folder, None, image="loop.pgm")), "'loop.pgm'")


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"just words",
        b"- 1\n- 2\n",
        b"a: [1, 2",
        b"\tx: 1",
        b"image: \xff\xfe\n",
        b"\xff\xfe\x00",
        b"? [1]\n: 2\n",
        b"[" * 900_000,
        b"a: 2001-13-45\n",
        b"a: !!int ''\n",
        b"a: !!bool x\n",
        b"a: !!timestamp x\n",
        b"a: !!python/object/apply:os.getcwd []\n",
        b"a: &x [1]\nb: [*x, *x]\n",
        b"\x00\x01\x02",
    ],
)
def test_yaml_refused(tmp_path, text):
    path = tmp_path / "map.yaml"
    path.write_bytes(text)
    refused(lambda: read_map(path), path)


def test_yaml_files_refused(tmp_path):
    refused(lambda: read_map(tmp_path / "absent.yaml"), tmp_path / "absent.yaml")
    refused(lambda: read_map(tmp_path), tmp_path)
    refused(lambda: read_map(tmp_path / "two\nlines.yaml"), r"two\nlines.yaml")
    large = tmp_path / "large.yaml"
    large.write_bytes(b"#" * 1_000_001)
    refused(lambda: read_map(large), large, "100000 bytes")


def test_an_unreadable_yaml_is_refused(tmp_path, monkeypatch):
    path = store(tmp_path)

    def denied(*args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(_files.os, "open", denied)
    refused(lambda: read_map(path), path, "Permission denied")


RGB_NOISE = np.random.default_rng(0).integers(0, 255, (40, 40, 3), np.uint8)


@pytest.mark.parametrize(
    "image",
    [
        b"",
        b"not an image",
        b"P5 2 2 255\n\x00",
        b"P5 2 2 200\n\x00",
        b"P5 2 2 65535\n\x00",
        b"P2 2 2 255\n1 2 3",
        b"P2 2 2 255\n1 2 3 256",
        b"P2 2 2 255\n1 2 3 x",
        b"P5 2 2 0\n\x00\x00\x00\x00",
        b"P5 0 2 255\n",
        b"P5 -2 2 255\n\x00",
        b"P5 2 2",
        b"Pf 1 1 -1.0\n\x00\x00\x00\x00",
        encoded(RGB_NOISE)[:-900],
        encoded(RGB_NOISE)[:20],
        encoded(RGB_NOISE, image_format="BMP")[:-900],
        encoded(RGB_NOISE, image_format="JPEG")[:-900],
        encoded(RGB_NOISE, image_format="WEBP")[:-900],
        encoded(RGB_NOISE, image_format="WEBP")[:24],
        # Libraries of WebP make a decoder with its canvas, here of 16384 x 16384 pixels.
        b"RIFF\x1e\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0" + b"\xff\x3f\0" * 2,
        b"RIFF\x1e\0\0\0WEBPVP8L\x0a\0\0\0\x2f\xff\xff\xff\x0f" + bytes(8),
        b"\xff\xd8" + 101 * b"\xff\xda\0\x08",
        encoded(RGB_NOISE, "P", "GIF"),
        encoded(RGB_NOISE, image_format="TIFF"),
    ],
)
def test_images_refused(tmp_path, image):
    path = store(tmp_path, image)
    refused(lambda: read_map(path), tmp_path / "map.pgm", "accepted")


@pytest.mark.parametrize("side", [8001, 9500, 14000, 60000])
def test_large_images_are_refused_from_their_header(tmp_path, side):
    # 9500 is where Pillow warns and 14000 where it raises; no pixels follow the headers.
    for image in (b"P5 %d %d 255\n" % (side, side), grey_png(8, side, [b""] * side)):
        path = store(tmp_path, image)
        refused(lambda: read_map(path), tmp_path / "map.pgm", "too large", "64000000")  # noqa: B023


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"path": "map.txt"}, "map.txt"),
        ({"path": "map"}, "map"),
        ({"mode": "binary"}, "mode is 'binary'"),
        ({"probability": np.zeros((2, 2, 2), np.float32)}, "shape (2, 2, 2)"),
        ({"probability": np.zeros((0, 2), np.float32)}, "shape (0, 2)"),
        ({"probability": np.full((2, 2), 1.5, np.float32)}, "1.5"),
        ({"probability": np.full((2, 2), np.nan, np.float32)}, "nan"),
        ({"resolution": 0.0}, "resolution is 0.0"),
        ({"resolution": math.nan}, "resolution is nan"),
        ({"origin": (0.0, 0.0)}, "origin is (0.0, 0.0)"),
        ({"origin": (0.0, 0.0, math.inf)}, "origin[2] is inf"),
    ],
)
def test_arguments_of_write_refused(tmp_path, changes, named):
    arguments = {
        "path": "map.yaml",
        "probability": TRINARY,
        "resolution": 0.05,
        "origin": (0.0, 0.0, 0.0),
        **changes,
    }
    arguments["path"] = tmp_path / arguments["path"]
    refused(lambda: write_map(**arguments), named, "accepted")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("aws_small_house/map", (500, 500)),
        ("aws_small_warehouse_005/map", (423, 286)),
        ("levine_lobby/levinelobby", (836, 692)),
        ("nav2_depot/depot", (307, 604)),
        ("nav2_tb3_sandbox/tb3_sandbox", (384, 384)),
        ("nav2_warehouse/warehouse", (1674, 1006)),
        ("turtlebot3_world/map", (384, 384)),
        ("willow_garage_010/willow-2010-02-18-0.10", (608, 566)),
    ],
)
def test_maps_that_others_made(ros_maps, name, shape):
    probability, resolution, _ = read_map(ros_maps / f"{name}.yaml")
    assert probability.shape == shape
    assert resolution in (0.03, 0.05, 0.1)
    assert set(np.unique(probability)) <= {0.0, 0.5, 1.0}
    assert (probability == 0).any()
    assert (probability == 1).any()
