"""Refinement of cameras: each photograph is compared with what the others show of the surface, and its camera moves until both agree.

Matches of blocks (see `matching`) relate points on the surface to where the photograph shows them; robust least squares on pose, focal
length and the first radial coefficient fit the camera to them. A few rounds follow each other: a better camera finds better matches.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from ...errors import ImageError
from ...files.scratch import Scratch
from ...geometry.lenses import Lens, PhotoCamera
from ...geometry.mesh import TriangleMesh
from ...jobs.progress import Progress, Steps, subprogress
from ...messages import format_count
from ..photographs.color_correction import EXPOSURE_POINTS, estimate_gains
from ..photographs.observations import observe, sample_surface
from ..photographs.photograph import Photograph
from ..photographs.surface import Surface
from ..photographs.views import View
from .matching import GrayPhotograph, Matches, make_grays, match_others

ROUNDS = 3
MIN_MATCHES = 12
MAX_LOST = 0.3  # A camera that loses a larger fraction of its matches has not become better.
MIN_GAIN = 0.05  # relative decrease of the mean displacement
SIGMA_ROTATION, SIGMA_SHIFT = 0.1, 0.1  # expected errors, in radians and relative to the distance of the surface
SIGMA_FOCAL, SIGMA_RADIAL = 0.05, 0.05  # expected errors in the logarithm of the focal length, and in the radial coefficient
MIN_SCALE, MAX_SCALE = 0.2, 3.0  # pixels: errors of matches from which on they count less
WITHOUT_RADIAL = ("FOV", "INVERSE_RADIAL")  # lens models whose first coefficient is something else


@dataclass(frozen=True)
class Refinement:
    """What became of a camera.

    Attributes:
        camera: the refined one, or the given one if there is a problem.
        before, after: mean displacements in pixels to the other photographs.
        matches: the number of blocks at the end.
        problem: a sentence, empty if there is none.
    """

    camera: PhotoCamera
    before: float
    after: float
    matches: int
    problem: str = ""


def refine(
    mesh: TriangleMesh, photographs: list[Photograph], chosen: Sequence[int], scratch: Scratch, *, has_free_lens: Sequence[bool]
) -> Steps[list[Refinement]]:
    """Refine the cameras of the photographs with the indices `chosen` against all others.

    Args:
        mesh: in world space.
        photographs: all of them, with cameras that see the mesh. Several chosen ones are refined in turns, with those before them refined.
        scratch: keeps the images, each in the group of its index.
        has_free_lens: for each of `chosen`, whether its focal length and first radial coefficient change, too.

    Raises:
        GeometryError: the mesh is not finite or has no area.
        ImageError: there is only one photograph, or one does not have the size that its camera says.
    """
    if len(photographs) < 2:
        raise ImageError("There is only one photograph; refinement compares photographs with each other, so add cameras of others.")
    for photograph in photographs:
        photograph.check()
    surface = Surface.around_origin(mesh)
    surface.check_areas()
    grays = yield from subprogress(_prepare(surface, photographs, scratch), 0.0, 0.3)
    given, start, total = list(grays), [], (ROUNDS + 2) * len(chosen)
    for index in chosen:
        yield Progress(0.3 + 0.7 * len(start) / total, "Matching photographs")
        start.append(match_others(grays, index, surface, scratch))
    for turn in range(ROUNDS):
        for place, (index, is_free) in enumerate(zip(chosen, has_free_lens, strict=True)):
            yield Progress(0.3 + 0.7 * ((turn + 1) * len(chosen) + place) / total, "Refining cameras")
            matches = start[0] if turn == 0 and place == 0 else match_others(grays, index, surface, scratch)
            if len(matches.points) >= MIN_MATCHES:
                camera = fit_camera(grays[index].view.camera, matches, has_free_lens=is_free)
                grays[index] = replace(grays[index], view=View(camera, surface.mesh, grays[index].mask))
    results = []
    for place, (index, matches) in enumerate(zip(chosen, start, strict=True)):
        yield Progress(0.3 + 0.7 * ((ROUNDS + 1) * len(chosen) + place) / total, "Matching photographs")
        end = match_others(grays, index, surface, scratch)
        result = _judge(given[index].view.camera, grays[index].view.camera, matches, end)
        results.append(replace(result, camera=result.camera.relative_to(-surface.origin)))
    return results


def _prepare(surface: Surface, photographs: list[Photograph], scratch: Scratch) -> Steps[list[GrayPhotograph]]:
    """Find out what the photographs show, and adjust their exposures."""
    views = []
    for index, photograph in enumerate(photographs):
        yield Progress(0.7 * index / len(photographs), "Finding visible faces")
        views.append(View(photograph.camera.relative_to(surface.origin), surface.mesh, photograph.mask))
        views[-1].keep_in(scratch, index)
        scratch.release(index)
    yield Progress(0.7, "Comparing photographs")
    observed = yield from subprogress(observe(sample_surface(surface, EXPOSURE_POINTS), photographs, views, scratch), 0.7, 0.75)
    return (yield from subprogress(make_grays(photographs, views, estimate_gains(observed, len(photographs)), scratch), 0.75, 1.0))


def _judge(given: PhotoCamera, found: PhotoCamera, start: Matches, end: Matches) -> Refinement:
    """Return the result for a camera from the matches of its photograph before and after."""
    before, after = (matches.mean_displacement if len(matches.points) else float("nan") for matches in (start, end))
    if len(start.points) < MIN_MATCHES:
        problem = (
            f'"{given.name}" has {format_count(len(start.points), "part")} of the {MIN_MATCHES} that are needed whose details the other '
            "photographs show, too; it was left as it is."
        )
    elif len(end.points) < (1.0 - MAX_LOST) * len(start.points) or not after <= (1.0 - MIN_GAIN) * before:
        problem = (
            f'"{given.name}" does not fit to the other photographs any better ({before:.2f} pixels before, {after:.2f} after); it was left '
            "as it is."
        )
    else:
        return Refinement(found, before, after, len(end.points))
    return Refinement(given, before, before, len(start.points), problem)


def fit_camera(camera: PhotoCamera, matches: Matches, *, has_free_lens: bool) -> PhotoCamera:
    """Return the camera that projects the points of `matches` to where the photograph shows them, as well as it can.

    has_free_lens: whether focal length and, if the lens has one, the first radial coefficient change, too.
    """
    local = matches.points @ camera.rotation.T + camera.translation
    distance = float(np.median(local[:, 2]))
    targets = matches.positions + matches.displacements
    weights = np.sqrt(matches.confidences)[:, None]
    sigmas = np.array([SIGMA_ROTATION] * 3 + [SIGMA_SHIFT] * 3 + ([SIGMA_FOCAL, SIGMA_RADIAL] if has_free_lens else []))

    def project(parameters: np.ndarray) -> np.ndarray:
        moved = Rotation.from_rotvec(parameters[:3]).apply(local) + distance * parameters[3:6]
        positions, is_valid = _change_lens(camera.lens, parameters[6:]).project(moved)
        return np.where(is_valid[:, None], positions, matches.positions)

    def errors(parameters: np.ndarray, scale: float) -> np.ndarray:
        distances = project(parameters) - targets
        robust = np.sqrt(np.log1p(np.square(distances / scale).sum(axis=1, keepdims=True)))  # Cauchy, of the length
        directions = distances / np.maximum(np.linalg.norm(distances, axis=1, keepdims=True), 1e-12)
        return np.concatenate([(weights * robust * directions).ravel(), parameters / sigmas])

    parameters, scale = np.zeros(len(sigmas)), MAX_SCALE
    for _ in range(3):
        parameters = least_squares(errors, parameters, args=(scale,), x_scale=sigmas, max_nfev=50).x
        typical = 1.4826 * float(np.median(np.linalg.norm(project(parameters) - targets, axis=1)))
        scale = float(np.clip(typical, MIN_SCALE, MAX_SCALE))
    rotation = Rotation.from_rotvec(parameters[:3]).as_matrix()
    lens = _change_lens(camera.lens, parameters[6:])
    return PhotoCamera(camera.name, lens, rotation @ camera.rotation, rotation @ camera.translation + distance * parameters[3:6])


def _change_lens(lens: Lens, parameters: np.ndarray) -> Lens:
    """Return the lens after the logarithm of its focal lengths and its first radial coefficient have changed by `parameters` (2,), if
    there are any."""
    if not len(parameters):
        return lens
    factor, coefficients = float(np.exp(parameters[0])), lens.coefficients
    if coefficients and lens.model not in WITHOUT_RADIAL:
        coefficients = (coefficients[0] + float(parameters[1]), *coefficients[1:])
    return replace(lens, focal=(lens.focal[0] * factor, lens.focal[1] * factor), coefficients=coefficients)
