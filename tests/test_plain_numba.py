"""Kernels compiled by plain numba; private names of numba in the sources."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pinimpact
from pinimpact._compile import plain
from tests.test_kernel_compiling import CALL, package, python

__all__ = ["package"]

SOURCES = Path(pinimpact.__file__).parent
INTERNALS = SOURCES / "_compile" / "numba_internals.py"
PUBLIC = {"numba", "numba.extending", "numba.types", "llvmlite.ir", "llvmlite.binding", "llvmlite"}


def imported(path: Path) -> list[tuple[int, str, str]]:
    """Return line, module and name of the imports of numba and llvmlite in a file."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and not node.level:
            found += [(node.lineno, str(node.module), alias.name) for alias in node.names]
        elif isinstance(node, ast.Import):
            found += [(node.lineno, alias.name, "") for alias in node.names]
    return [one for one in found if one[1].split(".")[0] in ("numba", "llvmlite")]


def test_private_names_of_numba_are_in_one_module_with_reasons() -> None:
    private = {
        path: [one for one in imported(path) if one[1] not in PUBLIC] for path in SOURCES.rglob("*.py")
    }
    assert [path for path, names in private.items() if names] == [INTERNALS]
    lines = INTERNALS.read_text(encoding="utf-8").splitlines()
    assert len(private[INTERNALS]) <= 25
    for line, _, name in private[INTERNALS]:
        assert "  # " in lines[line - 1], name


def test_untested_versions_of_numba_are_used_without_extensions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(plain.VARIABLE, raising=False)
    assert plain.reason((0, 61)) == plain.reason((0, 68)) == ""
    assert "numba 0.60 has not been tested" in plain.reason((0, 60))
    assert "numba 1.0 has not been tested" in plain.reason((1, 0))
    monkeypatch.setattr(plain, "MISSING", "no JITCodeLibrary")
    assert "no JITCodeLibrary" in plain.reason()
    monkeypatch.setenv(plain.VARIABLE, "1")
    assert plain.VARIABLE in plain.reason()


def test_kernels_run_by_plain_numba(package: Path) -> None:
    rest = "\nfrom pinimpact._compile import jit\nprint(jit.WHY_PLAIN)"
    first = python(package, CALL + rest, PINIMPACT_PLAIN_NUMBA="1")
    answers, reason = first.stdout.splitlines()
    assert json.loads(answers)[0] == [7.0, 130.0, -3.0]
    assert reason == "PINIMPACT_PLAIN_NUMBA is set"
    assert first.stderr.count("\n") == 1
    assert "compiled by plain numba" in first.stderr
    again = python(package, CALL, PINIMPACT_PLAIN_NUMBA="1").stdout
    assert json.loads(again) == [[7.0, 130.0, -3.0], []]  # from the cache of numba
    lost = "import numba.core.codegen as gone\ndel gone.JITCodeLibrary\n"
    without = python(package, lost + CALL + rest).stdout.splitlines()
    assert json.loads(without[0])[0] == [7.0, 130.0, -3.0]
    assert "JITCodeLibrary" in without[1]


IN_CONTACT_SPACE = """
import json, numpy as np, pinimpact as p
rng = np.random.default_rng(1)
X = rng.standard_normal((200, 3, 7))
v = rng.standard_normal((200, 3))
v[:, 2] = -abs(v[:, 2])
found = [p.solve_impacts(X @ X.transpose(0, 2, 1) / 7, v, 0.3, 0.5, law) for law in ("poisson", "energetic")]
print(json.dumps([one.velocity.tolist() for one in found]))
"""

OF_A_ROBOT = """
import json, numpy as np, pinimpact as p
robot = p.load_robot("panda")
hand = p.Contact("panda_hand_tcp", p.Plane(), friction=0.4, restitution=0.5)
q = np.array([0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02])
print(json.dumps([p.impact(robot.model, robot.data, q, np.eye(9)[1], hand).v.tolist()]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("code", [IN_CONTACT_SPACE, pytest.param(OF_A_ROBOT, marks=pytest.mark.exhaustive)])
def test_impacts_agree_to_rounding(code: str) -> None:
    def impacts(chosen: str) -> list[np.ndarray]:
        environment = os.environ | {plain.VARIABLE: chosen}
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
        assert done.returncode == 0, done.stderr
        return [np.array(one) for one in json.loads(done.stdout)]

    for one, other in zip(impacts("1"), impacts("0"), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-13)  # 40 rounding errors
