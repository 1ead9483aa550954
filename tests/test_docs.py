"""The docs say what the code says, and what they point to is there."""

import re
import runpy
from pathlib import Path

import pytest

import environment

ROOT = environment.ROOT
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
LINK = re.compile(r"!?\[[^\]]*\]\(([^)#\s]+)(?:#[^)]*)?\)")
LARGEST_PICTURE, LARGEST_FOLDER = 400_000, 4_000_000  # bytes
with_tables = runpy.run_path(str(ROOT / "docs" / "tables.py"))["with_tables"]


def links(page: Path) -> list[str]:
    """What a page points to inside the checkout."""
    return [target for target in LINK.findall(page.read_text(encoding="utf-8")) if "://" not in target]


def pictures() -> list[Path]:
    return sorted((ROOT / "docs").rglob("*.png"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pictures_and_pages_that_are_named_exist(page):
    assert [target for target in links(page) if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("name", ["billboards.md", "btf.md", "clipbox.md", "unwrap.md"])
def test_tables_of_settings_are_those_of_the_core(name):
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    assert text.count("| `--") >= 10, "the table of settings is gone"
    assert with_tables(text) == text, "run `python3 docs/tables.py`"


def test_a_table_that_was_edited_by_hand_is_seen():
    text = (ROOT / "docs" / "billboards.md").read_text(encoding="utf-8")
    edited = text.replace("| `--error` | 1% |", "| `--error` | 2% |")
    assert edited != text and with_tables(edited) == text


def test_every_picture_is_named_and_light():
    named = {(page.parent / target).resolve() for page in PAGES for target in links(page)}
    assert [picture.name for picture in pictures() if picture.resolve() not in named] == []
    sizes = {picture.name: picture.stat().st_size for picture in pictures()}
    assert {name: size for name, size in sizes.items() if size > LARGEST_PICTURE} == {}
    assert sum(sizes.values()) <= LARGEST_FOLDER


def test_the_readme_opens_with_a_picture_and_two_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    picture, demo, tests = (text.index(words) for words in ("![", "python3 scripts/demo.py", "python3 scripts/test.py"))
    assert picture < demo < tests < text.index("\n## ")


def test_the_readme_names_every_tool_and_says_which_are_there():
    rows = dict(re.findall(r"^\| `(\w+)` \|(.*)\|$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE))
    there = {path.parent.name for path in (ROOT / "addon" / "core").glob("*/__init__.py")}
    assert there <= set(rows)
    assert {tool for tool, row in rows.items() if "not there yet" not in row} == there
