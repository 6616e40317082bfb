"""PD control of joints with effort limits, against closed forms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pinimpact
from pinimpact import Contact, InputError, JointPD, Plane, Scene, simulate

from .scene_models import UP, G, ball, pendulum, run, slider, unbounded


def mass(control, damping=0.0, **options):
    """Return a scene of a free mass of 1 kg on three prismatic joints."""
    model = slider()
    model.damping = np.full(3, damping)
    return Scene(model, control=control, without=["gravity"], **options)


def oscillator(x, v, kp, kd, t):
    """Return x(t), ẋ(t) of ẍ = −kp x − kd ẋ."""
    root = np.sqrt(complex(kd * kd / 4 - kp))
    a, b = -kd / 2 + root, -kd / 2 - root
    second = (v - a * x) / (b - a)
    first = x - second
    return (first * np.exp(a * t) + second * np.exp(b * t)).real, (
        first * a * np.exp(a * t) + second * b * np.exp(b * t)
    ).real


@pytest.mark.parametrize(("kp", "kd"), [(4.0, 0.5), (100.0, 0.0), (9.0, 10.0), (1e4, 20.0), (0.0, 3.0)])
def test_damped_oscillator(kp, kd):
    target = np.array([0.4, 0.0, -0.2])
    trajectory = run(mass(JointPD(kp, kd, target)), np.zeros(3), [1.0, 0, 0], 1.0, rtol=1e-10, atol=1e-12)
    for t in (0.1, 0.37, 1.0):
        q, v = trajectory.at(t)
        for i in range(3):
            x, speed = oscillator(-target[i], float(i == 0), kp, kd, t)
            assert q[i] - target[i] == pytest.approx(x, abs=1e-8)
            assert v[i] == pytest.approx(speed, abs=1e-6)


@pytest.mark.parametrize(("kp", "kd"), [(1e4, 1e3), (1e6, 2.5e3), (1e8, 1e5), (1.0, 1e6)])
def test_stiff_drives_need_no_more_evaluations(kp, kd):
    target = np.array([0.4, 0.0, -0.2])
    trajectory = run(mass(JointPD(kp, kd, target)), np.zeros(3), [1.0, 0, 0], 1.0)
    for t in (1e-6, 1e-4, 1e-2, 0.1, 1.0):
        q, v = trajectory.at(t)
        for i in range(3):
            x, speed = oscillator(-target[i], float(i == 0), kp, kd, t)
            assert q[i] - target[i] == pytest.approx(x, abs=1e-8)
            assert v[i] == pytest.approx(speed, abs=1e-6 * max(1.0, np.sqrt(kp)))
    assert trajectory.statistics["evaluations"] < 4000  # explicit steps would be at most about 5/kd


def test_drives_keep_the_numbers_that_they_were_given():
    target = np.zeros(3)
    control = JointPD(10.0, 1.0, target)
    target[:] = 7.0
    trajectory = simulate(mass(control), np.zeros(3), np.zeros(3), 0.5)
    assert np.abs(trajectory.q).max() < 1e-12


def test_error_of_stiff_drives_follows_the_tolerance():
    # a double pendulum with a light lower arm, against scipy's implicit method
    model = pendulum()
    elbow = model.addJoint(1, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0, 0, -1.0])), "elbow")
    model.appendBodyToJoint(
        elbow, pin.Inertia.FromSphere(0.01, 0.05), pin.SE3(np.eye(3), np.array([0, 0, -0.2]))
    )
    unbounded(model)
    data = model.createData()
    kp, kd, target = np.array([5.0, 400.0]), np.array([0.3, 30.0]), np.array([0.5, 1.0])

    def rate(t, y):
        tau = kp * (target - y[:2]) - kd * y[2:]
        return np.concatenate([y[2:], pin.aba(model, data, y[:2], y[2:], tau)])

    exact = solve_ivp(rate, (0, 0.5), [0, 0, 2, -3], method="Radau", rtol=1e-12, atol=1e-13).y[:, -1]
    errors = []
    for rtol in (1e-4, 1e-7, 1e-10):
        scene = Scene(model, control=JointPD(kp, kd, target))
        trajectory = run(scene, [0, 0], [2, -3], 0.5, audit=1e-3, rtol=rtol, atol=1e-2 * rtol)
        assert trajectory.statistics["evaluations"] < 2500
        found = np.concatenate([trajectory.q[-1], trajectory.v[-1]])
        errors.append(np.abs(found - exact).max())
    assert errors[0] < 1e-3
    assert errors[1] < 1e-6
    assert errors[2] < 1e-9


def test_body_on_leg_with_stiff_drive():
    # the foot stands on the floor, and a stiff drive supports the body, which sinks by m g/kp
    model = pin.Model()
    body = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "body")
    leg = model.addJoint(body, pin.JointModelPZ(), pin.SE3.Identity(), "leg")
    model.appendBodyToJoint(body, pin.Inertia.FromSphere(3.0, 0.1), pin.SE3.Identity())
    model.appendBodyToJoint(leg, pin.Inertia.FromSphere(1e-3, 0.01), pin.SE3.Identity())
    model.addFrame(pin.Frame("foot", leg, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    kp, kd = 1e5, 3e3
    control = JointPD([0.0, kp], [0.0, kd], [0.0, -0.5])
    scene = Scene(model, [Contact("foot", Plane(), name="foot")], control=control)
    trajectory = run(scene, [0.5, -0.5], [0, 0], 1.0)
    assert trajectory.mode_at("foot", 1.0) != "free"
    # the body is a damped oscillator of 3 kg about its equilibrium
    x, _ = oscillator(3.0 * G / kp, 0.0, kp / 3.0, kd / 3.0, 0.01)
    assert 0.5 - trajectory.at(0.01)[0][0] == pytest.approx(3.0 * G / kp - x, abs=1e-8)
    assert 0.5 - trajectory.q[-1, 0] == pytest.approx(3.0 * G / kp, abs=1e-8)
    assert trajectory.statistics["evaluations"] < 1500


def test_stiff_drive_leaves_saturation_at_the_exact_time():
    kp, kd, limit = 1e4, 1e3, 2.0
    trajectory = run(mass(JointPD(kp, kd, [0.5, 0, 0], limit)), np.zeros(3), np.zeros(3), 1.5)
    # the force is 2 N until 10⁴ (0.5 − t²) − 10³ · 2 t = 2
    leaves = (-2e3 + np.sqrt(4e6 + 4e4 * (5e3 - 2.0))) / 2e4
    first = trajectory.modes[0]
    assert (first.mode, first.start) == ("saturated", 0.0)
    assert first.end == pytest.approx(leaves, rel=1e-8)
    assert trajectory.modes[1].mode == "saturated"  # braking


@pytest.mark.parametrize(
    ("kp", "kd", "h"),
    [(1e2, 1.0, 0.01), (1e6, 0.0, 3e-3), (1e4, 200.0, 4e-3), (1e8, 0.0, 0.01), (1e8, 1e3, 0.01)],
)
def test_time_steps_of_stiff_drives_are_the_implicit_midpoint_rule(kp, kd, h):
    """Forces are at the means of velocities and of positions at both ends, which is stable for all gains."""
    scene = mass(JointPD(kp, kd, np.zeros(3)), damping=0.5)
    trajectory = simulate(scene, [1.0, 0, 0], [0.0, 0.3, 0], 20 * h, scheme="time-stepping", dt=h)
    x, v, drag = 1.0, 0.0, kd + 0.5
    for k in range(1, 21):
        before = v
        v = ((1.0 - 0.5 * h * drag - 0.25 * h * h * kp) * v - h * kp * x) / (
            1.0 + 0.5 * h * drag + 0.25 * h * h * kp
        )
        x += 0.5 * h * (before + v)
        assert trajectory.q[k, 0] == pytest.approx(x, abs=1e-9)
        assert trajectory.v[k, 0] == pytest.approx(v, abs=1e-9 * (1.0 + np.sqrt(kp)))
    assert np.abs(trajectory.energy.residual).max() < 1e-9 * kp


def test_drive_enters_and_leaves_saturation_at_exact_times():
    kp, kd, limit = 100.0, 4.0, 5.0
    trajectory = run(mass(JointPD(kp, kd, [0.2, 0, 0], limit)), np.zeros(3), np.zeros(3), 1.0, rtol=1e-10)
    # saturated with x = ½ · 5 t² until 100 (0.2 − x) − 4 v = 5, or 15 − 250 t² − 20 t = 0
    leaves = (-20 + np.sqrt(400 + 15000)) / 500
    first = trajectory.modes[0]
    assert (first.source, first.mode, first.start) == ("x drive", "saturated", 0.0)
    assert first.end == pytest.approx(leaves, rel=1e-9)
    x, v = 2.5 * leaves**2, 5.0 * leaves
    assert trajectory.at(leaves)[0][0] == pytest.approx(x, rel=1e-9)
    after, speed = oscillator(x - 0.2, v, kp, kd, 0.1 * leaves)
    assert trajectory.at(1.1 * leaves)[0][0] == pytest.approx(0.2 + after, rel=1e-8)
    assert trajectory.at(1.1 * leaves)[1][0] == pytest.approx(speed, rel=1e-7)
    times = np.linspace(0.0, 1.0, 1001)
    for t in times:
        q, v = trajectory.at(t)
        asked = kp * (0.2 - q[0]) - kd * v[0]
        if abs(asked) > limit * (1 + 1e-6):
            assert trajectory.mode_at("x drive", t) == "saturated"
        elif abs(asked) < limit * (1 - 1e-6):
            assert trajectory.mode_at("x drive", t) == "free"


def test_stiff_saturated_drive_is_a_bang_bang_oscillator():
    # the force is nearly −limit · sign(x), so x = 1 − t² at first, and the period is 4 s
    kp, limit = 1e6, 2.0
    trajectory = run(mass(JointPD(kp, 0.0, np.zeros(3), limit)), [1.0, 0, 0], np.zeros(3), 4.0)
    edge = limit / kp
    energy = limit * (1.0 - edge) + 0.5 * limit * edge  # potential energy, linear beyond the edge
    q, v = trajectory.at(0.5)
    assert q[0] == pytest.approx(1.0 - 0.25, rel=1e-9)
    q, v = trajectory.at(1.0 + 0.01)
    assert 0.5 * v[0] ** 2 + limit * (abs(q[0]) - edge) + 0.5 * limit * edge == pytest.approx(
        energy, rel=1e-7
    )
    crossings = [m for m in trajectory.modes if m.source == "x drive"]
    assert len(crossings) == 3


def test_limits_of_single_joints_and_joint_without_drive():
    kp, kd = np.array([50.0, 0.0, 50.0]), np.array([1.0, 0.0, 1.0])
    control = JointPD(kp, kd, np.ones(3), [np.inf, 1.0, 3.0])
    trajectory = run(mass(control), np.zeros(3), [0.0, 0.5, 0.0], 0.1)
    q, _ = trajectory.at(0.1)
    assert q[0] == pytest.approx(1.0 + oscillator(-1.0, 0.0, 50.0, 1.0, 0.1)[0], abs=1e-8)
    assert q[1] == pytest.approx(0.05, abs=1e-12)
    assert q[2] == pytest.approx(0.5 * 3.0 * 0.01, abs=1e-10)


def test_motion_agrees_with_control_as_a_function():
    robot = pinimpact.load_robot("panda")
    q0 = np.array([0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02])
    reference = q0 + np.array([0.5, 0.2, -0.3, 0.1, 0.4, 0.2, 0.5, 0, 0])
    kp = np.array([80.0] * 7 + [0, 0])
    kd = np.array([8.0] * 7 + [0, 0])
    hand = Contact("panda_hand_tcp", Plane(point=(0, 0, 0.2)), friction=0.4, restitution=0.5)
    options = {"contacts": [hand], "without": ["joint limits"]}
    built_in = Scene(robot, control=JointPD(kp, kd, reference), **options)
    function = Scene(robot, control=lambda t, q, v: kp * (reference - q) - kd * v, **options)
    one, other = (simulate(scene, q0, np.zeros(9), 0.3) for scene in (built_in, function))
    assert one.q[-1] == pytest.approx(other.q[-1], abs=1e-9)
    assert one.v[-1] == pytest.approx(other.v[-1], abs=1e-8)


def test_pendulum_with_saturated_drive():
    kp, kd, limit = 60.0, 3.0, 4.0

    def rate(t, y):
        return [y[1], -G * np.sin(y[0]) + np.clip(kp * (1.0 - y[0]) - kd * y[1], -limit, limit)]

    model = pendulum()
    trajectory = run(Scene(model, control=JointPD(kp, kd, [1.0], limit)), [0.0], [3.0], 2.0)
    reference = solve_ivp(rate, (0, 2), [0, 3], rtol=1e-11, atol=1e-12, max_step=1e-3)
    assert [trajectory.q[-1, 0], trajectory.v[-1, 0]] == pytest.approx(reference.y[:, -1], abs=1e-6)
    assert any(m.mode == "saturated" for m in trajectory.modes)


def test_impact_that_changes_the_sign_of_a_saturated_effort():
    # the force of damping with limited effort is reversed by the impact
    model, kd, limit, e = slider(), 10.0, 3.0, 1.0
    model.lowerPositionLimit = np.array([0.0, -np.inf, -np.inf])
    scene = Scene(
        model, control=JointPD(0.0, [kd, 0, 0], np.zeros(3), limit), limit_restitution=e, without=["gravity"]
    )
    trajectory = run(scene, [0.5, 0, 0], [-4.0, 0, 0], 0.4)
    # saturated: the speed is 4 − 3 t until the impact, and decreases at 3 m/s² after it too
    hit = (4 - np.sqrt(16 - 3)) / 3
    assert trajectory.impacts[0].time == pytest.approx(hit, rel=1e-9)
    speed, left = 4 - 3 * hit, 0.4 - hit
    assert trajectory.q[-1, 0] == pytest.approx(speed * left - 1.5 * left**2, rel=1e-8)


def test_free_base_is_not_driven():
    robot = pinimpact.load_robot("solo12")
    model = robot.model
    q0 = robot.q0.copy()
    q0[2] = 1.0
    scene = Scene(robot, control=JointPD(5.0, 0.1, q0, 2.0))
    moved = q0.copy()
    moved[7:] += 0.1
    trajectory = run(scene, moved, np.zeros(18), 0.1)
    # the centre of mass falls freely
    data = model.createData()
    start = pin.centerOfMass(model, data, moved).copy()
    end = pin.centerOfMass(model, data, trajectory.q[-1]).copy()
    assert end - start == pytest.approx([0, 0, -0.5 * G * 0.01], abs=1e-8)
    assert np.abs(trajectory.q[-1, 7:] - q0[7:]).max() < 0.1


def test_sampled_control():
    period, kp, kd, limit = 0.01, 60.0, 5.0, 4.0
    trajectory = run(mass(JointPD(kp, kd, [0.3, 0, 0], limit), period=period), np.zeros(3), np.zeros(3), 1.0)
    x = v = 0.0
    for _ in range(100):
        u = np.clip(kp * (0.3 - x) - kd * v, -limit, limit)
        x, v = x + v * period + 0.5 * u * period**2, v + u * period
    assert trajectory.q[-1, 0] == pytest.approx(x, abs=1e-12)


def test_joints_without_drives_and_invalid_numbers_raise():
    spinning = pin.Model()
    joint = spinning.addJoint(0, pin.JointModelRUBY(), pin.SE3.Identity(), "spinner")
    spinning.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    with pytest.raises(InputError, match="'spinner' does not have exactly one coordinate"):
        Scene(spinning, control=JointPD(1.0, 1.0, pin.neutral(spinning)))
    with pytest.raises(InputError, match="'body' does not have exactly one coordinate"):
        Scene(ball(), control=JointPD(np.ones(6), 0.0, [0, 0, 0, *UP]))
    for field, wrong in (
        ("kp", JointPD(-1.0, 0.0, np.zeros(3))),
        ("kp", JointPD(np.inf, 0.0, np.zeros(3))),
        ("kp", JointPD([1.0, 2.0], 0.0, np.zeros(3))),
        ("kd", JointPD(1.0, np.nan, np.zeros(3))),
        ("q_ref", JointPD(1.0, 1.0, np.zeros(2))),
        ("q_ref", JointPD(1.0, 1.0, [0, np.nan, 0])),
        ("limits", JointPD(1.0, 1.0, np.zeros(3), 0.0)),
        ("limits", JointPD(1.0, 1.0, np.zeros(3), [1.0, -2.0, 1.0])),
    ):
        with pytest.raises(InputError, match=f"{field}: "):
            mass(wrong)


def test_plan_and_scene_without_control():
    scene = mass(JointPD([1.0, 1.0, 0.0], 0.0, np.zeros(3)))
    assert scene.plan()["control"].reason == "PD control of 2 joints"
    off = Scene(scene.model, control=scene.control, without=["control", "gravity"])
    assert simulate(off, [1.0, 0, 0], np.zeros(3), 0.1).q[-1] == pytest.approx([1.0, 0, 0])
