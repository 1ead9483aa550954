"""Images of levels: means of those of the original, sizes, normals in the frames of a level, and never more bytes."""

import copy
from typing import Any

import numpy as np
import pytest

from farfield.addon.core.files.glb import Document
from farfield.addon.core.files.glb_levels import merge_images
from farfield.addon.core.imaging.coded_images import decode, encode
from farfield.addon.core.imaging.colors import decode_signed_srgb, encode_signed_srgb
from farfield.addon.core.texmesh.rebaking import image_sizes, smaller_images
from farfield.addon.core.texmesh.rebaking.rebake import rebake_images
from farfield.addon.core.texmesh.rebaking.smaller_images import Content, shrink_image, to_pixels
from farfield.addon.core.texmesh.rebaking.tangent_normals import TangentSurface, express_normals, find_normals
from farfield.addon.core.texmesh.rebaking.texture_uses import LevelDocument
from farfield.addon.core.texmesh.rebaking.uv_layout import find_coverage, repeats_texture, wrap_triangles

SIDE = 512
PIXEL = image_sizes.TEXELS_PER_PIXEL / SIDE  # where a texture on a unit square is not too small
TWICE, FOUR_TIMES = 2.0 * PIXEL, 4.0 * PIXEL


def grid(cells: int, low: float = 0.0, high: float = 1.0, height=lambda x, y: 0.0 * (x + y)) -> dict[str, np.ndarray]:
    """A primitive: a square of cells in the plane of x and z with y upwards by `height`, whose texture coordinates cover `low` to `high`,
    with exact normals and tangents."""
    ticks = np.linspace(0.0, 1.0, cells + 1)
    x, y = (values.ravel() for values in np.meshgrid(ticks, ticks, indexing="ij"))
    first = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = first, first + cells + 1, first + cells + 2, first + 1
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    step = 1e-5
    gradient_x = (height(x + step, y) - height(x - step, y)) / (2.0 * step)
    gradient_y = (height(x, y + step) - height(x, y - step)) / (2.0 * step)
    normals = np.stack([-gradient_x, np.ones_like(x), gradient_y], axis=1)
    tangents = np.stack([np.ones_like(x), gradient_x, 0.0 * x, np.linalg.norm([np.ones_like(x), gradient_x], axis=0)], axis=1)
    uvs = low + (high - low) * np.stack([x, y], axis=1)
    attributes = {
        "POSITION": np.stack([x, height(x, y), -y], axis=1),
        "NORMAL": normals / np.linalg.norm(normals, axis=1, keepdims=True),
        "TANGENT": np.concatenate([tangents[:, :3] / tangents[:, 3:], np.ones((len(x), 1))], axis=1),
        "TEXCOORD_0": uvs * [1.0, -1.0] + [0.0, 1.0],
    }
    return {"attributes": attributes, "indices": triangles.ravel(), "material": 0}


def document(part: dict[str, Any], images: dict[str, bytes], **material: Any) -> Document:
    """A document with one mesh, whose material has a texture for each of `images`."""
    textures = {name: {"index": index} for index, name in enumerate(images)}
    surface = {name: textures.pop(name) for name in ("baseColorTexture", "metallicRoughnessTexture") if name in textures}
    return {
        "nodes": [{"name": "object", "mesh": 0}],
        "meshes": [{"primitives": [part]}],
        "materials": [{"name": "material", "pbrMetallicRoughness": surface, **textures, **material}],
        "textures": [{"source": index} for index in range(len(images))],
        "images": [{"content": content, "name": name} for name, content in images.items()],
    }


def rebake(original: Document, level: Document, pixel_size: float, has_webp: bool = False) -> tuple[Document, list[str]]:
    """Return the document of a level with its own images."""
    original, level = copy.deepcopy(original), copy.deepcopy(level)
    merge_images([original, level])
    levels = [LevelDocument(item, {"object": size}, {}) for item, size in ((original, 0.0), (level, pixel_size))]
    sentences = rebake_images(levels, has_webp)
    return level, sentences


def image_of(found: Document, name: str) -> np.ndarray:
    """Return the pixels of an image of the material as fractions."""
    material = found["materials"][0]
    reference = {**material, **material["pbrMetallicRoughness"]}[name]
    return decode(found["images"][found["textures"][reference["index"]]["source"]]["content"]) / 255.0


def noise(channels: int = 3, side: int = SIDE) -> np.ndarray:
    return np.random.default_rng(5).integers(0, 256, (side, side, channels), np.uint8)


def means(values: np.ndarray) -> np.ndarray:
    return values.reshape(SIDE // 2, 2, SIDE // 2, 2, -1).mean(axis=(1, 3))


def test_colors_become_the_means_of_their_light_and_data_the_means_of_their_values():
    pixels = noise()
    images = {"baseColorTexture": encode(pixels, "png"), "metallicRoughnessTexture": encode(pixels[::-1], "png")}
    found, sentences = rebake(document(grid(4), images), document(grid(2), images), TWICE)
    light = encode_signed_srgb(means(decode_signed_srgb(pixels / 255.0)))
    np.testing.assert_allclose(image_of(found, "baseColorTexture"), light, atol=0.51 / 255.0)
    np.testing.assert_allclose(image_of(found, "metallicRoughnessTexture"), means(pixels[::-1] / 255.0), atol=0.51 / 255.0)
    assert sentences == [f"Images of levels have {SIDE // 2} pixels per side."]


def test_colors_are_weighted_by_the_opacity_that_a_material_shows():
    pixels = noise(4)
    pixels[..., 3] = np.random.default_rng(6).integers(1, 256, (SIDE, SIDE))
    images = {"baseColorTexture": encode(pixels, "png")}
    found, _ = rebake(document(grid(4), images, alphaMode="BLEND"), document(grid(2), images, alphaMode="BLEND"), TWICE)
    alpha = pixels[..., 3:] / 255.0
    light = encode_signed_srgb(means(decode_signed_srgb(pixels[..., :3] / 255.0) * alpha) / means(alpha))
    np.testing.assert_allclose(image_of(found, "baseColorTexture"), np.concatenate([light, means(alpha)], axis=2), atol=0.51 / 255.0)
    opaque, _ = rebake(document(grid(4), images), document(grid(2), images), TWICE)
    assert image_of(opaque, "baseColorTexture").shape[2] == 3, "nobody sees an alpha that does not count"


def test_an_image_with_colors_and_data_becomes_two():
    images = {"baseColorTexture": encode(noise(), "png")}
    shared = document(grid(2), images)
    shared["materials"][0]["occlusionTexture"] = {"index": 0}
    found, _ = rebake(shared, shared, TWICE)
    expected = means(noise() / 255.0)
    np.testing.assert_allclose(image_of(found, "occlusionTexture"), expected, atol=0.51 / 255.0)
    assert np.abs(image_of(found, "baseColorTexture") - expected).max() > 0.05 and len(found["images"]) == 2


@pytest.mark.parametrize("pixel_size", [TWICE, FOUR_TIMES])
def test_islands_are_continued_without_the_background(pixel_size):
    """The texture has one color within the island and another around it: only the first is in the result."""
    pixels = np.full((SIDE, SIDE, 3), (10, 200, 30), np.uint8)
    pixels[200:401, 200:401] = (200, 20, 90)
    images = {"baseColorTexture": encode(pixels, "png")}
    low, high = 200.5 / SIDE, 400.5 / SIDE
    part, flat = grid(5, low, high), grid(1, low, high)
    found, _ = rebake(document(part, images), document(flat, images), pixel_size * 200.0 / SIDE * (SIDE / 200.0) ** 2)
    assert len(image_of(found, "baseColorTexture")) < SIDE
    assert np.abs(image_of(found, "baseColorTexture") * 255.0 - (200, 20, 90)).max() < 1.0


def test_images_that_do_not_repeat_beyond_their_sides_keep_all_texels():
    images = {"baseColorTexture": encode(noise(), "png")}
    clamped = document(grid(2, -0.5, 0.25), images)
    clamped |= {"samplers": [{"wrapS": 33071, "wrapT": 33071}], "textures": [{"source": 0, "sampler": 0}]}
    found, _ = rebake(clamped, clamped, TWICE / 0.75)
    light = encode_signed_srgb(means(decode_signed_srgb(noise() / 255.0)))
    np.testing.assert_allclose(image_of(found, "baseColorTexture"), light, atol=0.51 / 255.0)
    assert found["textures"][0]["sampler"] == 0


def bumps(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.02 * np.sin(4.0 * np.pi * x) * np.sin(2.0 * np.pi * y)


def normals_of_bumps(side: int) -> np.ndarray:
    """The normals (H, W, 3) of the bumps in the frame of the plane."""
    centers = (np.arange(side) + 0.5) / side
    x, y = np.meshgrid(centers, centers)
    gradient_x = 0.08 * np.pi * np.cos(4.0 * np.pi * x) * np.sin(2.0 * np.pi * y)
    gradient_y = 0.04 * np.pi * np.sin(4.0 * np.pi * x) * np.cos(2.0 * np.pi * y)
    normals = np.stack([-gradient_x, -gradient_y, np.ones_like(x)], axis=2)
    return normals / np.linalg.norm(normals, axis=2, keepdims=True)


def test_a_flat_level_has_the_normals_of_a_bumpy_original():
    pixels = noise()
    pixels[:] = (128, 128, 255)
    pixels[::64, ::64] = 0  # so that the file is not smaller than what the level needs
    plain = encode(np.ascontiguousarray(pixels), "png", compression=0)
    images = {"normalTexture": plain}
    original, level = document(grid(96, height=bumps), images), document(grid(1), images)
    found, _ = rebake(original, level, TWICE)
    normals = 2.0 * image_of(found, "normalTexture") - 1.0
    error = np.linalg.norm(normals - normals_of_bumps(SIDE // 2), axis=2)
    assert np.median(error) < 0.01 and np.percentile(error, 95) < 0.03


def test_normals_of_the_original_return_in_the_frames_of_the_original():
    part = grid(24, height=bumps)
    corners = {name: values[part["indices"].reshape(-1, 3)] for name, values in part["attributes"].items()}
    surface = TangentSurface(corners["TEXCOORD_0"] * [1.0, -1.0] + [0.0, 1.0], corners["NORMAL"], corners["TANGENT"])
    vectors = np.random.default_rng(3).normal(0.0, 0.3, (64, 64, 3)) + [0.0, 0.0, 1.5]
    vectors = (vectors / np.linalg.norm(vectors, axis=2, keepdims=True)).astype(np.float32)
    np.testing.assert_allclose(express_normals(surface, find_normals(surface, vectors)), vectors, atol=1e-5)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_mirrored_frames_turn_normals_over(sign):
    part = grid(1)
    corners = {name: values[part["indices"].reshape(-1, 3)] for name, values in part["attributes"].items()}
    tangents = corners["TANGENT"] * [1.0, 1.0, 1.0, sign]
    surface = TangentSurface(corners["TEXCOORD_0"], corners["NORMAL"], tangents)
    normals = np.broadcast_to(np.float32([0.0, 0.8, -0.6]), (4, 4, 3))
    np.testing.assert_allclose(express_normals(surface, normals)[0, 0], [0.0, sign * 0.6, 0.8], atol=1e-6)


def test_the_scale_of_a_normal_map_is_baked():
    vectors = np.random.default_rng(4).normal(0.0, 0.2, (SIDE, SIDE, 3)) + [0.0, 0.0, 1.0]
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    images = {"normalTexture": encode(to_pixels(vectors, Content.NORMAL), "png")}
    scaled = document(grid(2), images)
    scaled["materials"][0]["normalTexture"]["scale"] = 0.5
    found, _ = rebake(scaled, scaled, TWICE)
    assert "scale" not in found["materials"][0]["normalTexture"]
    expected = means(2.0 * decode(images["normalTexture"]) / 255.0 - 1.0)
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    expected *= [0.5, 0.5, 1.0]
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    np.testing.assert_allclose(2.0 * image_of(found, "normalTexture") - 1.0, expected, atol=0.01)


def test_normals_stay_where_parts_of_an_image_are_used_twice_and_are_named():
    vectors = np.random.default_rng(4).normal(0.0, 0.2, (SIDE, SIDE, 3)) + [0.0, 0.0, 1.0]
    images = {"normalTexture": encode(to_pixels(vectors / np.linalg.norm(vectors, axis=2, keepdims=True), Content.NORMAL), "png")}
    tiled = document(grid(8, 0.0, 2.0, bumps), images)
    found, sentences = rebake(tiled, document(grid(1, 0.0, 2.0), images), PIXEL)
    assert "normalTexture" in sentences[1] and "more than once" in sentences[1]
    expected = means(2.0 * decode(images["normalTexture"]) / 255.0 - 1.0)
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    np.testing.assert_allclose(2.0 * image_of(found, "normalTexture") - 1.0, expected, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["PNG", "gray", "JPEG", "flat"])
def test_images_never_need_more_bytes_than_those_of_the_original(kind):
    smooth = np.linspace(0.0, 255.0, SIDE).astype(np.uint8)
    pixels = {
        "PNG": noise(),
        "gray": noise(1).repeat(3, axis=2),
        "JPEG": noise(),
        "flat": np.zeros((SIDE, SIDE, 3), np.uint8) + smooth[:, None],
    }
    file = encode(pixels[kind], "jpeg" if kind == "JPEG" else "png", quality=5, compression=9)
    images = {"baseColorTexture": file}
    for pixel_size in (0.0, PIXEL, TWICE, FOUR_TIMES, 1.0):
        for has_webp in (False, True):
            found, _ = rebake(document(grid(2), images), document(grid(1), images), pixel_size, has_webp)
            assert len(found["images"]) == 1 and len(found["images"][0]["content"]) <= len(file)
            assert len(image_of(found, "baseColorTexture")) == SIDE or pixel_size >= TWICE


def test_sizes_follow_the_distance_and_end_at_a_smallest_one():
    images = {"baseColorTexture": encode(noise(), "png")}
    sizes = [
        len(image_of(rebake(document(grid(2), images), document(grid(1), images), size)[0], "baseColorTexture"))
        for size in (0.0, PIXEL, 1.99 * PIXEL, TWICE, 1.0)
    ]
    assert sizes == [SIDE, SIDE, SIDE, SIDE // 2, image_sizes.MIN_SIDE]


def test_sizes_follow_the_direction_in_which_texels_are_longest():
    images = {"baseColorTexture": encode(noise(), "png")}
    stretched = document(grid(2), images)
    stretched["meshes"][0]["primitives"][0]["attributes"]["POSITION"] *= [4.0, 1.0, 0.25]
    found, _ = rebake(stretched, stretched, 4.0 * TWICE)
    assert len(image_of(found, "baseColorTexture")) == SIDE // 2


def test_an_image_that_is_placed_more_densely_becomes_smaller():
    """KHR_texture_transform repeats it twice along each side."""
    images = {"baseColorTexture": encode(noise(), "png")}
    placed = document(grid(2), images)
    placed["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {
        "KHR_texture_transform": {"scale": [2.0, 2.0], "rotation": 0.5}
    }
    found = [rebake(item, item, TWICE)[0] for item in (placed, document(grid(2), images))]
    assert [len(image_of(item, "baseColorTexture")) for item in found] == [SIDE // 4, SIDE // 2]


def test_images_that_cannot_be_read_stay_and_are_named():
    images = {"baseColorTexture": encode(noise(), "png")[:100]}
    found, sentences = rebake(document(grid(2), images), document(grid(1), images), 1.0)
    assert found["images"][0]["content"] == images["baseColorTexture"] and '"baseColorTexture"' in sentences[0]


def test_sides_that_are_no_powers_of_two_are_rounded_up():
    assert image_sizes.halve_size((1000, 333), 2) == (250, 84)
    pixels = np.full((333, 1000, 3), 77, np.uint8)
    (values,) = shrink_image(pixels, None, Content.DATA, [(250, 84)])
    assert values.shape == (84, 250, 3) and (to_pixels(values, Content.DATA) == 77).all()


@pytest.mark.slow
@pytest.mark.parametrize("size", [(1000, 333), (256, 1024)])
@pytest.mark.parametrize("content", [Content.DATA, Content.COLOR, Content.TRANSPARENT_COLOR, Content.NORMAL])
def test_strips_of_rows_give_the_images_of_all_rows_at_once(monkeypatch, size, content):
    random = np.random.default_rng(3)
    pixels = random.integers(0, 256, (size[1], size[0], 4)).astype(np.uint8)
    coverage, smaller = random.random(size[::-1]) < 0.7, [image_sizes.halve_size(size, 1), image_sizes.halve_size(size, 3)]
    found = []
    for rows in (10_000, 16):
        monkeypatch.setattr(smaller_images, "STRIP_ROWS", rows)
        found.append([to_pixels(values, content) for values in shrink_image(pixels, coverage, content, smaller)])
    assert all((first == second).all() for first, second in zip(*found, strict=True))


def uvs_of(cells: int, low: float, high: float) -> np.ndarray:
    part = grid(cells, low, high)
    return part["attributes"]["TEXCOORD_0"][part["indices"].reshape(-1, 3)]


def test_parts_of_a_texture_that_are_used_twice_are_found():
    once = uvs_of(4, 0.1, 0.6)
    assert not repeats_texture(once, (SIDE, SIDE)) and not repeats_texture(once + 2.7, (SIDE, SIDE))
    assert not repeats_texture(np.concatenate([once - [0.1, 0.0], once + [0.4, 0.0]]), (SIDE, SIDE)), "islands may touch"
    assert repeats_texture(np.concatenate([once, once + [0.25, 0.0]]), (SIDE, SIDE))
    assert repeats_texture(np.concatenate([once, once + [1.0, 0.0]]), (SIDE, SIDE))
    assert repeats_texture(uvs_of(4, 0.0, 2.0), (SIDE, SIDE)) and repeats_texture(uvs_of(1, 0.0, 1e6), (SIDE, SIDE))


def test_triangles_are_moved_to_every_repetition_that_they_meet():
    copies, owners = wrap_triangles(np.array([[[0.9, 0.1], [1.2, 0.1], [0.9, 0.5]], [[-1.0, 2.0], [0.0, 2.0], [0.0, 3.0]]]))
    assert owners.tolist() == [0, 0, 1]
    np.testing.assert_allclose(copies[:, 0], [[0.9, 0.1], [-0.1, 0.1], [0.0, 0.0]], atol=1e-12)


def test_coverage_is_that_of_triangles_also_where_they_repeat_the_image():
    coverage = find_coverage(uvs_of(1, 0.5, 1.25) * [1.0, -1.0] + [0.0, 1.0], (8, 8))
    assert coverage[4:, 4:].all() and coverage[:2, :2].all() and not coverage[2:4].any()
    assert find_coverage(uvs_of(1, 0.0, 1e6), (8, 8)).all()
