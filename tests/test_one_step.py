"""Impacts in one step: Moreau's law and the convex relaxation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

import pinimpact
from pinimpact import studies
from pinimpact.app.scene_loader import load_scene
from pinimpact.studies.one_step import ONE_STEP, solve_one_step


def random_impacts(seed: int, count: int = 200):
    """Return W, v, μ and e of random impacts; about one in ten sticks."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(count, 3, 3))
    velocity = rng.normal(size=(count, 3))
    velocity[:, 2] = -np.abs(velocity[:, 2])
    W = root @ root.transpose(0, 2, 1) + 0.3 * np.eye(3)
    return W, velocity, rng.uniform(0.05, 0.8, count), rng.uniform(0.0, 0.9, count)


@pytest.mark.parametrize("model", ONE_STEP)
def test_solutions_satisfy_the_laws(model: str) -> None:
    W, v, mu, e = random_impacts(1)
    found = solve_one_step(W, v, mu, e, model)
    P, after = found.impulse, found.velocity
    assert after == pytest.approx(v + np.einsum("nij,nj->ni", W, P))
    slip = np.hypot(after[:, 0], after[:, 1])
    sticks = found.flags != 0
    assert 10 < sticks.sum() < 190
    assert slip[sticks] == pytest.approx(0.0, abs=1e-12)
    assert (np.hypot(P[:, 0], P[:, 1]) <= mu * P[:, 2] * (1.0 + 1e-12)).all()
    along = -(mu * P[:, 2] / slip)[:, None] * after[:, :2]
    assert P[~sticks, :2] == pytest.approx(along[~sticks], abs=1e-11)
    normal = mu * slip if model == "convex" else np.zeros(len(v))
    assert after[:, 2] + e * v[:, 2] == pytest.approx(normal, abs=1e-11)


@pytest.mark.parametrize("model", ONE_STEP)
def test_neighbouring_roots_of_the_direction_of_slip(model: str) -> None:
    """W of condition numbers up to 10⁶ and friction up to 10: two roots can be close together."""
    rng = np.random.default_rng(0)
    count = 3000
    root = rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(-1.5, 1.5, (count, 1, 3))
    v = rng.normal(size=(count, 3))
    v[:, 2] = -np.abs(v[:, 2])
    W, mu = root @ root.transpose(0, 2, 1), 10.0 ** rng.uniform(-1.0, 1.0, count)
    found = solve_one_step(W, v, mu, np.full(count, 0.5), model)
    assert np.isfinite(found.impulse).all()
    P, slides = found.impulse, found.flags == 0
    terms = np.abs(v).max(axis=1) + np.einsum("nij,nj->ni", np.abs(W), np.abs(P)).max(axis=1)
    slip = found.velocity[:, :2]
    size = np.hypot(*slip.T)
    against = P[:, :2] * size[:, None] + mu[:, None] * P[:, 2:] * slip
    assert (np.abs(against).max(axis=1) <= 1e-9 * terms * P[:, 2])[slides].all()
    normal = found.velocity[:, 2] + 0.5 * v[:, 2] - (mu * size if model == "convex" else 0.0)
    assert (np.abs(normal) <= 1e-9 * (1.0 + mu) * terms)[slides].all()


def test_convex_model_minimizes_energy_in_the_cone() -> None:
    W, v, mu, e = random_impacts(2, 20)
    found = solve_one_step(W, v, mu, e, "convex").impulse
    for k in range(len(v)):
        c = v[k] * [1.0, 1.0, 1.0 + e[k]]
        cone = {"type": "ineq", "fun": lambda P, mu=mu[k]: mu * P[2] - np.sqrt(P[0] ** 2 + P[1] ** 2 + 1e-30)}
        best = minimize(
            lambda P, W=W[k], c=c: 0.5 * P @ W @ P + c @ P,
            *([0.0, 0.0, 0.1],),
            constraints=cone,
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        )
        assert found[k] == pytest.approx(best.x, abs=1e-6)


@pytest.mark.parametrize("model", ONE_STEP)
def test_derivatives_against_difference_quotients(model: str) -> None:
    W, v, mu, e = random_impacts(3)
    turned = np.random.default_rng(4).normal(size=(3, 3))
    turned += turned.T
    h = 1e-6

    def slope(dW, dmu: float, de: float):
        ends = [solve_one_step(W + s * dW, v, mu + s * dmu, e + s * de, model).impulse for s in (h, -h)]
        return (ends[0] - ends[1]) / (2.0 * h)

    by = solve_one_step(W, v, mu, e, model).derivatives
    assert by.dP_dfriction == pytest.approx(slope(0.0 * turned, 1.0, 0.0), abs=1e-7)
    assert by.dP_drestitution == pytest.approx(slope(0.0 * turned, 0.0, 1.0), abs=1e-7)
    assert np.einsum("nkij,ij->nk", by.dP_ddelassus, turned) == pytest.approx(
        slope(turned, 0.0, 0.0), abs=1e-7
    )


@pytest.mark.parametrize("friction", [0.1, 5.0])
def test_moreau_agrees_with_path_for_slip_of_constant_direction(friction: float) -> None:
    rng = np.random.default_rng(5)
    W = np.array([np.diag([t, t, n]) for t, n in rng.uniform(0.5, 2.0, (50, 2))])
    v = rng.normal(size=(50, 3))  # half of them are separating
    path = pinimpact.solve_impacts(W, v, friction, 0.4)
    found = solve_one_step(W, v, np.full(50, friction), np.full(50, 0.4), "moreau")
    assert found.impulse == pytest.approx(path.impulse, abs=1e-13)
    assert ((found.flags != 0) == ((path.flags & pinimpact.Flag.STICK) != 0)).all()


@pytest.mark.parametrize("model", ONE_STEP)
@pytest.mark.parametrize("tangential", [0.0, 1.0])
def test_unstoppable_approach_has_no_solution(model: str, tangential: float) -> None:
    W, v = np.diag([1.0, 1.0, 0.0])[None], np.array([[tangential, 0.0, -1.0]])
    found = solve_one_step(W, v, np.full(1, 0.3), np.zeros(1), model)
    assert np.isnan(found.impulse).all()
    assert found.status[0] == pinimpact.Status.UNSTOPPABLE


@pytest.mark.parametrize("model", ONE_STEP)
def test_approach_in_range_of_singular_matrix_sticks(model: str) -> None:
    root = np.array([[1.0, 0.2], [0.3, 1.0], [0.1, 0.9]])
    W, v = (root @ root.T)[None], (root @ [0.2, -1.0])[None]
    found = solve_one_step(W, v, np.full(1, 5.0), np.zeros(1), model)
    assert found.flags[0] == pinimpact.Flag.STICK
    assert found.velocity[0] == pytest.approx(0.0, abs=1e-15)


def test_fits_of_laws_are_compared_by_name() -> None:
    W, v = random_impacts(6, 150)[:2]
    after = pinimpact.solve_impacts(W, v, 0.3, 0.5).velocity
    after += 0.01 * np.random.default_rng(7).normal(size=after.shape)
    group = np.arange(150) // 3
    fits = {law: studies.identify((W, v, after), law=law, group=group) for law in ("poisson", *ONE_STEP)}
    assert fits["poisson"].x == pytest.approx([0.3, 0.5], abs=0.01)
    for law in ONE_STEP:
        difference = studies.compare(fits["poisson"], fits[law])
        assert difference.interval.shape == (1, 2)
        assert difference.interval[0, 1] < 0.0, law
        assert fits[law].fun.shape == fits["poisson"].fun.shape
    with pytest.raises(pinimpact.InputError, match="belong to data other"):
        studies.compare(fits["poisson"], studies.identify((W, v, after)))
    with pytest.raises(pinimpact.UnknownNameError, match="moreau"):
        fits["moreau"].apply(load_scene("solo12_landing").scene)
