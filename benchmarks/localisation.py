"""Localisation: the time of a match and of a particle filter, and how exact closed loops are."""

import argparse
import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from benchmarks.history import results_file
from benchmarks.setting import available_maps
from benchmarks.tables import Rows, table
from benchmarks.timing import TimedLoop, timed
from jaxplore.localisation.localiser import Localiser
from jaxplore.localisation.particles import ParticleFilter
from jaxplore.localisation.surface import EndPoints
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.run import simulate
from jaxplore.tasks.registry import build, make_settings

SITES = {
    "nav2_depot": "nav2_depot/depot.yaml",
    "levine_lobby": "levine_lobby/levinelobby.yaml",
    "nav2_warehouse": "nav2_warehouse/warehouse.yaml",
    "willow_garage_010": "willow_garage_010/willow-2010-02-18-0.10.yaml",
}
DRIFT = {"distance_noise": 0.02, "turn_per_distance_degrees": 1.0}
"""The odometry of the bars: 2 % of the distance and a degree in each metre."""
LIMIT = 1500.0
"""Simulated time after which a run ends [s]."""


class Sizes(NamedTuple):
    """A map, changes of the explorer's settings, steps of an exploration before its surfaces are
    matched to, numbers of particles, and timed calls."""

    path: str = next(iter(available_maps(SITES).values()))
    changes: dict[str, Any] = {}  # noqa: RUF012
    warm_up: int = 400
    particles: tuple[int, ...] = (500, 2000, 5000)
    runs: int = 300


FULL = Sizes()
# The loop of `tests/test_kinds.py`, which the suite compiles anyway.
SMOKE = Sizes(
    "office",
    {
        "office": {"width": 9.0, "height": 8.0},
        "lidar": {"num_beams": 72},
        "controller": {"num_samples": 64, "horizon": 20},
        "variation": {"gain": [0.9, 1.1]},
        "faults": {"scan_dropout": [0.4, 0.6]},
    },
    10,
    (20,),
    3,
)
TITLES = {"parts": "Parts of a localisation, scans of 360 beams"}


def exploration(path: str, seed: int, **changes: Any) -> Experiment:
    """Return an exploration by a robot that does not know its pose.

    Args:
        path: name of a generated map, or file of a map.
        seed: seed of the run.
        changes: further settings of the section `localisation`.
    """
    section = {**DRIFT, **changes}
    # The times of the tables are those to 99 %.
    end = {"time_limit": LIMIT, "target_coverage": 0.99}
    return build(make_settings({"map": path, "localisation": section, "seed": seed, **end}))


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the times of a match, of a whole correction, and of particle filters.

    The scan is a new one, from where the robot has driven in an exploration. Its guess is a fifth
    of a metre and three degrees off.
    """
    entries = {"map": sizes.path, "localisation": DRIFT, "seed": 0, **sizes.changes}
    controller, scenario, _, key = build(make_settings(entries))
    assert isinstance(scenario, ExplorationScenario)
    assert scenario.localisation is not None
    loop = TimedLoop(controller, scenario, key, sizes.warm_up)
    loop.run(sizes.warm_up)
    known = loop.state.task.own.place.known
    localiser, sensors = scenario.localisation.localiser, scenario.sensors
    assert isinstance(localiser, Localiser)
    pose = scenario.robot.pose(loop.state.task.robot)
    # Compiled: one operation at a time would be a hundred programs.
    scan, ends, points = eqx.filter_jit(_looked)(sensors[0], scenario.world, pose, key)
    guess = known._replace(
        pose=known.pose + jnp.array([0.14, 0.14, 0.05]),
        covariance=jnp.diag(jnp.array([0.1, 0.1, 0.04]) ** 2),
    )
    calls: dict[str, tuple[Any, ...]] = {
        "match": (_match, localiser.matcher, guess, ends),
        "match, add, store": (_corrected, localiser, guess, scan, sensors),
    }
    spread = jnp.diag(jnp.array([0.04, 0.04, 0.01]))
    for number in sizes.particles:
        each = ParticleFilter(scenario.localisation.odometry, number)
        field = eqx.filter_jit(each.likelihood_field)(scenario.world)
        cloud = eqx.filter_jit(each.init_around)(pose, spread, key)
        given = each, cloud, points, scan.is_return, field, key
        calls[f"{number} particles"] = (_filtered, *given)
    rows = []
    for name, call in calls.items():
        took = timed(*call, runs=sizes.runs)
        rows.append({"part": name, **took.row(), "compile_s": took.compile_seconds})
    return {"parts": rows}


def _looked(lidar: Any, world: Any, pose: Any, key: Any) -> tuple[Any, EndPoints, Any]:
    scan = lidar.scan(world, pose, key=key)
    return scan, EndPoints.of(lidar, scan), scan.points(lidar)


def _match(matcher: Any, known: Any, ends: Any) -> Any:
    return matcher(known.surface, ends, known.pose, known.covariance, known.way)


def _corrected(localiser: Any, known: Any, scan: Any, sensors: Any) -> Any:
    # The stored scans are not returned: the loop updates them in place, and a call copies them.
    after = localiser.correct(known, (scan,), sensors)
    return after.pose, after.covariance, after.surface, after.drift


def _filtered(
    particles: ParticleFilter, cloud: Any, points: Any, is_return: Any, field: Any, key: Any
) -> Any:
    motion = jnp.array([0.1, 0.0, 0.02])
    moved = particles.predict(cloud, motion, jnp.asarray(0.1), key)
    moved = particles.update(moved, points, is_return, field, key)
    return moved, particles.estimate(moved)


def measure_runs(
    seeds: Sequence[int], maps: Sequence[str] | None = None, **changes: Any
) -> list[dict[str, Any]]:
    """Return one row per map and seed; each is printed when it is done.

    Args:
        seeds: seeds of the runs.
        maps: names of maps; all when absent.
        changes: further settings of the section `localisation`.
    """
    rows = []
    for name, path in available_maps(SITES).items():
        if maps is not None and name not in maps:
            continue
        for seed in seeds:
            made = exploration(path, seed, **changes)
            metrics: Any = simulate(
                made.controller, made.scenario, made.num_steps, key=made.key, num_trajectories=0
            ).metrics
            rows.append(
                {
                    "map": name,
                    "seed": seed,
                    **changes,
                    "ate_m": metrics.ate,
                    "odometry_ate_m": metrics.odometry_ate,
                    "rpe_m": metrics.rpe,
                    "map_iou": metrics.map_iou,
                    "double_walls": metrics.double_walls,
                    "aligned_coverage": metrics.aligned_coverage,
                    "coverage": metrics.coverage,
                    "loops": metrics.num_loops,
                    "collisions": metrics.collisions,
                    "path_m": metrics.path_length,
                    "time_to_95_s": metrics.time_to["95"],
                    "finished_at_s": metrics.finished_at,
                }
            )
            print(json.dumps(rows[-1]), flush=True)
    return rows


def main() -> None:
    """Measure what the command line asks for."""
    from rich.console import Console

    parser = argparse.ArgumentParser(prog="python -m benchmarks.localisation", description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="*", default=list(range(5)))
    parser.add_argument(
        "--maps", nargs="*", choices=list(available_maps(SITES)), help="[default: all]"
    )
    parser.add_argument("--most-uncertainty", type=float, help="go back beyond this [m]")
    parser.add_argument(
        "--uncertainty-weight", type=float, nargs="*", default=[], help="pay so much for it"
    )
    parser.add_argument("--times", action="store_true", help="only the time of the parts")
    parser.add_argument("--out", type=results_file, help="JSON file of the rows")
    choice, console = parser.parse_args(), Console(width=180)
    if choice.times:
        rows = measure(FULL)["parts"]
        console.print(table(TITLES["parts"], rows))
    else:
        bound = choice.most_uncertainty
        changes = {} if bound is None else {"most_uncertainty": bound}
        each = [{**changes, "uncertainty_weight": weight} for weight in choice.uncertainty_weight]
        rows = [
            row
            for changed in each or [changes]
            for row in measure_runs(choice.seeds, choice.maps, **changed)
        ]
        console.print(table("Closed loops without a known pose", rows))
    if choice.out is not None:
        choice.out.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
