"""Texts on terminals, and the cut of long messages."""

import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from jaxplore._text import one_line, printable
from jaxplore.cli import main
from jaxplore.report import console, table


@given(st.text(st.characters(exclude_characters="\n", exclude_categories=())))
def test_everything_that_is_shown_prints(text: str) -> None:
    assert printable(text).isprintable()
    printable(text).encode()
    assert one_line(text).isprintable()


def test_what_prints_stays_and_the_rest_is_escaped() -> None:
    assert printable("5 µm, ±1°\n[/red]") == "5 µm, ±1°\n[/red]"
    # An escape sequence, a right-to-left override, and a byte of a name that is not UTF-8.
    assert printable("\x1b[31m\u202eb\udcff") == "\\x1b[31m\\u202eb\\xff"


def test_a_long_message_keeps_what_it_begins_and_ends_with() -> None:
    path = "/".join("x" * 90 for _ in range(3))
    assert one_line(f"{path} is\n\nthere") == f"{path} is there"
    for name in ("x" * 6000, "x " * 3000):
        line = one_line(f"map is {name} and not there; accepted: a file")
        assert len(line) <= 500
        assert line.startswith("map is x")
        assert line.endswith("; accepted: a file")


@pytest.mark.parametrize("name", ["[/red]", "\x1b[31mred", "b\udcff.yaml", "x" * 6000])
def test_no_name_reaches_the_terminal_as_it_is(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for arguments in (["run", name], ["run", "--settings", name], ["settings", name]):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 2
        (line,) = capfd.readouterr().err.splitlines()
        assert line.isprintable()
        assert len(line) <= 500
        assert "codec" not in line


def test_tables_and_progress_bars_have_no_markup(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.StringIO()

    def terminal(**options: object) -> Console:
        return Console(file=stream, force_terminal=True, width=100, color_system=None)

    monkeypatch.setattr(table, "Console", terminal)
    table.print_table([("[/red]", "a"), ("\x1b[31m", "b\udcff")], title="[/x]")
    monkeypatch.setattr("rich.console.Console", terminal)
    with console.progress_bar("[/red]", enabled=True) as advance:
        advance(0.5, "[/blue]\x1b]0;title\x07")
    shown = stream.getvalue()
    for each in ("[/red]", "[/x]", "\\x1b[31m", "b\\xff", "[/blue]\\x1b]0;title\\x07"):
        assert each in shown
    assert "\x1b]0;" not in shown
