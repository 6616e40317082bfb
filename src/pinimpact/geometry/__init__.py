"""Shapes: surfaces, convex shapes, their gap and time of contact. Independent of robots."""
