"""The scheme "auto": event-driven integration, with time steps over intervals where it fails."""

from __future__ import annotations

import itertools
import math
import pickle
import warnings
from dataclasses import replace
from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin
import pytest
from rich.console import Console
from scipy.optimize import brentq

from pinimpact import (
    BoundReachedWarning,
    Box,
    Contact,
    Event,
    Plane,
    Scene,
    Shape,
    SimulationError,
    SteppedWarning,
    simulate,
)
from pinimpact.app.report import run_facts, run_report
from pinimpact.errors import IrregularMotionError
from pinimpact.scene.alternating import Alternating
from pinimpact.scene.trajectory import Trajectory

from .scene_models import UP, ball, rough_joint, shaped_body, slider, unbounded
from .test_time_stepping import boxes

FLOOR = Plane()


def simulate_auto(scene, q0, v0, duration, **options):
    """Simulate with `scheme="auto"` and check the warnings.

    Intervals of time steps must cause exactly one `SteppedWarning`. One `BoundReachedWarning` is allowed.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        trajectory = simulate(scene, q0, v0, duration, scheme="auto", **options)
    stepped_warnings = [warning for warning in caught if warning.category is SteppedWarning]
    assert len(stepped_warnings) == bool(trajectory.stepped)
    others = [warning for warning in caught if warning not in stepped_warnings]
    assert [warning.category for warning in others] in ([], [BoundReachedWarning])
    assert trajectory.complete or trajectory.termination.startswith("The event")
    times = [(one.start, one.end) for one in trajectory.stepped]
    assert all(start < end for start, end in times)
    assert all(one[1] <= other[0] for one, other in itertools.pairwise(times))
    return trajectory


def overlap(one, other):
    """Return the penetration depth of two boxes (size, placement), computed by coal [m]."""
    shapes = [(coal.Box(*size), coal.Transform3s(at.rotation, at.translation)) for size, at in (one, other)]
    found = coal.CollisionResult()
    hit = coal.collide(*shapes[0], *shapes[1], coal.CollisionRequest(), found)
    return -found.getContact(0).penetration_depth if hit else 0.0


def deepest_penetration(trajectory, bodies, count=60):
    """Return the largest penetration of free boxes into the floor or each other at `count` times [m].

    `bodies` are the sizes of the boxes.
    """
    worst = 0.0
    for t in np.linspace(0.0, trajectory.t[-1], count):
        q = trajectory.at(t)[0]
        boxes = [(size, pin.XYZQUATToSE3(q[7 * k : 7 * k + 7])) for k, size in enumerate(bodies)]
        for size, at in boxes:
            corners = 0.5 * np.array(list(itertools.product((-1, 1), repeat=3))) * size
            worst = max(worst, -(at.translation[2] + corners @ at.rotation[2]).min())
        worst = max(worst, *(overlap(one, other) for one, other in itertools.combinations(boxes, 2)))
    return worst


def chattering(**options):
    """Return a scene with the control 0.3 − sign(v); from v = 1 it rests at 0.5/0.7 m from t = 1/0.7 s."""

    def control(t, q, v):
        return np.array([0.3 - np.sign(v[0]), 0.0, 0.0])

    return Scene(slider(), control=control, without=["gravity"], **options)


def test_plan_names_the_chosen_scheme():
    assert Scene(ball(), [Contact("center", FLOOR, radius=0.1)]).plan().scheme == "event-driven"
    assert boxes(1, (0.2, 0.2, 0.1), 1.0).plan().scheme == "event-driven"
    assert boxes(2, (0.2, 0.2, 0.1), 1.0).plan().scheme == "auto"


def test_regular_motion_equals_that_of_event_driven_scheme():
    scene = Scene(ball(), [Contact("center", FLOOR, radius=0.1, friction=0.3, restitution=0.5)])
    state = [0, 0, 1.0, *UP], [1.0, 0, 0, 0, 3.0, 0]
    one, other = simulate_auto(scene, *state, 2.0), simulate(scene, *state, 2.0, scheme="event-driven")
    assert one.stepped == ()
    assert one.statistics == other.statistics
    for name in ("t", "q", "v"):
        assert np.array_equal(getattr(one, name), getattr(other, name))


def test_chattering_control_is_stepped_and_comes_to_rest():
    errors = []
    for dt in (4e-3, 1e-3):
        trajectory = simulate_auto(chattering(), np.zeros(3), [1.0, 0, 0], 2.0, dt=dt)
        assert trajectory.stepped[0].start == pytest.approx(1 / 0.7, abs=0.1)
        assert "discontinuous" in trajectory.stepped[0].reason
        errors.append(abs(trajectory.q[-1, 0] - 0.5 / 0.7))
        assert abs(trajectory.v[-1, 0]) < 2.0 * dt
    assert errors[0] < 4e-3
    assert errors[1] < 1e-3


def test_interval_of_unknown_error_is_computed_once(monkeypatch):
    compared, plain = [], Alternating._try

    def unlike(self, start, end, dt):
        """Return the names of other contacts for each step size, so that the error is unknown."""
        q, v, _ = plain(self, start, end, dt)
        compared.append(end)
        return q, v, [str(dt)]

    monkeypatch.setattr(Alternating, "_try", unlike)
    trajectory = simulate_auto(chattering(), np.zeros(3), [1.0, 0, 0], 2.0, dt=1e-3)
    assert all(math.isnan(one.error) for one in trajectory.stepped)
    assert len(compared) == 2 * len(trajectory.stepped) > 0
    assert trajectory.q[-1, 0] == pytest.approx(0.5 / 0.7, abs=2e-3)


@pytest.mark.parametrize(
    "control",
    [lambda t, q, v: -np.sign(v), lambda t, q, v: -np.tanh(v / 1e-9)],
    ids=["jump", "stiff"],
)
def test_vanishing_step_sizes_end_the_event_driven_scheme(control):
    """Few of these steps are rejected, and velocities change by errors only; 1 s would take 10⁸ steps."""
    scene, v0 = Scene(slider(), control=control), [1.0, 0.4, 0.2]
    with pytest.raises(SimulationError, match="is discontinuous or too stiff") as caught:
        simulate(scene, np.zeros(3), v0, 3.0, scheme="event-driven")
    partial = caught.value.partial
    assert partial.statistics["steps"] < 1000
    assert partial.t[-1] == pytest.approx(0.4, abs=1e-3)
    crossed = simulate_auto(scene, np.zeros(3), v0, 1.2)
    np.testing.assert_allclose(crossed.q[-1, :2], np.square(v0[:2]) / 2.0, atol=2e-3)


def test_short_steps_of_fast_oscillation_are_accepted():
    rate = 1e8
    scene = Scene(slider(), control=lambda t, q, v: -(rate**2) * q)
    trajectory = simulate(scene, np.zeros(3), [1.0, 0.4, 0.2], 4e-6, scheme="event-driven")
    assert trajectory.statistics["steps"] > 400
    np.testing.assert_allclose(trajectory.v[-1], np.array([1.0, 0.4, 0.2]) * np.cos(400.0), atol=1e-4)


def test_user_events_happen_once_and_on_time_during_time_steps():
    seen = []
    event = Event(lambda t, q, v: t - 1.55, lambda t, q, v: seen.append(t), name="first")
    last = Event(lambda t, q, v: t - 1.7, terminal=True, name="last")
    trajectory = simulate_auto(chattering(events=[event, last]), np.zeros(3), [1.0, 0, 0], 3.0)
    assert seen == [pytest.approx(1.55, abs=1e-12)]
    assert [record.name for record in trajectory.events] == ["first", "last"]
    assert trajectory.t[-1] == pytest.approx(1.7, abs=1e-12)
    assert trajectory.stepped[-1].end == trajectory.t[-1]


@pytest.fixture(scope="module")
def chattered():
    return simulate_auto(chattering(), np.zeros(3), [1.0, 0, 0], 1.6)


def test_stepped_intervals_are_saved_and_pickled(chattered, tmp_path):
    trajectory = chattered
    assert "time steps of 0.0005 s" in str(trajectory)
    assert "in time steps" in repr(trajectory)
    trajectory.save(tmp_path / "motion.npz")
    for again in (pickle.loads(pickle.dumps(trajectory)), Trajectory.load(tmp_path / "motion.npz")):
        assert repr(again.stepped) == repr(trajectory.stepped)


def test_report_lists_stepped_intervals(chattered):
    trajectory = chattered
    console = Console(width=200)
    with console.capture() as shown:
        console.print(run_report(trajectory))
    interval = trajectory.stepped[0]
    assert f"{interval.start:.6f}" in shown.get().partition("Time stepping: ")[2]
    assert run_facts(trajectory)["stepped"][0]["end"] == interval.end


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning")
def test_user_event_in_the_step_before_time_steps_happens_once():
    """41 points arrive together, which the event-driven scheme refuses, in the step that has the event."""
    model, count = pin.Model(), 41
    for k in range(count):
        joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), f"{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        model.addJointFrame(joint)
    unbounded(model)
    event = Event(lambda t, q, v: q[0] - 0.001, name="near")
    scene = Scene(model, [Contact(f"{k}", FLOOR) for k in range(count)], events=[event])
    trajectory = simulate(scene, np.full(count, 0.1), np.zeros(count), 0.2)
    assert "41 contacts" in trajectory.stepped[0].reason
    assert [one.time for one in trajectory.events] == [pytest.approx(math.sqrt(0.198 / 9.81), abs=1e-9)]


def test_corner_resting_on_corner_is_stepped():
    """The normal of two touching corners is undetermined, so the crate may fall to any side."""
    robot = shaped_body(coal.Box(0.2, 0.2, 0.2), pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2), name="crate")
    turned = pin.rpy.rpyToMatrix(math.pi / 4, math.atan(math.sqrt(0.5)), 0.0)
    tip = Box(size=(1.0, 1.0, 1.0), rpy=tuple(pin.rpy.matrixToRpy(turned)), name="tip")
    scene = Scene(robot, Contact(geometry="crate", plane=tip))
    top = 0.6 * math.sqrt(3.0)
    q0 = np.array([0, 0, top + 0.1, *pin.Quaternion(turned).coeffs()])
    with pytest.raises(SimulationError, match="crate on tip"):
        simulate(scene, q0, np.zeros(6), 0.3, scheme="event-driven")
    trajectory = simulate_auto(scene, q0, np.zeros(6), 0.3)
    assert trajectory.stepped[0].start == pytest.approx(math.sqrt(0.2 / 9.81), abs=1e-6)
    total = trajectory.energy.total
    assert np.diff(total).max() < 1e-5  # of 11 J, by correction of penetration
    for t in np.linspace(0.0, 0.3, 60):
        crate = (0.2, 0.2, 0.2), pin.XYZQUATToSE3(trajectory.at(t)[0])
        # the corner moves along a curve within a step
        assert overlap(crate, ((1.0, 1.0, 1.0), pin.SE3(turned, np.zeros(3)))) < 5e-6


@pytest.mark.parametrize("scheme", ["auto", pytest.param("event-driven", marks=pytest.mark.exhaustive)])
def test_ten_aligned_boxes_stand_for_one_minute(scheme):
    """Corners lie on corners, so rounding moves contact points off the faces and edges and back."""
    scene = boxes(10, (0.2, 0.2, 0.1), 1.0)
    q0 = np.tile([0, 0, 0, *UP], 10)
    q0[2::7] = 0.05 + 0.1 * np.arange(10)
    trajectory = simulate(scene, q0, np.zeros(60), 60.0, scheme=scheme)
    assert trajectory.complete
    assert not trajectory.stepped
    assert not trajectory.impacts
    for t in np.linspace(0.0, 60.0, 31):
        q, v = trajectory.at(t)
        assert np.abs(q - q0).max() < 1e-8
        assert np.abs(v).max() < 1e-9
    assert sum(trajectory.forces(f"floor 0 corner {k}", 60.0)[2] for k in (1, 2, 3, 4)) == pytest.approx(
        10.0 * 9.81, rel=1e-9
    )


def dominoes(count, order):
    """Return scene, initial state and sizes of dominoes in a row, of which the first one is tipping.

    `order[k]` is the position of domino k in the row. The domino at the origin rotates about its lower edge.
    """
    thick, wide, high, rate = 0.008, 0.024, 0.048, 6.0
    scene = boxes(count, (thick, wide, high), 0.01, floor=0.6, between=0.3)
    q0 = np.tile([0, 0, 0.5 * high, *UP], count)
    q0[::7] = 0.028 * np.array(order)
    v0 = np.zeros(6 * count)
    first = 6 * order.index(0)
    v0[first : first + 6] = 0.5 * rate * high, 0, 0.5 * rate * thick, 0, rate, 0
    return scene, q0, v0, [(thick, wide, high)] * count


@pytest.mark.slow
def test_domino_times_do_not_depend_on_numbering():
    # Moreau–Jean steps of 1 ms with coal's patches and Pinocchio's ADMM: times of a lean of 0.3 rad
    wanted = [0.054, 0.144, 0.206, 0.253, 0.293]
    found = []
    for order in (list(range(5)), list(range(4, -1, -1))):
        scene, q0, v0, bodies = dominoes(5, order)
        trajectory = simulate_auto(scene, q0, v0, 0.32)

        def lean(t, k, trajectory=trajectory):
            q = trajectory.at(t)[0]
            return 2.0 * math.atan2(q[7 * k + 4], q[7 * k + 6]) - 0.3

        found.append([brentq(lean, 0.0, 0.32, args=(order.index(k),)) for k in range(5)])
        assert deepest_penetration(trajectory, bodies) < 1e-6
        # not exactly planar: in an impact at 16 contacts with e = 0, rounding decides which of two corners
        # stops first (NEAR_JUMP)
        assert np.abs(trajectory.q[:, 1::7]).max() < 1e-4
        assert np.diff(trajectory.energy.total).max() < 1e-6
    np.testing.assert_allclose(found, [wanted, wanted], atol=2e-3)
    np.testing.assert_allclose(found[0], found[1], atol=1e-3)


def test_step_sizes_do_not_depend_on_the_coordinate_of_another_body():
    """The tolerance of time steps is relative to the size of each coordinate, not to the largest one."""
    steps, count = [], 11
    for far in (0.0, 1e3):
        scene, q0, v0, _ = dominoes(count, list(range(count)))
        model, shapes = scene.model.copy(), scene.geometry
        joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "far")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        unbounded(model)
        given = dict.fromkeys(contact.pair for contact in scene.contacts if contact.pair is not None)
        floor = [
            Contact(geometry=f"box_{k}_0", plane=FLOOR, friction=0.6, name=f"floor {k}") for k in range(count)
        ]
        robot = pin.RobotWrapper(model, shapes, shapes)
        standing = Scene(robot, [*floor, *given])
        trajectory = simulate_auto(standing, [*q0, far], [*v0, 0.0], 0.1, rtol=1e-4, atol=1e-6)
        steps.append([(one.start, one.end, one.dt) for one in trajectory.stepped])
    assert steps[0] == steps[1] != []


def struck_stack(speed):
    """Return scene, initial state and sizes of a stack of five boxes and a small box flying at the top."""
    model, shapes = pin.Model(), pin.GeometryModel()
    sizes, masses = [(0.2, 0.2, 0.1)] * 5 + [(0.05, 0.05, 0.05)], [1.0] * 5 + [0.3]
    for k, (size, mass) in enumerate(zip(sizes, masses, strict=True)):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"box_{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(mass, *size), pin.SE3.Identity())
        model.addJointFrame(joint)
        shapes.addGeometryObject(pin.GeometryObject(f"box_{k}_0", joint, pin.SE3.Identity(), coal.Box(*size)))
    unbounded(model)
    pairs = [(k + 1, k) for k in range(4)] + [(5, k) for k in range(5)]
    contacts = [
        Contact(geometry=f"box_{k}_0", plane=FLOOR, friction=0.5, name=f"floor {k}") for k in range(6)
    ]
    contacts += [
        Contact(geometry=f"box_{i}_0", plane=Shape(f"box_{j}_0"), friction=0.5, name=f"pair {i} {j}")
        for i, j in pairs
    ]
    q0 = np.tile([0, 0, 0.05, *UP], 6)
    q0[2:35:7] += 0.1 * np.arange(5)
    q0[35:38] = -0.2, 0.0, 0.46
    v0 = np.zeros(36)
    v0[30:33] = speed, 0.0, 0.0
    return Scene(pin.RobotWrapper(model, shapes, shapes), contacts), q0, v0, sizes


@pytest.mark.slow
def test_struck_stack_agrees_with_short_time_steps():
    scene, q0, v0, sizes = struck_stack(2.0)
    short = simulate(scene, q0, v0, 0.12, scheme="time-stepping", dt=1.25e-4)
    runs = [simulate_auto(scene, q0, v0, 0.12, dt=dt) for dt in (4e-3, 1e-3, 2.5e-4)]
    for trajectory in runs:
        assert sum(one.end - one.start for one in trajectory.stepped) < 0.1  # the rest by events
        assert deepest_penetration(trajectory, sizes) < 1e-6
        assert np.abs(trajectory.q[:, 1::7]).max() < 1e-9  # the motion is mirror symmetric
        np.testing.assert_allclose(trajectory.q[-1], short.q[-1], atol=1e-4)
    errors = [np.abs(run.q[-1] - runs[-1].q[-1]).max() for run in runs[:-1]]
    assert errors[1] < 0.5 * errors[0] < 1e-6
    residuals = [abs(run.energy.residual[-1]) for run in runs]
    assert residuals[0] < 1e-5
    assert residuals[1] < max(0.4 * residuals[0], 1e-12)
    assert residuals[2] < 1e-6


def test_many_separate_boxes_are_stepped_and_come_to_rest():
    """Twelve boxes fall flat from different heights: too many contacts for the event-driven scheme."""
    count, fall = 12, np.linspace(0.02, 0.1, 12)
    q0 = np.tile([0, 0, 0, *UP], count)
    q0[0::7], q0[2::7] = 0.5 * np.arange(count), 0.05 + fall
    run = simulate_auto(boxes(count, (0.2, 0.2, 0.1), 1.0), q0, np.zeros(6 * count), 0.6)
    assert run.stepped[-1].reason == "scene: 44 contacts are active at once"
    # ten boxes stand when the eleventh lands
    assert run.stepped[-1].start == pytest.approx(math.sqrt(2.0 * fall[10] / 9.81), abs=1e-9)
    assert run.stepped[-1].end == 0.6
    rest = q0.copy()
    rest[2::7] = 0.05
    assert np.abs(run.q[-1] - rest).max() < 1e-8
    assert np.abs(run.v[-1]).max() < 1e-6
    assert np.abs(run.energy.residual).max() < 1e-6
    assert run.forces("floor 7 corner 1", 0.6)[2] == pytest.approx(9.81 / 4.0, rel=1e-6)


def test_wall_is_stepped_from_the_start():
    """Ten bricks in running bond are one island with 60 contacts."""
    courses = (3, 2, 3, 2)
    places = [(k + 0.5 * (row % 2), row) for row, count in enumerate(courses) for k in range(count)]
    q0 = np.hstack([[0.2 * x, 0.0, 0.06 * (row + 0.5), *UP] for x, row in places])
    scene = boxes(10, (0.2, 0.1, 0.06), 0.1)
    pairs = [
        Contact(geometry=f"box_{j}_0", plane=Shape(f"box_{i}_0"), friction=0.5, name=f"{i} under {j}")
        for (i, (x, row)), (j, (above, upper)) in itertools.combinations(enumerate(places), 2)
        if abs(above - x) < 1.0 and upper == row + 1
    ]
    floor = [contact for contact in scene.contacts if "floor" in contact.label]
    run = simulate_auto(replace(scene, contacts=[*floor, *pairs]), q0, np.zeros(60), 0.5)
    (stepped,) = run.stepped
    assert (stepped.start, stepped.end) == (0.0, 0.5)
    assert stepped.reason == "scene: 60 contacts are active at once"
    assert np.abs(run.q[-1] - q0).max() < 1e-9
    assert sum(run.forces(f"floor {i} corner {k}", 0.5)[2] for i in range(3) for k in (1, 2, 3, 4)) == (
        pytest.approx(10 * 0.1 * 9.81, rel=1e-9)
    )


def test_separate_boxes_at_rest_need_no_time_steps():
    count = 8
    q0 = np.tile([0, 0, 0.05, *UP], count)
    q0[0::7] = 0.5 * np.arange(count)
    run = simulate_auto(boxes(count, (0.2, 0.2, 0.1), 1.0), q0, np.zeros(6 * count), 1.0)
    assert not run.stepped
    assert run.statistics["steps"] < 5
    assert np.abs(run.q[-1] - q0).max() < 1e-12
    assert run.forces("floor 7 corner 1", 0.6)[2] == pytest.approx(9.81 / 4.0, rel=1e-9)


@pytest.mark.slow
def test_unresolved_impacts_of_a_pile_are_stepped():
    # with "auto", impacts (e = 0) whose propagation does not converge are not replaced by a plastic impact
    reasons = []
    for seed in range(5, 11):  # the motions are chaotic, and other reasons may come first
        rng = np.random.default_rng(seed)
        q0 = np.tile([0, 0, 0, *UP], 10)
        for k in range(10):
            q0[7 * k : 7 * k + 3] = *rng.normal(0.0, 0.05, 2), 0.06 + 0.13 * k
        run = simulate_auto(boxes(10, (0.2, 0.2, 0.1), 1.0), q0, np.zeros(60), 0.2)
        reasons += [one.reason for one in run.stepped]
        assert not any("plastic" in note.text for note in run.notes)
    assert any("not resolved" in reason for reason in reasons)


@pytest.mark.filterwarnings("ignore::pinimpact.SteppedWarning", "ignore::pinimpact.BoundReachedWarning")
def test_stepped_interval_may_start_with_an_impact():
    # boxes rattle on each other, and time steps start at the impact of a corner; no impact creates energy
    scene = boxes(3, (0.1, 0.1, 0.1), 1.0, restitution=0.5)
    q = []
    for k in range(3):
        turn = pin.Quaternion(pin.exp3(np.array([0.01 * (k + 1), 0.01, 0.1 * k])))
        q += [0.006 * k, 0.0, 0.07 + 0.11 * k, *turn.coeffs()]
    run = simulate(scene, np.array(q), np.zeros(18), 0.1)
    assert run.stepped
    started = run.stepped[0].start
    first = [impact for impact in run.impacts if impact.time == started]
    assert first
    mass = pin.crba(scene.model, scene.model.createData(), first[0].q)
    assert first[0].v_after @ mass @ first[0].v_after < first[0].v_before @ mass @ first[0].v_before
    assert np.diff(run.energy.total).max() < 1e-6 * run.energy.total[0]


@pytest.mark.parametrize(
    ("contacts", "count", "length", "ending", "takes_over"),
    [
        (8, 50, 0.50, 0.2, True),  # in time steps: (8/10)³ = 0.51
        (8, 50, 0.52, 0.2, False),
        (8, 50, 0.50, 0.05, False),  # a control makes steps short
        (8, 49, 0.50, 0.2, False),
        (10, 10, 0.0098, 0.2, True),  # a hundred times as short
        (10, 10, 0.0102, 0.2, False),
        (10, 9, 0.0098, 0.2, False),
        (9, 10, 0.0050, 0.2, False),  # cheaper than a time step
        (20, 6, 7.9, 0.2, True),  # six of them cost 48 time steps
        (20, 6, 8.1, 0.2, False),
        (20, 5, 7.9, 0.2, False),
        (38, 1, 54.0, 1.0, True),
        (38, 1, 55.0, 1.0, False),
        (4, 200, 0.05, 1.0, False),  # cheap steps
        (4, 200, 0.009, 1.0, True),  # events accumulate
    ],
)
def test_time_steps_take_over_where_event_driven_steps_cost_more(contacts, count, length, ending, takes_over):
    dt, h = 1e-3, 1e-3 * length
    lengths = (
        np.where(np.arange(count) < count * ending, 2.0, 1.0) * h
    )  # those that events end are cut by half
    steps = [SimpleNamespace(start=k * h, end=(k + 1) * h, h=length) for k, length in enumerate(lengths)]
    record = SimpleNamespace(dense_steps=steps)
    motion = SimpleNamespace(
        **{"work": SimpleNamespace(active_contacts=contacts), "record": record, "_longest": dt},
        **{"instant": SimpleNamespace(record=record), "state": SimpleNamespace(events_since=0), "rims": ()},
    )
    if takes_over:
        with pytest.raises(IrregularMotionError, match=f"{count} steps cover .* active contacts: {contacts}"):
            Alternating._watch_events(motion)
    else:
        Alternating._watch_events(motion)


def test_restitution_that_is_lost_in_time_steps_is_reported():
    """An elastic mass between stops 10 µm apart has more impacts in a step than the 20 that are located."""
    model = rough_joint(0.0)
    model.lowerPositionLimit[0], model.upperPositionLimit[0] = 0.0, 1e-5
    scene, q, lost = Scene(model, limit_restitution=1.0), [5e-6], "further ones are without restitution"
    for speed, frequent in ((0.15, False), (0.5, True)):
        steps = simulate(scene, q, [speed], 5e-3, scheme="time-stepping")
        assert (abs(steps.v[-1, 0]) < 0.9 * speed) == frequent
        assert any(lost in note.text for note in steps.notes) == frequent
    both = simulate_auto(scene, q, [6.0], 2e-3)
    assert abs(both.v[-1, 0]) < 5.0
    assert all(math.isnan(one.error) for one in both.stepped)
