"""What is installed, and what an import costs."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import pinimpact

ROOT = Path(__file__).parents[1]


def modules_after(statements: str) -> set[str]:
    code = f"{statements}; import sys; print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(out.stdout.split())


def test_import_loads_nothing_heavy() -> None:
    loaded = modules_after("import pinimpact")
    assert not loaded & {"numba", "scipy", "matplotlib", "meshcat", "pinocchio", "pydantic", "rich", "click"}


def test_the_command_line_starts_light() -> None:
    loaded = modules_after("import pinimpact.app.cli")
    assert not loaded & {"numba", "scipy", "matplotlib", "meshcat", "pinocchio", "pydantic"}


def test_an_impact_draws_nothing() -> None:
    loaded = modules_after(
        "import numpy, pinimpact as p; p.solve_impact(p.ImpactProblem(numpy.eye(3), (1, 0, -1), 0.1, 0.5))"
    )
    assert not loaded & {"matplotlib", "meshcat", "pinocchio", "pydantic", "rich"}


def test_pictures_are_reached_after_a_plain_import() -> None:
    loaded = modules_after("import pinimpact; pinimpact.visual.plots.impact_figure; pinimpact.replay")
    assert "pinimpact.visual.plots" in loaded
    assert not loaded & {"matplotlib", "meshcat"}
    assert "visual" in dir(pinimpact)
    assert "plots" in dir(pinimpact.visual)
    with pytest.raises(AttributeError, match="'plot'"):
        _ = pinimpact.visual.plot


def test_every_public_name_resolves() -> None:
    assert sorted(pinimpact.__all__) == sorted(set(pinimpact.__all__))
    for name in pinimpact.__all__:
        assert getattr(pinimpact, name) is not None


def test_no_module_bears_the_name_of_a_public_function() -> None:
    modules = {path.stem for path in (ROOT / "src" / "pinimpact").rglob("*.py")}
    assert not modules & set(pinimpact.__all__)


def test_the_wheel_holds_types_and_models(tmp_path: Path) -> None:
    pytest.importorskip("hatchling")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert "pinimpact/py.typed" in names
    for model in (ROOT / "models").glob("*.urdf"):
        assert f"pinimpact/models/{model.name}" in names
    for part in ("page.html", "player.js", "drawing.js"):
        assert f"pinimpact/visual/page/{part}" in names
    assert not any(name.startswith(("tests/", "examples/")) for name in names)
