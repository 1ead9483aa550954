"""What relightable textures are measured on: a tree of alpha-mapped leaves, a head with glossy paint, and the tree of the demo."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy

import environment
import scene_files
from demo_tree import grow
from farfield.addon.compat import give_nodes
from farfield.addon.core.errors import FileError

DATA = environment.ROOT.parent / "shared" / "data"
TREE, HEAD = Path("trees") / "leafy_tree.glb", Path("meshes") / "max_planck.obj"  # in DATA
PAINT = {"Base Color": (0.45, 0.04, 0.03, 1.0), "Roughness": 0.35, "Coat Weight": 1.0, "Coat Roughness": 0.12}


@dataclass(frozen=True)
class Model:
    """make: puts the model into an empty scene, given the folder of what it is made from. upper: whether it stands on the ground, to be
    seen and lit from above the horizon."""

    make: Callable[[Path], None]
    upper: bool


def save_model(model: Model, path: Path, data: Path) -> None:
    """Write a file with the model alone, made from what is in the folder `data`.

    Raises:
        FileError: when what it is made from is not beside the project, or the file cannot be written.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    model.make(data)
    scene_files.save_scene(path)


def _leafy_tree(data: Path) -> None:
    scene_files.open_scene(_given(data / TREE))


def _painted_head(data: Path) -> None:
    scene_files.open_scene(_given(data / HEAD))
    paint = bpy.data.materials.new("Paint")
    give_nodes(paint)
    surface = next(node for node in paint.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for name, value in PAINT.items():
        surface.inputs[name].default_value = value
    for item in bpy.context.scene.objects:
        item.data.materials.clear()
        item.data.materials.append(paint)
        item.data.shade_smooth()


def _demo_tree(_data: Path) -> None:
    grow()


def _given(path: Path) -> Path:
    if not path.exists():
        raise FileError(f'The model to measure with is not at "{path}"; name its folder with --data, or choose other models with --models.')
    return path


MODELS = {
    "max_planck": Model(_painted_head, upper=False),
    "leafy_tree": Model(_leafy_tree, upper=True),
    "demo_tree": Model(_demo_tree, upper=True),
}
