"""The main job in one call: a robot swings its hand, or drops its foot, onto a table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..errors import SimulationError
from ..robot.contact import Contact
from ..robot.loading import load_robot
from ..robot.matrices import contact_geometry
from ..robot.names import frame_id
from ..robot.plane import Plane
from ..scene.records import ImpactRecord
from ..scene.scene import Scene
from ..scene.simulation import simulate
from ..scene.trajectory import Trajectory

Array = NDArray[np.float64]

BEFORE, AFTER = 0.15, 0.35
"""How long the demo shows before and after the touch [s]."""
FIXED_BASE, FREE_BASE = (0.5, 0.3, -0.8), (0.6, 0.3, -2.0)
"""Velocity of the contact point at the touch [m/s], in world axes."""


@dataclass(frozen=True)
class Swing:
    """How a robot of the demo strikes.

    Attributes:
        frame: What strikes; None for the last frame of the model.
        others: Frames that may touch the table later.
        pose: Angles of the first joints at the touch [rad]; the others are as the robot comes.
        tilt: Roll, pitch and yaw of a free base at the touch [rad].
        friction: Coulomb coefficient.
        restitution: Coefficient of Poisson's law.
    """

    frame: str | None = None
    others: tuple[str, ...] = ()
    pose: tuple[float, ...] = ()
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    friction: float = 0.3
    restitution: float = 0.5


SWINGS = {
    "panda": Swing("panda_hand_tcp"),
    "ur5": Swing("tool0", pose=(0.0, -1.2, 1.7, -2.0, -1.57)),
    "talos_arm": Swing("gripper_left_motor_double_link", pose=(1.05, -0.36, -1.72, -2.14, 0.87, -0.24)),
    "xarm7": Swing("link_eef", pose=(-1.07, 1.55, -0.03, 2.83, -1.18, 1.84, 1.49)),
    "z1": Swing("gripperMover", pose=(-1.0, 2.44, -2.37, 0.44, 0.05, -0.52)),
    "kinova": Swing("j2s6s200_end_effector", pose=(-0.35, 3.38, 1.63, -0.47, 3.47, -0.15)),
    "solo12": Swing("FL_FOOT", ("FR_FOOT", "HL_FOOT", "HR_FOOT"), tilt=(-0.15, 0.25, 0.0)),
}


@dataclass(frozen=True, eq=False)
class Demo:
    """A demo that has been run.

    Attributes:
        robot: The robot.
        contacts: What may touch the table; the first one strikes.
        trajectory: The motion, with the impact.
    """

    robot: pin.RobotWrapper
    contacts: tuple[Contact, ...]
    trajectory: Trajectory

    @property
    def contact(self) -> Contact:
        """The contact that strikes."""
        return self.contacts[0]

    @property
    def impact(self) -> ImpactRecord:
        """The first impact of the contact on the table.

        Raises:
            SimulationError: It never struck.
        """
        for impact in self.trajectory.impacts:
            if impact.source == self.contact.label:
                return impact
        raise SimulationError(
            f"{self.contact.label}: no impact in {self.trajectory.duration:.3g} s",
            partial=self.trajectory,
        )


def run_demo(name: str) -> Demo:
    """Let a robot of example-robot-data (or of the bundled models, or of a URDF file) strike a table.

    The configuration and velocity at the touch are chosen, and the motion is taken back from there. A fixed
    base holds its joints' speeds by a control that cancels gravity and inertia; a free base falls. Limits,
    damping and dry friction of the joints play no part.

    Raises:
        PinimpactError: An unknown robot, or one that cannot strike as it should.
    """
    robot = load_robot(name)
    model = robot.model
    swing = SWINGS.get(name, Swing())
    frame = model.frames[model.nframes - 1].name if swing.frame is None else swing.frame
    free_base = model.njoints > 1 and model.joints[1].nv == 6
    q, v = state_at_touch(robot, swing, frame, free_base)
    point = contact_geometry(model, model.createData(), q, Contact(frame, Plane())).point
    table = Plane(point=tuple(point.tolist()))
    contacts = tuple(
        Contact(name, table, swing.friction, swing.restitution, name=f"{name} on table")
        for name in (frame, *swing.others)
    )
    data = model.createData()

    def hold_speeds(_: float, q: Array, v: Array) -> Any:
        return pin.nonLinearEffects(model, data, q, v)

    scene = Scene(
        model,
        contacts,
        control=None if free_base else hold_speeds,
        record=True,
        without=("joint limits", "joint damping", "joint friction"),
    )
    start = pin.integrate(model, q, -BEFORE * v)
    if free_base:
        start[:3] += 0.5 * BEFORE**2 * model.gravity.linear
        v[:3] -= BEFORE * pin.XYZQUATToSE3(q[:7]).rotation.T @ model.gravity.linear
    return Demo(robot, contacts, simulate(scene, start, v, BEFORE + AFTER))


def state_at_touch(robot: pin.RobotWrapper, swing: Swing, frame: str, free_base: bool) -> tuple[Array, Array]:
    """Return configuration and velocity at the touch.

    A free base moves as a whole at the chosen velocity; a fixed one with the least joint speeds that give it.
    """
    model = robot.model
    q = np.array(robot.q0)
    for joint, angle in enumerate(swing.pose, start=1):
        coordinates = slice(model.idx_qs[joint], model.idx_qs[joint] + model.nqs[joint])
        q[coordinates] = angle if model.nqs[joint] == 1 else (math.cos(angle), math.sin(angle))
    v = np.zeros(model.nv)
    if free_base:
        rotation = pin.rpy.rpyToMatrix(*swing.tilt)
        q[3:7] = pin.Quaternion(rotation).coeffs()
        v[:3] = rotation.T @ np.array(FREE_BASE)
    else:
        jacobian = pin.computeFrameJacobian(
            model, model.createData(), q, frame_id(model, frame), pin.LOCAL_WORLD_ALIGNED
        )[:3]
        v = np.linalg.pinv(jacobian, rcond=1e-3) @ np.array(FIXED_BASE)
    return q, v
