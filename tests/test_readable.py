"""Representation of results in terminals and notebooks."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, ImpactProblem, Plane, Scene, impact, solve_impact
from pinimpact.scene.records import Note, group_notes

PROBLEM = pinimpact.ImpactProblem(
    [[1.3, 0.2, 0.4], [0.2, 0.8, -0.3], [0.4, -0.3, 0.9]], (0.2, 0.1, -1.0), 0.8, 0.5
)


@pytest.fixture(scope="module")
def toss():
    robot = pinimpact.load_robot("ellipsoid")
    floor = pinimpact.Plane(name="floor <wet>")
    contact = pinimpact.Contact("tip", floor, friction=0.3, restitution=0.5)
    scene = pinimpact.Scene(robot, [contact])
    q = robot.q0.copy()
    q[2] += 0.3 - contact.gap(robot, robot.data, q)
    return scene, pinimpact.simulate(scene, q, np.array([0.4, 0.0, 0.0, 0.0, 0.0, 0.0]), 2.0)


class Tables(HTMLParser):
    """Parser of tables: rows of cells, and text outside of them; tags must be closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.texts: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data
        else:
            self.texts.append(data)


def test_flags_are_printed_in_words():
    flags = pinimpact.solve_impact(PROBLEM).flags
    assert pinimpact.Flag.STICK in flags
    assert str(flags) == f"{flags}" == " ".join(flags.describe())
    assert "The contact came to stick." in str(flags)
    assert str(pinimpact.Flag.NONE) == "Nothing special."
    assert repr(pinimpact.Flag.STICK) == "<Flag.STICK: 8>"
    assert f"{pinimpact.Status.SEPARATED}" == str(pinimpact.Status.SEPARATED)


def test_solution_in_notebook():
    solution = pinimpact.solve_impact(PROBLEM)
    found = Tables(solution._repr_html_())
    rows = {row[0]: row[1:] for row in found.rows if row}
    assert np.array(rows["velocity after [m/s]"], float) == pytest.approx(
        solution.velocity, rel=1e-5, abs=1e-9
    )
    assert np.array(rows["impulse [N s]"], float) == pytest.approx(solution.impulse, rel=1e-5, abs=1e-9)
    assert float(rows["total"][0]) == pytest.approx(solution.work.total, rel=1e-5)
    assert str(solution.status) in found.texts


def test_impact_at_several_contacts_in_notebook():
    robot = pinimpact.load_robot("solo12")
    floor = pinimpact.Plane(name="floor <wet>")
    feet = [pinimpact.Contact(name, floor, 0.5, 0.3, "energetic") for name in ("FL_FOOT", "HR_FOOT")]
    v = np.zeros(robot.model.nv)
    v[:3] = 0.3, 0.1, -1.0
    hit = pinimpact.impact(robot.model, robot.data, robot.q0, v, feet)
    found = Tables(hit._repr_html_())
    labels = [foot.label for foot in feet]
    tables = [
        np.array([row[1:4] for row in found.rows if row and row[0] == label], float) for label in labels
    ]
    for j, (world, after, impulse, work) in enumerate(tables):
        assert world == pytest.approx(hit.impulses_world[j], rel=1e-5)
        assert after == pytest.approx(hit.solution.velocity[j], rel=1e-5, abs=1e-9)
        assert impulse == pytest.approx(hit.solution.impulse[j], rel=1e-5)
        assert work[0] == pytest.approx(hit.solution.work.compression[j], rel=1e-5)
    (whole,) = [row for row in found.rows if row and row[0] == "all"]
    data = robot.model.createData()
    before, after = (pin.computeKineticEnergy(robot.model, data, robot.q0, u) for u in (v, hit.v))
    assert float(whole[-1]) == pytest.approx(after - before, rel=1e-5)
    assert f"{labels[0]}: {hit.solution.statuses[0]}" in found.texts
    assert "contact 1" in [row[0] for row in Tables(hit.solution._repr_html_()).rows if row]
    one = pinimpact.impact(robot.model, robot.data, robot.q0, v, feet[0])
    found = Tables(one._repr_html_())
    assert np.array(found.rows[1], float) == pytest.approx(one.impulse_world, rel=1e-5)
    assert str(one.solution.status) in found.texts


def test_plan_in_notebook(toss):
    plan = toss[0].plan()
    rows = Tables(plan._repr_html_()).rows[1:]
    assert [row[0] for row in rows] == [effect.name for effect in plan]
    assert [row[1] == "yes" for row in rows] == [effect.on for effect in plan]


def test_trajectory_in_terminal_and_notebook(toss):
    _, trajectory = toss
    count = len(trajectory.impacts)
    assert count > 0
    assert f"{count} impact" in repr(trajectory)
    assert f"{count} impacts (tip on floor <wet> {count})" in str(trajectory) or count == 1
    assert trajectory.termination in str(trajectory)
    found = Tables(trajectory._repr_html_())
    rows = [row for row in found.rows if len(row) == 5][1:]
    assert [row[1] for row in rows] == [impact.source for impact in trajectory.impacts[:20]]
    assert float(rows[0][0]) == pytest.approx(trajectory.impacts[0].time, rel=1e-5)


def test_repr_of_energy_and_impacts(toss):
    _, trajectory = toss
    energy, impact = trajectory.energy, trajectory.impacts[0]
    numbers = [float(x) for x in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", repr(energy))]
    assert len(repr(energy)) < 250
    assert numbers[:2] == pytest.approx([energy.total[0], energy.total[-1]], rel=1e-5)
    assert numbers[2:7] == pytest.approx([work[-1] for work in energy.by_cause().values()], rel=1e-5)
    assert len(repr(impact)) < 250
    assert impact.source in repr(impact)
    numbers = [float(x) for x in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", repr(impact).split("velocity")[1])]
    expected = [
        impact.problem.velocity[2],
        impact.solution.velocity[2],
        np.linalg.norm(impact.solution.impulse),
    ]
    assert numbers[:3] == pytest.approx(expected, rel=1e-5)


def test_equal_notes_are_grouped_in_one_line(toss):
    _, trajectory = toss
    notes = [note for note in trajectory.notes if "resting" in note.text]
    assert len(notes) >= 1
    assert sum("resting" in line for line in str(trajectory).splitlines()) == 1
    some = [
        Note(0.1, "a on floor comes to rest: it would bounce slower than 0.0003 m/s."),
        Note(0.2, "b on floor comes to rest: it would bounce slower than 0.0003 m/s."),
        Note(0.3, "a on floor comes to rest: it would bounce slower than 0.0004 m/s."),
        Note(0.4, "held: 'a 1' pulls on its surface with 0.3 N s; leave it out"),
        Note(0.5, "held: 'a 2' pulls on its surface with 0.3 N s; leave it out"),
        Note(0.6, "held: 'a 2' pulls on its surface with 1.5e-05 N s; leave it out"),
    ]
    groups = group_notes(some)
    assert [group.times for group in groups] == [(0.1, 0.3), (0.2,), (0.4,), (0.5, 0.6)]
    assert str(groups[0]).startswith("t = 0.1000 to 0.3000 s, 2 times: a on floor")
    assert str(groups[1]).startswith("t = 0.2000 s: b on floor")


def test_labels_of_contacts_contain_names_of_surfaces():
    table = pinimpact.Plane(name="table")
    assert pinimpact.Contact("hand", table).label == "hand on table"
    assert pinimpact.Contact("hand", pinimpact.Sphere(radius=1.0, name="ball")).label == "hand on ball"
    assert pinimpact.Contact("hand", pinimpact.Plane(body="tray")).label == "hand on tray"
    assert pinimpact.Contact("hand", pinimpact.Plane(body="tray", name="tray")).label == "hand on tray"
    assert pinimpact.Contact("hand", pinimpact.Plane(name="table"), name="grip").label == "grip"


def test_repr_of_objects_is_one_line(toss):
    robot = pinimpact.load_robot("panda")
    model, data = robot.model, robot.data
    hand = Contact("panda_hand_tcp", Plane((0, 0, 0.2)), friction=0.4, restitution=0.5)
    q, v = np.array([0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02]), -np.ones(9)
    both = ImpactProblem(np.eye(6) + 0.1, [(1, 0, -1), (0, 0, -1)], [0.3, 0.3], [0.5, 0.5])
    solution = solve_impact(ImpactProblem(np.eye(3), (1.0, 0.5, -1.0), 0.3, 0.5), record=True)
    scene = Scene(robot, [hand])
    stepper = pinimpact.Stepper(scene, q, np.zeros(9))
    shown = {
        "Scene": scene,
        "Plan": scene.plan(),
        "Stepper": stepper,
        "Solution": solution,
        "Path": solution.path,
        "ManySolution": solve_impact(both),
        "Hit": impact(model, data, q, v, hand),
        "Hits": pinimpact.impacts(model, data, q, v, hand),
        "ContactMatrices": pinimpact.contact_matrices(model, data, q, hand),
        "Trajectory": toss[1],
    }
    for name, item in shown.items():
        text = repr(item)
        assert text.startswith(f"{name}("), text
        assert len(text) < 250, text
        assert "\n" not in text
    first = [float(x) for x in re.findall(r"-?\d+\.?\d*(?:e[-+]?\d+)?", repr(solution).split("impulse")[0])]
    assert first == pytest.approx(solution.velocity.tolist(), rel=1e-5)
    assert "gravity" in repr(scene.plan())
    stepper.step(np.zeros(9), 0.25)
    assert "t = 0.25 s" in repr(stepper)
