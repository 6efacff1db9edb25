"""Reads a mesh or a point cloud from standard input; run as a script, see `mesh_process`.

It imports nothing of jaxplore, so that it begins soon and takes little memory. Whatever a file does
to the libraries that read it ends with this process.
"""

import io
import json
import os
import re
import sys
from contextlib import suppress
from typing import Any

import numpy as np

ASSET = 100_000
"""Bytes at the beginning of a COLLADA file in which its unit and its up axis are looked for."""
CHUNK = 1_000_000
"""Points of a LAS file that are read at a time."""


def read(data: bytes, kind: str) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Return corners or points (N, 3), the corners of triangles (M, 3), and what the file says.

    What it says is `up`, the axis x, y or z, and `unit` [m], where the format has them.
    """
    if kind == "pcd":
        from pypcd4.pypcd4 import PointCloud

        cloud = PointCloud.from_fileobj(io.BytesIO(data))  # type: ignore[arg-type]
        return cloud.numpy(("x", "y", "z")), np.zeros((0, 3), np.int32), {}
    if kind in ("las", "laz"):
        import laspy  # type: ignore[import-untyped]

        with laspy.open(io.BytesIO(data), closefd=False) as file:
            parts = [
                np.stack([each.x, each.y, each.z], axis=1) for each in file.chunk_iterator(CHUNK)
            ]
            points = np.concatenate([np.zeros((0, 3)), *parts])
            if len(points) != file.header.point_count:
                raise ValueError(f"it has {len(points)} points of {file.header.point_count}")
        return points, np.zeros((0, 3), np.int32), {"up": "z"}
    import trimesh

    # What a file names beside itself, such as materials, is not looked for.
    found: Any = trimesh.load(
        io.BytesIO(data), file_type=kind, process=True, skip_materials=True, resolver=None
    )
    if isinstance(found, trimesh.Scene):
        found = found.to_mesh()
    faces = getattr(found, "faces", np.zeros((0, 3)))
    about: dict[str, Any] = {}
    if kind in ("glb", "gltf"):
        about = {"up": "y", "unit": 1.0}
    elif kind == "dae":
        axis = re.search(rb"<up_axis>\s*([XYZ])_UP", data[:ASSET])
        unit = re.search(rb"<unit[^>]*\smeter=[\"']([0-9.eE+-]{1,30})[\"']", data[:ASSET])
        about = {
            "up": axis[1].decode().lower() if axis else "y",
            "unit": float(unit[1]) if unit else 1.0,
        }
    return found.vertices, np.asarray(faces), about


def num_open(faces: np.ndarray, size: int) -> int:
    """Return the number of edges that belong to an odd number of faces.

    Where bodies touch, an edge belongs to four faces: that is no hole.
    """
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64), axis=1)
    _, counts = np.unique(edges[:, 0] * size + edges[:, 1], return_counts=True)
    return int(np.count_nonzero(counts % 2))


def limit(memory: int, seconds: int) -> None:
    """Limit the address space [bytes] and the processor time [s], where the system can."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        for what, most in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, seconds)):
            _, hard = resource.getrlimit(what)
            resource.setrlimit(what, (most if hard < 0 else min(most, hard), hard))


def main(kind: str, memory: str, seconds: str) -> None:
    """Write a line of JSON, the corners in float64, and the faces in int32."""
    limit(int(memory), int(seconds))
    # What libraries print goes nowhere.
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    try:
        corners, faces, about = read(sys.stdin.buffer.read(), kind)
        corners = np.ascontiguousarray(corners, np.float64)
        if corners.shape[1:] != (3,):
            raise ValueError("its points have no x, y and z")
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(corners):
            raise ValueError("a face has a corner that is not there")
        about |= {
            "corners": len(corners),
            "faces": len(faces),
            "open": num_open(faces, len(corners)),
        }
        out.write(json.dumps(about).encode() + b"\n")
        out.write(corners.data)
        out.write(np.ascontiguousarray(faces, np.int32).data)
    except MemoryError:
        out.write(b'{"error": "memory"}\n')
    except ModuleNotFoundError as error:
        out.write(json.dumps({"missing": str(error.name)}).encode() + b"\n")
    except Exception as error:
        # Readers raise errors of many kinds for damaged files.
        text = f"{type(error).__name__}: {error}"[:200]
        out.write(json.dumps({"error": text}).encode() + b"\n")
    out.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
