"""Loading of robots by name and from files; messages if a robot cannot be loaded."""

import shutil
import subprocess
import sys
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from example_robot_data.robots_loader import ROBOTS

import pinimpact
from pinimpact.robot import loading
from pinimpact.robot.loading import bundled_models

from . import robot_cases as cases

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


def test_joint_with_the_name_of_the_free_joint_is_refused(urdf):
    """Pinocchio puts its link onto the free joint."""
    path = urdf()
    path.write_text(path.read_text().replace('name="hinge"', 'name="root_joint"'))
    assert list(pinimpact.load_robot(path).model.names) == ["universe", "root_joint"]
    with pytest.raises(pinimpact.ModelError, match="a joint has the name of the free joint, 'root_joint'"):
        pinimpact.load_robot(path, free_flyer=True)


def test_files_are_closed(monkeypatch):
    opened = []

    def remembering(*args, **kwargs):
        opened.append(open(*args, **kwargs))  # noqa: SIM115
        return opened[-1]

    for module in (loading, ElementTree):
        monkeypatch.setattr(module, "open", remembering, raising=False)
    pinimpact.load_robot(str(Path(__file__).parents[1] / "models" / "rod.urdf"))
    assert opened
    assert all(file.closed for file in opened)


def test_names_of_example_robot_data():
    robot = pinimpact.load_robot("panda")
    assert isinstance(robot, pin.RobotWrapper)
    assert (robot.model.nq, robot.visual_model.ngeoms > 5) == (9, True)
    assert pinimpact.load_robot("solo12").model.joints[1].shortname() == "JointModelFreeFlyer"


@pytest.mark.parametrize(
    ("name", "free_flyer", "nv"), [("ur5", True, 12), ("ur5", False, 6), ("solo12", False, 12)]
)
def test_free_or_fixed_base_of_named_robots(name, free_flyer, nv):
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


def test_bundled_models_of_installed_package(tmp_path):
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
def test_unknown_names_suggest_similar_ones(name, offered):
    with pytest.raises(pinimpact.UnknownNameError, match=offered) as caught:
        pinimpact.load_robot(name)
    assert caught.value.field == "robot"
    assert caught.value.value == name


def test_missing_file_is_named():
    with pytest.raises(pinimpact.ModelError, match=r"there is no file .*nothing\.urdf"):
        pinimpact.load_robot("here/nothing.urdf")


@pytest.mark.parametrize("text", ["", "<robot", "<robot name='x'></robot>", "no xml at all"])
def test_invalid_file_is_named(tmp_path, text):
    path = tmp_path / "broken.urdf"
    path.write_text(text)
    with pytest.raises(pinimpact.ModelError, match=r"broken\.urdf"):
        pinimpact.load_robot(path)


@pytest.mark.parametrize(
    ("right", "wrong", "said"),
    [
        ("</robot>", "", "no element found: line 17"),
        ('type="revolute"', 'type="hinge"', r"Joint \[hinge\] has no known type \[hinge\]"),
        ('child link="arm"', 'child link="hand"', r"child link \[hand\] of joint \[hinge\] not found"),
        (
            'mass value="1"',
            'mass value="${m}"',
            r"value='\$\{m\}' given for the mass of link 'arm', a finite number",
        ),
        ('ixy="0"', 'ixy=""', "ixy='' given for the inertia of link 'arm'"),
    ],
)
def test_errors_of_urdf_are_explained(urdf, right, wrong, said):
    path = urdf()
    path.write_text(path.read_text().replace(right, wrong))
    with pytest.raises(pinimpact.ModelError, match=said):
        pinimpact.load_robot(path)


def test_robot_without_inertia_raises(urdf):
    with pytest.raises(pinimpact.ModelError, match="no inertia"):
        pinimpact.load_robot(urdf(inertial=""))


def test_robot_with_missing_mesh_is_loaded_with_a_warning(urdf):
    with pytest.warns(UserWarning, match=r"lost\.stl"):
        robot = pinimpact.load_robot(urdf(visual=LOST_MESH))
    assert robot.visual_model.ngeoms == 0
    assert np.isfinite(pin.crba(robot.model, robot.data, robot.q0)).all()


# ---- contents of URDF files that Pinocchio ignores without a warning

TIP = """<joint name="tip" type="revolute"><parent link="right_finger"/><child link="right_tip"/>
  <origin xyz="1 0 0"/><axis xyz="0 0 1"/>{limit}<mimic joint="right" multiplier="0.5" offset="-0.3"/></joint>
<link name="right_tip">{inertial}</link>"""


@pytest.fixture
def gripper(tmp_path):
    def write(leader="left"):
        path = tmp_path / "gripper.urdf"
        path.write_text(cases.gripper(leader, INERTIAL, TIP))
        return path

    return write


def test_ignored_mimic_joints_warn(gripper):
    with pytest.warns(UserWarning, match=r"mimic joints right, tip of ") as caught:
        robot = pinimpact.load_robot(gripper())
    assert robot.model.nv == 4
    assert caught[0].filename == __file__
    assert pinimpact.load_robot(gripper(), mimic=False).model.nv == 4


def test_coupled_mimic_joints(gripper):
    """Compare v⁺ with that from Gᵀ M G and J G of the uncoupled robot at q = G p + g."""
    one, free = pinimpact.load_robot(gripper(), mimic=True), pinimpact.load_robot(gripper(), mimic=False)
    assert (one.nq, one.nv, len(one.q0)) == (2, 2, 2)
    coupling = np.array([[1, 0], [0, 1], [0, -2], [0, -1]])  # the tip mimics a mimic joint
    q, v = np.array([0.3, 0.7]), np.array([1.0, -0.5])
    full = coupling @ q + [0, 0, 0.1, 0.5 * 0.1 - 0.3]
    contact = pinimpact.Contact(
        "right_tip", pinimpact.Plane(normal=(1, 2, 3)), friction=0.3, restitution=0.5, offset=(1, 0, 0)
    )
    other = pinimpact.contact_matrices(free.model, free.data, full, contact)
    mass = coupling.T @ other.mass @ coupling
    jacobian = other.jacobian @ coupling
    if (jacobian @ v)[2] > 0:
        v = -v
    delassus = jacobian @ np.linalg.solve(mass, jacobian.T)
    hit = pinimpact.impact(one.model, one.data, q, v, contact)
    solution = pinimpact.solve_impact(pinimpact.ImpactProblem(delassus, jacobian @ v, 0.3, 0.5))
    expected = v + np.linalg.solve(mass, jacobian.T @ solution.impulse)
    assert hit.v == pytest.approx(expected, abs=1e-12)
    assert np.abs(hit.v - v).max() > 0.1


def test_coupled_mimic_joints_of_named_robot():
    robot = pinimpact.load_robot("panda", mimic=True)
    assert (robot.nq, robot.nv, len(robot.q0)) == (8, 8, 8)
    assert robot.visual_model.ngeoms == pinimpact.load_robot("panda").visual_model.ngeoms
    with pytest.raises(pinimpact.ModelError, match="panda_finger_joint2"):
        pinimpact.simulate(pinimpact.Scene(robot), robot.q0, np.zeros(8), 0.1)


@pytest.mark.parametrize("leader", ["tip", "nobody"])
def test_invalid_mimic_joints_are_named(gripper, leader):
    with pytest.warns(UserWarning, match=r"cannot couple the joints right\b"):
        robot = pinimpact.load_robot(gripper(leader), mimic=True)
    assert robot.model.nv >= 3


def test_negative_mass_is_named(urdf):
    path = urdf(inertial=INERTIAL.replace('mass value="1"', 'mass value="-2.5"'))
    with pytest.raises(pinimpact.ModelError, match=r"link 'arm' is negative \(-2\.5 kg\)"):
        pinimpact.load_robot(path)
    model = pin.Model()
    model.addJointFrame(model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift"))
    model.appendBodyToJoint(1, pin.Inertia(-2.5, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    with pytest.raises(pinimpact.ModelError, match=r"the negative mass -2\.5 kg of joint 'lift'"):
        pinimpact.impact(model, model.createData(), [0.0], [-1.0], pinimpact.Contact(1, pinimpact.Plane()))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('value="1"', 'value=" 2 "', r"value=' 2 ' given for the mass .*, without spaces after it, expected"),
        ('value="1"', 'value="1,5"', "value='1,5' given for the mass of link 'arm', a finite number"),
        ('value="1"', 'value="nan"', "value='nan'"),
        ('value="1"', 'value="1e400"', "value='1e400'"),
        ('value="1"', "", "no value given for the mass"),
        ('<mass value="1"/>', "", "no value given for the mass"),
        ('ixx="1"', 'ixx="inf"', "ixx='inf' given for the inertia"),
        ('izz="1"', "", "no izz given for the inertia"),
        ('<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>', "", "no ixx given for the inertia"),
        ("<mass", '<origin xyz="0 0"/><mass', "xyz='0 0' given for the origin .* three finite numbers"),
        ("<mass", '<origin xyz="0 0 a"/><mass', "xyz='0 0 a'"),
        ("<mass", '<origin xyz="0 0 nan"/><mass', "xyz='0 0 nan'"),
        ("<mass", '<origin xyz="0\t0 1"/><mass', r"xyz='0\\t0 1'"),
        ("<mass", '<origin rpy="0 0"/><mass', "rpy='0 0'"),
    ],
)
def test_inertials_that_urdfdom_drops_are_named(urdf, old, new, message):
    with pytest.raises(pinimpact.ModelError, match=message):
        pinimpact.load_robot(urdf(inertial=INERTIAL.replace(old, new)))


@pytest.mark.parametrize("mass", [" 2", "+2.", ".2e1"])
def test_inertials_that_urdfdom_reads(urdf, mass):
    given = f'<origin xyz=" 0  0 1 "/><mass unit="kg" value="{mass}"'
    robot = pinimpact.load_robot(urdf(inertial=INERTIAL.replace('<mass value="1"', given)))
    assert robot.model.inertias[1].mass == 2.0
    assert robot.model.inertias[1].lever.tolist() == [0.0, 0.0, 1.0]


BOX = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
MESH = '<visual><geometry><mesh filename="package://shapes/box.obj"/></geometry></visual>'
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def test_meshes_in_given_package_folders(urdf, tmp_path):
    package = tmp_path / "far" / "away" / "shapes"
    package.mkdir(parents=True)
    (package / "box.obj").write_text(OBJ)
    path = urdf(visual=MESH)
    assert pinimpact.load_robot(path, package_dirs=[package.parent]).visual_model.ngeoms == 1
    with pytest.warns(UserWarning, match=r"package://shapes/box\.obj; set package_dirs"):
        assert pinimpact.load_robot(path).visual_model.ngeoms == 0


def test_missing_mesh_removes_only_its_shape(urdf, tmp_path):
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "box.obj").write_text(OBJ)
    path = urdf(visual=LOST_MESH + MESH + BOX + MESH)
    with pytest.warns(UserWarning, match=r"lost\.stl") as caught:
        robot = pinimpact.load_robot(path)
    assert "box.obj" not in str(caught[0].message)
    assert robot.visual_model.ngeoms == 3
    assert {shape.parentJoint for shape in robot.visual_model.geometryObjects} == {1}


# ---- MuJoCo's files, and those that cannot be read

MJCF = """<mujoco model="hopper"><compiler angle="degree" meshdir="shapes"/><option gravity="0 0 -3"/>
<asset><mesh name="there" file="box.obj"/><mesh name="lost" file="lost.obj"/></asset>
<worldbody><geom type="plane" size="1 1 .1"/>
  <body name="base" pos="0 0 1"><freejoint name="root"/><geom type="box" size=".1 .1 .1" mass="2"/>{geoms}
    <body name="leg" pos="0 0 -.1">
      <joint name="knee" type="hinge" axis="0 1 0" range="-90 90"
        damping="0.1" armature="0.01" frictionloss=".2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1"/><site name="tip" pos="0 0 -.3"/>
    </body>
  </body>
</worldbody>{more}
<keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.3"/></keyframe></mujoco>"""


@pytest.fixture
def mjcf(tmp_path):
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "box.obj").write_text(OBJ)

    def write(geoms="", more=""):
        path = tmp_path / "hopper.xml"
        path.write_text(MJCF.format(geoms=geoms, more=more))
        return path

    return write


def test_robot_from_mjcf(mjcf):
    robot = pinimpact.load_robot(mjcf())
    model = robot.model
    assert list(model.names)[1:] == ["root", "knee"]
    assert robot.q0.tolist() == [0, 0, 1, 0, 0, 0, 1, 0.3]
    assert (model.damping[6], model.armature[6], model.friction[6]) == (0.1, 0.01, 0.2)
    assert model.lowerPositionLimit[7] == pytest.approx(-np.pi / 2)
    assert model.gravity.linear.tolist() == [0, 0, -3]
    assert robot.visual_model.ngeoms >= 2
    ground = pinimpact.Contact("tip", pinimpact.Plane(point=(0, 0, 0.5)), restitution=0.5)
    trajectory = pinimpact.simulate(
        pinimpact.Scene(robot, [ground], without=["joint damping", "joint friction"]),
        robot.q0,
        np.zeros(7),
        0.5,
    )
    gap = ground.gap(model, robot.data, robot.q0)
    assert trajectory.impacts[0].time == pytest.approx(np.sqrt(2 * gap / 3), rel=1e-8)


ROD = '<geom type="capsule" fromto="0 0 0 .1 .02 -.4" size=".03"/>'
PART = """<mujoco><compiler angle="radian" {compiler}/><option gravity="1 2 -3"/>{option}<worldbody>
<body pos="0 0 1" {body}><joint name="a" axis="0 1 .3" {joint}/>{rod}</body></worldbody></mujoco>"""


def part_of_mujoco(path, compiler="", option="", body="", joint=""):
    path.write_text(PART.format(compiler=compiler, option=option, body=body, joint=joint, rod=ROD))
    return path


def test_joint_limits_from_mjcf(tmp_path):
    text = """<mujoco><worldbody><body name="one" pos="0 0 1"><freejoint/>{rod}
      <body name="two"><joint name="a" axis="0 1 0" ref="30" range="-50 100"/>{rod}
        <body name="three"><joint name="b" type="slide" axis="1 0 0" ref=".2" range="-1 3"/>{rod}</body>
      </body></body></worldbody></mujoco>"""
    path = tmp_path / "x.xml"
    path.write_text(text.format(rod=ROD))
    robot = pinimpact.load_robot(path)
    model = robot.model
    np.testing.assert_allclose(robot.q0, [0, 0, 1, 0, 0, 0, 1, np.pi / 6, 0.2], rtol=1e-15)
    np.testing.assert_allclose(model.lowerPositionLimit[7:], [np.deg2rad(-50.0), -1.0], rtol=1e-14)
    np.testing.assert_allclose(model.upperPositionLimit[7:], [np.deg2rad(100.0), 3.0], rtol=1e-14)


def test_last_gravity_of_mjcf_is_used(tmp_path):
    path = tmp_path / "x.xml"
    twice = part_of_mujoco(path, option='<option timestep=".1"/><option gravity="0 1 -4"/>')
    assert pinimpact.load_robot(twice).model.gravity.linear.tolist() == [0, 1, -4]
    without = part_of_mujoco(path, option='<option><flag gravity="disable"/></option>')
    assert pinimpact.load_robot(without).model.gravity.linear.tolist() == [0, 0, 0]


def test_free_base_for_mjcf_with_joints_to_the_world_raises(tmp_path):
    path = part_of_mujoco(tmp_path / "x.xml")
    with pytest.raises(pinimpact.ModelError, match=r"free_flyer: True .* has joints to the world"):
        pinimpact.load_robot(path, free_flyer=True)
    path.write_text(path.read_text().replace('<joint name="a" axis="0 1 .3" />', ""))
    assert pinimpact.load_robot(path, free_flyer=True).model.nv == 6


def test_pose_of_free_base_of_mjcf_is_that_of_mujoco(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "x.xml"
    path.write_text(
        '<mujoco><worldbody><body name="base" pos="0.1 0.2 1" quat="0.5 0.1 -0.7 0.2"><freejoint/>'
        '<geom size=".1"/><body name="leg" pos="0 0.3 0.1" euler="20 30 40"><joint axis="1 2 0"/>'
        '<geom size=".1" pos=".2 0 0"/></body></body></worldbody></mujoco>'
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot = pinimpact.load_robot(path)
    theirs = mujoco.MjModel.from_xml_path(str(path))
    state = mujoco.MjData(theirs)
    for q in (robot.q0, pin.integrate(robot.model, robot.q0, np.linspace(-1.0, 1.0, 7))):
        state.qpos[:] = q
        state.qpos[3:7] = np.roll(q[3:7], 1)
        mujoco.mj_kinematics(theirs, state)
        pin.framesForwardKinematics(robot.model, robot.data, q)
        for body in ("base", "leg"):
            place = robot.data.oMf[robot.model.getFrameId(body)]
            assert place.translation == pytest.approx(state.body(body).xpos, abs=1e-12)
            assert place.rotation.ravel() == pytest.approx(state.body(body).xmat, abs=1e-12)


def test_moved_bodies_of_mjcf_are_named(tmp_path):
    """Pinocchio ignores the pose of a body that does not move, here displaced and turned about z."""
    pytest.importorskip("mujoco")
    for pose in ('pos="1 0 0"', 'euler="0 0 90"'):
        path = tmp_path / "x.xml"
        path.write_text(
            f'<mujoco><worldbody><body name="wall" {pose}><body name="arm"><joint axis="0 1 0"/>'
            '<geom size=".1" pos=".2 0 0"/></body></body></worldbody></mujoco>'
        )
        with pytest.warns(UserWarning, match="differs from MuJoCo's in positions: "):
            pinimpact.load_robot(path)


def test_ignored_trees_of_mjcf_are_named(tmp_path):
    body = '<body name="{0}"><joint name="{0}"/>' + ROD + "</body>"
    path = tmp_path / "x.xml"
    still = '<body name="table"><geom type="box" size="1 1 1"/></body>'
    path.write_text(f"<mujoco><worldbody>{body.format('a')}{still}</worldbody></mujoco>")
    assert pinimpact.load_robot(path).model.nv == 1
    path.write_text(f"<mujoco><worldbody>{''.join(map(body.format, 'abc'))}</worldbody></mujoco>")
    with pytest.warns(UserWarning, match=r"only the first moving body of .* load the others \(b, c\)"):
        pinimpact.load_robot(path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ""),
        ({"joint": 'damping=".3" armature=".02" frictionloss=".1" range="-1 2" ref=".5"'}, ""),
        ({"joint": 'stiffness="20" springref=".3"'}, "springs, damping or other passive forces"),
        ({"body": 'gravcomp="1"'}, "springs, damping or other passive forces"),
        ({"joint": 'range="-1 2" limited="false"'}, "joint limits"),
        ({"compiler": 'eulerseq="ZYX"', "body": 'euler=".3 .5 .7"'}, "gravity or axes"),
        ({"compiler": 'boundmass="5" boundinertia=".1"'}, "inertia, gravity or axes"),
        ({"joint": 'range="-1 2"/><joint type="slide" axis="1 0 0" ref=".3" range="-3 1"'}, ""),
    ],
)
def test_differences_from_mujoco_are_named(tmp_path, changes, said):
    pytest.importorskip("mujoco")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        pinimpact.load_robot(part_of_mujoco(tmp_path / "x.xml", **changes))
    texts = [str(warning.message) for warning in caught]
    assert len(texts) == bool(said)
    assert all(f"differs from MuJoCo's in {said}: " in text for text in texts)


def test_missing_mesh_of_mjcf_removes_only_its_shape(mjcf):
    without = pinimpact.load_robot(mjcf()).visual_model.ngeoms
    meshes = '<geom type="mesh" mesh="there" mass="1"/><geom type="mesh" mesh="lost" mass="1"/>'
    with pytest.warns(UserWarning, match=r"meshes .*: lost\.obj$") as caught:
        robot = pinimpact.load_robot(mjcf(meshes))
    assert caught[0].filename == __file__
    assert robot.visual_model.ngeoms == without + 1


def test_ignored_constraints_of_mjcf_warn(mjcf):
    weld = '<equality><weld body1="leg"/></equality>'
    with pytest.warns(UserWarning, match=r"equality constraints of .* \(weld\) are ignored"):
        pinimpact.load_robot(mjcf(more=weld))


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("robot.sdf", "<sdf version='1.7'><model name='x'/></sdf>", "without SDFormat"),
        ("robot.urdf.xacro", "<robot name='x'/>", r"xacro robot\.urdf\.xacro > robot\.urdf"),
        ("robot.xml", "<mujoco model='x'><worldbody/></mujoco>", "not an MJCF file that Pinocchio can read"),
    ],
)
def test_unsupported_file_formats_raise(tmp_path, name, text, said):
    if "sdf" in name and pin.WITH_SDFORMAT:
        pytest.skip("this Pinocchio reads SDF")
    (tmp_path / name).write_text(text)
    with pytest.raises(pinimpact.ModelError, match=said):
        pinimpact.load_robot(tmp_path / name)


def test_robots_of_one_name_share_their_meshes_only() -> None:
    """A robot is as example-robot-data loads it, whatever was done to an earlier one."""
    first, expected = pinimpact.load_robot("panda"), ROBOTS["panda"]().robot
    first.model.friction[:] = 3.0
    first.q0[:] = 9.0
    first.visual_model.geometryObjects[0].placement = pin.SE3.Random()
    first.collision_model.removeAllCollisionPairs()
    second = pinimpact.load_robot("panda")
    assert second.model == expected.model
    np.testing.assert_array_equal(second.q0, expected.q0)
    assert vars(second).keys() == vars(expected).keys()
    assert second.collision_model.collisionPairs.tolist() == expected.collision_model.collisionPairs.tolist()
    for shapes, others in (
        (second.visual_model, expected.visual_model),
        (second.collision_model, expected.collision_model),
    ):
        for shape, other in zip(shapes.geometryObjects, others.geometryObjects, strict=True):
            assert (shape.name, shape.placement) == (other.name, other.placement)
