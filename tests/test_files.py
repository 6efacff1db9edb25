"""Files and texts that are not trusted."""

import json
import os
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore import _files
from jaxplore._files import open_regular, parse_json, parse_yaml, read_bytes, read_yaml
from jaxplore.cli._entries import assign_all
from jaxplore.maps.files.images import read_greys
from jaxplore.settings.sections import SETTINGS_LIMIT, read_settings
from jaxplore.study.comparison.maps import MapFile, with_starts
from jaxplore.study.tuning.space import parse_parameter
from jaxplore.study.variants import make_variants


def bomb() -> str:
    lines, last = ["a: &a [x, x, x, x, x, x, x, x, x]"], "a"
    for name in "bcdefghij":
        lines.append(f"{name}: &{name} [{', '.join([f'*{last}'] * 9)}]")
        last = name
    return "\n".join(lines)


REFUSED = {
    "it uses YAML aliases": bomb(),
    "it nests more than 20 deep": "a: " + "[" * 5000 + "]" * 5000,
    "nests more than 20": "\n".join(" " * depth + "a:" for depth in range(1300)),
    "more than 200000 values": "a: [" + "1," * 400_000 + "]",
    "more than 5000 entries": "\n".join(f"{i * (2**61 - 1)}: 1" for i in range(6000)),
    "longer than 10000 characters": "a: " + "1:" * 400_000 + "1",
    "more than one document": "---\n" * 100_000,
    r"cannot be read \(KeyError\)": "map: !!bool foo",
    r"cannot be read \(IndexError\)": 'a: !!int ""',
    r"cannot be read \(AttributeError\)": "a: !!timestamp foo",
    "exponent|digits|int": "a: " + "9" * 9000,
    "could not convert|expected": "a: !!float x",
}


@pytest.mark.parametrize("loader", ["CSafeLoader", "SafeLoader"])
@pytest.mark.parametrize("reason", REFUSED)
def test_intricate_yaml_is_refused_in_one_line(reason, loader, monkeypatch) -> None:
    monkeypatch.setattr(_files, "_LOADER", getattr(yaml, loader))
    if loader == "SafeLoader" and len(REFUSED[reason]) > 10**5:
        pytest.skip("PyYAML without libyaml takes seconds for a text of this length")
    with pytest.raises(ValueError, match=reason) as error:
        parse_yaml(REFUSED[reason], SETTINGS_LIMIT)
    assert "\n" not in str(error.value)


@given(st.text(max_size=60) | st.text("[]{}&*!:-?'\"\\ \nab<|>%@,.0189exn_~", max_size=60))
@settings(max_examples=200, derandomize=True)
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    for parse in (parse_yaml, parse_json):
        try:
            parse(text)
            reason = ""
        except ValueError as error:
            reason = str(error)
        assert "\n" not in reason


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=9),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=8,
)


@given(VALUES)
@settings(max_examples=60, derandomize=True)
def test_what_is_written_is_read(value: object) -> None:
    assert parse_yaml(yaml.safe_dump(value)) == value
    assert parse_json(json.dumps(value)) == value


def test_json_has_limits() -> None:
    assert parse_json(json.dumps([[[1.5, {"a": None}]]])) == [[[1.5, {"a": None}]]]
    for text, reason in (
        ("[" * 200 + "]" * 200, "nests more than 100 deep"),
        ("[" * 100_000 + "]" * 100_000, "RecursionError|recursion|nests"),
        ("9" * 9000, "digits"),
        (" " * 2_000_000, "longer than 1000000 bytes"),
        ("{", "Expecting"),
    ):
        with pytest.raises(ValueError, match=reason):
            parse_json(text)


@pytest.mark.parametrize(
    "read",
    [
        read_settings,
        lambda text: assign_all({}, [f"a={text.read_text()}"]),
        lambda text: make_variants(varied=[f"a={text.read_text()}"]),
        lambda text: parse_parameter(f"a={text.read_text()},1"),
        lambda file: with_starts((MapFile("a", "a", ""),), file),
    ],
)
def test_all_yaml_is_read_with_the_limits(read, tmp_path: Path) -> None:
    for name, text in (("bomb", "[&a [x], *a]"), ("deep", "[" * 5000), ("bool", "!!bool foo")):
        (tmp_path / name).write_text(f"a: {text}" if read is read_settings else text)
        with pytest.raises(ValueError, match=r".") as error:
            read(tmp_path / name)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"P5\n4 3\n255\n\xfe\0\xcd", b"\x89PNG\r\n\x1a\n", b"a: \0"])
def test_what_is_no_text_is_said_so_and_the_yaml_beside_it_is_named(
    tmp_path: Path, content: bytes
) -> None:
    (tmp_path / "map.pgm").write_bytes(content)
    with pytest.raises(ValueError, match=r"not a map's YAML: it (holds what )?is no text"):
        read_yaml(tmp_path / "map.pgm")
    with pytest.raises(ValueError, match=r"map.pgm is not YAML: it (holds what )?is no text"):
        read_settings(tmp_path / "map.pgm")
    (tmp_path / "map.yaml").write_text("image: map.pgm\n")
    with pytest.raises(ValueError, match=r"accepted: .*map.yaml, which is beside it"):
        read_yaml(tmp_path / "map.pgm")


def test_large_settings_are_refused_before_they_are_read(tmp_path: Path) -> None:
    file = tmp_path / "large.yaml"
    file.write_text("# " + "x" * 20_000_000 + "\nmap: office\n")
    with pytest.raises(ValueError, match=r"is too large; accepted: at most 1000000 bytes"):
        read_settings(file)
    # As many settings as fit, which nobody has.
    file.write_text("\n".join(f"s{i}: {{{', '.join(f'k{j}: {j}' for j in range(900))}}}"
                              for i in range(95)))  # fmt: skip
    assert 900_000 < file.stat().st_size < SETTINGS_LIMIT
    assert read_settings(file)["s94"]["k899"] == 899


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes on this system")
def test_pipes_devices_and_folders_are_no_files(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "folder").mkdir()
    names = ["pipe", "link", "loop", "folder", "gone", "x" * 300, "/dev/zero", "\0"]
    for name in names:
        assert open_regular(tmp_path / name) is None
        with pytest.raises(ValueError, match="is not there or not a file; accepted: a thing file"):
            read_bytes(tmp_path / name, "a thing", 10)
        with pytest.raises(ValueError, match="is not there or not a file"):
            read_settings(tmp_path / name)
        with pytest.raises(ValueError, match="not there or not a file"):
            read_greys(tmp_path / name)
    (tmp_path / "file").write_bytes(b"0123456789")
    assert read_bytes(tmp_path / "file", "a thing", 10) == b"0123456789"
    with pytest.raises(ValueError, match="too large; accepted: at most 9 bytes of a thing"):
        read_bytes(tmp_path / "file", "a thing", 9)
