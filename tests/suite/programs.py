"""A plugin of pytest that counts what the suite compiles, and fails when that grows unseen.

Most of the suite's time is spent on compiling. A program is known by the key of JAX's cache, so it
counts once, whichever worker compiles it and whether it is read from the cache. A program is large
from `LARGE` instructions on (operations of StableHLO, those of inner functions and loops too).

Budgets are kept for the large programs and the closed loops of `make test` and of all tests, and
for the instructions of a file without the mark `long`. Programs of processes that tests start are
not counted.
"""

import resource
import time
from collections import defaultdict
from collections.abc import Iterator
from typing import Any, NamedTuple

import pytest

LOOP = "jit_run_chunk"
"""The closed loop of a task, the largest programs there are."""
LARGE = 400
"""Instructions of a large program."""
LAYERS = {"make test": ("not long",), "make test-all": ("not long", "long")}
"""Layers that a command runs."""
MOST_LARGE = {"make test": 289, "make test-all": 1260}
"""Large programs that a command compiles. Raising a budget needs a reason in the commit."""
MOST_LOOPS = {"make test": 17, "make test-all": 77}
"""Closed loops among them."""
MOST_IN_FILE = 26_000
"""Instructions of the large programs of a file without the mark `long`, closed loops apart."""
SHOWN = 10
"""Files that are shown, the dearest first."""


class Program(NamedTuple):
    """A program that was compiled, or read from the cache."""

    name: str
    instructions: int

    @property
    def is_large(self) -> bool:
        """Whether it counts."""
        return self.instructions >= LARGE

    @property
    def is_loop(self) -> bool:
        """Whether it is the closed loop of a task."""
        return self.name == LOOP

    @property
    def is_of_loop(self) -> bool:
        """Whether it is a closed loop, its start or what its frames show."""
        return self.name in (LOOP, "jit__initial_task", "jit_frame_arrays")


class FileCost:
    """What a file of tests took in one process."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self.compiling = 0.0
        self.programs: dict[str, Program] = {}
        self.is_long = False

    def add(self, other: "FileCost") -> None:
        """Add what it took in another process."""
        self.seconds += other.seconds
        self.compiling += other.compiling
        self.programs |= other.programs
        self.is_long |= other.is_long

    @property
    def layer(self) -> str:
        """Layer of the file."""
        return "long" if self.is_long else "not long"

    @property
    def instructions(self) -> int:
        """Instructions of its large programs; those of closed loops have a budget of their own."""
        counted = (each for each in self.programs.values() if not each.is_of_loop)
        return sum(each.instructions for each in counted if each.is_large)


class Count:
    """Counts in one process; the process that started the workers adds theirs.

    Attributes:
        files: cost of each file of tests.
        compiled: programs of the test that runs, by their keys.
    """

    def __init__(self) -> None:
        self.files: dict[str, FileCost] = defaultdict(FileCost)
        self._compiling = 0.0
        self.compiled: dict[str, Program] = {}

    def watch(self) -> None:
        """Wrap the two functions of JAX that see each program: there is no public way."""
        from jax._src import compilation_cache, compiler

        key_of, compile_program = (
            compilation_cache.get_cache_key,
            compiler.backend_compile_and_load,
        )

        def keyed(module: Any, *arguments: Any, **options: Any) -> str:
            key = key_of(module, *arguments, **options)
            self.compiled[key] = _describe(module)
            return key

        def timed(*arguments: Any, **options: Any) -> Any:
            began = time.process_time()
            try:
                return compile_program(*arguments, **options)
            finally:
                self._compiling += time.process_time() - began

        compilation_cache.get_cache_key = keyed
        compiler.backend_compile_and_load = timed

    @pytest.hookimpl(wrapper=True)
    def pytest_collection(self) -> Iterator[None]:
        """Begin to count."""
        self.watch()
        return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Count what one test takes, with its fixtures and its child processes."""
        self.compiled, self._compiling = {}, 0.0
        began = _cpu_seconds()
        try:
            return (yield)
        finally:
            cost = self.files[item.nodeid.split("::")[0]]
            cost.seconds += _cpu_seconds() - began
            cost.compiling += self._compiling
            cost.programs |= self.compiled
            cost.is_long |= item.get_closest_marker("long") is not None

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Hand the counts of a worker over, or judge the sum."""
        config = session.config
        if hasattr(config, "workeroutput"):
            config.workeroutput["programs"] = {
                name: (cost.seconds, cost.compiling, cost.is_long, _packed(cost.programs))
                for name, cost in self.files.items()
            }
        elif self.files and self.complaints() and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Add the counts of a worker that has ended."""
        for name, (*numbers, programs) in (
            getattr(node, "workeroutput", {}).get("programs", {}).items()
        ):
            cost = FileCost()
            cost.seconds, cost.compiling, cost.is_long = numbers
            cost.programs = {key: Program(*each) for key, *each in programs}
            self.files[name].add(cost)

    def programs_of(self, *layers: str) -> dict[str, Program]:
        """Return the programs of the files of layers."""
        costs = [each for each in self.files.values() if each.layer in layers]
        return {key: each for cost in costs for key, each in cost.programs.items()}

    def complaints(self) -> list[str]:
        """Return which budgets are passed."""
        said = []
        for command, layers in LAYERS.items():
            programs = self.programs_of(*layers).values()
            said += [
                f"`{command}` compiles {number} {kind}; at most {most[command]}: share "
                "programs (CONTRIBUTING.md, Tests), or raise the budget in "
                "tests/suite/programs.py with a reason"
                for number, kind, most in (
                    (sum(each.is_large for each in programs), "large programs", MOST_LARGE),
                    (sum(each.is_loop for each in programs), "closed loops", MOST_LOOPS),
                )
                if number > most[command]
            ]
        said += [
            f"{name} compiles {cost.instructions} instructions in large programs; at most "
            f"{MOST_IN_FILE} without the line `pytestmark = pytest.mark.long`"
            for name, cost in self.files.items()
            if not cost.is_long and cost.instructions > MOST_IN_FILE
        ]
        return said

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Print the counts."""
        if not self.files:
            return
        write = terminalreporter.write_line
        terminalreporter.section("what was compiled")
        programs = self.programs_of("not long", "long").values()
        seconds = sum(cost.seconds for cost in self.files.values())
        compiling = sum(cost.compiling for cost in self.files.values())
        large, loops = (
            sum(each.is_large for each in programs),
            sum(each.is_loop for each in programs),
        )
        write(
            f"{len(programs)} programs, {large} of them large ({LARGE} instructions and more), "
            f"{loops} closed loops"
        )
        write(f"{seconds:.0f} CPU seconds in tests, {compiling:.0f} of them compiling")
        write("CPU s  compiling  large  instructions  the dearest files")
        dearest = sorted(self.files.items(), key=lambda pair: -pair[1].seconds)
        for name, cost in dearest[:SHOWN]:
            large = sum(each.is_large for each in cost.programs.values())
            write(
                f"{cost.seconds:5.1f}  {cost.compiling:9.1f}  {large:5d}  {cost.instructions:12d}"
                f"  {name}"
            )
        for said in self.complaints():
            terminalreporter.write_line(said, red=True)


def _packed(programs: dict[str, Program]) -> list[tuple[str, str, int]]:
    return [(key, *each) for key, each in programs.items()]


def _describe(module: Any) -> Program:
    """Return the name of a module of MLIR, and the number of its operations."""
    from jax._src.lib.mlir import ir

    number = 0

    def visit(_: Any) -> Any:
        nonlocal number
        number += 1
        return ir.WalkResult.ADVANCE

    module.operation.walk(visit)
    return Program(ir.StringAttr(module.operation.attributes["sym_name"]).value, number)


def _cpu_seconds() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def pytest_configure(config: pytest.Config) -> None:
    """Count in this process."""
    config.pluginmanager.register(Count(), "programs")
