"""How kernels are compiled, cached and linked: everything that touches numba and llvmlite."""
