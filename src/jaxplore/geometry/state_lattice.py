"""Motions of a car between the nodes and headings of a lattice."""

import functools
import itertools
import math
from typing import NamedTuple

NUM_HEADINGS = 16
"""Headings of a state lattice."""
_FIRST = ((1, 0), (2, 1), (1, 1), (1, 2))
"""Vectors (x, y) along the headings of the first quadrant, in whole node spacings."""
TURNS = {1: 40.0, 2: 16.0, 4: 8.0}
"""Turns, in headings, and the largest turning radius at which a motion turns by so much [node
spacings]. Beyond it the motion would be long, and shorter turns follow a circle well enough."""
LARGEST_RADIUS = TURNS[1]
"""Largest turning radius of a lattice [node spacings]."""
RADIUS_STEP = 0.25
"""Step to which a turning radius is rounded up [node spacings]: similar cars share a program."""
SAMPLING = 0.2
"""Distance between the points of a motion whose nodes it passes [node spacings]."""
_TIE = 1e-6


def heading_vectors() -> tuple[tuple[int, int], ...]:
    """Return the vectors (x, y) along the headings of the lattice, in whole node spacings.

    They are not quite even: a car that drives straight on must meet nodes.
    """
    vectors = list(_FIRST)
    for _ in range(3):
        vectors += [(-y, x) for x, y in vectors[-len(_FIRST) :]]
    return tuple(vectors)


HEADINGS = tuple(math.atan2(y, x) % math.tau for x, y in heading_vectors())
"""Headings of the lattice [rad], ascending from 0."""


class Passed(NamedTuple):
    """The state of a lattice that is nearest to a point of a motion.

    `down` and `right` are rows and columns from the start, `heading` is an index.
    """

    down: int
    right: int
    heading: int


class Motion(NamedTuple):
    """A motion forwards from a node to another one.

    Args:
        start: index of the heading at its start.
        end: index of the heading at its end.
        down: rows from start to end, along y.
        right: columns from start to end, along x.
        length: length of its path [node spacings].
        via: the lattice states that it passes in between.
        before: length of the straight piece before its circle; `length` without one [node
            spacings].
        turn: angle by which it turns, counter-clockwise [rad].
    """

    start: int
    end: int
    down: int
    right: int
    length: float
    via: tuple[Passed, ...]
    before: float
    turn: float


def round_radius(turning_radius: float, spacing: float) -> float:
    """Return a turning radius [m] in node spacings, rounded up to a multiple of `RADIUS_STEP`."""
    rounded = RADIUS_STEP * math.ceil(turning_radius / spacing / RADIUS_STEP - 1e-6)
    if not 0.0 < rounded <= LARGEST_RADIUS:
        raise ValueError(
            f"turning_radius is {turning_radius:g} m; accepted: more than 0 and at most "
            f"{LARGEST_RADIUS * spacing:g} m with {spacing:g} m between the nodes of the fields"
        )
    return rounded


@functools.cache
def motions(radius: float) -> tuple[Motion, ...]:
    """Return the motions of a car with a turning radius [node spacings], ordered by first heading.

    From each heading they go straight on to the next node, and turn to either side by each of
    `TURNS`. A turn is the shortest path that is straight, then on the smallest circle, then
    straight again, and ends at a node. All of them are also motions backwards.

    Source: Pivtoraiko, Knepper and Kelly, "Differentially constrained mobile robot motion planning
    in state lattices", Journal of Field Robotics 2009.
    """
    vectors = heading_vectors()
    found = []
    for start, (x, y) in enumerate(vectors):
        found.append(_motion(start, start, y, x, math.hypot(x, y), radius))
        for turn, largest in TURNS.items():
            if radius > largest:
                continue
            for end in ((start + turn) % NUM_HEADINGS, (start - turn) % NUM_HEADINGS):
                found += _turns(start, end, radius)
    return tuple(found)


def _turns(start: int, end: int, radius: float) -> list[Motion]:
    """Return the shortest turns between two headings; several if they are equally long."""
    angle = abs(_difference(HEADINGS[end], HEADINGS[start]))
    tangent = radius * math.tan(0.5 * angle)
    reach = math.ceil(2.0 * tangent + 4.0)
    cos, sin = math.cos(HEADINGS[start]), math.sin(HEADINGS[start])
    other_cos, other_sin = math.cos(HEADINGS[end]), math.sin(HEADINGS[end])
    determinant = cos * other_sin - sin * other_cos
    candidates = []
    for right, down in itertools.product(range(-reach, reach + 1), repeat=2):
        # (right, down) = first * (cos, sin) + second * (other_cos, other_sin)
        first = (right * other_sin - down * other_cos) / determinant
        second = (cos * down - sin * right) / determinant
        if min(first, second) >= tangent - 1e-9:
            length = first + second - 2.0 * tangent + radius * angle
            candidates.append((length, abs(first - second), down, right))
    # Of equally long ones the most even: their reversals are motions as well.
    length, uneven, *_ = min(candidates)
    return [
        _motion(start, end, down, right, each, radius)
        for each, other, down, right in candidates
        if each <= length + 1e-6 and other <= uneven + 1e-6
    ]


def _motion(start: int, end: int, down: int, right: int, length: float, radius: float) -> Motion:
    """Return a motion with the states of the lattice that it passes."""
    turn = _difference(HEADINGS[end], HEADINGS[start])
    cos, sin = math.cos(HEADINGS[start]), math.sin(HEADINGS[start])
    before = length
    if turn != 0.0:
        # The length of the straight piece before the circle.
        other_cos, other_sin = math.cos(HEADINGS[end]), math.sin(HEADINGS[end])
        determinant = cos * other_sin - sin * other_cos
        before = (right * other_sin - down * other_cos) / determinant
        before -= radius * math.tan(0.5 * abs(turn))
    nearest: dict[tuple[int, int, int], None] = {}
    pieces = math.ceil(length / SAMPLING)
    for index in range(pieces + 1):
        at = length * index / pieces
        x, y, heading = at * cos, at * sin, HEADINGS[start]
        if at > before:
            arc = min(at - before, radius * abs(turn))
            heading += math.copysign(arc / radius, turn)
            side = math.copysign(radius, turn)
            x = before * cos + side * (math.sin(heading) - sin)
            y = before * sin - side * (math.cos(heading) - cos)
            rest = at - before - arc
            x, y = x + rest * math.cos(heading), y + rest * math.sin(heading)
        # Half-way between two nodes or headings both count, as they do for the reversed motion.
        here = (
            {round(y - _TIE), round(y + _TIE)},
            {round(x - _TIE), round(x + _TIE)},
            {_nearest_heading(heading - _TIE), _nearest_heading(heading + _TIE)},
        )
        for state in itertools.product(*here):
            nearest[state] = None
    for each in ((0, 0, start), (down, right, end)):
        nearest.pop(each, None)
    via = tuple(Passed(*state) for state in nearest)
    return Motion(start, end, down, right, length, via, before, turn)


def _difference(angle: float, other: float) -> float:
    """Return the difference of two angles in [-pi, pi) [rad]."""
    return (angle - other + math.pi) % math.tau - math.pi


def _nearest_heading(angle: float) -> int:
    return min(range(NUM_HEADINGS), key=lambda index: abs(_difference(angle, HEADINGS[index])))
