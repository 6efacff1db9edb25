"""The records of the robots of a fleet, as one record with an axis of robots."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp

from jaxplore._trees import stack_trees
from jaxplore.report.exploration.data import ExplorationRecord


def stack_records(
    records: Sequence[ExplorationRecord], together: Mapping[str, Any]
) -> ExplorationRecord:
    """Return the record of all robots, in which fields have an axis of robots (N,).

    `together` are the records of parts, by name, that judge what all robots know together. The
    states, the controls and what is counted on one map are left out.
    """
    alone = [
        each._replace(
            state=None,  # type: ignore[arg-type]
            control=None,  # type: ignore[arg-type]
            entropy=None,
            unknown=None,
            unknown_map=None,
            members=None,
            is_carried=_is_carried(each, records),
            parts={name: own for name, own in each.parts.items() if name not in together},
        )
        for each in records
    ]
    every: ExplorationRecord = stack_trees(alone)
    return every._replace(parts={**every.parts, **together})


def _is_carried(one: ExplorationRecord, records: Sequence[ExplorationRecord]) -> Any:
    """Return the flag of a robot; that of one which no fault carries is False beside others."""
    is_any = any(each.is_carried is not None for each in records)
    return jnp.array(False) if is_any and one.is_carried is None else one.is_carried
