"""Experiments: all that a run of any task needs."""

from typing import NamedTuple

from jaxplore._types import Key
from jaxplore.control.base import Controller
from jaxplore.simulation.scenario import Scenario


class Experiment(NamedTuple):
    """The arguments of `simulate`.

    Args:
        controller: computes the controls.
        scenario: the task.
        num_steps: greatest number of control periods.
        key: random key.
    """

    controller: Controller
    scenario: Scenario
    num_steps: int
    key: Key
