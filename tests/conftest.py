"""Set-up shared by all tests: Mitsuba started once, plots without a window, an own cache."""

import gc
import os
import shutil
import tempfile
import zlib

import matplotlib
import numpy as np
import pytest

from isas_cli.cli.app import main
from isas_cli.runtime import backend

_STARTED = pytest.StashKey[backend.Backend]()


def pytest_configure(config: pytest.Config) -> None:
    """Before any test module is imported, so that these may say `import mitsuba as mi`."""
    matplotlib.use("Agg")
    os.environ["MPLBACKEND"] = "Agg"  # for the commands that tests start
    os.environ["ISAS_CACHE_DIR"] = tempfile.mkdtemp(prefix="isas-cache-")
    os.environ["ISAS_ALLOW"] = "flaky_scene"  # a builder of tests' own
    # Workers side by side have a core each, and so have the runs and processes that they start:
    # threads that wait for work would take it from the others.
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker and hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(worker[2:]) % len(cores)]})
    config.stash[_STARTED] = backend.start(threads=1 if worker else 0)
    if worker:
        _load_by_two()


def _load_by_two() -> None:
    """Mitsuba reads EXR files by its threads, of which one alone would wait for itself."""
    import mitsuba as mi

    by_two, load_dict = backend.loading()(mi.load_dict), mi.load_dict

    def loaded(described, *arguments, **settings):
        # Others hold no pictures, and are made while kernels are traced.
        pictured = isinstance(described, dict) and described.get("type") in ("scene", "envmap")
        return (by_two if pictured else load_dict)(described, *arguments, **settings)

    mi.load_dict, mi.load_file = loaded, backend.loading()(mi.load_file)
    mi.load_string = backend.loading()(mi.load_string)


def pytest_unconfigure(config: pytest.Config) -> None:
    shutil.rmtree(os.environ["ISAS_CACHE_DIR"], ignore_errors=True)


def pytest_sessionstart(session: pytest.Session) -> None:
    machine = session.config.stash[_STARTED]
    terminal = session.config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None:
        terminal.write_line(f"{machine}; seeds of tests: CRC-32 of their names")


def pytest_collection_finish(session: pytest.Session) -> None:
    """Modules stay: the collector need not look at them again and again."""
    gc.collect()
    gc.freeze()


def pytest_sessionfinish(session: pytest.Session) -> None:
    gc.unfreeze()  # or bindings take what is left for leaks


@pytest.fixture(autouse=True, scope="module")
def _scenes_leave_between_modules(request: pytest.FixtureRequest):
    """Python's collector rests while a module's tests run: when it takes a scene of an earlier
    test in the middle of a frozen kernel, Dr.Jit finds other objects after the call than before.
    Building a problem collects, too. What a module's own functions remember goes with it: kernels
    hold the calls of every object that there is."""
    gc.collect()
    gc.disable()
    yield
    for each in vars(request.module).values():
        own = getattr(each, "__module__", "") == request.module.__name__
        if own and hasattr(each, "cache_clear"):
            each.cache_clear()
    gc.enable()


@pytest.fixture(scope="session")
def machine(request: pytest.FixtureRequest) -> backend.Backend:
    """What the tests run on."""
    return request.config.stash[_STARTED]


@pytest.fixture(scope="session")
def fixed_order(machine: backend.Backend) -> None:
    """For tests that ask for the same bits."""
    if machine.variant.startswith("cuda"):
        pytest.skip("a GPU adds in no fixed order")


@pytest.fixture
def seed(request: pytest.FixtureRequest) -> int:
    """A fixed seed of the test's own, printed when the test fails."""
    # Without the folder: a test that is moved keeps its seed.
    name = request.node.nodeid.rpartition("/")[2]
    value = zlib.crc32(f"tests/{name}".encode())
    print(f"seed {value}")
    return value


@pytest.fixture
def rng(seed: int) -> np.random.Generator:
    """A NumPy generator from the test's own seed."""
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def two_threads():
    """Mitsuba reads EXR files here, for which a worker's one thread is not enough."""
    with pytest.MonkeyPatch.context() as patch, backend.loading():
        patch.setattr(backend, "_every_thread", lambda: 2)  # also of runs, and after these
        yield


@pytest.fixture
def no_plots(monkeypatch):
    """Of comparisons, which have tests of their own."""
    monkeypatch.setattr("isas_cli.report.compare.page.plots.write_plots", lambda *_: [])


@pytest.fixture
def quick(monkeypatch):
    """Hulls whose outlines are compared at few points, where nothing is asked of that."""
    monkeypatch.setattr("isas_cli.scene.photos.coherence._COARSE", 20)
    monkeypatch.setattr("isas_cli.scene.photos.coherence._FINE", 36)
    monkeypatch.setattr("isas_cli.scene.photos.hull._FORMAT", -1)  # kept apart from others


@pytest.fixture
def isas(tmp_path, monkeypatch, capfd):
    """Calls the command in an empty folder: arguments → (status, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> tuple[int, str, str]:
        status = main(list(arguments))
        captured = capfd.readouterr()
        return status, captured.out, captured.err

    return call


@pytest.fixture
def refused(isas, capfd):
    """Calls the command, which is to answer in one line with all ``parts`` and to leave nothing in
    the folder: arguments → that line."""

    def call(arguments: list[str], *parts: str) -> str:
        capfd.readouterr()
        before = sorted(os.listdir())
        status, out, err = isas(*arguments)
        assert (status, out) == (2, ""), err
        assert err.startswith("isas: ") and err.count("\n") == 1, err
        for part in parts:
            assert part in err
        assert sorted(os.listdir()) == before
        return err

    return call
