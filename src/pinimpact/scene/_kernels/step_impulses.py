"""Contact impulses of a time step, computed island by island. (theory.md, 16)"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..._compile.declared import FLAGS, FLOAT_ROWS, FLOAT_STACK, FLOATS, INTEGERS, Integers, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.augmented_lagrangian import solve_velocities
from ..._numeric.augmented_newton import VelocityProblem, law_of_steps
from ..._numeric.coulomb_problem import CoulombProblem, solve_compliant, solve_coulomb
from ..._numeric.loops import assign, filled, largest
from ..._numeric.products import products
from ..._numeric.semidefinite import invert_definite
from ..._numeric.tolerances import COMPUTED, LITTLE, STALLED
from .step_rows import first_row

USABLE = STALLED
"""Residual of the contact problem, relative to u_free, above which it is reported. It is much smaller than
the error of steps of any useful size."""

TOLERABLE = LITTLE
"""Residual above which the problem is solved in the impulses, a thousand times slower for many contacts."""


@declared(FLOAT_ROWS, FLOATS, INTEGERS, FLOAT_ROWS, FLOAT_ROWS)
@jit
def invert_trees(upper, added, tree, mass, inverse):
    """Fill mass (nv, nv) with M + diag(added), from the upper triangle of M, and its inverse, tree by tree.

    tree (nv,) is the number of the tree of each velocity; entries between different trees stay zero. Returns
    whether all trees have an inverse; a mass matrix that is not finite has none.
    """
    nv, regular = len(tree), True
    moves = np.empty(nv, dtype=np.int64)
    for k in range(nv):
        size = 0
        for a in range(nv):
            if tree[a] == k:
                moves[size] = a
                size += 1
        if size == 0:
            break
        block = np.empty((size, size))
        for a in range(size):
            for b in range(size):
                i, j = moves[min(a, b)], moves[max(a, b)]
                block[a, b] = upper[i, j] + (added[i] if a == b else 0.0)
                mass[moves[a], moves[b]] = block[a, b]
        regular = invert_definite(block) and regular
        for a in range(size):
            for b in range(size):
                inverse[moves[a], moves[b]] = block[a, b]
    return regular


@inlined
def label_trees(columns, counts, contacts, active, tree, label, first):
    """Fill the label of each tree, equal within an island, and one tree of each item, −1 if inactive."""
    for k in range(len(label)):
        label[k] = k
    for i in range(len(active)):
        first[i] = -1
        row = first_row(contacts, i)
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
def solve_island(problem, part, accuracy, begin, change, found, course):
    """Compute the impulses of an island; return the residual of Coulomb's law relative to u_free.

    Args:
        problem: The `VelocityProblem` of the island.
        part: See `solve_velocities`.
        accuracy: Relative accuracy, see `solve_velocities`.
        begin: (m,) warm start: change of the velocities; overwritten with that for the next problem.
        change: (m,) is overwritten with the change of velocities by the impulses.
        found: (n,) is overwritten with the impulses.
        course: (2, …, n) is overwritten with r and f⁺ of the iterations, zeros if the problem was solved in
            the impulses.
    """
    residual = solve_velocities(problem, part, accuracy, begin, change, found, course)
    if residual <= TOLERABLE:
        return residual
    course[:] = 0.0
    return solve_in_impulses(problem, residual, change, found)


@external
def solve_in_impulses(problem, residual, change, found):
    """Compute the impulses of an island with its Delassus matrix; keep them if their residual is smaller.

    Arguments and result are those of `solve_island`; `residual` is that of the impulses in `found`.
    """
    _, inverse, _, values, columns, counts, free, law, compliance = problem
    n, m, nc = len(found), len(change), len(law.friction)
    jacobian, response, delassus = np.zeros((n, m)), np.empty((n, m)), np.empty((n, n))
    for a in range(n):
        for k in range(counts[a]):
            jacobian[a, columns[a, k]] = values[a, k]
    products(jacobian, inverse, response)
    products(jacobian, response, delassus)
    for a in range(n):
        for b in range(a):
            delassus[b, a] = delassus[a, b]
    impulses = np.zeros(n)
    whole = CoulombProblem(delassus, free, law)
    if n > m and nc > 0:
        residual_now = solve_compliant(whole, impulses, compliance, COMPUTED)
    else:
        residual_now = solve_coulomb(whole, impulses)
    if not residual_now < residual:
        return residual
    assign(found, impulses)
    for c in range(m):
        change[c] = 0.0
        for a in range(n):
            change[c] += response[a, c] * found[a]
    return residual_now


class Island(NamedTuple):
    """The members of an island, by their numbers in the whole problem.

    Attributes:
        items: Contacts, then scalar rows (counted after the contacts), in ascending order.
        contacts: Number of contacts among the items.
        rows: Rows of the items.
        moves: Velocities of the island's trees.
        place: (nv,) position of each velocity within its island.
    """

    items: Integers
    contacts: int
    rows: Integers
    moves: Integers
    place: Integers


@inlined
def members(nc, number, label, first, tree, place):
    """Return the `Island` whose trees have the label `number`, and fill the places of its velocities.

    nc is the number of contacts; label (trees,) and first (items,) are those of `label_trees`, place (nv,)
    that of `Island`.
    """
    items, rows = np.empty(len(first), dtype=np.int64), np.empty(2 * nc + len(first), dtype=np.int64)
    moves = np.empty(len(tree), dtype=np.int64)
    m = n = contacts = count = 0
    for i in range(len(first)):
        if first[i] >= 0 and label[first[i]] == number:
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
    for c in range(len(tree)):
        if label[tree[c]] == number:
            place[c] = m
            moves[m] = c
            m += 1
    return Island(items[:count], contacts, rows[:n], moves[:m], place)


@inlined
def problem_of(problem, island):
    """Return the `VelocityProblem` of an island, extracted from the whole one."""
    items, contacts, rows, moves, place = island
    mass, inverse, start, values, columns, counts, free, law, compliance = problem
    friction, lower, upper = law.friction, law.lower, law.upper
    m, n, scalars, widest = len(moves), len(rows), len(items) - contacts, 0
    for a in range(n):
        widest = max(widest, counts[rows[a]])
    own_mass, own_inverse, first = np.zeros((m, m)), np.zeros((m, m)), np.empty(m, dtype=np.int64)
    own, where = np.empty((n, widest)), np.empty((n, widest), dtype=np.int64)
    lengths, given = np.empty(n, dtype=np.int64), np.empty(n)
    mu, soft = np.empty(contacts), np.empty(contacts)
    low, high = np.empty(scalars), np.empty(scalars)
    for a in range(m):
        first[a] = place[start[moves[a]]]
        for b in range(first[a], a + 1):
            own_mass[a, b] = own_mass[b, a] = mass[moves[a], moves[b]]
            own_inverse[a, b] = own_inverse[b, a] = inverse[moves[a], moves[b]]
    for a in range(n):
        given[a], lengths[a] = free[rows[a]], counts[rows[a]]
        for k in range(lengths[a]):
            own[a, k], where[a, k] = values[rows[a], k], place[columns[rows[a], k]]
    for k in range(contacts):
        mu[k], soft[k] = friction[items[k]], compliance[items[k]]
    for k in range(scalars):
        i = items[contacts + k] - len(friction)
        low[k], high[k] = lower[i], upper[i]
    law = law_of_steps(mu, low, high)
    return VelocityProblem(own_mass, own_inverse, first, own, where, lengths, given, law, soft)


@declared(
    *(VelocityProblem, FLAGS, INTEGERS, float, float, float, FLOATS, FLOATS, FLOATS, FLOAT_STACK),
    result=float,
)
@jit
def step_impulses(problem, active, tree, part, accuracy, noise, begin, change, impulse, course):
    """Compute the impulses of a step; return the residual of Coulomb's law relative to u_free. (16.2)

    Of several solutions it is nearly the limit of small compliances.

    Args:
        problem: The `VelocityProblem`; M is zero between trees of joints, u_free [m/s] includes gap/h.
        active: (nc + ns,) contacts and scalar rows that take part.
        tree: (nv,) number of the tree that each velocity belongs to.
        part: See `solve_velocities`.
        accuracy: Relative accuracy, see `solve_velocities`.
        noise: Rounding error of u_free [m/s]; residuals of islands with smaller ones are not counted.
        begin: (nv,) warm start: change of the velocities; overwritten with that for the next problem.
        change: (nv,) is overwritten with the change of velocities by the impulses.
        impulse: (n,) is overwritten with the impulses.
        course: (2, …, n) is overwritten with r and f⁺ of the iterations of each island, see `solve_island`.
    """
    nc, nv, trees = len(problem.law.friction), len(tree), 0
    for c in range(nv):
        trees = max(trees, tree[c] + 1)
    label, first = np.empty(trees, dtype=np.int64), np.empty(len(active), dtype=np.int64)
    label_trees(problem.columns, problem.counts, nc, active, tree, label, first)
    filled(impulse, 0.0)
    course[:] = 0.0
    worst, place = 0.0, np.empty(nv, dtype=np.int64)
    for number in range(trees):
        island = members(nc, number, label, first, tree, place)
        rows, moves = island.rows, island.moves
        if len(rows) == 0:
            for k in range(len(moves)):
                change[moves[k]] = begin[moves[k]] = 0.0
            continue
        start, moved, found = np.empty(len(moves)), np.empty(len(moves)), np.empty(len(rows))
        for a in range(len(moves)):
            start[a] = begin[moves[a]]
        own, steps = problem_of(problem, island), np.zeros((2, course.shape[1], len(rows)))
        residual = solve_island(own, part, accuracy, start, moved, found, steps)
        if largest(own.free) > noise:
            worst = max(worst, residual)
        for a in range(len(rows)):
            impulse[rows[a]] = found[a]
            course[:, :, rows[a]] = steps[:, :, a]
        for a in range(len(moves)):
            begin[moves[a]], change[moves[a]] = start[a], moved[a]
    return worst
