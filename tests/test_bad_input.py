"""Invalid input: errors name the argument, and nothing that is not a real number is converted silently."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner

import pinimpact
from pinimpact import Contact, ImpactProblem, InputError, PinimpactError, Plane, Scene, simulate
from pinimpact.app.cli import main
from pinimpact.app.scene_file import read_scene_file
from pinimpact.visual import plots

from .scene_models import UP, ball, pendulum

NOT_REAL = {
    "complex": lambda x: x + 1j,
    "complex without imaginary part": lambda x: x + 0j,
    "masked": lambda x: np.ma.array(x, mask=True),
    "dates": lambda x: np.asarray(x).astype("datetime64[s]"),
    "text": lambda x: np.asarray(x).astype(str),
    "truth values": lambda x: np.asarray(x).astype(bool),
    "none": lambda x: None,
    "objects": lambda x: np.array([object()] * np.size(x)).reshape(np.shape(x)),
}

MODEL = pendulum()
DATA = MODEL.createData()
Q, V = np.array([0.3]), np.array([-1.0])
TIP = Contact("tip", Plane(point=(0.0, 0.0, -0.5)), friction=0.3, restitution=0.5)
W, U = np.diag([2.0, 3.5, 1.0]), np.array([0.5, 0.5, -1.0])
SCENE = Scene(MODEL, [Contact("tip", Plane(point=(0.0, 0.0, -5.0)))])


def impact(q, v):
    return pinimpact.impact(MODEL, DATA, q, v, TIP)


def step(tau, dt):
    return pinimpact.Stepper(SCENE, Q, V).step(tau, dt)


ARRAYS = {
    "impact q": ("q", Q, lambda x: impact(x, V)),
    "impact v": ("v", V, lambda x: impact(Q, x)),
    "impact of several q": ("q", Q, lambda x: pinimpact.impact(MODEL, DATA, x, V, [TIP])),
    "impacts q": ("q", Q[None], lambda x: pinimpact.impacts(MODEL, DATA, x, V[None], TIP)),
    "impacts v": ("v", V[None], lambda x: pinimpact.impacts(MODEL, DATA, Q[None], x, TIP)),
    "gap q": ("q", Q, lambda x: TIP.gap(MODEL, DATA, x)),
    "matrices q": ("q", Q, lambda x: pinimpact.contact_matrices(MODEL, DATA, x, TIP)),
    "place q": ("q", Q, lambda x: pinimpact.place_in_contact(MODEL, DATA, x, TIP)),
    "W": ("delassus", W, lambda x: pinimpact.solve_impact(ImpactProblem(x, U, 0.5, 0.5))),
    "velocity": ("velocity", U, lambda x: pinimpact.solve_impact(ImpactProblem(W, x, 0.5, 0.5))),
    "W of rows": ("delassus", W[None], lambda x: pinimpact.solve_impacts(x, U[None], 0.5, 0.5)),
    "velocity of rows": ("velocity", U[None], lambda x: pinimpact.solve_impacts(W, x, 0.5, 0.5)),
    "W of many": (
        "delassus",
        np.kron(np.eye(2), W),
        lambda x: pinimpact.solve_impact(ImpactProblem(x, [U, U], 0.5, 0.5)),
    ),
    "point": ("point", np.ones(3), lambda x: Plane(point=x)),
    "normal": ("normal", np.ones(3), lambda x: Plane(normal=x)),
    "plane's velocity": ("velocity", np.ones(3), lambda x: Plane(velocity=x)),
    "offset": ("offset", np.ones(3), lambda x: Contact("tip", Plane(), offset=x)),
    "axis": ("axis", np.ones(3), lambda x: Contact("tip", Plane(), rim=0.1, axis=x)),
    "size": ("size", np.ones(3), lambda x: pinimpact.Box(size=x)),
    "q0": ("q0", Q, lambda x: simulate(SCENE, x, V, 0.01)),
    "v0": ("v0", V, lambda x: simulate(SCENE, Q, x, 0.01)),
    "tau": ("tau", V, lambda x: step(x, 0.01)),
    "control": ("control", V, lambda x: simulate(Scene(MODEL, control=lambda t, q, v: x), Q, V, 0.01)),
    "sampled control": (
        "control",
        V,
        lambda x: simulate(Scene(MODEL, control=lambda t, q, v: x, period=0.001), Q, V, 0.01),
    ),
}


@pytest.mark.parametrize("entry", ARRAYS)
@pytest.mark.parametrize("kind", NOT_REAL)
def test_arrays_without_real_numbers_raise(entry, kind):
    field, good, call = ARRAYS[entry]
    call(good)
    with pytest.raises(PinimpactError, match=f"^{field}: ") as caught:
        call(NOT_REAL[kind](good))
    assert "expected" in str(caught.value)
    assert len(str(caught.value)) < 300


NUMBERS = {
    "friction": lambda x: Contact("tip", Plane(), friction=x),
    "restitution": lambda x: Contact("tip", Plane(), restitution=x),
    "sliding_friction": lambda x: Contact("tip", Plane(), sliding_friction=x),
    "stiffness": lambda x: Contact("tip", Plane(), stiffness=x),
    "radius": lambda x: Contact("tip", Plane(), radius=x),
    "resting_speed": lambda x: Scene(MODEL, resting_speed=x),
    "limit_restitution": lambda x: Scene(MODEL, limit_restitution=x),
    "duration": lambda x: simulate(SCENE, Q, V, x),
    "rtol": lambda x: simulate(SCENE, Q, V, 0.01, rtol=x),
    "atol": lambda x: simulate(SCENE, Q, V, 0.01, atol=x),
    "max_step": lambda x: simulate(SCENE, Q, V, 0.01, max_step=x),
    "max_impacts": lambda x: simulate(SCENE, Q, V, 0.01, max_impacts=x),
    "dt": lambda x: step(V, x),
    "t": lambda x: simulate(SCENE, Q, V, 0.01).at(x),
    "times": lambda x: simulate(SCENE, Q, V, 0.01).sample(x),
    "speed": lambda x: pinimpact.replay(MODEL, simulate(SCENE, Q, V, 0.01), path=None, speed=x),
}


@pytest.mark.parametrize("field", NUMBERS)
@pytest.mark.parametrize("value", ["0.3", "x", 0.3 + 0j, True, np.datetime64("2020-01-01"), np.ma.masked])
def test_values_that_are_not_numbers_raise(field, value):
    with pytest.raises(InputError, match=f"^{field}: "):
        NUMBERS[field](value)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"rtol": 1.0}, "rtol"),
        ({"rtol": 1e-20}, "rtol"),
        ({"rtol": 0.0}, "rtol"),
        ({"max_impacts": 1.5}, "max_impacts"),
        ({"scheme": "event-driven", "dt": 1e-2}, "dt"),
        ({"scheme": "time-stepping", "rtol": "a"}, "rtol"),
        ({"scheme": "time-stepping", "atol": -1.0}, "atol"),
        ({"scheme": "time-stepping", "max_step": np.nan}, "max_step"),
        ({"scheme": "time-stepping", "max_step": 0.0}, "max_step"),
    ],
)
def test_numbers_out_of_range_raise(options, field):
    with pytest.raises(InputError, match=f"^{field}: "):
        simulate(SCENE, Q, V, 0.01, **options)


def test_all_real_types_are_accepted():
    exact = impact(Q, V).v
    for kind in (np.float32, object, list):
        q = Q.tolist() if kind is list else Q.astype(kind)
        np.testing.assert_allclose(impact(q, V).v, exact, rtol=1e-5)  # 0.3 in single precision
    integers = pinimpact.solve_impact(ImpactProblem(np.eye(3, dtype=int), [1, 0, -1], 1, 0))
    np.testing.assert_array_equal(integers.velocity, [0.0, 0.0, 0.0])


def test_invalid_direction_of_event_raises():
    for direction in (5, "up", True, None):
        with pytest.raises(InputError, match="direction="):
            pinimpact.Event(lambda t, q, v: 1.0, direction=direction)


def test_rim_without_axis_raises():
    with pytest.raises(InputError, match="the axis of the rim"):
        Contact("tip", Plane(), rim=0.1, axis=(0.0, 0.0, 0.0))


def test_non_finite_mass_raises():
    model = pendulum()
    model.inertias[1] = pin.Inertia(np.nan, np.zeros(3), np.eye(3))
    with pytest.raises(pinimpact.ModelError, match=r"'hinge'.*not finite"):
        pinimpact.impact(model, model.createData(), Q, V, TIP)


@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_invalid_rotor_inertia_raises(value):
    model = pendulum()
    model.armature = np.array([value])
    with pytest.raises(pinimpact.ModelError, match=rf"model\.armature\[0\]: {value} given, .* 'hinge'"):
        pinimpact.impact(model, model.createData(), Q, V, TIP)


@pytest.mark.parametrize("count", range(2, 7))
def test_physically_impossible_inertia_warns(count):
    points = np.random.default_rng(count).normal(size=(count, 3))  # on a line, in a plane, in space
    model = pendulum()

    def strike(moments):  # eigenvalues of ∫ x xᵀ dm cannot be negative
        inertia = np.trace(moments) * np.eye(3) - moments
        model.inertias[1] = pin.Inertia(1.0, np.array([0.0, 0.0, -0.5]), (inertia + inertia.T) / 2)
        pinimpact.impact(model, model.createData(), Q, V, TIP)

    moments, axes = np.linalg.eigh(np.cov(points.T))
    strike(axes * moments @ axes.T)
    if count > 2:
        moments[0] = -0.3 * moments[1]
        with pytest.warns(pinimpact.InertiaWarning, match="of joint 'hinge': its principal moments are"):
            strike(axes * moments @ axes.T)


def test_negative_mass_with_positive_total_raises():
    model = ball()
    model.addJoint(1, pin.JointModelRX(), pin.SE3.Identity(), "lid")
    model.inertias[2] = pin.Inertia(-1e-3, np.zeros(3), 1e-2 * np.eye(3))
    scene = Scene(model, [])
    with pytest.raises(pinimpact.ModelError, match=r"negative mass -0\.001 kg of joint 'lid'"):
        simulate(scene, pin.neutral(model), np.zeros(model.nv), 0.1)


@pytest.mark.parametrize(
    ("robot", "says"),
    [
        (".", "is a folder"),
        ("https://example.org/robot.urdf", "https://example.org/robot.urdf is a URL"),
        (Path("https://example.org/robot.urdf"), "https://example.org/robot.urdf is a URL"),
        ("", "'' is neither a robot's name"),
        (None, "NoneType given"),
    ],
)
def test_message_for_invalid_robot(robot, says):
    with pytest.raises(PinimpactError, match=f"^robot: .*{says}"):
        pinimpact.load_robot(robot)


def test_missing_package_folder_raises(tmp_path):
    with pytest.raises(InputError, match=r"^package_dirs: there is no folder"):
        pinimpact.load_robot("rod", package_dirs=tmp_path / "nowhere")


def test_missing_output_folder_raises(tmp_path):
    trajectory = simulate(SCENE, Q, V, 0.01)
    nowhere = tmp_path / "nowhere"
    with pytest.raises(InputError, match=r"^path: there is no folder"):
        pinimpact.replay(MODEL, trajectory, path=nowhere / "replay.html")
    with pytest.raises(InputError, match=r"^path: there is no folder"):
        trajectory.save(nowhere / "trajectory.npz")
    with pytest.raises(InputError, match=r"^path: there is no folder"):
        plots.save_figure(plots.energy_figure(trajectory), nowhere / "energy.png")
    assert not nowhere.exists()
    with pytest.raises(InputError, match=r"^path: .* is a folder"):
        trajectory.save(tmp_path)


def test_missing_or_invalid_trajectory_file_raises(tmp_path):
    with pytest.raises(InputError, match=r"^path: there is no file .*fall\.npz$"):
        pinimpact.Trajectory.load(tmp_path / "fall.npz")
    (tmp_path / "text.npz").write_text("t, q, v")
    with pytest.raises(InputError, match=r"text\.npz' is not a readable trajectory \(not a zip archive\)"):
        pinimpact.Trajectory.load(tmp_path / "text.npz")


def test_solve_impact_without_problem_raises():
    with pytest.raises(InputError, match=r"^problem: ndarray given; an ImpactProblem is expected"):
        pinimpact.solve_impact(np.eye(3), [0, 0, -1])


def test_degrees_are_reported_first():
    arm = pinimpact.load_robot("panda")
    degrees = np.rad2deg(arm.q0)
    below = pinimpact.Contact("panda_hand_tcp", pinimpact.Plane((0, 0, 5)))
    with pytest.raises(InputError, match=r"^q0: .* beyond its limit .*looks like degrees"):
        simulate(pinimpact.Scene(arm, [below]), degrees, np.zeros(9), 0.1)
    table = pinimpact.Contact("panda_hand_tcp", pinimpact.Plane((0, 0, 0.3)))
    with pytest.warns(pinimpact.JointLimitWarning, match=r"looks like degrees"):
        pinimpact.place_in_contact(arm.model, arm.data, degrees, table)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('[contact]\nframe = "tip"\n', r"\[contact\] in .*; write \[\[contact\]\]"),
        ('robot = "rod"\nduration = 1\n', r"'rod' in .*; write \[\[robot\]\]"),
    ],
)
def test_table_instead_of_array_of_tables_raises(tmp_path, text, says):
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        read_scene_file(path)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["demo", "rod", "--direction", "0", "0", "0"], "give the way it moves, of any length but zero"),
        (["robots", "zzz"], "no robot has 'zzz'"),
        (["cost", "--method", "eulr"], "did you mean 'euler'"),
        (["demo", "rod", "--direction", "0", "0", "1"], "does not point down to the table"),
    ],
)
def test_invalid_arguments_of_commands(words, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, words)
    assert result.exit_code != 0
    assert says in " ".join(result.output.split())


def test_named_robots_can_be_loaded_here():
    from pinimpact.robot.loading import named_robots

    assert ("cassie" in named_robots()["example-robot-data"]) == pin.WITH_SDFORMAT


def test_repr_is_one_line():
    robot = pinimpact.load_robot("panda")
    scene = Scene(robot).contacts_from_geometry(Plane(), friction=0.3)
    many = pinimpact.solve_impact(
        ImpactProblem(np.kron([[1, 0.5], [0.5, 1]], W), [U, U], 0.3, 0.5), record=True
    )
    ends = [
        Contact("center", Plane(), radius=0.1, name=name, offset=(x, 0, 0))
        for name, x in (("a", 0.1), ("b", 0))
    ]
    events = [pinimpact.Event(lambda t, q, v: t - 0.01, name="soon")]
    landing = simulate(Scene(ball(), ends, events=events), [0, 0, 0.11, *UP], [0, 0, -1, 0, 0, 0], 0.02)
    shown = [
        scene,
        scene.contacts[0],
        Plane(),
        SCENE,
        ImpactProblem(W, U, 0.5, 0.5),
        simulate(SCENE, Q, V, 0.01),
        many,
        many.path,
        many.range(stiffness=(0.5, 2)),
        pinimpact.METHODS["exact"],
        pinimpact.POLICIES["together"],
        landing.events[0],
        landing.impacts[0],
        landing.impacts[0].group,
        landing.modes[0],
    ]
    for one in shown:
        assert "\n" not in repr(one)
        assert len(repr(one)) < 300
    assert repr(Plane()) == "Plane()"
    assert (
        repr(TIP)
        == "Contact(frame='tip', plane=Plane(point=(0.0, 0.0, -0.5)), friction=0.3, restitution=0.5)"
    )


def test_pickled_scene_has_only_the_shapes_of_its_contacts():
    robot = pinimpact.load_robot("solo12")
    foot = Contact("HR_FOOT", Plane(), friction=0.3)
    assert len(pickle.dumps(Scene(robot, [foot]))) < 1.1 * len(pickle.dumps(Scene(robot.model, [foot])))
    arm = pinimpact.load_robot("panda")
    q0, v0 = arm.q0, np.full(arm.model.nv, 0.5)
    name = arm.collision_model.geometryObjects[-1].name
    block = pinimpact.Box(size=(0.5, 0.5, 0.2), center=(0.4, 0.0, 0.3))
    scene = Scene(arm, [Contact(geometry=name, plane=block, friction=0.2)])
    again = pickle.loads(pickle.dumps(scene))
    one, other = simulate(scene, q0, v0, 0.3), simulate(again, q0, v0, 0.3)
    np.testing.assert_array_equal(one.q, other.q)
    assert len(again.geometry.geometryObjects) == 1


def test_integers_as_duration_and_state():
    scene = Scene(ball(), [Contact("center", Plane(), radius=0.1)])
    trajectory = simulate(scene, [0, 0, 30, *UP], [0] * 6, 1)
    assert trajectory.q[-1, 2] == pytest.approx(30.0 - 0.5 * 9.80665 * 1.0, abs=1e-2)
    q, v = trajectory.sample(0.5)
    np.testing.assert_array_equal(trajectory.at(0.5)[0], q)
    np.testing.assert_array_equal(trajectory.at(0.5)[1], v)


PROBLEM = ImpactProblem(W, U, 0.3, 0.5)
RUN = simulate(SCENE, Q, V, 0.05)
ARM = pinimpact.load_robot("panda")
RAGGED = [[1], [1, 2]]
TWICE = np.array(["left", "right"])
OF_ANOTHER_KIND = {
    "method: a number": ("method", lambda: pinimpact.solve_impact(PROBLEM, method=3)),
    "method: a list": ("method", lambda: pinimpact.solve_impact(PROBLEM, method=["exact"])),
    "steps: a truth value": ("steps", lambda: pinimpact.solve_impact(PROBLEM, "euler", steps=True)),
    "law: an array": ("law", lambda: Contact("tip", Plane(), law=TWICE)),
    "law: of a problem": ("law", lambda: pinimpact.solve_impact(ImpactProblem(W, U, 0.3, 0.5, TWICE))),
    "law: of a batch": ("law", lambda: pinimpact.impacts(MODEL, DATA, Q, V, TIP, law=["poisson"])),
    "simultaneous: an array": ("simultaneous", lambda: Scene(MODEL, [TIP], simultaneous=TWICE)),
    "simultaneous: a list": ("simultaneous", lambda: Scene(MODEL, [TIP], simultaneous=["together"])),
    "held: a truth value": ("held", lambda: pinimpact.impact(MODEL, DATA, Q, V, TIP, held=True)),
    "held: a number": ("held", lambda: pinimpact.contact_matrices(MODEL, DATA, Q, TIP, held=3)),
    "held: of a scene": ("held", lambda: Scene(MODEL, [TIP], held=3)),
    "contacts: none": ("contacts", lambda: Scene(MODEL, None)),
    "locked: a truth value": ("locked", lambda: pinimpact.impact(MODEL, DATA, Q, V, TIP, locked=True)),
    "locked: a number": ("locked", lambda: pinimpact.impact(MODEL, DATA, Q, V, TIP, locked=3.5)),
    "locked: a list of none": ("locked", lambda: pinimpact.impact(MODEL, DATA, Q, V, TIP, locked=[None])),
    "locked: of a scene": ("locked", lambda: Scene(MODEL, [TIP], locked=None)),
    "friction: ragged": (
        "friction",
        lambda: pinimpact.impacts(MODEL, DATA, Q, V, TIP, friction=[[1], [1, 2]]),
    ),
    "friction: ragged batch": ("friction", lambda: pinimpact.solve_impacts(W, U, RAGGED, 0.5)),
    "threads: a truth value": ("threads", lambda: pinimpact.solve_impacts(W, U, 0.3, 0.5, threads=True)),
    "contact: a number": ("contact", lambda: RUN.forces(3, 0.01)),
    "contact: a list": ("contact", lambda: RUN.forces(["tip"], 0.01)),
    "source: a number": ("source", lambda: RUN.mode_at(3, 0.01)),
    "side: an array": ("side", lambda: RUN.at(0.01, side=TWICE)),
    "side: of forces": ("side", lambda: RUN.forces("tip on plane", 0.01, side=["left"])),
    "rows: a list": ("rows", lambda: RUN.columns(["samples"])),
    "scheme: a list": ("scheme", lambda: simulate(SCENE, Q, V, 0.1, scheme=["event-driven"])),
    "path: a number": ("path", lambda: pinimpact.Trajectory.load(3)),
    "path: none": ("path", lambda: RUN.save(None)),
    "progress: a number": ("progress", lambda: simulate(SCENE, Q, V, 0.1, progress=3)),
    "dt: text, unused": ("dt", lambda: simulate(SCENE, Q, V, 0.1, scheme="event-driven", dt="1 ms")),
    "dt: a list": ("dt", lambda: step(V, [0.1])),
    "dt: an array": ("dt", lambda: step(V, np.array([0.1]))),
    "dt: of a derivative": ("dt", lambda: pinimpact.Stepper(SCENE, Q, V).linearize(V, [0.1])),
    "duration: a list": ("duration", lambda: simulate(SCENE, Q, V, [1])),
    "rtol: a list": ("rtol", lambda: simulate(SCENE, Q, V, 0.1, rtol=[1e-6])),
    "max_step: a list": ("max_step", lambda: simulate(SCENE, Q, V, 0.1, max_step=[0.1])),
    "dt: negative, unused": ("dt", lambda: simulate(SCENE, Q, V, 0.1, scheme="event-driven", dt=-1.0)),
    "atol: infinite": ("atol", lambda: simulate(SCENE, Q, V, 0.1, atol=np.inf)),
    "event: an array": ("events", lambda: pinimpact.Event(guard, direction=np.array([1, -1]))),
    "event: a number as name": ("events", lambda: pinimpact.Event(guard, name=3)),
    "guard: a truth value": ("events", lambda: watched(lambda t, q, v: q[0] > 0.1)),
    "guard: a complex number": ("events", lambda: watched(lambda t, q, v: q[0] + 0j)),
    "guard: text": ("events", lambda: watched(lambda t, q, v: "0.3")),
    "guard: masked": ("events", lambda: watched(lambda t, q, v: np.ma.masked)),
    "without: none": ("without", lambda: Scene(MODEL, without=None)),
    "without: a list of arrays": ("without", lambda: Scene(MODEL, without=[TWICE])),
    "surface: text": ("surface", lambda: Scene(ARM).contacts_from_geometry("floor")),
    "links: none": ("links", lambda: Scene(ARM).contacts_from_geometry(Plane(), links=None)),
    "contacts: a number": ("contacts", lambda: pinimpact.place_in_contact(MODEL, DATA, Q, 3)),
    "package_dirs: none": ("package_dirs", lambda: pinimpact.load_robot("rod", package_dirs=None)),
    "package_dirs: numbers": ("package_dirs", lambda: pinimpact.load_robot("rod", package_dirs=[3])),
    "free_flyer: text": ("free_flyer", lambda: pinimpact.load_robot("rod", free_flyer="no")),
    "mimic: a number": ("mimic", lambda: pinimpact.load_robot("rod", mimic=2)),
    "exponent: an array": (
        "exponent",
        lambda: pinimpact.solve_impact(ImpactProblem(np.kron(np.eye(2), W), [U, U], 0, 0), exponent=TWICE),
    ),
}


def guard(t, q, v):
    return q[0] - 0.1


def watched(asked):
    return simulate(Scene(MODEL, events=[asked]), Q, V, 0.01)


@pytest.mark.parametrize(("field", "call"), OF_ANOTHER_KIND.values(), ids=OF_ANOTHER_KIND)
def test_arguments_of_wrong_type_raise(field, call):
    with pytest.raises(PinimpactError, match=rf"^\W*{field}: ") as told:
        call()
    assert told.value.field == field
    assert len(str(told.value)) < 250


class Long:
    """An object whose repr has many lines."""

    def __repr__(self):
        return "<a long\nrepr>" * 1000


LONG = Long()
TOLD_IN_SHORT = {
    "contact": lambda: pinimpact.impact(MODEL, DATA, Q, V, LONG),
    "contacts": lambda: pinimpact.place_in_contact(MODEL, DATA, Q, [LONG]),
    "plane": lambda: Contact("tip", LONG),
    "name": lambda: Contact("tip", Plane(), name=LONG),
    "frame": lambda: Contact(LONG, Plane()),
    "body": lambda: Plane(body=LONG),
    "geometry": lambda: Scene(MODEL, geometry=LONG),
    "shape": lambda: Contact(geometry=LONG, plane=Plane()),
    "other shape": lambda: pinimpact.Shape(LONG),
    "control": lambda: Scene(MODEL, control=LONG),
    "guard": lambda: Scene(MODEL, events=[LONG]),
    "event": lambda: pinimpact.Event(guard, terminal=LONG),
    "without": lambda: Scene(MODEL, without=[LONG]),
    "simultaneous": lambda: Scene(MODEL, simultaneous=LONG),
    "locked": lambda: Scene(MODEL, locked=[LONG]),
    "links": lambda: Scene(ARM).contacts_from_geometry(Plane(), links=[LONG]),
    "of forces": lambda: RUN.forces(LONG, 0.01),
    "source": lambda: RUN.mode_at(LONG, 0.01),
    "side": lambda: RUN.at(0.01, side=LONG),
    "motion": lambda: pinimpact.replay(MODEL, LONG),
    "path": lambda: RUN.save(LONG),
    "impact": lambda: plots.hodograph(LONG),
    "contact of a plot": lambda: plots.hodograph(PROBLEM, contact=LONG),
    "solver's rtol": lambda: pinimpact.solve_impact(PROBLEM, "adaptive", rtol=LONG),
}


@pytest.mark.parametrize("call", TOLD_IN_SHORT.values(), ids=TOLD_IN_SHORT)
def test_messages_contain_no_long_reprs(call):
    with pytest.raises(PinimpactError) as told:
        call()
    assert "<a long repr>" in str(told.value)
    assert len(str(told.value)) < 400
    assert "\n" not in str(told.value)
