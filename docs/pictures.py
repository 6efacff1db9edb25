"""Draw the pictures of the guides that are not of runs: `python docs/pictures.py`."""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib
import matplotlib.colors
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle, Wedge

import jaxplore as jx
from jaxplore.information.trajectory import METHODS
from jaxplore.maps.generators.generated import KINDS, generate_map

IMAGES, RECORDS = Path(__file__).parent / "images", Path(__file__).parent / "records"
DPI = 120
BLUE, ORANGE, GREEN, VERMILION = "#0072b2", "#e69f00", "#009e73", "#d55e00"
"""Okabe and Ito's palette, told apart with any colour vision."""
GREY, INK = "#8a9099", "#2b303a"
STYLE = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}


def main() -> None:
    """Draw all of them."""
    with plt.rc_context(STYLE):
        for name, draw in (
            ("information_beam", beam),
            ("information_field", field),
            ("information_overlap", overlap),
            ("control_parts", control_parts),
            ("control_rollouts", control_rollouts),
            ("fusion_pillar", fusion_pillar),
            ("path_following", path_following),
            ("uncertainty_weight", uncertainty_weight),
            ("generated_maps", generated_maps),
            ("architecture", architecture),
        ):
            figure = draw()
            path = IMAGES / f"{name}.png"
            figure.savefig(path, dpi=DPI, metadata={"Software": None})
            plt.close(figure)
            print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


def beam() -> Figure:
    """Draw a beam through free, unknown, free and occupied cells."""
    parts = [("free", 0.02, 10), ("unknown", 0.5, 3), ("free", 0.02, 7), ("wall", 0.95, 2)]
    parts.append(("unknown", 0.5, 6))
    cells = np.concatenate([np.full(count, value) for _, value, count in parts])
    occupancy, model = jnp.asarray(cells, jnp.float32), jx.InverseSensorModel()
    passed = np.cumprod(1.0 - cells)
    reach = np.concatenate([[1.0], passed[:-1]])
    noise = jx.information.GaussianNoise(1.5)  # [cells]
    exact = np.asarray(jx.information.cell_information(occupancy, model))
    noisy = np.asarray(jx.information.cell_information(occupancy, model, noise=noise))
    middle = np.arange(len(cells)) + 0.5

    figure, axes = plt.subplots(3, 1, figsize=(7.5, 6.2), sharex=True, layout="constrained")
    axes[0].bar(middle, cells, 1.0, color=GREY, edgecolor="white", linewidth=0.5)
    axes[0].set(ylabel="probability", ylim=(0, 1.25), yticks=[0, 0.5, 1])
    axes[0].set_title("What the map says: occupancy o of each cell", loc="left")
    start = 0
    for name, value, count in parts:
        axes[0].text(start + count / 2, value + 0.05, name, ha="center", color=INK)
        start += count

    axes[1].bar(middle, cells * reach, 0.8, color=ORANGE, label="first hit in the cell, P(e)")
    axes[1].step(
        np.arange(len(cells) + 1),
        np.append(reach, passed[-1]),
        where="post",
        color=BLUE,
        label="the beam reaches the cell",
    )
    axes[1].set(ylabel="probability", ylim=(0, 1.1), yticks=[0, 0.5, 1])
    axes[1].set_title("What the beam will do", loc="left")
    axes[1].legend(loc="upper right")

    for values, side, colour, name in (
        (exact, -0.21, BLUE, "noise-free"),
        (noisy, 0.21, ORANGE, "Gaussian noise, 1.5 cells"),
    ):
        label = f"{name}: {values.sum():.2f} nat in total"
        axes[2].bar(middle + side, values, 0.42, color=colour, label=label)
    axes[2].set(ylabel="information [nat]", xlabel="distance along the beam [cells]")
    axes[2].set(xlim=(0, len(cells)))
    axes[2].set_title("What each cell contributes", loc="left")
    axes[2].legend(loc="upper right")
    return figure


def field() -> Figure:
    """Draw a half-explored office: its field, its local field and a reference that climbs it."""
    width, height = 12.0, 9.0
    world, model = jx.office(seed=1, width=width, height=height), jx.InverseSensorModel()
    lidar = jx.Lidar(num_beams=360, max_range=5.0, range_noise=0.02)
    grid = jx.OccupancyGrid.unknown(world.shape, world.frame)
    poses = jnp.asarray([[0.8, 4.95, 0.0], [1.6, 4.95, 0.0], [2.3, 4.95, 0.0]])
    for number, pose in enumerate(poses):
        grid = lidar.update(grid, lidar.scan(world, pose, key=jax.random.key(number)), pose, model)
    robot = jnp.asarray([2.8, 4.95])
    everywhere = eqx.filter_jit(jx.FieldSensor(lidar, grid.resolution, 64).field)(grid, model)
    camera = jx.Lidar(num_beams=30, max_range=5.0, field_of_view=np.pi / 2)
    sensor = jx.information.LocalFieldSensor(jx.PoseInformation(camera, model), grid.resolution)
    potential = eqx.filter_jit(sensor.field)(grid, robot).best
    climb = jx.planning.GradientReference()(potential, grid, jnp.append(robot, 0.0))

    figure, axes = plt.subplots(1, 2, figsize=(8.4, 5.6), layout="constrained")
    corner = np.asarray(potential.frame.origin[:2])
    side = potential.frame.resolution * np.asarray(potential.values.shape[::-1])
    lattice = (corner[0], corner[0] + side[0], corner[1], corner[1] + side[1])
    for axis, values, extent, title in (
        (axes[0], everywhere.total, (0.0, width, 0.0, height), "Field: 360 beams, a full turn"),
        (axes[1], potential.values, lattice, "Local field: 30 beams over 90°, best yaw"),
    ):
        shown = axis.imshow(values, origin="lower", extent=extent, cmap="viridis", vmin=0)
        axis.imshow(_cover(grid), origin="lower", extent=(0.0, width, 0.0, height))
        axis.plot(
            *poses[:, :2].T, "o", color="white", markeredgecolor=INK, markersize=4, label="scans"
        )
        axis.plot(
            *robot, "o", color=VERMILION, markeredgecolor="white", markersize=8, label="robot"
        )
        axis.set(xlim=(0, 8.5), ylim=(0, height), xlabel="x [m]", ylabel="y [m]")
        axis.set_title(title, loc="left")
        figure.colorbar(shown, ax=axis, location="bottom", label="information [nat]", shrink=0.8)
    way = np.concatenate([robot[None], climb[:, :2]])
    axes[1].plot(*way.T, color=VERMILION, linewidth=2.5, label="gradient reference")
    for axis in axes:
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.03))
        axis.text(6.3, 7.8, "unknown", color=INK, ha="center")
    return figure


def _cover(grid: jx.OccupancyGrid, *, only_walls: bool = False) -> np.ndarray:
    """Return the map (H, W, 4): unknown grey, occupied black, free see-through."""
    cover = np.zeros((*grid.shape, 4), np.float32)
    if not only_walls:
        cover[np.asarray(~grid.is_free)] = (0.83, 0.84, 0.86, 1.0)
    cover[np.asarray(grid.is_occupied)] = (0.1, 0.1, 0.1, 1.0)
    return cover


def overlap() -> Figure:
    """Draw three views that overlap across a wall, and what they are worth together."""
    grid = _wall_between()
    lidar = jx.Lidar(num_beams=100, max_range=4.0, field_of_view=np.pi / 2)
    pose = jx.PoseInformation(lidar)
    positions = jnp.asarray([[1.0, 2.6], [2.4, 5.0], [4.6, 5.0]])
    headings = jnp.asarray([0.0, -0.6, -1.9])
    colours = BLUE, ORANGE, GREEN
    extent = (0.0, 7.0, 0.0, 6.0)

    figure, grid_of_axes = plt.subplots(2, 2, figsize=(8.2, 7.4), layout="constrained")
    axes = grid_of_axes.reshape(-1)
    shown_by_pose = np.stack(
        [_in_view(grid, lidar, at, yaw) for at, yaw in zip(positions, headings, strict=True)]
    )
    reached = np.stack(
        [_reached(grid, pose, at, yaw) for at, yaw in zip(positions, headings, strict=True)]
    )
    is_first = shown_by_pose & (np.cumsum(shown_by_pose, axis=0) == 1)
    for axis in axes[:3]:
        axis.imshow(_cover(grid), origin="lower", extent=extent)
    for number, colour in enumerate(colours):
        layer = np.zeros((*grid.shape, 4), np.float32)
        layer[...] = matplotlib.colors.to_rgba(colour)
        layer[..., 3] = 0.6 * is_first[number]
        axes[1].imshow(layer, origin="lower", extent=extent)
        is_best = (reached.argmax(axis=0) == number) & (reached.max(axis=0) > 0.0)
        layer[..., 3] = 0.8 * np.where(is_best, reached[number], 0.0)
        axes[2].imshow(layer, origin="lower", extent=extent)
    titles = ["Three poses, 90° and 4 m each", '"filtered": the first view of a cell counts']
    titles.append('"occlusion": the best chance of reaching a cell')
    for axis, title in zip(axes[:3], titles, strict=True):
        axis.imshow(_cover(grid, only_walls=True), origin="lower", extent=extent)
        for number, (at, yaw, colour) in enumerate(zip(positions, headings, colours, strict=True)):
            _pose(axis, at, float(yaw), colour, str(number + 1))
        axis.set(xlim=extent[:2], ylim=extent[2:], xlabel="x [m]", ylabel="y [m]")
        axis.set_title(title, loc="left")

    for x, y, name in (1.3, 0.6, "free"), (5.9, 0.4, "unknown"):
        axes[0].text(x, y, name, color=INK, ha="center")
    axes[0].text(2.97, 3.55, "wall", color="white", ha="center", va="center", rotation=90)

    bottom = np.zeros(len(METHODS))
    added = np.stack(
        [
            np.asarray(jx.TrajectoryInformation(pose, name).per_pose(grid, positions, headings))
            for name in METHODS
        ]
    )
    for number, colour in enumerate(colours):
        axes[3].bar(
            METHODS, added[:, number], bottom=bottom, color=colour, label=f"pose {number + 1}"
        )
        bottom = bottom + added[:, number]
    for column, total in enumerate(bottom):
        axes[3].text(column, total + 0.3, f"{total:.1f}", ha="center")
    axes[3].set(ylabel="information [nat]", ylim=(0, 1.35 * bottom.max()))
    axes[3].set_title("What the three scans are worth", loc="left")
    axes[3].legend(ncols=3, loc="upper right")
    return figure


def _wall_between() -> jx.OccupancyGrid:
    """Return a room 7 m x 6 m: free this side of a wall, unknown behind it."""
    cells = np.full((60, 70), 0.01, np.float32)
    cells[:40, 30:] = 0.5
    cells[10:40, 28:31] = 0.99
    return jx.OccupancyGrid(cells, 0.1)


def _in_view(grid: jx.OccupancyGrid, lidar: jx.Lidar, at: jax.Array, yaw: jax.Array) -> np.ndarray:
    """Return the cells (H, W) in range and in the field of view, whatever is in between."""
    rows, columns = np.mgrid[: grid.shape[0], : grid.shape[1]]
    centre = grid.frame.cell_centre(jnp.stack([rows, columns], axis=-1))
    away = np.asarray(centre - at)
    off = np.angle(np.exp(1j * (np.arctan2(away[..., 1], away[..., 0]) - float(yaw))))
    is_near = np.hypot(away[..., 0], away[..., 1]) <= lidar.max_range
    return is_near & (np.abs(off) <= lidar.field_of_view / 2.0)


def _reached(
    grid: jx.OccupancyGrid, pose: jx.PoseInformation, at: jax.Array, yaw: jax.Array
) -> np.ndarray:
    """Return the greatest probability (H, W) with which a beam reaches each cell."""
    cell = np.asarray(pose.view(grid, at, yaw).cell)
    passing = 1.0 - np.asarray(grid.at_cell(jnp.asarray(cell)))
    reach = np.cumprod(np.pad(passing, ((0, 0), (1, 0)), constant_values=1.0), axis=1)[:, :-1]
    middle = np.asarray(grid.frame.cell_centre(jnp.asarray(cell)))
    distance = np.linalg.norm(middle - np.asarray(at), axis=-1)
    is_on = np.asarray(grid.contains(jnp.asarray(cell))) & (distance <= pose.lidar.max_range)
    best = np.zeros(grid.shape)
    np.maximum.at(best, tuple(np.moveaxis(cell[is_on], -1, 0)), reach[is_on])
    return best


def _pose(axis: Axes, at: jax.Array, yaw: float, colour: str, name: str) -> None:
    """Draw a pose and its field of view."""
    x, y = (float(value) for value in at)
    view = np.degrees(yaw) + np.array([-45.0, 45.0])
    axis.add_patch(Wedge((x, y), 4.0, *view, fill=False, edgecolor=colour, linewidth=1.2))
    axis.plot(x, y, "o", color=colour, markeredgecolor="white", markersize=11)
    axis.text(x, y, name, ha="center", va="center", color="white", fontsize=8, weight="bold")


def control_parts() -> Figure:
    """Draw one control of sampled sequences, for a few parameterisations and noises."""
    horizon, dt, shown = 40, 0.1, 4
    robot = jx.PointMass(1, max_acceleration=3.0)
    white = jx.GaussianProposal([1.0])
    panels = {
        "Direct, white noise": (white, jx.control.Direct()),
        "Direct, ColouredNoise(1)": (
            jx.GaussianProposal([1.0], noise=jx.ColouredNoise(1.0)),
            jx.control.Direct(),
        ),
        "Direct, ColouredNoise(2)": (
            jx.GaussianProposal([1.0], noise=jx.ColouredNoise(2.0)),
            jx.control.Direct(),
        ),
        "Smooth, 4 per second": (jx.GaussianProposal([4.0]), jx.Smooth()),
        "Knots(8, RBFKernel(2))": (white, jx.Knots(8, jx.RBFKernel(2.0))),
        "Knots(8), cubic spline": (white, jx.Knots(8)),
    }
    figure, grid_of_axes = plt.subplots(
        2, 3, figsize=(8.4, 4.6), sharex=True, sharey=True, layout="constrained"
    )
    space = jx.control.ControlSpace(
        robot.control_min, robot.control_max, robot.default_control, jnp.asarray(dt), horizon
    )
    times = dt * np.arange(horizon + 1)
    colours = matplotlib.colormaps["viridis"](np.linspace(0.05, 0.9, shown))
    for axis, (title, (proposal, parts)) in zip(
        grid_of_axes.reshape(-1), panels.items(), strict=True
    ):
        plan = jnp.zeros((horizon, 1))
        if isinstance(parts, jx.Smooth):
            plan = 1.5 * jnp.sin(2.0 * jnp.arange(horizon)[:, None] * dt)
        controls, knots = _sampled(proposal, parts, plan, space, shown)
        for number, colour in enumerate(colours):
            values = controls[:, 0, number]
            axis.step(times, np.append(values, values[-1]), where="post", color=colour, lw=1.3)
            if isinstance(parts, jx.Knots):
                at = dt * (np.linspace(0, horizon - 1, len(knots)) + 0.5)
                axis.plot(at, knots[:, 0, number], "o", color=colour, markersize=3)
        axis.plot(times[:-1] + 0.5 * dt, plan[:, 0], "--", color=INK, linewidth=1.0)
        axis.set_title(title, loc="left")
    grid_of_axes[0, 0].set(ylim=(-3.2, 3.2), xlim=(0, horizon * dt))
    for axis in grid_of_axes[:, 0]:
        axis.set_ylabel("control")
    for axis in grid_of_axes[1]:
        axis.set_xlabel("time [s]")
    return figure


def _sampled(
    proposal: jx.control.Proposal,
    parts: jx.control.Parameterisation,
    plan: jax.Array,
    space: jx.control.ControlSpace,
    count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Return controls (T, 1, K) and parameters (P, 1, K) sampled around a plan (T, 1)."""
    size = parts.num_parameters(space.horizon)
    nominal = parts.init(plan, space)
    around = jx.control.SamplingContext(parts, nominal, space)
    memory = proposal.init(size, 1)
    samples = proposal.sample(memory, around, count, key=jax.random.key(3))
    controls, knots = parts.decode(nominal, samples, space)
    return np.asarray(controls), np.asarray(knots)


def control_rollouts() -> Figure:
    """Draw one step of MPPI among discs: rollouts by weight, the plan, the best rollout."""
    robot = jx.DifferentialDrive(max_speed=1.5)
    discs = np.array([[1.4, 0.2], [2.7, -1.3], [2.7, 1.0]])
    goal = np.array([4.0, 0.0])
    cost = jx.GoalCost(goal) + jx.DiscObstacleCost(discs, 0.4) + 0.01 * jx.ControlCost()
    controller = jx.MPPI(
        robot, cost, horizon=30, num_samples=256, temperature=1.0, noise_std=[1.0, 2.0], dt=0.1
    )
    state, x = controller.init(), robot.at_pose(0.0, 0.0, 0.0)
    step, key = eqx.filter_jit(controller.step), jax.random.key(2)
    driven = [x]
    for _ in range(11):
        key, now = jax.random.split(key)
        control, state, _ = step(state, x, key=now)
        x = robot.step(x, control, controller.dt)
        driven.append(x)
    look = controller.inspect(state, x, key=key, num_trajectories=60)

    figure, axis = plt.subplots(figsize=(7.5, 4.2), layout="constrained")
    for disc in discs:
        axis.add_patch(Circle(disc, 0.4, facecolor="#d4d7dc", edgecolor=GREY))
    weights = np.asarray(look.weights)
    share = np.clip(weights / weights.max(), 1e-3, 1.0)
    scale = matplotlib.colors.LogNorm(1e-3, 1.0)
    shades = matplotlib.colormaps["Blues"](np.linspace(0.25, 1.0, 256))
    shading = matplotlib.colors.ListedColormap(shades)
    for index in np.argsort(weights):
        colour = shading(scale(share[index]))
        axis.plot(*look.samples[index, :, :2].T, color=colour, linewidth=0.9, zorder=2)
    axis.plot(
        *look.best.states[:, :2].T, color=ORANGE, linewidth=2.2, label="best rollout", zorder=3
    )
    axis.plot(*look.nominal.states[:, :2].T, color=VERMILION, linewidth=3, label="plan", zorder=4)
    axis.plot(*np.asarray(driven)[:, :2].T, color=INK, linewidth=1.5, zorder=4)
    axis.add_patch(Circle(x[:2], 0.2, facecolor="white", edgecolor=INK, zorder=5))
    axis.plot(*goal, "*", color=VERMILION, markersize=14, label="goal", zorder=5)
    axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-0.4, 4.4), ylim=(-1.9, 1.6))
    axis.legend(loc="lower left")
    mappable = matplotlib.cm.ScalarMappable(scale, shading)
    figure.colorbar(mappable, ax=axis, label="weight, relative to the greatest", shrink=0.8)
    return figure


def fusion_pillar() -> Figure:
    """Draw two members that pass a pillar on its two sides, their average, and safe fusion."""
    robot = jx.DifferentialDrive(max_speed=1.2, radius=0.25)
    belief, pillar, size, goal = _seen_pillar(robot)
    x = robot.at_pose(*np.asarray(belief.pose)).at[robot.state_names.index("v")].set(1.0)
    mppi = jx.MPPI(
        robot,
        0.3 * jx.costs.CollisionCost(),
        horizon=30,
        num_samples=1000,
        temperature=0.3,
        noise_std=[0.5, 1.0],
        dt=0.12,
        control_period=0.02,
    )
    sides = [jx.costs.RegionCost(0.25 * np.pi), jx.costs.RegionCost(-0.25 * np.pi)]
    row = {"goal": 0.8, "side": 0.2, "effort": 0.02}
    average = jx.Portfolio(
        mppi,
        {"goal": jx.costs.ToGoalCost(), "side": sides, "effort": jx.ControlCost()},
        {"left": row, "right": row},
        fusion="average",
    )
    safe = eqx.tree_at(
        lambda one: one.fusion, average, jx.planning.SafeFusion(jx.planning.Average())
    )
    step, state = eqx.filter_jit(jx.Portfolio.step), average.init()
    for number in range(60):
        _, state, _ = step(average, state, x, belief, key=jax.random.key(number))

    plans, key = {}, jax.random.key(60)
    for number, name in enumerate(average.member_names):
        alone = average.single(name, spread=state.spread)
        own = jax.tree.map(lambda leaf, at=number: leaf[at], state.members)
        plans[name] = eqx.filter_jit(alone.step)(own, x, belief, key=key)[2].controls
    plans["average"] = step(average, state, x, belief, key=key)[2].controls
    plans["safe fusion"] = step(safe, state, x, belief, key=key)[2].controls
    paths = {
        name: np.asarray(
            jx.control.rollout(robot, jx.ControlCost(), x, plan, mppi.dt, belief).states
        )
        for name, plan in plans.items()
    }

    figure, axes = plt.subplots(1, 2, figsize=(8.4, 3.3), sharey=True, layout="constrained")
    for axis, name, title in (
        (axes[0], "average", "Average: into the pillar"),
        (axes[1], "safe fusion", "Safe fusion: one of them"),
    ):
        axis.imshow(_cover(belief.grid), origin="lower", extent=(0.0, size[0], 0.0, size[1]))
        for path in paths[name][::4]:
            is_hit = np.hypot(*(path[:2] - pillar[:2])) < pillar[2] + float(robot.radius)
            colour = VERMILION if is_hit else GREY
            axis.add_patch(
                Circle(path[:2], float(robot.radius), facecolor=colour, alpha=0.25, lw=0)
            )
        for member, colour in (("left", BLUE), ("right", GREEN)):
            axis.plot(*paths[member][:, :2].T, color=colour, linewidth=2, label=member)
        axis.plot(*paths[name][:, :2].T, "--", color=VERMILION, linewidth=2.5, label=name)
        axis.plot(*x[:2], "o", color="white", markeredgecolor=INK, markersize=8)
        axis.plot(*goal, "*", color=VERMILION, markersize=13)
        axis.text(goal[0], goal[1] - 0.4, "goal", ha="center", color=INK)
        axis.set(xlabel="x [m]", xlim=(0.0, size[0]), ylim=(0.0, size[1]))
        axis.set_title(title, loc="left")
        axis.legend(loc="upper right", bbox_to_anchor=(1.0, 0.97))
    axes[0].set_ylabel("y [m]")
    return figure


def _seen_pillar(
    robot: jx.Dynamics,
) -> tuple[jx.belief.Belief, tuple[float, ...], tuple[float, float], tuple[float, float]]:
    """Return what a robot knows of a room with a pillar (x, y, radius), its size, and a goal."""
    (width, height), pillar, start = (6.0, 4.0), (2.6, 2.0, 0.3), (0.7, 2.0, 0.0)
    corners = (0.0, 0.0), (width, 0.0), (width, height), (0.0, height)
    walls = tuple((*a, *b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True))
    goal = (5.2, 2.0)
    world = jx.World(
        size=(width, height),
        start=start,
        goal=goal,
        wall_reach=0.1,
        known=jx.Shapes(walls=walls, discs=(pillar,)),
    ).truth()
    lidar = jx.Lidar(num_beams=360, max_range=6.0, range_noise=0.0)
    perception = jx.Perception(lidar, 0.1, robot.radius, goal=goal, is_goal_apart=True)
    # From behind the pillar as well, so that nothing in its shadow is unknown.
    poses = jnp.asarray([[4.0, 3.3, 0.0], [4.0, 0.7, 0.0], start])
    belief = perception.init(jx.OccupancyGrid.unknown(world.shape, world.frame), poses[-1])
    for number, pose in enumerate(poses):
        scan = lidar.scan(world, pose, key=jax.random.key(number))
        belief = perception.observe(belief, scan, pose)
    belief = perception.update_fields(belief, poses[-1], jnp.asarray(0.2))
    return belief, pillar, (width, height), goal


def path_following() -> Figure:
    """Draw twenty runs of contouring control along an S-curve, and print how they did."""
    waypoints = np.array([(0, 0), (10, 0), (20, 5), (30, 0), (40, -5), (50, 0)], np.float32)
    path = jx.path_through(waypoints)
    car = jx.KinematicBicycle(2.5, 1e-3, max_speed=15.0, max_acceleration=3.0, max_steering=0.5)
    following = jx.mpcc(
        car,
        path,
        noise_std=[0.5, 0.05],
        contouring_weight=100.0,
        lag_weight=100.0,
        progress_weight=630.0,
        comfort_weight=None,
        num_samples=256,
        temperature=50.0,
        dt=0.1,
    )
    model, end = following.model, float(path.length) - 0.8

    @eqx.filter_jit
    def drive(mppi: jx.MPPI, key: jax.Array) -> jax.Array:
        def advance(carry: tuple, key: jax.Array) -> tuple[tuple, jax.Array]:
            control, memory, _ = mppi.step(carry[1], carry[0], key=key)
            state = model.step(carry[0], control, mppi.dt)
            return (state, memory), state

        start = (model.at_pose(0.0, 0.0, 0.0), mppi.init())
        return jax.lax.scan(advance, start, jax.random.split(key, 200))[1]

    figure, (left, upper, lower) = plt.subplots(
        3, 1, figsize=(8.0, 6.2), height_ratios=(1.3, 1.0, 1.0), layout="constrained"
    )
    nodes = path.points
    left.plot(nodes[:, 0], nodes[:, 1], "--", color=GREY, lw=1.2, label="path")
    left.plot(waypoints[:, 0], waypoints[:, 1], "o", color=INK, ms=4, label="waypoints")
    results, drawn = [], None
    for seed in range(20):
        states = drive(following.controller, jax.random.key(seed))
        reached = np.flatnonzero(np.asarray(states[:, -1]) >= end)
        count = int(reached[0]) + 1 if reached.size else len(states)
        errors = [
            np.asarray(each.errors(states[:count], model))
            for each in (following.contouring, following.lag)
        ]
        results.append(
            [
                *(f(np.abs(e)) for e in errors for f in (np.mean, np.max)),
                0.1 * count,
                reached.size > 0,
            ]
        )
        drawn = left.scatter(
            states[:count, 0], states[:count, 1], c=states[:count, 3], s=3, cmap="viridis", vmin=0.0
        )
        for axis, error in zip((upper, lower), errors, strict=True):
            axis.plot(states[:count, -1], error, color=BLUE, alpha=0.35, lw=0.9)
    assert drawn is not None
    figure.colorbar(drawn, ax=left, label="speed [m/s]", pad=0.01)
    left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    left.legend(loc="upper right")
    upper.set(ylabel="contouring [m]", xticklabels=[])
    lower.set(ylabel="lag [m]", xlabel="progress along the path [m]")
    for axis in (upper, lower):
        axis.axhline(0.0, color=GREY, lw=0.8)
    mean, most = np.mean(results, axis=0), np.max(results, axis=0)
    print(
        f"contouring {mean[0]:.2f} mean, {most[1]:.2f} max; lag {mean[2]:.2f}, {most[3]:.2f}; "
        f"{np.median([row[4] for row in results]):.1f} s; {int(np.sum(results, axis=0)[5])} of 20"
    )
    return figure


def uncertainty_weight() -> Figure:
    """Draw how exact and how slow explorations are by the weight of the uncertainty.

    The rows are those of `python -m benchmarks.localisation --uncertainty-weight 0 3 ...`.
    """
    rows = json.loads((RECORDS / "uncertainty_weight.json").read_text(encoding="utf-8"))
    columns = (("ate_m", "trajectory error [m]"), ("finished_at_s", "time to 99 % [s]"))
    figure, axes = plt.subplots(1, len(columns), figsize=(7.2, 2.8), layout="constrained")
    for name, colour in zip(
        dict.fromkeys(row["map"] for row in rows), (BLUE, ORANGE), strict=False
    ):
        mine = [row for row in rows if row["map"] == name]
        weights = sorted({row["uncertainty_weight"] for row in mine})
        # The weight 0 has a place of its own on a logarithmic axis.
        places = np.arange(len(weights))
        for axis, (column, label) in zip(axes, columns, strict=True):
            values = [
                [row[column] for row in mine if row["uncertainty_weight"] == weight]
                for weight in weights
            ]
            axis.plot(places, [np.median(each) for each in values], color=colour, label=name)
            for place, each in zip(places, values, strict=True):
                axis.plot(np.full(len(each), place), each, "o", color=colour, ms=3, alpha=0.6)
            axis.set(ylabel=label, xlabel="uncertainty_weight", ylim=(0.0, None))
            axis.set_xticks(places, [f"{weight:g}" for weight in weights])
    axes[0].legend()
    return figure


def architecture() -> Figure:
    """The house: rooms as boxes, data flow as arrows, and where to add what."""
    figure, axes = plt.subplots(figsize=(10.0, 5.9))
    figure.subplots_adjust(0.01, 0.01, 0.99, 0.99)
    axes.set(xlim=(0.0, 100.0), ylim=(0.0, 61.0))
    axes.set_axis_off()
    axes.add_patch(Rectangle((1.5, 14.0), 82.0, 35.0, facecolor="#f3f5f8", edgecolor="#c9ced6"))
    axes.text(3.0, 46.3, "simulation: one closed loop for every task", color=GREY, fontsize=9.5)
    rooms = {
        "maps, geometry": (3.0, 52.0, 21.0, GREY, "true map, ROS files, paths", ""),
        "settings, tasks": (32.0, 52.0, 20.0, GREY, "YAML to Experiment", "kind"),
        "planning": (61.0, 52.0, 21.0, ORANGE, "presets, strategy, portfolio", "explorer"),
        "information": (3.0, 36.0, 20.0, BLUE, "expected gain of a scan", ""),
        "belief": (32.0, 36.0, 20.0, BLUE, "map, fields, obstacles", ""),
        "control": (61.0, 36.0, 21.0, ORANGE, "sample, evaluate, update", "proposal"),
        "sensing": (3.0, 20.5, 20.0, GREEN, "scans of the true map", "sensor"),
        "costs": (32.0, 20.5, 20.0, ORANGE, "stage, terminal, sequence", "cost"),
        "dynamics": (61.0, 20.5, 21.0, GREEN, "model of the robot", "model"),
        "report": (87.0, 28.0, 12.0, VERMILION, "recording", ""),
        "gym, view": (3.0, 2.0, 20.0, VERMILION, "environments, browser", ""),
        "study": (32.0, 2.0, 20.0, VERMILION, "compare, tune, workers", ""),
        "cli": (61.0, 2.0, 21.0, VERMILION, "jaxplore run, compare, tune", ""),
    }
    for name, (x, y, width, colour, content, addition) in rooms.items():
        axes.add_patch(
            FancyBboxPatch(
                (x, y),
                width,
                7.5,
                "round,pad=0,rounding_size=1.2",
                facecolor="white",
                edgecolor=colour,
                linewidth=1.6,
            )
        )
        middle = x + 0.5 * width
        axes.text(middle, y + 5.0, name, ha="center", va="center", color=INK, fontsize=10.5)
        axes.text(middle, y + 2.1, content, ha="center", va="center", color=GREY, fontsize=7.6)
        if addition:
            note = f"+ your {addition}"
            axes.text(x + width, y - 1.6, note, ha="right", va="center", color=BLUE, fontsize=7.6)
    axes.text(82.3, 46.5, "+ your task", ha="right", va="center", color=BLUE, fontsize=7.6)
    line = {"color": INK, "linewidth": 1.1}
    flows = (
        ((13.0, 28.3), (31.6, 37.0), "perceive"),
        ((23.4, 39.7), (31.6, 39.7), ""),
        ((52.4, 39.7), (60.6, 39.7), ""),
        ((52.4, 26.5), (62.0, 35.6), ""),
        ((42.0, 35.6), (42.0, 28.4), ""),
        ((69.0, 35.6), (69.0, 28.4), "advance"),
        ((69.0, 51.6), (69.0, 43.9), ""),
        ((13.0, 16.6), (13.0, 20.1), ""),
        ((83.8, 31.7), (86.7, 31.7), ""),
        ((13.0, 51.6), (13.0, 49.3), ""),
        ((42.0, 51.6), (42.0, 49.3), ""),
        *(((x, 13.7), (x, 9.9), "") for x in (13.0, 42.0, 71.5)),
    )
    for start, end, label in flows:
        arrow = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, **line}
        axes.annotate("", end, start, arrowprops=arrow)
        if label:
            box = {"facecolor": "#f3f5f8", "edgecolor": "none", "pad": 1.2}
            x, y = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])
            axes.text(x, y, label, ha="center", va="center", fontsize=8, color=INK, bbox=box)
    axes.plot([69.0, 69.0, 13.0], [20.3, 16.6, 16.6], **line)
    axes.text(
        42.0,
        16.6,
        "state of the robot",
        ha="center",
        va="center",
        fontsize=8,
        color=INK,
        bbox={"facecolor": "#f3f5f8", "edgecolor": "none", "pad": 1.2},
    )
    return figure


def generated_maps() -> Figure:
    """Draw an easy and a hard map of each kind, and where a robot starts."""
    figure, axes = plt.subplots(4, 4, figsize=(8.4, 7.0), layout="constrained")
    places = np.moveaxis(axes.reshape(2, 2, 4), 1, -1).reshape(-1, 2)
    for axis in places[len(KINDS) :].reshape(-1):
        axis.set_axis_off()
    for kind, pair in zip(KINDS, places, strict=False):
        for difficulty, axis in zip((0.2, 0.9), pair, strict=True):
            grid = generate_map(kind, 1, difficulty=difficulty)
            height, width = (side * grid.resolution for side in grid.shape)
            free = float(np.count_nonzero(grid.is_free)) * grid.resolution**2
            axis.imshow(
                grid.probability,
                origin="lower",
                extent=(0.0, width, 0.0, height),
                cmap="gray_r",
            )
            x, y, _ = jx.start_pose(grid)
            axis.plot(x, y, ">", color=VERMILION, markeredgecolor="white", markersize=6)
            axis.set(xticks=[], yticks=[])
            axis.set_title(f"{kind}, {difficulty:g}", loc="left")
            axis.set_xlabel(f"{width:.0f} m x {height:.0f} m, {free:.0f} m² free", fontsize=8)
    return figure


if __name__ == "__main__":
    main()
