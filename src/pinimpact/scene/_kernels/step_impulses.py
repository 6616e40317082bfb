"""The contact impulses of a time step, island by island. (theory.md, 16)"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLAGS, FLOAT_ROWS, FLOATS, INTEGER_ROWS, INTEGERS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.coulomb_problem import solve_compliant, solve_coulomb
from ..._numeric.loops import assign, flags
from ..._numeric.lu import factorize
from ..._numeric.lu import substitute as solve_factored
from ..._numeric.products import products
from ..._numeric.proximal_newton import solve_velocities
from ..._numeric.tolerances import PROXIMAL

USABLE = 1e-5
"""What the contact problem may miss, in parts of its velocities, before it is tried otherwise and noted: far
less than steps of any useful length do."""

TOLERABLE = 1e-3
"""The same, before it is solved in the impulses, which takes a thousand times as long for many contacts."""

ATTEMPTS = 3
"""Attempts with the proximal Newton method, the first from where the step before has ended."""

LESS = 0.1
"""Part of the compliances of an attempt that the next one takes: it takes more steps, but surer ones."""


@declared(FLOAT_ROWS, FLOATS, INTEGERS, FLOAT_ROWS, FLOAT_ROWS)
@jit
def invert_trees(upper, added, tree, mass, inverse):
    """Fill M (nv, nv) with what is added to its diagonal, and its inverse, tree by tree.

    Args:
        upper: (nv, nv) M; its upper triangle counts.
        added: (nv,) to the diagonal.
        tree: (nv,) number of the tree that each velocity belongs to; other entries stay as they are, zero.
        mass, inverse: To be filled.
    """
    nv = len(tree)
    moves = np.empty(nv, dtype=np.int64)
    for k in range(nv):
        size = 0
        for a in range(nv):
            if tree[a] == k:
                moves[size] = a
                size += 1
        if size == 0:  # there are no more trees
            break
        block, order = np.empty((size, size)), np.empty(size, dtype=np.int64)
        for a in range(size):
            for b in range(size):
                i, j = moves[min(a, b)], moves[max(a, b)]
                block[a, b] = upper[i, j] + (added[i] if a == b else 0.0)
                mass[moves[a], moves[b]] = block[a, b]
        factorize(block, order)
        column = np.empty(size)
        for b in range(size):
            for a in range(size):
                column[a] = 1.0 if a == b else 0.0
            solve_factored(block, order, column)
            for a in range(size):
                inverse[moves[a], moves[b]] = column[a]


@inlined
def label_trees(columns, counts, contacts, active, tree, label, first):
    """Fill the label of each tree, the same for those of an island, and a tree of each item, −1 for none."""
    for k in range(len(label)):
        label[k] = k
    for i in range(len(active)):
        first[i] = -1
        row = 3 * i if i < contacts else 2 * contacts + i
        if not active[i] or counts[row] == 0:
            continue
        first[i] = tree[columns[row, 0]]
        for k in range(counts[row]):
            one, other = label[first[i]], label[tree[columns[row, k]]]
            if one != other:
                for o in range(len(label)):
                    if label[o] == one or label[o] == other:
                        label[o] = min(one, other)


@external
def solve_island(
    mass,
    inverse,
    values,
    columns,
    counts,
    free,
    friction,
    lower,
    upper,
    compliance,
    accuracy,
    begin,
    change,
    found,
):
    """Find the impulses of an island; arguments as of `solve_velocities`."""
    n, m, nc = len(free), len(mass), len(friction)
    off, other, moved, proximal = math.inf, np.zeros(n), np.empty(m), PROXIMAL
    for attempt in range(ATTEMPTS):
        if attempt > 0:  # with less at a time, from nothing
            proximal *= LESS
            for c in range(m):
                begin[c] = 0.0
        left = solve_velocities(
            *(mass, inverse, values, columns, counts, free, friction, lower, upper, compliance),
            *(proximal, accuracy, begin, moved, other),
        )
        if left < off:
            off = left
            assign(change, moved)
            assign(found, other)
        if off <= USABLE:
            return off
    if off <= TOLERABLE:
        return off
    jacobian, response, delassus = np.zeros((n, m)), np.empty((n, m)), np.empty((n, n))
    for a in range(n):
        for k in range(counts[a]):
            jacobian[a, columns[a, k]] = values[a, k]
    products(jacobian, inverse, response)
    products(jacobian, response, delassus)
    for a in range(n):
        for b in range(a):
            delassus[b, a] = delassus[a, b]
    velocity, least, held = np.zeros((nc, 2)), np.zeros(nc), flags(nc, False)
    for a in range(n):
        other[a] = 0.0
    if n > m and nc > 0:
        left = solve_compliant(
            delassus, free, velocity, friction, least, held, lower, upper, other, compliance
        )
    else:
        left = solve_coulomb(delassus, free, velocity, friction, least, held, lower, upper, other)
    if not left < off:
        return off
    assign(found, other)
    for c in range(m):
        change[c] = 0.0
        for a in range(n):
            change[c] += response[a, c] * found[a]
    return left


@declared(
    *(FLOAT_ROWS, FLOAT_ROWS, FLOAT_ROWS, INTEGER_ROWS, INTEGERS, FLOATS, FLOATS, FLOATS, FLOATS, FLOATS),
    *(FLAGS, INTEGERS, float, FLOATS, FLOATS, FLOATS),
    result=float,
)
@jit
def step_impulses(
    mass,
    inverse,
    values,
    columns,
    counts,
    free,
    friction,
    lower,
    upper,
    compliance,
    active,
    tree,
    accuracy,
    begin,
    change,
    impulse,
):
    """Find the impulses of a step; return how far they are from Coulomb's law, in parts of `free`.

    Of several solutions nearly the limit of small compliances is taken. (11.5)

    Args:
        mass: (nv, nv) M, zero between trees of joints.
        inverse: (nv, nv) M⁻¹.
        values, columns, counts: J as of `solve_velocities`.
        free: (n,) velocities at the end of the step without impulses, and what gaps leave of them.
        friction: (nc,) coefficients of friction.
        lower, upper: (ns,) bounds of the scalar rows.
        compliance: (nc,) relative compliances of the contacts.
        active: (nc + ns,) what takes part.
        tree: (nv,) number of the tree that each velocity belongs to.
        accuracy: Part of `free` to which to find them.
        begin: (nv,) change of the velocities with which to begin; takes that with which a problem that is
            nearly the same begins best.
        change: (nv,) takes that by the impulses.
        impulse: (n,) takes the impulses.
    """
    nc, nv = len(friction), len(tree)
    trees = 0
    for c in range(nv):
        trees = max(trees, tree[c] + 1)
    label, moves = np.empty(trees, dtype=np.int64), np.empty(nv, dtype=np.int64)
    first, items = np.empty(len(active), dtype=np.int64), np.empty(len(active), dtype=np.int64)
    rows, place = np.empty(len(free), dtype=np.int64), np.empty(nv, dtype=np.int64)
    label_trees(columns, counts, nc, active, tree, label, first)
    for a in range(len(impulse)):
        impulse[a] = 0.0
    worst = 0.0
    for island in range(trees):
        m = n = contacts = count = 0
        for i in range(len(active)):
            if first[i] >= 0 and label[first[i]] == island:
                items[count] = i
                count += 1
                if i < nc:
                    contacts += 1
                    for a in range(3 * i, 3 * i + 3):
                        rows[n] = a
                        n += 1
                else:
                    rows[n] = 2 * nc + i
                    n += 1
        for c in range(nv):
            if label[tree[c]] == island:
                place[c] = m
                moves[m] = c
                m += 1
        if count == 0:
            for k in range(m):
                change[moves[k]] = begin[moves[k]] = 0.0
            continue
        widest = 0
        for a in range(n):
            widest = max(widest, counts[rows[a]])
        own_mass, own_inverse = np.empty((m, m)), np.empty((m, m))
        own, where = np.empty((n, widest)), np.empty((n, widest), dtype=np.int64)
        lengths = np.empty(n, dtype=np.int64)
        start, moved, given, found = np.empty(m), np.empty(m), np.empty(n), np.empty(n)
        mu, soft = np.empty(contacts), np.empty(contacts)
        low, high = np.empty(count - contacts), np.empty(count - contacts)
        for a in range(m):
            start[a] = begin[moves[a]]
            for b in range(m):
                own_mass[a, b] = mass[moves[a], moves[b]]
                own_inverse[a, b] = inverse[moves[a], moves[b]]
        for a in range(n):
            given[a], lengths[a] = free[rows[a]], counts[rows[a]]
            for k in range(lengths[a]):
                own[a, k], where[a, k] = values[rows[a], k], place[columns[rows[a], k]]
        for k in range(contacts):
            mu[k], soft[k] = friction[items[k]], compliance[items[k]]
        for k in range(contacts, count):
            low[k - contacts], high[k - contacts] = lower[items[k] - nc], upper[items[k] - nc]
        off = solve_island(
            *(own_mass, own_inverse, own, where, lengths, given, mu, low, high, soft),
            *(accuracy, start, moved, found),
        )
        worst = max(worst, off)
        for a in range(n):
            impulse[rows[a]] = found[a]
        for a in range(m):
            begin[moves[a]], change[moves[a]] = start[a], moved[a]
    return worst
