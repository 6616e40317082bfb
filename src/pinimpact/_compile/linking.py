"""Compilation and linking of kernels, without compiling callees again for each caller.

numba optimizes and translates a function together with all its callees, again at each level, so that a
function with ten callers is compiled ten times. Here an inlined kernel remains LLVM bitcode until another
kernel inlines it. Separately compiled kernels refer to each other by symbols that depend on names, types and
sources only, so that caches of different processes are compatible.
"""

from __future__ import annotations

import gc
import importlib
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite import binding as llvm

from .numba_internals import (
    Assign,
    CompilerBase,
    DefaultPassBuilder,
    Environment,
    Expr,
    Flags,
    JITCodeLibrary,
    NativeLowering,
    PythonFunctionDescriptor,
    compile_result,
    make_function,
    register_pass,
)
from .operators import OperatorTypes
from .sources import stamp

Kernel = tuple[str, str, tuple[Any, ...]]
"""Module, name and argument types of a separately compiled kernel."""


def symbol_stamp(module: str) -> str:
    """Return the part of the symbols of a module's kernels that depends on their code."""
    return stamp(module)[:16]


class KernelCode(JITCodeLibrary):
    """Code with the optimization that kernels need, in two thirds of numba's time.

    Before linking, variables are promoted to registers, which shortens each function; all other optimization
    is applied to the linked module. Loops are neither vectorized nor unrolled: most have three or seven
    iterations, and unrolling takes a fifth of LLVM's time without a gain. Independent operations on several
    numbers become vector instructions.
    """

    def _passes(self, level: int) -> Any:
        options = llvm.create_pipeline_tuning_options(level)
        options.slp_vectorization = True
        options.loop_vectorization = options.loop_unrolling = False
        return llvm.create_pass_builder(self._codegen._tm, options)

    def _optimize_functions(self, ll_module: Any) -> None:
        """Optimize each function separately."""
        ll_module.data_layout = self._codegen._data_layout
        passes = self._passes(1)
        manager = llvm.create_new_function_pass_manager()
        if hasattr(manager, "add_sroa_pass"):
            manager.add_sroa_pass()
        else:  # llvmlite 0.44
            manager = passes.getFunctionPassManager()
        for function in ll_module.functions:
            if not function.is_declaration:
                manager.run(function, passes)

    def _optimize_final_module(self) -> None:
        """Optimize the whole module."""
        passes = self._passes(2)
        manager = passes.getModulePassManager()
        manager.add_refprune_pass()
        manager.run(self._final_module, passes)


class InlinedLibrary(KernelCode):
    """The bitcode of a kernel that its callers inline."""

    def finalize(self) -> None:
        """Leave the code unchanged: it is optimized where it is inlined."""
        self._raise_if_finalized()
        self._finalized = True

    def entry(self, context: Any, fndesc: Any, env: Any) -> Any:
        """Return a placeholder for the function."""
        return _no_entry(self, fndesc, env)

    def own_code(self) -> Any:
        """Return the module of this kernel without its callees."""
        return super()._get_module_for_linking()

    def _get_module_for_linking(self) -> Any:
        """Return the module with all callees, for a caller that numba itself compiles."""
        module = self.own_code().clone()
        for library in _needed(self):
            module.link_in(_code(library), preserve=True)
        return module


class BitcodeLibrary(InlinedLibrary):
    """The bitcode of an inlined kernel and its inlined callees, for the cache."""

    kernel: Kernel

    def serialize_using_object_code(self) -> Any:
        """Return the argument of `load`."""
        module, callees = self.own_code().clone(), []
        for library in _needed(self):
            if isinstance(library, KernelLibrary):
                callees.append(library.kernel)
            else:
                module.link_in(_code(library), preserve=True)
        return self.name, module.as_bitcode(), self.kernel, tuple(callees)

    @classmethod
    def load(cls, codegen: Any, state: Any) -> BitcodeLibrary:
        """Return the library from the cache, with all callees."""
        name, code, kernel, callees = state
        self = cls(codegen, name)
        self.kernel = kernel
        self._final_module = llvm.parse_bitcode(code)
        self._linking_libraries = [_loaded(callee) for callee in callees]
        self._finalized = True
        return self


class KernelLibrary(KernelCode):
    """The machine code of a separately compiled kernel, including the kernels that it inlines."""

    kernel: Kernel
    callees: tuple[Kernel, ...] = ()  # the separately compiled kernels that it calls
    _final_module: Any
    _code: bytes = b""
    _symbols: tuple[str, ...] = ()

    @classmethod
    def without_code(cls, codegen: Any, kernel: Kernel) -> KernelLibrary:
        """Return a library without code for a kernel compiled elsewhere; callers use its symbol."""
        self = cls(codegen, kernel[1])
        self.kernel, self._finalized = kernel, True
        return self

    def finalize(self) -> None:
        """Link the inlined kernels, optimize the module, and translate it to machine code."""
        for library in _needed(self):
            if isinstance(library, KernelLibrary):
                self.callees += (library.kernel,)
            else:
                self._final_module.link_in(_code(library), preserve=True)
        self._linking_libraries.clear()
        super().finalize()

    def _finalize_final_module(self) -> None:
        """Translate to machine code, with linked functions internal, since other modules use their names."""
        self._finalize_dynamic_globals()
        for function in self._final_module.functions:
            if function.linkage == llvm.Linkage.linkonce_odr:
                function.linkage = llvm.Linkage.internal
        self._symbols = tuple(one.name for one in self._final_module.functions if not one.is_declaration)
        self._code = self._codegen._tm.emit_object(self._final_module)
        self._final_module = llvm.parse_assembly(str(self._codegen._create_empty_module(self.name)))
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Return an empty module: callers use the symbol."""
        return llvm.parse_assembly("")

    def serialize_using_object_code(self) -> Any:
        """Return the argument of `load`."""
        return self.name, self._code, self._symbols, self.kernel, self.callees

    @classmethod
    def load(cls, codegen: Any, state: Any) -> KernelLibrary:
        """Return the library from the cache."""
        name, code, symbols, kernel, callees = state
        self = cls.without_code(codegen, kernel)
        self._name, self._code, self._symbols, self.callees = name, code, symbols, callees
        return self

    def entry(self, context: Any, fndesc: Any, env: Any) -> Any:
        """Return the function that Python calls, with all callees loaded."""
        self._ensure_finalized()
        if _cache_only:
            return _no_entry(self, fndesc, env)
        for callee in self.callees:
            _loaded(callee)
        self.enable_object_caching()
        self._set_compiled_object(self._code)
        super()._finalize_final_module()
        self._codegen._engine._defined_symbols.update(self._symbols)
        return context.get_executable(self, fndesc, env)


_cache_only = False


@contextmanager
def cache_only() -> Iterator[None]:
    """Compile kernels for the cache only, without loading their code."""
    global _cache_only
    _cache_only = True
    try:
        yield
    finally:
        _cache_only = False


def placeholder(kernel: Any, types: tuple[Any, ...], result: Any) -> Any:
    """Return a compile result with symbol and types, but no code, of a kernel compiled elsewhere."""
    function, context = kernel.py_func, kernel.targetctx
    flags = Flags()
    kernel.targetdescr.options.parse_as_flags(flags, kernel.targetoptions)
    flags.no_compile = True
    fndesc = PythonFunctionDescriptor(
        *(True, function.__module__, function.__qualname__, function.__qualname__, "", None, result, None),
        *(function.__code__.co_varnames[: len(types)], (), context.mangler),
        argtypes=types,
        noalias=flags.noalias,
        abi_tags=[flags.get_mangle_string()],
        uid=symbol_stamp(function.__module__),
    )
    name = function.__module__, function.__qualname__, types
    library = KernelLibrary.without_code(context.codegen(), name)
    return compile_result(
        typing_context=kernel.typingctx,
        target_context=context,
        library=library,
        entry_point=_no_entry(library, fndesc, Environment({})),
        fndesc=fndesc,
        signature=result(*types),
        objectmode=False,
    )


def _loaded(kernel: Kernel) -> Any:
    """Return the library of a kernel, which is loaded from the cache or compiled."""
    module, name, types = kernel
    function = getattr(importlib.import_module(module), name)
    function.compile(types)
    return function.overloads[types].library


def _no_entry(library: Any, fndesc: Any, env: Any) -> Any:
    """Return a placeholder for a function that Python cannot call."""
    return make_function(fndesc.lookup_module(), fndesc.qualname, "", 0, env, (library,))


def _code(library: Any) -> Any:
    return library.own_code() if isinstance(library, InlinedLibrary) else library._get_module_for_linking()


def _needed(library: Any) -> list[Any]:
    """Return the libraries of the callees of a library, and of the callees of those that are inlined."""
    found: dict[Any, None] = {}
    waiting = list(library._linking_libraries)
    while waiting:
        one = waiting.pop()
        if one not in found:
            found[one] = None
            if isinstance(one, InlinedLibrary):
                waiting.extend(one._linking_libraries)
    return list(found)


_VIEWS = {"getitem", "static_getitem", "getattr", "build_tuple", "exhaust_iter", "cast"}
_VIEWS |= {"getiter", "iternext", "pair_first"}
"""Operations whose results contain no arrays but those of their operands, unless they select single items."""


def _owns_arrays(state: Any) -> bool:
    """Return whether a kernel allocates or returns arrays; otherwise references need not be counted.

    Its callers own all arrays that it uses.
    """
    models = state.targetctx.data_model_manager

    def counted(kind: Any) -> bool:
        return bool(models[kind].contains_nrt_meminfo())

    if counted(state.return_type):
        return True
    for block in state.func_ir.blocks.values():
        for step in block.find_insts(Assign):
            value = step.value
            if isinstance(value, Expr) and counted(state.typemap[step.target.name]):
                selects = value.op == "getitem" and counted(state.typemap[value.index.name])
                if value.op not in _VIEWS or selects:
                    return True
    return False


@register_pass(mutates_CFG=True, analysis_only=False)
class KernelLowering(NativeLowering):
    """Lowering with the library classes of kernels."""

    _name = "kernel_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lower a kernel and register it for its callers."""
        state.flags.no_compile = True  # numba leaves the entry point to this pass
        state.targetctx.enable_nrt = _owns_arrays(state)
        super().run_pass(state)
        lowered, library = state["cr"], state.library
        lowered.fndesc.typemap = lowered.fndesc.calltypes = None  # frees half a million unused objects
        entry = library.entry(state.targetctx, lowered.fndesc, lowered.env)
        state.targetctx.insert_user_function(entry, lowered.fndesc, [library])
        state["cr"] = lowered._replace(cfunc=entry)
        return True


_depth = 0


@contextmanager
def without_collecting() -> Iterator[None]:
    """Suspend garbage collection; traversing the compiler's objects takes a tenth of its time."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


def compiling() -> bool:
    """Whether a kernel is being compiled."""
    return _depth > 0


@contextmanager
def _nested_compilation() -> Iterator[None]:
    """Count the levels of nested compilations, and suspend garbage collection."""
    global _depth
    _depth += 1
    try:
        with without_collecting():
            yield
            gc.collect(0)
    finally:
        _depth -= 1


_OMITTED_PASSES = {"InlineClosureLikes", "NopythonRewrites", "ReconstructSSA", "PreLowerStripPhis"}


class KernelCompiler(CompilerBase):
    """The numba passes that kernels need; the omitted ones take a sixth of the time.

    Kernels have neither closures nor array expressions. They do not need numba's static single assignment
    form either: each variable of a kernel has one type, and LLVM builds this form itself.
    """

    library: Any = KernelLibrary

    def __init__(self, typing_context: Any, *others: Any) -> None:
        super().__init__(OperatorTypes(typing_context), *others)

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        """Compile a function."""
        with _nested_compilation():
            return super().compile_extra(func)

    def define_pipelines(self) -> list[Any]:
        """Return the list of passes."""
        state = self.state
        function = state.func_id
        function.unique_id = symbol_stamp(function.modname)
        if self.library is not KernelLibrary:  # its symbols must be the same in every process
            function.unique_id += secrets.token_hex(6)
        if state.library is None:
            state.library = self.library(state.targetctx.codegen(), function.func_qualname)
            state.library.enable_object_caching()
            state.library.kernel = function.modname, function.func_qualname, tuple(state.args)
        passes = DefaultPassBuilder.define_nopython_pipeline(state, "kernel")
        passes.passes = [
            (KernelLowering if one is NativeLowering else one, why)
            for one, why in passes.passes
            if one.__name__ not in _OMITTED_PASSES
        ]
        passes.finalize()
        return [passes]


class InlinedCompiler(KernelCompiler):
    """The passes for an inlined kernel."""

    library = InlinedLibrary


class BitcodeCompiler(InlinedCompiler):
    """The passes for an inlined kernel whose bitcode is cached."""

    library = BitcodeLibrary
