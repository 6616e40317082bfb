"""Impacts as functions of JAX, by callbacks, with derivatives in forward and reverse mode.

They can be transformed by `jax.jit`, `jax.vmap`, `jax.grad`, `jax.jacfwd` and `jax.jacrev`; there are no
second derivatives. Arguments are broadcast to a common leading shape (...), in double precision. Rows without
a solution and derivatives that do not exist (`Boundary`) are NaN. In forward mode one of them makes the whole
row NaN, as 0 · NaN is NaN; reverse mode returns the others. (docs/derivatives.md, 7)
"""

from __future__ import annotations

from typing import Any

from ..errors import InputError
from ._rows import ContactRows, RobotRows, RowFunctions, refuse_single_precision

try:
    import jax
    import jax.numpy as jnp
    from jax.custom_derivatives import SymbolicZero
except ImportError as error:
    raise InputError("jax: not installed; pip install 'pinimpact[jax]'", value=None) from error

REMEDY = 'call jax.config.update("jax_enable_x64", True) first'


def _call(rows: ContactRows | RobotRows, *given: Any) -> tuple[jax.Array, ...]:
    arrays = tuple(map(_array, given))
    for name, array in zip(rows.names, arrays, strict=True):
        refuse_single_precision(array.dtype, name, REMEDY)
    sizes = rows.outputs([array.shape for array in arrays])
    parts = [array.ndim - n for array, n in zip(arrays, rows.inputs, strict=True)]
    lead = jnp.broadcast_shapes(*(array.shape[:k] for array, k in zip(arrays, parts, strict=True)))
    # `jax.vmap` adds an axis in front of each argument, so all must have the same leading axes
    arrays = tuple(
        jnp.broadcast_to(array, lead + array.shape[k:]) for array, k in zip(arrays, parts, strict=True)
    )

    def shaped(*own: tuple[int, ...]) -> tuple[Any, ...]:
        return tuple(jax.ShapeDtypeStruct((*lead, *shape), jnp.float64) for shape in own)

    @jax.custom_jvp
    def call(*arrays: Any) -> tuple[Any, ...]:
        outputs = shaped(*((size,) for size in sizes))
        return jax.pure_callback(rows.values, outputs, *arrays, vmap_method="broadcast_all")

    def call_with_slopes(primals: Any, tangents: Any) -> tuple[Any, Any]:
        own = [array.shape[array.ndim - n :] for array, n in zip(primals, rows.inputs, strict=True)]
        shapes = [(size, *shape) for size in sizes for shape in own]
        found = jax.pure_callback(
            rows.slopes,
            shaped(*((size,) for size in sizes), *shapes),
            *primals,
            vmap_method="broadcast_all",
        )
        values, slopes = found[: len(sizes)], found[len(sizes) :]
        count = len(primals)
        changes = []
        for value, k in zip(values, range(0, len(slopes), count), strict=True):
            change = jnp.zeros_like(value)
            for slope, tangent, n in zip(slopes[k : k + count], tangents, rows.inputs, strict=True):
                if not isinstance(tangent, SymbolicZero):  # else NaN by another argument would be added
                    change += _product(slope, tangent, n)
            changes.append(change)
        return values, tuple(changes)

    call.defjvp(call_with_slopes, symbolic_zeros=True)
    return call(*arrays)


def _array(value: Any) -> jax.Array:
    """Return an array; whole numbers become floating-point numbers."""
    array = jnp.asarray(value)
    return array.astype(float) if jnp.issubdtype(array.dtype, jnp.integer) else array


def _product(slope: Any, change: Any, axes: int) -> Any:
    """Return the change (..., m) of an output from its derivative (..., m, *own) and a change (..., *own)."""
    letters = "ij"[:axes]
    return jnp.einsum(f"...m{letters},...{letters}->...m", slope, change)


_functions: RowFunctions[jax.Array] = RowFunctions(_call)
solve_impacts, impact = _functions.solve_impacts, _functions.impact
