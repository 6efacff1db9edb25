"""Array aliases with shapes, used in every signature.

Shape letters: K samples, T horizon, nx and nu state and control sizes, H and W rows and columns
of a map, B beams, D directions, N anything else that comes in numbers.
"""

from collections.abc import Sequence

from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float, Int, PRNGKeyArray

Scalar = Float[Array, ""]
Flag = Bool[Array, ""]
Count = Int[Array, ""]
Position = Float[Array, "2"]
Pose = Float[Array, "3"]
GridValues = Float[Array, "H W"]
GridMask = Bool[Array, "H W"]
StateVector = Float[Array, "nx"]
ControlVector = Float[Array, "nu"]
Key = PRNGKeyArray
Vector = ArrayLike | Sequence[float | int]
"""What is accepted where a few numbers are given by hand."""
Rows = ArrayLike | Sequence[Vector]
"""What is accepted where rows of numbers are given by hand."""
