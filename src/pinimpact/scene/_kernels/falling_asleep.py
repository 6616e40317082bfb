"""Which trees of joints have come to rest in a time step, with all that touches them. (theory.md, 16)"""

from __future__ import annotations

import numpy as np

from ..._compile.declared import FLAGS, FLOAT_ROWS, FLOATS, INTEGER_ROWS, INTEGERS, declared
from ..._compile.jit import jit
from ..._numeric.loops import flags
from .step_impulses import label_trees
from .tolerances import STEPS_LEFT


@declared(
    *(FLOATS, FLOATS, FLOATS, FLOATS, FLOATS, float),
    *(INTEGERS, INTEGER_ROWS, INTEGERS, int, FLAGS, FLOAT_ROWS, INTEGERS),
    result=int,
)
@jit
def trees_at_rest(
    v, v_end, moved, pushed, metres, still, tree, columns, counts, contacts, active, surface, island
):
    """Fill the island of each tree that has come to rest, −1 for the others; return how many have.

    An island rests where none of its velocities exceeds what counts as none, at the start of the step and at
    its end, and impulses take away all of its change: the next step is the same, and so are its impulses.

    Args:
        v, v_end: (nv,) velocities at the start and at the end of the step.
        moved: (nv,) displacement by which overlap was taken away, over the length of the step.
        pushed: (nv,) change of the velocity by the impulses of the step.
        metres: (nv,) per unit of each velocity, see `joint_metres`.
        still: What counts as none [m/s].
        tree: (nv,) number of the tree that each velocity belongs to.
        columns, counts: Of the rows of the step, see `midpoint_step`.
        contacts: How many contacts come first, held ones not among them.
        active: (items,) which contacts and scalar rows take part.
        surface: (contacts, …) velocities of the surfaces, held contacts' last [m/s].
        island: (trees,) to be filled.
    """
    label, first = np.empty(len(island), dtype=np.int64), np.empty(len(active), dtype=np.int64)
    label_trees(columns, counts, contacts, active, tree, label, first)
    rests, left = flags(len(island), True), np.zeros(len(island))
    for c in range(len(v)):
        k = label[tree[c]]
        left[k] = max(left[k], STEPS_LEFT * metres[c] * abs(pushed[c]))
    for c in range(len(v)):
        k, fastest = label[tree[c]], max(abs(v[c]), abs(v_end[c]), abs(moved[c]))
        if metres[c] * fastest > still or metres[c] * abs(v_end[c] - v[c]) > left[k]:
            rests[k] = False
    for i in range(len(surface)):
        item = i if i < contacts else contacts + 3 * (i - contacts)
        for e in range(3):
            if surface[i, e] != 0.0 and first[item] >= 0:
                rests[label[first[item]]] = False
    count = 0
    for k in range(len(island)):
        island[k] = label[k] if rests[label[k]] else -1
        count += 1 if rests[label[k]] else 0
    return count
