import errno
import os
from pathlib import Path

import pytest

from jaxplore.report.folder import check_folder, run_folder


def write(path: Path, text: str, **options) -> None:
    with run_folder(path, **options) as folder:
        (folder / "metrics.json").write_text(text)
        assert folder.parent == path.parent


def write_half(path: Path, error: BaseException | type[BaseException]) -> None:
    with run_folder(path) as folder:
        (folder / "half").write_text("1")
        raise error


def tree(path: Path) -> list[str]:
    return sorted(str(each.relative_to(path)) for each in path.rglob("*"))


def refused(path, *words: str, **options) -> None:
    """Both ways in refuse, in one line that names the folder and what is accepted."""
    for enter in (check_folder, lambda *a, **k: run_folder(*a, **k).__enter__()):
        with pytest.raises(ValueError, match="accepted") as caught:
            enter(path, **options)
        text = str(caught.value)
        assert "\n" not in text
        assert all(word in text for word in words), text


def test_the_folder_appears_complete(tmp_path):
    target = tmp_path / "a" / "b" / "run"
    with run_folder(target) as folder:
        (folder / "metrics.json").write_text("1")
        assert not target.exists()
    assert tree(tmp_path) == ["a", "a/b", "a/b/run", "a/b/run/metrics.json"]
    assert (target.stat().st_mode & 0o777) == (target.parent.stat().st_mode & 0o777)


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_after_an_exception_nothing_is_left(tmp_path, error):
    with pytest.raises(error):
        write_half(tmp_path / "a" / "run", error)
    assert tree(tmp_path) == []


def test_a_full_disk_is_one_line(tmp_path):
    with pytest.raises(ValueError, match="No space left on device") as caught:
        write_half(tmp_path / "run", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    assert isinstance(caught.value.__cause__, OSError)
    assert str(tmp_path / "run") in str(caught.value)
    assert tree(tmp_path) == []


def test_checking_leaves_nothing(tmp_path):
    check_folder(tmp_path / "run")
    check_folder(tmp_path / "a" / "b" / "run")
    check_folder(tmp_path / "ünï cöde")
    assert tree(tmp_path) == []


def test_what_is_there_stays(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("1")
    write(tmp_path / "run", "old")
    before = tree(tmp_path)
    refused(tmp_path / "run", "former run", "overwrite", str(tmp_path / "run"))
    for overwrite in (False, True):
        refused(tmp_path / "empty", "metrics.json", overwrite=overwrite)
        refused(tmp_path / "file", "not a folder", overwrite=overwrite)
    assert tree(tmp_path) == before


def test_places_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("1")
    refused(tmp_path / "file" / "run", "Not a directory")
    refused(tmp_path / "file" / "a" / "run", "Not a directory")
    refused(tmp_path / ("n" * 300), "too long")
    refused(tmp_path / "a" / ("n" * 300) / "run", "too long")
    refused("", "''")
    refused("a\0b")
    refused("/proc/run")
    assert tree(tmp_path) == ["file"]


@pytest.mark.parametrize("code", [errno.EROFS, errno.EACCES, errno.ENOSPC])
def test_the_disk_is_really_tried(tmp_path, monkeypatch, code):
    def fail(*_, **__):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "mkdir", fail)
    refused(tmp_path / "run", os.strerror(code))
    refused(tmp_path / "a" / "run", os.strerror(code))
    assert tree(tmp_path) == []


def test_overwriting_replaces_all_of_a_former_run(tmp_path):
    target = tmp_path / "run"
    write(target, "old")
    (target / "extra").write_text("1")
    check_folder(target, overwrite=True)
    with run_folder(target, overwrite=True) as folder:
        (folder / "metrics.json").write_text("new")
        assert (target / "metrics.json").read_text() == "old"
    assert tree(tmp_path) == ["run", "run/metrics.json"]
    assert (target / "metrics.json").read_text() == "new"


def test_a_former_run_survives_a_failure(tmp_path):
    write(tmp_path / "run", "old")
    with pytest.raises(RuntimeError), run_folder(tmp_path / "run", overwrite=True):
        raise RuntimeError
    assert tree(tmp_path) == ["run", "run/metrics.json"]


def test_a_former_run_returns_when_its_place_cannot_be_taken(tmp_path, monkeypatch):
    write(tmp_path / "run", "old")
    rename, calls = Path.rename, []

    def fail_second(self, target):
        calls.append(target)
        if len(calls) == 2:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_second)
    with pytest.raises(ValueError, match="Input/output error"):
        write(tmp_path / "run", "new", overwrite=True)
    assert tree(tmp_path) == ["run", "run/metrics.json"]
    assert (tmp_path / "run" / "metrics.json").read_text() == "old"


def test_a_folder_that_appears_meanwhile_stays(tmp_path):
    with pytest.raises(ValueError, match="exists"), run_folder(tmp_path / "run"):
        (tmp_path / "run").mkdir()
    assert tree(tmp_path) == ["run"]


def test_a_link_keeps_pointing_to_the_run(tmp_path):
    write(tmp_path / "real", "old")
    (tmp_path / "link").symlink_to("real")
    with run_folder(tmp_path / "link", overwrite=True) as folder:
        (folder / "metrics.json").write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real" / "metrics.json").read_text() == "new"


def test_relative_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with run_folder("run") as folder:
        (folder / "metrics.json").write_text("1")
    assert tree(tmp_path) == ["run", "run/metrics.json"]
