"""Cost of persistent contact: robots that stand, land and trot, and a box on many corners.

python -m benchmarks.persistent_contact

Run times are compared with MuJoCo with steps of 2 ms, the same bodies and contact points, and springs and
dampers of the same gains at the joints.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from benchmarks.scene_cost import free_body
from benchmarks.timing import best_of, publish, row
from example_robot_data import robots_loader

from pinimpact import Contact, JointPD, Plane, Scene, Stepper, Trajectory, load_robot, simulate

ROUNDS = 3
FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
ORIGINS = [(foot, (0.0, 0.0, 0.0)) for foot in FEET]
GAINS = (20.0, 0.5)
"""Stiffness [N m/rad] and damping [N m s/rad] of the joints of a standing quadruped."""
STEP = 2e-3
"""Step size of MuJoCo [s]."""
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
    """Return a run of solo12 that stands for 10 s under joint PD."""
    model, q, contacts = quadruped()
    scene = Scene(model, contacts, control=JointPD(*GAINS, q))
    return lambda: simulate(scene, q, np.zeros(model.nv), 10.0, rtol=1e-6, atol=1e-8)


def trotting() -> Run:
    """Return a run of solo12 that trots in place for 1 s, lifting pairs of legs, controlled at 1 kHz."""
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


def steps_standing() -> Callable[[], None]:
    """Return 100 steps of 1 ms of a standing solo12, with new torques in each step."""
    model, q, contacts = quadruped()
    stepper = Stepper(Scene(model, contacts), q, np.zeros(model.nv), rtol=1e-6, atol=1e-8)

    def steps() -> None:
        for _ in range(STEPS):
            tau = np.zeros(model.nv)
            tau[6:] = 20.0 * (q[7:] - stepper.q[7:]) - 0.5 * stepper.v[6:]
            stepper.step(tau, 1e-3)

    return steps


def branches() -> Callable[[], None]:
    """Return 100 copies of a stepper of a standing solo12, each of which takes 20 steps of 1 ms."""
    model, q, contacts = quadruped()
    stepper = Stepper(Scene(model, contacts), q, np.zeros(model.nv), rtol=1e-6, atol=1e-8)
    pulls = [np.append(np.zeros(6), np.full(12, 0.01 * k)) for k in range(BRANCHES)]
    stepper.step(pulls[0], 1e-3)

    def run() -> None:
        for tau in pulls:
            branch = stepper.copy()
            for _ in range(20):
                branch.step(tau, 1e-3)

    return run


def steps_in_mujoco() -> Callable[[], None]:
    """Return 100 steps of 1 ms of the same in MuJoCo, with torques computed in Python in each step.

    Damping is lower, since these steps are unstable with the full damping.
    """
    _, q, _ = quadruped()
    model = over_a_floor(in_mujoco("Solo12Loader", (0.0, 0.0)), q, q, ORIGINS, step=1e-3)
    data = mujoco.MjData(model)

    def steps() -> None:
        for _ in range(STEPS):
            data.qfrc_applied[6:] = 20.0 * (q[7:] - data.qpos[7:]) - 0.1 * data.qvel[6:]
            mujoco.mj_step(model, data)
        assert np.isfinite(data.qpos).all()

    return steps


def steps_in_flight() -> Callable[[], None]:
    """Return 100 steps of 1 ms of a Panda that falls above a floor."""
    robot = load_robot("panda")
    contact = Contact("panda_hand_tcp", Plane(point=(0.0, 0.0, -1.0)), friction=0.3)
    still = np.zeros(robot.model.nv)
    stepper = Stepper(Scene(robot, contact), robot.q0, still, rtol=1e-6, atol=1e-8)

    def steps() -> None:
        for _ in range(STEPS):
            stepper.step(still, 1e-3)

    return steps


def humanoid() -> Run:
    """Return a run of Talos that stands for 1 s on the corners of its soles under joint PD."""
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


def tilted_box() -> tuple[np.ndarray, np.ndarray]:
    """Return 16 corners of a box, and its initial configuration."""
    turn = 2.0 * np.pi * np.arange(16) / 16
    corners = np.column_stack([0.2 * np.cos(turn), 0.2 * np.sin(turn), np.full(16, -0.1)])
    tilt = pin.Quaternion(pin.utils.rotate("x", 0.2) @ pin.utils.rotate("y", 0.1)).coeffs()
    return corners, np.array([0.0, 0.0, 0.4, *tilt])


def box() -> Run:
    """Return a run of 2 s of a tilted box with 16 lower corners that is dropped and comes to rest."""
    corners, q = tilted_box()
    model = free_body(pin.Inertia.FromBox(1.0, 0.4, 0.4, 0.2), tuple(map(tuple, corners)))
    contacts = [Contact(f"tip{k}", Plane(), friction=0.5, restitution=0.0) for k in range(16)]
    scene = Scene(model, contacts)
    return lambda: simulate(scene, q, np.zeros(6), 2.0, rtol=1e-6, atol=1e-8)


Tips = Sequence[tuple[str, tuple[float, float, float]]]
"""Bodies, and points on them."""


def in_mujoco(loader: str, gains: tuple[float, float]) -> mujoco.MjSpec:
    """Return a robot with a free base for MuJoCo, with joint springs and dampers.

    Args:
        loader: Name of its loader in example-robot-data.
        gains: Stiffness and damping of each joint.
    """
    text = Path(getattr(robots_loader, loader)().df_path).read_text()
    text = re.sub(r"<(visual|collision|transmission|gazebo)\b[^>]*?(/>|>.*?</\1>)", "", text, flags=re.DOTALL)
    compiler = '<mujoco><compiler discardvisual="false" fusestatic="false"/></mujoco>'
    text = re.sub(r"(<robot[^>]*>)", rf"\1{compiler}", text, count=1)
    spec = mujoco.MjSpec.from_string(text)
    base = spec.worldbody.first_body()
    base.add_freejoint()
    for joint in spec.joints:
        if joint.type != mujoco.mjtJoint.mjJNT_FREE:
            joint.stiffness[0], joint.damping[0] = gains
    return spec


def over_a_floor(
    spec: mujoco.MjSpec, q: np.ndarray, rest: np.ndarray, tips: Tips, step: float = STEP
) -> mujoco.MjModel:
    """Return bodies above a floor, with spheres of 1 mm at given points.

    Args:
        spec: The bodies.
        q: (nq,) initial configuration, in the order of Pinocchio.
        rest: (nq,) configuration of relaxed springs.
        tips: Names of bodies, and points on them.
        step: Step size [s].
    """
    spec.option.timestep = step
    floor = spec.worldbody.add_geom()
    floor.type, floor.size, floor.pos = mujoco.mjtGeom.mjGEOM_PLANE, [1, 1, 0.1], [0, 0, -1e-3]
    for body, point in tips:
        tip = spec.body(body).add_geom()
        tip.type, tip.size, tip.mass, tip.pos = mujoco.mjtGeom.mjGEOM_SPHERE, [1e-3, 0, 0], 0.0, point
    model = spec.compile()
    order = [0, 1, 2, 6, 3, 4, 5, *range(7, len(q))]  # w first
    model.qpos0[:], model.qpos_spring[:] = q[order], rest[order]
    return model


def stepping(model: mujoco.MjModel, duration: float) -> Callable[[], None]:
    """Return a run of MuJoCo from rest."""
    data = mujoco.MjData(model)

    def run() -> None:
        mujoco.mj_resetData(model, data)
        for _ in range(round(duration / STEP)):
            mujoco.mj_step(model, data)
        assert np.isfinite(data.qpos).all()

    return run


def standing_in_mujoco() -> Callable[[], None]:
    """Return the same as `standing`."""
    _, q, _ = quadruped()
    return stepping(over_a_floor(in_mujoco("Solo12Loader", GAINS), q, q, ORIGINS), 10.0)


def box_in_mujoco() -> Callable[[], None]:
    """Return the same as `box`."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="box")
    body.mass, body.explicitinertial = 1.0, True
    body.inertia = np.diag(pin.Inertia.FromBox(1.0, 0.4, 0.4, 0.2).inertia)
    body.add_freejoint()
    corners, q = tilted_box()
    return stepping(over_a_floor(spec, q, q, [("box", corner) for corner in corners]), 2.0)


CASES = {
    "solo12 stands, 10 s": (standing, 0.3),
    "solo12 trots in place, 1 s": (trotting, 0.5),
    "talos on 8 corners, 1 s": (humanoid, 1.0),
    "box on 16 corners dropped tilted, 2 s": (box, 0.3),
}


STEPS = 100
"""Steps of a `Stepper` in one run."""

BRANCHES = 100
"""Copies of a `Stepper` in one run."""

STEPPED = {
    "1 ms step, solo12 on four feet": (steps_standing, 3e-4),
    "1 ms step, Panda in flight": (steps_in_flight, 1e-4),
}

IN_MUJOCO = "1 ms step, solo12 on four feet, MuJoCo"
BRANCHED = "100 branches of 20 steps of 1 ms, solo12"

AGAINST = {
    "solo12 stands, 10 s": standing_in_mujoco,
    "box on 16 corners dropped tilted, 2 s": box_in_mujoco,
}


def main() -> None:
    """Measure the shortest of a few alternating runs of each."""
    runs = {name: make() for name, (make, _) in CASES.items()}
    steps = {name: make() for name, (make, _) in STEPPED.items()}
    steps[IN_MUJOCO], steps[BRANCHED] = steps_in_mujoco(), branches()
    others = {f"{name}, MuJoCo": make() for name, make in AGAINST.items()}
    seconds = best_of({**runs, **steps, **others}, rounds=ROUNDS)
    rows = [row(name, seconds[name], goal) for name, (_, goal) in CASES.items()]
    rows += [row(name, seconds[name] / STEPS, goal) for name, (_, goal) in STEPPED.items()]
    rows += [row(IN_MUJOCO, seconds[IN_MUJOCO] / STEPS), row(BRANCHED, seconds[BRANCHED], 0.1)]
    rows += [row(name, seconds[name]) for name in others]
    publish("persistent_contact", rows)


if __name__ == "__main__":
    main()
