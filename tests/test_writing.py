# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Folders and files that are complete or not there."""

import pytest

from astro_scc.writing import partial_folder, replace_when_complete


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_and_a_file_that_are_gone_unless_complete(tmp_path):
    with pytest.raises(RuntimeError), partial_folder(tmp_path, ".part-") as folder:
        raise RuntimeError((folder / "a").write_text("x"))
    with partial_folder(tmp_path, ".part-") as folder:
        folder.rename(tmp_path / "whole")
    file = tmp_path / "a"

    def interrupted():
        with replace_when_complete(file) as part:
            part.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert names(tmp_path) == ["whole"]
    with replace_when_complete(file) as part:
        part.write_text("complete")
    assert names(tmp_path) == ["a", "whole"]
    for path, words in {
        "a": "a: exists; pass overwrite=True to replace it",
        "whole": "whole: is a directory; give the name of a file",
        "nowhere/a": "its folder .*nowhere does not exist",
    }.items():
        with pytest.raises(OSError, match=words):
            replace_when_complete(tmp_path / path).__enter__()
