"""States of a motion as initial states: the penetration that time steps leave is accepted and corrected."""

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
    """Return a scene of two boxes that fall onto the floor and onto each other, and its motion."""
    scene = boxes(2, SIZE, 1.0)
    q0 = [0, 0, 0.06, *UP, 0.02, 0.01, 0.175, *UP]
    return scene, simulate(scene, q0, np.zeros(12), 0.3, scheme="time-stepping")


def lowest(scene, trajectory, t):
    """Return the smallest gap between the boxes and the surfaces below them [m]."""
    z = trajectory.at(t)[0][2::7]
    return min(z[0] - 0.05, z[1] - z[0] - 0.1)


@pytest.mark.parametrize("scheme", CONTINUING)
def test_run_started_with_penetration_reaches_the_same_rest(scheme):
    scene, whole = landing()
    times = np.linspace(0.0, 0.2, 400)
    depths = -np.array([lowest(scene, whole, t) for t in times])
    deepest = times[[np.argmax(depths), *np.flatnonzero(depths > 1e-7)[::4]]]
    assert depths.max() > 1e-5
    for t in deepest:
        again = simulate(scene, *whole.at(t), 0.3, scheme=scheme)
        assert again.complete
        # with located events the upper box hits the lower one off centre, which then rocks and slips a little
        np.testing.assert_allclose(again.q[-1], whole.q[-1], atol=2e-5 if scheme == "time-stepping" else 2e-4)
        assert lowest(scene, again, 0.3) > -1e-8
        assert np.abs(again.v[-1]).max() < 1e-7
        assert np.abs(again.energy.residual).max() < 1e-9 * again.energy.total[0]


def test_energy_of_penetration_correction_is_weight_times_height():
    scene = Scene(ball(), [Contact("center", Plane(), radius=0.1)])
    depth = 3e-5
    for scheme in CONTINUING:
        run = simulate(scene, [0, 0, 0.1 - depth, *UP], np.zeros(6), 0.01, scheme=scheme)
        assert run.q[-1, 2] == pytest.approx(0.1, abs=1e-9)
        energy = run.energy
        assert energy.impacts[-1] == pytest.approx(energy.potential[-1] - energy.potential[0], rel=1e-6)
        assert energy.impacts[-1] > 0.0
        assert np.abs(energy.residual).max() < 1e-6 * energy.impacts[-1]


def test_start_slightly_beyond_joint_limit_is_accepted():
    model = pendulum()
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -0.5, 0.5
    scene = Scene(model)
    for scheme in CONTINUING:
        run = simulate(scene, [0.5 + 1e-3], [2.0], 0.05, scheme=scheme)
        assert run.q[5:].max() <= 0.5 + 1e-6
        with pytest.raises(InputError, match=r"starts 0\.02 beyond its limit"):
            simulate(scene, [0.52], [2.0], 0.05, scheme=scheme)


@pytest.mark.parametrize("dt", [1e-3, 1e-4])
def test_accepted_initial_penetration(dt):
    """The limit is the approach velocity times dt, plus 4 g dt²."""
    scene = Scene(ball(), [Contact("center", Plane(), radius=0.1)])
    for speed in (0.0, 1.0):
        left = 1e-8 * 0.1 + dt * (speed + 4.0 * dt * 9.80665)
        v0 = [0, 0, -speed, 0, 0, 0]
        for scheme in CONTINUING:
            assert simulate(scene, [0, 0, 0.1 - 0.99 * left, *UP], v0, 2 * dt, scheme=scheme, dt=dt).complete
            with pytest.raises(InputError, match=r"above its surface; pinimpact\.place_in_contact finds"):
                simulate(scene, [0, 0, 0.1 - 1.1 * left, *UP], v0, 2 * dt, scheme=scheme, dt=dt)


def test_stepper_resets_to_state_within_a_step():
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


def test_event_driven_scheme_refers_to_time_stepping():
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


def test_copy_before_first_step_includes_penetration():
    scene = boxes(1, SIZE, 1.0)
    stepper = Stepper(scene, [0, 0, 0.05 - 1e-5, *UP], np.zeros(6))
    twin = stepper.copy()
    for one in (stepper, twin):
        one.step(np.zeros(6), 0.02)
        assert one.trajectory.stepped[0].start == 0.0
        assert one.q[2] == pytest.approx(0.05, abs=1e-9)


def test_small_robots_start_with_rounding_errors_of_gaps():
    """Gaps have errors of 1e-12 m, more than 4e-12 of the size of a small robot."""
    scene = boxes(3, (8e-4, 2.4e-3, 4.8e-3), 1e-5)
    rng = np.random.default_rng(0)
    for _ in range(20):
        q0 = np.tile([0, 0, 2.4e-3, *UP], 3)
        q0[::7], q0[2::7] = 2.8e-3 * np.arange(3), 2.4e-3 - rng.uniform(0.0, 9e-13, 3)
        assert simulate(scene, q0, np.zeros(18), 1e-3, scheme="event-driven").complete


def test_contact_at_start_does_not_persist_elsewhere():
    """A box starts on another one, flies off, and bounces beside it."""
    scene = boxes(2, SIZE, 1.0, restitution=0.5, between=0.0)
    q0, v0 = np.array([0, 0, 0.05, *UP, 0, 0, 0.15, *UP]), np.zeros(12)
    v0[6:9] = 2.0, 0.0, 1.0
    run = simulate(scene, q0, v0, 0.8, scheme="time-stepping")
    beside = [impact for impact in run.impacts if impact.q[7] > 0.2]
    assert beside
    assert {impact.source.split()[0] for impact in beside} == {"floor"}
    assert np.abs(run.q[-1, :3] - q0[:3]).max() < 1e-9
