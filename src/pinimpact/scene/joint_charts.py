"""The configuration space of a model as a table of joints, for kernels that do not call Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..arrays import Array, Integers
from ..errors import ModelError
from ._kernels.lie_charts import CIRCLE, PLANAR, RIGID, ROTATION, VECTOR, advance, turn_axes


def joint_table(model: pin.Model) -> Integers:
    """Return the (k, 4) table described in `lie_charts`; consecutive vector coordinates share a row.

    Raises:
        ModelError: A joint whose configuration space is not supported (a composite of curved joints, a mimic
            joint).
    """
    rows: list[list[int]] = []
    for joint, name in zip(list(model.joints)[1:], list(model.names)[1:], strict=True):
        nq, nv, i, j = joint.nq, joint.nv, joint.idx_q, joint.idx_v
        kind_name = joint.shortname()
        if nq == nv and "Mimic" not in kind_name:
            if rows and rows[-1][0] == VECTOR and rows[-1][1] + rows[-1][3] == i:
                rows[-1][3] += nv
            else:
                rows.append([VECTOR, i, j, nv])
        elif (nq, nv) == (2, 1):
            rows.append([CIRCLE, i, j, nv])
        elif (nq, nv) == (7, 6):
            rows.append([RIGID, i, j, nv])
        elif (nq, nv) == (4, 3) and kind_name in ("JointModelPlanar", "JointModelSpherical"):
            rows.append([PLANAR if kind_name == "JointModelPlanar" else ROTATION, i, j, nv])
        else:
            raise ModelError(
                f"model: joint {name!r} is a {kind_name} with {nq} coordinates and {nv} velocities, which a "
                "simulation cannot integrate; build the model from its simple joints",
                value=name,
            )
    return np.array(rows, dtype=np.int64).reshape(-1, 4)


def coordinate_rates(table: Integers, q: Array, nv: int) -> Array:
    """Return ∂(q ⊕ δ)/∂δ (nq, nv) at δ = 0; its columns are orthogonal."""
    rates = np.zeros((len(q), nv))
    for kind, i, j, n in table.tolist():
        if kind == VECTOR:
            rates[i : i + n, j : j + n] = np.eye(n)
        elif kind in (CIRCLE, PLANAR):
            c, s = q[i + n - 1 : i + n + 1]
            rates[i + n - 1 : i + n + 1, j + n - 1] = -s, c
            if kind == PLANAR:
                rates[i : i + 2, j : j + 2] = (c, -s), (s, c)
        else:
            x, y, z, w = q[i + n - 3 : i + n + 1]
            turning = (w, -z, y), (z, w, -x), (-y, x, w), (-x, -y, -z)
            rates[i + n - 3 : i + n + 1, j + n - 3 : j + n] = 0.5 * np.array(turning)
            if kind == RIGID:
                rates[i : i + 3, j : j + 3] = pin.Quaternion(w, x, y, z).matrix()
    return rates


def displaced(table: Integers, q: Array, v: Array, displacement: Array) -> tuple[Array, Array]:
    """Return q ⊕ ξ (nq,) for a displacement ξ (nv,), and v (nv,) in the axes that free bodies have there."""
    end, turned = np.empty(len(q)), np.empty(len(v))
    advance(table, q, displacement, end)
    turn_axes(table, displacement, v, turned)
    return end, turned


def turning(frames: list[list[int]], v: Array) -> tuple[Array, Array]:
    """Return ω × v (nv,) of free bodies, see `add_turning`, and its derivative by v (nv, nv).

    Args:
        frames: Rows of the table of free bodies (`RIGID`, `PLANAR`).
        v: (nv,) velocity.
    """
    turned, by_v = np.zeros(len(v)), np.zeros((len(v), len(v)))
    for kind, _, j, _ in frames:
        if kind == RIGID:
            axes, a = slice(j, j + 3), slice(j + 3, j + 6)
            across = pin.skew(v[a])
            by_v[axes, a] = -pin.skew(v[axes])
        else:
            axes, a = slice(j, j + 2), slice(j + 2, j + 3)
            across = np.array([[0.0, -v[j + 2]], [v[j + 2], 0.0]])
            by_v[axes, a] = [[-v[j + 1]], [v[j]]]
        by_v[axes, axes] = across
        turned[axes] = across @ v[axes]
    return turned, by_v


def turned_axes(
    frames: list[list[int]], turn: Array, v: Array, by_turn: Array, by_v: Array
) -> tuple[Array, Array]:
    """Rotate the axes of free bodies' velocities; return v (nv,) and its changes (nv, n).

    Args:
        frames: Rows of the table of free bodies (`RIGID`, `PLANAR`).
        turn: (nv,) displacement with the rotations [rad].
        v: (nv,) velocity.
        by_turn: (nv, n) changes of the displacement.
        by_v: (nv, n) changes of the velocity.
    """
    v, by_v = v.copy(), by_v.copy()
    for kind, _, j, _ in frames:
        if kind == RIGID:
            axes, a = slice(j, j + 3), slice(j + 3, j + 6)
            rotation = pin.exp3(turn[a]).T
            v[axes] = rotation @ v[axes]
            bent = pin.skew(v[axes]) @ pin.Jexp3(turn[a])
        else:
            axes, a = slice(j, j + 2), slice(j + 2, j + 3)
            c, s = np.cos(turn[j + 2]), np.sin(turn[j + 2])
            rotation = np.array([[c, s], [-s, c]])
            v[axes] = rotation @ v[axes]
            bent = np.array([[v[j + 1]], [-v[j]]])
        by_v[axes] = rotation @ by_v[axes] + bent @ by_turn[a]
    return v, by_v
