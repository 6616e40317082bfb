"""The examples run and show what they should."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.figure import Figure

from pinimpact import load_robot

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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


def test_figure_3_lies_on_the_closed_form(figures) -> None:
    start = 5 / np.sqrt(2)
    for label, curve in curves(figures, 3).items():
        if label.startswith("μ"):
            np.testing.assert_allclose(curve[:, 1], start * (curve[:, 0] / start) ** 1.75, rtol=1e-9)


def test_figure_7_slip_resumes_across_the_rod(figures) -> None:
    for label, curve in curves(figures, 7).items():
        if label.startswith("v"):
            np.testing.assert_allclose(curve[-1], [0.0, -0.084710897502], atol=1e-9)


def test_a_pushed_quadruped_slips_and_stands_again(tmp_path: Path, capsys) -> None:
    push = example("push_recovery")
    push.main(tmp_path)
    assert (tmp_path / "push_recovery.png").is_file()
    assert "slips from 0.4" in capsys.readouterr().out
    trajectory = push.simulate_push()
    end = trajectory.t[-1]
    assert all(trajectory.mode_at(foot, end) == "stick" for foot in push.FEET)
    weight = 9.81 * pin.computeTotalMass(load_robot("solo12").model)
    assert sum(trajectory.forces(foot, end)[2] for foot in push.FEET) == pytest.approx(weight, rel=1e-3)
