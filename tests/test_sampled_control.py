"""Sampled controls: exact motion between samples, which are evaluated once and in order."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, InputError, JointPD, Plane, Scene, SimulationError, simulate

from .scene_models import UP, G, ball, run, slider


def mass(control, **options):
    """Return a scene of a free mass of 1 kg."""
    return Scene(slider(), control=control, without=["gravity"], **options)


def advanced(x, v, u, time):
    """Return position and velocity of a mass of 1 kg after a time under a constant force."""
    return x + v * time + 0.5 * u * time**2, v + u * time


class Recording:
    """A control that records its arguments."""

    def __init__(self, control=lambda t, q, v: np.zeros_like(v)):
        self.control = control
        self.times, self.states = [], []

    def __call__(self, t, q, v):
        self.times.append(t)
        self.states.append((q.copy(), v.copy()))
        return self.control(t, q, v)


@pytest.mark.parametrize(("kp", "kd"), [(40.0, 9.0), (400.0, 2.0), (2000.0, 60.0)])
def test_sampled_pd_control_is_a_discrete_recursion(kp, kd):
    period, target = 0.01, np.array([0.3, -0.2, 0.1])
    start, speed = np.array([0.0, 0.1, 0.0]), np.array([1.0, 0.0, -1.0])
    scene = mass(lambda t, q, v: kp * (target - q) - kd * v, period=period)
    trajectory = run(scene, start, speed, 1.0)
    x, v = start, speed
    for k in range(100):
        found = trajectory.at(k * period)
        assert found[0] == pytest.approx(x, abs=1e-12)
        assert found[1] == pytest.approx(v, abs=1e-11)
        u = kp * (target - x) - kd * v
        middle = trajectory.at((k + 0.37) * period)[0]
        assert middle == pytest.approx(advanced(x, v, u, 0.37 * period)[0], abs=1e-12)
        x, v = advanced(x, v, u, period)
    assert trajectory.q[-1] == pytest.approx(x, abs=1e-12)


@pytest.mark.parametrize("periods", [0.25, 1.0, 2.0, 2.5, 7.0])
def test_forces_act_after_the_delay(periods):
    period, late, kp, kd = Fraction(1, 50), Fraction(periods) / 50, 30.0, 4.0
    scene = mass(lambda t, q, v: -kp * q - kd * v, period=float(period), delay=float(late))
    trajectory = run(scene, [1.0, 0, 0], np.zeros(3), 1.0)
    x, v, u, t = 1.0, 0.0, 0.0, Fraction(0)
    forces = {}
    samples = {k * period for k in range(50)}
    for time in sorted(samples | {when + late for when in samples}):
        if time >= 1:
            break
        x, v = advanced(x, v, u, float(time - t))
        t = time
        found = trajectory.at(float(time))
        assert found[0][0] == pytest.approx(x, abs=1e-11)
        assert found[1][0] == pytest.approx(v, abs=1e-10)
        if time in samples:
            forces[time + late] = -kp * x - kd * v
        u = forces.get(time, u)


@pytest.mark.parametrize(
    ("period", "duration", "count"),
    [(0.01, 1.0, 100), (0.1, 0.3, 3), (0.3, 1.0, 4), (0.7, 0.7, 1), (5.0, 1.0, 1), (1e-7, 2e-5, 200)],
)
def test_samples_are_evaluated_once_and_in_order(period, duration, count):
    recorded = Recording()
    run(mass(recorded, period=period), [1.0, 0, 0], np.ones(3), duration)
    assert recorded.times == [k * period for k in range(count)]
    for t, (q, v) in zip(recorded.times, recorded.states, strict=True):
        assert q == pytest.approx(np.array([1.0, 0, 0]) + t, abs=1e-13)
        assert v == pytest.approx(np.ones(3), abs=1e-13)


def test_sample_at_the_time_of_an_impact():
    e, t0 = 0.5, 0.25
    contact = Contact("center", Plane(), radius=0.1, restitution=e, name="ball")
    recorded = Recording()
    scene = Scene(ball(), [contact], control=recorded, period=t0 / 5)
    trajectory = run(scene, [0, 0, 0.1 + 0.5 * G * t0**2, *UP], np.zeros(6), 0.4)
    assert len(trajectory.impacts) == 1
    assert recorded.times == [k * (t0 / 5) for k in range(8)]
    speed = recorded.states[5][1][2]
    # the impact is at the sample to rounding, so the sample has the velocity before or after it
    assert min(abs(speed - e * G * t0), abs(speed + G * t0)) < 1e-9
    assert recorded.states[6][1][2] == pytest.approx(e * G * t0 - G * t0 / 5, abs=1e-9)


def test_rejected_steps_do_not_repeat_samples():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRUBY(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(
        joint, pin.Inertia(1.0, np.array([0, 0, -1e-3]), np.eye(3) * 1e-9), pin.SE3.Identity()
    )
    recorded = Recording()
    trajectory = simulate(Scene(model, control=recorded, period=0.05), [1.0, 0.0], [300.0], 1.0, rtol=1e-11)
    assert trajectory.statistics["rejected"] > 0
    assert recorded.times == [k * 0.05 for k in range(20)]


def test_sampled_control_with_internal_state():
    period, kp, ki = 0.02, 3.0, 8.0
    total = [0.0]

    def integrating(t, q, v):
        total[0] += (1.0 - q[0]) * period
        return [kp * (1.0 - q[0]) + ki * total[0] - 3.0 * v[0], 0, 0]

    trajectory = run(mass(integrating, period=period), np.zeros(3), np.zeros(3), 1.0)
    x = v = s = 0.0
    for _ in range(50):
        s += (1.0 - x) * period
        x, v = advanced(x, v, kp * (1.0 - x) + ki * s - 3.0 * v, period)
    assert trajectory.q[-1, 0] == pytest.approx(x, abs=1e-12)


def test_discontinuous_sampled_control_needs_one_step_per_sample():
    scene = mass(lambda t, q, v: -np.sign(q), period=0.01)
    trajectory = run(scene, [1.0, 0, 0], np.zeros(3), 1.0)
    assert trajectory.statistics["steps"] == 100
    assert trajectory.statistics["rejected"] == 0


def test_error_at_a_sample_has_the_partial_trajectory():
    def failing(t, q, v):
        if t > 0.25:
            raise RuntimeError("no torque left")
        return np.zeros(3)

    with pytest.raises(
        SimulationError, match=r"control: RuntimeError at t = 0\.3 s: no torque left"
    ) as caught:
        simulate(mass(failing, period=0.1), np.zeros(3), np.ones(3), 1.0)
    assert caught.value.partial.t[-1] == pytest.approx(0.3)
    for wrong in ([1.0], [np.nan, 0, 0], "push"):
        with pytest.raises(SimulationError, match="control: "):
            simulate(mass(lambda t, q, v, wrong=wrong: wrong, period=0.1), np.zeros(3), np.ones(3), 1.0)


def test_invalid_period_or_delay_raises():
    def control(t, q, v):
        return 0 * v

    for wrong in (0.0, -0.01, np.nan, np.inf, "fast"):
        with pytest.raises(InputError, match="period: "):
            mass(control, period=wrong)
    for wrong in (-1e-3, np.inf, "late"):
        with pytest.raises(InputError, match="delay: "):
            mass(control, period=0.1, delay=wrong)
    with pytest.raises(InputError, match=r"period: .* no control="):
        mass(None, period=0.1)
    with pytest.raises(InputError, match=r"delay: .* without a period"):
        mass(control, delay=0.1)


def test_plan_and_scene_without_sampled_control():
    scene = mass(lambda t, q, v: np.ones(3), period=1e-3, delay=2e-3)
    assert (
        scene.plan()["control"].reason == "a control callback, sampled every 0.001 s and held, 0.002 s late"
    )
    still = Scene(scene.model, control=scene.control, period=1e-3, without=["control", "gravity"])
    assert pinimpact.simulate(still, np.zeros(3), np.zeros(3), 0.1).q[-1] == pytest.approx(np.zeros(3))


def test_work_of_sampled_control():
    trajectory = run(mass(lambda t, q, v: [2.0, 0, 0], period=0.03), np.zeros(3), np.zeros(3), 1.0)
    assert trajectory.energy.control[-1] == pytest.approx(2.0, rel=1e-12)


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
@pytest.mark.parametrize("scheme", ["auto", "time-stepping"])
def test_unstable_gains_of_sampled_control_raise(scheme):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1e-3, 0.1), pin.SE3.Identity())
    scene = Scene(model, control=JointPD(1.0, 5.0, [0.0]), period=0.01)  # v grows by d T/m = 50 per period
    with pytest.raises(SimulationError, match="velocities are not finite") as error:
        simulate(scene, [0.0], [1.0], 3.0, scheme=scheme)
    assert 0.5 < error.value.partial.t[-1] < 3.0
