"""Arrays of the frames of an exploration run."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import StateVector
from jaxplore.belief.belief import Belief
from jaxplore.control.base import SampledPlan
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan
from jaxplore.simulation.exploration.part_truth import PartTruth


def frame_arrays(
    robot: Dynamics,
    sensor: Sensor,
    state: StateVector,
    belief: Belief,
    scan: Scan,
    movers: Float[Array, "M 3"] | None,
    plan: SampledPlan | None,
    truths: Sequence[PartTruth],
    states: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the arrays of an `ExplorationFrame`, by field.

    The scan is from the robot's true pose. `movers` are (x, y, radius) of each moving obstacle [m];
    None without any. Without `plan`, none is shown. `truths` are what is true of the robot's parts,
    and `states` their states, by name.
    """
    pose = robot.pose(state)
    angles = pose[2] + jnp.asarray(sensor.beam_angles)
    directions = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
    nowhere = jnp.zeros((0, 2))
    tracks, followed = jnp.zeros((0, 2, 2)), belief.tracks
    if followed is not None:
        now, velocity = followed.mean[:, :2], followed.mean[:, 2:]
        ways = jnp.stack([now, now + velocity], axis=1)
        tracks = jnp.where(followed.is_confirmed[:, None, None], ways, jnp.nan)
    arrays = {
        "state": state,
        "probability": jnp.round(255.0 * belief.grid.probability).astype(jnp.uint8),
        "information": belief.information.total,
        "scan": pose[:2] + scan.ranges[:, None] * directions,
        "samples": jnp.zeros((0, 1, 2)),
        "weights": jnp.zeros(0),
        "plan": nowhere,
        "heading": pose[2],
        "reference": nowhere,
        "movers": nowhere if movers is None else movers[:, :2],
        "parts": part_frames(truths, belief.parts, states),
        "tracks": tracks,
        "terms": {},
        "sample_terms": {},
    }
    if plan is None:
        return arrays
    position = jax.vmap(robot.position)
    return arrays | {
        "samples": jax.vmap(position)(plan.samples),
        "weights": plan.weights,
        "plan": position(plan.nominal.states),
        "reference": nowhere if plan.reference is None else plan.reference[:, :2],
        "terms": plan.nominal.terms,
        "sample_terms": dict(plan.sample_terms),
    }


def part_frames(
    truths: Sequence[PartTruth], known: Mapping[str, Any], states: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arrays that a frame has of parts, by name.

    `known` are the states of parts, and `states` those of their truths.
    """
    frames = {
        each.name: each.frame(known.get(each.name), states.get(each.name))
        for each in truths
        if each.name in known or each.name in states
    }
    return {name: each for name, each in frames.items() if each is not None}


def crop_frame(arrays: Mapping[str, Any], world: OccupancyGrid, stride: int) -> dict[str, Any]:
    """Return the arrays of a frame, those with the shape of the map without the cells beside it.

    `stride` is the number of cells between the nodes of the information field.
    """
    rows, columns = world.crop(arrays["probability"]).shape
    nodes = -(-rows // stride), -(-columns // stride)
    on_map = {
        "probability": arrays["probability"][:rows, :columns],
        "information": arrays["information"][: nodes[0], : nodes[1]],
    }
    return {**arrays, **on_map}
