"""Kernels of scenes, against Pinocchio and finite differences along a motion."""

from __future__ import annotations

import numba
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from pinimpact import Contact, Plane, Scene, Sphere, contact_matrices
from pinimpact.geometry._kernels import surfaces
from pinimpact.geometry._kernels.constants import RADIUS
from pinimpact.geometry.tolerances import SAFETY
from pinimpact.robot._kernels import contact_motion
from pinimpact.scene._kernels import active_set, gap_bounds, lie_charts
from pinimpact.scene.dynamics import SceneDynamics
from pinimpact.scene.joint_charts import joint_table

from .scene_models import slider


@numba.njit
def bounds_about(work, peak, h, reach):
    """Return the bounds for all points within reach of the first contact."""
    return contact_motion.bounds(
        work.joint_jacobian,
        work.velocity_signs,
        work.velocity_joint,
        work.placements[work.contact_joints[0, 0]],
        work.contact_constants[0],
        peak,
        h,
        reach,
    )


@numba.njit
def bounds(work, peak, h):
    """Return the bounds for the first contact; `contact_motion.bounds` is called from kernels only."""
    k = work.contact_constants[0]
    return (*bounds_about(work, peak, h, 0.0), surfaces.least_radius(k) + k[RADIUS])


@numba.njit
def curvatures(gap, rate, later_gap, later_rate, width, bounds):
    """Return `gap_bounds.curvatures`, which is called from kernels only."""
    return gap_bounds.curvatures(gap, rate, later_gap, later_rate, width, bounds)


@numba.njit
def turning_bound(work, peak, h):
    """Return `contact_motion.turning_bound` of the first contact, which is called from kernels only."""
    return contact_motion.turning_bound(
        work.joint_jacobian,
        work.velocity_signs,
        work.placements[work.contact_joints[0, 0]],
        work.contact_constants[0],
        peak,
        h,
    )


@numba.njit
def rim_parts(work, out):
    """Fill `contact_motion.rim_and_rates` of the first contact."""
    tip, base = work.contact_joints[0, 0], work.contact_joints[0, 1]
    contact_motion.rim_and_rates(
        work.placements[tip],
        work.local_velocities[tip],
        work.placements[base],
        work.local_velocities[base],
        work.contact_constants[0],
        out,
    )


@numba.njit
def rim_clear(now, later, radius, curvature, width, floor):
    """Call the kernel of this name, which has no Python wrapper."""
    return gap_bounds.rim_clear(now, later, radius, curvature, width, floor)


def placements(model, data, q):
    """Return the placement of each frame, by name."""
    pin.framesForwardKinematics(model, data, q)
    return {frame.name: pin.SE3(place) for frame, place in zip(model.frames, data.oMf, strict=True)}


def curved_model():
    """Return a kinematic tree with joints of all kinds, and a second free body."""
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
def test_integration_of_configurations_agrees_with_pinocchio(size):
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


def random_surfaces(body):
    """Return a rotating belt, and spinning spheres in several positions relative to the tip."""
    normal = np.array([0.2, -0.5, 0.8])
    normal /= np.linalg.norm(normal)
    belt = np.cross(normal, [0.3, 0.7, -0.2])
    yield Plane((0.1, 0.2, -0.3), tuple(normal), tuple(belt), tuple(1.3 * normal), body)
    model = curved_model()
    data, (q, _, _) = model.createData(), random_state(model, 2)
    pin.framesForwardKinematics(model, data, q)
    tip = data.oMf[model.getFrameId("frame5")].act(np.array([0.1, -0.2, 0.3]))
    if body is not None:
        tip = data.oMf[model.getFrameId(body)].actInv(tip)
    for away in ((0.3, 0.2, 0.8), (0.9, -0.3, -0.1), (0.1, 0.3, -0.7), (0.0, 0.0, -0.6)):
        yield Sphere(tip - away, 0.5, angular_velocity=(0.4, -0.3, 0.9), body=body)


@pytest.mark.parametrize("kind", range(5))
@pytest.mark.parametrize("body", [None, "frame6"])
@pytest.mark.parametrize("radius", [0.0, 0.4])
def test_contact_kinematics_agree_with_finite_differences(body, radius, kind):
    model = curved_model()
    other = model.createData()
    surface = list(random_surfaces(body))[kind]
    contact = Contact("frame5", surface, offset=(0.1, -0.2, 0.3), radius=radius)
    q, v, tau = random_state(model, 2)
    scene = Scene(model, [contact], control=lambda *_: tau)
    dynamics = SceneDynamics(scene, model, [contact], [], [])

    def evaluate(q, v):
        found = dynamics.free_motion_at(0.0, q, v, [0])
        return found.joints, found.velocity[0], found.acceleration[0]

    def gap_and_rate(q, v):
        return dynamics.gaps_at(q, v)[0]

    closed = dynamics.free_motion_at(0.0, q, v, [0])
    a, velocity, acceleration = evaluate(q, v)
    matrices = contact_matrices(model, other, q, contact)
    assert closed.gap[0] == pytest.approx(contact.gap(model, other, q), abs=1e-13)
    # the tangential axes may differ by a rotation about the normal
    expected = matrices.velocity(v)
    assert velocity[2] == pytest.approx(expected[2], abs=1e-12)
    assert np.hypot(*velocity[:2]) == pytest.approx(np.hypot(*expected[:2]), rel=1e-11)
    assert closed.jacobian[0, 2] == pytest.approx(matrices.h, abs=1e-12)
    # the two tangential rows differ by this rotation, without reflection
    turn = np.linalg.lstsq(matrices.K, closed.jacobian[0, :2].T, rcond=None)[0]
    assert matrices.K @ turn == pytest.approx(closed.jacobian[0, :2].T, abs=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-12)
    assert closed.jacobian[0] @ v - velocity == pytest.approx(closed.surface[0], abs=1e-12)
    gap, rate = gap_and_rate(q, v)
    assert gap == pytest.approx(closed.gap[0], abs=1e-13)
    assert rate == pytest.approx(velocity[2], abs=1e-12)

    h = 1e-5
    states = [(pin.integrate(model, q, s * v + 0.5 * s * s * a), v + s * a) for s in (h, -h)]
    (ahead, behind), (gap_ahead, gap_behind) = (
        [evaluate(*state)[1] for state in states],
        [gap_and_rate(*state)[0] for state in states],
    )
    assert (ahead - behind) / (2 * h) == pytest.approx(acceleration, rel=1e-7, abs=1e-6)
    assert (gap_ahead - gap_behind) / (2 * h) == pytest.approx(rate, abs=1e-7)


def test_contact_axes_are_continuous_around_a_sphere():
    model = slider()
    contact = Contact("point", Sphere(radius=1.0))
    dynamics = SceneDynamics(Scene(model, [contact]), model, [contact], [], [])
    rows = []
    for angle in np.linspace(0.0, 4.0 * np.pi, 400):  # two full turns through both poles
        q = np.array([np.sin(angle), 0.0, np.cos(angle)])
        rows.append(dynamics.free_motion_at(0.0, q, np.zeros(3), [0]).jacobian[0])
        assert rows[-1] @ rows[-1].T == pytest.approx(np.eye(3), abs=1e-14)
        assert rows[-1][2] == pytest.approx(q, abs=1e-14)
    assert np.abs(np.diff(rows, axis=0)).max() < 0.04
    # along a great circle the axes do not rotate about the normal
    assert rows[-1] == pytest.approx(rows[0], abs=1e-13)


def test_contact_axes_that_start_at_the_lowest_point_of_a_sphere():
    model = slider()
    contact = Contact("point", Sphere(radius=1.0))
    for tilt in (0.0, 1e-17, -1e-17, 1e-9):
        dynamics = SceneDynamics(Scene(model, [contact]), model, [contact], [], [])
        before = dynamics.free_motion_at(0.0, np.array([tilt, 0.0, -1.0]), np.zeros(3), [0]).jacobian[0]
        after = dynamics.free_motion_at(0.0, np.array([-tilt, 1e-6, -1.0]), np.zeros(3), [0]).jacobian[0]
        assert before @ before.T == pytest.approx(np.eye(3), abs=1e-14)
        assert after == pytest.approx(before, abs=1e-5)


@pytest.mark.slow
def test_bound_of_gap_acceleration():
    model = curved_model()
    contact = Contact("frame5", Plane(), offset=(0.1, 0, 0.2))
    for seed in range(20):
        q, v, tau = random_state(model, seed)
        scene = Scene(model, [contact], control=lambda *_, tau=tau: tau)
        dynamics = SceneDynamics(scene, model, [contact], [], [])
        closed = dynamics.free_motion_at(0.0, q, v, [0])
        a = closed.joints
        peak = np.array([abs(v), abs(a), 0 * v, 0 * v])
        size, *_ = bounds(dynamics.work, peak, 0.0)
        assert abs(closed.acceleration[0, 2]) <= size + 9.82  # the acceleration includes gravity


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from(["", "frame5", "frame5 on frame6"]),
    st.booleans(),
    st.floats(-3, -0.5),
)
def test_the_bounds_of_a_gap_hold_between_any_two_times_of_a_step(seed, where, flat, size):
    """Against differences of gaps along a motion of constant v̇; the tip may go right through the sphere."""
    rng = np.random.default_rng(seed)
    model, tip = (curved_model(), "frame5") if where else (slider(), "point")
    body = "frame6" if "on" in where else None
    data = model.createData()
    h = 10.0**size
    q, v, a = random_state(model, seed)
    a = a / h * rng.uniform()  # what changes in the step is of the size of what is there
    steps = 64
    path = [q]
    for k in range(steps):
        path.append(pin.integrate(model, path[-1], h / steps * (v + (k + 0.5) / steps * h * a)))
    place = [placements(model, data, q) for q in path]
    tips = np.array([frames[tip].act(np.array([0.1, 0, 0.2])) for frames in place])
    if body is not None:
        tips = np.array([f[body].actInv(x) for f, x in zip(place, tips, strict=True)])
    reach = np.abs(tips - tips[0]).max()
    if flat:
        surface = Plane(tips[0], rng.normal(size=3), body=body)
    else:
        surface = Sphere(tips[steps // 2] + rng.normal(size=3) * reach * rng.uniform(), 0.05, body=body)
    contact = Contact(tip, surface, offset=(0.1, 0, 0.2), radius=0.05 * rng.integers(2))
    gaps = np.array([contact.gap(model, data, q) for q in path])
    dt = h / steps
    rates = np.gradient(gaps, dt, edge_order=2)
    second = np.concatenate([[np.nan], np.diff(gaps, 2) / dt**2, [np.nan]])
    blur = 2e-15 * max(1.0, np.abs(tips).max()) / dt**2  # of the differences

    dynamics = SceneDynamics(Scene(model, [contact]), model, [contact], [], [])
    dynamics.free_motion_at(0.0, path[int(rng.integers(steps))], v, [0])
    ends = v, v + h * a
    peak = np.array([np.maximum(*np.abs(ends)), abs(a), abs(h * a), 0 * v])
    found = np.array(bounds(dynamics.work, peak, h))
    found[:3] *= SAFETY
    for _ in range(20):
        i, j = sorted(rng.choice(np.arange(1, steps), 2, replace=False).tolist())
        between = second[i : j + 1]
        fall, bend = curvatures(gaps[i], rates[i], gaps[j], rates[j], (j - i) * dt, found)
        slack = blur + 1e-3 * np.abs(between).max()
        assert -between.min() <= fall + slack
        assert np.abs(between).max() <= bend + slack


def test_bounds_within_reach_cover_those_of_each_point():
    for seed in range(6):
        rng = np.random.default_rng(seed)
        model = curved_model()
        q, v, a = random_state(model, seed)
        peak = np.array([abs(v), abs(a), 0.1 * abs(a), 0.2 * abs(v)])
        found = []
        offsets = [np.zeros(3), *(0.3 * x / np.linalg.norm(x) for x in rng.normal(size=(8, 3)))]
        for offset in offsets:
            contact = Contact("frame5", Plane(), offset=offset)
            dynamics = SceneDynamics(Scene(model, [contact]), model, [contact], [], [])
            dynamics.free_motion_at(0.0, q, v, [0])
            found.append(bounds_about(dynamics.work, peak, 0.02, 0.0 if offset.any() else 0.3))
        assert (np.array(found[0]) >= np.max(found[1:], axis=0)).all()


@pytest.mark.parametrize("body", [None, "frame6"])
def test_bounds_of_rim_gap(body):
    """Compare the terms of the gap, their rates and the bound with finite differences for constant v̇."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        model = curved_model()
        q, v, a = random_state(model, seed)
        h, steps = 0.02, 64
        a = a / h * rng.uniform()
        times = np.linspace(0.0, h, steps + 1)
        path = [q]
        for t in times[:-1]:
            path.append(pin.integrate(model, path[-1], h / steps * (v + (t + 0.5 * h / steps) * a)))
        contact = Contact(
            "frame5", Plane(normal=rng.normal(size=3), body=body), rim=0.4, axis=rng.normal(size=3)
        )
        data = model.createData()
        gaps = np.array([contact.gap(model, data, q) for q in path])
        dynamics = SceneDynamics(Scene(model, [contact]), model, [contact], [], [])
        parts = np.empty((steps + 1, 8))
        for q, t, out in zip(path, times, parts, strict=True):
            found = dynamics.gaps_at(q, v + t * a)
            rim_parts(dynamics.work, out)
            assert found[0, 0] == pytest.approx(out[0] - 0.4 * np.linalg.norm(out[2:5]), abs=1e-14)
        assert parts[:, 0] - 0.4 * np.linalg.norm(parts[:, 2:5], axis=1) == pytest.approx(gaps, abs=1e-14)
        dt = h / steps
        for value, rate in ((parts[:, :1], parts[:, 1:2]), (parts[:, 2:5], parts[:, 5:8])):
            scale = 1e-3 * np.abs(rate).max() + 1e-9
            assert np.gradient(value, dt, axis=0)[1:-1] == pytest.approx(rate[1:-1], abs=scale)
        dynamics.free_motion_at(0.0, path[int(rng.integers(steps))], v, [0])
        peak = np.array([np.maximum(np.abs(v), np.abs(v + h * a)), abs(a), abs(h * a), 0 * v])
        bent = np.linalg.norm(np.diff(parts[:, 5:8], axis=0), axis=1).max() / dt
        bound = turning_bound(dynamics.work, peak, h)
        assert 0.4 * bent <= SAFETY * bound
        size, *_ = bounds(dynamics.work, peak, h)
        # no interval is reported as clear for a floor above the lowest point
        curvature = SAFETY * (size + bound)
        for _ in range(30):
            i, j = sorted(rng.choice(steps + 1, 2, replace=False).tolist())
            for above in (1e-12, 1e-3, 0.1, 1.0):
                floor = -(gaps[i : j + 1].min() + above)
                assert not rim_clear(parts[i], parts[j], 0.4, curvature, (j - i) * dt, floor)
            width = (j - i) * dt
            floor = -(min(gaps[i], gaps[j]) - 2.0 * width * np.abs(parts[:, 1:]).max() - curvature * width**2)
            assert rim_clear(parts[i], parts[j], 0.4, curvature, width, floor)


@numba.njit
def stop_along(rows, velocity, minverse, v):
    """Call `active_set.stop_along`, which has no Python wrapper."""
    return active_set.stop_along(rows, velocity, minverse, v)


@settings(deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 12), st.integers(1, 9), st.integers(1, 9), st.booleans())
def test_what_stops_along_rows_does_so_by_the_least_change(seed, rows, size, rank, moving):
    """Of all velocities that agree with the rows it is the one nearest in the metric of the mass matrix."""
    rng = np.random.default_rng(seed)
    rank = min(rank, rows, size)
    matrix = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, size))
    root = np.tril(rng.normal(size=(size, size)), -1) + np.diag(rng.uniform(0.5, 2.0, size=size))
    mass = root @ root.T
    sizes = np.linalg.svd(np.linalg.solve(root, matrix.T), compute_uv=False)
    assume(sizes[rank - 1] > 1e-2 * sizes[0])  # rows that almost depend on others are stopped only in part
    before = rng.normal(size=size)
    surface = matrix @ rng.normal(size=size) * moving
    v = before.copy()
    energy = stop_along(matrix, matrix @ before - surface, np.linalg.inv(mass), v)
    assert matrix @ v == pytest.approx(surface, abs=1e-9 * (1.0 + np.abs(surface).max()))
    # the change of momentum is a combination of the rows
    impulse = mass @ (v - before)
    part = matrix.T @ np.linalg.lstsq(matrix.T, impulse, rcond=1e-10)[0]
    assert part == pytest.approx(impulse, abs=1e-8 * (1.0 + np.abs(impulse).max()))
    gained = 0.5 * (v @ mass @ v - before @ mass @ before)
    assert energy == pytest.approx(gained, rel=1e-9, abs=1e-9)


def test_stop_along_nearly_parallel_rows():
    """Two rows differ by 10⁻⁷, so a velocity of 10⁻⁴ along their difference has a residual of 10⁻¹¹."""
    rows = np.array([[1.0, 1.0, 0.0], [1.0, 1.0 + 1e-7, 0.0]])
    right, off = np.array([0.3, -0.3, 1.0]), np.array([-1e-4, 1e-4, 0.0])
    v = right + off
    stop_along(rows, rows @ off, np.eye(3), v)
    assert v == pytest.approx(right, abs=1e-8)
