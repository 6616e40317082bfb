"""Small models and one audited way to run scenes, for the tests of scenes."""

from __future__ import annotations

import math

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

import pinimpact

G = 9.81
UP = (0.0, 0.0, 0.0, 1.0)


def free_body(inertia, tips=()):
    """A free-flying body with frames ``tip0``, ``tip1`` … at the given points, and ``center``."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("center", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    for k, point in enumerate(tips):
        placement = pin.SE3(np.eye(3), np.array(point, dtype=float))
        model.addFrame(pin.Frame(f"tip{k}", joint, 0, placement, pin.FrameType.OP_FRAME))
    return model


def ball(mass=2.0, radius=0.1):
    """A uniform solid ball; its frame ``center`` carries the spherical tip."""
    return free_body(pin.Inertia.FromSphere(mass, radius))


def slider(mass=1.0):
    """A point mass on three sliding joints."""
    model = pin.Model()
    parent = 0
    for k, kind in enumerate((pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ())):
        parent = model.addJoint(parent, kind, pin.SE3.Identity(), "xyz"[k])
    model.appendBodyToJoint(parent, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("point", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    return model


def rough_joint(friction):
    """A mass of 1 kg on one sliding joint with dry friction."""
    model = pin.Model()
    index = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    unbounded(model)
    model.friction = np.array([friction])
    return model


def box_on(corners, height=0.1, turn=0.3, mu=0.5):
    """A box of 1 kg whose lower corners lie on an ellipse, and contacts there; its centre's height."""
    angle = 2.0 * math.pi * np.arange(corners) / corners + turn
    points = np.column_stack([0.3 * np.cos(angle), 0.2 * np.sin(angle), np.full(corners, -height)])
    model = free_body(pin.Inertia.FromBox(1.0, 0.6, 0.4, 2.0 * height), points)
    plane = pinimpact.Plane()
    return model, [pinimpact.Contact(f"tip{k}", plane, friction=mu) for k in range(corners)]


def boxes_on_a_belt(mus, speed):
    """A scene of points of 1 kg, on three sliding joints each, on a belt that moves along x."""
    model, contacts = pin.Model(), []
    belt = pinimpact.Plane(velocity=(speed, 0.0, 0.0))
    for k, mu in enumerate(mus):
        parent = 0
        for i, kind in enumerate((pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ())):
            parent = model.addJoint(parent, kind, pin.SE3.Identity(), f"{k}{'xyz'[i]}")
        inertia = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(f"point{k}", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        contacts.append(pinimpact.Contact(f"point{k}", belt, friction=mu))
    unbounded(model)
    return pinimpact.Scene(model, contacts)


def box_on_a_slope(slope, mu, height):
    """A scene of a box of 1 kg on four corners on a slope, and where it starts; its centre's height."""
    normal = np.array([math.sin(slope), 0.0, math.cos(slope)])
    corners = [(x, y, -height) for x in (-0.2, 0.2) for y in (-0.15, 0.15)]
    model = free_body(pin.Inertia.FromBox(1.0, 0.4, 0.3, 2.0 * height), corners)
    turn = pin.Quaternion(pin.utils.rotate("y", slope)).coeffs()
    plane = pinimpact.Plane(normal=tuple(normal))
    contacts = [pinimpact.Contact(f"tip{k}", plane, friction=mu) for k in range(4)]
    return pinimpact.Scene(model, contacts), np.array([*(height * normal), *turn])


def pendulum(mass=1.0, length=1.0, joint=None):
    """A point mass on a massless rod that turns about y; zero hangs down, ``tip`` is the mass."""
    model = pin.Model()
    index = model.addJoint(0, joint or pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    lever = np.array([0.0, 0.0, -length])
    model.appendBodyToJoint(index, pin.Inertia(mass, lever, np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", index, 0, pin.SE3(np.eye(3), lever), pin.FrameType.OP_FRAME))
    if model.nq == model.nv:
        unbounded(model)
    return model


def unbounded(model):
    """Take the bounds off all joints."""
    model.lowerPositionLimit = np.full(model.nq, -np.inf)
    model.upperPositionLimit = np.full(model.nq, np.inf)


def run(scene, q0, v0, duration, audit=1e-6, **options):
    """Simulate and audit the energy: its change is the work of all that acts, of the energies at play."""
    trajectory = pinimpact.simulate(scene, q0, v0, duration, **options)
    energy = trajectory.energy
    works = (energy.control, energy.joints, energy.friction, energy.surface, energy.impacts)
    at_play = max(np.abs(x - x[0]).max() for x in (energy.kinetic, energy.potential, *works))
    at_play = max(at_play, energy.kinetic.max())
    assert np.abs(energy.residual).max() <= audit * at_play + 1e-12
    return trajectory


def shaped_body(shape, inertia, placement=None, name="thing_0"):
    """A free-flying body, frame ``thing``, with one collision shape."""
    model = free_body(inertia)
    model.addFrame(pin.Frame("thing", 1, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    shapes = pin.GeometryModel()
    placement = placement or pin.SE3.Identity()
    shapes.addGeometryObject(pin.GeometryObject(name, 1, model.getFrameId("thing"), placement, shape))
    return pin.RobotWrapper(model, shapes)


def mesh(points, triangles):
    """A mesh as coal has it."""
    solid = coal.BVHModelOBBRSS()
    solid.beginModel(len(triangles), len(points))
    for triangle in triangles:
        solid.addTriangle(*(np.array(points[k], dtype=float) for k in triangle))
    solid.endModel()
    return solid


def hull_mesh(points):
    """The convex hull of points as a mesh of triangles."""
    hull = ConvexHull(points)
    return mesh(points, hull.simplices)
