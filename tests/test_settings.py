"""Settings are declared once: flags and tables say what the declaration says, and what is read back is what was meant."""

import argparse
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from farfield.addon.core.billboards.settings import BillboardSettings
from farfield.addon.core.errors import SettingsError
from farfield.addon.core.settings import Unit, add_flags, describe, from_flags, markdown_table

DESCRIPTIONS = {item.name: item for item in describe(BillboardSettings)}
NUMBERS = [item for item in DESCRIPTIONS.values() if item.type in (int, float) and item.minimum is not None]


def read(*flags: str) -> BillboardSettings:
    """The settings that a script with these flags would use."""
    parser = argparse.ArgumentParser()
    add_flags(parser, BillboardSettings)
    return from_flags(BillboardSettings, parser.parse_args(flags))


def test_no_flags_mean_the_defaults():
    assert read() == BillboardSettings()


def test_units_of_people():
    assert read("--error", "1%").error == 0.01
    assert read("--error", "0.01").error == 0.01
    assert read("--max-normal-deviation", "60").max_normal_deviation == pytest.approx(math.pi / 3)
    assert read("--no-textures").textures is False
    assert read("--texture-mb", "1.5").texture_mb == 1.5
    assert read("--quads", "200").quads == 200


@pytest.mark.parametrize("item", NUMBERS, ids=lambda item: item.name)
@given(share=st.floats(0.0, 1.0))
def test_every_number_survives_being_written_as_a_flag(item, share):
    value = item.minimum + share * (item.maximum - item.minimum)
    value = item.parse(item.shown(item.type(value)))
    assert item.minimum <= value * (1 + 1e-5) and value <= item.maximum * (1 + 1e-5)
    assert item.parse(item.shown(value)) == pytest.approx(value, rel=1e-5, abs=1e-12)


@pytest.mark.parametrize("item", NUMBERS, ids=lambda item: item.name)
def test_limits_are_allowed_and_what_lies_beyond_is_refused_by_the_flag_name(item):
    for limit, beyond in ((item.minimum, item.minimum - 1), (item.maximum, item.maximum * 2 + 1)):
        assert getattr(BillboardSettings(**{item.name: item.type(limit)}), item.name) == limit
        with pytest.raises(SettingsError, match=item.flag):
            BillboardSettings(**{item.name: item.type(beyond)})


@pytest.mark.parametrize("flag", ["--error=0", "--error=-1%", "--error=900%", "--error=nan", "--error=small", "--levels=2.5"])
def test_absurd_values_are_refused_in_one_sentence(flag):
    with pytest.raises(SettingsError) as caught:
        read(flag)
    sentence = str(caught.value)
    assert flag.split("=")[0] in sentence and sentence.endswith(".") and "\n" not in sentence


def test_unknown_method_is_refused_with_the_known_ones():
    with pytest.raises(SettingsError, match="clusters, hough, decimate"):
        BillboardSettings(method="magic")


def test_every_setting_says_what_it_does_and_stands_in_the_table_once():
    table = markdown_table(BillboardSettings)
    for item in DESCRIPTIONS.values():
        assert item.help and not item.help.endswith(".")
        assert table.count(f"`{item.flag}`") == 1
    assert len(table.splitlines()) == len(DESCRIPTIONS) + 2


def test_shares_and_angles_are_shown_as_people_write_them():
    assert DESCRIPTIONS["error"].unit is Unit.SHARE and DESCRIPTIONS["error"].shown(0.005) == "0.5%"
    assert DESCRIPTIONS["max_normal_deviation"].shown(math.radians(60)) == "60"
    assert DESCRIPTIONS["textures"].shown(True) == "on"
