"""The control step of the closed loop: whole, and part by part."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks.setting import available_sites, experiment
from benchmarks.timing import TimedLoop, timed
from jaxplore import MPPI
from jaxplore.simulation.exploration.scenario import ExplorationScenario

CHUNK = 50


def measure(steps: int) -> dict[str, Any]:
    """Return the times of the very step of the loop, run one at a time and in chunks.

    Chunks and single steps take turns along one run on the first map, so that both see the same
    beliefs and the same noise of the machine.
    """
    site = available_sites()[0]
    controller, scenario, _, key = experiment(site, target_coverage=1.0)
    assert isinstance(scenario, ExplorationScenario)
    loop = TimedLoop(controller, scenario, key, CHUNK)
    controller, compile_seconds = loop.controller, loop.run(0)
    loop.run(CHUNK)
    chunks, single = loop.turns(steps)
    times = 1e3 * np.asarray(single)
    every = int(scenario.steps_per_field)
    phases = [float(np.median(times[phase::every])) for phase in range(every)]
    p50, p99 = np.percentile(times, [50, 99])
    assert isinstance(controller, MPPI)
    return {
        "map": site.name,
        "cells": list(scenario.world.shape),
        "samples": controller.num_samples,
        "horizon": controller.horizon,
        "steps": len(single),
        "compile_seconds": compile_seconds,
        "p50_ms": float(p50),
        "p99_ms": float(p99),
        "steps_per_second_p50": float(1e3 / p50),
        "loop_mean_ms": 1e3 * float(np.median(chunks)),
        "median_ms_by_phase": phases,
        "parts": _parts(controller, scenario, loop.state, key),
    }


def _parts(controller: Any, scenario: Any, state: Any, key: Any) -> dict[str, Any]:
    perception, pose = scenario.perception, scenario.robot.pose(state.task.robot)
    scan = scenario.sensors[0].scan(scenario.world, pose, key=key)
    model, sensor = perception.sensor_model, perception.field_sensor
    period = jnp.asarray(0.2)
    parts = {
        "scan": timed(
            lambda lidar, world, at, k: lidar.scan(world, at, key=k),
            scenario.sensors[0],
            scenario.world,
            pose,
            key,
        ),
        "map update and clearance": timed(perception.observe, state.task.belief, scan, pose),
        "information field, whole": timed(sensor.field, state.task.belief.grid, model),
        "all fields": timed(perception.update_fields, state.task.belief, pose, period),
        "MPPI": timed(
            lambda c, s, x, b, k: c.step(s, x, b, key=k),
            controller,
            state.controller,
            state.task.robot,
            state.task.belief,
            key,
        ),
    }
    result: dict[str, Any] = {name: dataclasses.asdict(part) for name, part in parts.items()}
    nodes = state.task.belief.information.total.size
    beams = nodes * sensor.table.num_directions
    field = result["information field, whole"]
    field["beams"] = beams
    field["million_beams_per_second"] = beams / field["p50_ms"] / 1e3
    return result
