"""Numerical kernels: numba and math only. Scalars in, tuples and status codes out; no exceptions."""
