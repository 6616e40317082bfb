"""Stretched arms whose tip is locked by friction, where no contact forces exist."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene, SimulationError, SteppedWarning, simulate

from .drawing import one_of_each
from .scene_models import G, unbounded


def arm(turns=True):
    """Return an arm of two links of 1 m in a vertical plane, which turns about a vertical axis if `turns`."""
    model = pin.Model()
    link = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.diag([0.01, 0.1, 0.1]))
    ahead = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    turn = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn") if turns else 0
    lift = model.addJoint(turn, pin.JointModelRY(), pin.SE3.Identity(), "lift")
    model.appendBodyToJoint(lift, link, pin.SE3.Identity())
    elbow = model.addJoint(lift, pin.JointModelRY(), ahead, "elbow")
    model.appendBodyToJoint(elbow, link, pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", elbow, 0, ahead, pin.FrameType.OP_FRAME))
    unbounded(model)
    return model


def with_weight(scene, q, v):
    """Add a weight that lies on a separate floor."""
    model = scene.model.copy()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "weight")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("weight", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    contacts = [Contact("weight", Plane(), friction=0.5), *scene.contacts]
    return Scene(model, contacts), np.append(q, 0.0), np.append(v, 0.0)


def stretching(mu, bend=0.02):
    """Return an arm at 45° whose tip slides outwards on a plane, with the elbow at 3 rad/s, and q and v."""
    angle = np.radians(45.0)
    reach = 2.0 * np.cos(0.5 * bend)
    q = np.array([0.0, -angle - 0.5 * bend, bend])  # positive angles about y lower the arm
    v = np.array([0.0, 0.0, -3.0])
    height = reach * np.sin(angle)
    # derivatives of the height by lift and elbow
    rates = np.array([-reach * np.cos(angle), -np.cos(angle - 0.5 * bend)])
    v[1] = -rates[1] * v[2] / rates[0]
    return Scene(arm(), [Contact("tip", Plane(point=(0.0, 0.0, height)), friction=mu)]), q, v


def locked(scene, q, v, bend, **options):
    """Check that the arm stops after bend / (3 rad/s) with its elbow straight, without a gain of energy."""
    with pytest.warns(SteppedWarning):
        trajectory = simulate(scene, q, v, 0.1, **options)
    energy, elbow = trajectory.energy, list(scene.model.names).index("elbow") - 1
    stopped = trajectory.stepped[0]
    assert stopped.start == pytest.approx(bend / 3.0, abs=1e-3)
    assert trajectory.q[-1, elbow] == pytest.approx(0.0, abs=2e-3)
    rtol, reach = options.get("rtol", 1e-8), 2.0
    assert trajectory.v[-1] == pytest.approx(np.zeros(scene.model.nv), abs=1e-3 + 20.0 * rtol)
    gain = 10.0 * rtol * energy.kinetic[0] + rtol * pin.computeTotalMass(scene.model) * G * reach
    assert energy.total.max() <= energy.total[0] + gain + 1e-3 * energy.kinetic[0]
    with pytest.raises(SimulationError):
        simulate(scene, q, v, 0.1, scheme="event-driven", **options)


@pytest.mark.parametrize("beside", [False, True])
def test_friction_locks_tip_at_full_reach(beside):
    """No forces of rigid bodies exist there, so the arm stops, also beside an independent body."""
    locked(*(with_weight(*stretching(1.2)) if beside else stretching(1.2)), 0.02)


@pytest.mark.parametrize("beside", [False, True])
def test_tip_with_less_friction_slides_back_from_full_reach(beside):
    scene, q, v = with_weight(*stretching(0.9)) if beside else stretching(0.9)
    trajectory = simulate(scene, q, v, 0.1)
    assert trajectory.complete
    assert trajectory.q[-1, 2] < -0.01


def rough(scene, q, v):
    """Add dry friction of 1 N m in all joints."""
    model = scene.model.copy()
    model.friction = np.ones(model.nv)
    return Scene(model, scene.contacts), q, v


def planar(scene, q, v):
    """Remove the joint about the vertical axis, so that the tip cannot move across the plane."""
    return Scene(arm(turns=False), scene.contacts), q[1:], v[1:]


@pytest.mark.parametrize(
    ("bend", "kind"), one_of_each([1e-4, 1e-5, -1e-6], [lambda *arm: arm, rough, planar])
)
@pytest.mark.parametrize("rtol", [4e-4, 1e-6])
def test_tip_near_full_reach_is_locked(rtol, bend, kind):
    """If the tip stuck while the arm moved, friction would increase the energy a thousandfold."""
    locked(*kind(*stretching(1.2, bend)), bend, rtol=rtol, atol=1e-2 * rtol)


@pytest.mark.parametrize("kind", [lambda *arm: arm, planar])
@pytest.mark.parametrize("bend", [1e-4, 1e-5, -1e-6])
@pytest.mark.parametrize("rtol", [4e-4, 1e-6])
def test_tip_with_less_friction_is_not_locked_near_full_reach(rtol, bend, kind):
    scene, q, v = kind(*stretching(0.9, bend))
    trajectory = simulate(scene, q, v, 0.1, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.complete
    assert trajectory.q[-1, -1] < -0.01
    assert not trajectory.notes


@pytest.mark.parametrize("joint", ["lift", "elbow"])
def test_locked_joint_does_not_lock_the_posture(joint):
    """A bent arm with a locked joint, supported by its tip, sticks as with all joints free."""
    scene, q, _ = stretching(1.2, -0.5)
    trajectory = simulate(Scene(scene.model, scene.contacts, locked=[joint]), q, np.zeros(3), 0.05)
    assert [mode.mode for mode in trajectory.modes] == ["stick"]
