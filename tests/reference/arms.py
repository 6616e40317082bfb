"""Contact-space problems of small arms in multiple precision.

An arm of one to three joints is on a base of any orientation; its tip is in contact with a plane of any
normal. Its axes are parallel, or each link is rotated relative to the previous one. Inputs are the doubles of
the URDF; rotations, Jacobian and mass matrix are computed with `mpmath`. W = FFᵀ and v = Fr have exactly the
rank of the mechanism.
"""

from __future__ import annotations

from dataclasses import dataclass

import mpmath as mp
from mpmath import mpf

MASS, REACH, LENGTH, CENTRE, INERTIA = 1.25, 0.375, 0.5, 0.25, 0.03125
"""Mass of each link [kg], distances of the tip, the next joint and the centre of mass from its joint [m], and
moment of inertia about the centre of mass [kg m²]."""

_BITS = 80
"""Precision to which F and r are rounded, so that W and v are exact in the precision of the reference."""


@dataclass(frozen=True)
class Arm:
    """An arm at an impact.

    Attributes:
        rpy: Roll, pitch and yaw of the base [rad].
        normal: Normal of the plane.
        q, v: One to three angles and their rates.
        twists: Roll, pitch and yaw of each further joint relative to the previous one [rad]; empty for
            parallel axes.
    """

    rpy: tuple[float, float, float]
    normal: tuple[float, float, float]
    q: tuple[float, ...]
    v: tuple[float, ...]
    twists: tuple[tuple[float, float, float], ...] = ()

    def __post_init__(self) -> None:
        for name in ("rpy", "normal", "q", "v"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))

    def urdf(self) -> str:
        """Return the arm as URDF; its last frame is ``tip``."""
        text = '<robot name="arm"><link name="world"/>'
        parent, place = "world", f'rpy="{self.rpy[0]!r} {self.rpy[1]!r} {self.rpy[2]!r}" xyz="0 0 0"'
        for i in range(len(self.q)):
            text += (
                f'<link name="link{i}"><inertial><origin xyz="{CENTRE} 0 0"/><mass value="{MASS}"/>'
                f'<inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/>'
                f'</inertial></link><joint name="joint{i}" type="revolute"><parent link="{parent}"/>'
                f'<child link="link{i}"/><origin {place}/><axis xyz="0 0 1"/>'
                '<limit lower="-9" upper="9" effort="9" velocity="99"/></joint>'
            )
            turned = " ".join(repr(x) for x in (*self.twists, *[(0, 0, 0)] * 3)[i])
            parent, place = f"link{i}", f'rpy="{turned}" xyz="{LENGTH} 0 0"'
        return text + (
            f'<link name="tip"/><joint name="end" type="fixed"><parent link="{parent}"/><child link="tip"/>'
            f'<origin xyz="{REACH} 0 0"/></joint></robot>'
        )

    def contact_problem(self, aligned: float = 0.0, digits: int = 60) -> tuple[list[list[mpf]], list[mpf]]:
        """Return W (3, 3) and v (3,) in contact axes, and these axes (3, 3).

        Args:
            aligned: Angle between the arm and the plane or its normal up to which it is taken as zero, since
                π/2 is not a double. The tangent axes are then along and across the arm.
            digits: Precision.
        """
        if self.twists:
            return self._spatial(digits)
        with mp.workdps(digits):
            plane = _axes(self.normal) * _rotation(self.rpy)[:, 0:2]  # axes of the arm in contact axes
            jacobian, mass = self._planar()
            across = mp.matrix([mp.fsum(r) for r in _cross(plane[:, 0], plane[:, 1])])
            turn = mp.eye(3)
            tangential = mp.hypot(across[0], across[1])
            if tangential < aligned:
                plane[2, :] = mp.zeros(1, 2)
            elif abs(across[2]) < aligned:
                d1, d2 = across[0] / tangential, across[1] / tangential
                turn = mp.matrix([[d2, -d1, 0], [d1, d2, 0], [0, 0, 1]])
                plane = turn * plane
                plane[1, :] = mp.zeros(1, 2)
            if len(self.q) == 1:
                plane, rates = _snapped(plane * jacobian, aligned), mp.matrix(self.v)
                lower = mp.matrix([[1 / mp.sqrt(mass[0, 0])]])
            else:
                rates = jacobian * mp.matrix(self.v)
                lower = mp.cholesky(jacobian * mp.inverse(mass) * jacobian.T)
            factor, made = (plane * lower).apply(_rounded), mp.lu_solve(lower, rates).apply(_rounded)
        with mp.workprec(400):
            return (factor * factor.T).tolist(), list(factor * made), turn.tolist()

    def _spatial(self, digits: int) -> tuple[list[list[mpf]], list[mpf]]:
        """Return the result of `contact_problem` for axes that are not parallel."""
        n = len(self.q)
        with mp.workdps(digits):
            turn, place = _rotation(self.rpy), mp.matrix([0, 0, 0])
            joints, axes, centres = [], [], []
            for i in range(n):
                joints.append(place)
                axes.append(turn[:, 2])
                turn = turn * _rotation((0.0, 0.0, self.q[i]))
                centres.append(place + turn * mp.matrix([mpf(CENTRE), 0, 0]))
                tip = place + turn * mp.matrix([mpf(REACH), 0, 0])
                place = place + turn * mp.matrix([mpf(LENGTH), 0, 0])
                turn = turn * _rotation((*self.twists, (0.0, 0.0, 0.0))[i])

            def jacobian(point: mp.matrix, last: int) -> mp.matrix:
                columns = mp.zeros(3, n)
                for j in range(last + 1):
                    columns[:, j] = mp.matrix([mp.fsum(r) for r in _cross(axes[j], point - joints[j])])
                return columns

            mass = mp.zeros(n)
            for i in range(n):
                J, turning = jacobian(centres[i], i), mp.zeros(3, n)
                for j in range(i + 1):
                    turning[:, j] = axes[j]
                mass += mpf(MASS) * J.T * J + mpf(INERTIA) * turning.T * turning
            lower = mp.cholesky(mass)
            rows = _axes(self.normal) * jacobian(tip, n - 1)
            factor = (rows * mp.inverse(lower).T).apply(_rounded)
            made = (lower.T * mp.matrix(self.v)).apply(_rounded)
        with mp.workprec(400):
            return (factor * factor.T).tolist(), list(factor * made), mp.eye(3).tolist()

    def _planar(self) -> tuple[mp.matrix, mp.matrix]:
        """Return the (2, n) Jacobian of the tip in the arm's plane, and its mass matrix."""
        n = len(self.q)
        angles = [mp.fsum(mpf(x) for x in self.q[: i + 1]) for i in range(n)]
        along = [mp.matrix([mp.cos(a), mp.sin(a)]) for a in angles]
        joints = [mp.matrix([0, 0])]
        for i in range(n - 1):
            joints.append(joints[i] + mpf(LENGTH) * along[i])

        def jacobian(point: mp.matrix, last: int) -> mp.matrix:
            columns = [point - joints[j] if j <= last else mp.matrix([0, 0]) for j in range(n)]
            return mp.matrix([[-r[1] for r in columns], [r[0] for r in columns]])

        mass = mp.zeros(n)
        for i in range(n):
            J = jacobian(joints[i] + mpf(CENTRE) * along[i], i)
            turning = mp.matrix([[1 if j <= i else 0 for j in range(n)]])
            mass += mpf(MASS) * J.T * J + mpf(INERTIA) * turning.T * turning
        return jacobian(joints[-1] + mpf(REACH) * along[-1], n - 1), mass


def _cross(x: mp.matrix, y: mp.matrix) -> list[tuple[mpf, mpf]]:
    """Return the terms of x × y."""
    return [
        (x[1] * y[2], -x[2] * y[1]),
        (x[2] * y[0], -x[0] * y[2]),
        (x[0] * y[1], -x[1] * y[0]),
    ]


def _snapped(x: mp.matrix, angle: float) -> mp.matrix:
    """Return a vector in contact axes, aligned with the normal or the plane if within an angle of it."""
    tangential = mp.hypot(x[0], x[1])
    size = mp.hypot(tangential, x[2])
    if abs(x[2]) < angle * size:
        return mp.matrix([x[0], x[1], 0]) * (size / tangential)
    if tangential < angle * size:
        return mp.matrix([0, 0, mp.sign(x[2]) * size])
    return x


def _rounded(x: mpf) -> mpf:
    with mp.workprec(_BITS):
        return +x


def _rotation(rpy: tuple[float, float, float]) -> mp.matrix:
    """Return R_z(yaw) R_y(pitch) R_x(roll)."""
    (cr, sr), (cp, sp), (cy, sy) = (mp.cos_sin(mpf(x)) for x in rpy)
    about_x = mp.matrix([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = mp.matrix([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = mp.matrix([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z * about_y * about_x


def _axes(normal: tuple[float, float, float]) -> mp.matrix:
    """Return t₁, t₂, n as rows: x, y, z rotated by the smallest rotation from z to n."""
    x, y, z = (mpf(c) for c in normal)
    size = mp.sqrt(x * x + y * y + z * z)
    x, y, z = x / size, y / size, z / size
    share = 1 / (1 + z)
    return mp.matrix(
        [[1 - x * x * share, -x * y * share, -x], [-x * y * share, 1 - y * y * share, -y], [x, y, z]]
    )
