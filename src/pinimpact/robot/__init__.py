"""Robots: loading, surfaces, contacts, their matrices, and the impact of a robot."""
