"""Checks of random motions (`tests.lawful`) detect violations of Coulomb's law between samples."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pinimpact import Contact, Plane, Scene, simulate
from pinimpact.scene.records import ModeInterval

from .lawful import law_violation, unexplained_velocity_loss
from .random_scenes import draw
from .scene_models import slider

RTOL = 1e-7


@pytest.fixture(scope="module")
def sliding():
    """Return a scene and motion of a sliding point mass that is pulled sideways until slip ends."""
    scene = Scene(slider(2.0), [Contact("point", Plane(), friction=0.4)], control=lambda t, q, v: [0, 3, 0])
    return scene, simulate(scene, np.zeros(3), [0.8, 0.0, 0.0], 0.4, rtol=RTOL, atol=1e-2 * RTOL)


def test_simulated_motion_satisfies_the_law(sliding):
    assert law_violation(*sliding, RTOL, 1) == ""


@pytest.mark.parametrize(
    ("seed", "times"),
    [
        (72000435, 1),
        (93000132, 93000132),  # two contacts begin to slip together, one is recorded first
    ],
)
def test_recorded_violations_are_fixed(seed, times):
    _, scene, q, v, rtol = draw(seed)
    assert law_violation(scene, simulate(scene, q, v, 1.0, rtol=rtol, atol=1e-2 * rtol), rtol, times) == ""


@pytest.mark.parametrize(("speed", "reported"), [(1.0, False), (0.01, True)])
def test_velocity_loss_within_error_of_previous_step_is_ignored(sliding, speed, reported):
    """The error of the velocity after a step that stops a contact is relative to the velocity before it."""
    scene, _ = sliding
    motion = SimpleNamespace(
        t=np.array([0.0, 0.1, 0.1]),
        q=np.zeros((3, 3)),
        v=np.array([[speed, 0.0, 0.0], [1e-5, 0.0, 0.0], [9e-6, 0.0, 0.0]]),
        modes=[ModeInterval("point on plane", "slip", 0.0, 0.2)],
        impacts=[],
        stepped=(),
    )
    assert bool(unexplained_velocity_loss(scene, motion, RTOL)) == reported


def test_violations_are_reported(sliding):
    """Check a motion against scenes with other coefficients or another plane."""
    scene, trajectory = sliding

    def judged(**other):
        contact = replace(scene.contacts[0], **other)
        return law_violation(Scene(scene.model, [contact]), trajectory, RTOL, 1)

    assert "is the most" in judged(friction=0.39)
    assert "friction off by" in judged(friction=0.41)
    assert "sinks in by 0.001" in judged(plane=Plane(point=(0, 0, 1e-3)))
    assert "N from 0.001 m" in judged(plane=Plane(point=(0, 0, -1e-3)))


def test_velocity_loss_without_impact_is_reported(sliding):
    scene, trajectory = sliding
    k = 1
    for name in ("t", "q"):
        rows = getattr(trajectory, name)
        object.__setattr__(trajectory, name, np.insert(rows, k, rows[k], axis=0))
    object.__setattr__(trajectory, "v", np.insert(trajectory.v, k + 1, (1 - 1e-5) * trajectory.v[k], axis=0))
    assert "unstruck" in law_violation(scene, trajectory, RTOL, 1)
