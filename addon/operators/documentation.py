"""The documentation, which is part of the packaged extension: pages for help buttons and for *Online Manual* in the context menu."""

from functools import cache
from pathlib import Path

import bpy

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ("distance", "billboards", "btf", "unwrap", "photos", "restore", "texmesh", "packages", "bdam", "clipbox")


@cache  # panels ask on every redraw
def find_page(page: str) -> str:
    """Return the URL of a page of the documentation, with a section after `#`: HTML in the packaged extension, Markdown in a checkout."""
    name, _, section = page.partition("#")
    path = ROOT / "manual" / f"{name}.html"
    if not path.exists():
        return (ROOT / "docs" / f"{name}.md").as_uri()
    return path.as_uri() + (f"#{section}" if section else "")


def manual_map() -> tuple[str, tuple[tuple[str, str], ...]]:
    """Return the prefix of all URLs and the URL of each operator pattern, as `bpy.utils.register_manual_map` expects them."""
    return "", tuple((f"bpy.ops.farfield.{tool}*", find_page(f"{tool}#operators")) for tool in TOOLS)


def register() -> None:
    """Connect *Online Manual* to the pages."""
    bpy.utils.register_manual_map(manual_map)


def unregister() -> None:
    """Undo `register`."""
    bpy.utils.unregister_manual_map(manual_map)
