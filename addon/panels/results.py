"""The latest result at the end of the panel of each tool: its first sentences, and a button for the others."""

from collections.abc import Sequence

import bpy

from ..core.messages import first_sentences, split_sentences
from ..operators import documentation, long_work, results
from .sidebar import ToolPanel, draw_message

PANEL_CHARS = 180  # Of the sentences on the panel, about six lines.
DETAILS_WIDTH = 520  # pixels at scale 1
DETAILS_CHARS = 84  # per line of this width
OTHER_PANELS = ("FARFIELD_PT_unwrap_uv_editor",)  # for tools that have one in two editors


class FARFIELD_OT_details(bpy.types.Operator):
    """Show all sentences of this report"""

    bl_idname = "farfield.details"
    bl_label = "Details"
    bl_options = {"INTERNAL"}
    __annotations__ = {"text": bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})}  # one sentence per line

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Open the popup."""
        return context.window_manager.invoke_popup(self, width=DETAILS_WIDTH)

    def execute(self, _context: bpy.types.Context) -> set[str]:
        """Do nothing more."""
        return {"FINISHED"}

    def draw(self, _context: bpy.types.Context) -> None:
        """Draw the sentences."""
        column = self.layout.column()
        for sentence in self.text.splitlines():
            draw_message(column, sentence, "DOT", DETAILS_CHARS)


def draw_details(layout: bpy.types.UILayout, sentences: Sequence[str], label: str) -> None:
    """Draw a button that opens these sentences."""
    layout.operator(FARFIELD_OT_details.bl_idname, text=label, icon="TEXT").text = "\n".join(sentences)


def draw_result(panel: ToolPanel, context: bpy.types.Context) -> None:
    """Draw the first sentences of the latest result, and the button if there are more. While a job runs they are disabled, and keep the
    height of the panel."""
    sentences = results.read_result(context.scene, panel.page)
    if not sentences:
        return
    column = panel.layout.box().column()
    column.enabled = long_work.current_run() is None
    shown = split_sentences(first_sentences(" ".join(sentences), PANEL_CHARS))
    for index, sentence in enumerate(shown):
        draw_message(column, sentence, "BLANK1" if index else "CHECKMARK")
    others = len(sentences) - len(shown)
    if others:
        draw_details(column, sentences, f"Details ({others:,} more)")


def panel_types() -> list[type[bpy.types.Panel]]:
    """Return the panels that show results."""
    return [getattr(bpy.types, name) for name in (*(f"FARFIELD_PT_{tool}" for tool in documentation.TOOLS), *OTHER_PANELS)]


def register() -> None:
    """Register the operator, and extend the panels, which are registered before."""
    bpy.utils.register_class(FARFIELD_OT_details)
    for panel in panel_types():
        panel.append(draw_result)


def unregister() -> None:
    """Undo `register`."""
    for panel in panel_types():
        panel.remove(draw_result)
    bpy.utils.unregister_class(FARFIELD_OT_details)
