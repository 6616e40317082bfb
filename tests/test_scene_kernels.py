"""The kernels of scenes against Pinocchio and against differences along a motion."""

from __future__ import annotations

import numba
import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene, contact_matrices
from pinimpact.robot._kernels import contact_motion
from pinimpact.scene._kernels import lie_charts
from pinimpact.scene.dynamics import Flow
from pinimpact.scene.joint_charts import joint_table


@numba.njit
def bounds(columns, points, placement, peak, h):
    """Return the bounds for the first contact; `contact_motion.bounds` is called from kernels only."""
    constants, ends, signs, group = points[:4]
    return contact_motion.bounds(columns, signs[0], group, placement[ends[0, 0]], constants[0], peak, h)


def curved_model():
    """A tree with every kind of joint, and a second body beside it."""
    model = pin.Model()
    rng = np.random.default_rng(3)
    parent = 0
    for k, joint in enumerate(
        (
            pin.JointModelFreeFlyer(),
            pin.JointModelRX(),
            pin.JointModelSpherical(),
            pin.JointModelRUBZ(),
            pin.JointModelPlanar(),
            pin.JointModelPY(),
            pin.JointModelFreeFlyer(),
        )
    ):
        placement = pin.SE3(pin.utils.rpyToMatrix(*rng.normal(size=3)), rng.normal(size=3))
        parent = model.addJoint(0 if k == 6 else parent, joint, placement, f"joint{k}")
        model.appendBodyToJoint(parent, pin.Inertia.FromSphere(1.0 + k, 0.3), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"frame{k}", parent, 0, placement, pin.FrameType.OP_FRAME))
    return model


def random_state(model, seed):
    rng = np.random.default_rng(seed)
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    return q, rng.normal(size=model.nv), rng.normal(size=model.nv)


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1e-2, 0.3, 1.5])
def test_charts_move_as_the_model_does(size):
    model = curved_model()
    table = joint_table(model)
    q0, v, xi = random_state(model, 1)
    xi *= size
    rate, q, moved = np.empty(model.nv), np.empty(model.nq), np.empty(model.nq)
    lie_charts.chart_rate(table, xi, v, rate)
    h = 1e-6
    lie_charts.advance(table, q0, xi - h * rate, q)
    lie_charts.advance(table, q0, xi + h * rate, moved)
    assert pin.difference(model, q, moved) / (2 * h) == pytest.approx(v, abs=1e-8)
    assert pin.isNormalized(model, moved, 1e-15)


@pytest.mark.parametrize("body", [None, "frame6"])
@pytest.mark.parametrize("radius", [0.0, 0.4])
def test_the_motion_of_a_contact_is_that_of_its_surface_and_its_bodies(body, radius):
    model = curved_model()
    other = model.createData()
    normal = np.array([0.2, -0.5, 0.8])
    normal /= np.linalg.norm(normal)
    belt = np.cross(normal, [0.3, 0.7, -0.2])
    plane = Plane((0.1, 0.2, -0.3), tuple(normal), tuple(belt), tuple(1.3 * normal), body)
    contact = Contact("frame5", plane, offset=(0.1, -0.2, 0.3), radius=radius)
    q, v, tau = random_state(model, 2)
    scene = Scene(model, [contact], control=lambda *_: tau)
    flow = Flow(scene, model, [contact], [], [])

    def evaluate(q, v):
        found = flow.probe(0.0, q, v, [0])
        return found.joints, found.velocity[0], found.acceleration[0]

    def gap_and_rate(q, v):
        return flow.look(q, v)[0]

    closed = flow.probe(0.0, q, v, [0])
    a, velocity, acceleration = evaluate(q, v)
    matrices = contact_matrices(model, other, q, contact)
    assert closed.gap[0] == pytest.approx(contact.gap(model, other, q), abs=1e-13)
    # the tangential axes may differ by a turn about the normal
    expected = matrices.velocity(v)
    assert velocity[2] == pytest.approx(expected[2], abs=1e-12)
    assert np.hypot(*velocity[:2]) == pytest.approx(np.hypot(*expected[:2]), rel=1e-11)
    assert closed.rows[0, 2] == pytest.approx(matrices.h, abs=1e-12)
    assert closed.rows[0] @ v - velocity == pytest.approx(closed.surface[0], abs=1e-12)
    gap, rate = gap_and_rate(q, v)
    assert gap == pytest.approx(closed.gap[0], abs=1e-13)

    h = 1e-5
    states = [(pin.integrate(model, q, s * v + 0.5 * s * s * a), v + s * a) for s in (h, -h)]
    (ahead, behind), (gap_ahead, gap_behind) = (
        [evaluate(*state)[1] for state in states],
        [gap_and_rate(*state)[0] for state in states],
    )
    assert (ahead - behind) / (2 * h) == pytest.approx(acceleration, rel=1e-7, abs=1e-6)
    assert (gap_ahead - gap_behind) / (2 * h) == pytest.approx(rate, abs=1e-7)


@pytest.mark.slow
def test_the_bound_of_the_curvature_holds():
    model = curved_model()
    contact = Contact("frame5", Plane(), offset=(0.1, 0, 0.2))
    for seed in range(20):
        q, v, tau = random_state(model, seed)
        scene = Scene(model, [contact], control=lambda *_, tau=tau: tau)
        flow = Flow(scene, model, [contact], [], [])
        closed = flow.probe(0.0, q, v, [0])
        a = closed.joints
        peak = np.array([abs(v), abs(a), 0 * v, 0 * v])
        size, *_ = bounds(flow.tree[12], flow.points, flow.tree[8], peak, 0.0)
        assert abs(closed.acceleration[0, 2]) <= size + 9.82  # the acceleration has gravity in it
