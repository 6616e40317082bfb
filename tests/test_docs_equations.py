"""The equations of the pages: they are numbered as cited, typeset without error, and nothing is fetched."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tools import pages

ROOT, DOCS = pages.ROOT, pages.DOCS
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
LOADED = {"script": "src", "img": "src", "source": "src", "video": "src", "iframe": "src"}
"""Attributes by which an element loads a file; `link` does by `href` for some values of `rel`."""
URL = re.compile(r"(?:url\(|@import)\s*['\"]?((?:https?:)?//[^'\")]+)")


class Loaded(HTMLParser):
    """Collect what a page loads, and count its formulas."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.urls: list[str] = []
        self.formulas = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take one element."""
        values = {key: value or "" for key, value in attrs}
        if tag in LOADED:
            self.urls.append(values.get(LOADED[tag], ""))
        elif tag == "link" and set(values.get("rel", "").split()) & {"stylesheet", "preload", "icon"}:
            self.urls.append(values.get("href", ""))
        self.formulas += "arithmatex" in values.get("class", "").split()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the built site."""
    pytest.importorskip("mkdocs", reason="pip install pinimpact[docs] builds the site")
    pytest.importorskip("mkdocstrings", reason="pip install pinimpact[docs] builds the site")
    folder = tmp_path_factory.mktemp("site")
    command = [shutil.which("mkdocs") or "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)
    assert built.returncode == 0, built.stderr[-3000:]
    return folder


@pytest.mark.slow
def test_the_site_loads_nothing_from_elsewhere(site: Path) -> None:
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
def test_every_file_of_a_style_sheet_is_served(site: Path) -> None:
    sheet = site / "katex" / "katex.min.css"
    fonts = re.findall(r"url\(([^)]+)\)", sheet.read_text(encoding="utf-8"))
    assert len(fonts) == len(list((sheet.parent / "fonts").iterdir())) > 0
    assert all((sheet.parent / font).is_file() for font in fonts)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium renders the formulas; none is installed")
def test_every_formula_is_typeset(site: Path) -> None:
    with_formulas = {
        path: count
        for path in site.rglob("*.html")
        if (count := Loaded(path.read_text(encoding="utf-8")).formulas)
    }
    assert site / "theory" / "index.html" in with_formulas
    for path, count in with_formulas.items():
        dom = rendered(path)
        assert "katex-error" not in dom, re.findall(r'katex-error" title="([^"]+)"', dom)
        assert dom.count('<annotation encoding="application/x-tex">') == count, path


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium renders the formulas; none is installed")
def test_a_formula_with_an_error_is_noticed(site: Path) -> None:
    page = site / "theory" / "broken.html"
    text = (site / "theory" / "index.html").read_text(encoding="utf-8")
    wrong = '<span class="arithmatex">\\(\\nosuchcommand{1}\\)</span></article>'
    page.write_text(text.replace("</article>", wrong), encoding="utf-8")
    assert rendered(page).count('katex-error" title=') == 1
    page.unlink()


def rendered(page: Path) -> str:
    """Return the document of a page after its scripts have run."""
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=10000", "--dump-dom"]
    command = [str(CHROMIUM), *options, page.as_uri()]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return run.stdout
