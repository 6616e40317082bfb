"""Robots by name and by file, and what is said where one cannot be had."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact.robot.loading import bundled_models

URDF = """<robot name="arm">
  <link name="base"/>
  <joint name="hinge" type="{kind}">
    <parent link="base"/>
    <child link="arm"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
  <link name="arm">
    {inertial}
    {visual}
  </link>
</robot>
"""
INERTIAL = """<inertial>
      <mass value="1"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
    </inertial>"""
LOST_MESH = """<visual><geometry><mesh filename="package://nowhere/lost.stl"/></geometry></visual>"""


@pytest.fixture
def urdf(tmp_path):
    def write(kind="revolute", inertial=INERTIAL, visual=""):
        path = tmp_path / "arm.urdf"
        path.write_text(URDF.format(kind=kind, inertial=inertial, visual=visual))
        return path

    return write


def test_names_of_example_robot_data():
    robot = pinimpact.load_robot("panda")
    assert isinstance(robot, pin.RobotWrapper)
    assert (robot.model.nq, robot.visual_model.ngeoms > 5) == (9, True)
    assert pinimpact.load_robot("solo12").model.joints[1].shortname() == "JointModelFreeFlyer"


@pytest.mark.parametrize(
    ("name", "free_flyer", "nv"), [("ur5", True, 12), ("ur5", False, 6), ("solo12", False, 12)]
)
def test_base_of_named_robots_as_asked_for(name, free_flyer, nv):
    robot = pinimpact.load_robot(name, free_flyer=free_flyer)
    assert robot.model.nv == nv
    assert robot.q0.shape == (robot.model.nq,)


def test_files_by_string_and_path(urdf):
    path = urdf()
    assert pinimpact.load_robot(path).model.nv == 1
    assert pinimpact.load_robot(str(path), free_flyer=True).model.nv == 7
    assert pinimpact.load_robot(urdf(kind="continuous")).model.nq == 2


def test_bundled_names():
    assert set(bundled_models()) == {
        "ellipsoid",
        "kane_double_pendulum",
        "rod",
        "spherical_pendulum",
        "two_link_arm",
    }
    assert pinimpact.load_robot("rod").model.nv == 5


def test_bundled_models_are_found_in_an_installed_package(tmp_path):
    package = Path(pinimpact.__file__).parent
    shutil.copytree(package, tmp_path / "pinimpact", ignore=shutil.ignore_patterns("__pycache__", "models"))
    shutil.copytree(next(iter(bundled_models().values())).parent, tmp_path / "pinimpact" / "models")
    script = "import pinimpact; print(pinimpact.__file__, pinimpact.load_robot('rod').model.nv)"
    run = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert run.stdout.split() == [str(tmp_path / "pinimpact" / "__init__.py"), "5"]


@pytest.mark.parametrize(
    ("name", "offered"), [("pnda", "'panda'"), ("UR-5", "'ur5'"), ("pendulum", "'spherical_pendulum'")]
)
def test_unknown_names_offer_near_ones(name, offered):
    with pytest.raises(pinimpact.UnknownNameError, match=offered) as caught:
        pinimpact.load_robot(name)
    assert caught.value.field == "robot"
    assert caught.value.value == name


def test_a_missing_file_is_named():
    with pytest.raises(pinimpact.ModelError, match=r"there is no file .*nothing\.urdf"):
        pinimpact.load_robot("here/nothing.urdf")


@pytest.mark.parametrize("text", ["", "<robot", "<robot name='x'></robot>", "no xml at all"])
def test_a_broken_file_is_named(tmp_path, text):
    path = tmp_path / "broken.urdf"
    path.write_text(text)
    with pytest.raises(pinimpact.ModelError, match=r"broken\.urdf"):
        pinimpact.load_robot(path)


def test_a_robot_without_inertia_is_refused(urdf):
    with pytest.raises(pinimpact.ModelError, match="no inertia"):
        pinimpact.load_robot(urdf(inertial=""))


def test_a_robot_without_its_meshes_still_moves(urdf):
    with pytest.warns(UserWarning, match=r"lost\.stl"):
        robot = pinimpact.load_robot(urdf(visual=LOST_MESH))
    assert robot.visual_model.ngeoms == 0
    assert np.isfinite(pin.crba(robot.model, robot.data, robot.q0)).all()
