"""Balls that roll from a face over an edge, or from an edge over its end. (docs/derivatives.md, 9)"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ..arrays import Array
from ..geometry._kernels import constants as layout
from ..geometry._kernels.constants import KIND, LINE, PLANE, SPHERE
from ..robot.contact import Contact, contact_constants
from ..robot.forest import joint_jacobian
from ..robot.names import motion_signs
from ..robot.shape_pair import ShapePair, closest_points
from .dense_step import DenseStep


def rolls_over(
    contacts: Sequence[Contact],
    pairs: Mapping[Contact, ShapePair],
    model: pin.Model,
    data: Any,
    before: DenseStep,
    after: DenseStep,
) -> Array | None:
    """Return ∂g/∂q (nv,) of the guard g of a ball that rolls over an edge or its end between steps, or None.

    Up to a factor, g is the distance of the ball beyond the edge e of a face along n × e, or beyond the end
    of an edge along e. The ball may separate there.

    Args:
        contacts: All contacts of the scene.
        pairs: The shapes of the contacts between shapes.
        model: The model.
        data: Its data.
        before: The step that ends where the ball rolls over.
        after: The next step.
    """
    one, other = before.closed, after.closed
    if one is None:
        return None
    later = np.zeros_like(one.modes) if other is None else other.modes
    closed, changed = np.flatnonzero(one.modes[: len(contacts)]), np.flatnonzero(one.modes != later)
    if len(changed) == 0 and other is not None:
        apart = [*range(layout.AXES), *range(KIND, layout.CONSTANTS)]
        rows = np.flatnonzero((one.constants != other.constants)[:, apart].any(axis=1)).tolist()
        features = [(other.constants[k], other.joints[k]) for k in rows]
    else:
        rows = [k for k, i in enumerate(closed.tolist()) if changed.tolist() == [i] and later[i] == 0]
        features = []
        for k, pair in ((k, contacts[closed[k]].pair) for k in rows):
            places = [] if pair is None else closest_points(model, data, after.q, pairs[pair])
            found = [point.lasting for point in places[0]] if len(places) == 1 else []
            every = [contact_constants(model, contact) for contact in found if contact is not None]
            kind = one.constants[k, KIND]
            features += [(c, np.array([tip, base])) for tip, base, c in every if c[KIND] != kind]
    if len(rows) != 1 or len(features) != 1:
        return None
    return _guard(model, data, after.q, [(one.constants[rows[0]], one.joints[rows[0]]), features[0]])


def _guard(model: pin.Model, data: Any, q: Array, sides: list[tuple[Array, Array]]) -> Array | None:
    """Return ∂g/∂q (nv,) from the constants and joints of the contacts on an edge and on its face or end."""
    (line, joints), (beside, joints_beside) = sorted(sides, key=lambda side: side[0][KIND] != LINE)
    along, flat = line[layout.LINE_AXIS : layout.CONSTANTS], beside[KIND] == PLANE
    known = np.array_equal(joints, joints_beside) if flat else beside[KIND] == SPHERE
    if line[KIND] != LINE or not known:
        return None
    if flat:
        along = np.cross(beside[layout.AXES + 6 : layout.VELOCITY], along)
    tip, base = joints.tolist()
    moves = joint_jacobian(model, data, q)
    centre, along = data.oMi[tip].act(line[layout.TIP : layout.RADIUS]), data.oMi[base].rotation @ along
    rows = along @ moves[:3] + np.cross(centre, along) @ moves[3:]
    return np.asarray(motion_signs(model, tip, base) * rows)
