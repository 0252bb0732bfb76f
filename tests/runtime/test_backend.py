"""Which LLVM and which variant are taken, and what is refused with one line."""

import importlib.metadata
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from isas_cli.cli import doctor
from isas_cli.engine import experiment
from isas_cli.runtime import backend, llvm
from isas_cli.runtime.errors import InputError


def refusal(function, *arguments) -> str:
    """The message of the InputError that the call must raise: one line."""
    with pytest.raises(InputError) as caught:
        function(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def without_wheel(monkeypatch) -> None:
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", missing)


def too_old_libraries() -> list[Path]:
    found = llvm._from_ldconfig() + [str(p) for p in Path("/usr/lib").glob("llvm-*/lib/libLLVM-*")]
    versions = {Path(name): llvm._version_in_name(Path(name).resolve()) for name in found}
    return [path for path, version in versions.items() if version and version < llvm.OLDEST]


@pytest.fixture
def usable(machine, monkeypatch) -> Path:
    """The LLVM library that the tests run on, with the user's own setting removed."""
    if machine.llvm_path is None:
        pytest.skip("runs on CUDA: no LLVM was looked for")
    monkeypatch.delenv(llvm.VARIABLE)
    return machine.llvm_path


def test_the_wheel_comes_before_the_system(usable, monkeypatch):
    monkeypatch.setattr(llvm, "_system_libraries", lambda: pytest.fail("looked at the system"))
    assert llvm.WHEEL in llvm.find().origin


def test_the_users_setting_comes_before_the_wheel(usable, monkeypatch, tmp_path):
    own = tmp_path / "libLLVM.so"
    own.symlink_to(usable)
    monkeypatch.setenv(llvm.VARIABLE, str(own))
    found = llvm.find()
    assert found.path == own and llvm.VARIABLE in found.origin


def test_a_library_states_the_version_that_its_wheel_claims(usable):
    assert llvm._probe(usable) == llvm.find().version


def test_without_a_wheel_the_first_usable_system_library_is_taken(usable, monkeypatch, tmp_path):
    without_wheel(monkeypatch)
    broken = tmp_path / "libLLVM-99.so"
    broken.write_text("not a library")
    monkeypatch.setattr(llvm, "_system_libraries", lambda: [broken, usable])
    assert llvm.find().path == usable


def test_system_libraries_are_tried_newest_first_without_the_old_ones(monkeypatch, tmp_path):
    names = ["libLLVM-14.so.1", "libLLVM-16.so.1", "libLLVM.so.19.1", "libLLVM.so"]
    for name in names:
        (tmp_path / name).touch()
    monkeypatch.setattr(llvm, "SYSTEM_PATTERNS", (str(tmp_path / "libLLVM*"),))
    monkeypatch.setattr(llvm, "_from_ldconfig", lambda: [])
    found = [path.name for path in llvm._system_libraries()]
    assert found == ["libLLVM.so.19.1", "libLLVM-16.so.1", "libLLVM.so"]


def test_no_llvm_at_all_says_what_to_install(usable, monkeypatch):
    without_wheel(monkeypatch)
    monkeypatch.setattr(llvm, "_system_libraries", lambda: [])
    assert f"pip install {llvm.WHEEL}" in refusal(llvm.find)


def test_homebrews_libraries_are_known_and_advised(usable, monkeypatch):
    for name, version in (("llvm/19.1.7", 19), ("llvm@17/17.0.6", 17)):
        path = Path(f"/opt/homebrew/Cellar/{name}/lib/libLLVM.dylib")
        assert llvm._version_in_name(path) == version
    without_wheel(monkeypatch)
    monkeypatch.setattr(llvm, "_system_libraries", lambda: [])
    monkeypatch.setattr(llvm, "sys", SimpleNamespace(platform="darwin"))
    message = refusal(llvm.find)
    assert "'brew install llvm'" in message and "pip install" not in message


def test_system_libraries_that_abort_dr_jit_are_refused(usable, monkeypatch):
    if not (libraries := too_old_libraries()):
        pytest.skip(f"there is no LLVM older than {llvm.OLDEST} here")
    for path in libraries:
        monkeypatch.setenv(llvm.VARIABLE, str(path))
        message = refusal(llvm.find)
        assert str(path) in message and f"version {llvm.OLDEST} or newer" in message


def test_a_library_without_the_version_call_is_too_old(usable, monkeypatch, tmp_path):
    """As LLVM 14 and 15, on machines that have neither: the probe's answer is "old"."""
    monkeypatch.setattr(llvm, "_PROBE", "print('old')")
    for name, expected in (("libLLVM-14.so.1", "is LLVM 14"), ("any.so", "is older than LLVM 16")):
        library = tmp_path / name
        library.touch()
        monkeypatch.setenv(llvm.VARIABLE, str(library))
        assert expected in refusal(llvm.find)


def test_a_setting_that_is_no_library_is_refused(usable, monkeypatch, tmp_path):
    text = tmp_path / "libLLVM.so"
    text.write_text("not a library")
    other = Path(sys.modules["_ctypes"].__file__)
    cases = [
        (tmp_path / "absent.so", "is not a file"),
        (tmp_path, "is not a file"),
        (text, "cannot be loaded"),
        (other, "is not an LLVM library"),
    ]
    for path, expected in cases:
        monkeypatch.setenv(llvm.VARIABLE, str(path))
        assert expected in refusal(llvm.find)


def test_auto_takes_the_gpu_only_where_one_works(machine):
    gpu, why_not = backend._find_gpu()
    assert machine.variant == ("cuda_ad_rgb" if gpu and not machine.left_out else "llvm_ad_rgb")
    assert bool(gpu) != bool(why_not)


def test_a_gpu_that_fails_is_no_gpu(monkeypatch):
    monkeypatch.setattr(backend.glob, "glob", lambda pattern: ["/dev/nvidia0"])
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    for code, expected in (
        ("raise AssertionError('cuInit failed')", "cuInit failed"),
        ("import os; os.abort()", "the NVIDIA driver crashed"),
    ):
        monkeypatch.setattr(backend, "_CUDA_PROBE", code)
        assert backend._find_gpu() == (None, expected)
        with monkeypatch.context() as patch:
            patch.setenv("CUDA_VISIBLE_DEVICES", "")
            told = backend._find_gpu()[1]
        assert told == f"{expected}; CUDA_VISIBLE_DEVICES='' may hide all cards"


@pytest.fixture
def card(usable, monkeypatch):
    """Has a card found that Dr.Jit ``takes`` or not, and ``said`` where a scene is loaded on it."""
    import drjit as dr
    import mitsuba as mi

    def found(takes: bool, said: str) -> None:
        def load(described):
            raise RuntimeError(said)

        own = mi.set_variant
        monkeypatch.setattr(backend, "_find_gpu", lambda: ("a card", ""))
        monkeypatch.setattr(dr, "has_backend", lambda which: takes or which == dr.JitBackend.LLVM)
        monkeypatch.setattr(mi, "set_variant", lambda name: name == "cuda_ad_rgb" or own(name))
        monkeypatch.setattr(mi, "load_dict", load)

    return found


@pytest.mark.parametrize("takes, told", [(False, "compute capability 7.5"), (True, "no OptiX!")])
def test_a_gpu_that_cannot_trace_rays_is_left_out(card, machine, takes, told):
    card(takes, "[optix.cpp]\nno OptiX!")
    found = backend.start("auto", machine.threads)
    assert (found.variant, found.device) == ("llvm_ad_rgb", machine.device)
    assert found.left_out.startswith("a card: ") and told in found.left_out
    message = refusal(backend.start, "cuda_ad_rgb")
    assert told in message and "use variant=llvm_ad_rgb or auto" in message
    assert backend.start("llvm_ad_rgb", machine.threads).left_out == ""


def test_a_full_card_is_not_left_out(card):
    card(True, "jit_malloc(): out of memory!")
    assert "the GPU's memory is full" in refusal(backend.start)


def test_a_gpu_that_is_left_out_is_told(machine, monkeypatch, capsys):
    left = replace(machine, variant="llvm_ad_rgb", left_out="a card: no OptiX")
    assert ("GPU", "left out: a card: no OptiX") in doctor._machine(left)
    monkeypatch.setattr(backend, "start", lambda *_: left)
    experiment.started([], SimpleNamespace(variant="auto", threads=0))
    told = "variant=llvm_ad_rgb, as the GPU cannot be used: a card: no OptiX\n"
    assert capsys.readouterr().err == told


def test_cuda_without_a_gpu_is_refused(monkeypatch):
    monkeypatch.setattr(backend, "_find_gpu", lambda: (None, "no NVIDIA GPU found"))
    message = refusal(backend.start, "cuda_ad_rgb")
    assert "no NVIDIA GPU found" in message and "variant=llvm_ad_rgb" in message


def test_an_unknown_variant_gives_the_nearest(monkeypatch):
    monkeypatch.setattr(backend, "_find_gpu", lambda: (None, "no NVIDIA GPU found"))
    assert "did you mean 'llvm_ad_rgb'?" in refusal(backend.start, "lvm_ad_rgb")
    assert "did you mean 'cuda_ad_rgb'?" in refusal(backend.start, "cuda_ad_rbg")


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_spectral"])
def test_a_variant_that_cannot_serve_is_refused(variant):
    message = refusal(backend.start, variant)
    assert "'_ad_rgb'" in message and "llvm_ad_rgb" in message


def test_a_negative_number_of_threads_is_refused():
    assert "threads=-1" in refusal(backend.start, "auto", -1)


def test_threads_are_set(machine):
    import drjit as dr

    try:
        assert backend.start(machine.variant, threads=1).threads == 1
        assert backend.start(machine.variant).threads == backend._every_thread(), "0: all"
    finally:
        dr.set_thread_count(machine.threads)


def test_an_llvm_that_was_loaded_before_is_taken_if_it_is_new_enough(usable, machine, monkeypatch):
    """As where drjit was imported before isas_cli."""
    import drjit as dr

    version = llvm.find().version
    other = llvm.Library(Path("/elsewhere/libLLVM.so"), "99.1.0", "newest system library")
    monkeypatch.setattr(llvm, "find", lambda: other)
    taken = backend.start("llvm_ad_rgb", machine.threads)
    assert (taken.llvm_path, taken.llvm_version) == (None, version)

    def none():
        raise InputError("no LLVM library")

    monkeypatch.setattr(llvm, "find", none)
    assert backend.start("llvm_ad_rgb", machine.threads).llvm_version == version
    monkeypatch.setattr(llvm, "find", lambda: other)
    monkeypatch.setattr(dr.detail, "llvm_version", lambda: (15, 0, 6))
    message = refusal(backend.start, "llvm_ad_rgb")
    assert "import isas_cli before drjit" in message and f"{llvm.VARIABLE}={other.path}" in message


def test_a_program_gets_back_what_it_had_set():
    """In a process of its own, which has other settings; also after a run that fails."""
    code = """
import isas_cli
import drjit as dr
import mitsuba as mi
from isas_cli.runtime import backend
mi.set_variant("llvm_ad_spectral")
dr.set_thread_count(2)
mi.file_resolver().prepend("/mine")
places = list(mi.file_resolver())
try:
    with backend.lent():
        backend.start("llvm_ad_rgb", 1)
        backend.look_beside("/a", "/b")
        assert list(mi.file_resolver()) == ["/b", "/a", *places]
        backend.look_beside("/c")
        assert list(mi.file_resolver()) == ["/c", *places]
        raise KeyError
except KeyError:
    pass
assert mi.variant() == "llvm_ad_spectral" and dr.thread_count() == 2
assert list(mi.file_resolver()) == places
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_every_module_can_be_imported_before_mitsuba_is_started(usable):
    """In a process of its own, where nothing has told Dr.Jit which LLVM to load."""
    code = """
import importlib, pathlib, sys
import isas_cli
from isas_cli.runtime import backend, llvm
root = pathlib.Path(isas_cli.__file__).parent
plugins = {"isas_cli.scene.phong", "isas_cli.rendering.emission"}
for path in sorted(root.rglob("*.py")):
    name = ".".join(path.relative_to(root.parent).with_suffix("").parts)
    if path.name != "__main__.py" and name not in plugins:
        importlib.import_module(name.removesuffix(".__init__"))
import mitsuba as mi
assert mi.variant() is None and not plugins & set(sys.modules)
machine = backend.start("llvm_ad_rgb")
assert plugins <= set(sys.modules)
assert machine.llvm_path == llvm.find().path
mapped = {line.split()[-1] for line in open("/proc/self/maps") if "libLLVM" in line}
assert {str(machine.llvm_path.resolve())} == mapped, mapped
assert mi.load_dict({"type": "phong"}) is not None
"""
    environment = {k: v for k, v in os.environ.items() if k != llvm.VARIABLE}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr


def test_every_variant_has_the_plugins(usable):
    """Also the second of a process, and the first again."""
    code = """
from isas_cli.runtime import backend
backend._check_name = lambda *_: None  # the only other one that every machine has
for variant in ("llvm_ad_rgb", "llvm_ad_spectral", "llvm_ad_rgb"):
    backend.start(variant)
    from isas_cli.rendering import volume
    from isas_cli.scene import scene_file
    import mitsuba as mi
    assert isinstance(mi.load_dict({"type": "phong"}), mi.BSDF)
    assert isinstance(mi.load_dict({"type": "emission"}), mi.Integrator)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_doctor_is_content_here(capsys):
    assert doctor.main() == 0
    printed = capsys.readouterr().out
    for word in ("mitsuba", "threads", "memory", "kernel cache", "denoiser", "gradient ok"):
        assert word in printed


def test_the_doctor_says_what_is_wrong(capsys, monkeypatch):
    monkeypatch.setattr(doctor, "gradient_difference", lambda: float("nan"))
    assert doctor.main() == 2
    assert "problem: the gradient of a test scene is wrong" in capsys.readouterr().out


def test_what_mitsuba_raises_is_a_problem_of_the_doctors(capsys, monkeypatch):
    def failing():
        raise RuntimeError("Could not\ninitialize OptiX!")

    monkeypatch.setattr(doctor, "gradient_difference", failing)
    assert doctor.main() == 2
    assert "problem: Could not initialize OptiX!\n" in capsys.readouterr().out


def test_the_doctor_reports_a_machine_without_llvm():
    environment = dict(os.environ, **{llvm.VARIABLE: "/absent/libLLVM.so"})
    code = "from isas_cli.cli import doctor; raise SystemExit(doctor.main('llvm_ad_rgb'))"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 2, done.stderr
    assert "problem: LLVM" not in done.stdout and "is not a file" in done.stdout
    assert "python" in done.stdout and "Traceback" not in done.stderr
