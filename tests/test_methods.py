"""Stepping methods: orders of convergence, agreement with the 50-digit table, invariants, options."""

import dataclasses
import itertools
import os
import subprocess
import sys

import numba
import numpy as np
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st

import pinimpact.contact_space.methods as methods_module
from pinimpact import (
    METHODS,
    Flag,
    ImpactProblem,
    InputError,
    Method,
    PinimpactError,
    UnknownNameError,
    register_method,
    solve_impact,
)
from pinimpact.studies.cost import problem_classes, relative_error

from . import random_impacts
from .drawing import examples
from .reference import table as stored

TABLE = stored.load()
CLASSES = problem_classes()
STEPS = [300, 500, 800, 1500, 2300, 5000, 12000]
STEPPING = {"euler": {"steps": 200}, "rk4": {"steps": 50}, "adaptive": {"rtol": 1e-8}}


def _errors(problem, method, settings):
    exact = solve_impact(problem)
    return np.array([relative_error(solve_impact(problem, method, **s), exact, problem) for s in settings])


def _order(problem, method, steps):
    errors = _errors(problem, method, [{"steps": n} for n in steps])
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0]


@pytest.mark.parametrize("name", ["smooth slip", "slip to stick", "resumed slip", "jam"])
def test_euler_is_of_first_order(name):
    # the error depends on where in a step slip ends, so the order is fitted over many numbers of steps
    assert _order(CLASSES[name], "euler", STEPS) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("law", ["poisson", "energetic", "newton"])
def test_rk4_is_of_fourth_order_in_smooth_slip(law):
    problem = dataclasses.replace(CLASSES["smooth slip"], law=law)
    assert _order(problem, "rk4", [4, 8, 16, 32]) == pytest.approx(4.0, abs=0.4)


@pytest.mark.parametrize("name", ["slip to stick", "resumed slip", "near-critical friction"])
def test_rk4_keeps_its_order_where_slip_ends(name):
    # as the direction of slip is not differentiable at v_t = 0, constant steps would be of first order
    assert _order(CLASSES[name], "rk4", [20, 40, 80, 160, 320]) > 3.3


def _agrees(p, k, law, method, tolerance, **options):
    problem = ImpactProblem(p.delassus[k], p.velocity[k], p.friction[k], p.restitution[k], law)
    exact = solve_impact(problem)
    stepped = solve_impact(problem, method, **options)
    near = Flag.NEAR_JUMP in exact.flags
    return near or relative_error(stepped, exact, problem) <= tolerance


@pytest.mark.parametrize("law", ["poisson", "energetic", "newton"])
@pytest.mark.parametrize("category", ["general", "near-critical friction", "planar", "rank two, rounded"])
def test_adaptive_method_for_slow_slip(category, law):
    """The direction of slip converges within ever shorter impulses, to which the step size adapts."""
    p = random_impacts.draw(np.random.default_rng(5), category, 150)
    agree = [_agrees(p, k, law, "adaptive", 1e-4, rtol=1e-8) for k in range(150)]
    assert all(agree)


@pytest.mark.parametrize("category", ["rank two, exactly", "tiny slip"])
def test_rk4_does_not_oscillate(category):
    """Steps longer than the convergence of the direction of slip would oscillate around it."""
    p = random_impacts.draw(np.random.default_rng(7), category, 300)
    answered = agree = 0
    for k in range(300):
        try:
            agree += _agrees(p, k, "poisson", "rk4", 1e-4, steps=100)
        except PinimpactError:  # too many steps of slow slip, or an unstoppable approach
            continue
        answered += 1
    assert agree == answered > 270


def test_order_of_stiff_step():
    """Compare with short Dormand–Prince steps: errors are of order h⁵, their estimates of order h⁴."""
    from pinimpact.contact_space._kernels.butcher import DORMAND_PRINCE
    from pinimpact.contact_space._kernels.slip_steps import slip_step
    from pinimpact.contact_space._kernels.stiff_step import STAGES, stiff_step

    tangent, mu, v1, v2 = (1.3, 0.2, 0.8, 0.4, -0.3), 0.7, 1.0, 0.6

    @numba.njit
    def explicit(table, v1, v2, h):
        return slip_step(table, tangent, mu, v1, v2, h, np.empty((7, 4)))

    @numba.njit
    def implicit(h):
        return stiff_step(tangent, mu, v1, v2, h, np.empty((STAGES, 4)))

    errors, estimates, lengths = [], [], [0.2, 0.1, 0.05, 0.025]
    for h in lengths:
        d, q, u = np.zeros(2), np.zeros(2), np.array([v1, v2])
        for _ in range(40):
            step = explicit(DORMAND_PRINCE, *u, h / 40)
            q += np.array(step[2:4]) + d * h / 40
            d += step[0:2]
            u = np.array(step[4:6])
        step = implicit(h)
        errors.append(np.abs(np.concatenate([step[0:2] - d, step[2:4] - q, step[4:6] - u])).max())
        estimates.append(step[6])
    assert np.polyfit(np.log(lengths), np.log(errors), 1)[0] > 4.8
    assert np.polyfit(np.log(lengths), np.log(estimates), 1)[0] == pytest.approx(4.0, abs=0.4)


@pytest.mark.parametrize("name", list(CLASSES))
def test_adaptive_follows_its_tolerance(name):
    tolerances = [1e-3, 1e-6, 1e-9, 1e-12]
    errors = _errors(CLASSES[name], "adaptive", [{"rtol": rtol} for rtol in tolerances])
    assert (errors <= 5.0 * np.array(tolerances)).all()


@pytest.mark.parametrize("name", list(CLASSES))
def test_solve_ivp_agrees(name):
    # its threshold of the speed of slip is ten times rtol
    for rtol in (1e-5, 1e-8):
        assert _errors(CLASSES[name], "solve_ivp", [{"rtol": rtol}])[0] <= 100.0 * rtol


def _rows():
    """Yield two rows of each category and law of the table with a low sensitivity to rounding errors."""
    for category in np.unique(TABLE.category):
        for law in np.unique(TABLE.law):
            rows = np.flatnonzero((TABLE.category == category) & (TABLE.law == law))
            size = np.linalg.norm(TABLE.answer[rows, :3, 0], axis=1) + np.linalg.norm(
                TABLE.velocity[rows], axis=1
            )
            tame = TABLE.sensitivity[rows, 0] < 1e-13 * size
            gentle = -TABLE.velocity[rows, 2] > 1e-2 * np.linalg.norm(TABLE.velocity[rows], axis=1)
            yield from (int(row) for row in rows[tame & gentle][:2])


@pytest.mark.parametrize("row", list(_rows()))
def test_methods_tend_to_the_reference(row):
    p = TABLE.problem(row)
    problem = ImpactProblem(p.delassus, p.velocity, p.friction, p.restitution, p.law)
    velocity, impulse = TABLE.answer[row, 0:3, 0], TABLE.answer[row, 3:6, 0]
    for method, options, tolerance in (("euler", {"steps": 2000}, 5e-2), ("adaptive", {"rtol": 1e-11}, 1e-7)):
        solution = solve_impact(problem, method, **options)
        assert np.linalg.norm(solution.velocity - velocity) <= tolerance * np.linalg.norm(p.velocity)
        assert np.linalg.norm(solution.impulse - impulse) <= tolerance * np.linalg.norm(impulse)


@st.composite
def problems(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    X = rng.standard_normal((3, draw(st.integers(4, 9)))) * 10.0 ** rng.uniform(-0.5, 0.5, (3, 1))
    v = rng.standard_normal(3) * 10.0 ** rng.uniform(-1.0, 1.0)
    v[2] = -abs(v[2]) - 0.1
    friction, restitution = draw(st.floats(0.0, 2.0)), draw(st.floats(0.0, 1.0))
    law = draw(st.sampled_from(["poisson", "energetic", "newton"]))
    return ImpactProblem(X @ X.T / 3.0, v, friction, restitution, law)


@pytest.mark.parametrize("method", list(STEPPING))
@examples(100)
@given(problem=problems())
def test_every_stepped_impact_obeys_mechanics(method, problem):
    try:
        solution = solve_impact(problem, method, record=True, **STEPPING[method])
    except PinimpactError as gave_up:  # creeping slip is stiff; docs/accuracy.md
        if gave_up.field not in STEPPING[method]:
            raise
        reject()
    W, v, mu = problem.delassus, problem.velocity, problem.friction
    P, w = solution.impulse, solution.work
    size = abs(w.compression) + w.restitution - w.friction
    assert solution.velocity[2] >= 0.0
    rounding = 1e-11 * np.linalg.norm(v) + 1e-13 * np.linalg.norm(W) * np.linalg.norm(P)
    assert solution.velocity == pytest.approx(v + W @ P, abs=rounding)
    assert np.hypot(P[0], P[1]) <= mu * P[2] * (1.0 + 2e-8)
    assert w.compression <= 0.0 <= w.restitution
    assert w.friction <= 1e-12 * size
    assert w.total == pytest.approx(0.5 * P @ (v + solution.velocity), abs=1e-11 * size)
    if problem.law == "energetic":
        assert w.total <= 1e-12 * size
        assert w.restitution == pytest.approx(-(problem.restitution**2) * w.compression, abs=1e-9 * size)
    elif problem.law == "poisson":
        ratio = P[2] / solution.compression_impulse - 1.0
        assert ratio == pytest.approx(problem.restitution, abs=1e-11)
    else:
        assert solution.velocity[2] == pytest.approx(-problem.restitution * v[2], rel=1e-12)
    assert solution.path.normal_impulse[0] == 0.0
    assert (np.diff(solution.path.normal_impulse) >= 0.0).all()
    assert solution.path.velocity[0] == pytest.approx(v)
    assert solution.path.impulse[-1] == pytest.approx(P, abs=1e-15)
    ends = [(s.start, s.end) for s in solution.segments]
    assert ends[0][0] == 0.0
    assert ends[-1][1] == pytest.approx(P[2])
    assert all(a[1] == pytest.approx(b[0]) for a, b in itertools.pairwise(ends))


@pytest.mark.parametrize("method", list(STEPPING))
@pytest.mark.parametrize("name", list(CLASSES))
def test_methods_have_the_same_flags_and_status(method, name):
    exact = solve_impact(CLASSES[name])
    stepped = solve_impact(CLASSES[name], method, **STEPPING[method])
    near = Flag.NEAR_JUMP | Flag.NEAR_STICK_THRESHOLD | Flag.SLIP_TURNED
    if name == "near-invariant start":
        near |= Flag.SLIP_RESUMED  # v_t passes zero within 1e-4, which a step takes as zero
    assert stepped.flags & ~near == exact.flags & ~near
    assert stepped.status == exact.status


@pytest.mark.parametrize("method", list(STEPPING))
def test_impact_without_collision(method):
    # at v₃ = 0 with negative normal acceleration, step sizes are relative to the impulse that ends slip
    problem = ImpactProblem([[1.2, 0, 1], [0, 8, 0], [1, 0, 1]], (1.0, 0.5, 0.0), 1.5, 0.5)
    exact = solve_impact(problem)
    stepped = solve_impact(problem, method, **STEPPING[method])
    assert Flag.IMPACT_WITHOUT_COLLISION in stepped.flags
    assert stepped.velocity == pytest.approx(exact.velocity, abs=1e-9)
    assert stepped.impulse == pytest.approx(exact.impulse, rel=1e-2)


@pytest.mark.parametrize("method", list(STEPPING))
def test_locked_mechanism(method):
    # the paper's pendulum: sticking implies v₃ = 0, but Poisson's law applies the impulse of restitution
    root = np.sqrt(0.5)
    problem = ImpactProblem([[1.5, 0, 1.5], [0, 3, 0], [1.5, 0, 1.5]], (-root, root, -root), 1.2, 0.8)
    stepped = solve_impact(problem, method, **STEPPING[method])
    assert stepped.velocity == pytest.approx(0.0, abs=1e-12)
    assert stepped.impulse[2] == pytest.approx(0.472518645665, rel=5e-3)
    assert Flag.LOCKED in stepped.flags


@pytest.mark.parametrize("method", list(STEPPING))
def test_slip_that_no_impulse_changes(method):
    # tangential impulses do not change v_t, and friction is at its bound
    problem = ImpactProblem(np.diag([0.0, 0.0, 2.0]), (3.0, -4.0, -1.0), 0.3, 0.5)
    stepped = solve_impact(problem, method, **STEPPING[method])
    assert stepped.velocity == pytest.approx([3.0, -4.0, 0.5], abs=1e-12)
    assert stepped.impulse == pytest.approx(0.75 * np.array([-0.18, 0.24, 1.0]), rel=1e-12)


@pytest.mark.parametrize("method", list(STEPPING))
def test_slip_and_compression_that_end_together(method):
    """As v is in the range of W, v₃ = κ·v_t; rounding errors must not cause a second compression."""
    fine = STEPPING | {"euler": {"steps": 1000}, "rk4": {"steps": 200}}
    rng = np.random.default_rng(3)
    (W, v, mu), e = random_impacts.rank_rounded(rng, 200, 2), rng.random(200)
    for k in np.flatnonzero(v[:150, 2] < -0.1):
        problem = ImpactProblem(W[k], v[k], mu[k], e[k])
        exact, stepped = solve_impact(problem), solve_impact(problem, method, **fine[method])
        assert (exact.flags ^ stepped.flags) & Flag.SECOND_COMPRESSION == Flag(0)


def test_steps_without_compiler():
    script = (
        "import numba, pinimpact.studies.cost as cost; from pinimpact import solve_impact\n"
        "assert numba.config.DISABLE_JIT\n"
        "problem = cost.problem_classes()['resumed slip']\n"
        "for method in ('euler', 'rk4', 'adaptive'):\n"
        "    print(*solve_impact(problem, method, record=True).velocity.tolist())\n"
    )
    environment = dict(os.environ, NUMBA_DISABLE_JIT="1")
    run = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    for line, method in zip(run.stdout.splitlines(), STEPPING, strict=True):
        compiled = solve_impact(CLASSES["resumed slip"], method).velocity
        assert [float(x) for x in line.split()] == pytest.approx(compiled, abs=1e-9)


def test_tables_are_consistent():
    from pinimpact.contact_space._kernels import butcher

    for table, order in ((butcher.EULER, 1), (butcher.RK4, 4), (butcher.DORMAND_PRINCE, 5)):
        a, b, c = table.a, table.b, table.c
        assert c == pytest.approx(a.sum(axis=1))
        for k in range(order):
            assert b @ c**k == pytest.approx(1.0 / (k + 1))
        if order > 2:
            assert b @ a @ c == pytest.approx(1.0 / 6.0)
            assert b @ a @ a @ c == pytest.approx(1.0 / 24.0)
        assert table.area.sum() == pytest.approx(0.5)
        assert table.error.sum() == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(
    ("method", "option", "value"),
    [
        ("euler", "steps", 0),
        ("euler", "steps", 2.5),
        ("rk4", "steps", "many"),
        ("adaptive", "rtol", 0.0),
        ("adaptive", "rtol", np.nan),
        ("solve_ivp", "rtol", 1.0),
    ],
)
def test_options_out_of_range(method, option, value):
    with pytest.raises(InputError, match=option) as caught:
        solve_impact(CLASSES["planar"], method, **{option: value})
    assert caught.value.field == option


def test_unknown_options():
    with pytest.raises(UnknownNameError, match="steps"):
        solve_impact(CLASSES["planar"], "adaptive", steps=3)


def test_too_many_steps_raise():
    problem = ImpactProblem([[1.2, 0, 1], [0, 8, 0], [1, 0, 1]], (1.0, 0.5, -1e-9), 1.5, 0.5)
    with pytest.raises(PinimpactError, match="exact"):
        solve_impact(problem, "euler", steps=10)


@pytest.fixture
def shifted():
    """Return a function that makes methods with a given normal impulse; unregister them after the test."""

    def make(number):
        def run(inputs, trace, path):
            return (0, 0, 1, *inputs[6:9], 0.0, 0.0, number, number, 0.0, 0, 0)

        return Method(lambda: run, "made for a test")

    names = set(METHODS)
    yield make
    for name in set(METHODS) - names:
        methods_module._methods.pop(name)
        methods_module._loaded.pop(name, None)


def test_known_name_is_replaced_only_on_request(shifted):
    problem = CLASSES["planar"]
    register_method("shifted", shifted(1.0))
    assert solve_impact(problem, "shifted").impulse[2] == 1.0
    with pytest.raises(InputError, match=r"'shifted'.*replace=True") as caught:
        register_method("shifted", shifted(2.0))
    assert caught.value.field == "name"
    assert solve_impact(problem, "shifted").impulse[2] == 1.0
    register_method("shifted", shifted(2.0), replace=True)  # also after it was loaded
    assert solve_impact(problem, "shifted").impulse[2] == 2.0


def test_exact_cannot_be_replaced(shifted):
    before = solve_impact(CLASSES["planar"]).impulse
    with pytest.raises(InputError, match="exact"):
        register_method("exact", shifted(1.0), replace=True)
    with pytest.raises(TypeError):
        METHODS["exact"] = shifted(1.0)
    assert solve_impact(CLASSES["planar"]).impulse.tolist() == before.tolist()


def test_registered_methods():
    assert list(METHODS) == ["exact", "euler", "rk4", "adaptive", "solve_ivp"]
    assert all(method.summary for method in METHODS.values())


def test_no_false_jam_as_slip_vanishes():
    """The error of the impulse hides the direction of vanishing slip."""
    rng = np.random.default_rng(21)
    turn = np.linalg.qr(rng.standard_normal((60, 3, 3)))[0]
    stiffness = 10.0 ** np.array([0.0, -3.0, -6.0])
    for axes in turn:
        W = axes * stiffness @ axes.T
        problem = ImpactProblem((W + W.T) / 2, (0.4, -0.7, -1.0), 0.8, 0.5)
        stepped = solve_impact(problem, "adaptive")
        assert (Flag.JAM in stepped.flags) == (Flag.JAM in solve_impact(problem).flags)
