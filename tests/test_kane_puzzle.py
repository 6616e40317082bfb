"""Kane's puzzle: a double pendulum whose kinetic energy increases by Newton's law of restitution."""

import numpy as np
import pytest

import pinimpact

DEGREES = np.array([20.0, 30.0])
RATES = np.array([-0.1, -0.2])


def strike(law, friction):
    robot = pinimpact.load_robot("kane_double_pendulum")
    angles = np.deg2rad(DEGREES)
    floor = pinimpact.Plane(point=(0, 0, -np.cos(angles).sum()))
    contact = pinimpact.Contact("tip", floor, friction=friction, restitution=0.5, law=law)
    q, v = np.array([angles[0], angles[1] - angles[0]]), np.array([RATES[0], RATES[1] - RATES[0]])
    assert contact.gap(robot.model, robot.data, q) == pytest.approx(0, abs=1e-15)
    return v, pinimpact.impact(robot.model, robot.data, q, v, contact)


def energy(v):
    """Return the kinetic energy of two unit rods with the given joint velocities."""
    (a, b), (u, w) = np.deg2rad(DEGREES), np.cumsum(v)
    return 0.5 * (4 / 3 * u * u + u * w * np.cos(a - b) + 1 / 3 * w * w)


@pytest.mark.parametrize(
    ("law", "friction", "ratio"),
    [
        ("newton", 0.7, 1.5875),
        ("poisson", 0.7, 0.5169),
        ("energetic", 0.7, 0.5258),
        ("newton", 0.5, 0.7372),
        ("poisson", 0.5, 0.5451),
        ("energetic", 0.5, 0.5532),
    ],
)
def test_energy_after_over_energy_before(law, friction, ratio):
    v, hit = strike(law, friction)
    assert energy(hit.v) / energy(v) == pytest.approx(ratio, abs=5e-5)
    assert (pinimpact.Flag.ENERGY_CREATED in hit.solution.flags) is (ratio > 1)
    assert hit.solution.work.total == pytest.approx(energy(hit.v) - energy(v), abs=1e-15)


def test_newtons_law_is_satisfied():
    v, hit = strike("newton", 0.7)
    before = -np.sin(np.deg2rad(DEGREES)) @ np.cumsum(v)  # height of the tip: −Σ cos
    assert hit.solution.velocity[2] == pytest.approx(0.5 * before, rel=1e-12)
