"""Large terrain in a scene: tiles as objects, welded exactly, with their normals, textures and materials."""

import bpy
import pytest

from farfield.addon.bridge.bdam.objects import SceneTerrain
from small_terrain_stores import add_texture, build_store, colors, hills

pytestmark = pytest.mark.usefixtures("empty_scene")


def test_smoke(tmp_path):
    folder = add_texture(build_store(tmp_path / "terrain", hills()), colors())
    assert bpy.ops.farfield.bdam_load(directory=str(folder)) == {"FINISHED"}
    (terrain,) = SceneTerrain.in_scene(bpy.context.scene)
    print(
        terrain.figures,
        terrain.tiles().keys(),
        [m.name for m in bpy.data.materials],
        [(i.name, i.size[:], i.packed_file.size) for i in bpy.data.images],
    )
    assert bpy.ops.farfield.bdam_update(shading="slope") == {"FINISHED"}
    print([m.name for m in bpy.data.materials])
    assert bpy.ops.farfield.bdam_remove() == {"FINISHED"}
    print(len(bpy.data.objects), [m.name for m in bpy.data.materials], len(bpy.data.images), len(bpy.data.meshes))
