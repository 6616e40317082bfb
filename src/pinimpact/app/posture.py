"""Postures of the demo: bent, with no part of the robot in the table."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from .._numeric.tolerances import LITTLE
from ..arrays import Array
from ..geometry.collision_shapes import extreme_points
from ..robot.joint_limits import bounds
from ..visual.shapes_in_contact import surface_points
from ..visual.surface_shapes import THICKNESS

SAMPLES, SEED = 600, 28
"""Number of random postures of an arm, before steps from the best of them, and their seed."""
STRAY, PLANAR = 0.15, 0.02
"""Cost of the distance from the initial posture [1/rad]; lever arm that is taken as zero, relative to the
robot's size."""
BEND, ASIDE = 0.7, 0.75
"""Angle by which a one-sided joint is bent, at most to the middle of its range [rad]; a joint is one-sided if
this middle is more than `ASIDE` half ranges from zero."""
WIDEST = 2.0
"""Maximum distance of random joint positions from the initial ones [rad or m]."""
CLEAR, ROOM = 0.01, 0.1
"""Minimum distance of other parts from the table, and distance beyond which the score does not increase,
relative to the robot's size."""
HEIGHT, HIGHEST = 0.2, 0.4
"""Range of heights of the table above the lowest part of the base without a cost, relative to the robot's
size."""
DEXTEROUS = 0.2
"""Lever arm beyond which the score does not increase, relative to the robot's size."""
TILTS = (1.0, 0.5, 0.2, 0.0)
"""Fractions of its tilt with which a free base tries to land on a foot."""
SLOPE, APART = 0.6, 0.05
"""Slope by which a foot is tilted to find other lowest points, and their minimum distance relative to the
robot's size."""
FLAT = LITTLE
"""Points this close to the lowest one belong to the same edge or face, relative to the robot's size; other
contacts are further away."""


@dataclass(frozen=True, eq=False)
class Strike:
    """A posture, and its contact point."""

    q: Array  # (nq,) the configuration
    point: Array  # (3,) the contact point, in world axes


class Body:
    """A robot as the corners of its visual shapes, or as its frames if it has none (`bare`).

    `size` is the diagonal of its bounding box [m], `solids` the joint of each shape and its corners (k, 3) in
    that joint's axes, `hulls` the same as coal objects with their placements there; `data` has the placements
    of the last posture.
    """

    def __init__(self, robot: pin.RobotWrapper) -> None:
        self.model: pin.Model = robot.model
        self.data = self.model.createData()
        shapes = robot.visual_model
        found = () if shapes is None else shapes.geometryObjects
        self.solids = [(int(s.parentJoint), _corners(s)) for s in found]
        self.hulls = [(_hull(s.geometry), s.placement) for s in found]
        self.bare = not self.solids
        if self.bare:
            frames = self.model.frames[1:]
            self.solids = [(int(f.parentJoint), f.placement.translation[None].copy()) for f in frames]
            self.hulls = [(coal.Sphere(0.0), f.placement) for f in frames]
        every = np.vstack(self.at(robot.q0))
        self.size = float(np.linalg.norm(np.ptp(every, axis=0))) or 1.0

    def at(self, q: Array) -> list[Array]:
        """Return the corners of each shape in world axes."""
        pin.framesForwardKinematics(self.model, self.data, q)
        places = self.data.oMi
        return [points @ places[j].rotation.T + places[j].translation for j, points in self.solids]

    def part(self, joint: int) -> set[int]:
        """Return a joint and its descendants."""
        return set(self.model.subtrees[joint])

    def lowest(self, corners: list[Array], normal: Array, joints: Collection[int]) -> Array | None:
        """Return the middle of the lowest points on some joints, None if they have no shape."""
        own = [points for (joint, _), points in zip(self.solids, corners, strict=True) if joint in joints]
        if not own:
            return None
        points = np.vstack(own)
        heights = points @ normal
        least = points[heights < heights.min() + FLAT * self.size]
        middle: Array = 0.5 * (least.min(axis=0) + least.max(axis=0))
        return middle + (heights.min() - middle @ normal) * normal

    def height(self, q: Array, point: Array, axes: Array) -> float:
        """Return the height of the lowest corner over a plate as large as the robot [m]."""
        across = (np.vstack(self.at(q)) - point) @ axes.T
        inside = np.linalg.norm(across[:, :2], axis=1) < 0.5 * self.size
        return float(across[inside, 2].min(initial=self.size))

    def clearance(self, point: Array, axes: Array, reach: float, own: Collection[int]) -> float:
        """Return the distance of the shapes of other joints than `own` from a plate [m]; < 0 in it.

        The plate reaches from a point to its sides [m]; axes (3, 3) are its directions and its normal, as
        rows.
        """
        thick = THICKNESS * self.size
        plate, middle = coal.Box(2.0 * reach, 2.0 * reach, thick), point - 0.5 * thick * axes[2]
        there, request, least = coal.Transform3s(axes.T, middle), coal.DistanceRequest(), np.inf
        for (joint, _), (hull, place) in zip(self.solids, self.hulls, strict=True):
            if joint not in own:
                at = self.data.oMi[joint] * place
                here = coal.Transform3s(at.rotation, at.translation)
                least = min(least, coal.distance(hull, here, plate, there, request, coal.DistanceResult()))
        return float(least)


def _hull(geometry: Any) -> Any:
    """Return a coal shape; for a mesh that is not flat, its convex hull."""
    if not hasattr(geometry, "buildConvexHull"):
        return geometry
    try:  # Coal would end the process where Qhull raises an error
        ConvexHull(surface_points(geometry))
        geometry.buildConvexHull(True, "Qt")
    except (QhullError, RuntimeError):  # flat, or a vertex with too many edges
        return geometry
    return geometry.convex


def _corners(shape: pin.GeometryObject) -> Array:
    """Return the corners (k, 3) of a shape's hull in the axes of its joint."""
    points = extreme_points(surface_points(shape.geometry), shape.name)
    placed: Array = points @ shape.placement.rotation.T + shape.placement.translation
    return placed


def bent(robot: pin.RobotWrapper) -> Array:
    """Return the initial posture of a robot, with straight knees and elbows bent."""
    model, q = robot.model, np.array(robot.q0, dtype=float)
    low, high = bounds(model)
    given = not np.allclose(q, pin.neutral(model))
    for j in range(1, model.njoints):
        k = model.idx_qs[j]
        if model.nqs[j] != 1 or not np.isfinite(high[k] - low[k]):
            continue
        middle, half = 0.5 * (low[k] + high[k]), 0.5 * (high[k] - low[k])
        if not given and abs(middle) > ASIDE * half:
            q[k] = np.copysign(min(BEND, abs(middle)), middle)
        q[k] = np.clip(q[k], low[k], high[k])
    return q


def arm_posture(body: Body, q0: Array, joint: int, local: Array | None, axes: Array, reach: float) -> Strike:
    """Return a posture in which a part touches a table from above and all others stay clear of it.

    The posture has the largest score among many: a sum of lever arm, distance from the table and uprightness
    of the hand, less a cost of the distance from the initial posture.

    Args:
        body: The robot.
        q0: (nq,) initial configuration.
        joint: Joint of the part in contact.
        local: (3,) contact point in the axes of the joint; None for the lowest point.
        axes: (3, 3) axes of the table as rows, the normal last.
        reach: Half the side length of the table [m].
    """
    model, normal, own = body.model, axes[2], body.part(joint)
    low, high = bounds(model)
    chain = [j for j in model.supports[joint] if j > 0 and model.nvs[j] == 1]
    own_velocities = [model.idx_vs[j] for j in chain]
    plain = [model.idx_qs[j] for j in chain if model.nqs[j] == 1]
    margin = np.minimum(0.05 * (high[plain] - low[plain]), 0.1)
    usable = np.ones(3, dtype=bool)

    def moved(q: Array, by: Array) -> Array:
        change = np.zeros(model.nv)
        change[own_velocities] = by
        q = pin.integrate(model, q, change)
        q[plain] = np.clip(q[plain], low[plain] + margin, high[plain] - margin)
        return q

    def rated(q: Array) -> tuple[float, Strike, Array]:
        corners = body.at(q)
        place = body.data.oMi[joint]
        lowest = body.lowest(corners, normal, own) if local is None else place.act(local)
        point = place.translation.copy() if lowest is None else lowest
        clear = body.clearance(point, axes, reach, own) / body.size
        pin.computeJointJacobians(model, body.data, q)
        full = pin.getJointJacobian(model, body.data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)
        jacobian = full[:3] - pin.skew(point - place.translation) @ full[3:]
        levers = np.zeros(3)
        levers[: min(jacobian.shape)] = np.linalg.svd(jacobian, compute_uv=False) / body.size
        parent = body.data.oMi[model.parents[joint]].translation
        upright = float((parent - point) @ normal) / (float(np.linalg.norm(parent - point)) or 1.0)
        ground = min(
            (c[:, 2].min() for (j, _), c in zip(body.solids, corners, strict=True) if j < 2), default=0.0
        )
        height = float(point[2] - ground) / body.size
        score = 2.0 * min(float(levers[usable].min(initial=np.inf)) / DEXTEROUS, 1.0) + 1.5 * upright
        score += min(clear / ROOM, 1.0) if clear > CLEAR else 20.0 * clear - 10.0
        score -= 10.0 if height < CLEAR else max(1.0 - height / HEIGHT, 0.0)
        score -= max(height / HIGHEST - 1.0, 0.0)
        score -= STRAY * float(np.abs(pin.difference(model, q0, q)).sum())
        return score, Strike(q, point), levers

    if len(chain) < 2:
        return rated(q0)[1]
    random = np.random.default_rng(SEED)
    some = [q0] + [
        moved(q0, (random.random(len(chain)) < 0.6) * random.uniform(-WIDEST, WIDEST, len(chain)))
        for _ in range(SAMPLES)
    ]
    usable = np.max([rated(q)[2] for q in some[:50]], axis=0) > PLANAR  # a planar arm has two directions
    best = max(map(rated, some), key=lambda one: one[0])
    for k in range(SAMPLES):
        width = WIDEST * 0.01 ** (k / SAMPLES) * 0.25
        step = (random.random(len(chain)) < 0.6) * random.normal(0.0, width, len(chain))
        best = max(best, rated(moved(best[1].q, step)), key=lambda one: one[0])
    return best[1]


def landing(body: Body, tilted: Sequence[Array], feet: Sequence[int], normal: Array) -> tuple[Strike, int]:
    """Return the posture in which a free-base robot lands, and the joint of its lowest point.

    Args:
        body: The robot.
        tilted: Configurations (nq,); the first one that lands on a foot is chosen, or else the first.
        feet: Joints of the feet.
        normal: (3,) normal of the table.
    """
    parts = [body.part(joint) for joint in feet]
    found = []
    for q in tilted:
        corners = body.at(q)
        heights = [float((points @ normal).min()) for points in corners]
        joint = body.solids[int(np.argmin(heights))][0]
        part = next((part for part in parts if joint in part), {joint})
        point = body.lowest(corners, normal, part)
        assert point is not None  # the lowest shape is one of the part's
        found.append((Strike(q, point), joint))
        if part in parts:
            return found[-1]
    return found[0]


def soles(body: Body, q: Array, joint: int, axes: Array) -> list[Array]:
    """Return the lowest points (3,) of a foot in world axes: as it is, and tilted in four directions."""
    corners, part = body.at(q), body.part(joint)
    found: list[Array] = []
    for slope in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
        point = body.lowest(corners, axes[2] + SLOPE * (slope[0] * axes[0] + slope[1] * axes[1]), part)
        if point is not None and all(np.linalg.norm(point - other) > APART * body.size for other in found):
            found.append(point)
    return found
