"""Octahedral impostors of the trees of the valley, the peer of game engines: each place shows the frame nearest to its view direction.

A frame is a quad through the center of the tree with color, coverage, normals and roughness of its hemi-octahedral atlas, without a blend
of frames, relief or shadows within the crown. A place shows the original up to where a pixel of a frame is a pixel of the image.
"""

from pathlib import Path

import bpy
import numpy as np

from farfield.addon.bridge.btf.export.octahedral_capture import capture_atlas
from farfield.addon.bridge.btf.export.octahedral_files import create_atlas_images
from farfield.addon.bridge.distance.level_switch import level_modifiers
from farfield.addon.bridge.geometry.geometry_nodes import TREE, GeometryBuilder
from farfield.addon.bridge.geometry.mesh_arrays import write_triangles, write_uvs
from farfield.addon.bridge.geometry.meshes import read_source
from farfield.addon.bridge.shading.node_builder import create_group, create_node_material
from farfield.addon.core.btf.octahedral import FrameGrid, OctahedralAtlas
from farfield.addon.core.geometry.cameras import switch_distance
from farfield.addon.core.jobs.progress import run_to_end
from lib import command_line

FRAMES, RESOLUTION, SAMPLES = 12, 128, 16  # Frames per side of an atlas, pixels per side of a frame, and Cycles samples of it.


def write_impostor_scene(decimated: Path, target: Path) -> None:
    """Write a scene with impostors instead of the levels of the trees of another one; rocks, houses and props keep theirs."""
    bpy.ops.wm.open_mainfile(filepath=str(decimated))
    scene = bpy.context.scene
    for scatter in [item for item in scene.objects if item.name.endswith(" Scatter")]:
        for modifier in level_modifiers(scatter):
            scatter.modifiers.remove(modifier)
        nodes = scatter.modifiers[0].node_group.nodes
        tree = next(node for node in nodes if node.bl_idname == "GeometryNodeObjectInfo").inputs["Object"].default_value
        scene.collection.objects.link(tree)
        bpy.context.view_layer.update()
        source = read_source([tree], bpy.context.evaluated_depsgraph_get())
        steps = capture_atlas(source, FrameGrid(FRAMES, upper=True), RESOLUTION, SAMPLES)
        atlas = run_to_end(steps, command_line.ProgressLine().show)
        scene.collection.objects.unlink(tree)
        _show_frames(scatter, tree, atlas, _create_frames(tree.name, atlas))
    bpy.data.orphans_purge(do_recursive=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(target))


def _create_frames(name: str, atlas: OctahedralAtlas) -> bpy.types.Collection:
    """Return a collection with a quad per frame, in their order."""
    frames = bpy.data.collections.new(f"{name} Impostor")
    frames.use_fake_user = True
    material = _create_material(name, atlas)
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    for index in range(len(atlas.grid)):
        view, (row, column) = atlas.view(index), divmod(index, FRAMES)
        mesh = bpy.data.meshes.new(f"{name} {index:04}")
        write_triangles(mesh, atlas.center + atlas.half_side * corners @ np.stack([view.right, view.up]), triangles)
        uvs = (np.array([column, row]) + 0.5 + 0.5 * corners) / FRAMES
        write_uvs(mesh.uv_layers.new(name="UVMap"), uvs[triangles].reshape(-1, 2))
        mesh.materials.append(material)
        frames.objects.link(bpy.data.objects.new(mesh.name, mesh))
    return frames


def _create_material(name: str, atlas: OctahedralAtlas) -> bpy.types.Material:
    material, builder = create_node_material(f"{name} Impostor")
    images = create_atlas_images(name, atlas)
    textures = {key: builder.node("ShaderNodeTexImage", {"image": image}) for key, image in images.items()}
    shader = builder.node("ShaderNodeBsdfPrincipled")
    builder.connect(textures["color"].outputs["Color"], shader.inputs["Base Color"])
    builder.connect(textures["color"].outputs["Alpha"], shader.inputs["Alpha"])
    normal = builder.vector("MULTIPLY_ADD", textures["normal_height"].outputs["Color"], (2.0, 2.0, 2.0))
    normal.node.inputs[2].default_value = (-1.0, -1.0, -1.0)
    builder.connect(builder.vector_transform(normal, "NORMAL", "OBJECT", "WORLD"), shader.inputs["Normal"])
    uniform = atlas.uniform_roughness_metallic
    values = uniform if uniform is not None else builder.separate_color(textures["roughness_metallic"].outputs["Color"])
    for value, socket in zip(values, ("Roughness", "Metallic"), strict=False):
        builder.connect(float(value) if uniform is not None else value, shader.inputs[socket])
    builder.connect(shader.outputs[0], builder.node("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def _show_frames(scatter: bpy.types.Object, tree: bpy.types.Object, atlas: OctahedralAtlas, frames: bpy.types.Collection) -> None:
    """Add a modifier that replaces far instances of `tree` in the geometry of `scatter` by the nearest of its frames."""
    scene = bpy.context.scene
    geometry = (("Geometry", "Geometry"),)
    group = create_group(f"{tree.name} Impostor", geometry, geometry, TREE)
    builder = GeometryBuilder(group)
    given, result = builder.node("NodeGroupInput").outputs[0], builder.node("NodeGroupOutput").inputs[0]
    camera = builder.call("GeometryNodeObjectInfo", {"Object": scene.camera}, {"transform_space": "RELATIVE"}).outputs["Location"]
    captured, local = builder.capture_transforms(given)
    inverse = builder.call("FunctionNodeInvertMatrix", {0: local}).outputs[0]
    offset = builder.vector("SUBTRACT", builder.transform_point(camera, inverse), atlas.center.tolist())
    pixel = 2.0 * atlas.half_side / RESOLUTION
    distance = switch_distance(pixel, scene.camera.data.angle, scene.render.resolution_x)
    is_near = builder.less(builder.vector("LENGTH", offset), distance)
    separated = builder.call("GeometryNodeSeparateGeometry", {0: captured, 1: is_near}, {"domain": "INSTANCE"})
    points = builder.call("GeometryNodeInstancesToPoints", {0: separated.outputs[1]}).outputs[0]
    index = _nearest_frame(builder, offset)
    info = builder.call("GeometryNodeCollectionInfo", {0: frames, "Separate Children": True}).outputs[0]
    inputs = {"Points": points, "Instance": info, "Pick Instance": True, "Instance Index": index}
    placed = builder.call("GeometryNodeInstanceOnPoints", inputs).outputs[0]
    placed = builder.call("GeometryNodeSetInstanceTransform", {0: placed, 2: local}).outputs[0]
    join = builder.node("GeometryNodeJoinGeometry")
    for part in (separated.outputs[0], placed):
        builder.tree.links.new(part, join.inputs[0])
    builder.tree.links.new(join.outputs[0], result)
    scatter.modifiers.new("Impostors", "NODES").node_group = group


def _nearest_frame(builder: GeometryBuilder, direction: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return the index of the frame nearest to a direction; for one below the horizon, that of the horizon below it."""
    x, y, z = builder.separate(direction)
    parts = [x, y, builder.math("MAXIMUM", z, 0.0)]
    sizes = [builder.math("ABSOLUTE", part) for part in parts]
    total = builder.math("ADD", builder.math("ADD", sizes[0], sizes[1]), sizes[2])
    x, y = (builder.math("DIVIDE", part, total) for part in parts[:2])
    half = 0.5 * (FRAMES - 1)
    ticks = []
    for value in (builder.math("ADD", x, y), builder.math("SUBTRACT", x, y)):
        scaled = builder.math("MULTIPLY", builder.math("ADD", value, 1.0), half)
        ticks.append(builder.math("ROUND", scaled))
    return builder.math("ADD", builder.math("MULTIPLY", ticks[1], float(FRAMES)), ticks[0])
