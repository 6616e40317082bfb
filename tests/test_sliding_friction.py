"""Separate friction coefficients for sustained contact and for impacts, against closed forms."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import Contact, Flag, InputError, Plane, Scene, simulate

from .scene_models import G, free_body, run, slider

ANGLE = 0.4
DOWN = np.array([np.cos(ANGLE), 0.0, -np.sin(ANGLE)])
NORMAL = np.array([np.sin(ANGLE), 0.0, np.cos(ANGLE)])


def point(plane=None, **options):
    return Scene(slider(), [Contact("point", plane or Plane(), name="block", **options)])


@pytest.mark.parametrize("impacts", [0.0, 0.2, 2.0])
def test_block_slides_down_slope_with_its_sliding_friction(impacts):
    mu = 0.3
    scene = point(Plane(normal=tuple(NORMAL)), friction=impacts, sliding_friction=mu)
    trajectory = run(scene, np.zeros(3), 0.1 * DOWN, 1.0)
    acceleration = G * (np.sin(ANGLE) - mu * np.cos(ANGLE))
    assert trajectory.q[-1] == pytest.approx((0.1 + 0.5 * acceleration) * DOWN, abs=1e-9)
    assert trajectory.energy.friction[-1] == pytest.approx(
        -mu * G * np.cos(ANGLE) * (0.1 + 0.5 * acceleration), rel=1e-9
    )


def test_block_sticks_on_slope_depending_on_its_sliding_friction():
    held = point(Plane(normal=tuple(NORMAL)), friction=0.0, sliding_friction=np.tan(ANGLE) + 0.01)
    released = point(Plane(normal=tuple(NORMAL)), friction=5.0, sliding_friction=np.tan(ANGLE) - 0.01)
    assert run(held, np.zeros(3), np.zeros(3), 1.0).q[-1] == pytest.approx(np.zeros(3), abs=1e-12)
    acceleration = 0.01 * G * np.cos(ANGLE)
    assert run(released, np.zeros(3), np.zeros(3), 1.0).q[-1] == pytest.approx(
        0.5 * acceleration * DOWN, abs=1e-9
    )


@pytest.mark.parametrize(("mu", "sliding"), [(0.1, 0.4), (0.4, 0.1), (0.3, 0.0), (0.0, 0.3)])
def test_coefficients_of_impact_and_of_slip_after_it(mu, sliding):
    height, speed = 0.2, 3.0
    scene = point(friction=mu, sliding_friction=sliding)
    trajectory = run(scene, [0, 0, height], [speed, 0, 0], 0.4)
    fall = np.sqrt(2 * height / G)
    (impact,) = trajectory.impacts
    after = speed - mu * G * fall
    assert impact.v_after == pytest.approx([after, 0, 0], abs=1e-9)
    assert impact.problem.friction == mu
    left = 0.4 - fall
    assert trajectory.q[-1, 0] == pytest.approx(
        speed * fall + after * left - 0.5 * sliding * G * left**2, abs=1e-8
    )


def test_impact_without_collision_has_the_coefficient_of_slip():
    # Painlevé's rod: c − μ b is negative with the coefficient of sliding only
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([1e-3, 1 / 12, 1 / 12]))
    rotation = pin.utils.rotate("y", -np.radians(60.0))
    q0 = [*(rotation @ [0.5, 0, 0]), *pin.Quaternion(rotation).coeffs()]
    v0 = np.concatenate([rotation.T @ [-1.0, 0, 0], np.zeros(3)])
    found = []
    for options in ({"friction": 2.5}, {"friction": 0.1, "sliding_friction": 2.5}):
        contact = Contact("tip0", Plane(), **options)
        trajectory = run(Scene(free_body(inertia, [(-0.5, 0, 0)]), [contact]), q0, v0, 1e-3)
        found.append(trajectory.impacts[0])
        assert Flag.IMPACT_WITHOUT_COLLISION in found[-1].solution.flags
    assert found[1].problem.friction == 2.5
    assert found[1].v_after == pytest.approx(found[0].v_after, rel=1e-12)


def test_default_is_the_friction_of_impacts():
    contact = Contact("point", Plane(), friction=0.3)
    assert contact.sliding_friction is None
    assert contact.sustained_friction == 0.3
    assert Contact("point", Plane(), friction=0.3, sliding_friction=0.0).sustained_friction == 0.0


def test_scene_without_contact_friction_has_no_sliding_friction():
    contact = Contact("point", Plane(), sliding_friction=0.5)
    assert Scene(slider(), [contact]).plan()["contact friction"].on
    scene = Scene(slider(), [contact], without=["contact friction"])
    assert simulate(scene, np.zeros(3), [1.0, 0, 0], 1.0).q[-1, 0] == pytest.approx(1.0)


@pytest.mark.parametrize("wrong", [-0.1, np.nan, np.inf, "rough"])
def test_invalid_sliding_friction_raises(wrong):
    with pytest.raises(InputError, match="sliding_friction: "):
        Contact("point", Plane(), sliding_friction=wrong)
