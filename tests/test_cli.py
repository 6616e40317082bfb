"""Commands of the command line."""

from __future__ import annotations

import io
import json
import logging
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

import pinimpact
from pinimpact.app.cli import RUN_FILES, main
from pinimpact.app.report import run_facts
from pinimpact.app.scene_loader import load_scene
from pinimpact.app.terminal import print_result
from pinimpact.scene.records import SteppedInterval

SCENES = Path(__file__).parents[1] / "examples" / "scenes"


def call(*args: str):
    return CliRunner().invoke(main, args)


def test_help_lists_commands() -> None:
    result = call("--help")
    assert result.exit_code == 0
    for verb in ("demo", "robots", "info", "plan", "run", "cost", "warmup"):
        assert f"  {verb} " in result.output


@pytest.mark.parametrize("robot", ["two_link_arm", "solo12"])  # a page of the site has that of the Panda
def test_demo(robot: str, tmp_path: Path) -> None:
    result = call("demo", robot, "-o", str(tmp_path / "out"))
    assert result.exit_code == 0, result.output
    for text in (
        "Contact velocity",
        "Joint velocities",
        "Segments",
        "Impulse",
        "total work",
        "Effects computed",
    ):
        assert text in result.output
    for name in ("replay.html", "hodograph.png"):
        assert name in result.output.replace("\n", "")
        assert (tmp_path / "out" / name).stat().st_size > 10_000


def test_demo_of_unknown_robot() -> None:
    result = call("demo", "pandaa")
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


def test_failed_run_writes_its_partial_trajectory(tmp_path: Path) -> None:
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
def test_invalid_output_folder_raises_before_computing(
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


@pytest.mark.parametrize(
    "command",
    [
        ("demo", "nosuch"),
        ("demo", "two_link_arm", "--friction", "-1"),
        ("run", "below.toml"),
        ("cost", "--robot", "nosuch"),
        ("ensemble", "study.toml"),
    ],
)
def test_failed_commands_leave_no_empty_folder(command, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = (SCENES / "falling_rod.toml").read_text().replace('urdf = "', f'urdf = "{SCENES}/')
    (tmp_path / "below.toml").write_text(re.sub(r"(?m)^position = .*$", "position = [0, 0, -1]", text))
    (tmp_path / "study.toml").write_text(
        'scene = "falling_rod"\nsamples = 4\ndesign = "nosuch"\n'
        '[over]\nfriction = { distribution = "uniform" }\n'
    )
    (tmp_path / "old").mkdir()
    files = set(tmp_path.iterdir())
    for folder in ("new/deep", "old"):
        assert call(*command, "-o", folder).exit_code == 1
        assert set(tmp_path.iterdir()) == files


def test_report_and_replay_agree_on_the_number_of_impacts(tmp_path: Path) -> None:
    result = call("run", "falling_rod", "-o", str(tmp_path))
    rows = pinimpact.Trajectory.load(tmp_path / "trajectory.npz").impacts
    page = (tmp_path / "replay.html").read_text(encoding="utf-8")
    motion = json.loads(re.search(r'<script id="motion" type="application/json">(.*?)</script>', page)[1])
    count = len({(one.time, *one.v_before, *one.v_after) for one in rows})  # both ends of the rod, at times
    assert len(motion["impacts"]) == count < len(rows)
    assert f"Impacts: {count} ({len(rows)} rows" in result.output


def test_cost_reports_method_that_reaches_target_error(tmp_path: Path) -> None:
    args = ("cost", "--robot", "two_link_arm", "--method", "exact", "--target", "1e-9", "--time-cap", "0.01")
    result = call(*args, "-o", str(tmp_path))
    assert result.exit_code == 0, result.output
    assert "exact" in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cost.json", "cost.png"]


def test_cost_prints_summary_and_all_rows_on_request(tmp_path: Path) -> None:
    args = ("cost", "--robot", "two_link_arm", "--method", "exact", "--method", "rk4", "--time-cap", "60")
    result = call(*args, "-o", str(tmp_path))
    assert result.exit_code == 0, result.output
    rows = [line for line in result.stdout.splitlines() if line.startswith("  ")]
    assert [row.split()[0] for row in rows] == ["method", "exact", "rk4"]
    assert "over 1 problem " in result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 80 or "/" in result.stdout
    every = call(*args, "--all", "--force", "-o", str(tmp_path))
    assert every.stdout.count("rk4(steps=") > 5
    figures = json.loads(call(*args, "--json", "--force", "-o", str(tmp_path)).stdout)
    assert {point["method"] for point in figures["points"]} == {"exact", "rk4"}


def test_interrupted_run_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from rich.progress import Progress

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "update", interrupt)
    result = call("run", str(SCENES / "ball_on_conveyor.toml"), "-o", str(tmp_path))
    assert result.exit_code == 130, result.output
    assert "Interrupted" in result.output
    assert (tmp_path / "trajectory.npz").is_file()


def test_exit_status_of_interrupted_demo_and_cost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pinimpact.app.demo.simulate", interrupt)
    monkeypatch.setattr("pinimpact.studies.cost.run_cost", interrupt)
    for command in (("demo", "two_link_arm"), ("cost",)):
        result = call(*command, "-o", str(tmp_path))
        assert result.exit_code == 130
        assert result.output.endswith("Interrupted.\n")


def test_files_of_earlier_runs_are_not_overwritten(tmp_path: Path, monkeypatch) -> None:
    scene = str(SCENES / "ball_on_conveyor.toml")
    (tmp_path / "replay.html").write_text("mine", encoding="utf-8")
    result = call("run", scene, "-o", str(tmp_path))
    assert result.exit_code == 1
    assert "already contains replay.html; use --force to overwrite it" in result.output
    assert (tmp_path / "replay.html").read_text(encoding="utf-8") == "mine"
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "energy.png").write_text("mine", encoding="utf-8")
    result = call("run", scene, "--quiet")
    assert (result.exit_code, result.output) == (0, "")
    assert (tmp_path / "out-2" / "replay.html").is_file()
    assert (tmp_path / "out" / "energy.png").read_text(encoding="utf-8") == "mine"
    assert call("run", scene, "--quiet", "--force").exit_code == 0
    assert (tmp_path / "out" / "energy.png").stat().st_size > 10_000
    assert set(RUN_FILES) == {path.name for path in (tmp_path / "out-2").iterdir()}


def test_forced_run_leaves_no_files_of_the_earlier_one(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert call("run", "falling_rod", "-o", str(out)).exit_code == 0
    assert {path.name for path in out.iterdir()} == set(RUN_FILES)
    text = (SCENES / "falling_rod.toml").read_text().replace('urdf = "', f'urdf = "{SCENES}/')
    short = tmp_path / "short.toml"
    short.write_text(re.sub(r"(?m)^duration = .*$", "duration = 0.01", text))
    result = call("run", str(short), "-o", str(out), "--force", "--json")
    files = json.loads(result.output)["files"].values()
    assert {path.name for path in out.iterdir()} == {Path(path).name for path in files}
    assert not (out / "impact.png").exists()


def test_run_as_json(tmp_path: Path) -> None:
    result = call("run", str(SCENES / "ball_on_conveyor.toml"), "--json", "-o", str(tmp_path))
    assert result.exit_code == 0, result.output
    facts = json.loads(result.stdout)
    trajectory = pinimpact.Trajectory.load(facts["files"]["Trajectory"])
    assert facts["complete"]
    assert [impact["time"] for impact in facts["impacts"]] == [impact.time for impact in trajectory.impacts]
    assert len(facts["notes"]) == len(trajectory.notes)
    assert facts["energy"]["energy residual"] == trajectory.energy.residual[-1]


def test_time_steps_without_an_estimate_of_their_error_as_json(capsys, monkeypatch) -> None:
    """The estimate is NaN if steps of two sizes led to impacts in different orders."""
    scene = load_scene(SCENES / "falling_rod.toml")
    run = pinimpact.simulate(scene.scene, scene.q, scene.v, 0.1, scheme="time-stepping")
    crossed = SteppedInterval(0.0, 0.1, 1e-3, "several impacts", float("nan"))
    monkeypatch.setattr(run, "stepped", (crossed,))
    print_result(lambda: run_facts(run), lambda: "", True, False)
    facts = json.loads(capsys.readouterr().out)
    assert facts["stepped"][-1]["error"] is None
    assert facts["stepped"][-1]["dt"] == 1e-3


def test_period_and_delay_of_run(tmp_path: Path) -> None:
    text = (SCENES / "solo12_landing.toml").read_text(encoding="utf-8")
    text = text.replace("duration = 0.6", "duration = 0.004").replace("rtol = 1e-6", "rtol = 1e-9")
    bare = tmp_path / "bare.toml"
    bare.write_text(text, encoding="utf-8")
    options = ("--json", "-o", str(tmp_path / "out"))
    result = call("run", str(bare), "--period", "1 ms", "--delay", "0.002", *options)
    assert result.exit_code == 0, result.output
    found = pinimpact.Trajectory.load(json.loads(result.stdout)["files"]["Trajectory"])
    # the robot starts at rest at its reference, so torques are zero until they are two samples old
    loaded = load_scene(bare, {"period": 1e-3, "delay": 2e-3})
    assert (loaded.scene.period, loaded.scene.delay) == (1e-3, 2e-3)
    assert found.q[-1] == pytest.approx(loaded.run().q[-1], abs=1e-15)
    assert np.ptp(found.energy.control[found.t <= 2e-3]) == 0.0
    for given, said in (
        (("--period", "2 N"), "control.period"),
        (("--delay", "1 ms"), "control.delay: only a sampled control has a delay"),
    ):
        result = call("run", str(bare), *given, *options)
        assert (result.exit_code, said in result.output) == (1, True), result.output
    result = call("run", str(SCENES / "falling_rod.toml"), "--period", "1 ms", *options)
    assert (result.exit_code, "has no table [control]" in result.output) == (1, True)


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (
            "ball_on_conveyer",
            "there is no file ball_on_conveyer, and no scene of that name; did you mean 'ball_on_conveyor'?",
        ),
        (".", "cannot read .: Is a directory"),
    ],
)
def test_message_for_unreadable_scene(scene: str, said: str) -> None:
    result = call("plan", scene)
    assert (result.exit_code, result.output) == (1, f"Error: scene: {said}\n")


def test_plan_as_json() -> None:
    effects = json.loads(call("plan", str(SCENES / "ball_on_conveyor.toml"), "--json").stdout)
    assert {effect["name"]: effect["on"] for effect in effects}["moving surfaces"] is True


def test_robots_are_listed() -> None:
    result = call("robots")
    assert result.exit_code == 0
    assert {"panda", "solo12", "two_link_arm", "talos_arm"} <= set(result.output.split())
    assert max(map(len, result.output.splitlines())) <= 80
    assert call("robots", "SOLO").output.split() == ["example-robot-data:", "solo12", "solo8"]
    assert json.loads(call("robots", "rod", "--json").stdout)["pinimpact"] == ["rod"]


def test_info_shows_joints_limits_and_frames() -> None:
    result = call("info", "panda")
    assert result.exit_code == 0, result.output
    for text in (
        "panda_joint4",
        "-3.072",
        "-0.0698",
        "prismatic",
        "fixed base",
        "panda_hand_tcp",
        "panda_hand_0",
    ):
        assert text in result.output
    facts = json.loads(call("info", "solo12", "--json").stdout)
    assert facts["free_base"]
    assert facts["contact_frames"] == ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"]
    assert facts["joints"][0]["lower"] == [None] * 7
    assert {frame["name"] for frame in facts["frames"]} >= {"FL_FOOT", "base_link"}
    assert "panda_link0_to_panda_joint" not in call("info", "panda").output
    assert call("info", "pandaa").exit_code == 1


@pytest.mark.parametrize("columns", [72, 80])
def test_narrow_tables_wrap_names_and_do_not_truncate_numbers(columns: int) -> None:
    from pinimpact.app.report import _columns

    names = ("left_gripper_of_the_humanoid_robot on the_table_in_the_kitchen",) * 2
    rows = [("0.123456", names[0], -123.456789, 98765.4321, -0.123456, names[1])]
    console = Console(width=columns, file=io.StringIO())
    console.print(
        _columns("Impacts", ("t [s]", "contact", "approach [m/s]", "impulse", "energy [J]", "x"), rows)
    )
    printed = console.file.getvalue()
    for number in ("0.123456", "-123.456789", "+98765.432100", "-0.123456"):
        assert number in printed
    assert "…" not in printed


def test_command_as_a_module() -> None:
    run = subprocess.run(
        [sys.executable, "-m", "pinimpact", "--version"],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ,
    )
    assert run.stdout == f"pinimpact, version {pinimpact.__version__}\n"


def test_closed_output_pipe_is_no_error() -> None:
    shown = subprocess.Popen(
        [sys.executable, "-m", "pinimpact", "robots"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert shown.stdout is not None
    shown.stdout.close()
    _, said = shown.communicate(timeout=60)
    assert "Errno" not in said


def test_cost_shows_progress(monkeypatch, tmp_path):
    def waits(*_, progress, **__):
        progress("a class")
        logging.getLogger("pinimpact.compiling").warning("compiling kernels: about 5 s")
        time.sleep(0.3)
        raise pinimpact.InputError("enough")

    monkeypatch.setattr("pinimpact.studies.cost.run_cost", waits)
    monkeypatch.setenv("FORCE_COLOR", "1")
    shown = call("cost", "-o", str(tmp_path)).stderr
    assert "measuring a class" in shown
    assert "compiling kernels: about 5 s" in shown
