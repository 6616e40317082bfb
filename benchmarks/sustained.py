"""What sustained contact costs: robots that stand, land and trot, and a box on many corners.

python -m benchmarks.sustained
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin
from benchmarks.scene_cost import free_body
from benchmarks.timing import publish, row

from pinimpact import Contact, JointPD, Plane, Scene, Trajectory, load_robot, simulate

ROUNDS = 3
FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
SOLES = ("left_sole_link", "right_sole_link")
Run = Callable[[], Trajectory]


def on_its_feet(model: pin.Model, q: np.ndarray, frames: list[str]) -> np.ndarray:
    """Return q with the lowest of some frames at z = 0."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    q = q.copy()
    q[2] -= min(data.oMf[model.getFrameId(frame)].translation[2] for frame in frames)
    return q


def quadruped() -> tuple[pin.Model, np.ndarray, list[Contact]]:
    """Return solo12, standing, and its contacts."""
    model = load_robot("solo12").model
    q = pin.neutral(model)
    q[7:] = np.tile([0.0, 0.7, -1.4], 4)
    return model, on_its_feet(model, q, list(FEET)), [Contact(foot, Plane(), friction=0.6) for foot in FEET]


def standing() -> Run:
    """Solo12 stands for 10 s under joint PD."""
    model, q, contacts = quadruped()
    scene = Scene(model, contacts, control=JointPD(20.0, 0.5, q))
    return lambda: simulate(scene, q, np.zeros(model.nv), 10.0, rtol=1e-6, atol=1e-8)


def trotting() -> Run:
    """Solo12 trots in place for 1 s: pairs of legs are drawn up in turn, by a control sampled at 1 kHz."""
    model, q, contacts = quadruped()
    lift = np.array([0.0, 0.35, -0.7])

    def control(t: float, at: np.ndarray, v: np.ndarray) -> np.ndarray:
        target = q[7:].copy()
        phase = np.sin(2.0 * np.pi * 2.0 * t)
        for leg in (0, 3) if phase > 0.0 else (1, 2):
            target[3 * leg : 3 * leg + 3] += abs(phase) * lift
        tau = np.zeros(model.nv)
        tau[6:] = 12.0 * (target - at[7:]) - 0.3 * v[6:]
        return tau

    scene = Scene(model, contacts, control=control, period=1e-3)
    return lambda: simulate(scene, q, np.zeros(model.nv), 1.0, rtol=1e-6, atol=1e-8)


def humanoid() -> Run:
    """Talos stands for 1 s on the corners of its soles, drawn to its posture by joint PD."""
    robot = load_robot("talos")
    model, corners = robot.model, []
    for sole in SOLES:
        frame = model.frames[model.getFrameId(sole)]
        for x in (-0.1, 0.1):
            for y in (-0.06, 0.06):
                placement = frame.placement * pin.SE3(np.eye(3), np.array([x, y, 0.0]))
                corners.append(f"{sole} {x:+g} {y:+g}")
                model.addFrame(pin.Frame(corners[-1], frame.parentJoint, placement, pin.FrameType.OP_FRAME))
    q = on_its_feet(model, robot.q0, corners)
    contacts = [Contact(corner, Plane(), friction=0.7) for corner in corners]
    scene = Scene(model, contacts, control=JointPD(2000.0, 40.0, q), without=["joint limits"])
    return lambda: simulate(scene, q, np.zeros(model.nv), 1.0, rtol=1e-6, atol=1e-8)


def box() -> Run:
    """A box with 16 corners below is dropped tilted and comes to rest, 2 s."""
    turn = 2.0 * np.pi * np.arange(16) / 16
    corners = np.column_stack([0.2 * np.cos(turn), 0.2 * np.sin(turn), np.full(16, -0.1)])
    model = free_body(pin.Inertia.FromBox(1.0, 0.4, 0.4, 0.2), tuple(map(tuple, corners)))
    contacts = [Contact(f"tip{k}", Plane(), friction=0.5, restitution=0.0) for k in range(16)]
    tilt = pin.Quaternion(pin.utils.rotate("x", 0.2) @ pin.utils.rotate("y", 0.1)).coeffs()
    q = np.array([0.0, 0.0, 0.4, *tilt])
    scene = Scene(model, contacts)
    return lambda: simulate(scene, q, np.zeros(6), 2.0, rtol=1e-6, atol=1e-8)


CASES = {
    "solo12 stands, 10 s": (standing, 0.3),
    "solo12 trots in place, 1 s": (trotting, 0.5),
    "talos on 8 corners, 1 s": (humanoid, 1.0),
    "box on 16 corners dropped tilted, 2 s": (box, 0.3),
}


def main() -> None:
    """Take the best of a few runs of each."""
    rows = []
    for name, (make, goal) in CASES.items():
        run, best = make(), float("inf")
        run()
        for _ in range(ROUNDS):
            begun = time.perf_counter()
            run()
            best = min(best, time.perf_counter() - begun)
        rows.append(row(name, best, goal))
    publish("sustained", rows)


if __name__ == "__main__":
    main()
