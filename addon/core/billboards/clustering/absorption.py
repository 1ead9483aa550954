"""Absorption of quads that are too small to see: what they show moves to larger quads within the error, whatever its normals."""

from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from ..primitives import Primitives
from .patches import Patch
from .rectangles import compute_bounds, rectangle_area

MAX_SPECK = 2.0  # Longer side of a quad that counts as a speck, in errors: a pixel at the switch distance covers one error.
MIN_HOST_RATIO = 1.5  # Shorter side of what absorbs a speck over its longer side, or over the shorter one of a sliver.
MAX_SLIVER = 1.0  # Shorter side of a quad that counts as a sliver, in errors.
MIN_FACING = 0.1  # Cosine between a quad and what it also draws: steeper faces would show as lines.
MAX_GROWTH = 1.0  # How far each side of a quad may move outwards for what it absorbs, in errors.


@dataclass
class _Hosts:
    """The Q patches that may absorb others.

    Attributes:
        normals: (Q, 3) unit.
        offsets: (Q,) of the planes.
        axes: (Q, 2, 3) of the rectangles.
        initial: (Q, 4) rectangles before any absorption.
        grown: (Q, 4) rectangles with what they have absorbed.
    """

    normals: np.ndarray
    offsets: np.ndarray
    axes: np.ndarray
    initial: np.ndarray
    grown: np.ndarray

    def find(self, positions: np.ndarray, normals: np.ndarray, allowed: np.ndarray, error: float) -> np.ndarray:
        """Return the host of each primitive with `positions` (K, C, 3) and `normals` (K, 3), -1 where none of the `allowed` (Q,) is near.

        The host is within `error`, hardly grows, and rather faces the same way.
        """
        heights = np.einsum("kci,qi->kcq", positions, self.normals) - self.offsets
        local = np.einsum("kci,qai->kcqa", positions, self.axes)
        low, high = local.min(axis=1), local.max(axis=1)
        growth = np.concatenate([self.grown[:, [0, 2]] - low, high - self.grown[:, [1, 3]]], axis=2).max(axis=2)
        reach = np.concatenate([self.initial[:, [0, 2]] - low, high - self.initial[:, [1, 3]]], axis=2).max(axis=2)
        is_host = (np.abs(heights).max(axis=1) <= error) & (reach <= MAX_GROWTH * error) & allowed
        cost = np.maximum(growth, 0.0) + np.abs(heights).max(axis=1) - error * (normals @ self.normals.T)
        cost = np.where(is_host, cost, np.inf)
        return np.where(is_host.any(axis=1), cost.argmin(axis=1), -1)


def absorb_small_patches(primitives: Primitives, kinds: np.ndarray, patches: list[Patch], error: float) -> list[Patch]:
    """Remove the patches that are specks or slivers at the scale of `error`, a length, and of which larger ones can show everything.

    kinds (P,): primitives of different kinds never share a patch.
    """
    sizes = np.array([np.ptp(patch.rectangle.reshape(2, 2), axis=1) for patch in patches]) / error
    is_speck, is_sliver = sizes.max(axis=1) <= MAX_SPECK, sizes.min(axis=1) <= MAX_SLIVER
    is_small = is_speck | is_sliver
    if is_small.all() or not is_small.any():
        return patches
    bounds = np.array([patch.rectangle for patch in patches])
    hosts = _Hosts(
        np.array([patch.normal for patch in patches]),
        np.array([patch.offset for patch in patches]),
        np.array([patch.axes for patch in patches]),
        bounds,
        bounds.copy(),
    )
    patch_kinds = np.array([kinds[patch.drawn[0]] for patch in patches])
    count = np.zeros(len(primitives), np.int32)
    for patch in patches:
        count[patch.drawn] += 1
    absorbed: dict[int, list[np.ndarray]] = {}
    removed = np.zeros(len(patches), bool)
    order = np.flatnonzero(is_small)
    for index in order[np.argsort([rectangle_area(bounds[i]) for i in order], kind="stable")]:
        drawn = patches[index].drawn
        exclusive = drawn[count[drawn] == 1]
        size = sizes[index].max() if is_speck[index] else sizes[index].min()
        allowed = ~is_small & (patch_kinds == patch_kinds[index]) & (sizes.min(axis=1) >= MIN_HOST_RATIO * size)
        found = hosts.find(primitives.positions[exclusive], primitives.normals[exclusive], allowed, error)
        if (found < 0).any():
            continue
        removed[index] = True
        count[drawn] -= 1
        count[exclusive] += 1
        for host in np.unique(found):
            members = exclusive[found == host]
            absorbed.setdefault(int(host), []).append(members)
            local = compute_bounds(primitives.positions[members], hosts.axes[host])
            grown = hosts.grown[host]
            grown[0::2] = np.minimum(grown[0::2], local[:, 0::2].min(axis=0))
            grown[1::2] = np.maximum(grown[1::2], local[:, 1::2].max(axis=0))
    return [_extend(patch, hosts.grown[index], absorbed.get(index, [])) for index, patch in enumerate(patches) if not removed[index]]


def _extend(patch: Patch, rectangle: np.ndarray, absorbed: list[np.ndarray]) -> Patch:
    """Return `patch` with a larger `rectangle` (4,) that also shows the `absorbed` primitives."""
    if not absorbed:
        return patch
    drawn = np.unique(np.concatenate([patch.drawn, *absorbed]))
    return replace(patch, rectangle=rectangle.copy(), drawn=drawn, region=np.union1d(patch.region, drawn))


def complete_regions(primitives: Primitives, sheets: np.ndarray, patches: list[Patch], error: float) -> list[Patch]:
    """Add to the region of each patch what else lies within `error` of its plane and faces it, so that its picture is complete.

    sheets (P,) bool: primitives that are drawn on one patch only, and keep to it.
    """
    solid = np.flatnonzero(~sheets)
    if len(solid) == 0:
        return patches
    corners, normals = primitives.corners[solid], primitives.normals[solid]
    completed = []
    for patch in patches:
        if sheets[patch.drawn[0]]:
            completed.append(patch)
            continue
        is_point_near = np.abs(primitives.points @ patch.normal - patch.offset) <= error
        is_near = (normals @ patch.normal >= MIN_FACING) & reduce(np.logical_and, (is_point_near[column] for column in corners.T))
        completed.append(replace(patch, region=np.union1d(patch.region, solid[is_near])))
    return completed
