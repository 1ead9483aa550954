"""A session in a Blender window: makes two balls distance-ready, cancels once, shows the originals, and undoes it."""

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import UserInput, current_job, module, open_panel_alone, results, save_screenshot, scene_state, start_session, wait_for_job

BUTTON = "farfield.distance_build"


def create_balls() -> None:
    """Add a ball with bumps and a texture near the camera, a linked duplicate far away, and another ball."""
    material = bpy.data.materials.new("Checker")
    module("addon.compat").enable_nodes(material)
    texture = material.node_tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("Checker", 64, 64)
    texture.image.generated_type = "COLOR_GRID"
    material.node_tree.links.new(texture.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    for subdivisions in (4, 3):
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=subdivisions)
        ball = bpy.context.object
        ball.data.materials.append(material)
        for vertex in ball.data.vertices:
            x, y, z = vertex.co
            vertex.co *= 1.0 + 0.15 * math.sin(5.0 * x) * math.sin(4.0 * y + 1.0) * math.sin(6.0 * z)
    duplicate = ball.copy()
    bpy.context.scene.collection.objects.link(duplicate)
    duplicate.location = -300.0 * bpy.context.scene.camera.matrix_world.col[2].to_3d()
    bpy.ops.object.select_all(action="DESELECT")


def modifiers() -> list[int]:
    """Return the number of modifiers of each mesh object of the scene."""
    return [len(item.modifiers) for item in bpy.context.scene.objects if item.type == "MESH"]


def instances() -> list[str]:
    """Return the names of the objects that the viewport shows as instances."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return sorted(item.object.name for item in depsgraph.object_instances if item.is_instance)


def find_view() -> bpy.types.RegionView3D:
    """Return the view of the 3D Viewport."""
    return next(area for area in bpy.context.screen.areas if area.type == "VIEW_3D").spaces.active.region_3d


def duplicate() -> bpy.types.Object:
    """Return the ball far away from the camera."""
    return max((item for item in bpy.context.scene.objects if item.type == "MESH"), key=lambda item: item.location.length)


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    limits = module("addon.core.distance.levels")
    limits.FEW_TRIANGLES = limits.MANY_TRIANGLES = 0  # So that perceptual levels are made, which take long enough to be cancelled.
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    create_balls()
    settings = bpy.context.scene.farfield_distance
    settings.min_triangles, settings.billboard_cloud = 100, False
    bpy.ops.ed.undo_push(message="Create Balls")
    open_panel_alone("distance")
    yield from user.open_sidebar()
    x, y = yield from user.find_button("farfield.distance_analyze")
    user.press("LEFTMOUSE", x, y)
    yield 2.0
    save_screenshot("1-analysis")
    results["analysis"] = [(plan.places, plan.outcome) for plan in settings.plans]
    results["before"] = scene_state()

    x, y = yield from user.press_and_start(BUTTON)
    yield from wait_for_job(until_fraction=0.05)
    results["was_running"] = current_job() is not None
    save_screenshot("2-running")
    user.press("ESC", x, y)
    yield from wait_for_job()
    yield 0.5
    results["cancelled"] = {"objects": [item.name for item in bpy.context.scene.objects], "modifiers": modifiers()}
    results["scenes"] = [scene.name for scene in bpy.data.scenes]

    yield from user.press_and_start(BUTTON)
    results["fractions"] = yield from wait_for_job()
    yield 2.0
    results["modifiers"], results["instances"] = modifiers(), instances()
    results["chains"] = [chain.name for chain in module("addon.bridge.distance.chains").read_chains()]
    save_screenshot("3-ready")

    x, y = yield from user.find_button("farfield.distance_show_original")
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    results["originals"] = instances()
    user.press("LEFTMOUSE", x, y)
    yield 1.0

    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.render.resolution_percentage = "CYCLES", 4096, 100
    x, y = yield from user.press_and_start("farfield.distance_measure")
    yield from wait_for_job(until_fraction=0.01)
    yield 1.0
    save_screenshot("4-measuring")
    results["fraction_at_esc"] = current_job().progress.fraction if current_job() else 1.0
    user.press("ESC", x, y)
    yield from wait_for_job()
    results["figures_of_cancelled"] = settings.figures

    scene.cycles.samples, scene.render.resolution_percentage = 2, 20
    yield from user.press_and_start("farfield.distance_measure")
    yield from wait_for_job()
    yield 2.0
    save_screenshot("5-measured")
    scene.render.resolution_percentage = 100
    results["figures"], results["instances_after"] = settings.figures, instances()

    view = find_view()
    view.view_location, view.view_distance = duplicate().location, 3.0
    yield 0.5
    results["far"] = instances()
    x, y = yield from user.find_button("farfield.distance_follow_view")
    user.press("LEFTMOUSE", x, y)
    yield 2.0
    results["followed"] = instances()
    save_screenshot("6-followed")
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    results["not_followed"] = instances()

    for _ in range(4):
        yield from user.press_undo()
    results["after_undo"] = modifiers()


if __name__ == "__main__":
    start_session(session)
