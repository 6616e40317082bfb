"""Incipient slip, whose direction adapts infinitely fast (stiff equations)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from scipy.special import erf

from pinimpact import Contact, Plane, Scene, simulate
from pinimpact.scene import progress
from pinimpact.scene._kernels import radau
from pinimpact.scene._kernels.workspace import SceneWorkspace

from .scene_models import G, free_body, run, slider, unbounded

FLOOR = Plane()
MASS, MU, SWELL, TURN = 2.0, 0.4, 3.0, 5.0
START = MU * MASS * G / SWELL


def turning(t, q=None, v=None):
    """Return a horizontal force of increasing size and rotating direction."""
    return SWELL * t * np.array([np.cos(TURN * t), np.sin(TURN * t), 0.0])


def reference(end):
    """Return position and velocity of a point mass under `turning`, by an implicit method of SciPy."""

    def rates(t, y):
        return np.concatenate([y[2:], turning(t)[:2] / MASS - MU * G * y[2:] / np.linalg.norm(y[2:])])

    begun = 1e-4  # the solution does not depend on the state before this time
    v = 0.5 * SWELL / MASS * begun**2 * turning(START + 0.5 * begun)[:2] / np.linalg.norm(turning(START))
    solution = solve_ivp(rates, (START + begun, end), [0.0, 0.0, *v], method="Radau", rtol=1e-11, atol=1e-14)
    return solution.y[:2, -1], solution.y[2:, -1]


@pytest.mark.parametrize("rtol", [1e-5, 1e-7, 1e-9])
def test_incipient_slip_under_rotating_force(rtol):
    end = START + 0.3
    scene = Scene(slider(MASS), [Contact("point", FLOOR, friction=MU)], control=turning)
    trajectory = run(scene, np.zeros(3), np.zeros(3), end, rtol=rtol, atol=1e-2 * rtol)
    assert [m.mode for m in trajectory.modes] == ["stick", "slip"]
    assert trajectory.modes[0].end == pytest.approx(START, rel=1e-8)
    q, v = reference(end)
    assert trajectory.q[-1, :2] == pytest.approx(q, abs=20 * rtol)
    assert trajectory.v[-1, :2] == pytest.approx(v, abs=20 * rtol)


@pytest.mark.parametrize(("width", "rtol"), [(1.0, 1e-4), (0.03, 1e-4), (0.01, 1e-8)])
@pytest.mark.parametrize("middle", [17.3, 37.123])
def test_short_push_after_long_rest_is_detected(width, rtol, middle):
    """A block under a force F exp(−(t − t₀)²/w²) slips once the force exceeds friction, until it stops."""
    force = 8.0

    def control(t, q, v):
        return np.array([force * np.exp(-(((t - middle) / width) ** 2)), 0.0, 0.0])

    scene = Scene(slider(), [Contact("point", FLOOR, friction=MU)], control=control)
    trajectory = run(scene, np.zeros(3), np.zeros(3), 45.0, audit=20 * rtol, rtol=rtol, atol=1e-6 * rtol)
    onset = width * np.sqrt(np.log(force / (MU * G)))

    def momentum(s):
        pushed = 0.5 * np.sqrt(np.pi) * width * force * (erf(s / width) + erf(onset / width))
        return pushed - MU * G * (s + onset)

    end = brentq(momentum, onset, 10.0 * width)
    moved = quad(momentum, -onset, end, epsabs=0.0, epsrel=1e-10)[0]
    assert [m.mode for m in trajectory.modes] == ["stick", "slip", "stick"]
    assert trajectory.q[-1, 0] == pytest.approx(moved, rel=20 * rtol)


def test_incipient_slip_takes_few_steps():
    scene = Scene(slider(MASS), [Contact("point", FLOOR, friction=MU)], control=turning)
    trajectory = run(scene, np.zeros(3), np.zeros(3), START + 0.3, rtol=1e-6)
    assert trajectory.statistics["steps"] < 50  # an explicit method takes hundreds


def test_few_steps_if_loads_depend_on_direction_of_slip():
    """The direction of friction changes the loads of the corners, which are not unique, but not their sum."""
    corners = [(x, y, 0.0) for x in (-0.1, 0.1) for y in (-0.06, 0.06)]
    box = free_body(pin.Inertia(MASS, np.array([0.0, 0.0, 0.15]), np.diag([0.02, 0.02, 0.02])), corners)

    def control(t, q, v):
        return np.append(pin.Quaternion(q[3:]).matrix().T @ turning(t), np.zeros(3))

    scene = Scene(box, [Contact(f"tip{k}", FLOOR, friction=MU) for k in range(4)], control=control)
    trajectory = run(scene, [0, 0, 0, 0, 0, 0, 1], np.zeros(6), START + 0.3, rtol=1e-7, max_step=np.inf)
    assert trajectory.statistics["steps"] < 60  # 3000 if this coupling were neglected
    # the loads rotate the box slightly, so the point mass is an approximation
    velocity = reference(START + 0.3)[1]
    assert trajectory.v[-1, :2] == pytest.approx(velocity, abs=1e-2 * np.linalg.norm(velocity))


def test_incipient_slip_beside_fast_sliding_contact():
    """A force rotates by 2 rad within 2·10⁻⁷ s, and another body slides at 100 km/s."""
    rate, model = 1e7, pin.Model()
    for k in range(2):
        parent = 0
        for kind in (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ):
            parent = model.addJoint(parent, kind(), pin.SE3.Identity(), f"joint{model.njoints}")
        model.appendBodyToJoint(parent, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"point{k}", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)

    def pull(t, q, v):
        return 2.0 * MU * G * np.array([0, 0, 0, np.cos(rate * t), np.sin(rate * t), 0])

    def rates(s, u):  # velocity in units of μg/ω, time in units of 1/ω
        return 2.0 * np.array([np.cos(s), np.sin(s)]) - u / np.linalg.norm(u)

    scene = Scene(model, [Contact(f"point{k}", FLOOR, friction=MU) for k in range(2)], control=pull)
    trajectory = run(scene, np.zeros(6), [1e5, 0, 0, 0, 0, 0], 2.0 / rate, rtol=1e-6, atol=1e-13)
    begun = 1e-6
    end = solve_ivp(rates, (begun, 2.0), [begun, 2.0 / 3.0 * begun**2], method="Radau", rtol=1e-9, atol=1e-12)
    assert trajectory.v[-1, 3:5] * rate / (MU * G) == pytest.approx(end.y[:, -1], abs=1e-4)


def test_turning_slip_of_robot_with_stiff_joint():
    """The joint has a mass of 1 mg and a damping of 10 N s/m, so it practically moves with its parent."""
    ends, steps = [], []
    for joints in (3, 4):
        model, parent = pin.Model(), 0
        kinds = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ, pin.JointModelPX)
        for k, kind in enumerate(kinds[:joints]):
            parent = model.addJoint(parent, kind(), pin.SE3.Identity(), f"joint{k}")
            if k > 1:
                mass = (1.0 if joints == 3 else 1.0 - 1e-6) if k == 2 else 1e-6
                inertia = pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
                model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        model.addFrame(pin.Frame("point", 3, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        unbounded(model)
        model.damping[3:] = 10.0

        def pull(t, q, v):
            force = MU * G * np.array([np.cos(3.0 * t), np.sin(3.0 * t), 0.0, 0.0])
            return 1.0001 * force[: len(v)]

        scene = Scene(model, [Contact("point", FLOOR, friction=MU)], control=pull)
        trajectory = run(scene, np.zeros(joints), [1e-3, *np.zeros(joints - 1)], 0.5, rtol=1e-8, atol=1e-12)
        assert [m.mode for m in trajectory.modes] == ["slip"]
        ends.append(np.append(trajectory.q[-1, :2], trajectory.v[-1, :2]))
        steps.append(trajectory.statistics["steps"])
    assert ends[1] == pytest.approx(ends[0], rel=1e-5)
    assert steps[1] < 3 * steps[0]


@pytest.mark.slow
def test_fast_transient_after_impact_takes_few_rejected_steps():
    # the velocity of the arm settles within 1e-10 s after the impact; before, steps are 1e-2 s long
    model = pin.Model()
    slider = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slider")
    model.appendBodyToJoint(slider, pin.Inertia(1.0, np.zeros(3), np.eye(3) * 1e-3), pin.SE3.Identity())
    arm = model.addJoint(slider, pin.JointModelRY(), pin.SE3.Identity(), "arm")
    lever = pin.Inertia(1e-3, np.array([0.01, 0.0, 0.0]), np.eye(3) * 1e-9)
    model.appendBodyToJoint(arm, lever, pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", slider, slider, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model.damping[:] = 0.0, 1e3
    scene = Scene(model, [Contact("tip", Plane(), restitution=0.8)])
    trajectory = simulate(scene, np.array([0.5, 0.3]), np.zeros(2), 2.0, rtol=1e-6)
    assert len(trajectory.impacts) >= 5
    assert trajectory.statistics["rejected"] <= 3 * len(trajectory.impacts)
    assert abs(trajectory.energy.residual[-1]) < 1e-6


def test_two_coupled_incipient_slips_agree_with_explicit_method(monkeypatch):
    """Two masses are coupled by an arm on a revolute and a prismatic joint; both begin to slip."""
    model, parent = pin.Model(), 0
    kinds = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
    for k, kind in enumerate((*kinds, pin.JointModelRZ, pin.JointModelPX, pin.JointModelPZ)):
        parent = model.addJoint(parent, kind(), pin.SE3.Identity(), f"joint{k}")
        if k in (2, 5):
            inertia = pin.Inertia(1.0 / (k - 1), np.zeros(3), 1e-3 * np.eye(3))
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            model.addFrame(pin.Frame(f"point{k}", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    contacts = [Contact(f"point{k}", FLOOR, friction=0.3) for k in (2, 5)]

    def pull(t, q, v):
        return np.array([1.5 * t, 2.5 * t, 0.0, 0.4 * t, -0.3 * t * t, 0.0])

    def end():
        scene = Scene(model, contacts, control=pull)
        trajectory = run(scene, [0, 0, 0, 0.3, 1.0, 0], np.zeros(6), 2.0, rtol=1e-9, atol=1e-11)
        assert [m.mode for m in trajectory.modes].count("slip") == 2
        return np.concatenate([trajectory.q[-1], trajectory.v[-1]]), trajectory.statistics["steps"]

    implicit, steps = end()
    monkeypatch.setattr(SceneWorkspace, "stiff_length", np.inf)  # all steps are explicit
    monkeypatch.setattr(progress, "BY_EVENTS", 0.0)  # explicit steps become as short as at a discontinuity
    explicit, more_steps = end()
    assert implicit == pytest.approx(explicit, abs=1e-5)
    assert 5 * steps < more_steps


def test_rod_on_two_tips_slips_when_no_sticking_forces_exist():
    """Forces along the rod are not unique: it sticks as long as some of them satisfy Coulomb's law."""
    rod = free_body(pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 0.1, 0.1])), [(-0.5, 0, 0), (0.5, 0, 0)])

    def pull(t, q, v):
        return 2.5 * t * np.array([0.3, 1.0, 0.0, 0.0, 0.0, 0.1])

    contacts = [Contact(f"tip{k}", FLOOR, friction=0.4) for k in range(2)]
    q0 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    start = 0.4 * 0.5 * G / (2.5 * (0.5 + 0.1))  # one tip bears the pull and the torque at its friction limit
    ends = []
    for longest in (np.inf, 0.05):
        trajectory = run(Scene(rod, contacts, control=pull), q0, np.zeros(6), 2.0, max_step=longest)
        assert [m.mode for m in trajectory.modes] == ["stick", "stick", "slip", "slip"]
        assert trajectory.modes[0].end == pytest.approx(start, rel=2e-3)
        assert np.abs(trajectory.at(start)[1]).max() < 1e-6
        ends.append(np.concatenate([trajectory.q[-1], trajectory.v[-1]]))
    assert ends[0] == pytest.approx(ends[1], abs=1e-5)


def test_coefficients_of_radau_iia():
    nodes, matrix, s = radau.ABSCISSAE, radau.MATRIX, radau.STAGES
    for k in range(2 * s - 1):
        assert matrix[-1] @ nodes**k == pytest.approx(1 / (k + 1), abs=1e-14)
    for k in range(s):
        assert matrix @ nodes**k == pytest.approx(nodes ** (k + 1) / (k + 1), abs=1e-14)
    assert nodes[-1] == 1.0
