"""Forces of sustained contact, joint limits and dry friction along a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..arrays import Array, Bools, Integers
from ._kernels import active_set, force_evaluation
from ._kernels.contact_forces import SLIP
from ._kernels.step_rows import MeanForces, StepResult, StepRows
from ._kernels.workspace import SceneWorkspace
from .dense_step import DenseStep

FORCE_SAMPLES = 7
"""Number of nodes per step at which a saved trajectory stores the forces; they are interpolated between."""

OF_CONTACTS = 8
"""Number of fields of `StepForces` that have a row for each contact."""


class ClosedSet(NamedTuple):
    """The active contacts of a smooth motion, and all else beside the state that determines their forces.

    Attributes:
        modes: (n + nl + nv,) modes of contacts, joint limits and joints.
        sliding: (nv,) dry friction of sliding joints, with the sign of the velocity.
        sides: (nv,) nonzero for drives at their effort limits.
        control: (nv,) constant generalized force of the control.
        constants: (k, …) constants of the active contacts; their axes follow the surfaces.
        direction_speed: Speed below which slip keeps its last direction [m/s].
        slips: Whether any contact slips.
        unique: Whether the motion determines the forces.
        joints: (k, 2) joints of the tip and of the surface of the active contacts.
        swapped: Contacts whose forces act on the second shape of their pair, not on the first.
    """

    modes: Integers
    sliding: Array
    sides: Integers
    control: Array
    constants: Array
    direction_speed: float
    slips: bool
    unique: bool
    joints: Integers
    swapped: Integers

    def under(self, control: Array, direction_speed: float) -> ClosedSet:
        """Return this set under another force of the control."""
        return self._replace(control=control, direction_speed=direction_speed)

    @classmethod
    def of(cls, work: SceneWorkspace, swapped: Integers) -> ClosedSet | None:
        """Return the present set; None if nothing is active and no joint slides with dry friction."""
        if work.active_contacts + work.active_scalars == 0 and not work.sliding_friction.any():
            return None
        index = work.active_index
        return cls(
            work.modes.copy(),
            work.sliding_friction.copy(),
            work.drive_side.copy(),
            work.control_force.copy(),
            work.contact_constants.take(index, axis=0),
            work.direction_speed,
            SLIP in work.active_mode.tolist(),
            work.forces_unique,
            work.contact_joints.take(index, axis=0),
            swapped,
        )


class Forces(NamedTuple):
    """Forces on the robot at one time.

    Attributes:
        world: (n, 3) contact forces in world axes [N].
        points: (n, 3) points where they act [m].
        normals: (n, 3) surface normals there, in world axes.
        joints: (nv,) forces of joint limits and dry friction [N, N m].
        unique: Whether the motion determines them; else they are those of equally stiff contacts. None in a
            time step, see `ForceSource.unique`.
    """

    world: Array
    points: Array
    normals: Array
    joints: Array
    unique: bool | None


class StepForces(NamedTuple):
    """Forces in a time step, during which they are constant.

    Attributes:
        contacts: (k,) numbers of the contacts that are near in the step, and of held ones.
        world, points: (k, 3) as in `Forces`.
        axes: (k, 3, 3) contact axes t₁, t₂, n as rows.
        impulses: (k, 3) impulses in contact axes [N s].
        speeds: (k, 3) velocities of the contact points at the end of the step, in contact axes [m/s].
        gaps: (k,) gaps there [m], zero for held contacts.
        ends: (k, 2) joints of the tips and of the surfaces.
        joints: (nv,) as in `Forces`.
        modes: (nl + nv,) modes of joint limits and joints.
        resting: The forces on bodies at rest, or None.
    """

    contacts: Integers
    world: Array
    points: Array
    axes: Array
    impulses: Array
    speeds: Array
    gaps: Array
    ends: Integers
    joints: Array
    modes: Integers
    resting: StepForces | None = None

    @classmethod
    def of(
        cls,
        work: SceneWorkspace,
        rows: StepRows,
        found: StepResult,
        mean: MeanForces,
        resting: StepForces | None,
    ) -> StepForces:
        """Return the forces of a step just reported, and those on bodies at rest."""
        contacts, near = np.concatenate([rows.contacts, rows.held]), len(rows.contacts)
        count = len(contacts)
        gaps = np.zeros(count)
        gaps[:near] = found.gap_end[:near]
        impulses, speeds = (part[: 3 * count].reshape(count, 3) for part in (found.impulse, found.u_end))
        return cls(
            *(contacts, mean.world, mean.points, mean.axes, impulses, speeds, gaps),
            *(work.contact_joints[contacts], mean.joints, work.modes[work.contacts :].copy(), resting),
        )

    def of_contacts(self) -> tuple[Any, ...]:
        """Return the fields that have a row for each contact, the first ones."""
        return self[:OF_CONTACTS]

    def replaced(self, of_contacts: Iterable[Any], joints: Array) -> StepForces:
        """Return other forces of the same step, without bodies at rest; see `of_contacts`."""
        parts: dict[str, Any] = dict(zip(self._fields, of_contacts, strict=False))
        return self._replace(**parts, joints=joints, resting=None)

    def together(self) -> StepForces:
        """Return these forces together with those on bodies at rest."""
        if self.resting is None:
            return self
        both = zip(self.of_contacts(), self.resting.of_contacts(), strict=True)
        return self.replaced(map(np.concatenate, both), self.joints + self.resting.joints)

    def of_all(self, count: int) -> Forces:
        """Return the forces of all `count` contacts."""
        world, points, normals = every = np.zeros((3, count, 3))
        whole = self.together()
        every[:, whole.contacts] = whole.world, whole.points, whole.axes[:, 2]
        return Forces(world, points, normals, whole.joints, None)

    def acting(self, count: int) -> Bools:
        """Return (`count`,) whether each contact has a force."""
        acts, whole = np.zeros(count, dtype=bool), self.together()
        acts[whole.contacts] = whole.world.any(axis=1)
        return acts


class ForceSource(Protocol):
    """Source of the forces of a trajectory.

    Attributes:
        contacts: Names of the contacts whose forces are known.
    """

    contacts: Sequence[str]

    def at(self, number: int, step: DenseStep, t: float) -> Forces | None:
        """Return the forces at a time [s] within a step, given with its number; None if nothing is active."""

    def unique(self, number: int, step: DenseStep, t: float) -> bool:
        """Return whether the motion determines these forces."""


class Dynamics(Protocol):
    """The part of `SceneDynamics` that forces need."""

    work: SceneWorkspace

    def make_room(self, closing: Integers) -> None:
        """See `SceneDynamics.make_room`."""

    def check(self) -> None:
        """See `SceneDynamics.check`."""


def set_closed(dynamics: Dynamics, closed: ClosedSet) -> None:
    """Set the active contacts and modes of some dynamics."""
    work = dynamics.work
    dynamics.make_room(closed.modes[: work.contacts])
    active_set.take_over(
        *(work, closed.modes, closed.sliding, closed.sides, closed.control, closed.constants, closed.joints)
    )
    work.direction_speed = closed.direction_speed


class EvaluatedForces:
    """Forces that are evaluated at the state of the motion on demand.

    Args:
        dynamics: Returns the dynamics of the scene, with tolerances set.
        determined: Returns whether the motion determines the forces of a time step, given with the
            configuration at its midpoint and a workspace.
        contacts: Names of the contacts.
    """

    def __init__(
        self,
        dynamics: Callable[[], Dynamics],
        determined: Callable[[StepForces, Array, SceneWorkspace], bool],
        contacts: Sequence[str],
    ) -> None:
        self._make, self._determined = dynamics, determined
        self.contacts = contacts

    @cached_property
    def _dynamics(self) -> Dynamics:
        return self._make()

    def at(self, number: int, step: DenseStep, t: float) -> Forces | None:
        """See `ForceSource`."""
        closed = step.closed
        if closed is None:
            return None
        if isinstance(closed, StepForces):
            return closed.of_all(len(self.contacts))
        dynamics = self._dynamics
        work = dynamics.work
        set_closed(dynamics, closed)
        share = (t - step.start) / step.h
        directions = np.zeros((work.contacts, 2))
        if step.directions is not None:
            between = (1.0 - share) * step.directions[0] + share * step.directions[1]
            length = np.linalg.norm(between, axis=1, keepdims=True)
            between = np.divide(between, length, out=between, where=length > 0.0)
            directions[np.flatnonzero(closed.modes[: work.contacts])] = between
        n = work.contacts
        world, points, normals = np.zeros((3, n, 3))
        joints = np.zeros(work.nv)
        unique = force_evaluation.forces_at(
            work, t, *step.at(t), directions, closed.unique, world, points, normals, joints
        )
        dynamics.check()
        world[closed.swapped] *= -1.0
        normals[closed.swapped] *= -1.0
        return Forces(world, points, normals, joints, bool(unique))

    def unique(self, number: int, step: DenseStep, t: float) -> bool:
        """See `ForceSource`."""
        if isinstance(step.closed, StepForces):
            middle, _ = step.at(step.start + 0.5 * step.h)
            return self._determined(step.closed.together(), middle, self._dynamics.work)
        found = self.at(number, step, t)
        return found is None or bool(found.unique)


class TabulatedForces:
    """Forces that are interpolated between the Chebyshev nodes of each step.

    Args:
        contacts: Names of the contacts.
        tables: (m,) numbers of the steps with active contacts; world, points and normals
            (m, `FORCE_SAMPLES`, n, 3), joints (m, `FORCE_SAMPLES`, nv) and unique (m,), see `Forces`.
    """

    def __init__(self, contacts: Sequence[str], *tables: Any) -> None:
        self.contacts, self.tables = list(contacts), tables
        self._row = {int(number): m for m, number in enumerate(tables[0])}

    @classmethod
    def of(cls, source: ForceSource, steps: Sequence[DenseStep]) -> TabulatedForces:
        """Tabulate the forces of another source, for the contacts that are ever active."""
        if isinstance(source, cls):
            return source
        count = len(source.contacts)
        closed = [
            step.closed.acting(count) if isinstance(step.closed, StepForces) else step.closed.modes[:count]
            for step in steps
            if step.closed is not None
        ]
        used = np.flatnonzero(np.any(closed, axis=0)) if closed else np.zeros(0, dtype=np.int64)
        rows: list[int] = []
        found: list[list[Forces]] = []
        unique: list[bool] = []
        for number, step in enumerate(steps):
            times = step.start + (step.end - step.start) * nodes()
            at_nodes = [one for t in times.tolist() if (one := source.at(number, step, t)) is not None]
            if at_nodes:
                rows.append(number)
                found.append(at_nodes)
                flags = [one.unique for one in at_nodes]
                unique.append(source.unique(number, step, step.start) if None in flags else all(flags))
        n, nv = len(used), len(steps[0].v) if steps else 0

        def table(part: Callable[[Forces], Array], *shape: int) -> Array:
            return np.array([[part(one) for one in step] for step in found]).reshape(
                len(found), FORCE_SAMPLES, *shape
            )

        return cls(
            [source.contacts[i] for i in used.tolist()],
            np.array(rows, dtype=np.int64),
            table(lambda one: one.world[used], n, 3),
            table(lambda one: one.points[used], n, 3),
            table(lambda one: one.normals[used], n, 3),
            table(lambda one: one.joints, nv),
            np.array(unique, dtype=np.bool_),
        )

    def at(self, number: int, step: DenseStep, t: float) -> Forces | None:
        """See `ForceSource`."""
        m = self._row.get(number)
        if m is None:
            return None
        _, *sampled, unique = self.tables
        width = step.end - step.start
        weights = _weights((t - step.start) / width if width > 0.0 else 0.0)
        world, points, normals, joints = (np.tensordot(weights, one[m], 1) for one in sampled)
        return Forces(world, points, normals, joints, bool(unique[m]))

    def unique(self, number: int, step: DenseStep, t: float) -> bool:
        """See `ForceSource`."""
        m = self._row.get(number)
        return m is None or bool(self.tables[-1][m])


def nodes() -> Array:
    """Return the Chebyshev nodes of the second kind in [0, 1]."""
    return 0.5 - 0.5 * np.cos(np.pi * np.arange(FORCE_SAMPLES) / (FORCE_SAMPLES - 1))


def _weights(x: float) -> Array:
    """Return the weights (`FORCE_SAMPLES`,) of the values at the nodes at x, by the barycentric formula."""
    away = x - nodes()
    hit = away == 0.0
    if hit.any():
        return hit.astype(float)
    signs = (-1.0) ** np.arange(FORCE_SAMPLES)
    signs[[0, -1]] *= 0.5
    weights: Array = signs / away
    return weights / weights.sum()
