"""Signed distances of surfaces, compiled."""
