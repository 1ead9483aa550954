"""A session in a Blender window: makes levels of a ball, shows features, previews and flickers levels, and calibrates the threshold."""

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import mathutils
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import UserInput, module, open_panel_alone, results, save_screenshot, scene_state, start_session, wait_for_job, wait_until


def create_ball(segments: int = 64) -> bpy.types.Object:
    """Create a bumpy ball with a texture as the active object."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=segments, ring_count=segments // 2)
    ball = bpy.context.object
    ball.name = "Ball"
    for vertex in ball.data.vertices:
        x, y, z = vertex.co
        vertex.co *= 1.0 + 0.1 * math.sin(5.0 * x) * math.sin(4.0 * y + 1.0) * math.sin(6.0 * z)
    ball.data.shade_smooth()
    image = bpy.data.images.new("Checker", 256, 256)
    rows, columns = np.mgrid[:256, :256]
    colors = np.ones((256, 256, 4), np.float32)
    colors[..., :3] = np.where(((rows // 16 + columns // 16) % 2)[..., None], (0.8, 0.5, 0.2), (0.15, 0.3, 0.5))
    image.pixels.foreach_set(colors.ravel())
    image.pack()
    material = bpy.data.materials.new("Checker")
    if material.node_tree is None:
        material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    material.node_tree.links.new(node.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    ball.data.materials.append(material)
    return ball


def visible_objects() -> list[str]:
    """Return the names of the meshes that are visible in viewports."""
    return sorted(item.name for item in bpy.data.objects if item.type == "MESH" and not item.hide_viewport)


def shows_one() -> bool:
    """Return whether one mesh is visible, which Preview sees to with its next step."""
    return len(visible_objects()) == 1


def press_button(user: UserInput, operator: str) -> Iterator[float | tuple[int, int]]:
    """Press the button of `operator`; return its position."""
    x, y = yield from user.find_button(operator)
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    return x, y


def scroll_sidebar(user: UserInput) -> Iterator[float]:
    """Scroll to the lower end of the sidebar."""
    sidebar = user.region("UI")
    position = sidebar.x + sidebar.width // 2, sidebar.y + sidebar.height // 2
    user.move(*position)
    yield 0.3
    for _ in range(20):
        user.press("WHEELDOWNMOUSE", *position)
        yield 0.05


def show_in_all_views(user: UserInput) -> Iterator[float]:
    """Record the visible meshes right after the run in each kind of shading."""
    results["after_run"] = {}
    shading = user.area.spaces.active.shading
    for kind in ("RENDERED", "MATERIAL", "SOLID"):
        shading.type = kind
        yield 2.0
        yield from wait_until(shows_one)
        results["after_run"][kind] = visible_objects()
        save_screenshot(f"2-levels-{kind.lower()}")


def undo_and_redo(user: UserInput) -> Iterator[float]:
    """Undo the run, and redo it; record the visible meshes."""
    yield from user.press_undo()
    results["undone"] = visible_objects()
    save_screenshot("2-levels-undone")
    yield from user.press_undo(redo=True)
    yield from wait_until(shows_one)
    results["redone"] = visible_objects()


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    create_ball()
    group = bpy.context.scene.farfield_texmesh
    group.levels, group.number, group.views, group.max_image = "number", 4, 2, 128
    bpy.ops.ed.undo_push(message="Create Ball")
    open_panel_alone("texmesh", "inspect", "calibration")
    yield from user.open_sidebar()

    bpy.ops.farfield.texmesh_analyze()
    view = user.area.spaces.active.region_3d
    view.view_rotation = mathutils.Euler((math.radians(62.0), 0.0, math.radians(40.0))).to_quaternion()
    view.view_distance = 5.0
    bpy.context.scene.farfield_texmesh_inspection.lowest_scale = 4
    yield 1.0
    overlay_button = yield from press_button(user, "farfield.texmesh_overlay")
    results["overlay_shown"] = module("addon.operators.texmesh.overlays").overlay.is_shown
    save_screenshot("1-features")
    user.press("LEFTMOUSE", *overlay_button)

    yield from user.press_and_start("farfield.texmesh_levels")
    results["fractions"] = yield from wait_for_job()
    yield 1.5
    results["levels"] = sorted(item.name for item in bpy.data.objects if "farfield_error" in item)
    results["crossfading"] = sorted(item.name for item in bpy.data.objects if "farfield_camera_position" in item)
    preview = module("addon.operators.texmesh.preview").current
    yield from show_in_all_views(user)
    yield from undo_and_redo(user)
    yield from press_button(user, "farfield.texmesh_show")
    results["chosen"] = visible_objects()
    yield from press_button(user, "farfield.texmesh_crossfade")
    results["preview"] = []
    for distance in (4.0, 25.0, 120.0):
        view.view_distance = distance
        yield 1.5
        results["preview"].append(visible_objects())
        save_screenshot(f"3-preview-{distance:.0f}")
    yield from press_button(user, "farfield.texmesh_flicker")
    shown = set()
    for _ in range(20):
        yield 0.1
        shown.update(visible_objects())
    results["flicker"] = sorted(shown)
    user.press("ESC", *viewport_center(user))
    yield 1.0
    results["flickers_after_esc"], results["follows_after_esc"] = preview.flickers, preview.follows_view
    yield from press_button(user, "farfield.texmesh_preview")
    results["after_preview"], results["rings_hidden"] = visible_objects(), not preview.is_running

    view.view_distance = 8.0
    yield from press_button(user, "farfield.texmesh_preview")
    yield from scroll_sidebar(user)
    before = scene_state()
    view.view_perspective = "ORTHO"
    yield from press_button(user, "farfield.texmesh_calibrate")
    yield 1.0
    results["perspective_of_calibration"] = view.view_perspective
    save_screenshot("4-calibration")
    results["calibrating"] = scene_state() != before
    center = viewport_center(user)
    user.move(*center)
    for key in ("WHEELUPMOUSE", "WHEELUPMOUSE", "RET", "WHEELDOWNMOUSE", "RET"):
        user.press(key, *center)
        yield 0.5
    save_screenshot("5-second-trial")
    user.press("ESC", *center)
    yield 1.0
    yield from wait_until(shows_one)
    results["after_calibration"] = scene_state() == before
    results["preview_after_calibration"] = preview.follows_view and visible_objects()
    results["perspective_afterwards"] = view.view_perspective
    results["answers"] = json.loads(bpy.context.scene["farfield_texmesh_answers"])
    results["overlays_again"] = user.area.spaces.active.overlay.show_overlays
    with bpy.context.temp_override(window=user.window, area=user.area):
        bpy.ops.farfield.texmesh_plot()
    properties = next(area for area in user.window.screen.areas if area.type == "PROPERTIES")
    properties.ui_type = "IMAGE_EDITOR"
    yield 1.0
    properties.spaces.active.image = bpy.data.images["Ball Scale Plot"]
    yield 1.0
    with bpy.context.temp_override(
        window=user.window, area=properties, region=next(item for item in properties.regions if item.type == "WINDOW")
    ):
        bpy.ops.image.view_all(fit_view=True)
    yield 1.0
    save_screenshot("6-plot")


def viewport_center(user: UserInput) -> tuple[int, int]:
    """Return the middle of the 3D Viewport in the window."""
    region = user.region("WINDOW")
    return region.x + region.width // 2, region.y + region.height // 2


if __name__ == "__main__":
    start_session(session)
