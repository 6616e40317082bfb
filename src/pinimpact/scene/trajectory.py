"""The result of a simulation: samples, dense output, impacts, modes and energy."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import Array, Bools, Integers
from ..checks import as_tuple, choice, counted, in_short, near_matches, real_number, real_numbers
from ..display import html_lines, html_table
from ..errors import InputError, UnknownNameError
from ..geometry.surfaces import contact_axes
from ..robot.contact import Contact
from ..tables import AXES, by_component, data_frame
from . import records
from ._kernels.tolerances import ROUNDING
from .columns import impact_columns, mode_columns, modes_at
from .dense_step import WORKS, DenseStep
from .forces import Forces, ForceSource, TabulatedForces
from .trajectory_io import read_trajectory, write_trajectory

PARTS = (
    *("impacts", "events", "modes", "energy", "notes", "stepped"),
    *("termination", "complete", "switched_off", "statistics", "sources", "coordinates"),
)
"""Arguments of `Trajectory` that are attributes of the same name."""

SHOWN = 20
"""Number of impacts that the HTML representation shows."""


class Trajectory:
    """The result of `simulate`. It can be pickled, and saved as a file of numbers and text.

    Attributes:
        t: (m,) times [s] at the ends of steps; an impact's time occurs twice, before and after it.
        q, v: (m, nq), (m, nv) states.
        impacts: The impacts in order.
        events: The user events in order, as `EventRecord`s.
        modes: The intervals in which contacts, limits and joints were not free, by their end.
        energy: Energies and work at the times `t`.
        termination: Why the run ended, as a sentence.
        complete: Whether it reached its duration.
        notes: Sentences with times: where the resting speed was used, where forces were not unique, etc.
        stepped: The intervals crossed by time steps, with `scheme="auto"`.
        switched_off: Effects switched off although they apply.
        statistics: Counts: "steps", "rejected", "evaluations".
        sources: Names that impacts and modes can have: contacts, joint limits and joints.
        contacts: The scene's contacts, then the held ones. In a trajectory from a file or pickle, a contact
            whose restitution was a function has 0; the value of each impact is in its problem.
        coordinates: Names of the entries of q and of v, after those of the joints.
        joint_table: (k, 4) the robot's configuration space, see `joint_charts`.
        sensitivities: Source of `sensitivity`; None unless they were requested from `simulate`.
    """

    def __init__(
        self,
        segments: Sequence[DenseStep],
        joints: Integers,
        samples: tuple[Array, Array, Array],
        impacts: Sequence[records.ImpactRecord],
        events: Sequence[records.EventRecord],
        modes: Sequence[records.ModeInterval],
        energy: records.Energy,
        notes: Sequence[records.Note],
        termination: str,
        complete: bool,
        switched_off: Sequence[str],
        statistics: dict[str, int],
        sources: Sequence[str],
        forces: ForceSource,
        contacts: Sequence[Contact],
        coordinates: tuple[Sequence[str], Sequence[str]],
        stepped: Sequence[records.SteppedInterval] = (),
    ) -> None:
        self._segments = tuple(segments)
        self.joint_table = joints
        self._starts = np.array([segment.start for segment in segments])
        self._ends = np.array([segment.end for segment in segments])
        self.t, self.q, self.v = samples
        self.impacts, self.events, self.modes = tuple(impacts), tuple(events), tuple(modes)
        self.energy, self.notes, self.stepped = energy, tuple(notes), tuple(stepped)
        self.termination, self.complete = termination, complete
        self.switched_off = tuple(switched_off)
        self.statistics = dict(statistics)
        self.sources, self.contacts = tuple(sources), tuple(contacts)
        q_names, v_names = coordinates
        self.coordinates = tuple(q_names), tuple(v_names)
        self._forces = forces
        self.sensitivities: records.SensitivitySource | None = None

    @property
    def duration(self) -> float:
        """Time that was simulated [s]."""
        return float(self.t[-1] - self.t[0])

    def at(self, t: float, side: Literal["left", "right"] = "right") -> tuple[Array, Array]:
        """Return q and v at a time; at an impact's time, before ("left") or after it ("right").

        Raises:
            InputError: A time outside the trajectory, or an unknown side.
        """
        _check_side(side)
        t = self._covered(t)
        if side == "right" and t >= self.t[-1]:
            return self.q[-1].copy(), self.v[-1].copy()
        if side == "left" and t <= self.t[0]:
            return self.q[0].copy(), self.v[0].copy()
        return self._segments[self._number(t, side)].at(t)

    def _number(self, t: float, side: str) -> int:
        """Return the number of the step that contains a time [s]."""
        if side == "right":
            return max(int(np.searchsorted(self._starts, t, side="right")) - 1, 0)
        return min(int(np.searchsorted(self._ends, t, side="left")), len(self._ends) - 1)

    def sensitivity(self, t: float, side: Literal["left", "right"] = "right") -> records.Sensitivity:
        """Return the derivatives of the state at a time by the initial state and by coefficients.

        They are those named in `simulate(..., sensitivities=)`, for changes that preserve the order of
        events. (derivatives.md, 9) At an event's time, before ("left") or after it ("right"). Not available
        from a file or pickle.

        Raises:
            InputError: As in `at`; a trajectory without sensitivities, or a motion without known derivatives.
        """
        _check_side(side)
        t = self._covered(t)
        if self.sensitivities is None:
            what = "sensitivities: name them in simulate(..., sensitivities=); files and pickles have none"
            raise InputError(what, field="sensitivities")
        number = self._number(t, side)
        return self.sensitivities.at(number, min(t, float(self._ends[number])))

    def work_at(self, t: float, side: Literal["left", "right"] = "right") -> Array:
        """Return the work of control, joints, sliding friction and surfaces up to a time, (4,) [J].

        As in `energy`, at any time. Raises the errors of `at`.
        """
        _check_side(side)
        t = self._covered(t)
        if not self._segments:
            return np.zeros(WORKS)
        return self._segments[self._number(t, side)].work_at(t)

    def sample(self, times: ArrayLike) -> tuple[Array, Array]:
        """Return q (k, nq) and v (k, nv) at times (k,), after any impact; (nq,) and (nv,) at one time.

        Raises:
            InputError: Times that are not numbers, or outside the trajectory.
        """
        found = real_numbers("times", times, "a time, or an array of them, in seconds")
        if found.ndim == 0:
            return self.at(float(found))
        states = [self.at(t) for t in found.ravel().tolist()]
        return (
            np.array([q for q, _ in states]).reshape(len(states), self.q.shape[1]),
            np.array([v for _, v in states]).reshape(len(states), self.v.shape[1]),
        )

    def forces(self, contact: str, t: ArrayLike, side: Literal["left", "right"] = "right") -> Array:
        """Return the force of a sustained contact on the robot, in contact axes [N].

        It is evaluated from the state and the contact modes at t by the equations of motion (theory.md,
        sections 9 to 11); in a trajectory from a file or pickle it is interpolated. Impulses of impacts are
        not included. If the motion does not determine the forces, see `forces_unique`, they are those of
        equally stiff contacts.

        Args:
            contact: Name of the contact.
            t: One time, or (m,) of them [s].
            side: At a discontinuity of the forces, the value before ("left") or after it ("right").

        Returns:
            (3,) or (m, 3) along t₁, t₂ and n, see `contact_axes`; zero while the contact is open.

        Raises:
            UnknownNameError: A contact that the scene does not have.
            InputError: A time outside the trajectory, or an unknown side.
        """
        return self._of_contact(contact, t, side, _in_axes)

    def forces_world(self, contact: str, t: ArrayLike, side: Literal["left", "right"] = "right") -> Array:
        """Return the force of `forces` in world axes."""
        return self._of_contact(contact, t, side, lambda forces, i: forces.world[i])

    def joint_forces(self, t: ArrayLike, side: Literal["left", "right"] = "right") -> Array:
        """Return the generalized forces of joint limits and dry joint friction, (nv,) or (m, nv) [N, N m]."""
        nv = self.v.shape[1]
        return self._of_times(t, side, lambda forces: np.zeros(nv) if forces is None else forces.joints)

    def forces_unique(self, t: ArrayLike, side: Literal["left", "right"] = "right") -> Bools:
        """Return whether the motion determines the forces, () or (m,)."""
        found = [step is None or self._forces.unique(*step) for step in self._steps(t, side)]
        return np.array(found, dtype=bool).reshape(np.shape(t))

    def center_of_pressure(
        self, contacts: str | Sequence[str], t: ArrayLike, side: Literal["left", "right"] = "right"
    ) -> Array:
        """Return the mean of contact points, weighted by normal forces, (3,) or (m, 3) in world axes [m].

        For contacts on one plane it is the point of the plane about which their normal forces have no moment.
        NaN if no contact has a force. Raises the errors of `forces`.
        """
        names = as_tuple("contacts", contacts, str, "the name of a contact")
        numbers = [self._contact(contact) for contact in names]

        def center(forces: Forces | None) -> Array:
            if forces is None:
                return np.full(3, np.nan)
            used = [i for i in numbers if i is not None]
            pushes = np.einsum("ij,ij->i", forces.normals[used], forces.world[used])
            total = pushes.sum()
            point: Array = pushes @ forces.points[used] / total if total > 0.0 else np.full(3, np.nan)
            return point

        return self._of_times(t, side, center)

    def _contact(self, name: str) -> int | None:
        """Return the index of a contact in `Forces`; None if it cannot reach its surface."""
        if name in self._forces.contacts:
            return self._forces.contacts.index(name)
        labels = [contact.label for contact in self.contacts]
        if name in labels:
            return None
        if name in self.sources:
            raise UnknownNameError(
                f"contact: {in_short(name)} is a joint, its limit or its drive; their forces are those of "
                "joint_forces",
                value=name,
            )
        raise UnknownNameError(
            f"contact: no contact is called {in_short(name)}; {near_matches(name, labels)}", value=name
        )

    def _of_contact(
        self, contact: str, t: ArrayLike, side: str, part: Callable[[Forces, int], Array]
    ) -> Array:
        i, zero = self._contact(contact), np.zeros(3)
        return self._of_times(t, side, lambda f: zero if f is None or i is None else part(f, i))

    def _of_times(self, t: ArrayLike, side: str, part: Callable[[Forces | None], Array]) -> Array:
        """Return `part(forces)` at one time, or stacked for several times [s]."""
        found = [part(None if step is None else self._forces.at(*step)) for step in self._steps(t, side)]
        if np.ndim(t) == 0:
            return found[0]
        none = np.asarray(part(None))  # has the shape also of no times
        return np.array(found, dtype=none.dtype).reshape(len(found), *none.shape)

    def _steps(self, t: ArrayLike, side: str) -> Iterator[tuple[int, DenseStep, float] | None]:
        """Yield number, step and time for each time [s]; None if the trajectory has no steps."""
        _check_side(side)
        for time in np.ravel(real_numbers("t", t, "a time, or an array of them, in seconds")).tolist():
            covered, number = self._covered(time), self._number(time, side)
            yield (number, self._segments[number], covered) if self._segments else None

    def mode_at(self, source: str, t: float) -> str:
        """Return the mode of a contact, joint limit or joint at a time.

        Args:
            source: Its name, one of `sources`.
            t: Time [s]; at a change of mode the new one is returned, at the end of the trajectory the last.

        Returns:
            A mode of `ModeInterval`, or "free".

        Raises:
            InputError: A time outside the trajectory.
            UnknownNameError: A name that the scene does not have.
        """
        t = self._covered(t)
        if source not in self.sources:
            raise UnknownNameError(
                f"source: no contact, joint limit or joint is called {in_short(source)}; "
                f"{near_matches(source, self.sources)}",
                value=source,
            )
        end = float(self.t[-1])
        for interval in reversed(self.modes):
            if interval.source != source or t < interval.start:
                continue
            if t < interval.end or t == interval.end == end:
                return interval.mode
        return "free"

    def _covered(self, t: float) -> float:
        """Return a time as a float, or raise `InputError` if it is outside the trajectory.

        Times that differ from the ends by rounding (such as 3 * 0.1 > 0.3) are taken as the ends.
        """
        time = real_number("t", t)
        start, end = self.t[[0, -1]].tolist()
        slack = ROUNDING * max(abs(start), abs(end))
        if not start - slack <= time <= end + slack:
            raise InputError(
                f"t: {time} lies outside the trajectory, from {start:.6g} s to {end:.6g} s", value=t
            )
        return min(max(time, start), end)

    def columns(self, rows: Literal["samples", "impacts", "modes"] = "samples") -> dict[str, NDArray[Any]]:
        """Return a table as arrays of equal length, by the names of its columns.

        Args:
            rows: "samples": t [s]; q and v by coordinate; energies and work [J]; for each contact its mode
                and force in contact axes t₁, t₂, n [N]. At an impact's time there are two rows, before and
                after it. "impacts": time [s], source, approach [m/s], impulse in contact axes [N s], work
                [J], friction, restitution, and v before and after. "modes": source, mode, start, end [s].

        Raises:
            UnknownNameError: Unknown rows.
        """
        tables: dict[str, Callable[[], dict[str, NDArray[Any]]]] = {
            "samples": self._sample_columns,
            "impacts": lambda: impact_columns(self.impacts, self.coordinates[1]),
            "modes": lambda: mode_columns(self.modes),
        }
        return tables[choice("rows", rows, tables, "a table")]()

    def to_dataframe(self, rows: Literal["samples", "impacts", "modes"] = "samples") -> Any:
        """Return `columns` as a pandas DataFrame; raise `InputError` also if pandas is not installed."""
        return data_frame(self.columns(rows))

    def _sample_columns(self) -> dict[str, NDArray[Any]]:
        energy, t = self.energy, self.t
        found: dict[str, NDArray[Any]] = {"t": t}
        for letter, names, values in zip("qv", self.coordinates, (self.q, self.v), strict=True):
            found |= by_component(letter, names, values)
        found |= {"kinetic": energy.kinetic, "potential": energy.potential}
        found |= {f"work.{cause}": work for cause, work in energy.by_cause().items()}
        found["residual"] = energy.residual
        before = np.append(t[1:] == t[:-1], False)  # before an impact or other jump
        labels = [contact.label for contact in self.contacts]
        forces = np.zeros((len(t), len(labels), 3))
        if labels:
            numbers = [self._contact(label) for label in labels]

            def in_axes(at: Forces | None) -> Array:
                return np.array([_in_axes(at, i) for i in numbers])

            for side, chosen in (("left", before), ("right", ~before)):
                if chosen.any():
                    forces[chosen] = self._of_times(t[chosen], side, in_axes)
        for k, label in enumerate(labels):
            found[f"{label}.mode"] = modes_at(self.modes, label, t, before)
            found |= by_component(f"{label}.force", AXES, forces[:, k])
        return found

    def save(self, path: str | Path) -> None:
        """Write the trajectory to one .npz file of numbers and text.

        Sensitivities are left out, and contacts whose restitution is a function have zero instead.
        """
        write_trajectory(path, self._parts())

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """Read a file of `save`.

        Raises:
            InputError: A file that is missing or is not a trajectory.
        """
        return cls(**read_trajectory(path))

    def _parts(self) -> dict[str, Any]:
        """Return the arguments of `Trajectory` that describe this one, for files and pickles."""
        parts = {name: getattr(self, name) for name in PARTS}
        return parts | {
            "segments": self._segments,
            "joints": self.joint_table,
            "samples": (self.t, self.q, self.v),
            "forces": TabulatedForces.of(self._forces, self._segments),
            "contacts": tuple(
                replace(contact, restitution=0.0) if callable(contact.restitution) else contact
                for contact in self.contacts
            ),
        }

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the forces as tables: the object that evaluates them holds addresses of this process."""
        return partial(Trajectory, **self._parts()), ()

    def __repr__(self) -> str:
        return (
            f"Trajectory({self.duration:.6g} s, {counted(len(self.impacts), 'impact')}"
            + (f", {sum(s.end - s.start for s in self.stepped):.3g} s in time steps" if self.stepped else "")
            + f"; {self.termination})"
        )

    def __str__(self) -> str:
        """Return a summary of several lines; notes that differ only in numbers are one line."""
        hits = ", ".join(
            f"{source} {count}" for source, count in Counter(i.source for i in self.impacts).items()
        )
        lines = [
            f"{self.duration:.6g} s in {counted(len(self.t) - 1, 'sample')}, "
            f"{counted(len(self.impacts), 'impact')}{f' ({hits})' if hits else ''}. {self.termination}",
            f"Energy {float(self.energy.total[0]):.6g} J to {float(self.energy.total[-1]):.6g} J, "
            f"energy residual {float(self.energy.residual[-1]):.2g} J.",
            *map(str, self.events),
            *map(str, self.stepped),
            *map(str, records.group_notes(self.notes)),
        ]
        if self.switched_off:
            lines.append("Switched off: " + ", ".join(self.switched_off))
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        impacts = html_table(
            f"{self.duration:.6g} s, {counted(len(self.impacts), 'impact')}"
            + (f", the first {SHOWN}" if len(self.impacts) > SHOWN else ""),
            ("t [s]", "contact or limit", "approach [m/s]", "impulse [N s]", "energy [J]"),
            [impact.summary for impact in self.impacts[:SHOWN]],
        )
        changes = html_table("Energy, change over the run [J]", ("", ""), self.energy.changes().items())
        ends = [self.termination, *map(str, self.stepped), *map(str, records.group_notes(self.notes))]
        return impacts + changes + html_lines(ends)


def _check_side(side: str) -> None:
    if not isinstance(side, str) or side not in ("left", "right"):
        raise InputError(f'side: {in_short(side)} given, "left" or "right" expected', value=side)


def _in_axes(forces: Forces | None, i: int | None) -> Array:
    """Return the force (3,) at a contact in its axes, zero if there is none."""
    if forces is None or i is None or not forces.world[i].any():
        return np.zeros(3)
    return contact_axes(forces.normals[i]) @ forces.world[i]
