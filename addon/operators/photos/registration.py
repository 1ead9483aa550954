"""Operators that register the photograph in an Image Editor by pairs of points, which are clicked there and in 3D Viewports."""

import bpy
import numpy as np
from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

from ...bridge.photos import point_pairs
from ...bridge.photos.camera_objects import place_registered_camera
from ...bridge.photos.pair_markers import markers, redraw_editors
from ...bridge.photos.point_pairs import PROPERTY
from ...bridge.photos.scene_cameras import has_photograph, read_photo_camera
from ...core.errors import SettingsError
from ...core.geometry.lenses import Lens
from ...core.messages import format_count
from .. import image_editors, long_work
from ..error_reports import report_message, reports_errors

NO_IMAGE = "Open a photograph in the Image Editor"
NO_VIEW = "Open a 3D Viewport next to the Image Editor"
HELP = "Click a place in the photograph and the same place on the mesh. Backspace: Remove Last, Enter: Finish, Esc: Cancel"
PASSED_EVENTS = {"MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "MOUSEROTATE", "NDOF_MOTION"}


def find_image_problem(context: bpy.types.Context) -> str:
    """Return why the photograph cannot be registered, or an empty string."""
    image = image_editors.shown_image(context)
    if image is None or image.type != "IMAGE" or image.source not in {"FILE", "GENERATED"}:
        return NO_IMAGE
    return "" if image.library is None else "The photograph is linked from a library; make it local"


class _ImageOperator:
    """Mixin of the operators, which need an Image Editor with an image, or its name."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether there is an image to work on."""
        return long_work.poll_with_reason(cls, cls.disabled_reason(context))

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why there is nothing to work on, or an empty string."""
        return find_image_problem(context) if image_editors.is_image_editor(context) else ""

    def find_image(self, context: bpy.types.Context) -> bpy.types.Image:
        """Return the image of this name, or the one in the editor. Raises SettingsError if there is none, or it has no pixels."""
        image = bpy.data.images.get(self.image) if self.image else image_editors.shown_image(context)
        if image is None:
            raise SettingsError(f'There is no image "{self.image}".' if self.image else f"{NO_IMAGE}.")
        if 0 in image.size:
            raise SettingsError(f'"{image.name}" has no pixels; check its file.')
        return image


IMAGE_PROPERTY = bpy.props.StringProperty(
    name="Image", description="Name of the photograph; by default the one in the Image Editor", options={"SKIP_SAVE"}
)


class FARFIELD_OT_photos_add_pairs(_ImageOperator, bpy.types.Operator):
    """Click places in the photograph and the same places on the mesh in a 3D Viewport. Press again, or Enter, to finish"""

    bl_idname = "farfield.photos_add_pairs"
    bl_label = "Add Pairs of Points"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = {
        "image": IMAGE_PROPERTY,
        "is_finished": bpy.props.BoolProperty(description="Set by a second call", options={"HIDDEN", "SKIP_SAVE"}),
    }

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why there is no place to click, or an empty string."""
        has_view = context.window is None or any(area.type == "VIEW_3D" for area in context.window.screen.areas)
        return super().disabled_reason(context) or ("" if has_view else NO_VIEW)

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start to wait for clicks, or end that if it was started before."""
        running = find_running(context)
        if running is not None:
            running.properties.is_finished = True
            return {"CANCELLED"}
        image = self.find_image(context)
        self.image = image.name
        self._former = point_pairs.copy_pairs(image)
        self._was_registered = getattr(image, PROPERTY).is_registered
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(HELP)
        context.window.cursor_modal_set("CROSSHAIR")
        redraw_editors()
        return {"RUNNING_MODAL"}

    @reports_errors
    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Add the point under the mouse, or finish."""
        goes_on = False
        try:
            result = self._handle(context, event)
            goes_on = result not in ({"FINISHED"}, {"CANCELLED"})
            return result
        finally:
            if not goes_on:
                self._end(context)

    def _handle(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        image = bpy.data.images.get(self.image)
        if image is None:
            raise SettingsError(f'"{self.image}" was removed.')
        is_enter = event.type in {"RET", "NUMPAD_ENTER"} and event.value == "PRESS"
        if is_enter or self.is_finished:
            point_pairs.remove_incomplete(image)
            return {"FINISHED"}
        if event.type in PASSED_EVENTS or event.value != "PRESS":
            return {"PASS_THROUGH"}
        if event.type == "ESC":
            point_pairs.restore_pairs(image, self._former, is_registered=self._was_registered)
            return {"CANCELLED"}
        if event.type == "BACK_SPACE":
            count = len(getattr(image, PROPERTY).pairs)
            if count:
                point_pairs.remove_pair(image, count - 1)
        elif event.type == "LEFTMOUSE":
            area, region = _find_region(context, event)
            if area is None:
                return {"PASS_THROUGH"}
            mouse = (event.mouse_x - region.x, event.mouse_y - region.y)
            if area.type == "VIEW_3D":
                self._click_view(context, image, area, region, mouse)
            elif area.spaces.active.image == image:
                position = np.array(region.view2d.region_to_view(*mouse)) * np.array(image.size)
                if (position < 0.0).any() or (position > np.array(image.size)).any():
                    report_message(self, "Click inside the photograph.", "WARNING")
                else:
                    point_pairs.add_position(image, position)
            else:
                report_message(self, f'Click in the Image Editor that shows "{image.name}".', "WARNING")
        else:
            return {"PASS_THROUGH"}
        redraw_editors()
        return {"RUNNING_MODAL"}

    def _click_view(
        self, context: bpy.types.Context, image: bpy.types.Image, area: bpy.types.Area, region: bpy.types.Region, mouse: tuple[int, int]
    ) -> None:
        view = area.spaces.active.region_3d
        origin, direction = region_2d_to_origin_3d(region, view, mouse), region_2d_to_vector_3d(region, view, mouse)
        is_hit, point, *_ = context.scene.ray_cast(context.evaluated_depsgraph_get(), origin, direction)
        if is_hit:
            point_pairs.add_point(image, np.array(point))
        else:
            report_message(self, "There is no mesh at this place; click on a visible one.", "WARNING")

    def _end(self, context: bpy.types.Context) -> None:
        context.workspace.status_text_set(None)
        context.window.cursor_modal_restore()
        redraw_editors()


def find_running(context: bpy.types.Context) -> bpy.types.Operator | None:
    """Return the operator that waits for clicks in the window of `context`, None if there is none."""
    operators = () if context.window is None else context.window.modal_operators
    return next((item for item in operators if item.bl_idname == FARFIELD_OT_photos_add_pairs.__name__), None)


def describe_next_step(image: bpy.types.Image) -> str:
    """Return where the user is to click next for the pairs of `image`."""
    pairs = getattr(image, PROPERTY).pairs
    if not len(pairs) or pairs[-1].has_point == pairs[-1].has_position:
        return "Click a point in the photograph, then the same point on the mesh"
    return f"Click the same point {'on the mesh' if pairs[-1].has_position else 'in the photograph'}"


class FARFIELD_OT_photos_remove_pair(_ImageOperator, bpy.types.Operator):
    """Remove a pair of points"""

    bl_idname = "farfield.photos_remove_pair"
    bl_label = "Remove Pair of Points"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = {
        "image": IMAGE_PROPERTY,
        "index": bpy.props.IntProperty(name="Index", description="Of the pair; -1 removes all", default=-1, min=-1, options={"SKIP_SAVE"}),
    }

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Remove it."""
        image = self.find_image(context)
        count = len(getattr(image, PROPERTY).pairs)
        if self.index >= count:
            raise SettingsError(f'"{image.name}" has {format_count(count, "pair")} of points.')
        for index in reversed(range(count)) if self.index < 0 else (self.index,):
            point_pairs.remove_pair(image, index)
        redraw_editors()
        return {"FINISHED"}


class FARFIELD_OT_photos_register(_ImageOperator, bpy.types.Operator):
    """Find the camera of the photograph from pairs of points, and create or move a camera object with it as background image"""

    bl_idname = "farfield.photos_register"
    bl_label = "Register Photograph"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = {"image": IMAGE_PROPERTY}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Register the photograph."""
        image = self.find_image(context)
        lens = self._read_lens(context, image)
        found = point_pairs.register_image(image, lens)
        item = place_registered_camera(found.camera, image, context.scene)
        redraw_editors()
        message = f'Registered "{item.name}": {found.mean_error:.2f} pixels on average.'
        wrong = [str(index + 1) for index, is_wrong in zip(point_pairs.read_pairs(image)[0], found.is_wrong, strict=True) if is_wrong]
        if wrong:
            message += f" {'Pair' if len(wrong) == 1 else 'Pairs'} {', '.join(wrong)} did not fit to the others and had no influence."
        report_message(self, message, "WARNING" if wrong else "INFO")
        return {"FINISHED"}

    def _read_lens(self, context: bpy.types.Context, image: bpy.types.Image) -> Lens | None:
        """Return the lens of the camera that the user has chosen. Raises SettingsError."""
        item = getattr(image, PROPERTY).lens_camera
        if item is None:
            return None
        if not has_photograph(item):
            raise SettingsError(f'The camera "{item.name}" has no photograph as background image; choose another lens.')
        lens = read_photo_camera(item, context.scene, context.evaluated_depsgraph_get()).lens
        if lens.size != tuple(image.size):
            raise SettingsError(
                f'The photograph of "{item.name}" has {lens.size[0]} x {lens.size[1]} pixels and "{image.name}" {image.size[0]} x '
                f"{image.size[1]}; choose the lens of a photograph of the same size, or none."
            )
        return lens


def _find_region(context: bpy.types.Context, event: bpy.types.Event) -> tuple[bpy.types.Area, bpy.types.Region] | tuple[None, None]:
    """Return the 3D Viewport or Image Editor under the mouse and its main region, unless the mouse is over its header or a sidebar."""
    for area in context.window.screen.areas:
        if area.type in {"VIEW_3D", "IMAGE_EDITOR"}:
            inside = [region for region in area.regions if region.width > 1 and _contains(region, event)]
            if len(inside) == 1 and inside[0].type == "WINDOW":
                return area, inside[0]
    return None, None


def _contains(region: bpy.types.Region, event: bpy.types.Event) -> bool:
    return 0 <= event.mouse_x - region.x < region.width and 0 <= event.mouse_y - region.y < region.height


CLASSES = (FARFIELD_OT_photos_add_pairs, FARFIELD_OT_photos_remove_pair, FARFIELD_OT_photos_register)
register_classes, unregister_classes = bpy.utils.register_classes_factory(CLASSES)


def register() -> None:
    """Register the classes, give images their pairs, and draw them in windows."""
    point_pairs.add_properties()
    register_classes()
    if not bpy.app.background:
        markers.start()


def unregister() -> None:
    """Undo `register`."""
    markers.stop()
    unregister_classes()
    point_pairs.remove_properties()
