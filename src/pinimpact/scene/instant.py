"""Changes of the state at one instant: impacts, contact modes, correction of constraint drift.

The methods are in theory.md, sections 11 to 14.
"""

from __future__ import annotations

import math
import warnings
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import EPS
from ..arrays import Array, Bools, Integers
from ..contact_space.simultaneous import LAST, MOST_IMPACTS, without_end
from ..errors import BoundReachedWarning, IrregularMotionError
from ..robot.pinocchio_bridge import check_inertia
from ._kernels.approach import APART, ARRIVING, STRUCK
from ._kernels.contact_forces import SLIP
from ._kernels.tolerances import LEAST_AHEAD, NEARLY_SINGULAR, ROUNDING, SINGULAR, START_ROUNDING
from .crowds import CrowdError
from .dense_step import DenseStep
from .dynamics import SceneDynamics
from .hybrid_state import HybridState
from .impact_results import GroupImpact, Impact
from .mode_intervals import ModeIntervals
from .recorder import Recorder
from .records import ImpactRecord, Note
from .rims import Rims
from .scene import STANDARD_GRAVITY, Scene
from .scene_impacts import SceneImpacts
from .shape_watch import ShapeWatch
from .start import check_start, left_by_steps
from .switched_off import altered, held_contacts

Arriving = int | list[int] | None
"""Numbers of the contacts, or of the limit, whose gap closes now; None: none."""

STICK_FRACTION = 0.1
"""Sticking speed, relative to the resting speed: slower slip is taken as zero."""

CLEAR = 10.0
"""A singularity is attributed to slip if friction has to grow by a factor of at most 1 + `CLEAR` · `singular`
to reach it. (theory.md, 13.3)"""

MOST_JAMS = 10
"""Largest number of impacts without collision at one instant."""

MOST_AHEAD = 0.1
"""Largest time by which to look ahead for modes that begin without a jump, relative to the step size."""


class Instant:
    """Resolve impacts and set contact modes at the present time of a motion.

    Contacts are numbered first, with held ones at their end, followed by the joint limits.

    Args:
        scene: The scene.
        model: Its model, without the effects that are switched off.
        data: Its data.
        state: The state of the motion.
        starts: Whether the motion starts in this state, which is then checked.
        dt: Length of the time steps [s].

    Attributes:
        data, state: As in the arguments.
        record: The record of the motion.
        shapes: The pairs of convex shapes.
        rims: The contacts that are rims.
        dynamics: The smooth dynamics, with the present contact modes.
        names: Of the contacts and the joint limits.
        impacts: Resolves single impacts.
    """

    def __init__(
        self, scene: Scene, model: pin.Model, data: pin.Data, state: HybridState, starts: bool, dt: float
    ) -> None:
        without = scene.without
        self.data, self.state = data, state
        layout = scene.layout()
        watched = () if "contact guards" in without else layout.watched
        contacts = [altered(contact, without) for contact in watched] if without else list(watched)
        held = held_contacts(scene)
        limits = layout.limits if "joint limits" not in without else ()
        self._recorded = scene.record and "recorded path" not in without
        extent, resting_speed = layout.extent, scene.rest
        self._resting_speed = resting_speed
        if starts:
            check_inertia(model, data, state.q)
        self.dynamics = SceneDynamics(scene, model, contacts, held, limits)
        self.impacts = SceneImpacts(scene, model, data, self.dynamics, held, resting_speed)
        contact_names = [contact.label for contact in self.dynamics.contacts]
        limit_names = [limit.name for limit in limits]
        self.names = [*contact_names, *limit_names]
        work = self.dynamics.work
        rounding = 8.0 * EPS * float(np.abs(state.q[layout.gap_coordinates]).max(initial=0.0))
        work.gap_floor = ROUNDING * extent + rounding
        work.touching_gap = 4.0 * work.gap_floor
        work.resting_speed = 0.0 if "sustained contact" in without else resting_speed
        work.stick_speed = STICK_FRACTION * resting_speed
        self.shapes = ShapeWatch(model, layout, self.dynamics, state)
        self.shapes.tolerance = work.touching_gap
        self.rims = Rims(self.dynamics, state)
        self._where = np.zeros(len(self.names), dtype=np.int64)  # APART, ARRIVING or STRUCK
        self._slow = np.zeros(len(self.names), dtype=np.int64)  # touches without bouncing
        self._hit = np.zeros(len(self.names), dtype=bool)  # collided at this instant
        self.record = Recorder(model, data, ModeIntervals(model, contact_names, limit_names))
        if starts:
            self.impacts.compile_kernels(state.q)
            left = partial(left_by_steps, dt, extent, max(work.gravity, STANDARD_GRAVITY))
            check_start(model, data, self.dynamics, state, self.names, extent, left)
            if self.shapes:
                self.shapes.start(state.q, state.v, START_ROUNDING, left)
            self._record_modes()

    def _record_modes(self) -> None:
        work = self.dynamics.work
        self.record.modes.update(self.state.t, work.modes, work.drive_side)

    def note(self, text: str) -> None:
        """Add a note at the present time to the record."""
        self.record.notes.append(Note(self.state.t, text))

    # ---- impacts

    def settle(self, arriving: Arriving = None, starting: bool = False) -> None:
        """Resolve the impacts of this instant, then set the contact modes. (theory.md, 11 and 14)

        Impacts are resolved by the scene's policy until no contact approaches faster than the resting speed.

        Args:
            arriving: The contacts or limit whose gap is known to close now.
            starting: Whether the motion starts now: the gaps of all touching contacts have just closed.

        Raises:
            SimulationError: The impacts do not end, or neither forces nor impulses are found.
        """
        where, slow, work = self._where, self._slow, self.dynamics.work
        # approaches within the error of a step are not impacts; the modes remove them
        work.least_approach = min(self.dynamics.error(self.state.v), work.resting_speed)
        where[:] = APART
        if arriving is not None:
            where[arriving] = ARRIVING
        if self.shapes:
            if arriving is not None:
                where[self.shapes.join(self.state.q, self.state.v, where.nonzero()[0])] = ARRIVING
            where[self.shapes.between()] = APART
            self.shapes.refresh(self.state.q)
        self._hit[:], self.impacts.unresolved, self.impacts.in_steps = False, 0.0, False
        resolved: list[dict[str, Any]] = []
        tried, jams = np.zeros(len(where), dtype=bool), 0
        while True:
            q, v = self.state.q, self.state.v
            parting = max(self.dynamics.error(v), work.resting_speed)
            i, rate = self.dynamics.fastest_approach(q, v, starting, parting, where, slow)
            if self.rims and self.rims.lie_down(where):
                continue
            if self.impacts.refuses and not resolved:
                self.impacts.refuse_crowd(int((where[: work.contacts] != APART).sum()))
            if i >= 0:
                where[i] = STRUCK
                resolved += self._strike(i, -rate, resolved)
                continue
            before = self.state.v
            self.shapes.let_tip()
            jammed, found = self._set_modes(slow)
            if found:
                tried |= slow != 0
                # velocities that active contacts lose may bring others to rest
                i, _ = self.dynamics.fastest_approach(self.state.q, self.state.v, False, parting, where, slow)
                if i < 0 and (slow.astype(bool) & ~tried).any():
                    continue
                break
            jams += 1
            if jams > MOST_JAMS:
                raise IrregularMotionError(
                    f"scene: {jams - 1} impacts without collision at t = {self.state.t:.6g} s do not "
                    f"end, the last at {_last(resolved)}; less friction may help"
                )
            struck = self._without_forces(before, jammed)
            if not struck:
                raise IrregularMotionError(
                    f"contacts: neither forces nor impulses were found for the active contacts at t = "
                    f"{self.state.t:.6g} s; less friction may help"
                )
            resolved += struck
        self._keep(resolved)

    def collide(
        self, touching: float, soon: float, slowest: float, error: float, pressed: Any
    ) -> dict[int, float]:
        """Resolve the impacts at the end of a time step; return those left to the next step.

        These are the numbers and coefficients of restitution of contacts and limits of a `CrowdError`.

        Contacts that separate take no part in the impacts of others, unless they have an impulse in the step
        that ends here: the velocities of active contacts vanish only at the ends of steps.

        Args:
            touching: See `approach`.
            soon: See `approach`.
            slowest: Speed of approach above which a contact collides [m/s], or the resting speed.
            error: Error of velocities that is acceptable [m/s], see `SceneImpacts.unresolved`.
            pressed: (n + nl,) whether each contact or limit has an impulse in that step; False: none has.
        """
        self._hit[:], self.impacts.unresolved, self.impacts.in_steps = False, error, True
        resolved: list[dict[str, Any]] = []
        left: dict[int, float] = {}
        parting: Array | None = None
        near: Any = False
        while self.names:
            rates = self.approach(self.state.q, self.state.v, touching, soon, near)
            near, rates[list(left)] = np.isfinite(rates), math.inf
            i = int(np.argmin(rates))
            if rates[i] >= -max(slowest, self.dynamics.work.resting_speed):
                break
            if parting is None:  # gaps of active contacts vanish only at the ends of steps, too
                wide = self.approach(self.state.q, self.state.v, max(touching, -soon * float(rates[i])))
                rates = np.minimum(rates, np.where(pressed, wide, math.inf))
                near = np.isfinite(rates)
                parting = np.maximum(self.dynamics.work.resting_speed, np.where(pressed, rates, 0.0))
            self._where[:] = np.where((rates <= parting) & near, ARRIVING, APART)
            try:
                resolved += self._strike(i, -float(rates[i]), resolved)
            except CrowdError as crowd:
                left |= crowd.left
        self._keep(resolved)
        return left

    def approach(self, q: Array, v: Array, touching: float, soon: float = 0.0, near: Any = False) -> Array:
        """Return gap rates (n + nl,), infinite unless `near`, up to `touching` [m], or closed in `soon`."""
        gaps, rates = self.dynamics.gaps_at(q, v).T
        near = near | (gaps <= np.maximum(touching, -soon * rates))
        near[: len(self.dynamics.contacts)] &= self.dynamics.work.bilateral == 0
        return np.where(near, rates, math.inf)

    def _without_forces(self, v: Array, jammed: int) -> list[dict[str, Any]]:
        """Resolve an impact without collision where no admissible contact forces exist. (theory.md, 13)

        Args:
            v: (nv,) velocity before the modes were set.
            jammed: Contact that alone has a negative normal acceleration, or −1.

        Returns:
            Fields of the impact records; empty if there is no such impact.
        """
        touching = self._closed(self._slow)
        slips = self._slipping(touching)
        if jammed >= 0 and len(touching) == 1:
            self.note(
                f"Slip at {self.names[jammed]} has a negative normal acceleration and no admissible force: "
                "an impact without collision."
            )
            return [
                self._take_over(jammed, self.impacts.without_collision(self.state.q, self.state.v, jammed))
            ]
        group = self.impacts.without_forces(self.state.t, self.state.q, v, touching, slips, 0.0)
        if group is None:
            return []
        self.change_velocity(v)
        self.note(
            f"Slip at {self._names(touching, slips)} has a negative normal acceleration and no admissible "
            "forces: an impact without collision."
        )
        return self._take_over_group(group)

    def _closed(self, chosen: Integers) -> list[int]:
        """Return the numbers of the chosen contacts and limits, without held contacts."""
        contacts, bilateral = len(self.dynamics.contacts), self.dynamics.work.bilateral
        return [i for i in np.flatnonzero(chosen).tolist() if i >= contacts or not bilateral[i]]

    def _names(self, touching: list[int], chosen: Bools) -> str:
        return ", ".join(self.names[i] for i, is_chosen in zip(touching, chosen, strict=True) if is_chosen)

    def _slipping(self, touching: list[int]) -> Bools:
        """Return which of the touching contacts and limits slip, when the modes were last set."""
        slips = np.zeros(len(touching), dtype=bool)
        contacts = [i for i in touching if i < self.dynamics.work.contacts]
        slips[: len(contacts)] = self.dynamics.work.slips[contacts] != 0
        return slips

    def _collide(self, i: int, approach: float) -> dict[str, Any]:
        """Resolve the impact of a single contact or limit; return the fields of its record."""
        impact = self.impacts.resolve(self.state.q, self.state.v, i, approach)
        for text in impact.notes:
            self.note(text)
        if impact.resting:
            self._note_rest(i)
        return self._take_over(i, impact)

    def _strike(self, i: int, approach: float, before: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Resolve the impact of a contact or limit, together with all that are coupled to it.

        If impacts follow one another without end, their limit is taken. (14.8)

        Args:
            i: The contact or limit that collides.
            approach: Its speed of approach [m/s].
            before: The impacts of this instant so far.

        Returns:
            The fields of the impact records.

        Raises:
            SimulationError: It still approaches after the limit.
        """
        self._hit[i] = True
        touching = self._closed(self._where != APART)
        every = self._closed(self._hit | (self._where != APART))
        beyond = len(before) - MOST_IMPACTS * len(every)
        if beyond < 0:
            return self._collide_together(i, touching) or [self._collide(i, approach)]
        impact = self.impacts.resolve_group(self.state.q, self.state.v, i, every, limit=True)
        if impact is None or not impact.struck or beyond > len(every):
            raise IrregularMotionError(
                f"scene: {len(before)} impacts at t = {self.state.t:.6g} s do not end, the last at "
                f'{_last(before)}; use simultaneous="propagate"'
            )
        self.note(without_end(len(before), [fields["source"] for fields in before]))
        self._warn_of_bound()
        return self._take_over_group(impact)

    def _collide_together(self, first: int, touching: list[int]) -> list[dict[str, Any]]:
        """Resolve an impact at several contacts; return the fields of its records, none if one takes part."""
        if len(touching) < 2 or not self.impacts.together:
            return []
        impact = self.impacts.resolve_group(self.state.q, self.state.v, first, touching)
        if impact is None:
            return []
        return self._take_over_group(impact)

    def _take_over_group(self, impact: GroupImpact) -> list[dict[str, Any]]:
        """Apply the velocity after an impact at several contacts; return the fields of its records."""
        for text in impact.notes:
            self.note(text)
        if impact.bounded:
            self._warn_of_bound()
        before, records = self.state.v, []
        self.change_velocity(impact.v)
        for source, place, resting, make in impact.struck:
            self._where[source] = STRUCK
            if resting:
                self._note_rest(source)
            fields = self._fields(source, before, make, resting)
            records.append(fields | {"group": (impact.group, place)})
        return records

    def _warn_of_bound(self) -> None:
        """Warn once per run that an impact is approximate; the last note describes it."""
        if not self.record.bound_reached:
            self.record.bound_reached = True
            text = self.record.notes[-1].text
            warnings.warn(
                f"t = {self.state.t:.6g} s: {text} Further such notes are in trajectory.notes only.",
                BoundReachedWarning,
                stacklevel=2,
            )

    def _note_rest(self, i: int) -> None:
        self.note(
            f"{self.names[i]} stays closed: it would bounce slower than the resting speed of "
            f"{self._resting_speed:.3g} m/s."
        )

    def _take_over(self, i: int, impact: Impact) -> dict[str, Any]:
        """Apply the velocity after an impact at one contact; return the fields of its record."""
        before = self.state.v
        self.change_velocity(impact.v)
        return self._fields(i, before, impact.contact_space, impact.resting)

    def _fields(self, i: int, before: Array, contact_space: Any, resting: bool) -> dict[str, Any]:
        """Return the fields of the record of an impact that changed the velocity from `before` (nv,)."""
        contacts, touches = self.dynamics.contacts, i < len(self.dynamics.contacts)
        return {
            "time": self.state.t,
            "source": self.names[i],
            "q": self.state.q,
            "v_before": before,
            "v_after": self.state.v,
            "contact_space": contact_space,
            "resting": resting,
            "record": self._recorded,
            "contact": contacts[i] if touches and contacts[i].pair is not None else None,
        }

    def _keep(self, resolved: list[dict[str, Any]]) -> None:
        """Record the impacts of this instant."""
        several = len(resolved) > 1
        self.record.impacts += [ImpactRecord(**fields, simultaneous=several) for fields in resolved]

    def change_velocity(self, v: Array) -> None:
        """Replace the velocity (nv,), and add the change of kinetic energy to that of the impacts."""
        energy = self.impacts.kinetic_energy
        self.state.impact_energy += energy(self.state.q, v) - energy(self.state.q, self.state.v)
        self.state.v = v

    def resolve_jam(self, singular: float = SINGULAR, leaving: bool = False) -> bool:
        """Resolve an impact without collision at slip whose forces grow without bound. (theory.md, 13.3)

        Args:
            singular: Relative size to which the effects of the forces cancel at a singularity, see (13.3).
            leaving: Whether the forces have just left their bounds; if the determinant has changed its sign
                too, they have passed through infinity.

        Returns:
            Whether there was such an impact.
        """
        work = self.dynamics.work
        unbounded = self.dynamics.forces_unbounded(
            self.state.t, self.state.q, self.state.v, leaving, singular
        )
        # within rounding of a singularity the equations have no solution, or many
        if not unbounded and (singular == SINGULAR or work.forces_unique):
            return False
        modes = work.modes
        touching = self._closed(modes[: len(self.names)])
        slips = (modes[touching] == SLIP) & (np.array(touching) < work.contacts)
        passed = leaving and work.force_margin == -math.inf
        slack = max(NEARLY_SINGULAR * passed, CLEAR * singular)
        now = self.state.t, self.state.q, self.state.v
        group = self.impacts.without_forces(*now, touching, slips, slack)
        if group is None:
            return False
        slipping = self._names(touching, slips)
        self.note(
            f"Slip at {slipping} makes the forces grow without bound (jam): an impact without collision."
        )
        resolved = self._take_over_group(group)
        self._keep(resolved)
        return True

    # ---- contact modes

    def _set_modes(self, slow: Integers) -> tuple[int, bool]:
        """Set the modes of the contacts that touch without bouncing.

        Args:
            slow: (n + nl,) nonzero for these, as `approach` fills it.

        Returns:
            A contact for which no admissible force exists, or −1; whether forces were found.
        """
        work = self.dynamics.work
        before, constrained = work.modes.copy(), self.dynamics.constrained
        self.dynamics.set_saturation(self.state.q, self.state.v)
        self.state.v = self.state.v.copy()
        jammed, converged, energy = self.dynamics.set_modes(self.state.t, self.state.q, self.state.v, slow)
        self.state.impact_energy += energy
        if jammed >= 0:
            return jammed, False
        same = bool((work.modes == before).all())
        work.least_margin = -math.inf if constrained and same else 0.0
        if not same or work.driven:
            self._record_modes()
        return -1, converged

    def set_modes_ahead(self, step: DenseStep) -> None:
        """Set the modes that follow from the forces slightly later, on the continuation of a step.

        Where forces leave their bounds without a jump, all accelerations are still zero at that time, so the
        contacts that begin to move can be identified only slightly later. (theory.md, 11.6)
        """
        work = self.dynamics.work
        before = found = work.modes.copy()
        present = self.dynamics.slipping()
        ahead, certain = LEAST_AHEAD * step.h, False
        while ahead <= MOST_AHEAD * step.h and not certain:
            self.dynamics.slip_as(*present)
            q, v = step.at(self.state.t + ahead)
            jammed, _, _ = self.dynamics.set_modes(self.state.t + ahead, q, v, self._slow)
            modes = work.modes.copy()
            changed = jammed < 0 and (modes != before).any()
            # contacts that begin to move together may show one after the other: accept modes found twice
            certain = changed and bool((modes == found).all())
            found = modes if changed else before
            ahead *= 4.0
        if (found == before).all():
            work.modes[:] = before
            self.dynamics.slip_as(*present)
            self._set_modes(self._slow)
            return
        work.least_margin = 0.0
        self._record_modes()

    def correct_constraint_drift(self) -> None:
        """Correct constraint drift of the active contacts in position and velocity. (12.1)"""
        self.state.q, self.state.v = self.state.q.copy(), self.state.v.copy()
        self.state.impact_energy += self.dynamics.correct_constraint_drift(
            self.state.t, self.state.q, self.state.v
        )


def _last(resolved: list[dict[str, Any]]) -> str:
    """Return the names of the contacts and limits of the last impacts."""
    return ", ".join(repr(fields["source"]) for fields in resolved[-LAST:])
