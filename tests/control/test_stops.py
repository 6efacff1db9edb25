"""The rule by which a robot is stopped, against one that keeps times instead of durations."""

import math

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore.control.plausibility import JUMP_SECONDS, MAX_MISFIT, RETRY_SECONDS
from jaxplore.control.stops import (
    BLIND,
    FROZEN,
    GOOD,
    JUMPED,
    LOST,
    MISFIT,
    REASONS,
    REPEATED,
    Evidence,
    StopState,
    next_stop,
)

LIMIT = np.float32(0.25)
FLAGS = [name for name in Evidence._fields if name.startswith("is_")]
step = jax.jit(next_stop)


def period(elapsed: float = 0.0625, misfit: float = 0.0, **flags: bool) -> Evidence:
    """Return the evidence of a period, in which nothing is wrong but what is given."""
    given = {name: np.bool_(flags.get(name, name == "is_driven")) for name in FLAGS}
    return Evidence(elapsed=np.float32(elapsed), misfit=np.float32(misfit), **given)


def stops_of(periods: list[Evidence]) -> list[int]:
    state, codes = StopState.initial(), []
    for each in periods:
        state = step(state, each, LIMIT)
        codes.append(int(state.code))
    return codes


def stops_by_times(periods: list[Evidence]) -> list[int]:
    """The rule in words, with the times at which things began."""
    now, code, began, jumped_at = 0.0, GOOD, 0.0, -math.inf
    same_from, repeated_from, codes = None, None, []
    for each in periods:
        before, now = now, now + float(each.elapsed)
        # What has been the same since the period before began then.
        same_from = (before if same_from is None else same_from) if each.is_same else None
        same_from = same_from if each.is_driven else None
        repeated_from = before if repeated_from is None else repeated_from
        repeated_from = repeated_from if each.is_scan_same and each.is_driven else None
        jumped_at = now if each.is_jump else jumped_at
        fits = each.misfit <= MAX_MISFIT
        is_frozen = same_from is not None and now - same_from > LIMIT
        # A robot that stands tries again after a while, where its scan fits.
        tries = now - began >= RETRY_SECONDS and fits
        is_repeat = repeated_from is not None and now - repeated_from > LIMIT and each.is_repeat
        wrong = {
            LOST: each.is_lost,
            FROZEN: is_frozen or (code == FROZEN and each.is_same and not tries),
            JUMPED: now - jumped_at < JUMP_SECONDS,
            BLIND: each.is_blind,
            REPEATED: is_repeat or (code == REPEATED and each.is_scan_same),
            MISFIT: not fits,
        }
        found = next((reason for reason, is_so in wrong.items() if is_so), GOOD)
        if found != code or (found == JUMPED and each.is_jump):
            code, began = found, now
        codes.append(code)
    return codes


@settings(max_examples=200)
@given(st.data())
def test_it_is_the_rule_with_times(data: st.DataObject) -> None:
    # Sums of such durations are exact. Few things are wrong in a drive, and they last.
    often = data.draw(st.sets(st.sampled_from(FLAGS), max_size=3), label="often")
    share = {name: 0.9 if name in often or name == "is_driven" else 0.05 for name in FLAGS}
    misfits = data.draw(st.sampled_from([0.05, 0.9]), label="misfits")
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1), label="seed"))
    periods = [
        period(
            elapsed=rng.integers(0, 20) / 64.0,
            misfit=rng.choice([0.75, 0.5], p=[misfits, 1.0 - misfits]),
            **{name: rng.random() < share[name] for name in FLAGS},
        )
        for _ in range(80)
    ]
    assert stops_of(periods) == stops_by_times(periods)


@pytest.mark.parametrize(
    ("flags", "code", "after"),
    [
        ({"is_lost": True}, LOST, 1),
        ({"is_same": True}, FROZEN, 5),
        ({"is_jump": True}, JUMPED, 1),
        ({"is_blind": True}, BLIND, 1),
        ({"is_scan_same": True, "is_repeat": True}, REPEATED, 5),
        ({"misfit": 0.75}, MISFIT, 1),
        # A robot that is not told to move may measure the same again and again.
        ({"is_same": True, "is_driven": False}, GOOD, 99),
        ({"is_scan_same": True}, GOOD, 99),
        ({"misfit": 0.5}, GOOD, 99),
    ],
)
def test_each_reason_begins_when_it_should(flags: dict, code: int, after: int) -> None:
    codes = stops_of([period(**flags)] * 12)
    assert codes == [GOOD] * min(after - 1, 12) + [code] * max(12 - after + 1, 0)
    assert (REASONS[code] == "") == (code == GOOD)


def test_a_jump_counts_for_a_second_also_where_the_pose_is_lost_meanwhile() -> None:
    codes = stops_of([period(is_jump=True), *[period(is_lost=True)] * 4, *[period()] * 14])
    assert codes == [JUMPED, *[LOST] * 4, *[JUMPED] * 11, *[GOOD] * 3]
