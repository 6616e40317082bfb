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


# exponents −7, −6.3, −6, −4.2, −2, −5/4
@pytest.mark.parametrize(
    ("k", "angle"),
    [(7 / 6, 1e-4), (63 / 53, 1e-2), (1.2, 1e-3), (21 / 16, 1e-3), (2.0, 1e-9), (5.0, 1e-15)],
)
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


@pytest.mark.parametrize("law", ["poisson", "energetic"])
def test_works_where_the_square_is_one_term(law):
    """U = G²π is constant around this invariant direction, E G is not."""
    W = np.array([[5.0, -2.0, -3.0], [-2.0, 5.0, -3.0], [-3.0, -3.0, 6.0]])
    *errors, _, _ = compare(W, (1.0, -0.5, -1.0), 0.5, 1.0, law)
    assert max(errors) < 1e-14


@pytest.mark.parametrize("law", ["poisson", "energetic", "newton"])
def test_slip_that_nearly_stops_and_grows_for_long(law):
    """From 1e-12 of its speed on it grows along an invariant direction, by e²⁵."""
    W = np.array([[2.22671806, 0.62533745, 0.49161481], [0.62533745, 0.65433648, -0.489925], [0, 0, 0]])
    W[2] = 0.49161481, -0.489925, 1.46109873
    *errors, _, exact = compare(W, (-0.58910619, 0.04872736, -1.1814261), 0.60673176, 0.9, law, digits=40)
    assert max(errors) < 1e-11
    assert not exact.flags


@pytest.mark.parametrize("law", ["poisson", "energetic", "newton"])
def test_creep_where_friction_is_exactly_critical(law):
    """Slip settles to a speed of 1e-24, so that the impulse is linear in L, and L grows to 1e23."""
    W = np.array([[0.25, 0.0, 0.078125], [0.0, 1.0, 0.75], [0.078125, 0.75, 1.5869140625]])
    v = (1.693409114936625e-24, 2.571876674319261e-24, -0.573393427157283)
    *errors, _, _ = compare(W, v, 0.8125, 1.0, law)
    assert max(errors) < 1e-14


def test_events_are_found_to_rounding():
    """Where slip settles and P₃ grows late, trials converge as fast as elsewhere."""
    W = np.array([[6.0, -4.0, -2.0], [-4.0, 6.0, 6.0], [-2.0, 6.0, 9.0]])
    *errors, _, _ = compare(W, (1.0, -0.5, -1.0), 1.25, 0.25, "poisson")
    assert max(errors[:2]) < 3e-15


def test_growth_that_takes_its_time():
    """Along an invariant direction of exponent −1e-9 nothing happens at first; the law is met at L = 1e10."""
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
def test_no_series_goes_beyond_an_invariant_direction(W, v, e):
    """The exponent is 1: S has no singularity there, and on the other side slip would be negative."""
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
"""Upper triangles of W; v, μ and e."""


@pytest.mark.parametrize("numbers", np.array(AT_THE_PEAK.split(), dtype=float).reshape(-1, 11))
def test_restitution_that_begins_to_jam_where_a_series_begins(numbers):
    """v₃ is at its peak there, dv₃/dP₃ a rounding of zero of either sign; and v₃ falls to zero."""
    W = np.zeros((3, 3))
    W[np.triu_indices(3)] = numbers[:6]
    W += np.triu(W, 1).T
    *errors, answer, exact = compare(W, tuple(numbers[6:9]), *numbers[9:], "poisson")
    assert max(errors) < 1e-13
    assert "SECOND_COMPRESSION" in exact.flags
    assert Flag.SECOND_COMPRESSION in answer.flags
