"""Simulations against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

import pinimpact
from pinimpact import Contact, Plane, Scene, SimulationError, load_robot, simulate
from pinimpact.scene.integrator import Integrator
from pinimpact.scene.options import Options
from pinimpact.scene.progress import MAX_STALLED

from .scene_models import UP, G, ball, free_body, pendulum, run, slider, unbounded

FLOOR = Plane()


def sphere(**options):
    return Contact("center", FLOOR, radius=0.1, name="ball", **options)


@pytest.mark.parametrize("stiff", [False, True])
def test_motion_is_as_accurate_among_bodies_at_rest(stiff):
    """The same steps are taken, explicit ones or, with strong damping, implicit ones."""
    ends, steps = [], []
    for others in (0, 1, 40):
        model = pendulum()
        for k in range(others):
            index = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), f"rest {k}")
            model.appendBodyToJoint(index, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        unbounded(model)
        model.damping[0] = 1e4 * stiff
        q, v = np.zeros((2, model.nv))
        q[0], v[0] = 2.5, 1e4 * stiff
        motion = simulate(Scene(model, []), q, v, 5.0, rtol=1e-6)
        ends.append(motion.q[-1][0])
        steps.append(motion.statistics["steps"])
    assert steps[0] == steps[1] == steps[2] > 3
    np.testing.assert_allclose(ends, ends[0], rtol=1e-10)


def test_bouncing_ball_agrees_with_closed_form_up_to_zeno_time():
    e, height = 0.5, 1.0
    scene = Scene(ball(), [sphere(restitution=e)], resting_speed=1e-5)
    trajectory = run(scene, [0, 0, 0.1 + height, *UP], np.zeros(6), 2.0)
    speed, time = np.sqrt(2 * G * height), np.sqrt(2 * height / G)
    assert len(trajectory.impacts) == 19  # 4.43 · 2⁻¹⁹ m/s is the first bounce below 1e-5 m/s
    for impact in trajectory.impacts:
        assert impact.time == pytest.approx(time, rel=1e-12)
        assert impact.v_before[2] == pytest.approx(-speed, rel=1e-8, abs=1e-10)
        if not impact.resting:
            assert impact.v_after[2] == pytest.approx(e * speed, rel=1e-8, abs=1e-10)
            q, _ = trajectory.at(time + e * speed / G)
            assert q[2] - 0.1 == pytest.approx((e * speed) ** 2 / (2 * G), rel=1e-8, abs=1e-15)
        speed *= e
        time += 2 * speed / G
    zeno = np.sqrt(2 * height / G) * (1 + e) / (1 - e)
    assert trajectory.modes[0].start == pytest.approx(zeno, abs=1e-5)
    assert trajectory.modes[0].end == 2.0
    assert np.abs(trajectory.v[-1]).max() <= 1e-14
    assert trajectory.q[-1, 2] == pytest.approx(0.1, abs=1e-13)
    assert any("resting" in note.text for note in trajectory.notes)


@pytest.mark.parametrize("direction", [0.0, 0.7, 3.0])
def test_sliding_ball_starts_to_roll(direction):
    mu, v0 = 0.3, 2.0
    heading = np.array([np.cos(direction), np.sin(direction), 0.0])
    scene = Scene(ball(), [sphere(friction=mu)])
    trajectory = run(scene, [0, 0, 0.1, *UP], [*(v0 * heading), 0, 0, 0], 1.0)
    sliding, rolling = trajectory.modes
    assert (sliding.mode, rolling.mode) == ("slip", "stick")
    assert sliding.end == pytest.approx(2 * v0 / (7 * mu * G), rel=1e-7)
    R = pin.Quaternion(trajectory.q[-1, 3:]).matrix()
    assert R @ trajectory.v[-1, :3] == pytest.approx(5 / 7 * v0 * heading, abs=1e-7)
    assert R @ trajectory.v[-1, 3:] == pytest.approx(
        np.cross([0, 0, 1], heading) * 5 / 7 * v0 / 0.1, abs=1e-6
    )
    lost = trajectory.energy.friction[-1]
    assert lost == pytest.approx(-(2 / 7) * 0.5 * 2.0 * v0**2, rel=1e-7)


@pytest.mark.parametrize(("rtol", "atol"), [(1e-13, 1e-10), (1e-9, 1e-8)])
def test_ball_rolls_at_any_absolute_tolerance(rtol, atol):
    scene, tolerances = Scene(ball(), [sphere(friction=0.3)]), {"rtol": rtol, "atol": atol}
    v0 = [0.5, 0, 0, 0, 5.0, 1.0]  # rolling, with rotation about the vertical
    trajectory = run(scene, [0, 0, 0.1, *UP], v0, 1.0, scheme="event-driven", **tolerances)
    assert trajectory.q[-1, :3] == pytest.approx([0.5, 0.0, 0.1], abs=10 * atol)


@pytest.mark.parametrize("excess", [-1e-3, 1e-3])
def test_block_on_slope_sticks_below_friction_angle_and_slides_above(excess):
    mu = 0.5
    angle = np.arctan(mu) + excess
    normal = (np.sin(angle), 0.0, np.cos(angle))
    scene = Scene(slider(), [Contact("point", Plane(normal=normal), friction=mu)])
    trajectory = run(scene, np.zeros(3), np.zeros(3), 3.0)
    way = np.linalg.norm(trajectory.q[-1])
    if excess < 0:
        assert [m.mode for m in trajectory.modes] == ["stick"]
        assert way < 1e-14
    else:
        assert [m.mode for m in trajectory.modes] == ["slip"]
        assert way == pytest.approx(0.5 * G * (np.sin(angle) - mu * np.cos(angle)) * 9.0, rel=1e-7)


def test_rod_on_two_tips_sticks_below_friction_angle_and_slides_above():
    mu, angle = 0.5, np.arctan(0.5)
    rod = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 0.1, 0.1])), [(-0.5, 0, 0), (0.5, 0, 0)])
    for tilt, mode in ((angle - 1e-3, "stick"), (angle + 1e-3, "slip")):
        plane = Plane(normal=(np.sin(tilt), 0.0, np.cos(tilt)))
        contacts = [Contact(f"tip{k}", plane, friction=mu) for k in range(2)]
        q0 = np.concatenate([np.zeros(3), pin.Quaternion(pin.utils.rotate("y", tilt)).coeffs()])
        trajectory = run(Scene(rod, contacts), q0, np.zeros(6), 1.0)
        assert {m.mode for m in trajectory.modes} == {mode}
        way = max(0.0, 0.5 * G * (np.sin(tilt) - mu * np.cos(tilt)))
        assert np.linalg.norm(trajectory.q[-1, :3]) == pytest.approx(way, rel=1e-6, abs=1e-12)


def test_slip_begins_when_increasing_force_exceeds_friction():
    mu, mass, swell = 0.4, 2.0, 3.0

    def push(t, q, v):
        return np.array([swell * t, 0.0, 0.0])

    scene = Scene(slider(mass), [Contact("point", FLOOR, friction=mu)], control=push)
    trajectory = run(scene, np.zeros(3), np.zeros(3), 4.0)
    start = mu * mass * G / swell
    assert [m.mode for m in trajectory.modes] == ["stick", "slip"]
    assert trajectory.modes[0].end == pytest.approx(start, rel=1e-8)
    assert trajectory.v[-1, 0] == pytest.approx(swell * (4.0 - start) ** 2 / (2 * mass), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "swings", [300, *(pytest.param(count, marks=pytest.mark.exhaustive) for count in (1000, 10_000))]
)
def test_pendulum_keeps_period_and_energy_over_many_swings(swings):
    amplitude = 2.0
    m = np.sin(amplitude / 2) ** 2
    period = 4 * ellipk(m) * np.sqrt(1 / G)
    trajectory = run(
        Scene(pendulum()), [amplitude], [0.0], swings * period, audit=1e-8, rtol=1e-12, atol=1e-13
    )
    assert trajectory.q[-1, 0] == pytest.approx(amplitude, abs=1e-8)
    assert abs(trajectory.v[-1, 0]) < 2e-8 * swings  # a phase error of 1e-9 of a period per swing
    quarter = np.array([0.1, 0.3, 12.34]) * period
    sn = ellipj(np.sqrt(G) * quarter + ellipk(m), m)[0]
    q, _ = trajectory.sample(quarter)
    assert q[:, 0] == pytest.approx(2 * np.arcsin(np.sqrt(m) * sn), abs=1e-8)


def test_tumbling_body_conserves_energy_and_momentum():
    model = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([0.1, 0.2, 0.3])))
    model.gravity = pin.Motion.Zero()
    trajectory = run(Scene(model), [0, 0, 0, *UP], [1.0, 2.0, 3.0, 0.1, 5.0, 0.1], 20.0)
    data = model.createData()
    momenta = [
        pin.computeCentroidalMomentum(model, data, q, v).vector.copy()
        for q, v in zip(trajectory.q, trajectory.v, strict=True)
    ]
    assert np.ptp(momenta, axis=0) == pytest.approx(np.zeros(6), abs=1e-6)
    assert np.ptp(trajectory.energy.kinetic) < 1e-6
    assert np.linalg.norm(trajectory.q[:, 3:], axis=1) == pytest.approx(1.0, abs=1e-15)
    assert trajectory.q[-1, :3] == pytest.approx(np.array([1.0, 2.0, 3.0]) * 20.0, rel=1e-6)


@pytest.mark.parametrize("depth", [1e-2, 1e-6, 1e-9])
def test_short_contact_within_a_step_is_detected(depth):
    model = pendulum()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "idle")
    model.appendBodyToJoint(2, pin.Inertia.FromEllipsoid(1.0, 0.3, 0.2, 0.1), pin.SE3.Random())
    unbounded(model)
    model.gravity = pin.Motion.Zero()  # steps are exact and thus as long as possible
    floor = Plane(point=(0, 0, -1.0 + depth))
    q0, v0 = [-0.5, 0.0], [1.0, 0.0]
    scene = Scene(model, [Contact("tip", floor, restitution=1.0)], resting_speed=1e-7)
    trajectory = run(scene, q0, v0, 1.0)
    assert len(trajectory.impacts) == 1
    assert trajectory.impacts[0].time == pytest.approx(0.5 - np.arccos(1.0 - depth), abs=1e-7)
    assert trajectory.v[-1, 0] == pytest.approx(-1.0, rel=1e-12)
    missed = run(Scene(model, [Contact("tip", Plane(point=(0, 0, -1.0 - depth)))]), q0, v0, 1.0)
    assert not missed.impacts
    assert missed.statistics["steps"] <= 10


def test_belt_accelerates_block_with_work_of_surface():
    mu, speed, mass = 0.2, 1.5, 3.0
    belt = Plane(velocity=(speed, 0, 0))
    trajectory = run(
        Scene(slider(mass), [Contact("point", belt, friction=mu)]), np.zeros(3), np.zeros(3), 2.0
    )
    assert [m.mode for m in trajectory.modes] == ["slip", "stick"]
    assert trajectory.modes[0].end == pytest.approx(speed / (mu * G), rel=1e-8)
    assert trajectory.energy.surface[-1] == pytest.approx(mass * speed**2, rel=1e-6)
    assert trajectory.energy.friction[-1] == pytest.approx(-0.5 * mass * speed**2, rel=1e-6)


def test_block_on_turntable_sticks_if_friction_suffices():
    spin, radius = 2.0, 0.3
    table = Plane(angular_velocity=(0, 0, spin))
    for mu, rides in ((1.01 * spin**2 * radius / G, True), (0.99 * spin**2 * radius / G, False)):
        scene = Scene(slider(), [Contact("point", table, friction=mu)])
        trajectory = run(scene, [radius, 0, 0], [0, spin * radius, 0], 2.0)
        end = trajectory.q[-1, :2]
        if rides:
            angle = 2.0 * spin
            assert end == pytest.approx(radius * np.array([np.cos(angle), np.sin(angle)]), abs=1e-6)
        else:
            assert np.linalg.norm(end) > 1.01 * radius


def test_ball_placed_on_belt_reaches_two_sevenths_of_its_speed():
    belt = Plane(velocity=(1.0, 0, 0))
    scene = Scene(ball(), [Contact("center", belt, friction=0.3, radius=0.1)])
    trajectory = run(scene, [0, 0, 0.1, *UP], np.zeros(6), 1.0)
    R = pin.Quaternion(trajectory.q[-1, 3:]).matrix()
    assert R @ trajectory.v[-1, :3] == pytest.approx([2 / 7, 0, 0], abs=1e-7)


def test_joint_limit_rebounds_and_supports_load():
    model = pendulum()
    model.gravity = pin.Motion.Zero()
    model.upperPositionLimit = np.array([0.5])
    trajectory = run(Scene(model, limit_restitution=0.5), [0.0], [1.0], 1.0)
    (hit,) = trajectory.impacts
    assert (hit.source, hit.time) == ("hinge upper", pytest.approx(0.5, rel=1e-12))
    assert trajectory.q[-1, 0] == pytest.approx(0.25, rel=1e-9)
    assert hit.solution.velocity[2] == pytest.approx(0.5)
    model.gravity.linear = np.array([G, 0.0, 0.0])  # pushes against the limit
    model.gravity = pin.Motion(np.array([-G, 0.0, 0.0]), np.zeros(3))
    trajectory = run(Scene(model), [0.0], [0.0], 3.0)
    assert trajectory.q[-1, 0] == 0.5
    assert trajectory.mode_at("hinge upper", 2.9) == "closed"


def test_dry_friction_stops_and_holds_joint():
    model = pendulum()
    model.gravity = pin.Motion.Zero()
    model.friction = np.array([0.5])
    trajectory = run(Scene(model), [0.0], [1.0], 3.0)
    assert trajectory.q[-1, 0] == pytest.approx(1.0, rel=1e-9)  # ω² I / 2τ
    assert trajectory.modes[0].mode == "stuck"
    assert trajectory.modes[0].start == pytest.approx(2.0, rel=1e-9)
    model.gravity = pin.Motion(np.array([0.0, 0.0, -G]), np.zeros(3))
    for angle, holds in ((np.arcsin(0.5 / G) - 1e-3, True), (np.arcsin(0.5 / G) + 1e-3, False)):
        trajectory = run(Scene(model), [angle], [0.0], 1.0)
        assert bool(trajectory.q[-1, 0] == angle) is holds


def test_rod_landing_flat_has_simultaneous_impacts_and_no_constraint_drift():
    rod = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 0.1, 0.1])), [(-0.5, 0, 0), (0.5, 0, 0)])
    contacts = [Contact(f"tip{k}", FLOOR, friction=0.3, restitution=0.4) for k in range(2)]
    trajectory = run(Scene(rod, contacts), [0, 0, 0.2, *UP], np.zeros(6), 20.0)
    assert all(impact.simultaneous for impact in trajectory.impacts[:2])
    data = rod.createData()
    resting = trajectory.t > 2.0
    for q in trajectory.q[resting]:
        assert all(abs(c.gap(rod, data, q)) <= 1e-11 for c in contacts)
    assert np.abs(trajectory.v[-1]).max() < 1e-9


def test_non_unique_load_of_four_tips_is_noted():
    tips = [(x, y, -0.1) for x in (-0.3, 0.3) for y in (-0.2, 0.2)]
    table = free_body(pin.Inertia(4.0, np.array([0.1, 0.05, 0.0]), np.diag([0.1, 0.1, 0.1])), tips)
    contacts = [Contact(f"tip{k}", FLOOR, friction=0.5, restitution=0.2) for k in range(4)]
    trajectory = run(Scene(table, contacts), [0, 0, 0.15, *UP], np.zeros(6), 3.0)
    assert {m.mode for m in trajectory.modes if m.end == 3.0} == {"stick"}
    assert len([m for m in trajectory.modes if m.end == 3.0]) == 4
    assert any("not unique" in note.text for note in trajectory.notes)


def test_slip_without_consistent_forces_becomes_impact_without_collision():
    # a steep rod pushes its tip ahead: c − μ b < 0, and gravity presses the tip onto the floor
    rod = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1 / 12, 1 / 12])), [(-0.5, 0, 0)])
    tilt, mu = np.radians(60.0), 2.5
    plane_rotation = pin.utils.rotate("y", -tilt)
    q0 = [*(plane_rotation @ [0.5, 0, 0]), *pin.Quaternion(plane_rotation).coeffs()]
    c = 1 + 12 * 0.25 * np.cos(tilt) ** 2
    b = 12 * 0.25 * np.cos(tilt) * np.sin(tilt)
    assert c - mu * b < 0
    for heading in (1.0, -1.0):
        v0 = np.concatenate([plane_rotation.T @ [heading, 0, 0], np.zeros(3)])
        trajectory = run(Scene(rod, [Contact("tip0", FLOOR, friction=mu)]), q0, v0, 0.05)
        struck = [i for i in trajectory.impacts if i.time == 0.0]
        assert bool(struck) is (heading < 0)
        if struck:
            assert pinimpact.Flag.IMPACT_WITHOUT_COLLISION in struck[0].solution.flags
            assert any("without collision" in note.text for note in trajectory.notes)


def test_held_tip_is_equivalent_to_hinge():
    # a rod with a held end rotates like a pendulum of the same inertia
    rod = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1 / 12, 1 / 12])), [(-0.5, 0, 0)])
    scene = Scene(rod, held=[Contact("tip0", FLOOR)])
    held = run(scene, [0.5, 0, 0, *UP], np.zeros(6), 2.0, rtol=1e-9)
    hinge = pin.Model()
    joint = hinge.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    inertia = pin.Inertia(1.0, np.array([0.5, 0, 0]), np.diag([1e-3, 1 / 12, 1 / 12]))
    hinge.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    unbounded(hinge)
    turned = run(Scene(hinge), [0.0], [0.0], 2.0, rtol=1e-9)
    assert held.v[-1, 4] == pytest.approx(turned.v[-1, 0], abs=1e-6)
    assert np.linalg.norm(held.q[-1, :3]) == pytest.approx(0.5, abs=1e-9)


def test_flight_agrees_with_mujoco():
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is an independent witness, not a dependency")
    text = """<mujoco><option timestep="2e-5" integrator="RK4"/><worldbody>
      <body><joint name="a" type="hinge" axis="0 1 0" damping="0.05"/>
        <inertial pos="0.1 0 -0.4" mass="1.5" diaginertia="0.02 0.03 0.01"/>
        <body pos="0 0 -0.8"><joint name="b" type="hinge" axis="1 0 0" damping="0.02"/>
          <inertial pos="0 0.05 -0.3" mass="0.7" diaginertia="0.01 0.02 0.03"/></body></body>
      </worldbody></mujoco>"""
    other = mujoco.MjModel.from_xml_string(text)
    state = mujoco.MjData(other)
    state.qpos[:], state.qvel[:] = [1.0, 0.5], [0.3, -2.0]
    mujoco.mj_step(other, state, 50_000)
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "a")
    model.appendBodyToJoint(
        first, pin.Inertia(1.5, np.array([0.1, 0, -0.4]), np.diag([0.02, 0.03, 0.01])), pin.SE3.Identity()
    )
    second = model.addJoint(first, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0, 0, -0.8])), "b")
    model.appendBodyToJoint(
        second, pin.Inertia(0.7, np.array([0, 0.05, -0.3]), np.diag([0.01, 0.02, 0.03])), pin.SE3.Identity()
    )
    unbounded(model)
    model.damping = np.array([0.05, 0.02])
    trajectory = run(Scene(model), [1.0, 0.5], [0.3, -2.0], 1.0)
    assert trajectory.q[-1] == pytest.approx(state.qpos, abs=1e-7)
    assert trajectory.v[-1] == pytest.approx(state.qvel, abs=1e-6)


def test_step_to_non_finite_state_is_rejected_without_calling_control():
    # steps grow during a long flight; the impact at its end starts a fast smooth oscillation
    model, stiffness = slider(), 1e8
    model.lowerPositionLimit = np.array([0.0, -np.inf, -np.inf])

    def control(t, q, v):
        assert np.isfinite(q).all()
        assert np.isfinite(v).all()
        return [0.0, -stiffness * q[1] ** 3 * (1.0 - v[0] ** 2), 0.0]

    scene = Scene(model, control=control, limit_restitution=0.5, without=["gravity"])
    trajectory = pinimpact.simulate(scene, [1000.0, 1.0, 0.0], [-1.0, 0.0, 0.0], 1000.003)
    assert trajectory.statistics["rejected"] > 0
    reference = solve_ivp(
        lambda t, y: [y[1], -0.75 * stiffness * y[0] ** 3], (0, 0.003), [1, 0], rtol=1e-12, atol=1e-12
    )
    assert trajectory.q[-1, :2] == pytest.approx([0.0015, reference.y[0, -1]], abs=1e-6)


@pytest.mark.parametrize("rtol", [1e-5, 1e-8, 1e-11])
def test_chattering_control_raises_and_suggested_remedies_succeed(rtol):
    """Control 0.3 − sign(v): the mass rests from t = 1/0.7, but no value of the control keeps it at rest."""
    model = slider()
    tolerances = {"rtol": rtol, "atol": 1e-2 * rtol}

    def rubbing(t, q, v):
        return np.array([0.3 - np.sign(v[0]), 0.0, 0.0])

    scene = Scene(model, control=rubbing, without=["gravity"])
    with pytest.raises(SimulationError, match=r"discontinuous.*friction.*period=") as caught:
        simulate(scene, np.zeros(3), [1.0, 0.0, 0.0], 3.0, scheme="event-driven", **tolerances)
    assert caught.value.field == "control"
    assert 1.0 < caught.value.partial.t[-1] < 2.0
    model = slider()
    model.friction = np.array([1.0, 0.0, 0.0])
    scene = Scene(model, control=lambda t, q, v: np.array([0.3, 0.0, 0.0]), without=["gravity"])
    trajectory = simulate(scene, np.zeros(3), [1.0, 0.0, 0.0], 3.0, **tolerances)
    assert trajectory.q[-1, 0] == pytest.approx(0.5 / 0.7, rel=1e2 * rtol)
    assert trajectory.v[-1, 0] == 0.0
    scene = Scene(slider(), control=rubbing, period=1e-3, without=["gravity"])
    trajectory = simulate(scene, np.zeros(3), [1.0, 0.0, 0.0], 3.0, **tolerances)
    assert abs(trajectory.v[-1, 0]) < 2e-3


@pytest.mark.parametrize("scheme", ["auto", "event-driven", "time-stepping"])
def test_failing_restitution_ends_the_run(scheme):
    scene = Scene(ball(), [sphere(restitution=lambda speed: 1 / 0)])
    with pytest.raises(pinimpact.SimulationError, match="restitution: ZeroDivisionError at an app") as caught:
        simulate(scene, [0, 0, 0.2, *UP], np.zeros(6), 1.0, scheme=scheme)
    assert 0.0 < caught.value.partial.t[-1] <= np.sqrt(0.2 / G)


def test_control_that_switches_a_hundred_times_is_accepted():
    """A force of ±1 N that switches every T = 10 ms: after each period of 2T, v = 0 and x has grown by T²."""
    rtol = 1e-8
    scene = Scene(
        slider(),
        control=lambda t, q, v: np.array([1.0 if t % 0.02 < 0.01 else -1.0, 0.0, 0.0]),
        without=["gravity"],
    )
    trajectory = simulate(scene, np.zeros(3), np.zeros(3), 1.0, rtol=rtol, atol=1e-2 * rtol, max_step=5e-3)
    assert trajectory.statistics["steps"] > 1000
    assert trajectory.q[-1, 0] == pytest.approx(50 * 0.01**2, rel=1e-5)


def test_energy_includes_rotor_inertia_of_unaligned_axis():
    axis, inertia, rotor, rate = np.array([1.0, 2.0, 3.0]) / math.sqrt(14.0), 0.1, 0.7, 2.0
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRevoluteUnaligned(axis), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
    model.armature, model.damping = np.array([rotor]), np.array([0.3])
    unbounded(model)
    trajectory = simulate(Scene(model, []), [0.0], [rate], 1.0)
    whole = inertia + rotor
    left = rate * math.exp(-0.3 / whole)  # the only force is damping
    assert trajectory.v[-1, 0] == pytest.approx(left, rel=1e-7)
    assert trajectory.energy.kinetic[[0, -1]] == pytest.approx(
        0.5 * whole * np.square([rate, left]), rel=1e-7
    )
    assert abs(trajectory.energy.residual[-1]) < 1e-7


def test_arm_with_rotor_inertia_conserves_energy():
    robot = load_robot("two_link_arm")
    model = robot.model
    unbounded(model)
    model.armature = np.array([0.3, 0.2])
    trajectory = simulate(Scene(model), [0.4, 0.7], [0.0, 1.0], 1.0, rtol=1e-10)
    data = model.createData()
    for k in (0, -1):
        q, v = trajectory.q[k], trajectory.v[k]
        mass = np.triu(pin.crba(model, data, q))
        mass += np.triu(mass, 1).T
        assert trajectory.energy.kinetic[k] == pytest.approx(0.5 * v @ mass @ v, rel=1e-12)
        height = pin.computePotentialEnergy(model, data, q)
        assert trajectory.energy.potential[k] == pytest.approx(height, rel=1e-12, abs=1e-12)
    assert np.ptp(trajectory.energy.potential) > 0.1
    assert np.abs(trajectory.energy.residual).max() < 1e-7


@pytest.mark.parametrize(("covered", "stalled"), [(1e-9, True), (1e-7, False)])
def test_stalled_steps_raise(covered, stalled):
    model = ball()
    integrator = Integrator(Scene(model), pin.neutral(model), np.zeros(6), Options())
    integrator.state.steps, integrator.state.t = MAX_STALLED + 1, covered
    error = integrator.progress.stalled(1.0)
    assert ("without progress" in str(error)) == stalled
