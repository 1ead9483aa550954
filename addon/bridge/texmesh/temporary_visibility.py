"""Levels that are shown for a while: what was shown before is stored in the objects, so that undo, saving and other files keep it.

Only 3D Viewports are affected, except that a cross-fade is suspended in renders, too, until the state is restored.
"""

from collections.abc import Iterable, Sequence

import bpy

from ..geometry.mesh_pool import is_local
from ..lod_crossfade import ALWAYS, CROSSFADE

STATE = "farfield_texmesh_shown"  # whether the object was hidden in viewports, followed by its cross-fade if it has one


def show_temporarily(levels: Sequence[bpy.types.Object], number: int, source: bpy.types.Object | None) -> None:
    """Show one of the `levels` in viewports, and hide the others and their source. Objects from libraries stay as they are."""
    wanted = [(item, index != number) for index, item in enumerate(levels)]
    for item, is_hidden in [*wanted, *([] if source is None else [(source, True)])]:
        if not is_local(item):
            continue
        _store_state(item)
        if item.hide_viewport != is_hidden:
            item.hide_viewport = is_hidden
        if CROSSFADE in item and item[CROSSFADE][0] != ALWAYS[0]:
            _set_crossfade(item, *ALWAYS)


def restore(items: Iterable[bpy.types.Object | None]) -> int:
    """Let objects be visible as before, and return how many had been changed."""
    changed = [item for item in items if item is not None and STATE in item and is_local(item)]
    for item in changed:
        state = list(item[STATE]) if hasattr(item[STATE], "__len__") else []
        if state and all(isinstance(value, float) for value in state):
            item.hide_viewport = bool(state[0])
            if len(state) == 3 and CROSSFADE in item:
                _set_crossfade(item, *state[1:])
        del item[STATE]
    return len(changed)


def resume_crossfades(items: Iterable[bpy.types.Object]) -> None:
    """Let the cross-fades of objects be as before, for a render. Custom properties keep their place in memory."""
    for item in items:
        if STATE in item and CROSSFADE in item and is_local(item) and len(item[STATE]) == 3:
            item[CROSSFADE][0], item[CROSSFADE][1] = item[STATE][1], item[STATE][2]


def _store_state(item: bpy.types.Object) -> None:
    if STATE not in item:
        crossfade = list(item[CROSSFADE])[:2] if CROSSFADE in item else []
        item[STATE] = [float(item.hide_viewport), *map(float, crossfade)]


def _set_crossfade(item: bpy.types.Object, start: float, end: float) -> None:
    item[CROSSFADE][0], item[CROSSFADE][1] = start, end
    item.update_tag()
