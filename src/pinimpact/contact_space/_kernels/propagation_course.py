"""An impact at many contacts, from event to event. (theory.md, section 14)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, INTEGERS, declared
from ..._compile.interrupts import answer_signals
from ..._compile.jit import external, inlined
from ..._numeric.loops import repeated
from ..._numeric.tolerances import LITTLE, ROUNDOFF
from .codes import HELD, NONE_YET, OPEN, SLIPPING
from .first_fall import NEVER
from .plastic import come_to_rest, end_plastically, plastic_impulses_now
from .propagation_advance import NO_ROW, advance, record, record_step, time_power
from .propagation_events import apply_events, find_events
from .propagation_friction import settle
from .propagation_series import ORDER, SHORT, Series, expand, natural_pace, unknown_after
from .propagation_slow_slip import expand_slowly, missed_slowly
from .propagation_state import BEGUN, TIED, State, System, begin_to_slip, close, loads, open_contact, stored
from .tolerances import AGREE, NEGLIGIBLE, SLIP_SPEED, SLOW

FIRST = np.int64(1)
"""Order of the series that tells the pace of slips."""

LONGEST = 1e3
"""The longest step, in units of the pace."""

STEP, EVENT, ROW, POINT, ENDED = 0, 1, 2, 3, 4
"""Places in `counts`."""

MOST_EVENTS = 200
"""Events per contact, at most, in which what is left of the approach does not fall to a half."""

PATIENCE = 16
"""Steps from one look for a slow motion to the next: as many as one look costs."""

PARTS = 0.0, LITTLE
"""Which turns of slip count as fast, in parts of the fastest: all that are, or those of the slowest slips."""

FEWEST, PLASTIC_EVENTS = 500, 4
"""Events, and those per contact, after which it is first asked, where no contact restores anything, how an
impact would end plastically. It does where it would have so at half as many events."""


@declared(
    *(System, State, Series, FLOAT_ROWS, FLOAT_ROWS, float, int, FLOAT_ROWS, INTEGERS, FLOAT_ROWS, FLOAT_ROWS)
)
@external
def follow(system, state, series, roots, room, accuracy, most_steps, works, counts, rows, path):
    """Go from event to event, with velocities of size one and κ W₃₃ ≤ 1; see `propagate`.

    Args:
        state: Before the impact; takes that after it.
        series, roots, room: Scratch, for `expand` and `find_events`.
    """
    system, state, series, works = borrowed(system), borrowed(state), borrowed(series), borrowed(works)
    counts, rows, path = borrowed(counts), borrowed(rows), borrowed(path)
    roots, room = borrowed(roots), borrowed(room)
    scratch = roots, room[0], room[1:]
    w, v, n = system.w, state.v, len(system.friction)
    plastic = not system.unloading.any()
    latest = repeated(n, NO_ROW)
    for j in range(n):
        if v[3 * j + 2] <= ROUNDOFF:
            if w[3 * j + 2, 3 * j + 2] > 0.0:
                close(system, state, j)
            elif v[3 * j + 2] < -ROUNDOFF:
                return False
    clock, at_once, slower, most_events = 0.0, 0, 0.5, MOST_EVENTS * n
    left, ends, apart = np.zeros(3 * n), np.zeros(3 * n), math.inf
    check = NONE_YET + FEWEST + PLASTIC_EVENTS * n
    counts[:] = 0
    counts[POINT] = record(path, NONE_YET, clock, state)
    while True:
        presses = _loaded(state)
        time = _next_closing(state)
        if not presses and time == NEVER:
            return True
        fastest = _fastest_approach(system, state)
        if fastest <= SLOW:
            counts[ENDED] = 1
            come_to_rest(system, state, works)
            counts[POINT] = record(path, counts[POINT], clock, state)
            return True
        if plastic and counts[EVENT] >= check:
            apart = max(apart, _moved_end(system, state, left, ends))
            if apart <= AGREE:
                counts[ENDED] = 1
                ended = end_plastically(system, state, left, works)
                if ended:
                    counts[POINT] = record(path, counts[POINT], clock, state)
                return ended
            apart, check = 0.0, 2 * counts[EVENT]
        if fastest <= slower:  # a series of impacts that dies out
            slower, most_events = 0.5 * fastest, counts[EVENT] + MOST_EVENTS * n
        if counts[ENDED] == 2 or counts[EVENT] >= most_events or counts[STEP] > most_steps * n:
            counts[ENDED] = 2
            return True
        if not presses:
            _fly(system, state, time)
            clock += time
            counts[EVENT] += 1
        unknown, inverse, weight = settle(system, state, series)
        if not _ring(system, state, unknown, inverse, series):
            at_once, clock = _go_to_event(
                *(system, state, series, (unknown, inverse, weight), scratch, accuracy, most_steps),
                *(at_once, clock, works, counts, rows, latest, path),
            )
        counts[EVENT] += 1


@inlined
def _go_to_event(
    system, state, series, forces, scratch, accuracy, most_steps, at_once, clock, works, counts, rows, latest,
    path,
):  # fmt: skip
    """Take steps up to the next event, and change the modes there.

    Args:
        system: The `System`.
        state: The `State`.
        series: Scratch for the series.
        forces: Places of the unknown forces, the matrix that solves for them, and their weights.
        scratch: Times of events, and two arrays of `find_events`.
        accuracy: See `propagate`.
        most_steps: See `propagate`.
        at_once: How many events have followed each other at once.
        clock: The time.
        works: See `propagate`.
        counts: (5,) numbers of steps, events, rows and points.
        rows: See `propagate`.
        latest: (n,) the last row of each contact.
        path: See `propagate`.

    Returns:
        `at_once` and the time at the event.
    """
    unknown, inverse, weight = forces
    roots, guard, work = scratch
    turns, most = _presses_and_slips(state), counts[STEP] + most_steps
    since, slowly, begun = 0, False, (state.fresh == BEGUN).any()
    while True:
        answer_signals()
        if turns:
            unknown, inverse, weight = unknown_after(system, state, _directions(state), weight)
        root, tied = False, since == 0 and (state.fresh == TIED).any()
        if tied:
            h, pace = _expand_onset(system, state, unknown, inverse, accuracy, series)
            tied = h > 0.0
        if not tied and (slowly or begun or since % PATIENCE == PATIENCE - 1):
            allowed = ROUNDOFF if slowly else NEGLIGIBLE
            h, pace = _expand_slow_step(system, state, unknown, inverse, accuracy, series, allowed)
            slowly, begun = h > 0.0, False
        if not (tied or slowly):
            h, pace, root = _expand_step(system, state, unknown, inverse, accuracy, series)
        counts[STEP] += 1
        since += 1
        if counts[STEP] > most:
            counts[ENDED] = 2
            return at_once, clock
        if pace == 1.0 and h >= LONGEST and _at_rest(series, state):
            _loaded_ends(state)
            return at_once, clock
        crowded = at_once > 2 * len(state.normal)
        first, degree = find_events(system, state, series, h, NEGLIGIBLE / pace, crowded, roots, guard, work)
        h = first if degree == SHORT else min(h, first)
        if h > 0.0:
            at_once = 0 if h * pace > NEGLIGIBLE else at_once
            counts[ROW] = advance(
                system, state, series, h, degree, pace, root, guard, works, rows, counts[ROW], latest
            )
            if path.shape[0] > 0:
                counts[POINT] = record_step(path, counts[POINT], clock, series, state, h, degree, pace, root)
            clock += time_power(NONE_YET, h, pace, root)
        if tied:
            _end_onset(state)
        if first <= h:
            apply_events(system, state, series, roots, first, NEGLIGIBLE / pace)
            return at_once + 1, clock


@inlined
def _moved_end(system, state, left, ends):
    """Fill the impulses (3n,) of a plastic end, and velocities `ends`; return by how much these change."""
    plastic_impulses_now(system, state, left)
    apart = 0.0
    for i in range(len(left)):
        end = state.v[i]
        for k in range(len(left)):
            end += system.w[i, k] * left[k]
        apart = max(apart, abs(end - ends[i]))
        ends[i] = end
    return apart


@inlined
def _fly(system, state, time):
    """Let all contacts, which are open, move on for a time, at whose end the first of them close."""
    for j in range(len(state.normal)):
        state.indentation[j] -= time * state.v[3 * j + 2]
        if state.indentation[j] >= -ROUNDOFF and state.v[3 * j + 2] < -ROUNDOFF:
            close(system, state, j)


@inlined
def _expand_step(system, state, unknown, inverse, accuracy, series):
    """Expand the series of a step; return its longest length, its pace, and whether it is one in √s."""
    expand(system, state, unknown, inverse, FIRST, 1.0, series)
    pace = natural_pace(state, series)
    root = expand(system, state, unknown, inverse, ORDER, pace, series)
    return _step_length(system, series, accuracy, pace, LONGEST), pace, root


@inlined
def _expand_onset(system, state, unknown, inverse, accuracy, series):
    """Expand the series of a step with which slips begin together; return its longest length and its pace.

    The length is 0 where not all begin, ρ > 0, or where they do not reach the speed at which others begin.
    """
    for i in range(len(state.v)):
        if state.fresh[i // 3] == TIED and i % 3 < 2:
            state.v[i] = 0.0
    h, pace, _ = _expand_step(system, state, unknown, inverse, accuracy, series)
    slowest = math.inf
    for j in range(len(state.fresh)):
        if state.fresh[j] == TIED:
            slowest = min(slowest, series.speed[0, j] * h * h)
    if slowest > SLIP_SPEED:
        return h, pace
    _end_onset(state)
    return 0.0, 1.0


@inlined
def _end_onset(state):
    """Let slips that were to begin together, and have not moved, begin each by itself."""
    for j in range(len(state.fresh)):
        if state.fresh[j] == TIED:
            begin_to_slip(state, j)


@inlined
def _expand_slow_step(system, state, unknown, inverse, accuracy, series, allowed):
    """Expand the series of a step of the slow motion; return its longest length, 0 for none, and its pace.

    `allowed` is by how much velocities may not be those that forces make.
    """
    slow, missed = np.empty((ORDER + 2, len(state.v))), np.empty((ORDER + 2, len(state.v)))
    for part in PARTS:
        pace = expand_slowly(system, state, unknown, inverse, series, part, slow, missed)
        if pace > 0.0:
            h = _step_length(system, series, accuracy, pace, LONGEST)
            if missed_slowly(missed, h) <= allowed:
                return h, pace
    return 0.0, 1.0


@inlined
def _presses_and_slips(state):
    """Return whether any contact is held and slips."""
    found = False
    for j in range(len(state.normal)):
        found = found or (state.normal[j] == HELD and state.tangent[j] == SLIPPING)
    return found


@inlined
def _ring(system, state, unknown, inverse, series):
    """Let held contacts oscillate about their new forces; return whether any of them separates. (14.12)"""
    n = len(state.normal)
    some = False
    for j in range(n):
        some = some or state.normal[j] == HELD
    if not some:
        return False
    expand(system, state, unknown, inverse, np.int64(0), 1.0, series)
    least, strongest = 0.0, 0.0
    for j in range(n):
        if state.normal[j] == HELD:
            mean = series.force[0, 3 * j + 2]
            cap = system.stiffness[j] * state.deepest[j] ** system.exponent
            strongest = max(strongest, cap)
            excited = state.ringing[j] + abs(state.last[j] - mean) / system.exponent
            state.ringing[j] = min(excited, max(cap - mean, 0.0) / system.exponent)
            state.last[j] = mean
            least = min(least, mean - state.ringing[j])
    if not least < -NEGLIGIBLE * strongest:
        return False
    for j in range(n):
        if state.normal[j] == HELD and state.last[j] - state.ringing[j] <= least + NEGLIGIBLE * strongest:
            if state.last[j] <= NEGLIGIBLE * strongest:
                open_contact(state, j)
            else:
                close(system, state, j)
    return True


@inlined
def _directions(state):
    """Return the directions (2n,) of slip."""
    unit = state.direction.copy()
    for j in range(len(state.normal)):
        speed = math.hypot(state.v[3 * j], state.v[3 * j + 1])
        if state.tangent[j] == SLIPPING and speed > 0.0:
            unit[2 * j], unit[2 * j + 1] = state.v[3 * j] / speed, state.v[3 * j + 1] / speed
    return unit


@inlined
def _loaded(state):
    """Return whether any contact is pressed or approaches; where none is, open those at rest."""
    n = len(state.normal)
    for j in range(n):
        if loads(state.normal[j]) and (state.indentation[j] > ROUNDOFF or state.v[3 * j + 2] < -ROUNDOFF):
            return True
    for j in range(n):
        if state.normal[j] != OPEN:
            open_contact(state, j)
    return False


@inlined
def _at_rest(series, state):
    """Return whether no velocity changes any more, and nothing is pressed on."""
    for j in range(len(state.normal)):
        if state.normal[j] != OPEN and abs(state.v[3 * j + 2]) > SLOW:
            return False
    for k in range(1, ORDER + 1):
        for i in range(series.v.shape[1]):
            if abs(series.v[k, i]) > ROUNDOFF:
                return False
    return True


@inlined
def _fastest_approach(system, state):
    """Return the speed at which any contact approaches, or can come to by what it has stored."""
    fastest = 0.0
    for j in range(len(state.normal)):
        z = 3 * j + 2
        fastest = max(fastest, -state.v[z])
        if state.normal[j] != OPEN and state.indentation[j] > 0.0:
            energy = stored(system, j, state.indentation[j])
            fastest = max(fastest, math.sqrt(2.0 * energy * system.w[z, z]))
    return fastest


@inlined
def _loaded_ends(state):
    """Unload what is locked: friction holds it, and what it has stored stays there."""
    for j in range(len(state.normal)):
        if state.normal[j] != OPEN:
            state.v[3 * j + 2] = 0.0
            open_contact(state, j)


@inlined
def _next_closing(state):
    """Return the time of flight to the next contact that closes."""
    time = NEVER
    for j in range(len(state.normal)):
        v3 = state.v[3 * j + 2]
        if v3 < -ROUNDOFF:
            time = min(time, state.indentation[j] / v3)
    return time


@inlined
def _step_length(system, series, accuracy, pace, h):
    """Return how far the series reaches."""
    n = len(system.friction)
    weight = 0.0
    for i in range(3 * n):
        weight = max(weight, system.w[i, i])
    for k in range(ORDER - 1, ORDER + 2):
        largest = 0.0
        for i in range(3 * n):
            largest = max(largest, abs(series.v[k, i]))
            # forces that cancel each other in all velocities are not seen there
            largest = max(largest, LITTLE * weight * abs(series.force[k - 1, i]) * pace / k)
        for j in range(n):
            largest = max(largest, abs(series.indentation[k, j]))
        if largest > 0.0:
            h = min(h, (accuracy / largest) ** (1.0 / k))
    return h
