"""Batches of impacts: broadcast arguments, held contacts and locked joints, work, single rows.

The random states depend on the names of the tests.
"""

import pickle
import warnings

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact.contact_space._kernels import batch as kernels
from pinimpact.status import Status

from . import robot_cases as cases

PLANE = pinimpact.Plane(normal=(0.2, -0.1, 1.0), velocity=(0.3, 0.1, 0.0))


@pytest.fixture
def rng(request):
    return np.random.default_rng(list(request.node.name.encode()))


def arm(rng, count):
    """Return an arm, a configuration, approaching velocities (count, nv), and a contact."""
    model, data = cases.load("ur5")
    q, v = cases.random_state(model, rng)
    contact = pinimpact.Contact("tool0", PLANE, friction=0.4, restitution=0.6)
    v = cases.approaching(model, data, q, v, contact)
    return model, data, q, v * rng.uniform(0.5, 2.0, size=(count, 1)), contact


def kinetic(model, data, q, v):
    return pin.computeKineticEnergy(model, data, q, v)


@pytest.mark.parametrize("hold", ["nothing", "locked", "held"])
def test_one_configuration_and_many_velocities(hold, rng):
    """Rows agree with `impact`, and the total work is the change of kinetic energy."""
    model, data, q, v, contact = arm(rng, 6)
    keep = {}
    if hold == "locked":  # joints at rest, so that locking them does no work
        keep = {"locked": ["wrist_2_joint", 1]}
        v[:, [0, 4]] = 0.0
    if hold == "held":  # its point cannot move, so the joints below it do not either
        keep = {"held": [pinimpact.Contact("forearm_link", pinimpact.Plane(), offset=(0.1, 0, 0))]}
        v[:, :3] = 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pinimpact.HeldContactWarning)
        hits = pinimpact.impacts(model, data, q, v, contact, friction=0.3, **keep)
    surface = np.zeros(6)
    for row in range(6):
        one = pinimpact.Contact("tool0", PLANE, friction=0.3, restitution=0.6)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pinimpact.HeldContactWarning)
            hit = pinimpact.impact(model, data, q, v[row], one, **keep)
        assert hits.v[row] == pytest.approx(hit.v, abs=1e-12)
        assert hits.impulse_world[row] == pytest.approx(hit.impulse_world, abs=1e-12)
        assert hits.status[row] == hit.solution.status
        surface[row] = hit.solution.work.surface
    change = [kinetic(model, data, q, hits.v[row]) - kinetic(model, data, q, v[row]) for row in range(6)]
    assert hits.work.total == pytest.approx(change, rel=1e-10, abs=1e-11)
    assert hits.work.surface == pytest.approx(surface, abs=1e-12)
    assert np.abs(surface).max() > 1e-3
    if hold == "locked":
        assert (hits.v[:, [0, 4]] == v[:, [0, 4]]).all()


def test_many_configurations_and_works(rng):
    model, data, q, v, contact = arm(rng, 5)
    many = np.array([pin.integrate(model, q, 0.1 * rng.normal(size=model.nv)) for _ in range(5)])
    hits = pinimpact.impacts(model, data, many, v, contact)
    change = [
        kinetic(model, data, many[i], hits.v[i]) - kinetic(model, data, many[i], v[i]) for i in range(5)
    ]
    assert hits.work.total == pytest.approx(change, rel=1e-10, abs=1e-11)
    assert (hits.work.friction <= 0).all()


def test_works_of_robots_are_found_by_solving_once(rng, monkeypatch):
    model, data, q, v, contact = arm(rng, 5)
    hits, solve, calls = pinimpact.impacts(model, data, q, v, contact), kernels.solve_rows, []
    monkeypatch.setattr(kernels, "solve_rows", lambda *given: (calls.append(given), solve(*given)))
    assert hits.work.friction.shape == (5,)
    assert len(calls) == 1


def test_a_row_is_a_hit(rng):
    model, data, q, v, contact = arm(rng, 4)
    restitution = np.array([0.1, 0.2, 0.3, 0.4])
    for keep in ({}, {"locked": ["elbow_joint"]}):
        hits = pinimpact.impacts(model, data, q, v, contact, restitution=restitution, **keep)
        assert len(hits) == 4
        assert [hit.problem.restitution for hit in hits] == [0.1, 0.2, 0.3, 0.4]
        for row in (0, 2, -1):
            hit = hits[row]
            assert isinstance(hit, pinimpact.Hit)
            assert hit.v == pytest.approx(hits.v[row], abs=1e-13)
            assert hit.solution.work.total == pytest.approx(hits.work.total[row], rel=1e-9)
            assert hit.solution.segments
        again = pickle.loads(pickle.dumps(hits))
        assert again[1].v.tolist() == hits[1].v.tolist()
    with pytest.raises(IndexError, match="0 to 3"):
        hits[4]
    with pytest.raises(TypeError, match="whole number"):
        hits["first"]
    with pytest.raises(TypeError, match="whole number"):
        hits[1:3]


def test_a_row_without_answer_spoils_no_other_and_says_what_is_wrong_when_it_is_asked_for(rng):
    model, data, q, v, contact = arm(rng, 3)
    held = pinimpact.Contact("forearm_link", pinimpact.Plane())
    v[1] = np.nan
    for keep in ({}, {"locked": ["elbow_joint"]}):
        hits = pinimpact.impacts(model, data, q, v, contact, **keep)
        assert hits.status[1] == Status.INVALID_NUMBERS
        assert np.isnan(hits.v[1]).all()
        assert np.isnan(hits.work.total[1])
        assert np.isfinite(hits.work.total[[0, 2]]).all()
        with pytest.raises(pinimpact.InputError, match="v: "):
            hits[1]
    hits = pinimpact.impacts(model, data, q, v, contact, held=[held])
    assert (hits.status == Status.INVALID_NUMBERS).all()
    with pytest.raises(pinimpact.InputError, match="held: 'forearm_link on plane' moves"):
        hits[0]


def test_one_matrix_and_many_velocities():
    rng = np.random.default_rng(3)
    W = np.array([[1.3, 0.2, 0.4], [0.2, 0.8, -0.3], [0.4, -0.3, 0.9]])
    v = rng.normal(size=(7, 3)) - (0, 0, 3)
    once = pinimpact.solve_impacts(W, v, 0.3, 0.5)
    tiled = pinimpact.solve_impacts([W] * 7, v, 0.3, 0.5)
    assert once.velocity.tolist() == tiled.velocity.tolist()
    assert once.work.total.tolist() == tiled.work.total.tolist()
    mu = np.linspace(0, 1, 7)
    one_v = pinimpact.solve_impacts(W, v[0], mu, 0.5)
    assert one_v.impulse.tolist() == pinimpact.solve_impacts([W] * 7, [v[0]] * 7, mu, 0.5).impulse.tolist()
    assert len(pinimpact.solve_impacts(W, v[0], 0.3, 0.5)) == 1


@pytest.mark.parametrize("law", pinimpact.LAWS)
def test_work_computed_with_the_batch_or_later_is_identical(law):
    rng = np.random.default_rng(4)
    X = rng.normal(size=(50, 3, 4))
    v = rng.normal(size=(50, 3)) - (0, 0, 2)
    later, at_once = (
        pinimpact.solve_impacts(X @ X.transpose(0, 2, 1), v, 0.4, 0.6, law, work=work)
        for work in (False, True)
    )
    assert at_once.velocity.tolist() == later.velocity.tolist()
    assert at_once.impulse.tolist() == later.impulse.tolist()
    gained = np.einsum("ij,ij->i", later.impulse, v + later.velocity) / 2
    for batch in (later, at_once):
        assert batch.work.total == pytest.approx(gained, rel=1e-12, abs=1e-13)
        assert (batch.work.compression <= 0).all()
    assert at_once.work.friction.tolist() == later.work.friction.tolist()


def test_batches_say_what_they_hold(rng):
    W = np.eye(3)
    batch = pinimpact.solve_impacts(W, [(0, 0, -1), (0, 0, 1), (1, 0, -1)], 0.3, 0.5)
    assert repr(batch) == "BatchSolution(3 impacts: 2 SEPARATED, 1 NO_IMPACT)"
    model, data, q, v, contact = arm(rng, 1)
    assert repr(pinimpact.impacts(model, data, q, v, contact)) == "Hits(1 impact: 1 SEPARATED)"
