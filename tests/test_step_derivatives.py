"""Derivatives of time steps, beside differences of the steps. (derivatives.md, 12)"""

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Boundary, Contact, JointPD, Plane, Scene, Shape, Stepper, simulate

FLAT = [0, 1, 5, 6, 7, 11]  # of a free body: changes that leave a level face on the floor
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


def slope(scene, q0, v0, duration, dt, towards, step):
    """Return how the state at the end changes in a direction, by differences of fourth order."""
    model, nv = scene.model, scene.model.nv
    ends = []
    for s in (-2, -1, 0, 1, 2):
        e = s * step * towards
        run = simulate(
            *(scene, pin.integrate(model, q0, e[:nv]), v0 + e[nv:], duration), scheme="time-stepping", dt=dt
        )
        ends.append((run.q[-1], run.v[-1]))
    a, b, _, c, d = (np.concatenate([pin.difference(model, ends[2][0], q), v]) for q, v in ends)
    return (a - 8 * b + 8 * c - d) / (12 * step)


def agrees(scene, q0, v0, duration, dt=1e-3, columns=None, step=1e-6, tolerance=1e-6):
    """Compare in a random direction among some columns; return the trajectory and the sensitivity."""
    n = 2 * scene.model.nv
    columns = list(range(n)) if columns is None else columns
    towards = np.zeros(n)
    towards[columns] = np.random.default_rng(len(columns)).normal(size=len(columns))
    run = simulate(scene, q0, v0, duration, scheme="time-stepping", dt=dt, sensitivities="state")
    found = run.sensitivity(duration)
    moved = found.state[:, columns] @ towards[columns]
    expected = slope(scene, q0, v0, duration, dt, towards, step)
    assert np.linalg.norm(moved - expected) <= tolerance * np.linalg.norm(expected)
    return run, found


def test_a_body_in_flight_falls_and_turns():
    q = pin.neutral(box())
    v = np.array([1.0, -0.3, 0.7, 0.4, 1.2, -2.0])
    _, found = agrees(Scene(box(), []), q, v, 0.05)
    assert found.boundary == Boundary.NONE
    assert np.allclose(found.state[:3, 6:9] @ np.ones(3), found.state[:3, 6:9].sum(axis=1))


PULLS, DRAG = np.array([3, -2, 5, 0.2, 0.1, 0.3]), 0.1


def swings(t, q, v):
    """A control by q, v and the time."""
    return np.cos(200.0 * t) * np.sin(q[:6]) * PULLS - DRAG * np.sin(v)


def jacobian_of_swings(t, q, v):
    turn = pin.Quaternion(q[3:7]).toRotationMatrix()
    by_place = np.zeros((6, 6))
    by_place[:3, :3] = turn
    x, y, z, w = q[3:7]
    by_place[3:, 3:] = 0.5 * np.array([[w, -z, y], [z, w, -x], [-y, x, w]])
    by_q = np.cos(200.0 * t) * np.diag(np.cos(q[:6]) * PULLS) @ by_place
    return np.hstack([by_q, -DRAG * np.diag(np.cos(v))])


swings.jacobian = jacobian_of_swings


@pytest.mark.parametrize("restitution", [0.0, 0.4])
@pytest.mark.parametrize("friction", [0.3, 2.0])
@pytest.mark.parametrize("control", [None, swings])
def test_a_box_lands_on_a_corner_and_slides_or_turns_over_it(friction, restitution, control):
    """An impact cuts a step, so that the next one has another midpoint, at which a control is asked."""
    model = box()
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0.2, 0.3, 0.2, 0.1]))
    v = np.array([0.5, 0.2, -0.3, 0.2, 0.1, 0.3])
    run, _ = agrees(Scene(model, corners(friction, restitution), control=control), q, v, 0.12, 2e-3)
    assert (len(run.impacts) > 0) == (restitution > 0.0)
    assert any(interval.mode in ("slip", "stick") for interval in run.modes) or run.impacts


@pytest.mark.parametrize("delay", [0.0, 0.004])
def test_a_sampled_control(delay):
    """It is asked at the start too, before the first step."""
    model = box()
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0.2, 0.3, 0.2, 0.1]))
    v = np.array([0.5, 0.2, -0.3, 0.2, 0.1, 0.3])
    scene = Scene(model, corners(0.3, 0.4), control=swings, period=0.013, delay=delay)
    run, _ = agrees(scene, q, v, 0.12, 2e-3)
    assert run.impacts


@pytest.mark.parametrize("height", [0.5 * 9.81 * 0.1**2, 0.0503])
def test_a_ball_that_bounces_in_a_step_or_at_its_end(height):
    # steps are exact in free fall: [[1, t], [0, 1]], and [[−e, 0], [−(1 + e) g/v, −e]] at the impact
    model, e, g = pin.Model(), 0.5, 9.81
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "height")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.addJointFrame(joint)
    scene = Scene(model, [Contact("height", Plane(), restitution=e)])
    run = simulate(scene, [height], [0.0], 0.15, scheme="time-stepping", dt=1e-3, sensitivities="state")
    found = run.sensitivity(0.15)
    fall = np.sqrt(2.0 * height / g)
    struck = np.array([[-e, 0.0], [-(1.0 + e) * g / (-g * fall), -e]])
    before, after = (np.array([[1.0, t], [0.0, 1.0]]) for t in (fall, 0.15 - fall))
    assert len(run.impacts) == 1
    assert np.allclose(found.state, after @ struck @ before, rtol=1e-9)


def test_a_block_that_slides_loses_speed_as_friction_says():
    # v = v° − μ g t, whatever the step: ∂v/∂μ = −g t along the slip, ∂x/∂μ = −g t²/2
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
    # what slips keeps its direction: across it changes decay as the speed does
    across = np.array([-0.8, 0.6])
    assert np.isclose(across @ found.state[6:8, 6:8] @ across, 1.0 - 0.3 * 9.81 * t, rtol=2e-3)


def test_friction_of_its_own_in_sustained_contact_is_no_friction_of_impacts():
    model, q = box(), pin.neutral(box())
    q[2] = 0.15
    contacts = [replace(one, sliding_friction=0.2) for one in corners(0.3, 0.0)]
    names = [f"friction:{contact.label}" for contact in Scene(model, contacts).contacts]
    run = simulate(
        Scene(model, contacts), q, [1.0, 0, 0, 0, 0, 0], 0.05, scheme="time-stepping", sensitivities=names
    )
    assert run.v[-1][0] == pytest.approx(1.0 - 0.2 * 9.81 * 0.05, rel=1e-6)
    assert all((by == 0.0).all() for by in run.sensitivity(0.05).parameters.values())


def test_a_box_at_rest_keeps_its_place():
    model, q = box(), pin.neutral(box())
    q[2] = 0.15
    scene, h = Scene(model, corners(0.5, 0.0)), 1e-3
    found = simulate(scene, q, np.zeros(6), 0.02, scheme="time-stepping", dt=h, sensitivities="state")
    state = found.sensitivity(0.02).state
    assert np.allclose(state[:, [0, 1, 5]], np.eye(12)[:, [0, 1, 5]], atol=1e-9)
    assert np.allclose(state[[0, 1, 5], [6, 7, 11]], 0.5 * h, atol=1e-9)  # half a step with the velocity
    assert np.allclose(state[6:], 0.0, atol=1e-9)


def test_friction_that_just_holds_at_rest_has_no_derivative_by_what_it_opposes():
    """Velocities at rest are none, so that what is slow has to be measured by what impulses take away."""
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


def test_a_ball_at_rest_rolls_after_any_change():
    """What rests takes no part in steps, but in those that are differentiated."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.addJointFrame(joint)
    q = pin.neutral(model)
    q[2] = 0.1
    scene = Scene(model, Contact("ball", Plane(), 0.3, radius=0.1))
    columns = [0, 1, 3, 4, 5, 6, 7, 9, 10, 11]
    agrees(scene, q, np.zeros(6), 0.05, columns=columns, step=1e-5)
    for rested in (0, 5):
        stepper = Stepper(scene, q, np.zeros(6), scheme="time-stepping")
        for _ in range(rested):
            stepper.step(np.zeros(6), 0.01)
        A, B = stepper.linearize(np.zeros(6), 0.01)
        assert A[6, 6] == pytest.approx(5.0 / 7.0, rel=1e-6)  # it slides no more, with what spin it has
        assert B[6, 0] == pytest.approx(0.01 * 5.0 / 7.0, rel=1e-2)


@pytest.mark.parametrize("e", [0.0, 0.4])
def test_what_lands_without_restitution_has_no_derivative_by_it(e):
    """It has no impact then, but one for any e > 0: the place of the box is off by what a step lasts."""
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


def test_a_box_that_slides_with_a_corner_without_load():
    """Its load is zero in all iterations but the first, whatever is as near to it."""
    model, q = box(), pin.neutral(box())
    q[2] = 0.15
    run, found = agrees(
        *(Scene(model, corners(0.3, 0.0)), q, np.array([0.6, 0.3, 0, 0, 0, 1.0]), 0.05),
        **{"columns": FLAT, "step": 1e-5, "tolerance": 1e-5},
    )
    assert np.isfinite(found.state[:, FLAT]).all()
    assert min(interval.end for interval in run.modes) == 0.05


def test_a_box_that_turns_on_its_face_while_it_slides():
    # the load is that of four equally stiff corners, found to some 1e-5
    model, q = box(), pin.neutral(box())
    q[2] = 0.15
    v = np.array([1.0, 0.3, 0, 0, 0, 0.7])
    agrees(Scene(model, corners(0.3, 0.0)), q, v, 0.02, columns=FLAT, step=1e-5, tolerance=1e-4)


@pytest.mark.parametrize(
    ("friction", "turn", "v"),
    [
        (0.3, [-0.1, -0.2, 1.1], [0.3, -0.1, -0.1, 0.7, 0.4, 0.3]),
        (0.3, [0.1, 0.1, 1.6], [0.2, 0.5, 0, 0.5, 0.5, -0.1]),  # where a change of the compliances counts
        (0.2, [0.1, -0.2, 1.7], [-0.4, -0.1, 0, 0.6, 1.2, 1.2]),  # where slip almost ends: off by 97 % once
        (0.9, [-0.1, 0.1, 0.6], [-0.6, -0.2, -0.1, 2.1, -2.4, 0.0]),
    ],
)
def test_a_box_that_falls_flat_while_it_slides_on_an_edge(friction, turn, v):
    """Its corners do not all reach what their gaps ask for, and what is left turns it by their friction."""
    model = box((0.2, 0.2, 0.1))
    scene = Scene(model, corners(friction, 0.0))
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, *turn]))
    q[2] -= min(contact.gap(model, model.createData(), q) for contact in scene.contacts)
    _, found = agrees(scene, q, np.array(v), 0.1, 2e-3, [*range(6, 12)], tolerance=1e-4)
    assert np.isfinite(found.state).all()


def test_impulses_without_iterations_change_as_those_of_small_compliances():
    """The method of section 11 has none; the box lands on two corners, whose rows are independent."""
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


def test_a_box_that_falls_flat_is_lifted_to_the_floor_as_exactly_as_it_moves():
    """A corner that lifts off as others are lifted is not held: velocities that follow were off by 0.6 %."""
    model = box((0.2, 0.2, 0.1))
    scene = Scene(model, corners(0.9, 0.0))
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, -0.1, -0.3, 1.1]))
    q[2] -= min(contact.gap(model, model.createData(), q) for contact in scene.contacts)
    v = np.array([0.3, -0.1, -0.1, 2.1, 1.2, 0.9])
    agrees(scene, q, v, 0.1, 2e-3, [*range(6, 12)], tolerance=1e-4)


def test_an_impact_right_at_the_start_of_a_step():
    """Overlap that is removed on the floor moves a corner onto the wall: the next step has no length."""
    model, size = box((0.2, 0.2, 0.1)), 0.5 * np.array([0.2, 0.2, 0.1])
    model.addFrame(pin.Frame("top", 1, pin.SE3(np.eye(3), size), pin.FrameType.OP_FRAME))
    floor = Contact("corner 1", Plane(), 0.3, 0.0)
    wall = Contact("top", Plane((0.1, 0, 0), (-1, 0, 0)), 0.3, 0.4)
    scene, data = Scene(model, [floor, wall]), model.createData()
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, 0, 0.05, -0.01]))
    q[2] -= floor.gap(model, data, q) - 1e-3
    q[0] += wall.gap(model, data, q)
    run, _ = agrees(scene, q, np.array([0.07, 0.2, -0.57, 1.19, -0.12, 0.77]), 0.012, 2e-3, tolerance=1e-4)
    assert run.impacts[0].time == pytest.approx(0.004, abs=1e-12)


def test_a_contact_that_opens_by_less_than_velocities_are_known():
    """The iterations that press a corner less and less end before velocities are those of the other three."""
    model = box((0.2, 0.2, 0.1))
    scene = Scene(model, corners(0.5, 0.0))
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, -0.221222, -0.070401, 1.159418]))
    q[2] -= min(contact.gap(model, model.createData(), q) for contact in scene.contacts) - 2e-3
    v = np.array([-0.116562, -0.098592, -0.823709, -1.431632, -0.251664, -1.265615])
    agrees(scene, q, v, 0.1, 2e-3, [3, *range(6, 12)], tolerance=1e-4)


def panda():
    robot = pinimpact.load_robot("panda")
    robot.model.damping[:] = 0.5
    v = 0.2 * np.random.default_rng(1).normal(size=9)
    v[7:] = 0.0
    return robot, v


def test_drives_and_damping():
    robot, v = panda()
    gains = np.array([80.0] * 7 + [50.0] * 2)
    control = JointPD(gains, 0.1 * gains, robot.q0 + 0.2)
    agrees(Scene(robot.model, control=control, without=["joint limits"]), robot.q0, v, 0.05)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_a_joint_limit(restitution):
    robot, v = panda()
    q = robot.q0.copy()
    q[0], v[0] = robot.model.upperPositionLimit[0] - 0.003, 0.4
    scene = Scene(robot.model, limit_restitution=restitution)
    agrees(scene, q, v, 0.03, columns=[*range(7), *range(9, 16)])


def test_dry_friction_and_a_sphere_on_a_moving_plane():
    robot, v = panda()
    robot.model.friction[:3] = 3.0
    plane = Plane((0, 0, 0.48), (0.1, 0.05, 1.0), velocity=(0.1, -0.2, 0.0))
    hand = Contact("panda_hand_tcp", plane, 0.3, 0.3, radius=0.02)
    q = pinimpact.place_in_contact(robot.model, robot.data, robot.q0, hand)
    J = pinimpact.contact_matrices(robot.model, robot.data, q, hand).jacobian
    q = pin.integrate(robot.model, q, 2e-3 * np.linalg.pinv(J)[:, 2])
    v = v - np.linalg.pinv(J)[:, 2] * (0.5 + J[2] @ v)
    run, _ = agrees(Scene(robot.model, [hand], without=["joint limits"]), q, v, 0.03)
    assert run.impacts


@pytest.mark.parametrize("restitution", [0.0, 0.3])
@pytest.mark.parametrize("what", ["edges", "corner on face", "face on corner"])
def test_two_moving_boxes_meet(what, restitution):
    places, turns = {
        "edges": ([(0, 0, 0.2), (0.07, 0.03, 0.45)], [(0, 0.8, 0.1), (0.8, 0, 0)]),
        "corner on face": ([(0, 0, 0.2), (0.02, 0.01, 0.43)], [(0.05, 0.02, 0.1), (0.5, 0.6, 0.1)]),
        "face on corner": ([(0, 0, 0.2), (0.02, 0.01, 0.43)], [(0.5, 0.6, 0.1), (0.05, 0.02, 0.1)]),
    }[what]
    scene, q = two_boxes(places, turns, restitution)
    v = np.array([0, 0, 0, 0.1, 0.2, 0.3, 0.3, 0.1, -2.9, 0.1, 0.2, 0.3])
    # an impact takes place where gaps of linear rates close: some 1e-7 m off, of boxes of 0.1 m
    run, _ = agrees(scene, q, v, 0.05, tolerance=1e-5)
    assert np.abs(run.v[-1][:3] - (v + 0.05 * np.array([0, 0, -9.81] + 9 * [0]))[:3]).max() > 0.05  # they met


@pytest.mark.parametrize("aligned", [False, True])
def test_a_box_rests_on_another(aligned):
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
    towards = np.array([0.3, -0.2, 0.5, 0.01, 0.03, -0.02])

    def end(s):
        twin = stepper.copy()
        return twin.step(tau + s * towards, 0.02)

    (q1, v1), (q2, v2) = end(1e-4), end(-1e-4)
    found = np.concatenate([pin.difference(model, q2, q1), v1 - v2]) / 2e-4
    assert np.allclose(B @ towards, found, rtol=1e-6, atol=1e-8)
    assert np.isfinite(A).all()


def test_two_gaps_that_close_at_once_have_no_derivative():
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
def test_an_impact_beside_a_contact_that_slides(turn, dt, duration, speed):
    """The contact has no normal velocity where a step ends, but the impact is in between."""
    model, bounce = box(), [0.0, 0.5]
    contacts = [replace(one, restitution=e) for one, e in zip(corners(0.1, 0.0)[:2], bounce, strict=True)]
    q = pin.integrate(model, pin.neutral(model), np.array([0, 0, 0, *turn]))
    q[2] -= contacts[0].gap(model, model.createData(), q)
    v = np.array([0.3, 0.1, 0, 0, 0, 0])
    run, _ = agrees(Scene(model, contacts), q, v, duration, dt, FLAT)
    group, _ = run.impacts[0].group
    beside, struck = -np.asarray(group.problem.velocity)[:, 2]
    assert 1e-6 < abs(beside) < 1e-3
    assert struck == pytest.approx(speed, rel=0.1)


def test_an_impact_beside_a_closed_limit():
    """It happens where the linear gap is zero, so that the gap itself depends on the state.

    The contact point of an impact of several is that of the surface, which follows the gap.
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
    run, _ = agrees(scene, np.array([0.1, 0.2, 0.3]), np.array([0.0, 1.0, 2.0]), 0.24, 4e-3, [1, 2, 4, 5])
    assert {record.source for record in run.impacts} == {"tip on plane", "upper upper"}
