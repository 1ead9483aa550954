"""The source objects of what was built from them, found again after they were renamed.

A collection stores names and tokens, not pointers: linking a cloud or levels into another file must not link their sources, and a file
must not keep sources that the user has deleted. A local source object has the same token as a custom property. Duplicates of the object
copy it, so the token alone does not identify the source: its name, its place and its identity in this session do, which `refresh_sources`
stores again before a file is saved and after it was opened.
"""

import json
import math
import uuid
from collections.abc import Iterator, Sequence
from pathlib import PurePath
from typing import Any

import bpy

from ..core.json_values import parse_json

SOURCES = "farfield_sources"  # custom property of a collection: JSON list with one entry per source object
TOKEN = "farfield_source_token"  # custom property of a local source object


class SourceIndex:
    """All objects in the file by token or library. They are read on the first search, and only when a source has lost its name."""

    def __init__(self) -> None:
        self._objects: dict[tuple[str, ...], list[bpy.types.Object]] | None = None

    def find(self, key: tuple[str, ...]) -> list[bpy.types.Object]:
        """Return the objects with `key`: a token, or the name and the file name of a linked object."""
        if self._objects is None:
            self._objects = {}
            for item in bpy.data.objects:
                for item_key in _keys(item):
                    self._objects.setdefault(item_key, []).append(item)
        return self._objects.get(key, [])


def store_sources(collection: bpy.types.Collection, objects: Sequence[bpy.types.Object]) -> None:
    """Store the `objects` that the content of `collection` was built from."""
    collection[SOURCES] = json.dumps([_describe(item) for item in objects])


def find_sources(collection: bpy.types.Collection, index: SourceIndex) -> list[tuple[str, bpy.types.Object | None]]:
    """Return the stored name of each source object of `collection`, with the object, or None if it is not in the file."""
    return [(entry["name"], _find_source(entry, index)) for entry in _read_entries(collection)]


def refresh_sources() -> None:
    """Store the current name, place and identity of each local source object, so that it is found after it is renamed and moved."""
    index = SourceIndex()
    for collection in bpy.data.collections:
        if SOURCES in collection and collection.library is None and collection.override_library is None:
            entries = _read_entries(collection)
            found = [_find_source(entry, index) for entry in entries]
            current = [
                entry | _locate(item) if item is not None and "token" in entry else entry
                for entry, item in zip(entries, found, strict=True)
            ]
            if current != entries:
                collection[SOURCES] = json.dumps(current)


def _locate(item: bpy.types.Object) -> dict[str, Any]:
    return {"name": item.name, "uid": item.session_uid, "matrix": _matrix(item)}


def _describe(item: bpy.types.Object) -> dict[str, Any]:
    """Return the entry of a source object, and give it a token. Linked objects and library overrides cannot keep one."""
    library_key = _library_key(item)
    if library_key is not None:
        return {"name": item.name, "library": list(library_key)}
    if not (isinstance(item.get(TOKEN), str) and _is_known_source(item)):  # a duplicate of a source becomes a source of its own
        item[TOKEN] = uuid.uuid4().hex
    return {"token": item[TOKEN], **_locate(item)}


def _is_known_source(item: bpy.types.Object) -> bool:
    """Return whether anything was built from `item` before."""
    index = SourceIndex()
    return any(item == source for collection in bpy.data.collections for _, source in find_sources(collection, index))


def _read_entries(collection: bpy.types.Collection) -> list[dict[str, Any]]:
    """Return the stored entries; files from elsewhere can hold anything."""
    text = collection.get(SOURCES)
    try:
        entries = parse_json(text) if isinstance(text, str) else []
    except ValueError:
        return []
    entries = entries if isinstance(entries, list) else []
    return [entry for entry in entries if isinstance(entry, dict) and isinstance(entry.get("name"), str) and _entry_key(entry) is not None]


def _entry_key(entry: dict[str, Any]) -> tuple[str, ...] | None:
    if isinstance(entry.get("token"), str):
        return (entry["token"],)
    library = entry.get("library")
    return tuple(library) if isinstance(library, list) and len(library) == 2 and all(isinstance(part, str) for part in library) else None


def _find_source(entry: dict[str, Any], index: SourceIndex) -> bpy.types.Object | None:
    """Return the source object that `entry` describes.

    Another object may have its name by now, and duplicates have its token. An object with another name is the source if it is the same
    data-block of this session, or if it is still where it was then.
    """
    key, name = _entry_key(entry), entry["name"]
    named = bpy.data.objects.get(name)
    if named is not None and key in _keys(named):
        return named
    candidates = index.find(key)
    for candidate in candidates:
        if "library" in entry or candidate.name == name or candidate.session_uid == entry.get("uid"):
            return candidate
    in_place = [candidate for candidate in candidates if _is_close(_matrix(candidate), entry.get("matrix"))]
    return min(in_place, key=lambda item: item.session_uid, default=None)  # the original is older than its duplicates


def _keys(item: bpy.types.Object) -> Iterator[tuple[str, ...]]:
    """Yield the keys of `item` in a `SourceIndex`."""
    token, library_key = item.get(TOKEN), _library_key(item)
    if isinstance(token, str):
        yield (token,)
    if library_key is not None:
        yield library_key


def _library_key(item: bpy.types.Object) -> tuple[str, str] | None:
    """Return the name and the file name of the linked object that `item` is or overrides; None for a local object."""
    linked = item if item.override_library is None else item.override_library.reference
    if linked is None or linked.library is None:
        return None
    return linked.name, PurePath(linked.library.filepath.replace("\\", "/")).name


def _matrix(item: bpy.types.Object) -> list[float]:
    """Return the transform from location, rotation and scale; Blender does not compute world matrices of hidden objects."""
    return [value for row in item.matrix_basis for value in row]


def _is_close(matrix: list[float], stored: Any) -> bool:
    if not (isinstance(stored, list) and len(stored) == 16 and all(isinstance(value, int | float) for value in stored)):
        return False
    return all(math.isclose(first, second, rel_tol=1e-5, abs_tol=1e-6) for first, second in zip(matrix, stored, strict=True))
