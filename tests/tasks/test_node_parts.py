"""Which capabilities the modes of a node take."""

import pytest

from jaxplore.tasks.exploration.pilot import make_node_settings

AREA = {"areas": [[[2.0, 2.0], [4.0, 2.0], [4.0, 4.0]]]}


@pytest.mark.parametrize(
    ("mode", "entries"),
    [
        ("goal", {"keep_out": AREA}),
        ("goal", {"battery": {}}),
        ("follow", {"battery": {}}),
    ],
)
def test_a_capability_that_the_mode_would_not_use_is_refused(mode, entries) -> None:
    (name,) = entries
    match = rf"setting {name} is given with node.mode {mode}; accepted: without it, or node.mode"
    with pytest.raises(ValueError, match=match):
        make_node_settings({**entries, "node": {"mode": mode}})


@pytest.mark.parametrize(
    ("mode", "entries"),
    [("control", {"keep_out": AREA, "battery": {}}), ("follow", {"keep_out": AREA})],
)
def test_the_other_capabilities_are_taken(mode, entries) -> None:
    settings, node = make_node_settings({**entries, "node": {"mode": mode}})
    assert node.mode == mode
    assert all(getattr(settings, name) is not None for name in entries)


def test_what_no_topic_tells_is_not_read() -> None:
    detector = {"classes": ["box", "door"], "confusion": [[0.9, 0.1], [0.1, 0.9]]}
    settings, _ = make_node_settings({"detector": detector, "watch": {}})
    assert settings.detector is None
    assert settings.watch is not None


def test_a_fleet_is_refused_for_one_node() -> None:
    with pytest.raises(ValueError, match=r"setting fleet.robots is 3; accepted: no section fleet"):
        make_node_settings({"fleet": {"robots": 3}})
