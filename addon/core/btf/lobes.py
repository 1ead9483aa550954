"""What a formula knows of a texel's colours: a diffuse and a glossy lobe, fitted to what was captured.

A highlight is narrower than the grid of a bake and stands elsewhere for every texel, so few components cannot hold it: it comes out as a
veil over everything. So lobes are fitted first and only the rest is factorised. Lambert for the diffuse lobe; GGX with Smith's shadowing
for the glossy one (Walter et al. 2007), whose Fresnel term, after Schlick, is two numbers of their own: straight on and at the rim.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..direction_grids import DirectionGrid
from ..parallel import mapped, slices
from ..progress import Progress, Steps, scaled
from .alternation import ViewData, by_light
from .broad_suns import BroadSuns
from .relief import Relief
from .shadows import Shadows

LEAST_ROUGHNESS = 0.05
LEAST_FACING = 1e-3  # cosine
RIM_FACING = 0.2  # cosine at which the rim is as bright as it gets: beyond, quads show what a smooth surface turns away
DIFFUSE, SPECULAR, RIM, EVEN, DOME_EVEN = range(5)  # columns of a fit; the last two take up what no lobe is, and are dropped
KEPT = 3
LARGEST = np.array([1.0, 1.0, 1.0, 10.0, 10.0])
WHITE = 1.0  # radiance that counts as much as any above it
QUAD_PRIOR, LEVEL_PRIOR = 0.1, 1.0  # of what a texel tells in the mean: how much its quad counts for it, and the level for the quad
ROUNDS, SETTLED = 60, 1e-6  # of coordinate descent, and the move of a number at which it may end
FACTORS = (0.5, 0.7, 1.0, 1.4)  # of the roughness in the maps: a coat is smoother, bumps and large texels are rougher
SAMPLE = 2000  # texels by which the factor is chosen
ALL = slice(None)
CHUNK = 1024  # texels at once: what they need in between stays in the processor's cache


@dataclass(frozen=True)
class Grazing:
    """How much brighter a lobe is the more it is turned away: strength * (1 - cosine)^power, up to where the cosine is RIM_FACING."""

    strength: float
    power: float

    def __call__(self, cosines: np.ndarray) -> np.ndarray:
        """At `cosines` between normal and view."""
        return self.strength * (1.0 - np.clip(cosines, RIM_FACING, 1.0)) ** self.power


SCHLICK = Grazing(1.0, 5.0)


@dataclass(frozen=True)
class Surface:
    """What the plain maps say of N texels: normals (N, 3) unit, in the object's frame; roughness (N,), as in a Principled BSDF; where
    normals are looked up from aslant, None for where the texel is."""

    normals: np.ndarray
    roughness: np.ndarray
    relief: Relief | None = None

    def towards(self, view: np.ndarray, rows: slice | np.ndarray = ALL) -> np.ndarray:
        """The normals (M, 3) of `rows` as a viewer in the unit direction `view` (3,) sees them: on its side."""
        normals = self.normals[rows] if self.relief is None else self.relief.seen(view, rows)
        return normals * np.where(normals @ view < 0.0, -1.0, 1.0)[:, None]


@dataclass(frozen=True)
class Lobes:
    """Lobes of N texels. diffuse (N, 3): albedo. specular (N, 3): what the glossy lobe reflects seen straight on; rim (N,): so much more
    at grazing angles. All float32, 0..1. shadows: where suns do not reach the lobes; None where they always do. openness (N,): how much of
    a dome comes back from them, light from other surfaces counted in; None for all of it. grazing: of `rim` under a dome."""

    surface: Surface
    diffuse: np.ndarray
    specular: np.ndarray
    rim: np.ndarray
    shadows: Shadows | None = None
    openness: np.ndarray | None = None
    grazing: Grazing = SCHLICK

    @property
    def bytes(self) -> int:
        """What they take as half floats, roughness counted in; the normals are those of the plain maps."""
        of_maps = self.diffuse.size + self.specular.size + 2 * len(self.rim) + (0 if self.openness is None else len(self.openness))
        return 2 * of_maps + (0 if self.shadows is None else self.shadows.bytes)

    def of_grid(self, view: np.ndarray, suns: BroadSuns, rows: np.ndarray) -> np.ndarray:
        """Radiance (M, L + 1, 3) of `rows` (M,) from the unit direction `view`, under each of the L broad suns and, last, the dome.

        How much of the suns reaches the texels, they say.
        """
        made = np.empty((len(rows), len(suns.directions) + 1, 3), np.float32)
        for start in range(0, len(rows), CHUNK):
            some = rows[start : start + CHUNK]
            made[start : start + CHUNK, :-1] = features(self.surface, view, suns, some, KEPT)[:, :-1] @ self._parts(some)
            made[start : start + CHUNK, -1] = self.of_dome(view, some)
        return made

    def under(self, lights: np.ndarray, view: np.ndarray, suns: BroadSuns, wanted: np.ndarray) -> np.ndarray:
        """Radiance (W, M * 3) float16 of the texels `wanted` (W,) from `view` under sums `lights` (L + 1, M) of the broad suns and the
        dome."""
        made = np.empty((len(wanted), lights.shape[1] * 3), np.float16)
        of_suns, of_dome = lights[:-1].T.astype(np.float32), lights[-1].astype(np.float32)
        for start in range(0, len(wanted), CHUNK):
            rows = wanted[start : start + CHUNK]
            shown = np.matmul(of_suns, features(self.surface, view, suns, rows, KEPT)[:, :-1]) @ self._parts(rows)
            made[start : start + CHUNK] = (shown + of_dome[:, None] * self.of_dome(view, rows)[:, None]).reshape(len(rows), -1)
        return made

    def _parts(self, rows: np.ndarray) -> np.ndarray:
        """What every feature counts (M, KEPT, 3)."""
        return np.stack([self.diffuse[rows], self.specular[rows], np.repeat(self.rim[rows, None], 3, axis=1)], axis=1)

    def of_suns(self, view: np.ndarray, lights: np.ndarray, rows: slice = ALL) -> np.ndarray:
        """Radiance (M, L, 3) of `rows` from `view` (3,) under suns like points of unit irradiance from `lights` (L, 3), unit directions."""
        normals = self.surface.towards(view, rows)
        straight, grazing = glossy_lobe(normals, view, lights, self.surface.roughness[rows])
        matt = np.maximum(normals @ lights.T, 0.0) / np.pi
        bright = matt[..., None] * self.diffuse[rows, None] + straight[..., None] * self.specular[rows, None]
        bright += (grazing * self.rim[rows, None])[..., None]
        return bright if self.shadows is None else bright * self.shadows.reached(lights, rows)[..., None]

    def of_dome(self, view: np.ndarray, rows: slice | np.ndarray = ALL) -> np.ndarray:
        """Radiance (M, 3) of `rows` from `view` under a dome of radiance 1."""
        grazing = self.grazing(self.surface.towards(view, rows) @ view)
        bright = self.diffuse[rows] + self.specular[rows] + (grazing * self.rim[rows])[:, None]
        return bright if self.openness is None else bright * self.openness[rows, None]


def normals_of(pixels: np.ndarray) -> np.ndarray:
    """The unit normals (N, 3) that pixels (N, 3 or more) of a normal map stand for; up where a pixel stands for none."""
    normals = 2.0 * pixels[:, :3] - 1.0
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 1e-6, normals / np.maximum(lengths, 1e-6), np.float32([0.0, 0.0, 1.0]))


def glossy_lobe(normals: np.ndarray, view: np.ndarray, lights: np.ndarray, roughness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """GGX times cosine (N, L) for unit irradiance, and the same times Schlick's (1 - h v)^5, which ends at RIM_FACING.

    normals (N, 3) on the side of `view` (3,); lights (L, 3); all unit. roughness (N,): its square is GGX's alpha.
    """
    from_view, from_light = _facing(normals, view)[:, None], np.maximum(normals @ lights.T, 0.0)
    half = lights + view
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-6)
    alpha = np.maximum(roughness, LEAST_ROUGHNESS)[:, None] ** 4
    spread = (normals @ half.T) ** 2 * (alpha - 1.0) + 1.0
    masked = from_light * np.sqrt(from_view**2 * (1.0 - alpha) + alpha) + from_view * np.sqrt(from_light**2 * (1.0 - alpha) + alpha)
    straight = 0.5 * alpha * from_light / (np.pi * spread**2 * np.maximum(masked, 1e-6))
    return straight, straight * SCHLICK(half @ view)


def features(surface: Surface, view: np.ndarray, suns: BroadSuns, rows: np.ndarray, count: int = len(LARGEST)) -> np.ndarray:
    """What each lobe of strength 1 makes (M, L + 1, count) float32 of `rows`, see DIFFUSE and so on; of a dome a first guess."""
    normals = surface.towards(view, rows)
    made = np.zeros((len(rows), len(suns.directions) + 1, count), np.float32)
    made[:, :-1, DIFFUSE] = suns.cosine(normals)
    made[:, :-1, SPECULAR] = suns.mirrored(normals, view, np.maximum(surface.roughness[rows], LEAST_ROUGHNESS))
    made[:, -1, [DIFFUSE, SPECULAR]] = 1.0
    cosines = normals @ view
    made[..., RIM] = made[..., SPECULAR] * SCHLICK(cosines)[:, None]
    if suns.reached is not None:
        made[:, :-1, :KEPT] *= suns.reached[rows, :, None]
    if suns.openness is not None:
        made[:, -1, :KEPT] *= suns.openness[rows, None]
    if count > KEPT:
        made[:, :-1, EVEN] = made[:, -1, DOME_EVEN] = 1.0
    return made


def fit_lobes(
    views: Sequence[ViewData],
    surface: Surface,
    quads: np.ndarray,
    grid: DirectionGrid,
    suns: BroadSuns,
    weights: np.ndarray,
    light_weights: np.ndarray,
) -> Steps[Lobes]:
    """Lobes that come nearest to what `views` saw, least squares with every number within 0 and 1.

    Texels that few views saw take after their quad, and quads after the level. The roughness is that of `surface` times the one of FACTORS
    that suits most texels best.

    Args:
        views: columns light by light, the dome last, three channels each. grid: their directions.
        quads: (N,) the quad of each texel. weights: (V, N), what each texel counts from each view. light_weights: (L + 1,).
    """
    count = len(quads)
    sample = np.arange(0, count, max(1, count // SAMPLE))
    tried = [replace(surface, roughness=factor * surface.roughness) for factor in FACTORS]
    trials = [_Equations(one, sample) for one in tried]
    yield from scaled(_taken(trials, views, grid, suns, weights, light_weights), 0.0, 0.3)
    errors = [equations.error(equations.solved(quads[sample])) for equations in trials]
    best = tried[int(np.argmin(errors))]
    equations = _Equations(best, np.arange(count))
    yield from scaled(_taken([equations], views, grid, suns, weights, light_weights), 0.3, 1.0)
    found = equations.solved(quads).astype(np.float32)
    return Lobes(best, found[:, DIFFUSE], found[:, SPECULAR], found[:, RIM].mean(axis=1))


def _taken(
    trials: Sequence["_Equations"],
    views: Sequence[ViewData],
    grid: DirectionGrid,
    suns: BroadSuns,
    weights: np.ndarray,
    light_weights: np.ndarray,
) -> Steps[None]:
    """Let all `trials` know what `views` saw; see `fit_lobes`."""

    def terms(place: int) -> list[_Terms]:
        index, values = views[place].read()
        return [each.terms(grid.directions[place], suns, index, values, weights[place], light_weights) for each in trials]

    suns.prepare()
    for place, found in enumerate(mapped(terms, range(len(views)))):
        yield Progress(place / len(views), "Fitting the gloss")
        for equations, own in zip(trials, found, strict=True):
            equations.add(own)


@dataclass(frozen=True)
class _Terms:
    """What one view adds to the equations of the texels at `places` (M,) int: left (M, K, K), right (M, K, 3), both float32; and to the sum
    of the squares of all that was seen."""

    places: np.ndarray
    left: np.ndarray
    right: np.ndarray
    square: float


class _Equations:
    """Normal equations of some texels `rows` of a surface, summed up view by view."""

    def __init__(self, surface: Surface, rows: np.ndarray) -> None:
        size = len(LARGEST)
        self._surface, self._places = surface, np.full(len(surface.roughness), -1)
        self._places[rows] = np.arange(len(rows))
        self._left, self._right = np.zeros((len(rows), size, size)), np.zeros((len(rows), size, 3))
        self._square = 0.0

    def terms(
        self, view: np.ndarray, suns: BroadSuns, index: np.ndarray, values: np.ndarray, weights: np.ndarray, light_weights: np.ndarray
    ) -> _Terms:
        """Those of what was seen from the direction `view`: `values` (M, (L + 1) * 3) of the texels `index`, which count `weights` (N,)."""
        chosen = np.flatnonzero(self._places[index] >= 0)
        size, square = len(LARGEST), 0.0
        left, right = np.empty((len(chosen), size, size), np.float32), np.empty((len(chosen), size, 3), np.float32)
        for start in range(0, len(chosen), CHUNK):
            own = chosen[start : start + CHUNK]
            made = features(self._surface, view, suns, index[own])
            seen = np.clip(by_light(values[own]), 0.0, WHITE)
            counting = (weights[index[own], None] * light_weights).astype(np.float32)
            weighted = (made * counting[..., None]).transpose(0, 2, 1)
            left[start : start + CHUNK], right[start : start + CHUNK] = weighted @ made, weighted @ seen
            square += float((counting * (seen**2).sum(axis=2)).sum(dtype=np.float64))
        return _Terms(self._places[index[chosen]], left, right, square)

    def add(self, terms: _Terms) -> None:
        """Add the terms of a view."""
        self._left[terms.places] += terms.left
        self._right[terms.places] += terms.right
        self._square += terms.square

    def solved(self, quads: np.ndarray) -> np.ndarray:
        """The best numbers (N, 5, 3)."""
        mean = self._left.mean(axis=0) + 1e-9 * np.eye(len(LARGEST))
        level = _bounded(mean[None], self._right.mean(axis=0)[None])
        pooled_left, pooled_right = (_sums(part, quads) for part in (self._left, self._right))
        of_quads = _bounded(pooled_left + LEVEL_PRIOR * mean, pooled_right + LEVEL_PRIOR * (mean @ level))
        return _bounded(self._left + QUAD_PRIOR * mean, self._right + QUAD_PRIOR * (mean @ of_quads)[quads])

    def error(self, found: np.ndarray) -> float:
        """The squared error that `found` leaves."""
        return self._square + float((found * (self._left @ found - 2.0 * self._right)).sum())


def _bounded(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions (N, K, 3) within 0 and LARGEST of least squares with normal equations (N, K, K), (N, K, 3): coordinate descent."""
    chunks = slices(len(left), CHUNK)
    return np.concatenate([np.zeros((0, *right.shape[1:])), *mapped(lambda rows: _descended(left[rows], right[rows]), chunks)])


def _descended(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """What `_bounded` looks for, of some texels."""
    found = np.clip(np.linalg.solve(left, right), 0.0, LARGEST[:, None])
    for _ in range(ROUNDS):
        moved = 0.0
        for own in range(len(LARGEST)):
            pull = right[:, own] - (left[:, own, None] @ found)[:, 0]
            better = np.clip(found[:, own] + pull / left[:, own, own, None], 0.0, LARGEST[own])
            moved = max(moved, float(np.abs(better - found[:, own]).max()))
            found[:, own] = better
        if moved < SETTLED:
            break
    return found


def _sums(parts: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """`parts` (N, ...) summed over the texels of each quad."""
    made = np.zeros((int(quads.max()) + 1, *parts.shape[1:]))
    np.add.at(made, quads, parts)
    return made


def _facing(normals: np.ndarray, view: np.ndarray) -> np.ndarray:
    return np.clip(normals @ view, LEAST_FACING, 1.0)
