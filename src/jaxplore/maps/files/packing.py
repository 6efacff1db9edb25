"""Pack the files of a map, to send them to another machine."""

import io
import os
from pathlib import Path

import yaml

from jaxplore.maps.files.untrusted import read_yaml

PACKED = "map.yaml"
"""File name of the YAML in a packed map."""


def find_image(path: str | os.PathLike[str]) -> Path | None:
    """Return the path of the image that a ROS map's YAML names, or None if there is none.

    Raises:
        ValueError: a file that is not a YAML mapping.
    """
    entry = read_yaml(Path(path)).get("image")
    if not isinstance(entry, str) or not entry or "\0" in entry:
        return None
    image = Path(path).parent / entry
    return image if image.is_file() else None


def pack_map(path: str | os.PathLike[str]) -> dict[str, bytes]:
    """Return the content of the files of a ROS map or a world, by file names valid in any folder.

    The YAML file becomes `map.yaml`, and refers to its image by the new name.

    Raises:
        ValueError: a file that is not a YAML mapping.
        OSError: a file that cannot be read.
    """
    entries, image = read_yaml(Path(path)), find_image(path)
    if image is None:
        return {PACKED: Path(path).read_bytes()}
    name = f"map{image.suffix}"
    text = io.StringIO()
    yaml.safe_dump({**entries, "image": name}, text, sort_keys=False, allow_unicode=True)
    return {PACKED: text.getvalue().encode(), name: image.read_bytes()}
