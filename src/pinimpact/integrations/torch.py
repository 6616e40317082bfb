"""Impacts as functions of PyTorch, with gradients.

They are computed on the CPU; results are on the device of the velocities. There are no second derivatives.
Arguments are broadcast to a common leading shape (...), in double precision. Rows without a solution and
derivatives that do not exist (`Boundary`) are NaN. (docs/derivatives.md, 7)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from ._rows import ContactRows, RobotRows, RowFunctions, refuse_single_precision

try:
    import torch
    from torch.autograd.function import once_differentiable
except ImportError as error:
    raise InputError("torch: not installed; pip install 'pinimpact[torch]'", value=None) from error

REMEDY = "convert it by .double()"


def _call(rows: ContactRows | RobotRows, *given: Any) -> tuple[torch.Tensor, ...]:
    tensors = []
    for name, value in zip(rows.names, given, strict=True):
        # Python numbers are converted to double precision
        tensor = value if isinstance(value, torch.Tensor) else torch.as_tensor(np.asarray(value, dtype=float))
        refuse_single_precision(tensor.dtype, name, REMEDY)
        tensors.append(tensor)
    rows.outputs([tuple(tensor.shape) for tensor in tensors])
    found: tuple[torch.Tensor, ...] = _Rows.apply(rows, *tensors)
    return found


class _Rows(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rows: ContactRows | RobotRows, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        device = tensors[1].device
        arrays = [tensor.detach().cpu().numpy() for tensor in tensors]
        wanted = any(ctx.needs_input_grad)
        found = [torch.from_numpy(x) for x in (rows.slopes if wanted else rows.values)(*arrays)]
        ctx.axes, ctx.shapes = rows.inputs, [(tensor.shape, tensor.device) for tensor in tensors]
        outputs = len(found) // (1 + len(tensors)) if wanted else len(found)
        ctx.slopes = found[outputs:]
        return tuple(value.to(device) for value in found[:outputs])

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        count = len(ctx.shapes)
        results: list[torch.Tensor | None] = [None]
        for i, ((shape, device), axes) in enumerate(zip(ctx.shapes, ctx.axes, strict=True)):
            if not ctx.needs_input_grad[i + 1]:
                results.append(None)
                continue
            letters = "ij"[:axes]
            parts = (
                torch.einsum(f"...m,...m{letters}->...{letters}", g.cpu(), slope)
                for g, slope in zip(gradients, ctx.slopes[i::count], strict=True)
            )
            results.append(sum(parts).sum_to_size(shape).to(device))
        return tuple(results)


_functions: RowFunctions[torch.Tensor] = RowFunctions(_call)
solve_impacts, impact = _functions.solve_impacts, _functions.impact
