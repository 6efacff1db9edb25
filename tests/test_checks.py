import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import DifferentialDrive, Dynamics, _checks, _kinds


@pytest.mark.parametrize("value", [0, -3, 1.5, "2", None, True, math.nan])
def test_positive_int_refuses(value: object) -> None:
    with pytest.raises(ValueError, match=r"n is .*; accepted: a whole number >= 1"):
        _checks.positive_int("n", value)


def test_positive_int_takes_numpy() -> None:
    assert _checks.positive_int("n", np.int64(4)) == 4


@pytest.mark.parametrize(
    "value", ["a", None, math.inf, 1e300, math.nan, True, [1.0], 0.0, 1.0, 10**400]
)
def test_number_refuses(value: object) -> None:
    with pytest.raises(ValueError, match=r"x is .*; accepted: a finite number > 0.0 and < 1.0"):
        _checks.number("x", value, above=0.0, below=1.0)


def test_closed_bounds_are_accepted() -> None:
    assert _checks.number("x", 2, at_least=2.0, at_most=2.0) == 2.0
    with pytest.raises(ValueError, match=r"accepted: a finite number >= 2.0 and <= 2.0"):
        _checks.number("x", 2.1, at_least=2.0, at_most=2.0)


def test_scalar_is_a_float32_leaf_and_passes_traced_values() -> None:
    assert _checks.scalar("x", 3).dtype == jnp.float32
    assert _checks.scalar("x", np.float64(3.0)).shape == ()
    with pytest.raises(ValueError, match=r"x has shape \(2,\); accepted: one number"):
        _checks.scalar("x", np.zeros(2))
    # Nothing raises in a trace: the value is not known there.
    assert float(jax.jit(lambda x: _checks.scalar("x", x, above=0.0))(-1.0)) == -1.0


@pytest.mark.parametrize(
    "value", [(1.0, 2.0), (1.0, 2.0, math.nan), (1.0, 2.0, 1e300), "abc", None, ((1.0,), 2.0)]
)
def test_vector_refuses(value: object) -> None:
    with pytest.raises(ValueError, match=r"v is .*; accepted: 3 finite numbers"):
        _checks.vector("v", value, 3)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "None"),
        ("x" * 99, "'" + "x" * 59 + "..."),
        (dict, "the class dict"),
        (len, "the function len"),
        ([1.0], "a list"),
        (np.zeros((2, 3)), "an array of shape (2, 3)"),
        (jnp.zeros(2), "an array of shape (2,)"),
        (OSError(), "an OSError"),
    ],
)
def test_a_wrong_value_is_described_in_a_few_words(value: object, words: str) -> None:
    assert _kinds.describe(value) == words


def test_instance_refuses() -> None:
    _kinds.instance("x", 3, int)
    _kinds.instance("x", None, int, may_be_none=True)
    with pytest.raises(ValueError, match=r"^x is None; accepted: an int or a str, of letters$"):
        _kinds.instance("x", None, int, str, hint="of letters")
    with pytest.raises(ValueError, match=r"^x is 'a'; accepted: an int or None$"):
        _kinds.instance("x", "a", int, may_be_none=True)
    with pytest.raises(ValueError, match=r"^x is the class bool; accepted: an instance, such as"):
        _kinds.instance("x", bool, int)
    with pytest.raises(ValueError, match=r"^x\[1\] is 'a'; accepted: an int$"):
        _kinds.instances("x", [1, "a"], int)
    with pytest.raises(ValueError, match=r"^x is 3; accepted: a list or tuple of int$"):
        _kinds.instances("x", 3, int)


@pytest.mark.parametrize("value", ["1", ["1", "2"], [[1.0], 2.0], 1j, np.datetime64("2026-01-01")])
def test_texts_and_dates_are_no_numbers(value: object) -> None:
    with pytest.raises(ValueError, match=r"^x is .*; accepted: numbers$"):
        _checks.floats("x", value, "numbers")


@pytest.mark.parametrize("value", [1, 0, None, "yes", jnp.array(True)])
def test_flag_refuses(value: object) -> None:
    assert _kinds.flag("is_on", np.True_) is True
    with pytest.raises(ValueError, match=r"^is_on is .*; accepted: True or False$"):
        _kinds.flag("is_on", value)


def test_a_key_may_be_raw_or_traced() -> None:
    _kinds.key("key", jax.random.key(0))
    _kinds.key("key", jax.random.PRNGKey(0))
    _kinds.key("keys", jax.random.split(jax.random.key(0)), ndim=1)
    jax.jit(lambda key: _kinds.key("key", key))(jnp.zeros(3))
    with pytest.raises(ValueError, match=r"^keys is an array of shape \(\); accepted: several"):
        _kinds.key("keys", jax.random.key(0), ndim=1)


def test_a_number_of_another_unit_is_warned_of() -> None:
    _checks.warn_above("yaw", -6.0, math.tau, "it is in radians")
    with pytest.warns(UserWarning, match=r"^yaw is -90; it is in radians$"):
        _checks.warn_above("yaw", -90.0, math.tau, "it is in radians")
    jax.jit(lambda yaw: _checks.warn_above("yaw", yaw, 1.0, "it is in radians"))(90.0)


class Late:
    pass


@_kinds.check_arguments
def of_kinds(
    one: Dynamics | str,
    many: Sequence[Dynamics] = (),
    *,
    later: "Late | None" = None,
    number: float | None = None,
    numbers: Sequence[float] | None = None,
    anything: object = 1,
) -> str:
    return f"{one} {number}"


def test_arguments_are_checked_by_annotations() -> None:
    robot = DifferentialDrive()
    assert of_kinds("a", [robot], later=Late(), number=2.0, numbers=np.ones(3)) == "a 2.0"
    for given, words in (
        ({"one": 3}, "one is 3; accepted: a Dynamics or a str"),
        ({"one": "a", "many": robot}, "many is a DifferentialDrive; accepted: a list or tuple of"),
        ({"one": "a", "many": [robot, 3]}, r"many\[1\] is 3; accepted: a Dynamics"),
        ({"one": "a", "later": Late}, r"later is the class Late; accepted: an instance"),
        ({"one": "a", "later": 2}, "later is 2; accepted: a Late or None"),
    ):
        with pytest.raises(ValueError, match=words):
            of_kinds(**given)
    with pytest.raises(ValueError, match="many is 3"):
        of_kinds("a", 3)


def test_a_shape_is_accepted_as_it_is_and_lists_become_arrays() -> None:
    given = np.zeros(3)
    assert _checks.pose("pose", given) is given
    assert _checks.of_shape("dt", 0.1, ()) == 0.1
    made = _checks.of_shape("points", [(0, 1), [2.5, 3]], ("N", 2))
    assert made.dtype == jnp.float32
    np.testing.assert_array_equal(made, [[0.0, 1.0], [2.5, 3.0]])
    mixed = jax.jit(lambda x: _checks.position("position", [x, 2.0]))(jnp.float32(1.0))
    np.testing.assert_array_equal(mixed, [1.0, 2.0])


@pytest.mark.parametrize(
    "value", [np.zeros(2), [1.0, 2.0], [[1.0], 2.0, 3.0], "abc", ["a", "b", "c"], None, 1.0]
)
def test_another_shape_is_refused_by_name(value) -> None:
    with pytest.raises(ValueError, match=r"pose is .*; accepted: 3 numbers: x, y, yaw"):
        _checks.pose("pose", value)


def test_a_check_of_a_shape_leaves_no_trace_in_a_program() -> None:
    robot = DifferentialDrive()
    state, control, dt = jnp.zeros(5), jnp.zeros(2), jnp.array(0.1)
    checked = jax.make_jaxpr(robot.step)(state, control, dt)
    rate = robot.derivative_under

    def unchecked(state, control, dt):
        return robot.project(robot.integrator(rate(control), state, control, dt))

    assert str(checked) == str(jax.make_jaxpr(unchecked)(state, control, dt))
