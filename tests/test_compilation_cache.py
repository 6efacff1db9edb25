"""Programs that are kept for the next process."""

import os
import subprocess
import sys
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path

import click
import jax
import pytest
import zstandard
from click.testing import CliRunner
from jax.experimental.compilation_cache.compilation_cache import reset_cache

from jaxplore import compilation_cache
from jaxplore.cli._cache import VARIABLE, cache_option
from jaxplore.compilation_cache import enable_compilation_cache


def unpacked(entry: bytes) -> bytes:
    """Return the content of an entry: JAX packs it by zstandard where that package is there."""
    if entry.startswith(b"\x28\xb5\x2f\xfd"):
        return zstandard.ZstdDecompressor().decompressobj().decompress(entry)
    return zlib.decompress(entry)


NAMES = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
    "jax_persistent_cache_enable_xla_caches",
)
owned = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have no owner here")


@pytest.fixture(autouse=True)
def unchanged(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Leave JAX and the environment as they were."""
    before = {name: getattr(jax.config, name) for name in NAMES}
    for name in (*(name.upper() for name in NAMES), "PYTHONWARNINGS", VARIABLE):
        # Also what a test sets is undone.
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    with warnings.catch_warnings():
        yield
    for name, value in before.items():
        jax.config.update(name, value)
    reset_cache()


def entries(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*-cache")}


def compile_one(number: int = 7) -> None:
    """Compile a program that was not compiled in this process."""
    jax.clear_caches()
    jax.jit(lambda x: x * number)(2.0).block_until_ready()


def test_programs_are_kept_where_only_the_user_can_read(tmp_path: Path) -> None:
    folder = enable_compilation_cache(tmp_path / "cache")
    compile_one()
    assert folder.parent == tmp_path / "cache"
    assert entries(folder)
    if hasattr(os, "geteuid"):
        assert [each.stat().st_mode & 0o777 for each in (folder, folder.parent)] == [0o700, 0o700]
    # For the processes that this one starts.
    assert os.environ["JAX_COMPILATION_CACHE_DIR"] == str(folder)


def test_the_default_is_the_users_cache_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("platformdirs.user_cache_path", lambda *_, **__: tmp_path)
    assert enable_compilation_cache().parent == tmp_path


def test_nothing_is_kept_by_default() -> None:
    program = "import jaxplore, jax; print(jax.config.jax_compilation_cache_dir)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "None\n"


@pytest.mark.parametrize("content", [b"", b"broken", b"half"], ids=["empty", "garbage", "half"])
def test_a_broken_entry_is_ignored_and_rewritten(tmp_path: Path, content: bytes) -> None:
    folder = enable_compilation_cache(tmp_path)
    compile_one()
    whole = entries(folder)
    enable_compilation_cache(tmp_path)
    for name, before in whole.items():
        (folder / name).write_bytes(before[: len(before) // 2] if content == b"half" else content)
    enable_compilation_cache(tmp_path)
    assert not entries(folder)
    compile_one()
    rewritten = entries(folder)
    assert rewritten.keys() == whole.keys()
    assert all(unpacked(each) for each in rewritten.values())


def test_an_entry_that_breaks_meanwhile_is_no_warning(tmp_path: Path) -> None:
    # Every warning is an error in these tests.
    folder = enable_compilation_cache(tmp_path)
    compile_one()
    for name in entries(folder):
        (folder / name).write_bytes(b"broken")
    compile_one()


def test_a_whole_entry_stays(tmp_path: Path) -> None:
    folder = enable_compilation_cache(tmp_path)
    compile_one()
    before = entries(folder)
    assert enable_compilation_cache(tmp_path) == folder
    assert entries(folder) == before


def test_an_entry_of_another_kind_is_removed(tmp_path: Path) -> None:
    folder = enable_compilation_cache(tmp_path / "cache")
    (tmp_path / "elsewhere").write_bytes(zlib.compress(b"whole"))
    (folder / "linked-cache").symlink_to(tmp_path / "elsewhere")
    enable_compilation_cache(tmp_path / "cache")
    assert not entries(folder)
    assert (tmp_path / "elsewhere").exists()


def test_other_processors_flags_and_versions_have_other_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = {enable_compilation_cache(tmp_path)}
    compile_one()
    with monkeypatch.context() as patch:
        patch.setattr(compilation_cache, "_processor", lambda: "flags: fpu avx512_of_another")
        other = enable_compilation_cache(tmp_path)
        assert not entries(other)
        folders.add(other)
    with monkeypatch.context() as patch:
        patch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=true")
        folders.add(enable_compilation_cache(tmp_path))
    with monkeypatch.context() as patch:
        patch.setattr(jax, "__version__", "0.0.1")
        folders.add(enable_compilation_cache(tmp_path))
    assert len(folders) == 4


def test_the_processor_is_the_same_every_time() -> None:
    processor = compilation_cache._processor()
    assert processor == compilation_cache._processor()
    assert "MHz" not in processor


def test_the_size_is_bounded_over_all_folders(tmp_path: Path) -> None:
    folder = enable_compilation_cache(tmp_path)
    other = tmp_path / "jax-0.0.1-other"
    other.mkdir()
    entry = zlib.compress(b"whole")
    used = {other / "a-cache": 10, folder / "b-cache": 20, other / "c-cache": 30}
    for path, seconds in used.items():
        path.write_bytes(entry)
        os.utime(path, (seconds, 0))
    kept = tmp_path / "mine.txt"
    kept.write_bytes(bytes(10 * len(entry)))
    enable_compilation_cache(tmp_path, max_size=2 * len(entry))
    assert [path.exists() for path in used] == [False, True, True]
    enable_compilation_cache(tmp_path, max_size=1)
    assert not any(path.exists() for path in used)
    # What is not a program is nobody's to remove.
    assert kept.exists()


@owned
def test_a_folder_that_others_can_write_is_refused(tmp_path: Path) -> None:
    folder = enable_compilation_cache(tmp_path / "cache")
    for path in (folder, folder.parent):
        path.chmod(0o777)
        with pytest.raises(ValueError, match=r"writable by others; accepted: .*mode 700"):
            enable_compilation_cache(tmp_path / "cache")
        path.chmod(0o755)
        # Only readable: it is made private again.
        enable_compilation_cache(tmp_path / "cache")


@owned
def test_a_folder_of_another_user_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    user = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: user + 1)
    with pytest.raises(ValueError, match=r"another user's; accepted: a folder of your own"):
        enable_compilation_cache(tmp_path)


def test_what_is_no_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match=r"^path is .*; accepted: a folder to write$"):
        enable_compilation_cache(tmp_path / "file")


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Return the folders that a command asks for."""
    folders: list[object] = []

    def enable(path: object = None) -> None:
        folders.append(path)
        if path == "refused" or (path is None and os.environ.get("HOME") == "/nowhere"):
            raise ValueError("path is refused; accepted: another one")

    monkeypatch.setattr("jaxplore.compilation_cache.enable_compilation_cache", enable)
    jax.config.update("jax_compilation_cache_dir", None)
    return folders


@click.command()
@cache_option
def command() -> None:
    """Do nothing."""


def test_commands_keep_programs(asked: list[object]) -> None:
    assert CliRunner().invoke(command, []).output == ""
    assert asked == [None]


def test_commands_keep_programs_where_they_are_told(asked: list[object]) -> None:
    CliRunner().invoke(command, [], env={VARIABLE: "somewhere"})
    assert asked == ["somewhere"]


@pytest.mark.parametrize("word", ["off", "OFF"])
def test_the_cache_can_be_turned_off(asked: list[object], word: str) -> None:
    CliRunner().invoke(command, [], env={VARIABLE: word})
    CliRunner().invoke(command, ["--no-cache"])
    CliRunner().invoke(command, ["--no-cache"], env={VARIABLE: "somewhere"})
    assert asked == []


def test_what_jax_was_told_stays(asked: list[object], tmp_path: Path) -> None:
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    CliRunner().invoke(command, [])
    assert asked == []


def test_only_a_folder_that_was_asked_for_has_to_work(asked: list[object]) -> None:
    result = CliRunner().invoke(command, [], env={"HOME": "/nowhere"})
    assert result.exit_code == 0
    assert result.stderr.count("\n") == 1
    result = CliRunner().invoke(command, [], env={VARIABLE: "refused"})
    assert isinstance(result.exception, ValueError)


@pytest.mark.parametrize("name", ["run", "compare", "tune"])
def test_every_command_that_computes_has_the_option(name: str) -> None:
    from jaxplore.cli import cli

    assert "--no-cache" in CliRunner().invoke(cli, [name, "--help"]).output
