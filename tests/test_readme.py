"""The README: its first lines, picture, commands and links; its example is run in `test_docs`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from tools import pages

ROOT = pages.ROOT
README = (ROOT / "README.md").read_text(encoding="utf-8")
HOME = ROOT / "docs" / "index.md"
REPOSITORY = "https://github.com/pinimpact/pinimpact"
RAW = "https://raw.githubusercontent.com/pinimpact/pinimpact/main/"
SITE = "https://pinimpact.github.io/pinimpact/"
LINK = re.compile(r"\]\(([^)\s]+)\)")


def local_file(link: str) -> Path | None:
    """Return the file of the repository that a link refers to, or None for pages of other projects."""
    link = link.partition("#")[0]
    for start in (f"{REPOSITORY}/blob/main/", f"{REPOSITORY}/tree/main/", RAW):
        if link.startswith(start):
            return ROOT / link.removeprefix(start)
    if link.startswith(SITE):
        name = link.removeprefix(SITE).strip("/") or "index"
        return ROOT / "docs" / (name if Path(name).suffix else f"{name}.md")
    return None


def blocks(language: str) -> list[str]:
    return [block.text for block in pages.blocks_of(ROOT / "README.md") if block.language == language]


def test_first_lines_name_purpose_users_and_installation() -> None:
    first = README[: README.index("```")]
    assert "computes rigid-body impacts with friction" in first  # what it does
    assert "is written for researchers" in first  # and for whom
    assert len(blocks("python")) == 1
    assert len(blocks("python")[0].splitlines()) <= 11


def run_python(page: Path, folder: Path) -> dict[str, object]:
    """Run the Python code of a page, without its commands, in a folder and return the global names."""
    copy = folder / "page.md"
    text = page.read_text(encoding="utf-8")
    copy.write_text(re.sub(r"^```sh\n.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL), encoding="utf-8")
    return pages.run_page(copy, folder)


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """Return the names of the example."""
    return run_python(ROOT / "README.md", tmp_path_factory.mktemp("readme"))


def test_example_starts_in_contact(example: dict[str, object]) -> None:
    names = example
    robot: Any = names["robot"]
    hand: Any = names["hand"]
    assert abs(hand.gap(robot.model, robot.data, names["q"])) < 1e-11


@pytest.mark.slow
def test_picture_shows_the_impact_of_the_example(example: dict[str, object], tmp_path: Path) -> None:
    hits: list[Any] = [example["hit"], run_python(HOME, tmp_path)["hit"]]
    assert hits[0].impulse_world.tolist() == hits[1].impulse_world.tolist()
    assert pages.pictures_of(HOME) == ["index-impact.png"]
    assert f"{RAW}docs/figures/pages/index-impact.png" in README


def test_test_command_agrees_with_ci() -> None:
    from_index, run, test = blocks("sh")
    assert from_index == "python -m pip install pinimpact\n"
    assert "pinimpact demo" in run
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for step in test.strip().split(" && "):
        assert step.replace("pip install -e", "pip install -q --no-compile -e") in ci


def test_links_are_absolute_for_the_package_index() -> None:
    links = LINK.findall(README)
    assert len(links) > 15
    for link in links:
        assert link.startswith("https://"), link


@pytest.mark.parametrize("page", pages.pages(), ids=lambda page: page.stem)
def test_targets_of_links_into_the_project_exist(page: Path) -> None:
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        file = local_file(link)
        assert file is None or file.exists(), link


def test_named_scenes_are_bundled() -> None:
    from pinimpact.app.scene_file import bundled_scenes

    named = re.findall(r"pinimpact (?:run|plan) (\w+)", README)
    assert named
    assert set(named) <= set(bundled_scenes())
