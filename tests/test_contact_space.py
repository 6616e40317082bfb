"""Impacts in contact space: properties of all solutions, statuses and flags, batches, errors of input."""

import copy
import pickle
import threading
import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import pinimpact
from pinimpact import Flag, ImpactProblem, InputError, Status, solve_impact, solve_impacts

from . import random_impacts
from .drawing import examples

LAWS = pinimpact.LAWS
W = np.array([[1.0, 0.2, 0.3], [0.2, 1.5, -0.4], [0.3, -0.4, 2.0]])
V = np.array([1.0, 0.5, -1.0])


@st.composite
def problems(draw, laws=LAWS):
    """Draw problems over many scales of slip, friction and coupling, some with exact zeros."""
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    columns = draw(st.sampled_from([3, 4, 7]))
    X = rng.standard_normal((3, columns)) * 10.0 ** rng.uniform(-draw(st.sampled_from([0, 1, 2])), 0, (3, 1))
    delassus = X @ X.T / columns
    delassus = (delassus + delassus.T) / 2
    velocity = rng.standard_normal(3)
    velocity[2] = -abs(velocity[2])
    velocity[:2] *= 10.0 ** draw(st.sampled_from([0, 0, -1, -2, -6, -200]))
    velocity[2] *= 10.0 ** draw(st.sampled_from([0, 0, 0, -1, -4]))
    if draw(st.booleans()) and draw(st.booleans()):
        velocity[draw(st.integers(0, 2))] = 0.0
    mu = draw(st.sampled_from([0.0, 0.1, 0.3, 0.6, 1.0, 3.0, 1e3])) * rng.uniform(0.5, 1)
    e = draw(st.sampled_from([0.0, 0.3, 0.8, 1.0]))
    return ImpactProblem(delassus, velocity, float(mu), e, draw(st.sampled_from(laws)))


def _sizes(problem, solution):
    """Return scales of velocities and impulses for tolerances of rounding errors."""
    P = np.abs(solution.impulse).max()  # no squares: they may underflow
    return np.abs(problem.velocity).max() + np.abs(problem.delassus).max() * P, P


@given(problems())
@examples(300)
def test_every_impact_obeys_mechanics(problem):
    solution = solve_impact(problem)
    v0, v, P = np.asarray(problem.velocity), solution.velocity, solution.impulse
    speed, impulse = _sizes(problem, solution)
    small = 1e-13 * speed

    assert np.isfinite(v).all()
    assert np.isfinite(P).all()
    assert v[2] >= 0
    assert np.abs(v - v0 - problem.delassus @ P).max() <= small
    assert np.hypot(P[0], P[1]) <= problem.friction * P[2] * (1 + 1e-14)

    work = solution.work
    assert work.compression <= 0 <= work.restitution
    assert work.friction <= small * impulse
    assert work.surface == 0
    assert abs(work.total - P @ (v0 + v) / 2) <= small * impulse
    if problem.law == "energetic" or problem.restitution == 0:
        assert work.total <= small * impulse
    assert (Flag.ENERGY_CREATED in solution.flags) <= (problem.law == "newton")

    rest = P[2] - solution.compression_impulse
    assert rest >= -1e-14 * P[2]
    if solution.status == Status.SEPARATED:
        if problem.law == "poisson":
            assert abs(rest - problem.restitution * solution.compression_impulse) <= 1e-13 * P[2]
        elif problem.law == "newton":
            assert abs(v[2] + problem.restitution * v0[2]) <= 1e-13 * abs(v0[2])
        else:
            lack = work.restitution + problem.restitution**2 * work.compression
            assert abs(lack) <= 1e-12 * abs(work.compression) + small * impulse


@given(problems())
@examples(100)
def test_segments_tile_the_impact(problem):
    solution = solve_impact(problem)
    assume(solution.status != Status.NO_IMPACT)
    segments = solution.segments
    assert segments[0].start == 0
    small = 1e-13 * solution.impulse[2]
    assert segments[-1].end == pytest.approx(solution.impulse[2], abs=small)
    for before, after in pairwise(segments):
        assert after.start == pytest.approx(before.end, abs=small)
        assert not (before.mode == "stick" and after.mode == "slip")
        same = (before.mode, before.phase) == (after.mode, after.phase)
        assert not same or Flag.SLIP_RESUMED in solution.flags
    compression = sum(s.end - s.start for s in segments if s.phase == "compression")
    assert compression == pytest.approx(solution.compression_impulse, rel=1e-12)
    assert (Flag.STICK in solution.flags) == any(s.mode == "stick" for s in segments)


@given(problems())
@examples(60)
def test_recorded_path_ends_where_the_solution_does(problem):
    solution = solve_impact(problem, record=True)
    assume(solution.status != Status.NO_IMPACT)
    path = solution.path
    speed, impulse = _sizes(problem, solution)
    assert (np.diff(path.normal_impulse) >= 0).all()
    assert path.velocity[-1] == pytest.approx(solution.velocity, abs=1e-13 * speed)
    assert path.impulse[-1] == pytest.approx(solution.impulse, abs=1e-13 * impulse)
    assert path.impulse[:, 2] == pytest.approx(path.normal_impulse)
    v = np.asarray(problem.velocity) + path.impulse @ problem.delassus
    assert np.abs(v - path.velocity).max() <= 1e-12 * speed


MAPS = {
    "mirror in t1": np.diag([-1.0, 1.0, 1.0]),
    "mirror in t2": np.diag([1.0, -1.0, 1.0]),
    "axis swap": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "half turn": np.diag([-1.0, -1.0, 1.0]),
}


@pytest.mark.parametrize("name", MAPS)
@given(problem=problems())
@examples(30)
def test_the_same_answer_in_mapped_axes_bit_for_bit(name, problem):
    T = MAPS[name]
    mapped = ImpactProblem(
        T @ problem.delassus @ T.T, T @ problem.velocity, problem.friction, problem.restitution, problem.law
    )
    one, other = solve_impact(problem), solve_impact(mapped)
    assert (T @ one.velocity).tolist() == other.velocity.tolist()
    assert (T @ one.impulse).tolist() == other.impulse.tolist()
    assert one.flags == other.flags


@given(problems(), st.integers(-60, 60), st.integers(-60, 60))
@examples(100)
def test_masses_and_speeds_scale_bit_for_bit(problem, mass, speed):
    """W → W/m and v → s v for powers of two give v⁺ → s v⁺ and P → m s P."""
    m, s = 2.0**mass, 2.0**speed
    assume(np.linalg.norm(problem.velocity[:2]) * s > 1e-280 or not problem.velocity[:2].any())
    scaled = ImpactProblem(
        problem.delassus / m, s * problem.velocity, problem.friction, problem.restitution, problem.law
    )
    one, other = solve_impact(problem), solve_impact(scaled)
    assert (s * one.velocity).tolist() == other.velocity.tolist()
    assert (m * s * one.impulse).tolist() == other.impulse.tolist()
    assert one.flags == other.flags


@given(problems(laws=("poisson", "energetic")), st.floats(0, 6.3))
@examples(100)
def test_tangent_axes_do_not_matter(problem, angle):
    """Where the impact map does not jump, turned axes give the turned answer to rounding."""
    co, si = np.cos(angle), np.sin(angle)
    T = np.array([[co, -si, 0], [si, co, 0], [0, 0, 1]])
    delassus = T @ problem.delassus @ T.T
    turned = ImpactProblem(
        (delassus + delassus.T) / 2, T @ problem.velocity, problem.friction, problem.restitution, problem.law
    )
    one, other = solve_impact(problem), solve_impact(turned)
    assume(not (one.flags | other.flags) & (Flag.NEAR_JUMP | Flag.JAM))
    speed, impulse = _sizes(problem, one)
    assert T @ one.velocity == pytest.approx(other.velocity, abs=1e-11 * speed)
    condition = np.linalg.cond(problem.delassus)
    assert T @ one.impulse == pytest.approx(other.impulse, abs=1e-13 * (10 + condition) * impulse)


@given(problems(), st.tuples(*[st.floats(-5, 5)] * 3))
@examples(30)
def test_a_moving_surface_only_adds_its_work(problem, surface):
    moving = ImpactProblem(
        problem.delassus, problem.velocity, problem.friction, problem.restitution, problem.law, surface
    )
    one, other = solve_impact(problem), solve_impact(moving)
    assert one.velocity.tolist() == other.velocity.tolist()
    assert other.work.surface == pytest.approx(one.impulse @ surface)
    assert other.work.total == pytest.approx(one.work.total + other.work.surface)


@given(st.lists(problems(laws=("energetic",)), min_size=1, max_size=6))
@examples(30)
def test_batch_is_the_single_problem_row_by_row(rows):
    batch = solve_impacts(
        [p.delassus for p in rows],
        [p.velocity for p in rows],
        [p.friction for p in rows],
        [p.restitution for p in rows],
        law="energetic",
    )
    for k, problem in enumerate(rows):
        one = solve_impact(problem)
        assert batch.velocity[k].tolist() == one.velocity.tolist()
        assert batch.impulse[k].tolist() == one.impulse.tolist()
        assert batch.compression_impulse[k] == one.compression_impulse
        assert (batch.status[k], batch.flags[k]) == (one.status, one.flags)
        for part in ("compression", "restitution", "friction", "total"):
            assert getattr(batch.work, part)[k] == pytest.approx(getattr(one.work, part), rel=1e-14)


def _with(matrix, i, j, value):
    changed = np.array(matrix)
    changed[i, j] = value
    return changed


BAD = {
    "W of the wrong shape": (dict(delassus=np.eye(2)), "delassus", ["(2, 2)", "(3, 3)"]),
    "W not numbers": (dict(delassus="stone"), "delassus", ["stone"]),
    "NaN in W": (dict(delassus=np.full((3, 3), np.nan)), "delassus", ["finite"]),
    "infinity in W": (dict(delassus=_with(W, 2, 2, np.inf)), "delassus", ["finite"]),
    "W not symmetric": (dict(delassus=_with(W, 0, 1, 0.25)), "delassus", ["symmetric", "0.05"]),
    "W indefinite": (
        dict(delassus=np.diag([1.0, -0.125, 1.0])),
        "delassus",
        ["semidefinite", "-0.125", "7.11e-15"],
    ),
    "v of the wrong shape": (dict(velocity=[1.0, 2.0]), "velocity", ["(2,)", "(3,)"]),
    "NaN in v": (dict(velocity=[np.nan, 0.0, -1.0]), "velocity", ["finite"]),
    "negative friction": (dict(friction=-0.25), "friction", ["-0.25"]),
    "infinite friction": (dict(friction=np.inf), "friction", ["inf"]),
    "friction not a number": (dict(friction="rough"), "friction", ["rough"]),
    "restitution above one": (dict(restitution=1.25), "restitution", ["1.25"]),
    "restitution below zero": (dict(restitution=-0.5), "restitution", ["-0.5"]),
    "restitution NaN": (dict(restitution=np.nan), "restitution", ["nan"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_numbers_are_named(name):
    change, field, words = BAD[name]
    numbers = dict(delassus=W, velocity=V, friction=0.3, restitution=0.5) | change
    with pytest.raises(InputError) as caught:
        solve_impact(ImpactProblem(**numbers))
    assert caught.value.field == field
    assert caught.value.value is not None
    for word in (field, *words):
        assert word in str(caught.value)


def test_unknown_names():
    with pytest.raises(pinimpact.UnknownNameError, match=r"'stronge'.*energetic") as caught:
        solve_impact(ImpactProblem(W, V, 0.3, 0.5, law="stronge"))
    assert (caught.value.field, caught.value.value) == ("law", "stronge")
    with pytest.raises(pinimpact.UnknownNameError, match=r"'newmark'.*exact") as caught:
        solve_impact(ImpactProblem(W, V, 0.3, 0.5), method="newmark")
    assert caught.value.field == "method"
    with pytest.raises(pinimpact.UnknownNameError, match="steps"):
        solve_impact(ImpactProblem(W, V, 0.3, 0.5), steps=10)
    with pytest.raises(pinimpact.UnknownNameError, match="'stronge'"):
        solve_impacts([W], [V], 0.3, 0.5, law="stronge")


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_unstoppable_approach(law, friction):
    """For c = 0 a normal impulse does not change v₃."""
    with pytest.raises(pinimpact.UnstoppableApproachError, match="-1") as caught:
        solve_impact(ImpactProblem(np.diag([1.0, 2.0, 0.0]), V, friction, 0.5, law))
    assert caught.value.field == "velocity"
    with pytest.raises(pinimpact.UnstoppableApproachError, match="cannot move along the normal"):
        solve_impact(ImpactProblem(np.zeros((3, 3)), V, friction, 0.5, law))


def test_approach_of_locked_sticking_contact_raises():
    """W has rank two and v is not in its range, so v₃ stays negative while the contact sticks."""
    locked = np.array([[1.0, 0, 1], [0, 1, 0], [1, 0, 1]])
    with pytest.raises(pinimpact.UnstoppableApproachError, match="give less friction"):
        solve_impact(ImpactProblem(locked, [0.0, 0.0, -1.0], 2.0, 0.5))
    assert solve_impact(ImpactProblem(locked, [0.0, 0.0, -1.0], 0.5, 0.5)).status.ok


@pytest.mark.parametrize("law", LAWS)
def test_no_impact(law):
    """Separating contact, or closed contact at rest with positive normal acceleration."""
    for v3 in (0.0, 0.25):
        solution = solve_impact(ImpactProblem(W, [1.0, 0.5, v3], 0.3, 0.5, law))
        assert solution.status == Status.NO_IMPACT
        assert solution.velocity.tolist() == [1.0, 0.5, v3]
        assert solution.impulse.tolist() == [0.0, 0.0, 0.0]
        assert solution.segments == ()
        assert solution.work.total == 0
        assert solution.effects == ()


def test_flags_and_their_descriptions():
    locked = np.array([[1.0, 0, 1], [0, 2, 0], [1, 0, 1]])
    kinds = {
        Flag.LOCKED | Flag.STICK | Flag.SINGULAR_DELASSUS: ImpactProblem(locked, [-1, 0.5, -1], 3.0, 0.5),
        Flag.JAM | Flag.IMPACT_WITHOUT_COLLISION: ImpactProblem(
            [[1.2, 0, 1], [0, 8, 0], [1, 0, 1]], [1.0, 0.5, 0.0], 1.5, 0.5
        ),
        Flag.SECOND_COMPRESSION: ImpactProblem(
            [[1.2, 0, 1], [0, 8, 0], [1, 0, 1]], [0.5, 12, -0.54], 1.5, 1.0
        ),
        Flag.SLIP_RESUMED: ImpactProblem([[1, 0, 0.9], [0, 1, 0], [0.9, 0, 1]], [-0.1, 0.0, -1], 0.3, 0.5),
    }
    for expected, problem in kinds.items():
        solution = solve_impact(problem)
        assert expected & solution.flags == expected
        sentences = solution.flags.describe()
        assert len(sentences) == int(solution.flags).bit_count()
        assert all(s[0].isupper() and s.endswith(".") for s in sentences)
        assert str(solution.status).endswith(".")
    assert Flag.NONE.describe() == ()
    assert Flag(np.int64(8)) is Flag.STICK  # as arrays hold them


@pytest.mark.parametrize(
    ("problem", "record", "effects"),
    [
        (ImpactProblem(np.diag([1, 2, 1]), [1, 2, -1], 0.0, 0.0), False, ()),
        (ImpactProblem(np.diag([1, 2, 1]), [1, 2, -1], 0.0, 0.5), True, ("restitution", "recorded path")),
        (ImpactProblem(W, [1, 2, -1], 0.0, 0.0), False, ("normal-tangential coupling",)),
        (ImpactProblem(np.diag([1, 1, 1]), [3, 0, -1], 0.5, 0.0), False, ("friction",)),
        (ImpactProblem(np.diag([1, 2, 1]), [3, 4, -1], 0.5, 0.0), False, ("friction", "spatial slip")),
        (ImpactProblem(np.diag([1, 1, 1]), [0.5, 0, -1], 1.0, 0.0), False, ("friction", "stick")),
    ],
)
def test_effects(problem, record, effects):
    assert solve_impact(problem, record=record).effects == effects


def test_jump_of_the_impact_map():
    """P₃ jumps from 1.26 to 10.1 where the second compression starts."""
    edge = [[1.2, 0, 1], [0, 8, 0], [1, 0, 1]]
    P = [solve_impact(ImpactProblem(edge, [0.5, 12, v3], 1.5, 1.0)).impulse[2] for v3 in (-0.52915, -0.5292)]
    assert sorted(P) == pytest.approx([1.26, 10.1], abs=0.05)


def test_invalid_rows_do_not_affect_others():
    good = np.stack([W, 2 * W, W])
    matrices = np.concatenate([good, [np.full((3, 3), np.nan), -W, np.diag([1.0, 1.0, 0.0]), W, W]])
    velocities = np.tile(V, (8, 1))
    velocities[6, 0] = np.inf
    friction = np.array([0.3, 0.2, 0.1, 0.3, 0.3, 0.3, 0.3, -1.0])
    batch = solve_impacts(matrices, velocities, friction, 0.5)
    alone = solve_impacts(good, velocities[:3], friction[:3], 0.5)
    assert batch.velocity[:3].tolist() == alone.velocity.tolist()
    assert batch.impulse[:3].tolist() == alone.impulse.tolist()
    assert batch.work.total[:3].tolist() == alone.work.total.tolist()
    assert [Status(s).name for s in batch.status[3:].tolist()] == [
        "INVALID_NUMBERS",
        "INDEFINITE_DELASSUS",
        "UNSTOPPABLE",
        "INVALID_NUMBERS",
        "INVALID_NUMBERS",
    ]
    for column in (batch.velocity, batch.impulse, batch.compression_impulse, batch.work.total):
        assert np.isnan(column[3:]).all()
        assert np.isfinite(column[:3]).all()


@pytest.mark.parametrize(
    ("field", "arguments"),
    [
        ("delassus", ([[W]], [V], 0.3, 0.5)),
        ("delassus", ([W, W], [V], 0.3, 0.5)),
        ("velocity", ([W], [[V]], 0.3, 0.5)),
        ("friction", ([W], [V], [0.3, 0.4], 0.5)),
        ("restitution", ([W], [V], 0.3, [[0.5]])),
        ("velocity", ([W], [["a", "b", "c"]], 0.3, 0.5)),
    ],
)
def test_batch_shapes(field, arguments):
    with pytest.raises(InputError, match=field) as caught:
        solve_impacts(*arguments)
    assert caught.value.field == field


@pytest.mark.parametrize("law", LAWS)
def test_threads_change_no_bit(law):
    p = random_impacts.draw(np.random.default_rng(4), "general", 101)
    problems = p.delassus, p.velocity, p.friction, p.restitution, law
    one = solve_impacts(*problems)
    for threads in (2, 3, 200):
        many = solve_impacts(*problems, threads=threads)
        for name in ("velocity", "impulse", "compression_impulse", "status", "flags", "iterations"):
            assert np.array_equal(getattr(many, name), getattr(one, name))
        assert np.array_equal(many.work.total, one.work.total)


def test_other_threads_run_while_rows_are_solved():
    p = random_impacts.draw(np.random.default_rng(4), "general", 20_000)
    solve_impacts(p.delassus[:1], p.velocity[:1], 0.3, 0.5)  # compiled
    solver = threading.Thread(target=solve_impacts, args=(p.delassus, p.velocity, p.friction, 0.5))
    solver.start()
    counted = 0
    while solver.is_alive():
        counted += 1
        time.sleep(0)
    # if the interpreter lock were held, only the start and the end would be counted
    assert counted > 50


@pytest.mark.parametrize("threads", [0, -1, 1.5, "two", None])
def test_invalid_number_of_threads_raises(threads):
    with pytest.raises(InputError, match="threads") as caught:
        solve_impacts([W], [V], 0.3, 0.5, threads=threads)
    assert caught.value.field == "threads"


def test_empty_batch():
    batch = solve_impacts(np.empty((0, 3, 3)), np.empty((0, 3)), 0.3, 0.5)
    assert len(batch) == 0
    assert batch.velocity.shape == (0, 3)


@pytest.mark.parametrize("law", LAWS)
def test_stick_and_resumed_slip_are_flagged_with_a_segment_only(law):
    """Slip that stops exactly at the end of the impact is not followed by sticking."""
    at_the_end = ImpactProblem(np.diag([1.0, 1.0, 1.0]), [0.5, 0.0, -1.0], 0.5, 0.0, law)
    solution = solve_impact(at_the_end)
    assert solution.velocity.tolist() == [0.0, 0.0, 0.0]
    assert [s.mode for s in solution.segments] == ["slip"]
    assert Flag.STICK not in solution.flags
    assert "stick" not in solution.effects
    with_rest = solve_impact(ImpactProblem(np.diag([1.0, 1.0, 1.0]), [0.5, 0.0, -1.0], 0.5, 0.5, law))
    assert Flag.STICK in with_rest.flags
    assert with_rest.segments[-1].mode == "stick"


@pytest.mark.parametrize("method", ["exact", "euler", "adaptive"])
@pytest.mark.parametrize(
    "problem",
    [
        ImpactProblem(np.eye(3), [0.5, 0.0, -1.0], 0.5, 0.0),  # slip stops at the end of the impact
        ImpactProblem(np.eye(3), [0.0, 0.0, -1.0], 0.5, 0.5),  # sticks from the start
        ImpactProblem([[1, 0, 0.9], [0, 1, 0], [0.9, 0, 1]], [-0.1, 0.0, -1], 0.3, 0.5),
        ImpactProblem(W, V, 0.3, 0.5, "newton"),
    ],
)
def test_recorded_points_are_distinct(problem, method):
    path = solve_impact(problem, method, record=True).path
    assert (np.diff(path.normal_impulse) > 0).all()


@pytest.mark.parametrize("method", ["exact", "euler", "solve_ivp"])
@pytest.mark.parametrize("copied", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_solutions_can_be_pickled_and_copied(method, copied):
    options = {"steps": 50} if method == "euler" else {}
    solution = solve_impact(ImpactProblem(W, V, 0.3, 0.5, "energetic"), method, record=True, **options)
    other = copied(solution)  # before any attribute is computed
    assert other.velocity.tolist() == solution.velocity.tolist()
    assert other.segments == solution.segments
    assert other.work == solution.work
    assert other.path.impulse.tolist() == solution.path.impulse.tolist()
    assert (other.status, other.flags, other.effects) == (solution.status, solution.flags, solution.effects)


@pytest.mark.parametrize("copied", [lambda x: pickle.loads(pickle.dumps(x)), copy.deepcopy])
def test_batches_can_be_pickled_and_copied(copied):
    batch = solve_impacts([W, W], [V, 2 * V], 0.3, 0.5)
    other = copied(batch)
    assert other.impulse.tolist() == batch.impulse.tolist()
    assert other.work.total.tolist() == batch.work.total.tolist()


@pytest.mark.parametrize("field", ["delassus", "velocity", "friction", "restitution"])
def test_none_raises(field):
    arguments = dict(delassus=[W], velocity=[V], friction=0.3, restitution=0.5) | {field: None}
    with pytest.raises(InputError, match=f"{field}: None given; an array of real numbers") as caught:
        solve_impacts(**arguments)
    assert caught.value.field == field
    one = dict(delassus=W, velocity=V, friction=0.3, restitution=0.5) | {field: None}
    with pytest.raises(InputError, match=field) as caught:
        solve_impact(ImpactProblem(**one))
    assert caught.value.field == field


def test_single_precision_is_named_as_the_reason():
    singular = np.array([[1.0, 2.0, 3.0]]).T @ [[1.0, 2.0, 3.0]] / 7.0 + np.diag([0.0, 0.0, -1e-7])
    for matrix, word in ((W + 1e-7 * np.tri(3), "symmetric"), (singular, "semidefinite")):
        with pytest.raises(InputError, match=rf"{word}.*float32.*double precision") as caught:
            solve_impact(ImpactProblem(matrix.astype(np.float32), V, 0.3, 0.5))
        assert caught.value.field == "delassus"
        with pytest.raises(InputError) as caught:
            solve_impact(ImpactProblem(matrix, V, 0.3, 0.5))
        assert "float32" not in str(caught.value)


def test_laws_are_described():
    from pinimpact.contact_space.laws import _LAWS, law_code

    for law in _LAWS:
        assert _LAWS[law_code(law.name)] is law
        assert law.equation
        assert law.summary


@pytest.mark.parametrize("law", LAWS)
def test_law_satisfies_its_equation(law):
    """The quantity of restitution that the registry names reaches its goal."""
    from pinimpact.contact_space.laws import COUNTED

    e = 0.6
    solution = solve_impact(ImpactProblem(W, V, 0.3, e, law))
    restored = {
        "impulse": (solution.impulse[2] - solution.compression_impulse, e * solution.compression_impulse),
        "work": (solution.work.restitution, -(e**2) * solution.work.compression),
        "velocity": (solution.velocity[2], -e * V[2]),
    }
    gained, goal = restored[COUNTED[LAWS.index(law)]]
    assert gained == pytest.approx(goal, rel=1e-12)
