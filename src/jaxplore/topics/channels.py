"""Channels of Foxglove, made when they are first written to."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from jaxplore._optional import import_optional
from jaxplore.topics.messages import EXTRA


class Channels:
    """Topics of a context of Foxglove's SDK: of a file, or of a server for live views.

    `began` is when the run started [s since the epoch]; 0 for simulated time.
    """

    def __init__(self, context: Any, began: float = 0.0) -> None:
        self._sdk = import_optional("foxglove", EXTRA)
        self._typed = import_optional("foxglove.channels", EXTRA)
        self._context, self._began = context, round(1e9 * began)
        self._channels: dict[str, Any] = {}

    def stamp(self, time: float) -> int:
        """Return a time since the start of the run [s] in nanoseconds since the epoch."""
        return self._began + round(1e9 * time)

    def log(self, topic: str, message: Any, time: float) -> None:
        """Write a message of one of Foxglove's schemas; the time is since the start of the run [s].

        All messages of a topic are of one schema.
        """
        if topic not in self._channels:
            make = getattr(self._typed, f"{type(message).__name__}Channel")
            self._channels[topic] = make(topic, context=self._context)
        self._channels[topic].log(message, log_time=self.stamp(time))

    def log_values(self, topic: str, values: Mapping[str, float | str], time: float) -> None:
        """Write numbers and texts by name, as JSON; the time is since the start of the run [s].

        All messages of a topic have the same names. JSON has no infinity and no NaN: such a value
        is left out of its message.
        """
        kinds = {
            name: {"type": "string" if isinstance(each, str) else "number"}
            for name, each in values.items()
        }
        known = {
            name: each
            for name, each in values.items()
            if isinstance(each, str) or math.isfinite(each)
        }
        self._log_json(topic, known, kinds, time)

    def log_lists(self, topic: str, values: Mapping[str, Sequence[float]], time: float) -> None:
        """Write lists of numbers by name, as JSON; a number that is not finite is null.

        The time is since the start of the run [s]. All messages of a topic have the same names.
        """
        kind = {"type": "array", "items": {"type": "number"}}
        known = {
            name: [each if math.isfinite(each) else None for each in some]
            for name, some in values.items()
        }
        self._log_json(topic, known, dict.fromkeys(values, kind), time)

    def _log_json(
        self, topic: str, content: Mapping[str, Any], properties: Mapping[str, Any], time: float
    ) -> None:
        """Write a JSON object; `properties` is the schema of its entries by name."""
        if topic not in self._channels:
            schema = {
                "title": f"jaxplore{topic.replace('/', '.')}",
                "type": "object",
                "properties": properties,
            }
            self._channels[topic] = self._sdk.Channel(topic, schema=schema, context=self._context)
        self._channels[topic].log(content, log_time=self.stamp(time))

    def close(self) -> None:
        """Close all channels."""
        for each in self._channels.values():
            each.close()
        self._channels.clear()
