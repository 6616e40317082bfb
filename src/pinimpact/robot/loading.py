"""Robots by name or by file, as Pinocchio RobotWrappers."""

from __future__ import annotations

import warnings
from pathlib import Path

import pinocchio as pin
from example_robot_data.robots_loader import ROBOTS

from ..errors import ModelError, UnknownNameError
from .names import near_matches


def bundled_models() -> dict[str, Path]:
    """Return the names and files of the models that come with pinimpact."""
    package = Path(__file__).parents[1]
    installed = package / "models"
    folder = installed if installed.is_dir() else package.parents[1] / "models"
    return {path.stem: path for path in sorted(folder.glob("*.urdf"))}


def load_robot(robot: str | Path, free_flyer: bool | None = None) -> pin.RobotWrapper:
    """Load a robot.

    Args:
        robot: Name of a model that comes with pinimpact (see `bundled_models`), a name of
            example-robot-data, or the path of a URDF file.
        free_flyer: Whether the base flies freely; None: as the named robot comes, and fixed for a file.

    Returns:
        Pinocchio's RobotWrapper; ``q0`` is its reference configuration. A robot whose meshes are not
        found has no shapes; a warning says so.

    Raises:
        UnknownNameError: No robot bears the name; near matches are offered.
        ModelError: The file is missing or broken, or the robot has no inertia.
    """
    models = bundled_models()
    name = str(robot)
    if isinstance(robot, str) and name in models:
        wrapper = _from_file(models[name], bool(free_flyer))
    elif isinstance(robot, str) and name in ROBOTS:
        wrapper = _from_example_robot_data(name, free_flyer)
    elif isinstance(robot, Path) or Path(name).suffix or Path(name).name != name:
        wrapper = _from_file(Path(name).expanduser(), bool(free_flyer))
    else:
        raise UnknownNameError(
            f"robot: {name!r} is neither a robot's name nor the path of a URDF file; "
            f"{near_matches(name, [*models, *ROBOTS])}",
            field="robot",
            value=robot,
        )
    if not any(inertia.mass > 0.0 for inertia in wrapper.model.inertias):
        raise ModelError(
            f"robot: {name} has no inertia: no link that a joint moves has a mass; give its links <inertial>",
            field="robot",
            value=name,
        )
    return wrapper


def _from_example_robot_data(name: str, free_flyer: bool | None) -> pin.RobotWrapper:
    loader = ROBOTS[name]
    if free_flyer is not None:
        loader = type(name, (loader,), {"free_flyer": free_flyer})
    try:
        return loader().robot
    except Exception as error:
        raise ModelError(
            f"robot: example-robot-data cannot load {name}: {str(error).strip()}", field="robot", value=name
        ) from error


def _from_file(path: Path, free_flyer: bool) -> pin.RobotWrapper:
    if not path.is_file():
        raise ModelError(f"robot: there is no file {path}", field="robot", value=str(path))
    root_joint = (pin.JointModelFreeFlyer(),) if free_flyer else ()
    try:
        model = pin.buildModelFromUrdf(str(path), *root_joint)
    except Exception as error:  # urdfdom and Pinocchio raise what they like
        raise ModelError(
            f"robot: {path} is not a URDF file that Pinocchio can read: {str(error).strip()}",
            field="robot",
            value=str(path),
        ) from error
    package_dirs = [str(folder) for folder in path.resolve().parents[:4]]
    shapes = []
    for kind in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL):
        try:
            shapes.append(pin.buildGeomFromUrdf(model, str(path), kind, package_dirs=package_dirs))
        except Exception as error:
            warnings.warn(
                f"the robot of {path} has no shapes: {str(error).strip()}; "
                "the environment variable ROS_PACKAGE_PATH tells where meshes are",
                stacklevel=3,
            )
            shapes.append(pin.GeometryModel())
    return pin.RobotWrapper(model, *shapes)
