"""Surfaces taken apart: seams are kept, what is closed is opened, what is joined wrongly is parted, and glued again it is what it was."""

import numpy as np
import pytest

from charts import urchin
from farfield.addon.core.edges import edges_of
from farfield.addon.core.progress import finish
from farfield.addon.core.unwrap.borders import border_loops
from farfield.addon.core.unwrap.chart import Chart
from farfield.addon.core.unwrap.charts import pieces_of
from shapes import cylinder, sheet, sphere

NO_SEAMS = np.zeros((0, 2), int)
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)


def torus(around=24, across=12, handles=1):
    """Rings in a row, joined where they meet by taking out a square of each: a surface with as many handles."""
    vertices, triangles = [], []
    for number in range(handles):
        turn, tilt = np.meshgrid(2.0 * np.pi * np.arange(around) / around, 2.0 * np.pi * np.arange(across) / across, indexing="ij")
        out = 1.0 + 0.4 * np.cos(tilt)
        vertices.append(np.stack([out * np.cos(turn) + 4.0 * number, out * np.sin(turn), 0.4 * np.sin(tilt)], axis=-1).reshape(-1, 3))
        ring, belt = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
        a, b = ring * across + belt, (ring + 1) % around * across + belt
        c, d = (ring + 1) % around * across + (belt + 1) % across, ring * across + (belt + 1) % across
        faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 2, 3)
        triangles.append(faces + number * around * across)
    if handles == 2:
        first, second = triangles[0][0, 0].tolist() + [triangles[0][0, 1, 2]], triangles[1][0, 0].tolist() + [triangles[1][0, 1, 2]]
        bridge = []
        for here in range(4):
            a, b = first[here], first[(here + 1) % 4]
            c, d = second[-here % 4], second[(-here - 1) % 4]
            bridge += [[[a, b, d], [a, d, c]]]
        triangles = [triangles[0][1:], triangles[1][1:], np.array(bridge)]
    return np.concatenate(vertices), np.concatenate(triangles).reshape(-1, 3).astype(np.int32)


def taken_apart(vertices, triangles, seams=NO_SEAMS, faces=None, **how):
    surface = Chart(vertices, triangles, np.ones(len(triangles)), faces)
    pieces = finish(pieces_of(surface, seams, **how))
    seen = np.sort(np.concatenate([piece.triangles for piece in pieces]))
    assert np.array_equal(seen, np.arange(len(triangles)))
    for piece in pieces:
        assert np.array_equal(piece.chart.vertices[piece.chart.triangles], vertices[triangles[piece.triangles]])  # glued, it is the surface
        assert_lies_flat(piece.chart)
    return pieces


def assert_lies_flat(chart):
    """The chart is a connected and oriented manifold that a plane can hold."""
    edges = edges_of(chart.triangles)
    assert edges.uses.max() <= 2
    loops = border_loops(chart.triangles, chart.vertices)
    assert len(loops) >= 1
    assert len(chart.vertices) - len(edges.ends) + len(chart.triangles) == 2 - len(loops)


@pytest.mark.parametrize("handles", [1, 2])
def test_handles_are_cut(handles):
    [piece] = taken_apart(*torus(handles=handles))
    assert len(border_loops(piece.chart.triangles, piece.chart.vertices)) == 1


@pytest.mark.parametrize("mesh", [sphere(16), sphere(3)], ids=["fine", "coarse"])
def test_what_is_closed_is_opened_in_one_piece(mesh):
    assert len(taken_apart(mesh.vertices, mesh.triangles)) == 1


def test_even_a_tetrahedron_is_opened():
    assert len(taken_apart(*TETRAHEDRON)) == 1


def test_a_tube_is_cut_along():
    mesh = cylinder()
    [piece] = taken_apart(mesh.vertices, mesh.triangles)
    assert len(border_loops(piece.chart.triangles, piece.chart.vertices)) == 1


def test_what_is_all_but_closed_is_cut_only_where_asked():
    mesh = sphere(16)
    [whole] = taken_apart(mesh.vertices, mesh.triangles[2:], further=False)
    [cut] = taken_apart(mesh.vertices, mesh.triangles[2:])
    assert len(whole.chart.vertices) < len(cut.chart.vertices)


def test_seams_are_cut_and_nothing_else_where_they_suffice():
    mesh = sheet(8)
    across = np.flatnonzero(np.isclose(mesh.vertices[:, 0], np.median(mesh.vertices[:, 0])))
    across = across[np.argsort(mesh.vertices[across, 1])]
    pieces = taken_apart(mesh.vertices, mesh.triangles, np.column_stack([across[:-1], across[1:]]))
    assert len(pieces) == 2
    assert sum(len(piece.chart.vertices) for piece in pieces) == len(mesh.vertices) + len(across)


def test_a_seam_that_ends_within_opens_a_slit():
    mesh = sheet(8)
    row = np.flatnonzero(np.isclose(mesh.vertices[:, 0], np.median(mesh.vertices[:, 0])))
    row = row[np.argsort(mesh.vertices[row, 1])][:4]
    [piece] = taken_apart(mesh.vertices, mesh.triangles, np.column_stack([row[:-1], row[1:]]))
    assert len(piece.chart.vertices) == len(mesh.vertices) + 3


def test_pages_of_a_book_come_apart():
    spine = np.array([[0.0, 0, 0], [0, 0, 1]])
    pages = np.array([[np.cos(turn), np.sin(turn), 0.5] for turn in (0.0, 2.0, 4.0)])
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.int32)
    assert len(taken_apart(np.concatenate([spine, pages]), triangles)) == 3


def test_parts_that_touch_in_a_vertex_come_apart():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [-1, 0, 0], [-1, -1, 0]])
    assert len(taken_apart(vertices, np.array([[0, 1, 2], [0, 3, 4]], np.int32))) == 2


def test_triangles_wound_against_the_others_come_apart():
    mesh = sheet(4)
    triangles = mesh.triangles.copy()
    triangles[[3, 7]] = triangles[[3, 7]][:, ::-1]
    pieces = taken_apart(mesh.vertices, triangles)
    assert sorted(piece.triangles.tolist() for piece in pieces if len(piece.triangles) == 1) == [[3], [7]]


def test_a_closed_surface_with_many_arms_becomes_an_atlas():
    mesh = urchin()
    pieces = taken_apart(mesh.vertices, mesh.triangles)
    assert 1 < len(pieces) < len(mesh.triangles) / 10


def test_a_strip_with_one_side_is_cut():
    turn = 2.0 * np.pi * np.arange(24) / 24
    half = np.stack([np.cos(0.5 * turn) * np.cos(turn), np.cos(0.5 * turn) * np.sin(turn), np.sin(0.5 * turn)], axis=1)
    middle = np.column_stack([np.cos(turn), np.sin(turn), 0.0 * turn])
    vertices = np.concatenate([middle - 0.3 * half, middle + 0.3 * half])
    triangles = []
    for here in range(24):
        ahead = (here + 1) % 24
        low, high = (ahead, ahead + 24) if ahead else (24, 0)
        triangles += [[here, low, high], [here, high, here + 24]]
    taken_apart(vertices, np.array(triangles, np.int32))


def test_faces_are_never_cut_apart():
    mesh = sphere(10)
    faces = np.arange(len(mesh.triangles)) // 2
    edges = edges_of(mesh.triangles)
    for piece in taken_apart(mesh.vertices, mesh.triangles, faces=faces):
        place = np.full(len(mesh.triangles), -1)
        place[piece.triangles] = np.arange(len(piece.triangles))
        for one, other in zip(place[0::2], place[1::2], strict=True):
            shared = set(edges.opposite[piece.triangles[one]]) & set(edges.opposite[piece.triangles[other]])
            if shared:
                assert len(set(piece.chart.triangles[one]) & set(piece.chart.triangles[other])) == 2
