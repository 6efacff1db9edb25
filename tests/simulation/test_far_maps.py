"""A run far from the origin: the same steps, and everything that leaves it where the map is."""

import json

import jax
import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

import jaxplore as jx
from jaxplore.maps import Datum
from jaxplore.recorder import McapRecorder
from jaxplore.simulation.monitor import Monitor
from jaxplore.simulation.run import Run
from jaxplore.simulation.stacking import Stacked

pytestmark = pytest.mark.long

DATUM = Datum(500_000.0, 4_649_776.0)
KEY = jax.random.key(3)
STEPS = 80
PLACES = ("scan", "samples", "plan")


class Seen(Monitor):
    """Keeps the states and the frames that it is shown."""

    def __init__(self) -> None:
        self.states, self.frames = [], []

    def begin(self, recording, controller) -> None:
        self.recording = recording

    def is_due(self, simulated, elapsed) -> bool:
        return True

    def show(self, update) -> None:
        self.states.append(update.records.state)
        self.frames.append(update.frame)

    def end(self, recording) -> None:
        pass


@pytest.fixture(scope="module")
def pair(make, tmp_path_factory):
    """The same run at the origin and far away, and what watched the latter."""
    file = tmp_path_factory.mktemp("far") / "run.mcap"
    controller, here = make()
    _, there = make(rates={"datum": DATUM})
    near = jx.simulate(controller, here, STEPS, key=KEY)
    before = jx.simulation.run.run_chunk._cached._cache_size()
    seen = Seen()
    far = jx.simulate(controller, there, STEPS, key=KEY, monitors=[seen, McapRecorder(file)])
    assert jx.simulation.run.run_chunk._cached._cache_size() == before
    return near, far, (controller, there), seen, file


def test_a_run_far_away_is_the_same_and_recorded_where_the_map_is(pair) -> None:
    near, far, *_ = pair
    here, there = near.recording, far.recording
    np.testing.assert_array_equal(here.records.control, there.records.control)
    for name in here.records._fields:
        if name not in ("state", "members"):
            mine, theirs = (getattr(each.records, name) for each in (here, there))
            np.testing.assert_array_equal(mine, theirs)
    exact = {"rtol": 0.0, "atol": 1e-9}
    np.testing.assert_allclose(there.positions, here.positions + DATUM.offset, **exact)
    np.testing.assert_array_equal(here.records.state[:, 2:], there.records.state[:, 2:])
    np.testing.assert_allclose(there.origin[:2], here.origin[:2] + DATUM.offset, **exact)
    for one, other in zip(here.frames, there.frames, strict=True):
        for name in PLACES:
            expected = getattr(one, name) + DATUM.offset
            np.testing.assert_allclose(getattr(other, name), expected, **exact)
    # Pictures do not depend on where the map is.
    pictures = [np.asarray(each.frame_image(each.frames[-1])) for each in (here, there)]
    np.testing.assert_array_equal(*pictures)
    assert near.metrics.path_length > 0.05
    assert far.metrics.path_length == pytest.approx(near.metrics.path_length, abs=1e-6)
    assert far.metrics.coverage == near.metrics.coverage


def test_monitors_and_the_recorder_see_the_coordinates_of_the_map(pair) -> None:
    _, far, _, seen, file = pair
    np.testing.assert_array_equal(np.concatenate(seen.states), far.recording.records.state)
    np.testing.assert_array_equal(seen.recording.origin, far.recording.origin)
    np.testing.assert_allclose(seen.frames[-1].plan[0], far.recording.positions[-1], atol=0.2)
    with file.open("rb") as stream:
        poses = [data.data for _, _, data in make_reader(stream).iter_messages(["/state"])]
    last = json.loads(poses[-1])
    x, y = far.recording.positions[-1].tolist()
    assert (last["x"], last["y"]) == pytest.approx((x, y), abs=1e-6)


def test_a_folder_far_away_is_where_the_map_is_and_goes_on(pair, tmp_path) -> None:
    _, far, (controller, scenario), *_ = pair
    far.save(tmp_path / "run", animation=False)
    explored = yaml.safe_load((tmp_path / "run/explored.yaml").read_text())
    assert explored["origin"] == [DATUM.x, DATUM.y, 0.0]
    arrays = np.load(tmp_path / "run/arrays.npz")
    np.testing.assert_array_equal(arrays["positions"], far.recording.positions)
    np.testing.assert_array_equal(arrays["origin"][:2], DATUM.offset)
    whole = jx.simulate(controller, scenario, STEPS + 20, key=KEY).recording
    for part in (far, Run.load(tmp_path / "run")):
        rest = jx.simulate(controller, scenario, STEPS + 20, key=KEY, resume=part).recording
        np.testing.assert_array_equal(rest.records.control, whole.records.control)
        np.testing.assert_allclose(rest.positions, whole.positions, rtol=0.0, atol=1e-8)
    axes = far.plot("map").axes[0]
    axes.figure.canvas.draw()
    labels = [int(each.get_text()) for each in axes.get_yticklabels()]
    assert all(DATUM.y - 2 <= label <= DATUM.y + 6 for label in labels)


def test_scenarios_that_differ_in_their_datum_share_a_program(make) -> None:
    _, here = make()
    _, there = make(rates={"datum": DATUM})
    structures = [jax.tree.structure(each) for each in (here, there)]
    assert structures[0] == structures[1]
    assert hash(structures[0]) == hash(structures[1])
    Stacked.from_trees([here, there])
    for changed in (there.with_disturbances([]), there.for_batches()):
        assert changed.datum == DATUM
