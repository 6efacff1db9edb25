"""A page of a live view without drawing: it takes what a browser would, until the view is closed.

`python -m benchmarks.view_page LINK` is a process of its own, as a browser's is. It imports little.
"""

import sys
from importlib.metadata import version

import msgspec
from websockets.sync.client import connect


def take(address: str) -> None:
    """Take the messages of a view.

    Args:
        address: link of the view.
    """
    camera = {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (0.0, 0.0, 1.0),
        "look_at": (0.0, 0.0, 0.0),
        "up_direction": (0.0, 0.0, 1.0),
        **dict.fromkeys(("fov", "near", "far"), 1.0),
        **dict.fromkeys(("image_height", "image_width"), 100),
    }
    with connect(
        address.replace("http", "ws"),
        subprotocols=[f"viser-v{version('viser')}"],  # type: ignore[list-item]
        max_size=2**26,
    ) as connection:
        connection.send(msgspec.msgpack.encode(camera))
        for _ in connection:
            pass


if __name__ == "__main__":
    take(sys.argv[1])
