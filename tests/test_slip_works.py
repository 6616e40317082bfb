"""Work of slip, and slip that departs from an unstable direction, against references in 25 to 40 digits."""

import numpy as np
import pytest
from mpmath import mpf

import pinimpact
from pinimpact import Flag, ImpactProblem

from .reference.reference import solve_reference


def along_axis(k, mu=0.4):
    """Return W with an invariant direction of exponent k/(1 − k) (4.2), unstable for k > 1, and μ."""
    a, d = 1.1, 0.7
    b = mu * (a - k * d)
    return np.array([[a, 0.0, b], [0.0, d, 0.0], [b, 0.0, b * b / a + 0.3]]), mu


def compare(W, v, mu, e, law, digits=25):
    """Return the errors of v⁺, P and work, relative to |v|, Σ|P| and Σ|work|, and both solutions."""
    exact = solve_reference(W, v, mu, e, law, digits)
    answer = pinimpact.solve_impact(ImpactProblem(W, v, mu, e, law=law))

    def error(computed, wanted):
        return float(sum(abs(mpf(x) - y) for x, y in zip(computed, wanted, strict=True)))

    work = (exact.compression_work, exact.restitution_work, exact.friction_work)
    computed = (answer.work.compression, answer.work.restitution, answer.work.friction)
    return (
        error(answer.velocity.tolist(), exact.velocity) / np.linalg.norm(v),
        error(answer.impulse.tolist(), exact.impulse) / float(sum(map(abs, exact.impulse))),
        error(computed, work) / float(sum(map(abs, work))),
        answer,
        exact,
    )


# exponents −1/2, next to −1/2, −1/3, 0, next to 0, 1/4, 1/2, 1, 9, and the unstable −5/2 and −5/4
@pytest.mark.parametrize("k", [-1.0, -1.0 - 1e-9, -0.5, 0.0, 1e-10, 0.2, 1 / 3, 0.5, 0.9, 5 / 3, 5.0])
def test_work_near_invariant_direction(k):
    W, mu = along_axis(k)
    *errors, answer, _ = compare(W, (2.0 * np.cos(0.3), 2.0 * np.sin(0.3), -0.8), mu, 0.7, "energetic")
    assert max(errors) < 1e-14
    assert Flag.SLIP_TURNED in answer.flags


def test_work_of_nearly_straight_slip_that_stops():
    """Slip decreases by a factor of more than e² in one step, so a series of the work would be long."""
    W = np.diag([1.0, 1.0, 0.8])
    W[0, 2] = W[2, 0] = 1e-3
    W[1, 2] = W[2, 1] = 2e-4
    *errors, _, _ = compare(W, (0.6, 0.5, -1.0), 0.9, 0.5, "energetic")
    assert max(errors) < 1e-14


# exponents −7, −6.3, −6, −4.2, −2, −5/4
@pytest.mark.parametrize(
    ("k", "angle"),
    [(7 / 6, 1e-4), (63 / 53, 1e-2), (1.2, 1e-3), (21 / 16, 1e-3), (2.0, 1e-9), (5.0, 1e-15)],
)
def test_departure_from_unstable_direction(k, angle):
    W, mu = along_axis(k)
    *errors, _, _ = compare(W, (2.0, 2.0 * angle, -1.5), mu, 0.7, "energetic", digits=40)
    assert max(errors) < 1e-14


@pytest.mark.parametrize("k", [1.5, 2.0, 5.0])
def test_departure_from_unstable_direction_takes_few_steps(k):
    """One series covers the departure from any angle; other steps turn slip by a quarter of its angle."""
    W, mu = along_axis(k)
    v = [(2.0, 2.0 * 10.0**-exponent, -1.5) for exponent in range(2, 301)]
    assert pinimpact.solve_impacts(W, v, mu, 0.7, "energetic").iterations.max() <= 12


def test_negative_normal_acceleration_next_to_unstable_direction():
    """v₃ increases along the direction, but decreases while the angle of slip is between 2·10⁻¹¹ and 0.17."""
    W = np.array([[2.0, 0.1, 1.2], [0.1, 0.5, 0.1], [1.2, 0.1, 1.2 + 2e-12]])
    *errors, answer, exact = compare(W, (2.0, 1e-11, -0.4), 1.0, 0.7, "energetic", digits=40)
    assert max(errors) < 1e-13
    assert "JAM" in exact.flags
    assert Flag.JAM in answer.flags


@pytest.mark.parametrize("law", ["poisson", "energetic"])
def test_work_where_U_is_constant(law):
    """Near this invariant direction U = G²π is constant, but E G is not."""
    W = np.array([[5.0, -2.0, -3.0], [-2.0, 5.0, -3.0], [-3.0, -3.0, 6.0]])
    *errors, _, _ = compare(W, (1.0, -0.5, -1.0), 0.5, 1.0, law)
    assert max(errors) < 1e-14


@pytest.mark.parametrize("law", ["poisson", "energetic", "newton"])
def test_slip_that_almost_stops_and_grows_again(law):
    """Slip decreases to 10⁻¹² of its speed and then grows along an invariant direction, by e²⁵."""
    W = np.array([[2.22671806, 0.62533745, 0.49161481], [0.62533745, 0.65433648, -0.489925], [0, 0, 0]])
    W[2] = 0.49161481, -0.489925, 1.46109873
    *errors, _, exact = compare(W, (-0.58910619, 0.04872736, -1.1814261), 0.60673176, 0.9, law, digits=40)
    assert max(errors) < 1e-11
    assert not exact.flags


@pytest.mark.parametrize("law", ["poisson", "energetic", "newton"])
def test_slow_slip_at_critical_friction(law):
    """The speed of slip tends to 10⁻²⁴, so the impulse is linear in L, which grows to 10²³."""
    W = np.array([[0.25, 0.0, 0.078125], [0.0, 1.0, 0.75], [0.078125, 0.75, 1.5869140625]])
    v = (1.693409114936625e-24, 2.571876674319261e-24, -0.573393427157283)
    *errors, _, _ = compare(W, v, 0.8125, 1.0, law)
    assert max(errors) < 1e-14


def test_events_are_located_to_rounding():
    """Slip tends to a constant and P₃ grows late; the root search converges as fast as elsewhere."""
    W = np.array([[6.0, -4.0, -2.0], [-4.0, 6.0, 6.0], [-2.0, 6.0, 9.0]])
    *errors, _, _ = compare(W, (1.0, -0.5, -1.0), 1.25, 0.25, "poisson")
    assert max(errors[:2]) < 3e-15


def test_slow_growth_along_invariant_direction():
    """The exponent is −10⁻⁹, so slip hardly changes at first; the law is satisfied at L = 10¹⁰."""
    W = np.array([[3.09796015116312, 0.31287839997415345, -2.522880500633492], [0, 0, 0], [0, 0, 0]])
    W[1] = W[0, 1], 0.031599145526461175, -0.25479824737781726
    W[2] = W[0, 2], W[1, 2], 2.0545538754309507
    v = 2.190348970761567, 0.2211892561475449, -1.783615913450448
    answer = pinimpact.solve_impact(ImpactProblem(W, v, 0.9999204507916118, 0.1312352554190197, "newton"))
    assert answer.velocity[2] == pytest.approx(-0.1312352554190197 * v[2], rel=1e-14)
    assert answer.velocity == pytest.approx(np.add(v, W @ answer.impulse), abs=1e-6)  # of 5e7


@pytest.mark.parametrize(
    ("W", "v", "e"),
    [
        ([[8.0, -2.0, -4.0], [-2.0, 6.0, 4.0], [-4.0, 4.0, 4.0]], (0.5, 0.0, -1.0), 0.5),
        ([[6.0, 1.0, 2.0], [1.0, 6.0, 6.0], [2.0, 6.0, 8.0]], (0.5, -1.0, -2.0), 1.0),
    ],
)
def test_series_end_at_invariant_direction(W, v, e):
    """The exponent is 1, so S has no singularity at the direction; beyond it slip would be negative."""
    answer = pinimpact.solve_impact(ImpactProblem(W, v, 2.0, e))
    P = answer.impulse
    assert answer.velocity == pytest.approx(np.add(v, np.array(W) @ P), abs=1e-13)
    assert answer.work.total == pytest.approx(0.5 * P @ (answer.velocity + v), abs=1e-13)


AT_THE_PEAK = """
1.1924616605908076 0.6342174031408756 0.5284050232229097 1.3638662558752335
0.11139302613225338 0.2624651768112818 1.2745331843750023 2.2871409803202147
-0.07661988029762966 0.5523044127133673 0.29091868425726297
0.8462185869784062 -0.04389759774858728 -0.1794941932178106 0.29916199980732855
0.2744836194677121 0.293275076877481 0.44598469946433106 0.4668826876491037
-0.03856907536834633 1.367956355754944 0.7934452179231882
0.3170817795350993 -0.10098760653135368 -0.17553006429975546 0.2331015848683462
0.09874069830181705 0.12181715341577441 -1.1184405346364288 -1.649875086744738
-0.275056566442104 1.1030991538307608 0.6838503641035102
"""
"""Upper triangle of W, v, μ and e of three impacts."""


@pytest.mark.parametrize("numbers", np.array(AT_THE_PEAK.split(), dtype=float).reshape(-1, 11))
def test_second_compression_from_series_starting_at_maximum(numbers):
    """A series starts at the maximum of v₃, where dv₃/dP₃ is a rounding error; then v₃ falls to zero."""
    W = np.zeros((3, 3))
    W[np.triu_indices(3)] = numbers[:6]
    W += np.triu(W, 1).T
    *errors, answer, exact = compare(W, tuple(numbers[6:9]), *numbers[9:], "poisson")
    assert max(errors) < 1e-13
    assert "SECOND_COMPRESSION" in exact.flags
    assert Flag.SECOND_COMPRESSION in answer.flags
