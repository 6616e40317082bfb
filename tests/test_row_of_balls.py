"""Impact of a ball on a row of balls at rest, in a scene."""

import string
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Scene, Sphere, impact, simulate

RADIUS = 0.1


def row(stiffness):
    """Return a model of balls on a rail, and the contacts between neighbours with the given stiffnesses."""
    model, here = pin.Model(), pin.SE3.Identity()
    names = string.ascii_lowercase[: len(stiffness) + 1]
    for name in names:
        joint = model.addJoint(0, pin.JointModelPX(), here, name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, RADIUS), here)
        model.addJointFrame(joint)
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    pairs = zip(names[:-1], names[1:], stiffness, strict=True)
    elastic = {"radius": RADIUS, "restitution": 1.0, "law": "energetic"}
    return model, [
        Contact(b, Sphere(radius=RADIUS, body=a), name=a + b, stiffness=k, **elastic) for a, b, k in pairs
    ]


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
@pytest.mark.parametrize("stiffness", [(1.0, 1.0), (1.0, 1.0, 1.0), (1e8, 1e4, 1.0)])
def test_elastic_impact_on_row_of_balls(stiffness, scheme):
    model, contacts = row(stiffness)
    places = 2.0 * RADIUS * np.arange(model.nv)
    v = np.eye(model.nv)[0]
    start = places - 0.1 * v
    run = simulate(Scene(model, contacts), start, v, 0.2, scheme=scheme)
    after = run.impacts[-1].v_after
    assert after.sum() == pytest.approx(1.0, abs=1e-12)
    assert after @ after == pytest.approx(1.0, abs=1e-12)
    assert after == pytest.approx(impact(model, model.createData(), places, v, contacts).v, abs=1e-9)
    if stiffness[0] > 1.0:  # each pair separates before the next one is compressed
        assert after == pytest.approx(np.eye(model.nv)[-1], abs=1e-3)


def test_relative_motion_of_a_long_row_dies_out_in_many_events():
    """With little restitution the balls stay together: the approaches halve 33 times, in 16,000 events."""
    count, e = 18, 0.2
    model, contacts = row(np.ones(count - 1))
    contacts = [replace(contact, restitution=e) for contact in contacts]
    places, v = 2.0 * RADIUS * np.arange(count), np.eye(count)[0]
    found = impact(model, model.createData(), places, v, contacts)
    assert not found.solution.notes
    assert found.v == pytest.approx(np.full(count, 1.0 / count), abs=1e-10)
