"""The main job in one call: a robot swings its hand, or drops its foot, onto a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .contacts import Contact, contact_geometry
from .errors import SimulationError, UnknownNameError
from .lookup import frame_id
from .robots import load_robot
from .scene import Scene
from .simulation import simulate
from .surfaces import Plane
from .trajectory import ImpactRecord, Trajectory

Array = NDArray[np.float64]

BEFORE, AFTER = 0.25, 0.35
"""How long the demo shows before and after the touch [s]."""


@dataclass(frozen=True)
class Swing:
    """How a robot of the demo strikes.

    Attributes:
        frame: What strikes; None for the last frame of the model.
        pose: Joint angles at the touch [rad]; the others are as in the robot's reference configuration.
        tilt: Roll, pitch and yaw of a free base at the touch [rad].
        velocity: Velocity of the contact point at the touch [m/s].
        friction: Coulomb coefficient.
        restitution: Coefficient of Poisson's law.
    """

    frame: str | None = None
    pose: Mapping[str, float] = field(default_factory=dict)
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    velocity: tuple[float, float, float] = (0.5, 0.3, -0.8)
    friction: float = 0.3
    restitution: float = 0.5


SWINGS = {
    "panda": Swing("panda_hand_tcp"),
    "ur5": Swing(
        "tool0",
        {"shoulder_lift_joint": -1.2, "elbow_joint": 1.7, "wrist_1_joint": -2.0, "wrist_2_joint": -1.57},
    ),
    "talos_arm": Swing("gripper_left_base_link", {"arm_left_4_joint": -1.3}),
    "xarm7": Swing("link_eef", {"joint2": -0.3, "joint4": 1.2, "joint6": 1.5}),
    "z1": Swing("gripperMover", {"joint2": 1.4, "joint3": -1.3}),
    "kinova": Swing("j2s6s200_link_finger_tip_1"),
    "solo12": Swing("FL_FOOT", tilt=(-0.15, 0.25, 0.0)),
}


@dataclass(frozen=True, eq=False)
class Demo:
    """A demo that has been run.

    Attributes:
        robot: The robot.
        contact: The contact that struck.
        trajectory: The motion, with the impact.
    """

    robot: pin.RobotWrapper
    contact: Contact
    trajectory: Trajectory

    @property
    def hit(self) -> ImpactRecord:
        """The first impact of the contact on the table.

        Raises:
            SimulationError: It never struck.
        """
        for hit in self.trajectory.impacts:
            if hit.source == self.contact.label:
                return hit
        raise SimulationError(
            f"{self.contact.label}: no impact in {self.trajectory.duration:.3g} s",
            partial=self.trajectory,
        )


def run_demo(name: str) -> Demo:
    """Let a robot of example-robot-data (or of the bundled models, or of a URDF file) strike a table.

    The configuration and velocity at the touch are chosen, and the motion is taken back from there. A fixed
    base holds its joints' speeds by a control that cancels gravity and inertia; a free base falls.

    Raises:
        PinimpactError: An unknown robot, or one that cannot strike as it should.
    """
    robot = load_robot(name)
    model = robot.model
    swing = SWINGS.get(name, Swing())
    frame = model.frames[model.nframes - 1].name if swing.frame is None else swing.frame
    free_base = model.njoints > 1 and model.joints[1].nv == 6
    q, v = touch(robot, swing, frame, free_base)
    point = contact_geometry(model, model.createData(), q, Contact(frame, Plane())).point
    table = Plane(point=tuple(point.tolist()))
    contact = Contact(frame, table, swing.friction, swing.restitution, name=f"{frame} on table")
    data = model.createData()

    def keep_speeds(_: float, q: Array, v: Array) -> Any:
        return pin.nonLinearEffects(model, data, q, v)

    scene = Scene(model, [contact], control=None if free_base else keep_speeds, record=True)
    start = pin.integrate(model, q, -BEFORE * v)
    if free_base:
        start[:3] += 0.5 * BEFORE**2 * model.gravity.linear
        v[:3] -= BEFORE * pin.XYZQUATToSE3(q[:7]).rotation.T @ model.gravity.linear
    return Demo(robot, contact, simulate(scene, start, v, BEFORE + AFTER))


def touch(robot: pin.RobotWrapper, swing: Swing, frame: str, free_base: bool) -> tuple[Array, Array]:
    """Return configuration and velocity at the touch.

    A free base moves as a whole at the chosen velocity; a fixed one with the least joint speeds that give it.
    """
    model = robot.model
    q = np.array(robot.q0)
    for name, angle in swing.pose.items():
        joint = model.getJointId(name)
        if joint == model.njoints:
            raise UnknownNameError(f"pose: {model.name} has no joint {name!r}", field="pose", value=name)
        q[model.idx_qs[joint]] = angle
    v = np.zeros(model.nv)
    if free_base:
        rotation = pin.rpy.rpyToMatrix(*swing.tilt)
        q[3:7] = pin.Quaternion(rotation).coeffs()
        v[:3] = rotation.T @ np.asarray(swing.velocity)
    else:
        jacobian = pin.computeFrameJacobian(
            model, model.createData(), q, frame_id(model, frame), pin.LOCAL_WORLD_ALIGNED
        )[:3]
        v = np.linalg.pinv(jacobian, rcond=1e-3) @ np.asarray(swing.velocity)
    return q, v
