"""Read meshes and point clouds by their libraries, in a process with bounds of memory and time.

The libraries take a file at its word: a few bytes may ask for all memory, or never end. So
`mesh_script` runs them in a process of its own.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore._optional import is_missing
from jaxplore._text import error_reason

SECONDS = 60
"""Greatest processor time of a reader [s]."""
WAITS = 10
"""Greatest ratio of the time on the wall to it: a machine may be shared."""
LEAST = 0.5e9
"""Least memory of a reader: it takes half of that without a file [bytes]."""
KINDS = ("stl", "obj", "ply", "glb", "gltf", "dae", "pcd", "las", "laz")
"""Kinds of files that are read so."""
_SCRIPT = Path(__file__).with_name("mesh_script.py")
_LONGEST = 10_000


class Geometry(NamedTuple):
    """What the file of a mesh or of a point cloud holds, in its own unit and axes.

    Args:
        corners: (N, 3) corners or points.
        faces: (M, 3) corners of each triangle; none of a point cloud.
        num_open: edges that belong to an odd number of triangles.
        up: axis that the format says is up; None where it says none.
        unit: unit that it says [m]; None where it says none.
    """

    corners: NDArray[np.float64]
    faces: NDArray[np.int32]
    num_open: int
    up: str | None
    unit: float | None


def read_geometry(file: BinaryIO, kind: str, memory: float) -> Geometry:
    """Read a mesh or a point cloud from a regular file at its beginning; `kind` is in `KINDS`.

    The reader may take `memory` [bytes]; at least `LEAST` is given.
    """
    most = int(max(memory, LEAST))
    # Each thread of a numerical library takes address space.
    alone = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    # -P: modules beside the script are not found by its imports.
    command = [sys.executable, "-P", "-W", "ignore", str(_SCRIPT), kind, str(most), str(SECONDS)]
    with tempfile.TemporaryFile() as out:
        try:
            ended = subprocess.run(
                command,
                stdin=file,
                stdout=out,
                stderr=subprocess.DEVNULL,
                timeout=WAITS * SECONDS,
                env=os.environ | alone,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"its reader did not end within {WAITS * SECONDS} s") from None
        except OSError as error:
            raise ValueError(f"its reader cannot be started: {error_reason(error)}") from None
        out.seek(0)
        about = json.loads(out.readline(_LONGEST) or b'{"error": "ended"}')
        if "missing" in about:
            raise is_missing(about["missing"], "volumes")
        if about.get("error") == "memory":
            raise ValueError(f"its reader needs more than {most / 1e9:.3g} GB")
        if about.get("error") == "ended" or ended.returncode:
            raise ValueError(
                f"its reader ended with code {ended.returncode}, within {most / 1e9:.3g} GB and "
                f"{SECONDS} s"
            )
        if "error" in about:
            raise ValueError(error_reason(ValueError(about["error"])))
        corners = np.fromfile(out, np.float64, 3 * about["corners"]).reshape(-1, 3)
        faces = np.fromfile(out, np.int32, 3 * about["faces"]).reshape(-1, 3)
    return Geometry(corners, faces, about["open"], about.get("up"), about.get("unit"))
