"""Forces by convex programs against Coulomb's law itself, written down in NumPy."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from pinimpact.scene._kernels.force_cones import forces_by_cones


@numba.njit
def solve(delassus, free, velocity, mu, held, lower, upper, x):
    """Call the kernel, which only kernels can."""
    return forces_by_cones(delassus, free, velocity, mu, held, lower, upper, x)


def contacts_at_rest(seed, contacts, velocities):
    """A system of contacts and one bounded row, of full or of deficient rank, that loads press together."""
    rng = np.random.default_rng(seed)
    rows = 3 * contacts + 1
    jacobian = rng.normal(size=(rows, velocities))
    factor = rng.normal(size=(velocities, velocities))
    inverse = factor @ factor.T / velocities + 0.1 * np.eye(velocities)
    delassus = jacobian @ inverse @ jacobian.T
    return delassus, jacobian @ rng.normal(size=velocities), rng.uniform(0.1, 0.8, size=contacts)


@pytest.mark.parametrize("velocities", [6, 20])
@pytest.mark.parametrize("contacts", [1, 2, 4])
@pytest.mark.parametrize("seed", range(10))
def test_forces_obey_coulombs_law_at_the_level_of_accelerations(seed, contacts, velocities):
    delassus, free, mu = contacts_at_rest(seed, contacts, velocities)
    bound = 0.3
    x = np.empty(3 * contacts + 1)
    accuracy = solve(
        delassus,
        free,
        np.zeros((contacts, 2)),
        mu,
        np.zeros(contacts, dtype=np.bool_),
        np.array([-bound]),
        np.array([bound]),
        x,
    )
    assert accuracy <= 1e-10
    a = delassus @ x + free
    near = 1e-8 * (1.0 + np.abs(x).max() + np.abs(a).max())
    for i in range(contacts):
        tangent, normal = x[3 * i : 3 * i + 2], x[3 * i + 2]
        slip, rise = a[3 * i : 3 * i + 2], a[3 * i + 2]
        assert normal >= -near
        assert rise >= -near
        assert abs(normal * rise) <= near
        assert np.linalg.norm(tangent) <= mu[i] * normal + near
        # friction opposes what begins to slip, with all that it has
        assert tangent @ slip == pytest.approx(-mu[i] * normal * np.linalg.norm(slip), abs=near)
    assert abs(x[-1]) <= bound + near
    assert x[-1] * a[-1] == pytest.approx(-bound * abs(a[-1]), abs=near)
