"""How good a texture from photographs is: against the truth, at seams, and rendered against photographs."""

from typing import NamedTuple

import numpy as np
from photos_models import Paint
from scipy.optimize import minimize_scalar

from farfield.addon.core.geometry.edges import find_edges
from farfield.addon.core.geometry.lenses import PhotoCamera
from farfield.addon.core.geometry.mesh import TriangleMesh, vertex_normals
from farfield.addon.core.imaging.colors import decode_signed_srgb, encode_signed_srgb
from farfield.addon.core.imaging.images import sample_bilinear
from farfield.addon.core.imaging.metrics import psnr, ssim_map
from farfield.addon.core.imaging.raster import locate_pixels
from farfield.addon.core.photos.photographs.photograph import Photograph
from farfield.addon.core.photos.photographs.views import View
from farfield.addon.core.photos.texels.texel_map import TexelMap

STEP = 1.0  # texels from an edge to each side
MIN_EDGE_TEXELS = 1.0
MAX_GAP = 1e-3  # texels between the UVs of both sides of an edge that is no seam


class Truth(NamedTuple):
    """The true colors (N, 3) of the `texels` (N,) that at least one photograph shows."""

    texels: np.ndarray
    colors: np.ndarray


def find_truth(mesh: TriangleMesh, corner_uvs: np.ndarray, size: int, paint: Paint, cameras: list[PhotoCamera]) -> Truth:
    """Return the truth for a texture of `size`, with the cameras that took the photographs."""
    views = [View(camera, mesh) for camera in cameras]
    normals = vertex_normals(mesh.vertices, mesh.triangles)[mesh.triangles]
    texels, colors = [], []
    for tile in TexelMap(corner_uvs, size).tiles():
        points, directions = tile.interpolate(mesh.corners), tile.interpolate(normals)
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
        is_seen = np.zeros(len(points), bool)
        for view in views:
            is_seen[view.see(points, directions).indices] = True
        texels.append(tile.texels[is_seen])
        colors.append(paint(points[is_seen]))
    return Truth(np.concatenate(texels), np.concatenate(colors))


def score_truth(texture: np.ndarray, truth: Truth) -> float:
    """Return the PSNR of a texture (S, S, 3) after one gain per channel, in linear light, has been applied to all of it."""
    found = texture.reshape(-1, 3)[truth.texels]
    return round(psnr(truth.colors, apply_best_gain(found, truth.colors)), 2)


def apply_best_gain(encoded: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Return encoded colors (N, 3) with the gain per channel, in linear light, that brings them nearest to `reference` (N, 3)."""
    linear = decode_signed_srgb(encoded)
    result = np.empty_like(encoded)
    for channel in range(3):
        values, target = linear[:, channel], reference[:, channel]

        def error(logarithm: float, values: np.ndarray = values, target: np.ndarray = target) -> float:
            return float(np.square(encode_signed_srgb(values * np.float32(np.exp(logarithm))) - target).mean())

        best = minimize_scalar(error, bounds=(-1.5, 1.5), method="bounded").x
        result[:, channel] = encode_signed_srgb(values * np.float32(np.exp(best)))
    return result


def score_seams(mesh: TriangleMesh, corner_uvs: np.ndarray, texture: np.ndarray, source: np.ndarray | None) -> dict[str, float | None]:
    """Return the mean jumps of color across edges of the mesh, from one texel on one side to one on the other, relative to those at edges
    that are no border: at UV seams, and where the photograph with the largest weight `source` (S, S) changes."""
    size = len(texture)
    halfedges = find_edges(mesh.triangles, len(mesh.vertices)).interior_halfedges
    corners = corner_uvs.astype(np.float64) * size
    positions, lengths, ends = [], [], []
    for halfedge in halfedges.T:
        triangle, side = halfedge // 3, halfedge % 3
        third, first, second = (corners[triangle, (side + step) % 3] for step in range(3))
        along = second - first
        length = np.linalg.norm(along, axis=1)
        inward = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
        inward *= np.sign(np.einsum("ni,ni->n", inward, third - first))[:, None]
        positions.append(0.5 * (first + second) + STEP * inward)
        lengths.append(length)
        ends.append((first, second))
    gaps = [np.abs(ends[0][i] - ends[1][1 - i]).max(axis=1) for i in range(2)]
    is_seam = np.maximum(*gaps) > MAX_GAP
    used = np.minimum(*lengths) >= MIN_EDGE_TEXELS
    sides = [sample_bilinear(texture, position) for position in positions]
    jumps = np.abs(sides[0] - sides[1]).mean(axis=1)
    is_border = np.zeros(len(used), bool)
    if source is not None:
        texels = [np.clip(np.floor(position).astype(int), 0, size - 1) for position in positions]
        labels = [source[texel[:, 1], texel[:, 0]] for texel in texels]
        used &= (labels[0] >= 0) & (labels[1] >= 0)
        is_border = labels[0] != labels[1]
    inner = float(jumps[used & ~is_seam & ~is_border].mean())
    result = {"uv_seams": _mean_ratio(jumps[used & is_seam & ~is_border], inner)}
    if source is not None:
        result["mask_borders"] = _mean_ratio(jumps[used & is_border & ~is_seam], inner)
    return result


def _mean_ratio(jumps: np.ndarray, inner: float) -> float | None:
    return round(float(jumps.mean()) / inner, 3) if len(jumps) else None


class RenderScore(NamedTuple):
    """SSIM and PSNR of a texture rendered from a photograph's camera, over the pixels that show the mesh, and the image (H, W, 3) in front
    of the photograph."""

    ssim: float
    psnr: float
    image: np.ndarray


def score_render(mesh: TriangleMesh, corner_uvs: np.ndarray, texture: np.ndarray, photograph: Photograph) -> RenderScore:
    """Render a texture from the camera of a photograph and compare, after one gain per channel."""
    camera = photograph.camera
    positions, depths, is_valid = camera.project(mesh.vertices)
    kept = is_valid[mesh.triangles].all(axis=1)
    triangles = mesh.triangles[kept]
    located = locate_pixels(positions[triangles], depths[triangles], camera.lens.size)
    covered = located.covered
    image = np.zeros((*covered.shape, texture.shape[2]), np.float32)
    image[covered] = sample_bilinear(texture, located.interpolate(corner_uvs[kept]) * texture.shape[1::-1])
    pixels = photograph.pixels.astype(np.float32) / np.float32(255.0)
    if photograph.mask is not None:
        covered &= photograph.mask
    image[covered] = apply_best_gain(image[covered], pixels[covered])
    composed = np.where(covered[..., None], image, pixels)
    similarity = ssim_map(pixels, composed)[covered].mean()
    return RenderScore(round(float(similarity), 4), round(psnr(pixels[covered], image[covered]), 2), composed)
