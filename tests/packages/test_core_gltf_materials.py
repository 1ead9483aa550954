"""Materials of packages in glTF files: every factor and map is where glTF has it."""

import numpy as np
import pytest

from farfield.addon.core.imaging.coded_images import decode
from farfield.addon.core.packages.gltf_materials import describe_materials
from farfield.addon.core.packages.material_sources import MaterialSource
from farfield.addon.core.packages.shading import Shading


def flat(value: int, side: int = 16) -> np.ndarray:
    return np.full((side, side, 3), value, np.uint8)


def test_all_maps_and_factors_are_written():
    images = {"base_color": flat(200), "alpha": flat(90, 8), "roughness": flat(40), "metallic": flat(80, 8), "occlusion": flat(120)}
    images |= {"normal": flat(128), "emission": flat(255)}
    shading = Shading(0.5, 0.25, (4.0, 2.0, 0.0), 0.75, "mask", 0.25)
    material = MaterialSource("paint", (0.5, 0.6, 0.7, 0.8), True, images, shading)
    document = describe_materials([material, material])
    written, pixels = document["materials"][0], [decode(image["content"])[3, 3].tolist() for image in document["images"]]
    assert len(pixels) == len(document["textures"]) == 4
    surface = written["pbrMetallicRoughness"]
    assert surface["baseColorFactor"] == [0.5, 0.6, 0.7, 0.8] and (surface["roughnessFactor"], surface["metallicFactor"]) == (0.5, 0.25)
    assert pixels[surface["baseColorTexture"]["index"]] == [200, 200, 200, 90]
    assert pixels[surface["metallicRoughnessTexture"]["index"]] == pytest.approx([120, 40, 80], abs=2)
    assert written["occlusionTexture"] == surface["metallicRoughnessTexture"]
    assert written["normalTexture"]["scale"] == 0.75 and pixels[written["emissiveTexture"]["index"]] == [255, 255, 255]
    assert written["emissiveFactor"] == [1.0, 0.5, 0.0]
    assert written["extensions"] == {"KHR_materials_emissive_strength": {"emissiveStrength": 4.0}}
    assert (written["alphaMode"], written["alphaCutoff"], written["doubleSided"]) == ("MASK", 0.25, True)


def test_plain_materials_have_no_textures():
    document = describe_materials([MaterialSource("plain", (1.0, 1.0, 1.0, 1.0), False, {}, Shading(is_unlit=True))])
    assert document["textures"] == document["images"] == []
    assert set(document["materials"][0]) == {"name", "pbrMetallicRoughness", "extensions"}
