"""What happens to a scene at one instant: impacts, and which contacts stay closed after them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ._kernels import motion
from ._kernels.sustained import FREE, HELD, SLIP, STICK
from .contacts import Contact, contact_matrices
from .errors import InputError, SimulationError
from .flow import Closed, Flow
from .lookup import free_velocities
from .problem import ImpactProblem
from .reset import Hit, impact
from .scene import STANDARD_GRAVITY, Scene
from .solvers import solve_impact
from .trajectory import ImpactRecord, ModeInterval, Note

Array = NDArray[np.float64]
ContactSpace = Callable[[], tuple[ImpactProblem, Array]]

MODES = {SLIP: "slip", STICK: "stick", HELD: "held"}
"""Names of the modes of a contact that is closed."""

GAP_FLOOR = 1e-12
"""Gaps below this part of the robot's size are rounding."""

STILL_FRACTION = 0.1
"""Slip slower than this part of the resting speed is none."""

MAX_ROUNDS = 1000
"""Impacts at one instant, after which the approach left is taken away at once (and noted)."""


class Instant:
    """The state of a simulation, and what changes it at one instant.

    Contacts are numbered first, then joint limits.

    Attributes:
        t, q, v: Time [s] and state.
        contacts: The contacts that are watched.
        limits: The joint limits.
        flow: The smooth flow, with the modes that hold now.
        touch: Gap [m] at which a contact counts as touching.
        floor: Gaps above its negative count as none [m].
        tolerated: The forces leave what their modes allow, but no other modes do better.
        shut: (m,) which limits are closed.
        stuck: Velocity indices of the joints that their dry friction holds.
        work: Change of kinetic energy in impacts so far [J].
        impacts, notes, intervals: What there is to tell of the run so far.
        standing: Mode now, and its start, of each contact, limit or joint that is not free.
    """

    def __init__(self, scene: Scene, model: pin.Model, q: Array, v: Array) -> None:
        without = scene.without
        self.model = model
        self.data = model.createData()
        self.t, self.q, self.v = 0.0, q, v
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
        resting_speed = scene.rest
        self.rest = resting_speed if self.sustained else 0.0
        self.quiet = 1e-9 * resting_speed  # an approach slower than this is rounding
        self.names = [contact.label for contact in self.contacts] + [limit.name for limit in self.limits]

        self.flow = Flow(scene, model, self.contacts, self.held)
        self.flow.state[motion.STILL] = STILL_FRACTION * resting_speed
        gravity = max(float(np.linalg.norm(model.gravity.linear)), STANDARD_GRAVITY)
        self.flow.state[motion.ALLOWANCE] = 1e-10 * pin.computeTotalMass(model) * gravity
        self.floor = GAP_FLOOR * scene.extent + 8.0 * np.finfo(float).eps * float(np.abs(q).max(initial=0.0))
        self.touch = 4.0 * self.floor
        self._bilateral = slice(len(self.contacts), len(self.contacts) + len(self.held))
        self._yielding = free_velocities(model, self.locked)

        self.shut = np.zeros(len(self.limits), dtype=np.bool_)
        self.stuck: list[int] = []
        self.tolerated = False
        self.work = 0.0
        self.impacts: list[ImpactRecord] = []
        self.notes: list[Note] = []
        self.intervals: list[ModeInterval] = []
        self.standing: dict[str, tuple[str, float]] = {}
        self._check_start()

    def note(self, text: str) -> None:
        """Tell of something, at the present time."""
        self.notes.append(Note(self.t, text))

    def gaps_and_rates(self) -> Array:
        """Return (n + m, 2) gaps and their rates of contacts and limits at the present state."""
        found = self.flow.look(self.q, self.v)
        return np.delete(found, self._bilateral, axis=0) if self.held else found

    # ---- impacts

    def settle(self, hit: set[int]) -> None:
        """Resolve the impacts of this instant, then let contacts rest, slip or open as their forces demand.

        Of contacts that approach together the fastest is resolved first, and again, until none approaches
        faster than the resting speed.

        Args:
            hit: Contacts and limits whose gap is known to close now.
        """
        flow, count = self.flow, len(self.contacts)
        hit = set(hit)
        if flow.constrained:
            self.correct()
        found = self.gaps_and_rates()
        near = found[:, 0] <= self.touch
        near[:count] |= flow.mode[:count] != FREE
        near[count:] |= self.shut
        if self.t > 0.0:
            near[list(hit)] = True
        touching = np.flatnonzero(near).tolist()
        pending: list[dict[str, Any]] = []
        while True:
            rates = found[touching, 1].tolist()
            approaching = [
                (rate, i)
                for i, rate in zip(touching, rates, strict=True)
                if rate < -self.rest or (i in hit and rate < -self.quiet)
            ]
            if approaching and len(pending) < MAX_ROUNDS:
                rate, i = min(approaching)
                hit.discard(i)
                pending.append(self._collide(i, -rate))
                found = self.gaps_and_rates()
                continue
            if approaching:
                self.note(
                    f"{MAX_ROUNDS} impacts at one instant did not settle; the approach left was taken away."
                )
            slow = [
                i
                for i, rate in zip(touching, rates, strict=True)
                if self.sustained and abs(rate) <= self.rest
            ]
            jamming = self._close(slow)
            if jamming is None:
                break
            self.note(
                f"Slip at {self.names[jamming]} drives the surface in and no force holds it: "
                "an impact without collision."
            )
            pending.append(self._jam(jamming))
            found = self.gaps_and_rates()
        self.impacts += [ImpactRecord(**fields, simultaneous=len(pending) > 1) for fields in pending]

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
                if self.sustained and not plastic:
                    resting = bool(self.flow.look(q, hit.v)[i, 1] < self.rest)
            if hit is None or resting:
                hit = self._impact(self.plastic[i], v)
            after, contact_space = hit.v, partial(_of_hit, hit)
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
            after, contact_space = v - response * ((1.0 + e) * rate / c), partial(_of_limit, c, rate, e)
        if resting:
            self.note(
                f"{self.names[i]} is taken as resting: it would bounce slower than {self.rest:.3g} m/s."
            )
        return self._record(i, after, contact_space, resting)

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
        impulse = solution.impulse @ matrices.axes
        return self._record(i, after, lambda: (problem, impulse), False)

    def _record(self, i: int, after: Array, contact_space: ContactSpace, resting: bool) -> dict[str, Any]:
        """Take over the velocity after an impact; return the fields of its record."""
        before = self.v
        self.work += self._kinetic(after) - self._kinetic(before)
        self.v = after
        return {
            "time": self.t,
            "source": self.names[i],
            "q": self.q.copy(),
            "v_before": before.copy(),
            "v_after": after.copy(),
            "contact_space": contact_space,
            "resting": resting,
            "record": self.record and i < len(self.contacts),
        }

    def _impact(self, contact: Contact, v: Array) -> Hit:
        if not self.held:
            return impact(self.model, self.data, self.q, v, contact, locked=self.locked)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            hit = impact(self.model, self.data, self.q, v, contact, held=self.held, locked=self.locked)
        for warning in caught:
            self.note(str(warning.message))
        return hit

    def _kinetic(self, v: Array) -> float:
        return float(pin.computeKineticEnergy(self.model, self.data, self.q, v))

    def _yielding_inverse(self) -> Array:
        """Return M⁻¹ with what is held and locked projected out, at the present state."""
        nv = self.model.nv
        inverse = np.array(pin.computeMinverse(self.model, self.data, self.q)).reshape(nv, nv)
        if self._yielding.all() and not self.held:
            return inverse
        rows = np.eye(nv)[~self._yielding]
        if self.held:
            anchors = Closed(nv, range(len(self.contacts), len(self.flow.contacts)))
            self.flow.probe(self.t, self.q, self.v, anchors)
            rows = np.vstack([rows, anchors.rows.reshape(-1, nv)])
        response = inverse @ rows.T
        inverse -= response @ np.linalg.pinv(rows @ response, rcond=1e-10, hermitian=True) @ response.T
        return inverse

    # ---- contacts that stay closed

    def _close(self, slow: list[int]) -> int | None:
        """Set the modes of what touches without bouncing; return a contact where no force exists, if any."""
        flow, count = self.flow, len(self.contacts)
        contacts = [i for i in slow if i < count] + list(range(count, len(flow.contacts)))
        limits = [i - count for i in slow if i >= count]
        stuck: list[int] = []
        if flow.dry.any():
            stuck = np.flatnonzero((flow.dry > 0.0) & (np.abs(self.v) <= flow.still)).tolist()
            flow.sliding[:] = flow.dry * np.sign(self.v)
            flow.sliding[stuck] = 0.0
        if not contacts and not limits and not stuck:
            self._set_modes({}, {}, [], [])
            return None
        chosen = flow.choose(self.t, self.q, self.v, contacts, limits, stuck)
        self.work += chosen.work
        self.v = chosen.velocity
        if chosen.jamming is not None:
            return chosen.jamming
        if not chosen.converged:
            self.note("The forces of the closed contacts were not found to the usual accuracy.")
        for j, force in chosen.breaking.items():
            flow.sliding[j] = -math.copysign(flow.dry[j], force)
        self._set_modes(chosen.modes, chosen.reference, chosen.limits, chosen.stuck)
        return None

    def _set_modes(
        self, modes: dict[int, int], reference: dict[int, Array], limits: list[int], stuck: list[int]
    ) -> None:
        """Give each contact, limit and stuck joint its mode, and keep the intervals that end with it."""
        flow, count = self.flow, len(self.contacts)
        mode = np.full(len(flow.contacts), FREE)
        mode[count:] = HELD
        for i, m in modes.items():
            mode[i] = m
        before = flow.closed
        constrained = flow.constrained
        flow.close(mode, reference, limits, stuck)
        self.tolerated = constrained and flow.closed is before
        self.shut[:] = False
        self.shut[limits] = True
        self.stuck = stuck
        now = {flow.contacts[i].label: MODES[m] for i, m in enumerate(mode.tolist()) if m != FREE}
        now |= {self.limits[k].name: "closed" for k in limits}
        now |= {self.model.names[_joint_of(self.model, j)]: "stuck" for j in stuck}
        for source, (name, start) in list(self.standing.items()):
            if now.get(source) != name:
                if self.t > start:
                    self.intervals.append(ModeInterval(source, name, start, self.t))
                del self.standing[source]
        for source, name in now.items():
            self.standing.setdefault(source, (name, self.t))

    def holds(self, t: float, q: Array, v: Array) -> bool:
        """Whether any forces exist at a state for the modes that hold now; the kernels look at one choice."""
        flow = self.flow
        limits = np.flatnonzero(self.shut).tolist()
        which = flow.closed.which.tolist()
        chosen = flow.choose(t, q, v, which, limits, self.stuck)
        modes = {i: int(flow.mode[i]) for i in which if i < len(self.contacts)}
        return (chosen.modes, chosen.limits, chosen.stuck) == (modes, limits, self.stuck)

    def correct(self) -> None:
        """Bring the closed contacts back onto their surfaces, in position and in velocity."""
        self.q, self.v = self.q.copy(), self.v.copy()
        self.work += self.flow.correct(self.t, self.q, self.v, self.shut)

    # ---- the start

    def _check_start(self) -> None:
        flow, count = self.flow, len(self.contacts)
        gaps = self.gaps_and_rates()[:, 0].tolist()
        for i, gap in enumerate(gaps):
            if gap >= -self.touch:
                continue
            if i < count:
                contact = self.contacts[i]
                raise InputError(
                    f"q0: the contact {contact.label!r} at frame {contact.frame!r} starts {-gap:.6g} m "
                    "below its surface; start with every contact on or above its surface",
                    field="q0",
                    value=gap,
                )
            raise InputError(
                f"q0: the joint starts {-gap:.6g} beyond its limit {self.names[i]!r} "
                f"({self.limits[i - count].bound:.6g}); start within the limits, or leave "
                'them out with without=("joint limits",)',
                field="q0",
                value=gap,
            )
        flow.anchor(self.q, self.v)
        for k, i in enumerate(flow.closed.which.tolist()):
            speed = float(np.linalg.norm(flow.closed.velocity[k]))
            if speed > 1e-6 * (1.0 + float(np.abs(self.v).max(initial=0.0))):
                raise InputError(
                    f"v0: the held contact {flow.contacts[i].label!r} moves at {speed:.6g} m/s against its "
                    "surface; start with it at rest there, or leave it out of held",
                    field="v0",
                    value=speed,
                )


def _of_hit(hit: Hit) -> tuple[ImpactProblem, Array]:
    return hit.problem, hit.impulse_world


def _of_limit(c: float, rate: float, e: float) -> tuple[ImpactProblem, Array]:
    return ImpactProblem(np.diag([0.0, 0.0, c]), np.array([0.0, 0.0, rate]), 0.0, e), np.zeros(3)


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
