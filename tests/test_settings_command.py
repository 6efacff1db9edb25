"""`jaxplore settings`, and what shells complete."""

import re
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete

from jaxplore.cli import cli, main
from jaxplore.cli._entries import option_entries
from jaxplore.study.tuning.optimizers import NAMES
from jaxplore.tasks.reference import find_rows, setting_names
from jaxplore.tasks.registry import make_settings, places


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def settings_of(place: str | None, file: str | None) -> object:
    """Return the settings of a run, as `jaxplore run` makes them of its options."""
    given = {"map_": place, "settings_file": file, "path_file": None, "assignments": ()}
    return make_settings(option_entries({**given, "controller__num_samples": None}))


@pytest.mark.parametrize("place", places())
def test_printed_settings_are_a_settings_file_of_the_same_run(place: str, capsys) -> None:
    main(["settings", place])
    Path("settings.yaml").write_text(capsys.readouterr().out)
    assert settings_of(None, "settings.yaml") == settings_of(place, None)
    # Without a name they are those of the office.
    main(["settings"])
    is_office = capsys.readouterr().out == Path("settings.yaml").read_text()
    assert is_office == (place == "office")


def words_of(text: str) -> str:
    """Return the words of a table: without its lines."""
    return " ".join(re.sub(r"[^\x20-\x7e]+", " ", text).split())


def test_a_section_is_a_table(capsys) -> None:
    main(["settings", "lidar"])
    shown = words_of(capsys.readouterr().out)
    assert shown.startswith("lidar (on a map): the lidar of the robot setting default [unit]")
    for text in (
        "max_range 5.0 [m] greatest range; static",
        "Accepted: number in (0, 10000]. Read by: every run.",
        "field_of_view_degrees 360.0 [degrees] field of view",
        "In degrees; `Lidar` takes radians.",
        "Quadrotors: 4.0, a depth camera, from the design notes.",
    ):
        assert text in shown
    main(["settings", "controller"])
    shown = words_of(capsys.readouterr().out)
    assert "controller (on a map)" in shown
    assert "controller (along a path)" in shown


@pytest.mark.parametrize("section", ["lidar", "portfolio", "obstacles"])
def test_no_name_is_cut_off_on_a_narrow_terminal(section: str, monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("FORCE_COLOR", "1")
    main(["settings", section])
    shown = capsys.readouterr().out
    assert max(map(len, re.sub(r"\x1b\[\d*m", "", shown).splitlines())) <= 80
    assert "…" not in shown
    for row in find_rows(section):
        assert f" {row.name.rpartition('.')[2]} " in shown


def test_a_setting_is_a_table_of_all_that_is_known(capsys) -> None:
    main(["settings", "controller.information_weight"])
    shown = words_of(capsys.readouterr().out)
    first, _, second = shown.partition(" controller.information_weight (in a volume) ")
    assert second.startswith("meaning weight of `VolumeInformationCost`.")
    assert first == (
        "controller.information_weight (on a map) meaning weight of `InformationCost`. unit - "
        "default 2.0 accepted number >= 0 read by explorer, rule-based explorers (office) note "
        "Sets the controller parameter `cost.information.weight`. owner explorer"
    )
    main(["settings", "map"])
    assert "default must be given" in words_of(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("lidr", "'lidr' is not known; accepted: such as lidar"),
        ("max_speed", "such as robot.max_speed"),
        ("robot.max_sped", "such as robot.max_speed"),
        ("wharehouse", "such as warehouse"),
        ("", "setting '' is not known"),
        # What a terminal would take for colours is printed as plain text.
        ("\x1b[31m\n[bold]", r"setting '\x1b[31m\n[bold]' is not known"),
        ("x" * 9999, "xx...' is not known"),
    ],
)
def test_an_unknown_name_is_one_line_with_near_names(name: str, near: str, fails) -> None:
    error = fails("settings", name)
    assert near in error
    assert len(error) < 300


# Completion


def completed(*arguments: str) -> list[str]:
    """Return what a shell completes the last argument to."""
    *before, incomplete = arguments
    shell = ShellComplete(cli, {}, "jaxplore", "_JAXPLORE_COMPLETE")
    return [item.value for item in shell.get_completions(before, incomplete) if item.type != "file"]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["s"], ["settings"]),
        (["run", "--set"], ["--settings", "--set"]),
        (["run", "wa"], ["warehouse", "warehouse3d"]),
        (["compare", ""], list(places())),
        (
            ["run", "office", "--set", "rates."],
            ["rates.control=", "rates.sensing=", "rates.fields="],
        ),
        (["compare", "path", "--vary", "laps"], ["laps="]),
        (["tune", "path", "--tune", "laps"], ["laps"]),
        (["tune", "path", "--optimizer", ""], list(NAMES)),
        (["run", "--robot", "u"], ["unicycle"]),
        (["run", "--architecture", "two"], ["two-layer"]),
        (["compare", "--architectures", "goal,par"], ["goal,parallel"]),
        (["settings", "lidar.r"], ["lidar.range_noise", "lidar.roll_degrees", "lidar.rings"]),
        (
            ["settings", "w"],
            [
                *("warehouse", "warehouse3d", "watch", "world"),
                *("watch.memory", "watch.weight", "watch.doubling"),
            ],
        ),
    ],
)
def test_names_are_completed(arguments: list[str], expected: list[str]) -> None:
    assert completed(*arguments) == expected


def test_every_setting_is_completed_once() -> None:
    assert completed("run", "--set", "") == [f"{name}=" for name in setting_names()]
    found = completed("settings", "")
    assert len(found) == len(set(found))
    assert {*places(), *setting_names(), "lidar"} <= set(found)


def test_a_shell_asks_through_the_environment(capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_JAXPLORE_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "jaxplore run war")
    monkeypatch.setenv("COMP_CWORD", "2")
    with pytest.raises(SystemExit) as exit_:
        main([])
    assert exit_.value.code == 0
    # The shell completes names of files as well.
    assert capsys.readouterr().out.splitlines() == [
        "file,war",
        "plain,warehouse",
        "plain,warehouse3d",
    ]
    monkeypatch.setenv("_JAXPLORE_COMPLETE", "zsh_source")
    with pytest.raises(SystemExit):
        main([])
    assert capsys.readouterr().out.startswith("#compdef jaxplore")
