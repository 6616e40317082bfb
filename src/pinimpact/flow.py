"""The smooth flow of a scene between events, and what the guards look at."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ._kernels import sustained, touch
from ._kernels.sustained import FREE, HELD, SLIP, STICK
from .contacts import Contact
from .errors import SimulationError
from .lookup import frame_id
from .scene import Scene
from .surfaces import contact_axes

Array = NDArray[np.float64]

_WORLD = pin.Convention.WORLD
MODES = {FREE: "free", SLIP: "slip", STICK: "stick", HELD: "held"}
"""Names of the modes of a contact."""

LEAST_EFFECTIVE = 1e-9
"""Effective inverse inertia of a slipping contact, over that without friction, that counts as none."""


class ContactPoint:
    """A contact bound to a data: where its numbers stand there, and the kernels applied to them."""

    def __init__(self, model: pin.Model, data: pin.Data, contact: Contact) -> None:
        self.contact = contact
        self.name = contact.label
        frame = model.frames[frame_id(model, contact.frame)]
        plane = contact.plane
        tip, base = frame.parentJoint, 0
        carrier = pin.SE3.Identity()
        if plane.body is not None:
            body = model.frames[frame_id(model, plane.body, "body")]
            base, carrier = body.parentJoint, body.placement
        R = carrier.rotation
        self.constants = np.concatenate(
            [
                frame.placement.act(np.array(contact.offset)),
                [contact.radius],
                carrier.act(np.array(plane.point)),
                (contact_axes(plane.normal) @ R.T).ravel(),
                R @ plane.velocity,
                R @ plane.angular_velocity,
            ]
        )
        self.weights = np.zeros(model.nv)
        self._group = np.repeat(np.arange(model.njoints), np.array(model.nvs))
        for joint, weight in ((tip, 1.0), (base, -1.0)):
            for support in list(model.supports[joint])[1:]:
                i = model.idx_vs[support]
                self.weights[i : i + model.nvs[support]] += weight
        # views into the data, which pin.aba keeps up to date
        self._tip = (data.oMi[tip].rotation, data.oMi[tip].translation, data.ov[tip].vector)
        self._base = (data.oMi[base].rotation, data.oMi[base].translation, data.ov[base].vector)
        self._accelerations = (data.oa_gf[tip].vector, data.oa_gf[base].vector)
        self._jacobian = data.J.reshape(6, model.nv)
        self._data = data

    def gap_and_rate(self) -> tuple[float, float]:
        """Return the gap [m] and its rate [m/s] at the state last evaluated."""
        return touch.gap_and_rate(*self._tip, *self._base, self.constants)

    def curvature(self, peak: Array, h: float) -> tuple[float, float]:
        """Return bounds of |d²gap/dt²| over a step and of its variation, with half as much for safety."""
        R, t, _ = self._tip
        size, change = touch.curvature(
            self._jacobian, self.weights, self._group, R, t, self.constants, peak, h
        )
        return 1.5 * size, 1.5 * change

    def normal_acceleration(self) -> float:
        """Return d²gap/dt² at the state last evaluated, without contact forces [m/s²]."""
        rows, three = np.empty((3, len(self.weights))), np.empty((3, 3))
        self.motion(rows, three[0], three[1], three[2])
        return float(three[1, 2])

    def motion(self, rows: Array, velocity: Array, acceleration: Array, surface: Array) -> float:
        """Fill what a closed contact needs, see `touch.contact_motion`; return the gap [m]."""
        R, t, V = self._tip
        S, s, U = self._base
        A, B = self._accelerations
        return touch.contact_motion(
            R,
            t,
            V,
            A,
            S,
            s,
            U,
            B,
            self.constants,
            self._jacobian,
            self.weights,
            rows,
            velocity,
            acceleration,
            surface,
        )


class Active:
    """The numbers of some contacts and scalar rows at one state, in arrays of their own.

    Attributes:
        points: The contacts.
        scalars: (ns,) velocity index of each scalar row.
        rows: (nc, 3, nv); velocity, acceleration, surface: (nc, 3); gap: list of nc.
    """

    def __init__(self, points: list[ContactPoint], scalars: list[int], nv: int) -> None:
        count = len(points)
        self.points = points
        self.scalars = np.array(scalars, dtype=np.int64)
        self.rows = np.zeros((count, 3, nv))
        self.velocity = np.zeros((count, 3))
        self.acceleration = np.zeros((count, 3))
        self.surface = np.zeros((count, 3))
        self.gap = [0.0] * count
        self._views = [
            (point, self.rows[i], self.velocity[i], self.acceleration[i], self.surface[i])
            for i, point in enumerate(points)
        ]

    def measure(self) -> None:
        """Take the numbers from the data, at the state last evaluated without contact forces."""
        for i, (point, rows, velocity, acceleration, surface) in enumerate(self._views):
            self.gap[i] = point.motion(rows, velocity, acceleration, surface)

    def stacked(self) -> Array:
        """Return the (3 nc + ns, nv) rows of all."""
        nv = self.rows.shape[2]
        unit = np.zeros((len(self.scalars), nv))
        unit[np.arange(len(self.scalars)), self.scalars] = 1.0
        return np.vstack([self.rows.reshape(-1, nv), unit])


class Flow:
    """v̇ and the powers at a state, with the contacts that are closed in their present modes.

    Attributes:
        points: All contacts of the scene, held ones last.
        mode: Mode of each.
        active: The closed contacts, limits and stuck joints.
        force: (nc, 3) forces of the closed contacts in contact axes at the state last evaluated [N].
        scalar_force: (ns,) forces at limits and in stuck joints.
        unique: Whether the motion determines these forces; otherwise they are those of least norm.
        dry, sliding: (nv,) dry friction of the joints, and with its sign where a joint slides (else zero).
        still: Speed [m/s] below which the direction of slip is the one remembered.
        allowance: Force [N] by which Coulomb's law may seem violated through rounding.
        margin: By how much the forces keep to Coulomb's law; negative, the modes do not hold.
        least_margin: The least since it was last set to infinity.
    """

    def __init__(self, scene: Scene, model: pin.Model, contacts: list[Contact], held: list[Contact]) -> None:
        without = scene.without
        self.model = model
        self.data = model.createData()
        self.nv = model.nv
        pin.aba(model, self.data, pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv), _WORLD)
        self.points = [ContactPoint(model, self.data, contact) for contact in (*contacts, *held)]
        self.control = None if "control" in without else scene.control
        damping = scene.joint_damping
        self.damping = damping * ("joint damping" not in without)
        self.dry = scene.joint_friction * ("joint friction" not in without)
        self.sliding = np.zeros(model.nv)
        self.idle = np.zeros(model.nv)
        self._tau = np.zeros(model.nv)
        self._powers = np.zeros(2)
        self.still = 0.0
        self.allowance = 0.0
        self.margin = self.least_margin = math.inf
        self.driven = self.control is not None or bool(self.damping.any() or self.dry.any())
        self.set_modes([HELD if i >= len(contacts) else FREE for i in range(len(self.points))], {}, [], [])

    def set_modes(
        self,
        mode: list[int],
        reference: dict[int, Array],
        scalars: list[int],
        scalar_bounds: list[tuple[float, float]],
    ) -> None:
        """Close the contacts whose mode is not `FREE`, and the scalar rows given, within their bounds."""
        self.mode = mode
        self.closed = [i for i, m in enumerate(mode) if m != FREE]
        self.active = Active([self.points[i] for i in self.closed], scalars, self.nv)
        count = len(self.closed)
        self.modes = np.array([mode[i] for i in self.closed], dtype=np.int64)
        self.mu = np.array([self.points[i].contact.friction for i in self.closed])
        self.reference = np.array([reference.get(i, (1.0, 0.0)) for i in self.closed]).reshape(count, 2)
        self.lower = np.array([lower for lower, _ in scalar_bounds])
        self.upper = np.array([upper for _, upper in scalar_bounds])
        self.force = np.zeros((count, 3))
        self.scalar_force = np.zeros(len(scalars))
        size = sum(1 if m == SLIP else 3 for m in self.modes) + len(scalars)
        self._directions = np.zeros((count, 2))
        self._rows = np.zeros((size, self.nv))
        self._response = np.zeros((size, self.nv))
        self._solution = np.zeros(size)
        self.unique = True
        self.constrained = bool(count or scalars)

    def applied(self, t: float, q: Array, v: Array, powers: Array) -> Array:
        """Return the generalized forces of control, damping and sliding dry friction; fill their powers."""
        if not self.driven:
            return self.idle
        control = self.idle if self.control is None else self.ask_control(t, q, v)
        sustained.joint_forces(v, control, self.damping, self.sliding, self._tau, powers)
        return self._tau

    def ask_control(self, t: float, q: Array, v: Array) -> Array:
        """Return the control's forces, checked."""
        assert self.control is not None
        tau = np.asarray(self.control(t, q.copy(), v.copy()), dtype=float)
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
        return tau

    def open(self, t: float, q: Array, v: Array) -> Array:
        """Evaluate without contact forces: return v̇ and leave the kinematics in the data."""
        return pin.aba(self.model, self.data, q, v, self.applied(t, q, v, self._powers), _WORLD)

    def inverse(self) -> Array:
        """Return M⁻¹ at the state last evaluated; the array is the data's own."""
        return pin.computeMinverse(self.model, self.data).reshape(self.nv, self.nv)

    def __call__(self, t: float, q: Array, v: Array, out: Array) -> None:
        """Fill `out` with v̇ and the powers of control, joints, sliding friction and surfaces."""
        nv = self.nv
        tau = self.applied(t, q, v, out[nv:]) if self.driven else self.idle
        out[:nv] = pin.aba(self.model, self.data, q, v, tau, _WORLD)
        if self.constrained:
            self._constrain(out[:nv], out[nv + 2 :])

    def _constrain(self, acceleration: Array, powers: Array) -> None:
        """Add what the closed contacts do."""
        active = self.active
        active.measure()
        system, target, effective = sustained.assemble(
            self.inverse(),
            acceleration,
            active.rows,
            active.acceleration,
            active.velocity,
            self.modes,
            self.mu,
            self.reference,
            self.still,
            active.scalars,
            self._directions,
            self._rows,
            self._response,
        )
        self.unique = sustained.solve(system, target, self._solution)
        if not self.unique:
            self._solution[:] = least_norm(system, target, self.modes)
        self.margin = self.allowance + sustained.finish(
            self._solution,
            self._response,
            self._directions,
            active.velocity,
            active.surface,
            self.modes,
            self.mu,
            self.lower,
            self.upper,
            acceleration,
            self.force,
            self.scalar_force,
            powers,
        )
        if effective <= LEAST_EFFECTIVE:
            self.margin = -math.inf
        self.least_margin = min(self.least_margin, self.margin)


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
