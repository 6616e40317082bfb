"""Taking instructions whose values nobody uses out of LLVM's intermediate code before it is written down."""

from __future__ import annotations

from typing import Any

from llvmlite.ir import instructions

_PURE = (
    instructions.InsertValue,
    instructions.ExtractValue,
    instructions.CastInstr,
    instructions.CompareInstr,
    instructions.SelectInstr,
    instructions.GEPInstr,
    instructions.LoadInstr,
)
_SUMS = frozenset({"add", "sub", "mul", "and", "or", "xor", "fadd", "fsub", "fmul", "fneg"})


def _is_pure(value: Any) -> bool:
    return isinstance(value, _PURE) or getattr(value, "opname", None) in _SUMS


def remove_unused(module: Any) -> None:
    """Remove instructions that only make a value that nobody uses."""
    for function in module.functions:
        uses: dict[int, int] = {}
        found = [one for block in function.blocks for one in block.instructions]
        for one in found:
            if type(one) is instructions.PhiInstr:
                operands = [value for value, _ in one.incomings]
            else:
                operands = one.operands
            for operand in operands:
                uses[id(operand)] = uses.get(id(operand), 0) + 1
        waiting = [one for one in found if id(one) not in uses and _is_pure(one)]
        unused = set()
        while waiting:
            one = waiting.pop()
            unused.add(id(one))
            for operand in one.operands:
                uses[id(operand)] -= 1
                if (
                    not uses[id(operand)]
                    and isinstance(operand, instructions.Instruction)
                    and _is_pure(operand)
                ):
                    waiting.append(operand)
        if unused:
            for block in function.blocks:
                block.instructions = [one for one in block.instructions if id(one) not in unused]
