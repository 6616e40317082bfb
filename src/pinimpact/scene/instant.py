"""What changes the state of a motion at one instant: impacts, modes, corrections."""

from __future__ import annotations

import math
import warnings
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import Array, Bools, Integers
from ..contact_space.simultaneous import LAST, MOST_IMPACTS, without_end
from ..errors import BoundReachedWarning, IrregularMotionError
from ..robot.pinocchio_bridge import check_inertia
from ._kernels.approach import APART, ARRIVING, STRUCK
from ._kernels.contact_forces import SLIP
from ._kernels.tolerances import LEAST_AHEAD, NEARLY_SINGULAR, ROUNDING, SINGULAR, START_ROUNDING, WEIGHTLESS
from .dense_step import DenseStep
from .dynamics import SceneDynamics
from .hybrid_state import HybridState
from .impact_results import GroupImpact, Impact
from .mode_intervals import ModeIntervals
from .recorder import Recorder
from .records import ImpactRecord, Note
from .rims import Rims
from .scene import STANDARD_GRAVITY, Scene
from .scene_impacts import CROWD, SceneImpacts
from .shape_watch import ShapeWatch
from .start import check_start, left_by_steps
from .switched_off import altered, held_contacts

Arriving = int | list[int] | None
"""Numbers of contacts or of a limit whose gap closes now."""

ISLANDS = 5
"""Islands of bodies beyond which a crowd of contacts is left to time steps altogether. Forces of all contacts
are found together here, at a cost that grows with the cube of their number; time steps find them island by
island."""

STICK_FRACTION = 0.1
"""Slip slower than this part of the resting speed is none."""

CLEAR = 10.0
"""A singularity is that of slip if friction larger by no more than so many times that part makes it one."""

MOST_JAMS = 10
"""Impacts without collision at one instant."""

MOST_AHEAD = 0.1
"""How far to look ahead for modes that begin without a jump at the most, in parts of a step."""


class Instant:
    """What happens to a motion at one instant.

    Contacts are numbered first, held ones last of them, then joint limits.

    Args:
        scene: The scene.
        model: Its model, without what is switched off.
        data: Its data.
        state: The state of the motion.
        starts: Whether the motion starts in it, so that it is checked.
        dt: The length of time steps [s].

    Attributes:
        data: That of the arguments.
        state: Likewise.
        record: What there is to tell of the motion.
        shapes: The pairs of shapes that may meet.
        rims: The rims.
        dynamics: The motion between events, with the modes that hold now.
        names: Of the contacts that are watched, and of the joint limits.
        crowds_refused: Whether impacts that restore nothing are refused at more than `CROWD` contacts, or if
            their waves are not resolved.
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
        self._impacts = SceneImpacts(scene, model, data, self.dynamics, held, resting_speed)
        contact_names = [contact.label for contact in self.dynamics.contacts]
        limit_names = [limit.name for limit in limits]
        self.names = [*contact_names, *limit_names]
        work = self.dynamics.work
        gravity = max(float(np.linalg.norm(model.gravity.linear)), STANDARD_GRAVITY)
        rounding = 8.0 * np.finfo(float).eps * float(np.abs(state.q).max(initial=0.0))
        work.gap_floor = ROUNDING * extent + rounding
        work.touching_gap = 4.0 * work.gap_floor
        work.resting_speed = 0.0 if "sustained contact" in without else resting_speed
        work.stick_speed = STICK_FRACTION * resting_speed
        work.force_tolerance = WEIGHTLESS * pin.computeTotalMass(model) * gravity
        self.shapes = ShapeWatch(model, layout, self.dynamics, state)
        self.shapes.tolerance = work.touching_gap
        self.rims = Rims(model, data, self.dynamics, state)
        self._where = np.zeros(len(self.names), dtype=np.int64)
        self._slow = np.zeros(len(self.names), dtype=np.int64)
        self._hit = np.zeros(len(self.names), dtype=bool)  # at this instant
        self.crowds_refused = False
        self.record = Recorder(model, data, ModeIntervals(model, contact_names, limit_names))
        if starts:
            self._impacts.compile_kernels(state.q)
            left = partial(left_by_steps, dt, extent, gravity)
            check_start(model, data, self.dynamics, state, self.names, extent, left)
            if self.shapes:
                self.shapes.start(state.q, state.v, START_ROUNDING, left)
            self._tell_modes()

    def _tell_modes(self) -> None:
        work = self.dynamics.work
        self.record.modes.update(self.state.t, work.modes, work.drive_side)

    def note(self, text: str) -> None:
        """Tell of something, at the present time."""
        self.record.notes.append(Note(self.state.t, text))

    # ---- impacts

    def settle(self, arriving: Arriving = None, starting: bool = False) -> None:
        """Resolve the impacts of this instant, then let contacts rest, slip or open as their forces demand.

        All that touches and feels what collides takes part, by the scene's policy; until nothing approaches
        faster than the resting speed.

        Args:
            arriving: The contacts or limit whose gap is known to close now.
            starting: Whether the motion starts now, so that all that touches has just closed its gap.

        Raises:
            SimulationError: Impacts do not end, or neither forces nor impulses are found.
        """
        where, slow, work = self._where, self._slow, self.dynamics.work
        # an approach that the error of a step explains is no impact; modes take it away
        work.least_approach = min(self.dynamics.error(self.state.v), work.resting_speed)
        where[:] = APART
        if arriving is not None:
            where[arriving] = ARRIVING
            if self.shapes:
                where[self.shapes.join(self.state.q, self.state.v)] = ARRIVING
        if self.shapes:
            self.shapes.refresh(self.state.q)
        self._hit[:] = False
        self._impacts.unresolved = 0.0
        resolved: list[dict[str, Any]] = []
        jams = 0
        while True:
            q, v = self.state.q, self.state.v
            parting = max(self.dynamics.error(v), work.resting_speed)
            i, rate = self.dynamics.fastest_approach(q, v, starting, parting, where, slow)
            self.rims.check(where, work.touching_gap)
            if self.crowds_refused and not resolved:
                self._refuse_crowd()
            if i >= 0:
                where[i] = STRUCK
                resolved += self._strike(i, -rate, resolved)
                continue
            before = self.state.v
            jammed = self._set_modes(slow)
            if jammed < 0 and self.state.forces_found:
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
                    f"contacts: neither forces nor impulses were found for what touches at t = "
                    f"{self.state.t:.6g} s; less friction may help"
                )
            resolved += struck
        self._keep(resolved)

    def _refuse_crowd(self) -> None:
        """Refuse to go on where so much touches, in so many islands, that time steps are cheaper by far."""
        contacts = np.flatnonzero(self._where[: self.dynamics.work.contacts] != APART)
        if len(contacts) > CROWD and self._impacts.islands(contacts) > ISLANDS:
            raise IrregularMotionError(f"scene: {len(contacts)} contacts of many bodies touch")

    def collide(self, touching: float, slowest: float, unresolved: float, pressed: Bools | bool) -> None:
        """Resolve the impacts of what is nearer than a distance and approaches faster than a speed.

        What parts is open, and takes no part in impacts of others, unless a step presses it: rates of what
        stays closed vanish only at the ends of steps.

        Args:
            touching: The distance [m].
            slowest: The speed [m/s].
            unresolved: See `SceneImpacts`.
            pressed: (n + nl,) which contacts and limits the step that ends here presses; False: none.
        """
        self._hit[:] = False
        self._impacts.unresolved = unresolved
        resolved: list[dict[str, Any]] = []
        parting: Array | None = None
        while self.names:
            rates = self.approach(self.state.q, self.state.v, touching)
            i = int(np.argmin(rates))
            if rates[i] >= -slowest:
                break
            if parting is None:
                parting = np.maximum(self.dynamics.work.resting_speed, np.where(pressed, rates, 0.0))
            self._where[:] = np.where((rates <= parting) & np.isfinite(rates), ARRIVING, APART)
            self.rims.check(self._where, touching)
            resolved += self._strike(i, -float(rates[i]), resolved)
        self._keep(resolved)

    def approach(self, q: Array, v: Array, touching: float) -> Array:
        """Return the rates (n + nl,) of what is nearer than a distance [m] in a state; of others infinity."""
        gaps, rates = self.dynamics.gaps_at(q, v).T
        near = gaps <= touching
        near[: len(self.dynamics.contacts)] &= self.dynamics.work.bilateral == 0
        return np.where(near, rates, math.inf)

    def _without_forces(self, v: Array, jammed: int) -> list[dict[str, Any]]:
        """Resolve the impact without collision where no forces hold what touches.

        Args:
            v: (nv,) velocity before modes were looked for.
            jammed: The contact that drives the surface in by itself, or −1.

        Returns:
            Fields of records; none if nothing comes of it.
        """
        touching = self._closed(self._slow)
        slips = self._slipping(touching)
        if jammed >= 0 and len(touching) == 1:
            self.note(
                f"Slip at {self.names[jammed]} has a negative normal acceleration and no admissible force: "
                "an impact without collision."
            )
            return [
                self._take_over(jammed, self._impacts.without_collision(self.state.q, self.state.v, jammed))
            ]
        refuse = self.crowds_refused
        group = self._impacts.without_forces(self.state.t, self.state.q, v, touching, slips, 0.0, refuse)
        if group is None:
            return []
        self.change_velocity(v)
        self.note(
            f"Slip at {self._names(touching, slips)} has a negative normal acceleration and no admissible "
            "forces: an impact without collision."
        )
        return self._take_over_group(group)

    def _closed(self, chosen: Integers) -> list[int]:
        """Return those of contacts and limits that are chosen and not held."""
        contacts, bilateral = len(self.dynamics.contacts), self.dynamics.work.bilateral
        return [i for i in np.flatnonzero(chosen).tolist() if i >= contacts or not bilateral[i]]

    def _names(self, touching: list[int], chosen: Bools) -> str:
        return ", ".join(self.names[i] for i, is_chosen in zip(touching, chosen, strict=True) if is_chosen)

    def _slipping(self, touching: list[int]) -> Bools:
        """Return which of what touches slips, as modes were last looked for."""
        slips = np.zeros(len(touching), dtype=bool)
        contacts = [i for i in touching if i < self.dynamics.work.contacts]
        slips[: len(contacts)] = self.dynamics.work.slips[contacts] != 0
        return slips

    def _collide(self, i: int, approach: float) -> dict[str, Any]:
        """Resolve one impact; return the fields of its record."""
        impact = self._impacts.resolve(self.state.t, self.state.q, self.state.v, i, approach)
        for text in impact.notes:
            self.note(text)
        if impact.resting:
            self._note_rest(i)
        return self._take_over(i, impact)

    def _strike(self, i: int, approach: float, before: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Resolve the impact of what collides, with all that feels it; return the fields of records.

        Impacts one after another may have no end; then their limit is taken.

        Args:
            i: The contact or limit that collides.
            approach: Its speed of approach [m/s].
            before: The impacts of this instant so far.

        Raises:
            SimulationError: It still approaches after the limit.
        """
        self._hit[i] = True
        touching = self._closed(self._where != APART)
        every = self._closed(self._hit | (self._where != APART))
        beyond = len(before) - MOST_IMPACTS * len(every)
        if beyond < 0:
            return self._collide_together(i, touching) or [self._collide(i, approach)]
        impact = self._impacts.resolve_group(self.state.q, self.state.v, i, every, limit=True)
        if impact is None or not impact.struck or beyond > len(every):
            raise IrregularMotionError(
                f"scene: {len(before)} impacts at t = {self.state.t:.6g} s do not end, the last at "
                f'{_last(before)}; use simultaneous="propagate"'
            )
        self.note(without_end(len(before), [fields["source"] for fields in before]))
        self._warn_of_bound()
        return self._take_over_group(impact)

    def _collide_together(self, first: int, touching: list[int]) -> list[dict[str, Any]]:
        """Resolve the impact of all that feels what collides; return the fields of records, none if alone."""
        if len(touching) < 2 or not self._impacts.together:
            return []
        refuse = self.crowds_refused
        impact = self._impacts.resolve_group(self.state.q, self.state.v, first, touching, refuse=refuse)
        if impact is None:
            return []
        return self._take_over_group(impact)

    def _take_over_group(self, impact: GroupImpact) -> list[dict[str, Any]]:
        """Take over the velocity after an impact of several; return the fields of records."""
        for text in impact.notes:
            self.note(text)
        if impact.bounded:
            self._warn_of_bound()
        before, found = self.state.v, []
        self.change_velocity(impact.v)
        for source, place, resting, make in impact.struck:
            self._where[source] = STRUCK
            if resting:
                self._note_rest(source)
            fields = self._fields(source, before, make, resting)
            found.append(fields | {"group": (impact.group, place)})
        return found

    def _warn_of_bound(self) -> None:
        """Warn once per run that an impact is approximate; its note has been made."""
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
        """Take over the velocity after an impact; return the fields of its record."""
        before = self.state.v
        self.change_velocity(impact.v)
        return self._fields(i, before, impact.contact_space, impact.resting)

    def _fields(self, i: int, before: Array, contact_space: Any, resting: bool) -> dict[str, Any]:
        """Return the fields of the record of an impact that led from a velocity (nv,) to the present one."""
        contacts, touches = self.dynamics.contacts, i < len(self.dynamics.contacts)
        return {
            "time": self.state.t,
            "source": self.names[i],
            "q": self.state.q,
            "v_before": before,
            "v_after": self.state.v,
            "contact_space": contact_space,
            "resting": resting,
            "record": self._recorded and touches,
            "contact": contacts[i] if touches and contacts[i].pair is not None else None,
        }

    def _keep(self, resolved: list[dict[str, Any]]) -> None:
        """Record the impacts of this instant."""
        several = len(resolved) > 1
        self.record.impacts += [ImpactRecord(**fields, simultaneous=several) for fields in resolved]

    def change_velocity(self, v: Array) -> None:
        """Go on with another velocity, and count the kinetic energy that it brings."""
        energy = self._impacts.kinetic_energy
        self.state.impact_energy += energy(self.state.q, v) - energy(self.state.q, self.state.v)
        self.state.v = v

    def resolve_jam(self, singular: float = SINGULAR, leaving: bool = False) -> bool:
        """Resolve the impact without collision of slip whose forces have no bound, if there is any. (13.3)

        Args:
            singular: The part to which the effects of the forces cancel at a singularity.
            leaving: Whether forces have just left their bounds: if with a determinant that has changed its
                sign, they have gone through infinity.
        """
        without = leaving or not self.state.forces_found
        work = self.dynamics.work
        unbounded = self.dynamics.forces_unbounded(
            self.state.t, self.state.q, self.state.v, without, singular
        )
        # within rounding of a singularity the equations have no solution any more, or many
        if not unbounded and (singular == SINGULAR or work.forces_unique):
            return False
        modes = work.modes
        touching = self._closed(modes[: len(self.names)])
        slips = (modes[touching] == SLIP) & (np.array(touching) < work.contacts)
        passed = without and work.force_margin == -math.inf
        slack = max(NEARLY_SINGULAR * passed, CLEAR * singular)
        now = self.state.t, self.state.q, self.state.v
        group = self._impacts.without_forces(*now, touching, slips, slack, self.crowds_refused)
        if group is None:
            return False
        slipping = self._names(touching, slips)
        self.note(
            f"Slip at {slipping} makes the forces grow without bound (jam): an impact without collision."
        )
        resolved = self._take_over_group(group)
        self._keep(resolved)
        return True

    # ---- contacts that stay closed

    def _set_modes(self, slow: Integers) -> int:
        """Set the modes of what touches without bouncing; return a contact where no force exists, or −1."""
        work = self.dynamics.work
        before, constrained = work.modes.copy(), self.dynamics.constrained
        self.dynamics.set_saturation(self.state.q, self.state.v)
        self.state.v = self.state.v.copy()
        jammed, converged, energy = self.dynamics.set_modes(self.state.t, self.state.q, self.state.v, slow)
        self.state.impact_energy += energy
        if jammed >= 0:
            return jammed
        self.state.forces_found = converged
        same = bool((work.modes == before).all())
        work.force_bound_ignored = constrained and same
        if not same or work.driven:
            self._tell_modes()
        return -1

    def set_modes_ahead(self, step: DenseStep) -> None:
        """Set the modes that the forces call for just after now, if these are others.

        Where forces leave their bounds without a jump nothing moves yet at that very time, so what begins to
        move is seen a little later, in the smooth continuation of the step. (theory.md, 11.6)
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
            # of what begins together one may show before the other: the same modes twice are those
            certain = changed and bool((modes == found).all())
            found = modes if changed else before
            ahead *= 4.0
        if (found == before).all():
            work.modes[:] = before
            self.dynamics.slip_as(*present)
            self._set_modes(self._slow)
            return
        work.force_bound_ignored = False
        self._tell_modes()

    def correct_constraint_drift(self) -> None:
        """Bring the closed contacts back onto their surfaces, in position and in velocity."""
        self.state.q, self.state.v = self.state.q.copy(), self.state.v.copy()
        self.state.impact_energy += self.dynamics.correct_constraint_drift(
            self.state.t, self.state.q, self.state.v
        )


def _last(resolved: list[dict[str, Any]]) -> str:
    """Return the names of what the last impacts were at."""
    return ", ".join(repr(fields["source"]) for fields in resolved[-LAST:])
