"""Metres per unit of each velocity: how far the joint moves the mass that it carries. (10.6)"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..arrays import Array


def gyration(model: pin.Model) -> Array:
    """Return the root mean square distance ϱ (nv,) of the moved mass from each axis [m]. (10.6)

    For a joint's own body this is its radius of gyration. Bodies beyond further joints count at the largest
    distance that these joints allow, at zero sliding travel. Zero if no moved body has mass.
    """
    result = np.zeros(model.nv)
    axes = _subspaces(model)[:, 3:]
    mass, first, second = np.zeros((3, model.njoints))  # ∫dm, ∫l dm, ∫l² dm; l: distance from the joint
    squares = np.zeros(model.nv)  # ∫d² dm, with d the distance from the axis
    for joint in range(model.njoints - 1, 0, -1):
        inertia, velocities = model.inertias[joint], _velocities(model, joint)
        moments = inertia.matrix()[3:, 3:]
        squares[velocities] += np.einsum("ij,jk,ik->i", axes[velocities], moments, axes[velocities])
        way = float(np.linalg.norm(inertia.lever))
        mass[joint] += inertia.mass
        first[joint] += way * inertia.mass
        second[joint] += 0.5 * float(np.trace(moments))
        if mass[joint] > 0.0:
            result[velocities] = np.sqrt(np.maximum(squares[velocities], 0.0) / mass[joint])
        parent = model.parents[joint]
        if parent == 0:
            continue
        offset = model.jointPlacements[joint].translation
        link = float(np.linalg.norm(offset))
        moving = _velocities(model, parent)
        away = np.linalg.norm(np.cross(axes[moving], offset), axis=1)
        squares[moving] += second[joint] + away * (2.0 * first[joint] + away * mass[joint])
        mass[parent] += mass[joint]
        second[parent] += second[joint] + link * (2.0 * first[joint] + link * mass[joint])
        first[parent] += first[joint] + link * mass[joint]
    return result


def metres_per_unit(model: pin.Model, radii: Array, extent: float) -> Array:
    """Return κ (nv,) of (10.6), the speed [m/s] per unit of each velocity; 1 for sliding joints.

    Args:
        model: The model.
        radii: (nv,) ϱ of `gyration` [m].
        extent: Size of the robot [m], which replaces zero radii.
    """
    found = _subspaces(model)
    slides, turns = np.linalg.norm(found[:, :3], axis=1), np.linalg.norm(found[:, 3:], axis=1)
    return np.hypot(slides, turns * np.where(radii > 0.0, radii, extent))


def _velocities(model: pin.Model, joint: int) -> slice:
    return slice(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint])


def _subspaces(model: pin.Model) -> Array:
    """Return the spatial velocity (nv, 6) per unit of each velocity, in joint axes, at the neutral q."""
    neutral, result = pin.neutral(model), np.zeros((model.nv, 6))
    for joint in range(1, model.njoints):
        data = model.joints[joint].createData()
        model.joints[joint].calc(data, neutral)
        result[_velocities(model, joint)] = np.reshape(data.S, (6, -1)).T
    return result
