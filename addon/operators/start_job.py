"""What all operators have in common that start a job with the settings of a panel."""

from typing import Any

import bpy

from ..core.settings import Settings
from . import long_work, properties


def setting_properties(*settings_types: type[Settings]) -> dict[str, Any]:
    """Return one Blender property per setting, as annotations of an operator. They do not keep the values of the previous call."""
    return {
        name: annotation
        for settings_type in settings_types
        for name, annotation in properties.build_annotations(settings_type, {"SKIP_SAVE"}).items()
    }


class StartJob(long_work.LongWork):
    """Mixin of operators that start a job. Settings that the caller omits come from the panel, not from the previous call.

    settings_types: of the settings, whose properties the operator declares. panel_property: the property of the scene that holds them.
    """

    settings_types: tuple[type[Settings], ...] = ()
    panel_property = ""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether the job can be started now."""
        return long_work.poll_with_reason(cls, cls.disabled_reason(context))

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        """Return why the job cannot be started now, or an empty string."""
        raise NotImplementedError

    def read_settings(self, context: bpy.types.Context) -> dict[type[Settings], Any]:
        """Return the settings of each type in `settings_types`, by type.

        Raises:
            SettingsError: a value is out of range.
        """
        for settings_type in self.settings_types:
            properties.fill_unset(settings_type, self, getattr(context.scene, self.panel_property))
        return {settings_type: properties.read(settings_type, self) for settings_type in self.settings_types}
