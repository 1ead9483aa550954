"""One texture from several photographs of a surface (Textures Revisited, section 4).

Photographs are adjusted to each other, and their parts that show something else than the surface are left out. Then each texel gets the
weighted average of the photographs that show it, or each triangle is textured from the photograph that shows it best and the borders
between such regions are blended. Details are sharpened by comparison with the photographs, and texels that none shows are filled.
"""

from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..errors import GeometryError, ImageError
from ..files.scratch import Scratch
from ..geometry.mesh import TriangleMesh
from ..geometry.transforms import signed_areas
from ..imaging.images import dilate_in_place, sample_bilinear
from ..jobs.chunks import map_ordered
from ..jobs.progress import Progress, StageClock, Steps, subprogress
from .photo_texture import PhotoTexture
from .photographs.background import find_surface
from .photographs.color_correction import EXPOSURE_POINTS, ColorCorrection, estimate_corrections
from .photographs.consistency import rate_photographs
from .photographs.observations import MAX_OBSERVATIONS, POINTS, Observations, observe, sample_surface
from .photographs.photograph import Photograph
from .photographs.surface import Surface
from .photographs.views import View
from .previews import CLASS_COLORS, classify_texels, draw_trust
from .registration.alignment import align
from .settings import PhotosSettings
from .texels.blending import BlendedSurface, blend_gradients, blend_labels, blend_masks, blend_windows, shrink_masks
from .texels.face_visibility import VISIBLE, ShownSurface, find_visible_faces, order_by_corner
from .texels.hole_filling import HoleCounts, HoleFiller
from .texels.hole_interpolation import interpolate_colors, interpolate_holes
from .texels.pages import check_overlaps, check_texel_count
from .texels.painter import NO_PHOTOGRAPH, TexelPainter
from .texels.regions import VertexLabels, choose_labels, color_vertices, find_vertex_labels, rate_faces
from .texels.sharpening import estimate_noise, find_residuals, sharpen_colors
from .texels.texel_map import TexelMap

GUTTER = 8  # texels around covered ones that get the mean of their neighbors
FACES_END, RESIDUALS_END = 0.05, 0.25  # fractions of the stages that compute and that sharpen texels


@dataclass(frozen=True)
class StageEnds:
    """The fractions of the progress at which the stages of `merge` end, by the time that they take."""

    visibility: float = 0.03
    exposure: float = 0.09
    alignment: float = 0.11
    labels: float = 0.13
    texels: float = 0.5
    sharpening: float = 0.93


STAGES = StageEnds()


def merge(
    mesh: TriangleMesh,
    corner_uvs: np.ndarray,
    photographs: list[Photograph],
    settings: PhotosSettings,
    scratch: Scratch | None = None,
    *,
    pages: np.ndarray | None = None,
    keep_stages: bool = False,
) -> Steps[PhotoTexture]:
    """Merge `photographs` into a texture for `mesh` with UVs (T, 3, 2) in the `pages` (T,) of its triangles (see `pages`).

    The memory for it does not grow with the number of photographs: if they are many, their depths are in temporary files. Those of
    `scratch`, if it is given, may hold the photographs, too, each in the group of its index. keep_stages: draw pictures of the stages.

    Raises:
        ImageError: a photograph or mask does not have the size that its camera says, or there is none.
        GeometryError: no photograph shows the mesh, it has no area or is not finite, or the UV map overlaps itself, covers no texel, or
            needs too many.
        FileError: the disk of temporary files has too little space.
    """
    if not photographs:
        raise ImageError("There are no photographs; name a folder with the images that the cameras refer to.")
    for photograph in photographs:
        photograph.check()
    surface = Surface.around_origin(mesh)
    if not np.isfinite(corner_uvs).all():
        raise GeometryError("The UV map has coordinates that are not finite; unwrap the mesh again.")
    check_overlaps(corner_uvs, pages)
    check_texel_count(pages, settings.size)
    with Scratch() if scratch is None else nullcontext(scratch) as used:
        return (yield from _merge(_Merger(surface, corner_uvs, pages, photographs, settings, used, keep_stages)))


def _merge(merger: "_Merger") -> Steps[PhotoTexture]:
    clock, settings = merger.clock, merger.settings
    yield from subprogress(merger.look(), 0.0, STAGES.visibility)
    with clock.stage("exposure"):
        yield from subprogress(merger.compare(), STAGES.visibility, STAGES.exposure)
    if settings.alignment:
        with clock.stage("alignment"):
            yield from subprogress(merger.align(), STAGES.exposure, STAGES.alignment)
    with clock.stage("labels"):
        yield from subprogress(merger.label(), STAGES.alignment, STAGES.labels)
    yield from subprogress(merger.fill_texels(), STAGES.labels, STAGES.texels)
    if settings.sharpen and settings.method != "paper":
        yield from subprogress(merger.sharpen(), STAGES.texels, STAGES.sharpening)
    yield Progress(STAGES.sharpening, "Filling holes")
    with clock.stage("holes"):
        merger.interpolate_holes()
    with clock.stage("blending"):
        yield from subprogress(merger.blend(), STAGES.sharpening, 1.0)
    holes = None
    if settings.fill == "restore":
        filler = HoleFiller(merger.surface, merger.map, merger.colors, merger.source != NO_PHOTOGRAPH)
        with clock.stage("restore"):
            holes = yield from subprogress(filler.fill(), STAGES.sharpening, 1.0)
    with clock.stage("gutter"):
        return merger.finish(holes)


class _Merger:
    """The state between the steps of `merge`. The cameras are moved to the origin with the surface."""

    def __init__(
        self,
        surface: Surface,
        corner_uvs: np.ndarray,
        pages: np.ndarray | None,
        photographs: list[Photograph],
        settings: PhotosSettings,
        scratch: Scratch,
        keep_stages: bool,
    ) -> None:
        self.keep_stages, self.stages = keep_stages, dict[str, np.ndarray]()
        self.settings, self.clock, self.scratch = settings, StageClock(), scratch
        with self.clock.stage("texels"):
            self.map = TexelMap(corner_uvs, settings.size, pages)
            if not (self.map.triangles >= 0).any():
                raise GeometryError("The UV map covers no pixel of the texture; unwrap the mesh, or move its UVs into the range 0 to 1.")
        surface.check_areas()
        uv_areas = np.abs(signed_areas(corner_uvs.astype(np.float64))) * settings.size**2
        self.surface, self.mesh = surface, surface.mesh
        self.texel_areas = (surface.areas / np.maximum(uv_areas, 1e-12)).astype(np.float32)  # per triangle, on the surface
        self.photographs = [replace(photograph, camera=photograph.camera.relative_to(surface.origin)) for photograph in photographs]
        self.views: list[View] = []
        self.color_corrections = [ColorCorrection(photograph.camera.lens, np.ones(3)) for photograph in photographs]

    def look(self) -> Steps[None]:
        """Find out what each photograph shows."""
        yield Progress(0.0, "Finding visible faces")
        with self.clock.stage("visibility"):
            for index, view in enumerate(map_ordered(self._look_from, list(self.photographs))):
                view.keep_in(self.scratch, index)
                self.views.append(view)
                self.photographs[index] = self.photographs[index].pack_in(self.scratch, index)
                self.scratch.release(index)
                yield Progress((index + 1) / len(self.photographs), "Finding visible faces")

    def _look_from(self, photograph: Photograph) -> View:
        view = View(photograph.camera, self.mesh, photograph.mask)
        shown = find_surface(photograph, self.mesh, self.settings)
        if shown is not None:
            view.exclude(~shown)
        return view

    def compare(self) -> Steps[None]:
        """Estimate the gains of the photographs, and which of their parts show something else than the surface."""
        count = min(POINTS, MAX_OBSERVATIONS // len(self.photographs))
        seen = observe(sample_surface(self.surface, count), self.photographs, self.views, self.scratch)
        observed = yield from subprogress(seen, 0.0, 0.5)
        self._estimate_colors(observed, None)
        colors = np.empty_like(observed.colors)
        for index, correction in enumerate(self.color_corrections):
            own = observed.photographs == index
            colors[own] = correction.apply(observed.colors[own], observed.positions[own])
        sizes = [photograph.camera.lens.size for photograph in self.photographs]
        weights = np.empty(len(observed.points), np.float32)
        trust = yield from subprogress(rate_photographs(observed, colors, sizes), 0.5, 1.0)
        for _ in map_ordered(lambda pair: pair[0].apply_trust(pair[1]), zip(self.views, trust, strict=True)):
            pass
        for index, (cells, size) in enumerate(zip(trust, sizes, strict=True)):
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

    def align(self) -> Steps[None]:
        """Make the photographs show the surface at the same places."""
        gains = [each.gain for each in self.color_corrections]
        self.photographs = yield from align(self.photographs, self.views, gains, self.surface, self.scratch)

    def label(self) -> Steps[None]:
        """Choose the photograph of each triangle, and compute the colors of vertices."""
        self.labels = np.full(len(self.mesh.triangles), NO_PHOTOGRAPH, np.int32)
        if self.settings.method == "best":
            qualities = yield from subprogress(rate_faces(self.surface, self.views, self.scratch), 0.0, 0.4)
            self.labels = yield from subprogress(choose_labels(qualities, self.surface.edges), 0.4, 0.6)
        self.pairs: VertexLabels = find_vertex_labels(self.mesh.triangles, self.labels, self.surface.areas, len(self.photographs))
        colors = color_vertices(
            self.surface,
            self.pairs,
            self.photographs,
            self.views,
            self.color_corrections,
            self.scratch,
            is_leveled=self.settings.blending == "level",
        )
        self.vertex_colors = yield from subprogress(colors, 0.6, 1.0)

    def fill_texels(self) -> Steps[None]:
        """Compute the texels, tile by tile."""
        count = len(self.map.triangles)
        with self.clock.stage("faces"):
            shown = ShownSurface(self.surface)
            is_cosine = self.settings.method == "paper"
            faces = yield from subprogress(find_visible_faces(self.views, shown, self.scratch, is_cosine=is_cosine), 0.0, FACES_END)
            self.painter = TexelPainter(
                shown,
                faces,
                self.photographs,
                self.color_corrections,
                self.scratch,
                reduces_highlights=self.settings.reduce_highlights,
            )
            if len(self.pairs.keys):
                self.painter.use_labels(self.pairs, self.vertex_colors.corrections)
        self.colors, self.confidence = np.zeros((count, 3), np.float32), np.zeros(count, np.float32)
        self.source = np.full(count, NO_PHOTOGRAPH, np.int16)
        done, total = 0, int(np.count_nonzero(self.map.triangles >= 0))
        with self.clock.stage("colors"):
            for found in map_ordered(self.painter.paint, self.map.tiles()):
                texels = found.tile.texels
                self.colors[texels] = found.colors
                self.confidence[texels] = np.sqrt(np.minimum(found.resolution * self.texel_areas[found.tile.triangles], 1.0))
                self.source[texels] = found.source
                done += len(texels)
                yield Progress(FACES_END + (1.0 - FACES_END) * done / total, "Computing texels")

    def sharpen(self) -> Steps[None]:
        """Bring back the detail that resampling has blurred."""
        size, found = self.settings.size, self.source != NO_PHOTOGRAPH
        with self.clock.stage("residuals"):
            texture = np.concatenate([self.colors, np.ones((len(found), 1), np.float32)], axis=1)
            texture[~found] = 0.0
            texture = texture.reshape(-1, size, 4)
            corners = self.map.stacked_corners
            noise = estimate_noise(self.photographs)
            residuals = yield from subprogress(
                find_residuals(self.painter, self.photographs, self.views, self.mesh, corners, texture, self.scratch), 0.0, RESIDUALS_END
            )
        done, total = 0, int(np.count_nonzero(self.map.triangles >= 0))
        with self.clock.stage("sharpen"):
            for change in map_ordered(self.painter.with_photographs(residuals).paint, self.map.tiles()):
                texels = change.tile.texels
                self.colors[texels] = sharpen_colors(self.colors[texels], change.colors, noise)
                done += len(texels)
                yield Progress(RESIDUALS_END + (1.0 - RESIDUALS_END) * done / total, "Sharpening")

    def interpolate_holes(self) -> None:
        """Fill the texels that no photograph shows with colors interpolated over the surface, unless they stay transparent."""
        found = self.source != NO_PHOTOGRAPH
        if not found.any():
            raise GeometryError(_explain_blindness(self.mesh, self.photographs, self.settings.method == "paper"))
        if self.keep_stages:
            classes = classify_texels(self.map.triangles, found, self.mesh.triangles, self.vertex_colors.bound)
            self._keep_stage("classes", CLASS_COLORS[classes])
            self._keep_stage("photographed", self.colors)
        if self.settings.fill != "none":
            colors, known = interpolate_colors(self.vertex_colors.colors, self.vertex_colors.bound, self.surface.edges)
            colors[~known] = self.colors[found].mean(axis=0, dtype=np.float64)
            interpolate_holes(self.map, self.colors, found, order_by_corner(colors[self.mesh.triangles]))
            if self.keep_stages:
                self._keep_stage("interpolated", self.colors)
        np.clip(self.colors, 0.0, 1.0, out=self.colors)

    def blend(self) -> Steps[None]:
        """Blend the seams between photographs in windows, by the methods that do so."""
        method = "masks" if self.settings.method == "paper" else self.settings.blending if self.settings.method == "best" else "none"
        if method in ("none", "level"):
            return
        known = self.source != NO_PHOTOGRAPH if self.settings.fill == "none" else self.map.triangles >= 0
        blended = BlendedSurface(self.painter, self.map, self.surface, self.colors, known)
        if method == "masks":
            masks = np.stack([faces.status == VISIBLE for faces in self.painter.faces])
            blend = partial(blend_masks, blended, shrink_masks(masks, self.mesh.triangles, len(self.mesh.vertices)))
        else:
            blend = partial(blend_labels if method == "spline" else blend_gradients, blended, self.source)
        self.colors = yield from blend_windows(blended, blend)
        np.clip(self.colors, 0.0, 1.0, out=self.colors)

    def _keep_stage(self, name: str, colors: np.ndarray) -> None:
        self.stages[name] = np.clip(colors, 0.0, 1.0).reshape(-1, self.settings.size, 3)

    def finish(self, holes: HoleCounts | None) -> PhotoTexture:
        """Fill what lies around the islands of the UV map, and return the result."""
        size = self.settings.size
        covered, found = self.map.triangles >= 0, self.source != NO_PHOTOGRAPH
        known = found if self.settings.fill == "none" else covered
        for page_colors, page_known in zip(self.colors.reshape(-1, size, size, 3), known.reshape(-1, size, size), strict=True):
            dilate_in_place(page_colors, page_known, GUTTER)
        return PhotoTexture(
            colors=self.colors.reshape(-1, size, 3),
            confidence=self.confidence.reshape(-1, size),
            source=self.source.reshape(-1, size),
            holes=(covered & ~found).reshape(-1, size),
            color_corrections=self.color_corrections,
            labels=self.labels,
            hole_counts=holes,
            seconds=self.clock.seconds,
            stages=self.stages,
        )


def _explain_blindness(mesh: TriangleMesh, photographs: list[Photograph], is_paper: bool) -> str:
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
    if is_paper:
        return (
            "No photograph shows a triangle wholly, without the silhouette of the mesh; subdivide the mesh, or choose another method than "
            "Paper."
        )
    return (
        "No photograph shows the front of a face; flip the normals of the mesh, check the masks of the photographs, or export cameras and "
        "mesh with the same coordinate system."
    )
