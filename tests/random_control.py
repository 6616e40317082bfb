"""Random robots under joint PD control above a plane, and checks of the energy of their motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pinimpact import Contact, JointPD, Scene, Trajectory, load_robot
from pinimpact.scene.records import SteppedInterval

from .random_scenes import plane_below, relative_energy_residual

DURATION = 1.0
FEET = ("left_sole_link", "right_sole_link")
TIPS = {
    "panda": ("panda_hand_tcp", "panda_link6"),
    "ur5": ("tool0", "wrist_1_link"),
    "xarm7": ("link_eef", "link6"),
    "finger_edu": ("finger_tip_link",),
    "solo12": ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"),
    "talos": tuple(f"{foot} {x:+d}{y:+d}" for foot in FEET for x in (-1, 1) for y in (-1, 1)),
}
FASTEST = {"function": 3e3, "sampled": 0.3, "JointPD": 1e6}
"""Largest natural frequency and decay rate [1/s] of each kind of control; for "sampled", times the period."""


def _robots() -> dict[str, tuple[pin.Model, np.ndarray]]:
    """Return each model with the configuration about which initial and reference ones are drawn."""
    robots = {}
    for name in TIPS:
        robot = load_robot(name)
        model = robot.model
        if name == "talos":
            for corner in TIPS[name]:
                foot, signs = corner.split()
                sole = model.frames[model.getFrameId(foot)]
                offset = np.array([0.1 * int(signs[:2]), 0.06 * int(signs[2:]), 0.0])
                placement = sole.placement * pin.SE3(np.eye(3), offset)
                model.addFrame(pin.Frame(corner, sole.parentJoint, placement, pin.FrameType.OP_FRAME))
        robots[name] = model, pin.normalize(model, robot.q0)
    return robots


ROBOTS = _robots()


@dataclass(frozen=True, eq=False)
class Run:
    """Arguments of `simulate` drawn by a seed, with a description in `name`."""

    name: str
    scene: Scene
    q: np.ndarray
    v: np.ndarray
    rtol: float


def draw(seed: int) -> Run:
    """Return a robot above its plane, under a PD control as a function, sampled, or built in."""
    rng = np.random.default_rng(seed)
    robot = str(rng.choice(list(TIPS), p=[0.2, 0.2, 0.2, 0.1, 0.2, 0.1]))
    model, q0 = ROBOTS[robot]
    model = model.copy()
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    spread = 0.05 if robot == "talos" else 0.3
    q, reference = (pin.integrate(model, q0, spread * rng.normal(size=model.nv)) for _ in range(2))
    bounded = (np.abs(lower) < 1e3) & (np.abs(upper) < 1e3) & (upper > lower)
    q[bounded] = np.clip(q[bounded], lower[bounded] + 1e-3, upper[bounded] - 1e-3)
    q = pin.normalize(model, q)  # a quaternion has bounds too
    joints = np.ones(model.nv, dtype=bool)
    joints[: 6 * (model.joints[1].nv == 6)] = False
    if rng.random() < 0.6:
        model.friction = joints * 10 ** rng.uniform(-2.0, 0.5)

    plane = plane_below(rng, model, q, TIPS[robot], (0.3, 0.1), lambda: 10 ** rng.uniform(-4.0, -1.0))
    friction, restitution = rng.choice([0.0, 0.2, 0.5, 0.8, 1.2]), rng.choice([0.0, 0.0, 0.3, 0.6, 0.9])
    contacts = [Contact(tip, plane, friction=friction, restitution=restitution) for tip in TIPS[robot]]

    kind = str(rng.choice(list(FASTEST)))
    period = 10 ** rng.uniform(-3.0, -2.0)
    kp, kd = _gains(rng, model, q, joints, FASTEST[kind] / (period if kind == "sampled" else 1.0))
    limit = rng.choice([np.inf, 10 ** rng.uniform(0.0, 2.0)])
    if kind == "JointPD":
        control, options = JointPD(kp, kd, reference, limit), {}
    else:

        def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
            return kp * pin.difference(model, q, reference) - kd * v

        options = {"period": period, "delay": rng.choice([0.0, 0.5]) * period} if kind == "sampled" else {}
    scene = Scene(
        model,
        contacts,
        control=control,
        without=["joint limits"] if rng.random() < 0.3 else [],
        limit_restitution=float(rng.choice([0.0, 0.5])),
        **options,
    )
    v = rng.choice([0.0, 0.2, 1.0]) * rng.normal(size=model.nv)
    words = f"{robot}, {kind}, μ = {friction}, e = {restitution}, dry {model.friction[-1]:.2g}"
    return Run(words, scene, q, v, float(10 ** rng.uniform(-8.0, -4.0)))


def _gains(
    rng: np.random.Generator, model: pin.Model, q: np.ndarray, joints: np.ndarray, fastest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return stiffness and damping (nv,) with natural frequencies and decay rates up to `fastest` [1/s]."""
    kp = joints * 10 ** rng.uniform(0.0, 3.0)
    kd = kp * 10 ** rng.uniform(-2.5, -0.5)
    data = model.createData()
    minverse = pin.computeMinverse(model, data, q)
    minverse = np.triu(minverse) + np.triu(minverse, 1).T
    stiff, damped = (np.linalg.eigvalsh(np.sqrt(k)[:, None] * minverse * np.sqrt(k)).max() for k in (kp, kd))
    return kp * min(1.0, fastest**2 / stiff), kd * min(1.0, fastest / damped)


def _ends(t: np.ndarray, interval: SteppedInterval) -> tuple[int, int]:
    """Return the samples at the start and at the end of an interval."""
    return int(np.searchsorted(t, interval.start)), int(np.searchsorted(t, interval.end, side="right")) - 1


def violation_in(trajectory: Trajectory, rtol: float) -> str:
    """Return the violated energy law of a motion, or an empty string.

    As all surfaces are fixed, friction of joints and contacts must not add energy beyond the tolerance. The
    energy must balance.
    """
    energy = trajectory.energy
    size, t = energy.kinetic.max() + 1.0, trajectory.t
    located = np.full(len(t), True)  # time steps count part of the work of friction as that of an impact
    for one in trajectory.stepped:
        located &= (t < one.start) | (t > one.end)
        gained = np.diff((energy.joints + energy.friction + energy.impacts)[[*_ends(t, one)]])[0] / size
        if gained > 10.0 * rtol + np.nan_to_num(one.error):
            return f"friction and impacts gain {gained:.2g} of the energy in time steps"
    for name, work in (("joints", energy.joints), ("contacts", energy.friction)):
        gained = float(np.diff(work, prepend=0.0)[located].max(initial=0.0)) / size
        if gained > 10.0 * rtol:
            return f"the {name} gain {gained:.2g} of the energy by friction"
    missing = relative_energy_residual(trajectory)
    return f"relative energy residual {missing:.2g}" if missing > 1e4 * rtol else ""
