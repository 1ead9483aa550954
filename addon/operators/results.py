"""The latest result of each tool, which its panel shows: a string of the scene, so that undo of the result undoes it as well."""

import bpy

from ..core.messages import first_sentences, single_line, split_sentences
from .documentation import TOOLS
from .error_reports import report_message

STATUS_CHARS = 100  # that fit the status bar of a small window, followed by the number of further sentences
PROPERTY = "farfield_results"


class FARFIELD_PG_results(bpy.types.PropertyGroup):
    """The message of the latest result, by tool."""

    __annotations__ = {tool: bpy.props.StringProperty(options={"HIDDEN"}) for tool in TOOLS}


def tool_of(operator: str) -> str:
    """Return the tool of the operator with this identifier."""
    return operator.partition(".")[2].partition("_")[0]


def store_result(scene: bpy.types.Scene, tool: str, message: str) -> None:
    """Let the panel of a tool show `message`."""
    if scene.is_editable and tool in TOOLS:
        setattr(getattr(scene, PROPERTY), tool, single_line(message))


def read_result(scene: bpy.types.Scene, tool: str) -> list[str]:
    """Return the sentences of the latest result of a tool, none without a result."""
    return list(filter(None, split_sentences(getattr(getattr(scene, PROPERTY), tool))))


def report_result(operator: bpy.types.Operator, message: str) -> None:
    """Report `message`, and show its beginning and the number of its other sentences in the status bar, which shows the last report, if it
    is too long for it."""
    message = single_line(message)
    report_message(operator, message)
    first = first_sentences(message, STATUS_CHARS)
    others = len(split_sentences(message)) - len(split_sentences(first))
    if others:
        report_message(operator, f"{first} {others} more under Details.")


def show_result(operator: bpy.types.Operator, scene: bpy.types.Scene, message: str) -> None:
    """Report `message` as `report_result` does, and let the panel of the operator's tool show it in place of its latest result."""
    store_result(scene, tool_of(type(operator).bl_idname), message)
    report_result(operator, message)


register_classes, unregister_classes = bpy.utils.register_classes_factory((FARFIELD_PG_results,))


def register() -> None:
    """Add the results to scenes."""
    register_classes()
    setattr(bpy.types.Scene, PROPERTY, bpy.props.PointerProperty(type=FARFIELD_PG_results))


def unregister() -> None:
    """Undo `register`."""
    delattr(bpy.types.Scene, PROPERTY)
    unregister_classes()
