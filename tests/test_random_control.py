"""Robots under joint PD control, drawn by seeds that failed in earlier versions."""

from __future__ import annotations

import pytest

from pinimpact import simulate

from .random_control import DURATION, draw, violation_in


@pytest.mark.parametrize(
    "seed",
    [
        2000015,  # joints at incipient slip beside a sticking contact
        1000008,  # feet at rest, with joints held by dry friction
        2000252,  # a joint whose load equals its dry friction up to rounding, beside a frictionless contact
        1000095,
        1000249,
        1000281,
        1000293,  # joints that begin to slip when contacts close
        3000051,
        3000009,  # the next modes lead back to the previous ones
        4000053,
        5000092,  # a nearly redundant row: if the rank is too low, the joint moves
        1000142,
        1000026,  # joints that begin to slip while contacts are nearly redundant
        4000311,  # bounces lower than the gap that is taken as zero
        86000207,  # a stretched arm held by its tip and by dry friction: ill-conditioned forces
        91000145,  # a joint begins to slip, and its velocity is reversed when another joint stops
        179000872,  # a joint moved by two tips at rest against its dry friction, slower than the tolerance
        # feet that turn about several corners only under the forces of their modes
        pytest.param(61000205, marks=pytest.mark.exhaustive),
    ],
)
@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
def test_modes_settle(seed):
    run = draw(seed)
    trajectory = simulate(run.scene, run.q, run.v, DURATION, rtol=run.rtol, atol=1e-2 * run.rtol)
    assert trajectory.t[-1] == DURATION
    assert violation_in(trajectory, run.rtol) == ""


def test_contact_keeps_sliding_if_sticking_would_accelerate_joint_against_its_friction():
    """Otherwise the modes cycle, and ten intervals are crossed by time steps. (theory.md, 11.5)"""
    run = draw(9801000098)
    trajectory = simulate(run.scene, run.q, run.v, DURATION, rtol=run.rtol, atol=1e-2 * run.rtol)
    assert not trajectory.stepped


@pytest.mark.parametrize("seed", [1000285, 1000348])
def test_no_contact_pulls_beside_joint_supported_by_dry_friction_and_stop(seed):
    """Non-unique forces are admissible if any solution is, even if that of least norm is not."""
    run = draw(seed)
    trajectory = simulate(run.scene, run.q, run.v, DURATION, rtol=run.rtol, atol=1e-2 * run.rtol)
    assert violation_in(trajectory, run.rtol) == ""


@pytest.mark.parametrize(
    ("seed", "evaluations"),
    [
        (2000010, 10_000),  # stiff damping, slowly moving joints, a margin near zero
        (5000171, 20_000),  # stiff drives and stiff damping
    ],
)
def test_stiff_control_of_slow_joints_takes_few_evaluations(seed, evaluations):
    run = draw(seed)
    trajectory = simulate(run.scene, run.q, run.v, DURATION, rtol=run.rtol, atol=1e-2 * run.rtol)
    assert violation_in(trajectory, run.rtol) == ""
    assert trajectory.statistics["evaluations"] < evaluations
