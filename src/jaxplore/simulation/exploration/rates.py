"""When a simulated robot scans and derives its fields: every so many control periods."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxplore._types import Count, Flag, Scalar


class Rates(NamedTuple):
    """Control period [s], and how many are between two scans and two updates of the fields."""

    period: Scalar
    steps_per_scan: Count
    steps_per_field: Count

    @property
    def since_scan(self) -> Scalar:
        """Time between two scans [s]."""
        return self.period * self.steps_per_scan.astype(jnp.float32)

    @property
    def since_fields(self) -> Scalar:
        """Time between two updates of the fields [s]."""
        return self.period * self.steps_per_field.astype(jnp.float32)

    def is_scan_due(self, step: Count) -> Flag:
        """Check whether scans are due at a step."""
        return step % self.steps_per_scan == 0

    def are_fields_due(self, step: Count) -> Flag:
        """Check whether an update of the fields is due at a step.

        The fields are derived one step before a strategic layer of the same rate runs: it reads
        fresh fields, and no single step has the cost of both.
        """
        every = self.steps_per_field
        return (step % every == every - 1) | (step == 0)
