"""Files that are written whole or not at all, and refused before the work."""

import os

import pytest

from vislam.errors import DataError
from vislam.files import check_writable, replace_whole


def test_a_failed_write_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail():
        with replace_whole(path) as temporary:
            temporary.write_text("half")
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_is_said_at_once(tmp_path):
    (tmp_path / "file").write_text("x")
    check_writable(tmp_path / "new" / "deeper" / "a.yaml")
    with pytest.raises(DataError, match="cannot be written"):
        check_writable(tmp_path / "file" / "a.yaml")
    with pytest.raises(DataError, match="cannot be written"):
        check_writable(tmp_path)


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_read_only_folder_is_said_at_once(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(DataError, match="cannot be written"):
        check_writable(tmp_path / "a.yaml")
