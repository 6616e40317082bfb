"""Dynamics with closed contacts, steps and events: numba and math only."""
