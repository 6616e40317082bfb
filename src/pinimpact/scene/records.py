"""Records of a run: impacts, contact modes, energy, events and notes."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from itertools import groupby
from typing import Any, Protocol

import numpy as np

from ..arrays import Array
from ..contact_space.derivatives import Boundary
from ..contact_space.many_solution import ManySolution
from ..contact_space.problem import ImpactProblem
from ..contact_space.solution import Solution
from ..contact_space.solve import solve_impact
from ..display import short_repr
from ..errors import BoundReachedWarning
from ..robot.contact import Contact


@dataclass(frozen=True, eq=False, repr=False)
class ImpactGroup:
    """An impact at several contacts and limits, shared by the records of those with an impulse.

    Attributes:
        problem: The impact problem of all contacts.
        policy: Name of the policy that resolves it.
        options: Options of the policy.
        sources: Numbers of the contacts and limits; empty if the group was loaded from a file.
    """

    problem: ImpactProblem
    policy: str
    options: Mapping[str, Any]
    sources: tuple[int, ...] = ()

    __repr__ = short_repr

    @cached_property
    def solution(self) -> ManySolution:
        """The solution at all contacts, computed on first access."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BoundReachedWarning)  # the run has issued it
            return solve_impact(self.problem, record=True, simultaneous=self.policy, **self.options)


@dataclass(frozen=True, eq=False, repr=False)
class ImpactRecord:
    """One impact of a trajectory.

    Attributes:
        time: Time [s].
        source: Name of the contact or joint limit.
        q: (nq,) configuration.
        v_before, v_after: (nv,) velocities.
        resting: Whether the bounce is slower than the resting speed, so that the contact can stay closed;
            alone it is computed with a restitution of zero.
        simultaneous: Whether other impacts took place at the same instant.
        record: Whether the solution has a path.
        contact_space: Function that computes `problem` and `impulse_world`.
        group: For an impact at several contacts the `ImpactGroup` of all of them and the index in it. Then
            v_before and v_after are those of the whole impact, and `problem` is the part of this contact.
        contact: For two shapes their contact point, as a contact; else None.
    """

    time: float
    source: str
    q: Array
    v_before: Array
    v_after: Array
    resting: bool
    simultaneous: bool
    record: bool
    contact_space: Callable[[], tuple[ImpactProblem, Array]]
    group: tuple[ImpactGroup, int] | None = None
    contact: Contact | None = None

    @cached_property
    def _contact_space(self) -> tuple[ImpactProblem, Array]:
        return self.contact_space()

    @property
    def problem(self) -> ImpactProblem:
        """The contact-space problem that was solved; for a joint limit only the normal row has a meaning."""
        return self._contact_space[0]

    @property
    def impulse_world(self) -> Array:
        """(3,) impulse on the robot in world axes [N s]; zero for a joint limit."""
        return self._contact_space[1]

    @cached_property
    def solution(self) -> Solution:
        """The solution of the impact, computed on first access; for several contacts the part of this one."""
        if self.group is not None:
            whole, place = self.group
            return whole.solution.part(place)
        return solve_impact(self.problem, record=self.record)

    @property
    def summary(self) -> tuple[float, str, float, float, float]:
        """Time [s], source, speed of approach [m/s], size of the impulse [N s] and work [J]."""
        approach = -float(np.asarray(self.problem.velocity)[2])
        impulse = float(np.linalg.norm(self.solution.impulse))
        return self.time, self.source, approach, impulse, self.solution.work.total

    @property
    def remarks(self) -> list[str]:
        """Special properties of the impact, such as "resting" or "stick"."""
        words = [word for word in ("resting", "simultaneous") if getattr(self, word)]
        return words + [word for word in ("stick", "resumed slip", "jam") if word in self.solution.effects]

    def __repr__(self) -> str:
        solution, marks = self.solution, self.remarks
        before, after = float(np.asarray(self.problem.velocity)[2]), float(solution.velocity[2])
        return (
            f"ImpactRecord({self.source!r} at t = {self.time:.6g} s: normal velocity {before:.6g} to "
            f"{after:.6g} m/s, impulse {float(np.linalg.norm(solution.impulse)):.6g} N s, "
            f"work {solution.work.total:.6g} J"
            f"{'; ' + ', '.join(marks) if marks else ''})"
        )

    def __getstate__(self) -> dict[str, Any]:
        # cached results are omitted, and the function `contact_space` is replaced by its result
        state = {field.name: getattr(self, field.name) for field in fields(self)}
        return state | {"contact_space": partial(tuple, self._contact_space)}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class EventRecord:
    """One user event.

    Attributes:
        time: Time [s].
        name: Name of the event.
        q: (nq,) configuration.
        v_before, v_after: (nv,) velocities, before and after its callback.
    """

    time: float
    name: str
    q: Array
    v_before: Array
    v_after: Array

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class ModeInterval:
    """An interval in which a contact, limit or joint stayed in one mode.

    Attributes:
        source: Name of the contact, joint limit or joint with dry friction, or "JOINT drive".
        mode: "slip", "stick" or "held" for a contact, "closed" for a limit, "stuck" for a joint, "saturated"
            for a drive.
        start, end: Times [s].
    """

    source: str
    mode: str
    start: float
    end: float


@dataclass(frozen=True, slots=True)
class SteppedInterval:
    """A part of a motion that was crossed by time stepping.

    Attributes:
        start, end: Times [s].
        dt: Its shortest step [s].
        reason: Why events were not located there.
        error: Estimated error of the coordinates [m or rad]; NaN if steps of two sizes led to impacts in
            different orders, or if impacts were without restitution since there were too many, so that there
            is no estimate.
    """

    start: float
    end: float
    dt: float
    reason: str
    error: float

    def __str__(self) -> str:
        error = "of unknown error" if math.isnan(self.error) else f"estimated error {self.error:.2g}"
        return (
            f"t = {self.start:.4f} s to {self.end:.4f} s: time steps of {self.dt:.3g} s, {error}, since "
            f"events could not be located: {self.reason}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivity:
    """Derivatives of the state (q, v) of a motion at a time, with δq in Pinocchio's tangent space.

    Attributes:
        state: (2nv, 2nv) derivatives by the initial state; None if they were not requested.
        parameters: (2nv,) derivatives by each requested coefficient, by its name.
        boundary: Flags of `Boundary`; what has no derivative is NaN.
    """

    state: Array | None
    parameters: dict[str, Array]
    boundary: Boundary


class SensitivitySource(Protocol):
    """Source of the sensitivities of a trajectory."""

    def at(self, number: int, t: float) -> Sensitivity:
        """Return the sensitivity at a time [s] in a step, given by number."""


@dataclass(frozen=True, slots=True)
class Note:
    """A sentence about a limitation or a special event of a run.

    Attributes:
        time: Time [s].
        text: The sentence.
    """

    time: float
    text: str

    def __str__(self) -> str:
        return f"t = {self.time:.4f} s: {self.text}"


@dataclass(frozen=True, slots=True)
class NoteGroup:
    """Notes with the same text except for numbers.

    Attributes:
        text: Text of the first note.
        times: Times of the notes in ascending order [s].
    """

    text: str
    times: tuple[float, ...]

    def __str__(self) -> str:
        first, last = self.times[0], self.times[-1]
        if len(self.times) == 1:
            return f"t = {first:.4f} s: {self.text}"
        return f"t = {first:.4f} to {last:.4f} s, {len(self.times)} times: {self.text}"


def group_notes(notes: Sequence[Note]) -> tuple[NoteGroup, ...]:
    """Group notes whose texts differ only in numbers with units, in the order of first occurrence."""
    groups: dict[str, list[Note]] = {}
    for note in notes:
        groups.setdefault(_NUMBER.sub("#", note.text), []).append(note)
    return tuple(NoteGroup(same[0].text, tuple(n.time for n in same)) for same in groups.values())


_NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(\.\d*)?(e[-+]?\d+)?(?= (m|s|N|rad|J)\b)")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Energy:
    """Energies and work at the times of the trajectory [J], each (m,); work is summed from the start.

    Attributes:
        kinetic, potential: Energies of the robot, with rotor inertia.
        control: Work of the control.
        joints: Work of joint damping and dry friction, ≤ 0.
        friction: Work of friction in sustained contacts, on the velocity relative to the surface, ≤ 0.
        surface: Work of moving surfaces in sustained contacts.
        impacts: Change of kinetic energy in impacts (including moving surfaces), at contacts that come to
            rest, and by callbacks of events; with time steps also the energy of removing overlap.
    """

    kinetic: Array
    potential: Array
    control: Array
    joints: Array
    friction: Array
    surface: Array
    impacts: Array

    def __repr__(self) -> str:
        works = ", ".join(f"{cause} {float(work[-1]):.6g}" for cause, work in self.by_cause().items())
        return (
            f"Energy({float(self.total[0]):.6g} J to {float(self.total[-1]):.6g} J; work: {works}; "
            f"energy residual {float(self.residual[-1]):.2g} J)"
        )

    def by_cause(self) -> dict[str, Array]:
        """Return the work (m,) by cause [J]."""
        return {
            cause: getattr(self, cause) for cause in ("control", "joints", "friction", "surface", "impacts")
        }

    def changes(self) -> dict[str, float]:
        """Return the changes over the motion [J]: the total energy, work by cause and the residual."""
        works = {f"work of {cause}": float(work[-1]) for cause, work in self.by_cause().items()}
        total = float(self.total[-1] - self.total[0])
        return {"kinetic and potential": total, **works, "energy residual": float(self.residual[-1])}

    @property
    def total(self) -> Array:
        """(m,) kinetic and potential energy."""
        return self.kinetic + self.potential

    @property
    def residual(self) -> Array:
        """(m,) change of the total energy minus all work: zero to the tolerance of the run."""
        return self.total - self.total[0] - sum(self.by_cause().values())


def by_impact(records: Sequence[ImpactRecord]) -> list[list[ImpactRecord]]:
    """Return the records of each impact: several if contacts or joint limits collided simultaneously."""
    groups = groupby(records, lambda one: id(one if one.group is None else one.group[0]))
    return [list(group) for _, group in groups]
