"""Robots from MuJoCo's files, as far as Pinocchio supports them."""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ..errors import ModelError


def load_mjcf(path: Path, root_joint: tuple[Any, ...]) -> pin.RobotWrapper:
    """Return the robot of an MJCF file, or raise `ModelError`.

    Its ``q0`` is the key called "home", or else the first key, or else that of the joints in the file.
    Warnings name equality constraints, which are ignored, and meshes that are not found. `root_joint` is a
    joint of the base, or () if the file has one.
    """
    try:
        model = pin.buildModelAndConstraintsFromMJCF(str(path), *root_joint)[0]
        root = ElementTree.parse(path).getroot()
    except Exception as error:  # Pinocchio raises what it likes
        raise ModelError(
            f"robot: {path} is not an MJCF file that Pinocchio can read: {_last_line(error)}", value=str(path)
        ) from error
    gravity = root.find("option[@gravity]")
    if gravity is not None:
        model.gravity.linear = np.array([float(x) for x in gravity.get("gravity", "").split()])
    left_out = [constraint.tag for constraint in root.findall("equality/*")]
    if left_out:
        warnings.warn(
            f"the equality constraints of {path} ({', '.join(left_out)}) are ignored; close loops "
            "by held contacts",
            stacklevel=4,
        )
    shapes = [_shapes(model, path, kind) for kind in (pin.GeometryType.COLLISION, pin.GeometryType.VISUAL)]
    missing = dict.fromkeys(name for _, names in shapes for name in names)
    if missing:
        warnings.warn(
            f"meshes that are not found or cannot be read are left out of the robot of {path}: "
            f"{', '.join(missing)}",
            stacklevel=4,
        )
    robot = pin.RobotWrapper(model, *(shape for shape, _ in shapes))
    keys = {entry.key(): entry.data() for entry in model.referenceConfigurations}
    named = [key for key in keys if key != "qpos0"]
    robot.q0 = np.array(keys.get("home", keys[named[0]] if named else robot.q0))
    if len(robot.q0) != model.nq:  # a base that is added here has no coordinates in the file
        robot.q0 = pin.neutral(model)
    return robot


def _shapes(model: pin.Model, path: Path, kind: pin.GeometryType) -> tuple[pin.GeometryModel, list[str]]:
    """Return the shapes of one kind, without those whose meshes cannot be used, and the files of these."""
    try:
        return pin.buildGeomFromMJCF(model, str(path), kind), []
    except Exception:  # of which one it is there is no more than a text
        tree = ElementTree.parse(path)
    root = tree.getroot()
    compiler = root.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(root, "compiler")
    folder = path.resolve().parent / (compiler.get("meshdir") or compiler.get("assetdir") or "")
    compiler.set("meshdir", str(folder))
    lost = {}
    for asset in root.findall("asset"):
        for mesh in asset.findall("mesh"):
            file = mesh.get("file", "")
            if not (folder / file).is_file():
                lost[mesh.get("name") or Path(file).stem] = file
                asset.remove(mesh)
    for body in root.iter():
        for shape in [child for child in body if child.tag == "geom" and child.get("mesh") in lost]:
            body.remove(shape)
    with tempfile.TemporaryDirectory() as temporary:
        rest = Path(temporary) / path.name
        tree.write(rest)
        try:
            return pin.buildGeomFromMJCF(model, str(rest), kind), list(lost.values())
        except Exception as error:
            return pin.GeometryModel(), [*lost.values(), _last_line(error)]


def _last_line(error: Exception) -> str:
    lines = [line.strip() for line in str(error).strip().splitlines() if not line.startswith("Hint")]
    return lines[-1] if lines else type(error).__name__
