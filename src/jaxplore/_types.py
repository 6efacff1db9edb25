"""Name the array types that signatures use, with their shapes.

Shape letters: K samples, T horizon, nx and nu state and control sizes, H and W rows and columns
of a map, B beams, D directions, N any other count.
"""

from collections.abc import Sequence

from jax import Array
from jax.typing import ArrayLike as _ArrayLike
from jaxtyping import Bool, Float, Int, PRNGKeyArray

Scalar = Float[Array, ""]
Flag = Bool[Array, ""]
Count = Int[Array, ""]
Position = Float[Array, "2"]
Pose = Float[Array, "3"]
Twist = Float[Array, "3"]
GridValues = Float[Array, "H W"]
GridMask = Bool[Array, "H W"]
StateVector = Float[Array, "nx"]
ControlVector = Float[Array, "nu"]
Key = PRNGKeyArray
# Signatures and tooltips show the name of an alias, and would show all parts of a plain union.
type ArrayLike = _ArrayLike
"""A number or an array: Python's, NumPy's or JAX's."""
type Vector = ArrayLike | Sequence[float | int]
"""A few numbers written by hand: a list, a tuple or an array."""
type Rows = ArrayLike | Sequence[Vector]
"""Rows of numbers written by hand: nested lists, tuples or an array."""
