"""What a view draws of runs: shapes, the ground, trails and curves, and finished runs."""

import dataclasses
import socket
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import scipy.ndimage
import scipy.spatial
import shapely
from PIL import Image

from jaxplore.report.drawing.colours import FREE, OCCUPIED, UNKNOWN
from jaxplore.report.drawing.palette import HEAT, MAX_HEAT
from jaxplore.report.drawing.rollout_costs import cost_colours
from jaxplore.report.following.data import speeds
from jaxplore.scenes.scene import linear_light
from jaxplore.scenes.shapes import grow_outlines, prisms, segments, strip, turn
from jaxplore.scenes.textures import Ground
from jaxplore.view.display import weight_colours
from jaxplore.view.history import History, Thinned, plain
from jaxplore.view.replay import Replay


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_rounded_outlines_are_those_of_grown_polygons() -> None:
    corners = np.array([[[0.0, 0.0], [1.0, 0.2], [0.4, 0.9]], [[2.0, 1.0], [2.0, 1.0], [2.0, 1.0]]])
    radii = np.array([0.1, 0.3])
    for outline, polygon, radius in zip(grow_outlines(corners, radii), corners, radii, strict=True):
        exact = shapely.MultiPoint(polygon).convex_hull.buffer(radius, quad_segs=200)
        drawn = shapely.Polygon(outline)
        # The outline has corners on the edge of the exact shape, and nothing beyond it.
        assert drawn.is_valid
        assert exact.buffer(1e-4).contains(drawn)
        assert drawn.area > 0.97 * exact.area


def test_prisms_are_closed_but_for_their_floors() -> None:
    outlines = grow_outlines(rng().normal(size=(3, 4, 2)), np.full(3, 0.2))
    vertices, faces = prisms(outlines, 0.5, 1.5)
    volumes = np.einsum(
        "fi,fi->f", vertices[faces[:, 0]], np.cross(vertices[faces[:, 1]], vertices[faces[:, 2]])
    ).reshape(3, -1).sum(axis=1) / 6.0  # fmt: skip
    for outline, volume in zip(outlines, volumes, strict=True):
        area = shapely.Polygon(outline).area
        # What is missing of the integral is that of the floor, a third of its height and area.
        assert volume + 0.5 * -area / 3.0 == pytest.approx(area * 1.0, rel=1e-5)


def test_shapes_that_are_nowhere_are_deep_below_the_ground() -> None:
    corners = np.array([[[0.0, 0.0]], [[np.nan, np.nan]]])
    vertices, _ = prisms(grow_outlines(corners, np.array([1.0, 1.0])), 0.0, 1.0)
    assert np.isfinite(vertices).all()
    assert (vertices[len(vertices) // 2 :, 2] < -1000.0).all()
    lines = np.array([[[0.0, 0.0], [1.0, 0.0], [np.inf, 0.0]]])
    pieces = segments(lines, 0.1)
    assert pieces[0].tolist() == [[0.0, 0.0, pytest.approx(0.1)], [1.0, 0.0, pytest.approx(0.1)]]
    assert (pieces[1, :, 2] < -1000.0).all()


def test_a_strip_covers_the_ground_between_two_lines_once() -> None:
    along = np.linspace(0.0, 1.0, 5)
    left, right = (np.stack([along, np.full(5, y)], axis=-1) for y in (1.0, 0.0))
    vertices, faces = strip(left, right, 0.0)
    triangles = vertices[faces][..., :2]
    areas = [shapely.Polygon(each).area for each in triangles]
    assert sum(areas) == pytest.approx(1.0)
    assert shapely.unary_union([shapely.Polygon(each) for each in triangles]).area == (
        pytest.approx(1.0)
    )


def test_headings_are_rotations_about_the_vertical() -> None:
    for heading in (0.3, -2.0, 4.0):
        w, x, y, z = turn(heading)
        turned = scipy.spatial.transform.Rotation.from_quat([x, y, z, w]).apply([1.0, 0.0, 0.0])
        np.testing.assert_allclose(turned, [np.cos(heading), np.sin(heading), 0.0], atol=1e-7)
    assert turn(float("nan")) == turn(0.0)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (3.0, -2.0, 0.7)])
def test_the_ground_is_the_belief_and_over_it_the_information(origin) -> None:
    probability = np.full((30, 40), 128, np.uint8)
    probability[5:25, 5:35] = 0
    probability[10, 10] = 255
    information = rng().uniform(0.0, 5.0, (15, 20)).astype(np.float32)
    pose = np.array(origin)
    ground = Ground((30, 40), pose, 0.1, pose, 0.2)
    plain_ground = ground.picture(probability)
    times = plain_ground.shape[0] // 30
    assert plain_ground.shape == (30 * times, 40 * times, 3)
    cells = plain_ground[::times, ::times]
    np.testing.assert_allclose(cells[0, 0], UNKNOWN, atol=1)
    assert tuple(cells[7, 7]) == FREE
    assert tuple(cells[10, 10]) == OCCUPIED
    heated = ground.picture(probability, information)[::times, ::times]
    np.testing.assert_array_equal(heated[probability > 0], cells[probability > 0])
    # SciPy interpolates the same field at the middles of the cells.
    row, column = np.mgrid[:30, :40]
    where = [(row + 0.5) / 2.0 - 0.5, (column + 0.5) / 2.0 - 0.5]
    gain = scipy.ndimage.map_coordinates(information, where, order=1)
    share = np.clip(gain / np.percentile(gain[probability == 0], 99.0), 0.0, 1.0)[..., None]
    expected = np.array(FREE) + MAX_HEAT * share * (np.array(HEAT) - np.array(FREE))
    is_free = probability == 0
    np.testing.assert_allclose(heated[is_free], expected[is_free], atol=1.0)


def test_a_map_larger_than_a_picture_is_thinned() -> None:
    ground = Ground((10, 4000), np.zeros(3), 0.1, np.zeros(3), 0.5)
    probability = np.zeros((10, 4000), np.uint8)
    probability[:, 2000:] = 255
    picture = ground.picture(probability, np.ones((2, 800), np.float32))
    assert picture.shape[1] <= 1600
    middle = picture.shape[1] // 2
    assert tuple(picture[0, -1]) == OCCUPIED
    assert tuple(picture[0, middle + 1]) == OCCUPIED
    assert tuple(picture[0, middle - 1]) != OCCUPIED


def test_a_weight_is_a_colour_and_nan_counts_as_none() -> None:
    colours = weight_colours(np.array([1.0, 0.5, 0.0, np.nan])).astype(int)
    faint = colours[2]
    distance = np.abs(colours - faint).sum(axis=1)
    assert distance[0] > distance[1] > distance[2] == distance[3] == 0


def test_rows_that_are_kept_are_evenly_spaced_and_hold_the_newest() -> None:
    for pieces in (rng().integers(1, 40, 30), np.ones(500, int), np.array([1000])):
        kept, whole = Thinned(1, 50), np.arange(pieces.sum(), dtype=float)[:, None]
        done = 0
        for size in pieces:
            kept.add(whole[done : done + size])
            done += size
        rows = kept.rows[:, 0]
        assert len(rows) <= 51
        assert rows[0] == 0.0
        assert rows[-1] == whole[-1, 0]
        assert len(set(np.diff(rows[:-1]))) <= 1
    assert len(Thinned(3, 10).rows) == 0


@pytest.mark.parametrize("name", ["recording", "vehicle", "make_straight", "fleet_run"])
def test_the_history_of_pieces_is_that_of_the_whole(name, request) -> None:
    made = request.getfixturevalue(name)
    run = made() if callable(made) else made
    empty = run.records._replace()
    blank = dataclasses.replace(run, records=_rows(empty, slice(0, 0)), frames=run.frames[:1])
    history = History(blank)
    for first in range(0, run.num_steps - 3, 3):
        part = slice(first, first + 3)
        history.add(_rows(run.records, part), run.time[1:][part])
    # The last steps come with the end of the run.
    assert len(history.trail) < len(run.positions)
    history.catch_up(run)
    for frame in run.frames:
        history.add_frame(frame)
    np.testing.assert_allclose(history.trail, run.positions)
    plots = {plot.title: plot for plot in history.plots()}
    for one, other in zip(plots.values(), History(run).plots(), strict=True):
        assert one[:2] == other[:2]
        np.testing.assert_array_equal(one.rows, other.rows)
    if "speed [m/s]" in plots:
        np.testing.assert_allclose(plots["speed [m/s]"].rows[:, 1], speeds(run)[1:])
    elif name == "fleet_run":
        (main,) = plots.values()
        assert main.names == ("robot 1", "robot 2", "together")
        np.testing.assert_array_equal(main.rows[:, 1:3], run.records.parts["team"].coverages)
        np.testing.assert_array_equal(main.rows[:, 3], run.records.coverage)
    else:
        main = next(iter(plots.values()))
        np.testing.assert_array_equal(main.rows[:, 1], run.records.coverage)
        terms = plots["cost of the plan by term"]
        assert terms.names == ("ControlCost",)
        assert len(terms.rows) == len(run.frames)
    whole = history.recording_at(run.frames[-1])
    assert whole.frame_image(run.frames[-1]).size == run.frame_image(run.frames[-1]).size


def _rows(records, part: slice):
    return jax.tree.map(lambda rows: rows[part], records)


def test_names_are_shown_without_markup() -> None:
    assert plain("<img src=x onerror='f()'>") == "?img src?x onerror??f()??"
    assert plain("cost.obstacle-2.weight [m/s]") == "cost.obstacle-2.weight [m/s]"
    assert len(plain("x" * 1000)) == 60


@pytest.mark.parametrize("name", ["recording", "vehicle", "no_step", "make_straight", "make_ring"])
def test_a_finished_run_is_shown_at_every_time(name, request) -> None:
    made = request.getfixturevalue(name)
    run = made() if callable(made) else made
    replay = Replay(run, label="<b>")
    try:
        slider, play, speed = replay._slider, replay._play, replay._speed
        shown = []
        for frame in run.frames:
            slider.value = frame.time
            replay.tick(0.0)
            shown.append(replay._display._time.value)
        assert shown == [f"{frame.time:.2f} s" for frame in run.frames]
        # It plays from the start to the end and stops there.
        slider.value, play.value, speed.value = 0.0, True, "2 x real time"
        replay.tick(0.25)
        assert slider.value == pytest.approx(min(0.5, run.frames[-1].time))
        replay.tick(1000.0)
        assert not play.value
        assert replay._display._time.value == f"{run.frames[-1].time:.2f} s"
        slider.value = float("inf")
        replay.tick(0.0)
        layers = {node.split("/")[0] for node in replay._display._scene._nodes}
        assert layers - {"robot"} <= set(replay._display._scene.layers)
        name, data = replay._display.picture()
        assert name.endswith("s.png")
        assert data.startswith(b"\x89PNG")
    finally:
        replay.close()


@pytest.mark.parametrize("name", ["recording", "make_straight"])
def test_a_run_far_away_is_drawn_near_the_origin(name, request) -> None:
    """Pages draw in single precision."""
    made = request.getfixturevalue(name)
    run = made() if callable(made) else made
    offset = np.array([500_000.0, 4_649_776.0])
    frames = tuple(each.move(offset, run.state_names) for each in run.frames)
    drawn = []
    for each in (run, dataclasses.replace(run.move(offset), frames=frames)):
        replay = Replay(each)
        try:
            nodes = replay._display._scene._nodes
            drawn.append({name: np.array(nodes[name].points) for name in ("plan", "rollouts")})
            drawn[-1]["robot"] = np.array(nodes["robot"].position)
        finally:
            replay.close()
    start = drawn[0]["robot"][:2] - drawn[1]["robot"][:2]
    for part in drawn[0]:
        moved = drawn[0][part] - drawn[1][part]
        np.testing.assert_allclose(moved[..., :2], np.broadcast_to(start, moved[..., :2].shape),
                                   atol=1e-5)  # fmt: skip
    assert np.abs(drawn[1]["plan"]).max() < 100.0


def test_a_layer_is_hidden_and_the_information_with_the_next_frame(vehicle) -> None:
    replay = Replay(vehicle)
    try:
        scene, display = replay._display._scene, replay._display
        before = np.array(scene._nodes["belief"].image)
        for box in display._layers:
            display._show_layer(SimpleNamespace(target=SimpleNamespace(label=box.label, value=0)))
        drawn = {name: node.visible for name, node in scene._nodes.items()}
        assert not any(shown for name, shown in drawn.items() if not name.startswith("robot"))
        replay._draw(0)
        assert not np.array_equal(scene._nodes["belief"].image, before)
        display._show_layer(SimpleNamespace(target=SimpleNamespace(label="obstacles", value=1)))
        assert scene._nodes["obstacles"].visible
        assert scene._nodes["obstacles/rim"].visible
    finally:
        replay.close()


@pytest.mark.parametrize("name", ["recording", "make_straight"])
def test_rollouts_are_coloured_by_what_a_page_chooses(name, request) -> None:
    made = request.getfixturevalue(name)
    run = made() if callable(made) else made
    replay = Replay(run)
    try:
        display = replay._display
        choice, legend, nodes = (
            display._rollouts._choice,
            display._rollouts._legend,
            display._scene._nodes,
        )
        assert choice.options == ("weight", "total cost", "ControlCost", "ObstacleCost")
        by_weight = nodes["rollouts"].colors
        assert legend.content == ""
        for label, cost, text in (
            ("total cost", [1.0, 2.5, np.inf, 4.0, 5.5, np.nan], ("1<", "5.5<", "2 not finite")),
            ("ControlCost", np.arange(1.0, 7.0), ("1<", "6<")),
            ("ObstacleCost", [0.0, 0.5, np.inf, 0.0, 0.5, np.nan], ("0<", "0.5<", "2 not finite")),
        ):
            # It is drawn at once: a run may wait.
            choice.value = label
            per_rollout = nodes["rollouts"].colors.reshape(6, -1, 3)
            assert (per_rollout == per_rollout[:, :1]).all()
            shown = linear_light(cost_colours(np.array(cost)))
            np.testing.assert_array_equal(per_rollout[:, 0], shown)
            assert all(each in legend.content for each in text)
        # A page could send anything.
        choice.value = "<script>"
        np.testing.assert_array_equal(nodes["rollouts"].colors, by_weight)
    finally:
        replay.close()


def test_a_run_without_costs_of_rollouts_says_so(recording) -> None:
    frames = [dataclasses.replace(each, sample_terms={}) for each in recording.frames]
    replay = Replay(dataclasses.replace(recording, frames=tuple(frames)))
    try:
        rollouts = replay._display._rollouts
        assert rollouts._choice.options == ("weight",)
        assert "tells no costs" in rollouts._legend.content
        odd = {"<b>": np.ones(6), "?b?": np.ones(6), "weight": np.ones(6)}
        rollouts.offer(dataclasses.replace(frames[0], sample_terms=odd))
        assert rollouts._choice.options == ("weight", "total cost", "?b?", "?b?*")
        rollouts.offer(dataclasses.replace(frames[0], samples=np.zeros((0, 1, 2))))
        assert not rollouts._choice.visible
    finally:
        replay.close()


def test_a_run_that_cannot_be_shown_is_one_line_and_leaves_no_server(recording) -> None:
    with pytest.raises(ValueError, match="recording has no frames; accepted"):
        Replay(dataclasses.replace(recording, frames=()))
    broken = dataclasses.replace(recording.frames[0], weights=np.zeros(3, np.float32))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    with pytest.raises(ValueError, match=r"recording cannot be drawn .*; accepted: a run as"):
        Replay(dataclasses.replace(recording, frames=(broken,)), port=port)
    # The port is free again.
    Replay(recording, port=port).close()


def test_other_tasks_are_shown_by_their_own_picture(recording) -> None:
    from jaxplore.report.recording import Recording
    from jaxplore.scenes.picture import PictureScene

    class Dot(Recording):
        def metrics(self, *, seed=None):
            raise NotImplementedError

        def frame_image(self, frame, *, scale=1.0):
            image = Image.new("RGB", (8, 4), "white")
            image.putpixel((frame.step, 0), (255, 0, 0))
            return image

    run = Dot(
        **{
            name: getattr(recording, name)
            for name in ("records", "frames", "timing", "control_period", "is_interrupted")
        }
    )
    replay = Replay(run)
    try:
        scene = replay._display._scene
        assert isinstance(scene, PictureScene)
        # The upper row of the picture is at the high end of y.
        assert scene._nodes["picture"].image[-1, 0].tolist() == [255, 0, 0]
        assert scene._nodes["picture"].render_height == pytest.approx(5.0)
        assert len(replay._display.history.plots()) == 1
    finally:
        replay.close()
