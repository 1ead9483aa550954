"""Camera files of Metashape: components, chunks, and cameras that cannot be used."""

import numpy as np
import pytest

from camera_files import SIZE, assert_same, numbers, poses
from farfield.addon.core.errors import FileError
from farfield.addon.core.photos.importers import read_camera_file, read_cameras
from photo_scenes import ring

IDENTITY = "<transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform>"


class TestMetashape:
    """Components, chunks, and cameras that cannot be used."""

    ROTATION, TRANSLATION, SCALE = ring(1)[0].rotation, np.array([5.0, -2.0, 1.0]), 2.5

    def write(self, path, *, place="component", calibration="<f>300</f>", extra_sensor="", extra="", attributes=""):
        similarity = (
            f"<transform><rotation>{numbers(self.ROTATION)}</rotation><translation>{numbers(self.TRANSLATION)}</translation>"
            f"<scale>{self.SCALE}</scale></transform>"
        )
        sensor = f'<resolution width="{SIZE[0]}" height="{SIZE[1]}"/>'
        lines = [f'<sensor id="0" type="frame"><calibration type="frame" class="adjusted">{sensor}{calibration}</calibration></sensor>']
        lines += [extra_sensor, "</sensors>", '<components active_id="0"><component id="0">', similarity if place != "chunk" else ""]
        lines += ["</component></components><cameras>"]
        for index, pose in enumerate(poses()):
            local = np.eye(4)
            local[:3, :3] = self.ROTATION.T @ pose[:3, :3]
            local[:3, 3] = self.ROTATION.T @ (pose[:3, 3] - self.TRANSLATION) / self.SCALE
            more = attributes if index == 3 else ""
            lines.append(
                f'<camera id="{index}" sensor_id="0" component_id="0" label="{index}.png" {more}>'
                f"<transform>{numbers(local)}</transform></camera>"
            )
        lines += [extra, "</cameras>", similarity if place != "component" else ""]
        path.write_text(f"<document><chunk label='A'><sensors>{''.join(lines)}</chunk></document>", encoding="utf-8")
        return path

    @pytest.mark.parametrize("place", ["component", "chunk", "both"])
    def test_the_transform_of_the_component_is_applied(self, tmp_path, place):
        found = read_camera_file(self.write(tmp_path / "a.xml", place=place))
        assert_same(found.cameras)
        assert found.notes == []

    @pytest.mark.parametrize(
        ("extra_sensor", "extra", "note"),
        [
            ("", f'<camera sensor_id="0" label="x" enabled="false">{IDENTITY}</camera>', 'Skipped: "x" (disabled).'),
            ("", f'<camera sensor_id="0" label="x" enabled="0">{IDENTITY}</camera>', 'Skipped: "x" (disabled).'),
            (
                '<sensor id="1"><resolution width="9" height="9"/></sensor>',
                f'<camera sensor_id="1" label="x">{IDENTITY}</camera>',
                'Skipped: "x" (its sensor is not calibrated).',
            ),
            (
                '<sensor id="1" type="spherical"><resolution width="9" height="9"/></sensor>',
                "".join(f'<camera sensor_id="1" label="{name}">{IDENTITY}</camera>' for name in "abcde"),
                'Skipped: "a", "b", "c" and 2 more (its lens is of the type "spherical").',
            ),
            (
                '<sensor id="1"><calibration><resolution width="9" height="9"/><f>9</f><p3>1</p3></calibration></sensor>',
                f'<camera sensor_id="1" label="x">{IDENTITY}</camera>',
                'Skipped: "x" (its lens has coefficients that Farfield does not know).',
            ),
            ("", f'<camera sensor_id="0">{IDENTITY}</camera>', 'Skipped: "" (no label).'),
            (
                "",
                '<camera sensor_id="0" label="x" master_id="0"/>',
                "Cameras of a rig but its first are left out, since the file places them relative to it.",
            ),
        ],
    )
    def test_cameras_that_cannot_be_used_are_skipped_and_named(self, tmp_path, extra_sensor, extra, note):
        found = read_camera_file(self.write(tmp_path / "a.xml", extra_sensor=extra_sensor, extra=extra))
        assert_same(found.cameras)
        assert found.notes == [note]

    def test_if_none_is_left_the_reason_is_named(self, tmp_path):
        path = self.write(tmp_path / "a.xml", calibration="<f>300</f><p4>1</p4>")
        with pytest.raises(FileError, match=r'No camera in .* can be used: "0.png", "1.png", "2.png" and 1 more \(its lens has'):
            read_cameras(path)

    def test_other_components_without_a_transform_are_skipped(self, tmp_path):
        path = self.write(tmp_path / "a.xml", attributes="")
        text = path.read_text(encoding="utf-8").replace("</components>", '<component id="1"/></components>')
        path.write_text(text.replace('component_id="0" label="3.png"', 'component_id="1" label="3.png"'), encoding="utf-8")
        found = read_camera_file(path)
        assert_same(found.cameras, ("0.png", "1.png", "2.png"))
        assert found.notes == ['Skipped: "3.png" (it belongs to a component that is not aligned with the active one).']

    def test_one_chunk_is_read_and_geocentric_ones_are_named(self, tmp_path):
        path = self.write(tmp_path / "a.xml")
        chunk = path.read_text(encoding="utf-8").removeprefix("<document>").removesuffix("</document>")
        chunk = chunk.replace("</chunk>", '<reference>GEOGCS["WGS 84"]</reference></chunk>')
        path.write_text(f"<document><chunk><cameras/></chunk>{chunk}{chunk}</document>", encoding="utf-8")
        found = read_camera_file(path)
        assert_same(found.cameras)
        assert any("geocentric" in note for note in found.notes)
        assert 'Only the first of 2 chunks was read, "A".' in found.notes

    def test_cameras_on_the_surface_of_the_earth_are_geocentric(self, tmp_path):
        path = self.write(tmp_path / "a.xml")
        translation = numbers(self.TRANSLATION)
        path.write_text(path.read_text(encoding="utf-8").replace(translation, "-2499366.4 -4256836.5 4029217.9"), encoding="utf-8")
        [note] = read_camera_file(path).notes
        assert "geocentric" in note

    def test_skew_and_the_fourth_coefficient(self, tmp_path):
        """x = cx + (f + b1) x' + b2 y', y = cy + f y', with a radial polynomial of four coefficients."""
        terms = {"b1": 4.0, "b2": 3.0, "k1": 0.1, "k2": -0.02, "k3": 0.005, "k4": 0.03, "p1": 0.003, "p2": -0.001, "cx": 2.0, "cy": -1.0}
        tags = "".join(f"<{name}>{value}</{name}>" for name, value in terms.items())
        camera = read_cameras(self.write(tmp_path / "a.xml", calibration=f"<f>300</f>{tags}"))[0]
        local = np.random.default_rng(1).uniform(-0.4, 0.4, (20, 3)) + [0.0, 0.0, 1.5]
        u, v = (local[:, :2] / local[:, 2:]).T
        square = u * u + v * v
        radial = 1 + 0.1 * square - 0.02 * square**2 + 0.005 * square**3 + 0.03 * square**4
        x = u * radial + 0.003 * (square + 2 * u * u) - 0.002 * u * v
        y = v * radial - 0.001 * (square + 2 * v * v) + 0.006 * u * v
        found = camera.lens.project(local)[0]
        assert found == pytest.approx(np.stack([150 + 2 + 304 * x + 3 * y, 240 - (120 - 1 + 300 * y)], axis=1))
