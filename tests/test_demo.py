"""The demo: impacts of all named robots as requested, or an error of one sentence."""

from __future__ import annotations

import json
import re
import warnings
from functools import lru_cache
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner

import pinimpact
from pinimpact.app.cli import main
from pinimpact.app.demo import FIXED_BASE, FREE_BASE, Demo, run_demo
from pinimpact.app.posture import Body
from pinimpact.app.report import rounded
from pinimpact.app.robot_info import robot_facts, suggested_frames
from pinimpact.robot.loading import load_robot, named_robots
from pinimpact.robot.names import free_base

FIXED = """<robot name="post"><link name="base"/>
<joint name="weld" type="fixed"><parent link="base"/><child link="top"/></joint>
<link name="top">{inertial}</link>
</robot>"""
PENDULUM = """<robot name="pendulum"><link name="base"/>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="9" velocity="9"/></joint><link name="arm">{inertial}</link>
<joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0 0 -0.5"/></joint>
<link name="tip"/>
<joint name="idle" type="revolute"><parent link="arm"/><child link="flag"/><axis xyz="1 0 0"/>
<limit lower="-3" upper="3" effort="9" velocity="9"/></joint><link name="flag"/></robot>"""
INERTIAL = """<inertial><origin xyz="0 0 -0.3"/><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>"""


def call(*args: str):
    return CliRunner().invoke(main, args)


def written(tmp_path: Path, text: str) -> str:
    path = tmp_path / "own.urdf"
    path.write_text(text.format(inertial=INERTIAL), encoding="utf-8")
    return str(path)


@lru_cache(maxsize=12)
def demo_of(name: str) -> Demo:
    """Return the demo of a named robot, which several tests look at."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # mimic joints, and meshes that a distribution lacks
        return run_demo(name)


def test_demo_of_urdf_with_massless_joint(tmp_path: Path) -> None:
    """The pendulum hangs down, so its tip can strike a wall along x only; the massless joint is fixed."""
    shown = run_demo(written(tmp_path, PENDULUM))
    assert shown.contact.label == "tip on table"
    assert shown.frozen == ("idle",)
    assert np.abs(shown.contact.plane.normal) == pytest.approx([1, 0, 0])
    assert np.asarray(shown.impact.problem.velocity) == pytest.approx(
        [0, 0, -np.linalg.norm((0.5, 0.3, 0.8))]
    )
    # a pendulum of inertia I = 0.1 + 0.3² m, struck at 0.5 m: P = (1 + e) v I / 0.5²
    e = shown.impact.problem.restitution
    expected = (1 + e) * np.linalg.norm((0.5, 0.3, 0.8)) * 0.19 / 0.25
    assert shown.impact.solution.impulse[2] == pytest.approx(expected, rel=1e-6)


def test_urdf_without_shapes_is_replayed_in_lines(tmp_path: Path) -> None:
    result = call("demo", written(tmp_path, PENDULUM), "-o", str(tmp_path / "out"))
    assert result.exit_code == 0, result.output
    assert re.search(
        r"Normal of the table: \(-?1, 0, 0\); the frame cannot move down in this posture", result.output
    )
    assert not re.search(r"e-1[4-9]", result.output)  # rounding errors of zero
    assert "Joints without inertia are fixed: idle." in result.output
    assert (tmp_path / "out" / "replay.html").stat().st_size > 100_000


def test_rounding_errors_are_distinguished_from_small_numbers() -> None:
    assert rounded([1.0, 3e-15, -8e-15, 1e-12]) == [1.0, 0.0, -8e-15, 1e-12]
    assert rounded([1e-20, 2e-22]) == [1e-20, 2e-22]
    assert rounded([1e-20, 2e-22], size=1.0) == [0.0, 0.0]
    assert rounded([]) == []


def test_suggested_contact_frames_are_ends_of_chains() -> None:
    arm = load_robot(str(Path(__file__).parents[1] / "examples" / "arm.urdf"))
    assert robot_facts("arm", arm)["contact_frames"] == ["tip"]  # not the hand to which it is fixed
    assert "At joint origins: link2; offset=" in call("info", "double_pendulum").output


def test_demo_with_given_frame_velocity_and_normal() -> None:
    shown = run_demo(
        "ur5",
        "wrist_3_link",
        speed=1.5,
        direction=(1.0, 0.2, -0.5),
        normal=(-2.0, 0.0, 1.0),
        friction=0.7,
        restitution=0.2,
        law="newton",
    )
    impact, contact = shown.impact, shown.contact
    assert contact.label == "wrist_3_link on table"
    assert contact.plane.normal == pytest.approx(np.array([-2, 0, 1]) / np.sqrt(5))
    model, data = shown.robot.model, shown.robot.model.createData()
    frame = model.getFrameId("wrist_3_link")
    jacobian = pin.computeFrameJacobian(model, data, impact.q, frame, pin.LOCAL_WORLD_ALIGNED)[:3]
    direction = np.array([1.0, 0.2, -0.5]) / np.linalg.norm([1.0, 0.2, -0.5])
    assert jacobian @ impact.v_before == pytest.approx(1.5 * direction, abs=1e-5)
    assert impact.solution.velocity[2] == pytest.approx(-0.2 * impact.problem.velocity[2], rel=1e-9)
    assert (impact.problem.friction, impact.problem.law) == (0.7, "newton")


def test_robot_with_free_base_lands_on_its_lowest_foot() -> None:
    shown = run_demo("go2")
    data = shown.robot.model.createData()
    gaps = [contact.gap(shown.robot.model, data, shown.impact.q) for contact in shown.contacts]
    assert [contact.frame for contact in shown.contacts[1:]] == ["FR_foot", "RL_foot", "RR_foot"]
    assert shown.contact.frame == "FL_foot"
    assert gaps[0] == pytest.approx(0.0, abs=1e-9)
    assert min(gaps[1:]) > 0.0
    assert np.asarray(shown.impact.problem.velocity) == pytest.approx(FREE_BASE, abs=1e-4)


@pytest.mark.parametrize("name", ["simple_humanoid", "talos_legs"])
def test_biped_lands_on_its_feet(name: str) -> None:
    """After the impact the base rotates by less than 6°, and forces are at most ten times the weight.

    An inverted pendulum with the same tilt would rotate by 17° in this time.
    """
    shown = run_demo(name)
    trajectory, model = shown.trajectory, shown.robot.model
    first, last = (pin.XYZQUATToSE3(q[:7]).rotation for q in (shown.impact.q, trajectory.q[-1]))
    assert np.degrees(np.linalg.norm(pin.log3(first.T @ last))) < 6.0
    times = np.linspace(0.0, trajectory.duration, 300)
    force = sum(trajectory.forces(contact.label, times)[:, 2] for contact in shown.contacts)
    assert force.max() < 10.0 * 9.81 * pin.computeTotalMass(model)
    assert shown.stopped is None


@pytest.mark.slow
def test_hand_strikes_level_table_with_moderate_joint_speeds() -> None:
    """The thumb can hardly move in one direction, which is ignored; it would need 100 rad/s."""
    shown = run_demo("allegro_right_hand")
    assert not shown.turned
    assert np.abs(shown.impact.v_before).max() < 20.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tiago", pytest.param("tiago_dual", marks=pytest.mark.exhaustive)])
def test_table_of_tall_robot_is_below_its_head(name: str) -> None:
    shown = demo_of(name)
    data = shown.robot.model.createData()
    pin.framesForwardKinematics(shown.robot.model, data, shown.impact.q)
    head = data.oMf[shown.robot.model.getFrameId("head_2_link")].translation
    assert shown.contact.plane.point[2] < head[2] - 0.2


ARMS = "ur3", "panda", "z1", "xarm7", "kinova", "talos_arm", "allegro_left_hand"
WITH_FREE_BASES = "talos", "anymal_c", "icub", "hector", "bolt"


@pytest.mark.parametrize(
    "name",
    [
        "ur5",
        "iris",
        "solo12",
        *(pytest.param(n, marks=pytest.mark.exhaustive) for n in ARMS + WITH_FREE_BASES),
    ],
)
def test_no_mesh_penetrates_the_table(name: str) -> None:
    """Pinocchio computes the distances between the meshes and the plate that the replay shows."""
    shown = demo_of(name)
    model, q, shapes = shown.robot.model, shown.impact.q, shown.robot.visual_model.copy()
    page = pinimpact.replay(shown.robot, shown.trajectory, None).html
    motion = json.loads(re.search(r'<script id="motion" type="application/json">(.*?)</script>', page)[1])
    (plate,) = motion["surfaces"]
    place = np.reshape(plate["matrix"], (4, 4)).T
    size = motion["view"]["size"]
    box = pin.GeometryObject("plate", 0, 0, pin.SE3(place), coal.Box(*plate["size"]))
    table = shapes.addGeometryObject(box)
    for k in range(table):
        shapes.addCollisionPair(pin.CollisionPair(k, table))
    distances = shapes.createData()
    pin.computeDistances(model, model.createData(), shapes, distances, q)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    frame = (
        shown.contact.frame if isinstance(shown.contact.frame, int) else model.getFrameId(shown.contact.frame)
    )
    own = set(model.subtrees[model.frames[frame].parentJoint])
    others = [
        result.min_distance
        for result, shape in zip(distances.distanceResults, shapes.geometryObjects, strict=False)
        if shape.parentJoint not in own
    ]
    assert min(others, default=1.0) > 0.0
    point = data.oMf[frame].act(np.asarray(shown.contact.offset))
    assert point == pytest.approx(shown.contact.plane.point, abs=1e-6)
    nearest = min(
        float(((np.array(shape.geometry.vertices()) @ at.rotation.T + at.translation) - point)[:, 2].min())
        for shape in shapes.geometryObjects
        if shape.parentJoint in own and hasattr(shape.geometry, "vertices")
        for at in [data.oMi[shape.parentJoint] * shape.placement]
    )
    assert abs(nearest) < 2e-3 * size  # in contact at the impact
    before = shown.trajectory.at(0.5 * shown.impact.time)
    assert (
        0.0
        < shown.contact.gap(model, data, before[0])
        < shown.contact.gap(model, data, shown.trajectory.q[0])
    )


@pytest.mark.parametrize("own", [False, True])
def test_object_without_joints_falls(own: bool, tmp_path: Path) -> None:
    shown = run_demo(
        written(tmp_path, FIXED)
        if own
        else str(Path(__file__).parents[1] / "examples" / "scenes" / "ball.urdf")
    )
    model, impact = shown.robot.model, shown.impact
    assert model.joints[1].shortname() == "JointModelFreeFlyer"
    data = model.createData()
    momenta = []
    for v in (impact.v_before, impact.v_after):
        momenta.append(np.array(pin.computeCentroidalMomentum(model, data, impact.q, v).linear))
    assert momenta[1] - momenta[0] == pytest.approx(impact.impulse_world, rel=1e-9)
    q, v = shown.trajectory.q[0], shown.trajectory.v[0]
    start = np.array(pin.computeCentroidalMomentum(model, data, q, v).linear)
    fall = impact.time * pin.computeTotalMass(model) * np.array([0.0, 0.0, -9.81])
    assert momenta[0] - start == pytest.approx(fall, rel=1e-7, abs=1e-9)
    assert impact.impulse_world[2] > 0.0


def test_messages_for_impossible_demos(tmp_path: Path) -> None:
    assert call("info", written(tmp_path, FIXED)).exit_code == 0
    up = "0", "0", "1"
    for options, said in (
        (("two_link_arm", "--normal", "0", "1", "0"), "cannot move towards a table with this normal"),
        (("two_link_arm", "--normal", *up, "--direction", *up), "points away from the table"),
        (("two_link_arm", "--frame", "tpi"), "did you mean"),
        (("two_link_arm", "--frame", "world"), "no joint of two_link_arm moves frame 'world'"),
        (("two_link_arm", "--law", "newtonian"), "newton"),
        (("two_link_arm", "--friction", "-0.1"), "friction: -0.1"),
        (("two_link_arm", "--speed", "0"), "speed: 0.0"),
    ):
        result = call("demo", *options, "-o", str(tmp_path / "out"))
        assert result.exit_code == 1, result.output
        assert said in result.output
        assert len(result.output.strip().splitlines()) == 1, result.output


def test_options_of_the_command(tmp_path: Path) -> None:
    where = ["--frame", "tool0", "--speed", "0.5", "--direction", "0.1", "0", "-1", "--normal", "0", "0", "1"]
    how = ["--friction", "0.2", "--restitution", "0", "--law", "energetic"]
    result = call("demo", "ur5", *where, *how, "--json", "-o", str(tmp_path))
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    assert np.linalg.norm(facts["velocity_before"]) == pytest.approx(0.5, rel=1e-4)
    assert (facts["law"], facts["friction"], facts["restitution"]) == ("energetic", 0.2, 0.0)
    assert facts["velocity_after"][2] == pytest.approx(0.0, abs=1e-12)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hodograph.png", "replay.html"]


def test_suggested_contact_frames() -> None:
    for name, first in {
        "panda": ["panda_hand_tcp"],
        "solo12": ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"],
        "talos": ["left_sole_link", "right_sole_link"],
        "two_link_arm": ["tip"],
        "ellipsoid": ["tip"],
    }.items():
        model = pinimpact.load_robot(name).model
        assert [model.frames[i].name for i in suggested_frames(model)][: len(first)] == first


SAMPLES = (
    *("rod", "spherical_pendulum", "panda", "ur5", "allegro_left_hand", "cassie", "solo12"),
    *("iris", "tiago", "double_pendulum_continuous"),
)
"""An arm, a hand, feet, wings, wheels, joints of every kind, and a file that cannot be read."""


def robots() -> list[object]:
    """Return all named robots; those outside SAMPLES are marked as exhaustive."""
    more = pytest.mark.exhaustive
    names = [name for names in named_robots().values() for name in names]
    return [pytest.param(name, marks=[] if name in SAMPLES else more) for name in names]


@pytest.mark.slow
@pytest.mark.parametrize("name", robots())
def test_every_named_robot_has_consistent_impact_and_motion(name: str) -> None:
    """The work of the impact equals the change of kinetic energy; in the motion the energy balances."""
    if name == "cassie":  # an SDF file, which wheels of Pinocchio do not read
        with pytest.raises(pinimpact.ModelError, match="SDF"):
            demo_of(name)
        return
    shown = demo_of(name)
    impact, model = shown.impact, shown.robot.model
    data = model.createData()
    change = pin.computeKineticEnergy(model, data, impact.q, impact.v_after)
    change -= pin.computeKineticEnergy(model, data, impact.q, impact.v_before)
    assert impact.solution.work.total == pytest.approx(change, rel=1e-6, abs=1e-9)
    assert impact.problem.velocity[2] < 0.0
    assert shown.stopped is None or "another part reaches the table" in shown.stopped
    assert robot_facts(name, shown.robot)["contact_frames"]
    contact = pinimpact.Contact(shown.contact.frame, shown.contact.plane, friction=0.5, restitution=0.2)
    q, v = shown.trajectory.q[0], shown.trajectory.v[0]
    scene = pinimpact.Scene(model, [contact], without=("joint limits",))
    trajectory = pinimpact.simulate(scene, q, v, 0.05, rtol=1e-6)
    assert trajectory.complete
    size = 1.0 + np.abs(trajectory.energy.total).max()
    assert np.abs(trajectory.energy.residual).max() < 1e-4 * size
    assert free_base(model) == (model.joints[1].shortname() == "JointModelFreeFlyer")


@pytest.mark.parametrize(
    "name",
    ["solo12", "ur5"]
    + [
        pytest.param(n, marks=pytest.mark.exhaustive) for n in ("kinova", "panda", "talos_arm", "xarm7", "z1")
    ],
)
def test_contact_velocity(name: str) -> None:
    impact = demo_of(name).impact
    expected = FREE_BASE if free_base(demo_of(name).robot.model) else FIXED_BASE
    np.testing.assert_allclose(impact.problem.velocity, expected, rtol=1e-4, atol=1e-4)
    assert impact.solution.work.friction < 0.0


@pytest.mark.parametrize("name", ["iris", pytest.param("ur5", marks=pytest.mark.slow)])
def test_demo_ends_before_parts_without_contact_penetrate(name: str) -> None:
    shown = demo_of(name)
    model, shapes, plane = shown.robot.model, shown.robot.visual_model, shown.contact.plane
    data, heights = model.createData(), []
    for q in shown.trajectory.q:
        pin.forwardKinematics(model, data, q)
        places = [data.oMi[shape.parentJoint] * shape.placement for shape in shapes.geometryObjects]
        heights.append(
            [
                (
                    (shape.geometry.vertices() @ at.rotation.T + at.translation - plane.point) @ plane.axes[2]
                ).min()
                for shape, at in zip(shapes.geometryObjects, places, strict=True)
                if hasattr(shape.geometry, "vertices")
            ]
        )
    above = np.array(heights)[:, np.array(heights)[0] > 0.0]  # shapes next to the table may be below it
    size = Body(shown.robot).size
    assert shown.stopped is not None
    assert "another part reaches the table" in shown.stopped
    assert -0.011 * size < above.min() < -0.009 * size
    assert above.min() == above[-1].min()
