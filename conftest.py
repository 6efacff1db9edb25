"""Strict from day one: shapes and types of the whole package are checked at run time, implicit
dtype promotion is an error, and so is every warning (pyproject.toml).

Also runs the Python blocks of README.md and docs/, and the cells of notebooks: what the documents
show is what works. One document is one test, because its blocks build on each other: they share a
namespace and an empty working directory, and no test runner can spread them over several workers.
"""

import contextlib
import gc
import hashlib
import importlib
import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

# Tests compile far more than they compute: without LLVM's optimisations and expensive passes a
# quarter is saved. XLA's own passes stay. It is read when the first array is made;
# `XLA_FLAGS= pytest` optimises.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true",
)


def compiled_programs() -> Path:
    """Return the folder of compiled programs of these versions, this processor and these flags.

    JAX's own keys hold versions and flags but not the processor: a program that was compiled for
    another one may stop with an illegal instruction, or round differently.
    """
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    named = ("vendor_id", "model name", "flags", "CPU implementer", "CPU part", "Features")
    key = [version("jax"), version("jaxlib"), os.environ["XLA_FLAGS"], platform.machine()]
    key += sorted({line for line in lines if line.startswith(named)})
    name = hashlib.sha256("\n".join(key).encode()).hexdigest()[:16]
    return Path(__file__).parent / ".jax_cache" / name


# What was compiled in an earlier run, by the other worker or by a command that a test starts is
# read. Even the smallest program is: to compile `x * 2.0` takes 23 ms, to read it 7 ms. Through the
# environment, so that subprocesses inherit it, and before JAX is imported, which reads it then.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(compiled_programs()))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# Commands that are tested leave the user's own programs alone.
os.environ["JAXPLORE_CACHE"] = "off"

import jax
import pytest
from jaxtyping import install_import_hook
from sybil import Sybil
from sybil.parsers.myst import PythonCodeBlockParser

jax.config.update("jax_numpy_dtype_promotion", "strict")
# Nobody looks for lines of Python in the programs: that saves a fiftieth.
jax.config.update("jax_traceback_in_locations_limit", 0)

with install_import_hook("jaxplore", "beartype.beartype"):
    import jaxplore

    # Packages are imported when they are first used: here, so that the hook sees them.
    for name in dir(jaxplore):
        if name != "recorder":
            getattr(jaxplore, name)
    for name in ("content", "channels", "messages"):
        importlib.import_module(f"jaxplore.topics.{name}")
# The recorder imports the settings, which accept whole numbers where they say float.
importlib.import_module("jaxplore.tasks.registry")
with install_import_hook("jaxplore", "beartype.beartype"):
    importlib.import_module("jaxplore.recorder")

pytest_plugins = ("tests.suite.programs",)

documents = Sybil(
    parsers=[PythonCodeBlockParser()],
    patterns=["README.md", "docs/*.md"],
    path=str(Path(__file__).parent),
)


MOST_COMPILED = 2**31
"""Bytes of compiled programs that are kept. Sources change, and nobody asks for the old ones."""


def pytest_configure(config: pytest.Config) -> None:
    """Start again with no compiled programs when there are too many; before any worker starts."""
    folder = compiled_programs()
    if hasattr(config, "workerinput") or not folder.is_dir():
        return
    if sum(entry.stat().st_size for entry in os.scandir(folder)) > MOST_COMPILED:
        shutil.rmtree(folder)


MOST_MAPPINGS = 20_000
"""Pieces of memory that a process may map before compiled programs are forgotten."""


def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Forget compiled programs between files when there are many.

    Each takes pieces of memory of its own, of which Linux gives a process 65530; when they are used
    up, the next compilation crashes. Until then they are no garbage, and need not be looked through
    again and again.
    """
    if nextitem is None or nextitem.path == item.path:
        return
    mappings = Path("/proc/self/maps")
    if mappings.exists() and mappings.read_bytes().count(b"\n") > MOST_MAPPINGS:
        jax.clear_caches()
        gc.unfreeze()
        gc.collect()
    else:
        gc.freeze()


TOGETHER = [
    [".md"],
    ["tasks/test_defaults.py", "tasks/test_reference.py"],
    [
        *("comparison/test_command.py", "comparison/test_processes.py", "comparison/test_rows.py"),
        *("comparison/test_run_episodes.py", "comparison/test_page.py"),
    ],
    [
        *(f"simulation/test_{name}.py" for name in ("batch", "closed_loop", "environment")),
        *(f"simulation/test_{name}.py" for name in ("far_maps", "faults", "live_view", "monitor")),
    ],
    ["planning/test_architectures.py", "simulation/test_flights.py"],
    [f"onboard/test_{name}.py" for name in ("following", "localisation", "pilot")],
    [
        *("simulation/test_volume.py", "tests/test_volume_command.py"),
        *("planning/test_volume_informative.py", "planning/test_volume_targets.py"),
    ],
    [
        *("tests/test_cli.py", "tests/test_resume_command.py", "tests/test_view_command.py"),
        "tests/test_describe.py",
    ],
    [
        *("tests/test_path_command.py", "tests/test_tune_command.py", "tests/test_variants.py"),
        *(f"tuning/test_{name}.py" for name in ("results", "runs", "study")),
    ],
]
"""Files that run the same compiled loop or import the same large libraries, by the ends of their
names: on one worker that is done once."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give files that share what they compile to the same worker, with `--dist loadfile`."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Together(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            for files in TOGETHER:
                if file.endswith(tuple(files)):
                    return files[0]
            return file

    return Together(config, log)


LONG = re.compile(r"^(<!-- )?pytestmark = (\[\s*)?pytest\.mark\.long\b", re.MULTILINE)
"""How a file of tests or a document says that it compiles much, or starts programs that do."""


def _is_long(path: Path) -> bool:
    return LONG.search(path.read_text(encoding="utf-8")) is not None


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave files of the other layer unread: to import them all takes half a minute."""
    if config.option.markexpr not in ("long", "not long") or collection_path.is_dir():
        return None
    is_long = collection_path.suffix in (".md", ".py") and _is_long(collection_path)
    return True if is_long != (config.option.markexpr == "long") else None


class DocumentItem(pytest.Item):
    """All blocks of one document, in order."""

    def runtest(self) -> None:
        """Run them in an empty folder."""
        document = documents.parse(self.path)
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            for example in document.examples():
                example.evaluate()

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return where the document is."""
        return self.path, 0, self.name


class DocumentFile(pytest.File):
    """A Markdown file with at least one Python block."""

    def collect(self) -> Iterator[DocumentItem]:
        """Yield the document as one test."""
        if any(documents.parse(self.path).examples()):
            item = DocumentItem.from_parent(self, name="python blocks")
            if _is_long(self.path):
                item.add_marker(pytest.mark.long)
            yield item


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> DocumentFile | None:
    """Collect the documents."""
    if documents.should_parse(file_path):
        return DocumentFile.from_parent(parent, path=file_path)
    return None
