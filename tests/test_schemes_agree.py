"""Degenerate everyday motions by the default scheme against time steps: two formulations of the same law.

Faces lie on faces, so that loads are shared in many ways, and forces begin slip and rotation from rest.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, simulate

from .scene_models import UP, G
from .test_time_stepping import boxes

SIZE, MU = (0.2, 0.2, 0.1), 0.4
FLAT = [0.0, 0.0, 0.05, *UP]


def pushed(scene, q0, force, v0=None, gravity=(0.0, 0.0, -G)):
    """Return a scene under constant generalized forces and a gravity, and where it begins."""
    scene.model.gravity.linear[:] = gravity
    force = np.array(force, dtype=float)
    scene = dataclasses.replace(scene, control=lambda t, q, v: force)
    return scene, np.array(q0), np.zeros(scene.model.nv) if v0 is None else np.array(v0, dtype=float)


def on_the_floor(force, v0=None, **options):
    return pushed(boxes(1, SIZE, 1.0, floor=MU), FLAT, force, v0, **options)


def stacked(force, v0=None):
    scene = boxes(2, SIZE, 1.0, floor=MU, between=MU)
    return pushed(scene, [*FLAT, 0.0, 0.0, 0.15, *UP], force, v0)


def side_by_side(force, v0=None):
    scene = boxes(2, SIZE, 1.0, floor=MU, between=MU)
    return pushed(scene, [*FLAT, 0.2, 0.0, 0.05, *UP], force, v0)


def between_planes(normals, points, q0, force, v0=None):
    scene = boxes(1, SIZE, 1.0)
    contacts = [
        Contact(geometry="box_0_0", plane=Plane(normal=n, point=p), friction=MU, name=f"plane {k}")
        for k, (n, p) in enumerate(zip(normals, points, strict=True))
    ]
    return pushed(dataclasses.replace(scene, contacts=contacts), q0, force, v0)


def in_a_corner(force):
    return between_planes([(0, 0, 1), (-1, 0, 0)], [(0, 0, 0), (0.1, 0, 0)], FLAT, force)


def in_a_groove(force, v0=None):
    # the box lies on an edge: the width of its faces from the bottom of the groove
    turn = pin.Quaternion(pin.exp3(np.array([np.pi / 4, 0.0, 0.0]))).coeffs()
    center = np.array([0.0, 0.1 - 0.05, 0.1 + 0.05]) / np.sqrt(2.0)
    normals = [np.array([0.0, 1.0, 1.0]) / np.sqrt(2.0), np.array([0.0, -1.0, 1.0]) / np.sqrt(2.0)]
    return between_planes(normals, np.zeros((2, 3)), [*center, *turn], force, v0)


def slope(degrees, about):
    return tuple(pin.exp3(np.deg2rad(degrees) * np.array(about)) @ [0.0, 0.0, -G])


MOTIONS = {
    "slides and spins": on_the_floor(np.zeros(6), [1, 0.3, 0, 0, 0, 3]),
    "spins": on_the_floor(np.zeros(6), [0, 0, 0, 0, 0, 8]),
    "rests on a slope": on_the_floor(np.zeros(6), gravity=slope(21.0, (0.6, 0.8, 0.0))),
    "slides down a slope": on_the_floor(np.zeros(6), gravity=slope(25.0, (0.6, 0.8, 0.0))),
    "is pushed too little": on_the_floor([3.9, 0, 0, 0, 0, 0]),
    "is pushed": on_the_floor([4.1, 0, 0, 0, 0, 0]),
    "is pushed aside": on_the_floor([8, 0, 0, 0, 0, 0.64]),
    "is twisted": on_the_floor([0, 0, 0, 0, 0, 0.8]),
    "is lifted at an edge": on_the_floor([0, 0, 0, 0, 0.6, 0]),
    "lower box pulled, upper one keeps up": stacked([9.0, *np.zeros(11)]),
    "lower box pulled out": stacked([20.0, *np.zeros(11)]),
    "upper box pulled": stacked([*np.zeros(6), 5.0, *np.zeros(5)]),
    "upper box spins": stacked(np.zeros(12), [*np.zeros(11), 5.0]),
    "a box pushes another": side_by_side([9.0, *np.zeros(11)]),
    "a box pushes another off its middle": side_by_side([12.0, 0, 0, 0, 0, 0.6, *np.zeros(6)]),
    "two boxes press and shear": side_by_side([12, 0, 0, 0, 0, 0, -6, 3, 0, 0, 0, 0]),
    "is pressed into a corner": in_a_corner([6, 0, 0, 0, 0, 0]),
    "is drawn up a wall": in_a_corner([6, 0, 12, 0, 0, 0]),
    "is pushed along a wall": in_a_corner([6, 6, 0, 0, 0, 0]),
    "slides along a groove": in_a_groove(np.zeros(6), [1, 0, 0, 0, 0, 0]),
    "is pushed along a groove": in_a_groove([8, 0, 0, 0, 0, 0]),
    "is turned in a groove": in_a_groove([0, 0, 0, 0.8, 0, 0]),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_events_and_time_steps_give_the_same_motion(name):
    scene, q0, v0 = MOTIONS[name]
    located = simulate(scene, q0, v0, 0.25)
    assert located.complete
    coarse, fine = (simulate(scene, q0, v0, 0.25, scheme="time-stepping", dt=dt).q[-1] for dt in (1e-3, 5e-4))
    # steps are of first order where contact changes, and share loads to a part of their compliances
    error = 3.0 * np.abs(coarse - fine).max() + 3e-4 * np.abs(located.q[-1] - q0).max() + 1e-9
    assert located.q[-1] == pytest.approx(2.0 * fine - coarse, abs=error)
