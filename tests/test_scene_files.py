"""Scene files: the scenes they describe, and error messages that name the key."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact.app.scene_loader import load_scene
from pinimpact.app.units import quantity
from pinimpact.robot.merging import Placed, assemble

SCENES = Path(__file__).parents[1] / "examples" / "scenes"
BALL = (
    (SCENES / "ball_on_conveyor.toml")
    .read_text(encoding="utf-8")
    .replace("ball.urdf", str(SCENES / "ball.urdf"))
)


def scene_of(tmp_path: Path, text: str):
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return load_scene(path)


def test_scene_has_values_of_file(tmp_path: Path) -> None:
    loaded = scene_of(tmp_path, BALL)
    np.testing.assert_allclose(loaded.q, [0, 0, 0.25, 0, 0, 0, 1])
    (contact,) = loaded.scene.contacts
    assert contact.label == "ball on belt"
    assert (contact.friction, contact.restitution, contact.radius) == (0.1, 0.4, 0.05)
    assert contact.plane == pinimpact.Plane(velocity=(2, 0, 0), name="belt")
    assert loaded.file.duration == 1.5


def test_sphere_has_values_of_file(tmp_path: Path) -> None:
    ball = '[sphere.post]\ncenter = [0, 0, "-10 cm"]\nradius = "10 cm"\nangular_velocity = [0, "60 rpm", 0]'
    text = BALL.replace('plane = "belt"', 'plane = "post"').replace("[[contact]]", f"{ball}\n\n[[contact]]")
    (contact,) = scene_of(tmp_path, text).scene.contacts
    spin = (0, 2 * math.pi, 0)
    assert contact.plane == pinimpact.Sphere((0, 0, -0.1), 0.1, angular_velocity=spin, name="post")
    with pytest.raises(pinimpact.UnknownNameError, match="'belt' is both a plane and a sphere"):
        scene_of(tmp_path, BALL.replace("[[contact]]", "[sphere.belt]\nradius = 1\n[[contact]]"))


def test_boxes_and_shapes_have_values_of_file(tmp_path: Path) -> None:
    text = (SCENES / "falling_arm.toml").read_text(encoding="utf-8")
    text += """
[box.block]
size = [0.2, 0.2, "10 cm"]
center = [2.0, 0, 0.05]
rpy = [0, 0, "90 deg"]
[shape.base]
geometry = "panda_link0_0"
[[contact]]
geometry = "panda_hand_0"
plane = "block"
[[contact]]
geometry = "panda_hand_0"
plane = "base"
"""
    contacts = scene_of(tmp_path, text).scene.contacts
    surfaces = {contact.pair.plane for contact in contacts if contact.pair is not None}
    block = pinimpact.Box((0.2, 0.2, 0.1), (2.0, 0.0, 0.05), (0.0, 0.0, math.pi / 2), name="block")
    assert surfaces == {block, pinimpact.Shape("panda_link0_0", name="base")}


def test_arm_falls_with_contacts_of_shapes_only() -> None:
    loaded = load_scene(SCENES / "falling_arm.toml")
    shapes = {contact.shape for contact in loaded.scene.contacts}
    assert shapes == {s.name for s in loaded.robot.collision_model.geometryObjects} - {"panda_link0_0"}
    contact = loaded.scene.contacts[-1]
    assert (contact.friction, contact.restitution, contact.law) == (0.5, 0.2, "energetic")
    assert contact.plane == pinimpact.Plane(name="floor")


def link(name: str, shape: str) -> str:
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="1"/>{inertia}</inertial>'
    return f'<link name="{name}">{inertial}<collision><geometry>{shape}</geometry></collision></link>'


def test_shapes_and_links_have_values_of_file(tmp_path: Path) -> None:
    hinge = '<joint name="hinge" type="continuous"><parent link="box"/><child link="can"/></joint>'
    shapes = link("box", '<box size="1 1 1"/>'), link("can", '<cylinder radius="1" length="1"/>')
    (tmp_path / "chest.urdf").write_text(f'<robot name="chest">{"".join(shapes)}{hinge}</robot>', "utf-8")
    text = BALL.replace(str(SCENES / "ball.urdf"), "chest.urdf").replace('name = "ball on belt"', "")
    text = text.replace('radius = "5 cm"', "")

    def names(what: str) -> list[str]:
        contacts = scene_of(tmp_path, text.replace('frame = "ball"', what)).scene.contacts
        return [contact.label for contact in contacts if contact.of_rim is None]

    assert names('geometry = "can_0"') == ["can_0 rim 1 on belt", "can_0 rim 2 on belt"]
    assert names('geometry = "box_0"\nname = "lid"')[0] == "lid corner 1"
    assert len(names('links = "all"')) == 10
    assert len(names('links = ["can"]\nrim_points = 3')) == 6
    for what, message in (
        ('links = "all"\nframe = "can"', r"contact\[0\]: frame and links given; give one of frame, geometry"),
        ("", r"contact\[0\]: none given"),
        ('links = "all"\nradius = 0.1', r"contact\[0\].radius: applies to a frame"),
        ('geometry = "can_0"\nheld = true', r"contact\[0\].held: applies to a frame"),
        ('links = "all"\nrim_points = 2', r"contact\[0\]: rim_points: 2 given"),
    ):
        with pytest.raises(pinimpact.InputError, match=message):
            names(what)
    with pytest.raises(
        pinimpact.UnknownNameError, match=r"contact\[0\]: links: no link 'cans' .* mean 'can'"
    ):
        names('links = ["cans"]')
    with pytest.raises(
        pinimpact.UnknownNameError, match="no collision shape is called 'can'; did you mean 'can_0'"
    ):
        names('geometry = "can"')


def test_joints_by_name_and_unit() -> None:
    loaded = load_scene(SCENES / "panda_strikes_table.toml")
    model = loaded.robot.model
    names = list(model.names)
    assert loaded.q[model.idx_qs[names.index("panda_joint2")]] == pytest.approx(-math.pi / 6)
    assert loaded.q[model.idx_qs[names.index("panda_joint4")]] == -2.2
    assert loaded.v[model.idx_vs[names.index("panda_joint1")]] == pytest.approx(math.pi / 6)
    assert loaded.q[model.idx_qs[names.index("panda_joint6")]] == loaded.robot.q0[5]
    bias = pin.nonLinearEffects(model, model.createData(), loaded.q, loaded.v)
    np.testing.assert_allclose(loaded.scene.control(0.0, loaded.q, loaded.v), bias - 0.5 * loaded.v)


def test_initial_state_of_free_base(tmp_path: Path) -> None:
    more = 'rpy = [0, 0, "90 deg"]\nvelocity = [1, 0, 0]\nangular_velocity = [0, 0, "60 rpm"]\n[plane.belt]'
    loaded = scene_of(tmp_path, BALL.replace("[plane.belt]", more))
    np.testing.assert_allclose(loaded.q, [0, 0, 0.25, 0, 0, math.sqrt(0.5), math.sqrt(0.5)])
    np.testing.assert_allclose(loaded.v, [0, -1, 0, 0, 0, 2 * math.pi], atol=1e-15)  # in axes of the base


def test_control_excludes_free_base() -> None:
    loaded = load_scene(SCENES / "solo12_landing.toml")
    moved = pin.integrate(loaded.robot.model, loaded.q, 0.1 * np.ones(18))
    force = loaded.scene.control.drives(loaded.robot.model)(0.0, moved, np.ones(18))
    np.testing.assert_allclose(force, [0.0] * 6 + [-6.0 * 0.1 - 0.15] * 12, rtol=1e-9)


def test_sliding_friction_of_file(tmp_path: Path) -> None:
    text = BALL.replace("[[contact]]", "[[contact]]\nsliding_friction = 0.35")
    (contact,) = scene_of(tmp_path, text).scene.contacts
    assert (contact.friction, contact.sliding_friction) == (0.1, 0.35)


def test_step_size_of_file(tmp_path: Path) -> None:
    loaded = scene_of(
        tmp_path, BALL.replace("duration = 1.5", 'duration = 0.05\nscheme = "time-stepping"\ndt = "2 ms"')
    )
    times = loaded.run().t
    np.testing.assert_allclose(times, np.linspace(0.0, 0.05, len(times)), atol=1e-12)
    assert np.diff(times) == pytest.approx(2e-3)


def test_control_period_of_file(tmp_path: Path) -> None:
    text = (SCENES / "solo12_landing.toml").read_text(encoding="utf-8")
    sampled = text.replace("[control]", '[control]\nperiod = "2 ms"\ndelay = 3e-3')
    loaded = scene_of(tmp_path, sampled)
    assert (loaded.scene.period, loaded.scene.delay) == (2e-3, 3e-3)
    assert load_scene(SCENES / "solo12_landing.toml").scene.period is None
    for wrong, key in (
        ('period = "0 ms"', r"control\.period"),
        ('period = "2 N"', r"control\.period"),
        ('period = "2 ms"\ndelay = -1', r"control\.delay"),
        ('delay = "1 ms"', r"control\.delay.* set control\.period"),
    ):
        with pytest.raises(pinimpact.InputError, match=key):
            scene_of(tmp_path, text.replace("[control]", f"[control]\n{wrong}"))


def test_two_arms_in_one_scene() -> None:
    loaded = load_scene(SCENES / "two_arms.toml")
    model, one = loaded.robot.model, pinimpact.load_robot("ur5").model
    assert (model.nq, model.njoints) == (2 * one.nq, 2 * (one.njoints - 1) + 1)
    data, alone = model.createData(), one.createData()
    pin.framesForwardKinematics(model, data, loaded.q)
    pin.framesForwardKinematics(one, alone, loaded.q[one.nq :])
    table = loaded.file.robot[1]
    base = pin.SE3(pin.rpy.rpyToMatrix(*table.rpy), np.array(table.position))
    expected = base * alone.oMf[one.getFrameId("tool0")]
    assert data.oMf[model.getFrameId("right_tool0")].isApprox(expected, 1e-12)
    mass = pin.crba(model, data, loaded.q)
    assert not mass[: one.nv, one.nv :].any()
    assert loaded.robot.visual_model.ngeoms == 2 * pinimpact.load_robot("ur5").visual_model.ngeoms


def test_robots_without_distinct_prefixes_raise() -> None:
    arm = Placed(pinimpact.load_robot("two_link_arm"), "", pin.SE3.Identity())
    with pytest.raises(pinimpact.InputError, match="give each its own prefix"):
        assemble([arm, arm])


ROTOR = """<mujoco model="arm"><option gravity="0 0 -1.62"/><worldbody><body name="a" pos="0 0 1">
<joint name="j" type="hinge" axis="0 1 0" armature="0.3" damping="0.2" frictionloss="0.1"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia=".1 .1 .1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("placed", ['prefix = "own "', "position = [0, 0, 1]", 'rpy = [0, 0, "90 deg"]'])
def test_placed_robot_is_the_robot(placed: str, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ROTOR)
    (tmp_path / "scene.toml").write_text(f'duration = 0.1\n[[robot]]\nurdf = "arm.xml"\n{placed}\n')
    model, own = (
        load_scene(tmp_path / "scene.toml").scene.model,
        pinimpact.load_robot(tmp_path / "arm.xml").model,
    )
    assert own.armature == [0.3]
    for name in ("armature", "damping", "friction", "lowerPositionLimit", "upperPositionLimit"):
        assert np.array_equal(getattr(model, name), getattr(own, name))
    assert np.array_equal(model.gravity.linear, [0.0, 0.0, -1.62])


def test_compensated_arm_stays_at_rest_without_gravity(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    for without in ("", 'without = ["gravity"]\n'):
        file.write_text(
            f'duration = 0.1\n{without}[control]\ncancel_gravity = true\n[[robot]]\nname = "ur5"\n'
        )
        run = load_scene(file).run()
        assert np.abs(run.q[-1] - run.q[0]).max() < 1e-12


def test_robots_with_different_gravity(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ROTOR)
    robots = '[[robot]]\nurdf = "arm.xml"\n[[robot]]\nname = "ur5"\nprefix = "ur5 "\n'
    file = tmp_path / "scene.toml"
    file.write_text(f"duration = 0.1\n{robots}")
    with pytest.raises(pinimpact.InputError, match=r"gravity \(0.0, 0.0, -1.62\) and \(0.0, 0.0, -9.81\)"):
        load_scene(file)
    file.write_text(f"duration = 0.1\ngravity = [0, 0, -3]\n{robots}")
    model = load_scene(file).scene.model
    assert np.array_equal(model.gravity.linear, [0.0, 0.0, -3.0])
    assert np.array_equal(model.armature, [0.3, 0, 0, 0, 0, 0, 0])


def test_velocity_of_free_base_is_in_world_axes(tmp_path: Path) -> None:
    ball = f'[[robot]]\nurdf = "{SCENES / "ball.urdf"}"\nfree_flyer = true\n'
    moving = "velocity = [1, 2, 3]\nangular_velocity = [4, 5, 6]\n"
    turn = pin.Quaternion(pin.exp3(np.array([0.4, -1.0, 2.0]))).coeffs().tolist()
    start = f"[start]\nq = {[0, 0, 0, 0, 0, 0, 1, 0.1, 0.2, 0.3, *turn]}\n"
    first = ball + 'prefix = "first "\n'
    file = tmp_path / "scene.toml"
    file.write_text(f'duration = 0.1\n{first}{ball}prefix = "second "\n{moving}{start}')
    loaded = load_scene(file)
    data = loaded.scene.model.createData()
    pin.forwardKinematics(loaded.scene.model, data, loaded.q, loaded.v)
    velocity = pin.getVelocity(loaded.scene.model, data, 2, pin.LOCAL_WORLD_ALIGNED)
    assert velocity.vector == pytest.approx([1, 2, 3, 4, 5, 6], abs=1e-12)
    assert np.array_equal(loaded.v[:6], np.zeros(6))
    pose = "position = [0, 0, 1]\n"
    rest = f"[start]\nv = {[0.0] * 6}\n"
    for base, given, said in ((pose, "[start]\nq = [0, 0, 0, 0, 0, 0, 1]\n", "q"), (moving, rest, "v")):
        file.write_text(f"duration = 0.1\n{ball}{base}{given}")
        with pytest.raises(pinimpact.InputError, match=rf"start\.{said}: given beside the .* of robot\[0\]"):
            load_scene(file)


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_examples_load_and_start_without_penetration(path: Path) -> None:
    loaded = load_scene(path)
    data = loaded.robot.model.createData()
    for contact in loaded.scene.contacts:
        assert contact.gap(loaded.robot.model, data, loaded.q) > 0.0


WRONG = {
    "unknown key": (
        ("friction =", "frction ="),
        pinimpact.UnknownNameError,
        r"contact\[0\]\.frction.*'friction'",
    ),
    "unknown table": (("[plane.belt]", "[plain.belt]"), pinimpact.UnknownNameError, "plain.*'plane'"),
    "unknown plane": (
        ('plane = "belt"', 'plane = "bell"'),
        pinimpact.UnknownNameError,
        r"contact\[0\]\.plane.*'belt'",
    ),
    "no radius": (
        ("[plane.belt]", "[sphere.post]\n[plane.belt]"),
        pinimpact.InputError,
        r"sphere\.post\.radius: required key missing",
    ),
    "unknown frame": (('frame = "ball"', 'frame = "bal"'), pinimpact.UnknownNameError, "'bal'.*'ball'"),
    "unknown law": (
        ("friction = 0.1", 'friction = 0.1\nlaw = "possion"'),
        pinimpact.UnknownNameError,
        "'poisson'",
    ),
    "unknown scheme": (
        ("duration =", 'scheme = "events"\nduration ='),
        pinimpact.UnknownNameError,
        "scheme: 'events'.*'event-driven'",
    ),
    "wrong unit": (('"5 cm"', '"5 kg"'), pinimpact.InputError, r"contact\[0\]\.radius: '5 kg'.*m, cm, mm"),
    "angle for length": (
        ('"25 cm"', '"25 deg"'),
        pinimpact.InputError,
        r"robot\[0\]\.position\[2\]: '25 deg'",
    ),
    "text for number": (
        ("friction = 0.1", 'friction = "0.1"'),
        pinimpact.InputError,
        r"contact\[0\]\.friction: '0.1'",
    ),
    "flag for number": (
        ("friction = 0.1", "friction = true"),
        pinimpact.InputError,
        r"contact\[0\]\.friction: True",
    ),
    "out of range": (
        ("friction = 0.1", "friction = -1.0"),
        pinimpact.InputError,
        r"contact\[0\].*friction.*-1",
    ),
    "two numbers": (
        ("velocity = [2, 0, 0]", "velocity = [2, 0]"),
        pinimpact.InputError,
        r"plane\.belt\.velocity: \[2, 0\] given.*more numbers",
    ),
    "four numbers": (
        ("velocity = [2, 0, 0]", "velocity = [2, 0, 0, 0]"),
        pinimpact.InputError,
        r"plane\.belt\.velocity: .* given in .*; 3 numbers expected",
    ),
    "number for list": (
        ("velocity = [2, 0, 0]", "velocity = 2"),
        pinimpact.InputError,
        r"plane\.belt\.velocity: 2 given in .*; a list of numbers expected",
    ),
    "fraction for frame": (
        ('frame = "ball"', "frame = 1.5"),
        pinimpact.InputError,
        r"contact\[0\]\.frame: 1.5 given in .*; text or a whole number expected",
    ),
    "text for flag": (
        ("free_flyer = true", 'free_flyer = "yes"'),
        pinimpact.InputError,
        r"robot\[0\]\.free_flyer: 'yes' given in .*; true or false expected",
    ),
    "no space before unit": (
        ('"5 cm"', '"5cm"'),
        pinimpact.InputError,
        r"contact\[0\]\.radius: '5cm' given in .* is not a length; write .*'1 m'",
    ),
    "no duration": (("duration = 1.5", ""), pinimpact.InputError, "duration.*required key missing"),
    "required key misspelt": (
        ("duration =", "durations ="),
        pinimpact.UnknownNameError,
        "durations: unknown key in .*'duration'",
    ),
    "negative time": (("duration = 1.5", "duration = -1"), pinimpact.InputError, "duration: -1.*above 0"),
    "no TOML": (("duration =", "duration"), pinimpact.InputError, "is not TOML"),
    "no robot": (("urdf =", "# urdf ="), pinimpact.InputError, r"robot\[0\]: give either"),
    "fixed base moves": (
        ("[plane.belt]", '[[robot]]\nname = "ur5"\nprefix = "arm_"\nvelocity = [1, 0, 0]\n\n[plane.belt]'),
        pinimpact.InputError,
        r"robot\[1\]\.velocity.*fixed",
    ),
    "start of wrong length": (
        ("[output]", "[start]\nq = [1.0, 2.0]\n[output]"),
        pinimpact.InputError,
        "start.q: 2 numbers",
    ),
    "no such joint": (
        ("[output]", "[start.joints]\nrot_joint = 1.0\n[output]"),
        pinimpact.UnknownNameError,
        "start.joints.*'root_joint'",
    ),
    "joint of six": (
        ("[output]", "[start.speeds]\nroot_joint = 1.0\n[output]"),
        pinimpact.InputError,
        "root_joint has 6 degrees of freedom",
    ),
    "unknown effect": (
        ("duration =", 'without = ["gravty"]\nduration ='),
        pinimpact.UnknownNameError,
        "'gravity'",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_error_names_key(case: str, tmp_path: Path) -> None:
    (old, new), error, message = WRONG[case]
    assert old in BALL
    with pytest.raises(error, match=f"(?s){message}") as caught:
        scene_of(tmp_path, BALL.replace(old, new))
    assert caught.value.field


def test_file_without_robots_raises(tmp_path: Path) -> None:
    with pytest.raises(pinimpact.InputError, match=r"robot: \[\] given.*at least 1"):
        scene_of(tmp_path, "duration = 1.0\nrobot = []\n")


def test_file_with_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(BALL, encoding="utf-8-sig")
    assert load_scene(path).file.duration == 1.5


def test_missing_file_raises(tmp_path: Path) -> None:
    with pytest.raises(pinimpact.InputError, match=r"nothing\.toml"):
        load_scene(tmp_path / "nothing.toml")


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("5 cm", "length", 0.05),
        (2, "length", 2.0),
        ("180 deg", "angle", math.pi),
        ("-3 mm/s", "speed", -0.003),
    ],
)
def test_quantities(text, kind, value) -> None:
    assert quantity(text, kind) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("bad", ["5", "x m", "nan m", True, "5 s", [1], math.inf, 10**400])
def test_invalid_length_raises(bad) -> None:
    with pytest.raises(ValueError, match="is not a length"):
        quantity(bad, "length")


def test_motors_of_file_become_joint_pd_with_effort_limits(tmp_path: Path) -> None:
    text = (SCENES / "solo12_landing.toml").read_text(encoding="utf-8")
    control = scene_of(tmp_path, text.replace("[control]", "[control]\nlargest_effort = 1.5")).scene.control
    assert isinstance(control, pinimpact.JointPD)
    assert control.limits == 1.5
    for wrong in ("largest_effort = 0.0", "largest_effort = 1.5\ncancel_gravity = true"):
        with pytest.raises(pinimpact.InputError, match=r"control\.largest_effort"):
            scene_of(tmp_path, text.replace("[control]", f"[control]\n{wrong}"))


@pytest.mark.parametrize(("value", "kind"), [("30 cm", "an angle"), ("2 kg", "a time")])
def test_message_on_wrong_unit_uses_correct_article(value, kind):
    with pytest.raises(ValueError, match=f"'{value}' is not {kind}; its units are"):
        quantity(value, kind.split()[1])
