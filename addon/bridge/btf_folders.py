"""Relightable textures as a folder of pictures, one a view and light, laid out as the measured textures of Bonn and UTIA are.

views.txt lights.txt                            the directions, exact
tv030_pv060/tl015_pl000_tv030_pv060.exr         colours
coverage/tv030_pv060.exr                        alpha, which depends on the view alone
"""

from pathlib import Path

import bpy
import numpy as np

from ..compat import set_file_format
from ..core.btf.decoding import BakedAtlas
from ..core.btf.measured_names import direction_list, direction_names
from ..core.progress import Progress, Steps
from .temporary import TemporaryScene, temporary_scene

LARGEST_HALF = float(np.finfo(np.float16).max)


def write_folder(atlas: BakedAtlas, folder: Path, views: np.ndarray, lights: np.ndarray) -> Steps[None]:
    """Write a level into the empty `folder`, from unit directions `views` (V, 3) under `lights` (L, 3) in the object's frame.

    Pictures are half-float EXR, scene-linear Rec.709, straight: radiance under a sun of unit irradiance.

    Raises:
        SettingsError: when two directions would have one name.
        OSError, RuntimeError: when a file cannot be written.
    """
    view_names, light_names = direction_names(views, "v"), direction_names(lights, "l")
    (folder / "views.txt").write_text(direction_list(views), encoding="utf-8")
    (folder / "lights.txt").write_text(direction_list(lights), encoding="utf-8")
    (folder / "coverage").mkdir()
    with temporary_scene("Farfield Pictures") as work:
        image = _blank(work, atlas.size)
        for place, (view, view_name) in enumerate(zip(views, view_names, strict=True)):
            basis = atlas.seen_from(view[None], lights)[0]
            (folder / view_name).mkdir()
            _save(work, image, np.repeat(atlas.coverage(view)[..., None], 3, axis=2), folder / "coverage" / f"{view_name}.exr")
            for number, (light, light_name) in enumerate(zip(lights, light_names, strict=True)):
                yield Progress((place + number / len(lights)) / len(views), f"Picture {number + 1} of view {place + 1} of {len(views)}")
                _save(work, image, atlas.picture(basis[:, number], view, light), folder / view_name / f"{light_name}_{view_name}.exr")


def _blank(work: TemporaryScene, size: tuple[int, int]) -> bpy.types.Image:
    settings = work.scene.render.image_settings
    set_file_format(settings, "OPEN_EXR")
    settings.color_mode, settings.color_depth, settings.exr_codec = "RGB", "16", "ZIP"
    return work.keep(bpy.data.images.new("Farfield Picture", *size, alpha=False, float_buffer=True, is_data=True))


def _save(work: TemporaryScene, image: bpy.types.Image, pixels: np.ndarray, path: Path) -> None:
    """Write `pixels` (H, W, 3) through `image`. Rendered pictures keep their numbers; plain saving would encode them."""
    opaque = np.ones((*pixels.shape[:2], 1), np.float32)
    image.pixels.foreach_set(np.concatenate([np.minimum(pixels, LARGEST_HALF), opaque], axis=2, dtype=np.float32).ravel())
    image.update()
    image.save_render(str(path), scene=work.scene)
