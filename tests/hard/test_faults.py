"""What may happen to a run from outside: after it the record reads, and it goes on or says why."""

import errno
import io
import os
import random
import resource
import signal
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import processes
import pytest
from runs_for_tests import QUIET, ran

import isas_cli
from isas_cli import records
from isas_cli.config.schema import UnknownConfig
from isas_cli.engine import footprint
from isas_cli.engine.display import Display
from isas_cli.runtime import clock, images, memory
from isas_cli.runtime.errors import InputError

TINY = [
    *("scene=pottery", "size=tiny", "sampler=uniform", "target.spp=4", "estimator.batch=256"),
    *("evaluation.pixels=256", "effects=full", *QUIET),
]


def started(folder: Path, *settings: str, **environment) -> subprocess.Popen:
    words = ["run", *settings, "threads=1", f"hydra.run.dir={folder}"]
    return processes.started(folder.parent, *words, env=os.environ | environment)


def rows(folder: Path) -> list[tuple]:
    """What the record has of each evaluation, as numbers that are equal or not."""
    history = records.load(folder).history
    return [tuple(row) for row in history[["iteration", "seconds", "parameter_rmse"]].to_numpy()]


@pytest.mark.parametrize("kills", [3, pytest.param(50, marks=pytest.mark.slow)])
def test_killed_at_any_moment(kills, tmp_path, isas):
    """Before its folder is there, while it is made, in the loop, at its end."""
    rng, settings = random.Random(kills), [*TINY, "budget.seconds=1.5", "evaluation.count=40"]
    begun = time.monotonic()
    assert started(tmp_path / "whole", *settings).wait() == 0
    whole, stopped, resumed = time.monotonic() - begun, 0, 0
    for number in range(kills + 1):
        folder = tmp_path / f"killed{number}"
        if number < kills:
            process = started(folder, *settings)
            # Most of a run's life here is its beginning.
            time.sleep(whole * rng.uniform(0.5, 1.0))
        else:  # once where there surely is something to go on from
            words = ["run", *settings, "threads=1", f"hydra.run.dir={folder}"]
            process, _ = processes.begun(tmp_path, *words, rows=2, below=folder.name)
        process.send_signal(signal.SIGKILL)
        stopped += process.wait() == -signal.SIGKILL
        if not (folder / "checkpoint").exists():
            # Nothing was promised yet; the folder can be used.
            anew = [*settings, "budget.seconds=0.1", "overwrite=true", f"hydra.run.dir={folder}"]
            assert isas("run", *anew)[0] == 0
            continue
        before, (_, state) = rows(folder), records.load_checkpoint(folder)
        status, _, err = isas("run", f"resume={folder}")
        assert status in (0, 2), err
        if status == 0:
            resumed += 1
            assert records.load(folder).summary["status"] == "done"
            # Rows after the checkpoint are made again, at other seconds; those before it stay.
            kept = [row for row in before if row[0] <= state["iteration"]]
            # A kill between the checkpoint of the start and the first row leaves none.
            assert kept or state["iteration"] == 0
            assert rows(folder)[: len(kept)] == kept
        else:
            assert "budget is spent" in err
            assert rows(folder) == before
    print(f"{stopped} of {kills + 1} killed in time, {resumed} went on")
    assert stopped > kills / 4 and resumed


def test_a_full_disk_ends_a_run_in_one_line_and_loses_no_row(tmp_path):
    def little():
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    # Kernels and targets are there already: only the record meets the limit.
    settings = [*TINY, "scene=dodoco", "budget.iterations=600", "evaluation.count=300"]
    assert started(tmp_path / "before", *settings, "budget.iterations=20").wait() == 0
    words = ["run", *settings, "threads=1", f"hydra.run.dir={tmp_path / 'run'}"]
    done = processes.isas(tmp_path, *words, preexec_fn=little)
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
    assert "cannot be written" in done.stderr.splitlines()[-1]
    left = records.load(tmp_path / "run").history
    assert len(left) >= 3 and np.isfinite(left["parameter_rmse"]).all()


@pytest.mark.parametrize("where", ["a pipe", "/dev/full"])
def test_a_run_goes_on_where_nothing_that_it_says_arrives(where, tmp_path):
    """Its reader has gone, as when ssh drops, or the log's disk is full."""
    if where == "a pipe":
        source, sink = os.pipe()
        os.close(source)
    else:
        sink = os.open(where, os.O_WRONLY)
    words = ["run", *TINY, "budget.iterations=3", "threads=1", f"hydra.run.dir={tmp_path / 'run'}"]
    done = subprocess.run([*processes.ISAS, *words], stdout=subprocess.PIPE, stderr=sink)
    os.close(sink)
    assert done.returncode == 0
    run = records.load(tmp_path / "run")
    assert run.complete and run.summary["status"] == "done"


class Full(io.StringIO):
    """A terminal, or a log, that takes nothing."""

    def write(self, text):
        raise OSError(errno.ENOSPC, "No space left on device")

    def isatty(self):
        return True


def test_a_live_line_that_cannot_be_drawn_ends_nothing(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", Full())
    with Display(None) as display:
        assert display.live
        display.phase("targets")
        display.advanced(0.5, "half", "half")
        display.say("a line")
    assert display.console.quiet


def test_a_damaged_kernel_cache_costs_time_only(tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    environment = {"HOME": str(home), "ISAS_CACHE_DIR": os.environ["ISAS_CACHE_DIR"]}
    settings = [*TINY, "scene.max_depth=2", "budget.iterations=3"]
    assert started(tmp_path / "first", *settings, **environment).wait() == 0
    kernels = sorted((home / ".drjit").glob("*"))
    assert len(kernels) > 5
    rng = random.Random(1)
    for number, path in enumerate(kernels):
        data = path.read_bytes()
        changed = (data[: len(data) // 2], b"", rng.randbytes(len(data)), data)[number % 4]
        path.write_bytes(changed)
    process = started(tmp_path / "again", *settings, **environment)
    out, err = process.communicate()
    assert process.returncode == 0, err
    first, again = (isas_cli.load(tmp_path / name) for name in ("first", "again"))
    assert first.history["parameter_rmse"].tolist() == again.history["parameter_rmse"].tolist()


def test_two_that_fill_one_cache_both_finish(tmp_path):
    environment = {"ISAS_CACHE_DIR": str(tmp_path / "cache")}
    settings = [*TINY, "budget.iterations=5", "target.spp=64"]
    both = [started(tmp_path / name, *settings, **environment) for name in "ab"]
    for process in both:
        out, err = process.communicate()
        assert process.returncode == 0, err
    a, b = (isas_cli.load(tmp_path / name) for name in "ab")
    assert a.history["parameter_rmse"].tolist() == b.history["parameter_rmse"].tolist()
    assert not list((tmp_path / "cache").glob(".*.tmp"))


def test_a_clock_that_jumps_ends_a_run_at_worst(tmp_path, monkeypatch):
    """A machine that slept in the middle of a step: its hours are billed, and nothing breaks."""
    now, calls = time.perf_counter, []

    def jumping() -> float:
        calls.extend([None] * (sys._getframe(1).f_code.co_filename == clock.__file__))
        # Within a phase, which asks at its begin and at its end.
        return now() + (3600.0 if len(calls) > 401 else 0.0)

    monkeypatch.setattr("isas_cli.runtime.clock.time.perf_counter", jumping)
    run = ran(tmp_path / "run", *TINY, "budget.seconds=100", "budget.iterations=3000")
    assert run.summary["status"] == "done" and run.history["seconds"].is_monotonic_increasing
    assert np.isfinite(run.history["parameter_rmse"]).all()
    assert run.summary["seconds_billed"] + sum(run.summary["seconds_unbilled"].values()) > 3600


def test_what_cannot_fit_into_memory_is_refused_before_it_starts(refused):
    told = "needs at least", "GiB of memory", "a step 1", "lower estimator.batch"
    refused(["run", *TINY, "estimator.batch=2147483648"], *told)


def test_the_largest_part_is_named(monkeypatch):
    from scenes_for_tests import TEXTURE, problem

    made = problem({TEXTURE: 0.5})
    footprint.check(made, 256)
    for lanes, words in ((1, "the resolution of the views"), (10**6, "estimator.batch")):
        monkeypatch.setattr(memory, "available", lambda: 1000.0)
        with pytest.raises(InputError, match=f"are free: lower {words}"):
            footprint.check(made, lanes)


def test_paths_of_a_launch_need_memory(monkeypatch):
    """However few pixels they are of."""
    from gradient_estimates import configured
    from scenes_for_tests import TEXTURE, problem

    made = problem({TEXTURE: 0.5})
    entries = made.unknowns[TEXTURE].start.size
    for name, settings, paths in (
        ("two_path", {}, 64),
        ("finite_differences", {"spp": 100}, 64 * 200),
        ("plateau", {"spp": 100}, 64 * 100),
        ("plateau", {"spp": 100, "smooth": "loss"}, 64 * 200),
        ("plateau", {"spp": 100, "scheme": "separate"}, 64 * 50 * entries),
        ("plateau", {"residual_spp": 400}, 64 * 200),
    ):
        estimator = configured("estimator", name, {"batch": 64, **settings})
        assert estimator.paths_at_once(made) == paths, settings
    monkeypatch.setattr(memory, "available", lambda: 64 * 200 * 12.0)
    footprint.check(made, 64)
    with pytest.raises(InputError, match="are free: lower estimator.batch"):
        footprint.check(made, 64, paths=64 * 200)


def test_edges_in_all_views_need_memory(monkeypatch):
    from isas_cli.scenes import kirby
    from scenes_for_tests import without_targets
    from shapes_for_tests import KEY

    made = without_targets(kirby.build(3, 8, 3), {KEY: UnknownConfig(start="smooth")})
    # 1280 triangles have 1920 edges, in 3 views of 16 bytes each.
    monkeypatch.setattr(memory, "available", lambda: 3 * 1920 * 16 + 1000.0)
    footprint.check(made, 1)
    with pytest.raises(InputError, match="silhouettes .*lower the number of triangles of 'figure'"):
        footprint.check(made, 1, outlines=True)


def test_grids_of_256_points_a_side_fit_into_three_gibibytes(monkeypatch):
    def asked(side: int, free: float) -> None:
        def unknown(key: str, channels: int):
            start = np.broadcast_to(np.float32(0), (side, side, side, channels))
            return SimpleNamespace(key=key, start=start, kind=SimpleNamespace(name="grid"))

        monkeypatch.setattr(memory, "available", lambda: free)
        views = SimpleNamespace(total=32 * 96**2)
        grids = [unknown("density", 1), unknown("colour", 3)]
        footprint.check(SimpleNamespace(views=views, unknowns=grids), 16384)

    asked(256, 3 * 2**30)
    told = r"unknowns .* GiB.*lower the size of the grid 'colour', \({0}, {0}, {0}, 3\)"
    with pytest.raises(InputError, match=told.format(256)):
        asked(256, 2 * 2**30)  # a step's new values come beside the old
    with pytest.raises(InputError, match=told.format(512)):
        asked(512, 8 * 2**30)


def test_a_picture_that_claims_to_be_huge_is_refused(tmp_path):
    def chunk(kind: bytes, data: bytes) -> bytes:
        checked = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + checked

    header = struct.pack(">IIBBBBB", 900_000, 900_000, 8, 2, 0, 0, 0)
    rows = chunk(b"IDAT", zlib.compress(b"nothing")) + chunk(b"IEND", b"")
    (tmp_path / "huge.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + rows)
    with pytest.raises(InputError, match="huge.png"):
        images.read(tmp_path / "huge.png")


@pytest.mark.skipif(sys.platform != "linux", reason="control groups")
@pytest.mark.parametrize("kind, other", [("memory", ""), ("", "memory")])
def test_a_control_group_limits_what_is_free(kind, other, tmp_path, monkeypatch):
    """The process's own or any around it: those of Slurm's and systemd's jobs lie far within."""

    def limited(group: str, limit: str) -> None:
        (tmp_path / group).mkdir(parents=True, exist_ok=True)
        for name, text in (("limit", limit), ("used", "1000000"), ("memory.stat", "cached 500000")):
            (tmp_path / group / name).write_text(text + "\n")

    own = tmp_path / "own"
    own.write_text(f"2:cpu,cpuacct:/other\n1:{kind}:/slurm/job_1/step_0\n0:{other}:/other\n")
    monkeypatch.setattr(memory, "_GROUPS", [(kind, tmp_path, "limit", "used", "cached")])
    monkeypatch.setattr(memory, "_OWN", own)
    limited("other", "2000000")
    limited("slurm/job_1/step_0", "max")
    assert memory.available() > 2_500_000
    limited("slurm/job_1", "3000000")
    assert memory.available() == 2_500_000
    limited("slurm/job_1/step_0", "2900000")
    assert memory.available() == 2_400_000
    limited(".", "1500000")
    assert memory.available() == 1_000_000
    own.unlink()
    assert memory.available() == 1_000_000
