"""Chains of transforms, against matrices of SciPy's rotations."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from jaxplore.ros import messages
from jaxplore.ros.transforms import BACK_SECONDS, MOST_FRAMES, MOST_KEPT, Transforms

MANY = settings(max_examples=60, deadline=None)
PART = st.floats(-1.0, 1.0)
PLACE = st.tuples(st.floats(-100, 100), st.floats(-100, 100), st.floats(-2, 2))
TURN = st.tuples(PART, PART, PART, PART).filter(lambda q: np.linalg.norm(q) > 0.1)


def message(parent, child, place=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0, 1.0), time=0.0):
    seconds = math.floor(time)
    stamp = SimpleNamespace(sec=seconds, nanosec=round(1e9 * (time - seconds)))
    x, y, z, w = np.asarray(turn) / np.linalg.norm(turn)
    transform = SimpleNamespace(
        translation=SimpleNamespace(**dict(zip("xyz", place, strict=True))),
        rotation=SimpleNamespace(x=x, y=y, z=z, w=w),
    )
    header = SimpleNamespace(frame_id=parent, stamp=stamp)
    return SimpleNamespace(header=header, child_frame_id=child, transform=transform)


def along(x, time, parent="odom", child="base_link"):
    return message(parent, child, (x, 0.0, 0.0), time=time)


def matrix(place, turn):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_quat(turn).as_matrix(), place
    return found


@MANY
@given(st.lists(st.tuples(PLACE, TURN), min_size=2, max_size=6), st.data())
def test_poses_over_a_common_ancestor_are_products_of_matrices(places, data) -> None:
    """A random tree: frame k hangs on one of those before it."""
    transforms, in_root = Transforms(), {"f0": np.eye(4)}
    for index, (place, turn) in enumerate(places, 1):
        parent = f"f{data.draw(st.integers(0, index - 1))}"
        # Half of the names with the slash of old programs.
        transforms.add(message("/" * (index % 2) + parent, f"f{index}", place, turn, time=1.0))
        in_root[f"f{index}"] = in_root[parent] @ matrix(place, turn)
    first, second = (data.draw(st.sampled_from(sorted(in_root))) for _ in range(2))
    found = transforms.pose(first, second)
    expected = np.linalg.inv(in_root[first]) @ in_root[second]
    np.testing.assert_allclose(found.pose[:2], expected[:2, 3], atol=1e-9)
    axis = expected[:2, 0]
    # Where the x axis points straight up there is no yaw.
    if np.linalg.norm(axis) > 1e-3:
        turned = np.array([math.cos(found.pose[2]), math.sin(found.pose[2])])
        np.testing.assert_allclose(turned, axis / np.linalg.norm(axis), atol=1e-6)


@MANY
@given(PLACE, PLACE, TURN, st.floats(0.0, 1.5), st.floats(0.0, 1.0))
def test_between_two_stamps_a_transform_is_interpolated(start, end, turn, angle, share) -> None:
    """The localisation's stamps are ahead, as AMCL's are, so the odometry tells the time."""
    transforms = Transforms()
    first = Rotation.from_quat(turn)
    second = first * Rotation.from_rotvec([0.0, 0.0, angle])
    # The negative quaternion is the same rotation.
    transforms.add(message("map", "odom", start, first.as_quat(), time=10.0))
    transforms.add(message("map", "odom", end, -second.as_quat(), time=11.0))
    time = 10.0 + round(share, 6)
    transforms.add(along(2.0, time))
    found = transforms.pose("map", "base_link")
    assert found.time == pytest.approx(time, abs=1e-6)
    turned = Slerp([0.0, 1.0], Rotation.concatenate([first, second]))(time - 10.0)
    ahead = turned.apply([2.0, 0.0, 0.0])
    expected = np.array(start) + (time - 10.0) * (np.array(end) - start) + ahead
    # The straight line between two quaternions is not quite Slerp: 1e-2 rad over 1.5 rad.
    np.testing.assert_allclose(found.pose[:2], expected[:2], atol=0.05)


def test_the_time_is_that_up_to_which_all_transforms_are_known() -> None:
    transforms = Transforms()
    transforms.add(message("base_link", "base_scan", (0.2, 0.0, 0.1)), is_static=True)
    transforms.add(along(1.0, 5.0))
    transforms.add(along(9.0, 2.0, "map", "odom"))
    assert transforms.pose("map", "base_scan").time == 2.0
    assert transforms.pose("odom", "base_scan").time == 5.0
    # Back along the chain.
    assert transforms.pose("base_scan", "map").pose[0] == pytest.approx(-10.2)
    assert transforms.pose("base_link", "base_scan").time == 0.0


def test_an_order_that_the_network_changed_does_not_matter_and_a_clock_that_jumps_does() -> None:
    transforms = Transforms()
    for x, time in ((1.0, 10.0), (3.0, 10.4), (2.0, 10.2)):
        transforms.add(along(x, time))
    assert transforms.pose("odom", "base_link").pose[0] == 3.0
    transforms.add(along(7.0, 10.4 - BACK_SECONDS - 0.1))
    found = transforms.pose("odom", "base_link")
    assert (found.time, found.pose[0]) == (pytest.approx(9.3), 7.0)


def test_a_frame_may_get_another_parent_but_no_loop() -> None:
    transforms = Transforms()
    transforms.add(along(1.0, 1.0))
    transforms.add(along(2.0, 2.0, "map", "base_link"))
    assert transforms.pose("odom", "base_link") is None
    assert transforms.pose("map", "base_link").pose[0] == 2.0
    transforms.add(along(2.0, 2.0, "base_link", "map"))
    with pytest.raises(ValueError, match="transforms are map -> base_link -> map; accepted"):
        transforms.pose("map", "odom")


@pytest.mark.parametrize(
    ("given_", "said"),
    [
        (along(math.inf, 1.0), "translation is"),
        (along(math.nan, 1.0), "translation is"),
        (along(1.0, 1.0, "odom", "/odom"), "of 'odom' in itself; accepted: two frames"),
        (along(1.0, 1.0, "", "odom"), "names of 0 and 4 letters"),
        (along(1.0, 1.0, "o" * 1000, "odom"), "names of 1000 and 4 letters"),
        (along(1.0, -1.0), "stamp is -1 s"),
    ],
)
def test_transforms_that_are_none_are_refused(given_, said) -> None:
    with pytest.raises(ValueError, match=said):
        Transforms().add(given_)


def test_a_flood_of_frames_or_stamps_is_bounded() -> None:
    transforms = Transforms()
    for index in range(MOST_FRAMES):
        transforms.add(along(1.0, 1.0, "odom", f"f{index}"))
    with pytest.raises(ValueError, match="another frame, 'base_link'; accepted: at most"):
        transforms.add(along(1.0, 1.0))
    assert len(transforms.gap("map", "f0")) < 300
    for index in range(MOST_KEPT + 10):
        transforms.add(along(1.0, 1.0 + 1e-4 * index, "odom", "f0"))
    assert len(transforms._edges["f0"].times) == MOST_KEPT


def test_a_transform_that_was_filled_is_read_again() -> None:
    given_, transforms = along(0.0, 0.0), Transforms()
    messages.fill_transform(given_, 2.5, "map", "odom", (1.0, -2.0, 0.7))
    transforms.add(given_)
    found = transforms.pose("map", "odom")
    assert (found.time, found.frame) == (2.5, "map")
    np.testing.assert_allclose(found.pose, [1.0, -2.0, 0.7])
