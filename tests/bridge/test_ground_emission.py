"""Lava in the material of landscapes: it glows where the ground is low, and ground of other landscapes emits nothing."""

import bpy
import numpy as np

from farfield.addon.bridge.clipbox.materials import create_terrain_material

PIXELS = 64


def render_in_the_dark(folder, terrain, z, level=0.0):
    """The light (N, N, 3) of level ground at a height, 200 x 200 m from above, without any other light."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene, root = bpy.context.scene, bpy.data.objects.new("Root", None)
    mesh = bpy.data.meshes.new("Ground")
    mesh.from_pydata([(-300, -300, z), (300, -300, z), (300, 300, z), (-300, 300, z)], [], [(0, 1, 2, 3)])
    mesh.materials.append(create_terrain_material("Ground", root, -100.0, 100.0, 1.0, terrain=terrain, level=level))
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    for item in (root, bpy.data.objects.new("Ground", mesh), camera):
        scene.collection.objects.link(item)
    camera.location.z, camera.data.type, camera.data.ortho_scale = z + 20.0, "ORTHO", 200.0
    scene.camera, scene.render.engine, scene.cycles.samples = camera, "CYCLES", 1
    scene.render.resolution_x = scene.render.resolution_y = PIXELS
    scene.view_settings.view_transform, scene.render.image_settings.file_format = "Raw", "OPEN_EXR"
    scene.render.filepath = str(folder / "ground.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    return np.array(image.pixels).reshape(PIXELS, PIXELS, 4)[..., :3]


def test_cracks_emit_red_light_between_dark_plates_where_the_ground_is_low(tmp_path):
    red, green, blue = render_in_the_dark(tmp_path, "lava", 0.0).reshape(-1, 3).T
    assert red.max() > 0.5 and red.mean() > 2.0 * green.mean() > 4.0 * blue.mean() and np.percentile(red, 10.0) < 0.1 * red.max()
    assert render_in_the_dark(tmp_path, "lava", 30.0, level=30.0).max() > 0.5
    assert render_in_the_dark(tmp_path, "lava", 10.0).max() < 1e-4
    assert render_in_the_dark(tmp_path, "canyon", 0.0).max() < 1e-4
