"""Levels of detail of an object in a scene: one collection with the objects of all levels, found by their custom properties."""

import math
from dataclasses import dataclass, field
from typing import ClassVar, Self

import bpy

from . import lod_crossfade
from .source_links import SourceIndex, find_sources

KIND = "farfield_kind"  # custom property of all objects that Farfield creates
NUMBER, ERROR = "farfield_level", "farfield_error"


@dataclass(frozen=True)
class LodSet:
    """The levels in one collection. Do not keep it across redraws.

    Attributes:
        kind: the KIND of the levels, which a subclass sets.
        figures: custom properties with numbers, without which an object is no level.
        collection: the collection.
        levels: the objects, finest first.
        index: finds the source objects.
    """

    kind: ClassVar[str] = ""
    figures: ClassVar[tuple[str, ...]] = (NUMBER, ERROR)

    collection: bpy.types.Collection
    levels: list[bpy.types.Object]
    index: SourceIndex = field(default_factory=SourceIndex)

    @classmethod
    def in_scene(cls, scene: bpy.types.Scene) -> list[Self]:
        """Return all whose collections are in `scene`, at any depth."""
        index = SourceIndex()
        found = (cls.read(collection, index) for collection in scene.collection.children_recursive)
        return [levels for levels in found if levels is not None]

    @classmethod
    def find(cls, scene: bpy.types.Scene, item: bpy.types.Object | None) -> Self | None:
        """Return the one that has `item` as a level, or the newest one that was made from it."""
        found = [] if item is None else [levels for levels in cls.in_scene(scene) if item in levels.levels or item in levels.sources]
        return found[-1] if found else None

    @classmethod
    def read(cls, collection: bpy.types.Collection, index: SourceIndex | None = None) -> Self | None:
        """Return the levels in `collection`, or None if there are none. Those that are read at once share an `index` of source objects."""
        levels = sorted((item for item in collection.objects if cls.is_level(item)), key=lambda item: item[NUMBER])
        return cls(collection, levels, index or SourceIndex()) if levels else None

    @classmethod
    def is_level(cls, item: bpy.types.Object) -> bool:
        """Return whether `item` is a level with all its figures; custom properties can be deleted or come from elsewhere."""
        numbers = [item.get(name) for name in cls.figures]
        has_figures = all(isinstance(number, int | float) and math.isfinite(number) and number >= 0.0 for number in numbers)
        return item.get(KIND) == cls.kind and item.type == "MESH" and has_figures

    @property
    def errors(self) -> list[float]:
        """The error of each level."""
        return [float(level[ERROR]) for level in self.levels]

    @property
    def source_names(self) -> list[str]:
        """The names of the objects that the levels were made from: current ones, and the stored names of those that no longer exist."""
        return [name if source is None else source.name for name, source in find_sources(self.collection, self.index)]

    @property
    def sources(self) -> list[bpy.types.Object]:
        """The objects that the levels were made from, as far as they still exist, also under other names."""
        return [source for _, source in find_sources(self.collection, self.index) if source is not None]

    @property
    def has_crossfade(self) -> bool:
        """Whether the levels cross-fade."""
        return any(lod_crossfade.is_fading(level) for level in self.levels)


def set_hidden(item: bpy.types.Object, hidden: bool) -> None:
    """Hide an object in viewports and renders, or show it."""
    item.hide_viewport = item.hide_render = hidden
