"""Robots under joint PD control: seeds at which modes once came to no end, and what ends well."""

from __future__ import annotations

import pytest

from pinimpact import simulate

from .random_control import DURATION, draw, wrong_in


@pytest.mark.parametrize(
    "seed",
    [
        2000015,  # joints about to break away beside a contact that sticks
        1000008,  # feet that have come to rest under joints that dry friction holds
        2000252,  # a joint that dry friction holds to rounding, beside a contact without friction
        1000095,
        1000249,
        1000281,
    ],
)
def test_modes_settle(seed):
    run = draw(seed)
    trajectory = simulate(run.scene, run.q, run.v, DURATION, rtol=run.rtol, atol=1e-2 * run.rtol)
    assert trajectory.t[-1] == DURATION
    assert wrong_in(trajectory, run.rtol) == ""
