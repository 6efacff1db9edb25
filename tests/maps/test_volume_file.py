"""Volumes from files, against shapes that are known and other libraries' files."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest

import jaxplore as jx
from jaxplore.maps import read_volume
from jaxplore.maps.files.octomap_file import read_octomap

trimesh = pytest.importorskip("trimesh")


def box_mesh(size=(4.0, 3.0, 2.0), thick: float = 0.3):
    """Return a closed room: a box and the box inside of it, turned inside out."""
    outer = trimesh.creation.box(extents=size)
    inner = trimesh.creation.box(extents=np.subtract(size, 2 * thick))
    inner.invert()
    room = trimesh.util.concatenate([outer, inner])
    room.apply_translation(np.multiply(size, 0.5))
    return room


@pytest.mark.parametrize("kind", ["stl", "obj", "ply"])
def test_the_surface_of_a_mesh_is_solid(tmp_path: Path, kind: str) -> None:
    file = tmp_path / f"room.{kind}"
    box_mesh().export(file)
    grid = read_volume(file, resolution=0.1)
    assert grid.shape == (20, 30, 40)
    np.testing.assert_allclose(grid.origin, 0.0, atol=1e-6)
    solid = np.asarray(grid.is_occupied)
    z, y, x = np.meshgrid(*(np.arange(n) for n in solid.shape), indexing="ij")
    depth = np.min([x, 39 - x, y, 29 - y, z, 19 - z], axis=0)
    # The outer surface is in the first layer, and the inner one at 0.3 m between the third and the
    # fourth.
    assert solid[depth == 0].all()
    assert not solid[(depth == 1) | (depth > 3)].any()
    on_either_side = solid[depth == 2].mean() + solid[depth == 3].mean()
    assert on_either_side > 0.8
    # No line of sight passes a surface: the inside is closed to the outer layers.
    assert not solid[depth > 3].any()


def test_units_and_open_meshes(tmp_path: Path) -> None:
    room = box_mesh()
    room.apply_scale(1000.0)
    room.export(tmp_path / "mm.stl")
    with pytest.warns(UserWarning, match=r"is 4000 m x 3000 m x 2000 m; if its unit is the milli"):
        read_volume(tmp_path / "mm.stl", resolution=50.0)
    assert read_volume(tmp_path / "mm.stl", scale=0.001).shape == (20, 30, 40)
    with pytest.raises(ValueError, match=r"which are .* voxels .* file.scale=0.001"):
        read_volume(tmp_path / "mm.stl")
    whole = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    part = trimesh.Trimesh(whole.vertices, whole.faces[:-1])
    part.export(tmp_path / "open.stl")
    with pytest.raises(ValueError, match=r"is open: 3 edges belong to one face; accepted: a clos"):
        read_volume(tmp_path / "open.stl")
    assert read_volume(tmp_path / "open.stl", is_open=True).shape == (20, 20, 20)
    # Two boxes that touch are closed, although four faces meet at their common edges.
    beside = whole.copy()
    beside.apply_translation((2.0, 0.0, 0.0))
    trimesh.util.concatenate([whole, beside]).export(tmp_path / "two.stl")
    assert read_volume(tmp_path / "two.stl").shape == (20, 20, 40)


def test_points_make_voxels(tmp_path: Path) -> None:
    points = np.array([[0.05, 0.05, 0.05], [0.95, 0.45, 0.25], [0.95, 0.46, 0.25]])
    trimesh.PointCloud(points).export(tmp_path / "cloud.ply")
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4\n"
        "HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 4\nDATA "
    )
    rows = [*points.tolist(), [math.nan] * 3]
    text = "\n".join(" ".join(map(str, row)) for row in rows)
    (tmp_path / "ascii.pcd").write_text(f"{header}ascii\n{text}\n")
    packed = b"".join(struct.pack("<fff", *row) for row in rows)
    (tmp_path / "binary.pcd").write_bytes(f"{header}binary\n".encode() + packed)
    for name in ("cloud.ply", "ascii.pcd", "binary.pcd"):
        grid = read_volume(tmp_path / name, resolution=0.1)
        assert grid.shape == (3, 5, 10), name
        solid = np.asarray(grid.is_occupied)
        assert solid.sum() == 2
        assert solid[0, 0, 0]
        assert solid[2, 4, 9]
        assert np.asarray(read_volume(tmp_path / name, min_points=2).is_occupied).sum() == 1


def test_an_octomap_is_read_as_its_own_library_reads_it(tmp_path: Path) -> None:
    pyoctomap = pytest.importorskip("pyoctomap")
    tree = pyoctomap.OcTree(0.1)
    origin = np.array([3.0, 1.0, 0.5])
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (300, 3)) + origin
    tree.insertPointCloud(points, origin)
    file = tmp_path / "map.bt"
    tree.writeBinary(str(file))
    written = pyoctomap.OcTree(0.1)
    assert written.readBinary(str(file))
    grid = read_volume(file)
    assert grid.resolution == pytest.approx(0.1)
    np.testing.assert_allclose(grid.origin, written.getMetricMin(), atol=1e-6)
    solid = np.asarray(grid.is_occupied)
    for voxel in np.argwhere(np.ones_like(solid))[::97]:
        centre = np.asarray(grid.origin, np.float64) + (voxel[::-1] + 0.5) * 0.1
        node = written.search(centre)
        # An unknown voxel has no node.
        is_known = bool(node) if node is not None else False
        assert solid[tuple(voxel)] == (not is_known or written.isNodeOccupied(node))
    data = file.read_bytes()
    begin = data.index(b"\ndata\n") + 6
    for damaged in (data[:-20], data[:begin] + b"\xff" * 500, data[:begin]):
        file.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"map.bt is malformed: .*tree is (damaged|empty)"):
            read_volume(file)
    with pytest.raises(ValueError, match="more than 100"):
        read_octomap(data, 100)
    # One leaf of the second level, 2^14 voxels wide, is more than memory holds.
    file.write_bytes(b"# Octomap OcTree binary file\nid OcTree\nsize 2\nres 0.1\ndata\n\x01\x00")
    with pytest.raises(ValueError, match="voxels, more than"):
        read_volume(file)


def test_arrays_are_read_and_nothing_is_unpickled(tmp_path: Path) -> None:
    solid = np.random.default_rng(1).random((4, 5, 6)) < 0.5
    np.save(tmp_path / "a.npy", solid)
    np.savez(tmp_path / "b.npz", solid=solid, resolution=0.25, origin=[1.0, 2.0, 3.0])
    first, second = read_volume(tmp_path / "a.npy"), read_volume(tmp_path / "b.npz")
    for grid in (first, second):
        np.testing.assert_array_equal(grid.is_occupied, solid)
    assert first.resolution == 0.1
    assert second.resolution == 0.25
    np.testing.assert_allclose(second.origin, [1.0, 2.0, 3.0])
    np.save(tmp_path / "c.npy", np.array([{}], object), allow_pickle=True)
    with pytest.raises(ValueError, match="malformed"):
        read_volume(tmp_path / "c.npy")
    np.save(tmp_path / "d.npy", np.zeros((2, 2)))
    with pytest.raises(ValueError, match="type float64; accepted: booleans"):
        read_volume(tmp_path / "d.npy")
    np.savez(tmp_path / "e.npz", other=solid)
    with pytest.raises(ValueError, match="it has other and no solid"):
        read_volume(tmp_path / "e.npz")
    huge = (tmp_path / "a.npy").read_bytes().replace(b"(4, 5, 6)", b"(9999, 9999, 9999)")
    (tmp_path / "f.npy").write_bytes(huge[: huge.index(b"\n") + 1])
    with pytest.raises(ValueError, match="malformed"):
        read_volume(tmp_path / "f.npy")


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "pcd", "bt", "npy", "npz"])
@pytest.mark.parametrize("content", [b"", b"nonsense\n" * 20, bytes(range(256)) * 4])
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, kind: str, content: bytes) -> None:
    file = tmp_path / f"x.{kind}"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"volume .*x\.") as found:
        read_volume(file)
    assert "\n" not in str(found.value)


def test_what_is_no_volume_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot be read: it is not there or not a file"):
        read_volume(tmp_path / "a.stl")
    for change in ({"resolution": 0.0}, {"scale": -1.0}, {"min_points": 0}):
        with pytest.raises(ValueError, match=next(iter(change))):
            read_volume(tmp_path / "a.stl", **change)
    assert isinstance(jx.VoxelGrid.unknown((1.0, 1.0, 1.0), 0.5), jx.VoxelGrid)
