"""What a scene file may say: robots, surfaces, contacts, the start, what is computed and what is written."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from ..errors import InputError, PinimpactError, UnknownNameError
from ..robot.names import near_matches
from ..robot.plane import Plane
from ..robot.sphere import Sphere
from ..robot.surfaces import Surface
from .units import quantity

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


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


class SurfaceTable(_Table):
    """What every surface has; see `Surface`."""

    kind: ClassVar[type[Surface]]
    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    angular_velocity: tuple[AngularSpeed, AngularSpeed, AngularSpeed] = (0.0, 0.0, 0.0)
    body: FrameKey | None = None


class PlaneTable(SurfaceTable):
    """``[plane.NAME]``: see `Plane`."""

    kind = Plane
    point: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)


class SphereTable(SurfaceTable):
    """``[sphere.NAME]``: see `Sphere`."""

    kind = Sphere
    center: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    radius: Length


class ContactTable(_Table):
    """``[[contact]]``: a point of a robot and the surface it may meet, its ``plane``; see `Contact`.

    Without a name it is called "frame on surface", by their names in the file.
    """

    frame: FrameKey
    plane: str
    friction: float = 0.0
    sliding_friction: float | None = None
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
    on every joint alike. With a period they are sampled and held, and act late by the delay.
    """

    cancel_gravity: bool = False
    stiffness: Annotated[float, Field(ge=0.0)] = 0.0
    damping: Annotated[float, Field(ge=0.0)] = 0.0
    period: Time | None = None
    delay: Annotated[float, _of("time"), Field(ge=0.0)] = 0.0


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
    sphere: dict[str, SphereTable] = {}
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

    @property
    def surfaces(self) -> dict[str, Mapping[str, SurfaceTable]]:
        """The surfaces by kind and name."""
        return {"plane": self.plane, "sphere": self.sphere}


def read_scene_file(path: Path) -> SceneFile:
    """Return the checked tables of a scene file; paths in it are as they stand there.

    Raises:
        InputError: No such file, no TOML, a key with a bad value; the message names the key.
        UnknownNameError: A key that does not exist; near matches are offered.
    """
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
    ("sphere",): SphereTable,
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
