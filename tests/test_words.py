"""Retired words do not appear in docs, help, messages, public docstrings and names."""

from __future__ import annotations

import ast
import inspect
import io
import json
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

import pinimpact
from tools import pages

ROOT = pages.ROOT
RETIRED = {
    r"what (?:is closed|rests|holds)\b": "active contacts, sticking contacts",
    r"\b(?:go|goes|going|went|gone) on\b": "keeps sliding, continues",
    r"\blets? go\b": "releases, separates",
    r"\b(?:in )?vain\b": "rejected candidate",
    r"\b(?:throws?|thrown|threw)\b": "accelerated by an impulse",
    r"\bdr(?:ive|ives|iven|ove) the (?:surface|point) in\b": "negative normal acceleration",
    r"\bsweeps?\b": "projected Gauss–Seidel iterations",
    r"(?<!lemke )(?<!lemke's )\bpivots\b": "Lemke pivots",
    r"(?<!constraint[ -])\bdrifts?\b": "constraint drift",
    r"\b(?:the|all|their|its|by|and) works\b|\bworks (?:of|that|add)\b": "work, energy dissipated",
    r"\bways? of (?:a|the|each|these|contact) (?:contact )?points?\b": "path",
    r"\bno way goes\b": "no admissible continuation",
    r"\btell(?:s|ing)?\b|\btold\b": "reports; is given, is declared",
    r"\bcompany\b": "worker pool",
    r"\blent\b": "borrowed",
    r"\banew\b": "recomputed, regenerated",
    r"\bthat which\b|(?:^|[.;] )(?:By|Of|In) which\b": "recast the sentence",
    r"\byours to know\b": "you supply",
    r"\b(?:where )?every joule\b": "energy dissipated",
    r"\bnever guessed\b": "raises an error",
    r"\baslant\b": "obliquely",
    r"\bin (?:its|their) stead\b": "instead",
    r"\bhonest limits\b|\bwhat you will miss\b": "Limitations",
    r"\bfrom install to\b": "Tutorial",
    r"\b(?:not|un)[ -]?accounted for\b": "energy residual",
    r"\bhas no such (?:option|key)\b": "unknown option, unknown key",
    r"\bshapes to show\b": "visual shapes",
    r"\bthat touches\b": "in contact",
    r"\bgives? impacts only\b": "use impact(), not a scene",
    r"\bcounts? as none\b": "is taken as zero",
    r"\bfeels? the blow\b|\bblows?\b": "impact, impulse",
    r"\bpython names\b": "API reference",
    r"\bglue[sd]?\b": "bilateral constraint",
    r"\bcarr(?:y|ies|ied) on\b": "dragged against friction",
    r"\bparts (?:slowly|again)\b|\bparted\b": "separates",
    r"\bbegins? again at\b": "the loop restarts at",
    r"\bat their joints\b": "at joint origins",
    r"\bare met first\b": "common errors",
    r"\bfe(?:els?|lt)\b": "is coupled to",
    r"\bhangs? (?:on|together)\b": "is attached to",
    r"\bspoils?\b": "affects",
    r"\bmeets? (?:planes?|a|another|what|its|no)\b": "makes contact with",
    r"\bclaim(?:s|ed)?\b": "lock",
    r"\bat the touch\b": "at impact",
    r"\bstrongest impact\b|\blongest [\d.]+ N s\b": "the largest impulse",
    r"\bof (?:one|a user|the user)'s own\b": "your own, user",
    r"\bworks:": "work:",
    r"(?<!there )\bis no (?:effect|name|number|text|double|readable)\b": "is not",
    r"\bdoes not know\b(?! the)": "does not support",
    r"\bcome to nothing\b|\bcomes? to its end\b": "ends",
}
"""Regular expressions of retired words, each with its replacement."""

FOUND = {pattern: re.compile(pattern, re.IGNORECASE) for pattern in RETIRED}


def retired(text: str) -> list[str]:
    """Return the retired words in a text, each with its context and replacement."""
    text = " ".join(text.split())
    return [
        f"…{text[max(0, hit.start() - 40) : hit.end() + 40]}… → {RETIRED[pattern]}"
        for pattern, words in FOUND.items()
        for hit in words.finditer(text)
    ]


def strings_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the string literals of a module, docstrings among them, with their lines."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def docstrings_of(tree: ast.Module) -> set[int]:
    """Return the ids of the docstrings of a module, including those of attributes."""
    return {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }


def messages_of(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the string literals of a module that are not docstrings, with their lines."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docstrings = docstrings_of(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.lineno, node.value


def public_docstrings() -> Iterator[tuple[str, str]]:
    """Yield the docstrings of public names and of their public attributes."""
    plots = pinimpact.visual.plots
    for module, names in ((pinimpact, pinimpact.__all__), (plots, plots.__all__)):
        for name in names:
            item = getattr(module, name)
            if inspect.isclass(item) or inspect.isroutine(item):
                yield name, inspect.getdoc(item) or ""
            if inspect.isclass(item) and item.__module__.startswith("pinimpact"):
                for key, attribute in vars(item).items():
                    if not key.startswith("_"):
                        yield f"{name}.{key}", inspect.getdoc(attribute) or ""


def public_arguments() -> Iterator[tuple[str, str]]:
    """Yield the arguments of public functions and classes."""
    for name in pinimpact.__all__:
        item = getattr(pinimpact, name)
        if inspect.isroutine(item) or (inspect.isclass(item) and "__init__" in vars(item)):
            yield from ((name, argument) for argument in inspect.signature(item).parameters)


def comments_of(path: Path) -> str:
    """Return the comments of a module."""
    tokens = tokenize.generate_tokens(io.StringIO(path.read_text(encoding="utf-8")).readline)
    return " ".join(token.string.lstrip("# ") for token in tokens if token.type == tokenize.COMMENT)


SOURCES = sorted(path for path in (ROOT / "src").rglob("*.py") if "_kernels" not in path.parts)
"""Modules with messages; kernels have none."""
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PAGES = [*pages.pages(), ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
MODULE_NAMES = re.compile(r"benchmarks\.sweeps|test_sweeps\w+")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_pages(page: Path) -> None:
    assert retired(MODULE_NAMES.sub("", page.read_text(encoding="utf-8"))) == []


def test_messages_and_help() -> None:
    literals = [(path, *literal) for path in SOURCES for literal in messages_of(path)]
    literals += [
        (path, *literal) for path in SOURCES if path.parent.name == "app" for literal in strings_of(path)
    ]
    literals += [(path, *literal) for path in EXAMPLES for literal in strings_of(path)]
    assert len(literals) > 1000
    found = [f"{path.name}:{line} {word}" for path, line, text in literals for word in retired(text)]
    assert found == []


def test_public_docstrings_and_names() -> None:
    found = [f"{name}: {word}" for name, text in public_docstrings() for word in retired(text)]
    names = [name for name, _ in public_docstrings()]
    names += [f"{name}({argument})" for name, argument in public_arguments()]
    assert len(names) > 300
    found += [name for name in names if retired(re.sub(r"[_.()]", " ", name))]
    assert found == []


PLAIN = ("_compile", "_numeric", "app", "geometry", "robot", "scene/_kernels", "studies", "visual")
"""Packages whose private docstrings and comments are checked too."""


@pytest.mark.parametrize("package", PLAIN)
def test_private_docstrings_and_comments(package: str) -> None:
    found = []
    for path in sorted((ROOT / "src" / "pinimpact" / package).rglob("*.py")):
        texts = [text for _, text in strings_of(path)] + [comments_of(path)]
        words = [word for text in texts for word in retired(text)]
        found += [f"{path.name}: {word}" for word in words if package != "_numeric" or "pivots" not in word]
    assert found == []


def test_scene_files_and_notebooks() -> None:
    for path in sorted((ROOT / "examples").rglob("*.toml")):
        assert retired(path.read_text(encoding="utf-8")) == [], path.name
    for path in sorted((ROOT / "examples").rglob("*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        assert retired(" ".join("".join(cell["source"]) for cell in cells)) == [], path.name


@pytest.mark.parametrize(
    "text", ["Slip goes on.", "It is told ahead.", "a rejected\nimpulse, made anew", "Of which two are left"]
)
def test_a_retired_word_is_found(text: str) -> None:
    assert len(retired(text)) == 1
