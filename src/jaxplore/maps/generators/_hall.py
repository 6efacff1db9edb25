"""Generate halls and open ground, for `generate_map`: one open space with obstacles."""

import math

import numpy as np

from jaxplore.maps.generators._clutter import (
    Clutter,
    Mask,
    block,
    disc,
    interpolate,
    wall_cells,
    widest_part,
)


def hall(rng: np.random.Generator, occupied: Mask, difficulty: float, resolution: float) -> None:
    """Place discs, boxes and short walls in a hall."""
    passage = interpolate(1.6, 0.85, difficulty)
    longest = interpolate(2.0, 4.0, difficulty)
    # Short walls touch the outer wall, so they keep apart from each other only.
    stubs = Clutter(occupied, passage, resolution, is_apart=False)
    count = rng.binomial(math.ceil(sum(occupied.shape) * resolution / 2.5), 0.2 + 0.4 * difficulty)
    for _ in range(int(count)):
        piece = block(rng.uniform(0.8, longest), 0.2, 0.0, resolution)
        _put_at_wall(rng, stubs, piece)

    def draw(rng: np.random.Generator) -> Mask:
        kind = rng.random()
        if kind < 0.35:
            return disc(rng.uniform(0.3, 1.2), resolution)
        is_turned = rng.random() < 0.6
        yaw = rng.uniform(0.0, math.pi) if is_turned else int(rng.integers(2)) * math.pi / 2
        if kind < 0.75:
            return block(rng.uniform(0.4, 1.6), rng.uniform(0.3, 0.9), yaw, resolution)
        return block(rng.uniform(1.2, longest), 0.2, yaw, resolution)

    pieces = Clutter(occupied, passage, resolution, is_apart=True)
    pieces.scatter(rng, draw, interpolate(0.03, 0.2, difficulty))


def _put_at_wall(rng: np.random.Generator, clutter: Clutter, piece: Mask) -> None:
    """Place a short wall that runs from an outer wall into the hall, away from the corners."""
    across = bool(rng.integers(2))
    piece = np.ascontiguousarray(piece.T) if across else piece
    axis = 0 if across else 1
    wall, margin = wall_cells(clutter.resolution), clutter.passage
    slack = [size - side for size, side in zip(clutter.occupied.shape, piece.shape, strict=True)]
    start = [0, 0]
    start[axis] = wall if rng.random() < 0.5 else slack[axis] - wall
    start[1 - axis] = int(rng.integers(wall + margin, slack[1 - axis] - wall - margin + 1))
    clutter.put(piece, start[0], start[1])


def open_ground(
    rng: np.random.Generator, occupied: Mask, difficulty: float, resolution: float
) -> None:
    """Carve open ground with an irregular outline, and place a few pillars on it."""
    wall = wall_cells(resolution)
    height, width = occupied.shape
    y = (np.arange(height)[:, None] - (height - 1) / 2) / (height / 2 - wall)
    x = (np.arange(width)[None, :] - (width - 1) / 2) / (width / 2 - wall)
    angle = np.arctan2(y, x)
    waves = np.arange(2, 9)
    phase, size = rng.uniform(0.0, 2 * math.pi, waves.size), rng.uniform(0.4, 1.0, waves.size)
    bumps = np.zeros(occupied.shape)
    for wave, shift, high in zip(waves, phase, size, strict=True):
        bumps += high / math.sqrt(wave) * np.cos(wave * angle + shift)
    bumps = (bumps - bumps.min()) / (bumps.max() - bumps.min())
    depth = interpolate(0.15, 0.45, difficulty)
    # A superellipse, between an ellipse and a rectangle, pressed in at the bumps.
    inside = (x**4 + y**4) ** 0.25 <= 1.0 - depth * bumps
    inside[:wall] = inside[-wall:] = False
    inside[:, :wall] = inside[:, -wall:] = False
    occupied[:] = ~widest_part(inside, interpolate(0.8, 0.5, difficulty), resolution)
    pillars = Clutter(occupied, interpolate(2.0, 1.0, difficulty), resolution, is_apart=True)
    pillars.scatter(
        rng,
        lambda rng: disc(rng.uniform(0.3, 0.8), resolution),
        interpolate(0.003, 0.02, difficulty),
    )
