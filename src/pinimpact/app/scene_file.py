"""Scenes as TOML files: robots, planes, contacts, the start, what is computed and what is written."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from ..errors import InputError, PinimpactError, UnknownNameError
from ..robot.contact import Contact
from ..robot.loading import load_robot
from ..robot.merging import Placed, assemble
from ..robot.names import near_matches
from ..robot.plane import Plane
from ..scene.scene import Control, Scene
from ..scene.simulation import simulate
from ..scene.trajectory import Trajectory
from .units import quantity

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Array = NDArray[np.float64]


def _of(kind: str) -> BeforeValidator:
    return BeforeValidator(lambda value: quantity(value, kind))


Length = Annotated[float, _of("length")]
Angle = Annotated[float, _of("angle")]
Speed = Annotated[float, _of("speed")]
AngularSpeed = Annotated[float, _of("angular speed")]
Time = Annotated[float, _of("time"), Field(gt=0.0)]
Acceleration = Annotated[float, _of("acceleration")]
FrameKey = str | int


class _Table(BaseModel):
    """A table of the file: unknown keys are refused, and nothing is converted silently."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class RobotTable(_Table):
    """``[[robot]]``: one or several robots; several need a ``prefix`` each.

    Position and roll, pitch, yaw place the base: for good, or where a free base starts, with these
    velocities; all in world axes.
    """

    name: str | None = None
    urdf: str | None = None
    free_flyer: bool | None = None
    prefix: str = ""
    position: tuple[Length, Length, Length] | None = None
    rpy: tuple[Angle, Angle, Angle] | None = None
    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    angular_velocity: tuple[AngularSpeed, AngularSpeed, AngularSpeed] = (0.0, 0.0, 0.0)


class PlaneTable(_Table):
    """``[plane.NAME]``: a surface; see `Plane`."""

    point: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    angular_velocity: tuple[AngularSpeed, AngularSpeed, AngularSpeed] = (0.0, 0.0, 0.0)
    body: FrameKey | None = None


class ContactTable(_Table):
    """``[[contact]]``: a point of a robot and the plane it may meet; see `Contact`."""

    frame: FrameKey
    plane: str
    friction: float = 0.0
    restitution: float = 0.0
    law: str = "poisson"
    offset: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    radius: Length = 0.0
    name: str | None = None
    held: bool = False


class StartTable(_Table):
    """``[start]``: whole vectors q and v, or joints by name; the others are as the robot comes, at rest."""

    q: list[float] | None = None
    v: list[float] | None = None
    joints: dict[str, float | str] = {}
    speeds: dict[str, float | str] = {}


class ControlTable(_Table):
    """``[control]``: what the motors do; those of a free base are never driven.

    Stiffness [N m/rad or N/m] is towards the start, damping [N m s/rad or N s/m] against motion; both act
    on every joint alike.
    """

    cancel_gravity: bool = False
    stiffness: Annotated[float, Field(ge=0.0)] = 0.0
    damping: Annotated[float, Field(ge=0.0)] = 0.0


class OutputTable(_Table):
    """``[output]``: what `run` writes beside the trajectory."""

    replay: bool = True
    replay_speed: Annotated[float, Field(gt=0.0)] = 1.0
    plots: bool = True


class SceneFile(_Table):
    """The whole file."""

    title: str = ""
    duration: Time
    gravity: tuple[Acceleration, Acceleration, Acceleration] | None = None
    control: ControlTable | None = None
    robot: list[RobotTable]
    plane: dict[str, PlaneTable] = {}
    contact: list[ContactTable] = []
    start: StartTable = StartTable()
    locked: list[str] = []
    limit_restitution: float = 0.0
    resting_speed: Speed | None = None
    without: list[str] = []
    rtol: Annotated[float, Field(gt=0.0)] = 1e-8
    atol: Annotated[float, Field(gt=0.0)] = 1e-10
    max_impacts: Annotated[int, Field(gt=0)] = 10_000
    output: OutputTable = OutputTable()


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A scene file made ready to run.

    Attributes:
        file: What the file says.
        robot: The robot, or all of them in one.
        scene: The scene.
        q: (nq,) configuration at the start.
        v: (nv,) velocity at the start.
    """

    file: SceneFile
    robot: pin.RobotWrapper
    scene: Scene
    q: Array
    v: Array

    def run(self, progress: Any = None) -> Trajectory:
        """Simulate the scene for its duration; errors as in `simulate`."""
        file = self.file
        return simulate(
            self.scene,
            self.q,
            self.v,
            file.duration,
            rtol=file.rtol,
            atol=file.atol,
            max_impacts=file.max_impacts,
            progress=progress,
        )

    def write(self, trajectory: Trajectory, folder: Path) -> Iterator[tuple[str, Path]]:
        """Write what ``[output]`` asks for, and yield what each file is and its path."""
        from ..visual.html_replay import replay
        from ..visual.plots import energy_figure, impact_figure, save_figure

        trajectory.save(folder / "trajectory.npz")
        yield "Trajectory", folder / "trajectory.npz"
        output = self.file.output
        if output.plots:
            yield "Energy", save_figure(energy_figure(trajectory, self.file.title), folder / "energy.png")
            contacts = {contact.label for contact in self.scene.contacts}
            hits = [hit for hit in trajectory.impacts if hit.source in contacts]
            if hits:
                hit = max(hits, key=lambda hit: float(hit.solution.impulse[2]))
                title = f"{hit.source}, t = {hit.time:.4f} s: the strongest impact"
                figure = impact_figure(hit.problem, hit.solution, title)
                yield "Strongest impact", save_figure(figure, folder / "impact.png")
        if output.replay:
            page = folder / "replay.html"
            speed = output.replay_speed
            yield "Replay", replay(self.robot, trajectory, page, contacts=self.scene.contacts, speed=speed)


def load_scene(path: str | Path) -> LoadedScene:
    """Read a scene file. Paths in it are relative to the file.

    Raises:
        InputError: No such file, no TOML, a key with a bad value; the message names the key.
        UnknownNameError: A key, plane, joint, frame or robot that does not exist; near matches are offered.
        ModelError: A robot that cannot be used.
    """
    path = Path(path)
    file = read_scene_file(path)
    robot, v0 = _robots(file, path.parent)
    model = robot.model
    if file.gravity is not None:
        model.gravity.linear = np.array(file.gravity)
    q, v = _start(file.start, robot, v0)
    contacts = [(table.held, _contact(index, table, file)) for index, table in enumerate(file.contact)]
    scene = Scene(
        model,
        [contact for held, contact in contacts if not held],
        control=None if file.control is None else _control(file.control, model, q),
        held=[contact for held, contact in contacts if held],
        locked=file.locked,
        limit_restitution=file.limit_restitution,
        resting_speed=file.resting_speed,
        record=file.output.plots,
        without=file.without,
    )
    return LoadedScene(file, robot, scene, q, v)


def read_scene_file(path: Path) -> SceneFile:
    """Return the checked tables of a scene file; errors as in `load_scene`."""
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"scene: cannot read {path}: {error}", field="scene", value=str(path)) from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"scene: {path} is not TOML: {error}", field="scene", value=str(path)) from error
    try:
        return SceneFile.model_validate_json(json.dumps(tables, default=str))
    except ValidationError as error:
        raise _first_error(error, path) from None


_TABLES: dict[tuple[str, ...], type[_Table]] = {
    (): SceneFile,
    ("robot",): RobotTable,
    ("plane",): PlaneTable,
    ("contact",): ContactTable,
    ("start",): StartTable,
    ("control",): ControlTable,
    ("output",): OutputTable,
}


def _first_error(error: ValidationError, path: Path) -> PinimpactError:
    """Return pydantic's first complaint as an error that names the key."""
    complaint = error.errors()[0]
    place = complaint["loc"]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    if complaint["type"] == "extra_forbidden":
        table = _TABLES[tuple(str(part) for part in place[:-1][:1])]
        return UnknownNameError(
            f"{key}: {path.name} has no such key to set; {near_matches(str(place[-1]), table.model_fields)}",
            field=key,
            value=complaint["input"],
        )
    if complaint["type"] == "missing":
        return InputError(f"{key}: {path.name} does not set it, and it must", field=key)
    message = complaint["msg"].removeprefix("Value error, ")
    return InputError(
        f"{key}: {complaint['input']!r} given in {path.name}; {message}", field=key, value=complaint["input"]
    )


def _robots(file: SceneFile, folder: Path) -> tuple[pin.RobotWrapper, Array]:
    """Return all robots in one, and their velocities by their bases."""
    parts, speeds = [], []
    for index, table in enumerate(file.robot):
        key = f"robot[{index}]"
        if (table.name is None) == (table.urdf is None):
            raise InputError(f"{key}: give either name = ... or urdf = ...", field=key, value=table.name)
        source = table.name if table.name is not None else folder / str(table.urdf)
        robot = load_robot(source, table.free_flyer)
        rotation = pin.rpy.rpyToMatrix(*(table.rpy or (0.0, 0.0, 0.0)))
        pose = pin.SE3(rotation, np.array(table.position or (0.0, 0.0, 0.0)))
        v = np.zeros(robot.model.nv)
        if robot.model.njoints > 1 and robot.model.joints[1].shortname() == "JointModelFreeFlyer":
            if table.position or table.rpy:
                robot.q0[:7] = pin.SE3ToXYZQUAT(pose)
            inverse = pin.XYZQUATToSE3(robot.q0[:7]).rotation.T
            v[:6] = [*(inverse @ table.velocity), *(inverse @ table.angular_velocity)]
            pose = pin.SE3.Identity()
        elif any((*table.velocity, *table.angular_velocity)):
            raise InputError(
                f"{key}.velocity: the base of {source} is fixed; set free_flyer = true, or leave it out",
                field=f"{key}.velocity",
                value=table.velocity,
            )
        parts.append(Placed(robot, table.prefix, pose))
        speeds.append(v)
    return assemble(parts), np.concatenate(speeds)


def _start(start: StartTable, robot: pin.RobotWrapper, v0: Array) -> tuple[Array, Array]:
    model = robot.model
    q = np.array(robot.q0 if start.q is None else start.q, dtype=float)
    v = np.array(v0 if start.v is None else start.v, dtype=float)
    for key, vector, size in (("start.q", q, model.nq), ("start.v", v, model.nv)):
        if vector.shape != (size,):
            raise InputError(f"{key}: {len(vector)} numbers given, {size} expected", field=key, value=vector)
    for name, value in start.joints.items():
        joint, straight = _single_joint(model, "start.joints", name)
        number = _quantity(f"start.joints.{name}", value, "length" if straight else "angle")
        at = model.idx_qs[joint]
        q[at : at + model.nqs[joint]] = number if model.nqs[joint] == 1 else (np.cos(number), np.sin(number))
    for name, value in start.speeds.items():
        joint, straight = _single_joint(model, "start.speeds", name)
        number = _quantity(f"start.speeds.{name}", value, "speed" if straight else "angular speed")
        v[model.idx_vs[joint]] = number
    return q, v


def _single_joint(model: pin.Model, key: str, name: str) -> tuple[int, bool]:
    """Return the id of a joint with one degree of freedom, and whether it is prismatic."""
    joint = model.getJointId(name)
    if joint == model.njoints:
        names = list(model.names)[1:]
        raise UnknownNameError(
            f"{key}: no joint is called {name!r}; {near_matches(name, names)}", field=key, value=name
        )
    if model.nvs[joint] != 1:
        raise InputError(
            f"{key}: {name} has {model.nvs[joint]} degrees of freedom; set them with start.q and start.v, "
            "or those of a free base in its [[robot]] table",
            field=key,
            value=name,
        )
    return joint, model.joints[joint].shortname().startswith("JointModelP")


def _quantity(key: str, value: float | str, kind: str) -> float:
    try:
        return quantity(value, kind)
    except ValueError as error:
        raise InputError(f"{key}: {error}", field=key, value=value) from None


def _contact(index: int, table: ContactTable, file: SceneFile) -> Contact:
    key = f"contact[{index}]"
    if table.plane not in file.plane:
        raise UnknownNameError(
            f"{key}.plane: no [plane.{table.plane}] in the file; {near_matches(table.plane, file.plane)}",
            field=f"{key}.plane",
            value=table.plane,
        )
    try:
        plane = Plane(**file.plane[table.plane].model_dump())
        return Contact(plane=plane, **table.model_dump(exclude={"plane", "held"}))
    except InputError as error:
        raise InputError(f"{key}: {error}", field=f"{key}.{error.field}", value=error.value) from None
    except UnknownNameError as error:
        raise UnknownNameError(f"{key}: {error}", field=f"{key}.{error.field}", value=error.value) from None


def _control(table: ControlTable, model: pin.Model, start: Array) -> Control:
    data = model.createData()
    driven = np.ones(model.nv)
    for joint in range(1, model.njoints):
        if model.nvs[joint] == 6:
            driven[model.idx_vs[joint] : model.idx_vs[joint] + 6] = 0.0

    def control(_: float, q: Array, v: Array) -> Array:
        force = -table.stiffness * pin.difference(model, start, q) - table.damping * v
        if table.cancel_gravity:
            force += pin.nonLinearEffects(model, data, q, v)
        return driven * force

    return control
