"""The schema of scene files: robots, surfaces, contacts, initial state, control and output."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from ..checks import in_short, near_matches
from ..errors import InputError, PinimpactError, UnknownNameError
from ..geometry.plane import Plane
from ..geometry.sphere import Sphere
from ..geometry.surfaces import Surface
from ..robot.solids import Box, Shape
from ..scene._kernels.tolerances import ATOL, DT, RTOL
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


class Table(BaseModel):
    """A table of the file: unknown keys raise an error, and values are not converted.

    ``python -m tools.scene_keys`` writes the docstrings of keys to docs/scene-files.md.
    """

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)


Checked = TypeVar("Checked", bound=Table)


class RobotTable(Table):
    """``[[robot]]``: one or several robots; several need a ``prefix`` each.

    Position and roll, pitch, yaw are those of the base, at the start if the base is free; in world axes.
    """

    name: str | None = None
    """Name of a robot of pinimpact or example-robot-data. Give this or ``urdf``."""
    urdf: str | None = None
    """Path of a URDF file, relative to the folder of the scene file."""
    free_flyer: bool | None = None
    """Whether the base is free. Default: as in the named robot; fixed for a file."""
    prefix: str = ""
    """Prefix of the names of this robot's joints and frames."""
    position: tuple[Length, Length, Length] | None = None
    """Position of the base. Default: that of the robot."""
    rpy: tuple[Angle, Angle, Angle] | None = None
    """Roll, pitch and yaw of the base."""
    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Initial linear velocity of a free base, in world axes."""
    angular_velocity: tuple[AngularSpeed, AngularSpeed, AngularSpeed] = (0.0, 0.0, 0.0)
    """Initial angular velocity of a free base, in world axes."""


class SurfaceTable(Table):
    """Keys of all surfaces; see `Surface`."""

    kind: ClassVar[type[Surface]]


class MovingTable(SurfaceTable):
    """Keys of surfaces that can move within themselves."""

    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    """Velocity of the material at the point or centre, within the surface: a belt."""
    angular_velocity: tuple[AngularSpeed, AngularSpeed, AngularSpeed] = (0.0, 0.0, 0.0)
    """Angular velocity of the material: a turntable, a spinning sphere."""
    body: FrameKey | None = None
    """Frame to which the surface is attached, by name or id. Default: the world."""


class PlaneTable(MovingTable):
    """``[plane.NAME]``: a plane; see `Plane`."""

    kind = Plane
    point: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """A point of the plane, in world axes or those of ``body``."""
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Normal from the surface into free space; any length but zero."""


class SphereTable(MovingTable):
    """``[sphere.NAME]``: a sphere; see `Sphere`."""

    kind = Sphere
    center: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Centre, in world axes or those of ``body``."""
    radius: Length
    """Radius, above zero."""


class BoxTable(SurfaceTable):
    """``[box.NAME]``: a box, for contacts with ``geometry`` or ``links``; see `Box`."""

    kind = Box
    size: tuple[Length, Length, Length]
    """Lengths of its sides, above zero."""
    center: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Centre, in world axes or those of ``body``."""
    rpy: tuple[Angle, Angle, Angle] = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw, about the same axes."""
    body: FrameKey | None = None
    """Frame to which the box is attached, by name or id. Default: the world."""


class ShapeTable(SurfaceTable):
    """``[shape.NAME]``: a collision shape, for contacts with ``geometry`` or ``links``; see `Shape`."""

    kind = Shape
    geometry: str
    """Name of the collision shape."""
    rim_points: int | None = None
    """Number of points of each rim of a cylinder or cone, at least 3; required for these."""


class ContactTable(Table):
    """``[[contact]]``: a point or a collision shape of a robot, and a surface; see `Contact`.

    The default name is "frame on surface". Give one of ``frame``,
    ``geometry`` and ``links``.
    """

    frame: FrameKey | None = None
    """Frame of the contact point, by name or id."""
    geometry: str | None = None
    """Collision shape, by name; see [Contact from geometry](geometry.md)."""
    links: str | list[str] | None = None
    """``"all"``, or names of links: contacts of all their collision shapes."""
    rim_points: int | None = None
    """Number of points of each rim of a cylinder or cone, at least 3. Default: smooth rims, which
    make contact with planes only."""
    plane: str
    """Name of the surface: a plane, sphere, box or shape."""
    friction: float = 0.0
    """Coulomb coefficient of impacts, at least 0."""
    sliding_friction: float | None = None
    """Coulomb coefficient of sustained contact, slip and stick. Default: ``friction``."""
    restitution: float = 0.0
    """Coefficient of restitution, from 0 to 1."""
    law: str = "poisson"
    """Restitution law: ``"poisson"``, ``"energetic"`` or ``"newton"``."""
    stiffness: float = 1.0
    """Relative normal stiffness, above 0, for simultaneous impacts."""
    offset: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Position of the point relative to the origin of the frame, in its axes."""
    radius: Length = 0.0
    """Radius of a sphere about the point, such as a foot or a fingertip."""
    name: str | None = None
    """Name in reports."""
    held: bool = False
    """Whether the contact is a bilateral constraint: a grasp, a bolted foot."""


class StartTable(Table):
    """``[start]``: initial state, as vectors or by joint name; default: that of the robot, at rest.

    ``q`` replaces the pose of a free base, ``v`` its velocity: give one of the two.
    """

    q: list[float] | None = None
    """Configuration, in Pinocchio's order [m, rad]."""
    v: list[float] | None = None
    """Velocities, in Pinocchio's order [m/s, rad/s]."""
    joints: dict[str, float | str] = {}
    """``[start.joints]``: positions of joints by name [rad (deg), or m (cm, mm) if prismatic]."""
    speeds: dict[str, float | str] = {}
    """``[start.speeds]``: velocities of joints by name [rad/s (deg/s, rpm), or m/s (cm/s, mm/s)]."""


class ControlTable(Table):
    """``[control]``: forces of the joints; a free base has no actuator.

    Stiffness, damping and largest effort are the same for all joints.
    """

    cancel_gravity: bool = False
    """Whether the control compensates gravity, Coriolis and centrifugal forces."""
    stiffness: Annotated[float, Field(ge=0.0)] = 0.0
    """Stiffness towards the initial configuration [N m/rad or N/m]."""
    damping: Annotated[float, Field(ge=0.0)] = 0.0
    """Damping [N m s/rad or N s/m]."""
    largest_effort: Annotated[float, Field(gt=0.0)] | None = None
    """Limit of the force of each joint [N m or N]. Default: none."""
    period: Time | None = None
    """Sampling period of the control. Default: continuous."""
    delay: Annotated[float, _of("time"), Field(ge=0.0)] = 0.0
    """Time from a sample until its forces act; needs ``period``."""


class OutputTable(Table):
    """``[output]``: files that `run` writes in addition to the trajectory."""

    replay: bool = True
    """Whether to write the replay, an HTML file."""
    replay_speed: Annotated[float, Field(gt=0.0)] = 1.0
    """Seconds of motion per second of replay."""
    plots: bool = True
    """Whether to plot energy, forces and the impact with the largest impulse."""


class SceneFile(Table):
    """The whole file; these keys come before any table."""

    title: str = ""
    """Title of plots."""
    duration: Time
    """Simulated time."""
    gravity: tuple[Acceleration, Acceleration, Acceleration] | None = None
    """Gravity in world axes. Default: that of the model, usually (0, 0, −9.81)."""
    control: ControlTable | None = None
    robot: Annotated[list[RobotTable], Field(min_length=1)]
    plane: dict[str, PlaneTable] = {}
    sphere: dict[str, SphereTable] = {}
    box: dict[str, BoxTable] = {}
    shape: dict[str, ShapeTable] = {}
    contact: list[ContactTable] = []
    start: StartTable = StartTable()
    locked: list[str] = []
    """Joints whose velocity impacts do not change, as with stiff position control."""
    limit_restitution: float = 0.0
    """Restitution of the joint limits, from 0 to 1."""
    simultaneous: str = "propagate"
    """Policy for simultaneous impacts of contacts and joint limits: ``"propagate"``,
    ``"sequence"``, ``"together"``, ``"reflect"`` or ``"any"``."""
    resting_speed: Speed | None = None
    """Speed below which a bounce is taken as rest. Default: 10⁻⁴ √(g L), with the size L of the robot; see
    [Impacts and rest](scenes.md#impacts-and-rest)."""
    without: list[str] = []
    """Effects to switch off, by name; see [Effects](effects.md)."""
    rtol: float = RTOL
    """Relative tolerance of each step, from 3e-14 to 0.1."""
    atol: Annotated[float, Field(gt=0.0)] = ATOL
    """Absolute tolerance of each step [m, rad, m/s, rad/s]."""
    max_impacts: Annotated[int, Field(gt=0)] = 100_000
    """Largest number of instants with impacts."""
    scheme: str = "auto"
    """Scheme of the simulation: ``"event-driven"``, ``"time-stepping"`` or ``"auto"``; see
    [Time stepping](motions.md#time-stepping)."""
    dt: Time = DT
    """Length of time steps; with ``"auto"`` the longest one."""
    output: OutputTable = OutputTable()

    @property
    def options(self) -> dict[str, Any]:
        """The options of `simulate`."""
        return self.model_dump(include={"rtol", "atol", "max_impacts", "scheme", "dt"})

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
    """Return the checked tables of a scene file; paths in it are not resolved.

    Args:
        path: Path of the file.
        control: Keys of the table ``[control]`` that replace those in the file.

    Raises:
        InputError, UnknownNameError: An invalid file, key or value; the message names the key.
    """
    tables = read_toml(path, "scene", bundled_scenes())
    if control:
        if not isinstance(tables.get("control"), dict):
            key = next(iter(control))
            raise InputError(
                f"control.{key}: {control[key]!r} given, but {path} has no table [control]",
                value=control[key],
            )
        tables["control"] |= control
    return validated(SceneFile, tables, path)


def read_toml(path: Path, what: str, names: Iterable[str]) -> dict[str, Any]:
    """Return the tables of a TOML file, or raise `InputError`.

    Args:
        path: Path of the file.
        what: Kind of file, for messages.
        names: Names that may be given instead of a path; messages suggest similar ones.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError as error:
        known = f", and no {what} of that name; {near_matches(str(path), names)}" if names else ""
        raise InputError(f"{what}: there is no file {path}{known}", value=str(path)) from error
    except (OSError, UnicodeDecodeError) as error:
        reason = "it is not text" if isinstance(error, UnicodeDecodeError) else error.strerror
        raise InputError(f"{what}: cannot read {path}: {reason}", value=str(path)) from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{what}: {path} is not TOML: {error}", value=str(path)) from error


def validated(kind: type[Checked], tables: dict[str, Any], path: Path) -> Checked:
    """Return checked tables, or raise the errors of `read_scene_file`."""
    try:
        return kind.model_validate_json(json.dumps(tables, default=str))
    except ValidationError as error:
        raise _first_error(error, path, kind) from None


def _table_of(key: str) -> type[Table] | None:
    """Return the class of the tables of a key of a scene file, or None."""
    kind = getattr(SceneFile.model_fields.get(key), "annotation", None)
    kinds = [one for one in (kind, *get_args(kind)) if isinstance(one, type) and issubclass(one, Table)]
    return kinds[0] if kinds else None


EXPECTED = {
    "bool_type": "true or false",
    "dict_type": "a table",
    "float_type": "a number",
    "greater_than": "a number above {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "int_from_float": "a whole number",
    "int_type": "a whole number",
    "list_type": "a list",
    "model_type": "a table",
    "string_type": "text",
    "too_long": "{max_length} numbers",
    "tuple_type": "a list of numbers",
}
"""What a key expects, by the type of pydantic's error."""


def _first_error(error: ValidationError, path: Path, kind: type[Table]) -> PinimpactError:
    """Return pydantic's first error as an `InputError` that names the key."""
    complaints = error.errors()
    # a table instead of a list of tables causes further errors about missing keys
    complaint = next((one for one in complaints if one["type"] == "list_type"), complaints[0])
    place = complaint["loc"]
    if complaint["type"] == "missing":  # perhaps misspelt: the unknown key beside it says more
        unknown = (one for one in complaints if one["type"] == "extra_forbidden")
        complaint = next((one for one in unknown if one["loc"][:-1] == place[:-1]), complaint)
        place = complaint["loc"]
    kinds = [complaint["type"]]
    if str(place[-1]).partition("[")[0] in {"str", "int", "float", "list"}:  # one of several types
        place = place[:-1]
        kinds = [one["type"] for one in complaints if one["loc"][:-1] == place]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).lstrip(".")
    if complaint["type"] == "extra_forbidden":
        table = (_table_of(str(place[0])) if len(place) > 1 else None) or kind
        return UnknownNameError(
            f"{key}: unknown key in {path.name}; {near_matches(str(place[-1]), table.model_fields)}",
            value=complaint["input"],
        )
    if complaint["type"] == "list_type" and _table_of(key):
        given = f"[{key}]" if isinstance(complaint["input"], dict) else in_short(complaint["input"])
        return InputError(
            f"{key}: {given} in {path.name} must be a list of tables; write [[{key}]]",
            value=complaint["input"],
        )
    if complaint["type"] == "missing" and isinstance(place[-1], int):
        given, key = in_short(complaint["input"]), key[: key.rindex("[")]
        return InputError(
            f"{key}: {given} given in {path.name}; more numbers expected", value=complaint["input"]
        )
    if complaint["type"] == "missing":
        return InputError(f"{key}: required key missing in {path.name}")
    message = complaint["msg"].removeprefix("Value error, ")
    if EXPECTED.keys() >= set(kinds):
        expected = " or ".join(dict.fromkeys(EXPECTED[one] for one in kinds))
        message = expected.format(**complaint.get("ctx", {})) + " expected"
    given, (repeated, _, rest) = in_short(complaint["input"]), message.partition(" is not ")
    if rest and repeated == repr(complaint["input"]):
        text = f"{key}: {given} given in {path.name} is not {rest}"
    else:
        text = f"{key}: {given} given in {path.name}; {message}"
    return InputError(text, value=complaint["input"])
