"""States of a motion are starts of others: what time steps leave of overlap is removed, and no error."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from pinimpact import Contact, InputError, Plane, Scene, SteppedWarning, Stepper, simulate

from .scene_models import UP, ball, pendulum
from .test_time_stepping import boxes

SIZE = 0.2, 0.2, 0.1
CONTINUING = "time-stepping", "auto"


@pytest.fixture(autouse=True)
def _stepped_without_a_word():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SteppedWarning)
        yield


def landing():
    """Return two boxes that fall onto the floor and onto each other, and their motion in time steps."""
    scene = boxes(2, SIZE, 1.0)
    q0 = [0, 0, 0.06, *UP, 0.02, 0.01, 0.175, *UP]
    return scene, simulate(scene, q0, np.zeros(12), 0.3, scheme="time-stepping")


def lowest(scene, trajectory, t):
    """Return the least height of the boxes over what they land on [m]."""
    z = trajectory.at(t)[0][2::7]
    return min(z[0] - 0.05, z[1] - z[0] - 0.1)


@pytest.mark.parametrize("scheme", CONTINUING)
def test_what_overlaps_within_a_step_comes_to_rest_where_the_motion_does(scheme):
    scene, whole = landing()
    times = np.linspace(0.0, 0.2, 400)
    depths = -np.array([lowest(scene, whole, t) for t in times])
    deepest = times[[np.argmax(depths), *np.flatnonzero(depths > 1e-7)[::4]]]
    assert depths.max() > 1e-5  # else there is nothing to test
    for t in deepest:
        again = simulate(scene, *whole.at(t), 0.3, scheme=scheme)
        assert again.complete
        # located, the upper box hits the lower one beside its middle and makes it rock and slip a little
        np.testing.assert_allclose(again.q[-1], whole.q[-1], atol=2e-5 if scheme == "time-stepping" else 2e-4)
        assert lowest(scene, again, 0.3) > -1e-8
        assert np.abs(again.v[-1]).max() < 1e-7
        assert np.abs(again.energy.residual).max() < 1e-9 * again.energy.total[0]


def test_what_is_lifted_out_of_overlap_gains_its_weight_times_the_height():
    scene = Scene(ball(), [Contact("center", Plane(), radius=0.1)])
    depth = 3e-5
    for scheme in CONTINUING:
        run = simulate(scene, [0, 0, 0.1 - depth, *UP], np.zeros(6), 0.01, scheme=scheme)
        assert run.q[-1, 2] == pytest.approx(0.1, abs=1e-9)
        energy = run.energy
        assert energy.impacts[-1] == pytest.approx(energy.potential[-1] - energy.potential[0], rel=1e-6)
        assert energy.impacts[-1] > 0.0
        assert np.abs(energy.residual).max() < 1e-6 * energy.impacts[-1]


def test_a_joint_beyond_its_limit_by_what_a_step_leaves_starts():
    model = pendulum()
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -0.5, 0.5
    scene = Scene(model)
    for scheme in CONTINUING:
        run = simulate(scene, [0.5 + 1e-3], [2.0], 0.05, scheme=scheme)
        assert run.q[5:].max() <= 0.5 + 1e-6
        with pytest.raises(InputError, match=r"starts 0\.02 beyond its limit"):
            simulate(scene, [0.52], [2.0], 0.05, scheme=scheme)


@pytest.mark.parametrize("dt", [1e-3, 1e-4])
def test_how_deep_a_start_may_be_is_what_a_step_may_leave(dt):
    """It is the approach over dt, and 4 dt² g."""
    scene = Scene(ball(), [Contact("center", Plane(), radius=0.1)])
    for speed in (0.0, 1.0):
        left = 1e-8 * 0.1 + dt * (speed + 4.0 * dt * 9.80665)
        v0 = [0, 0, -speed, 0, 0, 0]
        for scheme in CONTINUING:
            assert simulate(scene, [0, 0, 0.1 - 0.99 * left, *UP], v0, 2 * dt, scheme=scheme, dt=dt).complete
            with pytest.raises(InputError, match=r"below its surface; start with every contact on or above"):
                simulate(scene, [0, 0, 0.1 - 1.1 * left, *UP], v0, 2 * dt, scheme=scheme, dt=dt)


def test_a_stepper_is_reset_to_a_state_within_a_step():
    scene, whole = landing()
    times = np.linspace(0.0, 0.2, 400)
    state = whole.at(times[np.argmin([lowest(scene, whole, t) for t in times])])
    stepper = Stepper(scene, *state, scheme="time-stepping")
    stepper.step(np.zeros(12), 0.05)
    after = stepper.q
    stepper.reset(*state)
    twin = stepper.copy()
    for one in (stepper, twin):
        one.step(np.zeros(12), 0.05)
        np.testing.assert_array_equal(one.q, after)


def test_the_event_driven_scheme_names_the_one_that_starts_there():
    scene = boxes(2, SIZE, 1.0)
    for shift in ([0, 0], [0, -1e-5], [-1e-5, -1e-5]):
        q0 = np.array([0, 0, 0.05, *UP, 0.02, 0.01, 0.15, *UP])
        q0[2::7] += shift
        if not any(shift):
            assert simulate(scene, q0, np.zeros(12), 0.01, scheme="event-driven").complete
            continue
        with pytest.raises(InputError, match=r'1e-05 m .*scheme="auto"'):
            simulate(scene, q0, np.zeros(12), 0.01, scheme="event-driven")
        with pytest.raises(InputError, match=r'scheme="auto"'):
            Stepper(scene, q0, np.zeros(12), scheme="event-driven")


def test_a_copy_before_the_first_step_knows_what_overlaps():
    scene = boxes(1, SIZE, 1.0)
    stepper = Stepper(scene, [0, 0, 0.05 - 1e-5, *UP], np.zeros(6))
    twin = stepper.copy()
    for one in (stepper, twin):
        one.step(np.zeros(6), 0.02)
        assert one.trajectory.stepped[0].start == 0.0
        assert one.q[2] == pytest.approx(0.05, abs=1e-9)


def test_small_robots_start_where_rounding_leaves_them():
    """A gap is closed to 1e-12 m, which is more than 4e-12 of a small robot's size."""
    scene = boxes(3, (8e-4, 2.4e-3, 4.8e-3), 1e-5)
    rng = np.random.default_rng(0)
    for _ in range(20):
        q0 = np.tile([0, 0, 2.4e-3, *UP], 3)
        q0[::7], q0[2::7] = 2.8e-3 * np.arange(3), 2.4e-3 - rng.uniform(0.0, 9e-13, 3)
        assert simulate(scene, q0, np.zeros(18), 1e-3, scheme="event-driven").complete


def test_what_touches_at_the_start_of_time_steps_touches_nowhere_else():
    """A box is thrown off another one, on which it starts, and bounces beside it."""
    scene = boxes(2, SIZE, 1.0, restitution=0.5, between=0.0)
    q0, v0 = np.array([0, 0, 0.05, *UP, 0, 0, 0.15, *UP]), np.zeros(12)
    v0[6:9] = 2.0, 0.0, 1.0
    run = simulate(scene, q0, v0, 0.8, scheme="time-stepping")
    beside = [impact for impact in run.impacts if impact.q[7] > 0.2]
    assert beside
    assert {impact.source.split()[0] for impact in beside} == {"floor"}
    assert np.abs(run.q[-1, :3] - q0[:3]).max() < 1e-9
