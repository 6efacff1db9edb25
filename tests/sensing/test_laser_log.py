"""Logs in CARMEN's format: what they say is read, and what is no such log is refused in a line."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import jaxplore as jx
from jaxplore.sensing import laser_log, read_laser_log

REAL = Path(__file__).resolve().parents[3] / "shared" / "logs" / "csail.corrected.log"


def line(beams: int = 181, time: float = 1.0, pose=(1.0, 2.0, 0.5), first: float = 0.25) -> str:
    ranges = first + 0.01 * np.arange(beams)
    numbers = [*ranges, *pose, *(0.5 * np.asarray(pose))]
    shown = " ".join(f"{number:.6g}" for number in numbers)
    return f"FLASER {beams} {shown} 7.5 host {time}"


@pytest.fixture
def log(tmp_path: Path):
    def write(*lines: str | bytes) -> Path:
        data = b"\n".join(each if isinstance(each, bytes) else each.encode() for each in lines)
        (tmp_path / "a.log").write_bytes(data)
        return tmp_path / "a.log"

    return write


@pytest.mark.parametrize(
    ("beams", "last", "spacing"), [(180, 89.0, 1.0), (181, 90, 1), (360, 89.5, 0.5), (361, 90, 0.5)]
)
def test_reads_what_is_written(log, beams: int, last: float, spacing: float) -> None:
    found = read_laser_log(
        log(
            "# a comment",
            "PARAM robot_frontlaser_offset 0.1 nodename 0 host 0",
            "ODOM 1 2 3 0 0 0 1.0 host 1.0",
            "FLASERS are no scans",
            line(beams, 2.0),
            b"\xff\xfe\x00",
            line(beams, 2.0, (3.0, 4.0, -1.0), 1.0).replace(" ", "\t") + "\r",
            line(beams, 5.5) + "   ",
        )
    )
    np.testing.assert_array_equal(found.times, [2.0, 2.0, 5.5])
    np.testing.assert_allclose(found.ranges[1], 1.0 + 0.01 * np.arange(beams))
    np.testing.assert_allclose(found.poses[:2], [[1.0, 2.0, 0.5], [3.0, 4.0, -1.0]])
    np.testing.assert_allclose(found.odometry, 0.5 * found.poses)
    np.testing.assert_allclose(
        np.degrees(found.beam_angles), -90.0 + spacing * np.arange(beams), atol=1e-9
    )
    assert np.degrees(found.beam_angles[-1]) == pytest.approx(last)
    assert np.degrees(found.field_of_view) == pytest.approx(last + 90.0)


def test_a_field_of_view_says_the_angles_of_other_lidars(log) -> None:
    path = log(line(5))
    with pytest.raises(ValueError, match=r"line 1 has 5 beams; accepted: 180, 181, 360, 361, or"):
        read_laser_log(path)
    found = read_laser_log(path, field_of_view=2.0)
    np.testing.assert_allclose(found.beam_angles, [-1.0, -0.5, 0.0, 0.5, 1.0])
    circle = read_laser_log(path, field_of_view=math.tau)
    np.testing.assert_allclose(circle.beam_angles, jx.Lidar(5, 5.0).beam_angles, rtol=1e-6)
    single = read_laser_log(log(line(1)), field_of_view=2.0)
    np.testing.assert_array_equal(single.beam_angles, [0.0])


def test_its_scans_are_scans_of_a_sensor(log) -> None:
    lidar = jx.Lidar(num_beams=181, max_range=1.5, field_of_view=math.pi)
    far = line().replace(" 0.3 ", " 81.91 ", 1)
    found = read_laser_log(log(line(), far))
    scan = found.scan(0, lidar)
    np.testing.assert_allclose(scan.ranges, np.minimum(found.ranges[0], 1.5), rtol=1e-6)
    np.testing.assert_array_equal(scan.is_return, found.ranges[0] <= 1.5)
    # No echo: free up to the range.
    scan = found.scan(1, lidar)
    assert float(scan.ranges[5]) == 1.5
    assert not bool(scan.is_return[5])
    # Not even a sensor with a longer range takes it for a wall.
    assert not bool(found.scan(1, jx.Lidar(181, 100.0, math.pi)).is_return[5])
    for index in (-1, 2):
        with pytest.raises(ValueError, match=r"^index is"):
            found.scan(index, lidar)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([""], "has no scan; accepted: a CARMEN log with lines FLASER"),
        (["ODOM 1 2 3 0 0 0 1.0 host 1.0"], "has no scan"),
        (["x,y", "1,2"], "has no scan"),
        ([b"\x89PNG\r\n\x1a\n\x00\x00"], "has no scan"),
        (["FLASER "], "line 1 has no beams; accepted: a whole number from 1 to 100000"),
        (["FLASER 1e2 1"], "line 1 has '1e2' beams"),
        (["FLASER -3 1"], "line 1 has '-3' beams"),
        (["FLASER 0 1"], "line 1 has '0' beams"),
        (["FLASER " + "9" * 5000], "line 1 has '999"),
        (["FLASER \u0663 1"], r"line 1 has '.*xd9.*xa3' beams"),
        ([line(), line() + " 1"], "line 2 has 193 columns; accepted: 192: FLASER, the number n"),
        (["#", line()[:-9]], "line 2 has 190 columns; accepted: 192"),
        ([line(181), line(180)], "line 2 has 180 beams; accepted: 181, as in the lines before"),
        ([line().replace("0.3", "nan")], "line 1 has 'nan' among its numbers; accepted: finite"),
        ([line().replace("0.3", "-inf")], "line 1 has '-inf' among its numbers"),
        ([line().replace("0.3", "1e999")], "line 1 has '1e999' among its numbers"),
        ([line().replace("0.3", "1_0")], "line 1 has '1_0' among its numbers"),
        ([line().replace("0.3", "0x1")], "line 1 has '0x1' among its numbers"),
        ([line().replace("0.3", "-0.3")], "line 1 has a range of -0.3 m; accepted: 0 to 10000 m"),
        ([line().replace("0.3", "1e5")], "line 1 has a range of 100000 m; accepted: 0 to 10000 m"),
        ([line(pose=(1e7, 0, 0))], r"line 1 has a pose with 1e\+07; accepted: numbers up to"),
        ([line(time=math.nan)], "line 1 has 'nan' among its numbers"),
        ([line(time=2.0), "", line(time=1.5)], "line 3 has the time 1.5; accepted: at least 2"),
        (
            [line(pose=(3.0, 2.0, 0.0)), line(pose=(0.0, 2.0, 0.0)), line(pose=(8.0, 8.1, 0.0))],
            "line 3 has the time of the scan before, 10.1 m away; accepted: at most 10 m",
        ),
    ],
)
def test_what_is_no_log_is_refused(log, lines, said: str) -> None:
    path = log(*lines)
    with pytest.raises(ValueError, match=said) as caught:
        read_laser_log(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_what_is_no_file_is_refused(tmp_path: Path, log, monkeypatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name in ("missing", "", "pipe", "a\0b"):
        with pytest.raises(ValueError, match="is not there or not a file; accepted: a CARMEN log"):
            read_laser_log(tmp_path / name)
    path = log(line(), line(), line())
    monkeypatch.setattr(laser_log, "MOST_SCANS", 2)
    with pytest.raises(ValueError, match="line 3 is one scan too many; accepted: at most 2"):
        read_laser_log(path)
    monkeypatch.setattr(laser_log, "LOG_LIMIT", 100)
    with pytest.raises(ValueError, match="is too large; accepted: at most 100 bytes"):
        read_laser_log(path)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=200)
@given(st.data())
def test_a_damaged_log_is_read_or_refused(log, data) -> None:
    """Bytes are changed, taken out and put in anywhere."""
    whole = f"# a\n{line(3, 1.0)}\nODOM 0 0 0\n{line(3, 2.0)}\n".encode()
    at = data.draw(st.integers(0, len(whole)))
    taken = data.draw(st.integers(0, 40))
    pieces = st.sampled_from([b"\n", b" ", b"FLASER", b"nan", b"1e400", b"-", b"9" * 400, b"\xff"])
    put = data.draw(st.one_of(st.binary(max_size=4), pieces))
    said, found = "", None
    try:
        found = read_laser_log(log(whole[:at] + put + whole[at + taken :]), field_of_view=1.0)
    except ValueError as error:
        said = str(error)
    assert "\n" not in said
    if found is None:
        return
    number, beams = found.ranges.shape
    assert found.poses.shape == found.odometry.shape == (number, 3)
    assert found.times.shape == (number,)
    assert all(np.isfinite(part).all() for part in found[:4])
    assert (found.ranges >= 0.0).all()
    assert (np.diff(found.times) >= 0.0).all()
    assert number >= 1
    assert beams >= 1


def test_a_real_log_whose_lines_were_mixed_is_refused(tmp_path: Path) -> None:
    """Its times have six digits: two for 406 scans."""
    if not REAL.is_file():
        pytest.skip(f"no log at {REAL}")
    lines = [each for each in REAL.read_text("ascii").splitlines() if each.startswith("FLASER")]
    for first, last in ((0, 406), (0, 60), (150, 300)):
        mixed = np.random.default_rng(first).permutation(np.asarray(lines[first:last], object))
        path = tmp_path / f"{first}.log"
        path.write_text("\n".join(mixed), "ascii")
        with pytest.raises(ValueError, match=r"line \d+ has the time"):
            read_laser_log(path)


def test_the_angles_of_a_real_log_make_sharp_walls() -> None:
    """A building is in its 361 beams: with other angles its walls spread over more cells."""
    if not REAL.is_file():
        pytest.skip(f"no log at {REAL}")
    found = read_laser_log(REAL)
    assert found.ranges.shape == (406, 361)
    is_near = found.ranges < 8.0

    def cells(turn: float) -> int:
        angles = found.poses[:, 2:] + found.beam_angles + turn
        x = found.poses[:, :1] + found.ranges * np.cos(angles)
        y = found.poses[:, 1:2] + found.ranges * np.sin(angles)
        return len(np.unique(np.floor(np.stack([x, y], -1)[is_near] / 0.1), axis=0))

    assert cells(0.0) < 0.9 * min(cells(math.radians(-1.0)), cells(math.radians(1.0)))
