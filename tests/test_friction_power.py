"""Friction does no positive work: what would let it is refused in the step, and told where it cannot be."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene
from pinimpact.scene.integrator import Integrator

from .scene_models import G, slider, unbounded


def sliding(speed=1.0, pull=0.0):
    """A point that slides at 1 m/s, μ = 0.3."""
    scene = Scene(slider(), [Contact("point", Plane(), friction=0.3)])
    integrator = Integrator(scene, np.zeros(3), [speed, 0.0, 0.0], 1e-8, 1e-10, math.inf, 100)
    integrator.begin(np.array([pull, 0.0, 0.0]))
    return integrator


def test_friction_that_takes_is_let_alone():
    integrator = sliding()
    integrator.advance(0.2)
    assert integrator.state.v[0] == pytest.approx(1.0 - 0.3 * G * 0.2)
    assert integrator.rejected == 0
    assert not integrator.state.notes


def test_a_contact_that_drives_is_mended():
    integrator = sliding()
    integrator.work.active_friction[:] = -0.3  # as a mode of the wrong sign would
    integrator._begin_motion()
    integrator.advance(0.2)
    assert integrator.rejected >= 6
    assert integrator.state.v[0] == pytest.approx(1.0 - 0.3 * G * 0.2)


def test_a_contact_that_is_dragged_on_as_it_sticks_is_mended():
    """Pulled with 2 N one way, it moves the other way; it slips until it is at rest."""
    integrator = sliding(speed=0.0, pull=2.0)
    integrator.state.v = np.array([-1e-3, 0.0, 0.0])  # as something that no stop takes away would
    integrator._begin_motion()
    integrator.advance(0.2)
    assert integrator.rejected >= 6
    assert integrator.state.v[0] == pytest.approx(0.0, abs=1e-12)
    assert integrator.state.q[0] == pytest.approx(-0.5e-6 / (2.0 + 0.3 * G))


def test_what_cannot_be_mended_is_told():
    integrator = sliding()
    integrator.work.friction[:] = -0.3
    integrator._settle()
    integrator._begin_motion()
    integrator.advance(0.2)
    (note,) = [
        note.text for note in integrator.state.notes if note.text.startswith("Friction has a positive power")
    ]
    assert float(note.split()[6]) == pytest.approx(0.3 * G, rel=0.3)


def test_a_joint_whose_friction_has_the_wrong_sign_is_mended():
    model = pin.Model()
    index = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    unbounded(model)
    model.friction = np.array([0.5])
    integrator = Integrator(Scene(model), [0.0], [1.0], 1e-8, 1e-10, math.inf, 100)
    integrator.begin()
    integrator.work.sliding_friction[:] = -0.5
    integrator._begin_motion()
    integrator.advance(1.0)
    assert integrator.state.v[0] == pytest.approx(0.5)
    assert integrator.state.q[0] == pytest.approx(0.75)


def test_forces_beyond_their_bounds_are_told_once_and_what_a_step_leaves_unknown_is_not():
    integrator = sliding()
    integrator._note_beyond(1e-9 * G)
    assert integrator.state.notes == []
    integrator._note_beyond(0.1)
    integrator._note_beyond(0.2)
    (note,) = integrator.state.notes
    assert "exceed the bounds of the contact modes by 0.1 N" in note.text
