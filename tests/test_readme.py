"""The README's example and commands are those that are tested."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_the_example_runs_as_printed() -> None:
    (example,) = blocks("python")
    (promised,) = blocks("text")
    printed = io.StringIO()
    names: dict[str, Any] = {}
    with contextlib.redirect_stdout(printed):
        exec(compile(example, "README.md", "exec"), names)
    assert printed.getvalue() == promised
    robot = names["robot"]
    assert abs(names["hand"].gap(robot.model, robot.data, names["q"])) < 1e-11  # it begins in contact
    assert example == (ROOT / "examples" / "first_impact.py").read_text(encoding="utf-8")
    assert len(example.splitlines()) <= 11


def test_the_second_command_is_what_ci_runs() -> None:
    run, test = blocks("sh")
    assert "pinimpact demo" in run
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for step in test.strip().split(" && "):
        assert step.replace("pip install -e", "pip install -q -e") in ci


def test_linked_files_exist() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        assert target.startswith("https://") or (ROOT / target).is_file(), target
    for target in re.findall(r"examples/[\w/.]+\.toml", README):
        assert (ROOT / target).is_file(), target
