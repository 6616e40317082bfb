"""Impacts within a scene: of contacts, of joint limits, and those without collision."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..contact_space.problem import ImpactProblem
from ..contact_space.simultaneous import ManyInputs, find_policy
from ..contact_space.solve import solve_impact
from ..errors import PinimpactError, SimulationError
from ..robot.contact import Contact
from ..robot.data_cache import data_cache
from ..robot.joint_limits import JointLimit
from ..robot.matrices import contact_matrices, many_matrices
from ..robot.names import free_velocities
from ..robot.robot_impact import Hit, impact
from .dynamics import SceneDynamics
from .scene import Scene

Array = NDArray[np.float64]

_compiled: set[tuple[bool, bool]] = set()


class Impact(NamedTuple):
    """What an impact comes to.

    Attributes:
        v: (nv,) velocity after it.
        resting: The bounce would have been slower than the resting speed, so restitution was left out.
        contact_space: Makes the problem and the impulse in world axes.
        notes: What a reader should know of it.
    """

    v: Array
    resting: bool
    contact_space: Callable[[], tuple[ImpactProblem, Array]]
    notes: tuple[str, ...] = ()


class Group(NamedTuple):
    """What several contacts and limits at one instant come to.

    Attributes:
        v: (nv,) velocity after it.
        sources: Which have had an impulse.
        resting: Of these, whether the bounce would have been slower than the resting speed.
        contact_space: Of these, what makes the problem and the impulse in world axes.
        places: Of these, in the problem.
        problem: That of all.
        notes: What a reader should know of it.
    """

    v: Array
    sources: tuple[int, ...]
    resting: tuple[bool, ...]
    contact_space: tuple[Callable[[], tuple[ImpactProblem, Array]], ...]
    places: tuple[int, ...]
    problem: ImpactProblem
    notes: tuple[str, ...]


COUPLED = 1e-12
"""Part of what two contacts feel of themselves below which they do not feel each other."""


class SceneImpacts:
    """Resolves the impacts of a scene.

    Args:
        scene: The scene.
        model: Its model, without what is switched off.
        data: Its data, which kernels do not read.
        dynamics: The scene's contacts and limits.
        held: Contacts that hold throughout.
        resting_speed: That of the scene [m/s].

    Attributes:
        policy: For what collides or rests at one instant.
        together: Whether it takes all of them at once.
    """

    def __init__(
        self,
        scene: Scene,
        model: pin.Model,
        data: pin.Data,
        dynamics: SceneDynamics,
        held: list[Contact],
        resting_speed: float,
    ) -> None:
        without = scene.without
        self._model = model
        self._data = data
        self._dynamics = dynamics
        self._held = held
        self._locked = scene.locked if "locked joints" not in without else ()
        self._limit_restitution = 0.0 if "restitution" in without else scene.limit_restitution
        self._sustained = "sustained contact" not in without
        self._resting_speed = resting_speed if self._sustained else 0.0
        self._yielding = free_velocities(model, self._locked)
        self._plastic: dict[int, tuple[Contact, Contact]] = {}
        self.policy = scene.simultaneous
        self.together = scene.simultaneous != "sequence"
        data_cache(model, data).ignore_limits()  # a start beyond them is refused, or the limits are left out

    def compile_kernels(self, q: Array) -> None:
        """Have compiled whatever impacts may come to need, once, by impacts at rest that change nothing.

        Args:
            q: (nq,) a configuration.
        """
        zero = np.zeros(self._model.nv)
        contacts = self._dynamics.contacts
        first = {contact.plane.body is None: i for i, contact in reversed([*enumerate(contacts)])}
        for in_world, i in first.items():
            contact, kind = contacts[i], (in_world, bool(self._held))  # what the types of numbers depend on
            if kind not in _compiled:
                _compiled.add(kind)
                with suppress(PinimpactError):  # what is wrong with it is told when it collides
                    self._impact(replace(contact, restitution=0.0), q, zero)
                    self.without_collision(q, zero, i, False)

    def resolve(self, t: float, q: Array, v: Array, i: int, approach: float) -> Impact:
        """Resolve the impact of a contact or, past those, of a joint limit.

        Args:
            t: Time [s].
            q: (nq,) configuration.
            v: (nv,) velocity before it.
            i: Which.
            approach: Its speed of approach [m/s or rad/s].
        """
        slow = self._sustained and approach <= self._resting_speed
        contacts = len(self._dynamics.contacts)
        if i < contacts:
            return self._of_contact(q, v, i, slow)
        return self._of_limit(t, q, v, self._dynamics.limits[i - contacts], approach, slow)

    def _of_contact(self, q: Array, v: Array, i: int, slow: bool) -> Impact:
        contact = self._dynamics.contacts[i]
        plastic = not callable(contact.restitution) and contact.restitution == 0.0
        hit, resting = None, slow and not plastic
        notes: tuple[str, ...] = ()
        if not slow:
            hit, notes = self._impact(contact, q, v)
            if self._sustained and not plastic:
                resting = bool(self._dynamics.gaps_at(q, hit.v)[i, 1] < self._resting_speed)
        if hit is None or resting:
            known = self._plastic.get(i)
            if known is None or known[0] is not contact:
                known = self._plastic[i] = contact, replace(contact, restitution=0.0)
            hit, more = self._impact(known[1], q, v)
            notes += more
        return Impact(hit.v, resting, partial(_of_hit, hit), notes)

    def _impact(self, contact: Contact, q: Array, v: Array) -> tuple[Hit, tuple[str, ...]]:
        if not self._held:
            return impact(self._model, self._data, q, v, contact, locked=self._locked), ()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            hit = impact(self._model, self._data, q, v, contact, held=self._held, locked=self._locked)
        return hit, tuple(str(warning.message) for warning in caught)

    def _of_limit(
        self, t: float, q: Array, v: Array, limit: JointLimit, approach: float, slow: bool
    ) -> Impact:
        e = self._limit_restitution
        resting = e > 0.0 and self._sustained and (slow or e * approach < self._resting_speed)
        e = 0.0 if resting else e
        column = self._yielding_inverse(t, q, v)[:, limit.index_v]
        c = float(column[limit.index_v])
        speed = float(v[limit.index_v])
        constrained = self._held or self._locked
        if constrained and c <= 1e-12 * float(np.abs(column).max(initial=0.0)):
            raise SimulationError(
                f"locked: the joint limit {limit.name!r} is hit at {approach:.6g}, but what is held or "
                "locked keeps the joint from yielding; leave it out there",
                field="locked",
                value=limit.name,
            )
        return Impact(v - column * ((1.0 + e) * speed / c), resting, partial(_of_limit, c, -approach, e))

    def resolve_group(
        self, q: Array, v: Array, first: int, touching: Sequence[int], rates: Array
    ) -> Group | None:
        """Resolve the impact of all that touches and feels what collides; None if nothing does.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity before it.
            first: The contact or limit that collides.
            touching: All that touch, `first` among them, contacts before limits.
            rates: (n + nl,) rates of all gaps.
        """
        count = len(self._dynamics.contacts)
        contacts = [self._dynamics.contacts[i] for i in touching if i < count]
        limits = [self._dynamics.limits[i - count] for i in touching if i >= count]
        rows = np.zeros((len(limits), self._model.nv))
        for row, limit in zip(rows, limits, strict=True):
            row[limit.index_v] = limit.sign
        matrices = many_matrices(
            self._model, self._data, q, contacts, self._held, self._locked, joint_rows=rows
        )
        chosen = _coupled(matrices.delassus, list(touching).index(first))
        if len(chosen) == 1:
            return None
        places = (3 * chosen[:, None] + np.arange(3)).ravel()
        delassus = np.ascontiguousarray(matrices.delassus[np.ix_(places, places)])
        velocity = matrices.velocity(v)[chosen]
        sources = [touching[k] for k in chosen]
        struck = [self._dynamics.contacts[i] if i < count else None for i in sources]
        e = np.array([self._restitution(c, rates[i]) for i, c in zip(sources, struck, strict=True)])
        stiffness = _stiffness(struck, np.diag(delassus)[2::3])
        friction = np.array([0.0 if contact is None else contact.friction for contact in struck])
        laws = {contact.law for contact in struck if contact is not None}
        resting = np.zeros(len(chosen), dtype=bool)
        inputs = ManyInputs(  # the robot's own numbers need no check
            *(delassus, velocity, friction, e, stiffness),
            min(laws) if len(laws) == 1 else "energetic",
            matrices.surface_velocity[chosen],
            singular=False,
        )
        policy = find_policy(self.policy)
        while True:
            solution = policy.run(inputs, False)
            bounce = solution.velocity[:, 2]
            slow = (solution.impulse[:, 2] > 0.0) & (bounce > 0.0) & (bounce < self._resting_speed)
            more = slow & (e > 0.0) & ~resting
            if not more.any():
                break
            resting |= more
            inputs = inputs._replace(restitution=np.where(resting, 0.0, e))
        problem = ImpactProblem(
            *(delassus, velocity, friction, inputs.restitution, inputs.law, inputs.surface_velocity),
            stiffness=stiffness,
        )
        after = v + matrices.response[:, places] @ solution.impulse.ravel()
        axes = [g.axes for g in matrices.contacts]
        hit = [k for k in range(len(chosen)) if solution.impulse[k, 2] > 0.0]
        return Group(
            after,
            tuple(sources[k] for k in hit),
            tuple(bool(resting[k]) for k in hit),
            tuple(
                partial(
                    _given,
                    _own_problem(problem, k),
                    solution.impulse[k] @ axes[chosen[k]] if chosen[k] < len(contacts) else np.zeros(3),
                )
                for k in hit
            ),
            tuple(hit),
            problem,
            solution.notes,
        )

    def _restitution(self, contact: Contact | None, rate: float) -> float:
        """Return the restitution of a contact, or of a limit, in an impact at many."""
        approach = max(-float(rate), 0.0)
        if self._sustained and approach <= self._resting_speed:
            return 0.0
        return self._limit_restitution if contact is None else contact.restitution_at(approach)

    def _yielding_inverse(self, t: float, q: Array, v: Array) -> Array:
        """Return M⁻¹ with what is held and locked projected out."""
        nv = self._model.nv
        inverse = np.array(pin.computeMinverse(self._model, self._data, q)).reshape(nv, nv)
        if self._yielding.all() and not self._held:
            return inverse
        rows = np.eye(nv)[~self._yielding]
        if self._held:
            contacts = len(self._dynamics.contacts)
            held = range(contacts - len(self._held), contacts)
            rows = np.vstack([rows, self._dynamics.free_motion_at(t, q, v, held).jacobian.reshape(-1, nv)])
        response = inverse @ rows.T
        inverse -= response @ np.linalg.pinv(rows @ response, rcond=1e-10, hermitian=True) @ response.T
        return inverse

    def without_collision(self, q: Array, v: Array, i: int, stop: bool) -> Impact:
        """Resolve the impact without collision of a contact that slips.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity before it.
            i: The contact.
            stop: Whether to stop its slip outright, since such an impact has not.
        """
        contact = self._dynamics.contacts[i]
        matrices = contact_matrices(self._model, self._data, q, contact, self._held, self._locked)
        velocity = matrices.velocity(v)
        velocity[2] = 0.0
        e = contact.restitution_at(0.0)
        problem = ImpactProblem(
            *(matrices.delassus, velocity, contact.sustained_friction, e, contact.law),
            surface_velocity=matrices.surface_velocity,
            velocity_scale=matrices.velocity_scale(v),
        )
        if stop:
            p = -np.linalg.pinv(matrices.delassus, rcond=1e-10, hermitian=True) @ velocity
        else:
            p = solve_impact(problem).impulse
        return Impact(v + matrices.response @ p, False, partial(_given, problem, p @ matrices.axes))

    def kinetic_energy(self, q: Array, v: Array) -> float:
        """Return the kinetic energy [J]."""
        return float(pin.computeKineticEnergy(self._model, self._data, q, v))


def _coupled(delassus: Array, first: int) -> NDArray[np.int64]:
    """Return the contacts that feel each other and `first`, in their order."""
    n = len(delassus) // 3
    sizes = np.abs(delassus).reshape(n, 3, n, 3).max(axis=(1, 3))
    own = np.sqrt(np.diag(sizes))
    feels = sizes > COUPLED * own[:, None] * own
    found = np.zeros(n, dtype=bool)
    found[first] = True
    for _ in range(n):
        found |= feels[found].any(axis=0)
    return np.flatnonzero(found)


def _stiffness(struck: Sequence[Contact | None], inverse_masses: Array) -> Array:
    """Return relative stiffnesses; of joint limits such that κ W is the mean of the contacts'."""
    given = [np.nan if contact is None else contact.stiffness for contact in struck]
    stiffness = np.array(given, dtype=float)
    stops = np.isnan(stiffness)
    mean = float(np.mean((stiffness * inverse_masses)[~stops])) if not stops.all() else 1.0
    usable = np.where(inverse_masses > 0.0, inverse_masses, 1.0)
    stiffness[stops] = (mean if mean > 0.0 else 1.0) / usable[stops]
    return stiffness


def _own_problem(problem: ImpactProblem, k: int) -> ImpactProblem:
    """Return what one contact's own part of a problem of many is."""
    rows = slice(3 * k, 3 * k + 3)
    return ImpactProblem(
        np.asarray(problem.delassus)[rows, rows],
        np.asarray(problem.velocity)[k],
        float(problem.friction[k]),
        float(problem.restitution[k]),
        problem.law,
        np.asarray(problem.surface_velocity)[k],
    )


def _of_hit(hit: Hit) -> tuple[ImpactProblem, Array]:
    return hit.problem, hit.impulse_world


def _of_limit(c: float, rate: float, e: float) -> tuple[ImpactProblem, Array]:
    return ImpactProblem(np.diag([0.0, 0.0, c]), np.array([0.0, 0.0, rate]), 0.0, e), np.zeros(3)


def _given(problem: ImpactProblem, impulse: Array) -> tuple[ImpactProblem, Array]:
    return problem, impulse
