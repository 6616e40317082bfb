"""Millions of random impacts of small arms, with checks of mechanics and of invariance under rotation.

The checks of each impact are: it has a solution; v₃⁺ ≥ 0; P is in the friction cone; M(v⁺ − v) = Jᵀ P, with M
and J computed here; energy does not grow, depending on the law; P has no component along horizontal axes of
parallel joints; v⁺ and P are equal, within eight times the effect of rounding errors of the robot's numbers,
if base and plane are rotated together. Impacts that fail the last one are compared with multiple precision,
and so are impulses along axes that differ from horizontal by a few rounding errors.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from pinimpact import LAWS, Contact, Plane, Status, impacts

from . import random_arms
from .random_arms import ALLOWED, EPS, RESOLVED, Case
from .random_impacts import turned as rotations
from .reference.arms import CENTRE, INERTIA, LENGTH, MASS, REACH, Arm

ROWS = 200
"""Number of impacts with the same base, plane and law."""
NOISE = 1e-11
"""Tolerance of the balances for rounding errors, relative to their terms."""
TRIALS = (2, 40)
"""Number of perturbations of each impact, and of one that would be doubtful otherwise."""
ALONG = np.array([1.0, 0.0, 0.0])
SIDEWAYS = "impulse along axes of joints"


@dataclass
class Group:
    """Impacts of one arm.

    Attributes:
        case: Its base, plane and law; state and coefficients are not used.
        tilt: Deviation of the arm's plane from an alignment [rad]; 1 for arms weak in two directions.
        q, v: (N, n) states.
        friction, restitution: (N,) coefficients.
    """

    case: Case
    tilt: float
    q: np.ndarray
    v: np.ndarray
    friction: np.ndarray
    restitution: np.ndarray

    def one(self, k: int) -> Case:
        arm = replace(self.case.arm, q=tuple(self.q[k]), v=tuple(self.v[k]))
        return replace(
            self.case, arm=arm, friction=float(self.friction[k]), restitution=float(self.restitution[k])
        )


@dataclass
class Report:
    """Results of a run; `judged` are the comparisons with multiple precision."""

    impacts: int = 0
    statuses: Counter = field(default_factory=Counter)
    judged: random_arms.Report = field(default_factory=random_arms.Report)
    violations: list[tuple[str, Case]] = field(default_factory=list)


def kinematics(arm: Arm, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the tip's Jacobians (N, 3, n) in world axes and the mass matrices (N, n, n)."""
    count, n = q.shape
    turn = np.tile(pin.rpy.rpyToMatrix(*arm.rpy), (count, 1, 1))
    place, joints, axes, centres = np.zeros((count, 3)), [], [], []
    for i in range(n):
        joints.append(place)
        axes.append(turn[:, :, 2])
        turn = turn @ rotations(q[:, i])
        centres.append(place + CENTRE * turn @ ALONG)
        tip = place + REACH * turn @ ALONG
        place = place + LENGTH * turn @ ALONG
        turn = turn @ pin.rpy.rpyToMatrix(*(*arm.twists, *[(0.0, 0.0, 0.0)] * 3)[i])

    def jacobian(point, last):
        columns = np.zeros((count, 3, n))
        for j in range(last + 1):
            columns[:, :, j] = np.cross(axes[j], point - joints[j])
        return columns

    mass = np.zeros((count, n, n))
    for i in range(n):
        J, turning = jacobian(centres[i], i), np.zeros((count, 3, n))
        for j in range(i + 1):
            turning[:, :, j] = axes[j]
        mass += MASS * J.transpose(0, 2, 1) @ J + INERTIA * turning.transpose(0, 2, 1) @ turning
    return jacobian(tip, n - 1), mass


def singular(arm: Arm, q: np.ndarray) -> np.ndarray:
    """Return q (N, 3) with last angles at a zero of det J, for rows with one between −0.9 and 0.6."""
    low, high = (np.concatenate([q[:, :2], np.full((len(q), 1), x)], axis=1) for x in (-0.9, 0.6))
    sign = np.linalg.det(kinematics(arm, low)[0]) > 0
    found = sign != (np.linalg.det(kinematics(arm, high)[0]) > 0)
    for _ in range(55):
        middle = (low + high) / 2
        below = (np.linalg.det(kinematics(arm, middle)[0]) > 0) == sign
        low, high = np.where(below[:, None], middle, low), np.where(below[:, None], high, middle)
    return np.where(found[:, None], low, q)


def draw(rng: np.random.Generator, count: int) -> Group:
    """Draw impacts of one arm with approaching velocities, as `random_arms.draw` does for single ones."""
    if rng.random() < random_arms.WEAK:
        return draw_weak(rng, count)
    kind = str(rng.choice(list(random_arms.KINDS)))
    n = int(rng.integers(1, 4))
    tilt = float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(-15, -3)) if rng.random() < 0.7 else 0.0
    arm = Arm(tuple(rng.uniform(-1.5, 1.5, 3)), (0.0, 0.0, 1.0), (0.0,) * n, (0.0,) * n)
    rpy, normal = random_arms.KINDS[kind](rng, arm, tilt)
    twists = tuple(random_arms.twist(rng) for _ in range(n - 1)) if kind == "twisted" else ()
    arm = Arm(rpy, normal, arm.q, arm.v, twists)
    q, v = rng.uniform(-2, 2, (count, n)), rng.standard_normal((count, n))
    if rng.random() < 0.2:  # near a singular posture
        miss = 10.0 ** rng.uniform(*random_arms.NEARLY, (count, n))
        if kind != "twisted":
            q[:, 1:] = miss[:, 1:]
        elif n == 3:
            q = singular(arm, q)
            q[:, 2] += 10.0 ** rng.uniform(-10, -2, count)
    special = rng.random(count) < 0.4
    J, _ = kinematics(arm, q)
    if kind == "upright" and n == 1:
        q[special] = -np.pi / 2  # the tip straight below the base
    elif kind == "upright":  # the tip comes straight down
        v[special] = -np.linalg.pinv(J[special], rcond=1e-8)[:, :, 2]
    elif kind != "twisted" and n == 3:  # a contact velocity that is small by cancellation
        small = 10.0 ** rng.uniform(-8, -1, (count, 1))
        v = np.where(special[:, None], np.linalg.svd(J)[2][:, 2] + small * v, v)
    J, _ = kinematics(arm, q)
    v[np.einsum("i,nij,nj->n", np.array(normal), J, v) > 0] *= -1.0
    e = rng.choice([0.0, 1.0, 0.5], count)
    e = np.where(e == 0.5, rng.random(count), e)
    case = Case(f"{kind}, {tilt:.0e}", arm, 0.0, 0.0, str(rng.choice(LAWS)))
    return Group(case, tilt, q, v, 10.0 ** rng.uniform(-1.5, 1, count), e)


def draw_weak(rng: np.random.Generator, count: int) -> Group:
    """Draw impacts of an arm that is weak in two directions, as `random_arms.draw_weak` does."""
    n = int(rng.integers(2, 4))
    why, arm = random_arms.weak(rng, n, (*random_arms.SURE, *random_arms.UNSURE))
    q, v = np.full((count, n), arm.q[0]), rng.standard_normal((count, n))
    q[:, 1:] = random_arms.faint(rng, count, n - 1) / 10.0 ** rng.integers(3)  # also below rounding errors
    J, _ = kinematics(arm, q)
    v[np.einsum("i,nij,nj->n", np.array(arm.normal), J, v) > 0] *= -1.0
    e = np.where(rng.random(count) < 0.5, rng.random(count), rng.choice([0.0, 1.0], count))
    case = Case(f"weak, {why}", arm, 0.0, 0.0, str(rng.choice(LAWS)))
    return Group(case, 1.0, q, v, 10.0 ** rng.uniform(-1.5, 1, count), e)


MODELS = {}


def solve(group: Group):
    """Return the package's `Hits`."""
    arm, n = group.case.arm, group.q.shape[1]
    if n not in MODELS:
        model = pin.buildModelFromXML(replace(arm, q=(0.0,) * n, v=(0.0,) * n, twists=()).urdf())
        MODELS[n] = model, model.createData()
    model, data = MODELS[n]
    for i, rpy in enumerate((arm.rpy, *arm.twists, *[(0.0, 0.0, 0.0)] * (n - 1 - len(arm.twists)))):
        model.jointPlacements[i + 1].rotation = pin.rpy.rpyToMatrix(*rpy)
    contact = Contact("tip", Plane(normal=arm.normal), 0.0, 0.0, group.case.law)
    return impacts(model, data, group.q, group.v, contact, group.friction, group.restitution)


def turned(rng: np.random.Generator, group: Group) -> tuple[Group, np.ndarray]:
    """Return the impacts with arm and plane rotated at random, and the rotation."""
    rotation = pin.rpy.rpyToMatrix(*rng.uniform(-3, 3, 3))
    arm = group.case.arm
    rpy = pin.rpy.matrixToRpy(rotation @ pin.rpy.rpyToMatrix(*arm.rpy))
    changed = replace(arm, rpy=tuple(rpy), normal=tuple(rotation @ arm.normal))
    return replace(group, case=replace(group.case, arm=changed)), rotation


def perturbed(rng: np.random.Generator, group: Group) -> Group:
    """Return the impacts with perturbations of a few rounding errors of the robot's numbers."""

    def noise(*shape):
        return 8 * EPS * rng.uniform(-1, 1, shape)

    case = random_arms.perturbed(rng, group.case)
    v = group.v + noise(*group.v.shape) * np.abs(group.v).max(axis=1, keepdims=True)
    friction = group.friction * (1 + noise(len(group.friction)))
    case = replace(case, friction=group.case.friction)
    return replace(group, case=case, q=group.q + noise(*group.q.shape), v=v, friction=friction)


def difference(group: Group, one, other, rotation=None) -> np.ndarray:
    """Return the largest change (N,) of v⁺ and P over their scales; infinite if only one has a solution."""
    impulse = other.impulse_world if rotation is None else other.impulse_world @ rotation
    speed = np.abs(group.v).max(axis=1) + np.abs(one.v).max(axis=1)
    size = np.abs(one.impulse_world).max(axis=1) + np.abs(impulse).max(axis=1) + 1e-300
    gap = np.abs(one.v - other.v).max(axis=1) / speed
    gap = np.maximum(gap, np.abs(one.impulse_world - impulse).max(axis=1) / size)
    return np.where(np.isfinite(gap), gap, np.inf)


def mechanics(group: Group, hits) -> dict[str, np.ndarray]:
    """Return which impacts violate which law of mechanics."""
    arm, law = group.case.arm, group.case.law
    J, mass = kinematics(arm, group.q)
    normal = np.array(arm.normal) / np.linalg.norm(arm.normal)
    P, change = hits.impulse_world, hits.v - group.v
    along = P @ normal
    sideways = np.linalg.norm(P - along[:, None] * normal, axis=1)
    size = np.abs(P).max(axis=1)
    speeds = np.abs(group.v).max(axis=1) + np.abs(hits.v).max(axis=1)
    approach = np.einsum("i,nij,nj->n", normal, J, hits.v)
    balance = np.abs(np.einsum("nij,nj->ni", mass, change) - np.einsum("nji,nj->ni", J, P)).max(axis=1)
    gained = 0.5 * np.einsum("ni,nij,nj->n", change, mass, hits.v + group.v)
    delassus = J @ np.linalg.solve(mass, J.transpose(0, 2, 1))
    values = np.linalg.eigvalsh(delassus)
    counted = np.where(values > 1e-13 * values[:, 2:], values, np.inf).min(axis=1)
    spread = np.sqrt(values[:, 2] / counted)
    noise = np.maximum(NOISE, 64 * EPS * spread)  # error of the directions of W
    # rounding error of the changes by a large impulse, whose parts cancel
    rounding = NOISE * size * np.sqrt(values[:, 2]) * np.sqrt(np.linalg.norm(mass, axis=(1, 2)))
    energy = np.einsum("ni,nij,nj->n", group.v, mass, group.v)
    wrong = {
        "refused": hits.status > Status.LOCKED,
        "approaches": approach < -noise * speeds - NOISE * size * values[:, 2],
        "outside the cone": sideways > group.friction * along + NOISE * size,
        "momentum": balance > NOISE * (size + speeds),
        "energy grows": ((law == "energetic") | (group.restitution == 0))
        & (gained > noise * spread * energy + rounding * np.sqrt(energy)),
    }
    if group.case.kind.startswith("upright") and abs(group.tilt) < 1e-14:  # 0, or a few roundings of the base
        axis = pin.rpy.rpyToMatrix(*arm.rpy)[:, 2]  # of the joints; no motion along it is possible
        whole = np.linalg.norm(J, axis=(1, 2))
        across = np.linalg.norm(J - np.einsum("i,j,njk->nik", normal, normal, J), axis=(1, 2))
        moves = across > 16 * EPS * whole  # tangential motion larger than rounding errors of J
        unsure = np.divide(4 * EPS * whole, across, out=np.zeros_like(whole), where=moves)
        wrong[SIDEWAYS] = np.abs(P @ axis) > np.maximum(noise, unsure) * size
    return wrong


def check(rng: np.random.Generator, group: Group, report: Report) -> None:
    """Solve and check a group of impacts, and add the results to the report."""
    hits = solve(group)
    report.impacts += len(group.q)
    report.statuses.update(hits.status.tolist())
    other, rotation = turned(rng, group)
    gap = difference(group, hits, solve(other), rotation)
    sensitive = np.full(len(gap), 8 * EPS)
    for _ in range(TRIALS[0]):
        sensitive = np.maximum(sensitive, difference(group, hits, solve(perturbed(rng, group))))
    doubtful = gap > ALLOWED * sensitive
    for _ in range(TRIALS[1] if doubtful.any() else 0):
        sensitive = np.maximum(sensitive, difference(group, hits, solve(perturbed(rng, group))))
    doubtful = gap > ALLOWED * sensitive
    wrong = mechanics(group, hits)
    if abs(group.tilt) < RESOLVED:  # both solutions are accepted
        wrong["refused"] &= group.tilt == 0.0
    if group.tilt != 0.0 and SIDEWAYS in wrong:  # a tilt of a few rounding errors may have an effect
        doubtful |= wrong.pop(SIDEWAYS)
    for what, rows in wrong.items():
        report.violations += [(what, group.one(k)) for k in np.flatnonzero(rows)]
    for k in np.flatnonzero(doubtful):
        random_arms.check(rng, group.one(k), report.judged)


def run(seed: int, count: int) -> Report:
    """Check `count` impacts."""
    report = Report()
    rng = np.random.default_rng(seed)
    while report.impacts < count:
        check(rng, draw(rng, min(ROWS, count - report.impacts)), report)
    return report
