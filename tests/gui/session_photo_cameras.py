"""A session in a Blender window: background images of cameras, drawn by Blender, and marks in the scene where Farfield projects them to."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from scipy import ndimage
from session import FOLDER, UserInput, module, results, save_screenshot, start_session

WIDTH, HEIGHT = 360, 240
DOT_PIXELS, SPACING = 5, 40  # radius and distance of the dots in the photograph
DISTANCE, MARK_RADIUS = 4.0, 0.02
RED, BLUE = 0, 2
PLACEMENTS = {  # properties of camera data, its background image, the render settings and the image
    "default": ({}, {}, {}, {}),
    "stretch": ({}, {"frame_method": "STRETCH"}, {}, {}),
    "crop": ({"shift_x": 0.1, "shift_y": -0.05}, {"frame_method": "CROP"}, {}, {}),
    "wide sensor": ({"sensor_fit": "HORIZONTAL", "sensor_width": 30.0}, {"offset": (0.2, -0.1)}, {"resolution_y": 2400}, {}),
    "high sensor": ({"sensor_fit": "VERTICAL", "sensor_height": 20.0, "shift_y": 0.2}, {"offset": (0.1, 0.15)}, {}, {}),
    "portrait": ({"shift_x": 0.2}, {"frame_method": "FIT", "offset": (-0.1, 0.1), "scale": 1.3}, {"resolution_y": 3000}, {}),
    "portrait, crop": ({}, {"frame_method": "CROP", "offset": (0.1, 0.1), "scale": 0.7}, {"resolution_y": 3000}, {}),
    "rotated": ({"shift_x": 0.1}, {"frame_method": "FIT", "rotation": 0.4, "offset": (0.05, 0.1)}, {}, {}),
    "rotated, stretch": ({}, {"frame_method": "STRETCH", "rotation": -0.6, "scale": 0.8}, {"pixel_aspect_x": 1.5}, {}),
    "flipped": ({"shift_y": 0.1}, {"frame_method": "FIT", "use_flip_x": True, "rotation": 0.3, "offset": (0.1, 0.0)}, {}, {}),
    "flipped twice": ({}, {"frame_method": "CROP", "use_flip_x": True, "use_flip_y": True}, {"pixel_aspect_y": 1.4}, {}),
    "wide pixels": ({}, {"frame_method": "FIT", "offset": (0.1, 0.2)}, {}, {"display_aspect": (1.5, 1.0)}),
    "scaled camera": ({}, {"frame_method": "FIT"}, {}, {}),
}


def dot_positions() -> np.ndarray:
    """Return the centers (N, 2) of the dots in pixels from the lower left corner; no mirror image of one meets another."""
    x, y = np.meshgrid(np.arange(SPACING // 2, WIDTH, SPACING), np.arange(SPACING // 2, HEIGHT, SPACING))
    positions = np.stack([x.ravel(), y.ravel()], axis=1).astype(float)
    return positions[(positions[:, 0] < 0.6 * WIDTH) | (positions[:, 1] < 0.3 * HEIGHT)]


def create_photograph() -> bpy.types.Image:
    """Create a black image with red dots."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    pixels = np.zeros((HEIGHT, WIDTH, 4), np.float32)
    for x, y in dot_positions():
        pixels[np.hypot(columns - x, rows - y) < DOT_PIXELS, RED] = 1.0
    pixels[..., 3] = 1.0
    image = bpy.data.images.new("Dots", WIDTH, HEIGHT)
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


def set_up_viewport(space: bpy.types.SpaceView3D) -> None:
    """Show nothing but flat objects and background images on black."""
    space.show_gizmo = space.show_region_ui = space.show_region_toolbar = space.show_region_header = False
    overlay = space.overlay
    for name in ("floor", "axis_x", "axis_y", "cursor", "text", "outline_selected", "object_origins", "relationship_lines"):
        setattr(overlay, f"show_{name}", False)
    shading = space.shading
    shading.type, shading.light, shading.color_type = "SOLID", "FLAT", "OBJECT"
    shading.background_type, shading.background_color = "VIEWPORT", (0.0, 0.0, 0.0)
    space.region_3d.view_perspective = "CAMERA"
    space.region_3d.view_camera_zoom = -10.0


def create_marks(camera, image) -> bpy.types.Object:
    """Create a blue ball on the ray of each dot of the photograph `image`, whose pixels Farfield flips."""
    background = bpy.context.scene.camera.data.background_images[0]
    positions = dot_positions()
    if background.use_flip_x:
        positions[:, 0] = image.size[0] - positions[:, 0]
    if background.use_flip_y:
        positions[:, 1] = image.size[1] - positions[:, 1]
    points = (DISTANCE * camera.lens.unproject(positions) - camera.translation) @ camera.rotation
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=2, radius=MARK_RADIUS)
    mark = bpy.context.object.data
    vertices = np.array([vertex.co for vertex in mark.vertices])
    triangles = np.array([list(face.vertices) for face in mark.polygons])
    bpy.data.objects.remove(bpy.context.object)
    mesh = bpy.data.meshes.new("Marks")
    offsets = len(vertices) * np.arange(len(points))[:, None, None]
    mesh.from_pydata((points[:, None] + vertices).reshape(-1, 3).tolist(), [], (offsets + triangles).reshape(-1, 3).tolist())
    item = bpy.data.objects.new("Marks", mesh)
    item.color = (0.0, 0.0, 1.0, 1.0)
    bpy.context.scene.collection.objects.link(item)
    return item


def find_blobs(name: str, channel: int, region: bpy.types.Region) -> np.ndarray:
    """Return the centers (N, 2) in pixels of the blobs of a color in a screenshot of the viewport, without those at its border."""
    image = bpy.data.images.load(str(FOLDER / f"{name}.png"))
    image.colorspace_settings.is_data = True
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(image.size[1], image.size[0], 4)[region.y : region.y + region.height, region.x : region.x + region.width]
    others = [other for other in (RED, BLUE) if other != channel]
    mask = (pixels[..., channel] > 0.5) & (pixels[..., others[0]] < 0.2) & (pixels[..., 1] < 0.2)
    labels, count = ndimage.label(mask)
    if count == 0:
        return np.zeros((0, 2))
    centers = np.array(ndimage.center_of_mass(mask, labels, np.arange(1, count + 1)))[:, ::-1]
    inside = [min(y.start, x.start) > 0 and y.stop < region.height and x.stop < region.width for y, x in ndimage.find_objects(labels)]
    return centers[inside]


def compare(name: str, user: UserInput) -> Iterator[float]:
    """Compare dots and marks of one placement."""
    scene, item = bpy.context.scene, bpy.context.scene.camera
    background = item.data.background_images[0]
    camera = module("addon.bridge.photos.scene_cameras").read_photo_camera(item, scene, bpy.context.evaluated_depsgraph_get())
    marks = create_marks(camera, background.image)
    region, shots = user.region("WINDOW"), {}
    for channel in (RED, BLUE):
        marks.hide_set(channel == RED)
        item.data.show_background_images = channel == RED
        user.area.tag_redraw()
        yield 0.7
        shot = f"{name}-{'dots' if channel == RED else 'marks'}"
        save_screenshot(shot)
        shots[channel] = find_blobs(shot, channel, region)
    marks.hide_set(False)
    item.data.show_background_images = True
    user.area.tag_redraw()
    yield 0.7
    save_screenshot(f"{name}-both")
    distances = np.linalg.norm(shots[RED][:, None] - shots[BLUE][None], axis=2)
    results[name] = {
        "dots": len(shots[RED]),
        "marks": len(shots[BLUE]),
        "distance": float(distances.min(axis=1).max()) if distances.size else -1.0,
    }
    bpy.data.objects.remove(marks)


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = UserInput()
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    item = bpy.context.scene.camera
    image = create_photograph()
    set_up_viewport(user.area.spaces.active)
    scene, original = bpy.context.scene, item.data
    for name, (data, background, render, photograph) in PLACEMENTS.items():
        scene.render.resolution_x, scene.render.resolution_y = 1920, 1080
        scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1.0
        image.display_aspect = (1.0, 1.0)
        item.data = original.copy()
        item.scale = (2.0, 0.5, 3.0) if name == "scaled camera" else (1.0, 1.0, 1.0)
        placed = item.data.background_images.new()
        placed.image, placed.alpha = image, 1.0
        item.data.show_background_images, item.data.show_passepartout = True, False
        for owner, values in ((item.data, data), (placed, background), (scene.render, render), (image, photograph)):
            for key, value in values.items():
                setattr(owner, key, value)
        yield 0.5
        yield from compare(name, user)


start_session(session)
