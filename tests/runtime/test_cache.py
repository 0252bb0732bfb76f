"""The cache of targets: of bounded size, and never what a run depends on."""

import os
from pathlib import Path
from types import SimpleNamespace

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


def test_what_is_larger_than_all_of_it_drops_nothing_and_is_said_once(folder, monkeypatch, capfd):
    """Kept, it would have gone with the next entry, after all others had gone for it."""
    monkeypatch.setattr(cache, "_too_large", set())
    monkeypatch.setattr(cache, "_KEPT_EVERY", 0.0)
    monkeypatch.setenv("ISAS_CACHE_GIB", str(100e3 / 2**30))
    stored("a", 1000.0)
    large = {"x": np.zeros(20_000)}
    for _ in range(2):
        assert cache.cached(key("b"), lambda: large) is large
    with pytest.raises(KeyboardInterrupt), cache.unfinished(key("b")) as (part, keep):
        keep(lambda: large)
        raise KeyboardInterrupt
    assert part == {} and words(folder) == ["a"]
    (told,) = capfd.readouterr().err.splitlines()
    assert told.startswith(f"{key('b')} takes 0.000149 GiB") and "ISAS_CACHE_GIB=N" in told


def test_what_takes_long_to_write_is_written_seldom(folder, monkeypatch):
    now, written = [0.0], []

    def store(*given) -> None:
        written.append(now[0])
        now[0] += 4.0

    monkeypatch.setattr(cache, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(cache, "_store", store)
    with cache.unfinished("long") as (_, keep):
        for _ in range(60):
            now[0] += 5.0
            keep(lambda: {})
    assert len(written) == 2 and written[0] == 25.0 and 200 < written[1] - written[0] < 210


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
