"""Operator *View in Browser* of the tool `packages`: shows the package that was exported last in the user's web browser."""

import webbrowser
from contextlib import ExitStack
from pathlib import Path

import bpy

from ...core.packages.local_server import LocalServer
from .. import long_work
from ..error_reports import reports_errors

_running = ExitStack()  # The server of the package that is shown; one at a time.


class FARFIELD_OT_packages_view(bpy.types.Operator):
    """Show the package that was exported last in the web browser. Only this machine can read it, until Blender ends"""

    bl_idname = "farfield.packages_view"
    bl_label = "View Package in Browser"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Return whether a package was exported from the scene."""
        return long_work.poll_with_reason(cls, "" if context.scene.farfield_packages.exported else "Export a package first")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> set[str]:
        """Serve the package and open its page."""
        server = LocalServer(Path(context.scene.farfield_packages.exported))
        _running.close()
        _running.callback(server.close)
        webbrowser.open(server.url)
        self.report({"INFO"}, f"The package is shown at {server.url}, on this machine only")
        return {"FINISHED"}


register, unregister_class = bpy.utils.register_classes_factory((FARFIELD_OT_packages_view,))


def unregister() -> None:
    """End the server and unregister the operator."""
    _running.close()
    unregister_class()
