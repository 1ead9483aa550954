"""A strip of a relightable cloud next to its source, under several Sun directions."""

import bpy
import numpy as np

from lib import environment

environment.import_farfield()

from farfield.addon.bridge.billboards.scene_clouds import SceneCloud
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.imaging import metrics
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.operators.btf.job import prepare_bake
from farfield.addon.operators.job_run import run_job
from lib.contact_sheet import PAPER_GRAY, draw_contact_sheet
from lib.studio import bounding_sphere, open_studio

SETTINGS = BtfSettings(views_per_side=6)
SUN_ANGLES = (-75, 55), (-35, 10), (10, 40), (50, 20), (95, 30)  # degrees: azimuth from the viewer, positive to the right; elevation


def draw_relight_strip(cloud: SceneCloud, view: np.ndarray, pixels: int, samples: int) -> np.ndarray:
    """Bake `cloud`, which has one level, and return a strip (H, W, 3) of its source and of the cloud from the direction `view` (3,)."""
    run_to_end(run_job(prepare_bake(bpy.context, cloud, SETTINGS, None, keep_finished_views=False)))
    (level,) = cloud.levels
    suns = [sun_direction(view, azimuth, elevation) for azimuth, elevation in SUN_ANGLES]
    center, radius = bounding_sphere(cloud.sources)
    with open_studio([*cloud.sources, level], samples) as studio:
        rows = []
        for items in (cloud.sources, [level]):
            rows.append([])
            for sun in suns:
                studio.set_sun_direction(sun)
                rows[-1].append(studio.render(items, view, center, 2.0 * radius / pixels, pixels))
    window = metrics.crop_to_object(np.max([render[..., 3] for row in rows for render in row], axis=0), margin=4)
    images = [[metrics.composite_over_gray(render[window], PAPER_GRAY) for render in row] for row in rows]
    labels = [[f"Sun {describe_azimuth(azimuth)},", f"elevation {elevation}\N{DEGREE SIGN}"] for azimuth, elevation in SUN_ANGLES]
    title = f"Five Sun directions; baked: {SETTINGS.view_count} views"
    return draw_contact_sheet(title, images, ["source", "relightable cloud"], labels)


def sun_direction(view: np.ndarray, azimuth: float, elevation: float) -> np.ndarray:
    """Return the direction (3,) towards a Sun light at `azimuth` to the right of the viewer and `elevation`, both in degrees."""
    horizontal = np.arctan2(view[1], view[0]) + np.radians(azimuth)
    z = np.radians(elevation)
    return np.array([np.cos(z) * np.cos(horizontal), np.cos(z) * np.sin(horizontal), np.sin(z)])


def describe_azimuth(azimuth: float) -> str:
    """Return an azimuth in degrees in words."""
    return f"{abs(azimuth)}\N{DEGREE SIGN} {'right' if azimuth > 0 else 'left'}"
