"""A session in a Blender window: clicks pairs of points in two editors, registers the photograph, and undoes it."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import UserInput, module, open_panel_alone, results, save_screenshot, scene_state, start_session

SIZE = (640, 480)
FOCAL = 700.0
POSITION = np.array([1.6, -5.2, 2.4])


class TwoEditors(UserInput):
    """Simulated input in an Image Editor, which is `area`, next to a 3D Viewport."""

    def __init__(self) -> None:
        super().__init__()
        self.view = self.area
        with bpy.context.temp_override(window=self.window, area=self.view, region=self.view.regions[0]):
            bpy.ops.screen.area_split(direction="VERTICAL", factor=0.4)
        areas = [area for area in self.window.screen.areas if area.type == "VIEW_3D"]
        self.area = max(areas, key=lambda area: area.x)
        self.view = min(areas, key=lambda area: area.x)
        self.area.ui_type = "IMAGE_EDITOR"

    def region(self, region_type: str) -> bpy.types.Region:
        """Return a region of the Image Editor."""
        return next(region for region in self.area.regions if region.type == region_type)

    def click(self, x: float, y: float) -> Iterator[float]:
        """Move the mouse and click."""
        self.move(round(x), round(y))
        yield 0.2
        self.press("LEFTMOUSE", round(x), round(y))
        yield 0.3

    def click_image(self, position: np.ndarray) -> Iterator[float]:
        """Click a position of the photograph in pixels."""
        region = self.region("WINDOW")
        x, y = region.view2d.view_to_region(*(position / SIZE), clip=False)
        yield from self.click(region.x + x, region.y + y)

    def click_mesh(self, point: np.ndarray) -> Iterator[float]:
        """Click a place in the 3D Viewport."""
        region = next(region for region in self.view.regions if region.type == "WINDOW")
        x, y = location_3d_to_region_2d(region, self.view.spaces.active.region_3d, point)
        yield from self.click(region.x + x, region.y + y)


def camera_axes() -> np.ndarray:
    """Return the axes (3, 3) of a camera at POSITION that looks at the origin: right, up, and backwards, in rows."""
    backward = POSITION / np.linalg.norm(POSITION)
    right = np.cross([0.0, 0.0, 1.0], backward)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(backward, right), backward])


def project(points: np.ndarray) -> np.ndarray:
    """Return the positions (N, 2) of points (N, 3) in the photograph, in pixels."""
    local = (points - POSITION) @ camera_axes().T
    return 0.5 * np.array(SIZE) + FOCAL * local[:, :2] / -local[:, 2:]


def visible_points() -> np.ndarray:
    """Return places on the sides of the cube that face both the camera and the viewer."""
    u = np.array([-0.7, 0.0, 0.7])
    front = [(x, -1.0, z) for x in u for z in (-0.6, 0.6)]
    right = [(1.0, y, z) for y in u for z in (-0.6, 0.6)]
    return np.array(front + right)


def create_photograph() -> bpy.types.Image:
    """Create a picture of the cube: the pixels that it covers are brighter."""
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    directions = np.stack([(columns - 0.5 * SIZE[0]) / FOCAL, (rows - 0.5 * SIZE[1]) / FOCAL, -np.ones(SIZE[::-1])], axis=-1)
    directions = directions @ camera_axes()
    with np.errstate(divide="ignore"):
        slabs = (np.stack([-1.0 - POSITION, 1.0 - POSITION])[:, None, None] / directions[None]).astype(float)
    near, far = slabs.min(axis=0).max(axis=-1), slabs.max(axis=0).min(axis=-1)
    pixels = np.ones((*SIZE[::-1], 4), np.float32)
    hit = POSITION + near[..., None] * directions
    checker = np.floor(hit * 2.5).sum(axis=-1) % 2
    pixels[..., :3] = np.where(near < far, 0.5 + 0.3 * checker, 0.15)[..., None]
    image = bpy.data.images.new("Aufnahme ü", *SIZE)
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    image.use_fake_user = True
    return image


def read_panel(user: TwoEditors) -> tuple[list[str], list[bool], str]:
    """Return the texts that the panel *Register Photograph* draws, whether each button is pressed, and why *Add Pairs* is disabled."""
    panel, texts, pressed = bpy.types.FARFIELD_PT_photos_registration, [], []

    class Layout:
        def label(self, text="", **_options):
            texts.append(text)

        def operator(self, _operator, text="", depress=False, **_options):
            pressed.append(depress)
            return self

        def __getattr__(self, name):
            return lambda *_arguments, **_options: self

    with bpy.context.temp_override(window=user.window, area=user.area, region=user.region("UI")):
        panel.draw(SimpleNamespace(layout=Layout()), bpy.context)
        reason = module("addon.operators.photos.registration").FARFIELD_OT_photos_add_pairs.disabled_reason(bpy.context)
    return texts, pressed, reason


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    for name in ("Camera", "Light"):
        bpy.data.objects.remove(bpy.data.objects[name])
    image = create_photograph()
    user = TwoEditors()
    yield 1.0
    user.area.spaces.active.image = image
    view = user.view.spaces.active.region_3d
    view.view_perspective = "PERSP"
    view.view_rotation = (0.78, 0.46, 0.22, 0.36)  # from the front, the right and above
    view.view_distance = 7.0
    bpy.ops.ed.undo_push(message="Create Photograph")
    open_panel_alone("photos")
    yield from user.open_sidebar()
    with bpy.context.temp_override(window=user.window, area=user.area, region=user.region("WINDOW")):
        bpy.ops.image.view_all(fit_view=False)
        bpy.ops.image.view_pan(offset=(130.0, 0.0))
    yield 1.0
    results["before"] = scene_state()
    save_screenshot("1-panel")

    user.view.ui_type = "OUTLINER"
    yield 1.0
    results["without_view"] = read_panel(user)
    save_screenshot("1-without-view")
    user.view.ui_type = "VIEW_3D"
    yield 1.0
    results["idle"] = read_panel(user)

    points = visible_points()
    positions = project(points)
    x, y = yield from user.find_button("farfield.photos_add_pairs")
    user.press("LEFTMOUSE", x, y)
    yield 0.5
    results["started"] = read_panel(user)
    save_screenshot("1-started")
    yield from user.click_image(positions[0])
    results["clicked_photograph"] = read_panel(user)
    yield from user.click_mesh(points[0])
    results["clicked_mesh"] = read_panel(user)
    results["pairs_before_esc"] = len(image.farfield_registration.pairs)
    user.press("ESC", x, y)
    yield 0.5
    results["pairs_after_esc"] = len(image.farfield_registration.pairs)
    results["after_esc"] = read_panel(user)

    for _ in range(2):
        user.press("LEFTMOUSE", *(yield from user.find_button("farfield.photos_add_pairs")))
        yield 0.5
        results.setdefault("toggled", []).append(read_panel(user)[1][0])

    x, y = yield from user.find_button("farfield.photos_add_pairs")
    user.press("LEFTMOUSE", x, y)
    yield 0.5
    for index, (point, position) in enumerate(zip(points, positions, strict=True)):
        steps = [user.click_image(position), user.click_mesh(point)]
        for step in steps if index % 2 else reversed(steps):
            yield from step
    yield from user.click_image(positions[0])
    results["pairs_with_incomplete"] = len(image.farfield_registration.pairs)
    user.press("BACK_SPACE", x, y)
    yield 0.5
    save_screenshot("2-pairs")
    user.press("RET", x, y)
    yield 0.5
    pairs = image.farfield_registration.pairs
    results["pairs"] = len(pairs)
    results["point_errors"] = [float(np.linalg.norm(np.array(pair.point) - point)) for pair, point in zip(pairs, points, strict=True)]
    results["position_errors"] = [
        float(np.linalg.norm(np.array(pair.position) - position)) for pair, position in zip(pairs, positions, strict=True)
    ]

    x, y = yield from user.find_button("farfield.photos_register")
    user.press("LEFTMOUSE", x, y)
    yield 2.0
    save_screenshot("3-registered")
    cameras = [item for item in bpy.data.objects if item.type == "CAMERA"]
    results["cameras"] = [item.name for item in cameras]
    results["distance"] = float(np.linalg.norm(np.array(cameras[0].location) - POSITION)) if cameras else None
    results["residuals"] = [float(np.linalg.norm(pair.residual)) for pair in image.farfield_registration.pairs]
    user.view.spaces.active.region_3d.view_perspective = "CAMERA"
    bpy.context.scene.camera = cameras[0]
    yield 2.0
    save_screenshot("4-camera-view")
    bpy.context.scene.camera = None
    region = next(region for region in user.view.regions if region.type == "WINDOW")
    user.move(region.x + region.width // 2, region.y + region.height // 2)
    yield 0.5
    user.press("Z", region.x + region.width // 2, region.y + region.height // 2, ctrl=True)
    yield 1.5
    results["cameras_after_undo"] = [item.name for item in bpy.data.objects if item.type == "CAMERA"]
    results["pairs_after_undo"] = len(bpy.data.images["Aufnahme ü"].farfield_registration.pairs)
    save_screenshot("5-undone")


start_session(session)
