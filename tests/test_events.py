"""User events, against closed forms."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pinocchio as pin
import pytest
from scipy.special import ellipj, ellipk

from pinimpact import Contact, Event, InputError, Plane, Scene, SimulationError, Trajectory, simulate

from .scene_models import UP, G, ball, pendulum, run, slider

START, REST = np.array([0.0, 0.0, 1.0]), np.zeros(3)


def height(value):
    def guard(t, q, v):
        return q[2] - value

    return guard


def fall(events, duration=0.4, start=START, v=REST, **options):
    """Simulate the free fall of a point mass from 1 m."""
    return run(Scene(slider(), events=events), start, v, duration, **options)


def times(trajectory):
    return [record.time for record in trajectory.events]


# ---- times of events


@pytest.mark.parametrize("level", [0.999, 0.75, 0.3])
def test_falling_point_crosses_height(level):
    trajectory = fall([Event(height(level))])
    (record,) = trajectory.events
    assert record.time == pytest.approx(math.sqrt(2 * (1.0 - level) / G), abs=1e-12)
    assert record.name == "guard"
    assert record.q[2] == pytest.approx(level, abs=1e-14)
    assert record.v_before[2] == pytest.approx(-math.sqrt(2 * G * (1.0 - level)), abs=1e-12)
    assert np.array_equal(record.v_before, record.v_after)


def test_guard_changes_sign_exactly_at_the_event():
    guard = height(0.6)
    trajectory = fall([guard])
    (time,) = times(trajectory)
    assert guard(time, *trajectory.at(time)) <= 0.0
    assert guard(time - 1e-15, *trajectory.at(time - 1e-15)) >= -1e-16


def test_pendulum_passes_zero():
    """From rest at θ₀ the first passage is K(sin²(θ₀/2))/ω, then every 2K/ω."""
    angle, omega = 2.0, math.sqrt(G)
    quarter = ellipk(math.sin(angle / 2) ** 2) / omega
    scene = Scene(pendulum(), events=[lambda t, q, v: q[0]])
    trajectory = run(scene, [angle], [0.0], 6.0, rtol=1e-13, atol=1e-14)
    assert times(trajectory) == pytest.approx(
        [quarter * (2 * k + 1) for k in range(len(trajectory.events))], abs=1e-12
    )
    assert len(trajectory.events) == math.floor(6.0 / (2 * quarter) + 0.5)


def test_pendulum_reverses():
    angle, omega = 1.0, math.sqrt(G)
    m = math.sin(angle / 2) ** 2
    half = 2 * ellipk(m) / omega
    scene = Scene(pendulum(), events=[lambda t, q, v: v[0]])
    trajectory = run(scene, [angle], [0.0], 5.0, rtol=1e-12, atol=1e-13)
    assert times(trajectory) == pytest.approx(
        [half * (k + 1) for k in range(len(trajectory.events))], abs=1e-10
    )
    sine = math.sqrt(m) * ellipj(ellipk(m) - omega * 0.5, m)[0]
    assert trajectory.at(0.5)[0][0] == pytest.approx(2 * math.asin(sine), abs=1e-10)


def test_guard_of_time():
    trajectory = fall([lambda t, q, v: t - 0.125])
    assert times(trajectory) == [0.125]


def test_events_without_effect_leave_motion_bitwise_equal():
    alone = fall([])
    watched = fall([Event(height(0.9), callback=lambda t, q, v: None), lambda t, q, v: v[2] + 1.0])
    assert len(watched.events) == 2
    assert np.array_equal(alone.t, watched.t)
    assert np.array_equal(alone.q, watched.q)
    assert alone.statistics == watched.statistics


@pytest.mark.parametrize(("direction", "expected"), [(0, 2), (1, 1), (-1, 1)])
def test_direction_selects_crossings(direction, expected):
    """With an initial velocity of 3 m/s the mass passes 1.2 m upwards, then downwards."""
    trajectory = fall([Event(height(1.2), direction=direction)], 0.6, v=[0, 0, 3.0])
    root = math.sqrt(9.0 - 2 * G * 0.2)
    up, down = (3.0 - root) / G, (3.0 + root) / G
    wanted = {0: [up, down], 1: [up], -1: [down]}[direction]
    assert len(trajectory.events) == expected
    assert times(trajectory) == pytest.approx(wanted, abs=1e-12)


def test_several_events_are_in_order_of_time():
    """Events within one step, declared in another order, two of them at the same time."""
    levels = [0.7, 0.95, 0.4, 0.95]
    events = [Event(height(level), name=f"{k}") for k, level in enumerate(levels)]
    trajectory = fall(events)
    assert [record.name for record in trajectory.events] == ["1", "3", "0", "2"]
    wanted = [math.sqrt(2 * (1.0 - level) / G) for level in sorted(levels, reverse=True)]
    assert times(trajectory) == pytest.approx(wanted, abs=1e-12)


def test_crossing_in_wrong_direction_does_not_hide_later_crossing():
    """Within one step the guard has a falling zero, then another event occurs, then a rising zero."""
    events = [
        Event(lambda t, q, v: math.sin(40 * t + 2.0), direction=1, name="rises"),
        Event(lambda t, q, v: t - 0.07, name="between"),
    ]
    trajectory = fall(events, 0.125, max_step=0.125)
    assert [record.name for record in trajectory.events] == ["between", "rises"]
    assert times(trajectory) == pytest.approx([0.07, (2 * math.pi - 2.0) / 40], abs=1e-14)


def test_guard_is_sampled_often_although_body_is_at_rest():
    """The zeros of the guard are 0.3 s apart; steps of the body at rest grow, samples stay 0.08 s apart."""
    scene = Scene(
        slider(), [Contact("point", Plane())], events=lambda t, q, v: math.sin(t / 0.3 * math.pi + 0.1)
    )
    trajectory = simulate(scene, np.zeros(3), REST, 40.0)
    wanted = 0.3 * (np.arange(1, 134) - 0.1 / math.pi)
    assert times(trajectory) == pytest.approx(wanted, abs=1e-13)


def test_zero_guard_at_start_is_not_an_event():
    assert times(fall([height(1.0), Event(lambda t, q, v: v[2], name="rest")])) == []


# ---- effects of events


def test_terminal_event_ends_run():
    trajectory = fall([Event(height(0.5), terminal=True, name="half way")])
    expected = math.sqrt(1.0 / G)
    assert trajectory.t[-1] == pytest.approx(expected, abs=1e-12)
    assert trajectory.q[-1, 2] == pytest.approx(0.5, abs=1e-14)
    assert trajectory.termination == "The event 'half way' ended the run."
    assert not trajectory.complete
    assert trajectory.at(trajectory.t[-1])[0][2] == trajectory.q[-1, 2]


def test_terminal_number_counts_events():
    scene = Scene(pendulum(), events=[Event(lambda t, q, v: q[0], terminal=3)])
    trajectory = run(scene, [0.5], [0.0], 60.0, rtol=1e-12, atol=1e-13)
    quarter = ellipk(math.sin(0.25) ** 2) / math.sqrt(G)
    assert len(trajectory.events) == 3
    assert trajectory.t[-1] == pytest.approx(5 * quarter, abs=1e-10)


def test_functions_with_scipy_attributes():
    guard = height(1.2)
    guard.terminal, guard.direction = True, -1
    trajectory = fall([guard], 2.0, v=[0, 0, 3.0])
    assert trajectory.t[-1] == pytest.approx((3.0 + math.sqrt(9.0 - 2 * G * 0.2)) / G, abs=1e-12)


def test_callback_changes_velocity():
    """At half height the callback sets a velocity of 2 m/s upwards and 1 m/s sideways."""

    def set_velocity(t, q, v):
        return [1.0, 0.0, 2.0]

    trajectory = fall([Event(height(0.5), set_velocity, direction=-1, name="set_velocity")], 0.6)
    (record,) = trajectory.events
    hit = math.sqrt(1.0 / G)
    assert record.time == pytest.approx(hit, abs=1e-12)
    assert record.v_before == pytest.approx([0, 0, -G * hit], abs=1e-12)
    assert record.v_after == pytest.approx([1.0, 0.0, 2.0], abs=0)
    after = 0.6 - hit
    assert trajectory.q[-1] == pytest.approx([after, 0.0, 0.5 + 2 * after - 0.5 * G * after**2], abs=1e-10)
    before, later = trajectory.at(record.time, side="left")[1], trajectory.at(record.time)[1]
    assert before == pytest.approx(record.v_before, abs=1e-14)
    assert later == pytest.approx(record.v_after, abs=0)


def test_callback_is_called_once_with_copies():
    seen = []

    def overwrite(t, q, v):
        seen.append((t, q.copy(), v.copy()))
        q[:] = v[:] = np.nan

    def guard(t, q, v):
        value = q[2] - 0.5
        q[:] = v[:] = np.nan
        return value

    trajectory = fall([Event(guard, overwrite)])
    assert len(seen) == 1
    assert seen[0][1][2] == pytest.approx(0.5, abs=1e-14)
    assert np.isfinite(trajectory.q).all()
    assert trajectory.q[-1, 2] == pytest.approx(1.0 - 0.5 * G * 0.4**2, abs=1e-10)


def test_callback_towards_surface_causes_impact():
    """A resting ball is given a downward velocity, and rebounds with e times its magnitude."""
    scene = Scene(
        ball(),
        [Contact("center", Plane(), radius=0.1, restitution=0.5)],
        events=[Event(lambda t, q, v: t - 0.1, lambda t, q, v: [0, 0, -2.0, 0, 0, 0])],
    )
    trajectory = run(scene, [0, 0, 0.1, *UP], np.zeros(6), 0.2)
    (impact,) = [one for one in trajectory.impacts if one.time > 0]
    assert impact.time == 0.1
    assert impact.v_before[2] == -2.0
    assert impact.v_after[2] == pytest.approx(1.0, abs=1e-14)
    assert trajectory.q[-1, 2] == pytest.approx(0.1 + 0.1 - 0.5 * G * 0.01, abs=1e-10)


def test_sign_change_by_impact_is_an_event_at_the_impact():
    """v_z of a bouncing ball becomes positive at the impact and negative at the top."""
    scene = Scene(
        ball(),
        [Contact("center", Plane(), radius=0.1, restitution=0.8)],
        events=[Event(lambda t, q, v: v[2], name="turns")],
    )
    trajectory = run(scene, [0, 0, 1.1, *UP], np.zeros(6), 0.9)
    first = math.sqrt(2.0 / G)
    assert [impact.time for impact in trajectory.impacts] == pytest.approx([first], abs=1e-10)
    assert times(trajectory) == pytest.approx([first, first + 0.8 * first], abs=1e-10)
    assert trajectory.events[0].time == trajectory.impacts[0].time
    assert trajectory.events[0].v_before[2] == pytest.approx(0.8 * G * first, abs=1e-9)


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
@pytest.mark.parametrize("terminal", [False, True])
def test_sign_change_by_impact_may_change_velocity_or_end_the_run(scheme, terminal):
    def kick(t, q, v):
        return v + np.array([1.0, 0, 0, 0, 0, 0])

    up = Event(lambda t, q, v: v[2], None if terminal else kick, terminal=terminal, direction=1, name="up")
    scene = Scene(ball(), [Contact("center", Plane(), radius=0.1, restitution=0.8)], events=[up])
    motion = simulate(scene, [0, 0, 1.1, *UP], np.zeros(6), 0.8, scheme=scheme)
    first = math.sqrt(2.0 / G)
    assert times(motion) == pytest.approx([first], abs=1e-9)
    assert motion.t[-1] == pytest.approx(first if terminal else 0.8, abs=1e-9)
    left = motion.t[-1] - first
    expected = [0.0 if terminal else left, 0.0, 0.1 + 0.8 * G * first * left - 0.5 * G * left**2]
    np.testing.assert_allclose(motion.q[-1, :3], expected, atol=1e-8)


def test_event_at_the_time_of_an_impact():
    """With the gap as guard, an event may occur only at the impact, which is resolved."""
    first = math.sqrt(2.0 / G)
    events = [Event(lambda t, q, v: q[2] - 0.1, lambda t, q, v: [1.0, 0, v[2], 0, 0, 0], direction=-1)]
    contact = Contact("center", Plane(), radius=0.1, restitution=0.5)
    trajectory = run(Scene(ball(), [contact], events=events), [0, 0, 1.1, *UP], np.zeros(6), 0.6)
    assert [impact.time for impact in trajectory.impacts] == pytest.approx([first], abs=1e-9)
    assert trajectory.q[-1, 2] > 0.1
    count = len(trajectory.events)
    assert count <= 1
    assert times(trajectory) == pytest.approx([first] * count, abs=1e-9)
    assert trajectory.v[-1, 0] == pytest.approx(1.0 * count, abs=1e-12)


def test_callback_that_reverses_its_guard_is_called_once():
    """The callback acts as a floor: it reverses the velocity at a height of 0.5 m."""
    event = Event(lambda t, q, v: q[2] - 0.5, lambda t, q, v: -v, direction=-1, name="floor")
    turns = Event(lambda t, q, v: v[2], name="turns")
    trajectory = fall([event, turns], 1.5)
    hit = math.sqrt(1.0 / G)
    floor = [record.time for record in trajectory.events if record.name == "floor"]
    assert floor == pytest.approx([hit, 3 * hit], abs=1e-9)
    turned = [record.time for record in trajectory.events if record.name == "turns"]
    assert turned == pytest.approx([hit, 2 * hit, 3 * hit, 4 * hit], abs=1e-9)


@pytest.mark.parametrize("scheme", ["event-driven", "time-stepping"])
@pytest.mark.parametrize("e", [1.0, 0.5])
def test_callback_that_turns_the_motion_back_is_called_once_per_arrival(scheme, e):
    """The guard reaches zero and returns: between its walls the point moves at constant speeds."""

    def rebound(t, q, v):
        return np.array([-e * v[0], 0.0, 0.0])

    walls = [
        Event(lambda t, q, v: q[0] - 0.2, rebound, name="right"),
        Event(lambda t, q, v: q[0] + 0.1, rebound, name="left"),
    ]
    model = slider()
    model.gravity = pin.Motion.Zero()
    trajectory = simulate(Scene(model, events=walls), np.zeros(3), [0.7, 0, 0], 1.9, scheme=scheme)
    t, speed, wanted = 0.2 / 0.7, 0.7, []
    while t < 1.9:
        wanted.append(t)
        speed *= e
        t += 0.3 / speed
    assert times(trajectory) == pytest.approx(wanted, abs=1e-12)
    assert abs(trajectory.v[-1, 0]) == pytest.approx(0.7 * e ** len(wanted), rel=1e-12)


def test_event_before_end_of_slip():
    """A block slides to rest at v₀/(μ g); before, its speed decreases to 0.1 m/s."""
    scene = Scene(
        slider(),
        [Contact("point", Plane(), friction=0.5)],
        events=[Event(lambda t, q, v: v[0] - 0.1, name="slow")],
    )
    trajectory = run(scene, [0, 0, 0], [1.0, 0, 0], 0.5)
    assert times(trajectory) == pytest.approx([0.9 / (0.5 * G)], abs=1e-10)
    assert trajectory.v[-1] == pytest.approx([0, 0, 0], abs=1e-12)


# ---- records, plan, errors


def test_events_are_saved_and_pickled(tmp_path):
    trajectory = fall([Event(height(0.5), lambda t, q, v: v + 1.0, name="set_velocity"), height(0.8)])
    trajectory.save(tmp_path / "run.npz")
    for other in (Trajectory.load(tmp_path / "run.npz"), pickle.loads(pickle.dumps(trajectory))):
        assert [(one.time, one.name) for one in other.events] == [
            (one.time, one.name) for one in trajectory.events
        ]
        for one, same in zip(other.events, trajectory.events, strict=True):
            for field in ("q", "v_before", "v_after"):
                assert np.array_equal(getattr(one, field), getattr(same, field))


def test_plan_lists_events_and_without_omits_them():
    scene = Scene(slider(), events=[Event(height(0.5), name="half"), height(0.2)])
    assert scene.plan()["user events"].reason == "located: half, guard"
    assert not Scene(slider()).plan()["user events"].on
    without = Scene(slider(), events=[height(0.5)], without=["user events"])
    assert without.plan().switched_off == ("user events",)
    assert times(run(without, START, REST, 0.4)) == []


@pytest.mark.parametrize(
    ("events", "message"),
    [
        (3, "events: 3 is neither an Event nor a function"),
        ([3], "events: 3 is neither an Event nor a function"),
        ([height(0.1), height(0.2)], "events: 2 events are called 'guard'; give each its own name="),
    ],
)
def test_invalid_events_raise(events, message):
    with pytest.raises(InputError, match=message):
        Scene(slider(), events=events)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"guard": 1}, "guard=1 given; a function"),
        ({"callback": 1}, "callback=1 given; a function"),
        ({"terminal": "yes"}, "terminal='yes' given; True, False or how often"),
        ({"terminal": -1}, "terminal=-1 given"),
        ({"direction": "up"}, "direction='up' given; 1 "),
        ({"direction": math.nan}, "direction=nan given"),
    ],
)
def test_invalid_event_fields_raise(fields, message):
    with pytest.raises(InputError, match=f"events: {message}"):
        Event(**{"guard": height(0.5), **fields})


def zero_division(t, q, v):
    return 1 / 0 if t > 0.1 else 1.0


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (
            Event(zero_division),
            "ZeroDivisionError in the guard of 'zero_division' at t = .* s: division by zero",
        ),
        (Event(lambda t, q, v: math.nan, name="bad"), "nan returned by the guard of 'bad' at t = 0 s"),
        (Event(lambda t, q, v: None, name="bad"), "InputError in the guard of 'bad' .*None given"),
        (Event(height(0.9), zero_division), "ZeroDivisionError in the callback of 'guard' at t = 0.14"),
        (Event(height(0.9), lambda t, q, v: [1.0, 2.0]), "InputError in the callback of 'guard' .*shape"),
        (Event(height(0.9), lambda t, q, v: [1.0, 2.0, math.inf]), "InputError in the callback of 'guard'"),
    ],
)
def test_errors_in_guard_or_callback_are_reported(event, message):
    with pytest.raises(SimulationError, match=f"^events: {message}") as caught:
        simulate(Scene(slider(), events=[event]), START, REST, 0.4)
    assert caught.value.field == "events"
    assert caught.value.partial.t[-1] <= 0.4


def test_interrupt_in_guard_ends_run():
    def guard(t, q, v):
        if t > 0.1:
            raise KeyboardInterrupt
        return 1.0

    trajectory = simulate(Scene(slider(), events=[guard]), START, REST, 0.4)
    assert trajectory.termination == "Interrupted from the keyboard."
    assert 0.0 < trajectory.t[-1] <= 0.1
    assert trajectory.at(trajectory.t[-1])[0][2] == trajectory.q[-1, 2]


def test_events_of_rotating_body():
    """The x axis of a body that spins about z crosses the plane y = 0 every half turn."""
    scene = Scene(
        ball(), events=[lambda t, q, v: pin.SE3(pin.XYZQUATToSE3(q)).rotation[1, 0]], without=["gravity"]
    )
    trajectory = run(scene, [0, 0, 0, 0, 0, math.sin(0.5), math.cos(0.5)], [0, 0, 0, 0, 0, 3.0], 4.0)
    assert times(trajectory) == pytest.approx([(k * math.pi - 1.0) / 3.0 for k in (1, 2, 3, 4)], abs=1e-10)
