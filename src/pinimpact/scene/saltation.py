"""Saltation matrices: derivatives of the state after an event by that before it. (docs/derivatives.md, 9)

"Changes" (2nv, n) are n columns of small changes (δq, δv), with δq in the tangent space. The last columns are
derivatives by parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from ..arrays import Array, Bools, Integers
from ..checks import finite_array, returned
from ..contact_space._kernels.tolerances import MISSED
from ..contact_space.derivatives import Boundary
from ..robot.corner_motion import Corner
from ..robot.many_derivatives import RowSlopes
from ..robot.placed_robot import PlacedRobot
from ._kernels.contact_forces import FREE, SLIP, STICK
from ._kernels.tolerances import COMPUTED, REMAINS, ROUNDING
from ._kernels.variations import admitted, stop
from .dense_step import WORKS, DenseStep
from .dynamics import SceneDynamics
from .events import Jacobian, as_events
from .forces import ClosedSet
from .impact_jumps import GroupJump, ImpactJumps, Parameter, SingleJump
from .mode_slopes import ModeSlopes, Slip, SlopesOfModes
from .records import EventRecord, ImpactRecord
from .rolling_over import rolls_over
from .scene import Scene
from .step_sets import TIED

SLOWEST = 1e3
"""Least speed of closing for a differentiable time of an event, relative to the error of velocities."""

_BOUNDS = {"friction": (0.0,), "restitution": (0.0, 1.0)}


class Saltation:
    """Propagates changes of the state through the events of a scene.

    Dynamics and model are without the effects that the scene switches off. The motion is differentiated by
    the parameters, under a constant generalized force tau (nv,). Events set flags of `boundary`.
    """

    def __init__(
        self,
        scene: Scene,
        dynamics: SceneDynamics,
        model: pin.Model,
        parameters: Sequence[Parameter],
        tau: Array,
    ) -> None:
        own = [contact.sliding_friction is not None for contact in dynamics.contacts]
        friction = [-1 if p.kind != "friction" or own[p.contact] else p.contact for p in parameters]
        self.slopes = SlopesOfModes(dynamics, model, friction, tau)
        self.parameters = tuple(parameters)
        self.boundary = Boundary.NONE
        self._dynamics, self._model, self._data = dynamics, model, model.createData()
        self._jumps = ImpactJumps(scene, dynamics, model)
        self._bilateral = dynamics.work.bilateral.astype(bool)
        self._events = {event.label: event for event in as_events(scene.events) if event.jacobian is not None}

    # ---- events

    def start(
        self,
        x: Array,
        first: DenseStep,
        impacts: Sequence[ImpactRecord],
        events: Sequence[EventRecord] = (),
        force: Array | None = None,
    ) -> Array:
        """Return changes x (2nv, n) of the initial state after the impacts and events at the start.

        `force` (nv, n) are the changes of the generalized force, None for zeros.
        """
        if self._called(events):
            return self._undefined(x, Boundary.EVENTS_COINCIDE)
        if impacts:
            before = self.before(impacts[0], first.closed)
            if before.closed is not None:
                mode = self.slopes.at(before, before.end)
                x = self._admitted(x, mode, self.slopes.gaps(mode)[0])
            return self.cross(x, before, first, impacts)
        if first.closed is None:
            return x
        after = self._begun(first)
        self._flag_rest(x, first, first.closed, after)
        return self._without_load(x, after, first, force)

    def _without_load(self, x: Array, mode: ModeSlopes, first: DenseStep, force: Array | None) -> Array:
        """Return the admitted changes, as NaN where contacts move that no load would close again.

        Changes x move them, or changes of the force (nv, n) or of friction accelerate them.
        """
        nv, (gaps, loaded, kept) = len(x) // 2, self.slopes.gaps(mode)
        if loaded.all():
            return self._admitted(x, mode, gaps)
        rows, metres = mode.rows[gaps[~loaded]], self._dynamics.work.joint_metres
        rows = rows[rows[:, nv:].any(axis=1)]  # not of contacts along whose normal the robot cannot move
        others = mode._replace(rows=mode.rows[kept], response=mode.response[:, kept])
        free = self._admitted(x, others, np.searchsorted(np.flatnonzero(kept), gaps[loaded]))
        pushed = np.zeros_like(x)
        pushed[nv:] = 0.0 if force is None else mode.inverse @ force
        pushed[nv:, x.shape[1] - len(self.parameters) :] += self.slopes.by_friction(first)
        moved = _moves(rows, x, free, metres) | _moves(rows[:, nv:], x[:nv], free[:nv], metres)
        moved |= _moves(rows, pushed, _onto(others, pushed), metres)
        admitted = self._admitted(x, mode, gaps)
        if moved.any():
            admitted[:, moved] = self._undefined(admitted[:, moved], Boundary.GRAZING)
        return admitted

    def flag_touching(self, q: Array, v: Array, modes: Integers, struck: Sequence[ImpactRecord]) -> None:
        """Flag what touches at a start but neither collides nor closes: some changes make it collide.

        `modes` are those at the start.
        """
        gaps, rates = self._dynamics.gaps_at(q, v).T
        touches = (gaps <= self._dynamics.work.touching_gap) & (np.abs(rates) <= self._dynamics.error(v))
        touches &= modes[: len(gaps)] == 0
        for record in struck:
            touches[list(self._jumps.sources(record))] = False
        if touches.any():
            self.boundary |= Boundary.GRAZING

    def _begun(self, step: DenseStep) -> ModeSlopes:
        """Return the slopes at the start of a step; flag friction at its bound, where they are one-sided."""
        slopes = self.slopes.at(step, step.start)
        if slopes.at_bound:
            self.boundary |= Boundary.STICK_THRESHOLD
        return slopes

    def _admitted(self, x: Array, mode: ModeSlopes, gaps: Integers) -> Array:
        """Return changes at a start, projected onto those that the active contacts, with `gaps`, admit."""
        if len(mode.rows) == 0:
            return x
        self.boundary |= Boundary.CLOSED
        return np.asarray(admitted(mode.rows, gaps, mode.response, mode.inverse, x))

    def _flag_rest(self, x: Array, first: DenseStep, closed: ClosedSet, after: ModeSlopes) -> None:
        """Flag changes at a start that move contacts which begin to slide: derivatives are one-sided."""
        if not (closed.slips or closed.sliding.any()):
            return
        work, nv, still = self._dynamics.work, len(x) // 2, self._dynamics.error(first.v)
        joints = (closed.sliding != 0.0) & (work.joint_metres * np.abs(first.v) <= still)
        if not (closed.slips or joints.any()):
            return
        slow = self.slopes.speeds(first, np.array([first.start]))[0] <= still
        begins = work.active_index[slow & (work.active_friction > 0.0)]
        slips = [slip.rows for slip in after.slips if slip.contact in begins]
        rows = np.vstack([*slips, np.eye(nv, 2 * nv, nv)[joints]])
        if (np.abs(rows @ x) > REMAINS * (np.abs(rows) @ np.abs(x))).any():
            self.boundary |= Boundary.START_AT_REST

    def before(self, record: ImpactRecord, closed: ClosedSet | None) -> DenseStep:
        """Return a step that ends at the impact where a motion starts, with only held contacts active."""
        work = self._dynamics.work
        step = DenseStep(
            *(record.time, 1.0, record.q, record.v_before, np.zeros(WORKS)),
            *(np.zeros((7, 2 * work.nv + WORKS)), work.joint_charts),
        )
        step.end = record.time
        if closed is not None and self._bilateral.any():
            modes = closed.modes.copy()
            kept = self._bilateral[np.flatnonzero(modes[: work.contacts])]
            modes[: work.contacts][~self._bilateral] = 0
            modes[work.contacts : work.contacts + work.limits] = 0
            step.closed = closed._replace(
                modes=modes, constants=closed.constants[kept], joints=closed.joints[kept], slips=False
            )
        return step

    def _called(self, events: Sequence[EventRecord]) -> list[tuple[Jacobian, EventRecord]]:
        """Return the events with a `jacobian` whose callback may have set a velocity, with their records."""
        known = ((self._events.get(record.name), record) for record in events)
        return [(event.jacobian, record) for event, record in known if event and event.jacobian]

    def cross(
        self,
        x: Array,
        before: DenseStep,
        after: DenseStep,
        impacts: Sequence[ImpactRecord],
        events: Sequence[EventRecord] = (),
    ) -> Array:
        """Return changes x (2nv, n) at the end of a step as changes at the start of the next one. (D25)

        `impacts` and user `events` are those between the steps.

        Raises:
            InputError: A `jacobian` of the wrong shape; an impact of two collision shapes with others.
        """
        called = self._called(events)
        if called:
            if impacts or len(called) > 1:
                return self._undefined(x, Boundary.EVENTS_COINCIDE)
            return self._through_callback(x, before, after, *called[0])
        if not impacts and after.closed is before.closed:
            return x
        t, work, robot = before.end, self._dynamics.work, (self._model, self._data)
        modes, later = self.modes(before), self.modes(after)
        minus = self.slopes.at(before, t)
        dry = before.closed.sliding if before.closed is not None else np.zeros(work.nv)
        sliding = after.closed.sliding if after.closed is not None else np.zeros(work.nv)
        plus = self._begun(after)
        count = work.contacts + work.limits
        closes = (modes[:count] == 0) & (later[:count] != 0)
        rates = np.append(before.at(t)[1], minus.acceleration), np.append(after.v, plus.acceleration)
        if impacts:
            x = self._through_impact(x, impacts, (modes, later), plus, rates)
        elif closes.any():
            return self._undefined(x, Boundary.GRAZING)
        elif (
            over := rolls_over(self._dynamics.contacts, self._jumps.pairs, *robot, before, after)
        ) is not None:
            passing = float(over @ rates[0][: len(over)])
            if not abs(passing) > SLOWEST * self._dynamics.error(after.v):
                return self._undefined(x, Boundary.GRAZING)
            x = x - np.outer(rates[0] - rates[1], over @ x[: len(over)] / passing)
        else:
            ends = [slip for slip in minus.slips if later[slip.contact] == STICK]
            slides = {slip.contact: slip.direction for slip in plus.slips if later[slip.contact] == SLIP}
            turns = [s for s in minus.slips if s.contact in slides and slides[s.contact] @ s.direction < 0.0]
            joints = np.flatnonzero((dry != 0.0) & ((later[count:] != 0) | (dry * sliding < 0.0)))
            lost = bool(((modes != 0) & ((later == 0) | (modes > later))).any())
            reversed_ = len(turns) > 0 or bool((dry * sliding < 0.0).any())
            # impulses that are not unique do not determine the motion if contacts slip
            shared = after.closed is not None and not after.closed.unique and len(plus.slips) > 0
            if len(ends) + len(joints) > 0 and not lost and not reversed_ and not shared:
                return _onto(plus, x)
            alone = len(ends) + len(turns) + (min(len(joints), 1) if shared else len(joints)) == 1
            metres = np.tile(work.joint_metres, 2)
            rate, jump = metres * rates[0], metres * (rates[0] - rates[1])
            if alone:
                x = _through_rest(x, minus, [*ends, *turns], joints[:1], rates)
            elif not np.linalg.norm(jump) <= REMAINS * np.linalg.norm(rate):
                return self._undefined(x, Boundary.EVENTS_COINCIDE)
            if np.isnan(x).all():
                return self._undefined(x, Boundary.EVENTS_COINCIDE)
        return self._checked(plus, x)

    def _through_callback(
        self, x: Array, before: DenseStep, after: DenseStep, jacobian: Jacobian, record: EventRecord
    ) -> Array:
        """Return changes x (2nv, n) after an event whose callback has set the velocity."""
        nv, given = len(record.v_before), (record.time, record.q.copy(), record.v_before.copy())
        found = returned("jacobian", f"at t = {record.time:.6g} s", jacobian, *given)
        by = finite_array("jacobian", found, (nv + 1, 2 * nv + 1))
        minus, plus = self.slopes.at(before, record.time), self.slopes.at(after, after.start)
        rate, later = np.append(record.v_before, minus.acceleration), np.append(after.v, plus.acceleration)
        passing = float(by[nv] @ np.append(rate, 1.0))
        if passing == 0.0:
            return self._undefined(x, Boundary.GRAZING)
        shift = -(by[nv, :-1] @ x) / passing
        moved = x + np.outer(rate, shift)
        found = np.vstack([moved[:nv], by[:nv, :-1] @ moved + np.outer(by[:nv, -1], shift)])
        return self._checked(plus, found - np.outer(later, shift))

    def modes(self, step: DenseStep) -> Integers:
        """Return the modes of contacts, limits and joints in a step."""
        work = self._dynamics.work
        if step.closed is None:
            return np.zeros(work.contacts + work.limits + work.nv, dtype=np.int64)
        return np.asarray(step.closed.modes)

    def _checked(self, plus: ModeSlopes, x: Array) -> Array:
        """Return changes x (2nv, n), projected onto the constraints after an event.

        They are NaN if a residual exceeds rounding: all columns for one by the state, else that column.
        """
        if len(plus.rows) == 0:
            return x
        missed, size = plus.rows @ x, np.abs(plus.rows) @ np.abs(x)
        exceeds: Bools = np.any(np.abs(missed) > REMAINS * (size + 1.0), axis=0)
        missing = np.flatnonzero(exceeds & np.isfinite(x).all(axis=0))
        if (missing < x.shape[1] - len(self.parameters)).any():
            return self._undefined(x, Boundary.EVENTS_COINCIDE)
        x = _onto(plus, x)
        if len(missing) > 0:
            x[:, missing] = self._undefined(x[:, missing], Boundary.EVENTS_COINCIDE)
        return x

    def _undefined(self, x: Array, flag: Boundary) -> Array:
        self.boundary |= flag
        return np.full_like(x, np.nan)

    # ---- impacts

    def _through_impact(
        self,
        x: Array,
        impacts: Sequence[ImpactRecord],
        modes: tuple[Integers, Integers],
        plus: ModeSlopes,
        rates: tuple[Array, Array],
    ) -> Array:
        """Return changes x (2nv, n) after the impacts of one instant.

        Modes, and rates (2nv,) of v and v̇, are given before and after them, the slopes `plus` after them.
        """
        records = [*{id(one if one.group is None else one.group[0]): one for one in impacts}.values()]
        nv, work = len(x) // 2, self._dynamics.work
        count = work.contacts + work.limits
        taking_part = np.zeros(count, dtype=bool)
        for record in records:
            taking_part[list(self._jumps.sources(record))] = True
        before, later = (one[:count] != 0 for one in modes)
        if (later & ~before & ~taking_part).any():
            return self._undefined(x, Boundary.EVENTS_COINCIDE)
        if any(one.resting for one in impacts):
            self.boundary |= Boundary.LAST_BOUNCE
        active = (before | later | taking_part)[: work.contacts] | self._bilateral
        island = self._jumps.islands(active) if len(records) > 1 else np.zeros(nv, dtype=np.int64)
        error = self._dynamics.error(impacts[0].v_before)
        jumps = [self._jumps.of(record, modes[0]) for record in records]
        shifts, shifted = np.zeros_like(x), np.zeros(nv, dtype=bool)
        for jump in jumps:
            guard = jump.guard(SLOWEST * error)
            if guard is None:
                return self._undefined(x, Boundary.EVENTS_COINCIDE)
            own = island == island[np.argmax(np.abs(guard))]
            if (own & shifted).any():  # successive impacts of one island at one instant
                return self._undefined(x, Boundary.EVENTS_COINCIDE)
            shifted |= own
            closing = float(guard @ rates[0][:nv])
            if not -closing > SLOWEST * error:
                return self._undefined(x, Boundary.GRAZING)
            shifts[np.tile(own, 2)] = -(guard @ x[:nv]) / closing
        result = self._after(x + rates[0][:, None] * shifts, jumps)
        removed = impacts[-1].v_after - rates[1][:nv]
        if self._dynamics.fastest(removed) > 10.0 * error:
            result = self._without(result, removed, impacts[0].q, plus)
        result -= rates[1][:, None] * shifts
        result = self._bounced(result, jumps, modes[1])
        by_e = [one.kind == "restitution" for one in self.parameters]
        if any(by_e) and len(plus.rows) > 0:
            columns = np.flatnonzero(by_e) + result.shape[1] - len(by_e)
            result[:, columns] = _onto(plus, result[:, columns])
        return np.asarray(result)

    def _bounced(self, x: Array, jumps: Sequence[SingleJump | GroupJump], later: Integers) -> Array:
        """Return changes with derivatives by e, at e = 0, of contacts that stay active after an impact. (D39)

        Such a contact rebounds at e times its approach and lands again with the same impulse; meanwhile its
        force is missing. Further bounces are of second order. The derivative is NaN for a contact that sticks
        in the impact and slides afterwards, and for impacts at several contacts. `later` (n + nl,) are the
        modes after the impacts.
        """
        nv, first = len(x) // 2, x.shape[1] - len(self.parameters)
        struck = {number: jump for jump in jumps for number in jump.numbers}
        for column, one in enumerate(self.parameters, first):
            jump, mode = struck.get(one.contact), int(later[one.contact])
            rests = self._dynamics.contacts[one.contact].restitution == 0.0 and mode != FREE
            if one.kind != "restitution" or jump is None or not rests:
                continue
            if isinstance(jump, SingleJump) and (
                mode == STICK or jump.record.solution.segments[-1].mode == "slip"
            ):
                x[nv:, column] += jump.by["restitution"]
            else:
                x[:, [column]] = self._undefined(x[:, [column]], Boundary.EVENTS_COINCIDE)
        return x

    def strike(
        self,
        x: Array,
        impacts: Sequence[ImpactRecord],
        modes: Integers,
        corners: Mapping[int, Corner],
        later: Integers,
    ) -> Array:
        """Return changes x (2nv, n) after impacts within a time step.

        There active contacts move: their velocities vanish only at the ends of steps. The modes (n + nl,) are
        those before the impacts and, `later`, in the next step; corners represent contacts of two shapes.
        """
        records = {id(one if one.group is None else one.group[0]): one for one in impacts}.values()
        if any(one.resting for one in impacts):
            self.boundary |= Boundary.LAST_BOUNCE
        jumps = [self._jumps.of(record, modes, corners, TIED) for record in records]
        return self._bounced(self._after(x, jumps), jumps, later)

    def _after(self, x: Array, jumps: Sequence[SingleJump | GroupJump]) -> Array:
        """Return changes x (2nv, n) after successive impacts."""
        nv = len(x) // 2
        for jump in jumps:
            passed = jump.after(x, self.parameters)
            if passed is None:
                return self._undefined(x, Boundary.JUMP)
            x = np.vstack([x[:nv], passed.after])
            self._flag(passed.boundary, passed.depends)
        return x

    def _without(self, x: Array, removed: Array, q: Array, plus: ModeSlopes) -> Array:
        """Return changes x (2nv, n) after a small velocity (nv,) of active contacts is removed. (D31)

        It is the response to the least impulses that stop the contacts active afterwards.
        """
        nv, response = len(removed), plus.inverse @ plus.rows[:, len(removed) :].T
        forces = np.linalg.lstsq(response, removed, rcond=ROUNDING)[0]
        if not np.linalg.norm(response @ forces - removed) <= MISSED * np.linalg.norm(removed):
            return self._undefined(x, Boundary.EVENTS_COINCIDE)
        work, end = self._dynamics.work, 0
        contacts, impulses = [], []
        for i, mode in zip(work.active_index.tolist(), work.active_mode.tolist(), strict=True):
            start, end = end, end + (1 if mode == SLIP else 3)
            contacts.append(self._dynamics.contacts[i])
            impulses.append(np.append(np.zeros(3 - (end - start)), forces[start:end]))
        if any(contact.pair is not None for contact in contacts):
            return self._undefined(x, Boundary.FEATURES_MEET)
        of_rows = RowSlopes(PlacedRobot(self._model, self._data, q), contacts)
        bent = of_rows.forces(np.array(impulses)) - of_rows.of_mass(removed)
        x = x.copy()
        x[nv:] -= plus.inverse @ bent @ x[:nv]
        return np.asarray(stop(plus.rows, response, nv, x))

    def _flag(self, flags: Boundary, on: Sequence[Parameter]) -> None:
        """Add the flags of an impact, and `BOUND` for parameters `on` which it depends at their bounds."""
        self.boundary |= flags & ~Boundary.BOUND
        for parameter in on:
            contact = self._dynamics.contacts[parameter.contact]
            if getattr(contact, parameter.kind) in _BOUNDS[parameter.kind]:
                self.boundary |= Boundary.BOUND


def _through_rest(
    x: Array, minus: ModeSlopes, stops: Sequence[Slip], joints: Integers, rates: tuple[Array, Array]
) -> Array:
    """Return changes after a contact or dry joint stops or reverses; those across its slip vanish. (D27)"""
    nv = len(x) // 2
    guard = np.zeros(2 * nv)
    guard[nv + joints] = 1.0
    rate = float(minus.acceleration[joints].sum())
    for slip in stops:
        across = np.array([-slip.direction[1], slip.direction[0]])
        row = across @ slip.rows
        response = np.hstack([minus.response, minus.inverse @ row[nv:, None]])
        x = _onto(minus._replace(rows=np.vstack([minus.rows, row]), response=response), x)
        guard = slip.direction @ slip.rows
        rate = float(slip.direction @ slip.rate)
        if abs(across @ slip.rate) > REMAINS * abs(rate):
            return np.full_like(x, np.nan)
    return np.asarray(x - np.outer(rates[0] - rates[1], guard @ x / rate))


def _moves(rows: Array, x: Array, projected: Array, metres: Array) -> Bools:
    """Return whether each projected change moves a row by more than errors of x and rounding errors.

    Changes are (nv, n) or (2nv, n), metres per unit (nv,).
    """
    parts = np.abs(x).reshape(-1, len(metres), x.shape[1])
    largest = (metres[:, None] * parts).max(axis=1, keepdims=True) / metres[:, None]
    sizes = np.abs(rows) @ (REMAINS * np.abs(x) + COMPUTED * largest.reshape(x.shape))
    return np.asarray((np.abs(rows @ projected) > sizes).any(axis=0))


def _onto(slopes: ModeSlopes, x: Array) -> Array:
    """Return changes (2nv, n) after the impulses at the active contacts that make their velocities vanish."""
    return np.asarray(stop(slopes.rows, slopes.response, len(x) // 2, x))
