"""The demo: a robot swings its hand, or drops its foot, onto a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import EPS, LITTLE
from ..arrays import Array
from ..checks import above_zero
from ..errors import InputError, ModelError, SimulationError
from ..geometry.plane import Plane
from ..geometry.surfaces import contact_axes, unit_vector
from ..robot.contact import Contact
from ..robot.loading import load_robot
from ..robot.names import frame_id, free_base
from ..scene.controls import Control, JointPD
from ..scene.events import Event
from ..scene.records import ImpactRecord
from ..scene.scene import Scene
from ..scene.simulation import simulate
from ..scene.trajectory import Trajectory
from ..visual.surface_shapes import MARGIN
from .posture import FLAT, TILTS, Body, Strike, arm_posture, bent, landing, soles
from .robot_info import frame_label, suggested_frames

BEFORE, AFTER = 0.15, 0.25
"""Simulated time before and after the impact [s], for a robot of 1 m; less for smaller ones."""
SUNK = 0.01
"""Penetration of a part without contact at which the demo ends, relative to the robot's size."""
SLIDE = 0.2
"""Motion of the contact point along the table before and after the impact [m], for a robot of 1 m."""
FRICTION, RESTITUTION = 0.3, 0.5
FIXED_BASE, FREE_BASE = (0.5, 0.3, -0.8), (0.6, 0.3, -2.0)
"""Velocity of the contact point at impact [m/s], in contact axes; the tangential part is smaller for a free
base with a small support (`_steadiness`)."""
TILT = (-0.15, 0.25, 0.0)
"""Roll, pitch and yaw of a free base at impact [rad], so that one foot lands first; also reduced by
`_steadiness`."""
LEAST_LEVER = 0.01
"""Minimum speed of a movable contact point [m/s], relative to max(1, |v|) with the joint velocities v."""
WEAK = 0.1
"""Smallest singular value of the contact Jacobian, relative to the largest, at which the point moves along a
direction by default; `LITTLE` if the user gives the direction."""
STIFFNESS, DAMPING, G = 1.0, 0.05, 9.81
"""Joint stiffness of a free-base robot relative to weight × size [1/rad], joint damping relative to
stiffness × √(size/g), and g [m/s²]."""
FLOOR = 0.1
"""Height above the lowest foot, relative to the robot's size, above which points do not support the robot."""
LEAST_STEADY = 0.2
"""Minimum factor of `_steadiness`: with less tilt several points of a foot would touch at once."""
NO_JOINT_EFFECTS = ("joint limits", "joint damping", "joint friction")


@dataclass(frozen=True, eq=False)
class Demo:
    """The result of a demo."""

    robot: pin.RobotWrapper  # the robot, without the joints of `frozen`
    contacts: tuple[Contact, ...]  # contacts with the table; the first one collides
    trajectory: Trajectory  # the motion, with the impact
    frozen: tuple[str, ...] = ()  # joints without inertia, whose motion is undetermined; they are fixed
    stopped: str | None = None  # why the motion after the impact could not continue, or None
    turned: bool = False  # whether the table is not level, because the contact point cannot move down

    @property
    def contact(self) -> Contact:
        """The contact that collides."""
        return self.contacts[0]

    @property
    def impact(self) -> ImpactRecord:
        """The first impact of the contact on the table.

        Raises:
            SimulationError: There was no impact.
        """
        for impact in self.trajectory.impacts:
            if impact.source == self.contact.label:
                return impact
        raise SimulationError(
            f"contact: {self.contact.label!r} has no impact in {self.trajectory.duration:.3g} s",
            partial=self.trajectory,
        )


@dataclass(frozen=True, eq=False)
class Touch:
    """The state at which a point collides with the table."""

    joint: int
    contact: Contact
    q: Array  # (nq,) configuration
    v: Array  # (nv,) velocity


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
    """Simulate an impact of a robot (of example-robot-data, a bundled model, or a file) with a table.

    The configuration and velocity at the impact are chosen, and the motion starts some time before. With a
    fixed base a control that compensates gravity and inertia keeps the joints at constant speed; a free base
    falls, and so does an object without joints. Limits, damping and dry friction of the joints are ignored.

    The arguments are the options of the command `demo`. `direction` (3,) and `normal` (3,) are in world axes;
    components of the direction in which the frame cannot move are omitted. The default normal is z or, if the
    frame cannot move down, opposite to a direction in which it can move.

    Raises:
        PinimpactError: An unknown robot, or one that cannot make this impact.
    """
    loaded = load_robot(name)
    if loaded.model.nv == 0:  # an object without joints falls
        loaded = load_robot(name, free_flyer=True)
    robot, frozen = _movable(loaded, name)
    model, body = robot.model, Body(robot)
    coefficients = (
        FRICTION if friction is None else friction,
        RESTITUTION if restitution is None else restitution,
    )
    touch = _touch(body, bent(robot), name, frame, speed, direction, normal, (*coefficients, law))
    contacts = [touch.contact]
    if frame is None and free_base(model):
        contacts += _other_feet(body, touch)
    pace = min(1.0, body.size)
    start, v, before = _take_back(model, contacts, touch, BEFORE * pace)
    control = _hold_posture(body, touch.q) if free_base(model) else _hold_speeds(model)
    plane = touch.contact.plane
    assert isinstance(plane, Plane)

    def clear(t: float, q: Array, v: Array) -> float:  # parts without contact would pass through the table
        return body.height(q, np.array(plane.point), plane.axes) + SUNK * body.size if t > before else 1.0

    ends = Event(clear, terminal=True, direction=-1, name="another part reaches the table")
    above = clear(np.inf, touch.q, touch.v) > 0.0
    trajectory, stopped = _run(
        Scene(model, contacts, control=control, record=True, without=NO_JOINT_EFFECTS, events=[ends] * above),
        start,
        v,
        before + AFTER * pace,
    )
    turned = (
        normal is None and direction is None and not np.allclose(touch.contact.plane.axes[2], (0.0, 0.0, 1.0))
    )
    demo = Demo(robot, tuple(contacts), trajectory, frozen, stopped, turned)
    if stopped is not None and not any(i.source == demo.contact.label for i in trajectory.impacts):
        raise SimulationError(stopped, partial=trajectory)
    return demo


def _movable(robot: pin.RobotWrapper, name: str) -> tuple[pin.RobotWrapper, tuple[str, ...]]:
    """Return the robot without the joints that move no inertia, and the names of these joints."""
    model = robot.model
    idle = sorted(_idle_joints(model, robot.q0))
    if not idle:
        return robot, ()
    if sum(model.nvs[j] for j in range(1, model.njoints) if j not in idle) == 0:
        raise ModelError(f"robot: no joint of {name} moves any mass", value=name)
    shapes = [robot.collision_model, robot.visual_model]
    reduced, shapes = pin.buildReducedModel(model, shapes, idle, robot.q0)
    whole = pin.RobotWrapper(reduced, *shapes)
    moving = [j for j in range(1, model.njoints) if j not in idle]
    whole.q0 = np.concatenate([robot.q0[model.idx_qs[j] : model.idx_qs[j] + model.nqs[j]] for j in moving])
    return whole, tuple(model.names[j] for j in idle)


def _idle_joints(model: pin.Model, q: Array) -> set[int]:
    """Return joints that move no inertia, alone or together: without them the mass matrix is regular."""
    joint_of = [j for j in range(1, model.njoints) for _ in range(model.nvs[j])]
    mass = pin.crba(model, model.createData(), q)
    idle: set[int] = set()
    while True:
        free = [k for k, j in enumerate(joint_of) if j not in idle]
        diagonal = mass.diagonal()[free]
        empty = {joint_of[k] for k, inertia in zip(free, diagonal, strict=True) if inertia <= 0.0}
        if empty or not free:
            idle |= empty
            if not free:
                return idle
            continue
        scaled = mass[np.ix_(free, free)] / np.sqrt(np.outer(diagonal, diagonal))
        eigenvalues, directions = np.linalg.eigh(scaled)
        if eigenvalues[0] > len(free) * EPS * eigenvalues[-1]:
            return idle
        idle.add(joint_of[free[int(np.argmax(np.abs(directions[:, 0])))]])


def _touch(
    body: Body,
    q0: Array,
    name: str,
    frame: str | None,
    speed: float | None,
    direction: Sequence[float] | None,
    normal: Sequence[float] | None,
    law: tuple[float, float, str],
) -> Touch:
    """Return the state at impact of the first frame that can move towards the table."""
    model = body.model
    free = free_base(model)
    keys: list[str | int]
    if frame is not None:
        keys = [int(frame) if frame.isdigit() else frame]
        frame_id(model, keys[0])
    else:
        keys = [frame_label(model, i) for i in suggested_frames(model)]
        keys += [frame_label(model, i) for i in range(model.nframes - 1, 0, -1)]
    axes = None if normal is None else contact_axes(unit_vector("normal", normal))
    default = np.array(FREE_BASE if free else FIXED_BASE)
    default[:2] *= _steadiness(body, q0) if free else 1.0
    size = float(np.linalg.norm(default)) if speed is None else above_zero("speed", speed)
    along = None if direction is None else np.array(unit_vector("direction", direction, "the way it moves"))
    if axes is not None and along is not None and float(axes[2] @ along) >= 0.0:
        raise InputError(
            f"direction: {tuple(direction or ())} points away from the table with the normal "
            f"{tuple(normal or ())}; give a direction against the normal",
            value=direction,
        )
    if axes is None and along is not None and float(along[2]) >= 0.0:
        raise InputError(
            f"direction: {tuple(direction or ())} does not point down to the table; give a "
            "direction with a negative z, or the table's normal too (normal=, --normal)",
            value=direction,
        )
    moves = None
    for key in keys:
        for tried in _tables(body, q0, frame_id(model, key), axes, along):
            i, strike = _strike(body, q0, frame_id(model, key), frame is not None, tried)
            jacobian = _jacobian(body, strike, i)
            wanted = along if along is not None else tried.T @ default
            v = np.zeros(model.nv)
            least = WEAK if along is None else LITTLE
            v[: jacobian.shape[1]] = np.linalg.pinv(jacobian, rcond=least) @ wanted
            reached = jacobian @ v[: jacobian.shape[1]]
            rate = float(np.linalg.norm(reached))
            if rate <= LEAST_LEVER * max(1.0, float(np.linalg.norm(v))):
                continue
            moves = reached / rate
            if float(tried[2] @ moves) <= -0.1:
                scale = size if speed is not None or along is not None else float(np.linalg.norm(default))
                v *= scale / rate
                table = Plane(point=tuple(strike.point.tolist()), normal=tuple(tried[2].tolist()))
                mu, e, kind = law
                contact = Contact(
                    plane=table, friction=mu, restitution=e, law=kind, **_place(body, strike.point, i)
                )
                return Touch(int(model.frames[i].parentJoint), contact, strike.q, v)
    what = f"frame {frame!r}" if frame is not None else "the contact frame"
    if moves is None:
        raise ModelError(
            f"robot: no joint of {name} moves {what}, so it cannot strike", field="frame", value=frame
        )
    x, y, z = (round(float(component), 3) + 0.0 for component in moves)
    raise InputError(
        f"normal: {what} of {name} cannot move towards a table with this normal in this posture; it moves "
        f"along ({x:g}, {y:g}, {z:g}); give the opposite normal, another direction, or another frame",
        value=normal,
    )


def _strike(body: Body, q0: Array, i: int, exact: bool, axes: Array) -> tuple[int, Strike]:
    """Return the id of the frame that collides, with posture and contact point.

    Args:
        body: The robot.
        q0: (nq,) initial configuration.
        i: Id of a frame.
        exact: Whether the origin of this frame collides. Otherwise it is the lowest point of a free-base
            robot, or of the part of a fixed-base robot at the frame.
        axes: (3, 3) axes of the table as rows, the normal last.
    """
    model = body.model
    joint = int(model.frames[i].parentJoint)
    origin = model.frames[i].placement.translation
    if not free_base(model):
        reach = MARGIN * body.size + SLIDE * min(1.0, body.size)
        return i, arm_posture(body, q0, joint, origin if exact or body.bare else None, axes, reach)
    tilted = [_tilted(model, q0, part * _steadiness(body, q0)) for part in TILTS]
    if exact:
        body.at(tilted[0])
        return i, Strike(tilted[0], body.data.oMf[i].translation.copy())
    feet = {int(model.frames[k].parentJoint): k for k in reversed(suggested_frames(model))}
    strike, lowest = landing(body, tilted, list(feet), axes[2])
    part = [k for foot, k in feet.items() if lowest in body.part(foot)]
    attached = [k for k, frame in enumerate(model.frames) if frame.parentJoint == lowest]
    return (part or attached)[-1], strike


def _jacobian(body: Body, strike: Strike, i: int) -> Array:
    """Return the (3, n) Jacobian of the contact point; a free base moves as a whole, n = 3."""
    body.at(strike.q)
    whole = pin.computeFrameJacobian(body.model, body.data, strike.q, i, pin.LOCAL_WORLD_ALIGNED)
    whole = whole.reshape(6, body.model.nv)
    jacobian: Array = whole[:3] - pin.skew(strike.point - body.data.oMf[i].translation) @ whole[3:]
    return jacobian[:, :3] if free_base(body.model) else jacobian


def _place(body: Body, point: Array, i: int, number: int = 1) -> dict[str, Any]:
    """Return frame, offset and name of a contact at a point (3,) in world axes, at this configuration."""
    model, key = body.model, frame_label(body.model, i)
    label = (key if isinstance(key, str) else f"{model.frames[i].name} (frame {key})") + " on table"
    offset = body.data.oMf[i].actInv(point)
    offset = np.round(offset, 12) + 0.0  # no negative zero
    return {
        "frame": key,
        "offset": tuple(offset.tolist()),
        "name": label if number == 1 else f"{label} {number}",
    }


def _other_feet(body: Body, touch: Touch) -> list[Contact]:
    """Return contacts at the other feet of a free base, and at other points of the foot that collides."""
    model, first = body.model, touch.contact
    found = []
    own = {int(model.frames[i].parentJoint): i for i in suggested_frames(model)}
    own |= {touch.joint: frame_id(model, first.frame)}
    for joint, i in own.items():
        points = soles(body, touch.q, joint, first.plane.axes)
        contacts = [replace(first, **_place(body, point, i, k + 1)) for k, point in enumerate(points)]
        found += [one for one in contacts if one.gap(model, body.data, touch.q) > FLAT * body.size]
    return found


def _tables(body: Body, q0: Array, i: int, axes: Array | None, along: Array | None) -> list[Array]:
    """Return axes (3, 3) of the tables to try: the given ones, or normals along z and against the motion."""
    if axes is not None:
        return [axes]
    tables = [contact_axes((0.0, 0.0, 1.0))]
    if along is not None:
        return [*tables, contact_axes(-along)]
    body.at(q0)
    left = np.linalg.svd(_jacobian(body, Strike(q0, body.data.oMf[i].translation.copy()), i))[0]
    main = left[:, 0] * (-1.0 if left[int(np.argmax(np.abs(left[:, 0]))), 0] > 0.0 else 1.0)
    return [*tables, contact_axes(-main)]


def _steadiness(body: Body, q: Array) -> float:
    """Return a measure of the stability of a standing robot, from `LEAST_STEADY` to 1.

    It is twice the smallest horizontal distance of the centre of mass from the sides of the bounding box of
    the support, divided by the height of the centre of mass.
    """
    axes, feet = np.eye(3), {int(body.model.frames[k].parentJoint) for k in suggested_frames(body.model)}
    points = np.reshape([point for foot in feet for point in soles(body, q, foot, axes)], (-1, 3))
    points = points[points[:, 2] < points[:, 2].min(initial=np.inf) + FLOOR * body.size]
    if len(points) == 0:
        return 1.0
    middle = pin.centerOfMass(body.model, body.data, q)
    away = np.minimum(middle - points.min(axis=0), points.max(axis=0) - middle)[:2].min()
    height = middle[2] - points[:, 2].min()
    return float(np.clip(2.0 * away / height, LEAST_STEADY, 1.0)) if height > 0.0 else 1.0


def _tilted(model: pin.Model, q: Array, part: float) -> Array:
    """Return a configuration with the free base tilted by a fraction of `TILT`."""
    root, q = model.jointPlacements[1].rotation, q.copy()
    tilt = pin.rpy.rpyToMatrix(*(part * np.array(TILT)))
    q[3:7] = pin.Quaternion(root.T @ tilt @ root @ pin.XYZQUATToSE3(q[:7]).rotation).coeffs()
    return q


def _take_back(
    model: pin.Model, contacts: Sequence[Contact], touch: Touch, before: float
) -> tuple[Array, Array, float]:
    """Return the initial configuration and velocity of a motion that leads to the impact, and its time [s].

    Joints move at constant speed, and a free base falls. The time is at most `before` [s], and shorter if a
    contact would touch the table earlier.
    """
    data = model.createData()
    fall = model.jointPlacements[1].rotation.T @ model.gravity.linear if free_base(model) else np.zeros(3)

    def earlier(time: float) -> Array:
        q: Array = pin.integrate(model, touch.q, -time * touch.v)
        q[:3] += 0.5 * time**2 * fall if free_base(model) else 0.0
        return q

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


def _hold_speeds(model: pin.Model) -> Control:
    data = model.createData()
    return lambda _, q, v: pin.nonLinearEffects(model, data, q, v)


def _hold_posture(body: Body, q: Array) -> JointPD:
    """Return a PD control that holds the joints at a configuration."""
    model = body.model
    single = [model.idx_vs[j] for j in range(2, model.njoints) if model.nvs[j] == model.nqs[j] == 1]
    gains = np.zeros(model.nv)
    gains[single] = STIFFNESS * pin.computeTotalMass(model) * G * body.size
    return JointPD(gains, DAMPING * np.sqrt(body.size / G) * gains, q)


def _run(scene: Scene, q: Array, v: Array, duration: float) -> tuple[Trajectory, str | None]:
    """Return the motion, and why it ended early or None; raise `KeyboardInterrupt` after Ctrl-C."""
    try:
        trajectory = simulate(scene, q, v, duration)
    except SimulationError as error:
        if error.partial is None:
            raise
        return error.partial, str(error)
    if trajectory.events:
        return trajectory, trajectory.termination
    if not trajectory.complete:
        raise KeyboardInterrupt
    return trajectory, None
