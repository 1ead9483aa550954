"""The page in Chromium: how soon the model is on screen, that it is complete within the limit, and that pixels are those of the level."""

import base64
import gzip
import io
import json
import re
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

pytest.importorskip("tornado")

from reference.mesh_decoding import decode_level, dequantize
from reference.streaming_state import find_target
from small_packages import decode_textures, painted_image, write_files, write_textured_package

from chromium import SKIP_REASON, Page, find_chromium, run_chromium
from farfield.addon.core.imaging.mipmaps import build_mipmaps, measure_footprints, sample_mipmaps
from farfield.addon.core.imaging.raster import locate_pixels
from farfield.addon.core.packages.files import read_page
from farfield.addon.core.packages.local_server import LocalServer
from farfield.addon.core.packages.manifest import MESH, TEXTURES, Manifest
from farfield.addon.core.packages.shading import Shading
from lib.connection_rate import ConnectionRate
from lib.package_server import run_server
from textured_models import plane, torus

pytestmark = [
    pytest.mark.once,
    pytest.mark.usefixtures("fast_coding", "small_images"),
    pytest.mark.skipif(find_chromium() is None, reason=f"THE PAGE WAS NOT TESTED IN A BROWSER: it {SKIP_REASON}"),
]
LINE = ConnectionRate(((1.0, 50_000.0),), latency=0.02)  # Slow: on a busy machine, the first drawing alone may take 2 seconds.
TIME_LIMIT = 4.5  # seconds
TRIES = 6  # Times are measured so often: the machine does other work meanwhile.
FINISHED = "window.farfield?.isFinished"
STATUS = "document.getElementById('status')?.textContent"
MISSING = "(({ bytes, total }) => total - bytes)(farfield.loader.measures)"
IS_ALL_KEPT = """caches.open("farfield-packages").then((cache) => cache.keys()).then((keys) => {
    const total = (intervals) => intervals.reduce((sum, [start, end]) => sum + (end - start), 0);
    const kept = keys.map((request) => /-(\\d+)-(\\d+)$/.exec(request.url).slice(1));
    return total(kept) === total(Object.values(farfield.loader.files).flatMap((file) => file.intervals));
})"""


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Iterator[Page]:
    with run_chromium(tmp_path_factory.mktemp("profile")) as page:
        yield page


@pytest.fixture(scope="module")
def package(fast_coding, small_images, tmp_path_factory) -> tuple[Path, Manifest]:
    """A torus of two materials."""
    folder = tmp_path_factory.mktemp("package")
    images = [painted_image(300, 220, 1), painted_image(440, 380, 2)]
    return folder, write_textured_package(folder, torus(96, 48, has_materials=True), images)


def read_capture(page: Page) -> np.ndarray:
    """Return the canvas (H, W, 4) uint8, row 0 at the bottom."""
    url = page.evaluate("farfield.capture()")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(url.split(",")[1]))).convert("RGBA"))[::-1]


def render_level(page: Page, folder: Path, manifest: Manifest, level: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the image (H, W, 3) float32 of a level as the page has to show it, sRGB from 0 to 255, and which pixels (H, W) bool are of one
    continuous piece of the surface with their neighbors."""
    decoded = decode_level((folder / MESH).read_bytes(), manifest, level)
    positions, uvs = (
        dequantize(decoded.positions, manifest.bounds, manifest.steps[0]),
        dequantize(decoded.uvs, manifest.uv_bounds, manifest.steps[1]).astype(np.float64),
    )
    width, height, clip = page.evaluate("(({width, height}) => [width, height, farfield.orbit.matrices(width / height).clip])(view)")
    points = np.concatenate([positions, np.ones((len(positions), 1))], axis=1) @ np.array(clip).reshape(4, 4)
    depths = points[:, 3]
    pixels = (points[:, :2] / depths[:, None] * 0.5 + 0.5) * [width, height]
    wedges = decoded.triangles
    corners = pixels[decoded.wedge_vertices[wedges]]
    edges = corners[:, 1:] - corners[:, :1]
    is_front = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0] > 0.0
    corners, corner_depths = corners[is_front], depths[decoded.wedge_vertices[wedges]][is_front]
    corner_uvs, materials = uvs[wedges][is_front], decoded.materials[is_front]
    located = locate_pixels(corners, corner_depths, (width, height))
    found, owners = located.interpolate(corner_uvs), materials[located.triangles]
    colors = np.zeros((len(found), 3), np.float32)
    for material, texture in enumerate(decode_textures(folder, manifest)):
        mipmaps = build_mipmaps(to_linear(texture[::-1] / np.float32(255.0)))
        footprints = measure_footprints(corners, corner_uvs, texture.shape[1::-1])
        rows = owners == material
        upwards = found[rows] * [1.0, -1.0] + [0.0, 1.0]
        colors[rows] = sample_mipmaps(mipmaps, upwards, footprints[located.triangles[rows]])
    image = np.zeros((height, width, 3), np.float32)
    image[located.covered] = 255.0 * to_srgb(colors)
    uv_image, is_inner = np.full((height, width, 2), 1e9), ndimage.binary_erosion(located.covered, np.ones((5, 5)))
    uv_image[located.covered] = found
    spans = [ndimage.maximum_filter(uv_image[..., axis], 3) - ndimage.minimum_filter(uv_image[..., axis], 3) for axis in (0, 1)]
    return image, is_inner & (np.maximum(*spans) < 0.05)


def to_linear(values: np.ndarray) -> np.ndarray:
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(np.float32)


def to_srgb(values: np.ndarray) -> np.ndarray:
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 0.0) ** (1.0 / 2.4) - 0.055)


@pytest.mark.slow
def test_something_is_shown_soon_and_all_within_limit(page, tmp_path):
    random = np.random.default_rng(3)
    image = painted_image(448, 384, 2) + random.normal(0.0, 25.0, (384, 448, 3))
    manifest = write_textured_package(tmp_path, torus(96, 48), [image.clip(0, 255).astype(np.uint8)], time_limit=TIME_LIMIT)
    assert manifest.files[TEXTURES][0] > 1.2 * manifest.time_limit * LINE.rate_at(0.0)
    fractions, deviations = [], []
    with run_server(tmp_path, connection=LINE) as url:
        for _ in range(TRIES):
            page.open(url)
            page.wait_for(FINISHED)
            assert page.messages == []
            deviations.append(page.evaluate("farfield.loader.measures.deviation ?? 1e9") / manifest.time_limit)
            fractions.append(page.evaluate("farfield.session.firstImage ?? 1e9") / manifest.time_limit)
            if fractions[-1] <= 0.7 and -0.2 <= deviations[-1] <= 0.05:
                break
    print(f"first image after {fractions} of the time, deviation {deviations} of it")
    assert min(fractions) <= 0.7
    assert -0.2 <= min(deviations, key=abs) <= 0.05
    assert page.evaluate("farfield.loader.shown") > 0
    assert all(request.startswith((url, "data:")) for request in page.requests)


@pytest.mark.slow
def test_limit_is_for_the_first_picture_and_refining_goes_on(page, package):
    folder, manifest = package
    with run_server(folder, connection=ConnectionRate(((5.0, 12_000.0), (1.0, 120_000.0)))) as url:
        page.open(url, 1600, 1200)
        page.wait_for("window.farfield?.loader?.picture")
        assert page.evaluate(f"{MISSING} > 0")
        page.wait_for(f"{FINISHED} && {MISSING} === 0")
        assert page.evaluate("farfield.loader.shown") == len(manifest.levels) - 1
        assert page.evaluate(STATUS) == "Complete."
        assert page.evaluate("farfield.loader.measures.deviation") / manifest.time_limit >= -0.5, "later is a matter of the machine"
    with run_server(folder, connection=ConnectionRate(((5.0, 12_000.0),))) as url:
        page.open(url, 1600, 1200)
        page.wait_for("window.farfield?.loader")
        page.evaluate("refine.click()")
        page.wait_for(FINISHED)
        assert page.evaluate(f"[{MISSING} > 0, {STATUS}]") == [True, "Stopped at the time limit."]


@pytest.mark.slow
def test_size_on_screen_decides_what_is_loaded(page, package):
    folder, manifest = package
    read = "[farfield.loader.target, farfield.loader.shown, farfield.loader.measures.bytes]"
    with run_server(folder) as url:
        sizes = []
        for width, scale in ((128, 1.0), (64, 2.0), (256, 1.0)):
            page.open(url, width, width, scale=scale)
            page.wait_for(FINISHED)
            target, level, received = page.evaluate(read)
            expected = find_target(manifest, width * scale)
            assert (tuple(target), level) == (expected, expected[0])
            assert page.evaluate(f"[{STATUS}, {MISSING}]") == ["Complete for this size on screen.", 0]
            sizes.append(received)
        assert sizes[0] == sizes[1] < sizes[2]
        assert find_target(manifest, 128) < find_target(manifest, 256) < (len(manifest.levels) - 1, manifest.state_count - 1)
        page.call("Emulation.setDeviceMetricsOverride", width=640, height=640, deviceScaleFactor=1, mobile=False)
        page.wait_for(f"{FINISHED} && farfield.loader.target[1] >= {find_target(manifest, 640)[1]}")
        page.evaluate("farfield.orbit.set({zoom: 20})")
        page.wait_for(f"{FINISHED} && {STATUS} === 'Complete.'")
        assert page.evaluate(read)[:2] == [[len(manifest.levels) - 1, manifest.state_count - 1], len(manifest.levels) - 1]


@pytest.mark.slow
def test_the_local_server_sends_all_of_a_package(page, package):
    with closing(LocalServer(package[0])) as server:
        page.open(server.url, 640, 640)
        page.wait_for(f"{FINISHED} && {MISSING} === 0")
        assert page.evaluate(STATUS) == "Complete." and page.messages == []
        assert page.evaluate("farfield.loader.shown") == len(package[1].levels) - 1


@pytest.mark.slow
def test_another_visit_asks_for_nothing_that_has_come(page, package):
    with run_server(package[0]) as url:
        page.open(url)
        page.wait_for(FINISHED)
        before = read_capture(page)
        assert any(".bin?" in request for request in page.requests)
        page.wait_for(IS_ALL_KEPT)
        page.open(url, keeps_storage=True)
        page.wait_for(FINISHED)
        assert not any(".bin" in request for request in page.requests)
        np.testing.assert_array_equal(read_capture(page), before)
        page.evaluate("farfield.orbit.set({zoom: 20})")
        page.wait_for(f"{FINISHED} && {STATUS} === 'Complete.'")
        assert any(".bin" in request for request in page.requests)


def flat_image(*values: int) -> np.ndarray:
    return np.full((64, 64, 3), values, np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("maps", "shading", "opacity", "expected"),
    [
        ({"occlusion": flat_image(0)}, Shading(), 1.0, (0, 0, 0, 255)),
        ({"occlusion": flat_image(0), "emission": flat_image(128)}, Shading(emission=(1.0, 0.0, 0.0)), 1.0, (128, 0, 0, 255)),
        ({"alpha": flat_image(128)}, Shading(alpha_mode="blend"), 0.5, (None, None, None, 64)),
        ({"alpha": flat_image(128)}, Shading(alpha_mode="mask", alpha_cutoff=0.6), 1.0, (0, 0, 0, 0)),
        ({"alpha": flat_image(128)}, Shading(alpha_mode="mask", alpha_cutoff=0.4), 1.0, (None, None, None, 255)),
        ({"alpha": flat_image(128)}, Shading(is_unlit=True), 1.0, (200, 100, 50, 255)),
    ],
)
def test_maps_are_drawn(page, tmp_path, maps, shading, opacity, expected):
    image = flat_image(200, 100, 50)
    write_textured_package(tmp_path, plane(8, 8), [image], tile_size=64, maps=maps, shading=shading, opacity=opacity)
    with run_server(tmp_path) as url:
        page.open(url)
        page.wait_for(FINISHED)
        found = read_capture(page)
    center = found[220:260, 300:340].reshape(-1, 4).astype(float)
    for channel, value in enumerate(expected):
        assert value is None or np.abs(np.median(center[:, channel]) - value) <= 3.0, (channel, center.mean(axis=0))


@pytest.mark.slow
def test_light_of_rough_and_metallic_surfaces(page, tmp_path):
    """The right half of a plane is smooth metal, or metal next to plastic. A metal has no matte part, but reflects in its color."""
    half = np.zeros((64, 64, 3), np.uint8)
    half[:, 32:] = 255
    sides, square = {}, plane(8, 8)
    square = replace(square, uvs=square.uvs * 12.5)
    for name, map_ in (("roughness", 255 - half // 255 * 250), ("metallic", half)):
        shading = Shading(roughness=1.0 if name == "roughness" else 0.3, metallic=1.0)
        write_textured_package(tmp_path / name, square, [flat_image(220, 40, 40)], tile_size=64, maps={name: map_}, shading=shading)
        with run_server(tmp_path / name) as url:
            page.open(url)
            page.wait_for(FINISHED)
            found = read_capture(page)[..., :3].astype(float)
        sides[name] = [found[230:250, columns].reshape(-1, 3).mean(axis=0) for columns in (slice(240, 260), slice(380, 400))]
    rough, smooth = sides["roughness"]
    assert np.abs(rough - smooth).max() > 10.0
    plastic, metal = sides["metallic"]
    assert metal[1] / metal[0] < plastic[1] / plastic[0]


@pytest.fixture(scope="module")
def shown(page, package) -> Iterator[Page]:
    """The page with the whole package."""
    with run_server(package[0]) as url:
        page.open(url)
        page.wait_for(FINISHED)
        page.evaluate("document.querySelector('main').hidden = true; farfield.orbit.set({zoom: 20})")
        page.wait_for(f"{FINISHED} && {STATUS} === 'Complete.'")
        yield page


@pytest.mark.parametrize(
    ("zoom", "level"),
    [(1.0, 0), (4.0, 2), *(pytest.param(*case, marks=pytest.mark.exhaustive) for case in ((1.0, 1), (1.0, 2), (4.0, 0), (4.0, 1)))],
)
def test_pixels_are_those_of_level(shown, package, level, zoom):
    shown.evaluate("light.checked = false; light.dispatchEvent(new Event('change'))")
    shown.evaluate(f"levels.value = {level}; levels.dispatchEvent(new Event('change'))")
    shown.evaluate(f"farfield.orbit.set({{azimuth: 0.7, elevation: 0.5, zoom: {zoom}}})")
    expected, is_inner = render_level(shown, *package, level)
    found = read_capture(shown)
    assert (found[is_inner, 3] == 255).mean() > 0.999
    differences = np.abs(found[is_inner, :3].astype(np.float32) - expected[is_inner])
    assert is_inner.mean() > 0.05
    # Edges are smoothed on the page; where it is zoomed out, there are many.
    assert np.quantile(differences, 0.99 if zoom > 1.0 else 0.9) <= 2.0
    assert differences.mean() < 1.0


@pytest.mark.slow
def test_image_survives_loss_of_graphics_context(shown):
    before = read_capture(shown)
    shown.evaluate("window.lost = view.getContext('webgl2').getExtension('WEBGL_lose_context'); lost.loseContext()")
    time.sleep(0.3)
    shown.evaluate("lost.restoreContext()")
    end = time.monotonic() + 30.0
    while not np.array_equal(read_capture(shown), before):
        assert time.monotonic() < end, "the image did not return"
        time.sleep(0.2)


def test_keys_and_wheel_move_the_camera(shown):
    shown.evaluate("farfield.orbit.reset(); view.focus()")
    read = "[farfield.orbit.azimuth, farfield.orbit.elevation, farfield.orbit.zoom, farfield.orbit.target[1]]"
    azimuth, elevation, zoom, height = shown.evaluate(read)
    for key, shift in (("ArrowRight", 0), ("ArrowDown", 0), ("+", 0), ("ArrowUp", 8)):
        shown.call("Input.dispatchKeyEvent", type="keyDown", key=key, modifiers=shift)
        shown.call("Input.dispatchKeyEvent", type="keyUp", key=key, modifiers=shift)
    after = shown.evaluate(read)
    assert after[0] > azimuth and after[1] < elevation and after[2] > zoom and after[3] < height
    shown.call("Input.dispatchMouseEvent", type="mouseWheel", x=300, y=200, deltaX=0, deltaY=-200)
    shown.wait_for(f"farfield.orbit.zoom > {after[2]}")
    shown.call("Input.dispatchKeyEvent", type="keyDown", key="Home")
    assert shown.evaluate(read) == [azimuth, elevation, zoom, height]


@pytest.mark.slow
def test_damage_is_found_and_repaired_from_mirror(page, package, tmp_path):
    folder, manifest = package
    files = {name: (folder / name).read_bytes() for name in ("manifest.json", MESH, TEXTURES)}
    section = manifest.levels[1].positions
    damaged = bytearray(files[MESH])
    damaged[section.offset + section.size // 2] ^= 0x10
    write_files(tmp_path / "damaged", files | {MESH: bytes(damaged)})
    with run_server(tmp_path / "damaged") as url:
        page.open(url)
        page.wait_for("document.getElementById('status')?.textContent.includes('is damaged')")
    with run_server(folder) as mirror:
        with_mirror = files["manifest.json"].replace(b'"mirrors":[]', b'"mirrors":["%s"]' % mirror.encode())
        write_files(tmp_path / "repaired", files | {MESH: bytes(damaged), "manifest.json": with_mirror})
        with run_server(tmp_path / "repaired") as url:
            page.open(url)
            page.wait_for(FINISHED)
            assert page.evaluate("farfield.loader.shown") == len(manifest.levels) - 1
            assert {request[: len(url)] for request in page.requests if ".bin?" in request} <= {url, mirror[: len(url)]}
            assert any(request.startswith(mirror) for request in page.requests)


@pytest.mark.slow
def test_other_servers_and_packages(page, package, tmp_path):
    folder, manifest = package
    files = {name: (folder / name).read_bytes() for name in ("manifest.json", MESH, TEXTURES)}
    write_files(tmp_path / "whole", files | read_page())
    write_files(tmp_path / "newer", {"manifest.json": re.sub(rb'"version":4\b', b'"version":5', files["manifest.json"])})
    lie = files["manifest.json"].replace(b'"mesh.bin":[', b'"mesh.bin":[1')
    write_files(tmp_path / "lying", files | {"manifest.json": lie})
    write_files(tmp_path / "incomplete", {name: files[name] for name in ("manifest.json", MESH)})
    with run_static_server(tmp_path) as url:
        page.open(f"{url}whole/")
        page.wait_for(FINISHED)
        assert "whole files only" in page.evaluate("document.getElementById('status')?.textContent")
        assert page.evaluate("[farfield.loader.shown, farfield.loader.passed]") == [len(manifest.levels) - 1, manifest.increment_count]
        for name, message in (("newer", "version 5"), ("lying", "is damaged"), ("incomplete", "404"), ("missing", "cannot be loaded")):
            page.open(f"{url}whole/?package=../{name}")
            page.wait_for(f"document.getElementById('status')?.textContent.includes('{message}')")


@pytest.mark.slow
def test_the_page_asks_no_server_but_its_own_and_the_mirrors(page, package, tmp_path):
    folder, _ = package
    with run_server(folder) as other, run_server(folder) as url:
        page.open(f"{url}?package={other}")
        page.wait_for(f"{STATUS}?.includes('cannot be loaded')")
        for address in ("http://", "http://[", "//:"):
            page.open(f"{url}?package={address}")
            page.wait_for(f"{STATUS} === 'The address names no package.'")
        assert page.evaluate("document.getElementById('late')") is None
        content = json.loads((folder / "manifest.json").read_bytes())
        files = {name: (folder / name).read_bytes() for name in (MESH, TEXTURES)}
        files["manifest.json"] = json.dumps(content | {"textures": [content["textures"][0] | {"tile_size": 0.001}]}).encode()
        write_files(tmp_path / "frozen", files | read_page())
    with run_static_server(tmp_path) as url:
        page.open(f"{url}frozen/")
        page.wait_for(f"{STATUS}?.includes('manifest.json')")


@pytest.mark.slow
def test_servers_that_are_set_up_wrong_are_named(page, package):
    folder, _ = package
    files = {path.name: path.read_bytes() for path in folder.iterdir()} | read_page()
    with run_static_server(folder, files, script_type="text/plain") as url:
        page.open(url)
        page.wait_for("document.getElementById('late')?.getAnimations().length === 1")
        assert page.evaluate("getComputedStyle(late).visibility") == "hidden"
        page.evaluate("late.getAnimations()[0].finish()")
        assert page.evaluate("[getComputedStyle(late).visibility, late.textContent.includes('text/javascript')]") == ["visible", True]
    with run_static_server(folder, files, is_compressing=True) as url:
        page.open(url)
        page.wait_for(f"{STATUS}?.includes('compress what it must send in ranges') || {FINISHED}")


@contextmanager
def run_static_server(
    folder: Path, files: dict[str, bytes] | None = None, script_type: str = "text/javascript", is_compressing: bool = False
) -> Iterator[str]:
    """Serve a folder without ranges, as the simplest servers do, or these files, with a type of .js files, and compressed. Yields its
    URL."""

    class Handler(SimpleHTTPRequestHandler):
        def __init__(self, *arguments) -> None:
            super().__init__(*arguments, directory=str(folder))

        def log_message(self, *arguments) -> None:
            pass

        def do_GET(self) -> None:
            if files is None:
                super().do_GET()
                return
            name = self.path.split("?")[0].strip("/") or "index.html"
            content = gzip.compress(files.get(name, b"")) if is_compressing else files.get(name, b"")
            self.send_response(200 if name in files else 404)
            self.send_header("Content-Type", script_type if name.endswith(".js") else self.guess_type(name))
            self.send_header("Content-Length", str(len(content)))
            if is_compressing:
                self.send_header("Content-Encoding", "gzip")
            self.end_headers()
            self.wfile.write(content)

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join()
