"""What a scene file may say: robots, surfaces, contacts, the start, what is computed and what is written."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from ..checks import near_matches
from ..errors import InputError, PinimpactError, UnknownNameError
from ..geometry.plane import Plane
from ..geometry.sphere import Sphere
from ..geometry.surfaces import Surface
from ..robot.solids import Box, Shape
from .units import quantity

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def _of(kind: str) -> BeforeValidator:
    return BeforeValidator(partial(quantity, kind=kind))


Length = Annotated[float, _of("length")]
Angle = Annotated[float, _of("angle")]
Speed = Annotated[float, _of("speed")]
AngularSpeed = Annotated[float, _of("angular speed")]
Time = Annotated[float, _of("time"), Field(gt=0.0)]
Acceleration = Annotated[float, _of("acceleration")]
FrameKey = str | int


class _Table(BaseModel):
    """A table of the file: unknown keys are refused, and nothing is converted silently.

    What is said of a key stands in docs/scene-files.md too; ``python -m tools.scene_keys`` puts it there.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)


class RobotTable(_Table):
    """``[[robot]]``: one or several robots; several need a ``prefix`` each.

    Position and roll, pitch, yaw place the base: for good, or where a free base starts, with these
    velocities; all in world axes.
    """

    name: str | None = None
    """A robot that comes with pinimpact or with example-robot-data. Give this or ``urdf``."""
    urdf: str | None = None
    """Path of a URDF file, from the folder of the scene file."""
    free_flyer: bool | None = None
    """Whether the base flies freely. Left out: as the named robot comes, and fixed for a file."""
    prefix: str = ""
    """Goes before the names of this robot's joints and frames."""
    position: tuple[Length, Length, Length] | None = None
    """Where the base stands, or starts. Left out: as the robot comes."""
    rpy: tuple[Angle, Angle, Angle] | None = None
    """Roll, pitch and yaw of the base."""
    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Of a free base at the start."""
    angular_velocity: tuple[AngularSpeed, AngularSpeed, AngularSpeed] = (0.0, 0.0, 0.0)
    """Of a free base at the start."""


class SurfaceTable(_Table):
    """What every surface has; see `Surface`."""

    kind: ClassVar[type[Surface]]


class MovingTable(SurfaceTable):
    """What a surface has whose material can move."""

    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Of the surface's material at its point or centre, within the surface: a belt."""
    angular_velocity: tuple[AngularSpeed, AngularSpeed, AngularSpeed] = (0.0, 0.0, 0.0)
    """Of the surface's material: a turntable, a ball that spins."""
    body: FrameKey | None = None
    """Frame that carries the surface, by name or number. Left out: the world."""


class PlaneTable(MovingTable):
    """``[plane.NAME]``: a plane; see `Plane`."""

    kind = Plane
    point: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """A point of the plane, in world axes or those of ``body``."""
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Points from the surface into free space; any length but zero."""


class SphereTable(MovingTable):
    """``[sphere.NAME]``: a ball or the head of a post; see `Sphere`."""

    kind = Sphere
    center: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Its centre, in world axes or those of ``body``."""
    radius: Length
    """Above zero."""


class BoxTable(SurfaceTable):
    """``[box.NAME]``: a box, which contacts with ``geometry`` or ``links`` meet; see `Box`."""

    kind = Box
    size: tuple[Length, Length, Length]
    """Lengths of its sides, above zero."""
    center: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Its centre, in world axes or those of ``body``."""
    rpy: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of its sides, about the same axes."""
    body: FrameKey | None = None
    """Frame that carries the box, by name or number. Left out: the world."""


class ShapeTable(SurfaceTable):
    """``[shape.NAME]``: a collision shape that contacts with ``geometry`` or ``links`` meet; see `Shape`."""

    kind = Shape
    geometry: str
    """Its name among the collision shapes of the robots."""
    rim_points: int | None = None
    """Points that stand for each rim of a cylinder or cone, at least 3; must be given for these."""


class ContactTable(_Table):
    """``[[contact]]``: a point or a collision shape of a robot and the surface it may meet; see `Contact`.

    Without a name it is called "frame on surface", by their names in the file. Give one of ``frame``,
    ``geometry`` and ``links``.
    """

    frame: FrameKey | None = None
    """Frame that carries the point, by name or number."""
    geometry: str | None = None
    """Collision shape, by name; see [Contact from geometry](geometry.md)."""
    links: str | list[str] | None = None
    """``"all"``, or names of the links all of whose collision shapes may meet the surface."""
    rim_points: int | None = None
    """Points that stand for each rim of a cylinder or cone, at least 3. Left out: smooth rims that roll and
    meet planes alone."""
    plane: str
    """Name of the surface, a plane, sphere, box or shape."""
    friction: float = 0.0
    """Coulomb coefficient of impacts, at least 0; of sustained contact too, without the next key."""
    sliding_friction: float | None = None
    """Coulomb coefficient of sustained contact, slip and stick. Left out: ``friction``."""
    restitution: float = 0.0
    """Coefficient of the law, from 0 to 1."""
    law: str = "poisson"
    """``"poisson"``, ``"energetic"`` or ``"newton"``."""
    stiffness: float = 1.0
    """Relative normal stiffness, above 0; counts where several contacts collide at one instant."""
    offset: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Of the point from the frame's origin, in the frame's axes."""
    radius: Length = 0.0
    """Of a ball around the point that touches in its stead, such as a foot or a fingertip."""
    name: str | None = None
    """How reports call the contact."""
    held: bool = False
    """Whether the contact holds throughout, in both directions: a grasp, a bolted foot."""


class StartTable(_Table):
    """``[start]``: whole vectors q and v, or joints by name; the others are as the robot comes, at rest."""

    q: list[float] | None = None
    """The whole configuration, in Pinocchio's order [m, rad]."""
    v: list[float] | None = None
    """All velocities, in Pinocchio's order [m/s, rad/s]."""
    joints: dict[str, float | str] = {}
    """``[start.joints]``: where each joint that is named stands [rad (deg), or m (cm, mm) if prismatic]."""
    speeds: dict[str, float | str] = {}
    """``[start.speeds]``: the speed of each joint that is named [rad/s (deg/s, rpm), or m/s (cm/s, mm/s)]."""


class ControlTable(_Table):
    """``[control]``: what the motors do; those of a free base are never driven.

    Stiffness and damping act on every joint alike, up to the largest effort. With a period they are sampled
    and held, and act late by the delay.
    """

    cancel_gravity: bool = False
    """Whether the motors cancel gravity, Coriolis and centrifugal forces."""
    stiffness: Annotated[float, Field(ge=0.0)] = 0.0
    """Towards the configuration at the start [N m/rad or N/m]."""
    damping: Annotated[float, Field(ge=0.0)] = 0.0
    """Against motion [N m s/rad or N s/m]."""
    largest_effort: Annotated[float, Field(gt=0.0)] | None = None
    """Which no motor exceeds [N m or N]. Left out: there is no limit."""
    period: Time | None = None
    """Between two samples of the control. Left out: it is continuous."""
    delay: Annotated[float, _of("time"), Field(ge=0.0)] = 0.0
    """From a sample to when its forces act; needs ``period``."""


class OutputTable(_Table):
    """``[output]``: what `run` writes beside the trajectory."""

    replay: bool = True
    """Whether to write the replay, an HTML file."""
    replay_speed: Annotated[float, Field(gt=0.0)] = 1.0
    """Seconds of motion per second of replay; 0.1 is slow motion."""
    plots: bool = True
    """Whether to draw energy, forces and the strongest impact."""


class SceneFile(_Table):
    """The whole file; these keys come before any table."""

    title: str = ""
    """Stands above pictures."""
    duration: Time
    """How long to simulate."""
    gravity: tuple[Acceleration, Acceleration, Acceleration] | None = None
    """In world axes. Left out: the model's, as a rule (0, 0, −9.81)."""
    control: ControlTable | None = None
    robot: list[RobotTable]
    plane: dict[str, PlaneTable] = {}
    sphere: dict[str, SphereTable] = {}
    box: dict[str, BoxTable] = {}
    shape: dict[str, ShapeTable] = {}
    contact: list[ContactTable] = []
    start: StartTable = StartTable()
    locked: list[str] = []
    """Joints whose velocity no impact changes, as under stiff position control."""
    limit_restitution: float = 0.0
    """Restitution of the joint limits, from 0 to 1."""
    simultaneous: str = "propagate"
    """Policy for contacts and joint limits that collide or rest at one instant: ``"propagate"``,
    ``"sequence"``, ``"together"``, ``"reflect"`` or ``"any"``."""
    resting_speed: Speed | None = None
    """A bounce slower than this is taken as rest. Left out: 10⁻⁴ √(g L), with the size L of the robot; see
    [Impacts and rest](scenes.md#impacts-and-rest)."""
    without: list[str] = []
    """Effects to leave out, by their names in the plan; see [Effects](effects.md)."""
    rtol: Annotated[float, Field(gt=0.0)] = 1e-8
    """Relative tolerance of each step."""
    atol: Annotated[float, Field(gt=0.0)] = 1e-10
    """Absolute tolerance of each step [m, rad, m/s, rad/s]."""
    max_impacts: Annotated[int, Field(gt=0)] = 100_000
    """At how many instants to resolve impacts before giving up."""
    output: OutputTable = OutputTable()

    @property
    def surfaces(self) -> dict[str, Mapping[str, SurfaceTable]]:
        """The surfaces by kind and name."""
        return {"plane": self.plane, "sphere": self.sphere, "box": self.box, "shape": self.shape}


def bundled_scenes() -> dict[str, Path]:
    """Return the names and files of the scenes that come with pinimpact."""
    package = Path(__file__).parents[1]
    installed = package / "scenes"
    folder = installed if installed.is_dir() else package.parents[1] / "examples" / "scenes"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def read_scene_file(path: Path, control: Mapping[str, Any] | None = None) -> SceneFile:
    """Return the checked tables of a scene file; paths in it are as they stand there.

    Args:
        path: The file.
        control: Keys of its table ``[control]`` to put in the place of those in the file.

    Raises:
        InputError: No such file, no TOML, a key with a bad value; the message names the key.
        UnknownNameError: A key that does not exist; near matches are offered.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(
            f"scene: there is no file {path}, and no scene of that name; "
            f"{near_matches(str(path), bundled_scenes())}",
            field="scene",
            value=str(path),
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        reason = "it is no text" if isinstance(error, UnicodeDecodeError) else error.strerror
        raise InputError(f"scene: cannot read {path}: {reason}", field="scene", value=str(path)) from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"scene: {path} is not TOML: {error}", field="scene", value=str(path)) from error
    if control:
        if not isinstance(tables.get("control"), dict):
            key = next(iter(control))
            raise InputError(
                f"control.{key}: {control[key]!r} given, but {path} has no table [control] to go by",
                field=f"control.{key}",
                value=control[key],
            )
        tables["control"] |= control
    try:
        return SceneFile.model_validate_json(json.dumps(tables, default=str))
    except ValidationError as error:
        raise _first_error(error, path) from None


_TABLES: dict[tuple[str, ...], type[_Table]] = {
    (): SceneFile,
    ("robot",): RobotTable,
    ("plane",): PlaneTable,
    ("sphere",): SphereTable,
    ("box",): BoxTable,
    ("shape",): ShapeTable,
    ("contact",): ContactTable,
    ("start",): StartTable,
    ("control",): ControlTable,
    ("output",): OutputTable,
}


def _first_error(error: ValidationError, path: Path) -> PinimpactError:
    """Return pydantic's first complaint as an error that names the key."""
    complaints = error.errors()
    # a table in place of a list is why other keys seem to be missing
    complaint = next((one for one in complaints if one["type"] == "list_type"), complaints[0])
    place = complaint["loc"]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    if complaint["type"] == "extra_forbidden":
        table = _TABLES[tuple(str(part) for part in place[:-1][:1])]
        return UnknownNameError(
            f"{key}: unknown key in {path.name}; {near_matches(str(place[-1]), table.model_fields)}",
            field=key,
            value=complaint["input"],
        )
    if complaint["type"] == "list_type" and isinstance(complaint["input"], dict):
        return InputError(
            f"{key}: [{key}] in {path.name} stands for one table of a list; write [[{key}]]",
            field=key,
            value=complaint["input"],
        )
    if complaint["type"] == "missing":
        return InputError(f"{key}: {path.name}: required key missing", field=key)
    message = complaint["msg"].removeprefix("Value error, ")
    return InputError(
        f"{key}: {complaint['input']!r} given in {path.name}; {message}", field=key, value=complaint["input"]
    )
