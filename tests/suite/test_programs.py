"""The count of programs sees what is compiled, and says which budget is passed."""

import jax
import numpy as np
import pytest
from tests.suite import programs
from tests.suite.programs import LARGE, Count, FileCost, Program


def test_a_program_counts_once_with_all_its_operations(request: pytest.FixtureRequest) -> None:
    count = request.config.pluginmanager.get_plugin("programs")

    def long_sum(x):
        for k in range(LARGE):
            x = x * np.float32(k)
        return x

    before = set(count.compiled)
    for _ in range(2):
        jax.clear_caches()
        assert jax.jit(long_sum)(np.float32(1.0)) == 0.0
    named = [count.compiled[key] for key in count.compiled if key not in before]
    (found,) = (each for each in named if each.name == "jit_long_sum")
    # A constant and a multiplication a turn, beside what holds them.
    assert 2 * LARGE <= found.instructions <= 2 * LARGE + 10
    assert found.is_large
    assert not found.is_loop


def cost(number: int, instructions: int, name: str = "jit_step", *, is_long=False) -> FileCost:
    made = FileCost()
    made.is_long = is_long
    made.programs = {f"{name} {k}": Program(name, instructions) for k in range(number)}
    return made


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"a": cost(3, LARGE), "b": cost(3, LARGE)}, []),  # the same three
        ({"a": cost(4, LARGE)}, ["4 large programs; at most 3"]),
        ({"a": cost(9, LARGE - 1)}, []),
        ({"a": cost(2, LARGE, "jit_run_chunk")}, ["2 closed loops; at most 1"]),
        ({"a": cost(1, 2001)}, ["a compiles 2001 instructions in large programs; at most 2000"]),
        ({"a": cost(1, 2001, is_long=True)}, []),
        # All tests have a budget of their own, in which a program of both layers counts once.
        ({"a": cost(3, LARGE), "b": cost(2, LARGE, "jit_look", is_long=True)}, []),
        ({"a": cost(3, LARGE), "b": cost(3, LARGE, is_long=True)}, []),
        (
            {"a": cost(3, LARGE), "b": cost(3, LARGE, "jit_look", is_long=True)},
            ["`make test-all` compiles 6 large programs; at most 5"],
        ),
    ],
)
def test_a_budget_that_is_passed_is_named(monkeypatch, files, said) -> None:
    monkeypatch.setattr(programs, "MOST_LARGE", {"make test": 3, "make test-all": 5})
    monkeypatch.setattr(programs, "MOST_LOOPS", {"make test": 1, "make test-all": 2})
    monkeypatch.setattr(programs, "MOST_IN_FILE", 2000)
    count = Count()
    count.files.update(files)
    found = count.complaints()
    assert len(found) == len(said)
    for line, wanted in zip(found, said, strict=True):
        assert wanted in line
