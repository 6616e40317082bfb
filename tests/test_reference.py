"""The multiple-precision reference and its table: published solutions, numerical integration, identities."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp, mpf
from scipy.integrate import solve_ivp

import pinimpact
from pinimpact import Flag, ImpactProblem, Status

from .drawing import one_of_each
from .reference import table as stored
from .reference.problems import CATEGORIES, draw
from .reference.reference import LAWS, solve_reference

TABLE = stored.load()


def _literature():
    """Yield the rows of the file: problem, μ, v⁺, P, compression impulse, events."""
    for line in Path(stored.__file__).with_name("literature.txt").read_text().splitlines():
        if not line.startswith("#"):
            name, mu, *vectors, events = (cell.strip() for cell in line.split("|"))
            velocity, impulse, (compression,) = ([mpf(x) for x in cell.split(",")] for cell in vectors)
            yield pytest.param(name, mu, velocity, impulse, compression, events, id=f"{name}, mu={mu}")


def _literature_problem(name: str) -> tuple[list[list[mpf]], list[mpf], float]:
    """Return W, v and e in the working precision."""
    root2, root3 = mp.sqrt(2), mp.sqrt(3)
    if name.startswith("ellipsoid"):
        slip = 5 / root2 if name.endswith("A") else mpf("0.5")
        return [[2, 0, 0], [0, mpf("3.5"), 0], [0, 0, 1]], [slip, slip, mpf(-1)], 0.5
    if name == "pendulum":
        v = [-root2 / 2, root2 / 2, -root2 / 2]
        return [[mpf("1.5"), 0, mpf("1.5")], [0, 3, 0], [mpf("1.5"), 0, mpf("1.5")]], v, mpf("0.8")
    si, co = mp.sin(mpf("0.46")), mp.cos(mpf("0.46"))
    sign = -1 if "-x" in name else 1
    v = [sign * mpf("0.2"), mpf("0.2") * root3, mpf(-2)]
    W = [[4, 0, 0], [0, 1 + 3 * si**2, -3 * si * co], [0, -3 * si * co, 1 + 3 * co**2]]
    return W, v, mpf("0.8")


@pytest.mark.parametrize(("name", "mu", "velocity", "impulse", "compression", "events"), list(_literature()))
def test_literature(name, mu, velocity, impulse, compression, events):
    with mp.workdps(60):
        W, v, e = _literature_problem(name)
        if "mu_c" in name:
            mu = float(name.split()[2]) * mp.tan(mpf("0.46")) / (mp.sqrt(3) / 2)
        elif mu == "1.41421356237":
            mu = mp.sqrt(2)
        answer = solve_reference(W, v, mu, e, digits=30)
        half = mpf("0.51e-12")
        assert max(abs(a - b) for a, b in zip(answer.velocity, velocity, strict=True)) < half
        assert max(abs(a - b) for a, b in zip(answer.impulse, impulse, strict=True)) < half
        assert abs(answer.compression_impulse - compression) < half
        expected = [event.split(" @ ") for event in events.split("; ")]
        assert sorted(event for event, _ in answer.events) == sorted(event for event, _ in expected)
        place = dict(expected)
        assert all(abs(P3 - mpf(place[event])) < mpf("0.51e-10") for event, P3 in answer.events)


def _brute_force(W, v, mu, e, law):
    """Integrate dv/dτ = |v_t| b − μ A v_t with scipy, together with P and normal work; dP₃ = |v_t| dτ."""
    b, A = W[:2, 2], W[:2, :2]
    scale = float(np.linalg.norm(v))
    phases = {True: [0.0, 0.0], False: [0.0, 0.0]}
    direction = None  # of slip resumed from rest
    y = np.concatenate([v, np.zeros(4)])  # v, P, normal work

    def rates(_, y):
        if direction is not None:
            push, speed = -mu * direction, 1.0
        elif stuck:
            push, speed = -np.linalg.solve(A, b), 1.0
        else:
            speed = math.hypot(y[0], y[1])
            push = -mu * y[:2] / speed if speed else np.zeros(2)
        P = np.array([push[0], push[1], 1.0])
        return speed * np.concatenate([W @ P, P, [y[2]]])

    def law_end(_, y):
        impulse, work = y[5] - mark[5], y[6] - mark[6]
        if law == "poisson":
            return phases[False][0] + impulse - e * phases[True][0]
        if law == "energetic":
            return phases[False][1] + work + e**2 * phases[True][1]
        return y[2] + e * v[2]

    def turn(_, y):
        return y[2]

    def stop(_, y):
        return math.hypot(y[0], y[1]) - 1e-9 * scale

    turn.terminal = law_end.terminal = stop.terminal = True
    law_end.direction, stop.direction = 1, -1
    stuck, compressing, mark = False, True, y.copy()
    for _ in range(12):
        turn.direction = 1 if compressing else -1
        events = [turn] if compressing else [turn, law_end]
        slipping = direction is None and not stuck
        run = solve_ivp(
            rates,
            (0, 1e9),
            y,
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
            events=[*events, *([stop] * slipping)],
        )
        assert run.status == 1
        hit = next(i for i, t in enumerate(run.t_events) if len(t))
        y = run.y[:, -1]
        if slipping and hit == len(events):
            if np.linalg.norm(np.linalg.solve(A, b)) <= mu:
                stuck = True
            else:
                angles = np.linspace(0, 2 * np.pi, 3601)
                for _ in range(8):  # refine the direction σ that is parallel to b − μAσ
                    s = np.array([np.cos(angles), np.sin(angles)])
                    F = b[:, None] - mu * A @ s
                    error = np.abs(np.arctan2(s[0] * F[1] - s[1] * F[0], (s * F).sum(0)))
                    best = angles[np.argmin(error)]
                    angles = best + (angles - np.mean(angles)) / 100
                direction = np.array([np.cos(best), np.sin(best)])
            continue
        phases[compressing][0] += y[5] - mark[5]
        phases[compressing][1] += y[6] - mark[6]
        mark = y.copy()
        if hit == 1 or (compressing and e == 0):
            return y[:3], y[3:6], phases
        compressing = not compressing
    raise AssertionError("no end")


BRUTE = (
    "smooth slip",
    "slip to stick",
    "resumed slip",
    "jam",
    "second compression",
    "near-invariant start",
    "high friction",
    "isotropic",
    "balanced",
)


@pytest.mark.parametrize(("category", "turn"), one_of_each(list(BRUTE), [400, 401, 402, 403]))
def test_brute_force(category, turn):
    p = draw(3, turn * len(CATEGORIES) + CATEGORIES.index(category))
    answer = solve_reference(p.delassus, p.velocity, p.friction, p.restitution, p.law, digits=20)
    velocity, impulse, phases = _brute_force(p.delassus, p.velocity, p.friction, p.restitution, p.law)
    near = 3e-7 if category == "second compression" else 3e-8  # slip is taken as zero at 1e-9 of the speed
    exact = [[float(x) for x in vector] for vector in (answer.velocity, answer.impulse)]
    assert velocity == pytest.approx(exact[0], abs=near * np.linalg.norm(p.velocity))
    assert impulse == pytest.approx(exact[1], abs=near * np.linalg.norm(impulse))
    assert phases[True] == pytest.approx(
        [float(answer.compression_impulse), float(answer.compression_work)], rel=1e-6
    )


def _table_sample(count: int) -> list[int]:
    return sorted(np.random.default_rng(20).choice(len(TABLE), count, replace=False).tolist())


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, marks=() if k % 4 == 0 else pytest.mark.exhaustive)
        for k, row in enumerate(_table_sample(50))
    ],
)
def test_table_is_reproduced(row):
    p = TABLE.problem(row)
    answer = solve_reference(p.delassus, p.velocity, p.friction, p.restitution, p.law)
    with mp.workdps(60):
        new, old = stored.outputs(answer), TABLE.exact(row)
        for group in ([0, 1, 2], [3, 4, 5], [6], [7], [8], [9]):
            size = mp.norm([old[k] for k in group])
            # numbers below the smallest double are not stored
            assert mp.norm([new[k] - old[k] for k in group]) <= size * mpf(10) ** -40 + mpf(2) ** -1070
    assert answer.status == stored.STATUSES[TABLE.status[row]]


@pytest.mark.parametrize("row", _table_sample(8))
def test_more_digits_change_nothing(row):
    p = TABLE.problem(row)
    with mp.workdps(80):
        more = stored.outputs(
            solve_reference(p.delassus, p.velocity, p.friction, p.restitution, p.law, digits=70)
        )
        old = TABLE.exact(row)
        size = mp.norm(old)
        assert max(abs(a - b) for a, b in zip(more, old, strict=True)) <= size * mpf(10) ** -46


def test_table_covers_every_regime():
    assert len(TABLE) >= 3000
    for law in range(len(LAWS)):
        for category in range(len(CATEGORIES)):
            assert np.sum((TABLE.law == law) & (TABLE.category == category)) >= 20
    assert set(TABLE.status) == {0, 1, 3}
    for bit, name in enumerate(stored.FLAGS):
        assert np.sum(TABLE.flags >> bit & 1) >= 10, name


@pytest.mark.slow
def test_table_obeys_the_laws_of_mechanics():
    """Check momentum, friction cone, energy, separation and restitution law to the last stored digit."""
    with mp.workdps(60):
        small = mpf(10) ** -45
        least = mpf(2) ** -1060  # stored numbers below it are zero
        for row in range(len(TABLE)):
            p = TABLE.problem(row)
            out = TABLE.exact(row)
            v, P, (Pc, Pr, Wc, Wr) = out[:3], out[3:6], out[6:]
            v0 = [mpf(float(x)) for x in p.velocity]
            W = [[mpf(float(x)) for x in line] for line in p.delassus]
            mu, e = mpf(p.friction), mpf(p.restitution)
            speed, size = mp.norm(v0), mp.norm(P)
            bound = small * (speed + sum(abs(x) for line in W for x in line) * size)
            for i in range(3):
                assert abs(v[i] - v0[i] - sum(W[i][j] * P[j] for j in range(3))) <= bound
            assert mp.hypot(P[0], P[1]) <= mu * P[2] * (1 + small)
            assert v[2] >= 0
            assert abs(Pc + Pr - P[2]) <= small * P[2] + least
            total = sum(x * (a + b) for x, a, b in zip(P, v0, v, strict=True)) / 2
            assert total - Wc - Wr <= bound * size  # work of friction is not positive
            assert Wc <= 0 <= Wr + bound * size
            locked = stored.STATUSES[TABLE.status[row]] == "LOCKED"
            if p.law == "poisson":
                assert abs(Pr - e * Pc) <= small * P[2] + least
            elif p.law == "energetic" and not locked:
                # work is by quadrature, with a few digits less, but still twice those of a double
                assert abs(Wr + e**2 * Wc) <= mpf(10) ** -40 * abs(Wc) + least
            elif p.law == "newton" and not locked:
                assert abs(v[2] + e * v0[2]) <= small * abs(v0[2])
            if p.law == "energetic" or e == 0:
                assert total <= bound * size


def test_distance_of_two_slips_does_not_grow():
    """The distance of two slips of a contact in the norm of A⁻¹ does not grow; both end at the same P₃."""
    rng = np.random.default_rng(5)
    for _ in range(6):
        X = rng.standard_normal((2, 5))
        W = np.diag([0, 0, rng.uniform(0.5, 2)])
        W[:2, :2] = X @ X.T / 5
        starts = np.array([[3, 2, -1], [3, 2, -1]]) + rng.standard_normal((2, 3)) * [1, 1, 0]
        ends = [solve_reference(W, v, 0.5, 0.5, digits=20).velocity for v in starts]
        metric = np.linalg.inv(W[:2, :2])
        before, after = (np.subtract(*pair)[:2].astype(float) for pair in (starts, np.array(ends)))
        assert 0 < after @ metric @ after <= before @ metric @ before


def _allowed(rows):
    """Return tolerances of v⁺ and P: 1e-12, or eight times the sensitivity to rounding errors."""
    speed = np.linalg.norm(TABLE.velocity[rows], axis=-1)
    impulse = np.linalg.norm(TABLE.answer[rows, 3:6, 0], axis=-1)
    return np.maximum(1e-12 * np.stack([speed, impulse]), 8 * TABLE.sensitivity[rows].T)


def _worst(rows, misses) -> str:
    order = np.argsort(-np.nan_to_num(misses, nan=np.inf))[:5]
    return "; ".join(f"row {rows[k]} ({TABLE.problem(rows[k])}): {misses[k]:.2g}" for k in order)


@pytest.mark.parametrize("law", LAWS)
def test_solve_impacts(law):
    """Compare all rows of the table, in one batch for each law."""
    rows = TABLE.rows(law)
    batch = pinimpact.solve_impacts(
        TABLE.delassus[rows], TABLE.velocity[rows], TABLE.friction[rows], TABLE.restitution[rows], law
    )
    answer = TABLE.answer[rows, :, 0]
    slack_v, slack_P = _allowed(rows)
    miss = np.maximum(
        np.linalg.norm(batch.velocity - answer[:, :3], axis=1) / slack_v,
        np.linalg.norm(batch.impulse - answer[:, 3:6], axis=1) / slack_P,
    )
    assert (miss <= 1).all(), _worst(rows, miss)
    assert [Status(int(s)).name for s in batch.status] == [stored.STATUSES[k] for k in TABLE.status[rows]]

    miss = np.abs(batch.compression_impulse - answer[:, 6]) / slack_P
    assert (miss <= 1).all(), _worst(rows, miss)
    power = np.linalg.norm(TABLE.velocity[rows], axis=1) * slack_P
    power += np.linalg.norm(answer[:, 3:6], axis=1) * slack_v
    for work, column in ((batch.work.compression, 8), (batch.work.restitution, 9)):
        miss = np.abs(work - answer[:, column]) / power
        assert (miss <= 1).all(), _worst(rows, miss)

    e, unlocked = TABLE.restitution[rows], batch.status != Status.LOCKED
    if law == "poisson":
        rest = batch.impulse[:, 2] - batch.compression_impulse
        assert (np.abs(rest - e * batch.compression_impulse) <= 1e-12 * batch.impulse[:, 2]).all()
    elif law == "energetic":
        lack = np.abs(batch.work.restitution + e**2 * batch.work.compression)
        miss = (lack / np.maximum(4 * 2.0**-52 * power, 1e-12 * np.abs(batch.work.compression)))[unlocked]
        assert (miss <= 1).all(), _worst(rows[unlocked], miss)
    else:
        lack = np.abs(batch.velocity[:, 2] + e * TABLE.velocity[rows, 2])
        assert (lack <= 1e-12 * np.abs(TABLE.velocity[rows, 2]))[unlocked].all()


@pytest.mark.parametrize("row", _table_sample(200)[::4])
def test_solve_impact(row):
    """Compare a sample of rows, with flags, except those that rounding errors may decide."""
    p = TABLE.problem(row)
    solution = pinimpact.solve_impact(
        ImpactProblem(p.delassus, p.velocity, p.friction, p.restitution, law=p.law)
    )
    slack_v, slack_P = _allowed(row)
    assert np.linalg.norm(solution.velocity - TABLE.answer[row, :3, 0]) <= slack_v
    assert np.linalg.norm(solution.impulse - TABLE.answer[row, 3:6, 0]) <= slack_P
    for bit, name in enumerate(stored.FLAGS):
        if name in ("LOCKED", "IMPACT_WITHOUT_COLLISION", "SECOND_COMPRESSION", "SINGULAR_DELASSUS"):
            assert (Flag[name] in solution.flags) == bool(TABLE.flags[row] >> bit & 1), name


@pytest.mark.slow
@pytest.mark.parametrize("rank", [1, 2])
def test_singular_w_with_rounding_errors(rank):
    """Compare W = XXᵀ and v = Xw in doubles with the reference for exact products."""
    for trial in range(20):
        rng = np.random.default_rng((77, rank, trial))
        X, w = rng.standard_normal((3, rank)), rng.standard_normal(rank)
        w *= -np.sign((X @ w)[2])
        W, v, mu = X @ X.T, X @ w, float(rng.uniform(0.2, 3))
        law, e = LAWS[trial % 3], float(rng.choice([0, 0.5, 0.8, 1]))
        with mp.workdps(80):
            exact_X, exact_w = mp.matrix(X.tolist()), mp.matrix(w.tolist())
            exact_W, exact_v = exact_X * exact_X.T, exact_X * exact_w
            answer = solve_reference(exact_W.tolist(), list(exact_v), mu, e, law, digits=30)
        solution = pinimpact.solve_impact(ImpactProblem((W + W.T) / 2, v, mu, e, law=law))
        velocity, impulse = (np.array(x, dtype=float) for x in (answer.velocity, answer.impulse))
        assert np.linalg.norm(solution.velocity - velocity) <= 1e-12 * np.linalg.norm(v), trial
        assert np.linalg.norm(solution.impulse - impulse) <= 1e-12 * np.linalg.norm(impulse), trial
        assert solution.status.name == answer.status, trial


PLAIN = """
import sys
import pinimpact
from tests.reference import table as stored

table = stored.load()
for row in map(int, sys.argv[1:]):
    p = table.problem(row)
    problem = pinimpact.ImpactProblem(p.delassus, p.velocity, p.friction, p.restitution, p.law)
    solution = pinimpact.solve_impact(problem)
    print(*solution.velocity.tolist(), *solution.impulse.tolist())
"""


def test_without_compiler():
    """Kernels run as plain Python have the same accuracy."""
    rows = _table_sample(60)
    run = subprocess.run(
        [sys.executable, "-c", PLAIN, *map(str, rows)],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=True,
    )
    answers = np.array([[float(x) for x in line.split()] for line in run.stdout.splitlines()])
    slack_v, slack_P = _allowed(rows)
    assert (np.linalg.norm(answers[:, :3] - TABLE.answer[rows, :3, 0], axis=1) <= slack_v).all()
    assert (np.linalg.norm(answers[:, 3:] - TABLE.answer[rows, 3:6, 0], axis=1) <= slack_P).all()
