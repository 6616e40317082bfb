"""Impacts of a scene: at contacts, at joint limits, and without collision. (theory.md, 13 and 14)"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import TINY
from ..arrays import Array, Bools
from ..contact_space._kernels.tolerances import NUDGE
from ..contact_space.jam_growth import friction_of_jam, growing_indentations, nudged
from ..contact_space.many_inputs import rows_of
from ..contact_space.problem import ImpactProblem
from ..contact_space.simultaneous import ManyInputs, find_policy
from ..contact_space.solve import solve_impact
from ..contact_space.waves import COARSEST
from ..errors import IrregularMotionError, PinimpactError, SimulationError, UnstoppableApproachError
from ..robot._kernels.responses import taking_part
from ..robot.contact import Contact
from ..robot.data_cache import data_cache
from ..robot.forest import inverse_mass
from ..robot.joint_limits import JointLimit
from ..robot.many_impact import ImpactOptions
from ..robot.matrices import ManyMatrices, checked_matrices, contact_matrices
from ..robot.names import free_velocities
from ..robot.pinocchio_bridge import kinetic_energy
from ..robot.placed_robot import PlacedRobot
from ..robot.robot_impact import Hit, impact, impact_in_steps
from ._kernels.contact_forces import FREE, SLIP
from ._kernels.tolerances import NEGLIGIBLE, ROUNDING
from .crowds import BRIEF, CROWD, FEW, MANY, CrowdError
from .dynamics import SceneDynamics
from .impact_results import GroupImpact, Impact, Solved, group_impact, of_hit, of_limit
from .islands import islands, tree_roots
from .records import ImpactGroup
from .scene import Scene
from .switched_off import limit_restitution, locked_joints

_compiled: set[tuple[bool, bool]] = set()

GROWN = 100.0
"""Least growth of the initial velocity of an impact without collision; smaller changes are rounding."""

_NO_AXES = np.zeros((3, 3))
"""Axes of a joint limit, whose impulse has no direction in the world."""


class SceneImpacts:
    """Resolve the impacts of a scene.

    Args:
        scene: The scene.
        model: Its model, without the effects that are switched off.
        data: Its data, which kernels do not read.
        dynamics: The scene's contacts and limits.
        held: Bilateral contacts.
        resting_speed: Resting speed of the scene [m/s].

    Attributes:
        policy: Name of the policy for impacts at several contacts.
        together: Whether the policy resolves all contacts at once.
        unresolved: Change of velocity by gravity in a time step [m/s], 0 for the event-driven scheme. The
            relative error of time steps is the square of its ratio to the velocity; impacts need not be more
            accurate.
        in_steps: Whether the impacts are those of time steps; without restitution they follow Moreau's law,
            as the contact problem of a step does.
        refuses: Whether to raise an error for impacts without restitution whose waves are not resolved.
            Adaptive steps are then tried for up to `FEW` contacts.
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
        self._model = model
        self._data = data
        self._dynamics = dynamics
        self._held = held
        self._locked = locked_joints(scene)
        self._limit_restitution = limit_restitution(scene)
        self._resting_speed = 0.0 if "sustained contact" in scene.without else resting_speed
        self._mobility = free_velocities(model, self._locked).astype(np.float64)
        self._roots = tree_roots(model)
        self._plastic: dict[int, tuple[Contact, Contact]] = {}
        self.policy = scene.simultaneous
        self.together = scene.simultaneous != "sequence"
        self.unresolved, self.in_steps, self.refuses = 0.0, False, False
        data_cache(model, data).ignore_limits()  # a start beyond them is refused, or the limits are left out

    @property
    def _crowd(self) -> float:
        """Number of contacts above which the waves of an impact are followed only briefly."""
        return FEW if self.in_steps else CROWD if self.refuses else math.inf

    def compile_kernels(self, q: Array) -> None:
        """Compile the kernels that impacts may need, once, by resolving impacts with zero velocity.

        Args:
            q: (nq,) a configuration.
        """
        zero = np.zeros(self._model.nv)
        contacts = self._dynamics.contacts
        for in_world in (True, False):
            kind = in_world, bool(self._held)  # determines the types of arguments
            i = next((i for i, c in enumerate(contacts) if (c.plane.body is None) == in_world), None)
            if i is not None and kind not in _compiled:
                _compiled.add(kind)
                with suppress(PinimpactError):  # errors are reported when the contact collides
                    self._impact(replace(contacts[i], restitution=0.0), q, zero)
                    self.without_collision(q, zero, i)

    def resolve(self, q: Array, v: Array, i: int, approach: float) -> Impact:
        """Resolve the impact of a single contact or joint limit.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity before the impact.
            i: Number of the contact; joint limits follow the contacts.
            approach: Speed of approach [m/s].
        """
        slow = approach <= self._resting_speed
        if i < len(self._dynamics.contacts):
            return self._of_contact(q, v, i, slow)
        return self._of_limit(q, v, i, approach, slow)

    def _of_contact(self, q: Array, v: Array, i: int, slow: bool) -> Impact:
        contact = self._dynamics.contacts[i]
        plastic = not callable(contact.restitution) and contact.restitution == 0.0
        hit, resting = None, slow and not plastic
        notes: tuple[str, ...] = ()
        if not slow:
            hit, notes = self._impact(contact, q, v)
            if not plastic:
                resting = bool(self._dynamics.gaps_at(q, hit.v)[i, 1] < self._resting_speed)
        if hit is None or resting:
            known = self._plastic.get(i)
            if known is None or known[0] is not contact:
                known = self._plastic[i] = contact, replace(contact, restitution=0.0)
            hit, more = self._impact(known[1], q, v)
            notes += more
        return Impact(hit.v, resting, partial(of_hit, hit), notes)

    def _impact(self, contact: Contact, q: Array, v: Array) -> tuple[Hit, tuple[str, ...]]:
        if not self._held:
            return impact(self._model, self._data, q, v, contact, locked=self._locked), ()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            asked = ImpactOptions(self._held, self._locked, "exact", False, self.policy, None, {})
            hit = impact_in_steps(self._model, self._data, q, v, contact, asked)
        return hit, tuple(str(warning.message) for warning in caught)

    def _of_limit(self, q: Array, v: Array, i: int, approach: float, slow: bool) -> Impact:
        e, limit = self._limit_restitution, self._dynamics.limits[i - len(self._dynamics.contacts)]
        resting = e > 0.0 and (slow or e * approach < self._resting_speed)
        e = 0.0 if resting else e
        _, matrices = self._matrices(q, [i])
        c, k = float(matrices.delassus[2, 2]), limit.index_v
        constrained = self._held or self._locked
        if constrained and c <= ROUNDING * float(inverse_mass(self._model, self._data, q)[k, k]):
            raise SimulationError(
                f"locked: the joint limit {limit.name!r} is hit at {abs(float(v[k])):.6g}, but held "
                "contacts or locked joints keep the joint from moving; remove them there",
                value=limit.name,
            )
        rate = limit.sign * float(v[k])
        change = matrices.response[:, 2] * ((1.0 + e) * rate / c)
        return Impact(v - change, resting, partial(of_limit, c, rate, e))

    def resolve_group(
        self,
        q: Array,
        v: Array,
        first: int,
        touching: Sequence[int],
        limit: bool = False,
    ) -> GroupImpact | None:
        """Resolve an impact at several contacts and joint limits.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity before the impact.
            first: The contact or limit that collides.
            touching: All that touch, `first` among them, contacts before limits.
            limit: Whether to take the limit of endless impacts, which is a plastic impact of all. (14.8)

        Returns:
            The impact; None if only `first` takes part. If `first` has restitution and others are coupled to
            it but lifted, the impact is returned too, since the law is then the energetic one.

        Raises:
            CrowdError: The impact is refused, see `refuses`, or many contacts have many events.
        """
        touching = self._connected(first, touching)
        if len(touching) == 1:
            return None
        every, matrices = self._matrices(q, touching)
        velocity, surface = matrices.velocity(v), matrices.surface_velocity
        friction = np.array([0.0 if contact is None else contact.friction for contact in every])
        work = self._dynamics.work  # gap rates of active contacts are errors of steps
        least = max(work.least_approach, work.certain_speed)
        parts = np.empty(len(touching), dtype=np.int64)
        place, rates = touching.index(first), velocity[:, 2].copy()
        coupled = taking_part(matrices.delassus, friction, rates, least, place, parts)
        chosen = parts.nonzero()[0]
        struck = [every[k] for k in chosen.tolist()]
        one = struck[0]
        plastic = (self._limit_restitution if one is None else one.restitution) == 0.0
        if len(chosen) == 1 and (not coupled or plastic):
            return None
        e = [self._restitution(c, rate) for c, rate in zip(struck, rates[chosen].tolist(), strict=True)]
        sources = [touching[k] for k in chosen.tolist()]
        refuse = self.refuses and not limit and not any(e)
        crowd = not limit and not self._locked and len(chosen) > self._crowd  # steps do not lock joints
        policy = self.policy
        if limit or (self.in_steps and not any(e)):
            policy, e = "together", [0.0] * len(struck)
        delassus, response = matrices.delassus, matrices.response
        if len(chosen) < len(touching):
            places = rows_of(chosen)
            delassus, response = np.ascontiguousarray(delassus[np.ix_(places, places)]), response[:, places]
            velocity, surface, friction = velocity[chosen], surface[chosen], friction[chosen]
        accuracy = 0.0 if crowd or (refuse and len(chosen) > FEW) else self._accuracy(velocity)
        most = BRIEF if crowd and policy == "propagate" else None
        try:
            solved = self._solve(
                policy, struck, (delassus, velocity, friction, surface), e, sources, accuracy, most
            )
        except UnstoppableApproachError:
            # active contacts may approach by the error of steps in a direction that no impulse changes
            rests = work.modes[sources, None] > np.array([SLIP, SLIP, FREE])
            rests &= np.abs(velocity) <= least
            if not rests.any():
                raise
            velocity = np.where(rests, 0.0, velocity)
            solved = self._solve(
                policy, struck, (delassus, velocity, friction, surface), e, sources, accuracy, most
            )
        if refuse and not solved.solution.story.resolved:
            raise CrowdError(sources, e)
        axes = [matrices.axes[k] if k < len(matrices.axes) else _NO_AXES for k in chosen.tolist()]
        return group_impact(v, response, solved, sources, axes, 0.0)

    def without_forces(
        self, t: float, q: Array, v: Array, touching: Sequence[int], slips: Bools, slack: float
    ) -> GroupImpact | None:
        """Resolve an impact without collision, where no admissible forces exist. (theory.md, 13.2)

        Args:
            t: Time [s].
            q: (nq,) configuration.
            v: (nv,) velocity.
            touching: All that touch, contacts before limits.
            slips: (k,) whether each of these slips; the others are at rest.
            slack: Largest relative increase of friction that makes the forces unbounded; 0: no forces exist.

        Returns:
            The impact, or None if there is none.

        Raises:
            IrregularMotionError: It is refused, see `refuses`: its waves are not resolved.
        """
        if not touching:
            return None
        every, matrices = self._matrices(q, touching)
        velocity = matrices.velocity(v)
        velocity[:, 2] = np.minimum(velocity[:, 2], 0.0)
        velocity[~slips, :2] = 0.0
        speed = float(np.abs(velocity).max(initial=0.0))
        push = self._dynamics.pushes(t, q, v, touching)
        if speed == 0.0 or not push.min() < 0.0:
            return None
        friction = np.array([0.0 if contact is None else contact.sustained_friction for contact in every])
        if slack > 0.0:
            more = friction_of_jam(matrices.delassus, velocity, friction, slips)
            if more > 1.0 + slack:
                return None
            friction = friction * more
        growing = growing_indentations(
            matrices.delassus, velocity, friction, slips, _stiffness(every, matrices.delassus)
        )
        if growing is None:
            if slack > 0.0:
                return None
            growing = np.maximum(-push, 0.0) / -push.min()  # in proportion to the loads (13.7)
        before, velocity = velocity, nudged(velocity, slips, growing)
        nudge = float((before - velocity)[:, 2].max())
        e = [self._limit_restitution if c is None else c.restitution_at(0.0) for c in every]
        numbers = matrices.delassus, velocity, friction, matrices.surface_velocity
        try:
            accuracy = 0.0 if self.refuses else self._accuracy(velocity)
            solved = self._solve("propagate", every, numbers, e, touching, accuracy)
        except UnstoppableApproachError:
            return None
        if self.refuses and not solved.solution.story.resolved:
            raise IrregularMotionError("scene: an impact without collision is not resolved")
        change = matrices.delassus @ solved.solution.impulse.ravel()
        if not float(np.abs(change).max()) > GROWN * nudge:
            return None
        axes = [*matrices.axes, *[_NO_AXES] * (len(every) - len(matrices.axes))]
        return group_impact(v, matrices.response, solved, touching, axes, NUDGE)

    def _accuracy(self, velocity: Array) -> float:
        """Return the tolerance of adaptive steps through an impact, relative to its largest velocity."""
        missed = (self.unresolved / max(float(np.abs(velocity).max()), TINY)) ** 2
        return min(max(self._dynamics.work.rtol, missed), COARSEST)

    def refuse_crowd(self, active: int) -> None:
        """Raise an error if so many contacts of several robots are active that time steps are cheaper."""
        if active > MANY and self._roots[-1] > 1:
            raise IrregularMotionError(f"scene: {active} contacts are active at once")

    def _connected(self, first: int, touching: Sequence[int]) -> list[int]:
        """Return those of `touching` that joints and contacts, also held ones, connect with the first."""
        if self._roots[-1] <= 1:  # one tree
            return list(touching)
        work, count = self._dynamics.work, len(self._dynamics.contacts)
        every = np.array([first, *touching, *range(count - len(self._held), count)])
        of_contact, ends = every < count, np.empty((len(every), 2), dtype=np.int64)
        ends[of_contact] = work.contact_joints[every[of_contact]]
        ends[~of_contact] = work.velocity_joint[work.limit_v[every[~of_contact] - count], None]
        of = islands(self._roots, ends)[ends.max(axis=1)]
        return [i for i, island in zip(touching, of[1:].tolist(), strict=False) if island == of[0]]

    def _matrices(self, q: Array, touching: Sequence[int]) -> tuple[list[Contact | None], ManyMatrices]:
        """Return the contacts, with None for each limit, and their matrices."""
        count = len(self._dynamics.contacts)
        every = [self._dynamics.contacts[i] if i < count else None for i in touching]
        contacts = [contact for contact in every if contact is not None]
        limits = [self._dynamics.limits[i - count] for i in touching if i >= count]
        placed = PlacedRobot(self._model, self._data, q)
        return every, matrices_of_all(placed, contacts, limits, self._held, self._mobility)

    def _solve(
        self,
        name: str,
        struck: Sequence[Contact | None],
        numbers: tuple[Array, Array, Array, Array],
        e: Sequence[float],
        sources: Sequence[int],
        accuracy: float,
        most: int | None = None,
    ) -> Solved:
        """Solve an impact at several contacts, and determine which bounce slower than the resting speed.

        Args:
            name: Name of the policy.
            struck: The contacts, with None for each limit.
            numbers: Delassus matrix, velocities, friction and velocities of the surfaces.
            e: Coefficients of restitution.
            sources: Numbers of the contacts and limits.
            accuracy: Relative tolerance of adaptive steps through the impact; 0: no such steps.
            most: Largest number of steps between events per contact, for the policy "propagate".
        """
        delassus, velocity, friction, surface = numbers
        stiffness = _stiffness(struck, delassus)
        laws = {contact.law for contact in struck if contact is not None}
        law = laws.pop() if len(laws) == 1 else "energetic"
        policy = find_policy(name)
        restitution = np.array(e)
        inputs = ManyInputs(delassus, velocity, friction, restitution, stiffness, law, surface, False)
        options = {"accuracy": accuracy} if name == "propagate" else {}
        briefly = {} if most is None else {"most": most}
        try:
            solution = policy.run(inputs, False, **options, **briefly)
        except IrregularMotionError:
            raise CrowdError(sources, e) from None
        pressed, bounces = solution.impulse[:, 2].tolist(), solution.velocity[:, 2].tolist()
        slowest = [self._resting_speed / self._metres(i) for i in sources]
        resting = [
            0.0 < bounce < slow and p > 0.0 and one > 0.0
            for bounce, slow, p, one in zip(bounces, slowest, pressed, e, strict=True)
        ]
        problem = ImpactProblem(
            *(delassus, velocity, friction, restitution, law, surface), stiffness=stiffness
        )
        return Solved(solution, resting, ImpactGroup(problem, name, options))

    def _metres(self, i: int) -> float:
        """Return the metres per unit of a row: 1 for a contact, κ of (10.6) for a limit."""
        k = i - len(self._dynamics.contacts)
        return 1.0 if k < 0 else float(self._dynamics.work.joint_metres[self._dynamics.limits[k].index_v])

    def _restitution(self, contact: Contact | None, rate: float) -> float:
        """Return the restitution of a contact or limit at a gap rate [m/s]."""
        return self._limit_restitution if contact is None else contact.restitution_at(max(-rate, 0.0))

    def without_collision(self, q: Array, v: Array, i: int) -> Impact:
        """Resolve the impact without collision at a single slipping contact.

        Within rounding of the friction from which the normal acceleration is negative, that friction is used.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity before the impact.
            i: Number of the contact.
        """
        contact = self._dynamics.contacts[i]
        matrices = contact_matrices(self._model, self._data, q, contact, self._held, self._locked)
        velocity = matrices.velocity(v)
        velocity[2] = 0.0
        e, friction = contact.restitution_at(0.0), contact.sustained_friction
        along = float(matrices.delassus[2, :2] @ velocity[:2])
        if along > 0.0:
            largest = (1.0 + NEGLIGIBLE) * float(matrices.delassus[2, 2])
            friction = max(friction, largest * math.hypot(*velocity[:2]) / along)
        problem = ImpactProblem(
            *(matrices.delassus, velocity, friction, e, contact.law),
            surface_velocity=matrices.surface_velocity,
            velocity_scale=matrices.velocity_scale(v),
            factor=matrices.factor,
            factor_scale=matrices.factor_scale,
        )
        p = solve_impact(problem).impulse
        return Impact(v + matrices.response @ p, False, lambda: (problem, p @ matrices.axes))

    def kinetic_energy(self, q: Array, v: Array) -> float:
        """Return the kinetic energy [J]."""
        return kinetic_energy(self._model, self._data, q, v)


def matrices_of_all(
    placed: PlacedRobot,
    contacts: Sequence[Contact],
    limits: Sequence[JointLimit],
    held: Sequence[Contact],
    mobility: Array,
) -> ManyMatrices:
    """Return the matrices of contacts, followed by joint limits, of a robot at a configuration.

    Args:
        placed: The robot.
        contacts: The contacts.
        limits: The joint limits.
        held: Bilateral contacts.
        mobility: (nv,) 1 for velocities that impacts change, 0 for locked joints.
    """
    stops = np.zeros((len(limits), len(mobility)))
    for row, limit in zip(stops, limits, strict=True):
        row[limit.index_v] = limit.sign
    return checked_matrices(placed, contacts, tuple(map(placed.geometry, held)), mobility, stops, True)


def _stiffness(struck: Sequence[Contact | None], delassus: Array) -> Array:
    """Return relative stiffnesses κ; for a joint limit κ W is the mean of that of the contacts."""
    inverse_masses = delassus.diagonal()[2::3].tolist()
    given = [contact.stiffness * w for contact, w in zip(struck, inverse_masses, strict=True) if contact]
    mean = (sum(given) / len(given) if given else 0.0) or 1.0
    return np.array(
        [
            contact.stiffness if contact else mean / (w if w > 0.0 else 1.0)
            for contact, w in zip(struck, inverse_masses, strict=True)
        ]
    )
