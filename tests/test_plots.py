"""Plots: lines against closed forms and independent computations; legends."""

from __future__ import annotations

import importlib.util
import math
import re
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
import pinocchio as pin
import pytest
from matplotlib import pyplot
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text
from scipy.integrate import solve_ivp

import pinimpact
from pinimpact.studies.cost import problem_classes
from pinimpact.visual import plots
from pinimpact.visual.plots.one_impact import parts
from pinimpact.visual.plots.regimes import REGIMES
from pinimpact.visual.smooth_path import invariant_directions, smooth_path

matplotlib.use("Agg")

S, C = math.sin(0.46), math.cos(0.46)
ROD = pinimpact.ImpactProblem(  # a rod of mass 1: slip stops, and resumes across its first direction
    [[4.0, 0.0, 0.0], [0.0, 1.0 + 3.0 * S * S, -3.0 * S * C], [0.0, -3.0 * S * C, 1.0 + 3.0 * C * C]],
    (0.2, 0.2 * 3**0.5, -2.0),
    0.7,
    0.8,
)
PLANAR = pinimpact.ImpactProblem(
    [[1.2, 0.0, 0.9], [0.0, 1.0, 0.0], [0.9, 0.0, 1.0]], (0.8, 0.0, -1.0), 1.3, 0.6
)


def random_problems(count: int):
    rng = np.random.default_rng(11)
    for _ in range(count):
        root = rng.normal(size=(3, 3))
        velocity = rng.normal(size=3)
        velocity[2] = -abs(velocity[2])
        yield pinimpact.ImpactProblem(
            root @ root.T + 0.02 * np.eye(3), velocity, rng.uniform(0.05, 1.2), rng.choice([0.0, 0.4, 0.9])
        )


CLASSES = problem_classes()


def lines(ax, label: str) -> list[np.ndarray]:
    return [line.get_xydata() for line in ax.lines if line.get_label() == label]


def test_hodograph_agrees_with_closed_form() -> None:
    problem = pinimpact.ImpactProblem(np.diag([2.0, 3.5, 1.0]), (0.5, 0.5, -1.0), 0.5, 0.5)
    ax = plots.hodograph(problem)
    drawn = np.vstack([*lines(ax, "slip in compression"), *lines(ax, "slip in restitution")])
    assert len(drawn) > 50
    v1, v2 = drawn.T
    np.testing.assert_allclose(v2, 0.5 * (np.maximum(v1, 0.0) / 0.5) ** 1.75, atol=1e-6)  # closed form (32)
    assert "stick" in [line.get_label() for line in ax.lines]
    (first,) = lines(ax, "first touch")
    np.testing.assert_array_equal(first, [[0.5, 0.5]])


def test_smooth_paths_solve_the_equations_of_slip() -> None:
    for problem in random_problems(12):
        solution = pinimpact.solve_impact(problem)
        path = smooth_path(problem, solution)
        w, mu = np.asarray(problem.delassus), problem.friction

        def rate(_, v, w=w, mu=mu):
            slip = v[:2] / np.hypot(*v[:2])
            return w @ [-mu * slip[0], -mu * slip[1], 1.0]

        end = next(s.end for s in reversed(solution.segments) if s.mode == "slip")
        if solution.flags & pinimpact.Flag.SLIP_RESUMED:
            continue
        span = path.normal_impulse < end * (1.0 - 1e-4)
        found = solve_ivp(
            rate, (0, end), np.asarray(problem.velocity), rtol=1e-11, atol=1e-12, dense_output=True
        )
        np.testing.assert_allclose(path.velocity[span], found.sol(path.normal_impulse[span]).T, atol=2e-5)


def test_smooth_paths_have_no_kinks() -> None:
    for problem in random_problems(60):
        path = smooth_path(problem, pinimpact.solve_impact(problem))
        assert largest_kink(path.velocity[:, :2]) < 8.0


def compact_bodies(count: int) -> list[pinimpact.ImpactProblem]:
    """Return sticking impacts of compact bodies: W is isotropic with deviations of 1e-17 to 1e-1."""
    rng, problems = np.random.default_rng(7), []
    for _ in range(count):
        skew = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-17, -1)
        w = np.diag([3.5, 3.5, 1.0]) + 0.1 * (skew + skew.T)
        velocity = rng.normal(size=3) * (1.0, 1.0, 0.0) - (0.0, 0.0, rng.uniform(0.5, 3.0))
        law = str(rng.choice(["poisson", "energetic", "newton"]))
        problems.append(pinimpact.ImpactProblem(w, velocity, rng.uniform(0.2, 1.5), rng.uniform(0, 1), law))
    return problems


def test_paths_are_monotonic_and_end_at_the_solution() -> None:
    regimes = pinimpact.Flag.NONE
    for problem in [*random_problems(200), *compact_bodies(300), *CLASSES.values()]:
        solution = pinimpact.solve_impact(problem)
        regimes |= solution.flags
        path = smooth_path(problem, solution)
        w, start = np.asarray(problem.delassus), np.asarray(problem.velocity)
        size, largest = np.abs(path.velocity).max(), solution.impulse[2]
        assert np.isfinite(path.velocity).all()
        assert np.diff(path.normal_impulse).min() >= -1e-15 * largest
        np.testing.assert_allclose(path.impulse[-1], solution.impulse, atol=1e-12 * largest)
        np.testing.assert_allclose(path.velocity[-1], solution.velocity, atol=1e-12 * size)
        np.testing.assert_allclose(path.velocity, start + path.impulse @ w, atol=1e-9 * size)
        steps = np.diff(path.impulse, axis=0)  # friction within its cone
        beyond = np.hypot(steps[:, 0], steps[:, 1]) - problem.friction * steps[:, 2]
        assert beyond.max(initial=0.0) <= 1e-9 * largest
    wanted = pinimpact.Flag.STICK | pinimpact.Flag.SLIP_RESUMED | pinimpact.Flag.JAM
    assert wanted | pinimpact.Flag.SECOND_COMPRESSION | pinimpact.Flag.SINGULAR_DELASSUS in regimes


def largest_kink(velocity: np.ndarray) -> float:
    """Return the largest angle [°] between visible successive lines, except at the end of slip."""
    steps, speed = np.diff(velocity, axis=0), np.hypot(*velocity.T)
    length = np.hypot(*steps.T)
    seen = (np.minimum(length[1:], length[:-1]) > 0.01 * speed.max()) & (speed[1:-1] > 0.0)
    turned = np.angle((steps @ [1, 1j])[1:] * np.conj((steps @ [1, 1j])[:-1]))
    return float(np.degrees(np.abs(turned[seen])).max(initial=0.0))


def test_parts_of_path_cover_all_segments() -> None:
    without_exact_start = 0
    for problem in random_problems(80):
        solution = pinimpact.solve_impact(problem, record=True)
        path = smooth_path(problem, solution)
        found = parts(path, solution.segments)
        assert [segment for segment, _ in found] == list(solution.segments)
        assert found[0][1].start == 0
        assert found[-1][1].stop == len(path.normal_impulse)
        scale = np.abs(path.velocity).max()
        for (_, one), (_, other) in pairwise(found):
            assert other.start == one.stop - 1
        for segment, part in found:
            v = path.velocity[part]
            assert len(v) > 1 or segment.end - segment.start < 1e-12 * solution.impulse[2]
            sign = -1.0 if segment.phase == "compression" else 1.0
            assert (sign * v[:, 2] > -1e-9 * scale).all()
            assert segment.mode == "slip" or not v[:, :2].any()
            without_exact_start += not (path.normal_impulse == segment.start).any()
    assert without_exact_start > 10  # so a search for equal impulses is insufficient


def test_regimes_of_slip_in_hodograph(monkeypatch: pytest.MonkeyPatch) -> None:
    # stream lines, which take matplotlib a second, are not tested here
    monkeypatch.setattr("pinimpact.visual.plots.one_impact._draw_flow", lambda *_: None)
    for problem in random_problems(40):
        w, mu = np.asarray(problem.delassus), problem.friction
        angles = invariant_directions(problem)

        def turning(phi, w=w, mu=mu):
            s = np.array([np.cos(phi), np.sin(phi)])
            drive = w[:2, 2, None] - mu * w[:2, :2] @ s
            return -s[1] * drive[0] + s[0] * drive[1]

        fine = np.linspace(-np.pi, np.pi, 20001)
        crossed = np.flatnonzero(np.diff(np.sign(turning(fine))))
        np.testing.assert_allclose(np.sort(angles), fine[crossed] + 0.5 * (fine[1] - fine[0]), atol=4e-4)
        ax = plots.hodograph(problem)
        for kind, sign in (("attracting", -1.0), ("repelling", 1.0)):
            for line in lines(ax, f"invariant direction, {kind}"):
                phi = np.arctan2(*line[-1][::-1])
                assert sign * (turning(np.array([phi + 1e-5]))[0] - turning(np.array([phi - 1e-5]))[0]) > 0.0
        driven = w[2, 2] - mu * (w[0, 2] * np.cos(fine) + w[1, 2] * np.sin(fine)) < 0.0
        sectors = [patch for patch in ax.patches if patch.get_label() == "jam"]
        assert len(sectors) == driven.any()
        for sector in sectors:
            assert sector.theta2 - sector.theta1 == pytest.approx(360.0 * driven.mean(), abs=0.1)
        pyplot.close("all")


@pytest.mark.parametrize(
    "problem",
    [
        pinimpact.ImpactProblem(np.eye(3), (0.1, 0, 1), 0.5, 0.5),  # no impact
        pinimpact.ImpactProblem(np.eye(3), (0, 0, -1), 0.0, 0.0),
        pinimpact.ImpactProblem(np.eye(3), (0, 0, -1), 0.5, 0.5),
        pinimpact.ImpactProblem(np.diag([1.0, 0.0, 1.0]), (0.1, 0, -1), 0.5, 0.5),
        pinimpact.ImpactProblem([[1.2, 0, 0.9], [0, 1, 0], [0.9, 0, 0.7]], (2, 0.3, -1), 2.0, 0.6),
        pinimpact.ImpactProblem(1e-9 * np.eye(3), (1e-12, 0, -1e-9), 0.5, 0.5),
    ],
)
def test_plots_of_special_impacts(problem) -> None:
    for plot in (plots.hodograph, plots.velocities, plots.impulses, plots.impulse_space, plots.energy_ledger):
        ax = plot(problem)
        ax.figure.draw_without_rendering()
        assert ax.has_data()
    assert plots.regime_map(problem, "restitution", resolution=8).has_data()


def test_plots_of_decoupled_contacts_equal_those_of_single_ones() -> None:
    ones = [
        pinimpact.ImpactProblem(problem.delassus, problem.velocity, 0.3, 0.5, "energetic")
        for problem in random_problems(2)
    ]
    W = np.zeros((6, 6))
    for k, one in enumerate(ones):
        W[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = one.delassus
    many = pinimpact.ImpactProblem(W, [one.velocity for one in ones], 0.3, 0.5, "energetic")
    for k, one in enumerate(ones):
        solution = pinimpact.solve_impact(one)
        path = smooth_path(one, solution)
        ax = plots.velocities(many, contact=k)
        for row, name in enumerate(("v₁", "v₂", "v₃ (normal)")):
            (line,) = lines(ax, name)
            expected = np.interp(line[:, 0], path.normal_impulse, path.velocity[:, row])
            np.testing.assert_allclose(line[:, 1], expected, atol=2e-3)
            np.testing.assert_allclose(line[-1], [solution.impulse[2], solution.velocity[row]], rtol=1e-6)
        ax = plots.hodograph(many, contact=k)
        np.testing.assert_allclose(lines(ax, "separation")[0][0], solution.velocity[:2], atol=1e-7)
        assert not [line for line in ax.lines if "invariant" in str(line.get_label())]
        (whole,) = lines(plots.impulses(many, contact=k), "|Pₜ|")
        assert whole[-1] == pytest.approx([solution.impulse[2], np.hypot(*solution.impulse[:2])])
        *_, bar = plots.energy_ledger(many, contact=k).patches
        assert bar.get_width() == pytest.approx(solution.work.total)
    *_, bar = plots.energy_ledger(many).patches
    assert bar.get_width() == pytest.approx(sum(pinimpact.solve_impact(one).work.total for one in ones))
    figure = plots.impact_figure(many, pinimpact.solve_impact(many))
    assert [ax.get_title() for ax in figure.axes if "Contact " in ax.get_title()][::2] == [
        "Contact 0",
        "Contact 1",
    ]


def test_invalid_plots_of_several_contacts_raise() -> None:
    many = pinimpact.ImpactProblem(np.eye(6), [[0.1, 0, -1.0], [0, 0.2, -1.0]], 0.3, 0.5, "energetic")
    solution = pinimpact.solve_impact(many, simultaneous="any", seed=3)
    hit = plots.one_impact.Solved(many, solution)
    for call, said in (
        (lambda: plots.hodograph(many), "has 2 contacts, an index from 0 to 1"),
        (lambda: plots.velocities(many, contact=2), "contact: 2 given"),
        (lambda: plots.hodograph(ROD, contact=1), "is at one contact"),
        (lambda: plots.hodograph(hit, contact=0), "'any' has no path"),
        (lambda: plots.impulse_space(many), "impulse_space needs a single contact"),
        (lambda: plots.regime_map(hit), "regime_map needs a single contact"),
    ):
        with pytest.raises(pinimpact.InputError, match=said):
            call()


def test_resumed_slip_is_marked() -> None:
    ax = plots.hodograph(ROD)
    assert len(lines(ax, "slip resumes")) == 1
    assert not lines(ax, "stick")


def test_velocities_and_impulses_over_the_normal_impulse() -> None:
    solution = pinimpact.solve_impact(ROD)
    ax = plots.velocities(ROD)
    for row, name in enumerate(("v₁", "v₂", "v₃ (normal)")):
        (line,) = lines(ax, name)
        np.testing.assert_allclose(line[0], (0.0, ROD.velocity[row]), atol=1e-12)
        np.testing.assert_allclose(line[-1], (solution.impulse[2], solution.velocity[row]), atol=1e-9)
    ax = plots.impulses(ROD)
    (p1,), (p2,) = lines(ax, "P₁"), lines(ax, "P₂")
    np.testing.assert_allclose((p1[-1, 1], p2[-1, 1]), solution.impulse[:2], atol=1e-12)
    (whole,) = lines(ax, "|Pₜ|")
    assert (whole[:, 1] <= ROD.friction * whole[:, 0] + 1e-12).all()


def test_sum_of_energy_ledger() -> None:
    ax = plots.energy_ledger(ROD)
    *bars, whole = (patch for patch in ax.patches)
    solution = pinimpact.solve_impact(ROD)
    change = 0.5 * solution.impulse @ (np.asarray(ROD.velocity) + solution.velocity)  # (1.5)
    assert whole.get_width() == pytest.approx(change)
    assert sum(bar.get_width() for bar in bars) == pytest.approx(change)
    ends = [bar.get_x() + bar.get_width() for bar in bars]
    np.testing.assert_allclose([bar.get_x() for bar in bars], [0.0, *ends[:-1]], atol=1e-12)


def test_rouths_lines_intersect_the_path_at_events() -> None:
    ax = plots.impulse_space(PLANAR)
    solution = pinimpact.solve_impact(PLANAR, record=True)

    def distance(label: str, p: np.ndarray) -> float:
        (line,) = lines(ax, label)
        direction = (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
        return float(np.cross(np.append(direction, 0.0), np.append(p[[0, 2]] - line[0], 0.0))[2])

    stick = next(s for s in solution.segments if s.mode == "stick")
    turn = next(s for s in solution.segments if s.phase == "restitution")
    for p3, p, v in zip(
        solution.path.normal_impulse, solution.path.impulse, solution.path.velocity, strict=True
    ):
        assert (abs(distance("line of sticking", p)) < 1e-9) == (p3 >= stick.start * (1.0 - 1e-12))
        assert (abs(distance("line of maximum compression", p)) < 1e-9) == (abs(v[2]) < 1e-9)
    assert turn.start > stick.start
    solid = plots.impulse_space(ROD)
    assert solid.name == "3d"
    with pytest.raises(pinimpact.InputError, match="3d"):
        plots.impulse_space(ROD, ax=Figure().add_subplot())
    assert plots.impulse_space(PLANAR, ax=Figure().add_subplot(projection="3d")).name == "3d"


@pytest.mark.parametrize("against", ["slip angle", "restitution"])
def test_regime_map_agrees_with_single_impacts(against) -> None:
    ax = plots.regime_map(ROD, against, friction=1.2, resolution=24)
    (mesh,) = [c for c in ax.collections if c.get_array() is not None and c.get_array().size == 24**2]
    codes = np.asarray(mesh.get_array()).reshape(24, 24)
    assert len(np.unique(codes)) >= 3
    rng = np.random.default_rng(3)
    speed = np.hypot(*ROD.velocity[:2])
    for i, j in rng.integers(0, 24, (60, 2)):
        mu, share = 1.2 * (j + 0.5) / 24, (i + 0.5) / 24
        velocity, e = np.array(ROD.velocity), ROD.restitution
        if against == "restitution":
            e = share
        else:
            phi = np.pi * (2.0 * share - 1.0)
            velocity[:2] = speed * np.cos(phi), speed * np.sin(phi)
        solution = pinimpact.solve_impact(pinimpact.ImpactProblem(ROD.delassus, velocity, mu, e), record=True)
        at_zero = np.flatnonzero(~solution.path.velocity[:, :2].any(axis=1))
        regime = "slips to the end"
        if len(at_zero):
            rests = len(at_zero) > 1 and not solution.velocity[:2].any()
            regime = "comes to stick" if rests else "slip stops and resumes"
        assert REGIMES[int(codes[i, j])][0] == regime
    (star,) = lines(ax, "this impact")
    here = ROD.restitution if against == "restitution" else 60.0
    np.testing.assert_allclose(star, [[ROD.friction, here]])


def test_invalid_regime_map_raises() -> None:
    still = pinimpact.ImpactProblem(np.eye(3), (0, 0, -1), 0.3, 0.5)
    with pytest.raises(pinimpact.InputError, match="without slip"):
        plots.regime_map(still)
    with pytest.raises(pinimpact.InputError, match="against: 'mass'"):
        plots.regime_map(ROD, "mass")
    with pytest.raises(pinimpact.InputError, match="impact: 3 given"):
        plots.hodograph(3)


@pytest.fixture(scope="module")
def fall():
    robot = pinimpact.load_robot("rod")
    tip = pinimpact.Contact("tip", pinimpact.Plane(), friction=0.4, restitution=0.4, name="tip")
    scene = pinimpact.Scene(robot, [tip], without=["joint limits"])
    return robot, pinimpact.simulate(scene, [0, 0, 0.65, 0, 0.5], [0.6, 0.1, 0, 0.5, 0], 0.6)


def test_energy_is_drawn_between_steps(fall) -> None:
    robot, trajectory = fall
    ax = plots.energy(trajectory)
    (total,) = lines(ax, "kinetic + potential")
    assert len(total) > 2 * len(trajectory.t)
    assert total[0, 1] == 0.0
    data = robot.model.createData()

    def mechanical(t: float, side: str) -> float:
        q, v = trajectory.at(t, side)
        return pin.computeKineticEnergy(robot.model, data, q, v) + pin.computePotentialEnergy(
            robot.model, data, q
        )

    start = mechanical(0.0, "right")
    impacts = {impact.time for impact in trajectory.impacts}
    for k in range(0, len(total), 7):
        t, value = total[k]
        if t not in impacts:
            assert value == pytest.approx(mechanical(t, "right") - start, abs=1e-5)
    first = trajectory.impacts[0]
    at = total[total[:, 0] == first.time, 1]
    assert at[-1] - at[0] == pytest.approx(first.solution.work.total, abs=1e-9)
    assert np.ptp(ax.get_ylim()) < 3.0 * np.ptp(total[:, 1])  # the change fills the axes


def test_energy_of_time_steps(fall) -> None:
    # an unbalanced box spins and strikes a wall; steps have an error of the work
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "slides")
    inertia = pin.Inertia(1.0, np.array([0.05, 0.0, 0.0]), 0.01 * np.eye(3))
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    model.addJointFrame(joint)
    wall = pinimpact.Plane(point=(0.2, 0.0, 0.0), normal=(-1.0, 0.0, 0.0))
    corners = [
        pinimpact.Contact("slides", wall, friction=0.3, offset=(x, y, 0.0))
        for x in (-0.1, 0.1)
        for y in (-0.1, 0.1)
    ]
    scene = pinimpact.Scene(model, corners, without=["joint limits"])
    motion = pinimpact.simulate(
        *(scene, [0.0, 0.0, 1.0, 0.0], [2.0, 0.5, 30.0], 0.3), scheme="time-stepping", dt=5e-3
    )
    assert np.abs(motion.energy.residual).max() > 1e-3
    (total,) = lines(plots.energy(motion), "kinetic + potential")
    for t, value in zip(motion.t, motion.energy.total - motion.energy.total[0], strict=True):
        assert np.abs(total[total[:, 0] == t, 1] - value).min() < 1e-12


def test_gaps_modes_and_forces_over_time(fall) -> None:
    robot, trajectory = fall
    (gap,) = lines(plots.gaps(trajectory, robot), "tip")
    data, tip = robot.model.createData(), robot.model.getFrameId("tip")
    for t, height in gap[::50]:
        pin.framesForwardKinematics(robot.model, data, trajectory.at(t)[0])
        assert height == pytest.approx(data.oMf[tip].translation[2], abs=1e-12)
    ax = plots.modes(trajectory)
    drawn = sorted(
        (bar.get_x(), bar.get_x() + bar.get_width(), row.get_label()) for row in ax.containers for bar in row
    )
    modes = [(mode.start, mode.end, mode.mode) for mode in trajectory.modes]
    assert [row[2] for row in drawn] == [row[2] for row in modes]
    np.testing.assert_allclose([row[:2] for row in drawn], [row[:2] for row in modes], atol=1e-12)
    assert len(lines(ax, "impact")) == len(trajectory.impacts)
    ax = plots.forces(trajectory, "tip")
    (normal,), (friction,) = lines(ax, "normal"), lines(ax, "friction")
    (slip,) = [mode for mode in trajectory.modes if mode.mode == "slip"]
    sliding = (normal[:, 0] > slip.start) & (normal[:, 0] < slip.end)
    assert (normal[sliding, 1] > 0.0).all()
    np.testing.assert_allclose(friction[sliding, 1], 0.4 * normal[sliding, 1], rtol=1e-9)  # Coulomb
    assert not normal[normal[:, 0] < slip.start, 1].any()


def test_overview_has_four_rows(fall) -> None:
    robot, trajectory = fall
    rows = plots.overview(trajectory, robot)
    assert [row.get_ylabel() for row in rows] == ["gap [m]", "", "normal force [N]", "change of energy [J]"]
    own = Figure().subplots(4, 1)
    assert plots.overview(trajectory, robot.model, ax=own) is own
    with pytest.raises(pinimpact.InputError, match="2 axes given"):
        plots.overview(trajectory, robot, ax=own[:2])


def drawn_plots(fall):
    robot, trajectory = fall
    solution = pinimpact.solve_impact(ROD)
    yield from (
        plot(ROD) for plot in (plots.hodograph, plots.velocities, plots.impulses, plots.impulse_space)
    )
    yield plots.impulse_space(PLANAR)
    yield plots.regime_map(PLANAR, "restitution", resolution=20)
    yield plots.energy(trajectory)
    yield plots.forces(trajectory, "tip")
    yield from plots.overview(trajectory, robot)
    yield from plots.impact_figure(ROD, solution, "title").axes
    yield from plots.energy_figure(trajectory, "title").axes


def test_legends_have_no_duplicates_and_cover_no_lines(fall) -> None:
    count = 0
    for ax in drawn_plots(fall):
        legend = ax.get_legend()
        if legend is None:
            continue
        count += 1
        labels = [text.get_text() for text in legend.get_texts()]
        assert len(labels) == len(set(labels)) > 0
        ax.figure.draw_without_rendering()
        box, around = legend.get_window_extent(), ax.figure.bbox
        assert around.x0 <= box.x0
        assert box.x1 <= around.x1
        assert around.y0 <= box.y0
        assert box.y1 <= around.y1
        plot = ax.patch.get_window_extent()
        if ax.name != "3d":  # 3d axes fill the figure, with the legend in a corner
            assert not (box.x0 < plot.x1 and plot.x0 < box.x1 and box.y0 < plot.y1 and plot.y0 < box.y1)
    assert count > 10


@pytest.mark.parametrize("name", ["_foot", r"$\q$", "a$b$c", "x$", r"a\$b", "impact", "slip", "normal"])
def test_names_are_drawn_as_they_are(fall, name: str, tmp_path: Path) -> None:
    """Text of users is neither a formula nor hidden; matplotlib's own function tells formulas."""
    robot, trajectory = fall
    (tip,) = trajectory.contacts
    scene = pinimpact.Scene(robot, [replace(tip, name=name)], without=["joint limits"])
    named = pinimpact.simulate(scene, trajectory.q[0], trajectory.v[0], 0.1 + trajectory.impacts[0].time)
    rows = plots.overview(named, robot)
    figures = [
        rows[0].figure,
        plots.forces(named, name).figure,
        plots.energy_figure(named, name),
        plots.forces_figure(named, [name], name),
        plots.impact_figure(ROD, pinimpact.solve_impact(ROD), name),
        plots.distributions({name: np.array([name, "other"], dtype=object)}),
    ]
    for k, figure in enumerate(figures):
        plots.save_figure(figure, tmp_path / f"{k}.png")
        shown = [text for text in figure.findobj(Text) if text.get_text()]
        drawn = [text._preprocess_math(text.get_text()) for text in shown]
        assert any(text.split("\n")[0].strip() == name for text, _ in drawn)
        assert not any(formula for _, formula in drawn)
    for ax in (rows[0], rows[2]):  # the line of the contact, and those of impacts
        entries = {line.get_color(): line.get_label().strip() for line in ax.get_legend().get_lines()}
        assert len(entries) == 2
        assert plots.style.FLOW in entries


def test_plots_draw_into_given_axes(fall) -> None:
    robot, trajectory = fall
    calls = {
        plots.hodograph: (ROD,),
        plots.velocities: (ROD,),
        plots.impulses: (ROD,),
        plots.impulse_space: (PLANAR,),
        plots.regime_map: (ROD,),
        plots.energy_ledger: (ROD,),
        plots.gaps: (trajectory, robot),
        plots.modes: (trajectory,),
        plots.forces: (trajectory, "tip"),
        plots.energy: (trajectory,),
    }
    for plot, arguments in calls.items():
        ax = Figure().add_subplot()
        assert plot(*arguments, ax=ax) is ax
        assert ax.has_data()
    assert not pyplot.get_fignums()


def test_plots_of_hits_and_records_equal_those_of_problems(fall) -> None:
    robot, trajectory = fall
    record = trajectory.impacts[0]
    hit = pinimpact.impact(robot.model, robot.data, record.q, record.v_before, trajectory.contacts[0])
    (one,), (other,) = (lines(plots.velocities(what), "v₁") for what in (record, hit))
    np.testing.assert_allclose(one, other, atol=1e-12)


def test_phases_have_different_colours() -> None:
    ax = plots.hodograph(ROD)
    colors = {line.get_label(): to_hex(line.get_color()) for line in ax.lines}
    assert colors["slip in compression"] == "#d55e00"
    assert colors["slip in restitution"] == "#0072b2"


def test_figures_are_written(fall, tmp_path: Path) -> None:
    _, trajectory = fall
    for figure in (
        plots.impact_figure(ROD, pinimpact.solve_impact(ROD), "title"),
        plots.energy_figure(trajectory, "title"),
        plots.forces_figure(trajectory, "tip", "title"),
    ):
        pixels = imread(plots.save_figure(figure, tmp_path / "figure.png"))
        assert min(pixels.shape[:2]) > 250
        assert pixels.std() > 0.05
    with pytest.raises(pinimpact.InputError, match="contacts: none given"):
        plots.forces_figure(trajectory, [], "title")


def test_import_does_not_load_matplotlib() -> None:
    code = (
        "import sys, pinimpact.visual\n"
        "from pinimpact.visual import plots\n"
        "assert callable(plots.hodograph) and pinimpact.visual.plots is plots\n"
        "assert not {'matplotlib', 'meshcat'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_gallery_draws_the_plots_of_the_page() -> None:
    root = Path(__file__).parents[1]
    spec = importlib.util.spec_from_file_location("plot_gallery", root / "examples" / "plot_gallery.py")
    gallery = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(gallery)
    drawn = {f"plot_{name}.png" for name, _ in gallery.gallery()}
    text = (root / "docs" / "seeing.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"\(figures/(.*?)\)", text))
    assert shown == drawn | {"replay.png", "replay_hit.png"}
    assert all((root / "docs" / "figures" / name).is_file() for name in shown)
    for name in plots.__all__:
        assert name in text or name.endswith("_figure")


@pytest.mark.parametrize("start", [1.0, 0.0, -1e300])
def test_histogram_of_numbers_that_differ_by_rounding(start: float) -> None:
    values = start + np.spacing(start) * np.array([0, 1, 1, 2, 5, 5, 5])
    (axes,) = plots.distributions({"x": values}).axes
    assert sum(bar.get_height() for bar in axes.patches) == len(values)
    assert len(axes.patches) > 1
