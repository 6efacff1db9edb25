"""Bad content of files: texts that no parser should choke on, wrong entries, damaged images."""

import functools
import io
import json
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from . import places

Found = Iterator[tuple[str, list[str], Callable[[Path], None] | None]]


def writing(files: Mapping[str, bytes | str]) -> Callable[[Path], None]:
    """Return a function that writes files into a folder."""

    def write(folder: Path) -> None:
        for name, content in files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content.encode() if isinstance(content, str) else content)

    return write


def bomb(levels: int = 9, width: int = 9) -> str:
    """Return YAML whose aliases expand to `width ** levels` entries."""
    lines = ["a0: &a0 [" + ", ".join(["1"] * width) + "]"]
    for level in range(1, levels):
        inner = ", ".join([f"*a{level - 1}"] * width)
        lines.append(f"a{level}: &a{level} [{inner}]")
    return "\n".join(lines) + f"\nseed: *a{levels - 1}\n"


TEXTS: dict[str, bytes | str] = {
    "empty": "",
    "space": " \n\n",
    "null": "null",
    "a number": "3",
    "a list": "[1, 2]",
    "a text": "map",
    "an alias bomb": bomb(),
    "an alias bomb of mappings": "a: &a {x: 1}\nb: &b {<<: [*a, *a, *a], y: *a}\nseed: *b\n",
    "an alias to itself": "seed: &s [*s]\n",
    "a mapping with itself": "&m\nseed: 1\nrobot: *m\n",
    "an undefined alias": "seed: *nothing\n",
    "two anchors of a name": "seed: &a 1\nresolution: &a 0.1\ntime_limit: *a\n",
    "a flow nested 5000 deep": "seed: " + "[" * 5000 + "]" * 5000,
    "mappings nested 3000 deep": "seed: " + "{a: " * 3000 + "1" + "}" * 3000,
    "blocks nested 800 deep": "\n".join("  " * i + "a:" for i in range(800)),
    "an open flow": "seed: " + "[" * 2000,
    "dashes": "- " * 3000 + "1",
    "question marks": "? " * 2000 + "a",
    "a megabyte of settings": "".join(f"name{i}: {i}\n" for i in range(80_000)),
    "a comment of 20 MB": "# " + "x" * 20_000_000 + "\nseed: 1\n",
    "a line of 3 MB": "seed: " + "9" * 3_000_000,
    "a number of 5000 digits": "seed: " + "9" * 5000,
    "a key of 100 kB": "k" * 100_000 + ": 1\n",
    "a bool that is none": "seed: !!bool foo\n",
    "an int that is none": "seed: !!int foo\n",
    "an int of nothing": "seed: !!int ''\n",
    "a float that is none": "seed: !!float foo\n",
    "a float of nothing": "seed: !!float ''\n",
    "a timestamp that is none": "seed: !!timestamp foo\n",
    "a date": "seed: 2024-02-31\n",
    "a time": "seed: 2024-01-01T99:99:99Z\n",
    "a binary": "seed: !!binary '%%%'\n",
    "a set": "seed: !!set {a, b}\n",
    "a set of a list": "seed: !!set [a]\n",
    "an omap": "seed: !!omap [a, b]\n",
    "pairs": "seed: !!pairs [a: 1, a: 2]\n",
    "pairs of numbers": "seed: !!pairs [1]\n",
    "an own tag": "seed: !mine 3\n",
    "an object": "seed: !!python/object/apply:os.getcwd []\n",
    "a name of Python": "seed: !!python/name:os.system ''\n",
    "a tag of a scheme": "seed: !<tag:x.y,2000:z> 3\n",
    "a broken tag": "seed: !<> 3\n",
    "a null tag of a mapping": "!!null {a: 1}\n",
    "a merge of a number": "<<: 3\nseed: 1\n",
    "a merge of numbers": "<<: [1, 2]\nseed: 1\n",
    "a value key": "=: 3\n",
    "a value": "seed: =\n",
    "a list as a key": "? [1, 2]\n: 3\n",
    "a mapping as a key": "{{a: 1}: 2}\n",
    "a null key": "null: 3\n",
    "a number as a key": "1: 3\n1.5: 2\ntrue: 1\n",
    "a date as a key": "2024-01-01: 3\n",
    "not a number": "seed: .nan\nresolution: .inf\n",
    "sixties": "seed: 190:20:30\nresolution: 1:30.5\n",
    "octal and hexadecimal": "seed: 0o17\nresolution: 0x1G\n",
    "a binary number": "seed: 0b\n",
    "a huge exponent": "resolution: 1e999999999\n",
    "two documents": "seed: 1\n---\nseed: 2\n",
    "a directive": "%YAML 9.9\n---\nseed: 1\n",
    "two directives": "%YAML 1.1\n%YAML 1.1\n---\nseed: 1\n",
    "an unknown handle": "%TAG ! x\n---\nseed: !e!x 1\n",
    "a tab": "robot:\n\tradius: 1\n",
    "an open quote": 'seed: "1\n',
    "an open list": "seed: [1\n",
    "a bad escape": 'seed: "\\q"\n',
    "a lone surrogate": 'map: "\\ud800"\n',
    "a wide escape": 'map: "\\UFFFFFFFF"\n',
    "an escape of NUL": 'map: "a\\0b"\n',
    "an escape sequence": 'map: "\\e[31mred"\n"\\e[2J": 1\n',
    "a bell": b"seed: \x07\n",
    "NUL": b"seed: 1\x00\n",
    "not UTF-8": b"\xff\xfe\x00\x80",
    "half of a character": b"map: \xc3",
    "UTF-16": "seed: 1\n".encode("utf-16"),
    "UTF-32": "seed: 1\n".encode("utf-32"),
    "a mark of UTF-8": b"\xef\xbb\xbfseed: 1\n",
    "zeros": bytes(5000),
    "JSON": json.dumps({"seed": "\ud800"}),
    "a repeated key": "seed: 1\nseed: 2\n",
    "markup": "'[/red]': 1\n'[bold': 2\n",
    "a right-to-left mark": "map: \u202egpj.exe\n",
    "a literal block": "map: |9\n x\n",
    "a folded block": "map: >-0\n x\n",
}
"""Texts of which none is a sensible file of anything."""

READERS: dict[str, tuple[str, list[str]]] = {
    "settings": ("s.yaml", ["run", "office", "--settings", "s.yaml"]),
    "a map": ("s.yaml", ["run", "s.yaml"]),
    "a path": ("s.yaml", ["run", "--path", "s.yaml"]),
    "a CSV path": ("s.csv", ["run", "--path", "s.csv"]),
    "parameters of nav2": ("s.yaml", ["import-nav2", "s.yaml"]),
    "starts": ("s.yaml", ["compare", "--maps", "{base}/maps", "--starts", "s.yaml"]),
    "a variant": ("s.yaml", ["compare", "office", "--variants", "s.yaml"]),
    "another scenario": (
        "s.yaml",
        ["tune", "office", "--tune", "controller.temperature", "--also", "s.yaml"],
    ),
    "settings of a node": ("s.yaml", ["node", "--settings", "s.yaml"]),
}
"""Commands that read a text, and the file that it stands in."""


def texts() -> Found:
    """Yield every text for every reader, and as the value of `--set`."""
    for name, text in TEXTS.items():
        for reader, (file, arguments) in READERS.items():
            yield f"{name} as {reader}", arguments, writing({file: text})
        if isinstance(text, str) and len(text) < 100_000 and "\0" not in text:
            _, _, value = text.partition(": ")
            yield f"{name} in --set", ["run", "office", "--set", f"seed={value or text}"], None


VALUES: dict[str, Any] = {
    "null": None,
    "true": True,
    "a text": "many",
    "an empty text": "",
    "minus one": -1,
    "zero": 0,
    "half": 0.5,
    "huge": 1e308,
    "a googol": 10**100,
    "not a number": float("nan"),
    "infinite": float("inf"),
    "a list": [1, 2],
    "an empty list": [],
    "lists": [[1.0, 2.0], [3.0]],
    "a mapping": {"a": 1},
    "an empty mapping": {},
    "a long list": [0.5] * 3000,
    "a long text": "x" * 3000,
    "markup": "[/red]\x1b[31m",
}
"""Values of another type or size than an entry has."""

DOCUMENTS: dict[str, tuple[dict[str, Any], list[str]]] = {
    "map": (places.MAP, ["run", "d.yaml", "--start", "1", "1.5", "0"]),
    "world": (places.WORLD, ["run", "d.yaml"]),
    "nav2": (places.NAV2, ["import-nav2", "d.yaml"]),
    "settings": (places.SETTINGS, ["run", "{base}/room.yaml", "--settings", "d.yaml"]),
    "node": (places.NODE, ["node", "--settings", "d.yaml"]),
    "path": (places.POSES, ["run", "--path", "d.yaml"]),
}
"""Valid files by kind, and the commands that read them."""


def entries() -> Found:
    """Yield every entry of every kind of file with every value, missing, and beside a stranger."""
    for kind, (document, arguments) in DOCUMENTS.items():
        for where in list(_paths(document)):
            label = ".".join(map(str, where))
            changed = {name: _with(document, where, value) for name, value in VALUES.items()}
            changed["missing"] = _with(document, where, _MISSING)
            for name, whole in changed.items():
                yield f"{kind} {label}: {name}", arguments, _document(kind, whole)
        yield f"{kind} and a stranger", arguments, _document(kind, {**document, "stranger": 1})


_MISSING = object()


def _document(kind: str, document: Any) -> Callable[[Path], None]:
    # Written when the case is run: there are thousands.
    def write(folder: Path) -> None:
        files: dict[str, bytes | str] = {"d.yaml": yaml.safe_dump(document, sort_keys=False)}
        if kind == "map":
            files["map.pgm"] = encoded("PPM")
        writing(files)(folder)

    return write


def _paths(value: Any, where: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        yield (*where, key)
        if isinstance(inner, dict | list) and inner:
            yield from _paths(inner, (*where, key))


def _with(document: Any, where: tuple[Any, ...], value: Any) -> Any:
    """Return a copy of a document with another value in one place."""
    first, *rest = where
    copied = dict(document) if isinstance(document, dict) else list(document)
    if rest:
        copied[first] = _with(copied[first], tuple(rest), value)
    elif value is _MISSING:
        del copied[first]
    else:
        copied[first] = value
    return copied


@functools.cache
def encoded(kind: str) -> bytes:
    """Return the picture of the room in an image format."""
    stream = io.BytesIO()
    places.room_image().save(stream, kind)
    return stream.getvalue()


def png(*chunks: tuple[bytes, bytes]) -> bytes:
    """Return a PNG of chunks with their kinds, lengths and checksums."""
    whole = b"\x89PNG\r\n\x1a\n"
    for kind, data in chunks:
        whole += struct.pack(">I", len(data)) + kind + data
        whole += struct.pack(">I", zlib.crc32(kind + data))
    return whole


def _header(width: int, height: int, depth: int, colour: int) -> tuple[bytes, bytes]:
    return b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)


_ZEROS = zlib.compress(bytes(5_000_000))
_PIXELS = (b"IDAT", zlib.compress(b"\0\0" * 4))
_END = (b"IEND", b"")
IMAGES: dict[str, bytes] = {
    "empty": b"",
    "a text": b"this is no image",
    "PGM without pixels": b"P5 40 30 255\n",
    "PGM of nothing": b"P5 0 0 255\n",
    "PGM of a negative width": b"P5 -4 3 255\n" + bytes(12),
    "PGM of maxval 0": b"P5 4 3 0\n" + bytes(12),
    "PGM of maxval 70000": b"P5 4 3 70000\n" + bytes(24),
    "PGM of a huge width": b"P5 99999999999 3 255\n" + bytes(12),
    "PGM of 8000 x 8000": b"P5 8000 8000 255\n" + bytes(64),
    "PGM of a million digits": b"P5 " + b"9" * 1_000_000,
    "PGM with a comment of 5 MB": b"P5\n#" + b"x" * 5_000_000 + b"\n4 3 255\n" + bytes(12),
    "plain PGM of letters": b"P2 4 3 255\n" + b"a b c d " * 3,
    "plain PGM of large numbers": b"P2 4 3 255\n" + b"9999999999999999999999 " * 12,
    "PBM": b"P4 4 3\n" + bytes(3),
    "PFM": b"Pf 4 3 -1.0\n" + bytes(48),
    "PAM": b"P7\nWIDTH 4\nHEIGHT 3\nDEPTH 9\nMAXVAL 255\nTUPLTYPE X\nENDHDR\n" + bytes(108),
    "PNG of 65500 x 65500": png(_header(65500, 65500, 1, 0), _PIXELS, _END),
    "PNG of 4 thousand million": png(_header(2**31 - 1, 2**31 - 1, 8, 0), _PIXELS, _END),
    "PNG of nothing": png(_header(0, 0, 8, 0), _PIXELS, _END),
    "PNG of depth 3": png(_header(4, 1, 3, 0), _PIXELS, _END),
    "PNG of colour 9": png(_header(4, 1, 8, 9), _PIXELS, _END),
    "PNG without pixels": png(_header(4, 4, 8, 0), _END),
    "PNG without an end": png(_header(4, 1, 8, 0), _PIXELS),
    "PNG without a palette": png(_header(4, 1, 8, 3), _PIXELS, _END),
    "PNG of an empty palette": png(_header(4, 1, 8, 3), (b"PLTE", b""), _PIXELS, _END),
    "PNG of half a palette": png(_header(4, 1, 8, 3), (b"PLTE", b"\0" * 4), _PIXELS, _END),
    "PNG of a text of zeros": png(
        _header(4, 1, 8, 0),
        (b"zTXt", b"k\0\0" + _ZEROS),
        _PIXELS,
        _END,
    ),
    "PNG with a broken checksum": encoded("PNG")[:40] + b"\0\0\0" + encoded("PNG")[43:],
    "half a PNG": encoded("PNG")[:60],
    "half a BMP": encoded("BMP")[:60],
    "BMP of a palette of 0": encoded("BMP")[:46] + b"\xff\xff\xff\x7f" + encoded("BMP")[50:],
    "half a PGM": encoded("PPM")[:60],
    "GIF": encoded("GIF"),
    "TIFF": encoded("TIFF"),
    "half a TIFF": encoded("TIFF")[:30],
    "EPS": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n",
    "SVG": b"<svg xmlns='http://www.w3.org/2000/svg'/>",
    "ICO": b"\0\0\1\0\1\0\0\0\0\0\1\0\x20\0\xff\xff\xff\xff\x16\0\0\0",
    "PSD": b"8BPS\0\1"
    + bytes(6)
    + b"\0\3"
    + struct.pack(">II", 2**31 - 1, 2**31 - 1)
    + b"\0\10\0\3",
    "WebP": b"RIFF\xff\xff\xff\xffWEBPVP8 \xff\xff\xff\xff",
    "JPEG 2000": b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(40),
    "zip": b"PK\3\4" + bytes(60),
}
"""Images that are none, too large, damaged, or of a kind that no map has."""


def images() -> Found:
    """Yield every image as a map and as a height map, under three endings."""
    for name, data in IMAGES.items():
        for ending in ("pgm", "png", "bmp"):
            described = yaml.safe_dump(places.MAP | {"image": f"i.{ending}"})
            files = {"m.yaml": described, f"i.{ending}": data}
            yield f"{name} as .{ending}", ["run", "m.yaml"], writing(files)
        arguments = ["run", "{base}/map.yaml", "--set", "terrain.height_map=h.png"]
        yield f"{name} as height map", arguments, writing({"h.png": data})
        arguments = ["compare", "--maps", ".", "--architectures", "explorer"]
        yield f"{name} in a folder", arguments, writing(files)
