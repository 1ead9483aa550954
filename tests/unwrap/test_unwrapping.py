"""Complete unwraps: which charts are cut further, and the gain."""

import numpy as np
import pytest

from charts import dome
from farfield.addon.core.geometry.mesh import TriangleMesh
from farfield.addon.core.jobs.progress import run_to_end
from farfield.addon.core.unwrap.settings import UnwrapSettings
from farfield.addon.core.unwrap.unwrapping import UnwrapResult, unwrap
from shapes import sphere

pytestmark = pytest.mark.usefixtures("coarse_packing")
NO_SEAMS = np.zeros((0, 2), int)


def unwrap_mesh(mesh: TriangleMesh, seams: np.ndarray = NO_SEAMS, **settings) -> UnwrapResult:
    count = len(mesh.triangles)
    return run_to_end(unwrap(mesh, np.arange(count), seams, np.zeros(count), UnwrapSettings(**settings)))


@pytest.mark.slow
def test_a_disk_that_is_distorted_in_one_piece_is_cut_only_with_further_cuts():
    mesh = dome(32, 0.82)
    cut, uncut = unwrap_mesh(mesh), unwrap_mesh(mesh, further_cuts=False)
    assert uncut.metrics.symmetric_dirichlet > 5.2 > 4.7 > cut.metrics.symmetric_dirichlet
    assert cut.metrics.needles < 0.005
    assert cut.metrics.flips == cut.metrics.overlaps == uncut.metrics.flips == uncut.metrics.overlaps == 0


@pytest.mark.slow
def test_a_nearly_closed_surface_is_cut_only_with_further_cuts():
    mesh = sphere(16)
    nearly_closed = TriangleMesh(mesh.vertices, mesh.triangles[2:])
    cut, uncut = unwrap_mesh(nearly_closed), unwrap_mesh(nearly_closed, further_cuts=False)
    assert cut.metrics.symmetric_dirichlet < 4.5 < 10.0 < uncut.metrics.symmetric_dirichlet


@pytest.mark.slow
def test_marked_seams_are_not_added_to():
    mesh = dome(32, 0.82)
    seam = mesh.triangles[-1][[0, 1]]
    marked, uncut = unwrap_mesh(mesh, seam[None]), unwrap_mesh(mesh, further_cuts=False)
    assert marked.metrics.symmetric_dirichlet == pytest.approx(uncut.metrics.symmetric_dirichlet, rel=0.05)


@pytest.mark.slow
def test_a_part_with_little_distortion_stays_in_one_piece():
    mesh = dome(32, 0.4)
    cut, uncut = unwrap_mesh(mesh), unwrap_mesh(mesh, further_cuts=False)
    counts = [len(np.unique(result.corner_uvs.reshape(-1, 2), axis=0)) for result in (cut, uncut)]
    assert counts == [len(mesh.vertices)] * 2
    assert cut.metrics.symmetric_dirichlet == pytest.approx(uncut.metrics.symmetric_dirichlet, rel=1e-3)
