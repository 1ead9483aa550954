"""Relightable textures as a folder of images, one per view and light, with the file layout of the measured BTFs of Bonn and UTIA.

views.txt lights.txt                            exact directions
tv030_pv060/tl015_pl000_tv030_pv060.exr         radiance
coverage/tv030_pv060.exr                        alpha, which depends only on the view
"""

from pathlib import Path

import bpy
import numpy as np

from ....compat import set_file_format
from ....core.btf.decoding import RelightableTexture
from ....core.btf.formats.image_folders import direction_names, format_direction_list, is_complete_exr
from ....core.errors import FileError
from ....core.jobs.progress import Progress, Steps
from ...rendering.render_scene import RenderScene, render_scene

MAX_HALF_FLOAT = float(np.finfo(np.float16).max)


def write_images(texture: RelightableTexture, folder: Path, views: np.ndarray, lights: np.ndarray) -> Steps[None]:
    """Write a level into the empty `folder` for unit directions `views` (V, 3) and `lights` (L, 3) in object space.

    Images are half-float EXR, scene-linear Rec.709, straight alpha: radiance under a Sun of unit irradiance.

    Raises:
        SettingsError: if two directions would get the same file name.
        FileError, OSError, RuntimeError: if a file cannot be written.
    """
    view_names, light_names = direction_names(views, "v"), direction_names(lights, "l")
    (folder / "views.txt").write_text(format_direction_list(views), encoding="utf-8")
    (folder / "lights.txt").write_text(format_direction_list(lights), encoding="utf-8")
    (folder / "coverage").mkdir()
    with render_scene("Farfield Images") as work:
        image = _new_image(work, texture.size)
        for i, (view, view_name) in enumerate(zip(views, view_names, strict=True)):
            basis = texture.interpolate_basis(view[None], lights)[0]
            (folder / view_name).mkdir()
            _save_image(work, image, np.repeat(texture.coverage(view)[..., None], 3, axis=2), folder / "coverage" / f"{view_name}.exr")
            for j, (light, light_name) in enumerate(zip(lights, light_names, strict=True)):
                yield Progress((i + j / len(lights)) / len(views), f"Image {j + 1} of view {i + 1} of {len(views)}")
                path = folder / view_name / f"{light_name}_{view_name}.exr"
                _save_image(work, image, texture.radiance(basis[:, j], view, light), path)


def _new_image(work: RenderScene, size: tuple[int, int]) -> bpy.types.Image:
    settings = work.scene.render.image_settings
    set_file_format(settings, "OPEN_EXR")
    settings.color_mode, settings.color_depth, settings.exr_codec = "RGB", "16", "ZIP"
    return work.own(bpy.data.images.new("Farfield Image", *size, alpha=False, float_buffer=True, is_data=True))


def _save_image(work: RenderScene, image: bpy.types.Image, pixels: np.ndarray, path: Path) -> None:
    """Write `pixels` (H, W, 3) through `image`. Saving it as a render keeps its values; plain saving would encode them.

    Raises:
        FileError: the disk is full, which Blender does not always notice.
    """
    opaque = np.ones((*pixels.shape[:2], 1), np.float32)
    image.pixels.foreach_set(np.concatenate([np.minimum(pixels, MAX_HALF_FLOAT), opaque], axis=2, dtype=np.float32).ravel())
    image.update()
    image.save_render(str(path), scene=work.scene)
    if not path.exists() or not is_complete_exr(path):
        raise FileError(f'Cannot write "{path}": the image is truncated, because the disk or your quota is full; free some space.')
