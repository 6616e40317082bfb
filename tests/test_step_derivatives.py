"""Derivatives of time steps against difference quotients and closed forms. (derivatives.md, 12)"""

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Boundary, Box, Contact, JointPD, Plane, Scene, Shape, Stepper, simulate

from .scene_models import shaped_body

FLAT = [0, 1, 5, 6, 7, 11]  # changes of the state of a free body that leave a level face on the floor
LOWER, UPPER = [0.2, 0.2, 0.1], [0.2, 0.2, 0.1]


def box(size=(0.1, 0.2, 0.3)):
    """Return a free box with frames at four corners."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, *size), pin.SE3.Identity())
    for k, (x, y) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        place = pin.SE3(np.eye(3), 0.5 * np.array([x, y, -1]) * size)
        model.addFrame(pin.Frame(f"corner {k}", joint, place, pin.FrameType.OP_FRAME))
    return model


def corners(friction, restitution, plane=None):
    return [Contact(f"corner {k}", plane or Plane(), friction, restitution) for k in range(4)]


def two_boxes(places, turns, restitution):
    """Return a scene of two free boxes that collide, and their configuration."""
    model, shapes = pin.Model(), pin.GeometryModel()
    for k in range(2):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"box {k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, *LOWER), pin.SE3.Identity())
        model.addJointFrame(joint)
        shapes.addGeometryObject(pin.GeometryObject(f"box {k}", joint, pin.SE3.Identity(), coal.Box(*LOWER)))
    contact = Contact(geometry="box 1", plane=Shape("box 0"), friction=0.4, restitution=restitution)
    q = pin.neutral(model)
    for k, (place, turn) in enumerate(zip(places, turns, strict=True)):
        q[7 * k : 7 * k + 3] = place
        q[7 * k + 3 : 7 * k + 7] = pin.Quaternion(pin.exp3(np.array(turn))).coeffs()
    return Scene(model, [contact], geometry=shapes), q


def difference_quotient(scene, q0, v0, duration, dt, direction, step):
    """Return the change of the final state along a direction, by a difference quotient of fourth order."""
    model, nv = scene.model, scene.model.nv
    ends = []
    for s in (-2, -1, 0, 1, 2):
        e = s * step * direction
        run = simulate(
            *(scene, pin.integrate(model, q0, e[:nv]), v0 + e[nv:], duration), scheme="time-stepping", dt=dt
        )
        ends.append((run.q[-1], run.v[-1]))
    a, b, _, c, d = (np.concatenate([pin.difference(model, ends[2][0], q), v]) for q, v in ends)
    return (a - 8 * b + 8 * c - d) / (12 * step)


def compare(scene, q0, v0, duration, dt=1e-3, columns=None, step=1e-6, tolerance=1e-6):
    """Compare with difference quotients along a random combination of columns; return run and sensitivity."""
    n = 2 * scene.model.nv
    columns = list(range(n)) if columns is None else columns
    direction = np.zeros(n)
    direction[columns] = np.random.default_rng(len(columns)).normal(size=len(columns))
    run = simulate(scene, q0, v0, duration, scheme="time-stepping", dt=dt, sensitivities="state")
    found = run.sensitivity(duration)
    moved = found.state[:, columns] @ direction[columns]
    expected = difference_quotient(scene, q0, v0, duration, dt, direction, step)
    assert np.linalg.norm(moved - expected) <= tolerance * np.linalg.norm(expected)
    return run, found


def test_body_in_flight():
    q = pin.neutral(box())
    v = np.array([1.0, -0.3, 0.7, 0.4, 1.2, -2.0])
    run, found = compare(Scene(box(), []), q, v, 0.05)
    assert found.boundary == Boundary.NONE
    turned = pin.Quaternion(*np.roll(run.q[-1][3:], 1)).matrix()
    assert np.allclose(found.state[:3, 6:9], 0.05 * turned.T, atol=1e-9)  # x = t v, in the axes at the end


@pytest.mark.parametrize("friction", [0.1, 0.9])
def test_planar_joint_in_flight_and_at_an_impact(friction):
    # the plane of the joint is vertical, and the centre of mass is off its origin
    model = pin.Model()
    upright = pin.SE3(pin.utils.rotate("x", 0.5 * np.pi), np.zeros(3))
    joint = model.addJoint(0, pin.JointModelPlanar(), upright, "body")
    inertia = pin.Inertia(1.2, np.array([0.1, -0.05, 0.02]), np.diag([0.01, 0.02, 0.03]))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addJointFrame(joint)
    q = np.array([0.0, 0.2, np.cos(0.4), np.sin(0.4)])
    flight, _ = compare(Scene(model, []), q, np.array([0.6, 0.3, 5.0]), 0.1)
    assert flight.v[-1, 0] != flight.v[0, 0]
    tip = Contact("body", Plane(), friction=friction, restitution=0.5, offset=(0.15, 0.0, 0.0))
    run, found = compare(Scene(model, [tip]), q, np.array([0.6, -0.3, -5.0]), 0.2)
    assert len(run.impacts) == 1
    assert found.boundary == Boundary.RANK


PULLS, DRAG = np.array([3, -2, 5, 0.2, 0.1, 0.3]), 0.1


def oscillating_control(t, q, v):
    """Return generalized forces that depend on t, q and v."""
    return np.cos(200.0 * t) * np.sin(q[:6]) * PULLS - DRAG * np.sin(v)


def jacobian_of_control(t, q, v):
    turn = pin.Quaternion(q[3:7]).toRotationMatrix()
    by_place = np.zeros((6, 6))
    by_place[:3, :3] = turn
    x, y, z, w = q[3:7]
    by_place[3:, 3:] = 0.5 * np.array([[w, -z, y], [z, w, -x], [-y, x, w]])
    by_q = np.cos(200.0 * t) * np.diag(np.cos(q[:6]) * PULLS) @ by_place
    return np.hstack([by_q, -DRAG * np.diag(np.cos(v))])


oscillating_control.jacobian = jacobian_of_control


@pytest.mark.parametrize("restitution", [0.0, 0.4])
@pytest.mark.parametrize("friction", [0.3, 2.0])
@pytest.mark.parametrize("control", [None, oscillating_control])
def test_box_landing_on_corner(friction, restitution, control):
    """An impact cuts a step, so the midpoint of the next one, where the control is evaluated, changes."""
    model = box()
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0.2, 0.3, 0.2, 0.1]))
    v = np.array([0.5, 0.2, -0.3, 0.2, 0.1, 0.3])
    run, _ = compare(Scene(model, corners(friction, restitution), control=control), q, v, 0.12, 2e-3)
    assert (len(run.impacts) > 0) == (restitution > 0.0)
    assert any(interval.mode in ("slip", "stick") for interval in run.modes) or run.impacts


@pytest.mark.parametrize("delay", [0.0, 0.004])
def test_sampled_control(delay):
    """The control is evaluated at the start too, before the first step."""
    model = box()
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0.2, 0.3, 0.2, 0.1]))
    v = np.array([0.5, 0.2, -0.3, 0.2, 0.1, 0.3])
    scene = Scene(model, corners(0.3, 0.4), control=oscillating_control, period=0.013, delay=delay)
    run, _ = compare(scene, q, v, 0.12, 2e-3)
    assert run.impacts


@pytest.mark.parametrize("height", [0.5 * 9.81 * 0.1**2, 0.0503])
def test_ball_bouncing_within_step_or_at_its_end(height):
    # steps are exact in free fall, with derivative [[1, t], [0, 1]]; that of the impact is
    # [[−e, 0], [−(1 + e) g/v, −e]]
    model, e, g = pin.Model(), 0.5, 9.81
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "height")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.addJointFrame(joint)
    scene = Scene(model, [Contact("height", Plane(), restitution=e)])
    run = simulate(scene, [height], [0.0], 0.15, scheme="time-stepping", dt=1e-3, sensitivities="state")
    found = run.sensitivity(0.15)
    fall = np.sqrt(2.0 * height / g)
    at_impact = np.array([[-e, 0.0], [-(1.0 + e) * g / (-g * fall), -e]])
    before, after = (np.array([[1.0, t], [0.0, 1.0]]) for t in (fall, 0.15 - fall))
    assert len(run.impacts) == 1
    assert np.allclose(found.state, after @ at_impact @ before, rtol=1e-9)


def test_sliding_block():
    # for any step size v = v° − μ g t, so along the slip ∂v/∂μ = −g t and ∂x/∂μ = −g t²/2
    model, q = box(), pin.neutral(box())
    q[2] = 0.15
    scene, t = Scene(model, corners(0.3, 0.0)), 0.05
    names = [f"friction:{contact.label}" for contact in scene.contacts]
    v = np.array([0.6, 0.8, 0, 0, 0, 0])
    run = simulate(scene, q, v, t, scheme="time-stepping", dt=1e-3, sensitivities=("state", *names))
    found = run.sensitivity(t)
    together = sum(found.parameters.values())
    along = np.array([0.6, 0.8])
    assert np.allclose(together[6:8], -9.81 * t * along, rtol=1e-6)
    assert np.allclose(together[:2], -0.5 * 9.81 * t**2 * along, rtol=1e-6)
    assert Boundary.CLOSED in found.boundary
    # the direction of slip is constant, so a change across it decreases in proportion to the speed
    across = np.array([-0.8, 0.6])
    assert np.isclose(across @ found.state[6:8, 6:8] @ across, 1.0 - 0.3 * 9.81 * t, rtol=2e-3)


def test_sliding_friction_is_independent_of_friction_of_impacts():
    model, q = box(), pin.neutral(box())
    q[2] = 0.15
    contacts = [replace(one, sliding_friction=0.2) for one in corners(0.3, 0.0)]
    names = [f"friction:{contact.label}" for contact in Scene(model, contacts).contacts]
    run = simulate(
        Scene(model, contacts), q, [1.0, 0, 0, 0, 0, 0], 0.05, scheme="time-stepping", sensitivities=names
    )
    assert run.v[-1][0] == pytest.approx(1.0 - 0.2 * 9.81 * 0.05, rel=1e-6)
    assert all((by == 0.0).all() for by in run.sensitivity(0.05).parameters.values())


def test_box_at_rest():
    model, q = box(), pin.neutral(box())
    q[2] = 0.15
    scene, h = Scene(model, corners(0.5, 0.0)), 1e-3
    found = simulate(scene, q, np.zeros(6), 0.02, scheme="time-stepping", dt=h, sensitivities="state")
    state = found.sensitivity(0.02).state
    assert np.allclose(state[:, [0, 1, 5]], np.eye(12)[:, [0, 1, 5]], atol=1e-9)
    assert np.allclose(state[[0, 1, 5], [6, 7, 11]], 0.5 * h, atol=1e-9)  # the velocity lasts for half a step
    assert np.allclose(state[6:], 0.0, atol=1e-9)


def test_no_derivative_by_motion_that_friction_just_holds():
    """All velocities vanish, so the tolerance of ties is relative to those that impulses remove."""
    model = box()
    q = pin.neutral(model)
    q[:3] = 0.15 * np.array([0.2, 0.0, 1.0]) / np.hypot(0.2, 1.0)
    q[3:7] = pin.Quaternion(pin.exp3(np.array([0.0, np.arctan(0.2), 0.0]))).coeffs()
    scene = Scene(model, corners(0.2, 0.0, Plane(normal=(0.2, 0.0, 1.0))))
    run = simulate(scene, q, np.zeros(6), 0.02, scheme="time-stepping", sensitivities="state")
    found = run.sensitivity(0.02)
    assert np.isnan(found.state[:, 6]).all()
    assert np.isfinite(found.state[:, [0, 1]]).all()
    assert Boundary.EVENTS_COINCIDE in found.boundary
    mass = pin.Model()
    joint = mass.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "height")
    mass.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    mass.friction[:] = 9.81
    run = simulate(Scene(mass), [0.0], [0.0], 0.02, scheme="time-stepping", sensitivities="state")
    assert np.isnan(run.sensitivity(0.02).state[0, 1])


def test_ball_at_rest_rolls_after_any_change():
    """Bodies at rest are skipped, except in steps that are differentiated."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.addJointFrame(joint)
    q = pin.neutral(model)
    q[2] = 0.1
    scene = Scene(model, Contact("ball", Plane(), 0.3, radius=0.1))
    columns = [0, 1, 3, 4, 5, 6, 7, 9, 10, 11]
    compare(scene, q, np.zeros(6), 0.05, columns=columns, step=1e-5)
    for rested in (0, 5):
        stepper = Stepper(scene, q, np.zeros(6), scheme="time-stepping")
        for _ in range(rested):
            stepper.step(np.zeros(6), 0.01)
        A, B = stepper.linearize(np.zeros(6), 0.01)
        assert A[6, 6] == pytest.approx(5.0 / 7.0, rel=1e-6)  # of rolling without slip
        assert B[6, 0] == pytest.approx(0.01 * 5.0 / 7.0, rel=1e-2)


@pytest.mark.parametrize("e", [0.0, 0.4])
def test_no_derivative_by_restitution_at_zero(e):
    """At e = 0 a step stops the corner, for any e > 0 an impact does, up to a step earlier or later."""
    model = box()
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0.2, 0.3, 0.2, 0.1]))
    contacts, v = corners(0.3, e), np.array([0.5, 0.2, -0.5, 0.2, 0.1, 0.3])
    names = [f"restitution:corner {k} on plane" for k in range(4)]
    names = {"sensitivities": ("state", *names)}
    run = simulate(Scene(model, contacts), q, v, 0.08, scheme="time-stepping", **names)
    found = run.sensitivity(0.08)
    by_e = np.array(list(found.parameters.values()))
    assert np.isnan(by_e[2]).all() if e == 0.0 else np.abs(by_e[2]).max() > 0.1
    assert (by_e[[0, 1, 3]] == 0.0).all()
    assert np.isfinite(found.state).all()
    assert (Boundary.JUMP in found.boundary) == (e == 0.0)


def test_sliding_box_with_unloaded_corner():
    """The normal impulse of one corner is zero in all iterations but the first."""
    model, q = box(), pin.neutral(box())
    q[2] = 0.15
    run, found = compare(
        *(Scene(model, corners(0.3, 0.0)), q, np.array([0.6, 0.3, 0, 0, 0, 1.0]), 0.05),
        **{"columns": FLAT, "step": 1e-5, "tolerance": 1e-5},
    )
    assert np.isfinite(found.state[:, FLAT]).all()
    assert min(interval.end for interval in run.modes) == 0.05


def test_box_sliding_and_spinning_on_face():
    # loads are those of four equally stiff corners, with an error of about 1e-5
    model, q = box(), pin.neutral(box())
    q[2] = 0.15
    v = np.array([1.0, 0.3, 0, 0, 0, 0.7])
    compare(Scene(model, corners(0.3, 0.0)), q, v, 0.02, columns=FLAT, step=1e-5, tolerance=1e-4)


@pytest.mark.parametrize(
    ("friction", "turn", "v"),
    [
        (0.3, [-0.1, -0.2, 1.1], [0.3, -0.1, -0.1, 0.7, 0.4, 0.3]),
        (0.3, [0.1, 0.1, 1.6], [0.2, 0.5, 0, 0.5, 0.5, -0.1]),  # depends on changes of the compliances
        (0.2, [0.1, -0.2, 1.7], [-0.4, -0.1, 0, 0.6, 1.2, 1.2]),  # slip almost ends
        (0.9, [-0.1, 0.1, 0.6], [-0.6, -0.2, -0.1, 2.1, -2.4, 0.0]),
    ],
)
def test_box_falling_flat_while_sliding_on_edge(friction, turn, v):
    """No velocity satisfies the rows of all corners, so the impulses of the iterations have no limit."""
    model = box((0.2, 0.2, 0.1))
    scene = Scene(model, corners(friction, 0.0))
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, *turn]))
    q[2] -= min(contact.gap(model, model.createData(), q) for contact in scene.contacts)
    _, found = compare(scene, q, np.array(v), 0.1, 2e-3, [*range(6, 12)], step=1e-7, tolerance=1e-4)
    assert np.isfinite(found.state).all()


def cube_on_two_floors(friction=0.4):
    """Return a scene of a cube of 0.2 m on two level floors that meet at x = 0.03 m.

    Their stiffness differs, so that no corner is omitted.
    """
    cube = shaped_body(coal.Box(0.2, 0.2, 0.2), pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2), name="cube")
    floors = [Box(size=(1.0, 1.0, 0.2), center=(0.03 + x, 0, -0.1), name=f"floor {x}") for x in (-0.5, 0.5)]
    given = {"geometry": "cube", "friction": friction}
    contacts = [Contact(plane=floor, stiffness=1.0 + 1e-12 * k, **given) for k, floor in enumerate(floors)]
    return Scene(cube, contacts)


def test_cube_that_settles_on_two_level_floors():
    # eight corners exchange load while some slide and some lift off: the iterations have no limit, and repeat
    # any inconsistency of the derivatives of gaps and velocities; velocities are resolved to 4e-7 m/s
    scene = cube_on_two_floors()
    turn = pin.Quaternion(pin.utils.rotate("y", 0.02) @ pin.utils.rotate("x", 0.013)).coeffs()
    q, v = np.array([0, 0, 0.115, *turn]), np.array([0.3, 0.1, -1.0, 0.2, 0.1, 0.3])
    compare(scene, q, v, 0.018, step=1e-7, tolerance=1e-5)  # falls flat
    found = simulate(scene, q, v, 0.02, scheme="time-stepping", sensitivities="state").sensitivity(0.02)
    assert found.boundary == Boundary.NONE
    steps = np.linspace(-3e-7, 3e-7, 41)
    for k in (0, 2):
        ends = [pin.integrate(scene.model, q, step * np.eye(6)[k]) for step in steps]
        ends = [simulate(scene, end, v, 0.02, scheme="time-stepping").v[-1] for end in ends]
        assert np.allclose(found.state[6:, k], np.polyfit(steps, ends, 1)[0], atol=0.2)


def test_corners_of_faces_that_are_almost_parallel():
    # within 4e-7 rad of parallel, corners are of the shape they belong to, but have the normal of either face
    turn = pin.exp3(np.array([1.5e-7, -2.5e-7, 0.0])) @ pin.utils.rotate("z", 0.3)
    q = np.array([0, 0, 0.10003, *pin.Quaternion(turn).coeffs()])
    v = np.array([-0.3, 0.2, -0.05, 1e-4, 2e-4, 0.5])
    for k in (0, 1, 5, 11):
        compare(cube_on_two_floors(0.9), q, v, 0.003, columns=[k], tolerance=1e-5)


def on_four_floors(friction):
    """Return the contacts of a cube with four level floors, whose stiffness differs: no corner is omitted."""
    centers = [(0.03 + x, 0.02 + y, -0.1) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    floors = [Box(size=(1.0, 1.0, 0.2), center=center, name=f"floor {center}") for center in centers]
    given = {"geometry": "cube", "friction": friction}
    return [Contact(plane=floor, stiffness=1.0 + 1e-12 * k, **given) for k, floor in enumerate(floors)]


def test_removal_of_overlap_at_redundant_corners():
    # multipliers of redundant gaps are shared in proportion to the mobility there, which turns a tilted cube
    cube = shaped_body(coal.Box(0.2, 0.2, 0.2), pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2), name="cube")
    scene = Scene(cube, on_four_floors(0.9))
    q = np.array([0, 0, 0.100012, *pin.Quaternion(pin.exp3(np.array([-1.7e-5, -1.6e-6, 0.0]))).coeffs()])
    v = np.array([0.006, -0.04, -0.3, 0.003, -0.015, -0.08])
    found = simulate(scene, q, v, 0.001, scheme="time-stepping", sensitivities="state").sensitivity(0.001)
    expected = difference_quotient(scene, q, v, 0.001, 1e-3, np.eye(12)[2], 3e-6)
    assert np.allclose(found.state[:, 2], expected, rtol=0.0, atol=1e-6)


def test_removal_of_overlap_leaves_displacements_that_hardly_change_gaps():
    # a cube tilted by 7e-5 rad on four floors: W has singular values of 1e-10 to 1e-9 of the largest, which
    # the iterations do not resolve; the derivative by the tilt was wrong by 1
    cube = shaped_body(coal.Box(0.2, 0.2, 0.2), pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2), name="cube")
    scene = Scene(cube, on_four_floors(0.0))
    turn = pin.Quaternion(np.array([1.039377e-05, 3.39801958e-05, 1.49438132e-01, 9.88771077e-01]))
    q = np.array([0, 0, 0.10001948, *turn.normalized().coeffs()])
    v = np.array([-0.23564725, -0.02270263, -0.22159327, 0.00369946, -0.22664502, 0.49290726])
    found = simulate(scene, q, v, 0.001, scheme="time-stepping", sensitivities="state").sensitivity(0.001)
    expected = difference_quotient(scene, q, v, 0.001, 1e-3, np.eye(12)[4], 1e-6)
    assert np.allclose(found.state[:, 4], expected, rtol=0.0, atol=1e-3)


def test_derivatives_of_impulses_without_recorded_iterations():
    """Three iterations represent impulses of the direct method; the box lands on two independent corners."""
    model = box((0.2, 0.2, 0.1))
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0.08, 0.3, 0, 0]))
    run = simulate(
        *(Scene(model, corners(0.3, 0.0)), q, [0.5, 0.2, -0.5, 0, 0, 0.1], 0.06),
        **{"scheme": "time-stepping", "dt": 1e-3, "sensitivities": ("state", "friction:corner 0 on plane")},
    )
    taken = [step.taken for step in run.sensitivities._steps]
    known = run.sensitivity(0.06)
    assert sum(len(one.found.course[0]) for one in taken) > 50
    run.sensitivities._starts.clear()
    run.sensitivities._slopes.steps._held = None
    for one in taken:
        one.found = one.found._replace(course=one.found.course[:, :0])
    found = run.sensitivity(0.06)
    assert not np.array_equal(found.state, known.state)
    np.testing.assert_allclose(found.state, known.state, rtol=0, atol=1e-4 * np.abs(known.state).max())
    for name, by in known.parameters.items():
        assert np.abs(by).max() > 1e-3
        np.testing.assert_allclose(found.parameters[name], by, rtol=0, atol=1e-4 * np.abs(by).max())


def test_removal_of_overlap_of_box_falling_flat():
    """A corner that separates while the overlap of others is removed has z = 0 in (D36)."""
    model = box((0.2, 0.2, 0.1))
    scene = Scene(model, corners(0.9, 0.0))
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, -0.1, -0.3, 1.1]))
    q[2] -= min(contact.gap(model, model.createData(), q) for contact in scene.contacts)
    v = np.array([0.3, -0.1, -0.1, 2.1, 1.2, 0.9])
    compare(scene, q, v, 0.1, 2e-3, [*range(6, 12)], tolerance=1e-4)


def test_impact_at_start_of_step():
    """Removal of overlap with the floor moves a corner onto the wall, so the next step has zero length."""
    model, size = box((0.2, 0.2, 0.1)), 0.5 * np.array([0.2, 0.2, 0.1])
    model.addFrame(pin.Frame("top", 1, pin.SE3(np.eye(3), size), pin.FrameType.OP_FRAME))
    floor = Contact("corner 1", Plane(), 0.3, 0.0)
    wall = Contact("top", Plane((0.1, 0, 0), (-1, 0, 0)), 0.3, 0.4)
    scene, data = Scene(model, [floor, wall]), model.createData()
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, 0, 0.05, -0.01]))
    q[2] -= floor.gap(model, data, q) - 1e-3
    q[0] += wall.gap(model, data, q)
    run, _ = compare(scene, q, np.array([0.07, 0.2, -0.57, 1.19, -0.12, 0.77]), 0.012, 2e-3, tolerance=1e-4)
    assert run.impacts[0].time == pytest.approx(0.004, abs=1e-12)


def test_contact_opening_within_tolerance_of_iterations():
    """The normal impulse of a corner decreases in each iteration, but has not vanished when they end."""
    model = box((0.2, 0.2, 0.1))
    scene = Scene(model, corners(0.5, 0.0))
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, -0.221222, -0.070401, 1.159418]))
    q[2] -= min(contact.gap(model, model.createData(), q) for contact in scene.contacts) - 2e-3
    v = np.array([-0.116562, -0.098592, -0.823709, -1.431632, -0.251664, -1.265615])
    compare(scene, q, v, 0.1, 2e-3, [3, *range(6, 12)], tolerance=1e-4)


def panda():
    robot = pinimpact.load_robot("panda")
    robot.model.damping[:] = 0.5
    v = 0.2 * np.random.default_rng(1).normal(size=9)
    v[7:] = 0.0
    return robot, v


@pytest.mark.parametrize("stiff", [1.0, 300.0])
def test_drives_and_damping(stiff):
    robot, v = panda()
    gains = stiff * np.array([80.0] * 7 + [50.0] * 2)
    control = JointPD(gains, 0.1 * gains / np.sqrt(stiff), robot.q0 + 0.2)
    compare(Scene(robot.model, control=control, without=["joint limits"]), robot.q0, v, 0.05)


@pytest.mark.parametrize(("restitution", "damping"), [(0.0, 0.5), (0.5, 0.5), (0.5, 500.0)])
def test_joint_limit(restitution, damping):
    """Strong damping of a wrist joint is implicit (θ = 1), also in the step that the impact divides."""
    robot, v = panda()
    robot.model.damping[5] = damping
    q = robot.q0.copy()
    q[0], v[0] = robot.model.upperPositionLimit[0] - 0.003, 0.4
    scene = Scene(robot.model, limit_restitution=restitution)
    compare(scene, q, v, 0.03, columns=[*range(7), *range(9, 16)])


def test_dry_friction_and_sphere_on_moving_plane():
    robot, v = panda()
    robot.model.friction[:3] = 3.0
    plane = Plane((0, 0, 0.48), (0.1, 0.05, 1.0), velocity=(0.1, -0.2, 0.0))
    hand = Contact("panda_hand_tcp", plane, 0.3, 0.3, radius=0.02)
    q = pinimpact.place_in_contact(robot.model, robot.data, robot.q0, hand)
    J = pinimpact.contact_matrices(robot.model, robot.data, q, hand).jacobian
    q = pin.integrate(robot.model, q, 2e-3 * np.linalg.pinv(J)[:, 2])
    v = v - np.linalg.pinv(J)[:, 2] * (0.5 + J[2] @ v)
    run, _ = compare(Scene(robot.model, [hand], without=["joint limits"]), q, v, 0.03)
    assert run.impacts


@pytest.mark.parametrize("restitution", [0.0, 0.3])
@pytest.mark.parametrize("what", ["edges", "corner on face", "face on corner"])
def test_two_boxes_collide(what, restitution):
    places, turns = {
        "edges": ([(0, 0, 0.2), (0.07, 0.03, 0.45)], [(0, 0.8, 0.1), (0.8, 0, 0)]),
        "corner on face": ([(0, 0, 0.2), (0.02, 0.01, 0.43)], [(0.05, 0.02, 0.1), (0.5, 0.6, 0.1)]),
        "face on corner": ([(0, 0, 0.2), (0.02, 0.01, 0.43)], [(0.5, 0.6, 0.1), (0.05, 0.02, 0.1)]),
    }[what]
    scene, q = two_boxes(places, turns, restitution)
    v = np.array([0, 0, 0, 0.1, 0.2, 0.3, 0.3, 0.1, -2.9, 0.1, 0.2, 0.3])
    # the impact is where the gap of a linear rate closes, some 1e-7 m from the true contact
    run, _ = compare(scene, q, v, 0.05, tolerance=1e-5)
    falling = (v + 0.05 * np.array([0, 0, -9.81] + 9 * [0]))[:3]
    assert np.abs(run.v[-1][:3] - falling).max() > 0.05  # they collided


@pytest.mark.parametrize("aligned", [False, True])
def test_box_resting_on_another(aligned):
    places, turns = [(0, 0, 0.2), (0.03, 0.02, 0.3)], [(0, 0, 0.1), (0, 0, 0.35)]
    if aligned:
        places, turns = [(0, 0, 0.2), (0, 0, 0.3)], [(0, 0, 0), (0, 0, 0)]
    scene, q = two_boxes(places, turns, 0.0)
    floor = [Contact(geometry="box 0", plane=Plane((0, 0, 0.15)), friction=0.5)]
    scene = replace(scene, contacts=[*scene.contacts, *floor])
    columns = [0, 1, 5, 6, 7, 11]
    run = simulate(scene, q, np.zeros(12), 0.01, scheme="time-stepping", dt=1e-3, sensitivities="state")
    found = run.sensitivity(0.01)
    assert np.allclose(found.state[:, columns], np.eye(24)[:, columns], atol=1e-8)
    assert (Boundary.FEATURES_MEET in found.boundary) == aligned


@pytest.mark.parametrize("scheme", ["time-stepping", "auto"])
@pytest.mark.parametrize("restitution", [0.0, 0.4])
def test_linearize(scheme, restitution):
    model = box()
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0.2, 0.3, 0.2, 0.1]))
    v, tau = np.array([0.5, 0.2, -0.3, 0.2, 0.1, 0.3]), np.array([0.1, 0.2, -0.3, 0.01, 0.02, 0.03])
    stepper = Stepper(Scene(model, corners(0.3, restitution)), q, v, scheme=scheme)
    for _ in range(7):
        stepper.step(np.zeros(6), 0.004)
    A, B = stepper.linearize(tau, 0.02)
    assert stepper.t == pytest.approx(0.028)
    direction = np.array([0.3, -0.2, 0.5, 0.01, 0.03, -0.02])

    def end(s):
        twin = stepper.copy()
        return twin.step(tau + s * direction, 0.02)

    (q1, v1), (q2, v2) = end(1e-4), end(-1e-4)
    found = np.concatenate([pin.difference(model, q2, q1), v1 - v2]) / 2e-4
    assert np.allclose(B @ direction, found, rtol=1e-6, atol=1e-8)
    assert np.isfinite(A).all()


def test_no_derivative_where_two_gaps_close_at_once():
    model, q = box(), pin.neutral(box())
    q[2] = 0.152
    scene = Scene(model, corners(0.3, 0.5))
    run = simulate(
        scene, q, np.array([0, 0, -1.0, 0, 0, 0]), 0.01, scheme="time-stepping", sensitivities="state"
    )
    found = run.sensitivity(0.01)
    assert Boundary.EVENTS_COINCIDE in found.boundary
    assert np.isnan(found.state).all()


@pytest.mark.parametrize(
    ("turn", "dt", "duration", "speed"),
    [
        ([0.435, 0.034, 0.0], 4e-3, 0.186, 1.1),
        ([0.107, -0.31, 0.0], 4e-3, 0.08, 0.6),
        ([0.42, 0.034, 0.0], 4e-3, 0.18, 1.1),
    ],
)
def test_impact_next_to_sliding_contact(turn, dt, duration, speed):
    """The normal velocity of the sliding contact vanishes at ends of steps, not at an impact within one."""
    model, bounce = box(), [0.0, 0.5]
    contacts = [replace(one, restitution=e) for one, e in zip(corners(0.1, 0.0)[:2], bounce, strict=True)]
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, *turn]))
    q[2] -= contacts[0].gap(model, model.createData(), q)
    v = np.array([0.3, 0.1, 0, 0, 0, 0])
    run, _ = compare(Scene(model, contacts), q, v, duration, dt, FLAT)
    group, _ = run.impacts[0].group
    beside, at_impact = -np.asarray(group.problem.velocity)[:, 2]
    assert 1e-6 < abs(beside) < 1e-3
    assert at_impact == pytest.approx(speed, rel=0.1)


def test_impact_next_to_closed_limit():
    """The impact is where the linear gap vanishes, so the gap itself depends on the state.

    The contact points of an impact at several contacts are on the surfaces, and move with their gaps.
    """
    model = pin.Model()
    upper = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "upper")
    model.appendBodyToJoint(
        upper, pin.Inertia(1.0, np.array([0.2, 0, 0]), 0.02 * np.eye(3)), pin.SE3.Identity()
    )
    lower = model.addJoint(upper, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.4, 0, 0])), "lower")
    side = model.addJoint(lower, pin.JointModelRX(), pin.SE3.Identity(), "side")
    model.appendBodyToJoint(
        side, pin.Inertia(0.7, np.array([0.2, 0, 0]), 0.01 * np.eye(3)), pin.SE3.Identity()
    )
    model.addFrame(
        pin.Frame("tip", side, pin.SE3(np.eye(3), np.array([0.4, 0.1, 0.05])), pin.FrameType.OP_FRAME)
    )
    model.lowerPositionLimit = np.array([-9.0, -9.0, -9.0])
    model.upperPositionLimit = np.array([0.1, 9.0, 9.0])
    scene = Scene(model, Contact("tip", Plane((0, 0, -0.35)), 0.3, 0.6), limit_restitution=0.0)
    run, _ = compare(scene, np.array([0.1, 0.2, 0.3]), np.array([0.0, 1.0, 2.0]), 0.24, 4e-3, [1, 2, 4, 5])
    assert "tip on plane" in {record.source for record in run.impacts}


@pytest.mark.parametrize("gap", [0.08, 0.084])
def test_landing_right_at_the_midpoint_or_end_of_a_step_has_no_derivative(gap):
    """A cart strikes a door without restitution; the sign of the gap decides which step stops it."""
    model, end = pin.Model(), 0.05
    for name, kind in (("cart", pin.JointModelPX()), ("door", pin.JointModelRZ())):
        joint = model.addJoint(0, kind, pin.SE3.Identity(), name)
        middle = pin.SE3(np.eye(3), np.array([0.0, 0.5 * (name == "door"), 0.0]))
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), middle)
        model.addJointFrame(joint)
    model.gravity = pin.Motion.Zero()
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    leaf = Plane(normal=(-1, 0, 0), body="door")
    scene = Scene(model, Contact("cart", leaf, friction=0.0, offset=(0.0, 0.4, 0.0)))

    def state(apart, **more):
        run = simulate(scene, [-apart, 0.0], [4.0, 0.0], end, scheme="time-stepping", dt=2e-3, **more)
        return np.concatenate([run.q[-1], run.v[-1]]), run

    before, run = state(gap, sensitivities="state")
    found = run.sensitivity(end)
    ahead, behind = ((state(gap - s)[0] - before) / s for s in (1e-6, -1e-6))
    assert np.abs(ahead - behind).max() > 0.01
    assert Boundary.EVENTS_COINCIDE in found.boundary
    assert np.isnan(found.state[:, 0]).all()
    beside = state(gap + 1e-3, sensitivities="state")[1].sensitivity(end)
    assert Boundary.EVENTS_COINCIDE not in beside.boundary
    assert np.isfinite(beside.state).all()


def test_derivatives_of_a_box_that_flies_beside_an_edge():
    """The point of the edge that is near is on no feature whose motion is known, but it takes no part."""
    robot = shaped_body(coal.Box(0.2, 0.2, 0.2), pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2), name="cube")
    floors = [Box(size=(1.0, 1.0, 0.2), center=(x, 0.0, -0.1), name=f"floor {x}") for x in (0.0, 1.0)]
    scene = Scene(robot, [Contact(geometry="cube", plane=floor) for floor in floors])
    q0 = np.array([0.3993, 0.0, 0.1002, 0.0, 0.0, 0.0, 1.0])
    v0 = np.array([0.7, 0.01, 0.0, 0.0, 0.0, 0.0])
    run = simulate(scene, q0, v0, 0.001, scheme="time-stepping", sensitivities=("state",))
    along = np.eye(12)[:, [0, 1, 2, 6, 7, 8]]
    right = along + 0.001 * np.pad(along[6:], ((0, 6), (0, 0)))
    np.testing.assert_allclose(run.sensitivity(0.001).state[:, [0, 1, 2, 6, 7, 8]], right, atol=1e-6)
