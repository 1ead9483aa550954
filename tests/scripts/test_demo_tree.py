"""The demo's tree: equal seeds give equal trees, branches are connected, leaves have an image with alpha."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from lib import demo_materials, demo_tree  # noqa: E402 - only if bpy is available


@pytest.fixture(scope="module")
def skeleton():
    return demo_tree.grow_skeleton(3)


@pytest.fixture(scope="module")
def atlas() -> np.ndarray:
    return demo_materials.paint_sprig_atlas(0)


def test_every_branch_is_connected_to_the_root(skeleton):
    nodes = np.arange(len(skeleton.parents))
    assert skeleton.parents[0] == -1
    assert (skeleton.parents[1:] >= 0).all()
    assert (skeleton.parents < nodes).all()
    steps = np.linalg.norm(skeleton.positions[1:] - skeleton.positions[skeleton.parents[1:]], axis=1)
    assert steps.max() < 2.0 * demo_tree.STEP_LENGTH
    assert (skeleton.positions[0] == 0.0).all()


def test_branch_radii_follow_da_vincis_rule(skeleton):
    inner = skeleton.positions[:, 2] > 2.0  # above the flare at the ground
    powers = skeleton.radii**demo_tree.THICKNESS_EXPONENT
    carried = np.bincount(skeleton.parents[1:], powers[1:], len(powers))
    forks = inner & (carried > 0.0)
    assert powers[forks] == pytest.approx(carried[forks], rel=0.05)
    assert skeleton.radii.min() == pytest.approx(demo_tree.TWIG_RADIUS, rel=0.01)


def test_tubes_surround_their_branches(skeleton):
    from scipy.spatial import cKDTree

    vertices, polygons, uvs = demo_tree.build_tubes(skeleton)
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
    vertices, polygons, uvs, colors = demo_tree.build_leaf_cards(skeleton, 300, 3)
    assert (vertices.shape, polygons.shape, uvs.shape, colors.shape) == ((1200, 3), (300, 4), (300, 4, 2), (1200, 4))
    corners = vertices.reshape(300, 4, 3)
    across, along = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    assert np.einsum("fa,fa->f", across, along) == pytest.approx(np.zeros(300), abs=1e-9)
    assert corners[:, 2] == pytest.approx(corners[:, 1] + along, abs=1e-9)
    assert np.ptp(uvs, axis=1) == pytest.approx(np.full((300, 2), 1.0 / demo_materials.SPRIGS_PER_SIDE))
    assert vertices[:, 2].min() > 0.5


@pytest.mark.slow
def test_sprigs_have_leaves_and_transparent_pixels(atlas):
    side = demo_materials.SPRIGS_PER_SIDE * demo_materials.SPRIG_PIXELS
    assert atlas.shape == (side, side, 4)
    assert atlas.min() >= 0.0
    assert atlas.max() <= 1.0
    cells = atlas[..., 3].reshape(
        demo_materials.SPRIGS_PER_SIDE, demo_materials.SPRIG_PIXELS, demo_materials.SPRIGS_PER_SIDE, demo_materials.SPRIG_PIXELS
    )
    coverage = cells.mean(axis=(1, 3))
    assert ((coverage > 0.1) & (coverage < 0.6)).all()
    assert cells[:, [-1]].max() == 0.0  # no leaf is clipped at the upper edge
    assert (atlas[..., 1] >= atlas[..., 2]).all()  # green, also where transparent


@pytest.mark.slow
def test_growing_twice_gives_the_same_objects(monkeypatch, atlas):
    monkeypatch.setattr(demo_materials, "paint_sprig_atlas", lambda _seed: atlas)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    trees = [demo_tree.grow_tree(seed, leaves) for seed, leaves in ((1, 60), (1, 60), (2, 60), (1, 20))]
    arrays = [[positions(item) for item in tree] for tree in trees]
    assert [item.data.materials[0].node_tree is not None for item in trees[0]] == [True, True]
    for first, second in zip(arrays[0], arrays[1], strict=True):
        assert (first == second).all()
    assert not np.array_equal(arrays[0][0], arrays[2][0])
    assert np.array_equal(arrays[0][0], arrays[3][0])  # branches do not depend on the number of leaves
    assert len(trees[3][1].data.polygons) == 20


def positions(item) -> np.ndarray:
    coordinates = np.empty(3 * len(item.data.vertices), np.float32)
    item.data.vertices.foreach_get("co", coordinates)
    return coordinates
