"""The control step of the closed loop: whole, and part by part."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from benchmarks.setting import SMALL, SMALL_OFFICE, Site, available_sites, experiment
from benchmarks.tables import Rows
from benchmarks.timing import TimedLoop, percentiles, timed
from jaxplore.simulation.exploration.scenario import ExplorationScenario


class Sizes(NamedTuple):
    """A site, changes of the default explorer, steps and calls."""

    site: Site = available_sites()[0]
    changes: dict[str, Any] = {}  # noqa: RUF012
    chunk: int = 50
    steps: int = 2000
    runs: int = 200


FULL = Sizes()
SMOKE = Sizes(SMALL_OFFICE, SMALL, 25, 25, 3)
TITLES = {
    "step": "The closed-loop step: K = 1000, T = 40",
    "parts": "The same, part by part",
}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the times of the very step of the loop, run one at a time and in chunks.

    Chunks and single steps take turns along one run on the first map, so that both see the same
    beliefs and the same noise of the machine.
    """
    controller, scenario, _, key = experiment(sizes.site, target_coverage=1.0, **sizes.changes)
    assert isinstance(scenario, ExplorationScenario)
    loop = TimedLoop(controller, scenario, key, sizes.chunk)
    compile_seconds = loop.run(0)
    loop.run(sizes.chunk)
    chunks, single = loop.turns(sizes.steps)
    shared = {
        "map": sizes.site.name,
        "cells": " x ".join(map(str, scenario.world.shape)),
        "compile_seconds": compile_seconds,
    }
    return {
        "step": [
            {"": "one step at a time", **percentiles(single), **shared},
            {"": "in chunks, a step", **percentiles(chunks), **shared},
        ],
        "parts": _parts(loop, scenario, key, sizes.runs),
    }


def _scan(lidar: Any, world: Any, pose: Any, key: Any) -> Any:
    return lidar.scan(world, pose, key=key)


def _parts(loop: TimedLoop, scenario: ExplorationScenario, key: Any, runs: int) -> Rows:
    state, perception = loop.state, scenario.perception
    pose = scenario.robot.pose(state.task.robot)
    scan = eqx.filter_jit(_scan)(scenario.sensors[0], scenario.world, pose, key)
    model, sensor = perception.sensor_model, perception.field_sensor
    period = jnp.asarray(0.2)
    parts: dict[str, tuple[Any, ...]] = {
        "scan": (_scan, scenario.sensors[0], scenario.world, pose, key),
        "map update and clearance": (perception.observe, state.task.belief, scan, pose),
        "information field, whole": (sensor.field, state.task.belief.grid, model),
        "all fields": (perception.update_fields, state.task.belief, pose, period),
        "MPPI": (
            lambda c, s, x, b, k: c.step(s, x, b, key=k),
            loop.controller,
            state.controller,
            state.task.robot,
            state.task.belief,
            key,
        ),
    }
    rows = [{"": name, **timed(*each, runs=runs).row()} for name, each in parts.items()]
    beams = state.task.belief.information.total.size * sensor.table.num_directions
    for row in rows:
        of_field = row[""] == "information field, whole"
        row["million_beams_per_second"] = beams / row["p50_ms"] / 1e3 if of_field else None
    return rows
