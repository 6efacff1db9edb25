"""Maps are merged without counting a scan twice, whoever passes them on and in whatever order."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import InverseSensorModel
from jaxplore.belief.merging import log_odds_change, merge_maps
from jaxplore.simulation.fleet.radio import NEVER, Heard, newest, take_values

NUMBER, SHAPE = 3, (4, 5)
# Beyond the clamp nothing is merged exactly, so it is not reached here.
MODEL = InverseSensorModel(0.3, -0.2, -30.0, 30.0)
PRIOR = jnp.asarray(np.random.default_rng(7).uniform(0.2, 0.8, SHAPE), jnp.float32)
ALL = jnp.ones((NUMBER, NUMBER), bool) & ~jnp.eye(NUMBER, dtype=bool)


@jax.jit
def meet(grids, merged, heard, links, step):
    """Let robots exchange maps, as `exchange` does for whole explorations."""
    every = jnp.arange(NUMBER)
    own = jnp.stack([log_odds_change(MODEL, merged[i], grids[i]) for i in range(NUMBER)])
    log_odds = heard.log_odds.at[every, every].add(own)
    version = heard.version.at[every, every].set(step)
    source = newest(version, links)
    received, is_news, _ = take_values(log_odds, source, version)
    is_new = is_news | (links.any(axis=1)[:, None, None] & (own != 0.0))
    after = jnp.stack(
        [merge_maps(MODEL, PRIOR, received[i], grids[i], is_new[i]) for i in range(NUMBER)]
    )
    return after, Heard(received, heard.lengths, version[source, every[None, :]])


scan = jax.jit(lambda values, change: MODEL.update(values, change))
events = st.lists(
    st.one_of(
        st.tuples(st.just("scan"), st.integers(0, NUMBER - 1), st.integers(0, 2**20)),
        st.tuples(st.just("meet"), st.lists(st.booleans(), min_size=3, max_size=3)),
    ),
    max_size=25,
)


@given(events)
def test_merged_maps_are_the_map_of_one_robot_with_all_scans(happened) -> None:
    grids = jnp.stack([PRIOR] * NUMBER)
    merged, every_scan = grids, PRIOR
    heard = Heard.nothing(NUMBER, SHAPE, (1, 1))
    for step, (kind, *what) in enumerate(happened):
        if kind == "scan":
            robot, seed = what
            rng = np.random.default_rng(seed)
            change = jnp.asarray(rng.choice([0.3, -0.2, 0.0], SHAPE), jnp.float32)
            grids = grids.at[robot].set(scan(grids[robot], change))
            every_scan = scan(every_scan, change)
        else:
            links = np.zeros((NUMBER, NUMBER), bool)
            links[[0, 0, 1], [1, 2, 2]] = what[0]
            grids, heard = meet(grids, merged, heard, jnp.asarray(links | links.T), step)
            merged = grids
    # In the end everybody hears everybody, twice over, which must change nothing more.
    for step in (100, 101):
        grids, heard = meet(grids, merged, heard, ALL, step)
        merged = grids
        np.testing.assert_allclose(grids, jnp.stack([every_scan] * NUMBER), atol=1e-5, rtol=0)


def test_a_robot_that_hears_nobody_keeps_its_map_to_the_bit() -> None:
    grids = jnp.asarray(np.random.default_rng(1).uniform(0, 1, (NUMBER, *SHAPE)), jnp.float32)
    heard = Heard.nothing(NUMBER, SHAPE, (1, 1))
    links = jnp.zeros((NUMBER, NUMBER), bool).at[0, 1].set(True).at[1, 0].set(True)
    after, heard = meet(grids, jnp.stack([PRIOR] * NUMBER), heard, links, 5)
    np.testing.assert_array_equal(after[2], grids[2])
    assert np.abs(after[0] - grids[0]).max() > 0.01
    np.testing.assert_array_equal(heard.version, [[5, 5, NEVER], [5, 5, NEVER], [NEVER, NEVER, 5]])


def test_news_are_passed_on_and_old_ones_are_not_taken() -> None:
    """Robot 0 hears of robot 2 through robot 1, and keeps what it knows newer itself."""
    version = jnp.array([[9, 3, NEVER], [4, 9, 8], [NEVER, NEVER, 9]], jnp.int32)
    links = jnp.zeros((3, 3), bool).at[0, 1].set(True).at[1, 0].set(True)
    source = np.asarray(newest(version, links))
    np.testing.assert_array_equal(source, [[0, 1, 1], [0, 1, 1], [2, 2, 2]])


def test_what_is_taken_is_that_of_the_source_before_and_news_are_what_differs() -> None:
    """Against NumPy, with random versions and links: many robots take from one that takes itself
    from another."""
    rng = np.random.default_rng(4)
    every, take = np.arange(6), jax.jit(take_values)
    chains = 0
    for _ in range(20):
        values = rng.choice([0.0, 1.0, 2.0], (6, 6, 3, 5)).astype(np.float32)
        version = rng.integers(NEVER, 12, (6, 6)).astype(np.int32)
        version[every, every] = 12
        links = np.triu(rng.uniform(size=(6, 6)) < 0.5, 1)
        source = np.asarray(newest(jnp.asarray(version), jnp.asarray(links | links.T)))
        is_taken = source != every[:, None]
        chains += (is_taken & is_taken[source, every]).sum()
        found = take(jnp.asarray(values), jnp.asarray(source), jnp.asarray(version))
        expected = values[source, every]
        np.testing.assert_array_equal(found.values, expected)
        np.testing.assert_array_equal(found.is_news, (expected != values).any(axis=1))
        assert float(found.number) == (expected != values).sum()
    assert chains > 20


def test_the_clamp_bounds_the_sum_of_all() -> None:
    model = InverseSensorModel()
    full = jnp.full((2, *SHAPE), -7.0)
    now = jnp.full(SHAPE, 0.5)
    found = merge_maps(model, now, full, now, jnp.ones(SHAPE, bool))
    np.testing.assert_allclose(found, jax.nn.sigmoid(model.minimum), rtol=1e-6)
