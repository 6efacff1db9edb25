"""Files that are no files, sizes, coordinates and names that reach a terminal."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import yaml

from . import places
from .contents import Found, encoded, writing

PLACES: dict[str, list[str]] = {
    "map": ["run", "{it}"],
    "settings": ["run", "office", "--settings", "{it}"],
    "path": ["run", "--path", "{it}"],
    "resume": ["run", "--resume", "{it}", "--out", "new"],
    "out": ["run", "{base}/room.yaml", "--out", "{it}"],
    "record": ["run", "{base}/room.yaml", "--record", "{it}", "--out", "new"],
    "video": ["run", "{base}/room.yaml", "--video", "{it}", "--out", "new"],
    "height map": ["run", "{base}/map.yaml", "--set", "terrain.height_map={it}"],
    "maps": ["compare", "--maps", "{it}", "--out", "new"],
    "starts": ["compare", "--maps", "{base}/maps", "--starts", "{it}", "--out", "new"],
    "variants": ["compare", "office", "--variants", "{it}"],
    "comparison": ["compare", "--maps", "{base}/maps", "--out", "{it}"],
    "also": ["tune", "office", "--tune", "controller.temperature", "--also", "{it}"],
    "study": ["tune", "office", "--tune", "controller.temperature", "--out", "{it}"],
    "node": ["node", "--settings", "{it}"],
    "drive": ["node", "--out", "{it}"],
    "bag": ["replay", "{it}"],
    "run folder": ["view", "{it}"],
    "nav2": ["import-nav2", "{it}"],
    "settings to write": ["import-nav2", "{base}/nav2.yaml", "--out", "{it}"],
    "robot": ["robot", "{it}"],
}
"""Options and arguments that name a file or a folder."""


def _fifo(path: Path) -> None:
    os.mkfifo(path)


def _socket(path: Path) -> None:
    # The address of a socket is short: it is given within its folder.
    former = Path.cwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as opened:
            opened.bind(path.name)
    finally:
        os.chdir(former)


def _loop(path: Path) -> None:
    path.symlink_to(path.name)


def _dangling(path: Path) -> None:
    path.symlink_to("nowhere")


def _without_rights(path: Path) -> None:
    path.write_text("seed: 1\n")
    path.chmod(0)


def _of_fifos(path: Path) -> None:
    """Make a folder in which the files of a run, a study, a comparison and a map are pipes."""
    path.mkdir()
    names = ("metrics.json", "state.npz", "settings.yaml", "study.jsonl", "comparison.json")
    for name in (*names, "map.yaml", "starts.yaml", "metadata.yaml", ".lock"):
        os.mkfifo(path / name)


def _of_folders(path: Path) -> None:
    """Make a folder in which these files are folders."""
    names = ("metrics.json", "state.npz", "settings.yaml", "study.jsonl", "comparison.json", "runs")
    for name in (*names, "map.yaml", "starts.yaml", "metadata.yaml", ".lock"):
        (path / name).mkdir(parents=True)


KINDS: dict[str, Callable[[Path], None]] = {
    "a pipe": _fifo,
    "a socket": _socket,
    "a folder": Path.mkdir,
    "an empty file": Path.touch,
    "a link to itself": _loop,
    "a dangling link": _dangling,
    "a file without rights": _without_rights,
    "a folder of pipes": _of_fifos,
    "a folder of folders": _of_folders,
}
NAMES = {
    "a device that never ends": "/dev/zero",
    "an empty device": "/dev/null",
    "a terminal": "/dev/tty",
    "standard input": "/dev/stdin",
    "a file of the kernel": "/proc/self/mem",
    "a folder of the kernel": "/proc/self/fd",
    "no name": "",
    "a long name": "x" * 5000,
    "deep folders": "x/" * 3000 + "x",
    "the root": "/",
    "a file as folder": "{base}/map.pgm/inside",
    "here": ".",
    "above": "..",
    "a scheme": "file:///etc/passwd",
}
_ENDINGS = {"record": ".mcap", "video": ".mp4", "path": ".csv"}


def no_files() -> Found:
    """Yield everything that is no regular file, in every place for a file or folder."""
    for place, arguments in PLACES.items():
        # Some places look at the ending of a name first.
        it = "it" + _ENDINGS.get(place, ".yaml")
        for name, make in KINDS.items():

            def prepare(folder: Path, make: Callable[[Path], None] = make, it: str = it) -> None:
                make(folder / it)

            yield f"{name} as {place}", [each.replace("{it}", it) for each in arguments], prepare
        for name, path in NAMES.items():
            yield f"{name} as {place}", [each.replace("{it}", path) for each in arguments], None


IMPOSSIBLE = {
    "run {base}/room.yaml --set": (
        *("controller.horizon=1000000000", "controller.num_samples=1000000000"),
        *("fields.num_directions=1000000000", "lidar.num_beams=1000000000", "lidar.max_range=1e9"),
        *(
            "controller.num_iterations=1000000000",
            "time_limit=1e30",
            "time_limit=1e12",
            "seed=1e30",
        ),
        *("seed=100000000000000000000", "rates.control=1e12", "controller.horizon=100000000000000"),
    ),
    "run office --set": ("office.width=1e9", "office.height=5000", "resolution=1e-9"),
    "run zones --set": (
        *("informative.horizon=1000000000", "informative.num_samples=1000000000"),
        *("informative.field_range=1e9", "fields.num_directions=1000000000"),
        *("informative.local_range=1e9", "informative.num_samples=100000000000000000000"),
    ),
    "run warehouse --set": ("portfolio.num_samples=1000000000", "portfolio.horizon=1000000000"),
    "run path --set": (
        *("laps=100000000000000000000", "obstacles.number=1000000000", "track.bends=1000000"),
        *("controller.horizon=1000000000", "controller.num_samples=1000000000"),
        *("obstacles.number=100000000000000000000", "track.bends=1000000000"),
    ),
    "run path": ("--laps 99999999999999999999", "--obstacles 1000000000"),
    "node --set": ("node.map_size=1e9", "controller.horizon=1000000000", "node.map_size=1e30"),
    "compare office": (
        *("--seeds 1000000000", "--seeds 99999999999999999999", "--workers 1000000000"),
        *("--seed 99999999999999999999", "--beams 1000000000", "--samples 1000000000"),
        *("--fps 1e30", "--film-scale 1e30", "--film-scale 1e9", "--range 1e9"),
    ),
    "compare --maps {base}/maps": (
        *("--seeds 1000000000", "--batch 1000000000", "--workers 1000000000", "--range 1e9"),
        *("--time-limit 1e30", "--resolution 1e-9", "--beams 1000000000"),
    ),
    "tune {base}/room.yaml --tune controller.temperature": (
        *("--seeds 1000000000", "--unseen 1000000000", "--population 1000000000"),
        *("--batch 1000000000", "--workers 1000000000", "--measure coverage=0:1:1000000000"),
        "--measure coverage=0:1:99999999999999999999",
    ),
    "robot office": ("--delay 1e30", "--range 1e9"),
}
"""Settings and options for which no machine has room."""
HUGE = {
    "run office --set": (
        *("office.room_size=1e-9", "controller.horizon=1e9", "robot.radius=1e30", "resolution=1e9"),
        *("robot.max_speed=1e30", "fields.range=1e9", "fields.noise=1e30", "fields.stride=1e9"),
    ),
    "run zones --set": ("informative.local_extent=1e9", "informative.field_noise=1e30"),
    "run path --set": (
        *("track.length=1e12", "half_width=1e12", "obstacles.radius=1e12"),
        *("obstacles.speeds=[1e30, 1e30]", "robot.max_speed=1e30"),
    ),
    "node --set": ("node.latency=1e30", "node.max_age=1e30", "node.done_after=1e30"),
    "compare office": (
        "--vary controller.temperature=" + ",".join(["1"] * 3000),
        "--architectures " + ",".join(["explorer"] * 2000),
    ),
    "compare --maps {base}/maps": ("--resolution 1e9", "--radius 1e9", "--max-speed 1e30"),
    "tune {base}/room.yaml --tune controller.temperature": (
        *("--budget 99999999999999999999999", "--budget 1e30s", f"--budget {'9' * 400}h"),
        *("--tune controller.horizon=1:1000000000", "--tune controller.num_samples=1:1e18"),
    ),
    "robot office": ("--drift 1e30", "--mount 1e30 0 0", "--mount nan 0 0"),
    "view {base}/run": ("--port 99999999999",),
}
"""Settings and options that are huge, and may be accepted where they cost nothing."""


def impossible() -> Found:
    """Yield settings and options for which no machine has room."""
    yield from _given(IMPOSSIBLE)


def _given(options: dict[str, tuple[str, ...]]) -> Found:
    for command, some in options.items():
        for each in some:
            # A list of values in brackets is one word.
            words = [each] if command.endswith("--set") else each.split()
            yield f"{command} {each[:60]}", [*command.split(), *words], None


def sizes() -> Found:
    """Yield settings, options, maps, worlds and paths of sizes that nothing has."""
    yield from _given(HUGE)
    for side in (9_000, 60_000, 10**9):

        def sparse(folder: Path, side: int = side) -> None:
            """Write a map of zeros, which takes no room on the disk."""
            (folder / "map.yaml").write_text(yaml.safe_dump(places.MAP))
            with (folder / "map.pgm").open("wb") as file:
                file.write(f"P5 {side} {side} 255\n".encode())
                file.truncate(min(side * side, 2**32))

        yield f"a map of {side} x {side} cells", ["run", "map.yaml"], sparse
    for name, entries in {
        "a world of 1000 km": {"size": [1e6, 1e6]},
        "a world of 1e300 m": {"size": [1e300, 1e300]},
        "cells of a nanometre": {"resolution": 1e-9},
        "cells of 1e300 m": {"resolution": 1e300},
        "a world of a line": {"size": [1e9, 1.0]},
        "walls of 1e9 m": {"hidden": {"walls": [[0.0, 0.0, 1e9, 1e9]]}},
        "a reach of 1e9 m": {"wall_reach": 1e9},
        "many walls": {"hidden": {"walls": [[0.0, 0.1 * i, 1.0, 0.0] for i in range(3000)]}},
        "many targets": {"targets": [[0.001 * i, 1.0] for i in range(3000)]},
        "a fast mover": {"movers": [{"path": [[0, 0], [1, 0]], "speed": 1e30, "radius": 1e9}]},
        "hills of 1e9 m": {"hills": [[1.0, 1.0, 1e9, 1e-9]]},
    }.items():
        document = yaml.safe_dump(places.ROOM | entries)
        yield name, ["run", "world.yaml"], writing({"world.yaml": document})
    for name, rows in {
        "a path of a million rows": "0,0\n1,1\n" * 500_000,
        "a path of 1e30 m": "0,0\n1e30,0\n1e30,1e30\n",
        "a path of a nanometre": "0,0\n1e-9,0\n2e-9,1e-9\n",
        "a path of a row": "0,0\n",
        "a path of one place": "1,1\n" * 1000,
        "a path of a row of 100 columns": ",".join(["1"] * 100) + "\n",
        "a path with a row of 5 MB": "1" * 5_000_000 + ",1\n",
    }.items():
        yield name, ["run", "--path", "p.csv"], writing({"p.csv": rows})


FAR = (1e5, 4_649_776.0, 1e6, 1e9, 1e30, 1e308, float("inf"), float("nan"))


def coordinates() -> Found:
    """Yield maps, worlds, paths, starts and goals that are far away, or nowhere."""
    for far in FAR:
        described = {**places.MAP, "origin": [far, far, 0.5]}
        files = {"map.yaml": yaml.safe_dump(described), "map.pgm": encoded("PPM")}
        yield f"the origin of a map at {far:g}", ["run", "map.yaml"], writing(files)
        start = ["--start", f"{far:.17g}", f"{far:.17g}", "0"]
        yield f"map and start at {far:g}", ["run", "map.yaml", *start], writing(files)
        yield f"a start at {far:g}", ["run", "{base}/room.yaml", *start], None
        goal = ["--goal", f"{far:.17g}", "1"]
        yield f"a goal at {far:g}", ["run", "{base}/room.yaml", *goal], None
        yield f"a yaw of {far:g}", ["run", "office", "--start", "4", "4", str(far)], None
        world = yaml.safe_dump(
            {**places.ROOM, "origin": [far, far], "start": [far + 1.0, far + 1.5, 0.0]}
        )
        yield f"a world at {far:g}", ["run", "w.yaml"], writing({"w.yaml": world})
        rows = "".join(f"{far + x!r},{far + 0.1 * x * x!r}\n" for x in range(6))
        yield f"a path at {far:g}", ["run", "--path", "p.csv"], writing({"p.csv": rows})
        obstacles = f"obstacles.discs=[[{far!r}, 0.0, 1.0]]"
        yield f"an obstacle at {far:g}", ["run", "path", "--set", obstacles], None
        starts = yaml.safe_dump({"east": [far, far, far]})
        arguments = ["compare", "--maps", "{base}/maps", "--starts", "s.yaml"]
        yield f"starts at {far:g}", arguments, writing({"s.yaml": starts})
        yield f"a lidar at {far:g}", ["node", "--set", f"node.lidar_x={far!r}"], None


TEXTS = {
    "markup": "[/red]",
    "open markup": "[bold",
    "a link": "[link=file:///etc/passwd]x[/link]",
    "an escape sequence": "\x1b[31mred\x1b[2J",
    "a title": "\x1b]0;title\x07",
    "a bell": "a\x07b",
    "a carriage return": "good\rbad",
    "lines": "one\ntwo\nthree",
    "a tab": "a\tb",
    "backspaces": "abc\b\b\b",
    "a C1 control": "a\x9b31mb",
    "a right-to-left mark": "\u202egpj.exe",
    "a zero-width mark": "a\u200bb\u2066c",
    "a line separator": "a\u2028b\u0085c",
    "no UTF-8": "a\udcff\udc80b",
    "a long word": "x" * 6000,
    "a long word of signs": "ü" * 3000,
    "spaces": " " * 3000,
    "quotes": "'\"`$(id)",
    "percent": "%s%n{0}{x}",
    "emoji": "🤖" * 400,
    "a slash": "a/../../b",
}
"""Texts that may not reach a terminal as they are."""
NAMED = {
    "map": ["run", "{it}"],
    "command": ["{it}"],
    "option": ["run", "--{it}"],
    "option of one letter": ["run", "-{it}"],
    "settings file": ["run", "office", "--settings", "{it}"],
    "setting": ["run", "office", "--set", "{it}=1"],
    "assignment": ["run", "office", "--set", "{it}"],
    "value": ["run", "office", "--set", "robot.model={it}"],
    "value of a number": ["run", "office", "--set", "robot.radius={it}"],
    "parameter": ["run", "office", "--set", "parameters.{it}=1"],
    "architecture": ["run", "office", "--architecture", "{it}"],
    "own architecture": ["run", "office", "--architecture", "{it}:{it}", "--trust"],
    "robot": ["run", "office", "--robot", "{it}"],
    "out": ["run", "{base}/room.yaml", "--out", "{base}/run/{it}/x"],
    "figures": ["run", "office", "--figures", "{it}"],
    "record": ["run", "office", "--record", "{it}.mcap"],
    "video": ["run", "office", "--video", "{it}.gif"],
    "number": ["run", "office", "--seed", "{it}"],
    "variants": ["compare", "office", "--variants", "{it}"],
    "variant": ["compare", "office", "--vary", "{it}=1,2"],
    "varied value": ["compare", "office", "--vary", "robot.model={it},{it}"],
    "architectures": ["compare", "office", "--architectures", "{it},{it}"],
    "address": ["compare", "office", "--address", "{it}"],
    "tuned": ["tune", "office", "--tune", "{it}"],
    "bounds": ["tune", "office", "--tune", "controller.temperature={it}"],
    "objective": ["tune", "office", "--tune", "controller.temperature", "--objective", "{it}"],
    "optimizer": ["tune", "office", "--tune", "controller.temperature", "--optimizer", "{it}"],
    "measure": ["tune", "office", "--tune", "controller.temperature", "--measure", "{it}"],
    "budget": ["tune", "office", "--tune", "controller.temperature", "--budget", "{it}"],
    "also": ["tune", "office", "--tune", "controller.temperature", "--also", "{it}"],
    "shown setting": ["settings", "{it}"],
    "topic": ["node", "--set", "node.scan_topic={it}"],
    "namespace": ["node", "--namespace", "{it}"],
    "robot's namespace": ["robot", "office", "--namespace", "{it}"],
    "mode": ["node", "--mode", "{it}"],
    "bag": ["replay", "{it}"],
    "bag's topic": ["replay", "{base}/bag", "--scan", "{it}"],
    "host": ["view", "{base}/run", "--host", "{it}"],
    "folder": ["view", "{it}"],
    "nav2": ["import-nav2", "{it}"],
    "controller": ["import-nav2", "{base}/nav2.yaml", "--controller", "{it}"],
}
"""Places for a text on the command line."""


IN_FILES = {
    "an entry of settings": ("{it}: 1", ["run", "office", "--settings", "d.yaml"]),
    "a value of settings": (
        "robot: {model: {it}}",
        ["run", "{base}/room.yaml", "--settings", "d.yaml"],
    ),
    "an image": ("resolution: 0.1\norigin: [0, 0, 0]\nimage: {it}", ["run", "d.yaml"]),
    "an entry of a world": ("size: [4, 3]\nstart: [1, 1, 0]\n{it}: 1", ["run", "d.yaml"]),
    "a start": ("{it}: [0, 0, 0]", ["compare", "--maps", "{base}/maps", "--starts", "d.yaml"]),
    "a parameter of nav2": (
        "FollowPath: {plugin: 'x::MPPIController', vx_max: 1, {it}: 1}",
        ["import-nav2", "d.yaml"],
    ),
    "a controller of nav2": (
        "{it}: {plugin: 'x::MPPIController', vx_max: 1}",
        ["import-nav2", "d.yaml"],
    ),
}
"""Places for a text in files."""


def terminals() -> Found:
    """Yield every such text in every place, and in the names of files, maps and their entries."""
    for name, text in TEXTS.items():
        for place, arguments in NAMED.items():
            yield f"{name} as {place}", [each.replace("{it}", text) for each in arguments], None
        quoted = yaml.safe_dump(text.encode("utf-8", "replace").decode(), allow_unicode=False)
        for place, (document, arguments) in IN_FILES.items():
            value = quoted.replace("\n...\n", "").strip().replace("\n", " ")
            files: dict[str, bytes | str] = {"d.yaml": document.replace("{it}", value)}
            yield f"{name} as {place}", arguments, writing(files)
        if "/" in text or len(text) > 200:
            continue

        def named(folder: Path, text: str = text) -> None:
            """Write a map and a folder of maps with this name."""
            writing({f"{text}.yaml": yaml.safe_dump(places.MAP), "map.pgm": encoded("PPM")})(folder)

        yield f"a map called {name}", ["run", f"{text}.yaml"], named
        yield (
            f"a map without an image called {name}",
            ["run", f"{text}.yaml", "--start", "0", "0", "0"],
            named,
        )
        yield (
            f"a map in a folder called {name}",
            ["compare", "--maps", ".", "--out", "../base/run"],
            named,
        )
