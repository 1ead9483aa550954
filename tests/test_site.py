"""The docs as a site: every page is in its navigation, and it loads nothing from elsewhere."""

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

import programs
from chromium import SKIP_REASON, run_chromium
from lib import environment

ROOT = environment.ROOT
LOADED = re.compile(
    r'<(?:script|img|iframe|source)\b[^>]*\bsrc="([^"]+)"|<link\b[^>]*rel="stylesheet"[^>]*href="([^"]+)"|<link\b[^>]*href="([^"]+)"[^>]*rel="stylesheet"'
)
EXAMPLES = {"https://example.org/model/index.html"}  # In code that a page shows.

pytestmark = pytest.mark.once


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The folder of the site."""
    if programs.find_mkdocs() is None:
        pytest.skip("needs MkDocs, which `python3 scripts/build_docs.py` installs")
    folder = tmp_path_factory.mktemp("Füße") / "site"
    command = [sys.executable, str(ROOT / "scripts" / "build_docs.py"), "--out", str(folder)]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    return folder


def test_every_page_is_in_the_navigation():
    listed = re.findall(r"([\w/-]+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    pages = [page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")]
    assert sorted(listed) == sorted([*pages, "index.md", "changelog.md", "contributing.md"])


@pytest.mark.slow
def test_pages_load_files_of_the_site_only(site):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    for page in pages:
        loaded = {source for sources in LOADED.findall(page.read_text(encoding="utf-8")) for source in sources if source}
        missing = [source for source in loaded - EXAMPLES if not (page.parent / source.partition("?")[0]).is_file()]
        assert not missing or page.name == "404.html", page


@pytest.mark.slow
def test_search_works_without_a_server(site, tmp_path):
    if programs.find_chromium() is None:
        pytest.skip(SKIP_REASON)
    with run_chromium(tmp_path) as page:
        page.open((site / "glossary.html").as_uri())
        wait_for(page, "document.querySelector('iframe') !== null")
        page.evaluate("document.querySelector('[data-md-toggle=search]').click()")
        page.evaluate(
            "(input => { input.value = 'transparent bounces'; input.dispatchEvent(new KeyboardEvent('keyup', {bubbles: true})) })"
            "(document.querySelector('[data-md-component=search-query]'))"
        )
        found = "[...document.querySelectorAll('.md-search-result__link')].some(link => link.href.includes('render-farms.html'))"
        wait_for(page, found)
        assert not [url for url in page.requests if not url.startswith(("file:", "data:"))]


def wait_for(page, condition: str) -> None:
    started = time.monotonic()
    while not page.evaluate(condition):
        assert time.monotonic() - started < 60.0, condition
        time.sleep(0.05)


def test_a_folder_with_other_files_is_left_unchanged(tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work")
    command = [sys.executable, str(ROOT / "scripts" / "build_docs.py"), "--out", str(tmp_path)]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 2 and "contains other files" in outcome.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]
