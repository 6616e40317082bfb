"""The smooth flow of a scene between events: what the kernels that evaluate it read and write."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..errors import SimulationError
from ..robot._kernels.constants import CONSTANTS
from ..robot._kernels.python_calls import raise_kept_error
from ..robot.contact import Contact, contact_constants
from ..robot.pinocchio_bridge import Call, call_addresses, robot_dynamics
from ._kernels import advance, contact_forces, contact_modes, dynamics, workspace
from ._kernels.contact_forces import HELD, SLIP
from ._kernels.dynamics import ALLOWANCE, EVALUATIONS, FAILED, LEAST_MARGIN, MARGIN, STIFFNESS, UNIQUE
from .joint_charts import joint_table
from .scene import JointLimit, Scene
from .step import Segment, Step

Array = NDArray[np.float64]


class Probe(NamedTuple):
    """The motion of some contacts without contact forces.

    Attributes:
        joints: (nv,) v̇.
        rows: (k, 3, nv) contact Jacobians.
        velocity, acceleration, surface: (k, 3) of the contacts, and of the surfaces.
        gap: (k,) gaps [m].
    """

    joints: Array
    rows: Array
    velocity: Array
    acceleration: Array
    surface: Array
    gap: Array


class Flow:
    """v̇ and the powers at a state, with the contacts that are closed in their present modes.

    Attributes:
        contacts: All contacts of the scene, held ones last.
        limits: The joint limits.
        standing: (n + nl + nv,) the mode of each contact, then 1 for each closed limit, then 1 for each joint
            that its dry friction holds.
        step: The numbers of the step that the flow is integrated in.
        machine: All that the kernels need, see `pinimpact.scene._kernels.workspace`.
    """

    def __init__(
        self,
        scene: Scene,
        model: pin.Model,
        contacts: Sequence[Contact],
        held: Sequence[Contact],
        limits: Sequence[JointLimit],
    ) -> None:
        without = scene.without
        nv = model.nv
        self.nv = nv
        self.contacts = (*contacts, *held)
        self.limits = tuple(limits)
        self.control = None if "control" in without else scene.control
        robot = robot_dynamics(model)
        self._q, self._v = robot.q, robot.v
        self._given, self._clock = np.zeros(nv), np.zeros(1)
        # by address from the kernels, so these and all arrays must live as long as this
        self._calls = (
            *(robot.forward_dynamics, robot.inverse_mass, robot.forward_kinematics),
            *(Call(self._take_least_norm, ()), Call(self._ask_control, ())),
        )
        self._robot = robot
        calls = call_addresses(self._calls)
        if self.control is None:
            calls[dynamics.CONTROL] = 0
        dry = scene.joint_friction * ("joint friction" not in without)
        self.tree = (
            *(calls, robot.q, robot.v, robot.tau, self._given, self._clock),
            *(robot.acceleration, robot.minverse, robot.placements, robot.local_velocities),
            *(robot.velocities, robot.accelerations, robot.joint_jacobian),
            scene.joint_damping * ("joint damping" not in without),
            *(dry, np.zeros(nv)),
        )
        count = len(self.contacts)
        parts = [contact_constants(model, contact) for contact in self.contacts]
        self._kept = np.zeros(count)
        self.points = (
            np.array([constants for _, _, constants, _ in parts]).reshape(-1, CONSTANTS),
            np.array([(tip, base) for tip, base, _, _ in parts], dtype=np.int64).reshape(-1, 2),
            np.array([signs for _, _, _, signs in parts]).reshape(-1, nv),
            np.repeat(np.arange(model.njoints), np.array(model.nvs)),
            np.array([contact.friction for contact in self.contacts], dtype=float),
            self._kept,
            np.array([0] * len(contacts) + [1] * len(held), dtype=np.int64),
        )
        bounds = (
            np.array([limit.index_q for limit in limits], dtype=np.int64),
            np.array([limit.index_v for limit in limits], dtype=np.int64),
            np.array([limit.sign for limit in limits], dtype=float),
            np.array([limit.bound for limit in limits], dtype=float),
        )
        self.state = np.zeros(11)
        self.state[[MARGIN, LEAST_MARGIN]] = math.inf
        self.standing = np.zeros(count + len(limits) + nv, dtype=np.int64)
        self.step = Step(joint_table(model), model.nq, nv)
        most = len(limits) + int(np.count_nonzero(dry))
        self._closed = _room(count, most, nv)
        self._arrays = (
            *(*self.step.arrays, *self.tree, *self.points, *bounds),
            *(self.state, self.standing, *self._closed),
        )
        self.machine = _addresses(self._arrays)
        contact_modes.hold(self.machine)

    def settle(self, t: float, q: Array, v: Array, slow: NDArray[np.int64]) -> tuple[int, bool, float]:
        """Set the modes of what touches without bouncing; v loses what closed contacts take away of it.

        Args:
            t: Time [s].
            q: (nq,) configuration.
            v: (nv,) velocity.
            slow: (n + nl,) 1 for each contact and limit that touches.

        Returns:
            A contact where slip drives the surface in and no force exists, or −1; whether the forces were
            found to the usual accuracy; the kinetic energy gained.
        """
        jamming, converged, work = contact_modes.settle(t, q, v, slow, self.machine)
        self.check()
        return jamming, converged, work

    def end_of_modes(self, segment: Segment, end: float) -> float:
        """Return when no forces exist any more for the modes that hold, within a step until `end`."""
        time = contact_modes.end_of_modes(
            *(segment.start, segment.h, end, segment.q, segment.v, segment.coefficients, self.machine)
        )
        self.check()
        return float(time)

    def correct(self, t: float, q: Array, v: Array) -> float:
        """Bring what is closed back, changing q and v; return the kinetic energy gained."""
        work = contact_modes.correct(t, q, v, self.machine)
        self.check()
        return float(work)

    def jam(self, t: float, q: Array, v: Array, certain: bool) -> bool:
        """Stop contacts whose forces grow without bound, changing v; return whether there are any."""
        jammed = contact_modes.jam(t, q, v, certain, self.machine)
        self.check()
        return bool(jammed)

    def _ask_control(self) -> None:
        """Take the control's forces."""
        t = float(self._clock[0])
        try:
            tau = np.asarray(self.control(t, self._q.copy(), self._v.copy()), dtype=float)  # type: ignore[misc]
        except Exception as error:
            raise SimulationError(
                f"control: {type(error).__name__} at t = {t:.6g} s: {error}", field="control"
            ) from error
        if tau.shape != (self.nv,):
            raise SimulationError(
                f"control: an array of shape {tau.shape} came back at t = {t:.6g} s; ({self.nv},) expected",
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

    def _take_least_norm(self) -> None:
        """Solve for the forces of least norm, without forces that pull where none need to."""
        count, size = self.machine[workspace.MODES, 1], self.machine[workspace.TARGET, 1]
        modes, system, target, solution = (
            self._closed[k - workspace.WHICH]
            for k in (workspace.MODES, workspace.SYSTEM, workspace.TARGET, workspace.SOLUTION)
        )
        system = system.ravel()[: size * size].reshape(size, size)
        solution[:size] = least_norm(system, target[:size], modes[:count])

    def check(self) -> None:
        """Raise what went wrong in a call from a kernel, if anything did."""
        if self.state[FAILED]:
            self.state[FAILED] = 0.0
            raise_kept_error()

    @property
    def evaluations(self) -> int:
        """How often v̇ was evaluated."""
        return int(self.state[EVALUATIONS])

    @property
    def stiffness(self) -> float:
        """How fast the direction of slip settles at the start of the step, about [1/s]."""
        return float(self.state[STIFFNESS])

    @property
    def doubtful(self) -> bool:
        """Whether the forces last computed do not clearly keep to what their modes allow."""
        return bool(self.state[MARGIN] <= 2.0 * self.state[ALLOWANCE])

    @property
    def unique(self) -> bool:
        """Whether the motion determined the forces last computed; otherwise they are those of least norm."""
        return bool(self.state[UNIQUE])

    @property
    def constrained(self) -> bool:
        """Whether anything is closed."""
        return bool(self.machine[workspace.WHICH, 1] + self.machine[workspace.SCALARS, 1])

    def begin(self, t: float, q: Array, v: Array, near: float, seen: Array) -> float:
        """Begin a stretch: evaluate at its start and fill the gaps and rates; see `advance.begin`."""
        guess = advance.begin(t, q, v, near, seen, self.machine)
        self.check()
        return float(guess)

    def look(self, q: Array, v: Array) -> Array:
        """Return (n + nl, 2) gap and rate of all contacts, then of the joint limits."""
        found = np.empty((len(self.contacts) + len(self.limits), 2))
        advance.look(q, v, found, self.machine)
        return found

    def probe(self, t: float, q: Array, v: Array, which: Sequence[int]) -> Probe:
        """Take the motion of some contacts at a state without contact forces."""
        k, nv = len(which), self.nv
        velocity, acceleration, surface = np.empty((3, k, 3))
        found = Probe(np.empty(nv), np.empty((k, 3, nv)), velocity, acceleration, surface, np.empty(k))
        advance.probe(t, q, v, np.array(which, dtype=np.int64), *found, self.machine)
        self.check()
        return found

    def anchor(self, gaps: Array) -> None:
        """Let the contacts keep these gaps (n,) where they are closed."""
        self._kept[:] = gaps
        contact_modes.hold(self.machine)


def _room(contacts: int, scalars: int, nv: int) -> tuple[NDArray[Any], ...]:
    """Return the arrays of what is closed, from `WHICH` on, for as many contacts and scalar rows."""
    size = 3 * contacts + scalars
    shapes = (
        *((contacts,), (contacts,), (contacts,), (contacts, 2), (contacts,)),
        *((scalars,), (scalars,), (scalars,)),
        *((contacts, 3, nv), (contacts, 3), (contacts, 3), (contacts, 3), (contacts,), (contacts, 2)),
        *((size, nv), (size, nv), (size, size), (size,), (size,), (contacts, 3), (scalars,)),
    )
    integers = {workspace.WHICH, workspace.MODES, workspace.SCALARS}
    return tuple(
        np.zeros(shape, dtype=np.int64 if k in integers else float)
        for k, shape in enumerate(shapes, start=int(workspace.WHICH))
    )


def least_norm(system: Array, target: Array, modes: NDArray[np.int64]) -> NDArray[Any]:
    """Return the solution of least norm, without forces that pull where none need to."""
    solution = np.linalg.lstsq(system, target, rcond=contact_forces.SINGULAR_STILL)[0]
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
        trial[kept] = np.linalg.lstsq(system[:, kept], target, rcond=contact_forces.SINGULAR_STILL)[0]
        if np.abs(system @ trial - target).max() > 1e-9 * np.abs(target).max():
            return solution


def _addresses(arrays: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    """Return (k, 4) addresses and shapes."""
    return np.array(
        [(array.__array_interface__["data"][0], *array.shape, *(1,) * (3 - array.ndim)) for array in arrays],
        dtype=np.int64,
    )
