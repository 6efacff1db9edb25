import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.study.tuning import Parameter, Space
from jaxplore.study.tuning.space import distribution, parse_parameter

PLACES = st.floats(0.0, 1.0)


@st.composite
def parameters(draw) -> Parameter:
    kind = draw(st.sampled_from(["number", "log", "whole", "choices"]))
    if kind == "choices":
        choices = draw(st.lists(st.integers(-5, 5), min_size=2, max_size=6, unique=True))
        return Parameter("x", choices=tuple(choices))
    if kind == "whole":
        is_log = draw(st.booleans())
        low = draw(st.floats(0.01, 50.0) if is_log else st.floats(-50.0, 50.0))
        return Parameter("x", low, low + draw(st.floats(1.0, 60.0)), is_log=is_log, is_whole=True)
    low = draw(st.floats(1e-4, 1e3))
    return Parameter("x", low, low * draw(st.floats(1.01, 1e4)), is_log=kind == "log")


@given(parameters(), PLACES)
def test_places_and_values_are_each_others_inverse(parameter, place) -> None:
    value = parameter.value(place)
    if parameter.choices is not None:
        assert value in parameter.choices
    else:
        assert parameter.low <= value <= parameter.high
    again = parameter.value(parameter.place(value))
    if parameter.choices is not None or parameter.is_whole:
        assert again == value
    else:
        assert again == pytest.approx(value, rel=1e-9)
        assert parameter.place(value) == pytest.approx(place, abs=1e-6)
    # As Optuna understands the same bounds.
    assert distribution(parameter)._contains(distribution(parameter).to_internal_repr(value))


def test_ends_and_middles_are_known() -> None:
    straight = Parameter("x", 1.0, 100.0)
    curved = Parameter("x", 1.0, 100.0, is_log=True)
    assert [straight.value(each) for each in (0.0, 0.5, 1.0)] == [1.0, 50.5, 100.0]
    assert [curved.value(each) for each in (0.0, 0.5, 1.0)] == pytest.approx([1.0, 10.0, 100.0])
    assert straight.value(-3.0) == 1.0
    assert straight.value(3.0) == 100.0


def test_whole_numbers_and_choices_have_equal_parts() -> None:
    places = (np.arange(3000) + 0.5) / 3000
    for parameter in (
        Parameter("x", 2, 4, is_whole=True),
        Parameter("x", choices=("a", "b", "c")),
    ):
        _, counts = np.unique([str(parameter.value(each)) for each in places], return_counts=True)
        assert counts.tolist() == [1000, 1000, 1000]


@pytest.mark.parametrize(
    ("text", "start", "expected"),
    [
        ("a.b=1:10", 2.0, Parameter("a.b", 1.0, 10.0)),
        ("a=1e-3:1:log", 0.1, Parameter("a", 1e-3, 1.0, is_log=True)),
        ("a=-1:2.5", 0.1, Parameter("a", -1.0, 2.5)),
        ("n=2:8", 4, Parameter("n", 2, 8, is_whole=True)),
        ("n=10,20,30", 10, Parameter("n", choices=(10, 20, 30))),
        ("s=one,two", "one", Parameter("s", choices=("one", "two"))),
        ("a", 0.3, Parameter("a", 0.03, 3.0, is_log=True)),
        ("n", 40, Parameter("n", 4, 400, is_log=True, is_whole=True)),
    ],
)
def test_texts(text, start, expected) -> None:
    found = parse_parameter(text, start)
    assert found.name == expected.name
    assert (found.is_log, found.is_whole, found.choices) == (
        expected.is_log,
        expected.is_whole,
        expected.choices,
    )
    if expected.low is not None:
        assert (found.low, found.high) == pytest.approx((expected.low, expected.high))


@pytest.mark.parametrize(
    ("text", "start", "message"),
    [
        ("a=3:1", 1.0, r"bounds of a are 3 and 1; accepted: finite ones, the lower first"),
        ("a=0.2:0.8", 1, r"bounds of a are 0.2 and 0.8; accepted: some with a whole number"),
        ("a=0:1:log", 1.0, r"lower bound of a is 0 on a logarithmic scale; accepted: .* > 0"),
        ("a=1", 1.0, r"--tune is 'a=1'; accepted: NAME=LOW:HIGH"),
        ("a=1,1", 1, r"choices of a are \[1, 1\]; accepted: different"),
        ("a", -1.0, r"a is -1.0 now and has no bounds; accepted: a=LOW:HIGH"),
        ("a", "word", r"a is 'word' now and has no bounds"),
        ("a=1:nan", 1.0, r"--tune is 'a=1:nan'"),
        ("a=[1,2", 1.0, r"--tune is 'a=\[1,2'; accepted: numbers or words"),
    ],
)
def test_bad_texts_are_named(text, start, message) -> None:
    with pytest.raises(ValueError, match=message):
        parse_parameter(text, start)


def test_a_space_has_each_name_once() -> None:
    one = Parameter("a", 0.0, 1.0)
    with pytest.raises(ValueError, match=r"parameters are \['a', 'a'\]; accepted: different names"):
        Space((one, one))
    with pytest.raises(ValueError, match=r"parameters are \[\]; accepted: .* at least one"):
        Space(())
    space = Space((one, Parameter("b", 1.0, math.e, is_log=True)))
    assert space.candidate([0.25, 1.0]) == {"a": 0.25, "b": pytest.approx(math.e)}
    np.testing.assert_allclose(space.places({"a": 0.25, "b": 1.0}), [0.25, 0.0], atol=1e-12)
