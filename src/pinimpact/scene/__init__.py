"""Motions: what a scene calls for, its dynamics, modes, events and steps, and what a run leaves."""
