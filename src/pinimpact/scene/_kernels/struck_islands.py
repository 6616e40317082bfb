"""Islands with impacts by Moreau's law in a time step. (theory.md, 16.3)"""

from __future__ import annotations

import numpy as np

from ..._compile.jit import inlined
from ..._numeric.loops import assign, flags
from .step_impulses import label_trees
from .step_rows import normal_row


@inlined
def mark_struck(rows, system, active, found):
    """Mark the islands in which impulses stop contacts or limits that have been apart; return if any.

    Args:
        rows, system: The `StepRows` and the `StepSystem`.
        active: (items,) contacts and scalar rows that take part.
        found: The `StepResult` with the impulses; its `struck` is filled.
    """
    nc, tree, struck = len(rows.contacts), system.tree, found.struck
    every, hit = nc + len(rows.held), flags(len(struck), False)  # the trees of stopped contacts and limits
    strikes = False
    for i in range(nc + len(rows.limits)):
        row = normal_row(nc, every, i)[0]
        if found.fast[i] and not found.arrives[i] and found.impulse[row] > 0.0:
            strikes = hit[tree[rows.columns[row, 0]]] = True
    for c in range(len(struck)):
        struck[c] = False
    if not strikes:
        return False
    label, first = np.empty(len(struck), dtype=np.int64), np.empty(len(active), dtype=np.int64)
    label_trees(rows.columns, rows.counts, nc, active, tree, label, first)
    marked = flags(len(label), False)
    for k in range(len(hit)):
        if hit[k]:
            marked[label[k]] = True
    for c in range(len(struck)):
        struck[c] = marked[label[tree[c]]]
    return True


@inlined
def replace_struck(rows, found, begin, change, others):
    """Replace the results of struck islands by those of their second contact problem.

    Args:
        rows: The `StepRows`.
        found: The `StepResult`; its impulses and iterations are replaced, and kept as `tried`.
        begin, change: (nv,) see `step_impulses`.
        others: The second impulses, iterations, `begin` and `change`.
    """
    impulse, course, own_begin, own_change = others
    assign(found.tried, found.impulse)
    for i in range(len(course)):
        for j in range(len(course[i])):
            assign(found.tried_course[i, j], found.course[i, j])
    for a in range(len(impulse)):
        if rows.counts[a] > 0 and found.struck[rows.columns[a, 0]]:
            found.impulse[a] = impulse[a]
            for i in range(len(course)):
                assign(found.course[i, :, a], course[i, :, a])
    for c in range(len(begin)):
        if found.struck[c]:
            begin[c], change[c] = own_begin[c], own_change[c]
