"""The main job in one call: a robot swings its hand, or drops its foot, onto a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..checks import above_zero
from ..errors import InputError, ModelError, SimulationError
from ..geometry.plane import Plane
from ..geometry.surfaces import contact_axes, unit_vector
from ..robot.contact import Contact
from ..robot.loading import load_robot
from ..robot.matrices import contact_geometry
from ..robot.names import frame_id
from ..scene.records import ImpactRecord
from ..scene.scene import Scene
from ..scene.simulation import simulate
from ..scene.trajectory import Trajectory
from .robot_info import frame_label, free_base, suggested_frames

Array = NDArray[np.float64]

BEFORE, AFTER = 0.15, 0.35
"""How long the demo shows before and after the touch [s], at most."""
FIXED_BASE, FREE_BASE = (0.5, 0.3, -0.8), (0.6, 0.3, -2.0)
"""Velocity of the contact point at the touch [m/s], in contact axes."""
TILT = (-0.15, 0.25, 0.0)
"""Roll, pitch and yaw of a free base at the touch [rad], so that one foot comes first."""
LEAST_LEVER = 0.01
"""A point moves if joints at 1 rad/s or m/s give it this speed [m/s]."""
NO_INERTIA = 1e-14
"""What a joint moves [kg m² or kg] if it moves nothing."""
SINGULAR = 1e-12
"""Least eigenvalue of the mass matrix, scaled to ones on its diagonal, that is not taken for zero."""
CLEAR = 1e-3
"""Contacts that could touch later are this far away at the touch [m]."""


@dataclass(frozen=True)
class Swing:
    """How a robot of the demo strikes.

    Attributes:
        frame: What strikes; None for the first of the frames that suggest themselves and can move.
        others: Frames that may touch the table later.
        pose: Angles of the first joints at the touch [rad]; the others are as the robot comes.
        friction: Coulomb coefficient.
        restitution: Coefficient of its law.
    """

    frame: str | None = None
    others: tuple[str, ...] = ()
    pose: tuple[float, ...] = ()
    friction: float = 0.3
    restitution: float = 0.5


SWINGS = {
    "panda": Swing("panda_hand_tcp"),
    "ur5": Swing("tool0", pose=(0.0, -1.2, 1.7, -2.0, -1.57)),
    "talos_arm": Swing("gripper_left_motor_double_link", pose=(1.05, -0.36, -1.72, -2.14, 0.87, -0.24)),
    "xarm7": Swing("link_eef", pose=(-1.07, 1.55, -0.03, 2.83, -1.18, 1.84, 1.49)),
    "z1": Swing("gripperMover", pose=(-1.0, 2.44, -2.37, 0.44, 0.05, -0.52)),
    "kinova": Swing("j2s6s200_end_effector", pose=(-0.35, 3.38, 1.63, -0.47, 3.47, -0.15)),
    "solo12": Swing("FL_FOOT", ("FR_FOOT", "HL_FOOT", "HR_FOOT")),
}


@dataclass(frozen=True, eq=False)
class Demo:
    """A demo that has been run.

    Attributes:
        robot: The robot, without the joints of `frozen`.
        contacts: What may touch the table; the first one strikes.
        trajectory: The motion, with the impact.
        frozen: Joints that move no inertia, so that nothing can be said of their motion; they are held.
        stopped: Why the motion after the impact could not continue, or None.
        turned: Whether the table faces another way than up, since what strikes cannot move down.
    """

    robot: pin.RobotWrapper
    contacts: tuple[Contact, ...]
    trajectory: Trajectory
    frozen: tuple[str, ...] = ()
    stopped: str | None = None
    turned: bool = False

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


@dataclass(frozen=True, eq=False)
class Touch:
    """The instant at which a point strikes the table.

    Attributes:
        frame: The name or id of the frame that strikes.
        normal: (3,) of the table.
        q: (nq,) configuration.
        v: (nv,) velocity.
    """

    frame: str | int
    normal: Array
    q: Array
    v: Array


def run_demo(
    name: str,
    frame: str | None = None,
    *,
    speed: float | None = None,
    direction: Sequence[float] | None = None,
    normal: Sequence[float] | None = None,
    friction: float | None = None,
    restitution: float | None = None,
    law: str = "poisson",
) -> Demo:
    """Let a robot of example-robot-data (or of the bundled models, or of a file) strike a table.

    The configuration and velocity at the touch are chosen, and the motion is taken back from there. A fixed
    base holds its joints' speeds by a control that cancels gravity and inertia; a free base falls. Limits,
    damping and dry friction of the joints play no part.

    Args:
        name: Of the robot, or the path of its file.
        frame: What strikes; None for a hand or a foot that suggests itself.
        speed: Speed of the contact point at impact [m/s].
        direction: Of its motion, (3,) in world axes, of any length. What a frame cannot do is left out.
        normal: Of the table, (3,) in world axes, of any length; None for z or, where the frame cannot move
            that way, against the way in which it can.
        friction: Coulomb coefficient.
        restitution: Coefficient of the law.
        law: Of restitution.

    Raises:
        PinimpactError: An unknown robot, or one that cannot strike as it should; the message says why.
    """
    swing = SWINGS.get(name, Swing())
    robot, frozen = _movable(load_robot(name), name)
    model = robot.model
    touch = _touch(robot, name, swing, frame, speed, direction, normal)
    point = contact_geometry(model, model.createData(), touch.q, Contact(touch.frame, Plane())).point
    table = Plane(point=tuple(point.tolist()), normal=tuple(touch.normal.tolist()))
    mu = swing.friction if friction is None else friction
    e = swing.restitution if restitution is None else restitution

    def contact(key: str | int) -> Contact:
        label = key if isinstance(key, str) else f"{model.frames[key].name} (frame {key})"
        return Contact(key, table, mu, e, law, name=f"{label} on table")

    contacts = [contact(touch.frame)]
    if frame is None and free_base(model):
        others = swing.others or [frame_label(model, i) for i in suggested_frames(model)]
        data = model.createData()
        clear = [contact(key) for key in others if key != touch.frame]
        contacts += [other for other in clear if other.gap(model, data, touch.q) > CLEAR]
    start, v, before = _take_back(model, contacts, touch)
    trajectory, stopped = _run(_scene(model, contacts), start, v, before + AFTER)
    turned = normal is None and direction is None and not np.allclose(touch.normal, (0.0, 0.0, 1.0))
    demo = Demo(robot, tuple(contacts), trajectory, frozen, stopped, turned)
    if stopped is not None and not any(i.source == demo.contact.label for i in trajectory.impacts):
        raise SimulationError(stopped, partial=trajectory)
    return demo


def _movable(robot: pin.RobotWrapper, name: str) -> tuple[pin.RobotWrapper, tuple[str, ...]]:
    """Return the robot without the joints that move no inertia, and the names of these."""
    model = robot.model
    if model.nv == 0:
        raise ModelError(
            f"robot: {name} has no joint that moves, so it cannot strike", field="robot", value=name
        )
    idle = sorted(_idle_joints(model, robot.q0))
    if not idle:
        return robot, ()
    if sum(model.nvs[j] for j in range(1, model.njoints) if j not in idle) == 0:
        raise ModelError(f"robot: no joint of {name} moves any mass", field="robot", value=name)
    shapes = [robot.collision_model, robot.visual_model]
    reduced, shapes = pin.buildReducedModel(model, shapes, idle, robot.q0)
    whole = pin.RobotWrapper(reduced, *shapes)
    moving = [j for j in range(1, model.njoints) if j not in idle]
    whole.q0 = np.concatenate([robot.q0[model.idx_qs[j] : model.idx_qs[j] + model.nqs[j]] for j in moving])
    return whole, tuple(model.names[j] for j in idle)


def _idle_joints(model: pin.Model, q: Array) -> set[int]:
    """Return joints without which the mass matrix is regular: they move no inertia, or with others none."""
    joint_of = [j for j in range(1, model.njoints) for _ in range(model.nvs[j])]
    mass = pin.crba(model, model.createData(), q).reshape(model.nv, model.nv)
    mass = np.triu(mass) + np.triu(mass, 1).T
    idle: set[int] = set()
    while True:
        free = [k for k, j in enumerate(joint_of) if j not in idle]
        diagonal = mass.diagonal()[free]
        empty = {joint_of[k] for k, inertia in zip(free, diagonal, strict=True) if inertia <= NO_INERTIA}
        if empty or not free:
            idle |= empty
            if not free:
                return idle
            continue
        scaled = mass[np.ix_(free, free)] / np.sqrt(np.outer(diagonal, diagonal))
        sizes, directions = np.linalg.eigh(scaled)
        if sizes[0] > SINGULAR:
            return idle
        idle.add(joint_of[free[int(np.argmax(np.abs(directions[:, 0])))]])


def _touch(
    robot: pin.RobotWrapper,
    name: str,
    swing: Swing,
    frame: str | None,
    speed: float | None,
    direction: Sequence[float] | None,
    normal: Sequence[float] | None,
) -> Touch:
    """Return how the robot strikes: with the first frame that can move towards the table."""
    model = robot.model
    keys: list[str | int]
    if frame is not None:
        keys = [int(frame) if frame.isdigit() else frame]
        frame_id(model, keys[0])
    elif swing.frame is not None:
        keys = [swing.frame]
    else:
        keys = [frame_label(model, i) for i in suggested_frames(model)]
        keys += [frame_label(model, i) for i in range(model.nframes - 1, 0, -1)]
    q = _pose(robot, swing)
    if frame is None and swing.frame is None and free_base(model):
        keys = _lowest_first(model, q, keys, np.array((0.0, 0.0, 1.0) if normal is None else normal))
    axes = None if normal is None else contact_axes(unit_vector("normal", normal))
    default = np.array(FREE_BASE if free_base(model) else FIXED_BASE)
    size = float(np.linalg.norm(default)) if speed is None else above_zero("speed", speed)
    along = None if direction is None else np.array(unit_vector("direction", direction))
    if axes is not None and along is not None and float(axes[2] @ along) >= 0.0:
        raise InputError(
            f"direction: {tuple(direction or ())} leads away from a table whose normal is "
            f"{tuple(normal or ())}; a point strikes against the normal",
            field="direction",
            value=direction,
        )
    if axes is None and along is not None and float(along[2]) >= 0.0:
        raise InputError(
            f"direction: {tuple(direction or ())} does not lead down to the table; give a direction with a "
            "negative z, or the table's normal too (normal=, --normal)",
            field="direction",
            value=direction,
        )
    moves = None
    for key in keys:
        jacobian = pin.computeFrameJacobian(
            model, model.createData(), q, frame_id(model, key), pin.LOCAL_WORLD_ALIGNED
        ).reshape(6, model.nv)[:3]
        if free_base(model):
            jacobian = jacobian[:, :3]  # it moves as a whole
        for tried in _tables(jacobian, axes, along):
            wanted = along if along is not None else tried.T @ default
            v = np.zeros(model.nv)
            v[: jacobian.shape[1]] = np.linalg.pinv(jacobian, rcond=1e-3) @ wanted
            reached = jacobian @ v[: jacobian.shape[1]]
            rate = float(np.linalg.norm(reached))
            if rate <= 1e-3 or rate < LEAST_LEVER * float(np.linalg.norm(v)):
                continue
            moves = reached / rate
            if float(tried[2] @ moves) <= -0.1:
                scale = size if speed is not None or along is not None else float(np.linalg.norm(default))
                exact = float(np.linalg.norm(reached - wanted)) < 1e-6 * rate
                return Touch(
                    key, tried[2], q, v * (scale / (float(np.linalg.norm(wanted)) if exact else rate))
                )
    what = f"frame {frame!r}" if frame is not None else "what could strike"
    if moves is None:
        raise ModelError(
            f"robot: {name}: no joint moves {what}, so it cannot strike", field="frame", value=frame
        )
    x, y, z = (round(float(component), 3) + 0.0 for component in moves)
    raise InputError(
        f"normal: {what} of {name} cannot move towards such a table from where it is; it moves along "
        f"({x:g}, {y:g}, {z:g}): give a normal against that, another direction, or another frame",
        field="normal",
        value=normal,
    )


def _tables(jacobian: Array, axes: Array | None, along: Array | None) -> list[Array]:
    """Return the axes (3, 3) of the tables to try: what is asked for, or z and what can be moved along."""
    if axes is not None:
        return [axes]
    tables = [contact_axes((0.0, 0.0, 1.0))]
    if along is not None:
        return [*tables, contact_axes(-along)]
    left = np.linalg.svd(jacobian)[0]
    main = left[:, 0] * (-1.0 if left[int(np.argmax(np.abs(left[:, 0]))), 0] > 0.0 else 1.0)
    return [*tables, contact_axes(-main)]


def _pose(robot: pin.RobotWrapper, swing: Swing) -> Array:
    """Return the configuration at the touch, but for where a free base is."""
    model = robot.model
    q = np.array(robot.q0, dtype=float)
    for joint, angle in enumerate(swing.pose, start=1):
        coordinates = slice(model.idx_qs[joint], model.idx_qs[joint] + model.nqs[joint])
        q[coordinates] = angle if model.nqs[joint] == 1 else (math.cos(angle), math.sin(angle))
    if free_base(model):
        root = model.jointPlacements[1].rotation
        rotation = root.T @ pin.rpy.rpyToMatrix(*TILT) @ root @ pin.XYZQUATToSE3(q[:7]).rotation
        q[3:7] = pin.Quaternion(rotation).coeffs()
    return q


def _lowest_first(model: pin.Model, q: Array, keys: list[str | int], normal: Array) -> list[str | int]:
    """Return frames by their height over a table; those that suggest themselves stay before the others."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    suggested = {frame_label(model, i) for i in suggested_frames(model)}
    return sorted(
        keys, key=lambda key: (key not in suggested, data.oMf[frame_id(model, key)].translation @ normal)
    )


def _take_back(model: pin.Model, contacts: Sequence[Contact], touch: Touch) -> tuple[Array, Array, float]:
    """Return the state from which the motion leads to the touch, and how long before it that is [s].

    Joints move at their speeds, and a free base falls; so long that nothing touches before.
    """
    data = model.createData()
    fall = model.jointPlacements[1].rotation.T @ model.gravity.linear if free_base(model) else np.zeros(3)

    def earlier(time: float) -> Array:
        q: Array = pin.integrate(model, touch.q, -time * touch.v)
        q[:3] += 0.5 * time**2 * fall if free_base(model) else 0.0
        return q

    before = BEFORE
    while any(
        contact.gap(model, data, earlier(time)) <= 0.0
        for contact in contacts
        for time in np.linspace(0.0, before, 25)[1:]
    ):
        before *= 0.7
    v = touch.v.copy()
    if free_base(model):
        v[:3] -= before * pin.XYZQUATToSE3(touch.q[:7]).rotation.T @ fall
    return earlier(before), v, before


def _scene(model: pin.Model, contacts: Sequence[Contact]) -> Scene:
    data = model.createData()

    def hold_speeds(_: float, q: Array, v: Array) -> Any:
        return pin.nonLinearEffects(model, data, q, v)

    return Scene(
        model,
        contacts,
        control=None if free_base(model) else hold_speeds,
        record=True,
        without=("joint limits", "joint damping", "joint friction"),
    )


def _run(scene: Scene, q: Array, v: Array, duration: float) -> tuple[Trajectory, str | None]:
    """Return the motion, and why it could not continue, if it could not.

    Raises:
        KeyboardInterrupt: It was interrupted.
    """
    try:
        trajectory = simulate(scene, q, v, duration)
    except SimulationError as error:
        if error.partial is None:
            raise
        return error.partial, str(error)
    if not trajectory.complete:
        raise KeyboardInterrupt
    return trajectory, None
