"""Path files, good and bad."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.geometry.curves import path_through
from jaxplore.maps.files import path_file
from jaxplore.maps.files.path_file import read_path

SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]
POSES = """
header: {frame_id: map}
poses:
  - header: {frame_id: map}
    pose: {position: {x: 0.0, y: 0.0, z: 3.0}, orientation: {w: 1.0}}
  - pose: {position: {x: 1, y: 2.5}}
  - position: {x: 2.0, y: 2.5}
"""


def written(folder: Path, text: str, name: str = "path.csv") -> Path:
    file = folder / name
    file.write_text(text)
    return file


@pytest.mark.parametrize(
    "text",
    [
        "0,0\n4,0\n4,4\n0,4\n",
        "# a comment\nx, y\n0 , 0\n4, 0 # turn\n\n4, 4\n0, 4",
        "0;0\n4;0\n4;4\n4;4\n0;4\n",
        "\ufeff0 0\n4 0\n4 4\n0 4\n",
        "x_m,y_m,psi\n0,0,1\n4,0,2\n4,4,3\n0,4,4\n",
    ],
)
def test_rows_are_waypoints(tmp_path: Path, text: str) -> None:
    found, expected = read_path(written(tmp_path, text)), path_through(SQUARE)
    assert not found.is_closed
    np.testing.assert_allclose(found.points, expected.points)
    assert np.isinf(found.half_widths).all()


def test_a_centre_line_is_a_lap_with_its_widths(tmp_path: Path) -> None:
    t = np.linspace(0.0, 2 * np.pi, 40, endpoint=False)
    rows = [f"{5 * np.cos(a)}, {3 * np.sin(a)}, {1 + 0.1 * np.cos(a)}, 2.0" for a in t]
    text = "# x_m, y_m, w_tr_right_m, w_tr_left_m\n" + "\n".join(rows)
    path = read_path(written(tmp_path, text))
    assert path.is_closed
    left, right = path.room(jnp.asarray(0.0))
    np.testing.assert_allclose((left, right), (2.0, 1.1), rtol=1e-3)
    again = read_path(written(tmp_path, text + "\n" + rows[0]))
    np.testing.assert_allclose(again.length, path.length)
    assert not read_path(written(tmp_path, text), is_closed=False).is_closed


def test_a_ros_path(tmp_path: Path) -> None:
    path = read_path(written(tmp_path, POSES, "plan.yaml"))
    np.testing.assert_allclose(path.points[0], [0.0, 0.0])
    np.testing.assert_allclose(path.points[-1], [2.0, 2.5])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "", "has no waypoints"),
        ("a.csv", "0,0\n", "has 1 different waypoints; accepted: two or more"),
        ("a.csv", "0,0\n0,0\n", "has 1 different waypoints"),
        ("a.csv", "0,0\n1,nan\n", "waypoint 2 is .*; accepted: finite numbers"),
        ("a.csv", "0,0\n1,1e400\n", "waypoint 2 is"),
        ("a.csv", "0,0\n1,one\n", "line 2 is '1,one'; accepted: numbers"),
        ("a.csv", "0,0\n1,2,3\n", "line 2 has 3 columns; accepted: 2"),
        ("a.csv", "1\n2\n", "line 1 has 1 columns"),
        ("a.csv", "Lat, Lon\n48.1,11.5\n48.2,11.5\n", "columns 'Lat, Lon'; accepted: x, y"),
        ("a.csv", "longitude;latitude\n11;48\n12;48\n", "accepted: x, y .m., in a projection"),
        ("a.csv", "0,0,1,1\n1,0,0,1\n2,1,1,1\n", "half_widths has a value 0.0"),
        ("a.yaml", "poses: []", r"has poses \[\]; accepted: a list"),
        ("a.yaml", "poses: [{pose: {position: {x: 0}}}]", r"poses\[0\] is"),
        ("a.yaml", "poses: [{position: {x: 0, y: .nan}}, {position: {x: 1, y: 1}}]", "waypoint 1"),
        ("a.yaml", "poses: [{position: {x: '0', y: 1}}]", r"poses\[0\]"),
        ("a.yaml", "poses: [3]", r"poses\[0\] is 3"),
        ("a.yaml", "!!python/object:os.system {}", "is not a path's YAML"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, name: str, text: str, message: str) -> None:
    file = written(tmp_path, text, name)
    with pytest.raises(ValueError, match=message) as error:
        read_path(file)
    assert str(file) in str(error.value)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "x,y\n0,0\n1,1\n\n2,2\n3,nonsense\n", "line 5 is one waypoint too many"),
        ("a.yaml", f"poses: [{', '.join(['{position: {x: 0, y: 0}}'] * 3)}]", "has 3 waypoints"),
    ],
)
def test_a_path_has_at_most_so_many_waypoints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, text: str, message: str
) -> None:
    monkeypatch.setattr(path_file, "MOST_WAYPOINTS", 2)
    with pytest.raises(ValueError, match=f"{message}; accepted: at most 2"):
        read_path(written(tmp_path, text, name))


def test_a_file_that_is_not_there_or_no_text(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="is not there"):
        read_path(tmp_path / "nowhere.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ValueError, match="is not text"):
        read_path(tmp_path / "binary.csv")
