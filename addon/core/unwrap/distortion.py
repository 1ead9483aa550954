"""Quality metrics of a UV map, and colors for its stretch: stretch, flips, overlaps, triangle quality, filled area and texel density."""

from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import TriangleMesh, face_areas_and_normals
from ..geometry.transforms import signed_areas
from ..imaging.raster import fill_triangles
from ..jobs.chunks import slices
from ..jobs.progress import Progress, Steps
from .energies.rest_shapes import compute_rest_shapes
from .energies.shape_barrier import min_height_to_base
from .energies.stretch_energy import compute_jacobians
from .overlaps import count_overlaps
from .parameterization.density_control import compute_density_ratio
from .texture import Texture, compute_texel_density

NEGLIGIBLE_AREA = 1e-9  # The stretch of triangles below this fraction of the mean area is rounding noise.
TRIANGLES_AT_ONCE = 1 << 16  # Measured together, which bounds the memory.
PERCENTILES = 95.0, 99.0
MAX_ANISOTROPY = 4.0  # Above it a texture visibly smears along a line.
MAX_NEEDLE_EXPANSION = 4.0  # Triangles that are longer in the map than this multiple, and anisotropic, are needles.
IMPORTANCE_BINS = 4
NEUTRAL, STRETCHED, COMPRESSED = np.array([0.93, 0.93, 0.90]), np.array([0.75, 0.10, 0.08]), np.array([0.10, 0.28, 0.70])
SATURATION_STRETCH = 2.0  # Stretch, or its inverse, that gets the full color.
BACKGROUND = 0.16
TILE_TOLERANCE = 1e-3  # UVs may exceed a tile by so much without belonging to the next one.


@dataclass(frozen=True)
class Stretches:
    """Stretch of T triangles in a UV map that is scaled to the area of the surface.

    max_stretch, min_stretch (T,): largest and smallest ratio of a length on the surface to the length in the map; infinite where the
    triangle has no area in the map. is_flipped (T,) bool: triangles that are mirrored in the map.
    """

    max_stretch: np.ndarray
    min_stretch: np.ndarray
    is_flipped: np.ndarray

    @property
    def dominant(self) -> np.ndarray:
        """The one of both stretches (T,) that is farther from 1: above 1 where the map is compressed, below 1 where it is expanded."""
        return np.where(self.max_stretch * self.min_stretch >= 1.0, self.max_stretch, self.min_stretch)

    @property
    def anisotropy(self) -> np.ndarray:
        """The ratio (T,) of both stretches, 1 or more."""
        is_finite = (self.max_stretch < np.inf) & (self.min_stretch > 0.0)
        return np.divide(self.max_stretch, self.min_stretch, out=np.full(len(is_finite), np.inf), where=is_finite)

    @property
    def is_needle(self) -> np.ndarray:
        """Triangles (T,) bool that are anisotropic and expanded by more than `MAX_NEEDLE_EXPANSION`."""
        return (self.anisotropy > MAX_ANISOTROPY) & (self.min_stretch * MAX_NEEDLE_EXPANSION < 1.0)


@dataclass(frozen=True)
class DistortionMetrics:
    """Metrics of a UV map that is scaled to the area of the surface. For an isometry the stretches are 1 and symmetric_dirichlet is 4.

    Attributes:
        l2, linf: Geometric stretch, mean and maximum (Sander et al. 2001, section 3). The maximum is the largest compression in the map.
        p95, p99: Percentiles of the maximum stretch of triangles, weighted by area.
        max_expansion: Largest ratio of a length in the map to the length on the surface.
        symmetric_dirichlet: Mean symmetric Dirichlet energy at the best scale.
        anisotropy_p99: 99th percentile of the ratio of the two stretches of triangles, weighted by area.
        anisotropic_fraction: Fraction of the used texture in triangles with a ratio above `MAX_ANISOTROPY`.
        needles: Fraction of the used texture in such triangles that are expanded by more than `MAX_NEEDLE_EXPANSION`.
        flips: Number of flipped triangles.
        overlaps: Number of overlapping pairs of triangles.
        min_quality: Minimum height-to-base ratio of UV triangles.
        fill: Covered fraction of the UDIM tiles in use.
        texel_density: Texels per meter on the surface, on average.
        densities: Texel density over the mean density, for triangles with importance in the first to the fourth quarter of 0..1; 0
            for empty quarters.
        density_ratio: Texel density of triangles with an importance above 0.5 over that of the others; 0 where either set is empty.
    """

    l2: float
    linf: float
    p95: float
    p99: float
    max_expansion: float
    symmetric_dirichlet: float
    anisotropy_p99: float
    anisotropic_fraction: float
    needles: float
    flips: int
    overlaps: int
    min_quality: float
    fill: float
    texel_density: float
    densities: tuple[float, ...]
    density_ratio: float


def compute_stretches(mesh: TriangleMesh, corner_uvs: np.ndarray) -> Steps[Stretches]:
    """Return the stretch of every triangle of `mesh` in a UV map `corner_uvs` (T, 3, 2)."""
    count = len(corner_uvs)
    areas, determinants, largest = np.empty(count), np.empty(count), np.empty(count)
    for part in slices(count, TRIANGLES_AT_ONCE):
        yield Progress(part.start / count, "Measuring")
        corners, uv = mesh.vertices[mesh.triangles[part]], corner_uvs[part].reshape(-1, 2)
        jacobians = compute_jacobians(compute_rest_shapes(corners), np.arange(len(uv)).reshape(-1, 3), uv)
        areas[part], determinants[part] = face_areas_and_normals(corners)[0], jacobians.determinants
        # Singular values s1 >= s2 from s1^2 + s2^2 and s1 s2; s2 = determinant / s1 keeps precision.
        half_difference = np.sqrt(np.maximum(jacobians.frobenius_squared**2 - 4.0 * jacobians.determinants**2, 0.0))
        largest[part] = np.sqrt(0.5 * (jacobians.frobenius_squared + half_difference))
    scale = np.sqrt(areas @ np.abs(determinants) / (areas.sum() or 1.0))
    absolute = np.abs(determinants)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Stretches(
            np.where(absolute > 0.0, scale * largest / absolute, np.inf),
            np.where(largest > 0.0, scale / largest, np.inf),
            determinants < 0.0,
        )


def measure_distortion(
    mesh: TriangleMesh,
    corner_uvs: np.ndarray,
    stretches: Stretches,
    importance: np.ndarray,
    texture: Texture | None = None,
    unit_length: float = 1.0,
    tile_count: int = 1,
    is_stacked: np.ndarray | None = None,
) -> Steps[DistortionMetrics]:
    """Return all metrics of the UV map `corner_uvs` (T, 3, 2) of `mesh`, from its `stretches` and `importance` (T,), 0 to 1.

    texture: that the map is made for. unit_length: of a unit of `mesh`, in meters. tile_count: UDIM tiles of the map.
    is_stacked: (T,) bool, triangles in the place of others on purpose, which neither overlap these nor cover anything.
    """
    texture = texture or Texture()
    separate = slice(None) if is_stacked is None else ~is_stacked
    areas, _ = face_areas_and_normals(mesh.corners)
    measurable = areas > NEGLIGIBLE_AREA * areas.mean()
    weights = areas[measurable] / areas[measurable].sum()
    max_stretch, min_stretch = stretches.max_stretch[measurable], stretches.min_stretch[measurable]
    squares = max_stretch**2 + min_stretch**2
    p95, p99 = _percentiles(max_stretch, weights)
    with np.errstate(divide="ignore"):
        inverse_squares = 1.0 / max_stretch**2 + 1.0 / min_stretch**2
        dirichlet = 2.0 * np.sqrt((weights @ squares) * (weights @ inverse_squares))  # The best scale balances both means.
    uv_areas = np.abs(signed_areas(corner_uvs))
    used_texture = uv_areas[measurable] / uv_areas[measurable].sum()
    anisotropy = stretches.anisotropy[measurable]
    yield Progress(0.0, "Measuring")
    overlaps = yield from count_overlaps(corner_uvs[separate])
    return DistortionMetrics(
        l2=float(np.sqrt(0.5 * weights @ squares)),
        linf=float(max_stretch.max()),
        p95=p95,
        p99=p99,
        max_expansion=float(1.0 / min_stretch.min()),
        symmetric_dirichlet=float(dirichlet),
        anisotropy_p99=_percentiles(anisotropy, weights)[1],
        anisotropic_fraction=float(used_texture[anisotropy > MAX_ANISOTROPY].sum()),
        needles=float(used_texture[stretches.is_needle[measurable]].sum()),
        flips=int(stretches.is_flipped.sum()),
        overlaps=overlaps,
        min_quality=float(min_height_to_base(corner_uvs * texture.aspect).min()),
        fill=float(uv_areas[separate].sum()) / tile_count,
        texel_density=compute_texel_density(corner_uvs, float(areas.sum()) * unit_length**2, texture),
        densities=_compute_densities(uv_areas, areas, importance),
        density_ratio=compute_density_ratio(uv_areas, areas, importance),
    )


def _percentiles(values: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """Return `PERCENTILES` of `values` (N,) by their `weights` (N,), which sum to 1."""
    order = np.argsort(values)
    ranks = 100.0 * np.cumsum(weights[order])
    p95, p99 = (float(values[order[min(int(np.searchsorted(ranks, rank)), len(order) - 1)]]) for rank in PERCENTILES)
    return p95, p99


def _compute_densities(uv_areas: np.ndarray, areas: np.ndarray, importance: np.ndarray) -> tuple[float, ...]:
    """Return `uv_areas` over `areas` per quarter of importance, (T,) each, relative to all triangles."""
    bins = np.clip((IMPORTANCE_BINS * importance).astype(int), 0, IMPORTANCE_BINS - 1)
    area_sums, uv_sums = (np.bincount(bins, values, IMPORTANCE_BINS) for values in (areas, uv_areas))
    densities = np.divide(uv_sums, area_sums, out=np.zeros(IMPORTANCE_BINS), where=area_sums > 0.0)
    return tuple((densities * areas.sum() / uv_areas.sum()).tolist())


def stretch_colors(stretches: np.ndarray) -> np.ndarray:
    """Return colors (N, 3) float32, sRGB, of `stretches` (N,); 1 is no stretch."""
    t = np.clip(np.log(np.maximum(stretches, 1e-6)) / np.log(SATURATION_STRETCH), -1.0, 1.0)[:, None]
    return (NEUTRAL + np.abs(t) * (np.where(t > 0.0, STRETCHED, COMPRESSED) - NEUTRAL)).astype(np.float32)


def draw_stretch_image(corner_uvs: np.ndarray, stretches: np.ndarray, resolution: int) -> np.ndarray:
    """Return an image (resolution, resolution, 3), sRGB, of a UV map `corner_uvs` (T, 3, 2), colored by `stretches` (T,).

    It shows the unit square, or the square around all UDIM tiles.
    """
    scale = resolution / max(np.ceil(corner_uvs.max(initial=1.0) - TILE_TOLERANCE), 1.0)
    return fill_triangles(np.asarray(corner_uvs, np.float64) * scale, stretch_colors(stretches), (resolution, resolution), BACKGROUND)
