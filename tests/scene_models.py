"""Small models for tests of scenes, and a simulation that checks the energy balance."""

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
    """Return a free-flying body with frames ``tip0``, ``tip1`` … at the given points, and ``center``."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("center", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    for k, point in enumerate(tips):
        placement = pin.SE3(np.eye(3), np.array(point, dtype=float))
        model.addFrame(pin.Frame(f"tip{k}", joint, 0, placement, pin.FrameType.OP_FRAME))
    return model


def ball(mass=2.0, radius=0.1):
    """Return a uniform solid ball with the frame ``center``."""
    return free_body(pin.Inertia.FromSphere(mass, radius))


def slider(mass=1.0):
    """Return a point mass on three prismatic joints, with the frame ``point``."""
    model = pin.Model()
    parent = 0
    for k, kind in enumerate((pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ())):
        parent = model.addJoint(parent, kind, pin.SE3.Identity(), "xyz"[k])
    model.appendBodyToJoint(parent, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("point", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    return model


def rough_joint(friction):
    """Return a mass of 1 kg on a prismatic joint with dry friction."""
    model = pin.Model()
    index = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    unbounded(model)
    model.friction = np.array([friction])
    return model


def box_on(corners, height=0.1, turn=0.3, mu=0.5):
    """Return a body of 1 kg and contacts at points on an ellipse, `height` below its centre."""
    angle = 2.0 * math.pi * np.arange(corners) / corners + turn
    points = np.column_stack([0.3 * np.cos(angle), 0.2 * np.sin(angle), np.full(corners, -height)])
    model = free_body(pin.Inertia.FromBox(1.0, 0.6, 0.4, 2.0 * height), points)
    plane = pinimpact.Plane()
    return model, [pinimpact.Contact(f"tip{k}", plane, friction=mu) for k in range(corners)]


def boxes_on_a_belt(mus, speed):
    """Return a scene of point masses of 1 kg on prismatic joints, on a belt that moves along x."""
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
    """Return a scene of a box of 1 kg on a slope, and its configuration with four corners in contact.

    `height` is that of its centre above the slope.
    """
    normal = np.array([math.sin(slope), 0.0, math.cos(slope)])
    corners = [(x, y, -height) for x in (-0.2, 0.2) for y in (-0.15, 0.15)]
    model = free_body(pin.Inertia.FromBox(1.0, 0.4, 0.3, 2.0 * height), corners)
    turn = pin.Quaternion(pin.utils.rotate("y", slope)).coeffs()
    plane = pinimpact.Plane(normal=tuple(normal))
    contacts = [pinimpact.Contact(f"tip{k}", plane, friction=mu) for k in range(4)]
    return pinimpact.Scene(model, contacts), np.array([*(height * normal), *turn])


def pendulum(mass=1.0, length=1.0, joint=None):
    """Return a point mass (frame ``tip``) on a massless rod that rotates about y and points down at zero."""
    model = pin.Model()
    index = model.addJoint(0, joint or pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    lever = np.array([0.0, 0.0, -length])
    model.appendBodyToJoint(index, pin.Inertia(mass, lever, np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", index, 0, pin.SE3(np.eye(3), lever), pin.FrameType.OP_FRAME))
    if model.nq == model.nv:
        unbounded(model)
    return model


def unbounded(model):
    """Remove the position limits of all joints."""
    model.lowerPositionLimit = np.full(model.nq, -np.inf)
    model.upperPositionLimit = np.full(model.nq, np.inf)


def run(scene, q0, v0, duration, audit=1e-6, **options):
    """Simulate and check that the energy residual is at most `audit` times the energies exchanged."""
    trajectory = pinimpact.simulate(scene, q0, v0, duration, **options)
    energy = trajectory.energy
    works = (energy.control, energy.joints, energy.friction, energy.surface, energy.impacts)
    at_play = max(np.abs(x - x[0]).max() for x in (energy.kinetic, energy.potential, *works))
    at_play = max(at_play, energy.kinetic.max())
    weight = pin.computeTotalMass(scene.model) * np.linalg.norm(scene.model.gravity.linear)
    height = options.get("atol", 1e-10)  # gaps are known to it
    assert np.abs(energy.residual).max() <= audit * at_play + weight * height + 1e-12
    return trajectory


def shaped_body(shape, inertia, placement=None, name="thing_0"):
    """Return a free-flying body with one collision shape on its frame ``thing``."""
    model = free_body(inertia)
    model.addFrame(pin.Frame("thing", 1, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    shapes = pin.GeometryModel()
    placement = placement or pin.SE3.Identity()
    shapes.addGeometryObject(pin.GeometryObject(name, 1, model.getFrameId("thing"), placement, shape))
    return pin.RobotWrapper(model, shapes)


def mesh(points, triangles):
    """Return a mesh of coal."""
    solid = coal.BVHModelOBBRSS()
    solid.beginModel(len(triangles), len(points))
    for triangle in triangles:
        solid.addTriangle(*(np.array(points[k], dtype=float) for k in triangle))
    solid.endModel()
    return solid


def hull_mesh(points):
    """Return the convex hull of points as a triangle mesh."""
    hull = ConvexHull(points)
    return mesh(points, hull.simplices)
