"""The triangles around removed vertices, before and after their collapses."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry.collapses import creates_repeated_edge
from ...geometry.proximity import encode_pairs
from .topology import BOUNDARY, Collapses, Topology


@dataclass(frozen=True)
class CollapseFans:
    """All corners of removed vertices, in P pairs.

    collapses: N of them. owners: (P,) int32, index of the collapse, ascending. corners: (P,) int32, halfedges that begin at the removed
    vertices. following, preceding: (P,) int32, the other two vertices of their triangles. vanishes: (P,) bool, whether a triangle contains
    the kept vertex, too. wedges: (P,) int32, the wedge of the kept vertex that replaces that of the removed one.
    """

    topology: Topology
    collapses: Collapses
    owners: np.ndarray
    corners: np.ndarray
    following: np.ndarray
    preceding: np.ndarray
    vanishes: np.ndarray
    wedges: np.ndarray

    @property
    def triangles(self) -> np.ndarray:
        """(P,) int32 indices of the triangles."""
        return self.corners % self.topology.triangle_count

    @cached_property
    def vanishing_counts(self) -> np.ndarray:
        """(N,) number of triangles that vanish."""
        return np.bincount(self.owners[self.vanishes], minlength=len(self.collapses.removed))

    @cached_property
    def neighbors(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of a collapse and a neighbor of its removed vertex; each neighbor once."""
        is_last = self.topology.twins[self.topology.previous(self.corners)] == BOUNDARY
        return np.concatenate([self.owners, self.owners[is_last]]), np.concatenate([self.following, self.preceding[is_last]])

    @cached_property
    def new_edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Pairs of a collapse and the key, see `encode_pairs`, of an edge that it creates at the kept vertex."""
        owners, neighbors = self.neighbors
        collapses = self.collapses
        kept = collapses.kept[owners]
        is_new = neighbors != kept
        for opposite in collapses.opposite:
            is_new &= neighbors != opposite[owners]
        return owners[is_new], encode_pairs(kept[is_new], neighbors[is_new], self.topology.vertex_count)

    @cached_property
    def merged_halfedges(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For each triangle that vanishes: the collapse, and the halfedges between its third vertex and the removed and the kept vertex."""
        rows = np.flatnonzero(self.vanishes)
        corners, topology = self.corners[rows], self.topology
        following, preceding = topology.next(corners), topology.previous(corners)
        is_first = self.following[rows] == self.collapses.kept[self.owners[rows]]
        return self.owners[rows], np.where(is_first, preceding, corners), following

    def any_of(self, is_found: np.ndarray) -> np.ndarray:
        """Return for which collapses (N,) bool any pair `is_found` (P,)."""
        found = np.zeros(len(self.collapses.removed), bool)
        found[self.owners[is_found]] = True
        return found


def build_fans(topology: Topology, collapses: Collapses, groups: np.ndarray, attributes: np.ndarray) -> CollapseFans:
    """Return the fans of `collapses`.

    The corners on each side of a seam get the kept vertex's wedge on the same side. Where the two wedges differ only by attributes, inside
    of a group, corners get the one whose attributes are closer.

    Args:
        groups: (W,) int32 of wedges between which there are no seams. attributes: (W, A).
    """
    owners, corners = topology.find_corners(collapses.removed)
    following = topology.ends[corners]
    preceding = topology.starts[topology.previous(corners)]
    kept = collapses.kept[owners]
    current = topology.wedges[corners]
    wedges, second = collapses.kept_wedges[:, owners]
    removed_first, removed_second = collapses.removed_wedges[:, owners]
    has_choice = (second >= 0) & (wedges != second)
    is_seam = groups[removed_first] != groups[np.maximum(removed_second, 0)]
    use_second = has_choice & is_seam & (groups[current] != groups[removed_first])
    rows = np.flatnonzero(has_choice & ~is_seam)
    if len(rows):
        distances = [np.abs(attributes[side[rows]] - attributes[current[rows]]).sum(axis=1) for side in (wedges, second)]
        use_second[rows] = distances[1] < distances[0]
    return CollapseFans(
        topology=topology,
        collapses=collapses,
        owners=owners,
        corners=corners,
        following=following,
        preceding=preceding,
        vanishes=(following == kept) | (preceding == kept),
        wedges=np.where(use_second, second, wedges),
    )


def find_compatible(fans: CollapseFans) -> np.ndarray:
    """Return which collapses (N,) bool can be performed together. Of two that cannot, the first is preferred.

    Two collapses that share no triangle may still make the same edge or the same triangle, or close a curve from both sides.
    """
    topology = fans.topology
    is_compatible = ~creates_repeated_edge(*fans.new_edges, len(fans.collapses.removed))
    _drop_mirrored_triangles(fans, is_compatible)
    owners, _, at_kept = fans.merged_halfedges
    vanishing_owner = np.full(topology.triangle_count, -1, np.int32)
    vanishing_owner[at_kept % topology.triangle_count] = owners
    twins = topology.twins[at_kept]
    other = np.where(twins >= 0, vanishing_owner[twins % topology.triangle_count], -1)
    is_compatible[owners[(other >= 0) & (other < owners)]] = False
    return is_compatible


def _drop_mirrored_triangles(fans: CollapseFans, is_compatible: np.ndarray) -> None:
    """Exclude collapses that with earlier ones give two triangles with the same vertices: those on both sides of an edge."""
    topology = fans.topology
    rows = np.flatnonzero(~fans.vanishes)
    opposite = topology.next(fans.corners[rows])
    changed_owner = np.full(len(topology.starts), -1, np.int32)
    changed_owner[opposite] = fans.owners[rows]
    twins = topology.twins[opposite]
    other = np.where(twins >= 0, changed_owner[twins], -1)
    kept = fans.collapses.kept
    owners = fans.owners[rows]
    is_mirrored = (other >= 0) & (other < owners) & (kept[owners] == kept[np.maximum(other, 0)])
    is_compatible[owners[is_mirrored]] = False
