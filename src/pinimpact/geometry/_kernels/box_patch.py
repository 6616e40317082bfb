"""The contact patch of two boxes; see `geometry.patch`, which supports all convex shapes.

A box is a placement of twelve numbers (its axes, column by column, and its centre) and half its edges (3,).
"""

from __future__ import annotations

import math

import numpy as np

from ..._compile.declared import FLOAT_ROWS, FLOATS, INTEGERS, declared
from ..._compile.jit import external, inlined, jit
from ..._numeric.loops import assign
from ..._numeric.tolerances import NOISE
from ..tolerances import COINCIDE, FACE, FACING, TIE
from .constants import EDGE, PLANE, TIP_PLANE

MOST = 8
"""Largest number of corners of a patch, a face clipped by another."""

SIDE = 1.0
"""Mark of an edge of a clipped polygon that is a side of the clipping face."""


@inlined
def along(a, i, x1, x2, x3):
    """Return the product of a box's axis and a vector."""
    return a[3 * i] * x1 + a[3 * i + 1] * x2 + a[3 * i + 2] * x3


@inlined
def extent(a, half, n1, n2, n3):
    """Return half a box's width along a direction."""
    return (
        half[0] * abs(along(a, 0, n1, n2, n3))
        + half[1] * abs(along(a, 1, n1, n2, n3))
        + half[2] * abs(along(a, 2, n1, n2, n3))
    )


@inlined
def reach(half):
    """Return the distance of a box's corners from its centre [m]."""
    return math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)


@inlined
def coincidence(half_a, half_b):
    """Return the distance below which points of two boxes coincide [m]; see `COINCIDE`."""
    one, other = reach(half_a), reach(half_b)
    return COINCIDE * min(one, other) + NOISE * max(one, other)


@inlined
def direction(a, b, k):
    """Return direction k of those that may separate two boxes, zero if it does not exist.

    0, 1, 2 are normals of faces of B, 3, 4, 5 of A; 6 + 3 i + j is perpendicular to edges i of A and j of B.
    """
    if k < 3:
        return b[3 * k], b[3 * k + 1], b[3 * k + 2]
    if k < 6:
        return a[3 * k - 9], a[3 * k - 8], a[3 * k - 7]
    i, j = (k - 6) // 3, (k - 6) % 3
    n1 = a[3 * i + 1] * b[3 * j + 2] - a[3 * i + 2] * b[3 * j + 1]
    n2 = a[3 * i + 2] * b[3 * j] - a[3 * i] * b[3 * j + 2]
    n3 = a[3 * i] * b[3 * j + 1] - a[3 * i + 1] * b[3 * j]
    length = math.sqrt(n1 * n1 + n2 * n2 + n3 * n3)
    if length <= COINCIDE:
        return 0.0, 0.0, 0.0
    return n1 / length, n2 / length, n3 / length


@inlined
def separation(a, half_a, b, half_b, n1, n2, n3):
    """Return the separation [m] of two boxes along a direction, and the height [m] of A's centre over B's."""
    height = n1 * (a[9] - b[9]) + n2 * (a[10] - b[10]) + n3 * (a[11] - b[11])
    return abs(height) - extent(a, half_a, n1, n2, n3) - extent(b, half_b, n1, n2, n3), height


@external
def separate(a, half_a, b, half_b):
    """Return the separation of two boxes along the best direction, that direction (3), and its number."""
    tie = TIE * (reach(half_a) + reach(half_b))
    best, kind, m1, m2, m3 = -math.inf, -1, 0.0, 0.0, 1.0
    for k in range(15):
        n1, n2, n3 = direction(a, b, k)
        if n1 == n2 == n3 == 0.0:
            continue
        value, height = separation(a, half_a, b, half_b, n1, n2, n3)
        if value > best + tie:
            sign = 1.0 if height >= 0.0 else -1.0
            best, kind, m1, m2, m3 = value, k, sign * n1, sign * n2, sign * n3
    return best, m1, m2, m3, kind


@external
def undecided(a, half_a, b, half_b, normal, depth):
    """Return whether a very different direction than `normal` separates two boxes as well, up to a depth."""
    least = separation(a, half_a, b, half_b, normal[0], normal[1], normal[2])[0] - depth
    for k in range(15):
        n1, n2, n3 = direction(a, b, k)
        if n1 == n2 == n3 == 0.0 or abs(n1 * normal[0] + n2 * normal[1] + n3 * normal[2]) >= FACING:
            continue
        if separation(a, half_a, b, half_b, n1, n2, n3)[0] >= least:
            return True
    return False


@inlined
def facing_axis(a, n1, n2, n3):
    """Return the axis of a box closest to a direction or its opposite, and their cosine."""
    best, axis = 0.0, 0
    for i in range(3):
        cosine = along(a, i, n1, n2, n3)
        if abs(cosine) > abs(best):
            best, axis = cosine, i
    return axis, best


@inlined
def beyond(height, tolerance):
    """Return a height beyond a side, zero within the tolerance."""
    return height if height > tolerance else min(height, 0.0)


@external
def clip_face(a, half_a, axis, side, b, half_b, face, up, tolerance, polygon):
    """Clip a face of A by the sides of a face of B; return the number of corners.

    Args:
        a, half_a, b, half_b: The boxes.
        axis, side: Axis of the face of A, and its side, ±1.
        face, up: Axis of the face of B, and its side, ±1.
        tolerance: Points beyond a side by less than this lie in it [m], so that edges along a side do not
            cross it.
        polygon: (2 `MOST`, 4) is overwritten with the corners: coordinates along the two other axes of B,
            from its centre; the height over the face of B; the mark of the edge to the next corner, 0 for one
            of A, `SIDE` for one of B.
    """
    p, q, k, o = (axis + 1) % 3, (axis + 2) % 3, (face + 1) % 3, (face + 2) % 3
    other, count = np.empty((2 * MOST, 4)), 4
    for c in range(4):
        s = half_a[p] if c in (0, 3) else -half_a[p]
        t = half_a[q] if c < 2 else -half_a[q]
        w = side * half_a[axis]
        x1 = a[9] + w * a[3 * axis] + s * a[3 * p] + t * a[3 * q] - b[9]
        x2 = a[10] + w * a[3 * axis + 1] + s * a[3 * p + 1] + t * a[3 * q + 1] - b[10]
        x3 = a[11] + w * a[3 * axis + 2] + s * a[3 * p + 2] + t * a[3 * q + 2] - b[11]
        polygon[c, 0], polygon[c, 1] = along(b, k, x1, x2, x3), along(b, o, x1, x2, x3)
        polygon[c, 2], polygon[c, 3] = up * along(b, face, x1, x2, x3) - half_b[face], 0.0
    for c in range(4):
        along_side, bound = c // 2, half_b[k] if c < 2 else half_b[o]
        sign = 1.0 if c % 2 == 0 else -1.0
        kept = 0
        for m in range(count):
            following = (m + 1) % count
            now = beyond(sign * polygon[m, along_side] - bound, tolerance)
            then = beyond(sign * polygon[following, along_side] - bound, tolerance)
            if now <= 0.0:
                assign(other[kept], polygon[m])
                kept += 1
            if (now <= 0.0) != (then <= 0.0):
                share = now / (now - then)
                for e in range(3):
                    other[kept, e] = polygon[m, e] + share * (polygon[following, e] - polygon[m, e])
                other[kept, 3] = SIDE if now <= 0.0 else polygon[m, 3]
                kept += 1
        count = kept
        for m in range(count):
            assign(polygon[m], other[m])
    return count


@inlined
def nearest_on_edges(along_a, half_a, along_b, half_b, cosine):
    """Return the closest points of two segments, from the middle of each along its direction.

    `along_a` and `along_b` are from the middle of the second to that of the first, along each; half_a and
    half_b half their lengths; cosine that of the angle between them.
    """
    determinant = 1.0 - cosine * cosine
    if determinant > 0.0:
        s = min(max((cosine * along_b - along_a) / determinant, -half_a), half_a)
    else:  # parallel: the middle of the overlap
        low = min(max(-along_a - half_b, -half_a), half_a)
        s = 0.5 * (low + min(max(-along_a + half_b, -half_a), half_a))
    t = min(max(along_b + s * cosine, -half_b), half_b)
    return min(max(t * cosine - along_a, -half_a), half_a), t


@inlined
def edge_middle(a, half, i, first, second):
    """Return the middle (3) of an edge along axis i, on these sides of the two axes after it."""
    p, q = (i + 1) % 3, (i + 2) % 3
    s, t = first * half[p], second * half[q]
    return (
        a[9] + s * a[3 * p] + t * a[3 * q],
        a[10] + s * a[3 * p + 1] + t * a[3 * q + 1],
        a[11] + s * a[3 * p + 2] + t * a[3 * q + 2],
    )


@external
def nearest_of_two_edges(a, half_a, i, p, q, b, half_b, j, k, o, points, others):
    """Compute the closest points of an edge of A and one of B.

    Args:
        a, half_a, b, half_b: The boxes.
        i, p, q: The edge of A is along its axis i, on the sides p and q, ±1, of the two axes after it.
        j, k, o: Likewise for B.
        points, others: (…, 3) the first rows are overwritten with the points of A and of B.

    Returns:
        Their distance, and whether they are within both edges.
    """
    x1, x2, x3 = edge_middle(a, half_a, i, p, q)
    y1, y2, y3 = edge_middle(b, half_b, j, k, o)
    r1, r2, r3 = x1 - y1, x2 - y2, x3 - y3
    cosine = along(a, i, b[3 * j], b[3 * j + 1], b[3 * j + 2])
    s, t = nearest_on_edges(along(a, i, r1, r2, r3), half_a[i], along(b, j, r1, r2, r3), half_b[j], cosine)
    square = 0.0
    for e, (x, y) in enumerate(((x1, y1), (x2, y2), (x3, y3))):
        points[0, e] = x + s * a[3 * i + e]
        others[0, e] = y + t * b[3 * j + e]
        square += (points[0, e] - others[0, e]) ** 2
    return math.sqrt(square), abs(s) < half_a[i] and abs(t) < half_b[j]


@external
def nearest_edges(a, half_a, b, half_b, tolerance, points, others):
    """Write the mean of the closest points of all pairs of edges to the first rows; return the distance.

    Pairs whose distances differ by less than the tolerance [m] are equally close.
    """
    best, count = math.inf, 0
    one, other = np.empty((1, 3)), np.empty((1, 3))
    for i in range(3):
        for j in range(3):
            for c in range(16):
                p, q = 1.0 - 2.0 * (c % 2), 1.0 - 2.0 * (c // 2 % 2)
                k, o = 1.0 - 2.0 * (c // 4 % 2), 1.0 - 2.0 * (c // 8)
                distance, _ = nearest_of_two_edges(a, half_a, i, p, q, b, half_b, j, k, o, one, other)
                if distance < best - tolerance:
                    best, count = distance, 0
                if distance <= best + tolerance:
                    for e in range(3):
                        before = points[0, e] * count, others[0, e] * count
                        points[0, e] = (before[0] + one[0, e]) / (count + 1) if count else one[0, e]
                        others[0, e] = (before[1] + other[0, e]) / (count + 1) if count else other[0, e]
                    count += 1
    return best


@declared(
    *(FLOATS, FLOATS, FLOATS, FLOATS, float, FLOATS, FLOAT_ROWS, FLOAT_ROWS, FLOATS, INTEGERS, FLOAT_ROWS),
    result=int,
)
@jit
def box_patch(a, half_a, b, half_b, within, normal, points, others, gaps, kinds, edges):
    """Compute the contact patch of two boxes; return the number of its points, 0 if they are apart.

    Args:
        a, half_a, b, half_b: The boxes.
        within: Distance up to which points belong to the patch [m].
        normal: (3,) is overwritten with the normal from B to A.
        points, others: (`MOST`, 3) are overwritten with points of A, and the opposite points of B [m].
        gaps: (`MOST`,) is overwritten with the gaps along the normal, negative for overlap [m].
        kinds: (`MOST`,) is overwritten with the features: `PLANE` for a point of A on a face of B,
            `TIP_PLANE` for one of B on a face of A, `EDGE` for two edges.
        edges: (2, 3) is overwritten with the directions of the edges of A and B, for `EDGE`.
    """
    value, n1, n2, n3, kind = separate(a, half_a, b, half_b)
    if value > within:
        return 0
    normal[0], normal[1], normal[2] = n1, n2, n3
    kinds[0] = PLANE
    axis_a, cosine_a = facing_axis(a, n1, n2, n3)
    axis_b, cosine_b = facing_axis(b, n1, n2, n3)
    of_a = kind >= 3 if kind < 6 else abs(cosine_a) > abs(cosine_b)
    if kind < 6 or max(abs(cosine_a), abs(cosine_b)) >= FACE:
        up_a, up_b = (-1.0 if cosine_a > 0.0 else 1.0), (1.0 if cosine_b > 0.0 else -1.0)
        one, two = (a, half_a, axis_a, up_a), (b, half_b, axis_b, up_b)
        if of_a:
            count = face_patch(*two, *one, within, normal, others, points, gaps, kinds, TIP_PLANE)
            for e in range(3):
                normal[e] = -normal[e]
        else:
            count = face_patch(*one, *two, within, normal, points, others, gaps, kinds, PLANE)
        if count >= 0:
            return count
        if value <= 0.0:
            return 0
        tolerance = coincidence(half_a, half_b)
        value = nearest_edges(a, half_a, b, half_b, tolerance, points, others)
        if value <= tolerance:
            return 0
        for e in range(3):
            normal[e] = (points[0, e] - others[0, e]) / value
    else:
        crossing_edges(a, half_a, b, half_b, kind - 6, normal, points, others, kinds, edges)
    gaps[0] = 0.0
    for e in range(3):
        gaps[0] += (points[0, e] - others[0, e]) * normal[e]
    return 1 if gaps[0] <= within else 0


@external
def crossing_edges(a, half_a, b, half_b, pair, normal, points, others, kinds, edges):
    """Fill the patch of two boxes with edges along axes i of A and j of B closest; `pair` is 3 i + j."""
    n1, n2, n3 = normal
    i, j = pair // 3, pair % 3
    p, q, k, o = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
    _, inside = nearest_of_two_edges(
        *(a, half_a, i, -sign(along(a, p, n1, n2, n3)), -sign(along(a, q, n1, n2, n3))),
        *(b, half_b, j, sign(along(b, k, n1, n2, n3)), sign(along(b, o, n1, n2, n3)), points, others),
    )
    if inside:
        kinds[0] = EDGE
        for e in range(3):
            edges[0, e], edges[1, e] = a[3 * i + e], b[3 * j + e]
        turned = 0.0
        for e in range(3):
            f, g = (e + 1) % 3, (e + 2) % 3
            turned += normal[e] * (edges[0, f] * edges[1, g] - edges[0, g] * edges[1, f])
        for e in range(3):
            edges[0, e] *= sign(turned)


@inlined
def sign(x):
    """Return ±1."""
    return -1.0 if x < 0.0 else 1.0


@external
def face_patch(a, half_a, axis, side, b, half_b, face, up, within, normal, points, others, gaps, kinds, kind):
    """Fill the patch of A over a face of B; return the number of points, −1 if A is beyond its sides.

    Corners are points of A, with the code `kind`. For parallel faces corners of B are points of B, and
    crossings of edges points of the first box, so that the result does not depend on which face is the
    reference. Other arguments as for `clip_face` and `box_patch`.
    """
    polygon = np.empty((2 * MOST, 4))
    tolerance = coincidence(half_a, half_b)
    count = clip_face(a, half_a, axis, side, b, half_b, face, up, tolerance, polygon)
    if count == 0:
        return -1
    for e in range(3):
        normal[e] = up * b[3 * face + e]
    k, o, found = (face + 1) % 3, (face + 2) % 3, 0
    cosine = abs(along(a, axis, normal[0], normal[1], normal[2]))
    for m in range(count):
        before, square = (m - 1 if m > 0 else count - 1), 0.0
        for e in range(3):
            square += (polygon[m, e] - polygon[before, e]) ** 2
        # of corners that all coincide, one is kept
        apart = square > tolerance * tolerance or (found == 0 and m == count - 1)
        if not apart or polygon[m, 2] > within or found == MOST:
            continue
        gaps[found], kinds[found] = polygon[m, 2], kind
        if cosine >= 1.0 - TIE and polygon[m, 3] == SIDE and polygon[before, 3] == SIDE:
            kinds[found] = TIP_PLANE if kind == PLANE else PLANE
        elif cosine >= 1.0 - TIE and polygon[m, 3] != polygon[before, 3]:
            kinds[found] = PLANE
        for e in range(3):
            others[found, e] = (
                b[9 + e]
                + half_b[face] * normal[e]
                + polygon[m, 0] * b[3 * k + e]
                + polygon[m, 1] * b[3 * o + e]
            )
            points[found, e] = others[found, e] + gaps[found] * normal[e]
        found += 1
    return found
