"""How many triangles and images levels by distance need in the images of a camera, and the error with which they fit a budget."""

from collections.abc import Sequence
from functools import cached_property

import bpy
import numpy as np

from ...bridge.distance.assets import Asset
from ...bridge.distance.chains import Chain
from ...bridge.distance.views import count_image_bytes, place_levels
from ...core.distance.forecasts import MAX_ERROR, Forecast, View, find_error, forecast
from ...core.distance.settings import DistanceSettings
from ...core.messages import format_bytes, format_count


class Budget:
    """The levels of assets at their places, with the budget of the settings.

    chains: assets with their levels and factors of the allowed error. views: of the active camera; without any, nothing is limited.
    """

    def __init__(self, settings: DistanceSettings, chains: Sequence[tuple[Asset, Chain, float]], views: Sequence[View]) -> None:
        self._settings, self._chains, self._frames = settings, chains, len(views)
        self._placed = [place_levels(asset, chain, factor, views) for asset, chain, factor in chains] if views else []

    @cached_property
    def _images(self) -> list[list[dict[bpy.types.Image, int]]]:
        """The images of each level of each asset, with their bytes."""
        return [[count_image_bytes(collection.objects) for collection in chain.collections] for _, chain, _ in self._chains]

    def find_error(self, other_triangles: int) -> float:
        """Return the error in pixels with which levels fit the budget, at least that of the settings; at most `MAX_ERROR`.

        other_triangles: of what has no levels.
        """
        settings = self._settings
        if not self._placed:
            return settings.max_error
        found = find_error(lambda error: self._fits(error, other_triangles), settings.max_error)
        return max(MAX_ERROR, settings.max_error) if found is None else found

    def _fits(self, error: float, other_triangles: int) -> bool:
        settings = self._settings
        if not settings.triangle_budget and not settings.texture_budget:
            return True
        found = self._forecast(error)
        is_light = not settings.triangle_budget or found.triangles.max() + other_triangles <= settings.triangle_budget
        return is_light and (not settings.texture_budget or self._count_bytes(found) <= settings.texture_budget * 1e6)

    def _forecast(self, error: float) -> Forecast:
        return forecast(self._placed, error, self._settings.fade_range)

    def _count_bytes(self, found: Forecast) -> int:
        """Return the memory of all images that the heaviest frame needs."""
        totals = []
        for frame in range(self._frames):
            used: dict[bpy.types.Image, int] = {}
            for counts, images in zip(found.counts, self._images, strict=True):
                for level in np.flatnonzero(counts[frame]):
                    used |= images[level]
            totals.append(sum(used.values()))
        return max(totals)

    def describe(self, error: float, other_triangles: int) -> str:
        """Return the end of a sentence about the heaviest frame with the given error, and sentences about the budget."""
        full = other_triangles + sum(asset.triangles * len(asset.matrices) for asset, _, _ in self._chains)
        if not self._placed:
            return f"in full, they have {full:,} triangles."
        found = self._forecast(error)
        frames = "this frame" if self._frames == 1 else f"the heaviest of {format_count(self._frames, 'frame')}"
        sentences = [f"{frames} has {int(found.triangles.max()) + other_triangles:,} triangles instead of {full:,}"]
        sentences[0] += f", and {format_bytes(self._count_bytes(found))} of images."
        if not self._fits(error, other_triangles):
            sentences.append(f"The budget is too small: even with a Max Error of {error:g} pixels, levels are heavier.")
        elif error > self._settings.max_error:
            sentences.append(f"Max Error was raised to {error:.3g} pixels for the budget.")
        return " ".join(sentences)
