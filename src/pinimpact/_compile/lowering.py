"""From typed code to LLVM's intermediate code, on short ways for what kernels are full of.

numba writes 30 to 100 instructions for an element of an array or the head of a loop over a range, with memory
of its own for each array that it looks at, and counts references to arrays that others hold. LLVM takes most
of that away again, but to write it down, to parse it and to take it away is a third of the time that kernels
take to compile. What is short here means the same; all else goes numba's way.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir as llvm_ir
from numba import core
from numba.core import analysis, cgutils, ir, lowering

from . import short_calls
from .arguments import (
    ARRAY,
    DATA,
    ITEMSIZE,
    MEMINFO,
    NITEMS,
    PARENT,
    SHAPE,
    STRIDES,
    counted,
    has_fields,
    lent_arguments,
)
from .short_calls import is_index

errors: Any = core.errors  # no stub tells all that is in them
types: Any = core.types

_RANGE = ("start", "stop", "step")
_RANGE_ITERATOR = ("iter", "stop", "step", "count")

_REFERENCE = types.MemInfoPointer(types.voidptr)

_INTEGER, _REAL = llvm_ir.IntType(64), llvm_ir.DoubleType()

_SUMS = {operator.add: "add", operator.sub: "sub", operator.mul: "mul"}
_COMPARISONS = {
    operator.lt: "<",
    operator.le: "<=",
    operator.gt: ">",
    operator.ge: ">=",
    operator.eq: "==",
    operator.ne: "!=",
}


def _reached(graph: Any, place: int) -> set[int]:
    """Return the blocks that control may come to after one."""
    found: set[int] = set()
    waiting = [place]
    while waiting:
        for one, _ in graph.successors(waiting.pop()):
            if one not in found:
                found.add(one)
                waiting.append(one)
    return found


def _is_number(kind: Any) -> bool:
    return kind is types.float64 or is_index(kind)


def _constant(value: Any) -> int | None:
    """Return a value of LLVM's if it is a number that is known."""
    known = isinstance(value, llvm_ir.Constant) and isinstance(value.constant, int)
    return value.constant if known else None


def parts(builder: Any, value: Any, count: int) -> list[Any]:
    """Return the parts of an aggregate: as they were put in, where that is seen."""
    found: list[Any] = [None] * count
    made = value
    while isinstance(made, llvm_ir.instructions.InsertValue) and len(made.indices) == 1:
        if found[made.indices[0]] is None:
            found[made.indices[0]] = made.operands[1]
        made = made.operands[0]
    return [builder.extract_value(value, k) if part is None else part for k, part in enumerate(found)]


def aggregate(context: Any, builder: Any, kind: Any, values: Iterable[tuple[Any, Any]]) -> Any:
    """Return a structure of numba's, of fields by their places and what goes there."""
    made = llvm_ir.Constant(context.get_value_type(kind), llvm_ir.Undefined)
    for place, value in values:
        made = builder.insert_value(made, value, place)
    return made


def view(
    context: Any,
    builder: Any,
    kind: Any,
    owner: tuple[Any, Any],
    itemsize: Any,
    data: Any,
    shape: list[Any],
    strides: list[Any],
) -> Any:
    """Return an array of a type `kind` over memory of others, whose `owner` is its `meminfo` and `parent`."""
    count = shape[0]
    for length in shape[1:]:
        count = builder.mul(count, length, flags=["nsw"])
    return aggregate(
        context,
        builder,
        kind,
        [
            (MEMINFO, owner[0]),
            (PARENT, owner[1]),
            (NITEMS, count),
            (ITEMSIZE, itemsize),
            (DATA, data),
            *(((SHAPE, k), length) for k, length in enumerate(shape)),
            *(((STRIDES, k), stride) for k, stride in enumerate(strides)),
        ],
    )


class Lowering(lowering.Lower):
    """Lowering on short ways, without a thought of the references of what has none."""

    def init(self) -> None:
        """Take arguments as kernels hand them over."""
        super().init()
        if not self.func_ir.func_id.is_generator:
            models = self.context.data_model_manager
            self.fndesc.argtypes = lent_arguments(models, self.fndesc.argtypes, self.fndesc.restype)

    def _find_singly_assigned_variable(self) -> None:
        """Find the variables that need no memory of their own, and the arrays that need no count, or one."""
        self._debugged = self._disable_sroa_like_opt
        self._unowned: set[str] = set()
        self._held: dict[str, int] = {}
        self._let_go: dict[int, list[str]] = {}
        self._to_unowned = False
        if self._debugged or self.func_ir.func_id.is_generator:
            super()._find_singly_assigned_variable()
            return
        blocks = self.func_ir.blocks
        values: dict[str, list[Any]] = {}
        places: dict[str, int] = {}
        for offset, block in blocks.items():
            for inst in block.find_insts(ir.Assign):
                values.setdefault(inst.target.name, []).append(inst.value)
                places[inst.target.name] = offset
        uses = self.func_ir.variable_lifetime.usedefs.usemap
        used: dict[str, int] = {}  # where another block than the one that assigns a variable uses it
        for offset, others in uses.items():
            for name in others:
                used[name] = min(offset, used.get(name, offset))
        self._blk_local_varmap: dict[str, Any] = {}
        self._singly_assigned_vars = {
            name for name, given in values.items() if len(given) == 1 and name not in used
        }
        self._unowned = self._find_unowned(values)
        self._held = self._find_held(values, places, uses)
        if self._held:
            self._unowned = self._find_unowned(values)
        first = min(blocks)
        if any(first in block.terminator.get_targets() for block in blocks.values()):
            return
        for name, given in values.items():
            # assigned once, and before all that uses it: on Python's stack, or where the function begins
            before = places[name] < used.get(name, math.inf) and (name[0] == "$" or places[name] == first)
            if len(given) == 1 and before and not self._is_counted(name):
                self._singly_assigned_vars.add(name)

    def _is_counted(self, name: str) -> bool:
        """Whether references to what a variable holds are counted."""
        return name not in self._unowned and counted(self.context.data_model_manager, self.typeof(name))

    def _find_held(
        self, values: dict[str, list[Any]], places: dict[str, int], uses: dict[int, set[str]]
    ) -> dict[str, int]:
        """Return the arrays, and tuples of them, that can as well be held until the function returns.

        Each is made once, at the place that comes with it, and nothing uses it, nor returns after it, but by
        way of there.

        Args:
            values: What each variable is assigned.
            places: Where it is assigned.
            uses: What each block uses of other blocks.
        """
        blocks = self.func_ir.blocks
        deleted = {inst.value for block in blocks.values() for inst in block.find_insts(ir.Del)}
        found = {
            name: places[name]
            for name in sorted(deleted - self._singly_assigned_vars - self._unowned)
            if isinstance(self.typeof(name), (types.Array, types.BaseTuple))
            and self._is_counted(name)
            and len(values.get(name, ())) == 1
        }
        if not found:
            return found
        graph = analysis.compute_cfg_from_blocks(blocks)
        inside = {offset for loop in graph.loops().values() for offset in loop.body}
        before = graph.dominators()
        ends = [offset for offset, block in blocks.items() if isinstance(block.terminator, ir.Return)]
        users: dict[str, list[int]] = {name: [] for name in found}
        for offset, names in uses.items():
            for name in found.keys() & set(names):
                users[name].append(offset)

        def leads(place: int, offset: int) -> bool:
            return place < offset and place in before.get(offset, ())

        for name, place in [*found.items()]:
            if place in inside or place in ends:
                del found[name]
                continue
            after = _reached(graph, place).intersection(ends)
            if not all(leads(place, offset) for offset in (*users[name], *after)):
                del found[name]
        for end in ends:
            held = [name for name, place in found.items() if leads(place, end)]
            self._let_go[id(blocks[end].terminator)] = held
        return found

    def _find_unowned(self, values: dict[str, list[Any]]) -> set[str]:
        """Return the arrays, and tuples of them, that need no count of references, for others outlive them.

        They are arguments, what is `held`, items of such tuples, the views that a type `lends`, and rows of
        such arrays.

        Args:
            values: What each variable is assigned.
        """
        found = {name for name in values if isinstance(self.typeof(name), (types.Array, types.BaseTuple))}

        def lasts(name: str) -> bool:
            return name in found or name in self._held

        def lent(name: str, value: Any) -> bool:
            kind = self.typeof(name)
            if name in self._held:
                return False
            if isinstance(value, ir.Arg):
                return self.typeof(f"arg.{value.name}") == kind
            if isinstance(value, ir.Var):
                return lasts(value.name) and self.typeof(value.name) == kind
            if not isinstance(value, ir.Expr) or value.op not in ("getattr", "getitem", "static_getitem"):
                return False
            owner = self.typeof(value.value.name)
            if isinstance(owner, types.BaseTuple):
                return lasts(value.value.name) and self._place_in(kind, owner, value) is not None
            if value.op == "getattr":
                return getattr(owner, "lends", False)
            index = value.index if value.op == "getitem" else value.index_var
            if not lasts(value.value.name) or index is None:
                return False
            return self.fndesc.calltypes[value].return_type == kind and self._is_row(kind, owner, index)

        while owned := {name for name in found if not all(lent(name, value) for value in values[name])}:
            found -= owned
        return found

    def _counted(self, kind: Any) -> bool:
        return counted(self.context.data_model_manager, kind)

    def _has(self, kind: Any, fields: tuple[str, ...]) -> bool:
        return has_fields(self.context.data_model_manager, kind, fields)

    def incref(self, typ: Any, val: Any) -> None:
        """Count one more reference."""
        if isinstance(typ, types.Array) and self._has(typ, ARRAY):
            super().incref(_REFERENCE, self.builder.extract_value(val, MEMINFO))
        elif self._counted(typ):
            super().incref(typ, val)

    def decref(self, typ: Any, val: Any) -> None:
        """Count one less."""
        if isinstance(typ, types.Array) and self._has(typ, ARRAY):
            super().decref(_REFERENCE, self.builder.extract_value(val, MEMINFO))
        elif self._counted(typ):
            super().decref(typ, val)

    def delvar(self, name: str) -> None:
        """End the life of a variable."""
        if self._debugged or (self._is_counted(name) and name not in self._held):
            super().delvar(name)

    def storevar(self, value: Any, name: str, argidx: int | None = None) -> None:
        """Give a variable a value."""
        if name in self._held:
            self._blk_local_varmap[name] = value
        elif self._debugged or self._is_counted(name):
            super().storevar(value, name, argidx)
        elif name in self._singly_assigned_vars:
            self._blk_local_varmap[name] = value
        else:
            self.builder.store(value, self.getvar(name))

    def lower_block(self, block: Any) -> None:
        """Lower a block of instructions."""
        self.pre_block(block)
        try:
            for inst in block.body:
                self.loc = inst.loc
                self.lower_inst(inst)
        except Exception:
            where = partial(errors.LoweringError, loc=self.loc)
            with errors.new_error_context(
                'lowering "{inst}" at {loc}', inst=inst, loc=self.loc, errcls_=where
            ):
                raise
        self.post_block(block)

    def lower_inst(self, inst: Any) -> None:
        """Lower one instruction."""
        if type(inst) is ir.Assign and not self._debugged:
            name, value = inst.target.name, inst.value
            self._to_unowned = name in self._unowned
            if self._to_unowned and isinstance(value, ir.Arg):
                self.storevar(self.fnargs[value.index], name)
            elif self._to_unowned and isinstance(value, ir.Var):
                self.storevar(self.loadvar(value.name), name)
            else:
                self.storevar(self.lower_assign(self.typeof(name), inst), name)
        elif type(inst) is ir.Del and not self._debugged:
            self.delvar(inst.value)
        else:
            if type(inst) is ir.Return:
                for name in self._let_go.get(id(inst), ()):
                    self.decref(self.typeof(name), self.loadvar(name))
            super().lower_inst(inst)

    def lower_expr(self, resty: Any, expr: Any) -> Any:
        """Lower an expression."""
        short = _SHORT.get(expr.op)
        if short is not None:
            found = short(self, resty, expr)
            if found is not None:
                return found
        return super().lower_expr(resty, expr)

    def lower_getitem(self, resty: Any, expr: Any, value: Any, index: Any, signature: Any) -> Any:
        """Lower what reads an item."""
        found = None
        kind = self.typeof(value.name)
        if isinstance(kind, types.Array) and signature.return_type == resty:
            found = self._item(resty, kind, value, index)
        return super().lower_getitem(resty, expr, value, index, signature) if found is None else found

    def lower_setitem(self, target_var: Any, index_var: Any, value_var: Any, signature: Any) -> None:
        """Lower what sets an item."""
        kind = self.typeof(target_var.name)
        count = self._integers(kind, index_var)
        if not count or count < kind.ndim:
            super().lower_setitem(target_var, index_var, value_var, signature)
            return
        value = self.context.cast(
            self.builder, self.loadvar(value_var.name), self.typeof(value_var.name), kind.dtype
        )
        self.builder.store(value, self._place(kind, self.loadvar(target_var.name), self._indices(index_var)))

    # ---- arrays

    def _integers(self, kind: Any, index: Any) -> int:
        """Return how many integers an index into an array of numbers consists of; 0 for others."""
        number = isinstance(kind, types.Array) and kind.dtype in (types.float64, types.int64)
        if not number or kind.layout == "A" or not kind.aligned or not self._has(kind, ARRAY):
            return 0
        form = self.typeof(index.name)
        count = 1 if is_index(form) else 0
        if isinstance(form, types.BaseTuple) and all(map(is_index, form.types)):
            count = len(form)
        return 0 if self.context.enable_boundscheck or count > kind.ndim else count

    def _is_row(self, resty: Any, kind: Any, index: Any) -> bool:
        return 0 < self._integers(kind, index) < kind.ndim and kind.layout == resty.layout == "C"

    def _indices(self, index: Any) -> list[Any]:
        """Return the values of an index of integers."""
        form = self.typeof(index.name)
        if isinstance(form, types.BaseTuple):
            return parts(self.builder, self.loadvar(index.name), len(form))
        return [self._loaded(index, form)]

    def _loaded(self, variable: Any, form: Any) -> Any:
        if isinstance(form, types.IntegerLiteral):
            return _INTEGER(form.literal_value)
        return self.loadvar(variable.name)

    def _place(self, kind: Any, array: Any, indices: list[Any]) -> Any:
        """Return where an item or a row of an array begins."""
        builder = self.builder
        lengths = [builder.extract_value(array, (SHAPE, k)) for k in range(kind.ndim)]
        inside = [self._from_start(*pair) for pair in zip(indices, lengths, strict=False)]
        places = inside + [None] * (kind.ndim - len(inside))
        order = range(kind.ndim) if kind.layout == "C" else range(kind.ndim - 1, -1, -1)
        offset = None
        for k in order:
            if offset is not None:
                offset = builder.mul(offset, lengths[k])
            if places[k] is not None:
                offset = places[k] if offset is None else builder.add(offset, places[k])
        return builder.gep(builder.extract_value(array, DATA), [offset])

    def _from_start(self, index: Any, length: Any) -> Any:
        """Return an index that counts from the start."""
        known = _constant(index)
        if known is not None and known >= 0:
            return index
        builder = self.builder
        negative = builder.icmp_signed("<", index, _INTEGER(0))
        return builder.select(negative, builder.add(index, length), index)

    def _item(self, resty: Any, kind: Any, value: Any, index: Any) -> Any:
        builder, array = self.builder, self.loadvar(value.name)
        if self._integers(kind, index) == kind.ndim:
            return builder.load(self._place(kind, array, self._indices(index)))
        if not isinstance(resty, types.Array) or not self._is_row(resty, kind, index):
            return None
        indices = self._indices(index)
        left = range(len(indices), kind.ndim)
        row = view(
            self.context,
            builder,
            resty,
            (builder.extract_value(array, MEMINFO), builder.extract_value(array, PARENT)),
            builder.extract_value(array, ITEMSIZE),
            self._place(kind, array, indices),
            [builder.extract_value(array, (SHAPE, k)) for k in left],
            [builder.extract_value(array, (STRIDES, k)) for k in left],
        )
        if not self._to_unowned:
            self.incref(resty, row)
        return row

    def _attribute(self, resty: Any, expr: Any) -> Any:
        kind = self.typeof(expr.value.name)
        if expr.attr == "shape" and isinstance(kind, types.Array) and self._has(kind, ARRAY):
            return self.builder.extract_value(self.loadvar(expr.value.name), SHAPE)
        return self._known_item(resty, expr)

    # ---- tuples

    def _place_in(self, resty: Any, kind: Any, expr: Any) -> int | None:
        """Return the place in a tuple of what an expression reads of it, None where it is not known."""
        if not isinstance(kind, types.BaseTuple):
            return None
        place = None
        if expr.op == "static_getitem":
            place = expr.index
        elif expr.op == "getattr" and isinstance(kind, types.BaseNamedTuple) and expr.attr in kind.fields:
            place = kind.fields.index(expr.attr)
        known = isinstance(place, int) and -len(kind) <= place < len(kind) and kind.types[place] == resty
        return place if known else None

    def _known_item(self, resty: Any, expr: Any) -> Any:
        kind = self.typeof(expr.value.name)
        place = self._place_in(resty, kind, expr)
        if place is None:
            return None
        found = parts(self.builder, self.loadvar(expr.value.name), len(kind))[place]
        if not self._to_unowned:
            self.incref(resty, found)
        return found

    def _of_pair(self, resty: Any, expr: Any, which: int) -> Any:
        if not self._has(self.typeof(expr.value.name), ("first", "second")):
            return None
        found = parts(self.builder, self.loadvar(expr.value.name), 2)[which]
        self.incref(resty, found)
        return found

    # ---- loops over ranges

    def _start_loop(self, resty: Any, expr: Any) -> Any:
        """Lower the start of a loop: what it counts, and how often it is still to run, in memory."""
        known = resty == types.range_iter64_type and self._has(resty, _RANGE_ITERATOR)
        if not known or not self._has(self.typeof(expr.value.name), _RANGE):
            return None
        builder = self.builder
        start, stop, step = parts(builder, self.loadvar(expr.value.name), 3)
        if _constant(step) not in (1, -1):
            return None
        count = builder.sub(*((stop, start) if _constant(step) == 1 else (start, stop)))
        return aggregate(
            self.context, builder, resty, enumerate((self._kept(start), stop, step, self._kept(count)))
        )

    def _kept(self, value: Any) -> Any:
        place = cgutils.alloca_once(self.builder, _INTEGER)
        self.builder.store(value, place)
        return place

    def _next_of_loop(self, resty: Any, expr: Any) -> Any:
        kind = self.typeof(expr.value.name)
        if kind != types.range_iter64_type or not self._has(kind, _RANGE_ITERATOR):
            return None
        builder, iterator = self.builder, self.loadvar(expr.value.name)
        place, step, left = (builder.extract_value(iterator, k) for k in (0, 2, 3))
        value, count = builder.load(place), builder.load(left)
        builder.store(builder.add(value, step), place)
        builder.store(builder.sub(count, _INTEGER(1), flags=["nsw"]), left)
        pair = value, builder.icmp_signed(">", count, _INTEGER(0))
        return aggregate(self.context, builder, resty, enumerate(pair))

    # ---- calls and sums

    def _call(self, resty: Any, expr: Any) -> Any:
        called = getattr(self.typeof(expr.func.name), "typing_key", None)
        if expr.vararg:
            return None
        kinds = [self.typeof(one.name) for one in expr.args]
        known = short_calls.signature(called, kinds, {name: self.typeof(one.name) for name, one in expr.kws})
        if known is not None:
            found = self._known_call(called, known.return_type, expr, kinds)
            return self.context.cast(self.builder, found, known.return_type, resty)
        if called == "array.reshape" and not expr.kws:
            return self._reshaped(resty, self.typeof(expr.func.name).this, expr)
        if called not in (range, len, bool) or expr.kws:
            return None
        if called is len:
            if isinstance(kinds[0], types.Array) and kinds[0].ndim and self._has(kinds[0], ARRAY):
                return self.builder.extract_value(self.loadvar(expr.args[0].name), (SHAPE, 0))
        elif called is bool:
            if kinds[0] == types.boolean:
                return self.loadvar(expr.args[0].name)
        elif resty == types.range_state64_type and all(map(is_index, kinds)):
            numbers = self._numbers(expr.args, kinds)
            if len(numbers) == 1:
                numbers.insert(0, _INTEGER(0))
            if len(numbers) == 2:
                numbers.append(_INTEGER(1))
            return aggregate(self.context, self.builder, resty, enumerate(numbers))
        return None

    def _numbers(self, variables: Any, kinds: Any) -> list[Any]:
        return [self._loaded(*pair) for pair in zip(variables, kinds, strict=True)]

    def _known_call(self, called: Any, result: Any, expr: Any, kinds: list[Any]) -> Any:
        """Lower a call whose types `short_calls` knows."""
        if called is max or called is min:
            return short_calls.extreme(self.builder, called, result, self._numbers(expr.args, kinds))
        if called is int:
            return self.context.cast(self.builder, self.loadvar(expr.args[0].name), kinds[0], result)
        return self._new_array(result, self._indices(expr.args[0]), called is np.zeros)

    def _new_array(self, kind: Any, shape: list[Any], zero: bool) -> Any:
        """Return a new array."""
        context, builder = self.context, self.builder
        width = _INTEGER(context.get_abi_sizeof(context.get_data_type(kind.dtype)))
        strides = [width]
        for length in shape[:0:-1]:
            strides.append(builder.mul(strides[-1], length))
        size = builder.mul(strides[-1], shape[0])
        align = context.get_preferred_array_alignment(kind.dtype)
        meminfo = context.nrt.meminfo_alloc_aligned(builder, size, context.get_constant(types.uint32, align))
        data = context.nrt.meminfo_data(builder, meminfo)
        if zero:
            cgutils.memset(builder, data, size, 0)
        data = builder.bitcast(data, context.get_data_type(kind.dtype).as_pointer())
        parent = context.get_constant_null(types.pyobject)
        return view(context, builder, kind, (meminfo, parent), width, data, shape, strides[::-1])

    def _reshaped(self, resty: Any, kind: Any, expr: Any) -> Any:
        """Lower the view of a contiguous array in another shape, whose lengths are all told."""
        forms = [self.typeof(one.name) for one in expr.args]
        if len(forms) == 1 and isinstance(forms[0], types.BaseTuple):
            forms = list(forms[0].types)
        told = all(is_index(one) and getattr(one, "literal_value", 0) >= 0 for one in forms)
        if not told or not kind.layout == resty.layout == "C" or not self._has(kind, ARRAY):
            return None
        builder, array = self.builder, self.loadvar(expr.func.name)
        shape = [length for one in expr.args for length in self._indices(one)]
        itemsize = builder.extract_value(array, ITEMSIZE)
        strides, count = [itemsize], shape[-1]
        for length in shape[-2::-1]:
            strides.append(builder.mul(itemsize, count))
            count = builder.mul(count, length)
        wrong = builder.icmp_signed("!=", count, builder.extract_value(array, NITEMS))
        for length in shape:
            if _constant(length) is None:
                wrong = builder.or_(wrong, builder.icmp_signed("<", length, _INTEGER(0)))
        with builder.if_then(wrong, likely=False):
            told_wrongly = ("total size of new array must be unchanged",)
            self.call_conv.return_user_exc(
                builder, ValueError, told_wrongly, self.loc, self.func_ir.func_id.func_name
            )
        owner = builder.extract_value(array, MEMINFO), builder.extract_value(array, PARENT)
        data = builder.extract_value(array, DATA)
        found = view(self.context, builder, resty, owner, itemsize, data, shape, strides[::-1])
        self.incref(resty, found)
        return found

    def _binary(self, resty: Any, expr: Any) -> Any:
        """Lower a sum, product, quotient or comparison of two numbers of one type."""
        fn = expr.fn if expr.op == "binop" else expr.immutable_fn
        left, right = self.typeof(expr.lhs.name), self.typeof(expr.rhs.name)
        builder = self.builder
        if is_index(left) and is_index(right):
            if isinstance(left, types.IntegerLiteral) and isinstance(right, types.IntegerLiteral):
                return None
            lhs, rhs = self._loaded(expr.lhs, left), self._loaded(expr.rhs, right)
            if resty is types.int64 and fn in _SUMS:
                return getattr(builder, _SUMS[fn])(lhs, rhs, flags=["nsw"])
            if resty is types.boolean and fn in _COMPARISONS:
                return builder.icmp_signed(_COMPARISONS[fn], lhs, rhs)
        elif _is_number(left) and _is_number(right):
            if resty is types.float64 and fn in _SUMS:
                return getattr(builder, "f" + _SUMS[fn])(
                    self._real(expr.lhs, left), self._real(expr.rhs, right)
                )
            if (
                resty is types.float64
                and fn is operator.truediv
                and not self.context.error_model.raise_on_fp_zero_division
            ):
                return builder.fdiv(self._real(expr.lhs, left), self._real(expr.rhs, right))
            if resty is types.boolean and fn in _COMPARISONS:
                compare = builder.fcmp_unordered if fn is operator.ne else builder.fcmp_ordered
                return compare(_COMPARISONS[fn], self._real(expr.lhs, left), self._real(expr.rhs, right))
        return None

    def _real(self, variable: Any, kind: Any) -> Any:
        """Return the value of a number as a real one."""
        if kind is types.float64:
            return self.loadvar(variable.name)
        if isinstance(kind, types.IntegerLiteral):
            return _REAL(float(kind.literal_value))
        return self.builder.sitofp(self.loadvar(variable.name), _REAL)


_SHORT: dict[str, Any] = {
    "binop": Lowering._binary,
    "inplace_binop": Lowering._binary,
    "call": Lowering._call,
    "getattr": Lowering._attribute,
    "getiter": Lowering._start_loop,
    "iternext": Lowering._next_of_loop,
    "pair_first": partial(Lowering._of_pair, which=0),
    "pair_second": partial(Lowering._of_pair, which=1),
    "static_getitem": Lowering._known_item,
}
