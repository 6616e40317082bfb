"""Accuracy against run time, and other solvers of the same problem."""
