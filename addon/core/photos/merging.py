"""One texture from several photographs of a surface (Textures Revisited, section 4).

Each triangle is textured from the photograph that shows it best; photographs are blended within the triangles between two regions, after
their exposures and then their colors at the vertices have been adjusted to each other. Texels that their photographs do not show get the
average of all others, and texels that none shows are interpolated over the surface.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import GeometryError, ImageError
from ..files.scratch import Scratch
from ..geometry.edges import Edges, find_edges
from ..geometry.geometry_2d import signed_areas
from ..geometry.mesh import TriangleMesh, check_points, face_areas_and_normals
from ..imaging.images import dilate_in_place, sample_bilinear
from ..jobs.chunks import map_ordered
from ..jobs.progress import Progress, StageClock, Steps, subprogress
from .background import find_surface
from .color_correction import ColorCorrection, estimate_corrections
from .consistency import rate_photographs
from .face_visibility import order_by_corner, prepare_surface
from .hole_filling import HoleCounts, HoleFiller
from .labels import choose_labels
from .leveling import VertexLabels, find_vertex_labels, solve_corrections
from .observations import MAX_OBSERVATIONS, POINTS, Observations, observe, sample_surface
from .overlaps import check_overlaps
from .photographs import Photograph
from .settings import PhotosSettings
from .stages import CLASS_COLORS, classify_texels, draw_trust
from .surface import interpolate_colors
from .texel_colors import NO_PHOTOGRAPH, TexelPainter
from .texels import TexelMap, corner_normals, vertex_normals
from .views import View

FACE_SAMPLES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / np.array([[3], [6], [6], [6]])  # barycentric
EXPOSURE_POINTS = 20_000
GUTTER = 8  # texels around covered ones that get the mean of their neighbors


@dataclass(frozen=True)
class PhotoTexture:
    """The result of `merge`.

    colors: (H, W, 3) float32, sRGB-encoded, row 0 at the bottom. confidence: (H, W) float32, 0 to 1, the pixels per texel along one axis of
    the best photograph. source: (H, W) int16, the photograph with the largest weight, -1 for none. holes: (H, W) bool, covered texels that
    no photograph shows. color_corrections: K. labels: (T,) the photograph of each triangle, -1 for none.
    hole_counts: if they were restored. stages: pictures (H, W, 3) by name, if they were requested: `used NAME` for each photograph,
    `classes`, `photographed` and `interpolated`.
    """

    colors: np.ndarray
    confidence: np.ndarray
    source: np.ndarray
    holes: np.ndarray
    color_corrections: list[ColorCorrection]
    labels: np.ndarray
    hole_counts: HoleCounts | None
    seconds: dict[str, float]
    stages: dict[str, np.ndarray]

    @property
    def gains(self) -> np.ndarray:
        """(K, 3) gains of the photographs per channel."""
        return np.array([correction.gain for correction in self.color_corrections])


def merge(
    mesh: TriangleMesh,
    corner_uvs: np.ndarray,
    photographs: list[Photograph],
    settings: PhotosSettings,
    scratch: Scratch | None = None,
    *,
    keep_stages: bool = False,
) -> Steps[PhotoTexture]:
    """Merge `photographs` into a texture for `mesh` with UVs (T, 3, 2).

    The memory for it does not grow with the number of photographs: if they are many, their depths are in temporary files. Those of
    `scratch`, if it is given, may hold the photographs, too, each in the group of its index. keep_stages: draw pictures of the stages.

    Raises:
        ImageError: a photograph or mask does not have the size that its camera says, or there is none.
        GeometryError: no photograph shows the mesh, it has no area or is not finite, or the UV map overlaps itself or covers no
            texel.
        FileError: the disk of temporary files has too little space.
    """
    if not photographs:
        raise ImageError("There are no photographs; name a folder with the images that the cameras refer to.")
    for photograph in photographs:
        photograph.check()
    check_points(mesh.vertices, "mesh")
    if not np.isfinite(corner_uvs).all():
        raise GeometryError("The UV map has coordinates that are not finite; unwrap the mesh again.")
    check_overlaps(corner_uvs)
    if scratch is not None:
        return (yield from _merge(_Merger(mesh, corner_uvs, photographs, settings, scratch, keep_stages)))
    with Scratch() as own:
        return (yield from _merge(_Merger(mesh, corner_uvs, photographs, settings, own, keep_stages)))


def _merge(merger: "_Merger") -> Steps[PhotoTexture]:
    clock, settings = merger.clock, merger.settings
    yield from merger.look()
    yield Progress(0.2, "Comparing photographs")
    with clock.stage("exposure"):
        merger.compare()
    yield Progress(0.3, "Choosing photographs")
    with clock.stage("labels"):
        merger.label()
    yield Progress(0.33, "Adjusting colors")
    with clock.stage("leveling"):
        merger.level()
    yield from merger.fill_texels()
    yield Progress(0.9, "Filling holes")
    with clock.stage("holes"):
        merger.interpolate_holes()
    holes = None
    if settings.fill == "restore":
        with clock.stage("restore"):
            holes = yield from subprogress(merger.restore_holes(), 0.9, 1.0)
    with clock.stage("gutter"):
        return merger.finish(holes)


class _Merger:
    """The state between the steps of `merge`. The surface and the cameras are moved to the origin, where float32 is exact enough."""

    def __init__(
        self,
        mesh: TriangleMesh,
        corner_uvs: np.ndarray,
        photographs: list[Photograph],
        settings: PhotosSettings,
        scratch: Scratch,
        keep_stages: bool,
    ) -> None:
        self.keep_stages, self.stages = keep_stages, dict[str, np.ndarray]()
        self.settings, self.clock, self.corner_uvs, self.scratch = settings, StageClock(), corner_uvs, scratch
        with self.clock.stage("texels"):
            self.map = TexelMap(corner_uvs, settings.size)
            if not (self.map.triangles >= 0).any():
                raise GeometryError("The UV map covers no pixel of the texture; unwrap the mesh, or move its UVs into the range 0 to 1.")
        self.areas, _ = face_areas_and_normals(mesh.corners)
        if not self.areas.any():
            raise GeometryError("The faces of the mesh have no area; scale it up.")
        uv_areas = np.abs(signed_areas(corner_uvs.astype(np.float64))) * settings.size**2
        self.texel_areas = (self.areas / np.maximum(uv_areas, 1e-12)).astype(np.float32)  # of the surface, per triangle
        origin = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
        self.mesh = TriangleMesh(mesh.vertices - origin, mesh.triangles)
        self.photographs = [_move(photograph, origin) for photograph in photographs]
        self.normals = vertex_normals(self.mesh)
        self.corner_normals = corner_normals(self.mesh, self.normals)
        self.edges: Edges = find_edges(mesh.triangles, len(mesh.vertices))
        self.views: list[View] = []
        self.color_corrections = [ColorCorrection(photograph.camera.lens, np.ones(3)) for photograph in photographs]

    def look(self) -> Steps[None]:
        """Find out what each photograph shows."""
        for index, photograph in enumerate(self.photographs):
            yield Progress(0.2 * index / len(self.photographs), "Finding visible faces")
            with self.clock.stage("visibility"):
                view = View(photograph.camera, self.mesh, photograph.mask)
                shown = find_surface(photograph, self.mesh, self.settings)
                if shown is not None:
                    view.exclude(~shown)
                view.keep_in(self.scratch, index)
                self.views.append(view)
                self.photographs[index] = photograph.pack_in(self.scratch, index)
                self.scratch.release(index)

    def compare(self) -> None:
        """Estimate the gains of the photographs, and which of their parts show something else than the surface."""
        count = min(POINTS, MAX_OBSERVATIONS // len(self.photographs))
        points = sample_surface(self.mesh, self.corner_normals, self.areas, count)
        observed = observe(points, self.photographs, self.views, self.scratch)
        self._estimate_colors(observed, None)
        colors = np.empty_like(observed.colors)
        for index, correction in enumerate(self.color_corrections):
            own = observed.photographs == index
            colors[own] = correction.apply(observed.colors[own], observed.positions[own])
        sizes = [photograph.camera.lens.size for photograph in self.photographs]
        weights = np.empty(len(observed.points), np.float32)
        for index, (view, cells, size) in enumerate(zip(self.views, rate_photographs(observed, colors, sizes), sizes, strict=True)):
            view.apply_trust(cells)
            if self.keep_stages:
                self.stages[f"used {self.photographs[index].camera.name}"] = draw_trust(self.photographs[index], cells)
            own = observed.photographs == index
            weights[own] = sample_bilinear(cells[..., None], observed.positions[own] / np.array(size) * cells.shape[::-1])[:, 0]
            self.scratch.release(index)
        self._estimate_colors(observed, weights)

    def _estimate_colors(self, observed: Observations, weights: np.ndarray | None) -> None:
        if self.settings.exposure and len(self.photographs) > 1:
            few = slice(int(np.searchsorted(observed.points, EXPOSURE_POINTS)))
            part = Observations(*(values[few] for values in observed))
            lenses = [photograph.camera.lens for photograph in self.photographs]
            given = None if weights is None else weights[few]
            self.color_corrections = estimate_corrections(
                part, lenses, given, has_gamma=self.settings.gamma, has_vignetting=self.settings.vignetting
            )

    def label(self) -> None:
        """Choose the photograph of each triangle."""
        if self.settings.method == "best":
            self.labels = choose_labels(self._rate_faces(), self.edges)
        else:
            self.labels = np.full(len(self.mesh.triangles), NO_PHOTOGRAPH, np.int32)
        self.pairs: VertexLabels = find_vertex_labels(self.mesh.triangles, self.labels, self.areas, len(self.photographs))

    def _rate_faces(self) -> np.ndarray:
        """Return how well (T, K) each photograph shows each triangle, 0 if not all of it."""
        corners, normals = self.mesh.corners, self.corner_normals
        qualities = np.zeros((len(corners), len(self.views)), np.float32)
        for index, view in enumerate(self.views):
            counts = np.zeros(len(corners), np.int32)
            for barycentric in FACE_SAMPLES:
                seen = view.see(np.einsum("i,tic->tc", barycentric, corners), _unit(np.einsum("i,tic->tc", barycentric, normals)))
                counts[seen.indices] += 1
                qualities[seen.indices, index] += seen.weights / np.float32(len(FACE_SAMPLES))
            qualities[counts < len(FACE_SAMPLES), index] = 0.0
            self.scratch.release(index)
        return qualities

    def level(self) -> None:
        """Compute the colors of vertices and their corrections."""
        self.corrections = np.zeros((len(self.pairs.keys), 3), np.float32)
        colors, visible = np.zeros((len(self.pairs.keys), 3), np.float32), np.zeros(len(self.pairs.keys), bool)
        sums, weights = np.zeros((len(self.mesh.vertices), 3)), np.zeros(len(self.mesh.vertices))
        for index, view in enumerate(self.views):
            seen = view.see(self.mesh.vertices, self.normals)
            smooth = np.zeros((len(self.mesh.vertices), 3), np.float32)
            encoded = self.photographs[index].smoothed().sample(seen.positions)
            smooth[seen.indices] = self.color_corrections[index].apply(encoded, seen.positions)
            is_visible = np.zeros(len(smooth), bool)
            is_visible[seen.indices] = True
            sums[seen.indices] += seen.weights[:, None] * smooth[seen.indices]
            weights[seen.indices] += seen.weights
            own = np.flatnonzero(self.pairs.photographs == index)
            colors[own], visible[own] = smooth[self.pairs.vertices[own]], is_visible[self.pairs.vertices[own]]
            self.scratch.release(index)
        if self.settings.leveling and len(self.pairs.keys):
            self.corrections = solve_corrections(self.pairs, colors, visible, self.edges)
        self.vertex_colors = np.where(weights[:, None] > 0.0, sums / np.maximum(weights, 1e-30)[:, None], 0.0)
        self.bound = weights > 0.0
        shown = self.pairs.weights * visible
        totals = np.bincount(self.pairs.vertices, shown, len(self.mesh.vertices))
        has_label = totals > 0.5
        for channel in range(3):
            leveled = np.bincount(self.pairs.vertices, shown * (colors + self.corrections)[:, channel], len(self.mesh.vertices))
            self.vertex_colors[has_label, channel] = leveled[has_label] / totals[has_label]

    def fill_texels(self) -> Steps[None]:
        """Compute the texels, tile by tile."""
        count = self.settings.size**2
        with self.clock.stage("faces"):
            surface = prepare_surface(self.mesh, self.normals, self.corner_normals)
            is_cosine = self.settings.method == "paper"
            painter = TexelPainter(surface, self.photographs, self.views, self.color_corrections, self.scratch, is_cosine=is_cosine)
            if len(self.pairs.keys):
                painter.use_labels(self.pairs, self.corrections)
        self.colors, self.confidence = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
        self.source = np.full(count, NO_PHOTOGRAPH, np.int16)
        done, total = 0, int(np.count_nonzero(self.map.triangles >= 0))
        with self.clock.stage("colors"):
            for found in map_ordered(painter.paint, self.map.tiles()):
                texels = found.tile.texels
                self.colors[texels] = found.colors
                self.confidence[texels] = np.sqrt(np.minimum(found.resolution * self.texel_areas[found.tile.triangles], 1.0))
                self.source[texels] = found.source
                done += len(texels)
                yield Progress(0.35 + 0.55 * done / total, "Computing texels")

    def interpolate_holes(self) -> None:
        """Fill the texels that no photograph shows with colors interpolated over the surface, unless they stay transparent."""
        found = self.source != NO_PHOTOGRAPH
        if not found.any():
            raise GeometryError(_explain_blindness(self.mesh, self.photographs))
        if self.keep_stages:
            classes = classify_texels(self.map.triangles, found, self.mesh.triangles, self.bound)
            self._keep_stage("classes", CLASS_COLORS[classes])
            self._keep_stage("photographed", self.colors)
        if self.settings.fill != "none":
            colors, known = interpolate_colors(self.vertex_colors, self.bound, self.edges)
            colors[~known] = self.colors[found].mean(axis=0, dtype=np.float64)
            corner_colors = order_by_corner(colors[self.mesh.triangles])
            for tile in self.map.tiles():
                part = tile.select(np.flatnonzero(~found[tile.texels]))
                self.colors[part.texels] = part.interpolate(corner_colors)
            if self.keep_stages:
                self._keep_stage("interpolated", self.colors)
        np.clip(self.colors, 0.0, 1.0, out=self.colors)

    def _keep_stage(self, name: str, colors: np.ndarray) -> None:
        self.stages[name] = np.clip(colors, 0.0, 1.0).reshape(self.settings.size, self.settings.size, 3)

    def restore_holes(self) -> Steps[HoleCounts]:
        """Continue the texture into the holes."""
        return HoleFiller(self.mesh, self.edges, self.corner_uvs, self.map, self.colors, self.source != NO_PHOTOGRAPH).fill()

    def finish(self, holes: HoleCounts | None) -> PhotoTexture:
        """Fill what lies around the islands of the UV map, and return the result."""
        size = self.settings.size
        covered, found = self.map.triangles >= 0, self.source != NO_PHOTOGRAPH
        image, known = self.colors.reshape(size, size, 3), found if self.settings.fill == "none" else covered
        dilate_in_place(image, known.reshape(size, size), GUTTER)
        return PhotoTexture(
            colors=image,
            confidence=self.confidence.reshape(size, size),
            source=self.source.reshape(size, size),
            holes=(covered & ~found).reshape(size, size),
            color_corrections=self.color_corrections,
            labels=self.labels,
            hole_counts=holes,
            seconds=self.clock.seconds,
            stages=self.stages,
        )


def _move(photograph: Photograph, origin: np.ndarray) -> Photograph:
    """Return the photograph with a camera in coordinates relative to `origin` (3,)."""
    camera = photograph.camera
    return replace(photograph, camera=replace(camera, translation=camera.translation + camera.rotation @ origin))


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
