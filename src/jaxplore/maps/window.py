"""A box of cells of a map, so that what changes around the robot costs no whole map."""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Int

from jaxplore._types import Position
from jaxplore.maps.frame import GridFrame


class Window(eqx.Module):
    """A box of cells of a map of n axes. Its shape is static, and its place may be traced.

    A map that is no larger than the window is the window: nothing is cut out then. `corner` is the
    first cell, such as (row, column). `map_shape` is the shape of the map's arrays.
    """

    corner: Int[Array, " n"]
    shape: tuple[int, ...] = eqx.field(static=True)
    map_shape: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def at(
        cls, corner: Int[Array, " n"], shape: Sequence[int], map_shape: tuple[int, ...]
    ) -> "Window":
        """Return a window of a map with a first cell; at the border of the map it is moved inwards.

        Along each axis it has no more cells than the map. Both shapes are static.
        """
        sizes = tuple(min(own, size) for own, size in zip(shape, map_shape, strict=True))
        farthest = np.subtract(map_shape, sizes).astype(np.int32)
        return cls(jnp.clip(corner, 0, farthest), sizes, map_shape)

    @classmethod
    def around(
        cls, position: Position, reach: float, frame: GridFrame, map_shape: tuple[int, int]
    ) -> "Window":
        """Return the window that holds all cells of the map within `reach` [m] of a position.

        Around a position that is not finite it is anywhere. `reach` and `map_shape` are static.
        """
        # One cell more: a reading at the greatest range is taken to lie behind it (`Sensor.sight`).
        cells = math.ceil(reach / frame.resolution) + 1
        return cls.at(frame.to_cell(position) - cells, [2 * cells + 1] * 2, map_shape)

    def grow(self, margin: int) -> "Window":
        """Return the window with `margin` cells (static) more on each side, within the map."""
        shape = [size + 2 * margin for size in self.shape]
        return Window.at(self.corner - margin, shape, self.map_shape)

    @property
    def is_inner(self) -> Bool[Array, "n 2"]:
        """Whether the low and the high face across each axis lie inside the map."""
        ends = self.corner + np.asarray(self.shape, np.int32)
        return jnp.stack([self.corner > 0, ends < np.asarray(self.map_shape)], axis=1)

    def relative_to(self, outer: "Window") -> "Window":
        """Return this window as one of the part of a larger window."""
        return Window(self.corner - outer.corner, self.shape, outer.shape)

    def read(self, values: Array) -> Array:
        """Return the part of an array whose last axes are those of the map."""
        if self.shape == self.map_shape:
            return values
        leading = self._batch_shape(values)
        return jax.lax.dynamic_slice(values, self._start(leading), (*leading, *self.shape))

    def write(self, values: Array, part: Array) -> Array:
        """Return an array, whose last axes are those of the map, with another part."""
        if self.shape == self.map_shape:
            return part
        return jax.lax.dynamic_update_slice(values, part, self._start(self._batch_shape(values)))

    def _batch_shape(self, values: Array) -> tuple[int, ...]:
        return values.shape[: values.ndim - len(self.shape)]

    def _start(self, leading: tuple[int, ...]) -> tuple[Array | int, ...]:
        return (*(0 for _ in leading), *(self.corner[axis] for axis in range(len(self.shape))))


def read_first(window: Window, values: Array) -> tuple[Array, Array]:
    """Return the part of an array in a window, and the array to go on with.

    The part is read before the array that is returned changes. A compiler that reads it later, from
    the array before its change, must copy the array, however small the window is.
    """
    barrier = jax.lax.optimization_barrier
    part, same = barrier((window.read(values), values))  # type: ignore[no-untyped-call]
    return part, same


def near_faces(
    shape: Sequence[int], which: Bool[Array, "n 2"], width: int
) -> Bool[Array, "*shape"]:
    """Return the mask of the cells of a box that are within `width` cells of some of its faces.

    `which` tells whether the low and the high face across each axis count.
    """
    near = jnp.zeros(shape, bool)
    for axis, size in enumerate(shape):
        along = jnp.arange(size)
        low = (along < width) & which[axis, 0]
        high = (along >= size - width) & which[axis, 1]
        near = near | jnp.expand_dims(low | high, [a for a in range(len(shape)) if a != axis])
    return near
