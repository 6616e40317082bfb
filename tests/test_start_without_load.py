"""Derivatives of motions that start with contacts and limits that touch without a load, or open at once."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Boundary, Contact, Plane, Scene, Stepper, simulate

from .scene_models import UP, ball, free_body
from .test_sensitivities import point

SCHEMES = "event-driven", "time-stepping"
WALL = Plane(normal=(1.0, 0.0, 0.0))
X, Y, Z, ROLL, PITCH, YAW = range(6)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_friction_without_load_holds_nothing(scheme):
    """A ball on a floor touches a wall: it rolls along the wall as without it, and spins."""
    floor, wall = (Contact("center", plane, 0.5, radius=0.1) for plane in (Plane(), WALL))
    stepper = Stepper(Scene(ball(), [floor, wall]), [0.1, 0.0, 0.1, *UP], np.zeros(6), scheme=scheme)
    dt = 0.1
    found = stepper.linearize(np.zeros(6), dt)
    by_v, by_force = found.A[6:, 6:], found.B[6:]
    assert np.allclose(by_v[[Y, ROLL], Y], [5 / 7, -50 / 7])
    assert np.allclose(by_v[:, YAW], np.eye(6)[YAW], atol=1e-12)
    assert np.allclose(by_force[[Y, ROLL], Y], np.array([5 / 7, -50 / 7]) * dt / 2.0)
    assert np.allclose(by_force[YAW, YAW], dt / (0.4 * 2.0 * 0.1**2))
    # towards the wall it stops, away from it it rolls
    assert np.isnan(by_v[:, X]).all()
    assert np.isnan(by_force[:, [X, PITCH]]).all()
    assert found.boundary & (Boundary.GRAZING | Boundary.EVENTS_COINCIDE)


def test_box_beside_wall_has_no_derivative_by_pushes_across_it():
    """Loads of the corners on the floor are not unique, those at the wall vanish."""
    size = np.array([0.2, 0.3, 0.4])
    places = [np.array([x, y, z]) * size / 2 for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    model = free_body(pin.Inertia.FromBox(1.0, *size), places)
    floor = [Contact(f"tip{k}", Plane(), 0.5) for k, place in enumerate(places) if place[2] < 0.0]
    wall = [Contact(f"tip{k}", WALL, 0.5) for k, place in enumerate(places) if place[0] < 0.0]
    scene = Scene(model, floor + wall)
    stepper = Stepper(scene, [0.1, 0.0, 0.2, *UP], np.zeros(6), scheme="event-driven")
    force = np.array([0.0, 7.0, 0.0, 0.0, 0.0, 0.0])  # it slides along the wall
    stepper.step(force, 0.1)
    found, (q, v) = stepper.linearize(force, 0.1), (stepper.q, stepper.v)
    assert np.isfinite(found.A[:, 6 + Y]).all()
    assert np.isnan(found.B[:, X]).all()
    assert Boundary.GRAZING in found.boundary

    def after(push):
        moved = Stepper(scene, q, v)
        return moved.step(force + np.array([push, 0, 0, 0, 0, 0]), 0.1)[0][X]

    assert after(1e-3) - q[X] > 1e-7 > abs(after(-1e-3) - q[X])


def test_limit_without_load():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -1.0, 1.0
    found = Stepper(Scene(model), [-1.0], [0.0], scheme="event-driven").linearize([0.0], 0.1)
    assert np.isnan(found.A).all()
    assert np.isnan(found.B).all()
    assert Boundary.GRAZING in found.boundary


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("impact", [False, True])
def test_contact_that_opens_at_start_is_flagged(scheme, impact):
    """A point is pulled from a wall that it touches: a velocity towards the wall would be reversed."""
    model = point("block")
    model.gravity.linear[:] = 0.0
    contacts = [Contact("block centre", WALL, restitution=1.0)]
    contacts += [Contact("block centre", Plane(), restitution=0.5)] if impact else []
    scene, pull = Scene(model, contacts), [1.0, 0.0, 0.0]
    found = Stepper(scene, np.zeros(3), [0.0, 0.0, -impact], scheme=scheme).linearize(pull, 0.1)
    assert found.boundary & (Boundary.GRAZING | Boundary.EVENTS_COINCIDE)
    column = found.A[:, 3]
    assert np.isnan(column).all() or np.allclose(column, [0.1, 0, 0, 1, 0, 0])
    away = Stepper(scene, [1e-3, 0, 1e-3], np.zeros(3), scheme=scheme).linearize(pull, 0.1)
    assert away.boundary == Boundary.NONE


def test_friction_that_just_balances_load_of_wall():
    """A belt pulls a block towards a wall as hard as gravity pulls it away."""
    model = point("block")
    model.gravity.linear = np.array([0.5 * 9.81, 0.0, -9.81])
    belt = Contact("block centre", Plane(velocity=(-1.0, 0.0, 0.0)), 0.5, name="belt")
    scene = Scene(model, [belt, Contact("block centre", WALL)])
    names = "state", "friction:belt"
    run = simulate(scene, np.zeros(3), np.zeros(3), 0.1, scheme="event-driven", sensitivities=names)
    found = run.sensitivity(0.1)
    assert np.isnan(found.parameters["friction:belt"]).all()
    assert np.isfinite(found.state[:, 3 + Y]).all()
    assert Boundary.GRAZING in found.boundary
