"""What is measured on a GPU has the times of the CPU beside it."""

import pytest
from benchmarks.gpu import joined

ROWS = [
    {
        "": name,
        "device": "card",
        "p50_ms": 1.0,
        "wanted_ms": 3.0,
        "MPPI-Generic on an RTX 4090": 2.0,
    }
    for name in ("a", "b")
]


def test_times_of_a_cpu_are_beside_those_of_the_device() -> None:
    beside = [{**row, "p50_ms": 7.0 + n, "p99_ms": 9.0 + n} for n, row in enumerate(ROWS)]
    first, second = joined(ROWS, beside)
    assert first == {**ROWS[0], "cpu_p50_ms": 7.0, "cpu_p99_ms": 9.0}
    assert (second["p50_ms"], second["cpu_p50_ms"]) == (1.0, 8.0)
    assert list(first)[-2:] == ["wanted_ms", "MPPI-Generic on an RTX 4090"]
    assert joined(ROWS, [{}, {}])[0]["cpu_p50_ms"] is None
    with pytest.raises(ValueError, match="shorter"):
        joined(ROWS, beside[:1])
