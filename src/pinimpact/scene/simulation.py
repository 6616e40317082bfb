"""The simulation: smooth flow up to the next event, the reset there, and so on to the end."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..checks import finite_array
from ..errors import InputError, PinimpactError, SimulationError
from ..robot.data_cache import checked_configuration, data_cache
from ._kernels import advance, dynamics, step_dop853, step_radau
from .records import Energy, ModeInterval
from .scene import Scene
from .state import Instant
from .step import QUADRATURES, Segment
from .trajectory import Trajectory

Array = NDArray[np.float64]
Progress = Callable[[float, float], None]
"""progress(t, duration), called after every step."""

CERTAIN = 10.0
"""Slip has a direction where it is faster than the error of a step by this factor."""

MAX_STALLED = 200
"""Steps without progress in time, after which slip is stopped, or a simulation gives up."""

JAMS = 3
"""How often slip that a jam has stopped may begin again at one instant before it is left to begin."""

STALLED = 1e-8
"""Time [s] that is no progress, or that part of a duration below 1 s."""


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
        InputError: A start below a surface or beyond a joint limit, a held contact that moves or is further
            from its surface than a thousandth of the robot's size, numbers of the wrong shape or range.
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
    """One simulation under way."""

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
        try:
            q = checked_configuration(data_cache(model, self.data), model, q0).copy()
        except InputError as error:
            raise InputError(f"q0: {str(error).removeprefix('q: ')}", field="q0", value=q0) from None
        v = finite_array("v0", v0, (model.nv,)).copy()
        self.now = Instant(scene, model, self.data, q, v)
        self.flow = self.now.flow
        self.rtol, self.atol = rtol, atol
        self.drift = max(self.now.touch, atol)
        self.switched_off = scene.plan().switched_off if without else ()
        self.sources = scene.sources()
        self.duration = duration
        self.max_step = max_step
        self.max_impacts = max_impacts
        self.w = np.zeros(QUADRATURES)
        self.segments: list[Segment] = []
        self.samples: list[tuple[float, Array, Array, Array, float]] = []
        self.steps = self.rejected = 0
        self.jams = 0
        self.mark = 0, 0.0
        self.told = False
        self._later = np.empty((len(self.flow.contacts), 2))

    def go(self, progress: Progress | None) -> Trajectory:
        """Run to the end; return the trajectory, or raise with what there is of it."""
        now = self.now
        kept = self._kept()
        try:
            self._sample()
            kept = self._kept()
            now.settle(starting=True)
            self._restart()
            h = self.flow.step.first_length(self.rtol, self.atol)
            while now.t < self.duration:
                h = self._step(h)
                kept = self._kept()
                if progress is not None:
                    progress(now.t, self.duration)
        except KeyboardInterrupt:
            return self._trajectory("Interrupted from the keyboard.", False, kept)
        except PinimpactError as error:
            self._stop(error, kept)
        return self._trajectory("The duration is covered.", True, self._kept())

    def _stop(self, error: PinimpactError, kept: tuple[Any, ...]) -> None:
        partial = self._trajectory(f"Stopped: {error}", False, kept)
        reached = partial.t[-1]
        if isinstance(error, SimulationError):
            error.partial = partial
            raise error
        raise SimulationError(
            f"{error.field}: the simulation stops at t = {reached:.6g} s: {type(error).__name__}: {error}",
            partial=partial,
            field=error.field,
            value=error.value,
        ) from error

    def _kept(self) -> tuple[Any, ...]:
        """What is consistent now; an interrupt falls back to it."""
        return (
            len(self.segments),
            len(self.samples),
            len(self.now.impacts),
            len(self.now.intervals),
            dict(self.now.standing),
            len(self.now.notes),
        )

    def _trajectory(self, termination: str, complete: bool, kept: tuple[Any, ...]) -> Trajectory:
        segments, samples, impacts, intervals, standing, notes = kept
        rows = self.samples[: max(samples, 1)]
        t = np.array([row[0] for row in rows])
        q = np.array([row[1] for row in rows])
        v = np.array([row[2] for row in rows])
        w = np.array([row[3] for row in rows])
        kinetic, potential = np.empty((2, len(rows)))
        for k, (_, at, moving, *_) in enumerate(rows):
            kinetic[k] = pin.computeKineticEnergy(self.model, self.data, at, moving)
            potential[k] = pin.computePotentialEnergy(
                self.model, self.data
            )  # where the line before has put it
        impacts_work = np.array([row[4] for row in rows])
        energy = Energy(kinetic, potential, w[:, 0], w[:, 1], w[:, 2], w[:, 3], impacts_work)
        modes = self.now.intervals[:intervals] + [
            ModeInterval(source, mode, start, float(t[-1])) for source, (mode, start) in standing.items()
        ]
        return Trajectory(
            self.segments[:segments],
            self.flow.step.joints,
            (t, q, v),
            self.now.impacts[:impacts],
            modes,
            energy,
            self.now.notes[:notes],
            termination,
            complete,
            self.switched_off,
            {"steps": self.steps, "rejected": self.rejected, "evaluations": self.flow.evaluations},
            self.sources,
        )

    def _sample(self) -> None:
        now = self.now
        self.samples.append((now.t, now.q, now.v, self.w, now.work))

    def _restart(self) -> None:
        """Begin a smooth stretch at the present state."""
        now, flow = self.now, self.flow
        self.seen = np.empty_like(self._later)
        error = self.atol + self.rtol * float(np.abs(now.v).max(initial=0.0))
        flow.state[dynamics.SLOWEST] = min(CERTAIN * error, flow.state[dynamics.STILL])
        # no step is taken far beyond the end of a bounce
        self.horizon = 1.3 * flow.begin(now.t, now.q, now.v, now.touch, self.seen)
        now.tolerated &= flow.doubtful
        if not flow.unique and not self.told:
            now.note("The forces of the closed contacts are not unique; those of least norm are taken.")
        self.told = not flow.unique

    def _step(self, h: float) -> float:
        """Take one accepted step, or a part of it up to an event; return the length to try next."""
        now, flow, t = self.now, self.flow, self.now.t
        if self.steps - self.mark[0] > MAX_STALLED:
            if t - self.mark[1] > STALLED * min(1.0, self.duration):
                self.mark = self.steps, t
            elif self._unstick():
                return flow.step.first_length(self.rtol, self.atol)
            else:
                raise SimulationError(
                    f"scene: {MAX_STALLED} steps at t = {t:.6g} s without progress; the modes of contact do "
                    "not settle there; a larger resting_speed may help",
                    field="scene",
                )
        left = self.duration - t
        natural = h
        h = min(h, self.max_step, self.horizon)
        while True:
            trial = left if h > 0.9 * left else h
            if t + trial <= t:
                if self._unstick():
                    return flow.step.first_length(self.rtol, self.atol)
                raise SimulationError(
                    f"rtol: the step fell to {trial:.3g} s at t = {t:.6g} s; the motion is not smooth "
                    "(a control that jumps, forces beyond bounds?), or the tolerance is too small",
                    field="rtol",
                    value=self.rtol,
                )
            explicit = trial * flow.stiffness <= step_radau.STIFF
            attempt = step_dop853.attempt if explicit else step_radau.attempt
            error = attempt(t, trial, self.rtol, self.atol, flow.machine)
            flow.check()
            if error > 1.0:
                self.rejected += 1
                natural = h = trial * (0.2 if math.isinf(error) else max(0.2, 0.9 * error**-0.125))
                continue
            time, number, margin, drift, growth = advance.finish(
                *(t, trial, error, explicit, now.floor, now.tolerated, self.seen, self._later, flow.machine)
            )
            flow.check()
            if time >= t:
                break
            self.rejected += 1
            h = 0.5 * trial  # the slip turns too fast for a step of this length
        self.steps += 1
        segment = flow.step.segment(t, trial, now.q, now.v, self.w)
        self.segments.append(segment)
        if now.tolerated:
            ended = flow.end_of_modes(segment, min(time, segment.end))
            if ended <= segment.end:
                time, number = ended, advance.MODE_CHANGE
        if time <= segment.end:
            self._cut(segment, time, number, drift)
            return natural
        self.w = self.w + segment.coefficients[0, 2 * flow.nv :]
        now.t = segment.end = self.duration if trial == left else segment.end
        now.q, now.v = flow.step.q0.copy(), flow.step.v0.copy()
        if now.tolerated and margin >= 0.0:
            now.tolerated = False
        if flow.constrained and (drift > self.drift or now.tolerated):
            if now.tolerated:
                self._settle()
            else:
                now.correct()
            self._restart()
        else:
            self.seen, self._later = self._later, self.seen
            self.horizon = math.inf
        self._sample()
        return trial * growth

    def _unstick(self) -> bool:
        """Stop all slip where the motion does not go on; return False if nothing slips."""
        if not self.now.jam(certain=True):
            return False
        self.mark = self.steps, self.now.t
        self.jams += 1
        self._settle()
        self._restart()
        self._sample()
        return True

    def _cut(self, segment: Segment, t: float, number: int, drift: float) -> None:
        """End the step at an event and deal with it."""
        now = self.now
        segment.end = now.t = t
        now.q, now.v = segment.at(t)
        self.w = segment.works(t)
        self._sample()
        if drift > self.drift:
            now.correct()
        if number == advance.MODE_CHANGE:
            now.jam(certain=False)
        self._settle(None if number == advance.MODE_CHANGE else number)
        self._restart()
        self._sample()

    def _settle(self, hit: int | None = None) -> None:
        """Let the instant settle, within the number of impacts allowed."""
        impacts = self.now.impacts
        count = len(impacts)
        self.now.settle(hit)
        for _ in range(JAMS):
            if not self.now.jam(certain=False):
                break
            self.jams += 1
            self.now.settle()
        if len(impacts) > count:  # `max_impacts` watches over these
            self.mark = self.steps, self.now.t
        if len(impacts) + self.jams > self.max_impacts:
            last = f", the last at {impacts[-1].source!r}" if impacts else ""
            raise SimulationError(
                f"max_impacts: {len(impacts) + self.jams} impacts until t = {self.now.t:.6g} s{last}; "
                "if they accumulate, a larger resting_speed or a smaller restitution ends them, "
                "otherwise raise max_impacts",
                field="max_impacts",
                value=self.max_impacts,
            )
