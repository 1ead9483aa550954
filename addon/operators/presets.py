"""Presets of the settings of any tool: those that ship with the extension, and those of the user, see `core/presets.py`.

The settings are those of the property groups of the scene whose names begin with `farfield_<tool>` and which have `settings_types`.
"""

from pathlib import Path
from typing import ClassVar

import bpy

from ..core.errors import FileError, SettingsError
from ..core.files.file_access import convert_os_errors
from ..core.messages import format_count
from ..core.presets import Preset, describe_values, list_presets, preset_path, preset_settings, read_preset, write_preset
from ..core.settings import Settings
from . import documentation, long_work, properties
from .error_reports import report_message, reports_errors

BUILT_IN = documentation.ROOT / "addon" / "presets"


def user_folder(tool: str) -> Path:
    """Return the folder of the user's presets of a tool, next to Blender's own; it may not exist yet."""
    return Path(bpy.utils.user_resource("SCRIPTS", path=str(Path("presets", "farfield", tool))))


def find_presets(tool: str) -> dict[str, Path]:
    """Return the files of the presets of a tool by name: those of the extension, then those of the user, which replace others."""
    return {path.stem: path for folder in (BUILT_IN / tool, user_folder(tool)) for path in list_presets(folder)}


def settings_groups(scene: bpy.types.Scene, tool: str) -> list[bpy.types.PropertyGroup]:
    """Return the property groups of a scene with the settings of a tool that presets hold."""
    names = [item.identifier for item in scene.bl_rna.properties]
    groups = [getattr(scene, name) for name in names if f"{name}_".startswith(f"farfield_{tool}_")]
    return [group for group in groups if hasattr(group, "settings_types")]


def settings_types(scene: bpy.types.Scene, tool: str) -> list[type[Settings]]:
    """Return the types of the settings of a tool that presets hold."""
    return [each for group in settings_groups(scene, tool) for each in group.settings_types]


def find_preset(tool: str, name: str) -> Path:
    """Return the file of the preset `name`. Raises FileError if there is none."""
    path = find_presets(tool).get(name)
    if path is None:
        raise FileError(f'There is no preset "{name}"; choose another one.')
    return path


class PresetOperator:
    """Mixin of the operators of presets."""

    __annotations__: ClassVar = {
        "tool": bpy.props.EnumProperty(
            name="Tool", items=[(tool, tool, "") for tool in documentation.TOOLS], options={"HIDDEN", "SKIP_SAVE"}
        ),
        "name": bpy.props.StringProperty(name="Name", description="Name of the preset", options={"SKIP_SAVE"}),
    }

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the settings can be changed now: a running job has read them."""
        reason = "" if context.scene.is_editable else "The scene is linked from a library"
        return long_work.poll_with_reason(cls, long_work.running_job_message() or reason)


class FARFIELD_OT_preset_apply(PresetOperator, bpy.types.Operator):
    """Set the settings of a tool to those of a preset. Settings that it does not name get their defaults; files and objects stay"""

    bl_idname = "farfield.preset_apply"
    bl_label = "Apply Preset of Farfield"
    bl_options = {"REGISTER", "UNDO"}
    __annotations__ = PresetOperator.__annotations__

    @classmethod
    def description(cls, context: bpy.types.Context, chosen: bpy.types.OperatorProperties) -> str:
        """Return what the preset is for and what it sets, or why it cannot be applied."""
        if not chosen.name:
            return "Set all settings of this tool to their defaults"
        types = settings_types(context.scene, chosen.tool)
        try:
            preset = read_preset(find_preset(chosen.tool, chosen.name), types)
        except (FileError, SettingsError) as error:
            return str(error)
        return ". ".join(filter(None, [preset.description, describe_values(preset, types)]))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Read and check the whole preset, then set all settings."""
        types = settings_types(context.scene, self.tool)
        preset = read_preset(find_preset(self.tool, self.name), types) if self.name else Preset()
        for group in settings_groups(context.scene, self.tool):
            for item in preset_settings(group.settings_types):
                setattr(group, item.name, properties.to_blender(item, preset.values.get(item.name, item.default)))
        long_work.redraw_sidebars(context.window_manager)  # Blender redraws only the menu, which stays open.
        count = format_count(len(preset.values), "setting")
        report_message(
            self, f'Preset "{self.name}": {count} changed from the defaults.' if self.name else "All settings have their defaults."
        )
        return {"FINISHED"}


class FARFIELD_OT_preset_save(PresetOperator, bpy.types.Operator):
    """Save the settings of this tool that differ from their defaults as a preset. It replaces your preset of the same name"""

    bl_idname = "farfield.preset_save"
    bl_label = "Save Preset of Farfield"
    bl_options = {"REGISTER"}
    __annotations__ = PresetOperator.__annotations__

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Write the preset."""
        if not self.name.strip():
            raise SettingsError("The preset needs a name; type one next to the button.", ("name",))
        path = preset_path(user_folder(self.tool), self.name.strip())
        if preset_path(BUILT_IN / self.tool, path.stem).exists():
            raise SettingsError(f'"{path.stem}" is a preset of Farfield; choose another name.', ("name",))
        values = {}
        for group in settings_groups(context.scene, self.tool):
            for each in group.settings_types:
                settings = properties.read(each, group)
                found = {item.name: (getattr(settings, item.name), item.default) for item in preset_settings([each])}
                values |= {name: value for name, (value, default) in found.items() if value != default}
        write_preset(path, Preset(values=values))
        report_message(self, f'Saved preset "{path.stem}" with {format_count(len(values), "setting")}.')
        return {"FINISHED"}


class FARFIELD_OT_preset_remove(PresetOperator, bpy.types.Operator):
    """Delete your preset. Settings stay as they are"""

    bl_idname = "farfield.preset_remove"
    bl_label = "Delete Preset of Farfield"
    bl_options = {"REGISTER"}
    __annotations__ = PresetOperator.__annotations__

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask first: a file cannot be brought back by undo."""
        return context.window_manager.invoke_confirm(self, event, title=f'Delete Preset "{self.name}"?', confirm_text="Delete")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Delete the file."""
        path = preset_path(user_folder(self.tool), self.name)
        if not path.is_file():
            raise FileError(f'You have no preset "{self.name}"; those of Farfield stay.')
        with convert_os_errors(f'Cannot delete "{path}"'):
            path.unlink()
        report_message(self, f'Deleted preset "{path.stem}".')
        return {"FINISHED"}


CLASSES = (FARFIELD_OT_preset_apply, FARFIELD_OT_preset_save, FARFIELD_OT_preset_remove)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
