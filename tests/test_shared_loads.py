"""Contacts that share their load in several ways: the limit of small equal compliances, by both schemes."""

from __future__ import annotations

import warnings

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from pinimpact import Contact, Plane, Scene, simulate

from .scene_models import UP, G, unbounded

SIZE, MU, T = (0.2, 0.2, 0.1), 0.4, 0.25
CORNERS = np.array([(x, y, -0.05) for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
INERTIA = (SIZE[0] ** 2 + SIZE[1] ** 2) / 12.0


def box(push):
    """Return the scene of a box of 1 kg on a floor, pushed by a force along its x axis and a torque."""
    model, shapes = pin.Model(), pin.GeometryModel()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, *SIZE), pin.SE3.Identity())
    model.addJointFrame(joint)
    shapes.addGeometryObject(pin.GeometryObject("box_0", joint, pin.SE3.Identity(), coal.Box(*SIZE)))
    unbounded(model)
    contact = Contact(geometry="box_0", plane=Plane(), friction=MU)
    force = np.array([push[0], 0, 0, 0, 0, push[1]])
    return Scene(model, [contact], geometry=shapes, control=lambda t, q, v: force)


def on_springs(push, start):
    """Return x, y, angle, and their rates at T of that box on four equal stiff springs.

    Loads N balance weight and the moments of friction about the two horizontal axes. Compressions of equal
    springs below a rigid flat box satisfy N₁ − N₂ − N₃ + N₄ = 0.
    """

    def rates(t, y):
        c, s = np.cos(y[2]), np.sin(y[2])
        arms = CORNERS[:, :2] @ np.array([[c, s], [-s, c]])
        slip = y[3:5] + y[5] * np.column_stack([-arms[:, 1], arms[:, 0]])
        drag = -MU * slip / np.linalg.norm(slip, axis=1)[:, None]  # of one newton of load
        height = -CORNERS[0, 2]
        loads = np.linalg.solve(
            [
                np.ones(4),
                arms[:, 0] + height * drag[:, 0],  # about y
                arms[:, 1] + height * drag[:, 1],  # about x
                [1.0, -1.0, -1.0, 1.0],
            ],
            [G, 0.0, 0.0, 0.0],
        )
        assert loads.min() > 0.0
        force = loads @ drag + push[0] * np.array([c, s])
        torque = loads @ (arms[:, 0] * drag[:, 1] - arms[:, 1] * drag[:, 0]) + push[1]
        return [*y[3:], *force, torque / INERTIA]

    return solve_ivp(rates, (0.0, T), [0, 0, 0, *start], method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]


@pytest.mark.parametrize(
    ("push", "start"),
    [
        ((0.0, 0.0), (1.5, 0.3, 3.0)),
        ((0.0, 0.0), (1.5, 0.0, 10.0)),
        ((1.0, 0.2), (0.8, -0.8, -5.0)),
        ((8.0, 0.6), (0.01, 0.0, 0.3)),
    ],
)
def test_a_box_slides_and_turns_as_on_four_stiff_springs(push, start):
    wanted = on_springs(push, start)
    scene, q0 = box(push), np.array([0, 0, 0.05, *UP])
    v0 = np.array([*start[:2], 0, 0, 0, start[2]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        located = simulate(scene, q0, v0, T, scheme="event-driven", rtol=1e-10)
        assert pose(located) == pytest.approx(wanted, abs=1e-7)
        off = [
            np.abs(pose(simulate(scene, q0, v0, T, scheme="time-stepping", dt=dt)) - wanted).max()
            for dt in (1e-3, 2.5e-4)
        ]
    assert off[0] < 2e-2
    assert off[1] < 0.6 * off[0]


def pose(run):
    """Return x, y, angle and their rates at the end, in world axes."""
    q, v = run.q[-1], run.v[-1]
    turned = pin.XYZQUATToSE3(q).rotation
    velocity = turned @ v[:3]
    return np.array([*q[:2], np.arctan2(turned[1, 0], turned[0, 0]), *velocity[:2], v[5]])
