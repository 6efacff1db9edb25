"""What `make test` installs on a fresh machine."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_constraints_pin_a_version_of_each_package_and_name_no_file_or_address() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if line and not line.startswith("#")]
    assert len(pins) > 50
    wrong = [line for line in pins if not re.fullmatch(r"[A-Za-z0-9][\w.-]*==[\w.!+]+", line)]
    assert not wrong, "a fresh machine has no such files: pip freeze writes them for local wheels"
