"""Robots from MuJoCo's files, as far as Pinocchio supports them."""

from __future__ import annotations

import tempfile
import warnings
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import EXACT
from ..arrays import Array
from ..errors import ModelError
from .names import free_base

SLIDES = "JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismatic"
"""Prefixes of the names of joints whose coordinate is a length."""

SAME = 1e-6
"""Tolerance relative to the largest inertia, force or limit: two programs integrate meshes differently."""


def load_mjcf(path: Path, root_joint: tuple[Any, ...]) -> pin.RobotWrapper:
    """Return the robot of an MJCF file, or raise `ModelError`.

    Its ``q0`` is the key called "home", or else the first key, or else that of the bodies in the file.
    Warnings name equality constraints, which are ignored, meshes that are not found and, if MuJoCo is
    installed, in what the model differs from MuJoCo's. `root_joint` is a joint of the base, or () if the file
    has one.
    """
    try:
        model = pin.buildModelAndConstraintsFromMJCF(str(path), *root_joint)[0]
        root = ElementTree.parse(path).getroot()
    except Exception as error:  # Pinocchio raises what it likes
        raise ModelError(
            f"robot: {path} is not an MJCF file that Pinocchio can read: {_last_line(error)}", value=str(path)
        ) from error
    if root_joint and not free_base(model):
        raise ModelError(
            f"free_flyer: True given, but the first body of {path} has joints to the world already; give it "
            "a freejoint in the file instead",
            value=True,
        )
    for option in root.findall("option[@gravity]"):  # the last one holds
        model.gravity.linear = np.array([float(x) for x in option.get("gravity", "").split()])
    if root.find("option/flag[@gravity='disable']") is not None:
        model.gravity.linear = np.zeros(3)
    if not root_joint and free_base(model):
        model.jointPlacements[1] = pin.SE3.Identity()  # its coordinates are the pose in the world
    keys = {entry.key(): entry.data() for entry in model.referenceConfigurations}
    _correct_limits(model, root, keys.get("qpos0", np.zeros(model.nq)))
    trees = [
        tree
        for tree in root.findall("worldbody/body")
        if {"joint", "freejoint"} & {x.tag for x in tree.iter()}
    ]
    if len(trees) > 1:
        names = ", ".join(tree.get("name", "unnamed") for tree in trees[1:])
        warnings.warn(
            f"only the first moving body of {path} is loaded; load the others ({names}) from separate files",
            stacklevel=4,
        )
    different = [] if root_joint or len(trees) > 1 else _differences(model, path)
    if different:
        warnings.warn(
            f"the robot of {path} differs from MuJoCo's in {', '.join(different)}: Pinocchio ignores a part "
            "of the file or interprets it differently",
            stacklevel=4,
        )
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
    named = sorted(keys, key=lambda key: (key != "home", key == "qpos0"))
    robot.q0 = np.array(keys[named[0]] if named else robot.q0)
    if len(robot.q0) != model.nq:  # a base that is added here has no coordinates in the file
        robot.q0 = pin.neutral(model)
    return robot


@cache
def _misread_limits() -> tuple[float, float]:
    """Return Pinocchio's length of a range of 1 m in a file in degrees, and its lower limit for `ref` = 1."""
    text = """<mujoco><worldbody><body name="x"><joint name="x" type="slide" ref="1" range="0 1"/>
        <geom size="1"/></body></worldbody></mujoco>"""
    with tempfile.TemporaryDirectory() as temporary:
        path = Path(temporary) / "slide.xml"
        path.write_text(text)
        model = pin.buildModelFromMJCF(str(path))
    low, high = float(model.lowerPositionLimit[0]), float(model.upperPositionLimit[0])
    return high - low, low


def _correct_limits(model: pin.Model, root: ElementTree.Element, start: Array) -> None:
    """Set the limits to those of the file, whose own coordinates begin at `start`."""
    metre, part = _misread_limits()
    angles = [compiler.get("angle") for compiler in root.findall("compiler[@angle]")]
    if angles[-1:] == ["radian"]:
        metre = 1.0
    for joint in model.joints[1:]:
        if joint.nq != joint.nv:
            continue
        composite = joint.shortname() == "JointModelComposite"
        for k, one in enumerate(joint.extract().joints if composite else [joint]):
            i = joint.idx_q + k
            unit = metre if one.shortname().startswith(SLIDES) else 1.0
            at = start[i - model.nq]
            for limits in (model.lowerPositionLimit, model.upperPositionLimit):
                limits[i] = (limits[i] - part * at) / unit


def _differences(model: pin.Model, path: Path) -> list[str]:
    """Return the differences of a model from MuJoCo's of the file, if MuJoCo is installed and can read it."""
    try:
        import mujoco

        theirs = mujoco.MjModel.from_xml_path(str(path))
    except (ImportError, ValueError):
        return []
    if theirs.nv != model.nv:
        return [f"the number of its velocities ({model.nv}, there {theirs.nv})"]
    state, data, v = mujoco.MjData(theirs), model.createData(), np.random.default_rng(0).normal(size=model.nv)
    mujoco.mj_integratePos(theirs, state.qpos, v, 0.3)
    q, free, ball = state.qpos.copy(), int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    axes, limits = np.eye(model.nv), np.full((2, model.nq), [[-np.inf], [np.inf]])
    for kind, i, k, limited, ends in zip(
        *(theirs.jnt_type, theirs.jnt_qposadr, theirs.jnt_dofadr, theirs.jnt_limited, theirs.jnt_range),
        strict=True,
    ):
        if kind in (free, ball):
            turn = slice(i + 3, i + 7) if kind == free else slice(i, i + 4)
            q[turn] = np.roll(q[turn], -1)
            limits[:, i : turn.stop] = np.nan
        elif limited:
            limits[:, i] = ends
        if kind == free:  # velocities in world axes there, and in those of the body here, which turn
            axes[k : k + 3, k : k + 3] = pin.Quaternion(q[turn]).matrix()
            v[k : k + 3] = 0.0
    state.qvel[:] = v
    mujoco.mj_forward(theirs, state)
    mass, products = pin.crba(model, data, q), np.empty((model.nv, model.nv))
    for product, column in zip(products, axes.T, strict=True):
        mujoco.mj_mulM(theirs, state, product, column.copy())
    bounds = np.array([model.lowerPositionLimit, model.upperPositionLimit])
    compared = {
        "inertia": (np.triu(mass), np.triu(products @ axes)),
        "gravity or axes": (pin.nonLinearEffects(model, data, q, v), axes.T @ state.qfrc_bias),
        "springs, damping or other passive forces": (-model.damping * v, axes.T @ state.qfrc_passive),
        "dry friction": (model.friction, theirs.dof_frictionloss),
        "joint limits": (np.where(np.isnan(limits), limits, bounds), limits),
    }
    different = [name for name, (ours, other) in compared.items() if not _same(ours, other)]
    if different:
        return different
    # a displacement, or a rotation about the vertical, changes none of these
    moment, slopes = _first_moment(theirs, state)
    whole, motion = pin.computeTotalMass(model), pin.jacobianCenterOfMass(model, data, q)
    placed = _same(whole * pin.centerOfMass(model, data, q), moment)
    placed &= _same(whole * motion.reshape(3, model.nv), slopes @ axes)
    return [] if placed else ["positions"]


def _same(ours: Array, other: Array) -> bool:
    much = max(SAME * np.abs(other[np.isfinite(other)]).max(initial=0.0), EXACT)
    return np.allclose(ours, other, rtol=0.0, atol=much, equal_nan=True)


def _first_moment(theirs: Any, state: Any) -> tuple[Array, Array]:
    """Return Σ m x (3,) of the moving bodies of MuJoCo's model, and its derivatives (3, nv)."""
    import mujoco

    moment, slopes, jacobian = np.zeros(3), np.zeros((3, theirs.nv)), np.empty((3, theirs.nv))
    for body in np.flatnonzero(theirs.body_weldid).tolist():
        mujoco.mj_jacBodyCom(theirs, state, jacobian, None, body)
        moment += theirs.body_mass[body] * state.xipos[body]
        slopes += theirs.body_mass[body] * jacobian
    return moment, slopes


def _shapes(model: pin.Model, path: Path, kind: pin.GeometryType) -> tuple[pin.GeometryModel, list[str]]:
    """Return the shapes of one kind, without those whose meshes cannot be used, and the files of these."""
    try:
        return pin.buildGeomFromMJCF(model, str(path), kind), []
    except Exception:  # Pinocchio raises no specific type
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
