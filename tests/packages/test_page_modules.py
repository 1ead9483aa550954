"""The page's files: no requests elsewhere, labels, size, and modules that agree with Python."""

import gzip
import hashlib
import json
import re
import shutil
import subprocess
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_packages import write_opaque_package

from farfield.addon.core.packages.files import PAGE_FOLDER, join_modules, read_page
from farfield.addon.core.packages.increments import Increments, encode_increments
from farfield.addon.core.packages.manifest import encode_manifest
from farfield.addon.core.packages.tile_pyramid import TilePyramid

pytestmark = pytest.mark.once
MAX_BYTES = 28_000  # Size of all files, each compressed.
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed, so modules of the page are not run")


class Tags(HTMLParser):
    """All start tags of a page: names and attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


def run_module(folder: Path, code: str, value: Any) -> Any:
    """Return the JSON that the function body `code` returns for `value`; it may `await import(page + "module.js")`."""
    script = folder / "runner.mjs"
    (folder / "input.json").write_text(json.dumps(value), encoding="utf-8")
    script.write_text(
        'import { readFileSync } from "node:fs";\nconst page = process.argv[2];\n'
        f"const run = async (value) => {{{code}}};\n"
        "const result = await run(JSON.parse(readFileSync(process.argv[3])));\nprocess.stdout.write(JSON.stringify(result));\n",
        encoding="utf-8",
    )
    command = ["node", str(script), PAGE_FOLDER.as_uri() + "/", str(folder / "input.json")]
    outcome = subprocess.run(command, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    return json.loads(outcome.stdout)


def test_page_asks_nobody_else():
    for name, content in read_page().items():
        found = re.findall(r"https?://[^\s\"'`)]*", content.decode())
        assert found == [], name
    tags = Tags(read_page()["index.html"].decode()).found
    policy = next(attributes["content"] for tag, attributes in tags if attributes.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
    assert not any(tag == "style" or name.startswith("on") or name == "style" for tag, attributes in tags for name in attributes)


def test_the_policy_names_the_mirrors_and_no_other_server():
    def sources(mirrors: tuple[str, ...]) -> list[str]:
        tags = Tags(read_page(mirrors)["index.html"].decode()).found
        policy = next(attributes["content"] for tag, attributes in tags if attributes.get("http-equiv") == "Content-Security-Policy")
        return next(part.split() for part in policy.split(";") if part.strip().startswith("connect-src"))

    assert sources(()) == ["connect-src", "'self'"]
    mirrors = ("https://example.org/a/", "https://example.org/b/", "http://127.0.0.1:8000/")
    assert sources(mirrors) == ["connect-src", "'self'", "https://example.org", "http://127.0.0.1:8000"]


@needs_node
def test_page_refuses_manifests_that_make_no_sense(tmp_path):
    """Each change is one sentence, and never an error of JavaScript."""
    code = """
      const { fetchManifest } = await import(page + "loader.js");
      const answers = [];
      for (const manifest of value) {
        globalThis.fetch = async () => new Response(manifest);
        answers.push(await fetchManifest("http://127.0.0.1/").then(() => "accepted", (error) => error.message));
      }
      return answers;
    """
    manifest = json.loads(encode_manifest(write_opaque_package(tmp_path / "package")))
    texture = {"role": "base_color", "width": 64, "height": 64, "tile_size": 32, "headers": ["00"]}
    manifest |= {"textures": [texture], "mirrors": ["https://example.org/a/"]}
    errors, texts = manifest["errors"], ["[1", "null"]
    changes = [
        *({"textures": [texture | {"tile_size": value}]} for value in (0.001, 0, -1, 1e9, "32", None, 2.5)),
        *({"textures": [texture | {"width": value}]} for value in (0, 1e9, None)),
        {"textures": [texture | {"width": 65536, "tile_size": 1}]},
        *({"textures": [texture | {"headers": value}]} for value in ([""], [5], None, "00", ["zz!"])),
        *({"textures": value} for value in (None, [None], {})),
        *({"mirrors": value} for value in (None, ["javascript:alert(1)"], ["http://"], [5], "https://a/")),
        *({"bounds": value} for value in (None, [], [None, None], [[0, 0, 0], [1, 1]], [[0, 0, "0"], [1, 1, 1]])),
        *({"uv_bounds": value} for value in (None, [[0, 0]], [[0], [1]])),
        *({"steps": value} for value in (None, [1], ["a", "b"])),
        *({"increment_count": value} for value in (2**31, -1, None, 1.5)),
        *({"first_increment": value} for value in (2**40, -1, None)),
        *({"levels": value} for value in (None, [], [None], [manifest["levels"][0] | {"vertex_count": -1}])),
        {"levels": [manifest["levels"][0] | {"triangle_counts": [1, 2]}]},
        *(
            {"errors": value}
            for value in (
                None,
                {},
                errors | {"states": []},
                errors | {"states": [0, 0, 0]},
                errors | {"levels": [None]},
                errors | {"exponent": 0},
            )
        ),
        *({"materials": value} for value in (None, [], [{"textures": {"base_color": 7}}])),
        *({"time_limit": value} for value in (0, None, -1)),
        *({"files": value} for value in (None, {}, {"mesh.bin": [2**40, ""], "textures.bin": [0, ""]})),
    ]
    answers = run_module(tmp_path, code, [json.dumps(manifest), *(json.dumps(manifest | change) for change in changes), *texts])
    assert answers[0] == "accepted"
    unexpected = [(change, answer) for change, answer in zip([*changes, *texts], answers[1:], strict=True) if "manifest.json" not in answer]
    assert not unexpected


def test_page_names_files_that_exist():
    page = read_page()
    tags = Tags(page["index.html"].decode()).found
    links = [value for _, attributes in tags for name, value in attributes.items() if name in ("src", "href") and value != "data:,"]
    named = {value.split("?")[0] for value in links}
    assert named | {"index.html"} == set(page)


def test_urls_name_the_content_of_script_and_style():
    page = read_page()
    for name in ("main.js", "style.css"):
        assert f'"{name}?{hashlib.sha256(page[name]).hexdigest()[:16]}"' in page["index.html"].decode()


def test_all_modules_are_joined_and_preloaded():
    names = {path.name for path in PAGE_FOLDER.glob("*.js")}
    script = read_page()["main.js"].decode()
    assert set(re.findall(r"^const \$(\w+)=", script, re.MULTILINE)) == {Path(name).stem for name in names}
    assert not re.search(r"^(import|export)\b", script, re.MULTILINE)
    preloaded = set(re.findall(r'"modulepreload" href="([^"]+)"', (PAGE_FOLDER / "index.html").read_text("utf-8")))
    assert preloaded | {"main.js"} == names


@needs_node
def test_joined_modules_do_what_they_did(tmp_path):
    modules = {
        "main": 'import { double, Counter } from "./numbers.js";\nimport { base } from "./base.js";\n'
        "const numbers = new Counter();\nprocess.stdout.write(JSON.stringify([double(base), numbers.next()]));\n",
        "numbers": 'import { base } from "./base.js";\nexport function double(x) { return 2 * x; }\n'
        "export class Counter {\n  next() { return base + 1; }\n}\nconst hidden = 5;\n",
        "base": "export const base = 20, other = 3;\n",
    }
    (tmp_path / "joined.mjs").write_text(join_modules(modules), encoding="utf-8")
    outcome = subprocess.run(["node", str(tmp_path / "joined.mjs")], capture_output=True, text=True, check=False)
    assert (outcome.stdout, outcome.stderr) == ("[40,21]", "")


def test_controls_have_labels():
    tags = Tags(read_page()["index.html"].decode()).found
    for tag, attributes in tags:
        assert tag not in ("canvas", "progress") or attributes.get("aria-label")
    text = read_page()["index.html"].decode()
    for control in re.findall(r"<(?:select|input)[^>]*>", text):
        assert re.search(r"<label>[^<]*" + re.escape(control), text) or re.search(re.escape(control) + r"[^<]+</label>", text), control
    assert any(tag == "html" and attributes.get("lang") == "en" for tag, attributes in tags)


def test_page_is_small():
    sizes = {name: len(gzip.compress(content, 9, mtime=0)) for name, content in read_page().items()}
    assert sum(sizes.values()) <= MAX_BYTES, sizes


def test_shortened_page_has_no_comments_of_their_own():
    for name, content in read_page().items():
        if name.endswith(".js"):
            assert not re.search(r"^\s*(//|/\*|\*)", content.decode(), re.MULTILINE), name
            assert content.count(b"`") % 2 == 0


@needs_node
def test_shortened_modules_are_valid(tmp_path):
    for name, content in read_page().items():
        if name.endswith(".js"):
            (tmp_path / f"{name}.mjs").write_bytes(content)
            outcome = subprocess.run(["node", "--check", str(tmp_path / f"{name}.mjs")], capture_output=True, text=True, check=False)
            assert outcome.returncode == 0, outcome.stderr


@needs_node
def test_page_reads_table_of_increments(tmp_path):
    random = np.random.default_rng(3)
    count = 500
    firsts = np.sort(np.arange(count) % 20)
    table = Increments(
        textures=random.integers(0, 2, count),
        tiles=random.integers(0, 300, count),
        headers=random.integers(0, 3, count),
        sizes=random.integers(1, 70000, count),
        firsts=firsts,
        lasts=np.minimum(firsts + random.integers(0, 9, count), 19),
    )
    planes = zlib.decompress(encode_increments(table), -15)
    textures = [{"width": 2500, "height": 2000, "tile_size": 128, "headers": ["", "", ""]}] * 2
    total = 1000 + int(table.sizes.sum())
    manifest = {"increment_count": count, "first_increment": 1000, "textures": textures, "files": {"textures.bin": [total, ""]}}
    manifest["errors"] = {"states": [0.5] * 20}
    code = """
      const { readIncrements } = await import(page + "tiles.js");
      const plain = (table) => Object.fromEntries(Object.entries(table).map(([name, values]) => [name, [...values]]));
      const refused = value.damages.map((damage) => {
        try { return readIncrements(Uint8Array.from(value.planes), { ...value.manifest, ...damage }) && false; } catch { return true; }
      });
      return [plain(readIncrements(Uint8Array.from(value.planes), value.manifest)), refused];
    """
    damages = [{"increment_count": count - 1}, {"first_increment": 999}, {"textures": textures[:1]}]
    damages.append({"textures": [texture | {"height": 900} for texture in textures]})
    damages += [{"errors": {"states": [0.5] * states}} for states in (19, 21)]
    found, refused = run_module(tmp_path, code, {"planes": list(planes), "manifest": manifest, "damages": damages})
    for name in ("textures", "tiles", "headers", "sizes", "firsts", "lasts"):
        assert found[name] == getattr(table, name).tolist()
    assert found["ends"] == (1000 + np.cumsum(table.sizes)).tolist()
    assert refused == [True] * len(damages)


@needs_node
def test_page_locates_tiles_like_python(tmp_path):
    textures = [(2500, 2000, 128), (1, 1, 16), (300, 40, 48), (1024, 4096, 256)]
    code = """
      const { listLevels, locateTile } = await import(page + "tiles.js");
      return value.map(([width, height, tile_size]) => {
        const texture = { width, height, tile_size }, levels = listLevels(texture);
        const count = levels.reduce((sum, [rows, columns]) => sum + rows * columns, 0);
        return [levels, Array.from({ length: count }, (_, number) => Object.values(locateTile(texture, number)))];
      });
    """
    for (width, height, tile_size), (levels, places) in zip(textures, run_module(tmp_path, code, textures), strict=True):
        pyramid = TilePyramid(width, height, tile_size)
        assert levels == [list(shape) for shape in pyramid.shapes]
        found = [pyramid.locate(number) for number in range(pyramid.tile_count)]
        sides = [pyramid.side(level) << level for level, _, _ in found]
        assert places == [[column * side, row * side, side] for side, (_, row, column) in zip(sides, found, strict=True)]


@needs_node
def test_later_tiles_stay_on_top_in_any_order(tmp_path):
    code = """
      const { TileDecoder } = await import(page + "tiles.js");
      globalThis.createImageBitmap = async (blob) => ({ id: new Uint8Array(await blob.arrayBuffer()).at(-1) });
      const manifest = { textures: [{ width: 128, height: 128, tile_size: 32, headers: ["00"] }] };
      const results = [];
      for (const order of value.orders) {
        const image = Array(16).fill(-1);
        const show = (texture, place, { id }) => {
          for (let y = place.top / 32; y < (place.top + place.side) / 32; y++) {
            for (let x = place.left / 32; x < (place.left + place.side) / 32; x++) image[4 * y + x] = id;
          }
        };
        const decoder = new TileDecoder(manifest, show);
        order.forEach((i) => decoder.add(i, 0, value.tiles[i], 0, Uint8Array.of(i)));
        while (!decoder.isIdle) await new Promise((resolve) => setTimeout(resolve, 1));
        results.push(image);
      }
      return results;
    """
    random = np.random.default_rng(2)
    pyramid = TilePyramid(128, 128, 32)
    tiles = [20, *random.integers(0, pyramid.tile_count, 14).tolist()]
    expected = np.full((4, 4), -1)
    for index, number in enumerate(tiles):
        expected[pyramid.covered(*pyramid.locate(number))] = index
    orders = [list(range(15)), *(random.permutation(15).tolist() for _ in range(5))]
    for image in run_module(tmp_path, code, {"orders": orders, "tiles": tiles}):
        assert image == expected.ravel().tolist()


@needs_node
def test_page_computes_checksums_like_zlib(tmp_path):
    contents = [b"", b"a", bytes(range(256)), np.random.default_rng(1).bytes(5000)]
    code = """
      const { crc32 } = await import(page + "network.js");
      return value.map((bytes) => crc32(Uint8Array.from(bytes)));
    """
    assert run_module(tmp_path, code, [list(content) for content in contents]) == [zlib.crc32(content) for content in contents]


@needs_node
def test_page_knows_which_bytes_have_come(tmp_path):
    random = np.random.default_rng(5)
    parts = [(int(start), int(size)) for start, size in zip(random.integers(0, 900, 60), random.integers(1, 40, 60), strict=True)]
    code = """
      const { PartialFile } = await import(page + "network.js");
      const file = new PartialFile("mesh.bin", [1000, "00"]);
      return value.map(([start, size]) => {
        file.put(start, Uint8Array.from({ length: size }, (_, i) => (start + i) % 251));
        const sections = [[0, 30], [start, size], [100, 400], [950, 0], [990, 30]];
        return [file.intervals, sections.map((section) => file.read(section) && [...file.read(section)]), file.endFrom(start)];
      });
    """
    is_here = np.zeros(1001, bool)
    for (start, size), (intervals, sections, end) in zip(parts, run_module(tmp_path, code, parts), strict=True):
        is_here[start : start + size] = True
        edges = np.flatnonzero(np.diff(np.concatenate([[False], is_here]).astype(int)))
        assert intervals == edges.reshape(-1, 2).tolist()
        assert end == start + int(np.argmin(is_here[start:]))
        for (first, length), found in zip([(0, 30), (start, size), (100, 400), (950, 0), (990, 30)], sections, strict=True):
            is_complete = first + length <= 1000 and is_here[first : first + length].all()
            assert found == ([i % 251 for i in range(first, first + length)] if is_complete else None)


@needs_node
def test_camera_shows_all_of_object(tmp_path):
    code = """
      const { Orbit } = await import(page + "orbit.js");
      const orbit = new Orbit({ addEventListener() {} }, () => {});
      orbit.frame(value.bounds);
      return value.views.map(([azimuth, elevation, aspect]) => {
        orbit.set({ azimuth, elevation });
        return orbit.matrices(aspect).clip;
      });
    """
    low, high = np.array([-1.0, 2.0, 5.0]), np.array([3.0, 3.0, 11.0])
    views = [(azimuth, elevation, aspect) for azimuth in (0.0, 2.0, -4.0) for elevation in (-1.5, 0.0, 1.0) for aspect in (0.5, 1.0, 2.0)]
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1)
    for clip in run_module(tmp_path, code, {"bounds": [low.tolist(), high.tolist()], "views": views}):
        points = np.array(clip).reshape(4, 4).T @ np.concatenate([corners, np.ones((1, 8))])
        assert (np.abs(points[:3]) <= points[3]).all()
        assert np.abs(points[:2] / points[3]).max() > 0.25


@needs_node
def test_sharp_corners_are_flat_and_others_smooth(tmp_path):
    code = """
      const { buildSurface } = await import(page + "surface.js");
      const surface = buildSurface(value);
      return Object.fromEntries(Object.entries(surface).map(([name, values]) => [name, [...values]]));
    """
    positions = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1]]  # two sides of a box
    corners = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 5], [0, 5, 4]])
    uvs = [[float(i), i + 0.5] for i in range(6)]
    mesh = {
        "positions": np.ravel(positions).tolist(),
        "wedges": list(range(6)),
        "uvs": np.ravel(uvs).tolist(),
        "corners": corners.ravel().tolist(),
    }
    found = run_module(tmp_path, code, mesh)
    shape = {"positions": 3, "uvs": 2, "normals": 3, "triangles": 3}
    surface = {name: np.array(values).reshape(-1, shape[name]) for name, values in found.items()}
    triangles = surface["triangles"]
    np.testing.assert_array_equal(surface["positions"][triangles], np.array(positions, float)[corners])
    np.testing.assert_array_equal(surface["uvs"][triangles], np.array(uvs)[corners])
    normals = surface["normals"][triangles]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, rtol=1e-6)
    np.testing.assert_allclose(normals[0], [[0.0, 0.0, -1.0]] * 3, atol=1e-6)
    np.testing.assert_allclose(normals[3], [[0.0, -1.0, 0.0]] * 3, atol=1e-6)
