"""How operators, timers and handlers report results and errors: one line, and the traceback of a defect in a log."""

import functools
import platform
from collections.abc import Callable

import bpy

from ..compat import blender_version
from ..core.bundled_modules import BUNDLED_MODULES
from ..core.errors import Cancelled, FarfieldError
from ..core.files.defect_log import defect_message, write_defect_log
from ..core.messages import single_line


def describe_error(error: Exception, title: str) -> str:
    """Return one sentence about `error`, which is being handled, on one line. A defect is written to a log, which the sentence names.

    title: what failed.
    """
    if isinstance(error, FarfieldError):
        return single_line(error)
    if isinstance(error, MemoryError):
        return f"{title} needs more memory than is free; close other programs or choose smaller settings."
    if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in BUNDLED_MODULES:
        return (
            f"{title} needs the module {error.name}, which Blender's Python {platform.python_version()} cannot load; install the zip "
            "of Farfield that is made for it."
        )
    return single_line(defect_message(title, error, write_defect_log(title, error, (f"Blender {blender_version()}",))))


def report_message(operator: bpy.types.Operator, message: str, level: str = "INFO") -> None:
    """Show `message` to the user on one line. level: "INFO", "WARNING" or "ERROR"."""
    operator.report({level}, single_line(message))


def report_error(operator: bpy.types.Operator, error: Exception, title: str = "") -> set[str]:
    """Report `error`, which is being handled, to the user and return the result of the operator.

    title: what failed; by default the label of the operator.
    """
    report_message(operator, describe_error(error, title or operator.bl_label), "INFO" if isinstance(error, Cancelled) else "ERROR")
    return {"CANCELLED"}


def reports_errors(method: Callable[..., set[str]]) -> Callable[..., set[str]]:
    """Decorate `execute`, `invoke` or `modal` of an operator: its errors are reported, and the operator is cancelled."""
    if method.__code__.co_argcount == 2:  # Blender counts the arguments of the method that it calls

        def run(self: bpy.types.Operator, context: bpy.types.Context) -> set[str]:
            try:
                return method(self, context)
            except Exception as error:  # noqa: BLE001 catch-all, see CONTRIBUTING.md
                return report_error(self, error)

    else:

        def run(self: bpy.types.Operator, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
            try:
                return method(self, context, event)
            except Exception as error:  # noqa: BLE001
                return report_error(self, error)

    return functools.wraps(method)(run)
