"""Render the pictures of the presets of terrains, which their menu shows: `python3 docs/preset_pictures.py [--only NAME ...]`.

Each is a view of the terrain that the preset makes, as it is now, in a file next to the preset.
"""

import argparse
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parent / "scripts"))

from lib import environment

environment.ensure()
environment.import_farfield()

import numpy as np
from figures import terrain_views
from PIL import Image

from farfield.addon.core.clipbox.settings import ClipboxSettings
from farfield.addon.core.presets import list_presets, read_preset
from farfield.addon.core.sky import SkySettings

PRESETS = FOLDER.parent / "addon" / "presets" / "clipbox"
PIXELS, SAMPLES, QUALITY = 192, 24, 82
# Where the camera stands, and the point that it looks at, scene units.
VIEWS = {
    "Alien": ((1015.0, -712.0, 40.0), (935.0, -772.0, 42.0)),
    "Alpine Range": ((300.0, -400.0, 172.0), (-160.0, -381.0, 160.0)),
    "Arches": ((-240.0, -564.0, 9.0), (-302.0, -530.0, 20.0)),
    "Asteroids": ((0.0, -260.0, 60.0), (40.0, 60.0, 0.0)),
    "Blocks": ((-40.0, -160.0, 60.0), (60.0, 60.0, -60.0)),
    "Boulder Field": ((-60.0, -170.0, 110.0), (20.0, 20.0, 0.0)),
    "Canyon": ((-280.0, -140.0, 345.0), (-620.0, 20.0, 210.0)),
    "Caves and Arches": ((-20.0, -130.0, 37.5), (60.0, 60.0, -5.0)),
    "Coast": ((1050.0, -500.0, 30.0), (700.0, 0.0, 20.0)),
    "Dunes": ((82.0, 5.0, 38.0), (223.0, 98.0, -14.0)),
    "Floating Islands": ((0.0, -300.0, 100.0), (60.0, 200.0, 10.0)),
    "Karst Bay": ((584.0, -645.0, 129.0), (487.0, -619.0, 107.0)),
    "Lava": ((136.0, -1482.0, 14.0), (-492.0, -1020.0, 62.0)),
    "Mesas": ((256.0, -208.0, -52.0), (420.0, 157.0, -41.0)),
    "Rolling Hills": ((-100.0, 0.0, 95.0), (285.0, 210.0, 70.0)),
    "Terraces": ((-80.0, -200.0, 150.0), (40.0, 60.0, -30.0)),
}


def main() -> None:
    """Render the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=sorted(VIEWS), default=sorted(VIEWS), help="names of presets")
    for path in list_presets(PRESETS):
        if path.stem in parser.parse_args().only:
            preset = read_preset(path, [ClipboxSettings, SkySettings])
            position, target = (np.array(point) for point in VIEWS[path.stem])
            with tempfile.TemporaryDirectory() as folder:
                rendered = Path(folder) / "view.png"
                settings, light = preset.build(ClipboxSettings), preset.build(SkySettings)
                terrain_views.square_view(rendered, PIXELS, SAMPLES, settings, position, target, light)
                Image.open(rendered).convert("RGB").save(path.with_suffix(".webp"), quality=QUALITY, method=6)


if __name__ == "__main__":
    main()
