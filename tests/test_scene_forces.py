"""Forces and modes of scenes, against the full equations of motion and enumeration of modes."""

from __future__ import annotations

import itertools

import numba
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import linprog

from pinimpact import Contact, Plane, Scene
from pinimpact.scene._kernels import active_set
from pinimpact.scene._kernels.contact_forces import FREE, HELD, SLIP, STICK
from pinimpact.scene.dynamics import SceneDynamics

from .scene_models import G


@numba.njit
def close(work, reference):
    """Call `active_set.close`, which has no Python wrapper."""
    active_set.close(work, reference)


def tree(rng):
    """Return a free-flying body with three arms, their tips, dry friction in two joints, and a state."""
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, pin.Inertia.FromEllipsoid(1.0, 0.3, 0.2, 0.1), pin.SE3.Random())
    for arm in range(3):
        parent = root
        for k, joint in enumerate((pin.JointModelRX(), pin.JointModelPY(), pin.JointModelSpherical())):
            parent = model.addJoint(parent, joint, pin.SE3.Random(), f"{arm}{k}")
            model.appendBodyToJoint(parent, pin.Inertia.FromEllipsoid(1.0, 0.3, 0.2, 0.1), pin.SE3.Random())
        model.addFrame(pin.Frame(f"tip{arm}", parent, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    model.lowerPositionLimit, model.upperPositionLimit = np.full(model.nq, -np.inf), np.full(model.nq, np.inf)
    friction = np.zeros(model.nv)
    friction[[6, 12]] = 1e6
    model.friction = friction
    return (
        model,
        pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv)),
        rng.normal(size=model.nv),
    )


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    "modes",
    [(SLIP, FREE, FREE), (STICK, SLIP, FREE), (SLIP, SLIP, SLIP), (STICK, FREE, HELD), (STICK, SLIP, HELD)],
)
def test_accelerations_and_forces_solve_the_full_system(seed, modes):
    """Compare with one linear system in v̇ and forces: equations of motion and conditions of all modes."""
    pin.seed(seed)
    rng = np.random.default_rng(seed)
    model, q, v = tree(rng)
    mu, tau = 0.3, rng.normal(size=model.nv)
    contacts = [Contact(f"tip{k}", Plane(), friction=mu) for k in range(3)]
    scene = Scene(model, contacts, control=lambda *_: tau)
    dynamics = SceneDynamics(scene, model, contacts, [], [])
    work = dynamics.work
    work.modes[:3] = modes
    work.modes[3 + 6] = 1  # the joint of velocity 6 is held by its dry friction
    work.direction_speed = 0.0

    data = model.createData()
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    rows, wanted, pushes, axes = [], [], [], []
    reference = np.zeros((3, 2))
    for k, mode in enumerate(modes):
        frame = model.getFrameId(f"tip{k}")
        J = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
        bias = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
        slip = (J @ v)[:2]
        reference[k] = slip / np.linalg.norm(slip)
        if mode == SLIP:
            rows.append(J[2])
            wanted.append(-bias[2])
            pushes.append(J[2] - mu * reference[k] @ J[:2])
            axes.append((k, np.array([*(-mu * reference[k]), 1.0])))
        elif mode != FREE:
            rows.extend(J)
            wanted.extend(-bias)
            pushes.extend(J)
            axes.extend((k, axis) for axis in np.eye(3))
    joint = np.eye(model.nv)[6]
    rows, pushes, wanted = np.array([*rows, joint]), np.array([*pushes, joint]), np.array([*wanted, 0.0])
    mass = pin.crba(model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    acting = tau - pin.nle(model, data, q, v)
    size = len(rows)
    whole = np.block([[mass, -pushes.T], [rows, np.zeros((size, size))]])
    solution = np.linalg.solve(whole, np.concatenate([acting, wanted]))
    acceleration, forces = solution[: model.nv], solution[model.nv :]

    close(work, reference)
    dynamics.begin(0.0, q, v)
    scale = np.abs(acceleration).max()
    assert work.stage_rates[0, model.nv : 2 * model.nv] == pytest.approx(acceleration, abs=1e-9 * scale)
    expected = np.zeros((3, 3))
    for (k, axis), force in zip(axes, forces[:-1], strict=True):
        expected[k] += force * axis
    closed = [k for k in range(3) if modes[k] != FREE]
    assert work.contact_force == pytest.approx(expected[closed], abs=1e-9 * np.abs(forces).max())
    assert work.scalar_force == pytest.approx(forces[-1:], abs=1e-9 * np.abs(forces).max())
    margins = []
    for k in closed:
        if modes[k] != HELD:
            margins.append(expected[k, 2])
        if modes[k] == STICK:
            margins.append(mu * expected[k, 2] - np.hypot(*expected[k, :2]))
    margins += [1e6 - abs(forces[-1])]
    assert work.force_margin == pytest.approx(min(margins), abs=1e-8 * np.abs(forces).max())


def bar(length):
    """Return a bar in the plane y = 0 that rests level on two tips, with its centre of mass above them."""
    model = pin.Model()
    parent = 0
    for k, kind in enumerate((pin.JointModelPX(), pin.JointModelPZ(), pin.JointModelRY())):
        parent = model.addJoint(parent, kind, pin.SE3.Identity(), "xza"[k])
    inertia = pin.Inertia(1.0, np.array([0.0, 0.0, 0.2]), np.diag([0.02, 0.05, 0.05]))
    model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    for k, x in enumerate((-length, length)):
        placement = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        model.addFrame(pin.Frame(f"tip{k}", parent, 0, placement, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit, model.upperPositionLimit = np.full(3, -np.inf), np.full(3, np.inf)
    return model


OPEN, REST, RIGHT, LEFT = range(4)


def consistent_accelerations(length, mu, push):
    """Return all consistent pairs of modes of the two tips, with accelerations (ẍ, z̈, α)."""
    h, inertia = 0.2, 0.05
    # about the origin of the bar; α rotates z towards x, so a tip at (x, 0) accelerates by −x α along z
    mass = np.array([[1.0, 0, h], [0, 1.0, 0], [h, 0, inertia + h * h]])
    acting = push + np.array([0.0, -G, 0.0])
    tips = [np.array([[1.0, 0, 0], [0, 1.0, -x]]) for x in (-length, length)]
    found = []
    for modes in itertools.product((OPEN, REST, RIGHT, LEFT), repeat=2):
        if modes == (REST, REST):  # at rest if forces within both friction cones are in equilibrium
            columns = np.hstack([J.T for J in tips])
            cone = np.zeros((4, 4))
            for k in range(2):
                cone[2 * k, 2 * k : 2 * k + 2] = 1.0, -mu
                cone[2 * k + 1, 2 * k : 2 * k + 2] = -1.0, -mu
            bounds = [(None, None), (0, None)] * 2
            if linprog(np.zeros(4), cone, np.zeros(4), columns, -acting, bounds).status == 0:
                found.append((modes, np.zeros(3)))
            continue
        rows, pushes, owners = [], [], []
        for k, mode in enumerate(modes):
            if mode == OPEN:
                continue
            rows.append(tips[k][1])
            sign = {REST: 0.0, RIGHT: -1.0, LEFT: 1.0}[mode]
            pushes.append(tips[k][1] + sign * mu * tips[k][0])
            owners.append(k)
            if mode == REST:
                rows.append(tips[k][0])
                pushes.append(tips[k][0])
                owners.append(k)
        size = len(rows)
        R, P = np.array(rows).reshape(size, 3), np.array(pushes).reshape(size, 3)
        whole = np.block([[mass, -P.T], [R, np.zeros((size, size))]])
        if abs(np.linalg.det(whole)) < 1e-12:
            continue
        solution = np.linalg.solve(whole, np.concatenate([acting, np.zeros(size)]))
        a, forces = solution[:3], list(solution[3:])
        ok = True
        for k, mode in enumerate(modes):
            at, an = tips[k] @ a
            mine = [forces[i] for i in range(size) if owners[i] == k]
            if mode == OPEN:
                ok &= an > 0
            else:
                ok &= mine[0] >= 0
                ok &= abs(mine[1]) <= mu * mine[0] if mode == REST else True
                ok &= at > 0 if mode == RIGHT else at < 0 if mode == LEFT else True
        if ok:
            found.append((modes, a))
    return found


def test_modes_agree_with_enumeration():
    """Under random forces a bar on two tips stays at rest, slides, tips over, does both, or lifts off."""
    rng = np.random.default_rng(5)
    met = set()
    for _ in range(150):
        length, mu = rng.uniform(0.1, 0.5), rng.uniform(0.1, 0.7)
        push = rng.normal(size=3) * [8.0, 8.0, 3.0]
        found = consistent_accelerations(length, mu, push)
        assert found
        modes, expected = found[0]
        if any(np.abs(a - expected).max() > 1e-9 for _, a in found):
            continue  # not unique (Painlevé)
        model = bar(length)
        contacts = [Contact(f"tip{k}", Plane(), friction=mu) for k in range(2)]
        scene = Scene(model, contacts, control=lambda *_, push=push: push)
        dynamics = SceneDynamics(scene, model, contacts, [], [])
        work = dynamics.work
        work.stick_speed, work.direction_speed = 1e-5, 1e-9
        dynamics.set_modes(0.0, np.zeros(3), np.zeros(3), np.ones(2, dtype=np.int64))
        dynamics.begin(0.0, np.zeros(3), np.zeros(3))
        assert work.stage_rates[0, 3:6] == pytest.approx(expected, abs=1e-7 * (1 + np.abs(expected).max()))
        kinds = {OPEN: FREE, REST: STICK, RIGHT: SLIP, LEFT: SLIP}
        assert work.modes[:2].tolist() == [kinds[mode] for mode in modes]
        met.add(tuple(sorted(kinds[mode] for mode in modes)))
    assert {(FREE, FREE), (FREE, SLIP), (FREE, STICK), (SLIP, SLIP), (STICK, STICK)} <= met
