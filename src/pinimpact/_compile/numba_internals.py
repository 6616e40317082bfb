"""All private names of numba that are used, each with its purpose.

`MISSING` is the first one that this version of numba lacks; plain numba then compiles the kernels (`plain`).
"""

# ruff: noqa: F401, I001
from __future__ import annotations

from numba.core.typing.templates import AttributeTemplate  # types of a workspace's fields, in plain numba too

MISSING = ""

try:
    from numba._dynfunc import Environment  # constants of a function, loaded or a placeholder
    from numba._dynfunc import make_function  # makes the placeholder of a function
    from numba.core.caching import CompileResultCacheImpl  # location and contents of cache files
    from numba.core.caching import FunctionCache  # index and files of one kernel
    from numba.core.caching import NullCache  # used if no folder is writable
    from numba.core.codegen import JITCodeLibrary  # holds the code of a kernel: bitcode or machine code
    from numba.core.compiler import CompilerBase  # lists the passes of a kernel
    from numba.core.compiler import DefaultPassBuilder  # numba's own list of passes
    from numba.core.compiler import Flags  # options, which are part of a symbol
    from numba.core.compiler import compile_result  # record of a compiled kernel in its dispatcher
    from numba.core.compiler_lock import global_compiler_lock  # held during compilation
    from numba.core.compiler_machinery import register_pass  # numba requires passes to be registered
    from numba.core.ir import Assign, Expr  # operations of a kernel: whether any yields a new array
    from numba.core.funcdesc import PythonFunctionDescriptor  # symbol of a kernel compiled elsewhere
    from numba.core.runtime import rtsys  # array memory, initialized before kernels are loaded
    from numba.core.typed_passes import NativeLowering  # base class of `linking.KernelLowering`
except (ImportError, AttributeError) as error:
    MISSING = str(error)
