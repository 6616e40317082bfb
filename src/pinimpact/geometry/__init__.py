"""Shapes: surfaces, convex shapes, their gap and the time at which they touch. Knows nothing of robots."""
