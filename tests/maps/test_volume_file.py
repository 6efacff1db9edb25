"""Volumes from files, against shapes that are known and other libraries' files."""

import io
import math
import struct
import tracemalloc
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

import jaxplore as jx
from jaxplore.maps import Datum, read_volume, volume_datum
from jaxplore.maps.files import mesh_process
from jaxplore.maps.files.octomap_file import OctoMap
from jaxplore.maps.files.volume_file import SUFFIXES, open_volume

pytestmark = pytest.mark.long
trimesh = pytest.importorskip("trimesh")


def box_mesh(size=(4.0, 3.0, 2.0), thick: float = 0.3):
    """Return a closed room: a box and the box inside of it, turned inside out."""
    outer = trimesh.creation.box(extents=size)
    inner = trimesh.creation.box(extents=np.subtract(size, 2 * thick))
    inner.invert()
    room = trimesh.util.concatenate([outer, inner])
    room.apply_translation(np.multiply(size, 0.5))
    return room


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "glb", "gltf", "dae"])
def test_the_surface_of_a_mesh_is_solid(tmp_path: Path, kind: str) -> None:
    file = tmp_path / f"room.{kind}"
    # A glTF of one file has its numbers in it.
    options = {"embed_buffers": True} if kind == "gltf" else {}
    # pycollada sets shapes of arrays, which NumPy warns of.
    with warnings.catch_warnings(action="ignore"):
        written = trimesh.exchange.export.export_mesh(box_mesh(), None, kind, **options)
    if kind == "gltf":
        written = written["model.gltf"]
    file.write_bytes(written if isinstance(written, bytes) else written.encode())
    grid = read_volume(file, resolution=0.1, up="z")
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
    with pytest.warns(UserWarning, match=r"is 4 m x 3 m x 2 m .* millimetres are taken for its un"):
        assert read_volume(tmp_path / "mm.stl").shape == (20, 30, 40)
    assert read_volume(tmp_path / "mm.stl", scale=0.001).shape == (20, 30, 40)
    with pytest.raises(ValueError, match=r"which are .* voxels .* file.scale=0.001"):
        read_volume(tmp_path / "mm.stl", scale=1.0)
    whole = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    part = trimesh.Trimesh(whole.vertices, whole.faces[:-1])
    part.export(tmp_path / "open.stl")
    with pytest.raises(ValueError, match=r"is open: 3 edges belong to one face; accepted: a clos"):
        read_volume(tmp_path / "open.stl", up="z")
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
    laspy = pytest.importorskip("laspy")
    for name in ("cloud.las", "cloud.laz"):
        las = laspy.create(file_version="1.2", point_format=0)
        las.header.scales = [0.001] * 3
        las.x, las.y, las.z = points.T
        las.write(tmp_path / name)
    for name in ("cloud.ply", "ascii.pcd", "binary.pcd", "cloud.las", "cloud.laz"):
        grid = read_volume(tmp_path / name, resolution=0.1, scale=1.0)
        assert grid.shape == (3, 5, 10), name
        solid = np.asarray(grid.is_occupied)
        assert solid.sum() == 2
        assert solid[0, 0, 0]
        assert solid[2, 4, 9]
        again = read_volume(tmp_path / name, min_points=2, scale=1.0)
        assert np.asarray(again.is_occupied).sum() == 1


@pytest.mark.parametrize("kind", ["OcTree", "ColorOcTree"])
def test_an_octomap_is_read_as_its_own_library_reads_it(tmp_path: Path, kind: str) -> None:
    pyoctomap = pytest.importorskip("pyoctomap")
    tree = getattr(pyoctomap, kind)(0.1)
    origin = np.array([3.0, 1.0, 0.5])
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (300, 3)) + origin
    tree.insertPointCloud(points, origin)
    files = {".bt": tmp_path / "map.bt", ".ot": tmp_path / "map.ot"}
    assert tree.write(str(files[".ot"]))
    assert tree.writeBinary(str(files[".bt"]))
    for file in files.values():
        grid = read_volume(file)
        assert grid.resolution == pytest.approx(0.1)
        np.testing.assert_allclose(grid.origin, tree.getMetricMin(), atol=1e-6)
        solid = np.asarray(grid.is_occupied)
        assert 0.05 < solid.mean() < 0.95
        for voxel in np.argwhere(np.ones_like(solid))[::97]:
            centre = np.asarray(grid.origin, np.float64) + (voxel[::-1] + 0.5) * 0.1
            node = tree.search(centre)
            # An unknown voxel has no node.
            is_known = bool(node) if node is not None else False
            assert solid[tuple(voxel)] == (not is_known or tree.isNodeOccupied(node))
        data = file.read_bytes()
        begin = data.index(b"\ndata\n") + 6
        for damaged in (data[:-20], data[:begin] + b"\xff" * 500, data[:begin]):
            file.write_bytes(damaged)
            with pytest.raises(ValueError, match=r"map.[bo]t is malformed: .*tree is damaged"):
                read_volume(file)
        with pytest.raises(ValueError, match=r"nodes, which need .* GB; there is 1e-06 GB"):
            OctoMap(data, 1e3)
    # One leaf of the second level, 2^15 voxels wide, is more than memory holds.
    start = b"# Octomap OcTree binary file\nid OcTree\nsize 2\nres 0.1\ndata\n"
    for content, said in ((b"\1\0", "32768 x 32768 x 32768 voxels"), (b"\0\0", "tree is empty")):
        files[".bt"].write_bytes(start + content)
        with pytest.raises(ValueError, match=said):
            read_volume(files[".bt"])


def test_an_octomap_of_millions_of_leaves_takes_little_memory(tmp_path: Path) -> None:
    inner = b"\x55\xaa"
    for _ in range(5):
        inner = b"\xff\xff" + 8 * inner
    for _ in range(10):
        inner = b"\3\0" + inner
    file = tmp_path / "dense.bt"
    file.write_bytes(b"# Octomap OcTree binary file\nid OcTree\nsize 1\nres 0.1\ndata\n" + inner)
    tracemalloc.start()
    opened = open_volume(file)
    solid = opened.make()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert opened.shape == (64, 64, 64)
    # The lower four children of each node of two voxels are free, the upper four are occupied.
    np.testing.assert_array_equal(solid, np.indices(solid.shape)[0] % 2 == 1)
    # A tuple for each of the 262,144 leaves would take 40 MB.
    assert peak < 15e6


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
    with pytest.raises(ValueError, match=r"and type float64, not \(D, H, W\) of bool"):
        read_volume(tmp_path / "d.npy")
    np.savez(tmp_path / "e.npz", other=solid)
    with pytest.raises(ValueError, match="it has no solid"):
        read_volume(tmp_path / "e.npz")
    huge = (tmp_path / "a.npy").read_bytes().replace(b"(4, 5, 6)", b"(9999, 9999, 9999)")
    (tmp_path / "f.npy").write_bytes(huge[: huge.index(b"\n") + 1])
    with pytest.raises(ValueError, match="malformed"):
        read_volume(tmp_path / "f.npy")


def array_file(descr: str, shape: str, content: bytes = b"") -> bytes:
    """Return the file of an array whose header may be wrong."""
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    header = header.ljust(117) + b"\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header + content


def archive(members: dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as opened:
        for name, content in members.items():
            opened.writestr(f"{name}.npy", content)
    return file.getvalue()


def point_cloud(
    count: str, points: int, content: bytes = bytes(120), kind: str = "binary"
) -> bytes:
    header = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {count}\nWIDTH {points}\nHEIGHT 1\n"
    return f"{header}POINTS {points}\nDATA {kind}\n".encode() + content


def las_header(records: int = 0, points: int = 0, begin: int = 227) -> bytes:
    numbers = struct.pack("<HIIBHI", 227, begin, records, 0, 20, points)
    return (b"LASF" + bytes(90) + numbers).ljust(400, b"\0")


ROOM = array_file("'|b1'", "(4, 5, 6)", bytes(120))
LARGE = array_file("'|b1'", "(300, 300, 300)", bytes(300**3))
ELEMENTS = "property float x\nproperty float y\nproperty float z\n"
PLY = f"ply\nformat binary_little_endian 1.0\nelement vertex %d\n{ELEMENTS}end_header\n"
NODES = b"# Octomap OcTree file\nid %b\nsize 1\nres 0.1\ndata\n"
FALSE: dict[str, tuple[str, bytes, str]] = {
    "cut header": ("npy", ROOM[:40], "solid has a damaged header"),
    "open brackets": ("npy", ROOM[:10] + b"(" * 118, "solid has a damaged header"),
    "cut values": ("npy", array_file("'|b1'", "(400, 500, 600)"), "more or fewer values"),
    "header of 4 GB": ("npy", b"\x93NUMPY\2\0" + b"\xff" * 40, "solid has a damaged header"),
    "vast": ("npy", array_file("'|b1'", "(9999, 9999, 9999)"), "at most 2e.08 voxels"),
    "void": (
        "npz",
        archive({"solid": array_file("'|V2000000000'", "(9,)")}),
        "type [|]V2000000000",
    ),
    "no bytes": ("npz", archive({"solid": array_file("'|V0'", "(9, 9, 9)")}), "type [|]V0"),
    "record": (
        "npz",
        archive({"solid": array_file("[('a', '|b1', (1000000000,))]", "(2,)")}),
        r"type .*1000000000",
    ),
    "long corner": ("npz", archive({"solid": ROOM, "origin": LARGE}), "origin has shape"),
    "members": ("npz", b"PK\1\2" * 20_000, "more than 10000 members"),
    "count": ("pcd", point_cloud("2000000000 1 1", 9), "2000000002 numbers of a point in"),
    "points": ("pcd", point_cloud("1 1 1", 2 * 10**9), "promises 2000000000 points in"),
    "digits": (
        "pcd",
        point_cloud("1 1 1", 9).replace(b"POINTS 9", b"POINTS " + b"9" * 9000),
        "9{15} p",
    ),
    "elements": ("ply", (PLY % 2_000_000_000).encode(), "promises 2000000000 elements in"),
    "records": ("las", las_header(records=2**32 - 1), "4294967295 records"),
    "points of LAS": ("las", las_header(points=2**32 - 1), "4294967295 points of 20 bytes"),
    "begin of LAS": ("laz", las_header(begin=2**32 - 1), "4294967295 bytes before"),
    "root": ("ot", NODES % b"OcTree" + bytes(5), "65536 x 65536 x 65536 voxels"),
    "other tree": ("ot", NODES % b"OcTreeStamped" + bytes(9), "no id of OcTree or ColorOcTree"),
}
"""Files whose numbers are not true or ask for all memory: ending, content, and what is said."""


@pytest.mark.parametrize("name", FALSE)
def test_numbers_of_headers_are_checked_before_memory_is_taken(tmp_path: Path, name: str) -> None:
    kind, content, said = FALSE[name]
    file = tmp_path / f"x.{kind}"
    file.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(ValueError, match=rf"volume .*x\.{kind} .*{said}") as found:
        open_volume(file)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "\n" not in str(found.value)
    assert peak < 10 * len(content) + 8e6


def test_of_an_archive_only_what_is_needed_is_read(tmp_path: Path) -> None:
    file = tmp_path / "many.npz"
    file.write_bytes(archive({f"a{number}": LARGE for number in range(3)} | {"solid": ROOM}))
    tracemalloc.start()
    assert open_volume(file).shape == (4, 5, 6)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 5e6


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        # 4 GB unpacked, as its own header says.
        (
            "pcd",
            point_cloud("1 1 1", 9, struct.pack("<II", 99, 4_000_000_000), "binary_compressed"),
        ),
        # A face of two million corners.
        ("obj", b"v 0 0 0\nv 9 0 0\nv 9 9 1\nv 0 9 5\nf " + b"1 2 3 4 " * 500_000),
    ],
)
def test_a_reader_ends_where_its_memory_does(tmp_path: Path, kind: str, content: bytes) -> None:
    file = tmp_path / f"x.{kind}"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=rf"x\.{kind} cannot be read: its reader .*0\.5 GB"):
        open_volume(file, memory=1e6)


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("while True: pass", "its reader did not end within 1 s"),
        ("import os\nos.abort()", "its reader ended with code -6, within 4 GB"),
        ("import sys\nsys.exit(3)", "its reader ended with code 3, within 4 GB"),
    ],
)
def test_a_reader_that_hangs_or_dies_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, said: str
) -> None:
    monkeypatch.setattr(mesh_process, "_SCRIPT", tmp_path / "script.py")
    if "while" in script:
        monkeypatch.setattr(mesh_process, "SECONDS", 1)
        monkeypatch.setattr(mesh_process, "WAITS", 1)
    (tmp_path / "script.py").write_text(script)
    (tmp_path / "x.stl").write_bytes(b"solid x\nendsolid x\n")
    with pytest.raises(ValueError, match=said):
        open_volume(tmp_path / "x.stl")


def test_a_missing_library_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = mesh_process._SCRIPT.read_text().replace("import trimesh", "import not_there")
    (tmp_path / "script.py").write_text(script)
    (tmp_path / "x.stl").write_bytes(b"solid x\nendsolid x\n")
    monkeypatch.setattr(mesh_process, "_SCRIPT", tmp_path / "script.py")
    with pytest.raises(ValueError, match=r"not_there is not installed; .* '.\[volumes\]' in a clo"):
        open_volume(tmp_path / "x.stl")


@pytest.mark.parametrize("kind", [each[1:] for each in SUFFIXES])
@pytest.mark.parametrize("content", [b"", b"nonsense\n" * 20 + bytes(range(256)) * 4])
def test_damaged_files_are_refused_in_one_line(tmp_path: Path, kind: str, content: bytes) -> None:
    file = tmp_path / f"x.{kind}"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"volume .*x\.") as found:
        read_volume(file)
    assert "\n" not in str(found.value)


HALL = (12.0, 8.0, 3.0)


@pytest.mark.parametrize(
    ("axes", "kind", "said"),
    [
        # Axes of the file along which the hall has its length, width and height.
        ("xyz", "stl", None),
        ("xzy", "stl", "y is taken for up by its extents, file.up=y"),
        ("yzx", "obj", "x is taken for up by its extents, file.up=x"),
        ("xzy", "glb", "y is taken for up by its extents, file.up=y"),
        ("xyz", "glb", "z is taken for up by its extents, file.up=z"),
    ],
)
def test_the_up_axis_is_guessed_and_said(
    tmp_path: Path, axes: str, kind: str, said: str | None
) -> None:
    places = ["xyz".index(each) for each in axes]
    extents = np.zeros(3)
    extents[places] = HALL
    mesh = trimesh.creation.box(extents=extents)
    file = tmp_path / f"hall.{kind}"
    mesh.export(file)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        grid = read_volume(file, resolution=0.5)
    assert grid.shape[0] == 6
    assert sorted(grid.shape[1:]) == [16, 24]
    assert [str(each.message).rpartition("z: ")[2] for each in told] == [said] * bool(said)
    given = read_volume(file, resolution=0.5, up=axes[2])
    np.testing.assert_array_equal(given.is_occupied, grid.is_occupied)


def test_a_file_that_is_turned_stays_what_it_was(tmp_path: Path) -> None:
    """Turn a mesh of three corners of a room, in which left and right differ."""
    points = np.array(
        [[0.05, 0.05, 0.05], [0.95, 0.05, 0.05], [0.05, 0.75, 0.05], [0.05, 0.05, 0.45]]
    )
    solid = {}
    for up, columns, signs in (
        ("z", (0, 1, 2), 1),
        ("y", (0, 2, 1), (1, 1, -1)),
        ("x", (2, 0, 1), 1),
    ):
        trimesh.PointCloud(points[:, columns] * signs).export(tmp_path / f"{up}.ply")
        grid = read_volume(tmp_path / f"{up}.ply", up=up, scale=1.0)
        solid[up] = np.argwhere(grid.is_occupied).tolist()
    assert solid["z"] == solid["y"] == solid["x"] == [[0, 0, 0], [0, 0, 9], [0, 7, 0], [4, 0, 0]]


def test_a_small_thing_and_what_a_file_says_of_its_unit(tmp_path: Path) -> None:
    bunny = trimesh.creation.icosphere(subdivisions=1, radius=0.08)
    bunny.export(tmp_path / "bunny.stl")
    with pytest.warns(UserWarning, match=r"is 0.\d+ m .* if its unit is not the metre, file.scale"):
        read_volume(tmp_path / "bunny.stl")
    hall = trimesh.creation.box(extents=np.multiply(HALL, 100.0))
    with warnings.catch_warnings(action="ignore"):
        text = trimesh.exchange.export.export_mesh(hall, None, "dae").decode()
    head, asset, rest = text.partition("<asset>")
    assert asset
    units = asset + '<unit name="centimeter" meter="0.01"/>'
    (tmp_path / "hall.dae").write_text(head + units + rest)
    assert read_volume(tmp_path / "hall.dae", up="z", resolution=0.5).shape == (6, 16, 24)


def test_a_volume_in_utm_has_a_datum(tmp_path: Path) -> None:
    near = box_mesh()
    near.export(tmp_path / "near.obj")
    far = near.copy()
    far.apply_translation((500_000.0, 4_649_776.0, 100.0))
    far.export(tmp_path / "far.obj")
    datum = volume_datum(tmp_path / "far.obj", up="z")
    assert datum == Datum(500_000.0, 4_649_776.0)
    assert volume_datum(tmp_path / "near.obj", up="z") == Datum()
    here = read_volume(tmp_path / "near.obj", up="z")
    there = read_volume(tmp_path / "far.obj", up="z", datum=datum)
    np.testing.assert_array_equal(here.is_occupied, there.is_occupied)
    np.testing.assert_allclose(np.asarray(there.origin) - here.origin, [0.0, 0.0, 100.0], atol=1e-5)
    with pytest.raises(ValueError, match="relative to a datum"):
        read_volume(tmp_path / "far.obj", up="z")


def test_what_is_no_volume_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="cannot be read: it is not there or not a file"):
        read_volume(tmp_path / "a.stl")
    assert isinstance(jx.VoxelGrid.unknown((1.0, 1.0, 1.0), 0.5), jx.VoxelGrid)
