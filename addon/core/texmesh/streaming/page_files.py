"""The page that shows a package: files that any static web server sends beside it."""

import re
from pathlib import Path

PAGE_FOLDER = Path(__file__).resolve().parent / "page"
PAGE_SUFFIXES = (".html", ".css", ".js")
COMMENT = re.compile(r"^[ \t]*(?://[^\n]*|/\*\*.*?\*/)\n", re.MULTILINE | re.DOTALL)


def read_page() -> dict[str, bytes]:
    """Return the files of the page by name, as small as they are sent: comments that have lines of their own, indentation and empty lines
    are left out."""
    paths = (path for path in sorted(PAGE_FOLDER.iterdir()) if path.suffix in PAGE_SUFFIXES)
    return {path.name: _shorten(path.read_text("utf-8"), path.suffix).encode() for path in paths}


def _shorten(text: str, suffix: str) -> str:
    if suffix == ".js":
        text = COMMENT.sub("", text)
    return "".join(f"{line.strip()}\n" for line in text.splitlines() if line.strip())
