"""Friction of sustained contact apart from that of impacts, against closed forms."""

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
def test_a_block_slides_down_a_slope_by_its_sliding_friction(impacts):
    mu = 0.3
    scene = point(Plane(normal=tuple(NORMAL)), friction=impacts, sliding_friction=mu)
    trajectory = run(scene, np.zeros(3), 0.1 * DOWN, 1.0)
    acceleration = G * (np.sin(ANGLE) - mu * np.cos(ANGLE))
    assert trajectory.q[-1] == pytest.approx((0.1 + 0.5 * acceleration) * DOWN, abs=1e-9)
    assert trajectory.energy.friction[-1] == pytest.approx(
        -mu * G * np.cos(ANGLE) * (0.1 + 0.5 * acceleration), rel=1e-9
    )


def test_a_block_stays_on_a_slope_if_its_sliding_friction_holds_it():
    held = point(Plane(normal=tuple(NORMAL)), friction=0.0, sliding_friction=np.tan(ANGLE) + 0.01)
    let_go = point(Plane(normal=tuple(NORMAL)), friction=5.0, sliding_friction=np.tan(ANGLE) - 0.01)
    assert run(held, np.zeros(3), np.zeros(3), 1.0).q[-1] == pytest.approx(np.zeros(3), abs=1e-12)
    acceleration = 0.01 * G * np.cos(ANGLE)
    assert run(let_go, np.zeros(3), np.zeros(3), 1.0).q[-1] == pytest.approx(
        0.5 * acceleration * DOWN, abs=1e-9
    )


@pytest.mark.parametrize(("mu", "sliding"), [(0.1, 0.4), (0.4, 0.1), (0.3, 0.0), (0.0, 0.3)])
def test_an_impact_has_the_one_coefficient_and_the_slip_after_it_the_other(mu, sliding):
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


def test_an_impact_without_collision_has_the_coefficient_of_the_slip_that_drives_it():
    # Painlevé's rod, pushed ahead of its tip: c − μ b < 0 with the one coefficient, not with the other
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


def test_it_is_the_friction_unless_it_is_given():
    contact = Contact("point", Plane(), friction=0.3)
    assert contact.sliding_friction is None
    assert contact.sustained_friction == 0.3
    assert Contact("point", Plane(), friction=0.3, sliding_friction=0.0).sustained_friction == 0.0


def test_without_friction_there_is_neither():
    contact = Contact("point", Plane(), sliding_friction=0.5)
    assert Scene(slider(), [contact]).plan()["contact friction"].on
    scene = Scene(slider(), [contact], without=["contact friction"])
    assert simulate(scene, np.zeros(3), [1.0, 0, 0], 1.0).q[-1, 0] == pytest.approx(1.0)


@pytest.mark.parametrize("wrong", [-0.1, np.nan, np.inf, "rough"])
def test_what_is_no_coefficient_is_refused(wrong):
    with pytest.raises(InputError, match="sliding_friction: "):
        Contact("point", Plane(), sliding_friction=wrong)
