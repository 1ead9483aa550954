"""Blender's glTF exporter: its add-on is enabled meanwhile, it prints nothing, and its errors are errors of Farfield."""

import io
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path

import addon_utils
import bpy

from ..core.errors import FileError
from .blender import error_sentence

GLTF = "io_scene_gltf2"  # Blender's add-on


def export_gltf(path: Path, options: Mapping[str, object]) -> None:
    """Let Blender's exporter write `path` without animations. options: of its operator.

    Raises:
        FileError: it cannot write an image or the file.
    """
    errors = io.StringIO()
    with enabled_gltf(), redirect_stdout(io.StringIO()), redirect_stderr(errors):
        try:
            bpy.ops.export_scene.gltf(filepath=str(path), export_animations=False, **options)
        except RuntimeError as error:  # raised by Blender
            raise FileError(f"Blender's glTF exporter failed: {error_sentence(error)}.") from error
    messages = [line.partition("ERROR: ")[2] for line in errors.getvalue().splitlines() if "ERROR: " in line]
    if messages:  # such as an image that it could not write
        raise FileError(f"Blender's glTF exporter failed: {messages[-1]}. Free disk space and try again.")


@contextmanager
def enabled_gltf() -> Iterator[None]:
    """Enable Blender's add-on for glTF meanwhile."""
    was_enabled = addon_utils.check(GLTF)[1]
    if not was_enabled:
        addon_utils.enable(GLTF)
    try:
        yield
    finally:
        if not was_enabled:
            addon_utils.disable(GLTF)


@contextmanager
def finite_properties(owners: Mapping[bpy.types.ID, str]) -> Iterator[dict[str, list[str]]]:
    """Remove custom properties with numbers that are not finite meanwhile: JSON, and thus glTF, cannot store them.

    owners: data-blocks and what messages call them. Yields the names of the properties by what their owners are called.
    """
    removed: dict[bpy.types.ID, dict[str, object]] = {}
    for owner in owners:
        values = {key: _copy_value(value) for key, value in owner.items()}
        removed[owner] = {key: value for key, value in values.items() if not _is_finite(value)}
        for key in removed[owner]:
            del owner[key]
    try:
        lacking: dict[str, list[str]] = {}
        for owner, properties in removed.items():
            lacking.setdefault(owners[owner], []).extend(properties)
        yield lacking
    finally:
        for owner, properties in removed.items():
            for key, value in properties.items():
                owner[key] = value


def _copy_value(value: object) -> object:
    """Return the value of a custom property as Python's own types."""
    return value.to_dict() if hasattr(value, "to_dict") else value.to_list() if hasattr(value, "to_list") else value


def _is_finite(value: object) -> bool:
    """Whether all numbers in `value` are finite."""
    if isinstance(value, (dict, list)):
        return all(_is_finite(item) for item in (value.values() if isinstance(value, dict) else value))
    return not isinstance(value, float) or math.isfinite(value)
