"""Events of a user's own, against closed forms."""

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
    """A point mass falls freely from 1 m."""
    return run(Scene(slider(), events=events), start, v, duration, **options)


def times(trajectory):
    return [record.time for record in trajectory.events]


# ---- when


@pytest.mark.parametrize("level", [0.999, 0.75, 0.3])
def test_a_falling_point_crosses_a_height(level):
    trajectory = fall([Event(height(level))])
    (record,) = trajectory.events
    assert record.time == pytest.approx(math.sqrt(2 * (1.0 - level) / G), abs=1e-12)
    assert record.name == "guard"
    assert record.q[2] == pytest.approx(level, abs=1e-14)
    assert record.v_before[2] == pytest.approx(-math.sqrt(2 * G * (1.0 - level)), abs=1e-12)
    assert np.array_equal(record.v_before, record.v_after)


def test_the_guard_has_changed_its_sign_at_the_event_and_not_before():
    guard = height(0.6)
    trajectory = fall([guard])
    (time,) = times(trajectory)
    assert guard(time, *trajectory.at(time)) <= 0.0
    assert guard(time - 1e-15, *trajectory.at(time - 1e-15)) >= -1e-16


def test_a_pendulum_passes_zero():
    """From rest at θ₀ the first passage is K(sin²(θ₀/2))/ω, then every 2K/ω."""
    angle, omega = 2.0, math.sqrt(G)
    quarter = ellipk(math.sin(angle / 2) ** 2) / omega
    scene = Scene(pendulum(), events=[lambda t, q, v: q[0]])
    trajectory = run(scene, [angle], [0.0], 6.0, rtol=1e-13, atol=1e-14)
    assert times(trajectory) == pytest.approx(
        [quarter * (2 * k + 1) for k in range(len(trajectory.events))], abs=1e-12
    )
    assert len(trajectory.events) == math.floor(6.0 / (2 * quarter) + 0.5)


def test_a_pendulum_turns():
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


def test_time_is_a_guard_too():
    trajectory = fall([lambda t, q, v: t - 0.125])
    assert times(trajectory) == [0.125]


def test_motion_is_the_same_to_the_bit_with_events_that_only_tell():
    alone = fall([])
    watched = fall([Event(height(0.9), callback=lambda t, q, v: None), lambda t, q, v: v[2] + 1.0])
    assert len(watched.events) == 2
    assert np.array_equal(alone.t, watched.t)
    assert np.array_equal(alone.q, watched.q)
    assert alone.statistics == watched.statistics


@pytest.mark.parametrize(("direction", "expected"), [(0, 2), (1, 1), (-1, 1)])
def test_the_direction_counts(direction, expected):
    """Thrown up at 3 m/s it passes 1.2 m upwards, then downwards."""
    trajectory = fall([Event(height(1.2), direction=direction)], 0.6, v=[0, 0, 3.0])
    root = math.sqrt(9.0 - 2 * G * 0.2)
    up, down = (3.0 - root) / G, (3.0 + root) / G
    wanted = {0: [up, down], 1: [up], -1: [down]}[direction]
    assert len(trajectory.events) == expected
    assert times(trajectory) == pytest.approx(wanted, abs=1e-12)


def test_several_events_come_in_order_of_time():
    """In one step, given in another order, two of them at one time."""
    levels = [0.7, 0.95, 0.4, 0.95]
    events = [Event(height(level), name=f"{k}") for k, level in enumerate(levels)]
    trajectory = fall(events)
    assert [record.name for record in trajectory.events] == ["1", "3", "0", "2"]
    wanted = [math.sqrt(2 * (1.0 - level) / G) for level in sorted(levels, reverse=True)]
    assert times(trajectory) == pytest.approx(wanted, abs=1e-12)


def test_a_wrong_way_before_another_event_does_not_hide_the_right_way_after_it():
    """sin 40t falls, then an event, then it rises: all within one step."""
    events = [
        Event(lambda t, q, v: math.sin(40 * t + 2.0), direction=1, name="rises"),
        Event(lambda t, q, v: t - 0.07, name="between"),
    ]
    trajectory = fall(events, 0.125, max_step=0.125)
    assert [record.name for record in trajectory.events] == ["between", "rises"]
    assert times(trajectory) == pytest.approx([0.07, (2 * math.pi - 2.0) / 40], abs=1e-14)


def test_a_guard_is_asked_often_while_nothing_moves():
    """sin ωt over a body at rest, whose steps grow: 0.3 s between its zeros, 0.08 s between the questions."""
    scene = Scene(
        slider(), [Contact("point", Plane())], events=lambda t, q, v: math.sin(t / 0.3 * math.pi + 0.1)
    )
    trajectory = simulate(scene, np.zeros(3), REST, 40.0)
    wanted = 0.3 * (np.arange(1, 134) - 0.1 / math.pi)
    assert times(trajectory) == pytest.approx(wanted, abs=1e-13)


def test_zero_at_the_start_is_no_event():
    assert times(fall([height(1.0), Event(lambda t, q, v: v[2], name="rest")])) == []


# ---- what happens


def test_a_terminal_event_ends_the_run():
    trajectory = fall([Event(height(0.5), terminal=True, name="half way")])
    expected = math.sqrt(1.0 / G)
    assert trajectory.t[-1] == pytest.approx(expected, abs=1e-12)
    assert trajectory.q[-1, 2] == pytest.approx(0.5, abs=1e-14)
    assert trajectory.termination == "The event 'half way' ended the run."
    assert not trajectory.complete
    assert trajectory.at(trajectory.t[-1])[0][2] == trajectory.q[-1, 2]


def test_a_terminal_number_is_how_often():
    scene = Scene(pendulum(), events=[Event(lambda t, q, v: q[0], terminal=3)])
    trajectory = run(scene, [0.5], [0.0], 60.0, rtol=1e-12, atol=1e-13)
    quarter = ellipk(math.sin(0.25) ** 2) / math.sqrt(G)
    assert len(trajectory.events) == 3
    assert trajectory.t[-1] == pytest.approx(5 * quarter, abs=1e-10)


def test_plain_functions_carry_the_attributes_of_scipy():
    guard = height(1.2)
    guard.terminal, guard.direction = True, -1
    trajectory = fall([guard], 2.0, v=[0, 0, 3.0])
    assert trajectory.t[-1] == pytest.approx((3.0 + math.sqrt(9.0 - 2 * G * 0.2)) / G, abs=1e-12)


def test_a_callback_gives_a_kick():
    """At half height it is thrown up with 2 m/s and 1 m/s across; its energy stays accounted for."""

    def kick(t, q, v):
        return [1.0, 0.0, 2.0]

    trajectory = fall([Event(height(0.5), kick, direction=-1, name="kick")], 0.6)
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


def test_a_callback_is_called_once_with_arrays_of_its_own():
    seen = []

    def spoil(t, q, v):
        seen.append((t, q.copy(), v.copy()))
        q[:] = v[:] = np.nan

    def guard(t, q, v):
        value = q[2] - 0.5
        q[:] = v[:] = np.nan
        return value

    trajectory = fall([Event(guard, spoil)])
    assert len(seen) == 1
    assert seen[0][1][2] == pytest.approx(0.5, abs=1e-14)
    assert np.isfinite(trajectory.q).all()
    assert trajectory.q[-1, 2] == pytest.approx(1.0 - 0.5 * G * 0.4**2, abs=1e-10)


def test_a_kick_into_a_surface_collides():
    """A ball that lies on a floor is thrown down: it bounces with e times that."""
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


def test_an_impact_that_changes_the_sign_is_where_the_event_happens():
    """v_z of a ball that bounces turns upwards at the impact, downwards at the top."""
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


def test_an_event_at_the_instant_of_an_impact_comes_with_it():
    """The gap itself as a guard: its event is at the impact if anywhere, and the impact is resolved."""
    first = math.sqrt(2.0 / G)
    events = [Event(lambda t, q, v: q[2] - 0.1, lambda t, q, v: [1.0, 0, v[2], 0, 0, 0], direction=-1)]
    contact = Contact("center", Plane(), radius=0.1, restitution=0.5)
    trajectory = run(Scene(ball(), [contact], events=events), [0, 0, 1.1, *UP], np.zeros(6), 0.6)
    assert [impact.time for impact in trajectory.impacts] == pytest.approx([first], abs=1e-9)
    assert trajectory.q[-1, 2] > 0.1
    kicks = len(trajectory.events)
    assert kicks <= 1
    assert times(trajectory) == pytest.approx([first] * kicks, abs=1e-9)
    assert trajectory.v[-1, 0] == pytest.approx(1.0 * kicks, abs=1e-12)


def test_a_callback_that_turns_its_own_guard_happens_once_at_an_instant():
    """A floor of one's own: the velocity is reversed where it falls through 0.5 m."""
    event = Event(lambda t, q, v: q[2] - 0.5, lambda t, q, v: -v, direction=-1, name="floor")
    turns = Event(lambda t, q, v: v[2], name="turns")
    trajectory = fall([event, turns], 1.5)
    hit = math.sqrt(1.0 / G)
    floor = [record.time for record in trajectory.events if record.name == "floor"]
    assert floor == pytest.approx([hit, 3 * hit], abs=1e-9)
    turned = [record.time for record in trajectory.events if record.name == "turns"]
    assert turned == pytest.approx([hit, 2 * hit, 3 * hit, 4 * hit], abs=1e-9)


def test_a_slip_that_ends_is_left_to_the_scene_and_told_by_the_event():
    """A block slides to rest at v₀/(μ g); the guard sees its speed sink below a tenth before."""
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
    trajectory = fall([Event(height(0.5), lambda t, q, v: v + 1.0, name="kick"), height(0.8)])
    trajectory.save(tmp_path / "run.npz")
    for other in (Trajectory.load(tmp_path / "run.npz"), pickle.loads(pickle.dumps(trajectory))):
        assert [(one.time, one.name) for one in other.events] == [
            (one.time, one.name) for one in trajectory.events
        ]
        for one, same in zip(other.events, trajectory.events, strict=True):
            for field in ("q", "v_before", "v_after"):
                assert np.array_equal(getattr(one, field), getattr(same, field))


def test_the_plan_has_a_line_for_them_and_they_can_be_left_out():
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
def test_what_is_no_event_is_refused(events, message):
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
def test_an_event_of_nonsense_is_refused(fields, message):
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
def test_an_error_in_a_guard_or_callback_is_what_the_user_sees(event, message):
    with pytest.raises(SimulationError, match=f"^events: {message}") as caught:
        simulate(Scene(slider(), events=[event]), START, REST, 0.4)
    assert caught.value.field == "events"
    assert caught.value.partial.t[-1] <= 0.4


def test_an_interrupt_in_a_guard_ends_the_run_as_from_the_keyboard():
    def guard(t, q, v):
        if t > 0.1:
            raise KeyboardInterrupt
        return 1.0

    trajectory = simulate(Scene(slider(), events=[guard]), START, REST, 0.4)
    assert trajectory.termination == "Interrupted from the keyboard."
    assert 0.0 < trajectory.t[-1] <= 0.1
    assert trajectory.at(trajectory.t[-1])[0][2] == trajectory.q[-1, 2]


def test_events_on_a_robot_that_turns_in_space():
    """A body that spins about z: its x axis passes the plane y = 0 each half turn."""
    scene = Scene(
        ball(), events=[lambda t, q, v: pin.SE3(pin.XYZQUATToSE3(q)).rotation[1, 0]], without=["gravity"]
    )
    trajectory = run(scene, [0, 0, 0, 0, 0, math.sin(0.5), math.cos(0.5)], [0, 0, 0, 0, 0, 3.0], 4.0)
    assert times(trajectory) == pytest.approx([(k * math.pi - 1.0) / 3.0 for k in (1, 2, 3, 4)], abs=1e-10)
