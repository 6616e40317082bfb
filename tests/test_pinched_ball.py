"""A light ball between the floor and a heavy ball that moves down, against an exact sequence of impacts."""

import mpmath
import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene, simulate

from .scene_models import unbounded


def exact(restitution, ratio, duration):
    """Return the final velocities of both balls; the initial gaps are 0.1 m."""
    with mpmath.workdps(300):
        e, heavy, left = mpmath.mpf(restitution), mpmath.mpf(ratio), mpmath.mpf(duration)
        gap, between, light, down = mpmath.mpf("0.1"), mpmath.mpf("0.1"), mpmath.mpf(0), mpmath.mpf(-1)
        for _ in range(2000):
            times = [
                -x / rate if rate < 0 else mpmath.inf for x, rate in ((gap, light), (between, down - light))
            ]
            if min(times) > left:
                break
            t, left = min(times), left - min(times)
            gap, between = gap + light * t, between + (down - light) * t
            if times[0] == t:
                light *= -e
            else:
                impulse = (1 + e) * (light - down) / (1 + 1 / heavy)
                light, down = light - impulse, down + impulse / heavy
        return float(light), float(down)


@pytest.mark.filterwarnings("ignore::pinimpact.BoundReachedWarning")
@pytest.mark.parametrize("place", [0.0, 128.0, 1e4])
@pytest.mark.parametrize(("restitution", "ratio"), [(0.5, 100.0), (0.7, 10.0), (0.8, 25.0)])
def test_pinched_ball(restitution, ratio, place):
    """Gaps decrease to rounding errors at high speeds; separating contacts do not affect the next impact."""
    model = pin.Model()
    model.gravity = pin.Motion.Zero()
    for k, mass in enumerate((1.0, ratio)):
        joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), f"ball {k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(mass, 0.1), pin.SE3.Identity())
        model.addFrame(pin.Frame(f"center {k}", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    unbounded(model)
    contacts = [
        Contact("center 0", Plane((0, 0, place)), restitution=restitution),
        Contact("center 1", Plane(body="center 0"), restitution=restitution),
    ]
    q, duration = np.array([place + 0.1, place + 0.2]), 0.7
    scene, v, right = Scene(model, contacts), np.array([0.0, -1.0]), exact(restitution, ratio, duration)
    run = simulate(scene, q, v, duration, scheme="event-driven")
    np.testing.assert_allclose(run.v[-1], right, rtol=0, atol=1e-9)
    run = simulate(scene, q, v, duration, scheme="time-stepping", dt=1e-3)  # within about the resting speed
    np.testing.assert_allclose(run.v[-1], right, rtol=0, atol=1e-3)
