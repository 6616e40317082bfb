"""Simulation of scenes: dynamics, contact modes, impacts, events, time steps, and trajectories."""
