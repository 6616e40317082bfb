"""Impacts of scenes: at joint limits of constrained robots, one after the other, at uncoupled contacts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene, Sphere, impact, simulate


def chain(joints):
    """Return a planar chain of links of 0.4 m in the plane x z, without gravity, and its last frame."""
    model, parent, place = pin.Model(), 0, pin.SE3.Identity()
    for k in range(joints):
        parent = model.addJoint(parent, pin.JointModelRY(), place, f"j{k}")
        model.appendBodyToJoint(
            parent, pin.Inertia.FromBox(1.0 + k, 0.4, 0.1, 0.1), pin.SE3(np.eye(3), np.array([0.2, 0, 0]))
        )
        place = pin.SE3(np.eye(3), np.array([0.4, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", parent, place, pin.OP_FRAME))
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    model.gravity.linear[:] = 0.0
    return model


@pytest.mark.parametrize("locked", [(), ("j2",)])
@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
def test_joint_limit_is_hit_while_contact_is_held_and_joint_locked(scheme, held, locked):
    """Compared with M Δv = Aᵀ λ + s p, A Δv = 0, s v⁺ = −e s v⁻ for the constraint rows A."""
    model, e = chain(4), 0.4
    data, q, tip = model.createData(), np.array([0.3, 0.7, -0.5, 0.9]), model.getFrameId("tip")

    def tip_rows(q):
        return pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)[[0, 2] if held else []]

    v = np.array([1.0, 0.3, 0.2, -0.4])
    v -= np.linalg.pinv(tip_rows(q)) @ tip_rows(q) @ v
    v /= v[0]
    model.upperPositionLimit[0] = q[0] + 5e-4
    pin.framesForwardKinematics(model, data, q)
    anchor = Contact("tip", Plane(point=data.oMf[tip].translation))
    scene = Scene(model, held=[anchor] if held else [], locked=locked, limit_restitution=e)
    (hit,) = simulate(scene, q, v, 1e-3, scheme=scheme).impacts
    stop = -np.eye(4)[0]
    rows = np.vstack([tip_rows(hit.q), np.eye(4)[[2] if locked else []], stop])
    mass = np.triu(pin.crba(model, data, hit.q))
    mass += np.triu(mass, 1).T
    system = np.block([[mass, -rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    right = np.zeros(len(system))
    right[-1] = -(1.0 + e) * (stop @ hit.v_before)
    assert hit.v_before[0] > 0.1
    change = np.linalg.solve(system, right)[:4]
    np.testing.assert_allclose(hit.v_after, hit.v_before + change, atol=1e-12)


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
def test_restitution_of_joint_limits_can_be_switched_off(scheme):
    model = chain(1)
    model.upperPositionLimit[0] = 0.1
    scene = Scene(model, limit_restitution=0.5, without=["restitution"])
    run = simulate(scene, [0.0], [1.0], 0.2, scheme=scheme)
    assert run.q[-1] == pytest.approx(0.1, abs=1e-9)
    assert run.v[-1] == pytest.approx(0.0, abs=1e-8)


def test_sequence_of_impacts_has_the_restitution_of_each_speed():
    """Three equal balls in a row: two impacts with e = speed, one after the other."""
    model, radius = pin.Model(), 0.1
    for name in "abc":
        joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, radius), pin.SE3.Identity())
        model.addJointFrame(joint)
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    contacts = [
        Contact(b, Sphere(radius=radius, body=a), radius=radius, restitution=lambda speed: speed)
        for a, b in ("ab", "bc")
    ]
    run = simulate(Scene(model, contacts, simultaneous="sequence"), [-0.1, 0.2, 0.4], [0.8, 0.0, 0.0], 0.2)
    first = 0.5 * 0.8 * np.array([1.0 - 0.8, 1.0 + 0.8])
    second = 0.5 * first[1] * np.array([1.0 - first[1], 1.0 + first[1]])
    assert [one.source for one in run.impacts[:2]] == [contact.label for contact in contacts]
    np.testing.assert_allclose(run.impacts[0].v_after, [*first, 0.0], atol=1e-12)
    np.testing.assert_allclose(run.impacts[1].v_after, [first[0], *second], atol=1e-12)


def test_contact_that_locked_joint_uncouples_keeps_its_law():
    """Two arms on a locked slider: beside the other arm, at rest on the floor, one has Poisson's law."""
    model, here = pin.Model(), pin.SE3.Identity()
    base = model.addJoint(0, pin.JointModelPX(), here, "base")
    model.appendBodyToJoint(base, pin.Inertia.FromSphere(1.0, 0.1), here)
    for name in "ab":
        joint = model.addJoint(base, pin.JointModelRY(), here, f"{name}_hip")
        model.appendBodyToJoint(
            joint, pin.Inertia.FromBox(1.0, 0.4, 0.1, 0.1), pin.SE3(np.eye(3), np.array([0.2, 0, 0]))
        )
        joint = model.addJoint(
            joint, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.4, 0, 0])), f"{name}_knee"
        )
        model.appendBodyToJoint(
            joint, pin.Inertia.FromBox(1.0, 0.4, 0.1, 0.1), pin.SE3(np.eye(3), np.array([0.2, 0, 0]))
        )
        model.addFrame(pin.Frame(name, joint, pin.SE3(np.eye(3), np.array([0.4, 0, 0])), pin.OP_FRAME))
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    data, q = model.createData(), np.array([0.0, 0.5, 0.9, 0.4, 0.8])
    pin.framesForwardKinematics(model, data, q)
    contacts = [
        Contact(name, Plane(point=data.oMf[model.getFrameId(name)].translation), 0.3, 0.6) for name in "ab"
    ]
    v = np.array([0.0, 1.0, -0.2, 0.0, 0.0])
    alone = impact(model, data, q, v, contacts[0], locked=["base"])
    assert "slip" in {one.mode for one in alone.solution.segments}
    energetic = impact(model, data, q, v, replace(contacts[0], law="energetic"), locked=["base"])
    assert np.abs(alone.v - energetic.v).max() > 1e-3
    run = simulate(Scene(model, contacts, locked=["base"]), q, v, 1e-6)
    np.testing.assert_allclose(run.impacts[0].v_after, alone.v, atol=1e-12)
