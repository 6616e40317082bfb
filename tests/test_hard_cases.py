"""Cases of docs/hard-cases.md in contact space, by their numbers there, against multiple precision."""

import math

import numpy as np
import pytest

import pinimpact
from pinimpact import Flag, ImpactProblem, Status, solve_impact, solve_impacts

from . import random_impacts
from .drawing import one_of_each
from .reference.generate import sensitivity
from .reference.problems import Problem
from .reference.reference import solve_reference
from .sweeps import JAMS, SWEEPS, SYMMETRIC, THRESHOLD, W

LAWS = pinimpact.LAWS
MOST_ITERATIONS = 250


def solve(delassus, velocity, friction, restitution=0.5, law="poisson"):
    solution = solve_impact(ImpactProblem(delassus, velocity, friction, restitution, law))
    assert solution.iterations <= MOST_ITERATIONS
    return solution


def compare(delassus, velocity, friction, restitution=0.5, law="poisson"):
    """Return the solution after comparing with the reference within eight rounding errors of the input."""
    solution = solve(delassus, velocity, friction, restitution, law)
    delassus, velocity = np.asarray(delassus, dtype=float), np.asarray(velocity, dtype=float)
    problem = Problem(delassus, velocity, float(friction), restitution, law, "slow approach")
    answer = solve_reference(delassus, velocity, friction, restitution, law, digits=25)
    assert solution.status.name == answer.status
    exact_v, exact_P = (np.array(x, dtype=float) for x in (answer.velocity, answer.impulse))
    size = np.abs(exact_P).max()
    speed = np.abs(velocity).max() + np.abs(delassus).max() * size
    errors = np.abs(solution.velocity - exact_v).max(), np.abs(solution.impulse - exact_P).max()
    if errors[0] > 4e-16 * speed or errors[1] > 4e-16 * size:
        change = sensitivity(problem, answer, np.random.default_rng(0))
        assert errors[0] <= 8 * change[0] + 2e-15 * speed
        assert errors[1] <= 8 * change[1] + 2e-15 * size
    return solution


# ---- 1: friction at the stick threshold ----


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("decade", [2, 5, 8, 11, 14])
@pytest.mark.parametrize("slip", [0.0, 0.25])
def test_1_friction_near_the_threshold(decade, side, slip):
    solution = compare(W, [*(-slip * W[:2, 2]), -1.0], THRESHOLD * (1 + side * 10.0**-decade))
    if slip == 0.0:
        assert (Flag.STICK in solution.flags) == (side > 0)
        assert (Flag.SLIP_RESUMED in solution.flags) == (side < 0)
        assert (Flag.NEAR_STICK_THRESHOLD in solution.flags) == (decade > 6)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("velocity", [[0.0, 0.0, -1.0], [-0.09375, -0.125, -1.0]])
def test_1_friction_exactly_at_the_threshold(velocity, law):
    """b = (3, 4)/8 over A = 1: ‖A⁻¹b‖ = 5/8 = μ in doubles, so the contact sticks."""
    solution = compare([[1, 0, 0.375], [0, 1, 0.5], [0.375, 0.5, 2]], velocity, 0.625, 0.5, law)
    if velocity[0] == 0.0:
        assert Flag.STICK | Flag.NEAR_STICK_THRESHOLD in solution.flags


# ---- 2: slip along an invariant direction ----


@pytest.mark.parametrize("along", [0.75, -0.75, 3.0, -3.0])
@pytest.mark.parametrize("deviation", [0.0, 1e-300, 1e-20, 1e-12, -1e-12, 1e-4])
def test_2_slip_along_an_invariant_direction(along, deviation):
    """Slip approaches the stable direction, and departs from the unstable one depending on its deviation."""
    solution = compare(SYMMETRIC, [along, deviation, -1.0], 0.4)
    if deviation == 0.0:
        assert solution.velocity[1] == solution.impulse[1] == 0.0
        assert Flag.SLIP_TURNED not in solution.flags


@pytest.mark.parametrize("deviation", [0.0, 1e-12])
def test_2_in_rotated_axes(deviation):
    """Rotated axes have rounding errors, which do not matter for a stable direction."""
    T = random_impacts.turned(np.array([0.7]))[0]
    delassus, velocity = T @ SYMMETRIC @ T.T, T @ [-3.0, deviation, -1.0]
    solution = solve((delassus + delassus.T) / 2, velocity, 0.4)
    straight = solve(SYMMETRIC, [-3.0, deviation, -1.0], 0.4)
    assert T.T @ solution.velocity == pytest.approx(straight.velocity, abs=1e-14)


# ---- 3: vanishing slip ----


@pytest.mark.parametrize("exponent", [2, 6, 12, 20, 40, 100, 200, 300])
@pytest.mark.parametrize("friction", [0.2, 2.0])
def test_3_small_sliding_speed(exponent, friction):
    compare(W, [0.6 * 10.0**-exponent, 0.8 * 10.0**-exponent, -1.0], friction)


@pytest.mark.parametrize("friction", [0.0, 0.2, 2.0])
def test_3_no_sliding_at_all(friction):
    compare(W, [0.0, 0.0, -1.0], friction)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("slip", [0.5, 0.75])
def test_3_slip_that_stops_exactly_at_an_event(slip, law):
    """A = I, μ = 1/2: slip stops with the compression (1/2), or under Poisson's law with the impact (3/4)."""
    solution = compare(np.eye(3), [slip, 0.0, -1.0], 0.5, 0.5, law)
    assert solution.velocity.tolist() == [0.0, 0.0, 0.5]


# ---- 4: reversal and resumption of slip near the stick threshold ----


@pytest.mark.parametrize("decade", [1, 4, 7, 10, 13])
def test_4_reversal_in_a_plane(decade):
    """Slip against b stops and resumes in the opposite direction, as μ is slightly too small for sticking."""
    friction = 0.75 * (1 - 10.0**-decade)
    solution = compare(SYMMETRIC, [-0.1, 0.0, -1.0], friction)
    assert solution.velocity[0] > 0
    assert Flag.SLIP_RESUMED in solution.flags
    near = compare(SYMMETRIC, [-0.1, 1e-200, -1.0], friction)
    assert near.velocity == pytest.approx(solution.velocity, abs=1e-15)


@pytest.mark.slow
def test_4_half_integer_exponents():
    """Near the unstable direction slip is proportional to the angle to the power of −1/2 or nearly −1/2."""
    delassus, velocity = np.array([[2.0, 0, -3], [0, 1, 0], [-3, 0, 5]]), np.array([-1.5, 1, -2])
    compare(delassus, velocity, 1.0, 0.75)
    for angle in np.linspace(0.1, 6, 20):
        T = random_impacts.turned(np.array([angle]))[0]
        compare((T @ delassus @ T.T + (T @ delassus @ T.T).T) / 2, T @ velocity, 1.0, 0.75)


# ---- 5: negative normal acceleration (jam) ----


@pytest.mark.slow
@pytest.mark.parametrize(("approach", "law"), one_of_each([0.0, 1e-300, 1e-100, 1e-12, 1e-3], list(LAWS)))
def test_5_jam_at_first_contact(approach, law):
    solution = compare(JAMS, [1.0, 0.5, -approach], 1.5, 0.5, law)
    assert Flag.JAM in solution.flags
    assert (Flag.IMPACT_WITHOUT_COLLISION in solution.flags) == (approach == 0.0)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("approach", [1e-300, 1e-200, 1e-120, 1e-80, 1e-12])
def test_5_slow_approach_without_jam(approach, law):
    """Slip hardly turns in a short impact, so by all laws v₃⁺ = −e v₃ and P₃ = (1 + e)|v₃|/(c − μ bᵀσ)."""
    solution = solve(W, [0.75, 1.0, -approach], 0.25, 0.5, law)
    rate = W[2, 2] - 0.25 * (W[:2, 2] @ [0.6, 0.8])
    assert solution.velocity[2] == pytest.approx(0.5 * approach, rel=1e-10)
    assert solution.impulse[2] == pytest.approx(1.5 * approach / rate, rel=1e-10)


@pytest.mark.parametrize("approach", [0.0, 1e-300, 1e-12])
@pytest.mark.parametrize("shared", [0.0, 0.3, 0.5], ids=["uncoupled", "coupled", "listed twice"])
def test_5_jam_at_two_contacts_with_equal_impulses(shared, approach):
    """By symmetry both move as one contact whose Delassus matrix is the sum of a row's blocks."""
    one = solve(JAMS, [1.0, 0.5, -approach], 1.5, 0.5, "energetic")
    delassus = np.kron([[1.0 - shared, shared], [shared, 1.0 - shared]], JAMS)
    velocity = np.tile([1.0, 0.5, -approach], (2, 1))
    both = solve_impact(
        ImpactProblem(delassus, velocity, friction=1.5, restitution=0.5, law="energetic", stiffness=0.5)
    )
    assert both.velocity == pytest.approx(np.tile(one.velocity, (2, 1)), abs=1e-7)  # the initial approach
    assert np.linalg.norm(one.velocity - velocity[0]) > 0.5


def test_5_touching_without_jam_at_two_contacts_is_no_impact():
    delassus, velocity = np.kron(np.eye(2), JAMS), np.tile([-1.0, 0.5, 0.0], (2, 1))
    both = solve_impact(ImpactProblem(delassus, velocity, friction=1.5, restitution=0.5, law="energetic"))
    assert np.array_equal(both.velocity, velocity)
    assert not both.impulse.any()


def test_5_touching_without_jam_is_no_impact():
    assert solve(JAMS, [-1.0, 0.5, 0.0], 1.5).status == Status.NO_IMPACT


# ---- 6: the second compression and its edge ----


@pytest.mark.parametrize(
    ("approach", "law"), one_of_each([0.4, 0.5, 0.529, 0.52915, 0.5292, 0.53, 0.54, 0.6], list(LAWS))
)
def test_6_second_compression(approach, law):
    solution = compare(JAMS, [0.5, 12, -approach], 1.5, 1.0, law)
    if law == "poisson":
        assert (Flag.SECOND_COMPRESSION in solution.flags) == (approach > 0.52917)
        assert (Flag.NEAR_JUMP in solution.flags) == (0.52 < approach < 0.534)


def test_6_impact_map_jumps_where_the_reference_does():
    for approach in (0.52915, 0.5292):
        flags = solve(JAMS, [0.5, 12, -approach], 1.5, 1.0).flags
        assert Flag.NEAR_JUMP in flags
    low, high = 0.52915, 0.5292
    while high - low > 1e-13:  # so that the reference distinguishes the sides too
        middle = (low + high) / 2
        jumped = solve(JAMS, [0.5, 12, -middle], 1.5, 1.0).impulse[2] > 5
        low, high = (low, middle) if jumped else (middle, high)
    for approach, second in ((low - 1e-11, False), (high + 1e-11, True)):
        answer = solve_reference(JAMS, [0.5, 12, -approach], 1.5, 1.0, "poisson", digits=25)
        assert ("SECOND_COMPRESSION" in answer.flags) == second


def check_near_jump(solution, delassus, velocity, restitution, law):
    """Check what holds on both sides of a jump: the flag, v⁺ = v⁻ + W P, and the restitution law."""
    assert Flag.NEAR_JUMP in solution.flags
    balance = velocity + delassus @ solution.impulse
    assert solution.velocity == pytest.approx(balance, abs=1e-11 * np.abs(delassus @ solution.impulse).max())
    work, pc = solution.work, solution.compression_impulse
    met = {
        "poisson": (solution.impulse[2], (1 + restitution) * pc),
        "energetic": (work.restitution, -(restitution**2) * work.compression),
        "newton": (solution.velocity[2], -restitution * velocity[2]),
    }
    assert met[law][0] == pytest.approx(met[law][1], rel=1e-11)


@pytest.mark.parametrize("law", LAWS)
def test_6_both_sides_of_a_jump(law):
    """The jump is bracketed in the approach speed until its sides are adjacent doubles."""
    W, velocities, mu = random_impacts.second_compression(np.random.default_rng(3), 30)
    faster = np.linspace(0.1, 2.0, 150)
    jumps = 0
    for delassus, v, friction in zip(W, velocities, mu, strict=True):
        lines = v * np.array([[1.0, 1.0, x] for x in faster])
        impulse = solve_impacts(np.tile(delassus, (150, 1, 1)), lines, friction, 0.8, law).impulse[:, 2]
        k = int(np.argmax(np.abs(np.diff(impulse)) / (impulse[1:] + impulse[:-1])))
        low, high = lines[k, 2], lines[k + 1, 2]

        def at(v3, W=delassus, v=v, mu=friction):
            return solve(W, np.array([v[0], v[1], v3]), mu, 0.8, law)

        below, above = at(low), at(high)
        while low > (middle := (low + high) / 2) > high:
            here = at(middle)
            if abs(here.impulse[2] - below.impulse[2]) > abs(here.impulse[2] - above.impulse[2]):
                high, above = middle, here
            else:
                low, below = middle, here
        if abs(above.impulse[2] - below.impulse[2]) > 0.01 * above.impulse[2]:
            jumps += 1
            for v3, solution in ((low, below), (high, above)):
                check_near_jump(solution, delassus, np.array([v[0], v[1], v3]), 0.8, law)
    assert jumps > 5


NEAR_JUMPS = [  # v₃ vanishes, to rounding, as the restitution law is satisfied
    (
        "poisson",
        *([-1.8556255341920525, -0.4958853697676567, -0.004492934700920266], 1.9962170188494073),
        *(9.683806924217667, 0.0020946061566318175),
        (0.0015397632263608064, 0.005071699963100801, -0.004387454101028964, 0.32478753489093587),
        (0.02263982250335419, 0.022053489076454786),
    ),
    (
        "energetic",
        *([-0.2657185734870309, 12.007472408450665, -0.5291769401676418], 0.9184699985387019),
        *(1.5, 0.7697165601765514),
        (1.227614121490518, -0.4324505595207712, 0.9979674843304296, 7.972385878509482),
        (0.06372519297102047, 1.0),
    ),
    (
        "energetic",
        *([-1.844049998728917, 0.6893444539867436, -0.2652019343552274], 0.7992290224284958),
        *(5.4570415752958965, 0.15247818780961686),
        (0.09836109455844762, -0.025949393967519607, 0.01127262420734979, 0.008241370289324668),
        (-0.0026201272942709126, 0.002226197710039291),
    ),
    (
        "newton",
        *([11.9958133751167, -0.5919978626407755, -0.5293627393199531], 0.6282056502504902),
        *(1.5, 0.9667681620229845),
        (7.9996002019597965, -0.052138918620438915, -0.007667713442848905, 1.2003997980402032),
        (-0.9999706026531772, 1.0),
    ),
]


@pytest.mark.parametrize(("law", "v", "faster", "mu", "e", "rows", "last"), NEAR_JUMPS)
def test_6_adjacent_doubles_across_a_jump(law, v, faster, mu, e, rows, last):
    (w11, w12, w13, w22), (w23, w33) = rows, last
    delassus = np.array([[w11, w12, w13], [w12, w22, w23], [w13, w23, w33]])
    for factor in (faster, np.nextafter(faster, 3)):
        velocity = np.array([v[0], v[1], v[2] * factor])
        check_near_jump(solve(delassus, velocity, mu, e, law), delassus, velocity, e, law)


@pytest.mark.parametrize("law", LAWS)
def test_6_no_third_compression(law):
    p = random_impacts.draw(np.random.default_rng(6), "second compression", 150)
    for k in range(150):
        phases = [s.phase for s in solve(*(x[k] for x in list(p)[:4]), law).segments]
        starts = [a for a, b in zip(phases, ["", *phases], strict=False) if a == "compression" != b]
        assert len(starts) <= 2


# ---- 7: extreme friction and restitution ----


@pytest.mark.parametrize("restitution", [0.0, 1.0])
@pytest.mark.parametrize(("friction", "law"), one_of_each([0.0, 1e-12, 10.0, 1e3, 1e6], list(LAWS)))
def test_7_extreme_friction_and_restitution(friction, restitution, law):
    compare(W, [1.0, -2.0, -1.0], friction, restitution, law)


# ---- 8: W ill-conditioned and singular ----


@pytest.mark.parametrize("condition", [1e3, 1e6, 1e9, 1e11, 1e13])
@pytest.mark.parametrize("seed", range(3))
def test_8_condition(condition, seed):
    rng = np.random.default_rng((8, seed))
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    delassus = (Q * [1.0, rng.choice([1.0, condition**-0.5]), 1 / condition]) @ Q.T
    compare((delassus + delassus.T) / 2, [0.5, -0.75, -1.0], 0.6)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("friction", [0.5, 1.2, 2.0])
def test_8_pendulum_with_rounding_errors_of_either_sign(friction, law):
    """W of the paper's pendulum has rank two; a few ε are added to or subtracted from the zero eigenvalue."""
    delassus = np.array([[1.5, 0, 1.5], [0, 3, 0], [1.5, 0, 1.5]])
    velocity = np.array([-1.0, 1.0, -1.0]) / math.sqrt(2)
    plain = solve(delassus, velocity, friction, 0.8, law)
    for noise in (-8e-16, -2e-16, 2e-16, 8e-16):
        noisy = delassus + noise * np.outer([1, 0, -1], [1, 0, -1])
        solution = solve(noisy, velocity, friction, 0.8, law)
        assert solution.velocity == pytest.approx(plain.velocity, abs=1e-14)
        assert solution.impulse == pytest.approx(plain.impulse, abs=1e-14)
        assert solution.flags == plain.flags
    assert (plain.status == Status.LOCKED) == (friction > 1)


def test_8_eigenvalues_on_either_side_of_the_tolerance():
    """An eigenvalue below −32 ε‖W‖ raises an error, with the eigenvalue and the tolerance in the message."""
    zero = 32 * 2.0**-52
    assert solve(np.diag([1.0, -0.9 * zero, 1.0]), [1.0, 0.0, -1.0], 0.5).status == Status.SEPARATED
    with pytest.raises(pinimpact.InputError, match=r"-7\.81.*7\.1"):
        solve(np.diag([1.0, -1.1 * zero, 1.0]), [1.0, 0.0, -1.0], 0.5)


@pytest.mark.parametrize("law", LAWS)
def test_8_two_equal_eigenvalues_near_the_tolerance_are_both_zero_or_not(law):
    """If only one of them were zero, rounding errors would determine the null vector and the work."""
    rng, count = np.random.default_rng(5), 4000
    Q = np.linalg.qr(rng.standard_normal((count, 3, 3)))[0]
    small = 32 * random_impacts.EPS * rng.uniform(0.98, 1.02, count)
    values = np.stack([np.ones(count), small, small], axis=1)
    delassus = random_impacts.symmetric(Q * values[:, None, :] @ Q.transpose(0, 2, 1))
    given = random_impacts.approach(rng, count), random_impacts.power(rng, count, -1.5, 1), rng.random(count)
    problems = random_impacts.Problems(delassus, *given, np.zeros(count))
    assert not any(rows.any() for rows in random_impacts.mechanics(problems, law).values())


@pytest.mark.parametrize("law", ["energetic", "newton"])
@pytest.mark.parametrize("angle", [0.3, 0.9, 1.4])
def test_8_tilt_is_zero_below_the_uncertainty_of_a_direction(angle, law):
    """With λ₂ = λ₃ = 1 it is 32 ε. A = 1, so slip is straight and stops at P₃ = |v_t|/μ with v₃."""
    mu, slip = 0.3, np.array([-1.0, -0.5])
    for times, counts in ((0.9, False), (1.1, True)):
        tilt = times * 32 * random_impacts.EPS * np.array([math.cos(angle), math.sin(angle)])
        X = np.vstack([np.eye(2), tilt])
        solution = solve_impact(ImpactProblem(X @ X.T, X @ slip, mu, 0.5, law))
        assert Flag.NEAR_JUMP in solution.flags
        assert (solution.status is Status.LOCKED) == counts == (solution.status is not Status.NO_IMPACT)
        if counts:
            assert solution.impulse == pytest.approx([*-slip, np.hypot(*slip) / mu], abs=1e-12)
            assert solution.velocity == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_8_one_joint(law):
    """W has rank one: with sufficient friction the joint locks, else its slip stops and reverses."""
    x = np.array([1.0, 2.0, 2.0])
    for friction in (0.3, 2.0):
        compare(np.outer(x, x), -x, friction, 0.5, law)


def test_8_one_joint_and_moving_surface():
    """Slip turns to a direction of zero force; an approach that remains then cannot be stopped."""
    x = np.array([3.0, 3.0, -4.0])
    with pytest.raises(pinimpact.UnstoppableApproachError, match=r"-0\.908"):
        solve(np.outer(x, x), [-0.71875, -0.21875, -0.40625], 25.8, 0.0)
    compare(np.outer(x, x), [-0.5, 0.5, -0.4], 0.2, 0.5)


def test_8_planar_mechanism():
    """A tangential row of W is zero: the mechanism cannot move along it, but the surface may."""
    plane = np.array([[1.0, 0, 0.5], [0, 0, 0], [0.5, 0, 2.0]])
    for across in (0.0, 1e-12, 0.3):
        solution = compare(plane, [0.4, across, -1.0], 0.6)
        assert solution.velocity[1] == pytest.approx(across, rel=1e-14)


def test_8_planar_mechanism_with_steady_slip():
    """The surface moves across at w. Slip tends to σ·d = β/μα, with u = σ·d |w|/√(1 − (σ·d)²) along d.

    There dv₃/dP₃ = c − β²/α, so v₃ = v₃° + (c − β²/α) P₃ + (β/α)(u − u°) = 0 determines the impulse. The
    angle has then decreased by e⁻⁶⁰⁰ to e⁻⁸⁰⁰, to normal, subnormal or zero numbers.
    """
    alpha, beta, c, mu, w = 1.25, -0.75, 0.7, 0.9, -0.0056
    velocity = np.zeros((800, 3))
    velocity[:, 0], velocity[:, 1], velocity[:, 2] = 0.002, w, -np.linspace(1.8, 2.4, 800)
    solution = solve_impacts([[alpha, 0, beta], [0, 0, 0], [beta, 0, c]], velocity, mu, 0.0)
    part = beta / (mu * alpha)
    along = part * abs(w) / math.sqrt(1.0 - part * part)
    impulse = -(velocity[:, 2] + beta / alpha * (along - velocity[:, 0])) / (c - beta * beta / alpha)
    assert solution.impulse[:, 2] == pytest.approx(impulse, rel=1e-14)
    assert solution.velocity[:, 0] == pytest.approx(np.full(800, along), rel=1e-14)


def test_8_zero_delassus_matrix():
    with pytest.raises(pinimpact.UnstoppableApproachError):
        solve(np.zeros((3, 3)), [0.0, 0.0, -1.0], 0.5)
    assert solve(np.zeros((3, 3)), [1.0, 0.0, 0.0], 0.5).status == Status.NO_IMPACT


# ---- 9: scales ----


@pytest.mark.parametrize("mass", [1e-9, 1e-3, 1e9, 1e150])
@pytest.mark.parametrize("speed", [1e-12, 1e6, 1e-140])
def test_9_masses_and_speeds(mass, speed):
    velocity = np.array([0.5, -0.25, -1.0])
    plain, scaled = solve(W, velocity, 0.4), solve(W / mass, speed * velocity, 0.4)
    assert scaled.velocity / speed == pytest.approx(plain.velocity, rel=1e-14)
    assert scaled.impulse / (mass * speed) == pytest.approx(plain.impulse, rel=1e-14)


def test_9_overflow_raises():
    with pytest.raises(pinimpact.InputError, match="double precision"):
        solve(W * 1e-200, [1e150, 0.0, -1e150], 0.4)


# ---- 11: laws that create energy, laws that cannot be satisfied ----


def test_11_newtons_law_creates_energy_with_a_flag():
    rod = [[4, 0, 0], [0, 1.6, -1.2], [0, -1.2, 3.4]]
    created = compare(rod, [0.0, 0.4, -1.0], 0.7, 1.0, "newton")
    assert created.work.total > 0
    assert Flag.ENERGY_CREATED in created.flags
    for law in ("poisson", "energetic"):
        assert Flag.ENERGY_CREATED not in compare(rod, [0.0, 0.4, -1.0], 0.7, 1.0, law).flags


@pytest.mark.parametrize("below", [1e-2, 1e-4, 1e-6])
def test_11_newtons_law_with_slow_slip_needs_large_impulses(below):
    """Just below the friction threshold slip is slow, but v₃ has to be reversed at e = 1."""
    factor = np.array([[2.0, 1.0], [1.0, 3.0], [-1.0, 2.0]])
    threshold = np.sqrt(2.0)
    solution = compare(factor @ factor.T, factor @ [0.5, -1.0], threshold * (1 - below), 1.0, "newton")
    assert solution.impulse[2] > 0.5 / below
    assert Flag.ENERGY_CREATED | Flag.SLIP_RESUMED in solution.flags


def test_11_a_locked_mechanism():
    """By Poisson's law the impulse of restitution is applied; by the others the impact ends at v₃ = 0."""
    locked = np.array([[1.0, 0, 1], [0, 2, 0], [1, 0, 1]])
    P = {law: compare(locked, [-1.0, 0.5, -1.0], 3.0, 0.5, law).impulse[2] for law in LAWS}
    assert P["newton"] == P["energetic"] < P["poisson"]


# ---- families of problems: no jumps other than those of the model ----


@pytest.mark.parametrize("name", SWEEPS)
def test_sweeps_have_no_other_jumps(name):
    """Bisection towards the steepest changes reduces them to zero, except at jumps."""
    sweep = SWEEPS[name]
    jumps = 0
    for low, high in sweep.steepest(400, 3):
        low, high, change = sweep.close_in(low, high)
        if change > 1e-5:
            jumps += 1
            assert Flag.NEAR_JUMP in solve_impact(sweep.problem(low)).flags
            assert Flag.NEAR_JUMP in solve_impact(sweep.problem(high)).flags
    assert jumps == sweep.jumps


# ---- a short run of random problems ----


@pytest.mark.slow
def test_fuzz():
    report = random_impacts.run(seed=2, count=9000)
    assert [(what, category, law) for what, category, law, _ in report.violations] == []
    assert max(t.iterations for t in report.tallies.values()) <= MOST_ITERATIONS
    seen = {name for t in report.tallies.values() for name, number in t.flags.items() if number}
    assert seen == {flag.name for flag in Flag if flag} - {"BOUND_REACHED"}  # set at several contacts only


def test_fuzz_detects_wrong_impulses(monkeypatch):
    """A relative error of 1e-8 in one component of impulses is detected."""

    def wrong(*arguments):
        batch = solve_impacts(*arguments)
        batch.impulse[:, 0] *= 1 + 1e-8
        return batch

    monkeypatch.setattr(random_impacts, "solve_impacts", wrong)
    report = random_impacts.Report()
    random_impacts.check(np.random.default_rng(0), "isotropic", "poisson", 10, report)
    assert {"momentum", "ledger"} <= {what for what, *_ in report.violations}
