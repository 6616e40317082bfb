"""`Stepper`: steps under constant forces, events at the ends of steps, copies, accuracy."""

from __future__ import annotations

import copy
import math
import pickle
import warnings

import coal
import numpy as np
import pinocchio as pin
import pytest

from pinimpact import (
    Box,
    Contact,
    Event,
    InputError,
    Plane,
    Scene,
    SimulationError,
    SteppedWarning,
    Stepper,
    UnknownNameError,
    simulate,
)
from pinimpact.scene._kernels import step_dop853
from pinimpact.scene.hybrid_state import HybridState
from pinimpact.scene.integrator import Integrator
from pinimpact.scene.options import Options

from .drawing import one_of_each
from .scene_models import UP, G, ball, pendulum, shaped_body, slider

FLOOR = Plane()


def block(friction=0.5, **options):
    """Return a scene of a point mass of 1 kg on three prismatic joints above the floor."""
    return Scene(slider(), [Contact("point", FLOOR, friction=friction, name="block")], **options)


def bouncing_ball(restitution=0.5):
    return Scene(ball(), [Contact("center", FLOOR, radius=0.1, restitution=restitution, name="ball")])


def test_free_mass_under_piecewise_constant_forces():
    stepper = Stepper(Scene(slider(mass=2.0), without=["gravity"]), np.zeros(3), np.zeros(3))
    rng = np.random.default_rng(0)
    x, v, t = np.zeros(3), np.zeros(3), 0.0
    for dt in rng.uniform(1e-4, 0.3, 40):
        force = rng.normal(size=3)
        x, v, t = x + v * dt + 0.25 * force * dt**2, v + 0.5 * force * dt, t + dt
        found, speed = stepper.step(force, dt)
        assert found == pytest.approx(x, abs=1e-12)
        assert speed == pytest.approx(v, abs=1e-12)
        assert stepper.t == pytest.approx(t, rel=1e-14)


@pytest.mark.parametrize("steps", [1, 3, 5, 8, 50])
def test_impact_at_end_of_step_occurs_once(steps):
    e, t0 = 0.5, 0.25
    stepper = Stepper(bouncing_ball(e), [0, 0, 0.1 + 0.5 * G * t0**2, *UP], np.zeros(6))
    for _ in range(steps):
        stepper.step(np.zeros(6), t0 / steps)
    first = len(stepper.trajectory.impacts)
    for _ in range(steps):
        stepper.step(np.zeros(6), 0.5 * t0 / steps)
    impacts = stepper.trajectory.impacts
    assert first in (0, 1)  # it occurs at 0.25 s up to rounding
    assert len(impacts) == 1
    assert impacts[0].time == pytest.approx(t0, rel=1e-12)
    up, t = e * G * t0, 0.5 * t0
    assert stepper.q[2] - 0.1 == pytest.approx(up * t - 0.5 * G * t**2, rel=1e-9)
    assert stepper.v[2] == pytest.approx(up - G * t, abs=1e-9)


def test_impacts_within_steps_have_exact_times():
    e, height = 0.7, 0.3
    stepper = Stepper(bouncing_ball(e), [0, 0, 0.1 + height, *UP], np.zeros(6))
    while stepper.t < 1.0:
        stepper.step(np.zeros(6), 0.037)
    speed, time = np.sqrt(2 * G * height), np.sqrt(2 * height / G)
    for impact in stepper.trajectory.impacts:
        assert impact.time == pytest.approx(time, rel=1e-11)
        speed *= e
        time += 2 * speed / G
    assert len(stepper.trajectory.impacts) >= 3


def test_steps_agree_with_sampled_control():
    model = pendulum(joint=pin.JointModelRY())
    model.friction = np.array([0.3])
    tip = Contact("tip", Plane(normal=(-1, 0, 0), point=(0.4, 0, 0)), restitution=0.6, name="wall")
    start, period, count = [0.1], 0.01, 300

    def pulled(t, q, v):
        return 6.0 * np.sin(5.0 * t) - 0.2 * v

    expected = simulate(
        Scene(model, [tip], control=pulled, period=period),
        start,
        [0.0],
        count * period,
        rtol=1e-10,
        atol=1e-12,
    )
    stepper = Stepper(Scene(model, [tip]), start, [0.0], rtol=1e-10, atol=1e-12)
    for k in range(count):
        stepper.step(pulled(k * period, stepper.q, stepper.v), period)
    assert stepper.q == pytest.approx(expected.q[-1], abs=1e-10)
    assert stepper.v == pytest.approx(expected.v[-1], abs=1e-9)
    found = stepper.trajectory
    assert len(found.impacts) == len(expected.impacts) >= 2
    assert [i.time for i in found.impacts] == pytest.approx([i.time for i in expected.impacts], abs=1e-10)
    assert [m.mode for m in found.modes] == [m.mode for m in expected.modes]
    assert np.abs(found.energy.residual).max() <= 1e-8


def test_block_sticks_and_slips_under_stepwise_forces():
    mu, dt = 0.5, 0.1
    hold = mu * G
    stepper = Stepper(block(mu), np.zeros(3), np.zeros(3))
    x = v = 0.0
    for force, acceleration in (
        (0.9 * hold, 0.0),
        (1.5 * hold, 0.5 * hold),
        (1.2 * hold, 0.2 * hold),
        (0.5 * hold, -0.5 * hold),
        (0.5 * hold, -0.5 * hold),
    ):
        if v > 0.0 or acceleration > 0.0:
            moving = dt if v + acceleration * dt >= 0.0 else -v / acceleration
            x += v * moving + 0.5 * acceleration * moving**2
            v = v + acceleration * moving if moving == dt else 0.0
        stepper.step([force, 0, 0], dt)
        assert stepper.q[0] == pytest.approx(x, abs=1e-9)
        assert stepper.v[0] == pytest.approx(v, abs=1e-9)
    modes = [(m.mode, m.start) for m in stepper.trajectory.modes]
    assert [mode for mode, _ in modes] == ["stick", "slip", "stick"]
    assert modes[1][1] == pytest.approx(dt, abs=1e-15)


def test_incipient_slip_follows_the_current_force():
    mu, dt = 0.5, 1e-3
    stepper = Stepper(block(mu), np.zeros(3), np.zeros(3))
    stepper.step([0.5, 0, 0], dt)
    for force in ([2 * mu * G, 0, 0], [0, 0, 0], [0, 2 * mu * G, 0]):
        before, after = stepper.v, stepper.step(force, dt)[1]
        pushed = np.linalg.norm(force) > 0
        expected = before + np.array(force) * 0.5 * dt if pushed else np.zeros(3)
        assert after[:2] == pytest.approx(expected[:2], abs=1e-9)


def test_block_lifts_off_at_change_of_force_and_lands():
    stepper = Stepper(block(), np.zeros(3), np.zeros(3))
    stepper.step(np.zeros(3), 0.1)
    stepper.step([0, 0, 2 * G], 0.1)
    assert stepper.q[2] == pytest.approx(0.5 * G * 0.01, rel=1e-9)
    stepper.step(np.zeros(3), 0.5)
    landing = stepper.trajectory.impacts[0].time
    assert landing == pytest.approx(0.2 + 0.1 + np.sqrt(2) * 0.1, rel=1e-9)
    assert stepper.trajectory.mode_at("block", 0.65) == "stick"


def test_balanced_weight_comes_to_rest_when_force_is_removed():
    stepper = Stepper(block(), np.zeros(3), np.zeros(3))
    for lift in (0.5 * G, G, 0.5 * G, 1.0000001 * G, 0.0):
        stepper.step([0, 0, lift], 0.01)
    assert stepper.v[2] == pytest.approx(0.0, abs=1e-6)
    stepper.step(np.zeros(3), 0.1)
    assert stepper.trajectory.mode_at("block", stepper.t) == "stick"
    assert abs(stepper.q[2]) < 1e-9


def test_dry_friction_holds_then_yields_at_change_of_torque():
    model = pendulum()
    model.friction = np.array([2.0])
    stepper = Stepper(Scene(model, without=["gravity"]), [0.0], [0.0])
    stepper.step([1.9], 0.1)
    assert stepper.q[0] == 0.0
    stepper.step([-3.0], 0.1)
    assert stepper.q[0] == pytest.approx(-0.5 * 1.0 * 0.01, rel=1e-9)
    stepper.step([0.0], 0.2)
    assert stepper.q[0] == pytest.approx(-0.005 - 0.1**2 / 4, rel=1e-8)
    assert stepper.v[0] == 0.0


def copy_with_used_integrator(stepper):
    """Return a copy with the integrator of one that has continued and no longer exists."""
    other = stepper.copy()
    integrator, force = other._integrator, np.full(len(stepper.v), 0.1)
    for _ in range(20):
        other.step(force, 0.01)
    trajectory = other.trajectory
    positions, within = trajectory.q.copy(), trajectory.at(0.999 * other.t)
    del other
    again = stepper.copy()
    assert again._integrator is integrator
    again.copy().step(force, 0.01)
    assert np.array_equal(trajectory.q, positions)
    assert np.array_equal(np.concatenate(trajectory.at(0.999 * trajectory.t[-1])), np.concatenate(within))
    return again


COPIES = {
    "copy": Stepper.copy,
    "copy.copy": copy.copy,
    "copy.deepcopy": copy.deepcopy,
    "copy with used integrator": copy_with_used_integrator,
    "pickle": lambda stepper: pickle.loads(pickle.dumps(stepper)),
}


def copy_and_advance_both(one, kind):
    """Copy a stepper, advance both by 20 steps, check that they are equal, and return the copy."""
    other = COPIES[kind](one)
    for stepper in (one, other):
        for _ in range(20):
            stepper.step(np.zeros(6), 0.01)
    for name in ("t", "q", "v"):
        assert np.array_equal(getattr(one.trajectory, name), getattr(other.trajectory, name))
    return other


@pytest.mark.parametrize("kind", COPIES)
def test_copies_are_independent_and_bitwise_equal(kind):
    one = Stepper(bouncing_ball(), [0, 0, 0.3, *UP], [0.2, 0, 0, 1.0, 0, 0])
    for _ in range(30):
        one.step(np.zeros(6), 0.01)
    other, lifted = COPIES[kind](one), COPIES[kind](one)
    for _ in range(30):
        lifted.step([0, 0, 30.0, 0, 0, 0], 0.01)
    for _ in range(30):
        one.step(np.zeros(6), 0.01)
    for _ in range(30):
        other.step(np.zeros(6), 0.01)
    assert np.array_equal(one.q, other.q)
    assert np.array_equal(one.v, other.v)
    assert np.array_equal(one.trajectory.q, other.trajectory.q)
    assert [i.time for i in one.trajectory.impacts] == [i.time for i in other.trajectory.impacts]
    assert lifted.q[2] > one.q[2]


def below(t, q, v):
    return q[2] - 0.15


@pytest.mark.parametrize(
    ("when", "kind"),
    one_of_each(
        [(0, "auto"), (12, "auto"), (60, "auto"), (12, "time-stepping"), (60, "time-stepping")], list(COPIES)
    ),
)
def test_copies_include_shape_pairs_events_and_modes(when, kind):
    """A box that tumbles onto a table is copied at the start, in flight, and in contact."""
    steps, scheme = when
    model, shapes = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.1), pin.SE3.Identity())
    model.addJointFrame(joint)
    frame = model.getFrameId("box")
    shapes.addGeometryObject(
        pin.GeometryObject("box", joint, frame, pin.SE3.Identity(), coal.Box(0.2, 0.2, 0.1))
    )
    table = Box(size=(4.0, 4.0, 0.2), center=(0.0, 0.0, -0.1))
    contact = Contact(geometry="box", plane=table, friction=0.4, restitution=0.3, name="box")
    scene = Scene(pin.RobotWrapper(model, shapes), [contact], events=[Event(below, name="below")])
    one = Stepper(scene, [0, 0, 0.3, *UP], [0.3, 0, 0, 1.0, 2.0, 0], scheme=scheme)
    for _ in range(steps):
        one.step(np.zeros(6), 0.01)
    other = copy_and_advance_both(one, kind)
    for record in ("impacts", "events", "modes"):
        assert len(getattr(one.trajectory, record)) == len(getattr(other.trajectory, record))
    assert one.trajectory.modes == other.trajectory.modes
    assert [i.source for i in one.trajectory.impacts] == [i.source for i in other.trajectory.impacts]


def same(one, other):
    """Return whether two states, or values in them, are the same to the last bit."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return one.tobytes() == other.tobytes()
    if isinstance(one, HybridState):
        one, other = vars(one), vars(other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


@pytest.mark.parametrize("steps", [0, 7, 30, 31])
def test_state_object_determines_the_continuation(steps):
    """Scratch arrays shared with kernels are not part of the state: they are overwritten with NaN here."""
    one = Stepper(block(), [0.0, 0.0, 0.05], [0.3, 0.0, 0.0])
    force = np.array([4.0, 1.0, 0.0])
    for _ in range(steps):
        one.step(force, 0.01)
    before = one._integrator.value()
    other = pickle.loads(pickle.dumps(one))
    assert same(other._integrator.value(), before)
    assert same(one._integrator.value(), before)
    work = other._integrator.work
    for name in ("q", "v", "tau", "acceleration", "minverse"):
        getattr(work, name)[...] = math.nan
    for name in ("placements", "local_velocities", "spatial_velocities", "spatial_accelerations"):
        getattr(work, name)[1:] = math.nan  # index 0, the world, is constant
    assert one.step(force, 0.01)[0].tobytes() == other.step(force, 0.01)[0].tobytes()
    assert same(other._integrator.value(), one._integrator.value())
    assert not same(one._integrator.value(), before)


@pytest.mark.parametrize(("kind", "steps"), one_of_each(list(COPIES), [14, 16, 40]))
def test_copies_continue_during_time_stepping_intervals(kind, steps):
    """A crate lands with a corner on a corner, where the normal is undetermined."""
    robot = shaped_body(coal.Box(0.2, 0.2, 0.2), pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2), name="crate")
    turned = pin.rpy.rpyToMatrix(math.pi / 4, math.atan(math.sqrt(0.5)), 0.0)
    tip = Box(size=(1.0, 1.0, 1.0), rpy=tuple(pin.rpy.matrixToRpy(turned)), name="tip")
    scene = Scene(robot, Contact(geometry="crate", plane=tip))
    q0 = [0, 0, 0.6 * math.sqrt(3.0) + 0.1, *pin.Quaternion(turned).coeffs()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SteppedWarning)
        one = Stepper(scene, q0, np.zeros(6))
        for _ in range(steps):
            one.step(np.zeros(6), 0.01)
        other = copy_and_advance_both(one, kind)
    assert one.trajectory.stepped
    assert one.trajectory.stepped == other.trajectory.stepped


def test_time_steps_of_stepper_and_simulate_are_equal():
    """A control sampled at 100 Hz pushes a block beyond its friction limit and back."""
    period, count, mu = 0.01, 60, 0.5

    def push(t, q, v):
        return np.array([0.6 * mu * G + mu * G * math.sin(9.0 * t), 0.0, 0.0])

    rigid = block(mu)
    control = Scene(rigid.model, rigid.contacts, control=push, period=period)
    expected = simulate(control, np.zeros(3), np.zeros(3), count * period, scheme="time-stepping", dt=2e-3)
    stepper = Stepper(rigid, np.zeros(3), np.zeros(3), scheme="time-stepping", dt=2e-3)
    for k in range(count):
        stepper.step(push(k * period, stepper.q, stepper.v), period)
    assert expected.q[-1, 0] > 0.01
    np.testing.assert_allclose(stepper.q, expected.q[-1], atol=1e-12)
    np.testing.assert_allclose(stepper.trajectory.t, expected.t, atol=1e-12)
    with pytest.raises(UnknownNameError, match="scheme: 'steps'"):
        Stepper(rigid, np.zeros(3), np.zeros(3), scheme="steps")


def test_copy_of_stopped_stepper_is_stopped():
    stepper = Stepper(bouncing_ball(), [0, 0, 0.3, *UP], np.zeros(6), max_impacts=1)
    with pytest.raises(SimulationError):
        stepper.step(np.zeros(6), 5.0)
    with pytest.raises(SimulationError, match="has stopped"):
        pickle.loads(pickle.dumps(stepper)).step(np.zeros(6), 0.1)


def test_reset_stepper_equals_new_stepper():
    scene, start = bouncing_ball(), [0, 0, 0.3, *UP]
    used, new = Stepper(scene, [0, 0, 0.8, *UP], np.ones(6)), Stepper(scene, start, np.zeros(6))
    for _ in range(40):
        used.step(np.ones(6), 0.01)
    used.reset(start, np.zeros(6))
    assert used.t == 0.0
    assert used.trajectory.impacts == ()
    for _ in range(40):
        used.step(np.zeros(6), 0.01)
        new.step(np.zeros(6), 0.01)
    assert np.array_equal(used.q, new.q)
    assert np.array_equal(used.trajectory.t, new.trajectory.t)


def test_returned_arrays_are_copies():
    stepper = Stepper(block(), np.zeros(3), np.zeros(3))
    q, v = stepper.step([0, 0, 2 * G], 0.1)
    kept = q.copy()
    q[:], v[:] = 7.0, 7.0
    stepper.q[:] = 7.0
    assert stepper.q == pytest.approx(kept)
    assert stepper.trajectory.q[-1] == pytest.approx(kept)


def test_terminal_event_ends_step_and_next_step_continues():
    def half_way(t, q, v):
        return q[2] - 0.5

    scene = Scene(slider(), events=[Event(half_way, terminal=True)])
    stepper = Stepper(scene, [0, 0, 1.0], np.zeros(3))
    stepper.step(np.zeros(3), 1.0)
    fall = np.sqrt(2 * 0.5 / G)
    assert stepper.t == pytest.approx(fall, rel=1e-10)
    stepper.step(np.zeros(3), 0.1)
    assert stepper.t == pytest.approx(fall + 0.1, rel=1e-10)
    assert stepper.q[2] == pytest.approx(1.0 - 0.5 * G * (fall + 0.1) ** 2, rel=1e-9)


def test_step_that_a_terminal_event_ends_has_no_linearization():
    scene = Scene(slider(), events=[Event(lambda t, q, v: q[2] - 0.5, terminal=True, name="half")])
    stepper = Stepper(scene, [0, 0, 1.0], np.zeros(3))
    with pytest.raises(InputError, match=r"the event 'half' ends the step at t = 0\.319"):
        stepper.linearize(np.zeros(3), 1.0)
    assert stepper.t == 0.0
    assert stepper.linearize(np.zeros(3), 0.1).A[:3, 3:] == pytest.approx(0.1 * np.eye(3), abs=1e-9)


@pytest.mark.parametrize("scheme", ["event-driven", "auto", "time-stepping"])
def test_motion_is_that_of_the_model_at_its_start(scheme):
    """Later changes of the model, here of mass and gravity, affect the next motion only."""
    model = slider()
    scene, start = Scene(model, Contact("point", FLOOR, name="floor")), ([0, 0, 0.0], np.zeros(3))
    stepper = Stepper(scene, [0, 0, 1.0], np.zeros(3), scheme=scheme)
    stepper.step(np.zeros(3), 0.1)
    trajectory, mass = simulate(scene, *start, 0.2, scheme=scheme), model.inertias[3].mass
    model.inertias[3] = pin.Inertia(5.0 * mass, np.zeros(3), np.zeros((3, 3)))
    model.gravity.linear[2] = -2.0
    assert trajectory.forces("floor", 0.1)[2] == pytest.approx(mass * G, rel=1e-9)
    assert pickle.loads(pickle.dumps(trajectory)).forces("floor", 0.1)[2] == pytest.approx(mass * G, rel=1e-9)
    stepper.step(np.zeros(3), 0.1)
    assert stepper.v[2] == pytest.approx(-0.2 * G, rel=1e-9)
    later = simulate(scene, *start, 0.2, scheme=scheme)
    assert later.forces("floor", 0.1)[2] == pytest.approx(5.0 * mass * 2.0, rel=1e-9)


@pytest.mark.parametrize("dt", [0.0, -1e-3, np.nan, np.inf, "1", None, 1e-30])
def test_invalid_step_duration_raises(dt):
    stepper = Stepper(block(), np.zeros(3), np.zeros(3))
    stepper.step(np.zeros(3), 1.0)
    with pytest.raises(InputError, match="dt: "):
        stepper.step(np.zeros(3), dt)
    assert stepper.t == 1.0


@pytest.mark.parametrize("tau", [np.zeros(2), [0, 0, np.nan], [np.inf, 0, 0], "push", None])
def test_invalid_forces_raise_and_leave_state_unchanged(tau):
    stepper = Stepper(block(), np.zeros(3), np.zeros(3))
    with pytest.raises(InputError, match="tau: "):
        stepper.step(tau, 0.1)
    assert stepper.t == 0.0
    stepper.step(np.zeros(3), 0.1)


def test_scene_with_control_or_invalid_start_raises():
    with pytest.raises(InputError, match="control="):
        Stepper(block(control=lambda t, q, v: 0 * v), np.zeros(3), np.zeros(3))
    with pytest.raises(InputError, match="q0: "):
        Stepper(block(), [0, 0, -1.0], np.zeros(3))
    with pytest.raises(InputError, match="rtol: "):
        Stepper(block(), np.zeros(3), np.zeros(3), rtol=0.0)


def test_stopped_stepper_raises_until_reset():
    stepper = Stepper(bouncing_ball(0.9), [0, 0, 0.11, *UP], np.zeros(6), max_impacts=3)
    with pytest.raises(SimulationError, match="max_impacts") as caught:
        stepper.step(np.zeros(6), 5.0)
    assert caught.value.partial.t[-1] < 5.0
    with pytest.raises(SimulationError, match="reset"):
        stepper.step(np.zeros(6), 1e-3)
    stepper.reset([0, 0, 0.5, *UP], np.zeros(6))
    stepper.step(np.zeros(6), 1e-3)


def test_number_of_impacts_per_step():
    stepper = Stepper(bouncing_ball(0.9), [0, 0, 0.11, *UP], np.zeros(6), max_impacts=3)
    for _ in range(60):
        stepper.step(np.zeros(6), 0.01)
    assert len(stepper.trajectory.impacts) > 3


SWING, FAST = np.array([1.0]), np.array([2.0])


@pytest.fixture(scope="module")
def swing():
    """Return a function that measures the errors of steppers on a pendulum against an accurate solution."""
    model = pendulum()
    exact = simulate(Scene(model), SWING, FAST, 2.0, rtol=1e-13, atol=1e-15)

    def errors(steps, rtol):
        """Return the largest errors of q at the ends of steps and within steps, and evaluations per step."""
        stepper = Stepper(Scene(model), SWING, FAST, rtol=rtol, atol=rtol)
        for _ in range(steps):
            stepper.step(np.zeros(1), 2.0 / steps)
        found = stepper.trajectory
        ends, within = 2.0 / steps * np.arange(1, steps), 2.0 / steps * (np.arange(2, steps) + 0.4)
        at = [max(abs(found.at(t)[0] - exact.at(t)[0]).max() for t in times) for times in (ends, within)]
        return *at, found.statistics["evaluations"] / steps

    return errors


def test_short_steps_are_of_order_two(swing):
    coarse, fine = swing(40, 0.1), swing(160, 0.1)
    assert 1.8 < np.log(coarse[0] / fine[0]) / np.log(4.0) < 2.5
    assert 1.8 < np.log(coarse[1] / fine[1]) / np.log(4.0) < 2.5
    assert fine[2] < 4.0


@pytest.mark.parametrize(
    ("method", "order", "length"), [(0, 8, 0.4), (1, 5, 0.1), (2, 3, 0.05), (3, 2, 0.05)]
)
def test_order_of_explicit_methods(method, order, length):
    scene, errors = Scene(pendulum()), []
    for h in (length, 0.5 * length):
        integrator = Integrator(scene, SWING, FAST, Options())
        integrator.begin()
        integrator.work.method = method
        step_dop853.attempt(integrator.work, 0.0, h, 1.0, 1.0)
        exact = simulate(scene, SWING, FAST, h, rtol=1e-13, atol=1e-15)
        errors.append(abs(integrator.work.v1[0] - exact.v[-1, 0]))
    assert order + 0.6 < math.log2(errors[0] / errors[1]) < order + 1.6


@pytest.mark.parametrize("steps", [8, 200, 1000])
@pytest.mark.parametrize("rtol", [1e-5, 1e-8, 1e-11])
def test_steps_of_any_length_satisfy_tolerance(swing, steps, rtol):
    ends, within, _ = swing(steps, rtol)
    assert max(ends, within) < 30.0 * rtol


def test_time_steps_end_where_times_have_few_digits():
    """At 10¹² s times are multiples of 1.2e-4 s, and a bounce is located no better than that."""
    scene = Scene(slider(), [Contact("point", Plane(), restitution=0.8)])
    stepper = Stepper(scene, np.zeros(3), np.zeros(3), scheme="time-stepping")
    stepper.step(np.zeros(3), 1e12)
    stepper.step([0.0, 0.0, 20.0], 0.1)
    stepper.step(np.zeros(3), 0.5)
    assert stepper.t == pytest.approx(1e12 + 0.6, abs=1e-3)
    assert stepper.trajectory.impacts
    assert stepper.q[2] > -1e-9


def arm_on_floor(friction):
    """Return a scene of a planar arm of three links whose tip is on the floor, and its posture."""
    model, joint, place = pin.Model(), 0, np.zeros(3)
    for _ in range(3):
        joint = model.addJoint(joint, pin.JointModelRY(), pin.SE3(np.eye(3), place), f"joint {joint}")
        place = np.array([1.0, 0, 0])
        inertia = pin.Inertia(1.0, 0.5 * place, 0.1 * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, pin.SE3(np.eye(3), place), pin.FrameType.OP_FRAME))
    contact = Contact("tip", FLOOR, friction=friction, name="tip")
    return Scene(model, [contact]), np.radians([-60.0, 60.0, 60.0])


@pytest.mark.parametrize(("friction", "mode"), [(5.0, "stick"), (0.1, "slip")])
def test_new_forces_in_contact_equal_a_new_start(friction, mode):
    scene, q = arm_on_floor(friction)
    stepper, rng = Stepper(scene, q, np.zeros(3), rtol=1e-12, atol=1e-14), np.random.default_rng(7)
    stepper.step(np.zeros(3), 1e-3)
    other = Stepper(scene, stepper.q, stepper.v, rtol=1e-12, atol=1e-14)
    for _ in range(20):
        other.reset(stepper.q, stepper.v)
        tau = rng.uniform(-1.0, 1.0, 3)
        for one in (stepper, other):
            one.step(tau, 1e-3)
        assert stepper.q == pytest.approx(other.q, abs=1e-14)
        assert stepper.v == pytest.approx(other.v, abs=1e-13)
        half = stepper.t - 5e-4, other.t - 5e-4
        force, same = (one.trajectory.forces("tip", t) for one, t in zip((stepper, other), half, strict=True))
        assert force == pytest.approx(same, rel=1e-10)
    assert [m.mode for m in stepper.trajectory.modes] == [mode]


def test_new_forces_in_contact_need_no_evaluation():
    scene, q = arm_on_floor(5.0)
    stepper, counts = Stepper(scene, q, np.zeros(3), rtol=1e-6), []
    for k in range(30):
        stepper.step([0.1 * k, 0.0, 0.0], 1e-3)
        counts.append(stepper.trajectory.statistics["evaluations"])
    evaluations = np.diff(counts[10:])
    assert set(evaluations) <= {2, 3, 5}  # the stages of the methods of orders 2 and 3, or of both
    assert np.sum(evaluations == 5) <= 2


@pytest.mark.parametrize("kind", COPIES)
def test_copies_in_contact_are_bitwise_equal_under_new_forces(kind):
    scene, q = arm_on_floor(5.0)
    one = Stepper(scene, q, np.zeros(3))
    for k in range(5):
        one.step([0.1 * k, 0.0, 0.0], 1e-3)
    other = COPIES[kind](one)
    for stepper in (one, other):
        for k in range(5):
            stepper.step([-0.1 * k, 0.2 * k, 0.0], 1e-3)
    assert np.array_equal(one.trajectory.q, other.trajectory.q)
    assert np.array_equal(one.trajectory.v, other.trajectory.v)


@pytest.mark.parametrize("stop", ["limit", "contact"])
def test_body_that_is_pushed_back_before_it_separates_stays_at_rest(stop):
    """Its gap is still that of rounding, so that the contact closes again without an impact."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.addJointFrame(joint)
    model.gravity.linear[:] = 0.0
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = 0.0 if stop == "limit" else -np.inf, np.inf
    stepper = Stepper(Scene(model, [Contact("z", Plane())] if stop == "contact" else []), [0.0], [0.0])
    for push, dt in ((1.0, 1e-9), (-1.0, 1e-3), (2.0, 1e-6), (-3.0, 1e-3)):
        stepper.step([push], dt)
    assert stepper.v == [0.0]
    assert 0.0 <= stepper.q[0] < 1.1e-12  # 2 N for 1 µs
    assert not stepper.trajectory.impacts
