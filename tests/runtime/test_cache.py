"""The cache of targets: of bounded size, and never what a run depends on."""

import os
from pathlib import Path

import numpy as np
import pytest

from isas_cli.runtime import cache
from isas_cli.runtime.errors import InputError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    return tmp_path


def key(word: str) -> str:
    return f"{word}-{cache.digest(word)}-llvm_ad_rgb"


def stored(word: str, used: float) -> None:
    """An entry of about 80 kB that was last used ``used`` seconds after 1970."""
    cache.cached(key(word), lambda: {"x": np.zeros(10_000)})
    os.utime(cache.folder() / f"{key(word)}.npz", (used, used))


def words(folder: Path) -> list[str]:
    return sorted(path.stem.partition("-")[0] for path in folder.glob("*.npz"))


def test_what_was_not_used_for_longest_goes_first(folder, monkeypatch):
    monkeypatch.setenv("ISAS_CACHE_GIB", str(250e3 / 2**30))
    for number, word in enumerate(("a", "b", "c")):
        stored(word, 1000.0 + number)
    assert cache.size() == pytest.approx(240e3, rel=0.01)
    # Being read is being used.
    cache.cached(key("a"), lambda: pytest.fail("it was stored"))
    stored("d", 5000.0)
    assert words(folder) == ["a", "c", "d"]
    assert cache.size() <= cache.limit()


def test_what_cannot_go_leaves_it_to_the_next(folder, monkeypatch):
    """Another user's, where a cache is shared."""
    monkeypatch.setenv("ISAS_CACHE_GIB", str(250e3 / 2**30))
    for number, word in enumerate(("theirs", "b", "c")):
        stored(word, 1000.0 + number)
    unlink = Path.unlink

    def guarded(path, *more, **named):
        if path.stem == key("theirs"):
            raise PermissionError
        unlink(path, *more, **named)

    monkeypatch.setattr(Path, "unlink", guarded)
    stored("d", 5000.0)
    assert words(folder) == ["c", "d", "theirs"]


def test_files_of_somebodys_own_stay(folder, monkeypatch):
    """ISAS_CACHE_DIR may be any folder."""
    own = [folder / name for name in ("mine.npz", "weights-1.npz", ".x.tmp", ".mine.npz.1.tmp")]
    for path in own:
        path.write_bytes(bytes(10**6))
        os.utime(path, (1, 1))
    monkeypatch.setenv("ISAS_CACHE_GIB", str(100e3 / 2**30))
    stored("a", 1000.0)
    stored("b", 2000.0)
    assert all(path.exists() for path in own)
    assert words(folder) == ["b", "mine", "weights"] and cache.size() < 1e5


def test_home_is_a_folders_beginning(monkeypatch):
    monkeypatch.setenv("ISAS_CACHE_DIR", "~/cached")
    assert cache.folder() == Path.home() / "cached"


def test_what_does_not_fit_is_kept_until_the_next(folder, monkeypatch):
    monkeypatch.setenv("ISAS_CACHE_GIB", "1e-7")
    stored("a", 1000.0)
    assert words(folder) == ["a"]
    stored("b", 2000.0)
    assert words(folder) == ["b"]


def test_a_damaged_entry_is_made_anew(folder):
    stored("a", 1000.0)
    (folder / f"{key('a')}.npz").write_bytes(b"half")
    assert cache.cached(key("a"), lambda: {"x": np.ones(2)})["x"].tolist() == [1, 1]
    assert cache.cached(key("a"), lambda: {})["x"].tolist() == [1, 1]


def test_what_a_killed_process_left_goes(folder):
    stored("a", 1000.0)
    old, fresh = folder / f".{key('b')}.npz.1.tmp", folder / f".{key('c')}.npz.2.tmp"
    for each in (old, fresh):
        each.write_bytes(b"half")
    os.utime(old, (1, 1))
    stored("d", 1000.0)
    assert not old.exists() and fresh.exists()


@pytest.mark.parametrize("text", ("much", "-1", "nan", "inf"))
def test_a_limit_that_is_no_number_is_refused(monkeypatch, text):
    monkeypatch.setenv("ISAS_CACHE_GIB", text)
    with pytest.raises(InputError, match=f"ISAS_CACHE_GIB={text}: a number of GiB"):
        cache.limit()


def test_the_doctor_tells_it(folder):
    from isas_cli.cli import doctor

    stored("a", 1000.0)
    ((name, words),) = doctor._cache()
    assert name == "target cache" and str(folder) in words
    assert "0.1 of at most 4096 MiB, oldest go first" in words


def test_no_room_is_no_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    counts = []

    def compute() -> dict:
        counts.append(1)
        return {"a": np.ones(1000)}

    cache.cached("before", compute)
    monkeypatch.setenv("ISAS_CACHE_GIB", "0")
    cache.cached("before", compute)
    cache.cached("after", compute)
    assert len(counts) == 3 and not (tmp_path / "after.npz").exists()
    with cache.unfinished("half") as (part, keep):
        keep(lambda: {"a": np.ones(1000)})
    with pytest.raises(KeyboardInterrupt), cache.unfinished("half") as (part, keep):
        keep(lambda: {"a": np.ones(1000)})
        raise KeyboardInterrupt
    assert part == {} and [path.name for path in tmp_path.iterdir()] == ["before.npz"]
