"""The memory that runs may take: a share of what is free, in the machine and in its container."""

import os
from collections.abc import Iterator
from pathlib import Path

SHARE = 0.8
"""Share of the available memory that runs may take by default."""
_ROOT = Path("/")
_UNLIMITED = 2**60
"""Limits of control groups above this are none."""


def default_limit(root: Path = _ROOT) -> float:
    """Return the memory that runs may take by default [bytes].

    It is `SHARE` of the least of the memory that Linux says is available, and of what is left of
    the limit of the control group (version 1 or 2) and of each that holds it; elsewhere of the
    memory of the machine, infinite if unknown. Tests give another `root` of the file system.
    """
    return SHARE * min([_available(root), *_free_in_groups(root)])


def _available(root: Path) -> float:
    for line in _read(root / "proc/meminfo").splitlines():
        name, _, value = line.partition(":")
        if name == "MemAvailable":
            return 1024.0 * float(value.split()[0])
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def _free_in_groups(root: Path) -> Iterator[float]:
    """Yield what is left of each memory limit of this process's control groups [bytes]."""
    for line in _read(root / "proc/self/cgroup").splitlines():
        _, _, rest = line.partition(":")
        controllers, _, group = rest.partition(":")
        if controllers == "":
            mount, names = root / "sys/fs/cgroup", ("memory.max", "memory.current")
        elif "memory" in controllers.split(","):
            mount = root / "sys/fs/cgroup/memory"
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes")
        else:
            continue
        # In a container the group may be named as seen from outside: its own limit is at the mount.
        parts = Path(group.lstrip("/"))
        for folder in (mount / parts, *(mount / each for each in parts.parents)):
            most, used = (_number(_read(folder / name)) for name in names)
            if most is not None and most < _UNLIMITED:
                # Cached files count as used, and are given up when memory is needed.
                cached = _entry(_read(folder / "memory.stat"), "inactive_file")
                yield most - max(0.0, (used or 0.0) - cached)


def _entry(text: str, name: str) -> float:
    for line in text.splitlines():
        key, _, value = line.partition(" ")
        if key == name:
            return _number(value) or 0.0
    return 0.0


def _number(text: str) -> float | None:
    return float(text) if text.strip().isdecimal() else None


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
