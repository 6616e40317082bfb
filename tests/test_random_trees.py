"""Motions of further robots and of random trees of joints complete and obey the laws of contact."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pinimpact import simulate
from tests import random_trees
from tests.lawful import law_violation
from tests.random_control import violation_in

SEEDS = tuple(402_000_000 + k for k in (2, 5, 6, 8, 9, 11, 12, 13))


@pytest.mark.parametrize("seed", SEEDS)
def test_motions_complete_and_obey_laws(seed: int) -> None:
    _, scene, q, v, rtol = random_trees.draw(seed)
    trajectory = simulate(scene, q, v, 0.5, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.t[-1] == 0.5
    assert violation_in(trajectory, rtol) == ""
    assert law_violation(scene, trajectory, rtol, seed) == ""


def test_all_kinds_of_joints_are_drawn_and_mass_matrices_are_right() -> None:
    kinds = set()
    for seed in range(40):
        model, q, tips = random_trees.tree(np.random.default_rng(seed))
        assert tips
        kinds |= {joint.shortname() for joint in model.joints[1:]}
        data = model.createData()
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        pin.computeJointJacobians(model, data, q)
        summed = np.zeros_like(mass)
        for j in range(1, model.njoints):
            jacobian = pin.getJointJacobian(model, data, j, pin.LOCAL)
            summed += jacobian.T @ model.inertias[j].matrix() @ jacobian
        assert mass == pytest.approx(summed, abs=1e-12 * np.abs(summed).max())
    assert len(kinds) == 1 + len(random_trees.JOINTS)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
def test_events_accumulate_although_stiff_joints_settle_after_each() -> None:
    """Axes of the neck are nearly aligned at 0.606 s: a light link settles within 1e-10 s of each event."""
    _, scene, q, v, rtol = random_trees.draw(68_000_000_125)
    trajectory = simulate(scene, q, v, 0.61, rtol=rtol, atol=1e-2 * rtol)
    assert trajectory.t[-1] == 0.61
    assert trajectory.statistics["steps"] < 10_000
    assert violation_in(trajectory, rtol) == ""
