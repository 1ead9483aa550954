"""The files that the open scene refers to: outputs must not replace them."""

from contextlib import suppress
from pathlib import Path

import bpy

from ..core.errors import FarfieldError
from ..core.files.outputs import Input
from .bdam.objects import SceneTerrain as LargeTerrain
from .clipbox.objects import SceneTerrain as ClipboxTerrain
from .clipbox.sources import absolute_path

TILE_PATTERNS = {"<UDIM>": "[1-9][0-9][0-9][0-9]", "<UVTILE>": "u*_v*"}
FILE, TERRAIN = "a file of the scene", "a terrain of the scene"  # in messages


def scene_inputs() -> list[Input]:
    """Return the libraries, images, caches and other files of the open scene, and what its terrains show; not the .blend file itself."""
    names = {name for name in bpy.utils.blend_paths(absolute=True, packed=True, local=False) if name}
    inputs = [Input(FILE, path) for name in sorted(names) for path in _expand_tiles(Path(name))]
    for scene in bpy.data.scenes:
        for terrain in LargeTerrain.in_scene(scene):
            with suppress(FarfieldError):  # its folder is missing
                inputs.append(Input(TERRAIN, terrain.folder, is_closed=True))
        for terrain in ClipboxTerrain.in_scene(scene):
            with suppress(FarfieldError):  # its settings cannot be read
                paths = (terrain.settings.source, terrain.settings.source_color)
                inputs += [Input(FILE, Path(absolute_path(path, terrain.root.library))) for path in paths if path]
    return inputs


def _expand_tiles(path: Path) -> list[Path]:
    """Return the files that a path with a placeholder of tiles stands for; other paths as they are."""
    for placeholder, pattern in TILE_PATTERNS.items():
        if placeholder in path.name:
            with suppress(OSError):
                return sorted(path.parent.glob(path.name.replace(placeholder, pattern)))
    return [path]
