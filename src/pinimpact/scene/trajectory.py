"""What a simulation leaves: samples, the motion in between, impacts, modes and energy; one file holds it."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..contact_space.problem import ImpactProblem
from ..contact_space.solution import Solution
from ..contact_space.solve import solve_impact
from ..errors import InputError
from .step import QUADRATURES, Segment

Array = NDArray[np.float64]

_FORMAT = 1


@dataclass(frozen=True, eq=False)
class ImpactRecord:
    """One impact of a trajectory.

    Attributes:
        time: When [s].
        source: Name of the contact, or of the joint limit.
        q: (nq,) configuration.
        v_before, v_after: (nv,) velocities.
        resting: The bounce would have been slower than the resting speed, so restitution was left out.
        simultaneous: Other impacts took place at the same instant.
        record: Whether the solution has a path.
        contact_space: Makes `problem` and `impulse_world`, which few ask for.
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

    @cached_property
    def _contact_space(self) -> tuple[ImpactProblem, Array]:
        return self.contact_space()

    @property
    def problem(self) -> ImpactProblem:
        """The contact-space problem that was solved; of a joint limit only the normal row counts."""
        return self._contact_space[0]

    @property
    def impulse_world(self) -> Array:
        """(3,) impulse on the robot in world axes [N s]; zero for a joint limit."""
        return self._contact_space[1]

    @cached_property
    def solution(self) -> Solution:
        """The full solution of the impact, made on first access."""
        return solve_impact(self.problem, record=self.record)


@dataclass(frozen=True, slots=True)
class ModeInterval:
    """A time over which a contact, limit or joint stayed in one mode.

    Attributes:
        source: Name of the contact, joint limit or joint with dry friction.
        mode: "slip", "stick" or "held" for a contact, "closed" for a limit, "stuck" for a joint.
        start, end: Times [s].
    """

    source: str
    mode: str
    start: float
    end: float


@dataclass(frozen=True, slots=True)
class Note:
    """Something about a run that a reader should know.

    Attributes:
        time: When [s].
        text: What, in a sentence.
    """

    time: float
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Energy:
    """Energies and works at the samples [J], each (m,); works are counted from the start.

    Attributes:
        kinetic, potential: Of the robot, with rotor inertia.
        control: Work of the control.
        joints: Work of joint damping and dry friction, ≤ 0.
        friction: Work of friction in sustained contacts, in the velocity relative to the surface, ≤ 0.
        surface: Work of moving surfaces in sustained contacts.
        impacts: Change of kinetic energy in impacts, moving surfaces included, and in contacts that came to
            rest.
    """

    kinetic: Array
    potential: Array
    control: Array
    joints: Array
    friction: Array
    surface: Array
    impacts: Array

    @property
    def total(self) -> Array:
        """(m,) kinetic and potential energy."""
        return self.kinetic + self.potential

    @property
    def residual(self) -> Array:
        """(m,) change of the total energy less all works: zero to the tolerance of the run."""
        works = self.control + self.joints + self.friction + self.surface + self.impacts
        return self.total - self.total[0] - works


class Trajectory:
    """The motion that `simulate` found.

    Attributes:
        t: (m,) times [s], the ends of the smooth stretches; an impact's time stands twice, before and after
            it.
        q, v: (m, nq), (m, nv) samples.
        impacts: The impacts in order.
        modes: The intervals in which contacts, limits and joints were not free, by their end.
        energy: Energies and works at the samples.
        termination: Why the run ended, in a sentence.
        complete: Whether it reached its duration.
        notes: Where the resting speed was used, where forces were not unique, and the like.
        switched_off: Effects switched off although the scene calls for them.
        statistics: Counts: "steps", "rejected", "evaluations".
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        joints: NDArray[np.int64],
        samples: tuple[Array, Array, Array],
        impacts: Sequence[ImpactRecord],
        modes: Sequence[ModeInterval],
        energy: Energy,
        notes: Sequence[Note],
        termination: str,
        complete: bool,
        switched_off: Sequence[str],
        statistics: dict[str, int],
    ) -> None:
        self._segments = tuple(segments)
        self._joints = joints
        self._starts = np.array([segment.start for segment in segments])
        self._ends = np.array([segment.end for segment in segments])
        self.t, self.q, self.v = samples
        self.impacts = tuple(impacts)
        self.modes = tuple(modes)
        self.energy = energy
        self.notes = tuple(notes)
        self.termination = termination
        self.complete = complete
        self.switched_off = tuple(switched_off)
        self.statistics = dict(statistics)

    @property
    def duration(self) -> float:
        """Time that was covered [s]."""
        return float(self.t[-1] - self.t[0])

    def at(self, t: float, side: Literal["left", "right"] = "right") -> tuple[Array, Array]:
        """Return q and v at a time; at an impact's time, before ("left") or after it ("right").

        Raises:
            InputError: A time outside the trajectory, or an unknown side.
        """
        if side not in ("left", "right"):
            raise InputError(f'side: {side!r} given, "left" or "right" expected', field="side", value=side)
        if not self.t[0] <= t <= self.t[-1]:
            raise InputError(
                f"t: {t!r} lies outside the trajectory, from {self.t[0]:.6g} s to {self.t[-1]:.6g} s",
                field="t",
                value=t,
            )
        if side == "right" and t >= self.t[-1]:
            return self.q[-1].copy(), self.v[-1].copy()
        if side == "left" and t <= self.t[0]:
            return self.q[0].copy(), self.v[0].copy()
        if side == "right":
            segment = self._segments[int(np.searchsorted(self._starts, t, side="right")) - 1]
        else:
            segment = self._segments[int(np.searchsorted(self._ends, t, side="left"))]
        return segment.at(float(t))

    def sample(self, times: ArrayLike) -> tuple[Array, Array]:
        """Return q (k, nq) and v (k, nv) at many times, after any impact at them."""
        states = [self.at(float(t)) for t in np.asarray(times, dtype=float)]
        return np.array([q for q, _ in states]), np.array([v for _, v in states])

    def mode_at(self, source: str, t: float) -> str:
        """Return the mode of a contact, limit or joint at a time, "free" where none is on record."""
        for interval in self.modes:
            if interval.source == source and interval.start <= t < interval.end:
                return interval.mode
        return "free"

    def save(self, path: str | Path) -> None:
        """Write the trajectory to one .npz file, numbers and text only."""
        impacts, segments = self.impacts, self._segments
        nq, nv = self.q.shape[1], self.v.shape[1]
        meta = {
            "format": _FORMAT,
            "termination": self.termination,
            "complete": self.complete,
            "switched_off": self.switched_off,
            "statistics": self.statistics,
            "notes": [[note.time, note.text] for note in self.notes],
            "modes": [[m.source, m.mode, m.start, m.end] for m in self.modes],
            "impacts": [
                [
                    i.time,
                    i.source,
                    i.problem.friction,
                    i.problem.restitution,
                    i.problem.law,
                    i.resting,
                    i.simultaneous,
                    i.record,
                ]
                for i in impacts
            ],
        }

        def stack(rows: Sequence[Any], *shape: int) -> Array:
            return np.array(rows, dtype=float).reshape(len(rows), *shape)

        with open(path, "wb") as file:
            np.savez_compressed(
                file,
                meta=np.array(json.dumps(meta)),
                joints=self._joints,
                t=self.t,
                q=self.q,
                v=self.v,
                energy=np.array([getattr(self.energy, name) for name in Energy.__dataclass_fields__]),
                segment_times=stack([(s.start, s.end, s.h) for s in segments], 3),
                segment_q=stack([s.q for s in segments], nq),
                segment_v=stack([s.v for s in segments], nv),
                segment_w=stack([s.w for s in segments], QUADRATURES),
                segment_dense=stack([s.coefficients for s in segments], 7, 2 * nv + QUADRATURES),
                impact_q=stack([i.q for i in impacts], nq),
                impact_v=stack([(i.v_before, i.v_after) for i in impacts], 2, nv),
                impact_delassus=stack([i.problem.delassus for i in impacts], 3, 3),
                impact_vectors=stack(
                    [(i.problem.velocity, i.problem.surface_velocity, i.impulse_world) for i in impacts], 3, 3
                ),
            )

    @classmethod
    def load(cls, path: str | Path) -> Trajectory:
        """Read what `save` wrote.

        Raises:
            InputError: A file that is missing, or is no trajectory.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            meta = json.loads(str(arrays["meta"]))
            if meta["format"] != _FORMAT:
                raise ValueError(f"format {meta['format']}")
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise InputError(
                f"path: {str(path)!r} is no readable trajectory ({error}); give a file that save() wrote",
                field="path",
                value=path,
            ) from error
        joints = arrays["joints"]
        segments = []
        for i, (start, end, h) in enumerate(arrays["segment_times"].tolist()):
            segment = Segment(
                start,
                h,
                arrays["segment_q"][i],
                arrays["segment_v"][i],
                arrays["segment_w"][i],
                arrays["segment_dense"][i],
                joints,
            )
            segment.end = end
            segments.append(segment)
        impacts = [
            ImpactRecord(
                time,
                source,
                arrays["impact_q"][i],
                arrays["impact_v"][i, 0],
                arrays["impact_v"][i, 1],
                resting,
                simultaneous,
                record,
                partial(
                    _contact_space, arrays["impact_delassus"][i], arrays["impact_vectors"][i], (mu, e, law)
                ),
            )
            for i, (time, source, mu, e, law, resting, simultaneous, record) in enumerate(meta["impacts"])
        ]
        return cls(
            segments,
            joints,
            (arrays["t"], arrays["q"], arrays["v"]),
            impacts,
            [ModeInterval(*row) for row in meta["modes"]],
            Energy(*arrays["energy"]),
            [Note(*row) for row in meta["notes"]],
            meta["termination"],
            meta["complete"],
            meta["switched_off"],
            meta["statistics"],
        )

    def __repr__(self) -> str:
        return f"Trajectory({self.duration:.6g} s, {len(self.impacts)} impacts; {self.termination})"


def _contact_space(
    delassus: Array, vectors: Array, law: tuple[float, float, str]
) -> tuple[ImpactProblem, Array]:
    velocity, surface, impulse = vectors
    return ImpactProblem(delassus, velocity, *law, surface), impulse
