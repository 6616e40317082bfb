"""Equations of the pages: cited numbers exist, formulas are typeset without error, nothing is downloaded."""

from __future__ import annotations

import ast
import functools
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import NamedTuple

import pytest

from pinimpact._numeric import coulomb_problem
from pinimpact.contact_space import jam_growth
from pinimpact.contact_space._kernels import tolerances as many
from pinimpact.scene import alternating, crowds, instant, integrator, progress, scene_impacts
from pinimpact.scene._kernels import contact_modes, slip, tolerances
from tools import pages

ROOT, DOCS = pages.ROOT, pages.DOCS
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
LOADED = {"script": "src", "img": "src", "source": "src", "video": "src", "iframe": "src"}
"""Attributes by which elements load a file; `link` does so by `href` for some values of `rel`."""
URL = re.compile(r"(?:url\(|@import)\s*['\"]?((?:https?:)?//[^'\")]+)")

SECTIONS = 16
CITED = re.compile(r"(?<![\w\])])\((\d{1,2}\.\d{1,2}(?:(?:, | and |–)\(?\d{1,2}\.\d{1,2}\)?)*)\)?")
"""Numbers of equations in parentheses, (3.7) or (10.1)–(10.5), not after the name of a function."""


class Loaded(HTMLParser):
    """Collect the URLs that a page loads, and count its formulas."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.urls: list[str] = []
        self.formulas = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Process the start of an element."""
        values = {key: value or "" for key, value in attrs}
        if tag in LOADED:
            self.urls.append(values.get(LOADED[tag], ""))
        elif tag == "link" and set(values.get("rel", "").split()) & {"stylesheet", "preload", "icon"}:
            self.urls.append(values.get("href", ""))
        self.formulas += "arithmatex" in values.get("class", "").split()


def numbers_of(text: str) -> set[str]:
    """Return the numbers of equations that a text cites."""
    found = {number for cited in CITED.findall(text) for number in re.findall(r"\d+\.\d+", cited)}
    return {number for number in found if 1 <= int(number.split(".")[0]) <= SECTIONS}


@functools.cache
def prose_of(path: Path) -> str:
    """Return the docstrings and comments of a module, or a page without its blocks of code."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return re.sub(r"`[^`\n]*`", "", pages.FENCE.sub("", text))
    lines = text.splitlines()
    strings = []
    nodes: list[ast.AST] = [ast.parse(text)]
    for node in nodes:  # statements only, since strings within expressions are no docstrings
        for statement in getattr(node, "body", []):
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                strings.append("\n".join(lines[statement.lineno - 1 : statement.end_lineno]))
            nodes.append(statement)
    comments = [line.partition("# ")[2] for line in lines]
    return "\n".join([*strings, *comments])


def test_cited_equations_exist() -> None:
    theory = (DOCS / "theory.md").read_text(encoding="utf-8")
    tags = re.findall(r"\\tag\{([\d.]+)\}", theory)
    assert len(tags) == len(set(tags)) > 90
    places = [*DOCS.rglob("*.md"), *(ROOT / "src").rglob("*.py"), *(ROOT / "tests").glob("*.py")]
    cited = {str(path): numbers_of(prose_of(path)) for path in places}
    assert len(set().union(*cited.values())) > 60  # the search has found them
    missing = {name: numbers - set(tags) for name, numbers in cited.items() if numbers - set(tags)}
    assert missing == {}


def test_cited_equations_of_derivatives_exist_once() -> None:
    page = (DOCS / "derivatives.md").read_text(encoding="utf-8")
    tags = re.findall(r"\\tag\{(D\d+)\}", page)
    assert len(tags) == len(set(tags)) > 30
    places = [*DOCS.rglob("*.md"), *(ROOT / "src").rglob("*.py"), *(ROOT / "tests").glob("*.py")]
    cited = {number for path in places for number in re.findall(r"\b(D\d{1,2})\b", prose_of(path))}
    assert {number for number in cited if int(number[1:]) >= 3} <= set(tags)


def test_equations_are_in_their_sections() -> None:
    theory = (DOCS / "theory.md").read_text(encoding="utf-8")
    sections = re.split(r"^## (\d+)\. ", theory, flags=re.MULTILINE)[1:]
    assert [int(number) for number in sections[::2]] == list(range(1, SECTIONS + 1))
    for number, text in zip(sections[::2], sections[1::2], strict=True):
        assert {tag.split(".")[0] for tag in re.findall(r"\\tag\{([\d.]+)\}", text)} <= {number}


def test_cited_sections_exist() -> None:
    theory = (DOCS / "theory.md").read_text(encoding="utf-8")
    headings = set(re.findall(r"^###? (\d+(?:\.\d+)?)\.? ", theory, re.MULTILINE))
    cited: set[str] = set()
    for path in (ROOT / "src").rglob("*.py"):
        for text in re.findall(r"theory\.md,\s+(?:sections? )?([^)]*)", prose_of(path)):
            cited |= set(re.findall(r"(?<![(.])\b\d+(?:\.\d+)?\b", text.split(".\n")[0]))
    assert len(cited) > 10
    assert cited <= headings


NUMBERS = [
    (contact_modes.ROUNDS, 4, "repeated, up to four times"),
    (tolerances.STILL, 1e-3, "below $10^{-3}$ of the sticking speed"),
    (coulomb_problem.USABLE, 1e-10, "up to a residual of $10^{-10}$ of the largest load"),
    (tolerances.ROUNDED, 1e-11, r"$\varepsilon = 10^{-11}$ if the forces are unique"),
    (tolerances.NEGLIGIBLE, 1e-9, "and $10^{-9}$ otherwise"),
    (coulomb_problem.UNDETERMINED, 1e-9, r"is singular, of $10^{-9}$"),
    (coulomb_problem.QUICK, 0.2, "reduces the change of the forces to no less than a fifth"),
    (1.0 / coulomb_problem.FINER, 10.0, "and multiplied by ten where Newton's method fails"),
    (tolerances.SINGULAR_STILL, 1e-7, "is decided at $10^{-7}$ of its largest pivot"),
    (tolerances.NEGLIGIBLE, 1e-9, "a residual above $10^{-9}$"),
    (tolerances.FINEST, 1e-13, "else at $10^{-13}$"),
    (slip.CERTAIN, 10.0, r"\le 10\,\eta"),
    (instant.STICK_FRACTION, 0.1, "the sticking speed (a tenth of the resting speed)"),
    (tolerances.SINGULAR, 2.0**-26, "effects on the normals cancel to $2^{-26}$"),
    (instant.CLEAR, 10.0, "is less than ten times that fraction"),
    (tolerances.NEARLY_SINGULAR, 1e-4, r"or $s^* < 1 + 10^{-4}$ where the determinant"),
    (instant.MOST_JAMS, 10, "after ten such impacts at one instant"),
    (tolerances.NEARLY_SINGULAR, 1e-4, "The fraction is $10^{-4}$ where steps make no progress"),
    (progress.MAX_STALLED, 200, "where 200 steps make no progress"),
    (tolerances.STEPS_GAIN, 1e-4, "add more than $10^{-4}$ of the kinetic energy of $v$"),
    (crowds.CROWD, 16, "an impact has more than 16 contacts and waves"),
    (crowds.MANY, 40, "more than 40 contacts of several robots are active"),
    (crowds.AS_CHEAP, 10.0, "as long as $(n/10)^3$ time steps"),
    (alternating.LOOKED_AT, 50, "as cost 50 time steps"),
    (alternating.CHEAP, 0.1, "below a tenth of a time step"),
    (crowds.FEW, 8, "is used for at most 8 contacts and not for impacts without collision"),
    (integrator.SEEN_EVERY, 0.25, r"no step is longer than $\sqrt{L/g}/4$"),
    (many.NUDGE, 2.0**-26, r"\max\bigl(2^{-26}\,|v_t|"),
    (many.LEAST_NUDGE, 0.1 * 2.0**-26, r"\tfrac1{10}2^{-26}\max|v_t|"),
    (scene_impacts.GROWN, 100.0, r"stays below $100\,\varepsilon$"),
    (jam_growth.MOST_CHOSEN, 12, "subsets $a$ of up to twelve contacts"),
    (progress.GAINED, 10.0, r"$10\,(\mathrm{rtol} + \mathrm{atol}/|v|)$ of the kinetic energy"),
]
"""Constants of the code, and their places in the theory page."""


@pytest.mark.parametrize(("constant", "written", "sentence"), NUMBERS)
def test_constants_of_theory_and_code_agree(constant: float, written: float, sentence: str) -> None:
    text = " ".join((DOCS / "theory.md").read_text(encoding="utf-8").split())
    assert constant == written
    assert sentence in text


def test_glossary_is_sorted_with_links() -> None:
    text = (DOCS / "glossary.md").read_text(encoding="utf-8")
    entries = re.findall(r"^(\S.*)\n:   ((?:.+\n)+)", text, re.MULTILINE)
    terms = [term.lower() for term, _ in entries]
    assert terms == sorted(terms)
    wanted = (
        "delassus matrix",
        "hodograph",
        "invariant direction",
        "island",
        "jam",
        "locked (by friction)",
        "patch",
    )
    assert {*wanted, "normal impulse", "restitution law", "slip", "stick", "release"} <= set(terms)
    assert [term for term, entry in entries if not re.search(r"\]\([a-z-]+\.md", entry)] == []


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the built site."""
    pytest.importorskip("mkdocs", reason="pip install pinimpact[docs] builds the site")
    pytest.importorskip("mkdocstrings", reason="pip install pinimpact[docs] builds the site")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    assert built.returncode == 0, built.stderr[-3000:]
    return folder


@pytest.mark.slow
def test_site_loads_no_external_files(site: Path) -> None:
    found = [
        (path.relative_to(site).as_posix(), url)
        for path in site.rglob("*.html")
        for url in Loaded(path.read_text(encoding="utf-8")).urls
        if url.startswith(("http:", "https:", "//"))
    ]
    found += [
        (path.relative_to(site).as_posix(), url)
        for path in site.rglob("*.css")
        for url in URL.findall(path.read_text(encoding="utf-8"))
    ]
    assert found == []


@pytest.mark.slow
def test_files_of_style_sheets_are_in_the_site(site: Path) -> None:
    sheet = site / "katex" / "katex.min.css"
    fonts = re.findall(r"url\(([^)]+)\)", sheet.read_text(encoding="utf-8"))
    assert len(fonts) == len(list((sheet.parent / "fonts").iterdir())) > 0
    assert all((sheet.parent / font).is_file() for font in fonts)


ARTICLE = re.compile(r"(<article[^>]*>)(.*?)(</article>)", re.DOTALL)


OVERLAPS = """<script>
window.addEventListener("load", () => {
  const found = [];
  for (const formula of document.querySelectorAll(".measured .katex-display")) {
    const tag = formula.querySelector(".tag");
    const parts = [...formula.querySelectorAll(".katex-html > .base")];
    const right = Math.max(...parts.map((part) => part.getBoundingClientRect().right));
    const end = tag ? tag.getBoundingClientRect().left : formula.getBoundingClientRect().right;
    const wide = right > end || formula.scrollWidth > formula.clientWidth + 1;
    if (wide) found.push(formula.textContent.slice(0, 60));
  }
  const list = document.createElement("pre");
  list.id = "overlaps";
  list.textContent = found.join("\\n");
  document.body.append(list);
});
</script></body>"""
"""Script that appends to a page its measured formulas that are too wide."""

WRONG = [
    '<span class="arithmatex">\\(\\nosuchcommand{1}\\)</span>',
    '<div class="measured"><div class="arithmatex">\\[' + "x+" * 80 + "x \\tag{0}\\]</div></div>",
]
"""A formula with an error, and one that is too wide."""


class Shown(NamedTuple):
    dom: str  # of a page with the content of all pages that have formulas, and the wrong ones
    formulas: int  # without the wrong ones
    pages: int


@pytest.fixture(scope="module")
def shown(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Shown:
    """Render all pages with formulas as one, since each start of a browser takes seconds."""
    if CHROMIUM is None:
        pytest.skip("Chromium renders the formulas; none is installed")
    contents, count = [], 0
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        if formulas := Loaded(text).formulas:
            assert re.search(r'<script src="[./]*katex/render.js"', text), path
            (article,) = ARTICLE.findall(text)
            assert Loaded(article[1]).formulas == formulas, path
            measured = path.parent.name == "theory"
            contents.append(f'<div class="measured">{article[1]}</div>' if measured else article[1])
            count += formulas
    text = (site / "theory" / "index.html").read_text(encoding="utf-8")
    text = ARTICLE.sub(lambda found: found[1] + "".join(contents + WRONG) + found[3], text)
    page = site / "theory" / "all.html"
    page.write_text(text.replace("</body>", OVERLAPS), encoding="utf-8")
    dom = rendered(page, tmp_path_factory.mktemp("profile"))
    page.unlink()
    return Shown(dom, count, len(contents))


@pytest.mark.slow
def test_formulas_are_typeset(shown: Shown) -> None:
    """All but the one with an error."""
    assert shown.pages > 2
    (error,) = re.findall(r'katex-error" title="([^"]+)"', shown.dom)
    assert "nosuchcommand" in error
    wide = 1
    assert shown.dom.count('<annotation encoding="application/x-tex">') == shown.formulas + wide


@pytest.mark.slow
def test_formulas_do_not_overlap_their_numbers(shown: Shown) -> None:
    """None of the theory page, but the one that is too wide."""
    found = re.search(r'<pre id="overlaps">(.*?)</pre>', shown.dom, re.DOTALL)
    assert found is not None
    assert re.fullmatch(r"[x+]+", found[1]), found[1]


def rendered(page: Path, profile: Path) -> str:
    """Return the document of a page after its scripts have run, in a browser with a separate profile."""
    options = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--virtual-time-budget=10000",
        "--window-size=1300,2000",
        "--dump-dom",
    ]
    command = [str(CHROMIUM), *options, f"--user-data-dir={profile}", page.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return run.stdout
