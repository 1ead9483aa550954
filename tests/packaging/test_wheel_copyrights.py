"""The manifest names the copyright holders of the bundled wheels: notices in the license files of wheels are found."""

import zipfile

import pytest

from lib.wheel_copyrights import UNNAMED, find_notices, read_copyrights

pytestmark = pytest.mark.once


@pytest.mark.parametrize(
    ("text", "holder", "years"),
    [
        ("Copyright (c) 2021 Markus Worchel\n", "Markus Worchel", [2021]),
        ("Copyright © 2010 by Jeffrey 'Alex' Clark and contributors\n", "Jeffrey 'Alex' Clark and contributors", [2010]),
        ("# Copyright (C) 2009, 2010, 2013-2016 by the Brotli Authors.\n", "the Brotli Authors", [2009, 2010, 2013, 2016]),
        ("Copyright (c) 2000-2013 Universität A. All\n                        rights reserved.", "Universität A", [2000, 2013]),
        ("software, are copyright 1996-2019 Julian R Seward.  All rights reserved.", "Julian R Seward", [1996, 2019]),
        ("Copyright (c) 2018 A B <a@example.org>, all rights reserved", "A B", [2018]),
    ],
)
def test_notices(text, holder, years):
    assert find_notices(text) == [(holder, years)]


def test_other_sentences_are_no_notices():
    assert find_notices("The above copyright notice and this permission notice\nAUTHORS OR COPYRIGHT HOLDERS BE LIABLE 2020") == []


def test_license_files_of_several_wheels_give_one_entry_per_holder(tmp_path):
    files = {
        "a-1.dist-info/LICENSE": "Copyright (c) 2019 Zoé",
        "b-1.dist-info/licenses/x/COPYING.md": "Copyright 2021-2023 Zoé\nCopyright 2020 Ada",
    }
    files["a/code.py"] = "# Copyright 2001 Nobody"
    for name in "ab":
        with zipfile.ZipFile(tmp_path / f"{name}.whl", "w") as wheel:
            for path, text in files.items():
                if path.startswith(name):
                    wheel.writestr(path, text)
    assert read_copyrights(sorted(tmp_path.glob("*.whl"))) == ["2020 Ada", "2019-2023 Zoé", *UNNAMED]
