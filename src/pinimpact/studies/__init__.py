"""Measurements: what accuracy costs, and other solvers of the same problem."""
