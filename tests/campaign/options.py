"""Bad values of every option of every command, of every setting, and options that do not go."""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import click

from jaxplore.cli import cli
from jaxplore.cli._known import load_known

from .contents import Found, writing

BY_TYPE: dict[str, tuple[str, ...]] = {
    "integer": ("", "x", "1.5", "-1", "0", "99999999999999999999", "nan", "1e3", "0x10", "²"),
    "float": ("", "x", "nan", "inf", "-inf", "1e400", "-1", "0", "1e-320", "1_000", "٣"),
    "text": ("", " ", ",", "=", ":", "-", "--", "x,,y", "../..", "None", "[1]", "{}", "*", "0"),
    "choice": ("", "zzz", "CONTROL"),
}
"""Values by the name of click's type."""
NEEDED = {
    "run": ["{base}/room.yaml"],
    "compare": ["{base}/room.yaml"],
    "tune": ["{base}/room.yaml", "--tune", "controller.temperature"],
    "robot": ["{base}/room.yaml"],
    "replay": ["{base}/bag"],
    "view": ["{base}/run"],
    "import-nav2": ["{base}/nav2.yaml"],
    "merge": ["{base}/map.yaml", "{base}/map.yaml"],
}
"""What commands need to begin."""


def options() -> Found:
    """Yield every option of every command with every value of its type."""
    for name, command in cli.commands.items():
        for option in _options(command):
            for value in BY_TYPE.get(option.type.name, BY_TYPE["text"]):
                given = [value] * option.nargs
                arguments = [name, *NEEDED.get(name, []), option.opts[0], *given]
                yield f"{name} {option.opts[0]} {value!r}", arguments, None
            once = [name, *NEEDED.get(name, []), option.opts[0]]
            yield f"{name} {option.opts[0]} without a value", once, None


def _options(command: click.Command) -> Iterator[click.Option]:
    for parameter in command.params:
        if isinstance(parameter, click.Option) and not parameter.is_flag:
            yield parameter


VALUES = (
    *("", "null", "true", "x", "[]", "{}", "-1", "0", "1e400", ".nan", ".inf", "-.inf", "1e12"),
    *("[1, 2]", "[x]", "{a: 1}", "'1'", "2024-01-01", "!!bool foo", "[[[1]]]", "0.5", "!!set {a}"),
)
"""Values in YAML, of every type."""


def assignments() -> Found:
    """Yield every setting with every value."""
    for name, value in itertools.product(load_known().settings, VALUES):
        place = "path" if name.split(".")[0] in _OF_PATHS else "{base}/room.yaml"
        command = ["node"] if name.startswith("node.") else ["run", place]
        yield f"{name}={value}", [*command, "--set", f"{name}={value}"], None
    for section, value in itertools.product(load_known().sections, VALUES):
        place = "path" if section in _OF_PATHS else "{base}/room.yaml"
        yield f"{section}={value}", ["run", place, "--set", f"{section}={value}"], None


_OF_PATHS = ("path", "laps", "track", "obstacles", "half_width", "cost", "spline")


def combinations() -> Found:
    """Yield options that do not go together, commands without arguments, and repeated names."""
    for text in (
        *("", "run", "compare", "tune", "view", "replay", "import-nav2", "robot", "fly", "-"),
        *("run run", "run office zones", "run office --overwrite=3", "run office --no-animation=x"),
        "run office --path {base}/path.csv",
        "run path --path {base}/map.yaml",
        "run path --start 0 0 0 --goal 1 1",
        "run office --laps 3",
        "run office --resume {base}/run",
        "run --resume {base}/run",
        "run --resume {base}/run --settings {base}/settings.yaml --out x",
        "run --resume {base}/run --view --out x",
        "run --resume {base} --out x",
        "run --resume {base}/study --out x",
        "run office --fps 3 --no-animation",
        "run office --view-port 3",
        "run office --host 0.0.0.0",
        "run office --out {base}/run",
        "run office --out {base}/maps --overwrite",
        "run office --out {base}/study --overwrite",
        "run office --out {base}/map.pgm --overwrite",
        "run office --record {base}/map.pgm",
        "run office --record {base}/map.pgm --overwrite",
        "run office --record x.bag",
        "run office --video {base}/map.png",
        "run office --video x.exe",
        "run office --architecture os:system",
        "run office --architecture os:system --trust",
        "run office --architecture nothing.at_all:x --trust",
        "run office --architecture :x --trust",
        "run office --architecture os:path --trust",
        "run office --robot quadrotor",
        "run zones --robot ackermann",
        "compare office --architectures explorer,explorer",
        "compare office --architectures ,",
        "compare office --architectures explorer,",
        "compare office --vary controller.temperature=1,1",
        "compare office --vary controller.temperature=",
        "compare office --vary controller.temperature",
        "compare office --vary =1,2",
        "compare office --vary seed=1,2 --vary seed=3,4",
        "compare office --vary wings=1,2",
        "compare office --vary map=office,zones",
        "compare office --variants {base}/settings.yaml,{base}/settings.yaml",
        "compare office --variants {base}/nothing.yaml",
        "compare office --starts {base}/maps/starts.yaml",
        "compare office --batch 3",
        "compare office --maps {base}/maps",
        "compare path",
        "compare --maps {base}",
        "compare --maps {base}/run",
        "compare --maps {base}/map.yaml",
        "compare --maps {base}/maps --out {base}/study",
        "compare --maps {base}/maps --out {base}/run --overwrite",
        "compare --maps {base}/maps --out {base}/study --overwrite",
        "compare --maps {base}/maps --out {base}/comparison --samples 3",
        "compare --maps {base}/maps --ray --workers 0",
        "compare --maps {base}/maps --address nowhere",
        "compare --maps {base}/maps --fps 3",
        "tune office",
        "tune office --tune controller.temperature --overwrite",
        "tune office --tune controller.temperature --tune controller.temperature",
        "tune office --tune controller.temperature=3:1",
        "tune office --tune controller.temperature=0:1:log",
        "tune office --tune controller.temperature=1",
        "tune office --tune controller.temperature=nan:inf",
        "tune office --tune controller.horizon=a,b",
        "tune office --tune map",
        "tune office --tune robot.model=differential_drive,submarine",
        "tune office --tune controller.temperature --also office",
        "tune office --tune controller.temperature --also zones --also zones",
        "tune office --tune controller.temperature --out {base}/run",
        "tune office --tune controller.temperature --out {base}/comparison",
        "tune office --tune controller.temperature --out {base}/study",
        "tune office --tune controller.temperature --batch 2 --workers 2",
        "tune office --tune controller.temperature --objective coverage;coverage",
        "tune office --tune controller.temperature --objective ;",
        "tune office --tune controller.temperature --objective nothing",
        "tune office --tune controller.temperature --measure coverage=1:0",
        "tune office --tune controller.temperature --measure coverage=0:1:0",
        "tune office --tune controller.temperature --measure coverage=nan:1",
        "node --mode fly",
        "node office",
        "node --record x.txt",
        "node --settings {base}/map.yaml",
        "node --set node.lidar_x=wide",
        "robot path",
        "robot zones",
        "replay {base}",
        "replay {base}/run",
        "replay {base}/map.pgm",
        "replay {base}/bag --scan /odom",
        "replay {base}/bag --pose /scan",
        "replay {base}/bag --scan nothing",
        "replay {base}/bag/bag.db3 --out {base}/run",
        "view {base}",
        "view {base}/study",
        "view {base}/run --port -1",
        "view {base}/run --host nowhere.invalid",
        "settings lidar robot",
        "settings lidar.",
        "settings .",
        "settings ''",
        "import-nav2 {base}/settings.yaml",
        "import-nav2 {base}/nav2.yaml --out {base}/settings.yaml",
        "import-nav2 {base}/nav2.yaml --controller nothing",
        "import-nav2 {base}/nav2.yaml --out {base}/run --overwrite",
        "import-nav2 {base}/nav2.yaml --out nowhere/x.yaml",
    ):
        yield text or "nothing", text.split(), None
    yield "an own scenario with code", ["run", "s.yaml"], _own("architecture: os:system")
    yield "settings of a map and a path", ["run", "s.yaml"], _own("path: track")


def _own(line: str) -> Callable[[Path], None]:
    return writing({"s.yaml": f"map: office\n{line}\nrobot: {{radius: 0.2}}\n"})
