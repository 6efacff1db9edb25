"""Results are written whole, compared beyond noise, and shown on the page of performance."""

import argparse
import re
from pathlib import Path
from typing import Any

import pytest
from benchmarks.timing import percentiles

from benchmarks import history, page

HEADER = {"date": "2026-11-27T10:00:00+00:00", "commit": "abc1234", "machine": "cpu-2"}


def results(times: dict[str, list[float]], **changes: Any) -> dict[str, Any]:
    rows = [{"": name, "p50_ms": sum(each), "repeats": each} for name, each in times.items()]
    return {**HEADER, "sections": {"control": {"growth": rows}}, **changes}


def test_percentiles_have_the_medians_of_parts_in_order() -> None:
    found = percentiles([0.001] * 4 + [0.002] * 4 + [0.003] * 4 + [0.004] * 4 + [0.005] * 4)
    assert found["p50_ms"] == pytest.approx(3.0)
    assert found["repeats"] == pytest.approx([1.0, 2.0, 3.0, 4.0, 5.0])
    assert percentiles([0.001, 0.003])["repeats"] == pytest.approx([1.0, 3.0])


def test_only_what_is_apart_and_beyond_the_bound_has_changed() -> None:
    old = results({"a": [1.0, 1.1], "b": [1.0, 1.1], "c": [1.0, 1.1], "d": [2.0], "gone": [1.0]})
    new = results({"a": [1.2, 1.3], "b": [1.05, 2.0], "c": [2.0, 2.1], "d": [1.0], "new": [1.0]})
    # a: apart, but only 1.19 times; b: 1.45 times, but the intervals overlap.
    rows, said = history.compare(old, new)
    assert [(row[""], row["change"]) for row in rows] == [
        ("control / growth / c", "slower"),
        ("control / growth / d", "faster"),
    ]
    assert rows[0]["times_as_long"] == pytest.approx(2.05 / 1.05)
    assert "2 of 4 times changed" in said


def test_results_without_a_common_ground_do_not_compare() -> None:
    one = results({"a": [1.0]})
    with pytest.raises(ValueError, match="two machines, cpu-2 and cpu-4"):
        history.compare(one, {**one, "machine": "cpu-4"})
    with pytest.raises(ValueError, match="no time in common"):
        history.compare(one, results({"b": [1.0]}))


def test_files_are_read_as_written_the_newest_of_a_machine_first(tmp_path: Path) -> None:
    old = results({"a": [1.0, 0.123456789]})
    for number, changes in enumerate(
        ({}, {"date": "2026-11-28T09:00:00+00:00"}, {"machine": "cpu-4"})
    ):
        history.save({**old, **changes}, tmp_path / f"{number}.json")
    first, second = history.newest(tmp_path, "cpu-2")
    assert (first["date"][:10], second["date"][:10]) == ("2026-11-28", "2026-11-27")
    assert second["sections"]["control"]["growth"][0]["repeats"] == [1.0, 0.123457]
    # A line for a row, so that changes can be read.
    assert '   {"": "a", ' in (tmp_path / "0.json").read_text()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "none.json is not there or not a file"),
        ("{", "none.json: "),
        ("[]", "none.json has no results of benchmarks; accepted: an object with commit, date, ma"),
        ('{"date": "today"}', "none.json has no results of benchmarks; accepted: an object with"),
    ],
)
def test_files_without_results_are_refused_with_one_line(
    tmp_path: Path, text: str | None, message: str
) -> None:
    file = tmp_path / "none.json"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ValueError, match=re.escape(message)) as found:
        history.load(file)
    assert "\n" not in str(found.value)


def test_results_without_a_place_are_refused_before_they_are_measured(tmp_path: Path) -> None:
    wanted = tmp_path / "new" / "results.json"
    assert history.results_file(str(wanted)) == wanted
    assert (tmp_path / "new").is_dir()
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "new", tmp_path / "file" / "results.json"):
        with pytest.raises(argparse.ArgumentTypeError, match="cannot be written"):
            history.results_file(str(place))


def test_results_that_are_no_json_leave_the_former_file(tmp_path: Path) -> None:
    file = tmp_path / "kept.json"
    history.save(results({"a": [1.0]}), file)
    before = file.read_bytes()
    with pytest.raises(ValueError, match="not JSON compliant"):
        history.save(results({"a": [float("nan")]}), file)
    assert file.read_bytes() == before
    assert list(tmp_path.iterdir()) == [file]


def test_marked_tables_are_replaced_and_text_stays() -> None:
    text = "Before.\n<!-- table: control growth: p50_ms -->\nold\n<!-- end -->\nAfter.\n"
    written = page.rewritten(text, results({"a": [1.0, 2.0]}))
    table = "| p50 ms |\n| --- |\n| 3.00 |"
    expected = f"<!-- table: control growth: p50_ms -->\n\n{table}\n\n<!-- end -->"
    assert written == f"Before.\n{expected}\nAfter.\n"
    assert page.rewritten(written, results({"a": [1.0, 2.0]})) == written


def test_missing_tables_and_columns_are_named() -> None:
    found = results({"a": [1.0]})
    with pytest.raises(ValueError, match="no table view runs"):
        page.rewritten("<!-- table: view runs -->\n\n<!-- end -->", found)
    with pytest.raises(ValueError, match="no columns speed"):
        page.rewritten("<!-- table: control growth: speed -->\n\n<!-- end -->", found)


def test_each_section_of_the_page_has_the_newest_file_that_has_it(tmp_path: Path) -> None:
    view = {"view": {"runs": [{"": "v", "s": 1.0}]}}
    files = {
        "27": {},
        "28": {"sections": {**results({"a": [2.0]})["sections"], **view}},
        "29": {"sections": {"gpu": {"times": [{"": "g", "ms": 3.0}]}}, "machine": "gpu-16"},
    }
    for day, changes in files.items():
        date = {"date": f"2026-11-{day}T10:00:00+00:00"}
        history.save({**results({"a": [1.0]}), **date, **changes}, tmp_path / f"{day}.json")
    found = history.merged(history.newest(tmp_path))
    assert found["date"][:10] == "2026-11-29"
    assert set(found["sections"]) == {"control", "gpu", "view"}
    assert found["sections"]["control"]["growth"][0]["p50_ms"] == 2.0
    text = "<!-- table: control growth: p50_ms -->\n\n<!-- end -->"
    assert "| 2.00 |" in page.rewritten(text, found)


def test_page_is_written_from_the_newest_results_of_each_section() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    found = history.merged(history.newest())
    assert page.MARKED.search(text)
    assert page.rewritten(text, found) == text, "run python -m benchmarks --page"
