"""A contact that friction locks at a stretched arm: where no forces exist, against a scan of all of them."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, Plane, Scene, simulate
from pinimpact.scene.locked_posture import locked_direction

from .scene_models import unbounded


def slides(delassus, acceleration, mu):
    """Whether a force at its bound lets a contact slide off from rest, by a scan over its directions."""
    angle = np.linspace(0.0, 2.0 * np.pi, 20001)
    s = np.array([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    push = np.array([[0.0], [0.0], [1.0]]) - mu * s
    effective = delassus[2] @ push
    with np.errstate(divide="ignore"):
        normal = -acceleration[2] / effective
    moved = acceleration[:, None] + delassus @ push * normal
    across, along = moved[1] * s[0] - moved[0] * s[1], (moved * s).sum(axis=0)
    good = (normal > 0.0) & (along > 0.0)
    turns = (across[1:] * across[:-1] <= 0.0) & good[1:] & good[:-1]
    return bool(turns.any())


def test_a_contact_is_locked_where_no_force_lets_it_slide():
    rng = np.random.default_rng(1)
    found = []
    while len(found) < 300:
        rows, a, mu = rng.normal(size=(3, 2)), rng.normal(size=3), rng.uniform(0.3, 2.0)
        delassus = rows @ rows.T
        u = np.linalg.eigh(delassus)[1][:, 0]
        u *= np.sign(u[2])
        if a[2] >= 0.0 or u @ a >= 0.0 or np.hypot(*u[:2]) >= mu * u[2]:
            assert locked_direction(delassus, a, mu) is None
            continue
        if u @ a > -0.05:  # the scan is coarse
            continue
        locked = locked_direction(delassus, a, mu)
        assert (locked is None) == slides(delassus, a, mu)
        if locked is not None:
            assert delassus @ locked == pytest.approx(np.zeros(3), abs=1e-12)
        found.append(locked is None)
    assert sum(found) > 5


def arm(turns=True):
    """Two links of 1 m that turn about a vertical axis, or do not, then both upwards; its tip."""
    model = pin.Model()
    link = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), np.diag([0.01, 0.1, 0.1]))
    ahead = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    turn = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn") if turns else 0
    lift = model.addJoint(turn, pin.JointModelRY(), pin.SE3.Identity(), "lift")
    model.appendBodyToJoint(lift, link, pin.SE3.Identity())
    elbow = model.addJoint(lift, pin.JointModelRY(), ahead, "elbow")
    model.appendBodyToJoint(elbow, link, pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", elbow, 0, ahead, pin.FrameType.OP_FRAME))
    unbounded(model)
    return model


def with_weight(scene, q, v):
    """Add a weight that lies on a floor of its own, on a sliding joint."""
    model = scene.model.copy()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "weight")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("weight", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    contacts = [Contact("weight", Plane(), friction=0.5), *scene.contacts]
    return Scene(model, contacts), np.append(q, 0.0), np.append(v, 0.0)


def stretching(mu, bend=0.02):
    """An arm that rises at 45° from below a floor, its tip on it and sliding out, the elbow at 3 rad/s."""
    angle = np.radians(45.0)
    reach = 2.0 * np.cos(0.5 * bend)
    # about y a positive angle lowers what points along x
    q = np.array([0.0, -angle - 0.5 * bend, bend])
    v = np.array([0.0, 0.0, -3.0])
    height = reach * np.sin(angle)
    rates = np.array(
        [-reach * np.cos(angle), -np.cos(angle - 0.5 * bend)]
    )  # of the height, by lift and elbow
    v[1] = -rates[1] * v[2] / rates[0]
    return Scene(arm(), [Contact("tip", Plane(point=(0.0, 0.0, height)), friction=mu)]), q, v


@pytest.mark.parametrize("beside", [False, True])
def test_friction_locks_a_tip_at_the_arms_full_reach(beside):
    """Also beside what has nothing to do with it."""
    scene, q, v = with_weight(*stretching(1.2)) if beside else stretching(1.2)
    with pytest.raises(pinimpact.LockedPostureError, match=r"'tip on plane' is locked .* below 1,") as caught:
        simulate(scene, q, v, 0.1)
    assert isinstance(caught.value, pinimpact.SimulationError)
    # the elbow is straight, as nearly as its rate a little earlier tells
    time = float(re.search(r"t = (\S+) s", str(caught.value))[1])
    partial = caught.value.partial
    left = partial.q[-1, 2] + (time - partial.t[-1]) * partial.v[-1, 2]
    assert abs(left) < 5e-4
    assert partial.energy.residual == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("beside", [False, True])
def test_a_tip_with_less_friction_slides_back_from_the_arms_full_reach(beside):
    scene, q, v = with_weight(*stretching(0.9)) if beside else stretching(0.9)
    trajectory = simulate(scene, q, v, 0.1)
    assert trajectory.complete
    assert trajectory.q[-1, 2] < -0.01


def rough(scene, q, v):
    """Add dry friction of 1 N m in all joints."""
    model = scene.model.copy()
    model.friction = np.ones(model.nv)
    return Scene(model, scene.contacts), q, v


def planar(scene, q, v):
    """Take out the joint that turns the arm, so that nothing moves its tip across."""
    return Scene(arm(turns=False), scene.contacts), q[1:], v[1:]


@pytest.mark.parametrize("kind", [lambda *arm: arm, rough, planar])
@pytest.mark.parametrize("bend", [1e-4, 1e-5, -1e-6])
@pytest.mark.parametrize("rtol", [4e-4, 1e-6])
def test_a_tip_that_rests_next_to_the_full_reach_is_locked_there(rtol, bend, kind):
    """Its elbow is straight after bend / (3 rad/s); slip counts as rest a little earlier.

    Were it to stick without having been stopped, friction would throw it with a thousand times its energy.
    """
    scene, q, v = kind(*stretching(1.2, bend))
    with pytest.raises(pinimpact.LockedPostureError) as caught:
        simulate(scene, q, v, 0.1, rtol=rtol, atol=1e-2 * rtol)
    partial = caught.value.partial
    time = float(re.search(r"t = (\S+) s", str(caught.value))[1])
    early = 0.1 * scene.rest / (4.5 * np.sqrt(2.0))  # the tip slides at 1.5 √2 rad/s · bend
    assert abs(time - bend / 3.0) <= early
    assert partial.energy.kinetic.max() <= partial.energy.kinetic[0] * (1.0 + rtol)
    assert partial.energy.friction.max() <= 0.0


@pytest.mark.parametrize("kind", [lambda *arm: arm, planar])
@pytest.mark.parametrize("bend", [1e-4, 1e-5, -1e-6])
@pytest.mark.parametrize("rtol", [4e-4, 1e-6])
def test_a_tip_with_less_friction_is_not_locked_next_to_the_full_reach(rtol, bend, kind):
    scene, q, v = kind(*stretching(0.9, bend))
    trajectory = simulate(scene, q, v, 0.1, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.complete
    assert trajectory.q[-1, -1] < -0.01
    assert not trajectory.notes


@pytest.mark.parametrize("joint", ["lift", "elbow"])
def test_a_joint_whose_velocity_no_impact_changes_locks_no_posture(joint):
    """A bent arm that leans on its tip rests as it would with all joints free."""
    scene, q, _ = stretching(1.2, -0.5)
    trajectory = simulate(Scene(scene.model, scene.contacts, locked=[joint]), q, np.zeros(3), 0.05)
    assert [mode.mode for mode in trajectory.modes] == ["stick"]
