"""Robots of many kinematic trees, with one Pinocchio Data per few trees, against a single Data."""

from __future__ import annotations

import math

import coal
import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene, contact_matrices, impact, impact_derivatives, simulate
from pinimpact.robot.data_cache import data_cache
from pinimpact.robot.forest import (
    Forest,
    data_of,
    forward_kinematics,
    frame_placement,
    inverse_mass,
    joint_jacobian,
    mass_matrix,
    potential_energy,
)
from pinimpact.robot.matrices import many_matrices
from pinimpact.robot.merging import Placed, assemble
from pinimpact.robot.pinocchio_bridge import _InPlace, _OfParts, kinetic_energy
from pinimpact.visual.robot_shapes import joint_poses

from .scene_models import UP, G, unbounded


def several(most=0.3):
    """Return a model of two arms with a free body before, between and after them, and a random state."""
    model = pin.Model()
    for k in range(5):
        if k % 2:
            arm = pin.buildSampleModelManipulator()
            for j in range(1, arm.njoints):
                arm.names[j] = f"{k} {arm.names[j]}"
            for f in range(1, arm.nframes):
                arm.frames[f].name = f"{k} {arm.frames[f].name}"
            model = pin.appendModel(model, arm, 0, pin.SE3.Random())
        else:
            joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Random(), f"free {k}")
            model.appendBodyToJoint(joint, pin.Inertia.FromEllipsoid(1.0, 0.3, 0.2, 0.1), pin.SE3.Random())
            model.addFrame(pin.Frame(f"free {k}", joint, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    model.armature = np.linspace(0.0, most, model.nv)
    unbounded(model)
    rng = np.random.default_rng(5)
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    return model, q, rng.normal(size=model.nv)


def test_fields_assembled_from_parts_equal_those_of_the_whole():
    pin.seed(3)
    model, q, v = several()
    forest, data = Forest(model, 7), model.createData()
    assert len(forest.parts) > 3
    for one, other in (
        (mass_matrix, 1e-13),
        (inverse_mass, 1e-10),
        (joint_jacobian, 1e-13),
    ):
        whole = one(model, data, q)
        found = one(model, forest, q)
        assert np.abs(found - whole).max() <= other * np.abs(whole).max()
    assert kinetic_energy(model, forest, q, v) == pytest.approx(kinetic_energy(model, data, q, v), rel=1e-13)
    assert potential_energy(model, forest, q) == pytest.approx(potential_energy(model, data, q), rel=1e-12)
    a = np.linspace(-1.0, 1.0, model.nv)
    for at in (forest, data):
        forward_kinematics(model, at, q, v, a)
    for joint in range(1, model.njoints):
        assert forest.oMi[joint].isApprox(data.oMi[joint], 1e-12)
        assert forest.v[joint].isApprox(data.v[joint], 1e-12)
        assert forest.a[joint].isApprox(data.a[joint], 1e-12)
    for frame in range(model.nframes):
        assert frame_placement(model, forest, frame).isApprox(frame_placement(model, data, frame), 1e-12)


@pytest.mark.parametrize("armature", [0.0, 0.3])
def test_dynamics_of_parts_equal_those_of_the_whole(armature):
    pin.seed(3)
    model, q, v = several(armature)
    model.inertias[1] = pin.Inertia.FromEllipsoid(2.0, 0.1, 0.2, 0.4)
    whole, parts = _InPlace(model), _OfParts(model, Forest(model, 7))
    for robot in (whole, parts):
        robot.q[:], robot.v[:], robot.tau[:] = q, v, np.linspace(-3.0, 3.0, model.nv)
        for call in (robot.forward_kinematics, robot.forward_dynamics, robot.inverse_mass):
            call.function(*call.arguments)
    for name in (
        *("acceleration", "minverse", "placements", "local_velocities"),
        *("velocities", "accelerations", "joint_jacobian"),
    ):
        expected = getattr(whole, name)
        assert np.abs(getattr(parts, name) - expected).max() <= 1e-11 * (1.0 + np.abs(expected).max()), name


@pytest.mark.parametrize("held", [(), ("free 2",)])
def test_derivatives_of_impact_equal_those_of_the_whole(held):
    pin.seed(3)
    model, q, _ = several()
    contact = Contact("free 0", Plane(body="free 4"), friction=0.5, restitution=0.4)
    held = [Contact(frame, Plane()) for frame in held]
    rows = [contact_matrices(model, model.createData(), q, one).jacobian for one in (contact, *held)]
    v = -np.linalg.lstsq(np.vstack(rows), np.eye(3 * len(rows))[2] + 0.2 * np.eye(3 * len(rows))[0])[0]
    one, other = (
        impact_derivatives(model, at, q, v, contact, held) for at in (Forest(model, 7), model.createData())
    )
    assert other.dv_dq.any()
    assert np.abs(one.block - other.block).max() <= 1e-9 * np.abs(other.block).max()


def test_contacts_and_impacts_between_trees_equal_those_of_the_whole():
    pin.seed(3)
    model, q, v = several()
    forest, data = Forest(model, 7), model.createData()
    tip = model.frames[-2].name if model.frames[-2].name != "universe" else model.frames[-1].name
    contacts = [
        Contact("free 0", Plane(body="free 4"), friction=0.5, restitution=0.4),
        Contact("free 2", Plane(), friction=0.3, restitution=0.4),
        Contact(tip, Plane(body="free 2"), friction=0.3, restitution=0.4),
    ]
    assert data_cache(model, forest).tree is not None
    for contact in contacts:
        one, other = (contact_matrices(model, at, q, contact) for at in (forest, data))
        assert np.abs(one.jacobian - other.jacobian).max() <= 1e-12 * np.abs(other.jacobian).max()
        assert np.abs(one.delassus - other.delassus).max() <= 1e-10 * np.abs(other.delassus).max()
        one, other = (impact(model, at, q, v, contact) for at in (forest, data))
        assert np.abs(one.v - other.v).max() <= 1e-9 * np.abs(v).max()
    one, other = (many_matrices(model, at, q, contacts) for at in (forest, data))
    assert np.abs(one.delassus - other.delassus).max() <= 1e-10 * np.abs(other.delassus).max()


def free_boxes(count, e):
    """Return a scene of free boxes above a floor, without contacts between boxes."""
    model, shapes, contacts = pin.Model(), pin.GeometryModel(), []
    for k in range(count):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"box {k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.1), pin.SE3.Identity())
        model.addJointFrame(joint)
        shapes.addGeometryObject(
            pin.GeometryObject(f"shape {k}", joint, pin.SE3.Identity(), coal.Box(0.2, 0.2, 0.1))
        )
        contacts.append(
            Contact(geometry=f"shape {k}", plane=Plane(), friction=0.5, restitution=e, name=f"box {k}")
        )
    unbounded(model)
    return Scene(model, contacts, geometry=shapes)


@pytest.mark.parametrize("scheme", ["time-stepping", "event-driven"])
def test_separate_boxes_move_as_one_alone(scheme):
    count = 12
    rng = np.random.default_rng(1)
    pin.seed(1)
    placed = [pin.SE3ToXYZQUAT(pin.SE3.Random()) for _ in range(count)]
    for k, one in enumerate(placed):
        one[:3] = k, 0.0, 0.25
    moving = rng.normal(size=(count, 6))
    assert isinstance(data_of(free_boxes(count, 0.4).model), Forest)
    together = simulate(
        free_boxes(count, 0.4), np.concatenate(placed), moving.ravel(), 0.15, scheme=scheme, dt=1e-3
    )
    alone = free_boxes(1, 0.4)
    for k in range(0, count, 4):
        one = simulate(alone, placed[k], moving[k], 0.15, scheme=scheme, dt=1e-3)
        # impacts of any box cut the time steps of all; events are located to within the tolerance
        error = 2e-3 if scheme == "time-stepping" else 1e-6
        assert np.abs(together.q[-1, 7 * k : 7 * k + 7] - one.q[-1]).max() < error
        own = [record for record in together.impacts if record.source.startswith(f"box {k} ")]
        assert len(own) == len(one.impacts)


def test_hundred_free_boxes_fall_and_bounce():
    """A box at height h lands at √(2h/g); heights differ, so no two land at once."""
    count, e = 100, 0.3
    heights = np.linspace(0.01, 0.04, count)
    q0 = np.array([[0.5 * (k % 10), 0.5 * (k // 10), 0.05 + h, *UP] for k, h in enumerate(heights)])
    scene = free_boxes(count, e)
    run = simulate(scene, q0.ravel(), np.zeros(6 * count), 0.3, scheme="time-stepping", dt=1e-3)
    first = {}
    for record in run.impacts:
        first.setdefault(int(record.source.split()[1]), record)
    assert len(first) == count
    for k, record in first.items():
        assert record.time == pytest.approx(math.sqrt(2.0 * heights[k] / G), abs=1e-9)
        speed = math.sqrt(2.0 * G * heights[k])
        assert record.v_after[6 * k + 2] == pytest.approx(e * speed, rel=1e-9)
    assert run.q[-1].reshape(count, 7)[:, 2] == pytest.approx(np.full(count, 0.05), abs=1e-8)


def test_merged_robots_create_data_on_first_access():
    parts = [
        Placed(pin.RobotWrapper(pin.buildSampleModelManipulator()), f"{k} ", pin.SE3.Random()) for k in (1, 2)
    ]
    for part in parts:
        for name in ("collision_model", "visual_model"):
            setattr(part.robot, name, pin.GeometryModel())
    robot = assemble(parts)
    assert not {"data", "collision_data", "visual_data"} & set(vars(robot))
    assert robot.q0.shape == (robot.nq,)
    q = pin.randomConfiguration(robot.model)
    pin.forwardKinematics(robot.model, robot.data, q)
    other = pin.RobotWrapper(robot.model, robot.collision_model, robot.visual_model)
    assert robot.mass(q) == pytest.approx(other.mass(q), rel=1e-12, abs=1e-12)
    assert len(robot.collision_data.oMg) == len(other.collision_data.oMg)


def test_placements_of_joints_for_replays_equal_those_of_the_whole():
    model = several()[0]
    for prefix in ("again", "once more"):
        model = pin.appendModel(model, _renamed(several()[0], prefix), 0, pin.SE3.Identity())
    assert isinstance(data_of(model), Forest)
    every = [pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq)) for _ in range(2)]
    poses, data = joint_poses(model, every), model.createData()
    for k, at in enumerate(every):
        pin.forwardKinematics(model, data, at)
        for joint in range(model.njoints):
            assert pin.XYZQUATToSE3(poses[k, joint]).isApprox(data.oMi[joint], 1e-9)


def _renamed(model, prefix):
    for j in range(1, model.njoints):
        model.names[j] = f"{prefix} {model.names[j]}"
    for f in range(1, model.nframes):
        model.frames[f].name = f"{prefix} {model.frames[f].name}"
    return model
