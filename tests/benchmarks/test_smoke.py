"""Every section of `python -m benchmarks` runs, with tiny sizes."""

import json
import math
import os
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest
from benchmarks.__main__ import SECTIONS

from benchmarks import __main__ as program
from benchmarks import history

pytestmark = [
    pytest.mark.long,
    # The parser of ROS's interfaces imports them.
    pytest.mark.filterwarnings("ignore:module 'sre_.*' is deprecated:DeprecationWarning"),
]

EMPTY = {"ratios", "drives", "memory"}
"""Tables that are empty where a peer or ROS is not installed."""
ENDS = ("_ms", " ms", "_s", " s", "_seconds")


def numbers(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of a result with the names that they have."""
    if isinstance(value, dict):
        for key, each in value.items():
            yield from numbers(each, key)
    elif isinstance(value, list):
        for each in value:
            yield from numbers(each, name)
    elif isinstance(value, int | float):
        yield name, value


@pytest.mark.parametrize("name", SECTIONS)
def test_section_measures_with_tiny_sizes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    section = SECTIONS[name]
    for variable in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_DOMAIN_ID"):
        monkeypatch.setenv(variable, os.environ.get(variable, ""))  # The robot's changes them.
    found = section.measure(section.SMOKE)
    assert set(section.TITLES) <= set(found)
    assert {table for table, rows in found.items() if not rows} <= EMPTY
    # Numbers of NumPy and of JAX are no JSON, nor is what is not finite.
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    for table, rows in found.items():
        assert all(list(row) for row in rows), table
    times = [each for each in numbers(found) if each[0] == "repeats"]
    assert times or name in ("exploration", "robot")
    assert all(math.isfinite(time) and time > 0.0 for _, time in times)


def test_what_was_measured_before_a_failure_is_kept(tmp_path, monkeypatch) -> None:
    class Sizes(NamedTuple):
        steps: int = 1

    def section(measure) -> SimpleNamespace:
        return SimpleNamespace(
            FULL=Sizes(), SMOKE=Sizes(), TITLES={"times": "Times"}, measure=measure
        )

    def fail(sizes: Sizes) -> dict:
        raise TimeoutError("the robot is not there")

    sections = {
        "first": section(lambda sizes: {"times": [{"": "a", "p50_ms": float(sizes.steps)}]}),
        "second": section(fail),
    }
    monkeypatch.setattr(program, "SECTIONS", sections)
    out = tmp_path / "results.json"
    monkeypatch.setattr("sys.argv", ["benchmarks", "--steps", "7", "--out", str(out)])
    with pytest.raises(TimeoutError):
        program.main()
    assert history.load(out)["sections"] == {"first": {"times": [{"": "a", "p50_ms": 7.0}]}}
