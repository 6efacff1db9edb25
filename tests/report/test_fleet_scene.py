"""The scene of a fleet in the browser: each robot where it is, its way, and who hears whom."""

import dataclasses
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from jaxplore.parts.battery.report import BatteryReport
from jaxplore.report.exploration.team import robot_colour
from jaxplore.tasks.exploration.scene import ExplorationScene


class Nodes:
    """A server that remembers what was drawn, by name; a node has the arguments as attributes."""

    def __init__(self) -> None:
        self.drawn: dict[str, SimpleNamespace] = {}
        self.initial_camera = SimpleNamespace()
        self.scene = self

    def _add(self, name: str, **given: object) -> SimpleNamespace:
        node = SimpleNamespace(**given, remove=lambda: self.drawn.pop(name))
        self.drawn[name] = node
        return node

    def add_line_segments(self, name, points, colors, **given):
        return self._add(name, points=points, colors=colors, **given)

    def add_mesh_simple(self, name, vertices, faces, **given):
        return self._add(name, vertices=vertices, faces=faces, **given)

    def add_image(self, name, image, *size, **given):
        return self._add(name, image=image, size=size, **given)


@pytest.fixture
def drawn(fleet_run):
    server = Nodes()
    scene = ExplorationScene(server, fleet_run)
    for frame in fleet_run.frames:
        scene.draw(frame, fleet_run.positions[: frame.step + 1])
    return server, scene


def test_each_robot_is_where_it_is_in_its_colour(fleet_run, drawn) -> None:
    server, _ = drawn
    last = fleet_run.frames[-1]
    for number, place in enumerate(fleet_run.places(last)):
        body = server.drawn[f"/robots/{number}"]
        np.testing.assert_allclose(body.vertices[:, :2].mean(axis=0), place, atol=1e-5)
        away = np.hypot(*(body.vertices[:, :2] - place).T)
        np.testing.assert_allclose(away, fleet_run.radii[number], atol=1e-5)
        assert tuple(body.color) == robot_colour(number)
        way = server.drawn[f"/trail/{number}"].points
        np.testing.assert_allclose(way[0, 0, :2], fleet_run.trails[number, 0], atol=1e-5)
        np.testing.assert_allclose(way[-1, 1, :2], fleet_run.trails[number, last.step], atol=1e-5)
    nose = server.drawn["/robots/0/nose"].points[0, :, :2]
    turn = np.arctan2(*(nose[1] - nose[0])[::-1])
    assert np.cos(turn - last.headings[0]) == pytest.approx(1.0, abs=1e-4)


def test_a_line_joins_robots_that_hear_each_other(fleet_run, drawn) -> None:
    server, scene = drawn
    deaf, heard = (
        dataclasses.replace(fleet_run.frames[-1], parts={"team": {"links": links}})
        for links in (np.eye(2, dtype=bool), np.ones((2, 2), bool))
    )
    scene.draw(heard, fleet_run.positions)
    ends = server.drawn["/links"].points[0, :, :2]
    np.testing.assert_allclose(ends, fleet_run.places(heard), atol=1e-5)
    scene.draw(deaf, fleet_run.positions)
    assert (server.drawn["/links"].points[0, :, 2] < -100.0).all()


def test_a_run_that_goes_on_has_the_ways_of_its_frames(fleet_run) -> None:
    records = jax.tree.map(lambda rows: rows[:0], fleet_run.records)
    blank = dataclasses.replace(fleet_run, records=records)
    server = Nodes()
    scene = ExplorationScene(server, blank)
    for frame in fleet_run.frames:
        scene.draw(frame, fleet_run.positions[:1])
    way = server.drawn["/trail/1"].points
    places = np.stack([fleet_run.places(frame)[1] for frame in fleet_run.frames])
    np.testing.assert_allclose(way[:, 0, :2], places[:-1], atol=1e-5)
    np.testing.assert_allclose(way[:, 1, :2], places[1:], atol=1e-5)
    # An earlier frame has the way so far.
    scene.draw(fleet_run.frames[1], fleet_run.positions[:1])
    assert len(server.drawn["/trail/1"].points) == 1
    scene.clear()
    assert server.drawn == {}


def test_docks_and_the_goal_are_shown(fleet_run) -> None:
    docks = BatteryReport(np.array([[0.5, 0.5], [1.5, 0.5]]), 26.0, 0.2, 1.0)
    server = Nodes()
    goal = np.array([1.0, 1.2])
    ExplorationScene(
        server,
        dataclasses.replace(fleet_run, parts={**fleet_run.parts, "battery": docks}, goal=goal),
    ).draw(fleet_run.frames[0], fleet_run.positions[:1])
    shown = server.drawn["/targets/goal"].vertices[:, :2].mean(axis=0)
    np.testing.assert_allclose(shown, goal, atol=1e-5)
    np.testing.assert_allclose(
        server.drawn["/targets/marks/1"].vertices[:, :2].mean(axis=0), docks.docks[1], atol=1e-5
    )
