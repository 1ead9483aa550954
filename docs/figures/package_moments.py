"""The page of a package in Chromium at three moments of loading, side by side."""

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from chromium import SKIP_REASON, Page, find_chromium, run_chromium
from farfield.addon.bridge.overlays.line_chart import LINE_HEIGHT, PAPER_GRAY, draw_text
from farfield.addon.core.errors import SettingsError
from lib import environment
from lib.connection_rate import ConnectionRate
from lib.package_server import run_server

GAP = 6  # pixels
BYTES_PER_SECOND, LATENCY = 8_000.0, 0.05  # a slow connection, so that moments can be told apart where WebGL is computed by the processor
TIME_LIMIT = 12  # seconds
MOMENTS = (1.5, 5.5)  # seconds after the start; the last image is the one at the limit
SIDE = 300  # pixels
AT_LIMIT = "farfield.loader.picture !== null || farfield.isFinished"
CAPTION = "`${farfield.loader.time.toFixed(1)} s: ${triangles.textContent} triangles`"
VIEW = "farfield.orbit.set({azimuth: 3.7, elevation: 0.2, zoom: 1.25})"
PANEL = "document.querySelector('main')"
BOX = f"(({{left, top, right, bottom}}) => [left, top, right, bottom].map(Math.round))({PANEL}.getBoundingClientRect())"
MAX_SECONDS = 90.0


def draw_moments(model: Path, texture: Path, folder: Path) -> np.ndarray:
    """Return an image (H, W, 3) uint8, row 0 at the top, of the package of an .obj with a texture at three moments, and of the panel.

    folder: for files.

    Raises:
        SettingsError: there is no Chromium.
    """
    if find_chromium() is None:
        raise SettingsError(f"The image of the page {SKIP_REASON}.")
    build_package(model, texture, folder)
    (folder / "profile").mkdir()
    connection = ConnectionRate(((1.0, BYTES_PER_SECOND),), latency=LATENCY)
    with run_chromium(folder / "profile") as page, run_server(folder / "package", connection=connection) as url:
        page.open(url, SIDE, SIDE)
        page.wait_for("window.farfield?.loader?.manifest", MAX_SECONDS)
        page.wait_for("triangles.textContent.length > 1", MAX_SECONDS)
        page.evaluate(f"{VIEW}; {PANEL}.hidden = true")
        columns = []
        for moment in (*(f"farfield.loader.time >= {seconds}" for seconds in MOMENTS), AT_LIMIT):
            page.wait_for(moment, MAX_SECONDS)
            caption = page.evaluate(CAPTION)
            columns.append(add_caption(read_page(page), caption))
        page.call("Emulation.setDeviceMetricsOverride", width=2 * SIDE, height=2 * SIDE, deviceScaleFactor=1, mobile=False)
        page.evaluate(f"{PANEL}.hidden = false")
        box = page.evaluate(
            f"(({{left, top, right, bottom}}) => [left, top, right, bottom].map(Math.round))({PANEL}.getBoundingClientRect())"
        )
        panel = read_page(page)[box[1] : box[3], box[0] : box[2]]
    height = max(len(columns[0]), len(panel))
    return np.concatenate([extend(column, height) for column in (*columns, panel)], axis=1)


def build_package(model: Path, texture: Path, folder: Path) -> None:
    """Write the package of an .obj that names no material."""
    (folder / "model.mtl").write_text(f"newmtl painted\nKd 1 1 1\nmap_Kd {texture.resolve()}\n", "utf-8")
    source = folder / f"{model.stem}.obj"
    source.write_text(f"mtllib model.mtl\nusemtl painted\n{model.read_text('utf-8')}", "utf-8")
    script = environment.ROOT / "scripts" / "packages.py"
    command = [sys.executable, str(script), "build", str(source), "--out", str(folder / "package"), "--time-limit", str(TIME_LIMIT)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def read_page(page: Page) -> np.ndarray:
    """Return what the page shows, (H, W, 3) uint8."""
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))


def add_caption(image: np.ndarray, caption: str) -> np.ndarray:
    """Return the image with a line of text above it."""
    strip = np.full((2 * LINE_HEIGHT, image.shape[1], 3), PAPER_GRAY)
    draw_text(strip, caption, LINE_HEIGHT // 2, GAP)
    return np.concatenate([np.rint(255.0 * np.clip(strip, 0.0, 1.0)).astype(np.uint8), image])


def extend(image: np.ndarray, height: int) -> np.ndarray:
    """Return the image in the middle of one of `height` rows, with a border at its sides."""
    missing = height - len(image)
    paper = round(255.0 * PAPER_GRAY)
    return np.pad(image, ((missing // 2, missing - missing // 2), (GAP, GAP), (0, 0)), constant_values=paper)
