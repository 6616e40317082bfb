"""All private names of numba that are used, each with its purpose.

`MISSING` is the first that this version of numba lacks; kernels are then compiled by plain numba, see
`plain`.
"""

# ruff: noqa: F401, I001
from __future__ import annotations

from numba.core.typing.templates import AttributeTemplate  # types of a workspace's fields, in plain numba too

MISSING = ""

try:
    from numba._dynfunc import Environment  # constants of a function that is loaded or stood in for
    from numba._dynfunc import make_function  # stands for a function that Python cannot call
    from numba.core.caching import CompileResultCacheImpl  # where files of a cache are, and what is in them
    from numba.core.caching import FunctionCache  # index and files of one kernel
    from numba.core.caching import NullCache  # where no folder is writable
    from numba.core.codegen import JITCodeLibrary  # holds the code of a kernel: bitcode or machine code
    from numba.core.compiler import CompilerBase  # lists the passes of a kernel
    from numba.core.compiler import DefaultPassBuilder  # numba's own list of passes
    from numba.core.compiler import Flags  # options, which are part of a symbol
    from numba.core.compiler import compile_result  # what a dispatcher keeps of a kernel
    from numba.core.compiler_lock import global_compiler_lock  # other threads wait
    from numba.core.compiler_machinery import register_pass  # numba accepts no other pass
    from numba.core.funcdesc import PythonFunctionDescriptor  # the symbol of a kernel that is elsewhere
    from numba.core.runtime import rtsys  # memory of arrays, started before a kernel is loaded
    from numba.core.typed_passes import NativeLowering  # after it, code goes where kernels are linked
except (ImportError, AttributeError) as error:
    MISSING = str(error)
