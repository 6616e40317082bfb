"""Run the code blocks of README.md and docs/, compare their output and store their pictures.

The blocks of a page are run in order, in one folder and one Python session:

- ``python`` is executed, and each line of ``sh`` that calls `pinimpact`;
- ``xml`` and ``toml`` with a title are written to the file of that name;
- ``text`` directly after ``python`` or ``sh`` must equal the output of that block.

python -m tools.pages [PAGE ...] runs all or the given pages and copies the pictures that they show to
docs/figures/pages/.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PICTURES = DOCS / "figures" / "pages"
FENCE = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A fenced block of code.

    Attributes:
        language: Word after the fence.
        title: Name of the file to which the text is written, or "".
        text: Text between the fences.
        line: Line of the first fence.
        follows: Language of the previous block if no text stands in between, or "".
    """

    language: str
    title: str
    text: str
    line: int
    follows: str


def pages() -> list[Path]:
    """Return README.md and all pages of the site."""
    return [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]


def blocks_of(page: Path) -> list[Block]:
    """Return the code blocks of a page in order."""
    text = page.read_text(encoding="utf-8")
    blocks: list[Block] = []
    end = 0
    for fence in FENCE.finditer(text):
        language, _, rest = fence[1].partition(" ")
        title = re.fullmatch(r'title="(.+)"', rest)
        joined = blocks and not text[end : fence.start()].strip()
        line = text.count("\n", 0, fence.start()) + 1
        blocks.append(
            Block(language, title[1] if title else "", fence[2], line, blocks[-1].language if joined else "")
        )
        end = fence.end()
    return blocks


class PageError(Exception):
    """A command fails, or the output of a block differs from the page."""


def run_page(page: Path, folder: Path) -> dict[str, object]:
    """Run a page in a folder and return the global names of its Python session.

    Raises:
        PageError: A command fails, or the output of a block differs from the page.
    """
    names: dict[str, object] = {"__name__": "__main__"}
    printed = ""
    with in_folder(folder):
        for block in blocks_of(page):
            place = f"{page.name}:{block.line}"
            if block.title:
                Path(block.title).write_text(block.text, encoding="utf-8")
            elif block.language == "python":
                code = compile(block.text, place, "exec")
                with contextlib.redirect_stdout(io.StringIO()) as out:
                    exec(code, names)
                printed = out.getvalue()
            elif block.language == "sh":
                printed = "".join(run_command(line, place) for line in commands_of(block.text))
            elif block.language == "text" and block.follows in ("python", "sh") and printed != block.text:
                raise PageError(f"{place}: expected output\n{block.text}\nactual output\n{printed}")
    return names


@contextlib.contextmanager
def in_folder(folder: Path) -> Iterator[None]:
    """Change the current folder, and restore it at the end."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def commands_of(text: str) -> list[str]:
    """Return the lines of a shell block that call `pinimpact`, without their comments."""
    return [line.split("  #")[0] for line in text.splitlines() if line.startswith("pinimpact ")]


def run_command(line: str, place: str) -> str:
    """Run a `pinimpact` command and return its output."""
    from click.testing import CliRunner

    from pinimpact.app.cli import main

    result = CliRunner().invoke(main, shlex.split(line)[1:], catch_exceptions=False)
    if result.exit_code:
        raise PageError(f"{place}: {line!r} exits with {result.exit_code}:\n{result.output}")
    return result.stdout


def pictures_of(page: Path) -> list[str]:
    """Return the names of the pictures that a page shows and its own code draws."""
    return re.findall(r"\]\((?:\.\./)*figures/pages/([\w.-]+)\)", page.read_text(encoding="utf-8"))


def main(names: list[str]) -> None:
    """Run all or the named pages and store their pictures."""
    PICTURES.mkdir(exist_ok=True)
    for page in pages():
        if names and page.stem not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            run_page(page, Path(folder))
            for picture in pictures_of(page):
                shutil.copy(Path(folder) / picture, PICTURES / picture)
        print(page.relative_to(ROOT), *pictures_of(page))


if __name__ == "__main__":
    main(sys.argv[1:])
