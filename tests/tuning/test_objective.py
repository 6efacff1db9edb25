import dataclasses
import math

import jax.numpy as jnp
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.control.risk import ConditionalValueAtRisk
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.following.metrics import PathMetrics
from jaxplore.study.tuning import Objective
from jaxplore.study.tuning.objective import flat, is_late, list_metrics, with_late_times
from jaxplore.tasks.registry import build, make_settings


def test_a_sum_is_read_and_written() -> None:
    objective = Objective.parse("time_to.90 + 100*collisions - 0.5 * coverage")
    assert objective.terms == ((1.0, "time_to.90"), (100.0, "collisions"), (-0.5, "coverage"))
    assert str(objective) == "time_to.90 + 100*collisions - 0.5*coverage"
    metrics = {"time_to.90": 30.0, "collisions": 2.0, "coverage": 0.8}
    assert objective.value(metrics) == 30.0 + 200.0 - 0.4
    assert objective.mean([metrics, {**metrics, "collisions": 0.0}]) == pytest.approx(129.6)
    assert math.isnan(objective.value({**metrics, "collisions": None}))


@given(
    st.lists(
        st.tuples(
            st.floats(-1e3, 1e3).filter(lambda x: abs(x) > 1e-3),
            st.sampled_from(["a", "b.c", "d_1"]),
        ),
        min_size=1,
        max_size=5,
    )
)
def test_what_is_written_is_read_again(terms) -> None:
    rounded = tuple((float(f"{weight:g}"), name) for weight, name in terms)
    assert Objective.parse(str(Objective(rounded))).terms == rounded


@pytest.mark.parametrize("text", ["", "a b", "a +", "3*", "a * 3", "+", "a++b", "a/b", "a-", "a."])
def test_what_is_no_sum_is_refused(text) -> None:
    with pytest.raises(ValueError, match=r"objective"):
        Objective.parse(text)


def test_a_sign_needs_no_space_on_either_side() -> None:
    assert Objective.parse("a- b+c.90").terms == ((1.0, "a"), (-1.0, "b"), (1.0, "c.90"))


def test_unknown_metrics_are_named_with_near_ones() -> None:
    with pytest.raises(ValueError, match=r"metric colisions is not known; .*collisions"):
        Objective.parse("colisions").value({"collisions": 1.0, "coverage": 0.5})
    known = list_metrics(ExplorationMetrics)
    Objective.parse("time_to.90 + members.explorer.share + compute.step_ms_p50").check(known)
    watched = list_metrics(ExplorationMetrics, ("watch",))
    Objective.parse("watch.mean_idleness").check(watched)
    with pytest.raises(ValueError, match=r"metric watch.mean_idleness is not known"):
        Objective.parse("watch.mean_idleness").check(known)
    with pytest.raises(ValueError, match=r"metric time_to.91 is not known; .*time_to.90"):
        Objective.parse("time_to.91").check(known)
    with pytest.raises(ValueError, match=r"metric coverage is not known"):
        Objective.parse("coverage").check(list_metrics(PathMetrics))


@pytest.mark.parametrize("report", [ExplorationMetrics, PathMetrics])
def test_every_number_of_a_report_is_known(report) -> None:
    known = list_metrics(report)
    fields = {each.name for each in dataclasses.fields(report)}
    assert {name.split(".")[0] for name in known} <= fields
    left_out = fields - {name.split(".")[0] for name in known}
    assert left_out <= {"versions", "seed", "coverage_curve", "curves", "lap_times", "parts"}


def test_numbers_are_flattened() -> None:
    nested = {"a": 1, "b": {"x": None, "y": True}, "c": [1], "d": "text", "e": math.inf}
    assert flat(nested) == {"a": 1.0, "b.x": None, "b.y": 1.0, "e": None}


def explored(coverage: float, **others) -> dict:
    return {
        "coverage": coverage,
        "target_coverage": 0.99,
        "time_to.90": None,
        "finished_at": None,
        **others,
    }


@pytest.mark.parametrize("target", [0.99, None])
@given(st.floats(0.0, 0.89), st.floats(0.0, 0.89))
def test_who_gets_further_in_time_is_less_late(target, one, other) -> None:
    first, second = (
        with_late_times(explored(each, target_coverage=target), 100.0) for each in (one, other)
    )
    for name in ("time_to.90", "finished_at"):
        assert first[name] > 100.0
        assert (first[name] < second[name]) == (
            (100.0 * (1.0 + 0.9 - one)) < (100.0 * (1.0 + 0.9 - other))
        ) or first[name] == pytest.approx(second[name])


def test_late_times_are_those_of_the_mission() -> None:
    assert with_late_times(explored(0.4), 100.0)["time_to.90"] == pytest.approx(150.0)
    number, seen, last = "targets.number", "targets.seen", "targets.last_at"
    none = explored(0.4, **{number: 0.0, last: None})
    assert with_late_times(none, 100.0)[last] is None
    sought = explored(0.4, **{number: 4.0, seen: 3.0, last: None})
    assert with_late_times(sought, 100.0)[last] == pytest.approx(125.0)
    path = {"finished_at": None, "to_go": 30.0, "progress": 10.0}
    assert with_late_times(path, 40.0)["finished_at"] == pytest.approx(70.0)
    assert with_late_times(path, 40.0)["late.finished_at"] == 1.0
    assert is_late(["progress", "finished_at"], with_late_times(path, 40.0))
    assert not is_late(["progress"], with_late_times(path, 40.0))
    reached = {"time_to.90": 12.0, "finished_at": 20.0, "coverage": 0.99}
    assert with_late_times(reached, 100.0) == reached
    near, far = (
        with_late_times(explored(0.5, goal_distance=d, path_length=5.0, final_unknown=0.5), 100.0)[
            "finished_at"
        ]
        for d in (1.0, 4.0)
    )
    assert 100.0 < near < far < 200.0


@given(
    st.lists(st.floats(-100, 100), min_size=1, max_size=12),
    st.floats(0.0, 0.99),
)
def test_the_tail_is_the_least_of_rockafellar_and_uryasev(values, level) -> None:
    objective = Objective(((1.0, "a"),), level=level)
    found = objective.mean([{"a": each} for each in values])
    # The minimum over z of z + mean (v - z)_+ / (1 - level) is at one of the values.
    least = min(
        z + math.fsum(max(v - z, 0.0) for v in values) / len(values) / (1.0 - level) for z in values
    )
    assert found == pytest.approx(least, abs=1e-6)
    # The planner's measure of risk, in single precision, tolerates a rank that is nearly whole.
    totals = jnp.asarray(values, jnp.float32)[:, None]
    of_planner = ConditionalValueAtRisk(level).costs(totals, jnp.zeros(1))
    assert float(of_planner[0]) == pytest.approx(found, abs=0.05)


def test_a_tail_is_read_and_written() -> None:
    objective = Objective.parse(" cvar( 0.8, finished_at + 10*collisions ) ")
    assert objective == Objective(((1.0, "finished_at"), (10.0, "collisions")), level=0.8)
    assert str(objective) == "cvar(0.8, finished_at + 10*collisions)"
    assert Objective.parse(str(objective)) == objective
    assert Objective.parse("cvar(0, a)") == Objective.parse("a")
    # An episode that failed counts as infinite: it is in the tail, or left out.
    assert objective.mean_of([1.0, 2.0, 3.0, 4.0, math.inf]) == math.inf
    assert Objective.parse("cvar(0.5, a)").mean_of([1.0, 5.0]) == 5.0
    assert math.isnan(objective.mean([]))


@pytest.mark.parametrize("text", ["cvar(1, a)", "cvar(-0.1, a)", "cvar(x, a)", "cvar(nan, a)"])
def test_a_level_that_is_no_share_is_refused(text) -> None:
    with pytest.raises(ValueError, match=r"^level of objective .*; accepted: a number in \[0, 1\)"):
        Objective.parse(text)
    with pytest.raises(ValueError, match=r"^objective is .*cvar\(0.8, finished_at\)"):
        Objective.parse("cvar(0.8 a)")
    with pytest.raises(ValueError, match=r"^level of an objective is 1.0; accepted"):
        Objective(((1.0, "a"),), level=1.0)


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ({}, "finished_at + 100*collisions"),
        # It had the idleness of a map that the robot does not keep.
        ({"target": "never"}, "finished_at + 100*collisions"),
        ({"watch": {}}, "watch.mean_idleness + 100*collisions"),
        ({"watch": {}, "target_coverage": 0.9}, "finished_at + 100*collisions"),
    ],
)
def test_the_default_objective_is_a_metric_that_the_run_has(entries, expected) -> None:
    office = {"width": 8.0, "height": 7.0}
    made = build(make_settings({"map": "office", "office": office, **entries}))
    assert made.scenario.objective == expected
