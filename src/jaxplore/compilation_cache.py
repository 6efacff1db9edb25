"""Compiled programs, kept on disk for the next process.

JAX can write what XLA compiles to a folder, and read it in place of compiling. It leaves four
things to whoever chooses the folder, and they are here:

- Whoever can write there can run code as the user: the folder belongs to the user alone.
- XLA may use every instruction of the processor that it compiles on: each kind has its own folder.
- The folder grows: the entries that were read longest ago are removed. JAX can do this, but only
  with a lock that it waits for at every program, and only within one processor's folder.
- JAX ignores an entry that it cannot read, and never replaces it: such entries are removed.
"""

import hashlib
import importlib
import os
import platform
import stat
import time
import warnings
import zlib
from importlib.metadata import version
from pathlib import Path
from typing import Final

import jax
import platformdirs
from jax.experimental.compilation_cache.compilation_cache import reset_cache

from jaxplore._checks import positive_int

MAX_SIZE: Final = 2**30
"""Size of the cache from which on entries are removed [bytes]."""

_PREFIX, _SUFFIX, _CHECKED = "jax-", "-cache", ".checked"
_NOISE = tuple(f"Error {what} persistent compilation cache" for what in ("reading", "writing"))
"""How JAX's warnings begin: two processes may read and write, or a disk be full, at any time."""


def enable_compilation_cache(
    path: str | os.PathLike[str] | None = None, *, max_size: int = MAX_SIZE
) -> Path:
    """Keep compiled programs on disk, so that the next process need not compile them again.

    Call it before the first array is made. Processes that this one starts use the same folder.
    Several processes may use it at once. Programs of other versions of JAX, of other processors and
    of other `XLA_FLAGS` are not used; an entry that cannot be read is compiled and written again.

    Args:
        path: folder, made when absent. None: the folder for cached files that the operating system
            gives the user, such as `~/.cache/jaxplore`.
        max_size: size of all entries [bytes]. Beyond it, the least recently used entries are
            removed, now and at each further call.

    Returns:
        The folder within `path` that holds the programs of this processor.

    Raises:
        ValueError: a folder that belongs to another user, that others can write to, or that cannot
            be made; a size < 1.
    """
    positive_int("max_size", max_size)
    given = platformdirs.user_cache_path("jaxplore", appauthor=False) if path is None else path
    name = _folder_name(_processor(), os.environ.get("XLA_FLAGS", ""))
    try:
        # Links are followed once: JAX is given the folder that was looked at.
        root = Path(given).expanduser().resolve()
        folder = root / name
        _make_private(root)
        _make_private(folder)
        folder.chmod(0o700)
        _remove_broken(folder)
        _remove_least_recently_used(root, max_size)
    except (OSError, RuntimeError) as error:
        raise ValueError(f"path is {given}: {error}; accepted: a folder to write") from None
    # From the environment, for processes that this one starts.
    for name, value in {
        "jax_compilation_cache_dir": str(folder),
        # A run compiles a hundred programs of a few milliseconds: together they count.
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
        # XLA's own files would grow without bound.
        "jax_persistent_cache_enable_xla_caches": "none",
    }.items():
        jax.config.update(name, value)  # type: ignore[no-untyped-call]
        os.environ[name.upper()] = str(value)
    # JAX looks at the folder's name once.
    reset_cache()
    _silence()
    return folder


def _folder_name(processor: str, flags: str) -> str:
    """Return the folder's name: everything that a compiled program depends on but itself."""
    text = "\n".join((processor, *sorted(flags.split())))
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    return f"{_PREFIX}{jax.__version__}-{version('jaxlib')}-{digest}"


def _processor() -> str:
    """Return the model and the instruction sets of the processor, as far as the system says."""
    cpuinfo = Path("/proc/cpuinfo")
    if not cpuinfo.exists():
        return f"{platform.system()} {platform.machine()} {platform.processor()}"
    names = ("vendor", "model", "cpu family", "stepping", "flags", "features", "cpu ")
    # Of the first processor. Its clock rate is there as well, and never the same.
    first = cpuinfo.read_text().split("\n\n", 1)[0].splitlines()
    said = [line for line in first if line.lower().startswith(names)]
    return "\n".join(line for line in said if not line.startswith(("cpu MHz", "cpu cores")))


def _make_private(folder: Path) -> None:
    """Make a folder that only its owner can enter, or check that the one that is there can be
    trusted.

    Raises:
        ValueError: it belongs to another user, or others can write to it.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not hasattr(os, "geteuid"):
        return
    # Of the folder itself: a link may be another user's.
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid():
        raise ValueError(f"path is {folder}, another user's; accepted: a folder of your own")
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise ValueError(f"path is {folder}, writable by others; accepted: a folder of mode 700")


def _remove_broken(folder: Path) -> None:
    """Remove entries that were not written to their end, or not by this user.

    An entry is read once. After that only one that was changed since the last call is.
    """
    checked = folder / _CHECKED
    last = checked.stat().st_mtime_ns if checked.exists() else 0
    # Older than whatever other processes write while this one reads.
    now = folder / f"{_CHECKED}-{os.getpid()}-{time.monotonic_ns()}"
    now.touch(mode=0o600)
    owner = folder.stat().st_uid
    for entry in folder.glob(f"*{_SUFFIX}"):
        # Another process may remove it at the same time.
        try:
            found = entry.lstat()
            is_own = stat.S_ISREG(found.st_mode) and found.st_uid == owner
            changed = max(found.st_mtime_ns, found.st_ctime_ns)
            if not is_own or (changed >= last and not _is_whole(entry.read_bytes())):
                entry.unlink()
        except FileNotFoundError:
            continue
    now.replace(checked)


def _is_whole(entry: bytes) -> bool:
    """Say whether an entry can be unpacked. JAX packs with zlib, or Zstandard where it is there."""
    if not entry.startswith(b"\x28\xb5\x2f\xfd"):
        try:
            return bool(zlib.decompress(entry))
        except zlib.error:
            return False
    for name in ("compression.zstd", "zstandard"):
        try:
            return bool(importlib.import_module(name).decompress(entry))
        except ImportError:
            continue
        # The two libraries' own errors, which have no common base.
        except Exception:
            return False
    return False


def _remove_least_recently_used(root: Path, max_size: int) -> None:
    """Remove the entries that were used longest ago, of all versions and processors, until the
    others are no more than `max_size` bytes."""
    entries = []
    for path in root.glob(f"{_PREFIX}*/*{_SUFFIX}"):
        try:
            found = path.lstat()
        except FileNotFoundError:
            continue
        # Read or written; many file systems note the former once a day, some never.
        entries.append((max(found.st_atime_ns, found.st_mtime_ns), found.st_size, path))
    size = sum(each for _, each, _ in entries)
    for _, each, path in sorted(entries):
        if size <= max_size:
            return
        path.unlink(missing_ok=True)
        size -= each


def _silence() -> None:
    """Hide what JAX warns of when an entry cannot be read or written: it compiles instead."""
    for message in _NOISE:
        warnings.filterwarnings("ignore", message, UserWarning)
    given = os.environ.get("PYTHONWARNINGS", "")
    rules = [rule for rule in given.split(",") if rule]
    rules += [rule for message in _NOISE if (rule := f"ignore:{message}") not in rules]
    os.environ["PYTHONWARNINGS"] = ",".join(rules)
