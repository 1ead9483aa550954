"""A session in a Blender window: imports cameras through the file browser, once with Esc while overlays are drawn, looks at overlays and
coverage, cancels a merge once, merges photographs, and undoes it."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import (
    FOLDER,
    UserInput,
    current_job,
    module,
    open_panel_alone,
    results,
    save_screenshot,
    scene_state,
    start_session,
    wait_for_job,
    wait_until,
)

WIDTH, HEIGHT, FOCAL = 640, 480, 700.0
DISTANCE = 4.0
CAMERAS = 5
COLORS = ((0.8, 0.2, 0.1), (0.2, 0.6, 0.3))


def create_wall() -> bpy.types.Object:
    """Create a square of 2 x 2 units with many faces and no UV map, selected and active."""
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=60, y_subdivisions=60, size=2.0, calc_uvs=False)
    wall = bpy.context.object
    wall.name = "Wall"
    return wall


def is_first_color(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return where the wall has the first of its two colors."""
    return (np.floor(4.0 * x) + np.floor(4.0 * y)) % 2 == 0


def write_photographs(folder: Path) -> None:
    """Write photographs of a checkerboard on the wall and a transforms.json."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for index, position in enumerate(np.linspace(-0.5, 0.5, CAMERAS)):
        matrix = np.eye(4)
        matrix[:3, 3] = (position, 0.2 * index - 0.4, DISTANCE)
        columns, rows = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
        x = matrix[0, 3] + DISTANCE * (columns - 0.5 * WIDTH) / FOCAL
        y = matrix[1, 3] + DISTANCE * (rows - 0.5 * HEIGHT) / FOCAL
        pixels = np.ones((HEIGHT, WIDTH, 4), np.float32)
        pixels[..., :3] = np.where(is_first_color(x, y)[..., None], *COLORS)
        image = bpy.data.images.new("temporary", WIDTH, HEIGHT)
        image.pixels.foreach_set(pixels.ravel())
        image.filepath_raw, image.file_format = str(folder / "images" / f"{index}.png"), "PNG"
        image.save()
        bpy.data.images.remove(image)
        frames.append({"file_path": f"images/{index}.png", "transform_matrix": matrix.tolist()})
    lens = {"w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL, "cx": 0.5 * WIDTH, "cy": 0.5 * HEIGHT}
    (folder / "transforms.json").write_text(json.dumps(lens | {"frames": frames}), encoding="utf-8")


def texture_error() -> float:
    """Return the mean difference between the texture and the checkerboard at the centers of the faces."""
    wall = bpy.data.objects["Wall"]
    nodes = wall.material_slots[0].material.node_tree.nodes
    image = next(node.image for node in nodes if node.type == "TEX_IMAGE")
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, 4)
    layer, differences = wall.data.uv_layers.active.uv, []
    for polygon in wall.data.polygons:
        x, y = polygon.center[:2]
        if min(abs(4.0 * value - round(4.0 * value)) for value in (x, y)) > 0.2:  # not at an edge of the checkerboard
            u, v = np.mean([layer[loop].vector for loop in polygon.loop_indices], axis=0)
            expected = np.where(is_first_color(np.array(x), np.array(y)), *COLORS)
            differences.append(np.abs(pixels[int(v * height), int(u * width), :3] - expected).mean())
    return float(np.mean(differences))


def look_at_overlay(user: UserInput) -> Iterator[float]:
    """Show the first overlay in an Image Editor in place of the properties, and take a picture of it."""
    area = next(area for area in user.window.screen.areas if area.type == "PROPERTIES")
    area.type = "IMAGE_EDITOR"
    area.spaces.active.image = bpy.data.images[results["overlays"][0]]
    yield 2.0
    save_screenshot("4-overlay")
    area.type = "PROPERTIES"
    yield 1.0


def look_at_coverage(user: UserInput) -> Iterator[float]:
    """Show the coverage and hide it again, with the button."""
    overlay = module("addon.bridge.photos.coverage_overlay").overlay
    yield from user.press_and_start("farfield.photos_show_coverage")
    yield from wait_for_job()
    yield 2.0
    results["coverage_shown"] = overlay.is_shown
    save_screenshot("6-coverage")
    x, y = yield from user.find_button("farfield.photos_show_coverage")
    user.press("LEFTMOUSE", x, y)
    yield 1.0
    results["coverage_hidden"] = not overlay.is_shown


def import_cameras(user: UserInput, folder: Path) -> Iterator[float]:
    """Press the button, and choose the transforms.json in the file browser."""
    x, y = yield from user.find_button("farfield.photos_import_cameras")
    user.press("LEFTMOUSE", x, y)
    yield 2.0
    browsers = [area for window in bpy.context.window_manager.windows for area in window.screen.areas if area.type == "FILE_BROWSER"]
    results["browser_opened"] = len(browsers) == 1
    save_screenshot("2-browser")
    window = next(item for item in bpy.context.window_manager.windows if any(area.type == "FILE_BROWSER" for area in item.screen.areas))
    browsers[0].spaces.active.params.directory = str(folder).encode()
    browsers[0].spaces.active.params.filename = "transforms.json"
    yield 1.0
    save_screenshot("3-browser")
    with bpy.context.temp_override(window=window, area=browsers[0], region=browsers[0].regions[0]):
        bpy.ops.file.execute()


def cancel_overlays(user: UserInput, folder: Path) -> Iterator[float]:
    """Import cameras, press Esc while their overlays are drawn, and undo the import."""
    long_work = module("addon.operators.long_work")
    report_error, messages = long_work.report_error, []
    long_work.report_error = lambda operator, error, title: messages.append(str(error)) or report_error(operator, error, title)
    yield from import_cameras(user, folder)
    yield from wait_until(lambda: current_job() is not None)
    viewport = user.region("WINDOW")
    user.press("ESC", viewport.x + viewport.width // 2, viewport.y + viewport.height // 2)
    yield from wait_for_job()
    yield 0.5
    long_work.report_error = report_error
    overlays = [image.name for image in bpy.data.images if "Overlay" in image.name]
    results["overlays_cancelled"] = [messages, sum(item.type == "CAMERA" for item in bpy.data.objects), overlays]
    yield from user.press_undo()


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    folder = FOLDER / "Projekt ü"
    write_photographs(folder)
    for name in ("Cube", "Camera"):
        bpy.data.objects.remove(bpy.data.objects[name])
    create_wall()
    bpy.ops.ed.undo_push(message="Create Wall")
    open_panel_alone("photos")
    yield from user.open_sidebar()
    save_screenshot("1-panel")

    yield from cancel_overlays(user, folder)
    yield from import_cameras(user, folder)
    yield 2.0
    yield from wait_for_job()
    yield 1.0
    results["cameras"] = [item.name for item in bpy.data.objects if item.type == "CAMERA"]
    results["overlays"] = sorted(image.name for image in bpy.data.images if "Overlay" in image.name)
    results["loaded"] = [image.name for image in bpy.data.images if image.has_data and image.name not in results["overlays"]]
    yield from look_at_overlay(user)
    user.area.spaces.active.region_3d.view_perspective = "CAMERA"
    yield 2.0
    save_screenshot("5-camera-view")
    user.area.spaces.active.region_3d.view_perspective = "PERSP"
    results["selected"] = [item.name for item in bpy.context.view_layer.objects if item.select_get()]
    bpy.context.scene.farfield_photos.size = 1024
    results["before"] = scene_state()
    yield from look_at_coverage(user)

    x, y = yield from user.press_and_start("farfield.photos_merge")
    yield from wait_for_job(until_fraction=0.2)
    results["was_running"] = current_job() is not None
    save_screenshot("7-running")
    user.press("ESC", x, y)
    yield from wait_for_job()
    yield 0.5
    results["cancelled"] = scene_state()

    yield from user.press_and_start("farfield.photos_merge")
    results["fractions"] = yield from wait_for_job()
    yield 2.0
    results["uv_maps"] = [layer.name for layer in bpy.data.objects["Wall"].data.uv_layers]
    results["error_of_texture"] = texture_error()
    user.area.spaces.active.shading.color_type = "TEXTURE"
    yield 2.0
    save_screenshot("8-merged")

    yield from user.press_undo()
    yield 1.0
    results["after_undo"] = scene_state()
    save_screenshot("9-undone")


start_session(session)
