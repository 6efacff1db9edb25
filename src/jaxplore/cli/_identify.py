"""`jaxplore identify`: the motors of a base, from a bag or while somebody drives."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from jaxplore._signals import stop_requests
from jaxplore._text import printable_path
from jaxplore.cli._terminal import say
from jaxplore.onboard.identification import Identified, identify_motors
from jaxplore.onboard.motors import AXES, Motors
from jaxplore.report.console import progress_bar
from jaxplore.report.folder import write_whole
from jaxplore.report.table import print_table
from jaxplore.ros.driven import Driven, driven_topics, listen, read_driven
from jaxplore.ros.link import connect
from jaxplore.settings.defaults import arguments
from jaxplore.settings.node import part_node
from jaxplore.settings.ros_names import check_namespace, check_topic
from jaxplore.settings.sections import read_settings

NODE = "jaxplore_identify"
"""Name of the node that listens."""
BAGS = (".bag", ".db3", ".mcap")
"""Endings of the files of bags."""
OWN_LATENCY = 0.01
"""Latency of the node itself, beside the delay of the motors [s]: it computes in 5 to 15 ms."""
UNITS = ("m/s", "m/s", "rad/s")


def identify(
    source: str,
    out: Path | None,
    *,
    command: str | None,
    pose: str | None,
    namespace: str | None,
    seconds: float,
    overwrite: bool,
) -> None:
    """Identify motors from a bag, or from the commands on a topic; print and write them."""
    if out is not None and out.exists() and not overwrite:
        raise ValueError(f"{printable_path(out)} exists; accepted: another file, or --overwrite")
    driven = (
        _listen(source, pose, namespace, seconds)
        if _is_topic(source)
        else _read(Path(source), command, pose)
    )
    if driven.num_malformed:
        say(f"{driven.num_malformed} malformed messages were left out", err=True)
    found = identify_motors(driven.drive())
    print_table(_rows(found), title=f"motors, from {found.seconds:.0f} s", has_header=True)
    for axis in np.flatnonzero(~found.is_used):
        say(f"{AXES[axis]} hardly changes, and was left out", err=True)
    if out is not None:
        text = _as_yaml(found.motors, source)
        write_whole(out, lambda stream: stream.write(text.encode()), "settings")
        say(f"{printable_path(out)}: jaxplore node --settings, jaxplore robot --motors")


def read_motors(path: Path) -> Motors:
    """Read the motors of a settings file of a node."""
    _, node = part_node(read_settings(path))
    return Motors(**arguments(node.motors, Motors))


def _is_topic(source: str) -> bool:
    """Check whether a source is the name of a topic, and no bag that is there or is missing."""
    path = Path(source)
    if path.exists() or path.suffix in BAGS:
        return False
    return path.parent in (Path("."), Path("/")) or not path.parent.is_dir()


def _read(path: Path, command: str | None, pose: str | None) -> Driven:
    commands, poses = driven_topics(path, command, pose)
    say(f"Reading {commands} and {poses}", err=True)
    return read_driven(path, commands, poses)


def _listen(topic: str, pose: str | None, namespace: str | None, seconds: float) -> Driven:
    """Listen until the time is over, or the user says that it is enough."""
    topic = check_topic("BAG_OR_TOPIC", topic)
    pose = check_topic("--pose", "odom" if pose is None else pose)
    if namespace is not None:
        namespace = check_namespace("--namespace", namespace)
    with connect(NODE, namespace) as link, stop_requests() as is_stopped:
        say(
            f"Listening to {link.topic(topic)} and {link.topic(pose)} for {seconds:g} s: drive, "
            "with starts, stops and turns; Ctrl-C ends it sooner.",
            err=True,
        )
        with progress_bar("listening", enabled=True) as advance:
            return listen(link, topic, pose, seconds, is_stopped, advance)


def _rows(found: Identified) -> list[tuple[str, ...]]:
    """Return the table of what was found, an axis a column."""
    motors, used = found.motors, np.flatnonzero(found.is_used)

    def row(name: str, values: np.ndarray, errors: np.ndarray | None, scale: float) -> Any:
        cells = []
        for axis in used:
            value, error = float(values[axis]), None if errors is None else float(errors[axis])
            told = "not reached" if math.isinf(value) else f"{scale * value:.4g}"
            is_told = error is not None and math.isfinite(error) and math.isfinite(value)
            cells.append(f"{told} ± {scale * error:.2g}" if is_told and error is not None else told)
        return (name, *cells)

    delays = np.full(3, motors.delay), np.full(3, found.delay_error)
    return [
        ("", *(f"{AXES[axis]} [{UNITS[axis]}]" for axis in used)),
        row("delay [ms]", *delays, 1e3),
        row("lag [ms]", motors.lag, found.lag_errors, 1e3),
        row("dead zone", motors.dead_zone, found.dead_zone_errors, 1.0),
        row("greatest", motors.max_speed, found.max_speed_errors, 1.0),
        row("error before", found.before, None, 1.0),
        row("error after", found.after, None, 1.0),
    ]


def _as_yaml(motors: Motors, source: str) -> str:
    """Return the settings of a node with these motors."""

    def rounded(values: np.ndarray) -> list[float | None]:
        return [round(each, 5) if math.isfinite(each) else None for each in values.tolist()]

    entries = {
        "node": {
            "latency": OWN_LATENCY,
            "motors": {
                "delay": round(motors.delay, 5),
                "lag": rounded(motors.lag),
                "dead_zone": rounded(motors.dead_zone),
                "max_speed": rounded(motors.max_speed),
            },
        }
    }
    body = yaml.safe_dump(entries, sort_keys=False, default_flow_style=None)
    return f"# Identified by jaxplore from {printable_path(Path(Path(source).name))}.\n{body}"
