"""The cache of the user, with what interrupted jobs have finished, and the preferences of the extension."""

import shutil
from pathlib import Path

import bpy

from ..core.files.file_access import convert_os_errors, folder_bytes
from ..core.files.user_folders import user_cache_folder
from ..core.jobs import heartbeat
from ..core.messages import format_bytes
from . import long_work
from .error_reports import report_message, reports_errors

PACKAGE = __package__.partition(".addon.")[0]
CACHED_TOOLS = ("btf",)


def cache_folder(tool: str) -> Path:
    """Return the folder for what interrupted jobs of a tool have finished: in that of the extension, or in a checkout in the user's cache.

    Raises:
        FileError: the user has no folder for caches.
    """
    return (Path(bpy.utils.extension_path_user(PACKAGE)) if PACKAGE.startswith("bl_ext.") else user_cache_folder()) / tool


def cached_folders() -> list[Path]:
    """Return the folders of all interrupted jobs, not those of jobs that run, also in another Blender. Raises FileError, OSError."""
    parents = [cache_folder(tool) for tool in CACHED_TOOLS]
    folders = [folder for parent in parents if parent.is_dir() for folder in parent.iterdir()]
    return [folder for folder in folders if folder.is_dir() and not folder.is_symlink() and not heartbeat.is_alive(folder)]


def process_count() -> int:
    """Return the number of worker processes in the preferences, 0 for automatic or without preferences."""
    addon = bpy.context.preferences.addons.get(PACKAGE)
    return getattr(addon.preferences, "processes", 0) if addon is not None else 0


class FARFIELD_OT_clear_cache(bpy.types.Operator):
    """Delete what interrupted jobs have finished, so that they start from the beginning. Nothing that a file uses is lost"""

    bl_idname = "farfield.clear_cache"
    bl_label = "Clear Cache of Farfield"
    bl_options = {"INTERNAL"}

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        """Return whether no job runs."""
        return long_work.poll_with_reason(cls, long_work.running_job_message())

    @reports_errors
    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask first."""
        return context.window_manager.invoke_confirm(self, event, title="Delete the Cache of Farfield?", confirm_text="Delete")

    @reports_errors
    def execute(self, _context: bpy.types.Context) -> set[str]:
        """Delete the folders."""
        freed = 0
        with convert_os_errors("Cannot delete the cache"):
            for folder in cached_folders():
                freed += folder_bytes(folder)
                shutil.rmtree(folder)
        report_message(self, f"Freed {format_bytes(freed)}.")
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((FARFIELD_OT_clear_cache,))
