"""The voxels of the terrains that stand in the file, kept between two moves; made anew from the settings where they are missing."""

from dataclasses import replace

import bpy
import numpy as np

from ..bridge import terrain_sources  # noqa: F401 - it lets terrains be read from pictures and .vdb files
from ..bridge.terrain_objects import StandingTerrain
from ..core.clipbox.settings import ClipboxSettings
from ..core.clipbox.terrain import Terrain

_engines: dict[str, Terrain] = {}


def engine_of(standing: StandingTerrain) -> Terrain:
    """The voxels of a terrain that stands in the file.

    Raises:
        SettingsError, FileError: when its settings, its formula or its file cannot be read.
    """
    settings = _with_whole_paths(standing.settings)
    engine = _engines.get(standing.name)
    if engine is None or engine.settings != settings:
        engine = Terrain(settings)
        _engines[standing.name] = engine
    return engine


def new_engine(settings: ClipboxSettings, closed: bool = False) -> Terrain:
    """Voxels for a terrain that is to be made, with walls at the border of the outermost box where it is `closed`.

    Raises:
        SettingsError, FileError: when its formula or its file cannot be read.
    """
    return Terrain(_with_whole_paths(settings), closed)


def _with_whole_paths(settings: ClipboxSettings) -> ClipboxSettings:
    """Paths may be relative to the .blend file, as `//` at their beginning tells."""
    return replace(settings, source=bpy.path.abspath(settings.source)) if settings.source else settings


def keep(standing: StandingTerrain, engine: Terrain) -> None:
    """Use `engine`, which has made what is shown of a terrain, for its next moves."""
    _engines[standing.name] = engine


def is_shown_about(standing: StandingTerrain, viewer: np.ndarray) -> bool:
    """Whether what is shown of a terrain is what a move to `viewer` (3,) would show; needs no voxels."""
    return Terrain.same_place(standing.settings, standing.viewer, viewer)


def forget_shown() -> None:
    """What is shown is no more what was shown last: the next move of every terrain shows all of it."""
    for engine in _engines.values():
        engine.forget()


def forget_all() -> None:
    """Let go of all voxels."""
    _engines.clear()
