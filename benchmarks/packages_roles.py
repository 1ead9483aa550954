"""Part `roles` of bench_packages.py: how the bytes of a package are divided between base color, normal and roughness maps.

States of the textures are chosen with other weights of the errors of roles. FLIP of renders with two lights, diffuse and glossy (GGX),
tells which weights are best at equal bytes.
"""

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import texmesh_models
from packages_views import PIXELS_PER_DEGREE, random_directions
from PIL import Image
from texmesh_models import paint_patches

from farfield.addon.core.geometry.mesh import vertex_normals
from farfield.addon.core.imaging.colors import LINEAR_OF_BYTE
from farfield.addon.core.imaging.flip import FlipImage, compare, prepare_image
from farfield.addon.core.imaging.mipmaps import Mipmaps, build_mipmaps, measure_footprints, sample_mipmaps
from farfield.addon.core.imaging.raster import PixelLocations, draw_ids, locate_positions
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.packages.settings import PackageSettings
from farfield.addon.core.packages.textures.building import assemble_textures, code_textures
from farfield.addon.core.packages.textures.coding import CodedTexture, decode_textures
from farfield.addon.core.packages.textures.texture_tiles import TextureSource
from farfield.addon.core.texmesh.perception.views import BACKGROUND, frame_around, view_axes
from farfield.addon.core.texmesh.textured_mesh import TexturedMesh

ROLES = ("base_color", "normal", "roughness")
KINDS = ("planet", "mirrored")
SIDE = 1024  # Side of normal and roughness maps; the base color has 2048.
STEEPNESS = 6.0  # gradient of a change of the height by 1 between two texels
PIXELS, VIEWS = 512, 4
FACTORS = (1.0 / 16.0, 0.25, 1.0, 4.0)  # Factors of the weights of a role.
PARTS = (0.1, 0.2, 0.5)  # Fractions of all bytes.
LIGHTS = ((-0.5, 0.6, 0.62, 2.2), (0.8, 0.1, 0.59, 0.9))  # direction in the view: right, up, towards the viewer; strength
AMBIENT, F0 = 0.15, 0.04
MIN_ROUGHNESS = 0.05


def measure_roles(given: Namespace) -> dict[str, Any]:
    """Return fractions of bytes and FLIP of lit renders for several weights of normal and roughness maps."""
    results = {}
    for name in given.models or [f"{kind}:{given.seed + index}" for index, kind in enumerate(KINDS)]:
        generator = np.random.default_rng([given.seed, 6])
        mesh, images = texmesh_models.open_model(given.data, name), paint_maps(generator)
        judge = LitJudge(mesh, images, random_directions(VIEWS, generator))
        sources = [TextureSource(role, image, mesh, (0,)) for role, image in zip(ROLES, images, strict=True)]
        results[name] = measure_weights(run_to_end(code_textures(sources, PackageSettings(pixels=PIXELS), PIXELS_PER_DEGREE)), judge)
        print(name, results[name], file=sys.stderr)
    return results


def measure_weights(coded: Sequence[CodedTexture], judge: "LitJudge") -> dict[str, Any]:
    """Return a row per choice of weights."""
    choices = {f"normal x {factor:g}": (1.0, factor, 1.0) for factor in FACTORS}
    choices |= {f"roughness x {factor:g}": (1.0, 1.0, factor) for factor in FACTORS if factor != 1.0}
    rows = {}
    for name, weights in choices.items():
        built = assemble_textures([replace(item, errors=weight * item.errors) for item, weight in zip(coded, weights, strict=True)])
        sizes = np.array(built.increments.measure_states(built.increments.state_count))
        row = []
        for part in PARTS:
            state = int(np.abs(np.log(sizes / (part * sizes[-1]))).argmin())
            is_in = built.increments.are_in(state)
            fractions = np.bincount(built.increments.textures[is_in], built.increments.sizes[is_in], len(ROLES)) / sizes[state]
            flip = judge.measure_flip(decode_textures(built.textures, built.increments, built.content, state))
            row.append({"part": round(sizes[state] / sizes[-1], 3), "flip": round(flip, 4), "fractions": np.round(fractions, 3).tolist()})
        rows[name] = row
    is_last = built.increments.are_in(built.increments.state_count - 1)
    totals = np.bincount(built.increments.textures[is_last], built.increments.sizes[is_last], len(ROLES))
    flip = judge.measure_flip(decode_textures(built.textures, built.increments, built.content))
    return {"bytes": totals.astype(int).tolist(), "complete": round(flip, 4), "weights": rows}


def paint_maps(generator: np.random.Generator) -> list[np.ndarray]:
    """Return a base color, a normal map and a roughness map, (H, W, 3) uint8, of patches of different materials."""
    height = _shrink(paint_patches(generator)).mean(axis=2) / 255.0
    gradients = [0.5 * STEEPNESS * (np.roll(height, -1, axis) - np.roll(height, 1, axis)) for axis in (1, 0)]
    normals = np.stack([-gradients[0], -gradients[1], np.ones_like(height)], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    rough = 0.25 + 0.6 * _shrink(paint_patches(generator)).mean(axis=2) / 255.0
    maps = [0.5 + 0.5 * normals, np.repeat(rough[..., None], 3, axis=2)]
    return [paint_patches(generator), *(np.rint(255.0 * item).astype(np.uint8) for item in maps)]


def _shrink(image: np.ndarray) -> np.ndarray:
    return np.asarray(Image.fromarray(image).resize((SIDE, SIDE), Image.Resampling.BOX)).astype(float)


class View(NamedTuple):
    """What does not depend on textures: the pixels, texture coordinates (N, 2), footprints by role, each (N,), and axes (N, 3, 3) of the
    surface in the view: tangent, bitangent, normal."""

    located: PixelLocations
    uvs: np.ndarray
    footprints: list[np.ndarray]
    axes: np.ndarray


class LitJudge:
    """Compares maps of a mesh of one material with the original ones in renders without perspective."""

    def __init__(self, mesh: TexturedMesh, images: Sequence[np.ndarray], directions: np.ndarray) -> None:
        sizes = [(image.shape[1], image.shape[0]) for image in images]
        self._views = [_look_at(mesh, direction, sizes) for direction in directions]
        self._references = [self._draw(view, to_maps(images)) for view in self._views]

    def measure_flip(self, images: Sequence[np.ndarray]) -> float:
        """Return the mean FLIP error of the pixels of the object."""
        maps, total, count = to_maps(images), 0.0, 0
        for view, reference in zip(self._views, self._references, strict=True):
            error = compare(reference, self._draw(view, maps))[view.located.covered]
            total += float(error.sum())
            count += len(error)
        return total / count

    def _draw(self, view: View, maps: Sequence[Mipmaps]) -> FlipImage:
        image = np.full((PIXELS, PIXELS, 3), BACKGROUND, np.float32)
        image[view.located.covered] = shade(
            view, *(sample_mipmaps(item, view.uvs, size) for item, size in zip(maps, view.footprints, strict=True))
        )
        return prepare_image(image, PIXELS_PER_DEGREE, is_linear=True)


def to_maps(images: Sequence[np.ndarray]) -> list[Mipmaps]:
    """Return the mipmaps of linear colors, normals and roughness."""
    color, normal, roughness = images
    return [
        build_mipmaps(LINEAR_OF_BYTE[color]),
        build_mipmaps(normal / np.float32(127.5) - 1.0),
        build_mipmaps(roughness[..., :1] / np.float32(255.0)),
    ]


def shade(view: View, colors: np.ndarray, normals: np.ndarray, roughness: np.ndarray) -> np.ndarray:
    """Return the colors (N, 3) of pixels in the light of LIGHTS."""
    directions = np.einsum("nc,ncx->nx", normals, view.axes)
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-6)
    alpha = np.maximum(roughness[:, 0], MIN_ROUGHNESS) ** 2
    facing = np.maximum(directions[:, 2], 1e-3)
    result = AMBIENT * colors
    for *light, strength in LIGHTS:
        light = np.array(light) / np.linalg.norm(light)
        half = (light + [0.0, 0.0, 1.0]) / np.linalg.norm(light + [0.0, 0.0, 1.0])
        lit = np.maximum(directions @ light, 0.0)
        cosine = np.maximum(directions @ half, 0.0)
        spread = alpha**2 / (np.pi * (cosine**2 * (alpha**2 - 1.0) + 1.0) ** 2)
        geometry = 0.5 / (
            lit * np.sqrt(facing**2 * (1.0 - alpha**2) + alpha**2) + facing * np.sqrt(lit**2 * (1.0 - alpha**2) + alpha**2) + 1e-6
        )
        fresnel = F0 + (1.0 - F0) * (1.0 - half[2]) ** 5
        result = result + strength * lit[:, None] * (colors / np.pi + (spread * geometry * fresnel)[:, None])
    return result.astype(np.float32)


def _look_at(mesh: TexturedMesh, direction: np.ndarray, sizes: Sequence[tuple[int, int]]) -> View:
    frame, axes = frame_around(mesh.vertices), view_axes(direction)
    positions = (mesh.vertices - frame.center) @ axes.T
    corners = ((positions[:, :2] / frame.side + 0.5) * PIXELS)[mesh.triangles]
    owners, _ = draw_ids(corners, -positions[:, 2][mesh.triangles], (PIXELS, PIXELS))
    rows, columns = np.nonzero(owners >= 0)
    triangles = owners[rows, columns]
    barycentric = locate_positions(corners[triangles], np.ones((len(triangles), 3)), np.stack([columns, rows], axis=1) + 0.5)
    located = PixelLocations(owners >= 0, triangles, barycentric)
    corner_uvs = mesh.corner_uvs
    edges, uv_edges = np.diff(positions[mesh.triangles], axis=1), np.diff(corner_uvs, axis=1)
    determinants = uv_edges[:, 0, 0] * uv_edges[:, 1, 1] - uv_edges[:, 0, 1] * uv_edges[:, 1, 0]
    signs = np.where(determinants < 0.0, -1.0, 1.0)[:, None]
    tangents = signs * (edges[:, 0] * uv_edges[:, 1, 1, None] - edges[:, 1] * uv_edges[:, 0, 1, None])
    normals = located.interpolate((vertex_normals(mesh.vertices, mesh.triangles) @ axes.T)[mesh.triangles])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    across = tangents[located.triangles]
    across = across - (across * normals).sum(axis=1, keepdims=True) * normals
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    along = signs[located.triangles] * np.cross(normals, across)
    footprints = [measure_footprints(corners, corner_uvs, size)[located.triangles] for size in sizes]
    return View(located, located.interpolate(corner_uvs), footprints, np.stack([across, along, normals], axis=1))
