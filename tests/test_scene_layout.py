"""Cached data of a scene: recomputed when the model changes, and independent of other runs."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene, simulate

from .scene_models import UP, G, ball, run, slider


def sphere_above(radius=0.1):
    return Scene(ball(), [Contact("center", Plane(), radius=radius, restitution=0.5, name="ball")])


def test_changed_joint_limit_takes_effect():
    model = slider()
    model.upperPositionLimit = np.array([1.0, np.inf, np.inf])
    scene = Scene(model, without=["gravity"])
    for bound in (1.0, 0.25):
        model.upperPositionLimit = np.array([bound, np.inf, np.inf])
        assert run(scene, np.zeros(3), [1.0, 0, 0], 2.0).impacts[0].time == pytest.approx(bound, rel=1e-12)


def test_changed_frame_placement_takes_effect():
    scene = sphere_above()
    start = [0, 0, 1.0, *UP]
    assert run(scene, start, np.zeros(6), 0.5).impacts[0].time == pytest.approx(
        np.sqrt(2 * 0.9 / G), rel=1e-9
    )
    frame = scene.model.frames[scene.model.getFrameId("center")]
    frame.placement = pin.SE3(np.eye(3), np.array([0, 0, -0.4]))
    found = run(scene, start, np.zeros(6), 0.5).impacts[0].time
    assert found == pytest.approx(np.sqrt(2 * 0.5 / G), rel=1e-9)


def test_changed_joint_placement_recomputes_layout():
    model = slider()
    scene = Scene(model, [Contact(model.frames[-1].name, Plane(point=(0, 0, -5.0)))])
    before = scene.layout()
    assert scene.layout() is before
    model.jointPlacements[1] = pin.SE3(np.eye(3), np.array([0, 0, 3.0]))
    assert scene.layout() is not before


def test_changed_mass_takes_effect_for_many_bodies():
    """Such a robot has no Data of its own, but one for each of its trees."""
    model, count = pin.Model(), 30
    for k in range(count):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"ball{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        model.addBodyFrame(f"ball{k}", joint, pin.SE3.Identity(), 0)
    scene = Scene(model, [Contact(f"ball{k}", Plane(), radius=0.1, name=f"floor{k}") for k in range(count)])
    start = np.tile([0, 0, 0.1, *UP], count)
    start[::7] = np.arange(count)
    for mass in (1.0, 3.0):
        model.inertias[6] = pin.Inertia.FromSphere(mass, 0.1)
        trajectory = simulate(scene, start, np.zeros(6 * count), 0.1)
        assert trajectory.forces("floor5", 0.05)[2] == pytest.approx(mass * G, rel=1e-9)


def test_repeated_and_nested_runs_are_bitwise_equal():
    scene = sphere_above()
    start, v = [0, 0, 0.5, *UP], np.array([0.3, 0, 0, 1.0, 2.0, 0])
    alone = simulate(scene, start, v, 1.0)
    inner = []

    def progress(t, duration):
        if len(inner) < 3:
            inner.append(simulate(scene, start, v, 1.0))

    outer = simulate(scene, start, v, 1.0, progress=progress)
    again = simulate(scene, start, v, 1.0)
    for other in (outer, again, *inner):
        assert np.array_equal(other.t, alone.t)
        assert np.array_equal(other.q, alone.q)
        assert np.array_equal(other.v, alone.v)


def test_scene_can_be_pickled_after_a_run():
    scene = sphere_above()
    first = run(scene, [0, 0, 0.5, *UP], np.zeros(6), 0.5)
    second = run(pickle.loads(pickle.dumps(scene)), [0, 0, 0.5, *UP], np.zeros(6), 0.5)
    assert np.array_equal(first.q, second.q)
