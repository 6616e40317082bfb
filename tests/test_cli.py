"""The command line, as a user calls it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner

from pinimpact.app.cli import main
from pinimpact.app.demo import FIXED_BASE, FREE_BASE, SWINGS, run_demo

SCENES = Path(__file__).parents[1] / "examples" / "scenes"


def call(*args: str):
    return CliRunner().invoke(main, args)


def test_help_names_the_verbs() -> None:
    result = call("--help")
    assert result.exit_code == 0
    for verb in ("demo", "plan", "run", "cost"):
        assert f"  {verb} " in result.output


@pytest.mark.parametrize("robot", ["panda", "solo12"])
def test_demo(robot: str, tmp_path: Path) -> None:
    result = call("demo", "--robot", robot, "-o", str(tmp_path / "out"))
    assert result.exit_code == 0, result.output
    for text in (
        "Contact velocity",
        "Joint velocities",
        "Segments",
        "Impulse",
        "sum of the works",
        "Effects computed",
    ):
        assert text in result.output
    for name in ("replay.html", "hodograph.png"):
        assert name in result.output.replace("\n", "")
        assert (tmp_path / "out" / name).stat().st_size > 10_000


@pytest.mark.parametrize("robot", sorted(SWINGS))
def test_every_robot_strikes_as_planned(robot: str) -> None:
    shown = run_demo(robot)
    impact = shown.impact
    free = shown.robot.model.joints[1].nv == 6
    np.testing.assert_allclose(
        impact.problem.velocity, FREE_BASE if free else FIXED_BASE, rtol=1e-4, atol=1e-4
    )
    model, data = shown.robot.model, shown.robot.model.createData()
    change = pin.computeKineticEnergy(model, data, impact.q, impact.v_after)
    change -= pin.computeKineticEnergy(model, data, impact.q, impact.v_before)
    assert impact.solution.work.total == pytest.approx(change, rel=1e-6)
    assert impact.solution.work.friction < 0.0


def test_demo_of_an_unknown_robot() -> None:
    result = call("demo", "--robot", "pandaa")
    assert result.exit_code == 1
    assert "Error: robot: 'pandaa'" in result.output
    assert "'panda'" in result.output


def test_plan() -> None:
    result = call("plan", str(SCENES / "ball_on_conveyor.toml"))
    assert result.exit_code == 0, result.output
    rows = {line[:26].strip(): line[27:31].strip() for line in result.output.splitlines()}
    assert rows["moving surfaces"] == rows["gravity"] == "yes"
    assert rows["held contacts"] == rows["control"] == "no"


def test_run(tmp_path: Path) -> None:
    result = call("run", str(SCENES / "ball_on_conveyor.toml"), "-o", str(tmp_path))
    assert result.exit_code == 0, result.output
    assert "The duration is covered" in result.output
    names = ("trajectory.npz", "energy.png", "forces.png", "impact.png", "replay.html")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)


def test_run_keeps_what_was_computed_when_it_cannot_go_on(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    text = (SCENES / "ball_on_conveyor.toml").read_text(encoding="utf-8")
    text = text.replace("ball.urdf", str(SCENES / "ball.urdf")).replace(
        "restitution = 0.4", "restitution = 1.0"
    )
    scene.write_text("max_impacts = 3\n" + text, encoding="utf-8")
    result = call("run", str(scene), "-o", str(tmp_path / "out"))
    assert result.exit_code == 1
    assert "Error:" in result.output
    assert (tmp_path / "out" / "trajectory.npz").is_file()


@pytest.mark.parametrize("verb", [("demo",), ("run", str(SCENES / "ball_on_conveyor.toml")), ("cost",)])
def test_a_folder_that_cannot_be_made_is_said_before_anything_is_computed(
    verb: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def compute(*_: object, **__: object) -> None:
        raise AssertionError

    for name in ("app.demo.run_demo", "app.scene_loader.simulate", "studies.cost.run_cost"):
        monkeypatch.setattr(f"pinimpact.{name}", compute)
    (tmp_path / "file").write_text("not a folder", encoding="utf-8")
    result = call(*verb, "-o", str(tmp_path / "file" / "out"))
    assert result.exit_code == 1
    assert result.output.startswith("Error: ")
    assert str(tmp_path / "file") in result.output.replace("\n", "")


def test_cost_answers_what_reaches_an_error(tmp_path: Path) -> None:
    args = ("cost", "--robot", "two_link_arm", "--method", "exact", "--target", "1e-9", "--time-cap", "0.01")
    result = call(*args, "-o", str(tmp_path))
    assert result.exit_code == 0, result.output
    assert "exact" in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cost.json", "cost.png"]


def test_an_interrupted_run_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rich.progress import Progress

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "update", interrupt)
    result = call("run", str(SCENES / "ball_on_conveyor.toml"), "-o", str(tmp_path))
    assert result.exit_code == 130, result.output
    assert "Interrupted" in result.output
    assert (tmp_path / "trajectory.npz").is_file()
