"""A persistent cache of compiled programs on disk.

JAX can store compiled programs in a folder and load them instead of compiling again. It leaves
four things to the application, and this module does them:

- Anyone who can write to the folder can run code as the user: the folder is private to the user.
- XLA uses all instructions of the processor it compiles on: each processor type has its own folder.
- The folder grows: the least recently used entries are removed. JAX can do this too, but it waits
    for a lock at every program, and counts one processor's folder only.
- JAX ignores an unreadable entry and never replaces it: such entries are removed.
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

from jaxplore import _checks, _kinds

MAX_SIZE: Final = 2**30
"""Size of the cache above which entries are removed [bytes]."""

_PREFIX, _SUFFIX, _CHECKED = "jax-", "-cache", ".checked"
_NOISE = tuple(f"Error {what} persistent compilation cache" for what in ("reading", "writing"))
"""First words of JAX's warnings about the cache. They are harmless: another process may be writing
the same entry, or the disk may be full, and then JAX compiles."""


@_kinds.check_arguments
def enable_compilation_cache(
    path: str | os.PathLike[str] | None = None, *, max_size: int = MAX_SIZE
) -> Path:
    """Store compiled programs on disk, so that the next process need not compile them again.

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
    _checks.positive_int("max_size", max_size)
    given = platformdirs.user_cache_path("jaxplore", appauthor=False) if path is None else path
    name = _folder_name(_processor(), os.environ.get("XLA_FLAGS", ""))
    try:
        # Links are resolved once, so that JAX uses the very folder that was checked.
        root = Path(given).expanduser().resolve()
        folder = root / name
        _make_private(root)
        _make_private(folder)
        folder.chmod(0o700)
        _remove_broken(folder)
        _remove_least_recently_used(root, max_size)
    except (OSError, RuntimeError) as error:
        raise ValueError(f"path is {given}: {error}; accepted: a folder to write") from None
    # Set in the environment, so that child processes inherit the settings.
    for name, value in {
        "jax_compilation_cache_dir": str(folder),
        # No minimum compile time: a run compiles a hundred programs of a few milliseconds each,
        # which together matter.
        "jax_persistent_cache_min_compile_time_secs": 0.0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
        # XLA's own cache files would grow without bound.
        "jax_persistent_cache_enable_xla_caches": "none",
    }.items():
        jax.config.update(name, value)  # type: ignore[no-untyped-call]
        os.environ[name.upper()] = str(value)
    # JAX reads the name of the folder only once, at first use.
    reset_cache()
    _silence()
    return folder


def _folder_name(processor: str, flags: str) -> str:
    """Return a folder name that identifies JAX, the processor and the compiler flags."""
    text = "\n".join((processor, *sorted(flags.split())))
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    return f"{_PREFIX}{jax.__version__}-{version('jaxlib')}-{digest}"


def _processor() -> str:
    """Return the model and the instruction sets of the processor, as far as the system reports."""
    cpuinfo = Path("/proc/cpuinfo")
    if not cpuinfo.exists():
        return f"{platform.system()} {platform.machine()} {platform.processor()}"
    names = ("vendor", "model", "cpu family", "stepping", "flags", "features", "cpu ")
    # Lines of the first core. Its present clock rate is left out: it changes all the time.
    first = cpuinfo.read_text().split("\n\n", 1)[0].splitlines()
    said = [line for line in first if line.lower().startswith(names)]
    return "\n".join(line for line in said if not line.startswith(("cpu MHz", "cpu cores")))


def _make_private(folder: Path) -> None:
    """Make a folder that only its owner can enter, or check that an existing one can be trusted."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    # Windows has neither user ids nor these modes: there is nothing to check.
    if not hasattr(os, "geteuid"):
        return
    # Without following links: a link itself may belong to another user.
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid():
        raise ValueError(f"path is {folder}, another user's; accepted: a folder of your own")
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise ValueError(f"path is {folder}, writable by others; accepted: a folder of mode 700")


def _remove_broken(folder: Path) -> None:
    """Remove entries that are incomplete or were written by another user.

    An entry is read once, and again only if it has changed since the last call.
    """
    checked = folder / _CHECKED
    last = checked.stat().st_mtime_ns if checked.exists() else 0
    # The mark is made first: it is older than entries that other processes write while this
    # one reads, so the next call checks those.
    now = folder / f"{_CHECKED}-{os.getpid()}-{time.monotonic_ns()}"
    now.touch(mode=0o600)
    owner = folder.stat().st_uid
    for entry in folder.glob(f"*{_SUFFIX}"):
        # Another process may remove the entry at the same time.
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
    """Check whether an entry can be decompressed. JAX uses Zstandard if installed, else zlib."""
    # Every Zstandard frame begins with this magic number.
    if not entry.startswith(b"\x28\xb5\x2f\xfd"):
        try:
            return bool(zlib.decompress(entry))
        except zlib.error:
            return False
    for name in ("compression.zstd", "zstandard"):
        try:
            zstd = importlib.import_module(name)
        except ImportError:
            continue
        try:
            return bool(zstd.decompress(entry))
        # Both libraries call it so, but it has no common base class.
        except zstd.ZstdError:
            return False
    return False


def _remove_least_recently_used(root: Path, max_size: int) -> None:
    """Remove the least recently used entries of all versions and processors, down to `max_size`."""
    entries = []
    for path in root.glob(f"{_PREFIX}*/*{_SUFFIX}"):
        try:
            found = path.lstat()
        except FileNotFoundError:
            continue
        # Last read or written: many file systems update the read time once a day, some never.
        entries.append((max(found.st_atime_ns, found.st_mtime_ns), found.st_size, path))
    size = sum(each for _, each, _ in entries)
    for _, each, path in sorted(entries):
        if size <= max_size:
            return
        path.unlink(missing_ok=True)
        size -= each


def _silence() -> None:
    """Hide JAX's warnings about entries that cannot be read or written: it compiles instead."""
    for message in _NOISE:
        warnings.filterwarnings("ignore", message, UserWarning)
    # Child processes take their filters from the environment.
    given = os.environ.get("PYTHONWARNINGS", "")
    rules = [rule for rule in given.split(",") if rule]
    rules += [rule for message in _NOISE if (rule := f"ignore:{message}") not in rules]
    os.environ["PYTHONWARNINGS"] = ",".join(rules)
