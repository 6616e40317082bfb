"""Contact points of two bodies that lie between others in one plane, without impulse. (theory.md, 15.3)"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ..arrays import Array, Integers
from ..geometry.tolerances import CLOSE, COINCIDE, LOCAL
from ..robot.contact import Contact


def points_between(
    contacts: Mapping[int, Contact], ends: Integers, locate: Callable[[Contact], tuple[Any, Array, Array]]
) -> set[int]:
    """Return the contacts of shapes whose points lie between those of other shapes of the same two bodies.

    Level floors, or the boxes that a body consists of, have one face together. Their points at the joints
    between them do not approach if those at the corners do not, and an impulse there is equal to impulses at
    the corners.

    Args:
        contacts: The contacts by their numbers.
        ends: (n, 2) the two joints of each contact.
        locate: Returns a contact's gap, normal (3,) and point (3,).
    """
    alike: dict[tuple[object, ...], list[int]] = {}
    for i, one in contacts.items():
        if _shapes(one) is not None:
            alike.setdefault((*sorted(ends[i].tolist()), *_law(one)), []).append(i)
    found: set[int] = set()
    for rest in alike.values():
        while len({_shapes(contacts[i]) for i in rest}) > 1:
            located = [locate(contacts[i]) for i in rest]
            normals, points = (np.array([one[k] for one in located]) for k in (1, 2))
            across = points - points[0]
            size = float(np.linalg.norm(across, axis=1).max())
            level = np.abs(normals - normals[0]).max(axis=1) <= LOCAL
            level &= np.abs(across @ normals[0]) <= CLOSE * size
            same = np.flatnonzero(level).tolist()
            in_plane = across[level] @ np.linalg.svd(normals[:1])[2][1:].T
            corners = {same[k] for k in hull_corners(in_plane, COINCIDE * size)}
            found |= {rest[k] for k in same if k not in corners}
            rest = [i for k, i in enumerate(rest) if not level[k]]
    return found


def _shapes(contact: Contact) -> int | str | None:
    """Return what identifies the shapes of a contact; None for a contact of a frame, a ball or a rim."""
    if contact.radius > 0.0 or contact.rim > 0.0 or contact.plane.radius > 0.0:
        return None
    return contact.shape if contact.pair is None else id(contact.pair)


def _law(contact: Contact) -> tuple[object, ...]:
    """Return the coefficients of a contact's impact law, and the motion of its surface."""
    surface = contact.plane
    motion = surface.velocity, surface.angular_velocity, surface.origin * any(surface.angular_velocity)
    return contact.friction, contact.restitution, contact.law, contact.stiffness, *motion


def hull_corners(points: Array, tolerance: float) -> set[int]:
    """Return the corners of the convex hull of points (k, 2), by gift wrapping.

    Points closer than `tolerance` are one, and so close to a side they lie on it. SciPy's hull sometimes
    takes points that differ by rounding for several corners.
    """
    given = points.tolist()
    start = int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))
    corners, here = [start], start
    while len(corners) <= len(given):
        x, y = given[here]
        best, farthest, u, w = -1, 0.0, 0.0, 0.0  # all others are to the left of the side to the best one
        for k, (a, b) in enumerate(given):
            distance = math.hypot(a - x, b - y)
            if distance <= tolerance:
                continue
            left = (u * (b - y) - w * (a - x)) / farthest if best >= 0 else -math.inf
            if left < -tolerance or (left <= tolerance and distance > farthest):
                best, farthest, u, w = k, distance, a - x, b - y
        if best < 0 or math.dist(given[best], given[start]) <= tolerance:
            break
        corners.append(best)
        here = best
    return set(corners)
