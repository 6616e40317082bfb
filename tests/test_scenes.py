"""Scenes: the plan of effects, invalid input, recorded data, and typical scenes."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, Plane, Scene, Trajectory, simulate

from .scene_models import UP, ball, free_body, pendulum, run, slider, unbounded

FLOOR = Plane()


def dropped_ball(**options):
    contact = Contact("center", FLOOR, friction=0.3, restitution=0.5, radius=0.1, name="ball")
    return Scene(ball(), [contact], **options)


START = ([0, 0, 0.6, *UP], [0.3, 0, 0, 0, 2.0, 0])


# ---- the plan


def test_plan_gives_reason_for_every_effect():
    model = pendulum()
    model.damping, model.armature = np.array([0.1]), np.array([0.0])
    plan = Scene(model, [Contact("tip", Plane(point=(0, 0, -5.0)), friction=0.5)]).plan()
    present = {effect.name for effect in plan if effect.on}
    assert present == {"gravity", "joint damping", "contact friction"}
    assert plan.unreachable == ("tip on plane",)
    assert "out of reach" in plan["contact guards"].reason
    assert "zero" in plan["rotor inertia"].reason
    table = str(plan).splitlines()
    assert len(table) == len(plan.effects)
    assert all(
        effect.name in line and effect.reason in line for effect, line in zip(plan, table, strict=True)
    )


def test_trajectory_lists_effects_switched_off():
    scene = dropped_ball(without=["restitution", "joint damping"])
    trajectory = run(scene, *START, 0.5)
    assert trajectory.switched_off == ("restitution",)
    assert all(impact.problem.restitution == 0.0 for impact in trajectory.impacts)
    assert run(dropped_ball(), *START, 0.1).switched_off == ()


@pytest.mark.parametrize("name", ["spatial slip", "lightning"])
def test_unknown_effect_in_without_raises(name):
    with pytest.raises(pinimpact.PinimpactError, match=name):
        dropped_ball(without=[name])


@pytest.mark.parametrize(
    "effect", ["joint damping", "joint friction", "rotor inertia", "control", "restitution"]
)
def test_effect_of_zero_coefficient_equals_effect_switched_off(effect):
    def robot(**attributes):
        model = pendulum()
        model.addJoint(1, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0, 0, -1.0])), "elbow")
        model.appendBodyToJoint(
            2, pin.Inertia(0.5, np.array([0, 0, -0.3]), 0.01 * np.eye(3)), pin.SE3.Identity()
        )
        unbounded(model)
        for name, value in attributes.items():
            setattr(model, name, value)
        return model

    zero = np.zeros(2)
    attribute = {"joint damping": "damping", "joint friction": "friction", "rotor inertia": "armature"}
    model = robot(**({attribute[effect]: zero} if effect in attribute else {}))
    idle = (lambda t, q, v: zero) if effect == "control" else None
    contact = Contact("tip", Plane(point=(0, 0, -0.8)), friction=0.2)
    q0, v0 = [1.0, 0.3], [0.0, 1.0]
    given = run(Scene(model, [contact], control=idle), q0, v0, 1.0, max_step=np.inf)  # the same steps
    left_out = run(Scene(robot(), [contact], without=[effect]), q0, v0, 1.0)
    assert len(given.impacts) == len(left_out.impacts) > 0
    assert given.q[-1] == pytest.approx(left_out.q[-1], abs=1e-13)
    assert given.v[-1] == pytest.approx(left_out.v[-1], abs=1e-12)


def test_plan_lists_surfaces_out_of_reach():
    far = Scene(pendulum(), [Contact("tip", Plane(point=(0, 0, -1.5)))])
    near = Scene(pendulum(), [Contact("tip", Plane(point=(0, 0, -0.9)))])
    assert far.plan().unreachable == ("tip on plane",)
    assert near.plan().unreachable == ()


# ---- invalid input


def test_start_below_surface_raises_with_frame_and_depth():
    with pytest.raises(pinimpact.InputError, match=r"center.*0\.0?25 m below"):
        simulate(dropped_ball(), [0, 0, 0.075, *UP], np.zeros(6), 1.0)


def test_start_beyond_joint_limit_raises():
    model = pendulum()
    model.upperPositionLimit = np.array([0.5])
    with pytest.raises(pinimpact.InputError, match=r"hinge upper"):
        simulate(Scene(model), [0.6], [0.0], 1.0)
    assert simulate(Scene(model, without=["joint limits"]), [0.6], [0.0], 0.1).complete


def test_gravity_has_no_angular_part():
    model = pendulum()
    model.gravity.angular = np.array([0.0, 1.0, 0.0])
    with pytest.raises(pinimpact.ModelError, match=r"model\.gravity\.angular: .* given, zeros"):
        Scene(model)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("gravity", np.nan, r"model\.gravity: .* finite numbers"),
        ("damping", -1.0, r"model\.damping\[0\]: -1.0 given, .* ≥ 0 .* 'hinge'"),
        ("damping", np.nan, r"model\.damping\[0\]: nan given"),
        ("friction", -0.5, r"model\.friction\[0\]: -0.5 given, .* ≥ 0 .* 'hinge'"),
        ("friction", np.inf, r"model\.friction\[0\]: inf given"),
        ("armature", -0.5, r"model\.armature\[0\]: -0.5 given, .* ≥ 0 .* 'hinge'"),
        ("armature", np.nan, r"model\.armature\[0\]: nan given"),
        ("upperPositionLimit", np.nan, r"model\.upperPositionLimit\[0\]: nan given, a bound"),
    ],
)
def test_invalid_numbers_of_model_raise(field, value, message):
    model = pendulum()
    if field == "gravity":
        model.gravity.linear = np.array([0.0, 0.0, value])
    else:
        setattr(model, field, np.array([value]))
    with pytest.raises(pinimpact.ModelError, match=message):
        Scene(model)


def test_moving_held_contact_raises():
    rod = free_body(pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), [(-0.5, 0, 0)])
    with pytest.raises(pinimpact.InputError, match=r"v0: .*tip0.*0\.2 m/s"):
        simulate(Scene(rod, held=[Contact("tip0", FLOOR)]), [0, 0, 0, *UP], [0.2, 0, 0, 0, 0, 0], 1.0)


@pytest.mark.parametrize(
    ("answer", "text"),
    [(np.zeros(2), "shape"), (np.array([np.nan, 0, 0]), "not finite"), ("fail", "ZeroDivisionError")],
)
def test_failing_control_keeps_partial_trajectory(answer, text):
    def control(t, q, v):
        if t < 0.5:
            return np.zeros(3)
        return 1 / 0 if isinstance(answer, str) else answer

    with pytest.raises(pinimpact.SimulationError, match=text) as caught:
        simulate(Scene(slider(), control=control), np.zeros(3), np.zeros(3), 1.0, max_step=0.1)
    partial = caught.value.partial
    assert not partial.complete
    assert 0.3 <= partial.duration <= 0.5
    assert partial.q[-1, 2] == pytest.approx(-0.5 * 9.81 * partial.duration**2, rel=1e-9)


def test_max_impacts_error_keeps_partial_trajectory():
    last_five = r"max_impacts: .* the last at ('[^']+' \([\d.]+ s\)(, |;)){5}"
    with pytest.raises(pinimpact.SimulationError, match=last_five) as caught:
        simulate(dropped_ball(without=["sustained contact"]), *START, 5.0, max_impacts=20)
    assert len(caught.value.partial.impacts) == 20


def test_scene_without_sustained_contact_has_no_time_steps():
    scene = dropped_ball(without=["sustained contact"])
    with pytest.raises(
        pinimpact.InputError, match='"time-stepping" given for a scene without "sustained contact"'
    ):
        simulate(scene, *START, 1.0, scheme="time-stepping")
    with pytest.raises(pinimpact.SimulationError, match="max_impacts"):
        simulate(scene, *START, 5.0, max_impacts=20, scheme="auto")


def test_max_impacts_counts_simultaneous_impacts_once():
    corners = [(0.1 * x, 0.1 * y, -0.05) for x in (-1, 1) for y in (-1, 1)]
    contacts = [Contact(f"tip{k}", FLOOR, friction=0.3, restitution=0.9) for k in range(4)]
    falls = Scene(free_body(pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.1), corners), contacts)
    height, speed = (
        0.5,
        np.sqrt(2 * 9.81 * 0.45),
    )  # flat landings, the first two 2 e speed / g apart
    third = speed / 9.81 * (1 + 2 * 0.9 + 2 * 0.9**2)
    start = [0, 0, height, *UP], np.zeros(6)
    trajectory = simulate(falls, *start, third + 1e-3, max_impacts=3)
    assert len(trajectory.impacts) == 12
    with pytest.raises(pinimpact.SimulationError, match="impacts at 3 instants"):
        simulate(falls, *start, third + 1e-3, max_impacts=2)


def test_plane_moving_along_its_normal_raises():
    with pytest.raises(pinimpact.InputError, match="along its normal"):
        Scene(ball(), [Contact("center", Plane(velocity=(0, 0, 1.0)), radius=0.1)])


# ---- recorded data


def test_interrupt_keeps_partial_trajectory():
    def progress(t, duration):
        if t > 0.7:
            raise KeyboardInterrupt

    trajectory = simulate(dropped_ball(), *START, 2.0, progress=progress)
    assert not trajectory.complete
    assert "Interrupted" in trajectory.termination
    whole = simulate(dropped_ball(), *START, 2.0)
    q, v = trajectory.at(trajectory.t[-1], side="left")
    p, u = whole.at(trajectory.t[-1], side="left")
    assert q == pytest.approx(p, abs=1e-12)
    assert v == pytest.approx(u, abs=1e-12)
    assert [i.time for i in trajectory.impacts] == [
        i.time for i in whole.impacts if i.time <= trajectory.t[-1]
    ]


def test_trajectory_is_continuous_except_at_impacts():
    trajectory = run(dropped_ball(), *START, 2.0)
    for impact in trajectory.impacts:
        before, after = trajectory.at(impact.time, side="left"), trajectory.at(impact.time, side="right")
        assert before[1] == pytest.approx(impact.v_before, abs=1e-12)
        assert after[1] == pytest.approx(impact.v_after, abs=1e-3 if impact.resting else 1e-12)
        assert before[0] == pytest.approx(after[0], abs=1e-12)
    times = {impact.time for impact in trajectory.impacts} | {m.start for m in trajectory.modes}
    for t in trajectory.t[1:-1]:
        if t not in times:
            assert trajectory.at(t, "left")[1] == pytest.approx(trajectory.at(t)[1], abs=1e-9)
    with pytest.raises(pinimpact.InputError, match="outside"):
        trajectory.at(2.1)
    with pytest.raises(pinimpact.InputError, match="side"):
        trajectory.at(1.0, side="up")


def test_saved_trajectory_is_loaded_completely(tmp_path):
    trajectory = run(dropped_ball(), *START, 2.0)
    trajectory.save(tmp_path / "ball.npz")
    again = Trajectory.load(tmp_path / "ball.npz")
    for t in np.linspace(0, 2, 23):
        for side in ("left", "right"):
            for x, y in zip(trajectory.at(t, side), again.at(t, side), strict=True):
                assert np.array_equal(x, y)
    assert again.modes == trajectory.modes
    assert again.notes == trajectory.notes
    assert np.array_equal(again.energy.residual, trajectory.energy.residual)
    for a, b in zip(again.impacts, trajectory.impacts, strict=True):
        assert (a.time, a.source, a.resting) == (b.time, b.source, b.resting)
        assert np.array_equal(a.solution.impulse, b.solution.impulse)
        assert a.solution.segments == b.solution.segments
    (tmp_path / "broken.npz").write_bytes(b"nonsense")
    with pytest.raises(pinimpact.InputError, match="broken"):
        Trajectory.load(tmp_path / "broken.npz")


def test_recorded_path_is_saved_and_loaded(tmp_path):
    trajectory = run(dropped_ball(record=True), *START, 0.5)
    assert trajectory.impacts[0].solution.path is not None
    trajectory.save(tmp_path / "ball.npz")
    assert Trajectory.load(tmp_path / "ball.npz").impacts[0].solution.path is not None


# ---- typical scenes


def test_panda_strikes_table():
    robot = pinimpact.load_robot("panda")
    table = Plane(point=(0, 0, 0.2))
    hand = Contact("panda_hand_tcp", table, friction=0.4, restitution=0.5, name="hand")
    q0 = np.array([0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02])
    trajectory = run(Scene(robot, [hand]), q0, np.zeros(9), 0.5, audit=1e-5)
    assert trajectory.impacts[0].source == "hand"
    data = robot.model.createData()
    assert min(hand.gap(robot.model, data, q) for q in trajectory.q) > -1e-9


def test_dropped_rod_chatters_to_rest():
    inertia = pin.Inertia(1.0, np.zeros(3), np.diag([1e-4, 1 / 12, 1 / 12]))
    rod = free_body(inertia, [(-0.5, 0, 0), (0.5, 0, 0)])
    contacts = [Contact(f"tip{k}", FLOOR, friction=0.4, restitution=0.5, radius=0.01) for k in range(2)]
    tilt = pin.Quaternion(pin.utils.rotate("y", 0.3)).coeffs()
    trajectory = run(Scene(rod, contacts), [0, 0, 0.5, *tilt], np.zeros(6), 4.0, audit=1e-5)
    assert {m.source for m in trajectory.modes if m.end == 4.0} == {c.label for c in contacts}
    data = rod.createData()
    assert all(c.gap(rod, data, q) > -1e-9 for q in trajectory.q for c in contacts)


def test_solo12_lands_on_four_feet():
    robot = pinimpact.load_robot("solo12")
    model = robot.model
    feet = [f"{side}_FOOT" for side in ("FL", "FR", "HL", "HR")]
    contacts = [Contact(foot, FLOOR, friction=0.6, radius=0.016, name=foot) for foot in feet]
    posture = robot.q0.copy()
    posture[2] = 0.4

    def hold(t, q, v):
        return np.concatenate([np.zeros(6), 20.0 * (posture[7:] - q[7:]) - 0.6 * v[6:]])

    scene = Scene(model, contacts, control=hold, without=["joint limits"])
    trajectory = run(scene, posture, np.zeros(model.nv), 0.3, audit=1e-5)
    assert {impact.source for impact in trajectory.impacts} >= set(feet)
    data = model.createData()
    assert all(c.gap(model, data, q) > -1e-9 for q in trajectory.q for c in contacts)


def test_two_arms_collide():
    arm = pinimpact.load_robot("ur5").model
    other = pin.SE3(pin.utils.rotate("z", np.pi), np.array([1.3, 0.2183, 0]))
    model = pin.appendModel(_renamed(arm, "left_"), _renamed(arm, "right_"), 0, other)
    left = next(f.name for f in model.frames if f.name.endswith("left_tool0"))
    right = next(f.name for f in model.frames if f.name.endswith("right_tool0"))
    palm = Plane(point=(0, 0, 0), normal=(0, 0, 1.0), body=right)
    contact = Contact(left, palm, friction=0.3, restitution=0.6, radius=0.03, name="hands")
    q0 = np.tile([0.0, -1.2, 1.8, -0.6, np.pi / 2, 0.0], 2)
    v0 = np.tile([0.0, 1.0, -2.0, 1.0, 0.0, 0.0], 2)
    data = model.createData()
    gap = contact.gap(model, data, q0)
    assert gap > 0
    trajectory = run(Scene(model, [contact], without=["joint limits"]), q0, v0, 0.6, audit=1e-5)
    assert trajectory.impacts
    assert min(contact.gap(model, data, q) for q in trajectory.q) > -1e-9


def _renamed(model, prefix):
    model = model.copy()
    for k in range(1, model.njoints):
        model.names[k] = prefix + model.names[k]
    for frame in model.frames:
        frame.name = prefix + frame.name
    return model
