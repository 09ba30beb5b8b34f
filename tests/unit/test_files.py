from __future__ import annotations

import os
from pathlib import Path

import pytest

from missionplanner.errors import MissionError
from missionplanner.files import ensure_writable, replacing, write_atomic


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_text_and_bytes_are_written_as_they_are(tmp_path: Path) -> None:
    write_atomic(tmp_path / "text", "Höhe\r\n")
    write_atomic(tmp_path / "bytes", b"\x00\xff")
    assert (tmp_path / "text").read_bytes() == "Höhe\r\n".encode()
    assert (tmp_path / "bytes").read_bytes() == b"\x00\xff"
    assert names(tmp_path) == ["bytes", "text"]


def test_folders_are_made_and_files_replaced(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "plan.json"
    write_atomic(path, "a long first version")
    write_atomic(path, "second")
    assert path.read_text() == "second"
    assert names(path.parent) == ["plan.json"]


def test_a_file_is_as_readable_as_any_other(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_atomic(tmp_path / "plan.json", "")
        assert (tmp_path / "plan.json").stat().st_mode & 0o777 == 0o640
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(before)


def test_what_fails_half_way_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "terrain.tif"
    write_atomic(path, "old")
    with pytest.raises(RuntimeError, match="half way"), replacing(path) as draft:
        draft.write_text("half")
        raise RuntimeError("half way")
    assert path.read_text() == "old"
    assert names(tmp_path) == ["terrain.tif"]


def test_until_all_is_written_the_old_file_stands(tmp_path: Path) -> None:
    path = tmp_path / "terrain.tif"
    write_atomic(path, "old")
    with replacing(path) as draft:
        draft.write_text("new")
        assert path.read_text() == "old"
        assert draft.suffix == ".tif"  # some writers choose their format by it
        assert draft.parent == path.parent  # a rename is whole only within one file system
    assert path.read_text() == "new"


def test_a_folder_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "plan.json").mkdir()
    with pytest.raises(MissionError, match=r"plan\.json: could not be written: Is a directory"):
        write_atomic(tmp_path / "plan.json", "{}")
    assert names(tmp_path) == ["plan.json"]


def test_a_file_in_the_way_of_a_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    for path in (tmp_path / "file" / "plan.json", tmp_path / "file" / "out" / "plan.json"):
        with pytest.raises(MissionError, match="expected a folder that can be written to, got"):
            write_atomic(path, "{}")
        with pytest.raises(MissionError, match="expected a folder that can be written to, got"):
            ensure_writable(path.parent)
    assert (tmp_path / "file").read_text() == "kept"
    assert names(tmp_path) == ["file"]


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc here")
@pytest.mark.parametrize("folder", ["/proc", "/proc/here", "/proc/here/deeper"])
def test_a_folder_that_nobody_may_write_to(folder: str) -> None:
    with pytest.raises(MissionError, match=rf"^{folder}: expected a folder that can be written to, got: \w"):
        ensure_writable(Path(folder))
    with pytest.raises(MissionError, match="expected a folder that can be written to, got"):
        write_atomic(Path(folder) / "plan.json", "{}")


def test_a_name_too_long(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match="File name too long"):
        write_atomic(tmp_path / ("x" * 300), "")


def test_making_sure_leaves_nothing_but_the_folder(tmp_path: Path) -> None:
    ensure_writable(tmp_path / "a" / "b")
    ensure_writable(tmp_path / "a" / "b")
    assert names(tmp_path / "a" / "b") == []
