"""Examples and notebooks: they run, with the expected output."""

from __future__ import annotations

import ast
import functools
import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.figure import Figure
from PIL import Image
from scipy import stats

import pinimpact
from pinimpact import load_robot

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
NOTEBOOKS = sorted((EXAMPLES / "notebooks").glob("*.ipynb"))


@functools.cache
def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_example_is_short_and_has_main(script: Path) -> None:
    text = script.read_text(encoding="utf-8")
    tree = ast.parse(text)
    assert len(text.splitlines()) < 100
    assert ast.get_docstring(tree)
    assert "main" in [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    assert tree.body[-1].test.left.id == "__name__"


def printed_by(name: str, tmp_path: Path, monkeypatch, capsys, again: str = "") -> str:
    """Run an example in an empty folder and return its output.

    Its function `again`, which a test calls too, then returns what it has returned to the example.
    """
    monkeypatch.chdir(tmp_path)
    module = example(name)
    if again:
        monkeypatch.setattr(module, again, functools.cache(getattr(module, again)))
    module.main()
    return capsys.readouterr().out


def test_arm_sticks_to_inclined_wall_over_a_range_of_tilts(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("inclined_wall", tmp_path, monkeypatch, capsys)
    assert "slips, then sticks" in out
    assert "sticks, then slips" in out
    assert (tmp_path / "inclined_wall.png").is_file()


def test_inclined_wall_with_given_robot(tmp_path, monkeypatch) -> None:
    wall = example("inclined_wall")
    robot = load_robot(EXAMPLES.parent / "models" / "two_link_arm.urdf")
    frame = robot.model.frames[robot.model.nframes - 1].name
    hit = wall.strike(robot, frame, 0.0)
    assert hit.axes[2] == pytest.approx([-1.0, 0.0, 0.0])
    monkeypatch.chdir(tmp_path)
    wall.main(EXAMPLES.parent / "models" / "two_link_arm.urdf", frame)


@pytest.mark.slow
def test_arm_falls_on_elbow_and_hand(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("arm_falls_on_elbow_and_hand", tmp_path, monkeypatch, capsys)
    found = [line.split(" s  ")[1] for line in out.splitlines() if " s  " in line]
    assert "upper_arm_link_0 on floor" in found
    assert any(line.startswith("wrist") and line.endswith("on block") for line in found)
    for name in ("png", "html"):
        assert (tmp_path / f"arm_falls_on_elbow_and_hand.{name}").is_file()


@pytest.mark.slow
def test_forces_of_landed_quadruped_equal_its_weight(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("quadruped_landing", tmp_path, monkeypatch, capsys)
    weight = 9.81 * pin.computeTotalMass(load_robot("solo12").model)
    assert out.count("N in the end") == 4
    assert float(out.split("sum ")[1].split(" N")[0]) == pytest.approx(weight, rel=1e-3)
    assert (tmp_path / "quadruped_landing.png").is_file()


@pytest.mark.slow
def test_feet_of_landing_movie_slip_then_stick() -> None:
    """Forces are in the friction cone, feet above the floor; docs/figures has replay and animation."""
    movie = example("landing_movie")
    robot, trajectory = movie.landing()
    times = np.linspace(0.0, trajectory.duration, 400)
    for contact in trajectory.contacts:
        modes = [mode.mode for mode in trajectory.modes if mode.source == contact.label]
        assert "slip" in modes
        assert modes[-1] == "stick"
        force = trajectory.forces(contact.label, times)
        friction = np.hypot(force[:, 0], force[:, 1])
        assert np.all(friction <= contact.friction * force[:, 2] * (1.0 + 1e-6) + 1e-9)
        data = robot.model.createData()
        for time in times:
            pin.framesForwardKinematics(robot.model, data, trajectory.at(time)[0])
            assert data.oMf[robot.model.getFrameId(contact.frame)].translation[2] > -1e-5
    figures = EXAMPLES.parent / "docs" / "figures"
    with Image.open(figures / "landing.gif") as film:
        assert film.n_frames > 40
    assert (figures / "landing.gif").stat().st_size < 2e6
    assert (figures / "landing.html").stat().st_size < 4e6


def test_control_loop_touches_down_and_stays_on_the_table(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("control_loop", tmp_path, monkeypatch, capsys)
    assert "impulse" in out
    assert abs(float(out.split("gap ")[1].split(" mm")[0])) < 0.5


@pytest.mark.slow
def test_environment_in_the_style_of_gymnasium(tmp_path, monkeypatch, capsys) -> None:
    gym = example("gym_style_loop")
    environment = gym.Hop()
    first, _ = environment.reset(seed=3)
    observation, reward, terminated, truncated, info = environment.step(np.zeros(12))
    assert observation.shape == first.shape == (37,)
    assert 0.1 < reward < 0.5
    assert not terminated
    assert not truncated
    assert info["impacts"] > 0  # it starts 1 mm above the floor
    again, _ = environment.reset(seed=3)
    np.testing.assert_array_equal(first, again)
    gym.main()
    assert "return" in capsys.readouterr().out


def test_impulses_on_two_robots_are_opposite(tmp_path, monkeypatch, capsys) -> None:
    both = example("two_robots")
    model, split = both.both()
    assert model.nv == split + 9
    out = printed_by("two_robots", tmp_path, monkeypatch, capsys)
    free, locked = out.splitlines()
    assert "Panda 0.000 N m s" in locked
    assert "Panda 0.000 N m s" not in free


def test_stability_of_bouncing_motion_agrees_with_closed_form(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("bouncing_stability", tmp_path, monkeypatch, capsys)
    first, stable, _ = out.splitlines()
    assert float(first.split(": ")[1]) < 1e-9
    module = example("bouncing_stability")
    grid = np.linspace(0.0, 300.0, 61)
    expected = [k for k in grid if abs(module.closed_form(k)) < 2.0]
    assert stable == f"stable at {len(expected)} of 61 stiffnesses, from {expected[0]:.0f} N/m on"
    assert (tmp_path / "bouncing_stability.png").is_file()


def test_bounce_passes_agree_with_closed_form(tmp_path, monkeypatch, capsys) -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed")
    out = printed_by("bounce_pass", tmp_path, monkeypatch, capsys)
    first, second, _ = out.splitlines()
    assert float(first.split(": ")[1].split()[0]) < 1e-12
    assert float(second.split(" by ")[1].split()[0]) < 1e-8
    assert (tmp_path / "bounce_pass.png").is_file()


def test_joint_velocities_of_fast_strike_are_within_limits(tmp_path, monkeypatch, capsys) -> None:
    pytest.importorskip("daqp", reason="the solver daqp is not installed")
    pytest.importorskip("qpsolvers", reason="qpsolvers is not installed")
    out = printed_by("fast_strike", tmp_path, monkeypatch, capsys, "strike")
    fast, within, _ = (
        float(line.split("most ")[1].split()[0]) if "most" in line else 0 for line in out.splitlines()
    )
    assert fast > 1.2
    assert 0.98 < within < 1.0  # near the limits
    assert (tmp_path / "fast_strike.png").is_file()
    module = example("fast_strike")
    _, q, v = module.strike(True)
    ends = np.abs(module.after(q, v, (module.LEAST, module.MOST))).max(axis=1)
    assert (ends > 0.98).all()  # both ends limit the speed


@pytest.mark.slow
def test_quadruped_jumps_to_target(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("jump_to_place", tmp_path, monkeypatch, capsys, "aim")
    assert "impacts of 4 feet" in out
    assert float(out.split("replay is ")[1].split(" m")[0]) < 1e-6
    assert (tmp_path / "jump_to_place.png").is_file()
    module = example("jump_to_place")
    push, errors = module.aim()
    assert errors[-1][-1] < 1e-9
    end, place = module.ASKED[-1]
    found, slope = module.jump(push, end)
    assert found == pytest.approx([*place, 0.0, 0.0], abs=1e-9)

    def replayed(push):
        q, _ = module.replay(push, end).at(end)
        return np.r_[q[:3], pin.Quaternion(q[3:7]).matrix()[:2, 2]]

    for k, step in enumerate(1e-5 * np.eye(5)):
        differences = (replayed(push + step) - replayed(push - step)) / 2e-5
        assert slope[:, k] == pytest.approx(differences, abs=2e-6)


def test_only_newtons_law_creates_energy(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("comparing_laws", tmp_path, monkeypatch, capsys)
    kept = {line.split(": ")[1].split()[0]: float(line.split("keeps ")[1].split(" %")[0])
            for line in out.splitlines() if line.startswith("Kane")}  # fmt: skip
    assert kept["newton"] > 100.0 > kept["energetic"]
    assert kept["poisson"] < 100.0
    assert (tmp_path / "comparing_laws.png").is_file()


def test_output_of_kanes_puzzle(tmp_path, monkeypatch, capsys) -> None:
    lines = printed_by("kane_puzzle", tmp_path, monkeypatch, capsys).splitlines()
    assert [line.split()[0] for line in lines if "energy created" in line] == ["newton"]


@pytest.mark.slow
@pytest.mark.exhaustive
def test_tossed_box_is_identified(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("identify_box", tmp_path, monkeypatch, capsys)
    rows = [line.replace(",", "").split() for line in out.splitlines() if ", true " in line]
    found = {row[0]: (float(row[1]), float(row[5]), float(row[7]), float(row[9])) for row in rows}
    assert len(found) == 12
    for name, (value, low, high, true) in found.items():
        assert abs(value - true) < high - low, name  # four standard errors
    for name in ("friction", "restitution", "sliding_friction"):
        value, low, high, true = found[name]
        assert high - low < 0.1 * true
    assert float(out.split("95 % from ")[-1].split(" to ")[1].split(" mm")[0]) < 0.0
    assert (tmp_path / "identify_box.png").is_file()


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_without_output(notebook: Path) -> None:
    for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(notebook: Path, tmp_path: Path) -> None:
    pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    run = "import sys, nbformat, nbclient\nbook = nbformat.read(sys.argv[1], 4)\n"
    run += "nbclient.NotebookClient(book, timeout=300).execute()\nnbformat.write(book, sys.argv[2])"
    done = tmp_path / "done.ipynb"
    command = [sys.executable, "-c", run, str(notebook), str(done)]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    cells = json.loads(done.read_text(encoding="utf-8"))["cells"]
    shown = [output for cell in cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in shown)
    assert not any(output["output_type"] == "error" for output in shown)


@pytest.fixture(scope="module")
def figures():
    return example("paper_figures")


def curves(figures, number: int):
    axes = Figure().add_subplot()
    figures.FIGURES[number](axes)
    return {line.get_label(): line.get_xydata() for line in axes.lines}


def test_all_figures_are_written(figures, tmp_path: Path, capsys) -> None:
    figures.main(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"figure_{n}.png" for n in (3, 4, 6, 7, 9)]
    assert len(capsys.readouterr().out.splitlines()) == 5


def test_figure_3_agrees_with_closed_form(figures) -> None:
    start = 5 / np.sqrt(2)
    for label, curve in curves(figures, 3).items():
        if label.startswith("μ"):
            np.testing.assert_allclose(curve[:, 1], start * (curve[:, 0] / start) ** 1.75, rtol=1e-9)


def test_figure_7_slip_resumes_across_the_rod(figures) -> None:
    for label, curve in curves(figures, 7).items():
        if label.startswith("v"):
            np.testing.assert_allclose(curve[-1], [0.0, -0.084710897502], atol=1e-9)


def test_pushed_quadruped_slips_and_recovers(tmp_path: Path, monkeypatch, capsys) -> None:
    push = example("push_recovery")
    monkeypatch.setattr(push, "simulate_push", functools.cache(push.simulate_push))
    monkeypatch.setattr(push, "DURATION", 1.2)  # the feet stick and their forces are steady
    push.main(tmp_path)
    assert (tmp_path / "push_recovery.png").is_file()
    assert "slips from 0.4" in capsys.readouterr().out
    trajectory = push.simulate_push()
    end = trajectory.t[-1]
    assert all(trajectory.mode_at(foot, end) == "stick" for foot in push.FEET)
    weight = 9.81 * pin.computeTotalMass(load_robot("solo12").model)
    assert sum(trajectory.forces(foot, end)[2] for foot in push.FEET) == pytest.approx(weight, rel=1e-3)


def test_billiard_break_is_symmetric_and_loses_energy(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("billiard_break", tmp_path, monkeypatch, capsys)
    assert (tmp_path / "billiard_break.png").is_file()
    assert out.count("31 contacts") == 2
    table = example("billiard_break")
    places = table.rack()
    velocity, solution = table.strike(places, 0.0)
    image = [int(np.argmin(np.linalg.norm(places - place * [1, -1], axis=1))) for place in places]
    assert velocity[image] * [1, -1] == pytest.approx(velocity, abs=1e-11)
    assert velocity.sum(axis=0) == pytest.approx([1.0, 0.0], abs=1e-12)  # momentum
    assert -0.5 < solution.work.total.sum() < 0.0


def test_flat_and_tilted_landing(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("flat_landing", tmp_path, monkeypatch, capsys)
    assert "propagate, flat, first 5 ms: impulses 4, instants 1" in out
    assert (tmp_path / "flat_landing.png").is_file()
    _, flat = example("flat_landing").land(0.0)
    assert np.abs(flat[[1, 3, 5]]).max() < 1e-3  # masses of both sides of the robot differ by 1e-6


def test_feet_of_kicked_quadruped_push_and_held_ones_pull(tmp_path, monkeypatch, capsys) -> None:
    out = printed_by("kicked_quadruped", tmp_path, monkeypatch, capsys, "kick")
    assert (tmp_path / "kicked_quadruped.png").is_file()
    assert out.count("which pulls") == 2
    q, free, held = example("kicked_quadruped").kick()
    push, glued = free.impulses_world[1:], np.array(held.held_impulses)
    assert (push[:, 2] >= 0.0).all()
    assert (np.hypot(push[:, 0], push[:, 1]) <= 0.6 * push[:, 2] * (1 + 1e-9)).all()
    assert glued[:, 2].min() < 0.0
    model = load_robot("solo12").model
    data = model.createData()
    for v, trunk, feet in ((free.v, free.impulses_world[0], push), (held.v, held.impulse_world, glued)):
        momentum = pin.computeCentroidalMomentum(model, data, q, v).linear
        assert momentum == pytest.approx(trunk + feet.sum(axis=0), abs=1e-9)


def test_uncertainty_of_velocity_after_impact(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    sure = example("how_sure")
    sure.main(64)
    out = capsys.readouterr().out
    assert "over friction, restitution): 100% SEPARATED" in out
    assert "v.panda_joint4: median" in out
    assert (tmp_path / "how_sure.png").is_file()
    scene, found = sure.strike(20, "random")
    for i in (0, 19):  # each sample is an impact with its own coefficients
        contact = replace(scene.contacts[0], **{n: float(found.columns[n][i]) for n in sure.OVER})
        data = scene.model.createData()
        hit = pinimpact.impact(scene.model, data, load_robot("panda").q0, np.array(sure.VELOCITY), contact)
        after = [found.columns[f"v.panda_joint{k}"][i] for k in range(1, 8)]
        np.testing.assert_allclose(after, hit.v[:7], rtol=1e-9)


@pytest.mark.slow
def test_frequencies_of_fair_and_loaded_die(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    dice = example("die")
    dice.main(2)
    assert capsys.readouterr().out.count("100% of the tosses ended") == 2
    assert (tmp_path / "die.png").is_file()
    fair = dice.toss(dice.die(), 30, seed=1)  # five times a face, as a χ² test needs
    counts = np.array([(fair.columns["top"] == face).sum() for face in dice.FACES])
    assert counts.sum() == 30
    assert stats.chisquare(counts).pvalue > 1e-3
    assert all(share.low < 1 / 6 < share.high for share in fair.frequencies("top", 0.9999).values())
    np.testing.assert_allclose(fair.columns["height"], dice.HALF, rtol=1e-6)
    loaded = dice.toss(dice.die((0.0, 0.0, -0.5 * dice.HALF)), 20, seed=1)
    assert loaded.frequencies("top")["+z"].low > 1 / 6
