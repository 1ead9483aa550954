"""Render images of the docs that show packages: `python3 docs/packages_pictures.py [--only NAME ...]`.

package_fragments (Figure 9 of the paper, the lookup table, and a map of qualities), from a report of `bench_packages.py --only fragments`;
package_page (a package in Chromium at three moments, and the panel of the page).
"""

import io
import json
import sys
import tempfile
from argparse import Namespace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "scripts"))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from lib import environment

environment.ensure()
environment.import_farfield()

import numpy as np
from figures.fragment_charts import draw_fragments
from figures.package_moments import draw_moments
from PIL import Image

from farfield.addon.core.errors import SettingsError
from farfield.addon.core.jobs.progress import Progress
from lib import command_line
from lib.atomic_output import atomic_file

COLORS, KMEANS = 256, 3  # The size of the palette of an image, and the rounds that improve it.
SPOT = environment.ROOT.parent / "shared" / "data" / "textured" / "spot"


def main(arguments: list[str], line: command_line.ProgressLine) -> str:
    """Draw the selected images and return the result in one line; raises FarfieldError if an input is missing."""
    parser = command_line.Parser(prog="packages_pictures.py", description="Render images of the docs that show packages.")
    parser.add_argument("--only", nargs="+", choices=list(PICTURES), default=list(PICTURES), help="the images to render (default: all)")
    parser.add_argument("--out", type=Path, default=environment.ROOT / "docs" / "pictures", help="output folder (default: docs/pictures)")
    parser.add_argument("--report", type=Path, help="the report of bench_packages.py, for fragments")
    parser.add_argument("--model", type=Path, default=SPOT / "spot.obj", help="an .obj, for package_page")
    parser.add_argument("--texture", type=Path, default=SPOT / "spot_texture.png", help="its texture")
    given = parser.parse_args(arguments)
    for index, name in enumerate(given.only):
        line.show(Progress(index / len(given.only), f"Drawing {name}"))
        write(given.out.absolute() / f"{name}.png", PICTURES[name](given))
    return f"{len(given.only)} images in {given.out.absolute()}"


def fragments(given: Namespace) -> np.ndarray:
    """Draw the figures of the fragments.

    Raises:
        SettingsError: there is no report.
    """
    if given.report is None:
        raise SettingsError("The image package_fragments needs --report; write one with bench_packages.py --only fragments --report FILE.")
    return draw_fragments(json.loads(given.report.read_text("utf-8"))["fragments"])


def package(given: Namespace) -> np.ndarray:
    """Draw the page at three moments."""
    with tempfile.TemporaryDirectory() as folder:
        return draw_moments(given.model, given.texture, Path(folder))


def write(path: Path, image: np.ndarray) -> None:
    """Write an image (H, W, 3) uint8, row 0 at the top, with a palette."""
    buffer = io.BytesIO()
    Image.fromarray(image).quantize(COLORS, kmeans=KMEANS, dither=Image.Dither.NONE).save(buffer, "PNG", optimize=True)
    with atomic_file(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


PICTURES = {"package_fragments": fragments, "package_page": package}


if __name__ == "__main__":
    command_line.run(main)
