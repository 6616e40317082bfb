"""What happens to a scene at one instant: impacts, and which contacts stay closed after them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..contact_space.problem import ImpactProblem
from ..contact_space.solve import solve_impact
from ..errors import InputError, SimulationError
from ..robot.contact import Contact
from ..robot.matrices import contact_matrices
from ..robot.names import free_velocities
from ..robot.pinocchio_bridge import check_inertia
from ..robot.robot_impact import Hit, impact
from ._kernels import contact_modes, dynamics
from ._kernels.contact_forces import HELD, SLIP, STICK
from .dynamics import Flow
from .records import ImpactRecord, ModeInterval, Note
from .scene import STANDARD_GRAVITY, Scene

Array = NDArray[np.float64]
ContactSpace = Callable[[], tuple[ImpactProblem, Array]]

MODES = {SLIP: "slip", STICK: "stick", HELD: "held"}
"""Names of the modes of a contact that is closed."""

GAP_FLOOR = 1e-12
"""Gaps below this part of the robot's size are rounding."""

HELD_GAP = 1e-3
"""Held contacts start within this part of the robot's size from their surfaces; what gap is left is kept."""

STILL_FRACTION = 0.1
"""Slip slower than this part of the resting speed is none."""

MAX_ROUNDS = 1000
"""Impacts at one instant, after which the approach left is taken away at once (and noted)."""


class Instant:
    """The state of a simulation, and what changes it at one instant.

    Contacts are numbered first, held ones last of them, then joint limits. The arrays q and v are replaced,
    never changed, so that records may share them.

    Attributes:
        t, q, v: Time [s] and state.
        flow: The smooth flow, with the modes that hold now.
        names: Of the contacts that are watched, and of the joint limits.
        touch: Gap [m] at which a contact counts as touching.
        floor: Gaps above its negative count as none [m].
        tolerated: The forces leave what their modes allow, but no other modes do better.
        work: Change of kinetic energy in impacts so far [J].
        impacts, notes, intervals: What there is to tell of the run so far.
        standing: Mode now, and its start, of each contact, limit or joint that is not free.
    """

    def __init__(self, scene: Scene, model: pin.Model, data: pin.Data, q: Array, v: Array) -> None:
        without = scene.without
        self.model = model
        self.data = data
        self.t, self.q, self.v = 0.0, q, v
        unreachable = scene.unreachable()
        watched = () if "contact guards" in without else scene.contacts
        contacts = [_altered(contact, without) for contact in watched if contact.label not in unreachable]
        self.held = [_altered(c, without) for c in scene.held] if "held contacts" not in without else []
        self.locked = scene.locked if "locked joints" not in without else ()
        limits = scene.limits() if "joint limits" not in without else ()
        self.limit_restitution = 0.0 if "restitution" in without else scene.limit_restitution
        self.record = scene.record and "recorded path" not in without
        self.sustained = "sustained contact" not in without
        extent = scene.extent
        resting_speed = scene.rest
        self.rest = resting_speed if self.sustained else 0.0
        self.quiet = 1e-9 * resting_speed  # an approach slower than this is rounding

        check_inertia(model, data, q)
        self.flow = Flow(scene, model, contacts, self.held, limits)
        self.names = [contact.label for contact in self.flow.contacts] + [limit.name for limit in limits]
        self.flow.state[dynamics.STILL] = STILL_FRACTION * resting_speed
        gravity = max(float(np.linalg.norm(model.gravity.linear)), STANDARD_GRAVITY)
        self.flow.state[dynamics.ALLOWANCE] = 1e-10 * pin.computeTotalMass(model) * gravity
        self.floor = GAP_FLOOR * extent + 8.0 * np.finfo(float).eps * float(np.abs(q).max(initial=0.0))
        self.touch = 4.0 * self.floor
        self._yielding = free_velocities(model, self.locked)
        self._plastic: dict[int, Contact] = {}
        self._watched = np.zeros(len(self.names), dtype=np.int64)
        self._slow = np.zeros(len(self.names), dtype=np.int64)

        self.tolerated = False
        self.work = 0.0
        self.impacts: list[ImpactRecord] = []
        self.notes: list[Note] = []
        self.intervals: list[ModeInterval] = []
        self.standing: dict[str, tuple[str, float]] = {}
        self._check_start(extent)
        self._keep_intervals()

    def note(self, text: str) -> None:
        """Tell of something, at the present time."""
        self.notes.append(Note(self.t, text))

    # ---- impacts

    def settle(self, hit: int | None = None, starting: bool = False) -> None:
        """Resolve the impacts of this instant, then let contacts rest, slip or open as their forces demand.

        Of contacts that approach together the fastest is resolved first, and again, until none approaches
        faster than the resting speed.

        Args:
            hit: A contact or limit whose gap is known to close now.
            starting: Whether the motion starts now, so that all that touches has just closed its gap.
        """
        flow, watched, slow = self.flow, self._watched, self._slow
        watched[:] = contact_modes.FAR
        if hit is not None:
            watched[hit] = contact_modes.HIT
        pending: list[dict[str, Any]] = []
        jams = [0] * len(flow.contacts)
        while True:
            i, rate = contact_modes.approach(
                *(self.q, self.v, self.touch, starting, self.rest, self.quiet, watched, slow, flow.machine)
            )
            if i >= 0 and len(pending) < MAX_ROUNDS:
                watched[i] = contact_modes.NEAR
                pending.append(self._collide(i, -rate))
                continue
            if i >= 0:
                self.note(
                    f"{MAX_ROUNDS} impacts at one instant did not settle; the approach left was taken away."
                )
            jamming = self._close(slow)
            if jamming < 0:
                break
            jams[jamming] += 1
            if sum(jams) > MAX_ROUNDS:
                raise SimulationError(
                    f"scene: {MAX_ROUNDS} impacts without collision at t = {self.t:.6g} s do not settle, the "
                    f"last at {self.names[jamming]!r}; less friction would end them",
                    field="scene",
                )
            stop = jams[jamming] > 1
            self.note(
                f"Slip at {self.names[jamming]} drives the surface in and no force holds it: "
                f"an impact without collision{', which stops it' if stop else ''}."
            )
            pending.append(self._jam(jamming, stop))
        self.impacts += [ImpactRecord(**fields, simultaneous=len(pending) > 1) for fields in pending]

    def _collide(self, i: int, approach: float) -> dict[str, Any]:
        """Resolve one impact; return the fields of its record."""
        v = self.v
        slow = self.sustained and approach <= self.rest
        count = len(self.flow.contacts)
        if i < count:
            contact = self.flow.contacts[i]
            plastic = not callable(contact.restitution) and contact.restitution == 0.0
            hit, resting = None, slow and not plastic
            if not slow:
                hit = self._impact(contact, v)
                if self.sustained and not plastic:
                    resting = bool(self.flow.look(self.q, hit.v)[i, 1] < self.rest)
            if hit is None or resting:
                if i not in self._plastic:
                    self._plastic[i] = replace(contact, restitution=0.0)
                hit = self._impact(self._plastic[i], v)
            after, contact_space = hit.v, partial(_of_hit, hit)
        else:
            limit = self.flow.limits[i - count]
            e = self.limit_restitution
            resting = e > 0.0 and self.sustained and (slow or e * approach < self.rest)
            e = 0.0 if resting else e
            column = self._yielding_inverse()[:, limit.index_v]
            c = float(column[limit.index_v])
            speed = float(v[limit.index_v])
            if (self.held or self.locked) and c <= 1e-12 * float(np.abs(column).max(initial=0.0)):
                raise SimulationError(
                    f"locked: the joint limit {limit.name!r} is hit at {approach:.6g}, but what is held or "
                    "locked keeps the joint from yielding; leave it out there",
                    field="locked",
                    value=limit.name,
                )
            after = v - column * ((1.0 + e) * speed / c)
            contact_space = partial(_of_limit, c, -approach, e)
        if resting:
            self.note(
                f"{self.names[i]} is taken as resting: it would bounce slower than {self.rest:.3g} m/s."
            )
        return self._record(i, after, contact_space, resting)

    def _jam(self, i: int, stop: bool) -> dict[str, Any]:
        """Resolve the impact without collision of a contact that slips; return the fields of its record.

        Args:
            i: The contact.
            stop: Whether to stop its slip outright, since such an impact has not.
        """
        contact = self.flow.contacts[i]
        matrices = contact_matrices(self.model, self.data, self.q, contact, self.held, self.locked)
        velocity = matrices.velocity(self.v)
        velocity[2] = 0.0
        e = contact.restitution_at(0.0)
        problem = ImpactProblem(
            matrices.delassus, velocity, contact.friction, e, contact.law, matrices.surface_velocity
        )
        if stop:
            p = -np.linalg.pinv(matrices.delassus, rcond=1e-10, hermitian=True) @ velocity
        else:
            p = solve_impact(problem).impulse
        after = self.v + matrices.response @ p
        impulse = p @ matrices.axes
        return self._record(i, after, lambda: (problem, impulse), False)

    def jam(self, certain: bool) -> bool:
        """Stop contacts that jam, an impact without collision; return whether there are any.

        Args:
            certain: Whether the motion is known to end here, so that any slip is stopped.
        """
        v = self.v.copy()
        if not self.flow.jam(self.t, self.q, v, certain):
            return False
        closed = zip(self.names, self.flow.standing.tolist(), strict=False)
        slipping = ", ".join(name for name, mode in closed if mode == SLIP)
        self.note(f"Slip at {slipping} makes the forces grow without bound; the contacts jam and stick.")
        self.work += self._kinetic(v) - self._kinetic(self.v)
        self.v = v
        return True

    def _record(self, i: int, after: Array, contact_space: ContactSpace, resting: bool) -> dict[str, Any]:
        """Take over the velocity after an impact; return the fields of its record."""
        before = self.v
        self.work += self._kinetic(after) - self._kinetic(before)
        self.v = after
        return {
            "time": self.t,
            "source": self.names[i],
            "q": self.q,
            "v_before": before,
            "v_after": after,
            "contact_space": contact_space,
            "resting": resting,
            "record": self.record and i < len(self.flow.contacts),
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
            held = range(len(self.flow.contacts) - len(self.held), len(self.flow.contacts))
            rows = np.vstack([rows, self.flow.probe(self.t, self.q, self.v, held).rows.reshape(-1, nv)])
        response = inverse @ rows.T
        inverse -= response @ np.linalg.pinv(rows @ response, rcond=1e-10, hermitian=True) @ response.T
        return inverse

    # ---- contacts that stay closed

    def _close(self, slow: NDArray[np.int64]) -> int:
        """Set the modes of what touches without bouncing; return a contact where no force exists, or −1."""
        flow = self.flow
        before = flow.standing.copy()
        constrained = flow.constrained
        self.v = self.v.copy()
        jamming, converged, work = flow.settle(self.t, self.q, self.v, slow)
        self.work += work
        if jamming >= 0:
            return jamming
        if not converged:
            self.note("The forces of the closed contacts were not found to the usual accuracy.")
        same = bool((flow.standing == before).all())
        self.tolerated = constrained and same
        if not same:
            self._keep_intervals()
        return -1

    def _keep_intervals(self) -> None:
        """Keep the intervals of the modes that end now, and begin those of the new ones."""
        count, limits = len(self.flow.contacts), len(self.flow.limits)
        now = {}
        for i in np.flatnonzero(self.flow.standing).tolist():
            if i < count:
                now[self.names[i]] = MODES[int(self.flow.standing[i])]
            elif i < count + limits:
                now[self.names[i]] = "closed"
            else:
                now[self.model.names[_joint_of(self.model, i - count - limits)]] = "stuck"
        for source, (name, start) in list(self.standing.items()):
            if now.get(source) != name:
                if self.t > start:
                    self.intervals.append(ModeInterval(source, name, start, self.t))
                del self.standing[source]
        for source, name in now.items():
            self.standing.setdefault(source, (name, self.t))

    def correct(self) -> None:
        """Bring the closed contacts back onto their surfaces, in position and in velocity."""
        self.q, self.v = self.q.copy(), self.v.copy()
        self.work += self.flow.correct(self.t, self.q, self.v)

    # ---- the start

    def _check_start(self, extent: float) -> None:
        flow = self.flow
        count = len(flow.contacts)
        free = count - len(self.held)
        gaps = flow.look(self.q, self.v)[:, 0]
        for i, gap in enumerate(gaps.tolist()):
            if gap >= -self.touch or free <= i < count:
                continue
            if i < count:
                contact = flow.contacts[i]
                raise InputError(
                    f"q0: the contact {contact.label!r} at frame {contact.frame!r} starts {-gap:.6g} m "
                    "below its surface; start with every contact on or above its surface",
                    field="q0",
                    value=gap,
                )
            raise InputError(
                f"q0: the joint starts {-gap:.6g} beyond its limit {self.names[i]!r} "
                f"({flow.limits[i - count].bound:.6g}); start within the limits, or leave "
                'them out with without=("joint limits",)',
                field="q0",
                value=gap,
            )
        if not self.held:
            return
        for contact, gap in zip(flow.contacts[free:], gaps[free:count].tolist(), strict=True):
            if abs(gap) > HELD_GAP * extent:
                raise InputError(
                    f"q0: the held contact {contact.label!r} starts {gap:.6g} m from its surface; start "
                    "with it there, or put the surface where it is held",
                    field="q0",
                    value=gap,
                )
        kept = np.zeros(count)
        kept[free:] = gaps[free:count]
        flow.anchor(kept)
        held = range(free, count)
        for i, velocity in zip(held, flow.probe(self.t, self.q, self.v, held).velocity, strict=True):
            speed = float(np.linalg.norm(velocity))
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
        contact = replace(contact, plane=contact.plane.at_rest())
    return contact


def _joint_of(model: pin.Model, velocity: int) -> int:
    """Return the joint that a velocity index belongs to."""
    return max(j for j in range(1, model.njoints) if model.idx_vs[j] <= velocity and model.nvs[j])
