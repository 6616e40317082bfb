"""The processors for which kernels of a wheel are compiled by `tools/fill_wheel.py`; `cache` reads them."""

from __future__ import annotations

import platform
from functools import cache

from llvmlite.binding import get_host_cpu_features

X86_64 = "x86-64-v3"
"""Processors of Intel since Haswell (2013) and of AMD since Excavator (2015)."""

FEATURES = "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe"
"""Features of these processors that older ones lack."""


def processor() -> str:
    """Return LLVM's name of the processors for which kernels of a wheel are compiled on this architecture."""
    return X86_64 if platform.machine() in ("x86_64", "AMD64") else "generic"


@cache
def runs_here() -> bool:
    """Whether kernels of a wheel run on the processor of this machine."""
    if processor() != X86_64:
        return True
    found = get_host_cpu_features()
    return all(found.get(name, False) for name in FEATURES)
