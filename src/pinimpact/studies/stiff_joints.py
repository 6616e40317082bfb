"""Impacts of a robot as functions of the stiffening of its joints. (docs/theory.md, 1)"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..arrays import Array, Integers
from ..errors import InputError
from ..robot.matrices import ContactMatrices
from ..robot.names import mobilities, single_joints
from ..scene.scene import Scene
from .estimate import general_first


class StiffJoints(NamedTuple):
    """The matrices of N impacts, and the parameter of each joint's stiffening."""

    mass: Array  # (N, nv, nv) M
    jacobian: Array  # (N, 3, nv) J
    root: Array  # (N, m, nv) whitens residuals of velocities
    owner: Integers  # (nv,) index of the parameter of each velocity, −1 where it is free or locked
    mobility: Array  # (nv,) of the velocities without parameter: 1 free, 0 locked

    def matrices(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return W (N, 3, 3), the map (N, m, 3) from P to residuals, and their slopes by parameter (p, …).

        (1.7) and (1.8)
        """
        owned = self.owner >= 0
        d = np.where(owned, np.sqrt(1.0 - x[self.owner]), self.mobility)
        scaled = self.mass * np.outer(d, d)
        diagonal = np.arange(len(d))
        inertia = self.mass[:, diagonal, diagonal]
        scaled[:, diagonal, diagonal] = np.where(d > 0.0, inertia, 1.0)
        inverse = np.linalg.inv(scaled) * np.outer(d, d)  # (M + K)⁻¹
        response = inverse @ np.swapaxes(self.jacobian, 1, 2)
        rates = np.where(owned, inertia / np.where(owned, d, 1.0) ** 4, 0.0)  # ∂k/∂s
        W_slopes, map_slopes = [], []
        for p in range(len(x)):
            weighed = -(rates * (self.owner == p))[:, :, None] * response
            W_slopes.append(np.swapaxes(response, 1, 2) @ weighed)
            map_slopes.append(self.root @ (inverse @ weighed))
        return self.jacobian @ response, self.root @ response, np.array(W_slopes), np.array(map_slopes)


def stiff_joints(
    names: Sequence[str], scene: Scene, of_impacts: Sequence[ContactMatrices], root: Array
) -> StiffJoints:
    """Return the stiff joints of impacts, by parameters "stiffening", of all joints, or "stiffening:elbow".

    root (N, m, nv) whitens residuals of velocities. Raises `InputError` for held contacts, or without joints
    to stiffen.
    """
    if scene.held:
        raise InputError(
            "free: the stiffening of joints cannot be fitted with held contacts; give a scene without",
            value=list(names),
        )
    joints = single_joints(scene.model)
    if not joints:
        raise InputError(
            "free: no joint of the robot has one velocity, so that none can be stiffened", value=list(names)
        )
    owner = np.full(scene.model.nv, -1)
    for p in general_first(names):
        label = names[p].partition(":")[2]
        owner[[joints[label]] if label else list(joints.values())] = p
    mobility = mobilities(scene.model, scene.locked)
    owner[mobility == 0.0] = -1
    mass, jacobian = (np.array([getattr(one, name) for one in of_impacts]) for name in ("mass", "jacobian"))
    return StiffJoints(mass, jacobian, root, owner, mobility)
