"""Friction of sliding and the direction of gravity, from recorded motions of a body on a plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from .._numeric.tolerances import HALF_DIGITS, LITTLE, TINY
from ..arrays import Array
from ..checks import above_zero
from ..errors import InputError
from ..geometry.plane import Plane
from ..robot.matrices import contact_geometry
from ..robot.names import frame_id
from ..scene.scene import Scene
from ..scene.switched_off import altered
from .estimate import Identified, checked_kinds, fit, group_numbers, set_coefficient
from .flights import Body
from .found import free_body
from .measured import digests
from .recordings import FRAMES, Motion, checked_motions, gaps

PASSES = 16
"""Number of times that directions of slip are computed; those of paths that turn by 90° agree after four."""

AGREED = 0.05
"""Largest mean change of directions of slip [rad] in the last pass; slides with more are divided. With noise,
directions at low speeds do not agree to `LITTLE`. Errors of μ on curved paths are then below 1 %."""

_NAMES = {"sliding_friction": ("sliding_friction",), "gravity": ("gravity:t1", "gravity:t2")}


class _Slide(NamedTuple):
    """A slide of a body on a face; the cost of its path is |rows x − target|² plus a constant."""

    rows: Array  # (4, 4) for x = g_t, μ g_n and μ
    target: Array  # (4,)
    label: Any


def identify_sliding(
    motions: Sequence[Motion],
    scene: Scene,
    free: Sequence[str] = ("sliding_friction", "gravity"),
    *,
    loss: str = "soft_l1",
    closed: float = 0.0015,
    slowest: float = 0.02,
) -> Identified:
    """Fit the friction of sliding to the parts of recordings in which a body slides on a face. (I10)

    Args:
        motions: The recordings.
        scene: One free body, with contacts on one plane that is fixed in the world; at least three of them
            close on a face.
        free: "sliding_friction", and "gravity", whose direction may differ from that of the model: its
            components along t₁ and t₂ of the plane are fitted, its size is kept.
        loss: As in `identify`.
        closed: Gap up to which a contact is taken as closed [m]; it may also be as much below the plane.
        slowest: Speed up to which the body is taken as at rest [m/s]: it slides where it moves faster along
            the plane, and does not rock where it moves slower along the normal, by rotation too.

    Returns:
        An `Identified`, with intervals by the groups of the motions.

    Raises:
        InputError: A robot that is not one free body, contacts that are not on one fixed plane, gravity that
            does not press the body onto it, no recordings or some in which nothing slides, no free parameter,
            one twice, or one of an effect that is switched off.
        UnknownNameError: An unknown parameter or loss.
    """
    free_body(scene, "identify_sliding")
    motions = checked_motions(motions)
    if not motions:
        raise InputError("motions: no recordings given, at least one expected", value=motions)
    kinds = checked_kinds(free, _NAMES)
    names = [name for kind in kinds for name in _NAMES[kind]]
    closed, slowest = above_zero("closed", closed), above_zero("slowest", slowest)
    for kind, effect in (("sliding_friction", "contact friction"), ("gravity", "gravity")):
        if kind in kinds and effect in scene.without:
            raise InputError(f"free: {kind} is free, but the scene is without {effect}", value=kinds)
    axes, body = _axes(scene), Body.of(scene)
    strength, given = float(np.linalg.norm(body.gravity)), axes[:2] @ body.gravity
    pressing = -float(axes[2] @ body.gravity)
    if not pressing > LITTLE * strength:
        raise InputError(
            f"scene: gravity has {0.0 - pressing:+.6g} m/s² along the normal of the plane, so it presses no "
            "body onto it; a negative number is expected, -9.81 for a level plane whose normal points up",
            value=scene,
        )
    slides = _slides_of(scene, motions, body, axes, closed, slowest)
    rows, targets = np.array([slide.rows for slide in slides]), np.array([slide.target for slide in slides])
    known: dict[str, Any] = dict(measure="slides", rows=digests(rows, targets), slides=len(slides))
    group = group_numbers([slide.label for slide in slides], known["rows"])
    sustained = altered(scene.contacts[0], scene.without).sustained_friction
    place = {name: j for j, name in enumerate(names)}

    def parts(x: Array) -> tuple[float, Array, float]:
        mu = x[place["sliding_friction"]] if "sliding_friction" in place else sustained
        tangential = x[[place["gravity:t1"], place["gravity:t2"]]] if "gravity:t1" in place else given
        return mu, tangential, float(np.sqrt(strength**2 - tangential @ tangential))

    def residual(x: Array) -> Array:
        mu, tangential, normal = parts(x)
        return rows @ [*tangential, mu * normal, mu] - targets

    def jacobian(x: Array) -> Array:
        mu, tangential, normal = parts(x)
        slopes = np.zeros((4, len(names)))
        if "sliding_friction" in place:
            slopes[2:, place["sliding_friction"]] = normal, 1.0
        if "gravity:t1" in place:
            columns = [place["gravity:t1"], place["gravity:t2"]]
            slopes[:2, columns], slopes[2, columns] = np.eye(2), -mu / normal * tangential
        return rows @ slopes

    bounds = dict(zip(names, _bounds(names, given, strength), strict=True))
    setters = {"sliding_friction": set_coefficient, "gravity": _set_gravity}
    limits = {"sliding_friction": (0.0, np.inf)}
    return fit(residual, jacobian, bounds, group, loss, limits=limits, setters=setters, **known)


def _bounds(names: Sequence[str], given: Array, strength: float) -> list[tuple[float, float]]:
    """Return the bounds of the parameters: of μ, and of g_t (2,) about the given one.

    The latter are a square about the given g_t, with half the area of the one that just fits into |g_t| < g.
    """
    x, y = np.abs(given).tolist()
    fits = 0.5 * (np.sqrt(2.0 * strength**2 - (x - y) ** 2) - (x + y))
    width = float(fits / np.sqrt(2.0))
    around = dict(zip(_NAMES["gravity"], given.tolist(), strict=True))
    return [(around[name] - width, around[name] + width) if name in around else (0.0, 2.0) for name in names]


def _axes(scene: Scene) -> Array:
    """Return the axes t₁, t₂, n (3, 3) of the one fixed plane of all contacts."""
    planes = [contact.plane for contact in scene.contacts]
    if len(planes) < 3 or any(
        not isinstance(plane, Plane) or plane.body is not None or plane != planes[0] for plane in planes
    ):
        raise InputError(
            "scene: at least three contacts with one plane that is fixed in the world are expected",
            value=scene,
        )
    if planes[0] != planes[0].at_rest() and "moving surfaces" not in scene.without:
        raise InputError("scene: its plane moves; identify_sliding needs one at rest", value=planes[0])
    data, q = scene.model.createData(), np.array([0.0, 0, 0, 0, 0, 0, 1])
    return contact_geometry(scene.model, data, q, scene.contacts[0]).axes


def _points(scene: Scene) -> Array:
    """Return the contact points (k, 3), or the centres of spheres, in the axes of the body."""
    for contact in scene.contacts:
        if contact.rim > 0.0:
            raise InputError(
                f"scene: the rim {contact.label!r} has no fixed point; give points of it by rim_points=",
                value=scene,
            )
    frames = [scene.model.frames[frame_id(scene.model, contact.frame)] for contact in scene.contacts]
    pairs = zip(frames, scene.contacts, strict=True)
    return np.array([frame.placement.act(np.array(contact.offset)) for frame, contact in pairs])


def _slides_of(
    scene: Scene, motions: Sequence[Motion], body: Body, axes: Array, closed: float, slowest: float
) -> list[_Slide]:
    """Return the slides of all motions, or raise `InputError` if there are none."""
    slides = [
        slide
        for number, motion in enumerate(motions)
        for slide in _slides(scene, motion, body, axes, closed, slowest, number)
    ]
    if not slides:
        third = np.concatenate([np.sort(gaps(scene, motion.q), axis=1)[:, 2] for motion in motions])
        raise InputError(
            f"motions: no body slides on a face for {FRAMES + 2} frames, faster than {slowest:g} m/s, with "
            f"gaps from {-closed:g} m to {closed:g} m; the third smallest is {third.min():.3g} m to "
            f"{third.max():.3g} m",
            value=len(motions),
        )
    return slides


def _slides(
    scene: Scene, motion: Motion, body: Body, axes: Array, closed: float, slowest: float, number: int
) -> list[_Slide]:
    """Return the parts of a motion in which the body slides on a face."""
    rotation, t = Rotation.from_quat(motion.q[:, 3:]), motion.t
    path = (motion.q[:, :3] + rotation.apply(body.lever) - motion.q[0, :3]) @ axes.T
    near = gaps(scene, motion.q)
    arms = _points(scene) - body.lever
    velocity = np.gradient(path, t, axis=0)
    spin = (rotation[1:] * rotation[:-1].inv()).as_rotvec() / np.diff(t)[:, None] @ axes.T
    rocking = np.linalg.norm(arms, axis=1).max() * np.hypot(*np.vstack([spin, spin[-1:]]).T[:2])
    lowest, _, third = np.sort(near, axis=1)[:, :3].T
    slides = (lowest > -closed) & (third < closed) & (np.hypot(*velocity.T[:2]) > slowest)
    slides &= np.maximum(np.abs(velocity[:, 2]), rocking) < slowest
    # where the slip of a contact turns by more than 90° at a frame, the frames do not show when it did
    levers = np.einsum("ai,nij,kj->nka", axes[:2], rotation.as_matrix(), arms)
    steps = np.diff(path[:, None, :2] + levers, axis=0)
    slides[1:-1] &= ~(((steps[1:] * steps[:-1]).sum(axis=2) <= 0.0) & (near[1:-1] < closed)).any(axis=1)
    label = motion.label(number)
    found = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], slides.astype(int), [0]])))
    for first, last in edges.reshape(-1, 2):
        kept = slice(first + 1, last - 1)  # those at either end are next to something else
        if last - first >= FRAMES + 2:
            face = near[kept].mean(axis=0) < closed
            # angles of more than half a turn, which rotation vectors do not have
            turns = np.unwrap((rotation[kept] * rotation[first + 1].inv()).as_rotvec() @ axes[2])
            found += _parts(t[kept], path[kept], turns, levers[kept][:, face], label)
    return found


def _parts(t: Array, path: Array, turns: Array, levers: Array, label: Any) -> list[_Slide]:
    """Return a slide as a whole, or in parts whose directions of slip are found."""
    if len(t) < FRAMES:
        return []
    slide = _slide(t, path, turns, levers, label)
    if slide is not None:
        return [slide]
    halves = slice(len(t) // 2), slice(len(t) // 2, None)
    return [one for half in halves for one in _parts(t[half], path[half], turns[half], levers[half], label)]


def _slide(t: Array, path: Array, turns: Array, levers: Array, label: Any) -> _Slide | None:
    """Return the squares of a path (n, 3), of a body that turns by (n,), with contacts at (n, k, 2).

    The directions of slip follow from smooth velocities. Those of a parabola through the path are wrong where
    the path turns, so they are replaced by those of the path by (I10) with the last directions, until these
    agree; None if they do not.
    """
    dt = t - t.mean()
    rate = Polynomial.fit(dt, turns, 3).deriv()(dt)
    spin = rate[:, None, None] * levers[:, :, ::-1] * [-1.0, 1.0]
    velocity = np.column_stack([Polynomial.fit(dt, along, 2).deriv()(dt) for along in path[:, :2].T])
    line, lift = np.vander(dt, 2), np.gradient(path[:, 2], t)
    start = np.linalg.pinv(line)
    out = np.eye(len(dt)) - line @ start  # start and velocity of each slide are free
    target = (out @ path[:, :2]).ravel()
    bends, speeds = np.zeros((2, len(dt), 2, 4))
    for k in range(2):
        bends[:, k, k], speeds[:, k, k] = 0.5 * dt**2, dt
    last = np.full((len(dt), 2), np.inf)
    for _ in range(PASSES):
        slip = velocity[:, None, :] + spin
        opposed = -(slip / np.linalg.norm(slip, axis=2)[:, :, None]).mean(axis=1)
        change, last = float(np.abs(opposed - last).mean()), opposed
        if change < LITTLE:
            break
        for column, normal in ((2, t), (3, lift)):  # normal momentum by gravity and motion
            steps = 0.5 * (opposed[1:] + opposed[:-1]) * np.diff(normal)[:, None]
            speeds[1:, :, column] = np.cumsum(steps, axis=0)
            bends[:, :, column] = cumulative_trapezoid(speeds[:, :, column], t, axis=0, initial=0.0)
        columns = np.einsum("mn,nij->mij", out, bends).reshape(-1, 4)
        sizes = np.maximum(np.linalg.norm(columns[:, :3], axis=0), TINY)
        own = np.zeros(4)  # of this slide alone; straight ones determine only a sum
        own[:3] = np.linalg.lstsq(columns[:, :3] / sizes, target, rcond=HALF_DIGITS)[0] / sizes
        velocity = speeds @ own + start[0] @ (path[:, :2] - bends @ own)
    if change > AGREED:
        return None
    basis, rows = np.linalg.qr(columns)
    return _Slide(rows, basis.T @ target, label)


def _set_gravity(scene: Scene, name: str, value: float) -> Scene:
    """Return the scene with a tangential component of gravity, of the same size."""
    axes, model = _axes(scene), scene.model.copy()
    own = axes @ model.gravity.linear
    square = own @ own
    own[_NAMES["gravity"].index(name)] = value
    along = own[:2] @ own[:2]
    if along > square or own[2] > 0.0:
        raise InputError(
            f"scene: gravity of {np.sqrt(along):.6g} m/s² along the plane was fitted, but that of the scene "
            f"is {np.sqrt(square):.6g} m/s², {own[2]:+.6g} m/s² along the normal; give the scene of the fit",
            value=scene,
        )
    own[2] = -np.sqrt(square - along)
    model.gravity.linear = own @ axes
    return replace(scene, model=model)
