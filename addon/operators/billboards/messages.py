"""Sentences about clouds and originals whose visibility an operator could not change."""

from collections.abc import Sequence

import bpy

from ...bridge.billboards.scene_clouds import SceneCloud


def quote_names(scene_clouds: Sequence[SceneCloud]) -> str:
    """Return the names of the clouds in quotation marks, separated by commas."""
    return ", ".join(f'"{cloud.collection.name}"' for cloud in scene_clouds)


def linked_sources_message(names: Sequence[str]) -> str:
    """Return the sentence for source objects whose visibility cannot be changed."""
    return f"Visibility unchanged, linked from a library: {', '.join(dict.fromkeys(names))}."


def missing_original_message(cloud: SceneCloud) -> str:
    """Return that the original of `cloud` is missing, with the names of missing objects, as the end of a sentence."""
    names = ", ".join(f'"{name}"' for name in cloud.missing_source_names)
    return f"its original {names} was not found" if names else "its original was not found"


def describe_exceptions(scene_clouds: Sequence[SceneCloud], refused: Sequence[SceneCloud], view_layer: bpy.types.ViewLayer) -> str:
    """Return sentences about originals of `scene_clouds` that are missing, linked or not in `view_layer`, and about `refused` clouds, which
    are linked themselves. Empty if there is nothing to say."""
    missing = [name for cloud in scene_clouds for name in _missing_names(cloud)]
    linked = [name for cloud in scene_clouds for name in cloud.linked_source_names]
    absent = [source.name for cloud in scene_clouds for source in cloud.sources if source not in cloud.sources_in(view_layer)]
    absent += [f'"{cloud.collection.name}"' for cloud in scene_clouds if not cloud.is_in(view_layer)]
    sentences = [
        linked_sources_message(linked) if linked else "",
        f"Original not found: {', '.join(missing)}." if missing else "",
        f"Not in the view layer: {', '.join(dict.fromkeys(absent))}." if absent else "",
        f"Unchanged, linked from a library: {quote_names(refused)}; make local copies first." if refused else "",
    ]
    return " ".join(sentence for sentence in sentences if sentence)


def _missing_names(cloud: SceneCloud) -> list[str]:
    name = f'"{cloud.collection.name}"'
    return [f'"{source}" of {name}' for source in cloud.missing_source_names] if cloud.source_names else [f"that of {name}"]
