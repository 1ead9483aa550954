"""Renders of ordinary assets and their levels with whole materials, by Cycles: FLIP against the original, and sheets to look at.

Three views, each with a key light and with a back light, which shows the outline, both in front of a gray sky. Levels of pymeshlab have no
normals and are not rendered. The model fills 256 pixels.
"""

from argparse import Namespace
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from texmesh_asset_levels import Asset, find_points

from farfield.addon.core.imaging.colors import encode_signed_srgb
from farfield.addon.core.imaging.flip import compare, prepare_image
from lib.contact_sheet import draw_contact_sheet, write_png
from lib.studio import SKY_RADIANCE, Studio, look_at_matrix, open_studio

RENDERED = ("farfield", "decimate", "gltfpack")
SIZE, SAMPLES, PICTURE_SAMPLES = 256, 32, 64
MARGIN = 1.04  # Of an image relative to the model.
VIEWS = ((40.0, 20.0), (160.0, 35.0), (280.0, 10.0))  # azimuth and elevation, degrees
LIGHTS = ((-45.0, 40.0), (150.0, 30.0))  # from the camera: azimuth and, above the horizon, elevation
PICTURE_RATIOS = (0.25, 0.1)


def add_renders(given: Namespace, name: str, assets: Sequence[Asset], rows: dict[str, Any]) -> None:
    """Add FLIP to the figures `rows` of a model, and write its sheet, as far as they are wanted."""
    objects = [user for asset in assets for user in asset.users]
    for item in objects:
        item.modifiers.clear()  # Meshes are evaluated.
    with open_studio(objects, SAMPLES) as studio:
        views = Views(studio, objects, assets)
        if given.flip:
            originals = [prepare(image) for image in views.render_all("original", 1.0)]
            for label, row in rows.items():
                ratio = float(label.removesuffix("%")) / 100.0
                for method in RENDERED:
                    if "failures" not in row["methods"][method]:
                        images = [prepare(image) for image in views.render_all(method, ratio)]
                        row["methods"][method]["flip"] = round(measure_flip(originals, images), 5)
        if given.pictures:
            given.pictures.mkdir(parents=True, exist_ok=True)
            studio.set_samples(PICTURE_SAMPLES)
            write_png(given.pictures / f"{name}.png", draw_sheet(name, views, rows))


class Views:
    """Renders a scene with the levels of its objects."""

    def __init__(self, studio: Studio, objects: Sequence[bpy.types.Object], assets: Sequence[Asset]) -> None:
        self._studio, self._objects, self._assets = studio, objects, assets
        self._points = find_points(assets)
        self._nothing = studio.work.own(bpy.data.meshes.new("nothing"))  # shown where a method fails

    def render_all(self, method: str, ratio: float) -> list[np.ndarray]:
        """Return the images (SIZE, SIZE, 4) of all views with all lights."""
        self._show(method, ratio)
        return [self._render(view, light) for view in VIEWS for light in LIGHTS]

    def render(self, method: str, ratio: float, view: int) -> np.ndarray:
        """Return the image of one view with the first light."""
        self._show(method, ratio)
        return self._render(VIEWS[view], LIGHTS[0])

    def _show(self, method: str, ratio: float) -> None:
        for asset in self._assets:
            mesh = asset.mesh if method == "original" else asset.levels.get((method, ratio), self._nothing)
            for user in asset.users:
                user.data = mesh

    def _render(self, view: tuple[float, float], light: tuple[float, float]) -> np.ndarray:
        self._studio.set_sun_direction(direction_to(view[0] + light[0], light[1]))
        axes = np.array(look_at_matrix(direction_to(*view), np.zeros(3)))[:3, :3]
        places = self._points @ axes
        low, high = places.min(axis=0), places.max(axis=0)
        extent = max(*(high - low)[:2], 0.25 * (high - low)[2])  # The camera sees ten times as deep as wide.
        return self._studio.render(self._objects, axes[:, 2], axes @ (0.5 * (low + high)), MARGIN * extent / SIZE, SIZE)


def direction_to(azimuth: float, elevation: float) -> np.ndarray:
    """Return the unit vector (3,) towards angles in degrees."""
    a, e = np.radians(azimuth), np.radians(elevation)
    return np.array([np.sin(a) * np.cos(e), -np.cos(a) * np.cos(e), np.sin(e)])


def prepare(image: np.ndarray) -> tuple[Any, np.ndarray]:
    """Return an image in front of the sky as FLIP compares it, and where the model is."""
    return prepare_image(_compose(image), is_linear=True), image[..., 3] > 0.0


def _compose(image: np.ndarray) -> np.ndarray:
    return image[..., :3] + (1.0 - image[..., 3:]) * SKY_RADIANCE


def measure_flip(originals: Sequence[tuple[Any, np.ndarray]], images: Sequence[tuple[Any, np.ndarray]]) -> float:
    """Return the mean FLIP over the pixels of the model in all images."""
    errors = [compare(first, second)[mask | other] for (first, mask), (second, other) in zip(originals, images, strict=True)]
    return float(np.concatenate(errors).mean())


def draw_sheet(name: str, views: Views, rows: dict[str, Any]) -> np.ndarray:
    """Return the original and the levels of the first view side by side, one row per ratio; the title has the triangles of all levels."""
    original = views.render("original", 1.0, 0)
    images = [[original, *(views.render(method, ratio, 0) for method in RENDERED)] for ratio in PICTURE_RATIOS]
    encoded = [[np.clip(encode_signed_srgb(_compose(image)), 0.0, 1.0) for image in row] for row in images]
    labels = [f"{ratio:.0%}" for ratio in PICTURE_RATIOS]
    counts = [[rows[label]["methods"][method].get("triangles", 0) for method in RENDERED] for label in labels]
    title = "; ".join([name, *(f"{label}: {', '.join(map(str, row))}" for label, row in zip(labels, counts, strict=True))])
    return draw_contact_sheet(title, encoded, labels, [["original"], *([method] for method in RENDERED)])
