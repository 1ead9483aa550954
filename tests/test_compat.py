"""The running Blender accepts the values from compat.py."""

import pytest

pytest.importorskip("bpy")


def test_eevee_can_be_chosen(empty_scene):
    from farfield.addon import compat

    empty_scene.render.engine = compat.eevee_engine()
    assert "EEVEE" in empty_scene.render.engine


def test_file_formats_can_be_chosen_in_any_order(empty_scene):
    from farfield.addon import compat

    for file_format in ("PNG", "OPEN_EXR_MULTILAYER", "OPEN_EXR", "OPEN_EXR_MULTILAYER", "PNG"):
        compat.set_file_format(empty_scene.render.image_settings, file_format)
        assert empty_scene.render.image_settings.file_format == file_format
