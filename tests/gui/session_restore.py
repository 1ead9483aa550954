"""A session in a Blender window: paints a mask in the Image Editor, restores the image and undoes that, cancels once, restores again,
compares, undoes and redoes."""

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))  # Blender does not add the script's folder

from session import UserInput, current_job, module, open_panel_alone, results, save_screenshot, scene_state, start_session, wait_for_job

SIDE = 256
SCRATCH = (slice(75, 95), slice(30, 220))  # rows and columns
STROKE = 18  # mouse moves


class ImageEditorInput(UserInput):
    """Simulated input in an Image Editor, which replaces the 3D Viewport."""

    def __init__(self) -> None:
        super().__init__()
        self.area.ui_type = "IMAGE_EDITOR"

    def region(self, region_type: str) -> bpy.types.Region:
        """Return a region of the Image Editor."""
        return next(region for region in self.area.regions if region.type == region_type)

    @property
    def shown(self) -> bpy.types.Image:
        """The image in the editor."""
        return self.area.spaces.active.image

    def window_position(self, u: float, v: float) -> tuple[int, int]:
        """Return the position in the window of a point of the image in UV space."""
        region = self.region("WINDOW")
        x, y = region.view2d.view_to_region(u, v, clip=False)
        return region.x + int(x), region.y + int(y)

    def paint(self, start: tuple[float, float], stop: tuple[float, float]) -> Iterator[float]:
        """Paint a straight stroke between two points of the image in UV space."""
        positions = [self.window_position(*point) for point in np.linspace(start, stop, STROKE)]
        self.move(*positions[0])
        yield 0.3
        self.window.event_simulate(type="LEFTMOUSE", value="PRESS", x=positions[0][0], y=positions[0][1])
        for position in positions:
            self.move(*position)
            yield 0.05
        self.window.event_simulate(type="LEFTMOUSE", value="RELEASE", x=positions[-1][0], y=positions[-1][1])
        yield 1.5


def create_photograph() -> bpy.types.Image:
    """Create an image of bricks under a gradient, with a scratch that a user wants to remove."""
    random = np.random.default_rng(2)
    rows, columns = np.mgrid[:SIDE, :SIDE]
    shifted = columns + 16 * (rows // 16 % 2)
    is_mortar = (rows % 16 < 2) | (shifted % 32 < 2)
    brick = random.random((SIDE // 16, SIDE // 32 + 2))[rows // 16, shifted // 32]
    colors = np.where(is_mortar[..., None], (0.65, 0.62, 0.58), (0.55, 0.28, 0.2) + 0.12 * brick[..., None])
    colors = colors * (0.6 + 0.4 * rows / SIDE)[..., None] + 0.05 * random.standard_normal((SIDE, SIDE, 1))
    colors[SCRATCH] = (0.95, 0.95, 1.0)
    image = bpy.data.images.new("Mauer ü", SIDE, SIDE)
    image.pixels.foreach_set(np.dstack([colors.clip(0.0, 1.0), np.ones((SIDE, SIDE))]).astype(np.float32).ravel())
    image.update()
    image.pack()
    image.use_fake_user = True
    return image


def read(image: bpy.types.Image) -> np.ndarray:
    """Return the values (H, W, 4) of an image."""
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)


def add_wall(image: bpy.types.Image) -> bpy.types.ShaderNodeTexImage:
    """Give the cube a material that shows `image`; return the name of the material."""
    material = bpy.data.objects["Cube"].data.materials[0]
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    material.node_tree.links.new(node.outputs["Color"], material.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    return node


def wall_image() -> str:
    """Return the name of the image in the material of the cube."""
    nodes = bpy.data.objects["Cube"].data.materials[0].node_tree.nodes
    return next(node.image.name for node in nodes if node.type == "TEX_IMAGE")


def shown_name(user: ImageEditorInput) -> str | None:
    """Return the name of the image in the editor, None if it is empty."""
    return user.shown.name if user.shown else None


def session() -> Iterator[float]:
    """Run the session; yields pauses in seconds."""
    user = ImageEditorInput()
    source = create_photograph()
    add_wall(source)
    bpy.ops.ed.undo_push(message="Open Photograph")
    user.area.spaces.active.image = source
    open_panel_alone("restore", "structure_and_texture", "guides")
    yield from user.open_sidebar()
    outline = module("addon.bridge.restore.outline").outline
    group = bpy.context.scene.farfield_restore
    group.replace_in_materials, group.pyramid_levels = True, 2
    save_screenshot("1-panel")

    x, y = yield from user.find_button("farfield.restore_mask")
    user.press("LEFTMOUSE", x, y)
    yield 2.0
    tools = bpy.context.tool_settings
    left, right = user.window_position(0.0, 0.0)[0], user.window_position(1.0, 0.0)[0]
    results["brush"] = module("addon.compat").image_paint_settings(tools).size / (right - left)
    results["mask"] = {"name": user.shown.name, "mode": user.area.spaces.active.ui_mode}
    for row in (76, 82, 88, 94):
        yield from user.paint((25 / SIDE, row / SIDE), (225 / SIDE, row / SIDE))
    mask, source_name, mask_name = user.shown, source.name, user.shown.name
    results["painted"] = float((read(mask)[..., 0] > 0.5).mean())
    results["covered"] = float((read(mask)[SCRATCH][..., 0] > 0.5).mean())
    results["segments"] = len(outline.outlines[source.session_uid].segments)
    save_screenshot("2-painted")

    results["shown_with_mask"] = []
    yield from user.press_and_start("farfield.restore_image")
    yield from wait_for_job()
    yield 2.0
    for redo in (None, False, True, False):
        if redo is not None:
            yield from user.press_undo(redo=redo)
            yield 1.0
        results["shown_with_mask"].append([shown_name(user), user.area.spaces.active.ui_mode])
    save_screenshot("2-undone")
    source, mask = (bpy.data.images[name] for name in (source_name, mask_name))
    user.area.spaces.active.ui_mode = "VIEW"
    user.area.spaces.active.image = source
    yield 3.0
    save_screenshot("3-outline")
    bpy.ops.ed.undo_push(message="Paint Mask")
    results["before"], original = scene_state(), read(source)

    x, y = yield from user.press_and_start("farfield.restore_image")
    yield from wait_for_job(until_fraction=0.2)
    results["was_running"] = current_job() is not None
    save_screenshot("4-running")
    user.press("ESC", x, y)
    yield from wait_for_job()
    yield 0.5
    results["cancelled"] = scene_state()

    yield from user.press_and_start("farfield.restore_image")
    results["fractions"] = yield from wait_for_job()
    yield 3.0
    save_screenshot("5-restored")
    results["shown"], results["used"] = user.shown.name, wall_image()
    restored, outside = read(user.shown), read(mask)[..., 0] <= 0.5
    results["outside_unchanged"] = bool(np.array_equal(restored[outside], original[outside]))
    results["original_unchanged"] = bool(np.array_equal(read(source), original))
    results["scratch"] = float(restored[SCRATCH][..., 2].mean())
    results["wall"] = float(original[100:130, 30:220, 2].mean())

    for name in ("after_first_toggle", "after_second_toggle"):
        x, y = yield from user.find_button("farfield.restore_compare")
        user.press("LEFTMOUSE", x, y)
        yield 1.5
        results[name] = user.shown.name
        save_screenshot(f"6-{name}")
    x, y = yield from user.find_button("farfield.restore_outline")
    user.press("LEFTMOUSE", x, y)
    yield 1.5
    results["outline_hidden"] = outline.is_hidden
    save_screenshot("7-no-outline")

    yield from user.press_undo()
    yield 2.0
    results["after_undo"] = {"images": scene_state()["images"], "used": wall_image(), "shown": shown_name(user)}
    save_screenshot("8-undone")
    yield from user.press_undo(redo=True)
    yield 2.0
    results["after_redo"] = {"shown": shown_name(user), "used": wall_image()}
    results["same_pixels_after_redo"] = user.shown is not None and bool(np.array_equal(read(user.shown), restored))
    save_screenshot("9-redone")

    yield from user.press_and_start("farfield.restore_image")
    yield from wait_for_job()
    yield 2.0
    results["replaced"] = {"images": scene_state()["images"], "used": wall_image(), "shown": shown_name(user)}
    yield from user.press_undo()
    yield 2.0
    results["former_is_back"] = {"shown": shown_name(user), "same": bool(np.array_equal(read(user.shown), restored))}
    yield from user.press_and_start("farfield.restore_variant")
    yield from wait_for_job()
    yield 2.0
    results["variants"] = [shown_name(user)]
    for redo in (False, False, True, True):
        yield from user.press_undo(redo=redo)
        yield 2.0
        results["variants"].append(shown_name(user))
    save_screenshot("10-variant-redone")


start_session(session)
