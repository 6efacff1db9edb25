"""Commands of `jaxplore` with one more row of the registry: `python new_part_program.py`.

It writes JSON: what commands print, their exit codes, and the page of settings.
"""

import contextlib
import io
import json
import runpy
import sys
from pathlib import Path

from priority import PRIORITY

from jaxplore.parts import registry

registry.CAPABILITIES += (PRIORITY,)  # The row. Nothing else is told of the part.

from jaxplore.cli import _known, cli, main  # noqa: E402


def said(*arguments: str) -> tuple[int, str, str]:
    """Return the exit code of a command, and what it writes to either stream."""
    code, streams = 0, (io.StringIO(), io.StringIO())
    with contextlib.redirect_stdout(streams[0]), contextlib.redirect_stderr(streams[1]):
        try:
            main(arguments)
        except SystemExit as end:
            code = int(end.code or 0)
    return code, *(each.getvalue() for each in streams)


if __name__ == "__main__":
    from click.shell_completion import ShellComplete

    page = Path(sys.argv[1])
    # As `python docs/settings_page.py` does.
    _known.FILE = Path("known.json")
    _known.FILE.write_text(_known.as_text(_known.from_settings()))
    _known.load_known.cache_clear()
    shell = ShellComplete(cli, {}, "jaxplore", "_JAXPLORE_COMPLETE")
    short = ("--settings", "priority.yaml", "--no-animation")
    json.dump(
        {
            "page": runpy.run_path(str(page))["page"](),
            "completed": [
                each.value for each in shell.get_completions(["run", "office", "--set"], "prio")
            ],
            "explained": said("settings", "priority.worth"),
            "defaults": said("settings", "office"),
            "refused": said("run", "office", *short, "--set", "priority.worth=0"),
            "elsewhere": said("run", "path", "--set", "priority.worth=2"),
            "run": said("run", "office", *short, "--out", "alone"),
            "fleet": said("run", "fleet", *short, "--robots", "2", "--out", "fleet"),
        },
        sys.stdout,
    )
