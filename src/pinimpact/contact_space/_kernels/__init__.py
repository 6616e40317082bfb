"""The impact solver: numba and math only."""
