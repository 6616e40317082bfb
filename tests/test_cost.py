"""Benchmark of accuracy against run time, with a simulated clock, and Pinocchio's solvers."""

import itertools
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from pinimpact import Flag, ImpactProblem, InputError, Method, UnknownNameError, solve_impact
from pinimpact.contact_space.methods import METHODS
from pinimpact.studies import cost
from pinimpact.studies.pinocchio_baseline import SOLVERS, solve_constraint

CLASSES = cost.problem_classes()
TWO = {name: CLASSES[name] for name in ("smooth slip", "planar")}


TICK = 2.0**-20  # advance of the simulated clock [s]; its sums are exact


@pytest.fixture(scope="module")
def report():
    """Return a report by a clock that advances by `TICK` whenever it is read."""
    ticks = itertools.count()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cost, "time", SimpleNamespace(perf_counter=lambda: TICK * next(ticks)))
        return cost.run_cost(TWO, methods=("exact", "rk4", "adaptive"), repeats=1, time_cap=60.0)


def test_flags_of_problem_classes():
    flags = {name: solve_impact(problem).flags for name, problem in CLASSES.items()}
    assert flags["smooth slip"] == Flag.SLIP_TURNED
    assert Flag.STICK in flags["slip to stick"]
    assert Flag.SLIP_RESUMED in flags["resumed slip"]
    assert Flag.SLIP_RESUMED in flags["near-critical friction"]
    assert (Flag.JAM | Flag.SECOND_COMPRESSION) in flags["jam"]
    assert flags["planar"] == Flag.SINGULAR_DELASSUS
    assert flags["frictionless"] == Flag.NONE
    invariant = CLASSES["near-invariant start"]
    exactly = solve_impact(ImpactProblem(invariant.delassus, (-1.0, 0.0, -1.0), 0.3, 0.5))
    assert Flag.SLIP_TURNED not in exactly.flags
    critical = CLASSES["near-critical friction"]
    A, b = np.asarray(critical.delassus)[:2, :2], np.asarray(critical.delassus)[:2, 2]
    assert np.linalg.norm(np.linalg.solve(A, b)) / critical.friction == pytest.approx(1.0 + 1e-6, abs=1e-9)


def test_every_setting_is_measured(report):
    assert report.problems == tuple(TWO)
    count = 1 + len(cost.SETTINGS["rk4"]) + len(cost.SETTINGS["adaptive"])
    assert len(report.points) == 2 * count
    per_call = TICK / math.ceil(cost.BATCH / TICK)  # one tick per batch
    for point in report.points:
        assert point.call_seconds == per_call
        assert point.seconds == per_call


def test_errors_are_those_of_the_methods(report):
    for p in report.points:
        if p.method == "exact":
            assert p.error <= 1e-12
        elif p.method == "rk4":
            errors = (
                solve_impact(TWO[p.problem], "rk4", **p.setting).velocity
                - solve_impact(TWO[p.problem]).velocity
            )
            size = np.linalg.norm(TWO[p.problem].velocity)
            assert np.linalg.norm(errors) / size <= p.error


def test_cheapest_setting_within_a_target(report):
    best = report.cheapest(1e-6)
    for point, problem in zip(best, TWO, strict=True):
        rivals = [p for p in report.points if p.problem == problem and p.error <= 1e-6]
        assert point.error <= 1e-6
        assert point.cost == min(p.cost for p in rivals)
    assert report.cheapest(1e-30) == (None, None)
    assert "no method" in report.advice(1e-30)
    assert "smooth slip" in report.advice(1e-6)


@pytest.mark.parametrize("target", [0.0, -1.0, math.nan, math.inf])
def test_invalid_target_raises(report, target):
    with pytest.raises(InputError, match="target"):
        report.cheapest(target)


def test_table_names_everything(report):
    table = report.table()
    for word in ("smooth slip", "planar", "exact()", "rk4(steps=100)", "adaptive(rtol=1e-08)", "admm", "pgs"):
        assert word in table


def test_raw_figures_and_diagram(report, tmp_path):
    report.save(tmp_path / "cost.json")
    raw = json.loads((tmp_path / "cost.json").read_text(encoding="utf-8"))
    assert len(raw["points"]) == len(report.points)
    assert raw["points"][0]["error"] == report.points[0].error
    assert {"cpu", "system", "python", "packages"} <= set(raw["machine"])
    assert {"pinimpact", "pin", "numba", "numpy"} <= set(raw["machine"]["packages"])
    report.plot(tmp_path / "cost.png")
    assert (tmp_path / "cost.png").read_bytes().startswith(b"\x89PNG")


def test_failing_method_has_nan(monkeypatch, tmp_path):
    def load():
        def run(inputs, trace, path):
            raise InputError("no answer")

        return run

    monkeypatch.setattr(cost, "METHODS", {**METHODS, "failing": Method(load, "never answers")})
    report = cost.run_cost({"planar": CLASSES["planar"]}, methods=("failing",), repeats=1, time_cap=0.01)
    (point,) = report.points
    assert math.isnan(point.error)
    assert math.isnan(point.cost)
    report.save(tmp_path / "cost.json")
    assert json.loads((tmp_path / "cost.json").read_text(encoding="utf-8"))["points"][0]["error"] is None
    report.plot(tmp_path / "cost.png")


def test_unknown_method():
    with pytest.raises(UnknownNameError, match="no_such"):
        cost.run_cost(TWO, methods=("no_such",), repeats=1, time_cap=0.01)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(2.5, "2.5 s"), (1.25e-3, "1.25 ms"), (3e-6, "3 µs"), (4e-8, "40 ns"), (math.nan, "–")],
)
def test_durations(seconds, text):
    assert cost.duration(seconds) == text


@pytest.mark.parametrize("solver", SOLVERS)
def test_pinocchio_agrees_for_slip_of_constant_direction(solver):
    for name in ("planar", "frictionless"):
        problem = CLASSES[name]
        path = solve_impact(ImpactProblem(problem.delassus, problem.velocity, problem.friction, 0.0))
        velocity, impulse = solve_constraint(problem.delassus, problem.velocity, problem.friction, solver)
        assert velocity == pytest.approx(path.velocity, abs=1e-8)
        assert impulse == pytest.approx(path.impulse, abs=1e-8)


@pytest.mark.parametrize("solver", SOLVERS)
def test_pinocchio_friction_opposes_final_slip(solver):
    # the solution obeys Coulomb's law for the final slip, and differs from that by integration
    problem = CLASSES["smooth slip"]
    v, P = solve_constraint(problem.delassus, problem.velocity, problem.friction, solver)
    slip = v[:2] / np.linalg.norm(v[:2])
    assert v[2] == pytest.approx(0.0, abs=1e-9)
    assert P[:2] == pytest.approx(-problem.friction * P[2] * slip, abs=1e-8)
    path = solve_impact(ImpactProblem(problem.delassus, problem.velocity, problem.friction, 0.0))
    assert np.linalg.norm(v - path.velocity) > 1e-2


def test_unknown_solver():
    with pytest.raises(UnknownNameError, match="newton"):
        solve_constraint(np.eye(3), (1.0, 0.0, -1.0), 0.3, "newton")
