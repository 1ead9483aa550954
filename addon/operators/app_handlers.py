"""Registration of functions that Blender calls when something happens, `bpy.app.handlers`."""

from collections.abc import Callable, Iterable
from typing import Any

import bpy

Handlers = Iterable[tuple[str, Callable[..., Any]]]  # names of lists of handlers, and functions to be called


def add_handlers(handlers: Handlers) -> None:
    """Let Blender call `handlers`."""
    for name, handler in handlers:
        getattr(bpy.app.handlers, name).append(handler)


def remove_handlers(handlers: Handlers) -> None:
    """Undo `add_handlers`."""
    for name, handler in handlers:
        registered = getattr(bpy.app.handlers, name)
        if handler in registered:  # another add-on may have cleared the list
            registered.remove(handler)
