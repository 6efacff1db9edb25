"""Cases and mutations that are run in this process, one after the other."""

import shutil
from pathlib import Path
from typing import Any

from . import logs, places, volumes
from .cases import IMPOSSIBLE, Case
from .command import call
from .mutations import FORMATS, place
from .outcomes import Judged, Outcome, judge


class Trials:
    """Runs cases and mutations.

    Args:
        root: new folder, for the valid files and for the folder of a case.
    """

    def __init__(self, root: Path) -> None:
        root.mkdir()
        self.root = root.resolve()
        self.base, self._folder = self.root / places.BASE, self.root / "case"
        places.write_files(self.base)
        logs.write_logs(self.base)
        places.write_bag(self.base)
        places.write_kept(self.base)
        volumes.write_volumes(self.base)

    def run(self, case: Case) -> Judged:
        """Run a case in an empty folder."""
        self._empty()
        if case.prepare is not None:
            case.prepare(self._folder)
        judged = self._call(places.filled(case.arguments, self.base))
        if case.category in IMPOSSIBLE and judged.outcome is Outcome.ACCEPTED:
            return Judged(Outcome.BEGUN)
        return judged

    def mutate(self, name: str, mutation: tuple[bool, Any, Any]) -> Judged:
        """Run the command of a format with a mutated file."""
        self._empty()
        place(FORMATS[name], mutation, self.base, self._folder)
        return self._call(places.filled(FORMATS[name].arguments, self.base))

    def _empty(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder.mkdir()

    def _call(self, arguments: list[str]) -> Judged:
        return judge(call(arguments, self._folder, self.root))
