"""Boxes that rock about an edge; both corners of the other edge land at the same instant."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene, simulate

SIZE = 0.2, 0.3, 0.4


def rocking_box(angle, friction, turn):
    """Return a scene of a box at rest on an edge, and its configuration, both rotated by `turn`."""
    model, shapes, here = pin.Model(), pin.GeometryModel(), pin.SE3.Identity()
    model.gravity.linear = turn @ model.gravity.linear
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), here, "box")
    model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, *SIZE), here)
    model.addJointFrame(joint)
    shapes.addGeometryObject(pin.GeometryObject("box", joint, here, coal.Box(*SIZE)))
    floor = Contact(geometry="box", plane=Plane(normal=turn[:, 2]), friction=friction)
    rotation = pin.utils.rotate("y", angle)
    edge = rotation @ [0.1, 0.0, -0.2]
    q = np.concatenate([turn @ [0.0, 0.0, -edge[2]], pin.Quaternion(turn @ rotation).coeffs()])
    return Scene(pin.RobotWrapper(model, shapes, shapes), [floor]), q


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.5)])
@pytest.mark.parametrize(
    ("angle", "friction", "rtol"),
    [(0.2618, 1.0, 1e-8), (0.4, 1.0, 1e-8), (0.0891, 0.2, 1e-8), (0.1236, 0.2, 1e-6), (0.4, 1.0, 1e-4)],
)
def test_rocking_box_stays_in_its_plane(angle, friction, rtol, turn):
    # if corners landed one after another, the box would rotate out of its plane at about 0.1 rad/s; errors
    # of integration may grow from landing to landing
    scene, q = rocking_box(angle, friction, pin.exp3(np.array(turn)))
    run = simulate(scene, q, np.zeros(6), 0.8, rtol=rtol, atol=1e-2 * rtol, scheme="event-driven")
    assert len(run.impacts) > 4
    assert np.abs(run.v[:, [1, 3, 5]]).max() < 10.0 * rtol
