"""One texture from several photographs of a surface (Textures Revisited, section 4).

Each triangle is textured from the photograph that shows it best; photographs are blended within the triangles between two regions, after
their exposures and then their colors at the vertices have been adjusted to each other. Texels that their photographs do not show get the
average of all others, and texels that none shows are interpolated over the surface.
"""

from dataclasses import dataclass

import numpy as np

from ..errors import GeometryError, ImageError
from ..geometry.edges import Edges, find_edges
from ..geometry.geometry_2d import signed_areas
from ..geometry.mesh import TriangleMesh, check_points, face_areas_and_normals
from ..imaging.images import dilate
from ..jobs.progress import Progress, StageClock, Steps
from .consistency import rate_photographs
from .exposure import estimate_gains
from .labels import choose_labels
from .leveling import VertexLabels, find_vertex_labels, solve_corrections
from .observations import Observations, observe, sample_surface
from .photographs import Photograph, apply_gain
from .settings import PhotosSettings
from .surface import interpolate_colors
from .texels import TexelMap, TexelTile, vertex_normals
from .tile_colors import NO_PHOTOGRAPH, TileColors
from .views import View

FACE_SAMPLES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])  # barycentric
EXPOSURE_POINTS = 20_000
GUTTER = 8  # texels around covered ones that get the mean of their neighbors


@dataclass(frozen=True)
class PhotoTexture:
    """The result of `merge`.

    colors: (H, W, 3) float32, sRGB-encoded, row 0 at the bottom. confidence: (H, W) float32, 0 to 1, the pixels per texel along one axis of
    the best photograph. source: (H, W) int16, the photograph with the largest weight, -1 for none. holes: (H, W) bool, covered texels that
    no photograph shows. gains: (K, 3). labels: (T,) the photograph of each triangle, -1 for none.
    """

    colors: np.ndarray
    confidence: np.ndarray
    source: np.ndarray
    holes: np.ndarray
    gains: np.ndarray
    labels: np.ndarray
    seconds: dict[str, float]


def merge(mesh: TriangleMesh, corner_uvs: np.ndarray, photographs: list[Photograph], settings: PhotosSettings) -> Steps[PhotoTexture]:
    """Merge `photographs` into a texture for `mesh` with UVs (T, 3, 2).

    Raises:
        ImageError: a photograph or mask does not have the size that its camera says, or there is none.
        GeometryError: no photograph shows the mesh, it has no area or is not finite, or the UV map covers no texel.
    """
    if not photographs:
        raise ImageError("There are no photographs; name a folder with the images that the cameras refer to.")
    for photograph in photographs:
        photograph.check()
    check_points(mesh.vertices, "mesh")
    if not np.isfinite(corner_uvs).all():
        raise GeometryError("The UV map has coordinates that are not finite; unwrap the mesh again.")
    clock = StageClock()
    merger = _Merger(mesh, corner_uvs, photographs, settings, clock)
    yield from merger.look()
    yield Progress(0.3, "Comparing photographs")
    with clock.stage("exposure"):
        merger.compare()
    yield Progress(0.35, "Choosing photographs")
    with clock.stage("labels"):
        merger.label()
    yield Progress(0.4, "Adjusting colors")
    with clock.stage("leveling"):
        merger.level()
    yield from merger.fill_texels()
    yield Progress(0.9, "Filling holes")
    with clock.stage("holes"):
        return merger.finish()


class _Merger:
    """The state between the steps of `merge`."""

    def __init__(
        self, mesh: TriangleMesh, corner_uvs: np.ndarray, photographs: list[Photograph], settings: PhotosSettings, clock: StageClock
    ) -> None:
        self.mesh, self.photographs, self.settings, self.clock = mesh, photographs, settings, clock
        with clock.stage("texels"):
            self.map = TexelMap(corner_uvs, settings.size)
            if not self.map.covered.any():
                raise GeometryError("The UV map covers no pixel of the texture; unwrap the mesh, or move its UVs into the range 0 to 1.")
        self.areas, _ = face_areas_and_normals(mesh.corners)
        if not self.areas.any():
            raise GeometryError("The faces of the mesh have no area; scale it up.")
        uv_areas = np.abs(signed_areas(corner_uvs.astype(np.float64))) * settings.size**2
        self.texel_areas = self.areas / np.maximum(uv_areas, 1e-12)  # of the surface, per triangle
        self.normals = vertex_normals(mesh)
        self.edges: Edges = find_edges(mesh.triangles, len(mesh.vertices))
        self.views: list[View] = []
        self.gains = np.ones((len(photographs), 3))

    def look(self) -> Steps[None]:
        """Find out what each photograph shows."""
        for index, photograph in enumerate(self.photographs):
            yield Progress(0.3 * index / len(self.photographs), "Finding visible faces")
            with self.clock.stage("visibility"):
                self.views.append(View(photograph.camera, self.mesh, photograph.mask))

    def compare(self) -> None:
        """Estimate the gains of the photographs, and which of their parts show something else than the surface."""
        observed = observe(sample_surface(self.mesh, self.normals, self.areas), self.photographs, self.views)
        self._estimate_gains(observed, None)
        colors = np.empty_like(observed.colors)
        for index, gain in enumerate(self.gains):
            own = observed.photographs == index
            colors[own] = apply_gain(observed.colors[own], gain)
        trust = rate_photographs(observed, colors, [photograph.camera.lens.size for photograph in self.photographs])
        weights = np.empty(len(observed.points), np.float32)
        for index, (view, cells) in enumerate(zip(self.views, trust, strict=True)):
            view.trust = cells
            own = observed.photographs == index
            weights[own] = view.find_trust(observed.positions[own])
        self._estimate_gains(observed, weights)

    def _estimate_gains(self, observed: Observations, weights: np.ndarray | None) -> None:
        if self.settings.exposure and len(self.photographs) > 1:
            few = slice(int(np.searchsorted(observed.points, EXPOSURE_POINTS)))
            part = Observations(*(values[few] for values in observed))
            self.gains = estimate_gains(part, len(self.photographs), None if weights is None else weights[few])

    def label(self) -> None:
        """Choose the photograph of each triangle."""
        if self.settings.method == "best":
            self.labels = choose_labels(self._rate_faces(), self.edges)
        else:
            self.labels = np.full(len(self.mesh.triangles), NO_PHOTOGRAPH, np.int32)
        self.pairs: VertexLabels = find_vertex_labels(self.mesh.triangles, self.labels, self.areas, len(self.photographs))

    def _rate_faces(self) -> np.ndarray:
        """Return how well (T, K) each photograph shows each triangle, 0 if not all of it."""
        corners, normals = self.mesh.corners, self.normals[self.mesh.triangles]
        qualities = np.zeros((len(corners), len(self.views)), np.float32)
        for index, view in enumerate(self.views):
            seen = [view.see(np.einsum("i,tic->tc", b, corners), _unit(np.einsum("i,tic->tc", b, normals))) for b in FACE_SAMPLES]
            is_complete = np.all([each.visible for each in seen], axis=0)
            qualities[:, index] = np.where(is_complete, np.mean([each.weights for each in seen], axis=0), 0.0)
        return qualities

    def level(self) -> None:
        """Compute the colors of vertices and their corrections."""
        self.corrections = np.zeros((len(self.pairs.keys), 3), np.float32)
        colors, visible = np.zeros((len(self.pairs.keys), 3), np.float32), np.zeros(len(self.pairs.keys), bool)
        sums, weights = np.zeros((len(self.mesh.vertices), 3)), np.zeros(len(self.mesh.vertices))
        for index, view in enumerate(self.views):
            seen = view.see(self.mesh.vertices, self.normals)
            smooth = apply_gain(self.photographs[index].sample_smooth(np.nan_to_num(seen.positions)), self.gains[index])
            sums += seen.weights[:, None] * smooth
            weights += seen.weights
            own = np.flatnonzero(self.pairs.photographs == index)
            colors[own], visible[own] = smooth[self.pairs.vertices[own]], seen.visible[self.pairs.vertices[own]]
        if self.settings.leveling and len(self.pairs.keys):
            self.corrections = solve_corrections(self.pairs, colors, visible, self.edges)
        self.vertex_colors = np.where(weights[:, None] > 0.0, sums / np.maximum(weights, 1e-30)[:, None], 0.0)
        self.bound = weights > 0.0
        has_label = np.bincount(self.pairs.vertices, self.pairs.weights * visible, len(self.mesh.vertices)) > 0.5
        for channel in range(3):
            values = self.pairs.weights * (colors + self.corrections)[:, channel]
            leveled = np.bincount(self.pairs.vertices, values, len(self.mesh.vertices))
            self.vertex_colors[has_label, channel] = leveled[has_label]

    def fill_texels(self) -> Steps[None]:
        """Compute the texels, tile by tile."""
        count = self.settings.size**2
        self.colors, self.confidence = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
        self.source = np.full(count, NO_PHOTOGRAPH, np.int16)
        uses = [(self.pairs.find(self.mesh.triangles, index)) for index in range(len(self.views))]
        done, total = 0, int(np.count_nonzero(self.map.triangles >= 0))
        for tile in self.map.tiles():
            with self.clock.stage("colors"):
                self._fill_tile(tile, uses)
            done += len(tile.texels)
            yield Progress(0.45 + 0.45 * done / total, "Computing texels")

    def _fill_tile(self, tile: TexelTile, uses: list[np.ndarray]) -> None:
        found = TileColors(len(tile.texels))
        points, normals = tile.interpolate(self.mesh.corners), _unit(tile.interpolate(self.normals[self.mesh.triangles]))
        pair_weights = np.append(self.pairs.weights, 0.0).astype(np.float32)
        corrections = np.concatenate([self.corrections, np.zeros((1, 3), np.float32)])
        for index, pairs in enumerate(uses):
            corner_pairs = pairs[tile.triangles]
            blend = np.einsum("ni,ni->n", tile.barycentric, pair_weights[corner_pairs])
            used = np.flatnonzero(blend > 0.0)
            seen = self.views[index].see(points[used], normals[used])
            kept = used[seen.visible]
            colors = apply_gain(self.photographs[index].sample(seen.positions[seen.visible]), self.gains[index])
            colors += np.einsum("ni,nic->nc", tile.barycentric[kept], corrections[corner_pairs[kept]])
            found.add(index, kept, colors, blend[kept], seen.resolution[seen.visible])
        rest = np.flatnonzero(found.weights == 0.0)
        if len(rest):
            self._average(tile, points, normals, rest, found)
        is_found = found.weights > 0.0
        self.colors[tile.texels[is_found]] = found.colors[is_found]
        self.confidence[tile.texels] = np.sqrt(np.minimum(found.resolution * self.texel_areas[tile.triangles], 1.0))
        self.source[tile.texels] = found.source

    def _average(self, tile: TexelTile, points: np.ndarray, normals: np.ndarray, rest: np.ndarray, found: TileColors) -> None:
        """Average all photographs that show the texels `rest` (R,) of a tile with `points` and `normals` (N, 3)."""
        for index, view in enumerate(self.views):
            seen = view.see(points[rest], normals[rest])
            kept = rest[seen.visible]
            colors = apply_gain(self.photographs[index].sample(seen.positions[seen.visible]), self.gains[index])
            weights = seen.weights[seen.visible]
            if self.settings.method == "paper":
                to_camera = _unit(view.camera.position - points[kept])
                weights = np.einsum("ni,ni->n", to_camera, normals[kept]).astype(np.float32)
                weights *= view.find_trust(seen.positions[seen.visible])
            found.add(index, kept, colors, weights, seen.resolution[seen.visible])

    def finish(self) -> PhotoTexture:
        """Fill what no photograph shows, and what lies around the islands of the UV map."""
        covered, found = self.map.triangles >= 0, self.source != NO_PHOTOGRAPH
        if not found.any():
            raise GeometryError(_explain_blindness(self.mesh, self.photographs))
        if self.settings.fill == "interpolate":
            colors, known = interpolate_colors(self.vertex_colors, self.bound, self.edges)
            colors[~known] = self.colors[found].mean(axis=0)
            for tile in self.map.tiles():
                missing = ~found[tile.texels]
                part = TexelTile(tile.texels[missing], tile.triangles[missing], tile.barycentric[missing])
                self.colors[part.texels] = part.interpolate(colors[self.mesh.triangles].astype(np.float32))
        known = covered if self.settings.fill == "interpolate" else found
        size = self.settings.size
        image = np.clip(self.colors, 0.0, 1.0).reshape(size, size, 3)
        return PhotoTexture(
            colors=dilate(image, known.reshape(size, size), GUTTER),
            confidence=self.confidence.reshape(size, size),
            source=self.source.reshape(size, size),
            holes=(covered & ~found).reshape(size, size),
            gains=self.gains,
            labels=self.labels,
            seconds=self.clock.seconds,
        )


def _explain_blindness(mesh: TriangleMesh, photographs: list[Photograph]) -> str:
    """Return the sentence that says why no photograph shows the mesh."""
    inside = 0
    for photograph in photographs:
        positions, _, is_valid = photograph.camera.project(mesh.vertices)
        limits = np.array(photograph.camera.lens.size)
        inside += bool((is_valid & (positions >= 0.0).all(axis=1) & (positions < limits).all(axis=1)).any())
    if not inside:
        return (
            "No vertex of the mesh lies in the frame of any photograph; the cameras and the mesh are in different coordinate systems, so "
            "export both from the same reconstruction, or turn the mesh to the axes of the cameras."
        )
    return "No photograph shows the front of a face; flip the normals of the mesh, or check the masks of the photographs."


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)
