"""Data-blocks found again by their session UID, which stays the same while a job runs, also when they are renamed."""

from collections.abc import Iterable

import bpy


def find_by_uid(data_blocks: Iterable[bpy.types.ID], session_uid: int) -> bpy.types.ID | None:
    """Return the one of `data_blocks`, such as `bpy.data.objects`, with this session UID; None if it was removed."""
    return next((data_block for data_block in data_blocks if data_block.session_uid == session_uid), None)
