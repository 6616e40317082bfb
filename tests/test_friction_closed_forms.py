"""Sticking, onset and end of slip under random loads, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pinimpact import Contact, Plane, Scene, simulate

from .drawing import examples
from .scene_models import (
    G,
    box_on,
    box_on_a_slope,
    boxes_on_a_belt,
    rough_joint,
    slider,
    unbounded,
)
from .stick_slip import Swing, stick_slip

TOLERANCES = st.sampled_from([1e-4, 1e-6, 1e-8, 1e-10])


def powers(low, high):
    """Draw powers of ten with uniform exponents."""
    return st.floats(low, high).map(lambda x: 10.0**x)


def through_the_center(force, heading):
    return np.array([force * math.cos(heading), force * math.sin(heading), 0.0, 0.0, 0.0, 0.0])


@examples(40)
@given(powers(-2, 0).filter(lambda part: part < 0.99), powers(-0.5, 0.5), st.floats(1.0, 9.0), TOLERANCES)
def test_dry_friction_holds_between_two_crossings_and_lets_go_gently(part, b, later, rtol):
    """v falls to zero at t_c − b, where the load has less than the friction; at t_c it has as much."""
    a = 0.5 * part * b
    t_c, k = b + later, 2.0 * a / b**2
    scene = Scene(rough_joint(0.5), control=lambda t, q, v: np.array([-k * (t - t_c) - 0.5]))
    trajectory = simulate(scene, [0.0], [a - a * t_c**2 / b**2], t_c + 5.0, rtol=rtol, atol=1e-2 * rtol)
    (stuck,) = [interval for interval in trajectory.modes if interval.mode == "stuck"]
    # a part rtol of the largest force is none, nor are 1e-10 of the weight
    assert stuck.end == pytest.approx(t_c, abs=(rtol + 1e-10 * G) / k)
    assert trajectory.v[-1, 0] == pytest.approx(-0.5 * k * 25.0, rel=1e2 * rtol)


@examples(40)
@given(st.floats(0.1, 2.0), powers(-0.5, 1.3), st.floats(0.0, 6.28), st.floats(-0.45, 0.45))
def test_a_joint_with_dry_friction_under_a_swinging_force(amplitude, pace, phase, mean):
    load = Swing(amplitude, pace, phase, mean)
    x, v, _ = stick_slip(load, 0.5, 20.0)
    scene = Scene(rough_joint(0.5), control=lambda t, q, v: np.array([load.force(t)]))
    trajectory = simulate(scene, [0.0], [0.0], 20.0, rtol=1e-8, atol=1e-10)
    assert trajectory.q[-1, 0] == pytest.approx(x, abs=1e-5)
    assert trajectory.v[-1, 0] == pytest.approx(v, abs=1e-5)
    assert np.diff(trajectory.energy.joints).max() <= 1e-12


@examples(20)
@given(
    st.sampled_from([3, 4, 8, 16]),
    st.floats(0.0, 6.28),
    st.floats(0.0, 6.28),
    powers(-1, 0.2),
    powers(0, 1.5),
    TOLERANCES,
)
def test_a_box_on_corners_slips_when_its_cone_is_used_up(corners, turn, heading, mu, rate, rtol):
    model, contacts = box_on(corners, 0.01, turn, mu)
    onset = mu * G / rate
    scene = Scene(model, contacts, control=lambda t, q, v: through_the_center(rate * t, heading))
    trajectory = simulate(
        scene, [0, 0, 0.01, 0, 0, 0, 1.0], np.zeros(6), onset + 1.0, rtol=rtol, atol=1e-2 * rtol
    )
    along = np.array([math.cos(heading), math.sin(heading)])
    assert trajectory.v[-1, :2] @ along == pytest.approx(0.5 * rate, rel=1e3 * rtol)
    assert trajectory.q[-1, :2] @ along == pytest.approx(rate / 6.0, rel=1e3 * rtol)
    starts = [m.start for m in trajectory.modes if m.mode == "slip"]
    # a part rtol of the largest force is none, nor are 1e-10 of the weight, on each corner
    assert starts == pytest.approx([onset] * corners, rel=(3.0 * rtol + 1e-10 * corners) / mu)


@examples(15)
@given(
    st.sampled_from([3, 4, 8]),
    st.floats(0.0, 6.28),
    st.floats(0.0, 6.28),
    powers(-0.5, 1),
    st.floats(0.0, 6.28),
    st.floats(0.5, 2.0),
    st.floats(-0.4, 0.4),
)
def test_a_box_on_corners_moves_as_a_point_does(corners, turn, heading, pace, phase, amplitude, mean):
    mu = 0.5
    load = Swing(amplitude * mu * G, pace, phase, mean * mu * G)
    x, _, _ = stick_slip(load, mu * G, 6.0)
    model, contacts = box_on(corners, 0.01, turn, mu)
    scene = Scene(model, contacts, control=lambda t, q, v: through_the_center(load.force(t), heading))
    trajectory = simulate(scene, [0, 0, 0.01, 0, 0, 0, 1.0], np.zeros(6), 6.0)
    along = np.array([math.cos(heading), math.sin(heading)])
    assert trajectory.q[-1, :2] @ along == pytest.approx(x, abs=1e-5)


@examples(30)
@given(
    st.lists(st.sampled_from([0.2, 0.5]) | st.floats(0.05, 1.0), min_size=1, max_size=3),
    st.floats(0.1, 2.0),
    TOLERANCES,
)
def test_boxes_on_a_belt_come_up_to_its_speed_each_for_itself(mus, speed, rtol):
    scene = boxes_on_a_belt(mus, speed)
    model = scene.model
    end = speed / (min(mus) * G) + 0.1
    trajectory = simulate(scene, np.zeros(model.nq), np.zeros(model.nv), end, rtol=rtol, atol=1e-2 * rtol)
    for k, mu in enumerate(mus):
        lag = 0.5 * speed**2 / (mu * G)
        assert trajectory.q[-1, 3 * k] == pytest.approx(speed * end - lag, rel=1e2 * rtol)
    assert trajectory.notes == ()


@examples(40)
@given(st.floats(0.05, 1.2), powers(-9, -2), st.sampled_from([-1.0, 0.0, 1.0]))
def test_a_box_near_the_friction_angle_rests_or_slides(slope, part, side):
    excess = side * part
    mu = math.tan(slope) * (1.0 + excess)
    scene, q0 = box_on_a_slope(slope, mu, 0.02)
    trajectory = simulate(scene, q0, np.zeros(6), 1.0)
    moved = float(np.linalg.norm(trajectory.q[-1, :3] - q0[:3]))
    assert moved == pytest.approx(0.5 * max(0.0, -excess) * G * math.sin(slope), abs=1e-8)
    assert not any("jam" in note.text for note in trajectory.notes)


@examples(40)
@given(st.floats(0.02, 1.0), st.just(0.0) | st.floats(-1.0, 1.0), st.floats(0.2, 2.0), TOLERANCES)
def test_a_braked_wheel_rolls_or_locks_and_slides_to_its_rest(mu, excess, speed, rtol):
    """The brake is the dry friction of its axle, of a wheel of m = 1 kg, r = 0.2 m and I = m r²/2."""
    radius, inertia = 0.2, 0.02
    model, parent = pin.Model(), 0
    for kind in (pin.JointModelPX(), pin.JointModelPZ(), pin.JointModelRY()):
        parent = model.addJoint(parent, kind, pin.SE3.Identity(), kind.shortname())
    spin = np.diag([0.01, inertia, 0.01])
    model.appendBodyToJoint(parent, pin.Inertia(1.0, np.zeros(3), spin), pin.SE3.Identity())
    model.addFrame(pin.Frame("wheel", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    brake = 1.5 * mu * G * 10.0**excess  # at 0 friction is what rolling takes
    torque = brake * radius
    model.friction = np.array([0.0, 0.0, torque])
    scene = Scene(model, [Contact("wheel", Plane(), friction=mu, radius=radius)])
    rolling = brake / (1.0 + inertia / radius**2)  # deceleration
    deceleration = min(rolling, mu * G)
    start = [0.0, radius, 0.0], [speed, 0.0, speed / radius]
    trajectory = simulate(scene, *start, speed / deceleration + 0.1, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.q[-1, 0] == pytest.approx(0.5 * speed**2 / deceleration, rel=1e2 * rtol)
    turned = 0.5 * speed**2 / (deceleration * radius)
    if rolling > mu * G:  # the axle is slowed by what the brake has more than the ground
        turned = 0.5 * (speed / radius) ** 2 * inertia / (torque - mu * G * radius)
    assert trajectory.q[-1, 2] == pytest.approx(turned, rel=1e2 * rtol)
    assert np.abs(trajectory.v[-1]).max() == pytest.approx(0.0, abs=1e-12)


@examples(10)
@given(st.floats(0.1, 1.0), powers(0, 2), st.floats(0.05, 1.0), st.sampled_from([1e-6, 1e-8, 1e-10]))
def test_a_mass_on_a_spring_and_a_belt_swings_so_that_it_just_reaches_the_speed_of_the_belt(
    mu, stiffness, speed, rtol
):
    """Once a period it could stick, for no time: its cycle is the largest one that slides."""
    pace, pull = math.sqrt(stiffness), mu * G / stiffness
    belt = Plane(velocity=(speed, 0.0, 0.0))
    scene = Scene(
        slider(),
        [Contact("point", belt, friction=mu)],
        control=lambda t, q, v: np.array([-stiffness * q[0], 0.0, 0.0]),
    )
    onset = pull / speed
    times = onset + np.linspace(0.1, 3.2, 8) * 2.0 * math.pi / pace
    trajectory = simulate(scene, np.zeros(3), [speed, 0.0, 0.0], times[-1], rtol=rtol, atol=1e-2 * rtol)
    x = np.array([trajectory.at(t)[0][0] for t in times])
    exact = pull + speed / pace * np.sin(pace * (times - onset))
    assert x == pytest.approx(exact, abs=1e3 * rtol * (pull + speed / pace))
    assert trajectory.notes == ()
