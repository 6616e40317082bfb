"""Contact patches of pairs of boxes in time steps, as contacts at their corners. (theory.md, 16)"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..._compile.declared import (
    FLAGS,
    FLOAT_ROWS,
    FLOATS,
    INTEGER_ROWS,
    INTEGERS,
    FloatRows,
    Floats,
    FloatStack,
    IntegerRows,
    Integers,
    declared,
)
from ..._compile.jit import inlined, jit
from ..._numeric.loops import assign, filled
from ...geometry._kernels import constants as layout
from ...geometry._kernels.box_patch import MOST, box_patch, undecided
from ...geometry._kernels.contact_axes import contact_axes
from ...robot._kernels.placement import place, rotate, rotate_back
from .dynamics import compute_kinematics, set_state
from .workspace import SceneWorkspace

HALF, REACH, BOX = 12, 15, 16
"""Columns of a box after its placement (12) in joint axes: three half edges, then its radius about the centre
[m]; number of columns."""


@declared(FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, int, FLOAT_ROWS, float, float)
@jit
def fill_contact(row, tip, base, normal, point, other, kind, edges, radius, size):
    """Fill the constants of a contact from its present points in world axes.

    Args:
        row: (constants,) is overwritten.
        tip, base: (12,) placements of the two joints.
        normal: (3,) unit normal from the second shape to the first.
        point, other: (3,) contact points on the first and second shape [m].
        kind: Code of the features in contact, see `box_patch`.
        edges: (2, 3) directions of edges in contact.
        radius, size: Radii around the cores of the two shapes [m].
    """
    filled(row, 0.0)
    r = row[layout.RADIUS] = 0.0 if kind == layout.TIP_PLANE else radius
    s = row[layout.SIZE] = 0.0 if kind == layout.PLANE else size
    n1, n2, n3 = normal
    put(
        row,
        layout.TIP,
        rotate_back(
            tip, point[0] + r * n1 - tip[9], point[1] + r * n2 - tip[10], point[2] + r * n3 - tip[11]
        ),
    )
    put(
        row,
        layout.POINT,
        rotate_back(
            base, other[0] - s * n1 - base[9], other[1] - s * n2 - base[10], other[2] - s * n3 - base[11]
        ),
    )
    n1, n2, n3 = rotate_back(base, normal[0], normal[1], normal[2])
    axes = contact_axes(n1, n2, n3)
    for e in range(6):
        row[layout.AXES + e] = axes[e]
    put(row, layout.AXES + 6, (n1, n2, n3))
    row[layout.KIND] = kind
    if kind == layout.TIP_PLANE:
        put(row, layout.RIM_AXIS, rotate_back(tip, normal[0], normal[1], normal[2]))
    elif kind != layout.PLANE:
        put(row, layout.RIM_AXIS, rotate_back(tip, edges[0, 0], edges[0, 1], edges[0, 2]))
        put(row, layout.LINE_AXIS, rotate_back(base, edges[1, 0], edges[1, 1], edges[1, 2]))


@inlined
def put(row, k, vector):
    """Copy a vector (3,) to row[k : k + 3]."""
    row[k], row[k + 1], row[k + 2] = vector


@inlined
def place_boxes(work, joints, boxes, placed, speeds):
    """Fill the placements (k, 12) of boxes and bounds of the speeds (k,) of their points [m/s]."""
    for k in range(len(boxes)):
        pose, motion, box = work.placements[joints[k]], work.local_velocities[joints[k]], boxes[k]
        for axis in range(3):
            put(placed[k], 3 * axis, rotate(pose, box[3 * axis], box[3 * axis + 1], box[3 * axis + 2]))
        put(placed[k], 9, place(pose, box, 9))
        arm = math.sqrt(box[9] ** 2 + box[10] ** 2 + box[11] ** 2) + box[REACH]
        speeds[k] = math.sqrt(motion[0] ** 2 + motion[1] ** 2 + motion[2] ** 2) + arm * math.sqrt(
            motion[3] ** 2 + motion[4] ** 2 + motion[5] ** 2
        )


class FacingBoxes(NamedTuple):
    """Patches of pairs of boxes, see `box_patch`.

    Attributes:
        used: (p,) number of contacts in use as corners.
        normals: (p, 3) from the second box to the first.
        points, others: (p, `MOST`, 3) corners on the first and on the second box [m].
        kinds: (p, `MOST`) codes of the features in contact.
        edges: (p, 2, 3) directions of the edges in contact.
        within: (p,) distance up to which the boxes have a patch [m].
    """

    used: Integers
    normals: FloatRows
    points: FloatStack
    others: FloatStack
    kinds: IntegerRows
    edges: FloatStack
    within: Floats


@declared(
    *(SceneWorkspace, FLOATS, FLOATS, float, float, float, INTEGERS, FLOAT_ROWS, INTEGER_ROWS, FLOAT_ROWS),
    *(FLAGS, FLAGS, FacingBoxes),
)
@jit
def face_boxes(work, q, v, h, near, touching, joints, boxes, pairs, blanks, rests, ties, facing):
    """Fill the contacts reserved for pairs of boxes with the corners of their patches.

    Args:
        work: The workspace; its `contact_constants` are filled.
        q, v: The state.
        h: Time within which boxes may come into contact [s].
        near: Distance up to which boxes have a patch at any speed [m].
        touching: If not negative, distance up to which boxes have a patch, instead of h and `near` [m].
        joints: (k,) joints that carry the boxes.
        boxes: (k, `BOX`) see `HALF`.
        pairs: (p, 4) the two boxes, the first contact reserved for them, and the number of these.
        blanks: (contacts, constants) constants of unused contacts.
        rests: (nj,) joints at rest, including the world; pairs of these keep their patches.
        ties: (contacts,) is overwritten for these contacts: whether in this time another direction than the
            normal may come to separate the boxes.
        facing: The `FacingBoxes`, which is updated.
    """
    used, normals, points, others, kinds, edges, extents = facing
    set_state(work, q, v)
    compute_kinematics(work)
    placed, speeds, gaps = np.empty((len(boxes), 12)), np.empty(len(boxes)), np.empty(MOST)
    place_boxes(work, joints, boxes, placed, speeds)
    for p in range(len(pairs)):
        a, b, first, room = pairs[p, 0], pairs[p, 1], pairs[p, 2], pairs[p, 3]
        if rests[joints[a]] and rests[joints[b]]:
            continue
        within = extents[p] = touching if touching >= 0.0 else h * (speeds[a] + speeds[b]) + near
        reach = boxes[a, REACH] + boxes[b, REACH] + within
        square = 0.0
        for e in range(9, 12):
            square += (placed[a, e] - placed[b, e]) ** 2
        found, half_a, half_b = 0, boxes[a, HALF:REACH], boxes[b, HALF:REACH]
        if square <= reach * reach:
            found = box_patch(
                *(placed[a], half_a, placed[b], half_b, within),
                *(normals[p], points[p], others[p], gaps, kinds[p], edges[p]),
            )
        depth = within if touching >= 0.0 else 0.5 * within  # from the start of a step to its midpoint
        tie = found > 0 and undecided(placed[a], half_a, placed[b], half_b, normals[p], depth)
        for k in range(min(found, room)):
            ties[first + k] = tie
            fill_contact(
                *(work.contact_constants[first + k], work.placements[joints[a]], work.placements[joints[b]]),
                *(normals[p], points[p, k], others[p, k], kinds[p, k], edges[p], 0.0, 0.0),
            )
        for k in range(found, used[p]):
            assign(work.contact_constants[first + k], blanks[first + k])
        used[p] = min(found, room)
