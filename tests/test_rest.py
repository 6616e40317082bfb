"""Bodies at rest in time stepping: they are skipped, transmit their loads, and are woken when needed."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Event, Plane, Scene, Shape, Stepper, simulate

from .scene_models import UP, G, box_on
from .test_time_stepping import boxes

DT = 1e-3


def step(scene, q0, v0, duration, **options):
    return simulate(scene, q0, v0, duration, scheme="time-stepping", dt=DT, **options)


def never_resting(scene):
    """Return the same scene with a zero control, which prevents bodies from being skipped as at rest."""
    nv = scene.model.nv
    return Scene(scene.model, scene.contacts, geometry=scene.geometry, control=lambda t, q, v: np.zeros(nv))


def test_resting_stack_stands_and_transmits_its_load():
    count = 10
    scene = boxes(count, (0.2, 0.2, 0.1), 1.0)
    q0 = np.array([[0, 0, 0.05 + 0.1 * k, *UP] for k in range(count)])
    run = step(scene, q0.ravel(), np.zeros(6 * count), 60.0)
    assert np.abs(run.q[-1] - q0.ravel()).max() < 1e-8
    assert run.statistics["steps"] < 100
    for t in (0.5e-3, 30.0, 59.0):
        for k in range(count - 1):
            names = [f"pair {k}", *(f"pair {k} {i}" for i in range(2, 9))]
            force = sum(np.array(run.forces(name, t)) for name in names)
            assert force == pytest.approx([0.0, 0.0, (count - 1 - k) * G], abs=1e-5)
    assert run.mode_at("floor 0 corner 1", 59.0) == "stick"


@pytest.mark.parametrize("masses", [(1.0, 1e3), (1e3, 1.0), (1.0, 1e3, 1.0)])
def test_heavy_box_on_light_box_rests(masses):
    """With contact problems solved only to a residual of 10⁻⁵, the boxes would creep sideways for ever."""
    scene = boxes(len(masses), (0.2, 0.2, 0.1), 1.0)
    for k, mass in enumerate(masses):
        scene.model.inertias[k + 1] = pin.Inertia.FromBox(mass, 0.2, 0.2, 0.1)
    q0 = np.concatenate([[0.02 * k, -0.01 * k, 0.05 + 0.1 * k, *UP] for k in range(len(masses))])
    run = step(scene, q0, np.zeros(6 * len(masses)), 10.0)
    assert run.statistics["steps"] < 100
    assert np.abs(run.q[-1] - q0).max() < 1e-10
    assert not run.notes
    for k in range(1, len(masses)):
        names = [name for name in run.sources if name.split()[:2] == ["pair", str(k - 1)]]
        force = sum(np.array(run.forces(name, 5.0)) for name in names)
        np.testing.assert_allclose(force / (sum(masses[k:]) * G), [0.0, 0.0, 1.0], atol=1e-6)


@pytest.mark.parametrize(("height", "part"), [(0.05, 1.0), (0.08, 1e-3), (0.12, 1e-3), (0.15, 1e-4)])
def test_struck_stack_is_woken(height, part):
    """A box hits a resting stack of three; compare with steps in which no body is skipped.

    At a height of 0.05 m the box slides on the floor, and some contact problems are solved to 1e-5 only.
    """
    scene = boxes(3, (0.2, 0.2, 0.1), 1.0)
    model = scene.model
    other = pin.Model(model)
    joint = other.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "thrown")
    other.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.1, 0.1, 0.1), pin.SE3.Identity())
    other.addJointFrame(joint)
    shapes = scene.geometry.copy()
    shapes.addGeometryObject(pin.GeometryObject("thrown", joint, pin.SE3.Identity(), coal.Box(0.1, 0.1, 0.1)))
    for limit in (other.lowerPositionLimit, other.upperPositionLimit):
        limit[:] = np.inf
    other.lowerPositionLimit[:] = -np.inf
    contacts = [
        Contact(geometry=f"box_{k}_0", plane=Plane(), friction=0.5, name=f"floor {k}") for k in range(3)
    ]
    contacts += [
        Contact(geometry=f"box_{k + 1}_0", plane=Shape(f"box_{k}_0"), friction=0.5, name=f"pair {k}")
        for k in range(2)
    ]
    contacts += [
        Contact(geometry="thrown", plane=Shape(f"box_{k}_0"), friction=0.3, name=f"hit {k}") for k in range(3)
    ]
    contacts.append(Contact(geometry="thrown", plane=Plane(), friction=0.2, name="thrown"))
    hit = Scene(other, contacts, geometry=shapes)
    q0 = [*(c for k in range(3) for c in (0, 0, 0.05 + 0.1 * k, *UP)), -0.5, 0.01, height, *UP]
    v0 = [*np.zeros(18), 3.0, 0, 0.5, 0, 0, 0]
    one, other = (step(scene, q0, v0, 0.4) for scene in (hit, never_resting(hit)))
    short = simulate(hit, q0, v0, 0.4, scheme="time-stepping", dt=0.5 * DT)
    by_length = np.abs(one.q[-1] - short.q[-1]).max()  # discretization error of these steps
    assert np.abs(one.q[-1][:21] - np.array(q0[:21])).max() > 1e-2
    assert np.abs(one.q[-1] - other.q[-1]).max() < part * by_length


def test_changing_force_wakes_box():
    """A box that is pushed from t = 0.5 s on slides by (F/m − μ g) t²/2."""
    model, contacts = box_on(4, mu=0.3)

    def control(t, q, v):
        return [5.0 if t >= 0.5 else 0.0, 0, 0, 0, 0.0, 0]

    scene = Scene(model, contacts, control=control, period=0.01)
    run = step(scene, [0, 0, 0.1, *UP], np.zeros(6), 1.0)
    rate = 5.0 - 0.3 * G
    assert run.statistics["steps"] < 800
    assert run.q[-1, 0] == pytest.approx(0.5 * rate * 0.5**2, abs=2.0 * rate * 0.5 * DT)


def test_event_callback_wakes_box():
    model, contacts = box_on(4, mu=0.3)
    kick = Event(lambda t, q, v: t - 0.5, lambda t, q, v: np.array([1.0, 0, 0, 0, 0, 0]))
    run = step(Scene(model, contacts, events=[kick]), [0, 0, 0.1, *UP], np.zeros(6), 1.5)
    assert run.q[-1, 0] == pytest.approx(0.5 / (0.3 * G), abs=2.0 * DT)


def test_work_of_belt_slipping_under_resting_box():
    model, _ = box_on(4, turn=0.25 * np.pi)
    belt = Plane(velocity=(1.0, 0.0, 0.0))
    contacts = [Contact(f"tip{k}", belt, friction=0.3) for k in range(4)]
    wall = Plane(point=(0.25, 0.0, 0.0), normal=(-1.0, 0.0, 0.0))
    contacts += [Contact("tip0", wall, name="stop 0"), Contact("tip3", wall, name="stop 3")]
    placed = [0.0, 0, 0.1, *UP]
    run = step(Scene(model, contacts), placed, np.zeros(6), 3.0)
    assert np.abs(run.v[-1]).max() < 1e-6
    late = run.t > 2.0
    power = np.polyfit(run.t[late], run.energy.friction[late] + run.energy.surface[late], 1)[0]
    taken = run.energy.friction[-1] - run.energy.friction[late][0]
    assert taken == pytest.approx(-0.3 * G * (3.0 - run.t[late][0]), rel=1e-6)
    assert power == pytest.approx(0.0, abs=1e-6)


def test_copies_of_resting_stepper_continue_equally():
    model, contacts = box_on(4, mu=0.3)
    stepper = Stepper(Scene(model, contacts), [0, 0, 0.1, *UP], np.zeros(6), scheme="time-stepping", dt=DT)
    still, push = np.zeros(6), np.array([5.0, 0, 0, 0, 0, 0])
    stepper.step(still, 0.05)
    other = stepper.copy()
    for one in (stepper, other):
        for force in (still, push, still):
            one.step(force, 0.05)
    assert np.array_equal(stepper.q, other.q)
    assert stepper.q[0] > 1e-4


@pytest.mark.parametrize("tilt", [1e-3, 7e-3, 0.02])
def test_rocking_box_on_box_comes_to_rest(tilt):
    """Without contact forces both boxes fall alike, so a small decrease of a gap is no sign of separation."""
    scene, turn = boxes(2, (0.2, 0.2, 0.1), 1.0), pin.utils.rotate("y", 0.5 * np.pi + tilt)
    height = 0.1 + 0.05 * np.sin(tilt) + 0.1 * np.cos(tilt)
    q0 = np.r_[0, 0, 0.05, UP, 0, 0, height, pin.Quaternion(turn).coeffs()]
    run = simulate(scene, q0, np.zeros(12), 1.5, scheme="time-stepping", dt=2e-3)
    assert np.abs(run.v[-1]).max() == 0.0
    assert run.q[-1, 9] == pytest.approx(0.2, abs=1e-8)
