"""Lenses: projection and its inverse agree, and what a distortion folds back is not valid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from farfield.addon.core.errors import FileError
from farfield.addon.core.geometry.lenses import MODELS, Lens, PhotoCamera

SIZE = (640, 480)
COEFFICIENTS = {  # typical deviations of the coefficients of each model
    "SIMPLE_PINHOLE": (), "PINHOLE": (), "SIMPLE_RADIAL": (0.1,), "RADIAL": (0.1, 0.03), "OPENCV": (0.1, 0.03, 0.003, 0.003),
    "OPENCV_FISHEYE": (0.05, 0.01, 0.005, 0.001), "FULL_OPENCV": (0.1, 0.03, 0.003, 0.003, 0.01, 0.02, 0.01, 0.005), "FOV": (0.3,),
    "INVERSE_RADIAL": (0.1,), "METASHAPE": (0.1, 0.03, 0.003, 0.003, 0.01, 0.005, 0.002),
    "SIMPLE_RADIAL_FISHEYE": (0.05,), "RADIAL_FISHEYE": (0.05, 0.01),
    "THIN_PRISM_FISHEYE": (0.05, 0.01, 0.002, 0.002, 0.005, 0.001, 0.002, 0.002),
}  # fmt: skip


def random_lens(model, random):
    focal = random.uniform(450.0, 700.0, 2)
    if MODELS[model].is_isotropic:
        focal[1] = focal[0]
    center = np.array(SIZE) / 2 + random.uniform(-20.0, 20.0, 2)
    coefficients = tuple(float(scale * random.uniform(-1.0, 1.0)) for scale in COEFFICIENTS[model])
    return Lens(model, SIZE, tuple(focal), tuple(center), coefficients)


@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_projection_inverts_unprojection(model, seed):
    random = np.random.default_rng(seed)
    lens = random_lens(model, random)
    positions = random.uniform(0.0, 1.0, (200, 2)) * SIZE
    directions = lens.unproject(positions)
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
    found, is_valid = lens.project(directions * random.uniform(0.5, 9.0, (200, 1)))
    assert is_valid.all()
    assert np.abs(found - positions).max() < 1e-6


def test_a_pinhole_is_known():
    lens = Lens("PINHOLE", (100, 80), (50.0, 60.0), (40.0, 30.0))
    positions, is_valid = lens.project(np.array([[1.0, 2.0, 2.0], [0.0, 0.0, -1.0]]))
    assert positions[0].tolist() == [65.0, 80.0 - 90.0] and is_valid.tolist() == [True, False]


def test_coefficients_are_in_the_order_of_the_model():
    """OPENCV: k1, k2, p1, p2."""
    point = np.array([[0.3, 0.2, 1.0]])
    base = Lens("PINHOLE", SIZE, (1.0, 1.0), (0.0, 0.0)).project(point)[0][0] * [1, -1] + [0, SIZE[1]]
    u, v = base
    square = u * u + v * v
    expected = {
        0: (u * 0.1 * square, v * 0.1 * square), 1: (u * 0.1 * square**2, v * 0.1 * square**2),
        2: (0.2 * u * v, 0.1 * (square + 2 * v * v)), 3: (0.1 * (square + 2 * u * u), 0.2 * u * v),
    }  # fmt: skip
    for index, change in expected.items():
        coefficients = tuple(0.1 * (each == index) for each in range(4))
        found = Lens("OPENCV", SIZE, (1.0, 1.0), (0.0, 0.0), coefficients).project(point)[0][0] * [1, -1] + [0, SIZE[1]]
        assert found - base == pytest.approx(change)


def test_a_fisheye_without_coefficients_is_equidistant():
    lens = Lens("OPENCV_FISHEYE", SIZE, (100.0, 100.0), (320.0, 240.0), (0.0,) * 4)
    angle = np.deg2rad(70.0)
    positions, _ = lens.project(np.array([[np.sin(angle), 0.0, np.cos(angle)]]))
    assert positions[0] == pytest.approx([320.0 + 100.0 * angle, 240.0])


def test_what_folds_back_is_not_valid():
    lens = Lens("SIMPLE_RADIAL", SIZE, (400.0, 400.0), (320.0, 240.0), (-0.3,))
    radius = np.sqrt(1.0 / 0.9)  # where r - 0.3 r^3 is largest
    points = np.array([[0.98 * radius, 0.0, 1.0], [1.05 * radius, 0.0, 1.0], [50.0, 0.0, 1.0]])
    assert lens.project(points)[1].tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("model", "focal", "coefficients", "words"),
    [
        ("EQUIRECTANGULAR", (1.0, 1.0), (), "is unknown"),
        ("RADIAL", (1.0, 1.0), (0.1,), "2 coefficients, not 1"),
        ("PINHOLE", (0.0, 1.0), (), "no focal length"),
        ("SIMPLE_RADIAL", (1.0, 1.0), (float("nan"),), "not finite"),
    ],
)
def test_unusable_lenses_are_one_sentence(model, focal, coefficients, words):
    with pytest.raises(FileError, match=words):
        Lens(model, SIZE, focal, (0.0, 0.0), coefficients)


def test_a_camera_sees_its_own_position_at_the_origin():
    rotation = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    camera = PhotoCamera("a.jpg", Lens("PINHOLE", SIZE, (500.0, 500.0), (320.0, 240.0)), rotation, np.array([1.0, 2.0, 3.0]))
    assert rotation @ camera.position + camera.translation == pytest.approx(0.0)
    ahead = camera.position + 2.0 * rotation[2]
    positions, depths, is_valid = camera.project(ahead[None])
    assert positions[0] == pytest.approx([320.0, 240.0]) and depths[0] == pytest.approx(2.0) and is_valid[0]


@pytest.mark.parametrize("k", [-0.2, 0.0, 0.3])
def test_an_inverse_radial_lens_solves_its_equation(k):
    """d (1 + k d^2) = r, also where that has no solution: there the lens is not valid."""
    lens = Lens("INVERSE_RADIAL", SIZE, (1.0, 1.0), (0.0, 0.0), (k,))
    radii = np.linspace(0.0, 3.0, 61)
    positions, is_valid = lens.project(np.stack([radii, np.zeros(61), np.ones(61)], axis=1))
    distorted = positions[is_valid, 0]
    assert distorted * (1.0 + k * distorted**2) == pytest.approx(radii[is_valid], abs=1e-9)
    largest = 2.0 / 3.0 * np.sqrt(-1.0 / (3.0 * k)) if k < 0.0 else np.inf
    assert is_valid[radii < 0.99 * largest].all() and not is_valid[radii > 1.01 * largest].any()
