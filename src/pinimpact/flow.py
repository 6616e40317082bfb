"""The smooth flow of a scene between events: what the kernels that evaluate it read and write."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ._kernels import closing, march, memory, motion, sustained
from ._kernels.motion import EVALUATIONS, FAILED, LEAST_MARGIN, MARGIN, STIFFNESS, STILL, UNIQUE
from ._kernels.sustained import FREE, HELD, SLIP
from .contacts import Contact
from .errors import SimulationError
from .integrator import Step
from .lookup import frame_id
from .manifold import joint_table
from .scene import Scene
from .surfaces import contact_axes

Array = NDArray[np.float64]

_WORLD = pin.Convention.WORLD


def contact_constants(model: pin.Model, contact: Contact) -> tuple[int, int, Array, Array]:
    """Return a contact's joints (tip, plane), its constants and the signs of the velocities that move it.

    The constants are those of `pinimpact._kernels.touch`; the signs (nv,) are 1 for a velocity that moves
    the tip alone, −1 for the plane alone, else 0.
    """
    frame = model.frames[frame_id(model, contact.frame)]
    plane = contact.plane
    tip, base = frame.parentJoint, 0
    carrier = pin.SE3.Identity()
    if plane.body is not None:
        body = model.frames[frame_id(model, plane.body, "body")]
        base, carrier = body.parentJoint, body.placement
    R = carrier.rotation
    constants = np.concatenate(
        [
            frame.placement.act(np.array(contact.offset)),
            [contact.radius],
            carrier.act(np.array(plane.point)),
            (contact_axes(plane.normal) @ R.T).ravel(),
            R @ plane.velocity,
            R @ plane.angular_velocity,
        ]
    )
    signs = np.zeros(model.nv)
    for joint, sign in ((tip, 1.0), (base, -1.0)):
        for support in list(model.supports[joint])[1:]:
            i = model.idx_vs[support]
            signs[i : i + model.nvs[support]] += sign
    return tip, base, constants, signs


class Closed:
    """Some contacts and scalar rows, with what an evaluation leaves of them.

    A scalar row is a joint at its limit or held by its dry friction.

    Attributes:
        which: (nc,) numbers of the contacts; modes, mu: (nc,) theirs; reference: (nc, 2) directions of slip.
        scalars: (ns,) velocity index of each scalar row.
        rows: (nc, 3, nv); velocity, acceleration, surface, force: (nc, 3); gap: (nc,); rest: (nc,) the gap
            that each keeps.
        scalar_force: (ns,) forces at limits and in stuck joints.
        arrays: All, as `pinimpact._kernels.motion` takes them.
    """

    def __init__(
        self,
        nv: int,
        which: Sequence[int] = (),
        modes: Any = (),
        mu: Any = (),
        scalars: Any = (),
        bounds: Any = ((), ()),
        rest: Sequence[float] = (),
    ) -> None:
        count = len(which)
        self.which = np.array(which, dtype=np.int64)
        self.modes = np.array(modes, dtype=np.int64)
        self.mu = np.array(mu, dtype=float)
        self.reference = np.ones((count, 2))
        self.scalars = np.array(scalars, dtype=np.int64)
        limits = np.array(bounds, dtype=float).reshape(2, -1)
        self.rows = np.zeros((count, 3, nv))
        self.velocity = np.zeros((count, 3))
        self.acceleration = np.zeros((count, 3))
        self.surface = np.zeros((count, 3))
        self.gap = np.zeros(count)
        self.rest = np.array(rest, dtype=float)
        self.force = np.zeros((count, 3))
        self.scalar_force = np.zeros(len(scalars))
        size = sum(1 if mode == SLIP else 3 for mode in modes) + len(scalars)
        self.system, self.target, self.solution = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        self.arrays = (
            *(self.which, self.modes, self.mu, self.reference, self.scalars, limits[0], limits[1]),
            *(self.rest, self.rows, self.velocity, self.acceleration, self.surface),
            *(self.gap, np.zeros((count, 2)), np.zeros((size, nv)), np.zeros((size, nv)), self.system),
            *(self.target, self.solution, self.force, self.scalar_force),
        )


@dataclass(slots=True)
class Closing:
    """What stays closed at an instant.

    Attributes:
        velocity: (nv,) the velocity, without what closed contacts take away of it.
        work: Kinetic energy gained by that [J].
        modes: Mode of each contact that stays closed.
        reference: Directions of slip.
        limits: Joint limits that stay closed.
        stuck: Joints that their dry friction holds.
        breaking: The force on each joint that it holds no longer.
        jamming: A contact where slip drives the surface in and no force exists.
        converged: Whether the forces were found to the usual accuracy.
    """

    velocity: Array
    work: float
    modes: dict[int, int] = field(default_factory=dict)
    reference: dict[int, Array] = field(default_factory=dict)
    limits: list[int] = field(default_factory=list)
    stuck: list[int] = field(default_factory=list)
    breaking: dict[int, float] = field(default_factory=dict)
    jamming: int | None = None
    converged: bool = True


class Flow:
    """v̇ and the powers at a state, with the contacts that are closed in their present modes.

    Attributes:
        contacts: All contacts of the scene, held ones last.
        mode: (n,) the mode of each.
        closed: The closed contacts, limits and stuck joints.
        dry: (nv,) dry friction of the joints; sliding: with its sign where a joint slides, else zero.
        step: The numbers of the step that the flow is integrated in.
        machine: All that the kernels need, see `pinimpact._kernels.memory`.
    """

    def __init__(self, scene: Scene, model: pin.Model, contacts: list[Contact], held: list[Contact]) -> None:
        without = scene.without
        nv = model.nv
        self.model = model
        self.nv = nv
        self.data = data = model.createData()
        self.contacts = [*contacts, *held]
        self.control = None if "control" in without else scene.control
        self.failure: BaseException | None = None
        self.dry = scene.joint_friction * ("joint friction" not in without)
        self.sliding = np.zeros(nv)
        self._q, self._v, self._tau = pin.neutral(model), np.zeros(nv), np.zeros(nv)
        self._given, self._clock = np.zeros(nv), np.zeros(1)
        pin.aba(model, data, self._q, self._v, self._tau, _WORLD)
        pin.computeMinverse(model, data)
        # by address from the kernels, so they must live as long as this
        self._calls = (
            *(pin.aba, (model, data, self._q, self._v, self._tau, _WORLD)),
            *(pin.computeMinverse, (model, data)),
            *(pin.forwardKinematics, (model, data, self._q, self._v)),
            *(self._take_least_norm, ()),
            *(self._ask_control, ()),
        )
        calls = np.array([id(item) for item in self._calls])
        if self.control is None:
            calls[motion.CONTROL] = 0
        self.tree = (
            *(calls, self._q, self._v, self._tau, self._given, self._clock),
            *(data.ddq, data.Minv.reshape(nv, nv)),
            _rows_of([(m.rotation, m.translation) for m in data.oMi], 12),
            *(_rows_of([(m.vector,) for m in motions], 6) for motions in (data.v, data.ov, data.oa_gf)),
            *(data.J.reshape(6, nv), scene.joint_damping * ("joint damping" not in without), self.sliding),
        )
        parts = [contact_constants(model, contact) for contact in self.contacts]
        self.points = (
            np.array([constants for _, _, constants, _ in parts]).reshape(-1, 22),
            np.array([(tip, base) for tip, base, _, _ in parts], dtype=np.int64).reshape(-1, 2),
            np.array([signs for _, _, _, signs in parts]).reshape(-1, nv),
            np.repeat(np.arange(model.njoints), np.array(model.nvs)),
        )
        limits = () if "joint limits" in without else scene.limits()
        self.limits = (
            np.array([limit.index_q for limit in limits], dtype=np.int64),
            np.array([limit.index_v for limit in limits], dtype=np.int64),
            np.array([limit.sign for limit in limits], dtype=float),
            np.array([limit.bound for limit in limits], dtype=float),
        )
        self.state = np.zeros(10)
        self.state[[MARGIN, LEAST_MARGIN]] = math.inf
        self.state[UNIQUE] = 1.0
        self.step = Step(joint_table(model), model.nq, nv)
        arrays = (*self.step.arrays, *self.tree, *self.points, *Closed(nv).arrays, self.state, *self.limits)
        self._rows = _addresses(arrays)
        self.held_gap = [0.0] * len(held)
        self._held = np.arange(len(self.contacts)) >= len(contacts)
        self._mu = np.array([contact.friction for contact in self.contacts])
        self.mode = np.full(len(self.contacts), FREE)
        self.mode[len(contacts) :] = HELD
        self._known: dict[Any, tuple[Closed, NDArray[np.int64]]] = {}
        self.close(self.mode, {}, [], [])

    def close(
        self, mode: NDArray[np.int64], reference: dict[int, Array], limits: list[int], stuck: list[int]
    ) -> None:
        """Close the contacts whose mode is not `FREE`, joint limits, and joints that dry friction holds."""
        self.mode = mode
        key = (mode.tobytes(), tuple(limits), tuple(stuck))
        known = self._known.get(key)
        if known is None:
            which = np.flatnonzero(mode).tolist()
            scalars, bounds = self._scalar_rows(limits, stuck)
            free = len(self.contacts) - len(self.held_gap)
            closed = Closed(
                self.nv,
                which,
                mode[which],
                self._mu[which],
                scalars,
                bounds,
                [self.held_gap[i - free] if i >= free else 0.0 for i in which],
            )
            known = self._known[key] = (closed, self._table(closed))
        self.closed: Closed = known[0]
        self.machine: NDArray[np.int64] = known[1]
        for k, i in enumerate(self.closed.which.tolist()):
            self.closed.reference[k] = reference.get(i, (1.0, 0.0))
        self.slipping = bool((self.closed.modes == SLIP).any())
        self.constrained = len(self.closed.which) + len(self.closed.scalars) > 0
        self.state[UNIQUE] = 1.0

    def _table(self, closed: Closed) -> NDArray[np.int64]:
        """Return the table that `pinimpact._kernels.memory` reads; the arrays live as long as this does."""
        table = self._rows.copy()
        table[memory.WHICH : memory.STATE] = _addresses(closed.arrays)
        return table

    def _scalar_rows(self, limits: list[int], stuck: list[int]) -> tuple[NDArray[np.int64], Array]:
        """Return (ns,) velocity indices of limits and stuck joints, and (2, ns) bounds of their forces."""
        bounds = np.zeros((2, len(limits) + len(stuck)))
        for m, k in enumerate(limits):
            bounds[int(self.limits[2][k] > 0.0), m] = math.copysign(math.inf, self.limits[2][k])
        for m, j in enumerate(stuck, start=len(limits)):
            bounds[:, m] = -self.dry[j], self.dry[j]
        return np.concatenate([self.limits[1][limits], np.array(stuck, dtype=np.int64)]), bounds

    def choose(
        self, t: float, q: Array, v: Array, contacts: list[int], limits: list[int], stuck: list[int]
    ) -> Closing:
        """Find what stays closed of the contacts, limits and joints that are at rest against each other.

        Args:
            t: Time [s].
            q: (nq,) configuration.
            v: (nv,) velocity.
            contacts: Those that touch; held ones among them.
            limits: Joint limits that touch.
            stuck: Velocity indices of joints with dry friction that are at rest.
        """
        scalars, bounds = self._scalar_rows(limits, stuck)
        velocity = v.copy()
        count, rows = len(contacts), len(scalars)
        mode, reference = np.zeros(count, dtype=np.int64), np.zeros((count, 2))
        fate, strength = np.zeros(rows, dtype=np.int64), np.zeros(rows)
        which = np.array(contacts, dtype=np.int64)
        jamming, converged, work = closing.choose(
            *(t, q, velocity, which, self._held[which], self._mu[which], scalars, self.limits[2][limits]),
            *(bounds[0], bounds[1], mode, reference, fate, strength, self.machine),
        )
        self.check()
        if jamming >= 0:
            return Closing(velocity, work, jamming=contacts[jamming])
        ends = fate.tolist()
        joints = list(zip(stuck, ends[len(limits) :], strength[len(limits) :].tolist(), strict=True))
        return Closing(
            velocity,
            work,
            {i: m for i, m in zip(contacts, mode.tolist(), strict=True) if m != FREE},
            dict(zip(contacts, reference, strict=True)),
            [k for k, end in zip(limits, ends, strict=False) if end == closing.CLOSED],
            [j for j, end, _ in joints if end == closing.CLOSED],
            {j: force for j, end, force in joints if end == closing.BREAKING},
            converged=converged,
        )

    def correct(self, t: float, q: Array, v: Array, shut: NDArray[np.bool_]) -> float:
        """Bring what is closed back, changing q and v; return the kinetic energy gained."""
        work = closing.correct(t, q, v, shut, self.machine)
        self.check()
        return float(work)

    def _ask_control(self) -> None:
        """Take the control's forces; an error is kept, for a kernel cannot pass it on."""
        try:
            t = float(self._clock[0])
            tau = np.asarray(self.control(t, self._q.copy(), self._v.copy()), dtype=float)  # type: ignore[misc]
            if tau.shape != (self.nv,):
                raise SimulationError(
                    f"control: an array of shape {tau.shape} came back at t = {t:.6g} s; "
                    f"({self.nv},) expected",
                    field="control",
                    value=tau,
                )
            if not math.isfinite(tau.dot(tau)):
                raise SimulationError(
                    f"control: {tau.tolist()} came back at t = {t:.6g} s; numbers in it are not finite",
                    field="control",
                    value=tau,
                )
            self._given[:] = tau
        except BaseException as error:
            self.failure = error
            self.state[FAILED] = 1.0

    def _take_least_norm(self) -> None:
        """Solve for the forces of least norm, without forces that pull where none need to."""
        try:
            closed = self.closed
            closed.solution[:] = least_norm(closed.system, closed.target, closed.modes)
        except BaseException as error:
            self.failure = error
            self.state[FAILED] = 1.0

    def check(self) -> None:
        """Raise what went wrong in a call from a kernel, if anything did."""
        if self.state[FAILED]:
            self.state[FAILED] = 0.0
            failure, self.failure = self.failure, None
            raise failure or KeyboardInterrupt

    @property
    def evaluations(self) -> int:
        """How often v̇ was evaluated."""
        return int(self.state[EVALUATIONS])

    @property
    def still(self) -> float:
        """Speed [m/s] below which slip is none."""
        return float(self.state[STILL])

    @property
    def stiffness(self) -> float:
        """How fast the direction of slip settles at the start of the step, about [1/s]."""
        return float(self.state[STIFFNESS])

    @property
    def unique(self) -> bool:
        """Whether the motion determined the forces last computed; otherwise they are those of least norm."""
        return bool(self.state[UNIQUE])

    def begin(self, t: float, q: Array, v: Array, near: float, seen: Array) -> float:
        """Begin a stretch: evaluate at its start and fill the gaps and rates; see `march.begin`."""
        guess = march.begin(t, q, v, near, self.mode, seen, self.machine)
        self.check()
        return float(guess)

    def look(self, q: Array, v: Array) -> Array:
        """Return (n + m, 2) gap and rate of all contacts, then of the joint limits."""
        found = np.empty((len(self.contacts) + len(self.limits[0]), 2))
        march.look(q, v, found, self.machine)
        return found

    def probe(self, t: float, q: Array, v: Array, closed: Closed) -> Array:
        """Take the motion of some contacts at a state without contact forces; return v̇ there."""
        march.probe(t, q, v, self._table(closed))
        self.check()
        return self.tree[6].copy()

    def anchor(self, q: Array, v: Array) -> None:
        """Let the held contacts keep the gaps that they have at this state."""
        self.probe(0.0, q, v, self.closed)
        self.held_gap = self.closed.gap.tolist()
        self.closed.rest[:] = self.closed.gap


def least_norm(system: Array, target: Array, modes: NDArray[np.int64]) -> NDArray[Any]:
    """Return the solution of least norm, without forces that pull where none need to."""
    solution = np.linalg.lstsq(system, target, rcond=sustained.RANK)[0]
    widths = [1 if mode == SLIP else 3 for mode in modes]
    starts = np.concatenate([[0], np.cumsum(widths)]).astype(int)
    kept = np.ones(len(target), dtype=bool)
    trial = solution
    while True:
        pulls = [
            (trial[starts[k] + widths[k] - 1], k)
            for k in range(len(modes))
            if modes[k] != HELD and kept[starts[k]]
        ]
        normal, k = min(pulls, default=(0.0, 0))
        if normal >= 0.0:
            return trial
        kept[starts[k] : starts[k + 1]] = False
        trial = np.zeros(len(target))
        trial[kept] = np.linalg.lstsq(system[:, kept], target, rcond=sustained.RANK)[0]
        if np.abs(system @ trial - target).max() > 1e-9 * np.abs(target).max():
            return solution


def _addresses(arrays: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    """Return (k, 4) addresses and shapes."""
    return np.array(
        [(array.__array_interface__["data"][0], *array.shape, *(1,) * (3 - array.ndim)) for array in arrays],
        dtype=np.int64,
    )


def _rows_of(parts: list[tuple[Any, ...]], width: int) -> Array:
    """Return (n, width) rows as one view of what Pinocchio keeps in a vector, one row an element."""
    address = parts[0][0].__array_interface__["data"][0]
    numbers = (ctypes.c_double * (len(parts) * width)).from_address(address)
    rows = np.ctypeslib.as_array(numbers).reshape(-1, width)
    for row, part in zip(rows, parts, strict=True):
        laid_out = [item.T.ravel() if item.ndim == 2 else item for item in part]
        if not np.array_equal(row, np.concatenate(laid_out)):
            raise SimulationError(
                "model: this Pinocchio lays out its data in another way than the kernels read it",
                field="model",
            )
    return rows
