"""Shortcuts through numba: what it works out over and over with the same outcome, worked out once.

Most of the time that a kernel takes to compile, numba spends in Python: it looks for the type of each sum of
two floats anew, and takes care of references where there are none. While kernels are compiled (numba's own
lock keeps other threads from compiling then), these shortcuts hold. None changes what comes out.
"""

from __future__ import annotations

import dis
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from functools import cache
from types import BuiltinFunctionType
from typing import Any

from llvmlite.ir import IRBuilder, Type
from llvmlite.ir.instructions import InsertValue
from numba.core import base, byteflow, event, interpreter, ir, postproc, transforms, typeinfer
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import FunctionPass, PassManager, register_pass
from numba.core.cpu import CPUContext
from numba.core.errors import ForceLiteralArg, TypingError
from numba.core.rewrites import rewrite_registry
from numba.core.types.functions import BaseFunction
from numba.core.typing.context import Context

from . import short_calls
from .arguments import counted


def _remembering_types(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `BaseFunction.get_call_type` with a memory."""
    known: dict[Any, Any] = {}

    def get_call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
        found = short_calls.signature(self.typing_key, args, kws) if _in_kernel[-1] else None
        if found is not None:
            return found
        if kws:
            return original(self, context, args, kws)
        key = id(self), tuple(args)
        found = known.get(key)
        if found is None:
            known[key] = found = (
                original(self, context, args, kws),
                self,
                context,
            )  # they stay: ids are unique
        return found[0]

    return get_call_type


_in_kernel = [False]
"""Whether what is being compiled is a kernel, or one of numba's own functions that it calls."""


def _telling_kernels(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `CompilerBase._compile_core` that tells what it compiles."""

    def _compile_core(self: Any) -> Any:
        _in_kernel.append(getattr(self, "makes_kernels", False))
        try:
            return original(self)
        finally:
            _in_kernel.pop()

    return _compile_core


def _remembering_packers(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `BaseContext.get_arg_packer` with a memory."""
    known: dict[Any, Any] = {}

    def get_arg_packer(self: Any, arguments: Any) -> Any:
        key = self.data_model_manager, tuple(arguments)
        found = known.get(key)
        if found is None:
            known[key] = found = original(self, arguments)
        return found

    return get_arg_packer


def _remembering_declarations(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `BaseContext.declare_function` that looks first whether the module has the function."""

    def declare_function(self: Any, module: Any, fndesc: Any) -> Any:
        return module.globals.get(fndesc.mangled_name) or original(self, module, fndesc)

    return declare_function


def _remembering_sizes(original: Callable[..., int]) -> Callable[..., int]:
    """Return `Type.get_abi_size` with a memory; without, each call has LLVM parse a module."""
    known: dict[str, int] = {}

    def get_abi_size(self: Any, target_data: Any, context: Any = None) -> int:
        name = str(self)
        size = known.get(name)
        if size is None:
            known[name] = size = original(self, target_data, context)
        return size

    return get_abi_size


def _unless_lock(original: Callable[..., None]) -> Callable[..., None]:
    """Return `event.start_event` or `event.end_event` without a word of locks, which LLVM often takes."""

    def tell(kind: str, *args: Any, **kws: Any) -> None:
        if kind not in ("numba:compiler_lock", "numba:llvm_lock"):
            original(kind, *args, **kws)

    return tell


def _remembering_attributes(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `Context.find_matching_getattr_template` with a memory."""
    known: dict[Any, Any] = {}

    def find_matching_getattr_template(self: Any, typ: Any, attr: str) -> Any:
        key = self, typ, attr
        found = known.get(key)
        if found is None:
            found = original(self, typ, attr)
            if found is not None:
                known[key] = found
        return found

    return find_matching_getattr_template


# what has no variables in it
_LEAVES = frozenset({str, int, float, bool, type(None), ir.Loc, BuiltinFunctionType})


def _variables(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `Inst._rec_list_vars` with the frequent first."""

    def rec_list_vars(self: Any, value: Any) -> Any:
        if type(value) is not dict:
            return original(self, value)
        found = []
        for one in value.values():
            kind = type(one)
            if kind is ir.Var:
                found.append(one)
            elif kind not in _LEAVES:
                found += rec_list_vars(self, one._kws if kind is ir.Expr else one)
        return found

    return rec_list_vars


def _seen_through(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `IRBuilder.extract_value` that finds what has just been put into a structure."""

    def extract_value(self: Any, agg: Any, idx: Any, name: str = "") -> Any:
        path = tuple(idx) if isinstance(idx, (list, tuple)) else (idx,)
        while type(agg) is InsertValue:
            place = tuple(agg.indices)
            if place == path:
                return agg.operands[1]
            if place == path[: len(place)]:
                agg, path = agg.operands[1], path[len(place) :]
            elif path == place[: len(path)]:
                break
            else:
                agg = agg.operands[0]
        return original(self, agg, path, name)

    return extract_value


def _once(original: Callable[..., None]) -> Callable[..., None]:
    """Return `load_additional_registries` that imports and looks through all once for each context."""
    done: set[Any] = set()

    def load_additional_registries(self: Any) -> None:
        if self not in done:
            original(self)
            done.add(self)

    return load_additional_registries


def _unless_protected(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `Flow._run_handle_exception` that looks for no handler where the whole function has none."""

    def run_handle_exception(self: Any, runner: Any, state: Any) -> Any:
        if getattr(self._bytecode, "exception_entries", True):  # Python 3.10 has no table of them
            return original(self, runner, state)
        state.advance_pc()
        return None

    return run_handle_exception


def _unless_absent(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `Interpreter.post_process` that looks for `with` and for dictionaries where there are any."""
    searches = {
        interpreter.peep_hole_delete_with_exit: "WITH",
        interpreter.peep_hole_fuse_dict_add_updates: "MAP",
    }

    def post_process(self: Any, peepholes: Any, func_ir: Any) -> Any:
        there = " ".join(dis.opname[one] for one in set(self.func_id.code.co_code[::2]))
        return original(self, [one for one in peepholes if searches.get(one, "") in there], func_ir)

    return post_process


_asked: list[list[tuple[Any, Any]]] = []
"""The variables asked for, and their types then, of each constraint that is being looked at."""


def _noting(original: Callable[..., Any]) -> Callable[..., Any]:
    """Return `TypeVarMap.__getitem__` that notes what is asked for."""

    def getitem(self: Any, name: str) -> Any:
        found = self.get(name)
        if found is None:
            found = original(self, name)
        if _asked:
            _asked[-1].append((found, found.type))
        return found

    return getitem


def _propagate(self: Any, inferer: Any) -> list[Any]:
    """`ConstraintNetwork.propagate` that leaves out what would find the same as before."""
    errors: list[Any] = []
    settled: dict[int, Any] = self.__dict__.setdefault("settled", {})
    with inferer.warnings.catch_warnings():
        for place, constraint in enumerate(self.constraints):
            if place in settled and all(one.type is kind for one, kind in settled[place]):
                continue
            _asked.append([])
            try:
                constraint(inferer)
            except ForceLiteralArg as error:
                errors.append(error)
            except TypingError as error:
                errors.append(TypingError(str(error), loc=constraint.loc, highlighting=False))
            else:
                # not where what it has asked for is of another type now, as x = f(x) makes it
                if all(kind is None or one.type is kind for one, kind in _asked[-1]):
                    settled[place] = [(one, one.type) for one, _ in _asked[-1]]
            finally:
                _asked.pop()
    return errors


_SHORTCUTS: tuple[tuple[Any, str, Any], ...] = (
    (BaseFunction, "get_call_type", _remembering_types(BaseFunction.get_call_type)),
    (Type, "get_abi_size", _remembering_sizes(Type.get_abi_size)),
    (IRBuilder, "extract_value", _seen_through(IRBuilder.extract_value)),
    (CompilerBase, "_compile_core", _telling_kernels(CompilerBase._compile_core)),
    (base.BaseContext, "get_arg_packer", _remembering_packers(base.BaseContext.get_arg_packer)),
    (base.BaseContext, "declare_function", _remembering_declarations(base.BaseContext.declare_function)),
    (base, "_has_loc", cache(base._has_loc)),
    (ir.Inst, "_rec_list_vars", _variables(ir.Inst._rec_list_vars)),
    (
        Context,
        "find_matching_getattr_template",
        _remembering_attributes(Context.find_matching_getattr_template),
    ),
    (CPUContext, "load_additional_registries", _once(CPUContext.load_additional_registries)),
    (Context, "load_additional_registries", _once(Context.load_additional_registries)),
    (byteflow.Flow, "_run_handle_exception", _unless_protected(byteflow.Flow._run_handle_exception)),
    (interpreter.Interpreter, "post_process", _unless_absent(interpreter.Interpreter.post_process)),
    (typeinfer.TypeVarMap, "__getitem__", _noting(typeinfer.TypeVarMap.__getitem__)),
    (typeinfer.ConstraintNetwork, "propagate", _propagate),
    (event, "install_timer", lambda *_: nullcontext()),
    (event, "start_event", _unless_lock(event.start_event)),
    (event, "end_event", _unless_lock(event.end_event)),
)


@contextmanager
def _replaced(owner: Any, name: str, value: Any) -> Iterator[None]:
    """Give a class or module another attribute, as `unittest.mock` does, which takes long to import."""
    own = name in vars(owner)
    original = vars(owner).get(name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        if own:
            setattr(owner, name, original)
        else:
            delattr(owner, name)


@contextmanager
def shortcuts() -> Iterator[None]:
    """Let numba take the shortcuts."""
    with ExitStack() as stack:
        for owner, name, shortcut in _SHORTCUTS:
            stack.enter_context(_replaced(owner, name, shortcut))
        yield


class Passes(PassManager):
    """Passes that are not timed, and between which nothing is checked or analysed that no pass asks for."""

    def _runPass(self, index: int, one: Any, state: Any) -> None:
        one.analysis = self._analysis
        one.run_initialization(state)
        one.run_pass(state)
        one.run_finalizer(state)


@register_pass(mutates_CFG=True, analysis_only=False)
class Canonical(FunctionPass):
    """The control flow in the form that numba's passes expect."""

    _name = "kernel_canonical"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Bring blocks into order."""
        state.func_ir.blocks = transforms.canonicalize_cfg(state.func_ir.blocks)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class Lifetimes(FunctionPass):
    """The ends of variables, where references are counted; else nobody asks for them."""

    _name = "kernel_lifetimes"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Mark where variables end."""
        function, models = state.func_ir, state.targetctx.data_model_manager
        function.blocks = transforms.canonicalize_cfg(function.blocks)
        function.variable_lifetime = postproc.VariableLifetime(function.blocks)
        if any(counted(models, kind) for kind in set(state.typemap.values())):
            postproc.PostProcessor(function)._insert_var_dels()
        return True


@register_pass(mutates_CFG=True, analysis_only=False)
class Rewrites(FunctionPass):
    """The rewriting that comes before types, without the look at lifetimes after it."""

    _name = "kernel_rewrites"

    def __init__(self) -> None:
        FunctionPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Rewrite the function."""
        with _replaced(postproc.PostProcessor, "run", lambda self: None):
            rewrite_registry.apply("before-inference", state)
        return True
