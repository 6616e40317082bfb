"""What can happen at an event."""

ARRIVAL, MODE_CHANGE = range(2)
"""A contact or limit arrives at its surface or bound, and may bounce; or the modes are to be chosen anew."""
