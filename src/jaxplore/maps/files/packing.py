"""The files of a map, to be sent where this disk is not."""

import io
import os
from pathlib import Path

import yaml

from jaxplore.maps.files._files import read_yaml

PACKED = "map.yaml"
"""Name of the YAML file in a packed map."""


def image_of(path: str | os.PathLike[str]) -> Path | None:
    """Return the file that a ROS map's YAML names as its image; None if there is none.

    Raises:
        ValueError: no YAML mapping.
    """
    entry = read_yaml(Path(path)).get("image")
    if not isinstance(entry, str) or not entry or "\0" in entry:
        return None
    image = Path(path).parent / entry
    return image if image.is_file() else None


def packed(path: str | os.PathLike[str]) -> dict[str, bytes]:
    """Return the files of a ROS map or of a world by name, so that they can lie in any folder.

    The YAML file is `map.yaml`, and names its image anew.

    Raises:
        ValueError: no YAML mapping.
        OSError: a file that cannot be read.
    """
    entries, image = read_yaml(Path(path)), image_of(path)
    if image is None:
        return {PACKED: Path(path).read_bytes()}
    name = f"map{image.suffix}"
    text = io.StringIO()
    yaml.safe_dump({**entries, "image": name}, text, sort_keys=False, allow_unicode=True)
    return {PACKED: text.getvalue().encode(), name: image.read_bytes()}
