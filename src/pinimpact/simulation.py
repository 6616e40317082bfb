"""The simulation: smooth flow up to the next event, the reset there, and so on to the end."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ._kernels import guards, sustained
from ._kernels.sustained import FREE, HELD, SLIP, STICK
from .contacts import Contact, contact_matrices
from .errors import InputError, PinimpactError, SimulationError
from .events import curvatures, first_crossing, root
from .flow import MODES, Active, Flow
from .integrator import QUADRATURES, Integrator, Segment
from .lookup import configuration, free_velocities, workspace
from .manifold import joint_table
from .problem import ImpactProblem, finite_array
from .reset import impact
from .scene import STANDARD_GRAVITY, Scene
from .solvers import solve_impact
from .trajectory import Energy, ImpactRecord, ModeInterval, Note, Trajectory

Array = NDArray[np.float64]
Progress = Callable[[float, float], None]
"""progress(t, duration), called after every step."""

GAP_FLOOR = 1e-12
"""Gaps below this part of the robot's size are rounding."""

STILL_FRACTION = 0.1
"""Slip slower than this part of the resting speed is none."""

MAX_ROUNDS = 1000
"""Impacts at one instant, after which the approach left is taken away at once (and noted)."""

MAX_STALLED = 200
"""Events without progress in time, after which a simulation gives up."""

SWEEPS = 20_000


def simulate(
    scene: Scene,
    q0: ArrayLike,
    v0: ArrayLike,
    duration: float,
    *,
    rtol: float = 1e-8,
    atol: float = 1e-10,
    max_step: float = math.inf,
    max_impacts: int = 10_000,
    progress: Progress | None = None,
) -> Trajectory:
    """Simulate a scene from a state, for a time. (scenes.md)

    Between events the flow is integrated on the configuration manifold to the tolerances; events are located
    to rounding, and none is missed between steps. Impacts are resolved exactly. Ctrl-C ends the run early
    and leaves what was computed.

    Args:
        scene: The robot, its contacts and what acts on it.
        q0: (nq,) configuration at the start, no contact below its surface.
        v0: (nv,) velocity at the start.
        duration: Time to simulate [s].
        rtol: Relative tolerance of each step.
        atol: Absolute tolerance of each step, on coordinates [m, rad] and velocities.
        max_step: Longest step [s]; needed where a control acts in pulses between which nothing happens.
        max_impacts: How many impacts to resolve before giving up.
        progress: Called with the time reached and the duration, after every step.

    Raises:
        InputError: A start below a surface or beyond a joint limit, a held contact that moves, numbers of
            the wrong shape or range.
        ModelError: A joint that cannot be integrated.
        SimulationError: A run that cannot go on; its ``partial`` is the trajectory until then. A control that
            fails or returns nonsense, impacts beyond `max_impacts`, an impact without an answer.
    """
    if not isinstance(scene, Scene):
        raise InputError(f"scene: {scene!r} is not a Scene", field="scene", value=scene)
    for name, value in (
        ("duration", duration),
        ("rtol", rtol),
        ("atol", atol),
        ("max_step", max_step),
        ("max_impacts", max_impacts),
    ):
        if not value > 0.0 or (name == "duration" and not math.isfinite(value)):
            raise InputError(f"{name}: {value!r} given, a number > 0 expected", field=name, value=value)
    run = _Run(scene, q0, v0, float(duration), rtol, atol, max_step, max_impacts)
    return run.go(progress)


class _Run:
    """One simulation under way. Events have numbers: contacts first, then joint limits."""

    def __init__(
        self,
        scene: Scene,
        q0: ArrayLike,
        v0: ArrayLike,
        duration: float,
        rtol: float,
        atol: float,
        max_step: float,
        max_impacts: int,
    ) -> None:
        without = scene.without
        model = scene.model
        if "gravity" in without or "rotor inertia" in without:
            model = model.copy()
            if "gravity" in without:
                model.gravity = pin.Motion.Zero()
            if "rotor inertia" in without:
                model.armature = np.zeros(model.nv)
        self.model = model
        self.data = model.createData()
        space = workspace(model, self.data)
        try:
            q = configuration(space, model, q0).copy()
        except InputError as error:
            raise InputError(f"q0: {str(error).removeprefix('q: ')}", field="q0", value=q0) from None
        v = finite_array("v0", v0, (model.nv,)).copy()

        unreachable = scene.unreachable()
        self.contacts = [
            _altered(contact, without)
            for contact in scene.contacts
            if contact.label not in unreachable and "contact guards" not in without
        ]
        self.plastic = [replace(contact, restitution=0.0) for contact in self.contacts]
        self.held = [_altered(c, without) for c in scene.held] if "held contacts" not in without else []
        self.locked = scene.locked if "locked joints" not in without else ()
        self.limits = scene.limits() if "joint limits" not in without else ()
        self.limit_restitution = 0.0 if "restitution" in without else scene.limit_restitution
        self.record = scene.record and "recorded path" not in without
        self.sustained = "sustained contact" not in without
        self.rest = scene.rest if self.sustained else 0.0
        self.switched_off = scene.plan().switched_off if without else ()

        self.quiet = 1e-9 * scene.rest  # an approach slower than this is rounding

        self.flow = Flow(scene, model, self.contacts, self.held)
        self.flow.still = STILL_FRACTION * scene.rest
        gravity = max(float(np.linalg.norm(model.gravity.linear)), STANDARD_GRAVITY)
        self.flow.allowance = 1e-10 * pin.computeTotalMass(model) * gravity
        table = joint_table(model)
        self.integrator = Integrator(self.flow, table, model.nq, model.nv, rtol, atol)
        self.floor = GAP_FLOOR * scene.extent + 8.0 * np.finfo(float).eps * float(np.abs(q).max(initial=0.0))
        self.touch = 4.0 * self.floor
        self.drift = max(self.touch, atol)
        self._limit_q = np.array([limit.index_q for limit in self.limits], dtype=np.int64)
        self._limit_v = np.array([limit.index_v for limit in self.limits], dtype=np.int64)
        self._limit_sign = np.array([limit.sign for limit in self.limits])
        self._limit_bound = np.array([limit.bound for limit in self.limits])
        self._limit_found = np.empty(len(self.limits), dtype=np.int64)

        self.t, self.q, self.v = 0.0, q, v
        self.w = np.zeros(QUADRATURES)
        self.work_of_impacts = 0.0
        self.duration = duration
        self.max_step = max_step
        self.max_impacts = max_impacts
        self.segments: list[Segment] = []
        self.samples: list[tuple[float, Array, Array, Array, float]] = []
        self.impacts: list[ImpactRecord] = []
        self.intervals: list[ModeInterval] = []
        self.standing: dict[str, tuple[str, float]] = {}
        self.notes: list[Note] = []
        self.steps = self.rejected = 0
        self.stalled = 0
        self.tolerated = False
        self.told = False
        self.limit_closed: set[int] = set()
        self.held_gap: list[float] = []
        self._check_start()

    # ---- the run

    def go(self, progress: Progress | None) -> Trajectory:
        """Run to the end; return the trajectory, or raise with what there is of it."""
        kept = self._kept()
        try:
            self._sample()
            kept = self._kept()
            self._settle(set(range(len(self.contacts) + len(self.limits))))
            self._restart()
            h = self.integrator.first_step()
            while self.t < self.duration:
                h = self._step(h)
                kept = self._kept()
                if progress is not None:
                    progress(self.t, self.duration)
        except KeyboardInterrupt:
            return self._trajectory("Interrupted from the keyboard.", False, kept)
        except Exception as error:
            self._stop(error, kept)
        return self._trajectory("The duration is covered.", True, self._kept())

    def _stop(self, error: Exception, kept: tuple[Any, ...]) -> None:
        partial = self._trajectory(f"Stopped: {error}", False, kept)
        reached = partial.t[-1]
        if isinstance(error, SimulationError):
            error.partial = partial
            raise error
        if isinstance(error, PinimpactError):
            field, value = error.field, error.value
        else:
            field, value = "control", None
        raise SimulationError(
            f"{field}: the simulation stops at t = {reached:.6g} s: {type(error).__name__}: {error}",
            partial=partial,
            field=field,
            value=value,
        ) from error

    def _kept(self) -> tuple[Any, ...]:
        """What is consistent now; an interrupt falls back to it."""
        return (
            len(self.segments),
            len(self.samples),
            len(self.impacts),
            len(self.intervals),
            dict(self.standing),
            len(self.notes),
        )

    def _trajectory(self, termination: str, complete: bool, kept: tuple[Any, ...]) -> Trajectory:
        segments, samples, impacts, intervals, standing, notes = kept
        rows = self.samples[: max(samples, 1)]
        t = np.array([row[0] for row in rows])
        q = np.array([row[1] for row in rows])
        v = np.array([row[2] for row in rows])
        w = np.array([row[3] for row in rows])
        kinetic = np.array(
            [pin.computeKineticEnergy(self.model, self.data, a, b) for a, b in zip(q, v, strict=True)]
        )
        potential = np.array([pin.computePotentialEnergy(self.model, self.data, a) for a in q])
        impacts_work = np.array([row[4] for row in rows])
        energy = Energy(kinetic, potential, w[:, 0], w[:, 1], w[:, 2], w[:, 3], impacts_work)
        modes = self.intervals[:intervals] + [
            ModeInterval(source, mode, start, float(t[-1])) for source, (mode, start) in standing.items()
        ]
        return Trajectory(
            self.segments[:segments],
            self.integrator.joints,
            (t, q, v),
            self.impacts[:impacts],
            modes,
            energy,
            self.notes[:notes],
            termination,
            complete,
            self.switched_off,
            {"steps": self.steps, "rejected": self.rejected, "evaluations": self.integrator.evaluations},
        )

    def _sample(self) -> None:
        self.samples.append((self.t, self.q.copy(), self.v.copy(), self.w.copy(), self.work_of_impacts))

    def _note(self, text: str) -> None:
        self.notes.append(Note(self.t, text))

    # ---- smooth stretches

    def _restart(self) -> None:
        """Begin a smooth stretch at the present state."""
        self.integrator.start(self.t, self.q, self.v, self.w)
        if not self.flow.unique and not self.told:
            self._note("The forces of the closed contacts are not unique; those of least norm are taken.")
            self.told = True
        self._remember()
        self.horizon = self._horizon()

    def _remember(self) -> None:
        """Keep what the guards start from; the flow was last evaluated at the present state."""
        flow = self.flow
        self.watched = [i for i in range(len(self.contacts)) if flow.mode[i] == FREE]
        self.gaps = [flow.points[i].gap_and_rate() for i in self.watched]
        self._turn_references(flow.active.velocity)

    def _horizon(self) -> float:
        """Guess how long a bounce just begun will last, so that no step is taken far beyond it."""
        guess = math.inf
        for i, (gap, rate) in zip(self.watched, self.gaps, strict=True):
            if abs(gap) <= self.touch and rate > 0.0:
                acceleration = self.flow.points[i].normal_acceleration()
                if acceleration < 0.0:
                    guess = min(guess, -2.0 * rate / acceleration)
        return 1.3 * guess

    def _turn_references(self, velocity: Array) -> None:
        """Let the remembered directions of slip follow the present ones."""
        flow = self.flow
        for k in range(len(flow.modes)):
            if flow.modes[k] == SLIP:
                speed = math.hypot(velocity[k, 0], velocity[k, 1])
                if speed > flow.still:
                    flow.reference[k] = velocity[k, :2] / speed

    def _step(self, h: float) -> float:
        """Take one accepted step, or a part of it up to an event; return the length to try next."""
        integrator, flow = self.integrator, self.flow
        left = self.duration - self.t
        natural = h
        h = min(h, self.max_step, self.horizon)
        while True:
            trial = left if h > 0.9 * left else h
            if self.t + trial <= self.t:
                raise SimulationError(
                    f"rtol: the step fell to {trial:.3g} s at t = {self.t:.6g} s; the motion is not smooth "
                    "(a control that jumps, forces beyond bounds?), or the tolerance is too small",
                    field="rtol",
                    value=self.integrator.rtol,
                )
            flow.least_margin = math.inf
            error = integrator.attempt(trial)
            if error > 1.0:
                self.rejected += 1
                natural = h = trial * (0.2 if math.isinf(error) else max(0.2, 0.9 * error**-0.125))
                continue
            gaps = [flow.points[i].gap_and_rate() for i in self.watched]
            margin = flow.margin
            velocity = flow.active.velocity.copy()
            drift = self._drift() if flow.constrained else 0.0
            segment = integrator.segment(trial)
            event = self._first_event(segment, gaps, velocity)
            if event is None:
                break
            if event[0] > 0.0:
                self.steps += 1
                self._cut(segment, event[0], event[1])
                return natural
            h = 0.5 * trial  # the slip turns too fast for a step of this length
            self.rejected += 1
        self.steps += 1
        self.stalled = 0
        self.segments.append(segment)
        self.w = self.w + segment.coefficients[0, 2 * flow.nv :]
        integrator.go_on(trial, self.w)
        self.t = segment.end = self.duration if trial == left else integrator.t
        integrator.t = self.t
        self.q, self.v = integrator.q, integrator.v
        if self.tolerated and margin >= 0.0:
            self.tolerated = False
        if flow.constrained and (drift > self.drift or self.tolerated):
            if self.tolerated:
                self._settle(set())
            else:
                self._correct()
            self._restart()
        else:
            self.gaps = gaps
            self.horizon = math.inf
            self._turn_references(velocity)
        self._sample()
        return trial * min(5.0, 0.9 * max(error, 1e-7) ** -0.125)

    def _cut(self, segment: Segment, t: float, hit: set[int]) -> None:
        """End the step at an event and deal with it."""
        self.stalled = self.stalled + 1 if t - self.t <= 1e-13 * max(1.0, t) else 0
        impacts = len(self.impacts)
        if self.stalled > MAX_STALLED:
            raise SimulationError(
                f"scene: {self.stalled} events at t = {t:.6g} s without progress; the modes of contact do "
                "not settle there; a larger resting_speed may help",
                field="scene",
            )
        segment.end = t = float(t)
        self.q, self.v = segment.at(t)
        self.w = segment.works(t)
        self.t = t
        self.segments.append(segment)
        self._sample()
        self._settle(hit)
        if len(self.impacts) > impacts:  # `max_impacts` watches over these
            self.stalled = 0
        self._restart()
        self._sample()

    # ---- events within a step

    def _first_event(
        self, segment: Segment, gaps: list[tuple[float, float]], velocity: Array
    ) -> tuple[float, set[int]] | None:
        """Return time and numbers of the first event in a step; a time of −1 asks for a shorter step."""
        flow, integrator = self.flow, self.integrator
        start, end = segment.start, segment.end
        found: tuple[float, set[int]] | None = None

        for i, before, after in zip(self.watched, self.gaps, gaps, strict=True):
            bounds = flow.points[i].curvature(integrator.peak, segment.h)
            fall, _ = curvatures(before[1], after[1], segment.h, bounds)
            if not guards.clear(max(before[0], 0.0), before[1], *after, fall, segment.h, self.floor):

                def sample(t: float, i: int = i) -> tuple[float, float]:
                    q, v = segment.at(t)
                    flow.open(t, q, v)
                    return flow.points[i].gap_and_rate()

                last = after if end == segment.end else sample(end)
                t = first_crossing(sample, start, end, before, last, bounds, self.floor)
                if t is not None:
                    found, end = (t, {i}), t

        if self.limits:
            count = guards.unclear_limits(
                self._limit_q,
                self._limit_v,
                self._limit_sign,
                self._limit_bound,
                self.q,
                self.v,
                integrator.q1,
                integrator.v1,
                integrator.peak,
                segment.end - start,
                self.floor,
                self._limit_found,
            )
            for k in self._limit_found[:count].tolist():
                if k in self.limit_closed:
                    continue
                limit = self.limits[k]

                def of_limit(t: float, limit: Any = limit) -> tuple[float, float]:
                    q, v = segment.at(t)
                    return limit.sign * (q[limit.index_q] - limit.bound), limit.sign * v[limit.index_v]

                size, change = 1.5 * integrator.peak[1::2, limit.index_v]
                t = first_crossing(
                    of_limit, start, end, of_limit(start), of_limit(end), (size, change), self.floor
                )
                if t is not None:
                    found, end = (t, {len(self.contacts) + k}), t

        if flow.sliding.any():
            for j in np.flatnonzero(flow.sliding * integrator.v1 < -1e-12).tolist():
                sign = math.copysign(1.0, flow.sliding[j])
                if sign * self.v[j] > 0.0:

                    def rate(t: float, j: int = j) -> float:
                        return float(segment.at(t)[1][j])

                    t = root(rate, start, segment.end, float(self.v[j]), float(integrator.v1[j]))
                    if t < end:
                        found, end = (t, set()), t

        if not flow.constrained:
            return found
        return self._first_change_of_mode(segment, end, velocity) or found

    def _first_change_of_mode(
        self, segment: Segment, end: float, velocity: Array
    ) -> tuple[float, set[int]] | None:
        """Return when a slip ends, or a force leaves what its mode allows, before `end`."""
        flow = self.flow
        scratch = np.empty(flow.nv + QUADRATURES)
        found: tuple[float, set[int]] | None = None

        def evaluate(t: float) -> None:
            q, v = segment.at(t)
            flow(t, q, v, scratch)

        for k in range(len(flow.modes)):
            if flow.modes[k] != SLIP or flow.mu[k] == 0.0:
                continue
            direction = flow.reference[k].copy()

            def along(t: float, k: int = k, direction: Array = direction) -> float:
                evaluate(t)
                return float(direction @ flow.active.velocity[k, :2])

            ahead = float(direction @ velocity[k, :2])
            if ahead >= -1e-3 * flow.still:
                continue
            first = along(segment.start)
            if first <= 0.0:
                continue
            t = root(along, segment.start, segment.end, first, ahead)
            if t < end:
                along(t)
                if math.hypot(*flow.active.velocity[k, :2]) > flow.still:
                    return -1.0, set()
                found, end = (t, set()), t

        if flow.least_margin < 0.0 and not self.tolerated:

            def margin(t: float) -> float:
                evaluate(t)
                return max(flow.margin, -1e300)

            before, m_before = segment.start, margin(segment.start)
            for t in np.linspace(segment.start, end, 11)[1:].tolist():
                m = margin(t)
                if m < 0.0:
                    if m_before > 0.0:
                        t = root(margin, before, t, m_before, m)
                    return t, set()
                before, m_before = t, m
        return found

    # ---- impacts and modes at one instant

    def _number_of(self, i: int) -> tuple[float, float]:
        """Return gap and gap rate of contact or limit i, at the state last evaluated."""
        if i < len(self.contacts):
            return self.flow.points[i].gap_and_rate()
        limit = self.limits[i - len(self.contacts)]
        return (
            limit.sign * (float(self.q[limit.index_q]) - limit.bound),
            limit.sign * float(self.v[limit.index_v]),
        )

    def _name_of(self, i: int) -> str:
        count = len(self.contacts)
        return self.contacts[i].label if i < count else self.limits[i - count].name

    def _settle(self, hit: set[int]) -> None:
        """Resolve the impacts of this instant, then let contacts rest, slip or open as their forces demand.

        Of contacts that approach together the fastest is resolved first, and again, until none approaches
        faster than the resting speed.
        """
        flow, count = self.flow, len(self.contacts)
        hit = set(hit)
        if flow.constrained:
            self._correct()
        closed = {i for i in range(count) if flow.mode[i] != FREE} | {count + k for k in self.limit_closed}
        flow.open(self.t, self.q, self.v)
        numbers = {i: self._number_of(i) for i in range(count + len(self.limits))}
        touching = [
            i
            for i, (gap, _) in numbers.items()
            if i in closed or gap <= self.touch or (i in hit and self.t > 0.0)
        ]
        pending: list[dict[str, Any]] = []
        while True:
            rates = {i: self._number_of(i)[1] for i in touching}
            approaching = [
                i for i in touching if rates[i] < -self.rest or (i in hit and rates[i] < -self.quiet)
            ]
            if approaching and len(pending) < MAX_ROUNDS:
                i = min(approaching, key=lambda i: rates[i])
                hit.discard(i)
                pending.append(self._collide(i, -rates[i]))
                flow.open(self.t, self.q, self.v)
                continue
            if approaching:
                self._note(
                    f"{MAX_ROUNDS} impacts at one instant did not settle; the approach left was taken away."
                )
            jamming = self._close(touching)
            if jamming is None:
                break
            self._note(
                f"Slip at {self._name_of(jamming)} drives the surface in and no force holds it: "
                "an impact without collision."
            )
            pending.append(self._jam(jamming))
            flow.open(self.t, self.q, self.v)
        self.impacts += [ImpactRecord(**fields, simultaneous=len(pending) > 1) for fields in pending]
        if len(self.impacts) > self.max_impacts:
            raise SimulationError(
                f"max_impacts: {len(self.impacts)} impacts until t = {self.t:.6g} s, the last at "
                f"{self.impacts[-1].source!r}; if they accumulate, a larger resting_speed or a smaller "
                "restitution ends them, otherwise raise max_impacts",
                field="max_impacts",
                value=self.max_impacts,
            )

    def _collide(self, i: int, approach: float) -> dict[str, Any]:
        """Resolve one impact; return the fields of its record."""
        q, v = self.q, self.v
        slow = self.sustained and approach <= self.rest
        if i < len(self.contacts):
            contact = self.contacts[i]
            plastic = not callable(contact.restitution) and contact.restitution == 0.0
            hit, resting = None, slow and not plastic
            if not slow:
                hit = self._impact(contact, v)
                self.flow.open(self.t, q, hit.v)
                resting = self.sustained and not plastic and self._number_of(i)[1] < self.rest
            if hit is None or resting:
                hit = self._impact(self.plastic[i], v)
            after, problem, impulse = hit.v.copy(), hit.problem, hit.impulse_world
        else:
            limit = self.limits[i - len(self.contacts)]
            e = self.limit_restitution
            resting = e > 0.0 and self.sustained and (slow or e * approach < self.rest)
            e = 0.0 if resting else e
            response = limit.sign * self._yielding_inverse()[:, limit.index_v]
            c = limit.sign * float(response[limit.index_v])
            rate = limit.sign * float(v[limit.index_v])
            if c <= 1e-12 * float(np.abs(response).max(initial=0.0)) or c <= 0.0:
                raise SimulationError(
                    f"locked: the joint limit {limit.name!r} is hit at {-rate:.6g}, but what is held or "
                    "locked keeps the joint from yielding; leave it out there",
                    field="locked",
                    value=limit.name,
                )
            problem = ImpactProblem(np.diag([0.0, 0.0, c]), np.array([0.0, 0.0, rate]), 0.0, e)
            after, impulse = v - response * ((1.0 + e) * rate / c), np.zeros(3)
        if resting:
            self._note(
                f"{self._name_of(i)} is taken as resting: it would bounce slower than {self.rest:.3g} m/s."
            )
        return self._record(i, after, problem, impulse, resting)

    def _jam(self, i: int) -> dict[str, Any]:
        """Resolve the impact without collision of a contact that slips; return the fields of its record."""
        contact = self.contacts[i]
        matrices = contact_matrices(self.model, self.data, self.q, contact, self.held, self.locked)
        velocity = matrices.velocity(self.v)
        velocity[2] = 0.0
        e = contact.restitution_at(0.0)
        problem = ImpactProblem(
            matrices.delassus, velocity, contact.friction, e, contact.law, matrices.surface_velocity
        )
        solution = solve_impact(problem)
        after = self.v + matrices.response @ solution.impulse
        return self._record(i, after, problem, solution.impulse @ matrices.axes, False)

    def _record(
        self, i: int, after: Array, problem: ImpactProblem, impulse: Array, resting: bool
    ) -> dict[str, Any]:
        """Take over the velocity after an impact; return the fields of its record."""
        before = self.v
        self.work_of_impacts += self._kinetic(after) - self._kinetic(before)
        self.v = after
        return {
            "time": self.t,
            "source": self._name_of(i),
            "q": self.q.copy(),
            "v_before": before.copy(),
            "v_after": after.copy(),
            "problem": problem,
            "impulse_world": impulse,
            "resting": resting,
            "record": self.record and i < len(self.contacts),
        }

    def _impact(self, contact: Contact, v: Array) -> Any:
        if not self.held:
            return impact(self.model, self.data, self.q, v, contact, locked=self.locked)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            hit = impact(self.model, self.data, self.q, v, contact, held=self.held, locked=self.locked)
        for warning in caught:
            self._note(str(warning.message))
        return hit

    def _kinetic(self, v: Array) -> float:
        return float(pin.computeKineticEnergy(self.model, self.data, self.q, v))

    def _yielding_inverse(self) -> Array:
        """Return M⁻¹ with what is held and locked projected out, at the state last evaluated."""
        inverse = self.flow.inverse().copy()
        rows = np.eye(self.model.nv)[~free_velocities(self.model, self.locked)]
        if self.held:
            anchors = Active(self.flow.points[len(self.contacts) :], [], self.model.nv)
            anchors.measure()
            rows = np.vstack([rows, anchors.rows.reshape(-1, self.model.nv)])
        if len(rows):
            response = inverse @ rows.T
            inverse -= response @ np.linalg.pinv(rows @ response, rcond=1e-10, hermitian=True) @ response.T
        return inverse

    def _close(self, touching: list[int]) -> int | None:
        """Set the modes of what touches without bouncing; return a contact where no force exists, if any."""
        flow, count, nv = self.flow, len(self.contacts), self.model.nv
        slow = [i for i in touching if self.sustained and abs(self._number_of(i)[1]) <= max(self.rest, 0.0)]
        held = list(range(count, len(flow.points)))
        contacts = [i for i in slow if i < count] + held
        limits = [i - count for i in slow if i >= count]
        stuck: list[int] = []
        if flow.dry.any():
            stuck = [j for j in np.flatnonzero(flow.dry).tolist() if abs(self.v[j]) <= flow.still]
            flow.sliding = flow.dry * np.sign(self.v)
            flow.sliding[stuck] = 0.0
        scalars = [self.limits[k].index_v for k in limits] + stuck
        infinite = math.inf
        bounds = [(0.0, infinite) if self.limits[k].sign > 0.0 else (-infinite, 0.0) for k in limits]
        bounds += [(-float(flow.dry[j]), float(flow.dry[j])) for j in stuck]
        if not contacts and not scalars:
            self._set_modes([FREE] * count, {}, [], [], [], stuck)
            return None

        active = Active([flow.points[i] for i in contacts], scalars, nv)
        open_acceleration = np.array(flow.open(self.t, self.q, self.v))
        inverse = flow.inverse().copy()
        active.measure()
        rows = active.stacked()
        delassus = rows @ inverse @ rows.T
        free = np.concatenate([active.acceleration.ravel(), open_acceleration[scalars]])
        mu = np.array([flow.points[i].contact.friction for i in contacts])
        bilateral = np.array([i >= count for i in contacts])
        force = np.zeros((len(contacts), 3))
        scalar_force = np.zeros(len(scalars))
        sweeps, jamming = sustained.decide(
            delassus,
            free,
            active.velocity[:, :2],
            mu,
            bilateral,
            flow.still,
            np.array([lower for lower, _ in bounds]),
            np.array([upper for _, upper in bounds]),
            force,
            scalar_force,
            SWEEPS,
            1e-12,
        )
        if jamming >= 0:
            self._take_away(
                rows[3 * jamming + 2 : 3 * jamming + 3], inverse, np.array([active.velocity[jamming, 2]])
            )
            return contacts[jamming]
        if sweeps < 0:
            self._note("The forces of the closed contacts were not found to the usual accuracy.")
        result = free + delassus @ np.concatenate([force.ravel(), scalar_force])
        pace = 1e-9 * (float(np.abs(free).max(initial=0.0)) + 1e-3 * STANDARD_GRAVITY)

        rank = np.linalg.matrix_rank(delassus, tol=1e-10 * float(delassus.max(initial=0.0)), hermitian=True)
        unique = rank == len(delassus)

        mode = [FREE] * len(flow.points)
        reference: dict[int, Array] = {}
        kept: list[int] = []  # rows whose velocity becomes zero
        for k, i in enumerate(contacts):
            normal, tangent = force[k, 2], math.hypot(force[k, 0], force[k, 1])
            speed = math.hypot(active.velocity[k, 0], active.velocity[k, 1])
            if i >= count:
                mode[i] = HELD
                kept += [3 * k, 3 * k + 1, 3 * k + 2]
                continue
            if normal <= flow.allowance and result[3 * k + 2] > pace:
                if active.velocity[k, 2] < 0.0:
                    kept.append(3 * k + 2)
                continue
            kept.append(3 * k + 2)
            # a force on its cone means slip, unless another one would do, and then only what moves slips
            held_back = tangent <= mu[k] * normal * (1.0 - 1e-9)
            held_back |= not unique and math.hypot(result[3 * k], result[3 * k + 1]) <= pace
            if mu[k] > 0.0 and speed <= flow.still and held_back:
                mode[i] = STICK
                kept += [3 * k, 3 * k + 1]
                continue
            mode[i] = SLIP
            if speed > flow.still:
                reference[i] = active.velocity[k, :2] / speed
            elif tangent > 0.0:
                reference[i] = -force[k, :2] / tangent
        base = 3 * len(contacts)
        closed_limits, still_joints = [], []
        for m, k in enumerate(limits):
            sign = self.limits[k].sign
            if abs(scalar_force[m]) <= flow.allowance and sign * result[base + m] > pace:
                continue
            closed_limits.append(k)
            kept.append(base + m)
        for m, j in enumerate(stuck):
            n = base + len(limits) + m
            if abs(scalar_force[len(limits) + m]) >= flow.dry[j] * (1.0 - 1e-9):
                flow.sliding[j] = -math.copysign(flow.dry[j], scalar_force[len(limits) + m])
                self.v[j] = 0.0
                continue
            still_joints.append(j)
            kept.append(n)
        if kept:
            velocity = np.concatenate([active.velocity.ravel(), self.v[scalars]])
            self._take_away(rows[kept], inverse, velocity[kept])
        bounds_by = dict(zip(scalars, bounds, strict=True))
        scalar_rows = [self.limits[k].index_v for k in closed_limits] + still_joints
        self._set_modes(
            mode[:count],
            reference,
            closed_limits,
            scalar_rows,
            [bounds_by[j] for j in scalar_rows],
            still_joints,
        )
        return None

    def _take_away(self, rows: Array, inverse: Array, velocity: Array) -> None:
        """Bring the velocities of the given rows to zero, by the impulses that do least."""
        response = inverse @ rows.T
        impulse = np.linalg.lstsq(rows @ response, velocity, rcond=1e-12)[0]
        after = self.v - response @ impulse
        self.work_of_impacts += self._kinetic(after) - self._kinetic(self.v)
        self.v = after

    def _set_modes(
        self,
        mode: list[int],
        reference: dict[int, Array],
        limits: list[int],
        scalar_rows: list[int],
        bounds: list[tuple[float, float]],
        still_joints: list[int],
    ) -> None:
        flow = self.flow
        mode = mode + [HELD] * len(self.held)
        same = mode == flow.mode and scalar_rows == flow.active.scalars.tolist()
        self.tolerated = same and flow.constrained
        flow.set_modes(mode, reference, scalar_rows, bounds)
        self.told = self.told and same
        self.limit_closed = set(limits)
        now = {flow.points[i].name: MODES[m] for i, m in enumerate(mode) if m != FREE}
        now |= {self.limits[k].name: "closed" for k in limits}
        now |= {self.model.names[_joint_of(self.model, j)]: "stuck" for j in still_joints}
        for source, (name, start) in list(self.standing.items()):
            if now.get(source) != name:
                if self.t > start:
                    self.intervals.append(ModeInterval(source, name, start, self.t))
                del self.standing[source]
        for source, name in now.items():
            self.standing.setdefault(source, (name, self.t))

    # ---- positions of what is closed

    def _drift(self) -> float:
        """Return how far the closed contacts have left their surfaces [m], or their rest [m/s]."""
        flow = self.flow
        worst = 0.0
        for k, m in enumerate(flow.modes):
            velocity = flow.active.velocity[k]
            worst = max(worst, abs(self._offset(k)), abs(velocity[2]))
            if m != SLIP:
                worst = max(worst, abs(velocity[0]), abs(velocity[1]))
        for j in flow.active.scalars:
            worst = max(worst, abs(self.integrator.v1[j]))
        return worst

    def _offset(self, k: int) -> float:
        """Return the gap of the k-th closed contact, of a held one less that at the start."""
        flow = self.flow
        i = flow.closed[k] - len(self.contacts)
        return flow.active.gap[k] - (self.held_gap[i] if i >= 0 else 0.0)

    def _correct(self) -> None:
        """Bring the closed contacts back onto their surfaces, in position and in velocity."""
        flow = self.flow
        scratch = np.empty(flow.nv + QUADRATURES)
        flow(self.t, self.q, self.v, scratch)
        active = flow.active
        inverse = flow.inverse().copy()
        limits = [self.limits[k] for k in sorted(self.limit_closed)]
        rows = np.vstack([active.rows[:, 2, :], np.eye(flow.nv)[[limit.index_v for limit in limits]]])
        if len(rows):
            offset = np.array(
                [self._offset(k) for k in range(len(flow.modes))]
                + [self.q[limit.index_q] - limit.bound for limit in limits]
            )
            response = inverse @ rows.T
            xi = -response @ np.linalg.lstsq(rows @ response, offset, rcond=1e-12)[0]
            self.q = pin.integrate(self.model, self.q, xi)
            for limit in limits:
                self.q[limit.index_q] = limit.bound
            flow(self.t, self.q, self.v, scratch)
            inverse = flow.inverse().copy()
        kept = []
        for k, m in enumerate(flow.modes):
            kept += [3 * k + 2] if m == SLIP else [3 * k, 3 * k + 1, 3 * k + 2]
        base = 3 * len(flow.modes)
        kept += list(range(base, base + len(active.scalars)))
        velocity = np.concatenate([active.velocity.ravel(), self.v[active.scalars]])
        self._take_away(active.stacked()[kept], inverse, velocity[kept])

    # ---- the start

    def _check_start(self) -> None:
        flow = self.flow
        pin.aba(self.model, flow.data, self.q, self.v, flow.idle, pin.Convention.WORLD)
        for i in range(len(self.contacts) + len(self.limits)):
            gap, _ = self._number_of(i)
            if gap < -self.touch:
                if i < len(self.contacts):
                    contact = self.contacts[i]
                    raise InputError(
                        f"q0: the contact {contact.label!r} at frame {contact.frame!r} starts {-gap:.6g} m "
                        "below its surface; start with every contact on or above its surface",
                        field="q0",
                        value=gap,
                    )
                raise InputError(
                    f"q0: the joint starts {-gap:.6g} beyond its limit {self._name_of(i)!r} "
                    f"({self.limits[i - len(self.contacts)].bound:.6g}); start within the limits, or leave "
                    'them out with without=("joint limits",)',
                    field="q0",
                    value=gap,
                )
        flow.active.measure()
        for k, point in enumerate(flow.active.points):
            self.held_gap.append(flow.active.gap[k])
            speed = float(np.linalg.norm(flow.active.velocity[k]))
            if speed > 1e-6 * (1.0 + float(np.abs(self.v).max(initial=0.0))):
                raise InputError(
                    f"v0: the held contact {point.name!r} moves at {speed:.6g} m/s against its surface; "
                    "start with it at rest there, or leave it out of held",
                    field="v0",
                    value=speed,
                )


def _altered(contact: Contact, without: tuple[str, ...] | Any) -> Contact:
    """Return a contact without the effects that are switched off."""
    if "contact friction" in without:
        contact = replace(contact, friction=0.0)
    if "restitution" in without:
        contact = replace(contact, restitution=0.0)
    if "moving surfaces" in without:
        still = (0.0, 0.0, 0.0)
        contact = replace(contact, plane=replace(contact.plane, velocity=still, angular_velocity=still))
    return contact


def _joint_of(model: pin.Model, velocity: int) -> int:
    """Return the joint that a velocity index belongs to."""
    return max(j for j in range(1, model.njoints) if model.idx_vs[j] <= velocity and model.nvs[j])
