"""The files that the open scene refers to: outputs must not replace them."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import bpy

from ..core.errors import FarfieldError
from ..core.files.outputs import Input, Output, check_outputs
from .terrain_roots import TerrainRoot

TILE_PATTERNS = {"<UDIM>": "[1-9][0-9][0-9][0-9]", "<UVTILE>": "u*_v*"}
FILE = "a file of the scene"  # in messages


def scene_inputs() -> list[Input]:
    """Return the libraries, images, caches and other files of the open scene, and what its terrains show; not the .blend file itself."""
    names = {name for name in bpy.utils.blend_paths(absolute=True, packed=True, local=False) if name}
    inputs = [Input(FILE, path) for name in sorted(names) for path in _expand_tiles(Path(name))]
    for scene in bpy.data.scenes:
        for terrain in (terrain for kind in TerrainRoot.__subclasses__() for terrain in kind.in_scene(scene)):
            with suppress(FarfieldError):  # A path or the settings cannot be read.
                inputs += [Input(f"a file of the terrain {terrain.name}", path, is_closed=True) for path in terrain.input_paths()]
    return inputs


def default_folder() -> Path:
    """Return the folder in which a file browser begins: that of the open file, or the user's."""
    return Path(bpy.data.filepath).parent if bpy.data.filepath else Path.home()


def check_scene_outputs(outputs: Sequence[Output], inputs: Sequence[Input] = ()) -> None:
    """Check what an operator writes: nothing of the open scene, its file, or other `inputs` may be replaced.

    Raises:
        FileError: see `check_outputs`.
    """
    own = [Input("the open file", Path(bpy.data.filepath))] if bpy.data.filepath else []
    check_outputs(outputs, [*own, *scene_inputs(), *inputs])


def _expand_tiles(path: Path) -> list[Path]:
    """Return the files that a path with a placeholder of tiles stands for; other paths as they are."""
    for placeholder, pattern in TILE_PATTERNS.items():
        if placeholder in path.name:
            with suppress(OSError):
                return sorted(path.parent.glob(path.name.replace(placeholder, pattern)))
    return [path]
