"""The demo's tree: the same seed grows the same tree, branches hang together, leaves carry a picture with real alpha."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import demo_materials  # noqa: E402 - only where bpy is
import demo_tree  # noqa: E402


@pytest.fixture(scope="module")
def skeleton():
    return demo_tree.grow_skeleton(3)


def test_every_branch_leads_back_to_the_one_root(skeleton):
    nodes = np.arange(len(skeleton.parents))
    assert skeleton.parents[0] == -1
    assert (skeleton.parents[1:] >= 0).all()
    assert (skeleton.parents < nodes).all()
    steps = np.linalg.norm(skeleton.positions[1:] - skeleton.positions[skeleton.parents[1:]], axis=1)
    assert steps.max() < 2.0 * demo_tree.STEP
    assert (skeleton.positions[0] == 0.0).all()


def test_branches_are_as_thick_as_what_they_carry(skeleton):
    inner = skeleton.positions[:, 2] > 2.0  # above the flare at the ground
    powers = skeleton.radii**demo_tree.THICKNESS_EXPONENT
    carried = np.bincount(skeleton.parents[1:], powers[1:], len(powers))
    forks = inner & (carried > 0.0)
    assert powers[forks] == pytest.approx(carried[forks], rel=0.05)
    assert skeleton.radii.min() == pytest.approx(demo_tree.TWIG_RADIUS, rel=0.01)


def test_tubes_stand_around_their_branches(skeleton):
    from scipy.spatial import cKDTree

    vertices, polygons, uvs = demo_tree.tubes(skeleton)
    assert polygons.max() == len(vertices) - 1
    assert len(np.unique(polygons)) == len(vertices)
    assert uvs.shape == (len(polygons), 4, 2)
    distances, nearest = cKDTree(skeleton.positions).query(vertices)
    assert (distances <= 1.001 * skeleton.radii.max()).all()
    corners = vertices[polygons]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    thick = skeleton.radii[nearest[polygons[:, 0]]] > 0.03
    inside = skeleton.positions[nearest[polygons[:, 0]]]
    towards_surface = corners.mean(axis=1) - inside
    assert (np.einsum("fa,fa->f", outward, towards_surface)[thick] > 0.0).mean() > 0.97


def test_leaf_cards_are_flat_rectangles_in_one_cell_of_the_atlas(skeleton):
    vertices, polygons, uvs, tints = demo_tree.leaf_cards(skeleton, 300, 3)
    assert (vertices.shape, polygons.shape, uvs.shape, tints.shape) == ((1200, 3), (300, 4), (300, 4, 2), (1200, 4))
    corners = vertices.reshape(300, 4, 3)
    across, along = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    assert np.einsum("fa,fa->f", across, along) == pytest.approx(np.zeros(300), abs=1e-9)
    assert corners[:, 2] == pytest.approx(corners[:, 1] + along, abs=1e-9)
    assert np.ptp(uvs, axis=1) == pytest.approx(np.full((300, 2), 1.0 / demo_materials.SPRIGS_A_SIDE))
    assert vertices[:, 2].min() > 0.5


def test_sprigs_have_leaves_and_empty_ground():
    atlas = demo_materials.sprig_atlas(0)
    side = demo_materials.SPRIGS_A_SIDE * demo_materials.CELL
    assert atlas.shape == (side, side, 4)
    assert atlas.min() >= 0.0
    assert atlas.max() <= 1.0
    cells = atlas[..., 3].reshape(demo_materials.SPRIGS_A_SIDE, demo_materials.CELL, demo_materials.SPRIGS_A_SIDE, demo_materials.CELL)
    coverage = cells.mean(axis=(1, 3))
    assert ((coverage > 0.1) & (coverage < 0.6)).all()
    assert cells[:, [-1]].max() == 0.0  # no leaf is cut off at the upper edge
    assert (atlas[..., 1] >= atlas[..., 2]).all()  # green, also under empty ground


def test_growing_twice_gives_the_same_objects():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    trees = [demo_tree.grow(seed, leaves) for seed, leaves in ((1, 200), (1, 200), (2, 200), (1, 50))]
    arrays = [[positions(item) for item in tree] for tree in trees]
    assert [item.data.materials[0].node_tree is not None for item in trees[0]] == [True, True]
    for first, second in zip(arrays[0], arrays[1], strict=True):
        assert (first == second).all()
    assert not np.array_equal(arrays[0][0], arrays[2][0])
    assert np.array_equal(arrays[0][0], arrays[3][0])  # branches do not depend on the number of leaves
    assert len(trees[3][1].data.polygons) == 50


def positions(item) -> np.ndarray:
    found = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", found)
    return found
