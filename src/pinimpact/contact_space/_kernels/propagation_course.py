"""The loop over the events of an impact at several contacts. (theory.md, section 14)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.borrowing import borrowed
from ..._compile.declared import FLOAT_ROWS, INTEGERS, declared
from ..._compile.interrupts import answer_signals
from ..._compile.jit import external, inlined
from ..._numeric.loops import largest, largest_diagonal, repeated
from ..._numeric.products import dot
from ..._numeric.tolerances import LITTLE, ROUNDING, ROUNDOFF
from .codes import HELD, NONE_YET, OPEN, SLIPPING
from .first_fall import NEVER
from .plastic import come_to_rest, end_plastically, impulses_together
from .propagation_advance import NO_ROW, advance, record, record_step, time_power
from .propagation_events import apply_events, find_events
from .propagation_friction import settle
from .propagation_series import FEWER, ORDER, SHORT, START, Series, expand, natural_pace, unknown_after
from .propagation_slow_slip import expand_slowly, residual_at
from .propagation_state import BEGUN, TIED, State, System, begin_to_slip, close, loads, open_contact, stored
from .tolerances import AGREE, NEGLIGIBLE, SLIP_SPEED, SLOW

FIRST = np.int64(1)
"""Order of the series from which the time scale of slip is estimated."""

LONGEST = 1e3
"""The longest step, in units of the time scale `pace`."""

STEP, EVENT, ROW, POINT, ENDED = 0, 1, 2, 3, 4
"""Indices of `counts`."""

MOST_EVENTS = 200
"""Largest number of events per contact within which the fastest approach has to halve."""

PATIENCE = 16
"""Steps between two attempts to step along the slow motion; an attempt costs about as much as 16 steps."""

PARTS = 0.0, LITTLE
"""Least rates of turning slip, over the fastest, that (14.5) takes as fast; tried in this order."""

FEWEST, PLASTIC_EVENTS = 500, 4
"""The plastic end is first computed after `FEWEST` + `PLASTIC_EVENTS` n events, if no contact has
restitution, and again at every doubling. The impact ends if two successive results agree."""


@declared(
    *(System, State, Series, FLOAT_ROWS, FLOAT_ROWS, float, int, FLOAT_ROWS, INTEGERS, FLOAT_ROWS, FLOAT_ROWS)
)
@external
def follow(system, state, series, roots, room, accuracy, most_steps, works, counts, rows, path):
    """Integrate the impact from event to event, with velocities scaled to one and κ W₃₃ ≤ 1.

    Args:
        system: The `System`.
        state: The `State` before the impact; is overwritten with that after it.
        series: Scratch for `expand`.
        roots, room: (n, 3), (5, ORDER + 1) scratch for `find_events`.
        accuracy, most_steps, works, counts, rows, path: As for `propagate`.

    Returns:
        Whether all approaches could be stopped.
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
    clock, at_once, slower, most_events, most = 0.0, 0, 0.5, MOST_EVENTS * n, most_steps * n
    rest, ends, change = np.zeros(3 * n), np.zeros(3 * n), math.inf
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
            change = max(change, _update_plastic_end(system, state, rest, ends))
            if change <= AGREE:
                counts[ENDED] = 1
                ended = end_plastically(system, state, rest, works)
                if ended:
                    counts[POINT] = record(path, counts[POINT], clock, state)
                return ended
            change, check = 0.0, 2 * counts[EVENT]
        if fastest <= slower:  # the impacts die out
            slower, most_events = 0.5 * fastest, counts[EVENT] + MOST_EVENTS * n
            most = counts[STEP] + most_steps * n
        if counts[ENDED] == 2 or counts[EVENT] >= most_events or counts[STEP] > most:
            counts[ENDED] = 2
            return True
        if 0 < len(rows) <= counts[ROW] or 0 < len(path) <= counts[POINT]:  # to be repeated with longer ones
            return True
        if not presses:
            _fly(system, state, time)
            clock += time
            counts[EVENT] += 1
        unknown, inverse, weight = settle(system, state, series)
        if not _separate_oscillating(system, state, unknown, inverse, series):
            at_once, clock = _step_to_event(
                *(system, state, series, (unknown, inverse, weight), scratch, accuracy, most_steps),
                *(at_once, clock, works, counts, rows, latest, path),
            )
        counts[EVENT] += 1


@inlined
def _step_to_event(
    system, state, series, forces, scratch, accuracy, most_steps, at_once, clock, works, counts, rows, latest,
    path,
):  # fmt: skip
    """Take steps up to the next event and change the modes there.

    Args:
        system: The `System`.
        state: The `State`; is overwritten with that after the event.
        series: Scratch for `expand`.
        forces: Indices of the unknown forces, the matrix that solves for them, and their weights.
        scratch: The arguments `roots`, `guard`, `work` of `find_events`.
        accuracy, most_steps, works, counts, rows, path: As for `propagate`.
        at_once: Number of preceding events without a step in between.
        clock: Internal clock s.
        latest: (n,) index of the last row of each contact, or `NO_ROW`.

    Returns:
        `at_once` and the clock at the event.
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
        order = ORDER
        if not (tied or slowly):
            order = FEWER if since == 0 else ORDER
            h, pace, root = _expand_step(system, state, unknown, inverse, order, accuracy, series)
        counts[STEP] += 1
        since += 1
        if counts[STEP] > most:
            counts[ENDED] = 2
            return at_once, clock
        if not (tied or root) and _at_rest(system, series, state, pace):
            _open_locked(state)
            return at_once, clock
        crowded = at_once > 2 * len(state.normal)
        while True:
            first, degree = find_events(
                system, state, series, h, order, NEGLIGIBLE / pace, crowded, roots, guard, work
            )
            if first <= h or order == ORDER:
                break
            expand(system, state, unknown, inverse, order + 1, ORDER, pace, series)
            order, h = ORDER, _step_length(system, series, ORDER, accuracy, pace)
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
            apply_events(system, state, series, order, roots, first, NEGLIGIBLE / pace)
            return at_once + 1, clock


@inlined
def _update_plastic_end(system, state, impulse, ends):
    """Compute the plastic impulse (3n,) from here and the velocities `ends` (3n,) after it.

    Both are overwritten. Return the largest change of `ends`.
    """
    n, change = len(system.friction), 0.0
    impulses_together(system.w, state.v, system.friction, np.zeros(n), np.ones(n), impulse)
    for i in range(len(impulse)):
        end = state.v[i] + dot(system.w[i], impulse)
        change = max(change, abs(end - ends[i]))
        ends[i] = end
    return change


@inlined
def _fly(system, state, time):
    """Advance open contacts by the time of flight and close those whose gap is then zero."""
    for j in range(len(state.normal)):
        state.indentation[j] -= time * state.v[3 * j + 2]
        if state.indentation[j] >= -ROUNDOFF and state.v[3 * j + 2] < -ROUNDOFF:
            close(system, state, j)


@inlined
def _expand_step(system, state, unknown, inverse, order, accuracy, series):
    """Expand the series of a step; return the largest step size, its time scale, and whether it is in √s."""
    expand(system, state, unknown, inverse, START, FIRST, 1.0, series)
    pace = natural_pace(state, series)
    begin = START if pace < 1.0 else FIRST + 1
    root = expand(system, state, unknown, inverse, begin, order, pace, series)
    return _step_length(system, series, order, accuracy, pace), pace, root


@inlined
def _expand_onset(system, state, unknown, inverse, accuracy, series):
    """Expand the series (14.14) of shared slip from rest; return the largest step size and its time scale.

    The step size is 0 if a speed of slip does not exceed `SLIP_SPEED` within it. The contacts then begin to
    slip one by one.
    """
    for i in range(len(state.v)):
        if state.fresh[i // 3] == TIED and i % 3 < 2:
            state.v[i] = 0.0
    h, pace, _ = _expand_step(system, state, unknown, inverse, ORDER, accuracy, series)
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
    """Start the slip of each `TIED` contact separately."""
    for j in range(len(state.fresh)):
        if state.fresh[j] == TIED:
            begin_to_slip(state, j)


@inlined
def _expand_slow_step(system, state, unknown, inverse, accuracy, series, allowed):
    """Expand the series (14.5) of slow slip; return the largest step size, 0 for failure, and its time scale.

    `allowed` is the tolerance of the residual of velocities.
    """
    slow, residual = np.empty((ORDER + 2, len(state.v))), np.empty((ORDER + 2, len(state.v)))
    for part in PARTS:
        pace = expand_slowly(system, state, unknown, inverse, series, part, slow, residual)
        if pace > 0.0:
            h = _step_length(system, series, ORDER, accuracy, pace)
            if residual_at(residual, h) <= allowed:
                return h, pace
    return 0.0, 1.0


@inlined
def _presses_and_slips(state):
    """Return whether any contact is held at its peak and slips."""
    found = False
    for j in range(len(state.normal)):
        found = found or (state.normal[j] == HELD and state.tangent[j] == SLIPPING)
    return found


@inlined
def _separate_oscillating(system, state, unknown, inverse, series):
    """Update the oscillation amplitudes of held contacts; return whether any contact separates. (14.12)"""
    n = len(state.normal)
    some = False
    for j in range(n):
        some = some or state.normal[j] == HELD
    if not some:
        return False
    expand(system, state, unknown, inverse, START, START, 1.0, series)
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
    """Return the directions (2n,) of slip; contacts at rest have that of `State.direction`."""
    unit = state.direction.copy()
    for j in range(len(state.normal)):
        speed = math.hypot(state.v[3 * j], state.v[3 * j + 1])
        if state.tangent[j] == SLIPPING and speed > 0.0:
            unit[2 * j], unit[2 * j + 1] = state.v[3 * j] / speed, state.v[3 * j + 1] / speed
    return unit


@inlined
def _loaded(state):
    """Return whether any contact is pressed or approaches; if none is, open all contacts."""
    n = len(state.normal)
    for j in range(n):
        if loads(state.normal[j]) and (state.indentation[j] > ROUNDOFF or state.v[3 * j + 2] < -ROUNDOFF):
            return True
    for j in range(n):
        if state.normal[j] != OPEN:
            open_contact(state, j)
    return False


@inlined
def _at_rest(system, series, state, pace):
    """Return whether closed contacts have no normal velocity and all accelerations are zero.

    Forces and velocities are then constant. Accelerations are sums W p of forces that cancel, and zero to the
    rounding errors of their terms, of which the largest at a contact count: contacts that friction has locked
    vibrate about rest by such errors.
    """
    for j in range(len(state.normal)):
        if state.normal[j] != OPEN and abs(state.v[3 * j + 2]) > SLOW:
            return False
    for j in range(len(state.normal)):
        fastest = size = 0.0
        for i in range(3 * j, 3 * j + 3):
            terms = 0.0
            for a in range(series.v.shape[1]):
                terms += abs(system.w[i, a] * series.force[0, a])
            fastest, size = max(fastest, abs(series.v[1, i])), max(size, terms)
        if fastest > ROUNDING * size * pace:
            return False
    return True


@inlined
def _fastest_approach(system, state):
    """Return the largest speed of approach, including the one that stored energy could still cause."""
    fastest = 0.0
    for j in range(len(state.normal)):
        z = 3 * j + 2
        fastest = max(fastest, -state.v[z])
        if state.normal[j] != OPEN and state.indentation[j] > 0.0:
            energy = stored(system, j, state.indentation[j])
            fastest = max(fastest, math.sqrt(2.0 * energy * system.w[z, z]))
    return fastest


@inlined
def _open_locked(state):
    """Open the contacts that friction locks, at zero normal velocity; their stored energy is not released."""
    for j in range(len(state.normal)):
        if state.normal[j] != OPEN:
            state.v[3 * j + 2] = 0.0
            open_contact(state, j)


@inlined
def _next_closing(state):
    """Return the time of flight until the next contact closes, or `NEVER`."""
    time = NEVER
    for j in range(len(state.normal)):
        v3 = state.v[3 * j + 2]
        if v3 < -ROUNDOFF:
            time = min(time, state.indentation[j] / v3)
    return time


@inlined
def _step_length(system, series, order, accuracy, pace):
    """Return the step size at which the last three terms of the series equal the accuracy."""
    weight, h = largest_diagonal(system.w), LONGEST
    for k in range(order - 1, order + 2):
        # self-equilibrated forces do not appear in the velocities
        forces = LITTLE * weight * largest(series.force[k - 1]) * pace / k
        size = max(largest(series.v[k]), largest(series.indentation[k]), forces)
        if size > 0.0:
            h = min(h, (accuracy / size) ** (1.0 / k))
    return h
