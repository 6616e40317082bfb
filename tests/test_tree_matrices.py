"""Impacts by kernels that read the memory of a model, against Pinocchio, for all kinds of joints."""

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, InputError, ModelError, Plane, Status, contact_matrices, impact, impacts
from pinimpact.robot import pinocchio_bridge, tree_numbers
from pinimpact.robot.data_cache import data_cache

AXIS = np.array([0.36, -0.48, 0.8])
CONTINUOUS = (
    '<robot name="one"><link name="a"/><link name="b"><inertial><mass value="1"/><inertia ixx="1" ixy="0" '
    'ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><joint name="j" type="continuous"><parent link="a"/>'
    '<child link="b"/><axis xyz="0.36 -0.48 0.8"/></joint></robot>'
)
JOINTS = {
    "revolute x": pin.JointModelRX,
    "revolute y": pin.JointModelRY,
    "revolute z": pin.JointModelRZ,
    "revolute": lambda: pin.JointModelRevoluteUnaligned(AXIS),
    "unbounded x": pin.JointModelRUBX,
    "unbounded y": pin.JointModelRUBY,
    "unbounded z": pin.JointModelRUBZ,
    "unbounded": lambda: pin.buildModelFromXML(CONTINUOUS).joints[1],  # its class takes no axis in Python
    "prismatic x": pin.JointModelPX,
    "prismatic y": pin.JointModelPY,
    "prismatic z": pin.JointModelPZ,
    "prismatic": lambda: pin.JointModelPrismaticUnaligned(AXIS),
    "free flyer": pin.JointModelFreeFlyer,
    "spherical": pin.JointModelSpherical,
    "translation": pin.JointModelTranslation,
    "planar": pin.JointModelPlanar,
}
UNKNOWN = {"spherical zyx": pin.JointModelSphericalZYX, "universal": pin.JointModelUniversal}
"""Joints that only Pinocchio's algorithms support."""


def robot(kind, root=None) -> pin.Model:
    """Return a tree of a root joint, a joint of a kind, and two branches after it."""
    rng = np.random.default_rng(0)
    make = (JOINTS | UNKNOWN)[kind]
    joint = make(AXIS, np.array([0.8, 0.6, 0.0])) if kind == "universal" else make()
    model = pin.Model()
    parent = model.addJoint(0, root() if root else pin.JointModelRY(), pin.SE3.Random(), "root")
    model.appendBodyToJoint(parent, pin.Inertia.FromEllipsoid(1.0, 0.3, 0.2, 0.1), pin.SE3.Random())
    for name, one, at in (("joint", joint, 1), ("left", pin.JointModelRX(), 2), ("right", joint, 2)):
        j = model.addJoint(at, one, pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3)), rng.random(3)), name)
        inertia = pin.Inertia(1.0 + rng.random(), rng.random(3), np.diag(0.3 + 0.1 * rng.random(3)))
        model.appendBodyToJoint(j, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame(name, j, pin.SE3(np.eye(3), rng.random(3)), pin.FrameType.OP_FRAME))
    model.inertias[1] = pin.Inertia(2.0, rng.random(3), np.diag([0.5, 0.4, 0.3]))
    model.jointPlacements[1] = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1), rng.random(3))
    model.armature = 0.1 * rng.random(model.nv)
    return model


def state(model: pin.Model, seed: int = 1):
    rng = np.random.default_rng(seed)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, model.nv))
    return q, rng.standard_normal(model.nv)


def approaching(model, q, v, contact):
    return v if contact_matrices(model, model.createData(), q, contact).velocity(v)[2] < 0 else -v


def agree(model, contact, seed: int = 1, tolerance: float = 1e-12) -> None:
    """Compare an impact with Pinocchio's mass matrix and Jacobian from separate Data."""
    q, v = state(model, seed)
    v = approaching(model, q, v, contact)
    data = model.createData()
    hit = impact(model, data, q, v, contact)
    own = model.createData()
    matrices = contact_matrices(model, own, q, contact)
    assert hit.solution.status <= Status.LOCKED
    assert hit.problem.delassus == pytest.approx(matrices.delassus, rel=tolerance, abs=tolerance)
    assert hit.problem.velocity == pytest.approx(matrices.velocity(v), rel=tolerance, abs=tolerance)
    assert hit.axes == pytest.approx(matrices.axes, abs=tolerance)
    change = pin.crba(model, own, q) @ (hit.v - v)
    assert change == pytest.approx(matrices.jacobian.T @ hit.solution.impulse, abs=1e-10)


CONTACT = Contact(
    "left", Plane(point=(0.1, 0.2, -0.3), normal=(0.2, -0.3, 0.9)), friction=0.4, restitution=0.5
)
BETWEEN = Contact("left", Plane(normal=(0.1, 0.2, 0.9), body="right"), friction=0.4, restitution=0.5)


@pytest.mark.parametrize("kind", JOINTS)
def test_joints_supported_by_kernels(kind):
    model = robot(kind)
    agree(model, CONTACT)
    agree(model, BETWEEN, seed=2)
    assert data_cache(model, model.createData()).tree is not None


@pytest.mark.parametrize("kind", UNKNOWN)
def test_joints_supported_by_pinocchio_only(kind):
    model = robot(kind)
    agree(model, CONTACT)
    data = model.createData()
    assert data_cache(model, data).tree is None
    q, v = state(model)
    v = approaching(model, q, v, CONTACT)
    rows = impacts(model, data, q, np.array([v, 2 * v]), CONTACT, threads=2)
    assert np.array_equal(rows.v[0], impact(model, data, q, v, CONTACT).v)


def test_kernels_and_pinocchio_agree(monkeypatch):
    model = robot("free flyer")
    q, v = state(model)
    v = approaching(model, q, v, CONTACT)
    known = impact(model, model.createData(), q, v, CONTACT)
    monkeypatch.setattr(tree_numbers, "_tree", lambda model: None)
    data = model.createData()
    assert data_cache(model, data).tree is None
    unknown = impact(model, data, q, v, CONTACT)
    assert known.v == pytest.approx(unknown.v, rel=1e-12, abs=1e-12)
    assert known.impulse_world == pytest.approx(unknown.impulse_world, rel=1e-12)


def test_disagreement_with_pinocchio_is_detected(monkeypatch):
    """Pinocchio's public calls replace a kernel that disagrees with them, with a warning."""
    right = tree_numbers._tree

    def wrong(model):
        tree = right(model)
        tree.arrays["velocity_axis"][0] *= -1.0
        return tree

    monkeypatch.setattr(tree_numbers, "_tree", wrong)
    monkeypatch.setattr(pinocchio_bridge, "_warned", False)
    model = robot("spherical")
    with pytest.warns(pinocchio_bridge.PinocchioLayoutWarning, match="Jacobian"):
        agree(model, CONTACT)


def test_changes_of_the_model_take_effect_in_the_next_impact():
    model = robot("revolute")
    data = model.createData()
    q, v = state(model)
    v = approaching(model, q, v, CONTACT)
    seen = [impact(model, data, q, v, CONTACT).v]

    def changed():
        now = impact(model, data, q, v, CONTACT).v
        fresh = impact(model.copy(), model.createData(), q, v, CONTACT).v
        assert np.array_equal(now, fresh)
        assert not any(np.array_equal(now, before) for before in seen)
        seen.append(now)

    model.inertias[2] = pin.Inertia(3.0, np.array([0.1, 0.0, 0.2]), np.diag([0.4, 0.3, 0.2]))
    changed()
    model.inertias[3].lever[:] += 0.1
    changed()
    model.armature = model.armature + 0.3
    changed()
    model.frames[model.getFrameId("left")].placement = pin.SE3(np.eye(3), np.array([0.3, 0.4, 0.5]))
    changed()
    model.jointPlacements[2] = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.1, 0.2), np.array([0.2, 0.1, 0.5]))
    changed()
    for k in range(40):  # frames move in memory
        model.addFrame(pin.Frame(f"more {k}", 1, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    assert np.array_equal(impact(model, data, q, v, CONTACT).v, seen[-1])
    model.addJoint(1, pin.JointModelRX(), pin.SE3.Identity(), "another")
    with pytest.raises(InputError, match="data: made for another model"):
        impact(model, data, q, v, CONTACT)


def test_many_contacts_are_distinguished():
    model = robot("revolute")
    data = model.createData()
    q, v = state(model)
    v = approaching(model, q, v, CONTACT)
    first = impact(model, data, q, v, CONTACT)
    for k in range(300):  # more than the cache holds, some at memory addresses of deleted ones
        other = Contact("left", CONTACT.plane, friction=0.001 * k, restitution=0.5)
        assert impact(model, data, q, v, other).problem.friction == 0.001 * k
    assert np.array_equal(impact(model, data, q, v, CONTACT).v, first.v)


@pytest.mark.parametrize("kind", ["free flyer", "spherical", "unbounded", "planar"])
def test_configurations_that_are_not_normalized_raise(kind):
    model = robot(kind)
    q, v = state(model)
    q[-2:] *= 1.0 + 1e-6
    q[: model.nq - 2] *= 1.0 + 1e-6
    with pytest.raises(InputError, match="unit length"):
        impact(model, model.createData(), q, v, CONTACT)
    good, _ = state(model)
    rows = impacts(model, model.createData(), np.array([q, good]), v, CONTACT)
    assert rows.status[0] == Status.INVALID_NUMBERS
    assert rows.status[1] <= Status.LOCKED


def test_robot_far_from_the_origin():
    model = robot("revolute", root=pin.JointModelFreeFlyer)
    q, v = state(model)
    v = approaching(model, q, v, CONTACT)
    here = impact(model, model.createData(), q, v, CONTACT)
    q[:3] += 1000.0 * (pin.SE3(model.jointPlacements[1]).rotation.T @ [1.0, 2.0, -3.0])
    away = impact(model, model.createData(), q, v, CONTACT)
    assert away.v == pytest.approx(here.v, rel=1e-11, abs=1e-11)


def test_results_with_several_threads_are_identical():
    model = robot("free flyer")
    data = model.createData()
    rng = np.random.default_rng(0)
    q = np.array([state(model, seed)[0] for seed in range(50)])
    v = rng.standard_normal((50, model.nv))
    q[7], v[11] = np.nan, np.inf
    one = impacts(model, data, q, v, CONTACT)
    for threads in (2, 3, 64):
        more = impacts(model, data, q, v, CONTACT, threads=threads)
        for name in ("v", "impulse_world", "status", "flags"):
            assert np.array_equal(getattr(one, name), getattr(more, name), equal_nan=name != "status")
        assert np.array_equal(one.work.friction, more.work.friction, equal_nan=True)
    assert (one.status == Status.INVALID_NUMBERS).nonzero()[0].tolist() == [7, 11]
    with pytest.raises(InputError, match="threads"):
        impacts(model, data, q, v, CONTACT, threads=0)


def test_rows_of_equal_configurations_equal_single_impacts():
    """The tree is reevaluated only if q differs from the previous row."""
    model = robot("free flyer")
    data = model.createData()
    first, second = state(model, 1)[0], state(model, 2)[0]
    bad = first * (1.0 + 1e-6)
    q = np.array([first, first, second, bad, bad, second, np.full(model.nq, np.nan), second, first, first])
    v = np.random.default_rng(0).standard_normal((10, model.nv))
    rows = impacts(model, data, q, v, CONTACT)
    assert rows.status[[3, 4, 6]].tolist() == 3 * [Status.INVALID_NUMBERS]
    for k in (0, 1, 2, 5, 7, 8, 9):
        assert np.array_equal(rows.v[k], impact(model, data, q[k], v[k], CONTACT).v)


def test_joint_without_inertia_is_named_with_any_number_of_threads():
    model = robot("revolute")
    model.armature = np.zeros(model.nv)
    for j in (3, 4):
        model.inertias[j] = pin.Inertia.Zero()
    q = np.tile(state(model)[0], (70, 1))
    for threads in (1, 3):
        with pytest.raises(ModelError, match="'right'"):
            impacts(model, model.createData(), q, np.ones((70, model.nv)), CONTACT, threads=threads)
