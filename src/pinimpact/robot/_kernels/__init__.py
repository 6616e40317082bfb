"""Contact kinematics and the impact of a robot in one call: numba and math only."""
