"""Data on meshes that look like the results of unwrapping but are not: files come from anyone."""

import math

import bpy
import pytest

from farfield.addon.bridge.unwrap import uv_maps
from farfield.addon.operators.unwrap import operators
from farfield.addon.panels.unwrap import METRICS, draw_metrics

pytestmark = pytest.mark.usefixtures("empty_scene", "coarse_packing")


class Layout:
    """Records the labels that a panel draws."""

    def __init__(self):
        self.texts = []

    def row(self):
        return self

    box = row

    def column(self, align):
        return self

    def label(self, text):
        self.texts.append(text)


def add_cube():
    bpy.ops.mesh.primitive_cube_add(calc_uvs=False)
    return bpy.context.object


@pytest.mark.parametrize("value", ["text", 3, 1.5, True, [1.0, 2.0], [], {}, {"l2": "text", "p95": [1.0]}, {"l2": {"a": 1}}])
def test_metrics_of_another_type_are_ignored(value):
    """Custom properties come from anyone: neither polls nor the panel may fail."""
    item, layout = add_cube(), Layout()
    item.data[uv_maps.METRICS_PROPERTY] = value
    assert uv_maps.read_metrics(item.data) == {} and not operators.is_unwrapped(item)
    assert not bpy.ops.farfield.unwrap_stretch_image.poll()
    item.data[uv_maps.METRICS_PROPERTY] = {"l2": 1.5, "linf": math.inf, "p95": "text"}
    assert uv_maps.read_metrics(item.data) == {"l2": 1.5, "linf": math.inf} and operators.is_unwrapped(item)
    draw_metrics(layout, METRICS, uv_maps.read_metrics(item.data), uv_maps.read_texel_densities(item.data))
    assert len(layout.texts) == 2 * len(METRICS) - 2 and "1.500" in layout.texts and "inf" in layout.texts


@pytest.mark.slow
@pytest.mark.parametrize(("data_type", "domain"), [("FLOAT_VECTOR", "FACE"), ("STRING", "FACE"), ("FLOAT", "POINT")])
def test_a_stretch_attribute_of_another_type_is_no_stretch(data_type, domain):
    item = add_cube()
    assert bpy.ops.farfield.unwrap() == {"FINISHED"}
    item.data.attributes.remove(item.data.attributes[uv_maps.STRETCH_ATTRIBUTE])
    item.data.attributes.new(uv_maps.STRETCH_ATTRIBUTE, data_type, domain)
    assert uv_maps.read_uv_stretch(item.data) is None
