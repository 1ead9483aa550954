"""What the photographs show of random points on the surface; exposures and outliers are found from it, at a cost that does not depend on
the texture's size."""

from typing import NamedTuple

import numpy as np

from ...files.scratch import Scratch
from ...geometry.transforms import normalize
from ...jobs.chunks import map_ordered
from ...jobs.progress import Progress, Steps
from .photograph import Photograph
from .surface import Surface
from .views import View

LABEL = "Comparing photographs"
POINTS = 60_000
MAX_OBSERVATIONS = 1_200_000  # if every photograph showed every point: more photographs get fewer points


class Observations(NamedTuple):
    """What photographs show of points, one row for each visible point and photograph, ordered by points.

    points: (N,) int64. photographs: (N,) int64. positions: (N, 2) float32 in the pixels of the photograph. colors: (N, 3) float32,
    sRGB-encoded.
    """

    points: np.ndarray
    photographs: np.ndarray
    positions: np.ndarray
    colors: np.ndarray


def sample_surface(surface: Surface, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random points (N, 3), evenly by the areas of the triangles, and interpolated unit normals (N, 3)."""
    generator = np.random.default_rng(0)
    triangles = generator.choice(len(surface.areas), count, p=surface.areas / surface.areas.sum())
    barycentric = generator.dirichlet((1.0, 1.0, 1.0), count)
    points = np.einsum("ni,nic->nc", barycentric, surface.mesh.vertices[surface.mesh.triangles[triangles]])
    return points, normalize(np.einsum("ni,nic->nc", barycentric, surface.corner_normals[triangles]))


def observe(
    points: tuple[np.ndarray, np.ndarray], photographs: list[Photograph], views: list[View], scratch: Scratch
) -> Steps[Observations]:
    """Return what `photographs` show of `points` (see `sample_surface`), with colors that do not depend on the finest details.

    `scratch` keeps the images of photographs and views, and releases each after its use.
    """

    def look(label: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        seen = views[label].see(*points)
        colors = photographs[label].smoothed().sample(seen.positions)
        scratch.release(label)
        return seen.indices, np.full(len(seen.indices), label), seen.positions, colors

    found = []
    for each in map_ordered(look, range(len(photographs))):
        found.append(each)
        yield Progress(len(found) / len(photographs), LABEL)
    indices, labels, positions, colors = zip(*found, strict=True)
    every = np.concatenate(indices)
    order = np.argsort(every, kind="stable")
    return Observations(every[order], np.concatenate(labels)[order], np.concatenate(positions)[order], np.concatenate(colors)[order])
