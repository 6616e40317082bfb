"""Robots by name or file, as Pinocchio RobotWrappers."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from example_robot_data.robots_loader import ROBOTS

from ..checks import as_tuple, file_path, near_matches, truth_value
from ..errors import InputError, ModelError, UnknownNameError
from .mjcf import load_mjcf


def bundled_models() -> dict[str, Path]:
    """Return the names and files of the models that come with pinimpact."""
    package = Path(__file__).parents[1]
    installed = package / "models"
    folder = installed if installed.is_dir() else package.parents[1] / "models"
    return {path.stem: path for path in sorted(folder.glob("*.urdf"))}


def named_robots() -> dict[str, list[str]]:
    """Return the names that `load_robot` accepts, by the origin of their models."""
    # robots of SDF files need a Pinocchio that is built with SDFormat
    readable = [name for name, loader in ROBOTS.items() if not loader.sdf_filename or pin.WITH_SDFORMAT]
    return {"pinimpact": list(bundled_models()), "example-robot-data": sorted(readable)}


def load_robot(
    robot: str | Path,
    free_flyer: bool | None = None,
    *,
    mimic: bool | None = None,
    package_dirs: Sequence[str | Path] = (),
) -> pin.RobotWrapper:
    """Load a robot.

    Args:
        robot: Name of a model of pinimpact (see `bundled_models`) or of example-robot-data, or the path of a
            file: URDF, MuJoCo's MJCF (with its gravity), or SDF if Pinocchio is built with SDFormat,
            which the pip package is not.
        free_flyer: Whether the base is free. None: as in the named robot, and fixed for a file.
        mimic: Whether joints with a ``<mimic>`` tag follow the joint that it names, without a coordinate of
            their own: impacts support them, scenes do not, since Pinocchio has no forward dynamics for them.
            False: each is an independent joint. None: as False, with a warning for a file with such joints.
        package_dirs: Folders in which the packages of a URDF file's meshes are searched, before the file's
            folder, its parents, and those of the environment variable ROS_PACKAGE_PATH.

    Returns:
        Pinocchio's RobotWrapper. For a named robot ``q0`` is the configuration that is supplied with it, for
        a URDF file `pin.neutral`. For an MJCF file it is the key "home", or the first key, or without keys
        the configuration of the bodies in the file.

    Raises:
        UnknownNameError: There is no robot of that name; the message suggests similar names.
        ModelError: The file is missing or invalid, a mass is negative, or the robot has no inertia.

    Warns:
        UserWarning: Meshes that are not found, whose shapes are left out. If MuJoCo is installed, also the
            differences between the robot of an MJCF file and the one that MuJoCo loads.
    """
    package_dirs = _checked(robot, package_dirs, free_flyer, mimic)
    models = bundled_models()
    name = str(robot)
    if re.match(r"[a-z]{2,}:/", name):  # a Path leaves out one of two slashes
        raise InputError(
            f"robot: {re.sub(':/+', '://', name, count=1)} is a URL; download the file, and give its path",
            value=name,
        )
    if isinstance(robot, str) and name in models:
        path, wrapper = models[name], _from_file(models[name], bool(free_flyer), ())
    elif isinstance(robot, str) and name in ROBOTS:
        path, wrapper = _from_example_robot_data(name, free_flyer)
        mimic = bool(mimic)
    elif name and (
        isinstance(robot, Path) or Path(name).suffix or Path(name).name != name or Path(name).is_dir()
    ):
        path = Path(name).expanduser()
        wrapper = _from_file(path, bool(free_flyer), package_dirs)
    else:
        raise UnknownNameError(
            f"robot: {name!r} is neither a robot's name nor the path of a file; "
            f"{near_matches(name, [*models, *ROBOTS])}",
            value=robot,
        )
    if not any(inertia.mass > 0.0 for inertia in wrapper.model.inertias):
        raise ModelError(
            f"robot: {name} has no inertia: no link that a joint moves has a mass; give its links <inertial>",
            value=name,
        )
    if mimic is False:
        return wrapper
    coupled = _mimic_joints(path, wrapper.model)
    if coupled and mimic:
        return _couple(wrapper, coupled, name)
    if coupled:
        warnings.warn(
            f"the mimic joints {', '.join(coupled)} of {name} are loaded as independent joints; "
            "mimic=True couples them (for impacts only), mimic=False suppresses this warning",
            stacklevel=2,
        )
    return wrapper


def _checked(
    robot: Any, package_dirs: Any, free_flyer: bool | None, mimic: bool | None
) -> tuple[str | Path, ...]:
    """Return the package folders, or raise `InputError` for an invalid argument of `load_robot`."""
    if not isinstance(robot, (str, Path)):
        raise InputError(
            f"robot: {type(robot).__name__} given; the name of a robot or the path of a file is expected",
            value=robot,
        )
    folders: tuple[str | Path, ...] = as_tuple(
        "package_dirs", package_dirs, (str, Path), "the path of a folder"
    )
    for folder in folders:
        if not file_path("package_dirs", folder).expanduser().is_dir():
            raise InputError(f"package_dirs: there is no folder {folder}", value=folder)
    for field, flag in (("free_flyer", free_flyer), ("mimic", mimic)):
        if flag is not None:
            truth_value(field, flag)
    return folders


def _from_example_robot_data(name: str, free_flyer: bool | None) -> tuple[Path, pin.RobotWrapper]:
    """Return the file of a robot and the robot: a copy, whose meshes are those of earlier copies."""
    path, kept = _read(name, free_flyer)
    robot = pin.RobotWrapper(kept.model.copy(), kept.collision_model.copy(), kept.visual_model.copy())
    vars(robot).update(
        {key: given for key, given in vars(kept).items() if key not in vars(robot)}
    )  # its file
    robot.q0 = kept.q0.copy()
    return path, robot


@lru_cache(maxsize=8)
def _read(name: str, free_flyer: bool | None) -> tuple[Path, pin.RobotWrapper]:
    """Read a robot of example-robot-data; its meshes take half a second."""
    loader = ROBOTS[name]
    if free_flyer is not None:
        loader = type(name, (loader,), {"free_flyer": free_flyer})
    try:
        loaded = loader()
    except Exception as error:
        if "SDF" in str(error):
            raise _no_sdf(name) from error
        raise ModelError(
            f"robot: example-robot-data cannot load {name}: {str(error).strip()}", value=name
        ) from error
    return Path(loaded.df_path), loaded.robot


def _from_file(path: Path, free_flyer: bool, package_dirs: Sequence[str | Path]) -> pin.RobotWrapper:
    if path.is_dir():
        raise ModelError(f"robot: {path} is a folder; give a file in it", value=str(path))
    if not path.is_file():
        raise ModelError(f"robot: there is no file {path.absolute()}", value=str(path))
    root_joint = (pin.JointModelFreeFlyer(),) if free_flyer else ()
    kind = _kind_of(path)
    if kind == "mujoco":
        return load_mjcf(path, root_joint)
    if kind == "sdf":
        if not pin.WITH_SDFORMAT:
            raise _no_sdf(path)
        return pin.RobotWrapper.BuildFromSDF(str(path), [str(folder) for folder in package_dirs], *root_joint)
    if path.suffix == ".xacro":
        raise ModelError(
            f"robot: {path} is a xacro file; convert it to a URDF file first: xacro {path.name} > "
            f"{path.with_suffix('.urdf').name}",
            value=str(path),
        )
    try:
        model = pin.buildModelFromUrdf(str(path), *root_joint)
    except Exception as error:  # urdfdom and Pinocchio raise no specific type
        reason = _reason(path) or str(error).strip()
        raise ModelError(
            f"robot: {path} is not a URDF file that Pinocchio can read: {reason}", value=str(path)
        ) from error
    _check_inertias(path)
    if free_flyer and list(model.names).count("root_joint") > 1:  # Pinocchio finds joints by name
        raise ModelError(
            f"robot: {path}: a joint has the name of the free joint, 'root_joint'; rename it, or load the "
            "robot without free_flyer",
            value=str(path),
        )
    folders = [str(Path(folder).expanduser()) for folder in package_dirs]
    folders += [str(folder) for folder in path.resolve().parents[:4]]
    missing: dict[str, None] = {}
    shapes = [
        _shapes(model, path, kind, folders, missing)
        for kind in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL)
    ]
    if missing:
        warnings.warn(
            f"meshes that are not found or cannot be read are left out of the robot of {path}: "
            f"{', '.join(missing)}; set package_dirs or the environment variable ROS_PACKAGE_PATH",
            stacklevel=3,
        )
    return pin.RobotWrapper(model, *shapes)


def _reason(path: Path) -> str:
    """Return why a URDF file cannot be read: urdfdom writes it to the standard error only."""
    try:
        ElementTree.parse(path)
    except ElementTree.ParseError as error:
        return str(error)
    code = "import sys, pinocchio; pinocchio.buildModelFromUrdf(sys.argv[1])"
    ran = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False)
    return "; ".join(re.findall(r"^Error: +(.*)$", ran.stderr, re.MULTILINE))


def _kind_of(path: Path) -> str:
    """Return the root tag of an XML file, "" if there is none."""
    try:
        with open(path, "rb") as file:  # iterparse would not close a file that it does not read to the end
            for _, element in ElementTree.iterparse(file, events=("start",)):
                return str(element.tag)
    except ElementTree.ParseError:
        pass
    return ""


def _no_sdf(what: str | Path) -> ModelError:
    return ModelError(
        f"robot: {what} is an SDF file, and this Pinocchio is built without SDFormat (as the pip "
        "package is); use a URDF or MJCF file of the robot",
        value=str(what),
    )


_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
"""What urdfdom reads as a number, unless it is too large."""

_INERTIAL = (
    ("origin", ("xyz", "rpy")),
    ("mass", ("value",)),
    ("inertia", ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
)


def _check_inertias(path: Path) -> None:
    """Raise `ModelError` for negative masses, and for an <inertial> that urdfdom drops without an error."""
    # XML parsers return tabs and line breaks in attributes as spaces, but urdfdom accepts spaces only
    text = re.sub(
        rb"\"[^\"<>]*\"|'[^'<>]*'",
        lambda quoted: re.sub(rb"[\t\n\r]", lambda found: b"&#%d;" % ord(found[0]), quoted[0]),
        path.read_bytes(),
    )
    for link in ElementTree.fromstring(text).iterfind("link"):
        for inertial in link.findall("inertial")[:1]:  # urdfdom reads the first one
            for tag, keys in _INERTIAL:
                element = inertial.find(tag)
                given = {} if element is None else element.attrib
                for key in keys:
                    _check_numbers(path, link.get("name"), tag, key, given.get(key))


def _check_numbers(path: Path, link: str | None, tag: str, key: str, text: str | None) -> None:
    """Raise `ModelError` for an attribute of an <inertial> that urdfdom drops, and for a negative mass."""
    if text is None and tag == "origin":
        return
    words = [text or ""] if tag != "origin" else [word for word in (text or "").split(" ") if word]
    readable = all(_NUMBER.fullmatch(word) and np.isfinite(float(word)) for word in words)
    if not readable or len(words) != (3 if tag == "origin" else 1):
        given = f"no {key}" if text is None else f"{key}={text!r}"
        expected = "three finite numbers, separated by spaces," if tag == "origin" else "a finite number"
        spaced = "" if text is None or text == text.rstrip() else ", without spaces after it,"
        raise ModelError(
            f"robot: {path}: {given} given for the {tag} of link {link!r}, {expected}{spaced} expected",
            value=str(path),
        )
    if tag == "mass" and float(words[0]) < 0.0:
        raise ModelError(
            f"robot: {path}: the mass of link {link!r} is negative ({text} kg); a mass is at least 0",
            value=str(path),
        )


# ---- shapes


def _shapes(
    model: pin.Model, path: Path, kind: pin.GeometryType, folders: list[str], missing: dict[str, None]
) -> pin.GeometryModel:
    """Return the shapes of one kind, without those of unusable meshes, which are added to `missing`."""
    try:
        return pin.buildGeomFromUrdf(model, str(path), kind, package_dirs=folders)
    except Exception:  # Pinocchio raises no specific type
        root = ElementTree.parse(path).getroot()
    tag = "collision" if kind == pin.GeometryType.COLLISION else "visual"
    shaped = [
        (link, shape, mesh.get("filename", ""))
        for link in root.iter("link")
        for shape in link.findall(tag)
        if (mesh := shape.find("geometry/mesh")) is not None
    ]
    for link, shape, _ in shaped:
        link.remove(shape)
    for name in dict.fromkeys(name for _, _, name in shaped):
        added = [(link, shape) for link, shape, other in shaped if other == name]
        link, shape = added[0]
        link.append(shape)
        try:
            pin.buildGeomFromUrdfString(model, _text(root), kind, package_dirs=folders)
        except Exception:
            link.remove(shape)
            missing[name] = None
        else:
            for link, shape in added[1:]:
                link.append(shape)
    try:
        return pin.buildGeomFromUrdfString(model, _text(root), kind, package_dirs=folders)
    except Exception as error:
        missing[str(error).strip()] = None
        return pin.GeometryModel()


def _text(root: ElementTree.Element) -> str:
    return ElementTree.tostring(root, encoding="unicode")


# ---- mimic joints


class _Mimic(NamedTuple):
    """q = multiplier · q_leader + offset."""

    leader: str
    multiplier: float
    offset: float


def _mimic_joints(path: Path, model: pin.Model) -> dict[str, _Mimic]:
    """Return the joints of a model that mimic others, with leaders that do not mimic others themselves."""
    found = {}
    for joint in ElementTree.parse(path).getroot().iterfind("joint"):
        tag = joint.find("mimic")
        if tag is not None and model.existJointName(joint.get("name", "")):
            multiplier, offset = float(tag.get("multiplier") or 1.0), float(tag.get("offset") or 0.0)
            found[joint.get("name", "")] = _Mimic(tag.get("joint", ""), multiplier, offset)
    for name in found:
        passed = {name}
        while found[name].leader in found and found[name].leader not in passed:
            leader, a, b = found[name]
            passed.add(leader)
            further, multiplier, offset = found[leader]
            found[name] = _Mimic(further, a * multiplier, a * offset + b)
    return found


def _couple(robot: pin.RobotWrapper, coupled: dict[str, _Mimic], name: str) -> pin.RobotWrapper:
    """Return the robot with coupled mimic joints, as far as Pinocchio can couple them."""
    model, left = robot.model, []
    for joint, (leader, multiplier, offset) in coupled.items():
        try:
            if not model.existJointName(leader):
                raise ValueError(leader)
            ids = model.getJointId(leader), model.getJointId(joint)
            model = pin.transformJointIntoMimic(model, *ids, multiplier, offset)
        except Exception:  # a leader that is fixed, comes later in the tree, or is of another kind
            left.append(joint)
    if left:
        warnings.warn(
            f"Pinocchio cannot couple the joints {', '.join(left)} of {name} to those that they "
            "mimic (it couples a joint only to one of the same type, before it in the tree); "
            "they are independent",
            stacklevel=3,
        )
    whole = pin.RobotWrapper(model, robot.collision_model, robot.visual_model)
    own = [j for j in range(1, model.njoints) if "Mimic" not in model.joints[j].shortname()]
    before = robot.model
    whole.q0 = np.concatenate(
        [robot.q0[before.idx_qs[j] : before.idx_qs[j] + before.nqs[j]] for j in own] or [robot.q0[:0]]
    )
    return whole
