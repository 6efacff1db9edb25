"""Pack the files of a map, to send them to another machine."""

import io
import os
from pathlib import Path

import yaml

from jaxplore._files import YAML_LIMIT, read_bytes, read_yaml
from jaxplore.maps.files.images import BYTE_LIMIT

PACKED = "map.yaml"
"""File name of the YAML in a packed map."""


def find_image(path: str | os.PathLike[str]) -> Path | None:
    """Return the path of the image that a ROS map's YAML names, or None if there is none.

    A file that is not a YAML mapping raises a `ValueError`.
    """
    entry = read_yaml(Path(path)).get("image")
    if not isinstance(entry, str) or not entry or "\0" in entry:
        return None
    image = Path(path).parent / entry
    return image if image.is_file() else None


def read_files(path: str | os.PathLike[str]) -> tuple[bytes, bytes | None]:
    """Read the YAML file of a ROS map or a world, and its image; None without one.

    A file that is not a YAML mapping, or that cannot be read, raises a `ValueError`.
    """
    image = find_image(path)
    return (
        read_bytes(Path(path), "a map's YAML", YAML_LIMIT),
        None if image is None else read_bytes(image, "an image", BYTE_LIMIT),
    )


def pack_map(path: str | os.PathLike[str]) -> dict[str, bytes]:
    """Return the content of the files of a ROS map or a world, by file names valid in any folder.

    The YAML file becomes `map.yaml`, and refers to its image by the new name. It raises as
    `read_files`.
    """
    entries, (data, image) = read_yaml(Path(path)), read_files(path)
    if image is None:
        return {PACKED: data}
    name = f"map{Path(str(entries['image'])).suffix}"
    text = io.StringIO()
    yaml.safe_dump({**entries, "image": name}, text, sort_keys=False, allow_unicode=True)
    return {PACKED: text.getvalue().encode(), name: image}
