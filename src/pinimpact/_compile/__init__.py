"""Compilation, caching and linking of kernels: all use of numba and llvmlite."""
