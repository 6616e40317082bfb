"""Pictures of impacts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import pinimpact
from pinimpact.visual.plots import draw_hodograph, impact_figure, save_figure

umsgpack = pytest.importorskip("umsgpack")


def test_the_picture_of_an_impact(tmp_path: Path) -> None:
    problem = pinimpact.ImpactProblem(np.diag([2.0, 3.5, 1.0]), (0.5, 0.5, -1.0), 0.5, 0.5)
    solution = pinimpact.solve_impact(problem, record=True)
    figure = impact_figure(problem, solution, "title")
    hodograph = figure.axes[0]
    drawn = np.vstack(
        [line.get_xydata() for line in hodograph.lines if line.get_label() in ("compression", "restitution")]
    )
    v1, v2 = drawn.T
    np.testing.assert_allclose(v2, 0.5 * (np.maximum(v1, 0.0) / 0.5) ** 1.75, atol=1e-9)  # closed form (32)
    assert "stick" in [line.get_label() for line in hodograph.lines]
    pixels = imread(save_figure(figure, tmp_path / "impact.png"))
    assert min(pixels.shape[:2]) > 500
    assert pixels.std() > 0.05


def test_no_picture_without_a_path() -> None:
    problem = pinimpact.ImpactProblem(np.eye(3), (0.5, 0.5, -1.0), 0.5, 0.5)
    with pytest.raises(pinimpact.InputError, match="record=True"):
        draw_hodograph(None, problem, pinimpact.solve_impact(problem))
