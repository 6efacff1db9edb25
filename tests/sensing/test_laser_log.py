"""Logs in CARMEN's format: what they say is read, and what is no such log is refused in a line."""

import gzip
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest

import jaxplore as jx
from jaxplore.sensing import carmen, laser_log, read_laser_log

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
    with pytest.raises(
        ValueError, match=r"line 1 has 5 beams; accepted: 180, 181, .*, 1081, or any"
    ):
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


BAD = [
    ("FLASER ", "has no beams; accepted: a whole number from 1 to 100000"),
    ("FLASER 1e2 1", "has '1e2' beams"),
    ("FLASER -3 1", "has '-3' beams"),
    ("FLASER 0 1", "has '0' beams"),
    ("FLASER " + "9" * 5000, "has '999"),
    ("FLASER \u0663 1", r"has '.*xd9.*xa3' beams"),
    (line() + " 1", "has 193 columns; accepted: 192: FLASER, the number n"),
    (line()[:500], "has 103 columns; accepted: 192"),
    ("flaser 181 " + "1 " * 186, "has 188 columns; accepted: 192: FLASER"),
    (line().replace("0.3", "nan"), "has 'nan' among its numbers; accepted: finite"),
    (line().replace("0.3", "-inf"), "has '-inf' among its numbers"),
    (line().replace("0.3", "1e999"), "has '1e999' among its numbers"),
    (line().replace("0.3", "1_0"), "has '1_0' among its numbers"),
    (line().replace("0.3", "0x1"), "has '0x1' among its numbers"),
    (line().replace("0.3", "-0.3"), "has a range of -0.3 m; accepted: 0 to 10000 m"),
    (line().replace("0.3", "1e5"), "has a range of 100000 m; accepted: 0 to 10000 m"),
    (line(pose=(1e7, 0, 0)), r"has a pose with 1e\+07; accepted: up to"),
    (line(time=math.nan).replace("7.5", "host"), "has 'nan' among its numbers"),
    ("FLASER 3 " + "1 " * 3_000_000, "has 6000009 bytes; accepted: at most 4000000"),
]
"""Lines that are no scan, and what they have instead."""


@pytest.mark.parametrize(("bad", "said"), BAD)
def test_bad_lines_are_left_out_and_counted(log, bad: str, said: str) -> None:
    """Between good ones; without good ones, and with more of them, the log is refused."""
    found = read_laser_log(log(line(time=1.0), bad, line(time=2.0)))
    np.testing.assert_array_equal(found.times, [1.0, 2.0])
    assert sum(number for _, number in found.left_out) == 1
    assert re.search(f"1 of 3 lines FLASER were left out: 1 by their .* .line 2 {said}", found.news)
    for lines in ([bad], [bad, line(), bad]):
        path = log(*lines)
        with pytest.raises(ValueError, match=f"line 1 {said}") as caught:
            read_laser_log(path)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 450


@pytest.mark.parametrize(
    "lines",
    [
        [""],
        ["ODOM 1 2 3 0 0 0 1.0 host 1.0"],
        ["x,y", "1,2"],
        [b"\x89PNG\r\n\x1a\n\x00\x00"],
        ["VERTEX_SE2 0 0 0 0", "EDGE_SE2 0 1 0.5 0 0 500 0 0 500 0 500"],
    ],
)
def test_what_is_no_log_is_refused(log, lines) -> None:
    with pytest.raises(ValueError, match="has no scan; accepted: a CARMEN log with lines FLASER"):
        read_laser_log(log(*lines))


def test_scans_that_others_disagree_with_are_left_out(log) -> None:
    """A clock that went back or ahead, another number of beams, a place far away."""
    lines = [line(time=float(time), pose=(0.1 * time, 0.0, 0.0)) for time in range(40)]
    lines[10] = line(time=5.5, pose=(1.0, 0.0, 0.0))
    lines[20] = line(time=4.29497e9, pose=(2.0, 0.0, 0.0))
    lines[25] = line(180, 25.0, (2.5, 0.0, 0.0))
    lines[30] = line(time=30.0, pose=(99.0, 0.0, 0.0))
    found = read_laser_log(log(*lines))
    kept = [time for time in range(40) if time not in (10, 20, 25, 30)]
    np.testing.assert_array_equal(found.times, kept)
    assert found.left_out == (("beams", 1), ("positions", 1), ("times", 2))
    assert "line 11 has the time 5.5; accepted: at least 9" in found.news
    assert "line 31 has a position 96.1 m and 1 s after" in found.news
    # The same for the first scan, and where most scans have the other number.
    assert read_laser_log(log(lines[20], *lines[:8])).times[0] == 0.0
    found = read_laser_log(log(line(180), line(181, 2.0), line(181, 3.0)))
    assert found.ranges.shape == (2, 181)
    # Equal times say nothing about the order, the way of the robot does.
    away = [line(time=1.0, pose=(11.0 * step, 0.0, 0.0)) for step in range(12)]
    with pytest.raises(
        ValueError, match=r"has a position 11\.0 m and 0 s after that of the scan be"
    ):
        read_laser_log(log(*away))


def long_line(kind: str, time: float, pose=(1.0, 2.0, 0.5), beams: int = 181) -> str:
    """Return a line of a kind that describes its lidar, with the same ranges as `line`."""
    ranges = " ".join(f"{each:.6g}" for each in 0.25 + 0.01 * np.arange(beams))
    lidar = f"0 -1.570796 3.141593 0.017453 2.0 0.01 0 {beams} {ranges} 2 7 9"
    if kind.startswith("RAW"):
        return f"{kind} {lidar} {time} host {time}"
    ahead = (pose[0] + 0.2 * math.cos(pose[2]), pose[1] + 0.2 * math.sin(pose[2]), pose[2])
    shown = " ".join(f"{each:.6f}" for each in [*ahead, *pose])
    return f"{kind} {lidar} {shown} 0.1 0 0.3 0.3 1000 {time} host {time}"


POSES = [(0.5 * step, 0.1 * step, 0.05 * step) for step in range(4)]
ODOM = [f"ODOM {x} {y} {yaw} 0.1 0 0 {2.0 * i} h {2.0 * i}" for i, (x, y, yaw) in enumerate(POSES)]


@pytest.mark.parametrize(
    ("kind", "turn", "offset"),
    [
        ("RLASER", 0.0, 0.0),
        ("ROBOTLASER1", 0.0, 0.2),
        ("ROBOTLASER2", 0.0, 0.2),
        ("RAWLASER1", 0.0, 0.3),
        ("RAWLASER2", math.pi, -0.1),
        ("RAWLASER5", math.pi, -0.1),
        ("LASER_READING", 0.0, 0.0),
    ],
)
def test_every_kind_of_line_is_read(log, kind: str, turn: float, offset: float) -> None:
    """The scan and the pose of the lidar are those that were written."""
    params = ["PARAM robot_frontlaser_offset 0.3 h 0", "PARAM robot_rearlaser_offset -0.1 h 0"]
    times = (0.0, 2.0, 3.0, 6.0)
    expected = [*POSES[:2], np.mean(POSES[1:3], axis=0), POSES[3]]
    if kind == "RLASER":
        lines = [
            line(time=t, pose=p).replace("FLASER", kind)
            for t, p in zip(times, expected, strict=True)
        ]
    elif kind == "LASER_READING":
        lines = [
            " ".join([kind, *line(pose=p).split()[1:183], *map(str, p), str(t)])
            for t, p in zip(times, expected, strict=True)
        ]
    else:
        lines = [long_line(kind, t, p) for t, p in zip(times, expected, strict=True)]
    found = read_laser_log(log(*params, *ODOM[:2], *lines, *ODOM[2:]))
    assert found.kind == kind
    np.testing.assert_array_equal(found.times, times)
    # From the greatest reading of the lidar on, a beam met nothing.
    wanted = 0.25 + 0.01 * np.arange(181)
    is_far = (wanted >= 2.0) & ("LASER_R" not in kind) & (kind != "RLASER")
    np.testing.assert_array_equal(found.ranges >= laser_log.NO_ECHO, [is_far] * 4)
    np.testing.assert_allclose(found.ranges[:, ~is_far], [wanted[~is_far]] * 4)
    ahead = [[offset * math.cos(yaw), offset * math.sin(yaw), turn] for *_, yaw in expected]
    np.testing.assert_allclose(found.poses, np.add(expected, ahead), atol=1e-5)
    assert found.is_corrected == (kind == "RLASER")
    np.testing.assert_allclose(found.beam_angles, np.radians(np.arange(-90, 91)), atol=1e-3)


def test_one_lidar_of_several_is_read(log) -> None:
    rear = [line(time=t).replace("FLASER", "RLASER") for t in (1.0, 2.0)]
    found = read_laser_log(log(*rear, line(180, 3.0)))
    assert (found.kind, found.ranges.shape) == ("FLASER", (1, 180))
    found = read_laser_log(log(*rear, *rear, line(180, 3.0)))
    assert (found.kind, found.ranges.shape) == ("RLASER", (3, 181))
    with pytest.raises(ValueError, match="has RAWLASER1 without a pose; accepted: a log with line"):
        read_laser_log(log(long_line("RAWLASER1", 1.0)))


def test_other_texts_and_packings_are_read(log, tmp_path: Path) -> None:
    """Old endings of lines, UTF-16, gzip whole, in parts and cut off."""
    text = line(time=1.0) + "\n" + line(time=2.0) + "\n"
    for ending in (" 0 0 1.5", " 1.5 nohost", " 1.5 nohost 1.5", " 1.5"):
        changed = text.replace(" 7.5 host 1.0", ending)
        assert read_laser_log(log(changed)).times[0] == 1.5 if "0 0" not in ending else True
    packed = gzip.compress(text.encode())
    parts = gzip.compress(text[:900].encode()) + gzip.compress(text[900:].encode())
    for data in (text.encode("utf-16"), b"\xef\xbb\xbf" + text.encode(), packed, parts):
        assert len(read_laser_log(log(data)).times) == 2
    random = np.random.default_rng(0).uniform(0.5, 9.0, (40, 181))
    many = [
        line(time=float(i)).replace(line().split(" ", 3)[2], f"{each[0]:.3f}", 1)
        for i, each in enumerate(random)
    ]
    whole = gzip.compress("\n".join(many).encode())
    assert 0 < len(read_laser_log(log(whole[: len(whole) // 2])).times) < 40
    with pytest.raises(ValueError, match="which is packed, cannot be read"):
        read_laser_log(log(b"\x1f\x8b" + bytes(50)))


def test_what_is_packed_is_bounded(log, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(laser_log, "LOG_LIMIT", 10_000)
    bomb = gzip.compress(bytes(1_000_000))
    assert len(bomb) < 2_000
    with pytest.raises(ValueError, match="unpacked, is too large; accepted: at most 10000 bytes"):
        read_laser_log(log(bomb))
    with pytest.raises(ValueError, match="unpacked, is too large"):
        read_laser_log(log(gzip.compress(bytes(6_000)) * 2))


def test_a_corrected_log_has_its_odometry_in_other_lines(log) -> None:
    """GMapping goes on from each corrected pose by the odometry, in lines ODOM."""
    rng = np.random.default_rng(1)
    corrected = np.cumsum(rng.uniform(0.1, 0.5, (30, 3)), axis=0)
    motions = rng.uniform(-0.4, 0.4, (30, 2, 3))
    lines = []
    for index, pose in enumerate(corrected):
        shown = " ".join(f"{each:.6f}" for each in [*pose, *pose])
        lines.append(f"FLASER 1 2.5 {shown} {index} h {index}")
        if index == 12:
            # One that is no scan: the lines go on from its pose all the same.
            lines[-1] = lines[-1].replace("2.5", "nan")
        # The pose of the scan, and two motions.
        for motion in (np.zeros(3), *motions[index]):
            x, y, yaw = pose
            dx, dy, turn = motion
            pose = np.array(
                [
                    x + dx * math.cos(yaw) - dy * math.sin(yaw),
                    y + dx * math.sin(yaw) + dy * math.cos(yaw),
                    yaw + turn,
                ]
            )
            lines.append("ODOM " + " ".join(f"{each:.6f}" for each in pose) + " 0 0 0 0 h 0")
    found = read_laser_log(log(*lines), field_of_view=1.0)
    assert found.is_corrected
    assert len(found.times) == 29
    np.testing.assert_allclose(found.poses, np.delete(corrected, 12, axis=0), atol=1e-5)
    pose = corrected[0]
    expected = [pose]
    for index, pair in enumerate(motions[:-1]):
        for dx, dy, turn in pair:
            x, y, yaw = pose
            cos, sin = math.cos(yaw), math.sin(yaw)
            pose = np.array([x + dx * cos - dy * sin, y + dx * sin + dy * cos, yaw + turn])
        if index != 11:
            expected.append(pose)
    np.testing.assert_allclose(found.odometry, expected, atol=1e-4)
    np.testing.assert_allclose(found.measured, found.odometry)
    # Lines ODOM that do not go on from the poses are another odometry.
    others = [each for each in lines if "ODOM" not in each]
    assert not read_laser_log(log(*others), field_of_view=1.0).is_corrected


def test_what_is_no_file_is_refused(tmp_path: Path, log, monkeypatch) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name in ("missing", "", "pipe", "a\0b"):
        with pytest.raises(ValueError, match="is not there or not a file; accepted: a CARMEN log"):
            read_laser_log(tmp_path / name)
    path = log(line(), line(), line())
    monkeypatch.setattr(carmen, "MOST_SCANS", 2)
    with pytest.raises(ValueError, match="line 3 is one scan too many; accepted: at most 2"):
        read_laser_log(path)
    monkeypatch.setattr(carmen, "MOST_ODOMETRY", 2)
    with pytest.raises(ValueError, match="line 3 is one line ODOM too many; accepted: at most 2"):
        read_laser_log(log(*ODOM))
    monkeypatch.setattr(laser_log, "LOG_LIMIT", 100)
    with pytest.raises(ValueError, match="is too large; accepted: at most 100 bytes"):
        read_laser_log(path)


WHOLE = {
    "FLASER": f"# a\n{line(3, 1.0)}\nODOM 0 0 0\n{line(3, 2.0)}\n",
    "RAWLASER1": "\n".join([*ODOM, *(long_line("RAWLASER1", t, beams=3) for t in (1.0, 2.0, 3.0))]),
    "ROBOTLASER1": "\n".join(long_line("ROBOTLASER1", t, beams=3) for t in (1.0, 2.0, 3.0)),
    "packed": f"# a\n{line(3, 1.0)}\nODOM 0 0 0\n{line(3, 2.0)}\n",
}
"""Small logs of which each is mutated."""


@pytest.mark.parametrize("kind", WHOLE)
def test_a_damaged_log_is_read_or_refused(log, kind: str) -> None:
    """Bytes are flipped, taken out, repeated and put in anywhere; counts become huge."""
    whole = WHOLE[kind].encode()
    whole = gzip.compress(whole, mtime=0) if kind == "packed" else whole
    rng = np.random.default_rng(7)
    pieces = [
        b"\n",
        b" ",
        b"FLASER",
        b"nan",
        b"1e400",
        b"-",
        b"9" * 400,
        b"\xff",
        b" 99999 ",
        b"\0",
    ]
    for _ in range(300):
        data = whole
        for _ in range(rng.integers(1, 4)):
            at, taken = int(rng.integers(0, len(data) + 1)), int(rng.integers(0, 40))
            put = pieces[rng.integers(len(pieces))] if rng.random() < 0.7 else rng.bytes(2)
            end = at + taken if rng.random() < 0.9 else len(data)
            data = data[:at] + put * int(rng.integers(0, 3)) + data[end:]
        said, found = "", None
        try:
            found = read_laser_log(log(data), field_of_view=1.0)
        except ValueError as error:
            said = str(error)
        assert "\n" not in said
        if found is None:
            continue
        number, beams = found.ranges.shape
        assert found.poses.shape == found.odometry.shape == found.measured.shape == (number, 3)
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
        with pytest.raises(ValueError, match=r"line \d+ has (the time|a position)"):
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
