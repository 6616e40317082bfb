"""Motions that friction holds, against closed forms: rest, the onset of slip, reversal, and rest again."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Plane, Scene, simulate

from .scene_models import G, slider, unbounded
from .stick_slip import Swing, stick_slip


def rough_joint(friction):
    model = pin.Model()
    index = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    unbounded(model)
    model.friction = np.array([friction])
    return model


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize(
    ("a", "b", "t_c"), [(0.1, 1.0, 10.0), (0.1, 1.0, 5.0), (0.02, 0.3, 8.0), (1.0, 2.0, 4.0)]
)
def test_dry_friction_holds_between_two_crossings_and_lets_go_gently(a, b, t_c, rtol):
    k = 2.0 * a / b**2
    scene = Scene(rough_joint(0.5), control=lambda t, q, v: np.array([-k * (t - t_c) - 0.5]))
    start = [a - a * t_c**2 / b**2]
    trajectory = simulate(scene, [0.0], start, t_c + 10.0, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.v[-1, 0] == pytest.approx(-0.5 * k * 100.0, rel=1e2 * rtol)
    (stuck,) = [interval for interval in trajectory.modes if interval.mode == "stuck"]
    assert stuck.start == pytest.approx(t_c - b, abs=1e3 * rtol)
    assert stuck.end == pytest.approx(t_c, abs=1e-8)


@pytest.mark.parametrize("seed", range(30))
def test_a_joint_with_dry_friction_under_a_swinging_force(seed):
    rng = np.random.default_rng(seed)
    load = Swing(
        rng.uniform(0.1, 2.0), 10 ** rng.uniform(-0.5, 1.3), rng.uniform(0, 6.28), rng.uniform(-0.45, 0.45)
    )
    x, v, _ = stick_slip(load, 0.5, 20.0)
    scene = Scene(rough_joint(0.5), control=lambda t, q, v: np.array([load.force(t)]))
    trajectory = simulate(scene, [0.0], [0.0], 20.0, rtol=1e-8, atol=1e-10)
    assert trajectory.q[-1, 0] == pytest.approx(x, abs=1e-5)
    assert trajectory.v[-1, 0] == pytest.approx(v, abs=1e-5)
    assert np.diff(trajectory.energy.joints).max() <= 1e-12


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-12])
def test_a_point_that_a_swinging_force_moves_again_and_again(rtol):
    load = Swing(0.3, 10.0, 0.0, 0.25)
    x, _, slips = stick_slip(load, 0.5, 20.0)
    assert slips == 32
    scene = Scene(
        slider(),
        [Contact("point", Plane(), friction=0.5 / G)],
        control=lambda t, q, v: np.array([load.force(t), 0.0, 0.0]),
    )
    trajectory = simulate(scene, np.zeros(3), np.zeros(3), 20.0, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.q[-1, 0] == pytest.approx(x, rel=1e3 * rtol)
    assert sum(interval.mode == "slip" for interval in trajectory.modes) == 32
