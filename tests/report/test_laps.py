import dataclasses

import numpy as np
import pytest

from jaxplore.report.following.data import lap_starts, lap_times, num_laps, speeds


@pytest.fixture
def make_laps(make_straight):
    """Make a run of steps of half a second, on laps of 10 m, with a given progress."""

    def make(progress, *, laps=2, is_closed=True, length=10.0):
        run = make_straight()
        steps = len(progress) - 1
        rows = {
            name: np.resize(values, (steps, *np.shape(values)[1:]))
            for name, values in run.records._asdict().items()
        }
        records = type(run.records)(**rows)._replace(progress=np.asarray(progress[1:], np.float32))
        return dataclasses.replace(
            run,
            records=records,
            start_progress=float(progress[0]),
            is_closed=is_closed,
            length=length,
            end=float(np.float32(laps * length)),
        )

    return make


def test_laps_end_between_two_steps(make_laps):
    run = make_laps([0.0, 3.0, 6.0, 9.0, 12.0, 15.0, 18.0, 21.0])
    assert num_laps(run) == 2
    # At 10 m, a third of the way from 9 m at 1.5 s to 12 m; at 20 m, two thirds from 3 s on.
    np.testing.assert_allclose(lap_starts(run), [0.0, 1.5 + 0.5 / 3, 3.0 + 1.0 / 3])
    assert lap_times(run) == pytest.approx([5.0 / 3, 5.0 / 3])
    assert all(type(each) is float for each in lap_times(run))


def test_a_lap_that_is_not_completed_has_no_time(make_laps):
    assert lap_times(make_laps([0.0, 5.0, 10.0, 15.0, 19.9])) == pytest.approx([1.0])
    assert lap_times(make_laps([0.0, 5.0, 9.9])) == []
    assert lap_starts(make_laps([0.0, 5.0, 9.9])).tolist() == [0.0]


def test_a_line_is_passed_once(make_laps):
    # Back behind it, and over it again.
    run = make_laps([0.0, 8.0, 12.0, 9.0, 11.0, 16.0, 20.0])
    assert lap_times(run) == pytest.approx([0.75, 2.25])


def test_the_first_lap_is_from_where_the_robot_starts(make_laps):
    assert lap_times(make_laps([-2.0, 4.0, 10.0, 20.0])) == pytest.approx([1.0, 0.5])
    assert lap_times(make_laps([6.0, 10.0, 20.0])) == pytest.approx([0.5, 0.5])


def test_several_lines_within_a_step(make_laps):
    run = make_laps([0.0, 5.0, 30.0], laps=3)
    assert lap_times(run) == pytest.approx([0.6, 0.2, 0.2])


@pytest.mark.parametrize("laps", [1, 3, 7])
def test_a_run_that_is_finished_has_all_its_laps(make_laps, laps):
    # The end is rounded to single precision, where so many lengths may be more.
    for length in np.random.default_rng(0).uniform(5.0, 100.0, 50):
        length = float(np.float32(length))
        run = make_laps([0.0, 1.0, np.float32(laps * length)], laps=laps, length=length)
        assert len(lap_times(run)) == laps
        assert lap_starts(run)[-1] == 1.0


def test_an_open_path_has_no_laps(make_laps, path_start):
    for run in (make_laps([0.0, 5.0, 10.0], laps=1, is_closed=False), path_start):
        assert num_laps(run) == 0
        assert lap_times(run) == []
        assert lap_starts(run).tolist() == [0.0]


def test_speeds_are_those_of_the_state(straight):
    state = straight.records.state.copy()
    state[:, 3] = -1.5
    backwards = straight.records._replace(state=state)
    assert speeds(straight).tolist() == [0.0] + [2.0] * 10
    assert speeds(dataclasses.replace(straight, records=backwards)).tolist() == [0.0] + [1.5] * 10
    # As if the third and fourth component were another one's: (yaw, v) = (0, 2).
    planar = dataclasses.replace(straight, state_names=("x", "y", "vx", "vy", "phi"))
    assert speeds(planar).tolist() == [0.0] + [2.0] * 10


def test_speeds_of_a_state_without_one_are_those_of_the_positions(straight, path_start):
    names = ("x", "y", "yaw", "other", "phi")
    bare = dataclasses.replace(straight, state_names=names)
    np.testing.assert_allclose(speeds(bare), [0.0] + [2.0] * 10)
    assert speeds(dataclasses.replace(path_start, state_names=names)).tolist() == [0.0]
