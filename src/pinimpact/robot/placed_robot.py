"""A robot at a configuration, and position, axes and Jacobian of its contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import Array
from ..display import in_a_line
from ._kernels import contact_kinematics
from .data_cache import checked_configuration, data_cache
from .forest import forward_kinematics, frame_placement, joint_jacobian, mass_matrix
from .names import model_of
from .pinocchio_bridge import refuse

WORLD = np.eye(4)
"""Placement of surfaces that are attached to no body."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ContactGeometry:
    """Position, axes and Jacobian of a contact.

    Attributes:
        point: (3,) contact point in world axes [m].
        gap: Signed distance of the point from the surface [m].
        axes: (3, 3) contact axes t₁, t₂, n as rows, in world axes.
        K: (nv, 2) tangential columns of Jᵀ.
        h: (nv,) normal column of Jᵀ.
        surface_velocity: (3,) velocity of the surface relative to its body, at the contact point, in contact
            axes [m/s].
    """

    point: Array
    gap: float
    axes: Array
    K: Array
    h: Array
    surface_velocity: Array

    def __repr__(self) -> str:
        return f"ContactGeometry(point={in_a_line(self.point)}, gap={self.gap:.6g})"

    @property
    def jacobian(self) -> Array:
        """(3, nv) J = [K h]ᵀ: velocity of the point relative to the surface's carrier, in contact axes."""
        return np.column_stack([self.K, self.h]).T

    def velocity(self, v: ArrayLike) -> Array:
        """Return the (3,) contact velocity J q̇ − v_surface in contact axes [m/s]."""
        return self.jacobian @ np.asarray(v, dtype=np.float64) - self.surface_velocity

    def velocity_scale(self, v: ArrayLike) -> float:
        """Return the size of the terms that `velocity` is the sum of, Σ|J||q̇| + |v_surface| [m/s]."""
        moving = np.abs(self.jacobian) @ np.abs(np.asarray(v, dtype=np.float64))
        return float(np.sum(moving + np.abs(self.surface_velocity)))


class PlacedRobot:
    """A robot at q (nq,); its Data, or `Forest`, contain the placements until they are used for another one.

    `cache` has data that do not change between calls. Raises `InputError` for an invalid q, or data of
    another model.
    """

    def __init__(self, robot: Any, data: Any, q: ArrayLike) -> None:
        self.model, self.data = model_of(robot), data
        self.cache = data_cache(self.model, data)
        self.q = checked_configuration(self.cache, self.model, q)
        self._jacobian: Array | None = None
        self._placements: dict[tuple[int, int], tuple[Array, Array]] = {}
        forward_kinematics(self.model, data, self.q)

    def mass_matrix(self) -> Array:
        """Return M (nv, nv)."""
        self._check()
        return mass_matrix(self.model, self.data, self.q)

    def placements(self, contact: Any) -> tuple[Array, Array]:
        """Return the (4, 4) placements of a contact's frame and of the frame of its surface."""
        frame, carrier, _ = self.cache.contact(contact.frame, contact.plane.body)
        known = self._placements.get((frame, carrier))
        if known is None:
            at = frame_placement(self.model, self.data, frame).homogeneous
            on = frame_placement(self.model, self.data, carrier).homogeneous if carrier else WORLD
            self._placements[frame, carrier] = known = at, on
        return known

    def columns(self, contact: Any) -> tuple[Array, Array]:
        """Return the joint Jacobian (6, nv) and signs (nv,) of `contact_kinematics.jacobian`.

        Mimic joints are summed: each column is then that of the frame minus that of the carrier.
        """
        self._check()
        frame, carrier, signs = self.cache.contact(contact.frame, contact.plane.body)
        if self.cache.mimics:
            return self._summed(frame, carrier), signs
        if self._jacobian is None:
            self._jacobian = joint_jacobian(self.model, self.data, self.q)
        return self._jacobian, signs

    def locate(self, contact: Any) -> tuple[float, Array, Array]:
        """Return a contact's gap [m], normal (3,) and point (3,), in world axes."""
        gap, *rest = contact_kinematics.locate(*self.placements(contact), contact.constants)
        return gap, np.array(rest[:3]), np.array(rest[3:])

    def fill_jacobian(self, contact: Any, rows: Array, on_surface: bool = False) -> Array:
        """Fill a contact's Jacobian (3, nv); return its axes (9) and the surface's velocity (3) in them.

        `on_surface` takes the point of the surface below the tip, see `contact_kinematics.jacobian`.
        """
        numbers = contact_kinematics.jacobian(
            *self.placements(contact), *self.columns(contact), contact.constants, on_surface, rows
        )
        return np.array(numbers)

    def geometry(self, contact: Any) -> ContactGeometry:
        """Return position, axes and Jacobian of a contact."""
        rows = np.empty((3, self.cache.nv))
        numbers = self.fill_jacobian(contact, rows)
        gap, _, point = self.locate(contact)
        return ContactGeometry(point, gap, numbers[:9].reshape(3, 3), rows[:2].T, rows[2], numbers[9:])

    def _check(self) -> None:
        if self.cache.flaw is not None:
            refuse(self.model)

    def _summed(self, frame: int, carrier: int) -> Array:
        columns = np.zeros((6, self.model.nv), order="F")
        for sign, k in ((1.0, frame), (-1.0, carrier)):
            if k > 0:
                found = pin.computeFrameJacobian(self.model, self.data, self.q, k, pin.LOCAL_WORLD_ALIGNED)
                rows = found.reshape(columns.shape)  # of one column it is a vector
                rows[:3] -= np.cross(rows[3:], self.data.oMf[k].translation, axisa=0, axisc=0)
                columns += sign * rows
        return columns
