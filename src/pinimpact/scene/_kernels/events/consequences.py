"""What can happen at an event."""

ARRIVAL, MODE_CHANGE, SIDE_CHANGE = range(3)
"""A contact or limit arrives at its surface or bound, and may bounce; the modes are to be set again; or a
drive comes to the bound of its effort or leaves it."""
