"""Models whose colors are known at every point, and virtual photographs of them, for `bench_photos.py`."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from farfield.addon.core.geometry.lenses import Lens, PhotoCamera
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.imaging.colors import decode_signed_srgb, encode_signed_srgb
from farfield.addon.core.imaging.raster import locate_pixels
from farfield.addon.core.photos.photographs.photograph import Photograph

Paint = Callable[[np.ndarray], np.ndarray]

SIZE = (1200, 900)
FOCAL = 2600.0
DISTANCE = 2.3  # from the center of the bounding box, in its diagonals
SUPERSAMPLING = 2
SHORTEST_WAVE, LONGEST_WAVE = 0.008, 0.6  # Fractions of the diagonal; the shortest are about 9 pixels.
WAVES = 64
MAX_EXPOSURE = 0.5  # in stops
SENSOR_NOISE = 0.004  # Standard deviation in encoded colors.


@dataclass(frozen=True)
class Shoot:
    """Photographs of a model: as they are given to the methods, and the cameras that they were really taken with."""

    photographs: list[Photograph]
    true_cameras: list[PhotoCamera]


def make_paint(points: np.ndarray, random: np.random.Generator) -> Paint:
    """Return encoded colors (N, 3), as a function of positions (N, 3), that are band-limited: waves in space, and spots of other waves."""
    low, high = points.min(axis=0), points.max(axis=0)
    diagonal = float(np.linalg.norm(high - low))
    lengths = diagonal * np.exp(random.uniform(np.log(SHORTEST_WAVE), np.log(LONGEST_WAVE), WAVES))
    vectors = random.normal(size=(WAVES, 3))
    vectors *= 2.0 * np.pi / lengths[:, None] / np.linalg.norm(vectors, axis=1, keepdims=True)
    phases = random.uniform(0.0, 2.0 * np.pi, WAVES)
    strengths = (lengths / lengths.max()) ** 0.25
    colors = random.normal(size=(WAVES, 3)) * 0.4 + random.normal(size=(WAVES, 1))
    colors *= strengths[:, None]
    colors /= np.sqrt(0.5 * np.square(colors).sum(axis=0))
    spots = random.normal(size=(WAVES, 1)) * (lengths > 0.06 * diagonal)[:, None]
    spots /= np.sqrt(0.5 * np.square(spots).sum())
    base, other = random.uniform(0.3, 0.55, 3), random.uniform(0.3, 0.55, 3)

    def paint(positions: np.ndarray) -> np.ndarray:
        result = np.empty((len(positions), 3), np.float32)
        for start in range(0, len(positions), 1 << 17):
            part = slice(start, start + (1 << 17))
            waves = np.sin(((positions[part] - low) @ vectors.T + phases).astype(np.float32))
            is_spot = 1.0 / (1.0 + np.exp(-4.0 * (waves @ spots.astype(np.float32))))
            result[part] = base + is_spot * (other - base) + 0.07 * waves @ colors.astype(np.float32)
        return np.clip(result, 0.05, 0.8)

    return paint


def make_knot(random: np.random.Generator) -> TriangleMesh:
    """Return a tube along a torus knot."""
    turns, radius = (2, 3) if random.random() < 0.5 else (3, 4), random.uniform(0.22, 0.32)
    t = np.linspace(0.0, 2.0 * np.pi, 600, endpoint=False)
    around = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)

    def curve(angle: np.ndarray) -> np.ndarray:
        ring = 2.0 + np.cos(turns[1] * angle)
        return np.stack([ring * np.cos(turns[0] * angle), ring * np.sin(turns[0] * angle), -np.sin(turns[1] * angle)], axis=1)

    tangents = curve(t + 1e-4) - curve(t - 1e-4)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    outward = curve(t) * [1.0, 1.0, 0.0]
    outward -= np.einsum("ni,ni->n", outward, tangents)[:, None] * tangents
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    side = np.cross(tangents, outward)
    vertices = (
        curve(t)[:, None] + radius * (np.cos(around)[None, :, None] * outward[:, None] + np.sin(around)[None, :, None] * side[:, None])
    ).reshape(-1, 3)
    return TriangleMesh(vertices, _grid_triangles(len(t), len(around), wrap_rows=True)[:, ::-1])


def make_rock(random: np.random.Generator) -> TriangleMesh:
    """Return a sphere displaced by smooth noise."""
    rows, columns = 120, 240
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    azimuth = 2.0 * np.pi * np.arange(columns) / columns
    directions = np.stack(
        [np.sin(polar)[:, None] * np.cos(azimuth), np.sin(polar)[:, None] * np.sin(azimuth), np.cos(polar)[:, None] + 0.0 * azimuth],
        axis=-1,
    ).reshape(-1, 3)
    waves = random.normal(size=(24, 3)) * random.uniform(1.0, 5.0, (24, 1))
    bumps = np.sin(directions @ waves.T + random.uniform(0.0, 6.0, 24)) / np.linalg.norm(waves, axis=1)
    vertices = directions * (1.0 + 0.12 * bumps.sum(axis=1, keepdims=True)) * random.uniform(0.7, 1.3, 3)
    poles = vertices.reshape(rows, columns, 3)[[0, -1]].mean(axis=1)
    triangles = _grid_triangles(rows, columns, wrap_rows=False)
    next_columns = np.roll(np.arange(columns), -1)
    caps = [
        np.stack([np.full(columns, rows * columns), np.arange(columns), next_columns], axis=1),
        np.stack(
            [np.full(columns, rows * columns + 1), next_columns + (rows - 1) * columns, np.arange(columns) + (rows - 1) * columns], axis=1
        ),
    ]
    return TriangleMesh(np.concatenate([vertices, poles]), np.concatenate([triangles, *caps]).astype(np.int32))


def photograph_model(mesh: TriangleMesh, paint: Paint, random: np.random.Generator, count: int = 8, pose_noise: float = 0.3) -> Shoot:
    """Take `count` photographs all around, with random exposures, poses that are wrong by `pose_noise` pixels in the mean, and one
    passer-by in front of the model in one of them."""
    center, diagonal = _center(mesh.vertices), _diagonal(mesh.vertices)
    passed = int(random.integers(count))
    photographs, cameras = [], []
    for index in range(count):
        azimuth = 2.0 * np.pi * (index + random.uniform(-0.2, 0.2)) / count
        elevation = (-1) ** index * random.uniform(0.2, 0.65)
        direction = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
        camera = _look_at(center + DISTANCE * diagonal * direction, center, f"{index}.png")
        image = _render(mesh, paint, camera, random)
        if index == passed:
            image = _add_passer_by(image, random)
        exposed = encode_signed_srgb(decode_signed_srgb(image) * np.float32(2.0 ** random.uniform(-MAX_EXPOSURE, MAX_EXPOSURE)))
        noisy = exposed + SENSOR_NOISE * random.normal(size=exposed.shape)
        pixels = np.rint(255.0 * np.clip(noisy, 0.0, 1.0)).astype(np.uint8)
        cameras.append(camera)
        photographs.append(Photograph(_disturb(camera, mesh.vertices, pose_noise, random), pixels))
    return Shoot(photographs, cameras)


def _render(mesh: TriangleMesh, paint: Paint, camera: PhotoCamera, random: np.random.Generator) -> np.ndarray:
    """Return the encoded image (H, W, 3) in front of a gray gradient."""
    width, height = SIZE
    positions, depths, _ = camera.project(mesh.vertices)
    size = (width * SUPERSAMPLING, height * SUPERSAMPLING)
    located = locate_pixels(positions[mesh.triangles] * SUPERSAMPLING, depths[mesh.triangles], size)
    y, x = np.mgrid[: size[1], : size[0]] / max(size)
    gradient = random.uniform(-0.2, 0.2, (2, 3))
    image = (0.55 + x[..., None] * gradient[0] + y[..., None] * gradient[1]).astype(np.float32)
    image[located.covered] = paint(located.interpolate(mesh.corners))
    return image.reshape(height, SUPERSAMPLING, width, SUPERSAMPLING, 3).mean(axis=(1, 3))


def _add_passer_by(image: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return the image with an upright blurred figure in front of the middle of the model."""
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width]
    column = 0.5 * width + random.uniform(-0.12, 0.12) * width
    wide, tall = random.uniform(0.03, 0.06) * width, random.uniform(0.2, 0.35) * height
    inside = ((x - column) / wide) ** 2 + ((y - 0.45 * height) / tall) ** 2 < 1.0
    stripes = 0.15 + 0.5 * (np.sin(2.0 * np.pi * y / 60.0) > 0.0)[..., None] * random.uniform(0.2, 1.0, 3)
    opacity = gaussian_filter(inside.astype(np.float32), 1.0)[..., None]
    return image * (1.0 - opacity) + opacity * stripes.astype(np.float32)


def _disturb(camera: PhotoCamera, points: np.ndarray, pixels: float, random: np.random.Generator) -> PhotoCamera:
    """Return the camera with a pose that moves `points` (N, 3) in the image by `pixels` in the mean."""
    axis, shift = random.normal(size=3), random.normal(size=3) * _diagonal(points)
    reference, _, _ = camera.project(points)
    scale = 1e-4
    for _ in range(3):
        rotation = _rotation(axis * scale) @ camera.rotation
        wrong = PhotoCamera(camera.name, camera.lens, rotation, _rotation(axis * scale) @ camera.translation + shift * scale)
        moved, _, _ = wrong.project(points)
        scale *= pixels / max(float(np.linalg.norm(moved - reference, axis=1).mean()), 1e-9)
    return wrong


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a rotation vector (3,)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / max(angle, 1e-30)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _look_at(position: np.ndarray, target: np.ndarray, name: str) -> PhotoCamera:
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    lens = Lens("SIMPLE_PINHOLE", SIZE, (FOCAL, FOCAL), (0.5 * SIZE[0], 0.5 * SIZE[1]))
    return PhotoCamera(name, lens, rotation, -rotation @ position)


def _grid_triangles(rows: int, columns: int, *, wrap_rows: bool) -> np.ndarray:
    """Return the triangles of a grid of vertices, closed along its columns."""
    row, column = np.meshgrid(np.arange(rows if wrap_rows else rows - 1), np.arange(columns), indexing="ij")
    a, b = row * columns + column, row * columns + (column + 1) % columns
    c, d = (row + 1) % rows * columns + column, (row + 1) % rows * columns + (column + 1) % columns
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))]).astype(np.int32)


def _center(points: np.ndarray) -> np.ndarray:
    return 0.5 * (points.min(axis=0) + points.max(axis=0))


def _diagonal(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.ptp(points, axis=0)))
