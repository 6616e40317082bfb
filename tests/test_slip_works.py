"""Works of slip, and slip that leaves an unstable direction: series against closed forms in 30 digits."""

import numpy as np
import pytest
from mpmath import mpf

import pinimpact
from pinimpact import Flag, ImpactProblem

from .reference.reference import solve_reference


def along_axis(k, mu=0.4):
    """W whose first axis is an invariant direction: of exponent k/(1 − k) (4.2), unstable for k > 1."""
    a, d = 1.1, 0.7
    b = mu * (a - k * d)
    return np.array([[a, 0.0, b], [0.0, d, 0.0], [b, 0.0, b * b / a + 0.3]]), mu


def compare(W, v, mu, e, law, digits=25):
    """Errors of v⁺ and P, and of the works over the sum of their sizes; and the two answers."""
    exact = solve_reference(W, v, mu, e, law, digits)
    answer = pinimpact.solve_impact(ImpactProblem(W, v, mu, e, law=law))

    def off(found, wanted):
        return float(sum(abs(mpf(x) - y) for x, y in zip(found, wanted, strict=True)))

    works = (exact.compression_work, exact.restitution_work, exact.friction_work)
    found = (answer.work.compression, answer.work.restitution, answer.work.friction)
    return (
        off(answer.velocity.tolist(), exact.velocity) / np.linalg.norm(v),
        off(answer.impulse.tolist(), exact.impulse) / float(sum(map(abs, exact.impulse))),
        off(found, works) / float(sum(map(abs, works))),
        answer,
        exact,
    )


# exponents −1/2, next to it, −1/3, 0, next to it, 1/4, 1/2, 1, 9; then −5/2 and −5/4 of unstable ones
@pytest.mark.parametrize("k", [-1.0, -1.0 - 1e-9, -0.5, 0.0, 1e-10, 0.2, 1 / 3, 0.5, 0.9, 5 / 3, 5.0])
def test_works_around_an_invariant_direction(k):
    W, mu = along_axis(k)
    *errors, answer, _ = compare(W, (2.0 * np.cos(0.3), 2.0 * np.sin(0.3), -0.8), mu, 0.7, "energetic")
    assert max(errors) < 1e-14
    assert Flag.SLIP_TURNED in answer.flags


def test_slip_that_dies_nearly_straight():
    """Its works are no short series: it falls by more than e⁻² in one step."""
    W = np.diag([1.0, 1.0, 0.8])
    W[0, 2] = W[2, 0] = 1e-3
    W[1, 2] = W[2, 1] = 2e-4
    *errors, _, _ = compare(W, (0.6, 0.5, -1.0), 0.9, 0.5, "energetic")
    assert max(errors) < 1e-14


@pytest.mark.parametrize(("k", "angle"), [(1.2, 1e-3), (2.0, 1e-9), (5.0, 1e-15)])
def test_a_way_out_of_an_unstable_direction(k, angle):
    W, mu = along_axis(k)
    *errors, _, _ = compare(W, (2.0, 2.0 * angle, -1.5), mu, 0.7, "energetic", digits=40)
    assert max(errors) < 1e-14


@pytest.mark.parametrize("k", [1.5, 2.0, 5.0])
def test_a_way_out_of_an_unstable_direction_is_short(k):
    """One series from any angle on, where those before it each turned slip by a quarter of its angle."""
    W, mu = along_axis(k)
    v = [(2.0, 2.0 * 10.0**-exponent, -1.5) for exponent in range(2, 301)]
    assert pinimpact.solve_impacts(W, v, mu, 0.7, "energetic").iterations.max() <= 12


def test_a_jam_right_beside_an_unstable_direction_is_seen():
    """v₃ rises along the direction and falls from an angle of 2·10⁻¹¹ on, until slip has turned by 0.17."""
    W = np.array([[2.0, 0.1, 1.2], [0.1, 0.5, 0.1], [1.2, 0.1, 1.2 + 2e-12]])
    *errors, answer, exact = compare(W, (2.0, 1e-11, -0.4), 1.0, 0.7, "energetic", digits=40)
    assert max(errors) < 1e-13
    assert "JAM" in exact.flags
    assert Flag.JAM in answer.flags
