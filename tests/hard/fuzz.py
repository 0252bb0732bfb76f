"""Damaged and hostile input: one clear line each, never a traceback, a hang, or a file elsewhere.

Each input is made from a sound one by a random number generator that its number seeds: texts and
bytes cut off, repeated, exchanged, replaced by numbers that are none, by paths that lead out, by
tags that would run code. It goes to what reads it in `isas`, which may take it or refuse it with an
`IsasError`. A child process does the reading; what kills it or keeps it for 30 seconds is a finding
like a traceback, and another child goes on behind it.

    make fuzz                                            100,000 inputs
    .venv/bin/python tests/hard/fuzz.py --count 1000 --seed 3
    .venv/bin/python tests/hard/fuzz.py --seed 3 --only 4711     one of them again, its files kept
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import faulthandler
import json
import os
import random
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

HERE = Path(__file__).resolve()
sys.path.insert(0, str(HERE.parents[1] / "support"))
_SECONDS = 30
_NUMBERS = (
    *("nan", "inf", "-inf", "-1", "0", "1e999", "-1e-999", "1e38", "99999999999999999999", "0x10"),
    *("", "1,5", "null", "true", "[]", "{}", "'", '"', "\\", "ü", "\ufeff", "1e-45", "2147483648"),
)
_OWNED = "touch ../owned"
_TRICKS = (
    *("../../../../etc/passwd", "/dev/zero", "/proc/self/mem", ".", "..", "/", "~", "x" * 5000),
    *(
        "!!python/object/apply:os.system ['" + _OWNED + "']",
        "${oc.env:HOME}",
        "${scene}",
        "${",
        "$",
    ),
    *("!!python/name:os.system", "{a: &a [*a]}", "&x *x", "!include x", "{{", "%s%n", "../owned"),
    *("os.system", "subprocess.call", "isas_cli.runtime.allowed.named", "builtins.eval"),
)
_KEYS = (
    *("scene", "sampler", "loss", "prior", "estimator", "effects", "size", "seed", "threads"),
    *("budget.seconds", "budget.iterations", "budget.paths", "optimizer.lr", "optimizer.schedule"),
    *("scene.path", "scene.builder", "scene.unknowns", "scene.poses", "scene.arguments.resolution"),
    *("scene.targets", "scene.masks", "scene.max_depth", "sampler.floor", "sampler.refresh"),
    *("sampler._target_", "loss._target_", "estimator.batch", "target.spp", "frames.views"),
    *("effects.max_depth", "effects.light_samples", "effects.directions", "hydra.run.dir", "name"),
    *("variant", "tracker"),
    *(
        "evaluation.pixels",
        "optimizer.beta_1",
        "hydra.sweeper",
        "hydra.job.chdir",
        "optimizer.final",
    ),
)
_VALUES = (
    *("pottery", "uniform", "progress", "l2", "relative_l2", "smoothness", "plateau", "0.5", "10"),
    *("[1,2]", "{a:1}", '{"jar.bsdf.base_color.data": {"start": 0.5}}', "file", "tiny", "auto"),
)
SCENE = """<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="3"/></integrator>
  <emitter type="constant" id="sky"><rgb name="radiance" value="0.8"/></emitter>
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,1,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="6"/></film>
  </sensor>
  <shape type="sphere" id="thing"><float name="radius" value="0.8"/>
    <bsdf type="principled"><texture type="bitmap" name="base_color">
      <string name="filename" value="paint.png"/></texture><float name="roughness" value="0.4"/>
    </bsdf></shape>
  <shape type="obj" id="mesh"><string name="filename" value="mesh.obj"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.2, 0.3, 0.4"/></bsdf></shape>
  <shape type="ply" id="other"><string name="filename" value="mesh.ply"/></shape>
</scene>"""
CLOUD = (
    SCENE[: SCENE.index("  <shape")]
    + """  <shape type="cube" id="box"><bsdf type="null"/>
    <medium type="heterogeneous" name="interior">
      <volume type="gridvolume" name="sigma_t"><string name="filename" value="grid.vol"/></volume>
      <volume type="gridvolume" name="albedo"><string name="filename" value="grid.vol"/></volume>
    </medium></shape>
</scene>"""
)
# Photographs in each form that photo_sets makes → the files that are spoilt.
FORMS = {
    "transforms": ("transforms.json",),
    "blender": ("transforms_train.json", "view_0.png"),
    "ours": ("cameras.json",),
    "colmap": ("sparse/0/cameras.txt", "sparse/0/images.txt", "sparse/0/points3D.txt"),
    "neus": ("cameras_sphere.npz",),
    "llff": ("poses_bounds.npy",),
    "meshroom": ("cameras.sfm",),
    "openmvg": ("sfm_data.json",),
}
DENSITY = "box.interior_medium.sigma_t.data"
UNKNOWNS = {"thing.bsdf.base_color.data": 0.5, "mesh.bsdf.reflectance.value": 0.5}
OBJ = """v -1 -1 0
v 1 -1 0
v 1 1 0
v -1 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
f 1/1/1 2/2/1 3/3/1
f 1/1/1 3/3/1 4/4/1
"""


def ply() -> bytes:
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
    header += "".join(f"property float {name}\n" for name in ("x", "y", "z", "u", "v"))
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    vertices = struct.pack("<15f", 0, 0, 1, 0, 0, 1, 0, 1, 1, 0, 0, 1, 1, 0, 1)
    return header.encode() + vertices + struct.pack("<B3i", 3, 0, 1, 2)


# ------------------------------------ making inputs ------------------------------------


def damaged(rng: random.Random, data: bytes) -> bytes:
    """One to three changes."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        data = rng.choice(_CHANGES)(rng, data)
    return data


def _cut(rng, data):
    return data[: rng.randrange(len(data) + 1)]


def _flip(rng, data):
    made = bytearray(data)
    for _ in range(rng.choice((1, 4, 32)) if made else 0):
        made[rng.randrange(len(made))] = rng.randrange(256)
    return bytes(made)


def _drop(rng, data):
    start = rng.randrange(len(data) + 1)
    return data[:start] + data[start + rng.randrange(64) :]


def _repeat(rng, data):
    start = rng.randrange(len(data) + 1)
    part = data[start : start + rng.randrange(1, 64)]
    return data[:start] + part * rng.choice((2, 3, 1000)) + data[start:]


def _exchange(rng, data):
    a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    return data[b:] + data[a:b] + data[:a]


def _number(rng, data):
    """A number becomes another or none."""
    found = list(re.finditer(rb"-?\d+\.?\d*(e[+-]?\d+)?", data))
    if not found:
        return _flip(rng, data)
    where = rng.choice(found)
    return data[: where.start()] + rng.choice(_NUMBERS).encode() + data[where.end() :]


def _word(rng, data):
    """What stands between quotes, or behind a colon, becomes a trick."""
    found = list(re.finditer(rb'"([^"\n]*)"|: ([^\n]*)', data))
    if not found:
        return _repeat(rng, data)
    where = rng.choice(found)
    group = 1 if where.group(1) is not None else 2
    trick = rng.choice(_TRICKS + _NUMBERS).encode()
    return data[: where.start(group)] + trick + data[where.end(group) :]


def _nothing(rng, data):
    return b""


def _anything(rng, data):
    return rng.randbytes(rng.randrange(200))


def _swap_words(rng, data):
    """Two words change places: a file of the right form that says something else."""
    found = list(re.finditer(rb"[A-Za-z_]{3,}", data))
    if len(found) < 2:
        return _flip(rng, data)
    a, b = sorted(rng.sample(found, 2), key=lambda each: each.start())
    return data[: a.start()] + b[0] + data[a.end() : b.start()] + a[0] + data[b.end() :]


_CHANGES = (
    *(_cut, _flip, _drop, _repeat, _exchange, _number, _number, _number, _word, _word),
    *(_nothing, _anything, _swap_words, _swap_words),
)


def spoilt(rng: random.Random, path: Path) -> None:
    """The file at ``path``, changed, or something else of its name."""
    chance = rng.random()
    if chance < 0.94:
        path.write_bytes(damaged(rng, path.read_bytes()))
        return
    data = path.read_bytes()
    path.unlink()
    if chance < 0.96:
        path.mkdir()
    elif chance < 0.98:
        path.symlink_to(rng.choice((path.name, "/dev/null", "..", "nowhere")))
    elif chance < 0.99:
        path.write_bytes(data + b"\0" * (1 << 22))


# ------------------------------------ what reads them ------------------------------------


class Enough(Exception):
    """As far as a scene is read here."""


class Reader:
    """Sound files, and for each kind of input a function that spoils and reads one."""

    def __init__(self, folder: Path):
        """``folder``: of sound files, made here where there are none."""
        self.sound = folder
        if not (folder / "run").is_dir():
            self._make()

    def _make(self) -> None:
        import mitsuba as mi
        import numpy as np
        import photo_sets

        from isas_cli.runtime import images

        rng = np.random.default_rng(0)
        paint = rng.random((4, 4, 3)).astype(np.float32)
        self.sound.mkdir(parents=True)
        images.write_png(self.sound / "paint.png", (paint * 255).astype(np.uint8))
        images.write_exr(self.sound / "paint.exr", paint, [*"RGB"], {})
        (self.sound / "paint.pfm").write_bytes(b"PF\n4 4\n-1.0\n" + paint.tobytes())
        rgbe = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 4\n" + bytes(range(64))
        (self.sound / "paint.hdr").write_bytes(rgbe)
        grid = rng.uniform(0.1, 0.9, (2, 3, 4, 1)).astype(np.float32)
        mi.VolumeGrid(grid).write(str(self.sound / "grid.vol"))
        np.save(self.sound / "grid.npy", grid)
        (self.sound / "scene.xml").write_text(SCENE)
        (self.sound / "mesh.obj").write_text(OBJ)
        (self.sound / "mesh.ply").write_bytes(ply())
        for form in FORMS:
            self.sound.joinpath(form).mkdir()
            getattr(photo_sets, form)(photo_sets.Files(self.sound / form, photo_sets.POSES))
        # In a process that is gone when its record is read.
        command = [sys.executable, "-m", "isas_cli", "run", "scene=file"]
        command += [
            *(f"scene.path={self.sound / 'scene.xml'}", "sampler=uniform"),
            f"scene.unknowns={json.dumps({k: {'start': v} for k, v in UNKNOWNS.items()})}",
            *("estimator.batch=64", "budget.iterations=3", "evaluation.pixels=16", "target.spp=2"),
            *("evaluation.spp=2", "evaluation.count=2", "frames.views=0", "frames.snapshots=0"),
            *("report=false", f"hydra.run.dir={self.sound / 'run'}"),
        ]
        subprocess.run(command, check=True, capture_output=True)

    def scene(self, rng: random.Random, folder: Path, spoil: str | None = None) -> None:
        """A scene file, or what it names, up to where kernels would be compiled."""
        for name in ("scene.xml", "mesh.obj", "mesh.ply", "paint.png"):
            shutil.copy(self.sound / name, folder)
        spoilt(rng, folder / (spoil or "scene.xml"))
        self._assembled(folder / "scene.xml", UNKNOWNS)

    def _assembled(self, path: Path, starts: dict) -> None:
        from isas_cli.config.schema import SceneConfig, TargetConfig, UnknownConfig
        from isas_cli.engine import assemble

        def enough(problem) -> None:
            raise Enough

        unknowns = {key: UnknownConfig(start=value) for key, value in starts.items()}
        scene = SceneConfig(name="file", path=str(path), unknowns=unknowns)
        with contextlib.suppress(Enough):
            assemble.problem(scene, TargetConfig(), lambda done, total: None, check=enough)

    def mesh(self, rng: random.Random, folder: Path) -> None:
        self.scene(rng, folder, rng.choice(("mesh.obj", "mesh.ply")))

    def grid(self, rng: random.Random, folder: Path) -> None:
        """That of a medium, or what an unknown one starts from."""
        (folder / "scene.xml").write_text(CLOUD)
        for name in ("grid.vol", "grid.npy"):
            shutil.copy(self.sound / name, folder)
        shutil.copy(self.sound / "grid.vol", folder / "start.vol")
        spoil = rng.choice(("grid.vol", "grid.npy", "start.vol"))
        spoilt(rng, folder / spoil)
        start = "start.vol" if spoil == "grid.vol" else spoil
        self._assembled(folder / "scene.xml", {DENSITY: str(folder / start)})

    def camera(self, rng: random.Random, folder: Path) -> None:
        """Photographs and what says where they were taken, up to a scene of them."""
        from isas_cli.config.schema import PhotosConfig
        from isas_cli.scene import built
        from isas_cli.scene.photos import building, checks, photographs

        form = rng.choice(list(FORMS))
        shutil.copytree(self.sound / form, folder / form)
        spoilt(rng, folder / form / rng.choice(FORMS[form]))
        settings = PhotosConfig(path=str(folder / form), sphere=[0.0, 0.0, 0.0, 0.5])
        taken = photographs.load(settings)
        checks.warnings(checks.views(taken), taken)
        built.load(building.description(taken, None))

    def picture(self, rng: random.Random, folder: Path) -> None:
        from isas_cli.runtime import images

        name = rng.choice(("paint.png", "paint.exr", "paint.pfm", "paint.hdr"))
        shutil.copy(self.sound / name, folder)
        spoilt(rng, folder / name)
        # Under a name of another kind as well.
        path = folder / rng.choice((name, name, "x.png", "x.exr", "x.jpg", "x"))
        if (folder / name).exists():
            (folder / name).rename(path)
        rng.choice((images.read, images.read_mask))(path)

    def configuration(self, rng: random.Random, folder: Path) -> None:
        from isas_cli.config.compose import compose, instantiate, translate
        from isas_cli.engine import experiment

        settings = ["scene=pottery"] if rng.random() < 0.8 else []
        for _ in range(rng.choice((1, 1, 2, 3))):
            value = rng.choice(_VALUES + _TRICKS + _NUMBERS)
            text = f"{rng.choice(_KEYS)}={value}"
            if rng.random() < 0.3:
                text = damaged(rng, text.encode()).decode(errors="replace")
            settings.append(rng.choice(("", "", "", "", "+", "++", "~")) + text)
        cfg = compose(translate(settings))
        experiment.checked(cfg)
        for name in ("loss", "sampler", "estimator", "prior", "effects"):
            instantiate(cfg[name], name)

    def record(self, rng: random.Random, folder: Path) -> None:
        from isas_cli import records
        from isas_cli.engine import resumption
        from isas_cli.records.follow import Follower

        names = ("manifest.json", "config.yaml", "history.csv", "summary.json")
        self._run(rng, folder, names)
        run = records.load(folder / "run")
        run.keys, run.complete  # noqa: B018
        Follower(folder / "run").update()
        resumption.prepare(folder / "run", {"budget.iterations": 9})

    def checkpoint(self, rng: random.Random, folder: Path) -> None:
        from isas_cli import records
        from isas_cli.engine import resumption

        self._run(rng, folder, ("checkpoint/state.npz",))
        records.load(folder / "run").parameters()
        resumption.prepare(folder / "run", {"budget.iterations": 9})

    def _run(self, rng: random.Random, folder: Path, names: tuple[str, ...]) -> None:
        shutil.copytree(self.sound / "run", folder / "run")
        for name in rng.sample(names, rng.choice((1, 1, min(2, len(names))))):
            spoilt(rng, folder / "run" / name)


KINDS = ("scene", "mesh", "picture", "configuration", "record", "checkpoint", "grid", "camera")


def inputs(count: int, first: int = 0, only: str | None = None) -> list[tuple[int, str]]:
    """Numbers and kinds. ``only``: a kind, instead of all in turn."""
    return [(n, only or KINDS[n % len(KINDS)]) for n in range(first, first + count)]


def child(sound: Path, seed: int, asked: list[tuple[int, str]], work: Path) -> None:
    """Reads what is ``asked`` for, and prints ``number kind outcome`` of each before and after."""
    from isas_cli.runtime import backend
    from isas_cli.runtime.errors import IsasError

    backend.start(threads=1)
    reader = Reader(sound)
    out = os.fdopen(os.dup(1), "w")
    # What Mitsuba and OpenImageIO print of broken files is not what is asked for here.
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    for number, kind in asked:
        print(number, kind, "begun", file=out, flush=True)
        folder = work / "inside"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        os.chdir(folder)
        rng = random.Random(f"{seed} {number}")
        faulthandler.dump_traceback_later(_SECONDS, exit=True)
        try:
            getattr(reader, kind)(rng, folder)
            outcome = "taken"
        except IsasError:
            outcome = "refused"
        except BaseException as error:
            traceback.print_exc()
            frames = [f for f in traceback.extract_tb(error.__traceback__) if "isas" in f.filename]
            where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}"
            outcome = f"traceback: {where} {type(error).__name__} {' '.join(str(error).split())}"
        faulthandler.cancel_dump_traceback_later()
        os.chdir(work)
        if os.listdir(work) != ["inside"]:
            outcome = f"wrote {os.listdir(work)}"
        print(number, kind, outcome, file=out, flush=True)


def search(
    asked: list[tuple[int, str]], seed: int, sound: Path
) -> tuple[collections.Counter, list]:
    """Outcomes by kind, and findings: ``(number, kind, what, the child's last words)``."""
    outcomes, findings = collections.Counter(), []
    work = Path(tempfile.mkdtemp(prefix="isas-fuzz-"))
    try:
        while asked:
            command = [sys.executable, str(HERE), "--child", str(sound), "--seed", str(seed)]
            command += ["--work", str(work)]
            with open(work.with_suffix(".log"), "w+") as words:
                pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": words}
                with subprocess.Popen(command, **pipes, text=True) as process:
                    json.dump(asked, process.stdin)
                    process.stdin.close()
                    last = None
                    for line in process.stdout:
                        number, kind, outcome = line.rstrip("\n").split(" ", 2)
                        last = int(number), kind, outcome
                        if outcome != "begun":
                            outcomes[kind, outcome.partition(":")[0]] += 1
                            if outcome not in ("taken", "refused"):
                                findings.append((*last, ""))
                words.seek(0)
                said = words.read()
            if last is None:
                raise SystemExit(f"no input was read:\n{said[-3000:]}")
            if last[2] == "begun":
                outcomes[last[1], "died"] += 1
                findings.append((*last[:2], f"died: {process.returncode}", said[-3000:]))
            elif said and findings:
                findings[-1] = (*findings[-1][:3], said[-6000:])
            asked = asked[[number for number, _ in asked].index(last[0]) + 1 :]
            shutil.rmtree(work)
            work.mkdir()
    finally:
        shutil.rmtree(work, ignore_errors=True)
        work.with_suffix(".log").unlink(missing_ok=True)
    return outcomes, findings


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, metavar="NUMBER")
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child:
        child(chosen.child, chosen.seed, json.load(sys.stdin), chosen.work)
        return 0
    sound = Path(tempfile.mkdtemp(prefix="isas-sound-")) / "files"
    os.environ.setdefault("ISAS_CACHE_DIR", str(sound.parent / "cache"))
    if chosen.only is not None:
        work = Path(tempfile.mkdtemp(prefix="isas-fuzz-"))
        child(sound, chosen.seed, inputs(1, chosen.only, chosen.kind), work)
        print(f"files: {work}")
        return 0
    from isas_cli.runtime import backend

    backend.start()
    Reader(sound)
    asked = inputs(chosen.count, chosen.first, chosen.kind)
    outcomes, findings = search(asked, chosen.seed, sound)
    shutil.rmtree(sound.parent)
    for (kind, outcome), number in sorted(outcomes.items()):
        print(f"{kind:14} {outcome:10} {number:7}")
    for number, kind, what, said in findings:
        print(f"--- {number} {kind}: {what}\n{said}")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
