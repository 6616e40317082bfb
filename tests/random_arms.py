"""Impacts of random arms of one to three joints against multiple precision.

Most arms are planar, others have axes of any direction. Bases have random orientations, or are within
1e-15 … 1e-3 of an alignment. Some tips move parallel to the plane, and some contact velocities are small by
cancellation. Some arms are weak in two directions: two eigenvalues of W are small.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import mpmath as mp
import numpy as np
import pinocchio as pin

from pinimpact import LAWS, Contact, Flag, PinimpactError, Plane, impact

from .reference.arms import Arm
from .reference.reference import UnsupportedProblemError, solve_reference

EPS = 2.0**-52
ALLOWED = 8.0
"""Ratio of disagreement to sensitivity above which there is a violation."""
RESOLVED = 1e-12
"""Angle that the package need not distinguish from zero [rad], so that both solutions are accepted. It is
larger by the ratio of the roots of the eigenvalues of W, as in `resolved`."""
NEARLY = (-6.0, -2.0)
"""Range of the exponents of ten of the angles between some arms and a singular posture."""
FAINT = (-13.0, -3.0)
"""The same for both small angles of arms that are weak in two directions; below about 1e-14 they would be
rounding errors, so the reference would depend on digits that doubles do not have."""
WEAK = 0.1
"""Fraction of the arms that are weak in two directions."""
SCALE = 10.0
"""Ratio of the numbers from which the factor of W is computed to the factor, for arms of three links."""
ANSWERED = ("SEPARATED", "ENDED_AT_REST", "LOCKED", "NO_IMPACT")
TRIALS = (4, 60)
"""Number of perturbations of each impact, and of one that would be a violation otherwise."""


@dataclass(frozen=True)
class Case:
    """An impact of an arm."""

    kind: str
    arm: Arm
    friction: float
    restitution: float
    law: str


def _rotation(rpy):
    return pin.rpy.rpyToMatrix(*rpy)


def _any(rng, arm, tilt):
    return arm.rpy, tuple(rng.standard_normal(3))


def _upright(rng, arm, tilt):
    """Return a base whose arm moves within `tilt` of a vertical plane, and the normal of the floor."""
    return (np.pi / 2 + tilt, 0.0, float(rng.choice([0.0, rng.uniform(-3, 3)]))), (0.0, 0.0, 1.0)


def _parallel(rng, arm, tilt):
    """Return a normal that differs from the axis of the joints by `tilt`."""
    normal = _rotation(arm.rpy) @ [np.sin(tilt), 0.0, np.cos(tilt)]
    return arm.rpy, tuple(normal)


def _twisted(rng, arm, tilt):
    return arm.rpy, tuple(rng.standard_normal(3))


KINDS = {"any": _any, "upright": _upright, "parallel": _parallel, "twisted": _twisted}


def twist(rng: np.random.Generator) -> tuple[float, float, float]:
    """Draw the orientation of a link relative to the previous one: any, or by right angles as in robots."""
    right = (np.pi / 2 * rng.choice([-1, 1]), np.pi / 2 * rng.choice([-1, 0, 1]), 0.0)
    return tuple(map(float, rng.uniform(-2, 2, 3) if rng.random() < 0.5 else right))


def faint(rng: np.random.Generator, *shape: int):
    """Draw small angles of either sign and independent magnitudes."""
    return rng.choice([-1, 1], shape) * 10.0 ** rng.uniform(*FAINT, shape)


SURE, UNSURE = ("floor", "axes"), ("normal", "upright")
"""Reasons why an arm is weak in two directions. In the unsure cases the second direction is tangential, and
its entry in W is a product of two small angles below rounding errors: its impulse is not compared."""


def weak(rng: np.random.Generator, joints: int, reasons: tuple[str, ...]) -> tuple[str, Arm]:
    """Draw a nearly stretched arm that is weak in two directions, and return the reason and the arm.

    A small angle separates its plane from the floor, from the normal, or from standing upright on the floor,
    or the axes of its joints from each other.
    """
    why = str(rng.choice(reasons))
    rpy = rng.uniform(-1.5, 1.5, 3) if rng.random() < 0.7 else np.zeros(3)
    first, lean = rng.uniform(-2, 2), float(faint(rng))
    normals = {
        "floor": [np.sin(lean), 0.0, np.cos(lean)],
        "normal": [np.cos(first + lean), np.sin(first + lean), rng.choice([0.0, float(faint(rng))])],
        "upright": [np.cos(a := rng.uniform(-3, 3)), np.sin(a), np.sin(lean)],
        "axes": rng.standard_normal(3),
    }
    twists = ()
    if why == "axes":
        twists = tuple((*faint(rng, 2).tolist(), 0.0) for _ in range(joints - 1))
    normal = _rotation(rpy) @ normals[str(rng.choice([*SURE])) if why == "axes" else why]
    rest = (0.0,) * (joints - 1)
    return why, Arm(tuple(rpy), tuple(normal), (first, *rest), (0.0, *rest), twists)


def draw_weak(rng: np.random.Generator) -> Case:
    """Draw an impact of an arm that is weak in two directions."""
    joints = int(rng.integers(2, 4))
    why, arm = weak(rng, joints, SURE)
    q, v = (arm.q[0], *faint(rng, joints - 1).tolist()), rng.standard_normal(joints)
    arm = replace(arm, q=q, v=tuple(v))
    if float(arm.contact_problem()[1][2]) > 0:
        arm = replace(arm, v=tuple(-v))
    e = float(rng.choice([0.0, 1.0, rng.random()]))
    return Case(f"weak, {why}", arm, float(10.0 ** rng.uniform(-1.5, 1)), e, str(rng.choice(LAWS)))


def draw(rng: np.random.Generator) -> Case:
    """Draw an impact with an approaching velocity."""
    if rng.random() < WEAK:
        return draw_weak(rng)
    kind = str(rng.choice(list(KINDS)))
    joints = int(rng.integers(1, 4))
    rpy = tuple(rng.uniform(-1.5, 1.5, 3).tolist())
    stretched = kind != "twisted" and rng.random() < 0.2
    tilt = float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(-15, -3)) if rng.random() < 0.7 else 0.0
    q, v = rng.uniform(-2, 2, joints), rng.standard_normal(joints)
    if stretched:
        q[1:] = 10.0 ** rng.uniform(*NEARLY, joints - 1)
    arm = Arm(rpy, (0.0, 0.0, 1.0), tuple(q.tolist()), tuple(v.tolist()))
    rpy, normal = KINDS[kind](rng, arm, tilt)
    twists = tuple(twist(rng) for _ in range(joints - 1)) if kind == "twisted" else ()
    arm = Arm(tuple(map(float, rpy)), tuple(map(float, normal)), arm.q, arm.v, twists)
    if kind == "upright" and rng.random() < 0.4:
        if joints == 1:  # the tip straight below the base
            arm = Arm(arm.rpy, arm.normal, (-np.pi / 2,), arm.v)
        else:  # the tip comes straight down
            J = np.array(arm._planar()[0].tolist(), dtype=float)
            arm = Arm(arm.rpy, arm.normal, arm.q, tuple((np.linalg.pinv(J) @ [0.0, -1.0]).tolist()))
    elif kind != "twisted" and joints == 3 and rng.random() < 0.4:
        J = np.array(arm._planar()[0].tolist(), dtype=float)
        still = np.linalg.svd(J)[2][2]
        v = still + 10.0 ** rng.uniform(-8, -1) * v
        arm = Arm(arm.rpy, arm.normal, arm.q, tuple(v.tolist()))
    if float(arm.contact_problem()[1][2]) > 0:
        arm = Arm(arm.rpy, arm.normal, arm.q, tuple(-x for x in arm.v), arm.twists)
    e = float(rng.choice([0.0, 1.0, rng.random()]))
    return Case(f"{kind}, {tilt:.0e}", arm, float(10.0 ** rng.uniform(-1.5, 1)), e, str(rng.choice(LAWS)))


def solve(case: Case):
    """Return the package's `Hit`."""
    arm = case.arm
    model = pin.buildModelFromXML(arm.urdf())
    contact = Contact("tip", Plane(normal=arm.normal), case.friction, case.restitution, case.law)
    return impact(model, model.createData(), np.array(arm.q), np.array(arm.v), contact)


def perturbed(rng: np.random.Generator, case: Case) -> Case:
    """Return the impact with perturbations of a few rounding errors of the robot's numbers."""

    def shaken(x):
        return tuple((np.array(x) + 8 * EPS * rng.uniform(-1, 1, len(x))).tolist())

    arm = case.arm
    scale = max(abs(x) for x in arm.v)
    rates = tuple((np.array(arm.v) + 8 * EPS * scale * rng.uniform(-1, 1, len(arm.v))).tolist())
    twists = tuple(shaken(twist) for twist in arm.twists)
    changed = Arm(shaken(arm.rpy), shaken(arm.normal), shaken(arm.q), rates, twists)
    mu = case.friction * (1 + 8 * EPS * rng.uniform(-1, 1))
    return Case(case.kind, changed, mu, case.restitution, case.law)


@dataclass
class Report:
    """Results of a run.

    Attributes:
        worst: Largest ratio of disagreement to sensitivity.
        violations: Messages and impacts.
        impacts: Number of impacts.
        uncovered: Number of impacts that the reference does not support.
        refused: Number of impacts that raise an error.
    """

    worst: float = 0.0
    violations: list[tuple[str, Case]] = field(default_factory=list)
    impacts: int = 0
    uncovered: int = 0
    refused: int = 0


def resolved(case: Case) -> float:
    """Return the smallest angle that a factor of W in double precision resolves.

    It is 64 ε times `SCALE` times the ratio of the roots of the largest and smallest nonzero eigenvalues.
    """
    with mp.workdps(60):
        values = mp.eigsy(mp.matrix(case.arm.contact_problem()[0]), eigvals_only=True)
        roots = [float(mp.sqrt(abs(x))) for x in values]
    return max(RESOLVED, 64 * EPS * SCALE * max(roots) / min(x for x in roots if x > 1e-11 * max(roots)))


def check(rng: np.random.Generator, case: Case, report: Report) -> None:
    """Compare an impact with the reference, and add the result to the report."""
    report.impacts += 1
    found = {}
    try:
        for aligned in (0.0, resolved(case)):
            W, v, axes = case.arm.contact_problem(aligned)
            exact = solve_reference(W, v, case.friction, case.restitution, case.law)
            found[aligned] = exact, np.array(axes, dtype=float)
    except UnsupportedProblemError:
        report.uncovered += 1
        return
    answers = [
        (
            np.concatenate([np.array(part, dtype=float) @ axes for part in (x.velocity, x.impulse)]),
            4 * aligned,
        )
        for aligned, (x, axes) in found.items()
        if x.status in ANSWERED
    ]
    try:
        hit = solve(case)
    except PinimpactError as raised:
        report.refused += 1
        if len(answers) == len(found):
            report.violations.append((f"refused: {raised}", case))
        return
    scale = hit.problem.velocity_scale
    here = np.concatenate([hit.solution.velocity, hit.solution.impulse])

    def gap(other):
        size = max(np.abs(here[3:]).max(), np.abs(other[3:]).max(), 1e-300)
        change = np.abs(here - other)
        return max(change[:3].max() / scale, change[3:].max() / size)

    error = min((max(gap(other) - slack, 0.0) for other, slack in answers), default=np.inf)
    sensitivity, trials = 8 * EPS, 0
    for most in TRIALS:
        while trials < most and error > ALLOWED * sensitivity:
            trials += 1
            try:
                other = solve(perturbed(rng, case)).solution
            except PinimpactError:
                sensitivity = np.inf
                break
            sensitivity = max(sensitivity, gap(np.concatenate([other.velocity, other.impulse])))
    # arms that are weak in two directions may depend on rounding errors, if flagged
    flagged = case.kind.startswith("weak") and Flag.NEAR_JUMP in hit.solution.flags
    if not flagged:
        report.worst = max(report.worst, error / sensitivity)
    if error > ALLOWED * sensitivity and not flagged:
        expected = [(x.status, x.flags) for x, _ in found.values()]
        what = f"error {error:.2g}, sensitivity {sensitivity:.2g}; {expected} {hit.solution.flags!r}"
        report.violations.append((what, case))


def run(seed: int, count: int) -> Report:
    """Check `count` impacts."""
    report = Report()
    rng = np.random.default_rng(seed)
    for _ in range(count):
        check(rng, draw(rng), report)
    return report
