"""Robots dropped at random onto planes, without control, and the energy residual of a run."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinimpact import Contact, Plane, Scene, Trajectory, load_robot

TIPS = {
    "panda": ("panda_hand_tcp", "panda_link6"),
    "ur5": ("tool0", "wrist_1_link"),
    "solo12": ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"),
}
MODELS = {name: load_robot(name).model for name in TIPS}
DURATION = 1.0


def plane_below(rng, model, q, tips, tilts, depth) -> Plane:
    """Return a plane under the lowest of some frames.

    Args:
        rng: Random numbers.
        model: The robot.
        q: Its configuration.
        tips: Names of the frames.
        tilts: Probability of a tilt, and its size.
        depth: Function that draws the distance [m].
    """
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    points = np.array([data.oMf[model.getFrameId(tip)].translation for tip in tips])
    normal = np.array([0.0, 0.0, 1.0])
    if rng.random() < tilts[0]:
        normal[:2] = tilts[1] * rng.normal(size=2)
        normal /= np.linalg.norm(normal)
    below = (points @ normal).min() - depth()
    return Plane(point=tuple(below * normal), normal=tuple(normal))


def draw(seed: int) -> tuple[str, Scene, np.ndarray, np.ndarray, float]:
    """Return a robot's name, a scene, a state above its plane, and a tolerance."""
    rng = np.random.default_rng(seed)
    name = str(rng.choice(list(TIPS)))
    model = MODELS[name]
    q = pin.normalize(model, pin.integrate(model, pin.neutral(model), 0.5 * rng.normal(size=model.nv)))
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    bounded = (np.abs(lower) < 1e3) & (np.abs(upper) < 1e3) & (upper > lower)
    q[bounded] = np.clip(q[bounded], lower[bounded] + 1e-3, upper[bounded] - 1e-3)
    if not pin.isNormalized(model, q):  # a quaternion has bounds too
        q = pin.normalize(model, q)
    plane = plane_below(rng, model, q, TIPS[name], (0.5, 0.2), lambda: rng.uniform(1e-3, 0.3))
    friction, restitution = rng.choice([0.0, 0.2, 0.4, 0.8, 1.2]), rng.choice([0.0, 0.0, 0.3, 0.5, 0.9])
    contacts = [Contact(tip, plane, friction=friction, restitution=restitution) for tip in TIPS[name]]
    without = ["joint limits"] if rng.random() < 0.3 else []
    scene = Scene(model, contacts, without=without, limit_restitution=float(rng.choice([0.0, 0.3])))
    v = rng.choice([0.0, 0.5, 2.0]) * rng.normal(size=model.nv)
    return name, scene, q, v, float(10 ** rng.uniform(-8, -3))


def relative_energy_residual(trajectory: Trajectory) -> float:
    """Return the largest energy residual relative to the largest kinetic energy plus 1 J."""
    energy = trajectory.energy
    return float(np.abs(energy.residual).max() / (energy.kinetic.max() + 1.0))
