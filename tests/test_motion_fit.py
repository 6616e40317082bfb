"""Identification of friction and restitution from whole motions."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from pinimpact import InputError, UnknownNameError, simulate, studies
from pinimpact.studies.motion_fit import SAMPLES, _residual, _without_jumps
from pinimpact.studies.rolling_out import differences, starts_of

from .test_recorded_impacts import box_scene, recorded, toss


@pytest.fixture(scope="module")
def motions():
    rng, scene = np.random.default_rng(4), box_scene(0.25, 0.4)
    return [recorded(toss(scene, rng, 0.35), rng, sigma=(1e-5, 1e-4)) for _ in range(5)]


@pytest.mark.slow
def test_fit_of_simulated_tosses(motions) -> None:
    """From wrong initial values the fit converges to the true 0.25 and 0.4, within the noise."""
    scene = box_scene(0.5, 0.1)
    free = {"friction": (0.05, 0.6), "restitution": (0.0, 0.8)}
    with ThreadPoolExecutor(1) as pool:
        fit = studies.identify(scene=scene, free=free, trajectories=motions[:3], executor=pool)
    assert fit.x == pytest.approx([0.25, 0.4], abs=5e-3)
    assert fit.apply(scene).contacts[3].friction == fit.x[0]
    assert fit.groups == 3


@pytest.mark.slow
def test_intervals_of_fit_with_restarts_contain_the_true_coefficients(motions) -> None:
    free = {"friction": (0.05, 0.6), "restitution": (0.0, 0.8)}
    fit = studies.identify(scene=box_scene(0.5, 0.1), free=free, trajectories=motions, restart=True)
    assert not fit.unidentified
    assert fit.x == pytest.approx([0.25, 0.4], abs=5e-3)
    low, high = fit.interval(0.999).T
    assert (low < [0.25, 0.4]).all()
    assert (high > [0.25, 0.4]).all()
    assert (high - low < 0.05).all()


@pytest.mark.parametrize(("jump", "has_interval"), [(0.0, True), (1e-4, True), (0.1, False)])
def test_no_interval_if_motions_jump(jump, has_interval) -> None:
    """One residual has a step at x, by which its difference quotient dominates the information on y."""
    result = studies.Identified(
        x=np.array([0.5, 0.5]),
        names=("friction", "restitution"),
        covariance=np.eye(2),
        unidentified=(),
    )

    def residual(y):
        return np.array([[y[0] + jump * (y[0] > 0.5), y[1]], [y[0] ** 3, y[1]], [2 * y[0], y[1] ** 3]])

    x, h = result.x, 1e-3 * np.eye(2)
    ahead = np.stack([residual(x + step) - residual(x) for step in h], axis=2)
    behind = np.stack([residual(x) - residual(x - step) for step in h], axis=2)
    _without_jumps(result, ahead, behind)
    assert bool(np.isfinite(result.covariance[0, 0])) is has_interval
    assert result.covariance[1, 1] == 1.0
    assert len(result.unidentified) == (not has_interval)
    if not has_interval:
        assert result.unidentified[0].startswith("friction has no interval: ")
        assert "1 motions" in result.unidentified[0]
        assert result.covariance[0, 1] == 0.0


def test_residuals_are_distances_of_poses(motions) -> None:
    """|r|² is the mean over frames of |shift|² and rotation² weighted by inertia/m."""
    scene = box_scene(0.25, 0.4)
    (start,) = starts_of(scene, motions[:1], False, "trajectories")
    inertia = scene.model.inertias[1].inertia / scene.model.inertias[1].mass
    found = _residual(scene, np.linalg.cholesky(inertia), start)
    frames = np.linspace(0, len(start.t) - 1, SAMPLES).round().astype(int)
    off, turn = differences(scene, start, frames)
    body = start.rotation[frames].inv().apply(turn)
    energy = (off**2).sum(axis=1) + np.einsum("ni,ij,nj->n", body, inertia, body)
    assert found @ found == pytest.approx(energy.mean(), rel=1e-12)
    run = simulate(scene, start.q, start.v, start.t[-1])
    assert np.linalg.norm(off[-1]) == pytest.approx(
        np.linalg.norm(_com(scene, run.at(run.t[-1])[0]) - start.com[-1]), rel=1e-9
    )


def _com(scene, q):
    import pinocchio as pin

    return pin.centerOfMass(scene.model, scene.model.createData(), q)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"scene": None}, "trajectories= needs the scene"),
        ({"group": [1, 2]}, "group: given beside trajectories="),
        ({"executor": 2}, "executor: 2 given; None or a concurrent.futures.Executor expected"),
        ({"free": {"stiffening": (0, 1)}}, "free: 'stiffening' is not a parameter"),
        ({"law": "hertz"}, "law: 'hertz' is not a restitution law"),
        ({"restart": "no"}, "restart: 'no'"),
    ],
)
def test_bad_input(motions, changed, message) -> None:
    arguments = {"scene": box_scene(), "trajectories": motions} | changed
    with pytest.raises((InputError, UnknownNameError)) as caught:
        studies.identify(**arguments)
    assert message in str(caught.value)


def test_parameter_of_one_contact_is_set_for_that_contact() -> None:
    scene = box_scene()
    fit = studies.Identified(
        names=("friction:corner 2",), x=np.array([0.9]), law=None, setters={"friction": _set}
    )
    assert fit.apply(scene).contacts[2] == replace(scene.contacts[2], friction=0.9)


@pytest.mark.parametrize("names", [("friction", "friction:corner 2"), ("friction:corner 2", "friction")])
def test_parameter_of_one_contact_overrides_that_of_all_in_any_order(names) -> None:
    x = np.array([0.9 if ":" in name else 0.3 for name in names])
    fit = studies.Identified(names=names, x=x, law=None, setters={"friction": _set})
    contacts = fit.apply(box_scene()).contacts
    assert [contact.friction for contact in contacts] == [0.3, 0.3, 0.9, 0.3, 0.3, 0.3, 0.3, 0.3]


def _set(scene, name, value):
    from pinimpact.studies.estimate import set_coefficient

    return set_coefficient(scene, name, value)
