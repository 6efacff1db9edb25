"""Write a session while a robot drives: no command waits for it, and the map does not either."""

import concurrent.futures
import time
from collections.abc import Callable

from jaxplore._text import error_reason, printable_path
from jaxplore.onboard.pilot import Pilot
from jaxplore.onboard.session import PLACE_SECONDS, SAVE_SECONDS, Session


class SessionWriter:
    """Writes what a pilot knows into the folder of its session, in a thread of its own.

    What it knows is in arrays that nothing changes, so a writing is as of the moment when it
    begins. Where the disk is full the drive goes on, and the former file stays.

    Args:
        pilot: a pilot with a session.
        tell: gets one line when the session was written because somebody asked for it, or when it
            could not be written.
        clock: time that does not jump [s].
    """

    def __init__(
        self,
        pilot: Pilot,
        tell: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        assert pilot.session is not None
        self._pilot, self._session, self._tell, self._clock = pilot, pilot.session, tell, clock
        self._thread = concurrent.futures.ThreadPoolExecutor(1, "session")
        self._running: concurrent.futures.Future[None] | None = None
        self._saved_at = self._placed_at = clock()
        self._is_asked = False

    @property
    def session(self) -> Session:
        """The session."""
        return self._session

    def ask(self) -> None:
        """Write at the next occasion."""
        self._is_asked = True

    def write_when_due(self) -> None:
        """Begin to write what is due, unless the last writing goes on; call it between commands."""
        if self._running is not None and not self._running.done():
            return
        now = self._clock()
        if self._is_asked or now - self._saved_at >= SAVE_SECONDS:
            is_asked, self._is_asked = self._is_asked, False
            self._saved_at = self._placed_at = now
            self._running = self._thread.submit(self._write, is_asked=is_asked)
        elif now - self._placed_at >= PLACE_SECONDS:
            self._placed_at = now
            self._running = self._thread.submit(self._write_place)

    def end(self) -> None:
        """Write for the last time; the robot stands."""
        self._thread.shutdown()
        self._write(is_asked=False)

    def _write(self, *, is_asked: bool) -> None:
        kept = self._pilot.snapshot()
        folder = printable_path(self._session.folder)
        if kept is None:
            if is_asked:
                self._tell(f"session {folder} is not written: the robot does not know its place")
            return
        try:
            self._session.write(kept)
        except OSError as error:
            self._tell(f"session {folder} cannot be written: {error_reason(error)}")
            return
        self._write_place()
        if is_asked:
            self._tell(f"session {folder} is written")

    def _write_place(self) -> None:
        place = self._pilot.last_place()
        # A place without a map would be one of another map.
        if place is None or not self._session.is_written:
            return
        try:
            self._session.write_place(place)
        except OSError as error:
            folder = printable_path(self._session.folder)
            self._tell(f"session {folder} cannot be written: {error_reason(error)}")
