"""The pages of docs/ as HTML, which the packaged extension contains for its help buttons."""

import re
import shutil
from pathlib import Path

import markdown

STYLE = """
body { max-width: 60em; margin: 2em auto; padding: 0 1em; font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; }
img { max-width: 100%; } table { border-collapse: collapse; } th, td { border: 1px solid #ccc; padding: .2em .6em; text-align: left; }
pre { background: #f4f4f4; padding: .8em; overflow-x: auto; } code { background: #f4f4f4; }
"""
PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{style}</style></head>
<body>
{body}
</body></html>
"""
LINK = re.compile(r"(\]\((?!\w+:)[^)\s#]+)\.md(#[^)\s]*)?\)")


def convert_page(text: str) -> str:
    """Return a Markdown page as HTML. Links to other pages lead to their HTML."""
    title = next((line.removeprefix("# ") for line in text.splitlines() if line.startswith("# ")), "Farfield")
    body = markdown.markdown(LINK.sub(r"\1.html\2)", text), extensions=["tables", "fenced_code", "toc"], output_format="html")
    return PAGE.format(title=title, style=STYLE, body=body)


def write_pages(source: Path, target: Path) -> None:
    """Write all pages below `source` as HTML to `target`, and copy their images."""
    for page in sorted(source.rglob("*.md")):
        path = target / page.relative_to(source).with_suffix(".html")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(convert_page(page.read_text(encoding="utf-8")), encoding="utf-8")
    shutil.copytree(source / "pictures", target / "pictures")
