"""Models of the benchmark of relightable textures: a tree with alpha-mapped leaves, a head with glossy paint, and the demo's tree."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy

from farfield.addon.compat import enable_nodes
from farfield.addon.core.errors import FileError
from lib import environment, scene_files
from lib.demo_tree import grow_tree

DATA = environment.ROOT.parent / "shared" / "data"
TREE, HEAD = Path("trees") / "leafy_tree.glb", Path("meshes") / "max_planck.obj"  # in DATA
PAINT = {"Base Color": (0.45, 0.04, 0.03, 1.0), "Roughness": 0.35, "Coat Weight": 1.0, "Coat Roughness": 0.12}


@dataclass(frozen=True)
class Model:
    """make: creates the model in an empty scene from files in a folder. upper: whether it stands on the ground, so that only views and
    lights above the horizon matter."""

    make: Callable[[Path], None]
    upper: bool


def save_model(model: Model, path: Path, data: Path) -> None:
    """Write a file that contains only the model, created from files in the folder `data`.

    Raises:
        FileError: if an input file is missing or the output cannot be written.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    model.make(data)
    scene_files.save_scene(path)


def _leafy_tree(data: Path) -> None:
    scene_files.open_scene(_require(data / TREE))


def _painted_head(data: Path) -> None:
    scene_files.open_scene(_require(data / HEAD))
    paint = bpy.data.materials.new("Paint")
    enable_nodes(paint)
    shader = next(node for node in paint.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for name, value in PAINT.items():
        shader.inputs[name].default_value = value
    for item in bpy.context.scene.objects:
        item.data.materials.clear()
        item.data.materials.append(paint)
        item.data.shade_smooth()


def _demo_tree(_data: Path) -> None:
    grow_tree()


def _require(path: Path) -> Path:
    if not path.exists():
        raise FileError(f'The model "{path}" does not exist; set its folder with --data, or choose other models with --models.')
    return path


MODELS = {
    "max_planck": Model(_painted_head, upper=False),
    "leafy_tree": Model(_leafy_tree, upper=True),
    "demo_tree": Model(_demo_tree, upper=True),
}
