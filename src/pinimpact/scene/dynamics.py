"""The dynamics of a scene between events: the workspace, and the calls of the kernels that integrate them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from .._compile.jit import compile_all
from ..arrays import Array, Integers
from ..contact_space.simultaneous import find_policy
from ..robot._kernels import contact_kinematics, responses, robot_impact, tree_matrices
from ..robot._kernels.python_calls import raise_kept_error
from ..robot.contact import Contact
from ..robot.joint_limits import JointLimit
from ..robot.pinocchio_bridge import Call, RobotDynamics, call_addresses
from ._kernels import (
    active_set,
    approach,
    constraint_drift,
    contact_modes,
    dense_output,
    drives,
    jamming,
    smooth_motion,
    step_dop853,
    step_radau,
)
from ._kernels.events import force_bound
from ._kernels.workspace import CALLS, SceneWorkspace
from .controls import ContinuousControl, Drives, JointPD, no_drives
from .dense_step import WORKS
from .islands import tree_masses
from .layout import SceneLayout
from .scene import Scene
from .step_memory import StepMemory

STIFF = 1e3
"""Decay rate of damped joints [1/s] above which steps may be implicit in the damping."""

CLOSABLE = 64
"""Initial capacity of the workspace: contacts that may be active at once, in addition to held ones."""


class FreeMotion(NamedTuple):
    """The motion of k contacts without contact forces.

    Attributes:
        joints: (nv,) v̇.
        jacobian: (k, 3, nv) contact Jacobians.
        velocity, acceleration: (k, 3) of the contacts [m/s, m/s²].
        surface: (k, 3) velocities of the surfaces [m/s].
        gap: (k,) gaps [m].
    """

    joints: Array
    jacobian: Array
    velocity: Array
    acceleration: Array
    surface: Array
    gap: Array


class SceneDynamics:
    """The smooth dynamics with the present contact modes, and the choice of these modes.

    Attributes:
        contacts: All contacts of the scene, held ones last.
        limits: The joint limits.
        work: The workspace of the kernels.
        step_memory: The part of its memory that describes a completed step.
        driven: Whether there are drives.
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
        self.contacts = [*contacts, *held]
        self.limits = tuple(limits)
        layout = scene.layout()
        robot = layout.dynamics_for(self, model)
        # kernels call these by address, so they must live as long as this object
        self._calls = [robot.forward_dynamics, robot.inverse_mass, robot.forward_kinematics]
        control = None
        motors = no_drives(model.nv)
        if scene.control is not None and scene.period is None and "control" not in without:
            if isinstance(scene.control, JointPD):
                motors = scene.control.drives(model)
            else:
                control = ContinuousControl(scene.control)
                self._calls.append(Call(control, ()))
        dry = np.array(scene.model.friction) * ("joint friction" not in without)
        damping = np.array(scene.model.damping) * ("joint damping" not in without)
        self.driven = len(motors.velocity) > 0
        stiff = self.driven or layout.rate_of_damping(damping) > STIFF
        rough = any(contact.sustained_friction != 0.0 for contact in self.contacts)
        alone = len(contacts) < 2
        _compile(rough, stiff, None if alone else scene.simultaneous)  # before anything else calls kernels
        self.work = self._workspace(layout, robot, model, motors, damping, dry, len(held))
        if control is not None:
            control.work = self.work
        self.work.stiff_joints = stiff
        self.work.force_margin = math.inf
        self.work.gravity = float(np.linalg.norm(model.gravity.linear))
        active_set.close_held(self.work)

    def _workspace(
        self,
        layout: SceneLayout,
        robot: RobotDynamics,
        model: pin.Model,
        motors: Drives,
        damping: Array,
        dry: Array,
        held: int,
    ) -> SceneWorkspace:
        """Return the workspace of the kernels, of which the last `held` contacts are bilateral."""
        contacts, limits, nv = self.contacts, self.limits, model.nv
        charts, tables = layout.joint_charts, layout.tables(tuple(contacts))
        self.step_memory = StepMemory(model.nq, nv)
        count, scalars = len(contacts), len(limits) + int(np.count_nonzero(dry))
        closable = min(count, held + CLOSABLE)
        calls = np.zeros(CALLS, dtype=np.int64)
        calls[: 2 * len(self._calls)] = call_addresses(self._calls)
        work = SceneWorkspace(
            {
                "nq": model.nq,
                "nv": nv,
                "bodies": model.njoints,
                "charts": len(charts),
                "rates": 2 * nv + WORKS,
                "contacts": count,
                "closable": closable,
                "blocks": len(tables.blocks),
                "spheres": len(tables.spheres),
                "limits": len(limits),
                "sources": count + len(limits) + nv,
                "scalars": scalars,
                "driven": len(motors.velocity),
                "rows": 3 * closable + scalars,
            },
            {
                "calls": calls,
                **self.step_memory.arrays(self.step_memory.values)._asdict(),
                "q": robot.q,
                "v": robot.v,
                "tau": robot.tau,
                "acceleration": robot.acceleration,
                "minverse": robot.minverse,
                "placements": robot.placements,
                "local_velocities": robot.local_velocities,
                "spatial_velocities": robot.velocities,
                "spatial_accelerations": robot.accelerations,
                "joint_jacobian": robot.joint_jacobian,
                "drive_velocity": motors.velocity,
                "drive_coordinate": motors.coordinate,
                "drive_stiffness": motors.stiffness,
                "drive_damping": motors.damping,
                "drive_reference": motors.reference,
                "drive_limit": motors.limit,
                "damping": damping,
                "dry_friction": dry,
                "joint_charts": charts,
                "joint_velocity": layout.chains[0],
                "velocity_parent": layout.chains[1],
                "velocity_joint": layout.velocity_joint,
                "joint_metres": layout.metres_per_unit,
                "tree_mass": tree_masses(model),
                "contact_blocks": tables.blocks,
                "sphere_constants": tables.spheres,
                "friction": tables.friction,
                "bilateral": (np.arange(count) >= count - held).astype(np.int64),
                "limit_q": np.array([limit.index_q for limit in limits], dtype=np.int64),
                "limit_v": np.array([limit.index_v for limit in limits], dtype=np.int64),
                "limit_sign": np.array([limit.sign for limit in limits], dtype=float),
                "limit_bound": np.array([limit.bound for limit in limits], dtype=float),
            },
        )
        work.contact_constants[:], work.contact_joints[:] = tables.constants, tables.joints
        return work

    # ---- calls from kernels

    def check(self) -> None:
        """Raise the error of a Python function that a kernel has called, if there is one."""
        if self.work.callback_failed:
            self.work.callback_failed = False
            raise_kept_error()

    # ---- copies

    def values(self) -> tuple[Any, ...]:
        """Return the values of the workspace, and of Pinocchio's arrays if they are used again."""
        work = self.work
        evaluated = (work.minverse.copy(), work.acceleration.copy()) if work.evaluated else None
        return work.values(), self.step_memory.values.copy(), evaluated

    def set_values(self, values: tuple[Any, ...]) -> None:
        """Restore the result of `values`."""
        of_workspace, of_step, evaluated = values
        self.work.set_values(of_workspace)
        self.step_memory.values[:] = of_step
        if evaluated is not None:
            self.work.minverse[:], self.work.acceleration[:] = evaluated

    # ---- active contacts

    def fastest_approach(
        self, q: Array, v: Array, starting: bool, parting: float, where: Integers, slow: Integers
    ) -> Any:
        """Return the contact or limit that approaches fastest, or −1, and its gap rate; see the kernel."""
        source, rate = approach.fastest_approach(self.work, q, v, starting, parting, where, slow)
        self.check()
        return source, rate

    def set_modes(self, t: float, q: Array, v: Array, slow: Integers) -> tuple[int, bool, float]:
        """Set the modes of the contacts, limits and joints at an instant. (theory.md, 11)

        Args:
            t: Time [s].
            q: (nq,) configuration.
            v: (nv,) velocity; it is overwritten with the one after active contacts have come to rest.
            slow: (n + nl,) nonzero where a contact or limit touches without bouncing, see `approach`.

        Returns:
            A contact with negative normal acceleration for which no force exists, or −1; whether the forces
            were found to the usual accuracy; the kinetic energy gained [J].
        """
        self.make_room(slow[: self.work.contacts])
        jammed, converged, energy = contact_modes.set_modes(self.work, t, q, v, slow)
        self.check()
        return jammed, converged, energy

    def slipping(self) -> tuple[Integers, Integers, Array]:
        """Return the present slip: `active_index`, `active_mode` and `sliding_friction` of the workspace."""
        work = self.work
        return work.active_index.copy(), work.active_mode.copy(), work.sliding_friction.copy()

    def slip_as(self, active: Integers, modes: Integers, sliding: Array) -> None:
        """Restore the slip that `slipping` has returned, from which the next modes are set."""
        work = self.work
        work.active_contacts = len(active)
        work.active_index[:], work.active_mode[:], work.sliding_friction[:] = active, modes, sliding

    def pushes(self, t: float, q: Array, v: Array, touching: Sequence[int]) -> Array:
        """Return the second rates (k,) of the gaps of contacts, then limits, without contact forces."""
        contacts = [i for i in touching if i < self.work.contacts]
        motion = self.free_motion_at(t, q, v, contacts)
        limits = [self.limits[i - self.work.contacts] for i in touching[len(contacts) :]]
        stops = [limit.sign * float(motion.joints[limit.index_v]) for limit in limits]
        return np.array([*motion.acceleration[:, 2].tolist(), *stops])

    def make_room(self, closing: Integers) -> None:
        """Enlarge the workspace if it has no room for all contacts where `closing` (n,) is nonzero."""
        work, count = self.work, int(np.count_nonzero(closing))
        if count > work.closable:
            closable = min(max(count, 2 * work.closable), work.contacts)
            work.enlarge({"closable": closable, "rows": 3 * closable + work.scalars})

    def hold_at(self, gaps: Array) -> None:
        """Set the gaps (n,) [m] that active contacts keep, and activate the held contacts."""
        self.work.rest_gap[:] = gaps
        active_set.close_held(self.work)

    def correct_constraint_drift(self, t: float, q: Array, v: Array) -> float:
        """Correct constraint drift of q (nq,) and v (nv,) in place; return the energy gained [J]. (12.1)"""
        energy = constraint_drift.correct_constraint_drift(self.work, t, q, v)
        self.check()
        return float(energy)

    def forces_unbounded(self, t: float, q: Array, v: Array, leaving: bool, singular: float) -> bool:
        """Return whether forces of slipping contacts grow without bound, see the kernel. (theory.md, 13.3)"""
        unbounded = jamming.forces_unbounded(self.work, t, q, v, leaving, singular)
        self.check()
        return bool(unbounded)

    @property
    def doubtful_margin(self) -> float:
        """Force margin [N] up to which, given the errors, the forces may violate their bounds."""
        return float(force_bound.doubtful_margin(self.work))

    @property
    def constrained(self) -> bool:
        """Whether any contact, joint limit or dry joint is active."""
        return self.work.active_contacts + self.work.active_scalars > 0

    def set_saturation(self, q: Array, v: Array) -> None:
        """Determine which drives are at their effort limits at a state."""
        if self.driven:
            drives.set_saturation(self.work, q, v)

    def change_side(self, index: int) -> None:
        """Set a drive to its effort limit, or release it from there; see `events.saturation.value`."""
        nv, sides = self.work.nv, self.work.drive_side
        upper, j = index < nv, index % nv
        sides[j] = 0 if sides[j] else (1 if upper else -1)

    # ---- steps

    def begin(self, t: float, q: Array, v: Array) -> float:
        """Begin a smooth motion; return the predicted duration of a bounce [s], see `smooth_motion.begin`."""
        bounce = smooth_motion.begin(self.work, t, q, v)
        self.check()
        return float(bounce)

    def first_length(self) -> float:
        """Return a conservative size for the first step of a smooth motion [s], from its accelerations."""
        work = self.work
        nv, rtol, atol = work.nv, work.rtol, work.atol
        rates = np.abs(work.stage_rates[0, nv : 2 * nv]) / (atol + rtol * np.maximum(1.0, np.abs(work.v0)))
        fastest = float(rates.max(initial=0.0)) * rtol
        return 0.01 / fastest if fastest > 0.0 else 0.01

    def fastest(self, v: Array) -> float:
        """Return the largest magnitude of velocities (nv,), in metres by (10.6) [m/s]."""
        return float(np.abs(self.work.joint_metres * v).max(initial=0.0))

    def error(self, v: Array) -> float:
        """Return the error η of a step in velocities (nv,) [m/s]. (theory.md, 11.5)"""
        return float(self.work.atol + self.work.rtol * self.fastest(v))

    # ---- states

    def gaps_at(self, q: Array, v: Array) -> Array:
        """Return (n + nl, 2) gap [m] and gap rate [m/s] of all contacts, then of the joint limits.

        The gap is infinite for contacts in a bounding sphere that is far from the surface.
        """
        found = np.empty((len(self.contacts) + len(self.limits), 2))
        smooth_motion.gaps_at(self.work, q, v, found)
        self.check()
        return found

    def free_motion_at(self, t: float, q: Array, v: Array, contacts: Sequence[int]) -> FreeMotion:
        """Return the motion of k contacts at a state without contact forces."""
        k, nv = len(contacts), self.work.nv
        velocity, acceleration, surface = np.empty((3, k, 3))
        found = FreeMotion(np.empty(nv), np.empty((k, 3, nv)), velocity, acceleration, surface, np.empty(k))
        smooth_motion.free_motion_at(self.work, t, q, v, np.array(contacts, dtype=np.int64), *found)
        self.check()
        return found


_compiled: set[tuple[bool, bool, str | None]] = set()


def _compile(rough: bool, stiff: bool, policy: str | None) -> None:
    """Compile or load the kernels that a scene is likely to call, so that no simulation waits for them later.

    Args:
        rough: Whether there is friction; then steps may be implicit in the directions of slip.
        stiff: Whether there are drives or strong damping; then steps may be implicit in these.
        policy: The policy for impacts at several contacts; None if no two contacts can touch at one instant.
    """
    if (rough, stiff, policy) in _compiled:
        return
    _compiled.add((rough, stiff, policy))
    kernels = [
        active_set.close_held,
        smooth_motion.gaps_at,
        smooth_motion.free_motion_at,
        approach.fastest_approach,
        contact_modes.set_modes,
        smooth_motion.begin,
        smooth_motion.modes_continue,
        smooth_motion.replace_force,
        force_bound.doubtful_margin,
        step_dop853.attempt,
        smooth_motion.explicit_step,
        smooth_motion.step_under,
        smooth_motion.finish,
        constraint_drift.correct_constraint_drift,
        jamming.forces_unbounded,
        dense_output.state,
        dense_output.interpolate,
        robot_impact.robot_impact,
        contact_kinematics.locate,
        contact_kinematics.jacobian,
        tree_matrices.evaluate_tree,
        responses.half_solve,
        responses.respond,
    ]
    if policy:
        kernels += [responses.taking_part, *find_policy(policy).kernels()]
    if rough or stiff:
        kernels.append(step_radau.attempt)
    if stiff:
        kernels.append(drives.set_saturation)
    compile_all(*((kernel,) for kernel in kernels))
