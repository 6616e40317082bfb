"""Islands that have come to rest in a time step. (theory.md, 16)"""

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
    """Fill the island of each tree that has come to rest, −1 for other trees; return how many have.

    An island is at rest if its velocities are zero, within tolerances, at the start and end of the step and
    the impulses cancel their change: the next step would then have the same impulses.

    Args:
        v, v_end: (nv,) velocities at the start and at the end of the step.
        moved: (nv,) displacement that removed overlap, divided by the length of the step.
        pushed: (nv,) change of the velocity by the impulses of the step.
        metres: (nv,) κ of (10.6).
        still: Speed that is taken as zero [m/s].
        tree: (nv,) number of the tree that each velocity belongs to.
        columns, counts: Those of the `StepRows`.
        contacts: Number of contacts without held ones.
        active: (items,) contacts and scalar rows that take part.
        surface: (contacts + held, 3) velocities of the surfaces [m/s].
        island: (trees,) is overwritten with the islands.
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
