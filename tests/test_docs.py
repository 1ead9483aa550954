"""The docs agree with the code, and their links and images exist."""

import re
import runpy
from pathlib import Path

import pytest

from lib import environment

ROOT = environment.ROOT
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"!?\[(?:[^\[\]]|\[[^\]]*\])*\]\(([^)#\s]*)(#[^)]*)?\)|!\[[^\]]*\]\(([^)#\s]+)\)")
IMAGE_SUFFIXES = {".png", ".gif", ".webp"}
MAX_IMAGE_BYTES, MAX_FOLDER_BYTES, MIN_IMAGES = 400_000, 6_000_000, 15
SECTIONS = ["Overview", "Quick Start", "Settings", "Operators", "Command Line", "Tips", "Limitations", "Output", "How It Works"]
update_tables = runpy.run_path(str(ROOT / "docs" / "tables.py"))["update_tables"]


def tools() -> list[str]:
    """The tools that exist."""
    return sorted(path.parent.name for path in (ROOT / "addon" / "core").glob("*/settings.py"))


def anchors(page: Path) -> set[str]:
    """The anchors of the headings of `page`."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def links(page: Path) -> list[tuple[str, str]]:
    """Path and anchor of the links of `page` that stay inside the checkout."""
    found = [(path or image, anchor.removeprefix("#")) for path, anchor, image in LINK.findall(page.read_text(encoding="utf-8"))]
    return [(path, anchor) for path, anchor in found if "://" not in path]


def images() -> list[Path]:
    """All images of the docs."""
    return sorted(path for path in (ROOT / "docs").rglob("*") if path.suffix in IMAGE_SUFFIXES)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    broken = []
    for path, anchor in links(page):
        target = page.parent / path if path else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            broken.append(f"{path}#{anchor}")
    assert not broken


@pytest.mark.parametrize("tool", tools())
def test_tables_of_settings_match_the_core(tool):
    text = (ROOT / "docs" / f"{tool}.md").read_text(encoding="utf-8")
    assert text.count("| `--") >= 5, "the table of settings is missing"
    assert update_tables(text) == text, "run `python3 docs/tables.py`"


def test_a_table_edited_by_hand_is_noticed():
    text = (ROOT / "docs" / "billboards.md").read_text(encoding="utf-8")
    edited = text.replace("| 1% |", "| 2% |")
    assert edited != text and update_tables(edited) == text


@pytest.mark.parametrize("tool", tools())
def test_pages_of_tools_have_all_sections_in_order(tool):
    headings = re.findall(r"^## (.*)$", (ROOT / "docs" / f"{tool}.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert [heading for heading in headings if heading in SECTIONS] == SECTIONS
    assert (ROOT / "docs" / "results" / f"{tool}.md").exists()


def test_every_image_is_used_and_small():
    used = {(page.parent / path).resolve() for page in PAGES for path, _ in links(page) if path}
    assert [image.name for image in images() if image.resolve() not in used] == []
    sizes = {image.name: image.stat().st_size for image in images()}
    assert len(sizes) >= MIN_IMAGES
    assert {name: size for name, size in sizes.items() if size > MAX_IMAGE_BYTES} == {}
    assert sum(sizes.values()) <= MAX_FOLDER_BYTES


def test_the_readme_serves_users_first_and_contributors_with_two_commands():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    parts = [
        text.index(part)
        for part in (
            "![",
            "\n## Install",
            "\n## Tools",
            "\n## Try It from a Checkout\n```\npython3 scripts/demo.py\npython3 scripts/test.py\n```",
        )
    ]
    assert parts == sorted(parts)


def test_the_readme_lists_every_tool_and_the_roadmap_the_others():
    sections = (ROOT / "README.md").read_text(encoding="utf-8").split("\n## ")
    table, roadmap = (next(section for section in sections if section.startswith(title)) for title in ("Tools", "Roadmap"))
    assert set(re.findall(r"\) `(\w+)` \|", table)) == set(tools())
    assert set(re.findall(r"^\| `(\w+)` \|", roadmap, re.MULTILINE)) == {"restore", "photos", "bdam", "texmesh"} - set(tools())


def test_names_of_data_in_files_are_those_of_the_code():
    page = (ROOT / "docs" / "data.md").read_text(encoding="utf-8")
    code = "\n".join(path.read_text(encoding="utf-8") for path in sorted((ROOT / "addon").rglob("*.py")))
    written = set(re.findall(r"`(farfield_\w+|Farfield [\w-]+)`", page))
    stems = {name.rstrip("0123456789") for name in written}
    of_every_terrain = {stem: re.sub("_(bdam|clipbox)_", "_{tool}_", stem) for stem in stems}
    assert sorted(stem for stem in stems if stem not in code and of_every_terrain[stem] not in code) == []
    assert len(written) > 30
