"""Scale space of the range image of a mesh, the method of the TexMesh paper (sections II and III.A)."""

import numpy as np

from ...errors import GeometryError
from ...jobs.progress import Progress, Steps
from ..textured_mesh import TexturedMesh
from .range_filter import RangeFilter, find_zero_crossings
from .range_image import RangeImage, build_range_image
from .scale_map import SCALES, LastFeatures, ScaleMap
from .settings import ScaleSpaceSettings

ROUNDING = 1e-9  # of the largest range: smaller differences of the Laplacian owe their sign to rounding
SEARCH_STEPS = 20  # bisections of the largest standard deviation
MIN_SAMPLES = 16
MIN_LOSS = 0.0005  # of the area, that is worth a sentence


def analyze_range_image(mesh: TexturedMesh, settings: ScaleSpaceSettings) -> Steps[ScaleMap]:
    """Return the scale map of `mesh` by filters of its range image. The last scale of a vertex is that of its pixel, 0 if its pixel shows
    another part of the surface.

    Raises:
        GeometryError: next to nothing of the surface faces the axis.
    """
    yield Progress(0.0, "Building the range image")
    image = build_range_image(mesh.vertices, mesh.triangles, "xyz".index(settings.axis))
    if image.is_known.sum() < MIN_SAMPLES:
        raise GeometryError(
            f"The surface is edge-on to the {settings.axis.upper()} axis, so that it has no range image; choose another axis or analysis."
        )
    sample = float(np.sqrt(image.column_length * image.row_length))
    filtering = RangeFilter(image.ranges, image.is_known, phi=(image.column_length / sample) ** 2, psi=(image.row_length / sample) ** 2)
    limit = 0.5 * max(image.ranges.shape[1] * image.column_length, image.ranges.shape[0] * image.row_length) / sample
    sigmas = np.linspace(0.0, _search_last_sigma(filtering, image, settings.convergence, limit), SCALES)

    pixels = LastFeatures(np.zeros(image.ranges.size))
    spans = []
    for scale, sigma in enumerate(sigmas):
        yield Progress(0.1 + 0.85 * scale / SCALES, f"Filtering, scale {scale} of {SCALES - 1}")
        spans.append(_measure_span(filtering, image, sigma))
        if scale:
            crossings = find_zero_crossings(filtering.laplacian(sigma), image.is_known, ROUNDING * float(image.ranges.max()))
            pixels.add(scale, *crossings)
    features = LastFeatures(np.where(image.is_seen, pixels.strengths[image.pixels], 0.0))
    features.last_scales = np.where(image.is_seen, pixels.last_scales[image.pixels], 0).astype(np.int8)
    return features.to_scale_map(sigmas * sample, np.array(spans) / max(spans[0], np.finfo(float).tiny), _describe_losses(image))


def _search_last_sigma(filtering: RangeFilter, image: RangeImage, convergence: float, limit: float) -> float:
    """Return the standard deviation, at most `limit`, in mean samples, at which the range of the filtered image falls to the fraction
    `convergence` (section IV)."""
    target = convergence * _measure_span(filtering, image, 0.0)
    low, high = 0.0, limit
    if _measure_span(filtering, image, high) >= target:
        return high
    for _ in range(SEARCH_STEPS):
        center = 0.5 * (low + high)
        low, high = (low, center) if _measure_span(filtering, image, center) < target else (center, high)
    return high


def _measure_span(filtering: RangeFilter, image: RangeImage, sigma: float) -> float:
    """Return the largest minus the smallest filtered value (Figure 10)."""
    return float(np.ptp(filtering.smooth(sigma)[image.is_known]))


def _describe_losses(image: RangeImage) -> str:
    if image.hidden + image.edge_on < MIN_LOSS:
        return ""
    return (
        f"{100.0 * (image.hidden + image.edge_on):.1f}% of the area is not in the range image: {100.0 * image.hidden:.1f}% is behind other "
        f"parts, {100.0 * image.edge_on:.1f}% is edge-on to the axis, such as caps."
    )
