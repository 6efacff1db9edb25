"""How long nothing has come of what a node needs: a robot that is gone."""

import math
import time
from collections.abc import Sequence

from jaxplore.ros.link import Link

GONE_SECONDS = 10.0
"""Silence after which a robot is gone [s]."""
REPORT_SECONDS = 60.0
"""Time between two reports of that [s]."""


class Silence:
    """Tells that topics are silent, and when to give up.

    Topics have their full names. One that has never been heard counts from the start. Times are
    real ones: with a simulator that is paused nothing comes either. `give_up_after` is the silence
    after which the node ends [s]; it waits for ever when absent.
    """

    def __init__(self, link: Link, topics: Sequence[str], give_up_after: float | None) -> None:
        self._link, self._give_up_after = link, give_up_after
        now = time.monotonic()
        self._heard = dict.fromkeys(topics, now)
        self._never = set(topics)

    def hear(self, topic: str) -> None:
        """Note that a message of a topic has come."""
        self._heard[topic] = time.monotonic()
        self._never.discard(topic)

    @property
    def is_long(self) -> bool:
        """Whether a robot that is so silent is gone."""
        return self._longest >= GONE_SECONDS

    @property
    def _longest(self) -> float:
        return time.monotonic() - min(self._heard.values(), default=math.inf)

    def check(self) -> str:
        """Report a long silence once a minute; return why the node gives up, or an empty text."""
        if not self.is_long:
            return ""
        now = time.monotonic()
        silent = [
            f"nothing {'has come' if topic in self._never else 'comes'} on {topic} for "
            f"{now - heard:.0f} s"
            for topic, heard in self._heard.items()
            if now - heard >= GONE_SECONDS
        ]
        text = " and ".join(silent)
        if self._give_up_after is not None and self._longest >= self._give_up_after:
            return f"{text}: the robot is gone"
        ends = "" if self._give_up_after is not None else "; node.give_up_after would end the node"
        self._link.warn("silence", f"{text}{ends}", every=REPORT_SECONDS)
        return ""
