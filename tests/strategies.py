"""Hypothesis strategies of the inputs that the campaigns use too; see `random_inputs`."""

import numpy as np
from hypothesis import strategies as st

import random_images
import random_inputs
from farfield.addon.core.settings import Description

RANDOM = st.randoms(use_true_random=False)  # Hypothesis controls and simplifies its choices


def names() -> st.SearchStrategy[str]:
    """Names of data-blocks."""
    return RANDOM.map(random_inputs.random_name)


def meshes() -> st.SearchStrategy[random_inputs.PolygonMesh]:
    """Small meshes, often with defects."""
    return RANDOM.map(random_inputs.random_mesh)


def images() -> st.SearchStrategy[np.ndarray]:
    """Small images as they are stored in files."""
    return RANDOM.map(random_images.random_image)


def damaged(content: bytes) -> st.SearchStrategy[bytes]:
    """Damaged copies of a file."""
    return RANDOM.map(lambda random: random_inputs.damage(random, content))


def formulas() -> st.SearchStrategy[str]:
    """Formulas of x, y and z, valid or not."""
    return RANDOM.map(random_inputs.random_formula)


def values(description: Description) -> st.SearchStrategy[str | bool]:
    """Valid values of a setting."""
    return RANDOM.map(lambda random: random_inputs.valid_value(random, description))


def bad_values() -> st.SearchStrategy[str]:
    """Text that few settings accept."""
    return RANDOM.map(random_inputs.bad_value)
