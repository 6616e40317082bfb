"""Consequences of events."""

ARRIVAL, MODE_CHANGE, SIDE_CHANGE = range(3)
"""A contact or joint arrives at its surface or limit, and may bounce; the modes are chosen again; a drive
reaches or leaves its effort limit."""
