"""Handlers that let clouds and levels find their originals, however these are renamed and moved between two sessions."""

from typing import Any

import bpy

from ..bridge.source_links import refresh_sources
from .follow_handlers import add_handlers, remove_handlers


@bpy.app.handlers.persistent
def _refresh(*_: Any) -> None:
    refresh_sources()


HANDLERS = (("save_pre", _refresh), ("load_post", _refresh))


def register() -> None:
    """Register the handlers."""
    add_handlers(HANDLERS)


def unregister() -> None:
    """Undo `register`."""
    remove_handlers(HANDLERS)
