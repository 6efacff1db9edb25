"""`jaxplore import-nav2`: settings from the parameter file of nav2's MPPI controller."""

from pathlib import Path

import yaml

from jaxplore._text import printable_path
from jaxplore.cli._terminal import say
from jaxplore.report.folder import write_whole
from jaxplore.ros.nav2 import Nav2Settings, read_nav2


def import_nav2(
    file: Path, out: Path | None, task: str, controller: str | None, *, overwrite: bool
) -> None:
    """Write settings, and name the parameters without a counterpart.

    Without `out` the settings go to standard output. `controller` is the name of the controller in
    the file, if there are several.
    """
    found = read_nav2(file, task, controller)
    text = _as_yaml(found, file)
    if out is None:
        say(text, nl=False)
        return
    if out.exists() and not overwrite:
        raise ValueError(f"{printable_path(out)} exists; accepted: another file, or --overwrite")
    write_whole(out, lambda stream: stream.write(text.encode()), "settings")
    say(f"{printable_path(out)}: settings for jaxplore run --settings")
    for name, reason in found.left_out:
        say(f"no counterpart: {name}: {reason}")


def _as_yaml(found: Nav2Settings, file: Path) -> str:
    lines = [f"# From {printable_path(Path(file.name))}, parameters of nav2."]
    if found.left_out:
        lines += ["#", "# Without a counterpart:"]
        lines += [f"# {_plain(name)}: {reason}" for name, reason in found.left_out]
    body = yaml.safe_dump(found.entries, sort_keys=False, default_flow_style=None)
    return "\n".join(lines) + "\n\n" + body


def _plain(name: str) -> str:
    # Names come from the file: a line break in one would end the comment.
    return name if name.isprintable() else repr(name)
