"""A gripper closes on a cube that is not centred: one finger pushes it over the floor until both hold it."""

from __future__ import annotations

import warnings

import coal
import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene, Shape, SteppedWarning, simulate

GRIP, DAMPING, SIDE = 20.0, 10.0, 0.05


def gripper():
    """Return a palm on a vertical prismatic joint with two fingers on horizontal ones, and a free cube."""
    model, shapes, here = pin.Model(), pin.GeometryModel(), pin.SE3.Identity()
    palm = model.addJoint(0, pin.JointModelPZ(), here, "lift")
    model.appendBodyToJoint(palm, pin.Inertia.FromBox(1.0, 0.2, 0.05, 0.03), here)
    sizes = {"left": (0.02, 0.04, 0.1), "right": (0.02, 0.04, 0.1), "cube": (SIDE,) * 3}
    for name, size in sizes.items():
        finger = name != "cube"
        side = -0.06 if name == "left" else 0.06
        at = pin.SE3(np.eye(3), np.array([side, 0.0, -0.08])) if finger else here
        kind = pin.JointModelPX() if finger else pin.JointModelFreeFlyer()
        joint = model.addJoint(palm if finger else 0, kind, at, name)
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(0.1 if finger else 0.3, *size), here)
        model.addJointFrame(joint)
        shapes.addGeometryObject(pin.GeometryObject(name, joint, here, coal.Box(*size)))
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    return pin.RobotWrapper(model, shapes, shapes)


def closing(t, q, v):
    force = np.zeros(9)
    force[0] = 2000.0 * (0.15 - q[0]) - 150.0 * v[0] + 1.2 * 9.81
    force[1], force[2] = GRIP - DAMPING * v[1], -GRIP - DAMPING * v[2]
    return force


@pytest.mark.parametrize("aside", [0.0, 1e-3])
@pytest.mark.parametrize("scheme", ["auto", "time-stepping"])
def test_fingers_close_on_a_cube_and_hold_it(scheme, aside):
    robot = gripper()
    contacts = [Contact(geometry="cube", plane=Plane(name="floor"), friction=0.5, restitution=0.2)]
    contacts += [Contact(geometry=name, plane=Shape("cube"), friction=0.1) for name in ("left", "right")]
    scene = Scene(robot, contacts, control=closing, period=1e-3)
    q = np.array([0.15, 0.0, 0.0, 0.005, aside, 0.5 * SIDE, 0.0, 0.0, 0.0, 1.0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SteppedWarning)  # rounding decides whether modes are found
        trajectory = simulate(scene, q, np.zeros(9), 0.12, scheme=scheme)
    assert not any("may be wrong" in note.text for note in trajectory.notes)
    # of a cube right between the fingers, rounding decides how it turns; their friction stops it slowly
    speed = 0.05 if scheme == "auto" and aside == 0.0 else 1e-6
    assert np.abs(trajectory.v[-1]).max() < speed
    assert np.abs(trajectory.energy.residual).max() < 1e-5
