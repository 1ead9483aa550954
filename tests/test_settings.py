"""Settings are declared once: flags, tables and error messages follow the declaration, and values survive a round trip."""

import argparse
import copy
import math
import runpy
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.billboards.settings import BillboardSettings, CrossfadeSettings
from farfield.addon.core.btf.settings import BtfSettings
from farfield.addon.core.errors import SettingsError
from farfield.addon.core.settings import (
    Choice,
    Settings,
    Unit,
    add_flags,
    default_label,
    describe,
    from_flags,
    is_used,
    setting,
    unused_flags,
    with_flags,
)
from lib import environment

tables = runpy.run_path(str(environment.ROOT / "docs" / "tables.py"))
find_settings, markdown_table = tables["find_settings"], tables["markdown_table"]
DESCRIPTIONS = {item.name: item for item in describe(BillboardSettings)}
NUMBERS = [item for item in DESCRIPTIONS.values() if item.type in (int, float) and item.minimum is not None]


def read(*flags: str) -> BillboardSettings:
    """Return the settings that a script with these flags would use."""
    parser = argparse.ArgumentParser()
    add_flags(parser, BillboardSettings)
    return from_flags(BillboardSettings, parser.parse_args(flags))


def test_no_flags_give_the_defaults():
    assert read() == BillboardSettings()


def test_flags_take_the_units_of_the_interface():
    assert read("--error", "1%").error == 0.01
    assert read("--error", "0.01").error == 0.01
    assert read("--max-normal-deviation", "60").max_normal_deviation == pytest.approx(math.pi / 3)
    assert read("--texture-mb", "1.5").texture_mb == 1.5
    assert read("--quads", "200").quads == 200


def test_booleans_have_a_positive_and_a_negative_flag():
    assert DESCRIPTIONS["textures"].flags == ("--textures", "--no-textures")
    assert read().textures is True
    assert read("--textures").textures is True
    assert read("--no-textures").textures is False
    assert read("--no-textures", "--textures").textures is True


@pytest.mark.parametrize("item", NUMBERS, ids=lambda item: item.name)
@given(fraction=st.floats(0.0, 1.0))
def test_numbers_survive_formatting_and_parsing(item, fraction):
    value = item.minimum + fraction * (item.maximum - item.minimum)
    value = item.parse(item.format(item.type(value)))
    assert item.minimum <= value * (1 + 1e-5) and value <= item.maximum * (1 + 1e-5)
    assert item.parse(item.format(value)) == pytest.approx(value, rel=1e-5, abs=1e-12)


@pytest.mark.parametrize("item", NUMBERS, ids=lambda item: item.name)
def test_limits_are_allowed_and_values_outside_are_rejected_with_the_label(item):
    for limit, outside in ((item.minimum, item.minimum - 1), (item.maximum, item.maximum * 2 + 1)):
        assert getattr(BillboardSettings(**{item.name: item.type(limit)}), item.name) == limit
        with pytest.raises(SettingsError, match=f"^{item.label} is ") as caught:
            BillboardSettings(**{item.name: item.type(outside)})
        assert caught.value.settings == (item.name,) and "--" not in str(caught.value)


@pytest.mark.parametrize(
    "flag", ["--error=0", "--error=-1%", "--error=900%", "--error=nan", "--error=small", "--levels=2.5", f"--levels={10**400}"]
)
def test_command_line_rejects_bad_values_in_one_sentence_with_flag_and_label(flag):
    with pytest.raises(SettingsError) as caught:
        read(flag)
    message, name = str(caught.value), flag.split("=")[0]
    assert message.startswith(f"{name}: {name[2:].capitalize()} ") and message.endswith(".") and "\n" not in message


def test_errors_gain_the_flags_of_their_settings_once():
    error = SettingsError("Quads is 5 and Texture MB is 2.", ("quads", "texture_mb"))
    assert str(with_flags(error)) == "--quads, --texture-mb: Quads is 5 and Texture MB is 2."
    assert str(with_flags(with_flags(error))) == str(with_flags(error))
    plain = SettingsError("No texture is large enough.")
    assert with_flags(plain) is plain


def test_copies_of_errors_keep_their_settings():
    error = copy.copy(SettingsError("Quads is 5.", ("quads",)))
    assert str(error) == "Quads is 5." and error.settings == ("quads",)


def test_unknown_method_is_rejected_with_the_known_ones():
    with pytest.raises(SettingsError, match="Method must be one of clusters, hough, decimate"):
        BillboardSettings(method="magic")


def test_every_setting_has_a_help_text_and_one_table_row():
    table = markdown_table(BillboardSettings)
    for item in DESCRIPTIONS.values():
        assert item.help and not item.help.endswith(".")
        assert all(table.count(f"`{flag}`") == 1 for flag in item.flags)
        in_panel = "" if item.panel_label == item.label else f" (in the panel: *{item.panel_label}*)"
        assert table.count(f"| {item.label}{in_panel} |") == 1
    assert len(table.splitlines()) == len(DESCRIPTIONS) + 2


def test_fractions_and_angles_are_formatted_in_the_units_of_the_interface():
    assert DESCRIPTIONS["error"].unit is Unit.FRACTION and DESCRIPTIONS["error"].format(0.005) == "0.5%"
    assert DESCRIPTIONS["max_normal_deviation"].format(math.radians(60)) == "60"
    assert DESCRIPTIONS["textures"].format(True) == "on"


def test_labels_keep_abbreviations_in_capitals():
    assert default_label("texture_mb") == "Texture MB" and default_label("uv_map") == "UV Map"
    codec = next(item for item in describe(BtfSettings) if item.name == "codec")
    assert codec.choices["pca"].label == "PCA"


def test_declarations_carry_label_path_group_and_choices():
    @dataclass(frozen=True, kw_only=True)
    class ExampleSettings(Settings):
        folder: str = setting("", "Where files go", label="Output Folder", path="folder", group="Output")
        mode: str = setting("a", "Mode", choices={"a": Choice("A", "First"), "b": Choice("B", "Second")})

    folder, mode = describe(ExampleSettings)
    assert (folder.label, folder.path, folder.group) == ("Output Folder", "folder", "Output")
    assert (mode.label, mode.path, mode.group) == ("Mode", None, "")
    assert "`a` (A), `b` (B)" in markdown_table(ExampleSettings)


@dataclass(frozen=True, kw_only=True)
class PaintSettings(Settings):
    tool: str = setting("brush", "Tool", choices={name: Choice(name.title(), name) for name in ("brush", "spray", "fill", "eraser")})
    size: float = setting(1.0, "Size", minimum=0.0, maximum=9.0, used_if={"tool": ("brush", "spray", "eraser")})
    is_soft: bool = setting(True, "Whether borders are soft", label="Soft", used_if={"size": True, "tool": ("brush", "spray")})
    count: int = setting(0, "Number of drops", minimum=0, maximum=9, used_if={"tool": ("spray",), "is_soft": False})


@dataclass(frozen=True, kw_only=True)
class PaperSettings(Settings):
    depends_on = (PaintSettings,)

    absorbs: bool = setting(False, "Whether paper absorbs paint", label="Absorb", used_if={"tool": ("brush",)})


def test_conditions_are_written_for_readers():
    conditions = {item.name: item.condition for item in describe(PaintSettings, PaperSettings)}
    assert conditions == {
        "tool": "",
        "size": "Tool is not Fill",
        "is_soft": "Size is not 0 and Tool is Brush or Spray",
        "count": "Tool is Spray and Soft is off",
        "absorbs": "Tool is Brush",
    }
    tool, size = describe(PaintSettings)[:2]
    assert (tool.tooltip, size.tooltip) == ("Tool", "Size. Used if Tool is not Fill")
    assert "| Range | Used if | Description |" in markdown_table(PaintSettings)
    assert "Used if" not in markdown_table(CrossfadeSettings)


@pytest.mark.parametrize(
    ("values", "unused"),
    [
        ({}, {"count"}),
        ({"size": 0.0}, {"is_soft", "count"}),
        ({"tool": "spray", "is_soft": False}, {"absorbs"}),
        ({"tool": "fill"}, {"size", "is_soft", "count", "absorbs"}),
    ],
)
def test_settings_count_where_all_conditions_are_met(values, unused):
    settings = PaintSettings(**values)
    assert {item.name for item in describe(PaintSettings, PaperSettings) if not is_used(item, settings)} == unused


def test_flags_that_are_not_used_are_named():
    parser = argparse.ArgumentParser()
    add_flags(parser, PaintSettings)
    add_flags(parser, PaperSettings)

    def unused(*flags: str) -> list[str]:
        arguments = parser.parse_args(flags)
        return unused_flags(arguments, [from_flags(settings_type, arguments) for settings_type in (PaintSettings, PaperSettings)])

    assert unused() == unused("--size", "2", "--is-soft") == []
    assert unused("--size", "0", "--no-is-soft") == ["--no-is-soft is not used with --size 0."]
    assert unused("--tool", "fill", "--absorbs") == ["--absorbs is not used with --tool fill."]
    assert unused("--count", "3", "--tool", "spray") == ["--count is not used with --is-soft."]


@pytest.mark.parametrize("table", list(find_settings()))
def test_the_flag_of_a_setting_is_its_label(table):
    for item in describe(find_settings()[table]):
        assert item.flag == "--" + item.label.lower().replace(" ", "-")


@pytest.mark.parametrize("table", list(find_settings()))
def test_conditions_name_values_that_exist(table):
    settings_type = find_settings()[table]
    known = {item.name: item for item in describe(*settings_type.depends_on, settings_type)}
    for item in known.values():
        for name, wanted in item.used_if.items():
            assert isinstance(wanted, bool) != bool(known[name].choices)
            assert isinstance(wanted, bool) or set(wanted) < set(known[name].choices)


def test_panel_labels_fit_into_a_narrow_sidebar():
    """At the default width of the sidebar about 15 characters fit next to a value; check boxes have the whole width."""
    items = describe(*find_settings().values())
    assert [item.panel_label for item in items if item.type is not bool and len(item.panel_label) > 15] == []
