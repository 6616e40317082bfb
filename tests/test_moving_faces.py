"""Time stepping of shapes that slide on each other: second order, in either order of the shapes."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

from pinimpact import Contact, InputError, Scene, Shape, simulate

from .scene_models import unbounded

TURNED = np.pi / 4
SHAPES = {
    "face on corners": (coal.Box(1.0, 0.1, 0.02), 0.0, coal.Box(0.1, 0.05, 0.1), 0.0),
    "face on ball": (coal.Box(1.0, 0.1, 0.02), 0.0, coal.Sphere(0.05), 0.0),
    "edge on edge": (coal.Box(1.0, 0.05, 0.05), TURNED, coal.Box(0.1, 0.1, 0.1), TURNED),
    "edge on ball": (coal.Box(1.0, 0.05, 0.05), TURNED, coal.Sphere(0.05), 0.0),
    "capsule on edge": (coal.Capsule(0.02, 1.0), TURNED, coal.Box(0.1, 0.1, 0.1), TURNED),
}
"""Shape of the bar and its rotation about its length; shape of the cart and its rotation about the hinge."""

KNOWN = [(what, swapped) for what in SHAPES for swapped in (False, True) if what != "edge on ball" or swapped]
"""An edge of the first shape against a ball of the second: the contact point is fixed to the edge."""


def bar_on_cart(what, swapped, at=0.4):
    """Return a scene of a hinged bar that lies on a cart, and a state in which the cart moves away."""
    bar, roll, cart, turn = SHAPES[what]
    model, shapes = pin.Model(), pin.GeometryModel()
    joints = (
        model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge"),
        model.addJoint(0, pin.JointModelPX(), pin.SE3(np.eye(3), np.array([0, 0, -0.2])), "rail"),
    )
    middle = np.array([0.5, 0.0, 0.0])
    lies = pin.exp3(np.array([0.0, np.pi / 2, 0.0])) if isinstance(bar, coal.Capsule) else np.eye(3)
    places = (
        pin.SE3(pin.exp3(np.array([roll, 0.0, 0.0])) @ lies, middle),
        pin.SE3(pin.exp3(np.array([0.0, turn, 0.0])), np.zeros(3)),
    )
    for joint, name, shape, place in zip(joints, ("bar", "cart"), (bar, cart), places, strict=True):
        model.addJointFrame(joint)
        inertia = pin.Inertia.FromBox(1.0, *((1.0, 0.1, 0.02) if name == "bar" else (0.1, 0.1, 0.1)))
        model.appendBodyToJoint(joint, inertia, pin.SE3(np.eye(3), place.translation))
        shapes.addGeometryObject(pin.GeometryObject(f"{name}_0", joint, place, shape))
    unbounded(model)
    tip, base = ("cart_0", "bar_0") if swapped else ("bar_0", "cart_0")
    contact = Contact(geometry=tip, plane=Shape(base), friction=0.2)
    robot, data = pin.RobotWrapper(model, shapes, shapes), model.createData()

    def gap(angle, place):
        return contact.gap(robot, data, np.array([angle, place]))

    angle, e = brentq(gap, 0.1, 0.4, args=(at,), xtol=1e-15), 1e-4
    by_angle, by_place = (
        (8 * (gap(angle + e * x, at + e * y) - gap(angle - e * x, at - e * y)) - far) / (12 * e)
        for x, y in ((1, 0), (0, 1))
        for far in [gap(angle + 2 * e * x, at + 2 * e * y) - gap(angle - 2 * e * x, at - 2 * e * y)]
    )
    slope = by_place / by_angle
    return Scene(robot, contact), np.array([angle, at]), np.array([-1.5 * slope, 1.5])


def end_of(trajectory):
    return np.concatenate([trajectory.q[-1], trajectory.v[-1]])


@pytest.mark.parametrize(("what", "swapped"), KNOWN)
def test_sliding_shapes_agree_with_event_driven_scheme(what, swapped):
    """Second order requires the motion of contact point and normal in the rates of the rows."""
    scene, q, v = bar_on_cart(what, swapped)
    reference = end_of(simulate(scene, q, v, 0.1, scheme="event-driven", rtol=1e-11, atol=1e-12))
    errors = [
        np.abs(end_of(simulate(scene, q, v, 0.1, scheme="time-stepping", dt=dt)) - reference).max()
        for dt in (2e-3, 1e-3)
    ]
    assert errors[1] < 3e-6
    assert 3.5 < errors[0] / errors[1] < 4.5


@pytest.mark.parametrize("what", [what for what, swapped in KNOWN if not swapped])
def test_order_of_shapes_does_not_matter(what):
    ends = [
        end_of(simulate(*bar_on_cart(what, swapped), 0.1, scheme="time-stepping", dt=1e-3))
        for swapped in (False, True)
    ]
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-7)


@pytest.mark.parametrize(("what", "swapped"), KNOWN)
def test_derivatives_agree_with_differences_of_steps(what, swapped):
    """The initial states are varied so that the shapes stay in contact."""
    e, options = 1e-4, {"scheme": "time-stepping", "dt": 2e-3}
    runs = [bar_on_cart(what, swapped, 0.4 + e * k) for k in (-2, -1, 0, 1, 2)]
    scene, q, v = runs[2]
    found = simulate(scene, q, v, 0.03, sensitivities="state", **options).sensitivity(0.03).state
    starts = np.array([np.concatenate(one[1:]) for one in runs])
    ends = np.array([end_of(simulate(*one, 0.03, **options)) for one in runs])
    towards, expected = (np.array([1, -8, 0, 8, -1]) @ one / (12 * e) for one in (starts, ends))
    np.testing.assert_allclose(found @ towards, expected, rtol=0, atol=3e-6 * np.abs(expected).max())


@pytest.mark.parametrize("ball_first", [True, False])
def test_ball_on_edge_has_derivative_in_one_order_only(ball_first):
    """The motion of an edge of the first shape over a ball of the second is not supported."""
    scene, q, v = bar_on_cart("edge on ball", ball_first)
    if not ball_first:
        with pytest.raises(InputError, match="on an edge"):
            simulate(scene, q, v, 0.01, scheme="time-stepping", sensitivities="state").sensitivity(0.01)
        return
    found = simulate(scene, q, v, 0.01, scheme="time-stepping", sensitivities="state").sensitivity(0.01)
    assert np.isfinite(found.state).all()
