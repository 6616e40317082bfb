"""What the scenes' fuzz looks for between samples is seen where it is."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pinimpact import Contact, Plane, Scene, simulate
from pinimpact.scene.records import ModeInterval

from .lawful import lost, unlawful
from .random_scenes import draw
from .scene_models import slider

RTOL = 1e-7


@pytest.fixture(scope="module")
def sliding():
    """A point mass that is pulled across its slip, so that this turns and ends."""
    scene = Scene(slider(2.0), [Contact("point", Plane(), friction=0.4)], control=lambda t, q, v: [0, 3, 0])
    return scene, simulate(scene, np.zeros(3), [0.8, 0.0, 0.0], 0.4, rtol=RTOL, atol=1e-2 * RTOL)


def test_a_lawful_motion_is_found_so(sliding):
    assert unlawful(*sliding, RTOL, 1) == ""


@pytest.mark.parametrize(
    ("seed", "times"),
    [
        (72000435, 1),
        (93000132, 93000132),  # two contacts that begin to slip together, of which one shows first
    ],
)
def test_what_once_was_not_lawful_is(seed, times):
    _, scene, q, v, rtol = draw(seed)
    assert unlawful(scene, simulate(scene, q, v, 1.0, rtol=rtol, atol=1e-2 * rtol), rtol, times) == ""


@pytest.mark.parametrize(("speed", "told"), [(1.0, False), (0.01, True)])
def test_velocity_is_known_to_the_error_of_the_step_before(sliding, speed, told):
    """What is left of a speed that a step takes away is known no better than that speed was."""
    scene, _ = sliding
    motion = SimpleNamespace(
        t=np.array([0.0, 0.1, 0.1]),
        q=np.zeros((3, 3)),
        v=np.array([[speed, 0.0, 0.0], [1e-5, 0.0, 0.0], [9e-6, 0.0, 0.0]]),
        modes=[ModeInterval("point on plane", "slip", 0.0, 0.2)],
        impacts=[],
        stepped=(),
    )
    assert bool(lost(scene, motion, RTOL)) == told


def test_what_breaks_a_law_is_told(sliding):
    """A motion is judged by a scene that is not its own."""
    scene, trajectory = sliding

    def judged(**other):
        contact = replace(scene.contacts[0], **other)
        return unlawful(Scene(scene.model, [contact]), trajectory, RTOL, 1)

    assert "is the most" in judged(friction=0.39)
    assert "friction off by" in judged(friction=0.41)
    assert "sinks in by 0.001" in judged(plane=Plane(point=(0, 0, 1e-3)))
    assert "N from 0.001 m" in judged(plane=Plane(point=(0, 0, -1e-3)))


def test_velocity_that_is_lost_without_an_impact_is_told(sliding):
    scene, trajectory = sliding
    k = 1
    for name in ("t", "q"):
        rows = getattr(trajectory, name)
        object.__setattr__(trajectory, name, np.insert(rows, k, rows[k], axis=0))
    object.__setattr__(trajectory, "v", np.insert(trajectory.v, k + 1, (1 - 1e-5) * trajectory.v[k], axis=0))
    assert "unstruck" in unlawful(scene, trajectory, RTOL, 1)
