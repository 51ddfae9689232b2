"""Results that are kept on disk."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hplan.base import disk_cache
from hplan.base.disk_cache import cached_arrays
from hplan.geometry import convex_decomposition
from hplan.geometry.convex_decomposition import convex_pieces


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HPLAN_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def call(part: bytes, value: float) -> float:
    return float(cached_arrays([part], [disk_cache], lambda: {"value": np.array(value)})["value"])


@pytest.mark.usefixtures("folder")
def test_cache_returns_the_first_result_of_equal_inputs() -> None:
    assert [call(b"a", 1.0), call(b"b", 2.0), call(b"a", 3.0)] == [1.0, 2.0, 1.0]


@pytest.mark.parametrize("damage", [lambda data: data[:-3], lambda data: data[:40] + b"x" + data[41:], lambda _: b""])
def test_cache_computes_again_if_a_file_is_damaged(folder: Path, damage: object) -> None:
    call(b"a", 1.0)
    (path,) = folder.glob("*.npz")
    path.write_bytes(damage(path.read_bytes()))  # type: ignore[operator]
    assert call(b"a", 5.0) == 5.0
    assert call(b"a", 6.0) == 5.0


def test_cache_that_cannot_be_written_does_no_harm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("HPLAN_CACHE_DIR", str(tmp_path / "file"))
    assert [call(b"a", 1.0), call(b"a", 2.0)] == [1.0, 2.0]


def test_cache_removes_the_files_that_were_not_used_for_the_longest_time(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    call(b"a", 1.0)
    size = next(folder.glob("*.npz")).stat().st_size
    monkeypatch.setattr(disk_cache, "_MOST_BYTES", int(2.5 * size))
    call(b"b", 1.0)
    for path in folder.glob("*.npz"):
        os.utime(path, (1.0, 1.0))  # times of files have a coarse resolution
    for part in (b"a", b"c"):
        call(part, 1.0)
    assert call(b"a", 7.0) == 1.0
    assert call(b"b", 7.0) == 7.0


def test_pieces_from_disk_are_those_that_were_computed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import trimesh

    torus = trimesh.creation.torus(major_radius=0.1, minor_radius=0.03, major_sections=12, minor_sections=6)
    vertices, faces = np.array(torus.vertices), np.array(torus.faces, dtype=np.int64)
    computed = convex_pieces(vertices, faces)
    assert len(list(folder.glob("*.npz"))) == 1
    monkeypatch.setattr(convex_decomposition, "_cut", None)
    kept = convex_pieces(vertices, faces)
    assert kept.excess == computed.excess
    assert len(kept.hulls) == len(computed.hulls) > 1
    for one, other in zip(kept.hulls, computed.hulls, strict=True):
        assert (one.name, one.rounding) == (other.name, other.rounding)
        np.testing.assert_array_equal(one.core, other.core)
        np.testing.assert_array_equal(one.faces, other.faces)
