"""Robots under joint PD control: seeds at which modes once did not settle, or contacts pulled."""

from __future__ import annotations

import pytest

from pinimpact import simulate

from .random_control import DURATION, draw, violation_in


@pytest.mark.parametrize(
    "seed",
    [
        2000015,  # joints about to break away beside a contact that sticks
        1000008,  # feet that have come to rest under joints that dry friction holds
        2000252,  # a joint that dry friction holds to rounding, beside a contact without friction
        1000095,
        1000249,
        1000281,
        1000293,  # joints that break away as contacts close
        3000051,
        3000009,  # modes ahead that lead back
        4000053,
        5000092,  # a row that hardly differs from others, of which a rank taken too low let the joint move
        1000142,
        1000026,  # joints that break away in a motion of all but redundant contacts
        4000311,  # bounces lower than a gap that counts as none
        86000207,  # a stretched arm whose tip and dry joints hold it, and whose forces are hardly determined
        91000145,  # a joint that is let go, and thrown against its friction as another one stops
        179000872,  # a joint that two tips at rest carry along against its dry friction, slower than an error
        # feet that turn on several corners: by other forces than those of the modes they would not
        pytest.param(61000205, marks=pytest.mark.exhaustive),
    ],
)
@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
def test_modes_settle(seed):
    run = draw(seed)
    trajectory = simulate(run.scene, run.q, run.v, DURATION, rtol=run.rtol, atol=1e-2 * run.rtol)
    assert trajectory.t[-1] == DURATION
    assert violation_in(trajectory, run.rtol) == ""


def test_a_contact_keeps_sliding_whose_sticking_would_accelerate_a_joint_against_its_friction():
    """Else its modes do not settle, and time steps cross ten intervals. (theory.md, 11.5)"""
    run = draw(9801000098)
    trajectory = simulate(run.scene, run.q, run.v, DURATION, rtol=run.rtol, atol=1e-2 * run.rtol)
    assert not trajectory.stepped


@pytest.mark.parametrize("seed", [1000285, 1000348])
def test_no_contact_pulls_beside_a_joint_whose_dry_friction_and_stop_share_its_load(seed):
    """Forces that are not unique are within their bounds where any are, not where those of least norm are."""
    run = draw(seed)
    trajectory = simulate(run.scene, run.q, run.v, DURATION, rtol=run.rtol, atol=1e-2 * run.rtol)
    assert violation_in(trajectory, run.rtol) == ""


@pytest.mark.parametrize(
    ("seed", "evaluations"),
    [
        (2000010, 10_000),  # damping that is stiff, joints that creep, a margin next to zero
        (5000171, 20_000),  # drives and damping that are stiff, of which only drives were implicit
    ],
)
def test_what_is_stiff_and_slow_takes_few_evaluations(seed, evaluations):
    run = draw(seed)
    trajectory = simulate(run.scene, run.q, run.v, DURATION, rtol=run.rtol, atol=1e-2 * run.rtol)
    assert violation_in(trajectory, run.rtol) == ""
    assert trajectory.statistics["evaluations"] < evaluations
