"""A robot on the ground that chooses zones, from settings to records as `jaxplore run` makes them.

The other architectures fly in `tests/planning/test_architectures.py`, and that settings give the
same controllers is checked in `tests/build/test_defaults.py`.
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxplore.build.tasks import build, make_settings
from jaxplore.simulation.loop import initial_loop_state, run_chunk

STEPS = 50
ON_THE_GROUND = {
    "map": "zones",
    "architecture": "sequential",
    "robot": {"model": "differential_drive", "radius": 0.3, "max_speed": 1.0},
    "resolution": 0.2,
    "rates": {"control": 25.0, "sensing": 12.5, "fields": 5.0},
    "lidar": {"num_beams": 12},
    "fields": {"num_directions": 12},
    "informative": {
        "horizon": 20,
        "dt": 0.08,
        "num_samples": 32,
        "field_beams": 6,
        "field_range": 6.0,
        "field_noise": 0.0,
        "field_spacing": 1.0,
    },
}


def test_a_robot_on_the_ground_goes_from_zone_to_zone() -> None:
    experiment = build(make_settings(ON_THE_GROUND))
    scenario = experiment.scenario
    controller = experiment.controller.at_period(scenario.control_period)
    before = initial_loop_state(controller, scenario)
    after, records, done = run_chunk(
        controller, scenario, before, experiment.key, jnp.asarray(STEPS), STEPS
    )
    assert int(done) == STEPS
    records = jax.tree.map(np.asarray, records)
    assert np.isfinite(records.state).all()
    assert np.isfinite(records.control).all()
    assert not records.is_collision.any()
    belief = np.asarray(after.task.belief.grid.probability)
    assert belief.min() >= 0.0
    assert belief.max() <= 1.0
    travelled = records.state[-1, :2] - np.asarray(scenario.start)[:2]
    assert np.linalg.norm(travelled) > 0.3
    assert records.unknown[-1] < float(before.task.progress.unknown)
