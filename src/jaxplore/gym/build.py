"""Environments from settings or from scenarios."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

from jaxplore import _checks
from jaxplore._limits import MOST_AT_ONCE
from jaxplore.planning.presets.explorer import waypoint_mppi
from jaxplore.settings.defaults import parameter_default
from jaxplore.settings.fleet import FLEET
from jaxplore.settings.sections import RunSettings
from jaxplore.simulation.environment.action_modes import (
    ActionMode,
    ControlMode,
    WaypointMode,
)
from jaxplore.simulation.environment.environment import Environment
from jaxplore.simulation.scenario import Scenario
from jaxplore.tasks.exploration.settings import OFFICE, Settings
from jaxplore.tasks.registry import build, default_kind, find_kind, make_settings

DRIVE = {name: parameter_default(waypoint_mppi, name) for name in ("horizon", "num_samples")}
"""Default settings of the controller that drives to waypoints."""
WAYPOINT_PERIOD = 1.0
"""Time between waypoints [s]."""
BESIDE_A_SCENARIO = ("controller", "time_limit")
"""Settings that may be given together with a scenario."""


def build_environment(
    *,
    scenario: Scenario | Sequence[Scenario] | None = None,
    action: str = "control",
    action_period: float | None = None,
    reach: float = 3.0,
    view: float | None = None,
    collision_penalty: float = 1.0,
    num_floors: int = 1,
    **settings: Any,
) -> Environment:
    """Build an environment from a scenario or from settings.

    Args:
        scenario: scenario, or several of one size; built from the settings when absent.
        action: "control", an action is a control of the robot; or "waypoint", an action is a
            position (x, y) in the robot's frame, to which MPPI drives: see `WaypointMode`.
        action_period: time between actions [s]; rounded to control periods. When absent, a sensing
            period for controls and a second for waypoints.
        reach: greatest x and y of a waypoint [m].
        view: side of the observed square of the belief around the robot [m]; the whole map when
            absent.
        collision_penalty: reduction of the reward by contact [1/s].
        num_floors: number of generated offices, with the seeds from `office.seed` on; each episode
            draws one of them.
        settings: settings of a run, as in a settings file. With a `path` the task is path
            following, with a `volume` the exploration of one, otherwise that of a map; the map
            is the office unless another is given.
            `time_limit` ends an episode, `controller` is the MPPI of waypoints. An action of a
            `fleet` is the controls of all its robots, which have no guards.

    Raises:
        ValueError: an unknown action, settings that are not accepted, settings that a given
            scenario already determines, several floors of a map other than the office, or a value
            that `Environment` rejects.
    """
    given = _check_settings(scenario, settings)
    if scenario is None:
        scenario = _scenarios(given, num_floors)
    elif num_floors != 1:
        raise ValueError(f"num_floors is {num_floors!r} beside a scenario; accepted: several of it")
    first = scenario if isinstance(scenario, Scenario) else next(iter(scenario), None)
    if not isinstance(first, Scenario):
        raise ValueError(f"scenario is {scenario!r}; accepted: a scenario, or several")
    mode: ActionMode
    if action == "control":
        mode = ControlMode(first.robot)
    elif action == "waypoint" and isinstance(given, Settings):
        # Driving to a waypoint earns no information, so its controller has no weight for it.
        numbers = given.controller.model_dump(exclude={"information_weight"})
        mode = WaypointMode(waypoint_mppi(first.robot, **numbers), reach)
        action_period = WAYPOINT_PERIOD if action_period is None else action_period
    else:
        accepted = "control, waypoint" if isinstance(given, Settings) else "control"
        raise ValueError(f"action is {action!r}; accepted: {accepted}")
    return Environment(
        scenario,
        mode,
        action_period=action_period,
        time_limit=given.time_limit,
        collision_penalty=collision_penalty,
        view=view,
    )


def _check_settings(scenario: object, settings: dict[str, Any]) -> RunSettings:
    if "seed" in settings:
        raise ValueError(
            f"seed is {settings['seed']!r} among the settings of an environment; accepted: a seed "
            "of its reset"
        )
    if scenario is not None:
        for name in settings:
            if name not in BESIDE_A_SCENARIO:
                raise ValueError(
                    f"setting {name} is given beside a scenario; accepted: "
                    + ", ".join(BESIDE_A_SCENARIO)
                )
    if find_kind(settings) is not default_kind():
        return make_settings(settings)
    entries = {"map": OFFICE, "controller": {}, **settings}
    if isinstance(entries["map"], os.PathLike):
        entries["map"] = os.fspath(entries["map"])
    if isinstance(entries["controller"], Mapping):
        entries["controller"] = {**DRIVE, **entries["controller"]}
    if entries.get(FLEET) is not None:
        # A guard stops one robot, and an agent commands all of a fleet at once.
        entries.setdefault("guard", False)
    # The controller is that of waypoints, whatever the architecture.
    return default_kind().make_settings(entries)


def _scenarios(settings: RunSettings, num_floors: int) -> list[Scenario]:
    number = _checks.positive_int("num_floors", num_floors, at_most=MOST_AT_ONCE)
    if number == 1:
        return [build(settings).scenario]
    if not isinstance(settings, Settings) or settings.map != OFFICE:
        raise ValueError(f"num_floors is {number}; accepted: 1, or the map {OFFICE}")
    floors = (
        settings.office.model_copy(update={"seed": settings.office.seed + k}) for k in range(number)
    )
    return [build(settings.model_copy(update={"office": floor})).scenario for floor in floors]
