"""The package: imports, sizes of modules, wheel, metadata and versions."""

from __future__ import annotations

import ast
import email
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import pinimpact

ROOT = Path(__file__).parents[1]
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def modules_after(statements: str) -> set[str]:
    code = f"{statements}; import sys; print(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(out.stdout.split())


def test_import_loads_no_heavy_modules() -> None:
    loaded = modules_after("import pinimpact")
    assert not loaded & {"numba", "scipy", "matplotlib", "meshcat", "pinocchio", "pydantic", "rich", "click"}


def test_command_line_loads_no_heavy_modules() -> None:
    loaded = modules_after("import pinimpact.app.cli")
    assert not loaded & {"numba", "scipy", "matplotlib", "meshcat", "pinocchio", "pydantic"}


def test_impact_does_not_load_plots() -> None:
    loaded = modules_after(
        "import numpy, pinimpact as p; p.solve_impact(p.ImpactProblem(numpy.eye(3), (1, 0, -1), 0.1, 0.5))"
    )
    assert not loaded & {"matplotlib", "meshcat", "pinocchio", "pydantic", "rich"}


def test_plots_are_accessible_after_import() -> None:
    loaded = modules_after("import pinimpact; pinimpact.visual.plots.impact_figure; pinimpact.replay")
    assert "pinimpact.visual.plots" in loaded
    assert not loaded & {"matplotlib", "meshcat"}
    assert "visual" in dir(pinimpact)
    assert "plots" in dir(pinimpact.visual)
    with pytest.raises(AttributeError, match="'plot'"):
        _ = pinimpact.visual.plot


LONGEST_FUNCTION, LONGEST_MODULE = 80, 500


def test_functions_and_modules_are_short() -> None:
    longer = []
    for path in (ROOT / "src").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if len(text.splitlines()) > LONGEST_MODULE:
            longer.append(path.name)
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                assert node.end_lineno is not None
                if node.end_lineno - node.lineno + 1 > LONGEST_FUNCTION:
                    longer.append(f"{node.name} in {path.name}")
    assert longer == []


def test_public_names_resolve() -> None:
    assert sorted(pinimpact.__all__) == sorted(set(pinimpact.__all__))
    for name in pinimpact.__all__:
        assert getattr(pinimpact, name) is not None


def test_no_module_has_the_name_of_a_public_function() -> None:
    modules = {path.stem for path in (ROOT / "src" / "pinimpact").rglob("*.py")}
    assert not modules & set(pinimpact.__all__)


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """Return a folder with the wheel and the source distribution."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder


def test_wheel_contains_types_models_and_scenes(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert "pinimpact/py.typed" in names
    for model in (ROOT / "models").glob("*.urdf"):
        assert f"pinimpact/models/{model.name}" in names
    for file in (ROOT / "examples" / "scenes").iterdir():
        assert f"pinimpact/scenes/{file.name}" in names
    for part in ("page.html", "player.js", "drawing.js"):
        assert f"pinimpact/visual/page/{part}" in names
    assert all(name.startswith(("pinimpact/", "pinimpact-")) for name in names)


def test_source_distribution_contains_files_of_tests(built: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        names = {name.partition("/")[2] for name in packed.getnames()}
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    wanted = [name for name in tracked.stdout.splitlines() if not name.startswith((".github", ".pre-commit"))]
    assert set(wanted) <= names
    assert {"mkdocs.yml", "tools/pages.py", "examples/arm.urdf", "pyproject.toml"} <= names


def test_metadata_is_complete(built: Path) -> None:
    (wheel,) = built.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (path,) = (name for name in archive.namelist() if name.endswith("/METADATA"))
        metadata = email.message_from_bytes(archive.read(path))
    assert metadata["Name"] == "pinimpact"
    assert metadata["Version"] == pinimpact.__version__
    assert metadata["License-Expression"] == "BSD-3-Clause"
    assert metadata["Description-Content-Type"] == "text/markdown"
    urls = dict(line.split(", ", 1) for line in metadata.get_all("Project-URL"))
    assert {"Documentation", "Source", "Issues", "Changelog"} <= set(urls)
    assert "# pinimpact" in metadata.get_payload()
    extras = {"bench", "cluster", "crocoddyl", "data", "dev", "docs", "jax", "torch"}
    assert extras == set(metadata.get_all("Provides-Extra"))


def test_versions_agree() -> None:
    version = f"version: {pinimpact.__version__}\n"
    assert version in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    oldest, newest = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', PYPROJECT)[::4]
    assert f'requires-python = ">={oldest}"' in PYPROJECT
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    assert f'"{oldest}"' in workflow
    assert f'"{newest}"' in workflow


def test_oldest_tested_versions_are_the_required_ones() -> None:
    workflow = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    for name in ("pin", "numba", "numpy"):
        asked = re.search(rf'"{name}>=([\d.]+)"', PYPROJECT)
        assert asked is not None
        assert re.search(rf"\b{name}=={re.escape(asked[1])}\b", workflow), name
