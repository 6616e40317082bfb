"""Pages: their code blocks run with the printed output; numbers are measured; public names are documented."""

from __future__ import annotations

import importlib.util
import re
import shlex
from pathlib import Path

import pytest

import pinimpact
from pinimpact.app.scene_file import SceneFile, bundled_scenes
from pinimpact.scene.effects import DERIVED, SWITCHABLE
from tools import figures, pages, scene_keys

ROOT, DOCS = pages.ROOT, pages.DOCS
ALL = [*pages.pages(), ROOT / "CONTRIBUTING.md"]
LANGUAGES = {"python", "sh", "text", "toml", "xml"}
FIGURES_MARK = re.compile(r"<!-- (\w+\.txt) -->\n```text\n(.*?)```\n<!-- end -->", re.DOTALL)
MARK = re.compile(r"<!-- \w+(?:\.txt|: )")
OTHER_TOOLS = {
    "pip",
    "pytest",
    "mypy",
    "ruff",
    "lint-imports",
    "mkdocs",
    "coverage",
    "pdb",
    "tests.reference.generate",
}
"""Commands that shell blocks may call besides pinimpact and scripts of the repository."""


def having(*languages: str) -> list[Path]:
    return [page for page in ALL if any(block.language in languages for block in pages.blocks_of(page))]


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT).with_suffix(""))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Attempting to set identical")
@pytest.mark.parametrize("page", [p for p in having("python", "sh") if p.stem != "CONTRIBUTING"], ids=name_of)
def test_blocks_of_page_run_with_the_printed_output(page: Path, tmp_path: Path) -> None:
    pages.run_page(page, tmp_path)
    for picture in pages.pictures_of(page):
        assert (tmp_path / picture).stat().st_size > 1000, picture
        assert (pages.PICTURES / picture).is_file(), f"python -m tools.pages {page.stem} makes {picture}"


def test_wrong_output_on_a_page_is_detected(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text('```python\nprint("one")\n```\n\n```text\ntwo\n```\n', encoding="utf-8")
    with pytest.raises(pages.PageError, match=r"page\.md:5: expected output\ntwo"):
        pages.run_page(page, tmp_path)
    page.write_text("```sh\npinimpact plan nothing.toml\n```\n", encoding="utf-8")
    with pytest.raises(pages.PageError, match=r"exits with 1"):
        pages.run_page(page, tmp_path)


@pytest.mark.parametrize("page", ALL, ids=name_of)
def test_all_blocks_are_checked(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    found = pages.blocks_of(page)
    assert 2 * len(found) == len(re.findall(r"^ *```", text, re.MULTILINE)), "a fence that no test sees"
    tables = {block for _, block in FIGURES_MARK.findall(text)}
    for block in found:
        assert block.language in LANGUAGES, block
        if block.language in ("toml", "xml"):
            assert block.title, block
        if block.language == "text" and block.follows not in ("python", "sh"):
            assert block.text in tables, block


@pytest.mark.parametrize("page", [p for p in ALL if MARK.search(p.read_text(encoding="utf-8"))], ids=name_of)
def test_tables_and_figures_agree_with_measurements(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(MARK.findall(text)) == len(figures.TABLE.findall(text)) + len(figures.FIGURE.findall(text))
    assert figures.refreshed(text) == text, "python -m tools.figures writes the measured figures"


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [
        (10.23, "10 s"),
        (0.99951, "1.0 s"),
        (0.6351, "640 ms"),
        (0.009951, "10 ms"),
        (7.74e-5, "77 µs"),
        (3.13e-6, "3.1 µs"),
    ],
)
def test_figures_have_two_digits(seconds: float, shown: str) -> None:
    assert figures.time_of(seconds) == shown


TIME = re.compile(
    r"\b(?:\d[\d.,]*|half a|two|three|four|five|six|seven|eight|nine|ten)\s"
    r"(?:ns|µs|ms|s|seconds?|minutes?|hours?)\b"
)
STEPS = {"1 ms", "2 ms"}
"""Step sizes, which are not measured."""


def times_in_sentences(text: str) -> set[str]:
    """Return the times in sentences of a page without a mark that refers to a row of docs/figures."""
    for bound in (figures.FIGURE, figures.TABLE, pages.FENCE, re.compile(r"`[^`\n]*`|\$[^$]+\$")):
        text = bound.sub("", text)
    return {" ".join(found.split()) for found in TIME.findall(text)} - STEPS


@pytest.mark.parametrize("page", pages.pages(), ids=name_of)
def test_run_times_in_sentences_are_measured(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert times_in_sentences(text) == set(), "give the row of docs/figures that has it"


def test_times_without_measurement_are_detected() -> None:
    text = (
        "It takes <!-- speed: impact, ur5, mean -->3.8 µs<!-- end -->, or five\nseconds, in steps of `1 s`."
    )
    assert times_in_sentences(text) == {"five seconds"}


def words_of(command: str) -> list[str]:
    """Return the words of a command without leading assignments of variables."""
    words = shlex.split(command, comments=True)
    while words and "=" in words[0] and not words[0].startswith("-"):
        words.pop(0)
    return words


@pytest.mark.parametrize("page", having("sh"), ids=name_of)
def test_commands_in_shell_blocks_exist(page: Path) -> None:
    lines = "".join(block.text for block in pages.blocks_of(page) if block.language == "sh").splitlines()
    for command in (part for line in lines for part in line.split("&&")):
        if not (words := words_of(command)):
            continue
        tool, *rest = words
        if Path(tool).name.startswith("python") and rest[0] == "-m":
            tool, *rest = rest[1:]
        elif Path(tool).name.startswith("python"):
            tool, *rest = rest
            assert (ROOT / tool).is_file(), command
        tool = tool.removeprefix(".venv/bin/")
        if tool.split(".")[0] in ("benchmarks", "tools"):
            spec = importlib.util.find_spec(tool)
            assert spec is not None, command
            source = Path(str(spec.origin)).read_text(encoding="utf-8")
            for option in (word for word in rest if word.startswith("--")):
                assert option in source, command
        elif not tool.endswith(".py"):
            assert tool in {"pinimpact", "venv", ".ci/run", "pre-commit", *OTHER_TOOLS}, command


def test_public_names_are_in_the_api_reference() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    shown = re.findall(r"^::: pinimpact\.(\w+)$", text, re.MULTILINE)
    assert sorted(shown) == sorted(pinimpact.__all__)
    plots = re.findall(r"^::: pinimpact\.visual\.plots\.(\w+)$", text, re.MULTILINE)
    assert sorted(plots) == sorted(pinimpact.visual.plots.__all__)
    studies = re.findall(r"^::: pinimpact\.studies\.(\w+)$", text, re.MULTILINE)
    assert sorted(studies) == sorted(pinimpact.studies.__all__)


def test_names_of_the_api_reference_can_be_imported() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    for name in re.findall(r"^::: ([\w.]+)$", text, re.MULTILINE):
        module, _, last = name.rpartition(".")
        shown = getattr(importlib.import_module(module), last)
        assert shown.__doc__ or not callable(shown), name


def test_pages_are_in_the_menu() -> None:
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in DOCS.rglob("*.md"):
        assert f": {page.relative_to(DOCS).as_posix()}\n" in menu, page


def test_files_of_the_architecture_exist() -> None:
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    package = ROOT / "src" / "pinimpact"
    named = re.findall(r"`((?:[\w.]+/)*\w+\.py|\w[\w/]*/)`", text)
    assert len(named) > 50
    places = package, ROOT, package / "contact_space" / "_kernels"  # for the table of moves
    assert [name for name in named if not any((place / name).exists() for place in places)] == []
    folders = {path.parent.name for path in package.glob("*/__init__.py")}
    assert folders <= {name.strip("/") for name in named}


def test_pictures_are_shown() -> None:
    shown = {picture for page in pages.pages() for picture in pages.pictures_of(page)}
    assert {path.name for path in pages.PICTURES.iterdir()} == shown


def test_documented_keys_of_scene_files_agree_with_the_schema() -> None:
    text = scene_keys.PAGE.read_text(encoding="utf-8")
    assert scene_keys.page(text) == text, "python -m tools.scene_keys writes the tables"
    schema = SceneFile.model_json_schema()
    tables = {"Keys of the file": schema} | {
        heading: schema["$defs"][model.__name__]
        for model, heading in scene_keys.TABLES.values()
        if model is not SceneFile
    }
    for heading, table in tables.items():
        section = text.split(f"### {heading}\n")[1].split("\n### ")[0]
        rows = dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", section, re.MULTILINE))
        keys = {key for key in table["properties"] if table is not schema or key not in scene_keys.TABLES}
        assert set(rows) == keys
        for key in set(table.get("required", ())) & keys:
            assert "**required**" in rows[key]


def test_examples_are_listed() -> None:
    text = (DOCS / "examples.md").read_text(encoding="utf-8")
    for folder, kind in (("", "*.py"), ("notebooks/", "*.ipynb")):
        for path in (ROOT / "examples" / folder).glob(kind):
            assert f"/examples/{folder}{path.name})" in text, path.name
    assert set(re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)) == set(bundled_scenes())


@pytest.mark.parametrize("page", [page for page in pages.pages() if page.stem != "README"], ids=name_of)
def test_code_is_no_wider_than_a_page(page: Path) -> None:
    for block in pages.blocks_of(page):
        if block.language != "text":
            assert all(len(line) <= 100 for line in block.text.splitlines()), block


def test_effects_of_scenes_are_documented() -> None:
    text = (DOCS / "effects.md").read_text(encoding="utf-8")
    table = text.split("| effect |")[1].split("\n\n")[0]
    assert tuple(re.findall(r"^\| ([a-z][a-z -]+) \|", table, re.MULTILINE)) == SWITCHABLE + DERIVED
