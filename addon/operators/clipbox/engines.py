"""The engines of terrains, created from settings as they are stored."""

from dataclasses import replace

import bpy

from ...bridge.clipbox.sources import READERS, absolute_path
from ...core.clipbox.engine import TerrainEngine
from ...core.clipbox.settings import ClipboxSettings


def create_engine(settings: ClipboxSettings, closed: bool = False, library: bpy.types.Library | None = None) -> TerrainEngine:
    """Create an engine for a new terrain; `closed` adds walls at the boundary of the outermost box.

    library: the file that the settings are linked from, None for this file.

    Raises:
        SettingsError, FileError: the formula or the source file cannot be read.
    """
    return TerrainEngine(resolve_paths(settings, library), READERS, closed)


def resolve_paths(settings: ClipboxSettings, library: bpy.types.Library | None = None) -> ClipboxSettings:
    """Return settings whose source path does not depend on the .blend file ("//") or on the current folder."""
    return replace(settings, source=absolute_path(settings.source, library)) if settings.source else settings
