"""Memory of a run against the size of its film, up to the papers' 16 million pixels.

`earth` with r × r pixels and half as many texels, 65,536 drawn pixels a step, targets rendered anew
with few paths (which does not change what they take). A process each; the peak of what it holds,
less that of the same run at size=tiny (interpreter, libraries, compiled kernels, a step's lanes),
over the bytes of its targets and texture in single precision. Host: the process's largest resident
set, on a CPU with Dr.Jit's share in it; device: the watermark of Dr.Jit's allocator on a card.
Writes results/memory.csv, a row a size.

    .venv/bin/python benchmarks/memory.py [--sizes 1024 2048 4096]
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import _contest
import pages
import pandas

RESULTS = Path(__file__).parent / "results" / "memory.csv"
SETTINGS = ["scene=earth", "budget.iterations=20", "target.spp=4", "estimator.batch=65536"]
SETTINGS += ["evaluation.count=2", *_contest.QUIET]


def child(arguments: list[str]) -> None:
    """One run in this process; prints its device and its peaks in bytes."""
    import drjit as dr

    from isas_cli.cli.app import main as isas
    from isas_cli.runtime import backend

    sys.argv = ["isas", "run", *SETTINGS, *arguments]
    code = isas()
    peak = {"host": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024}
    if not code and backend.start().variant.startswith("cuda"):
        peak["device"] = dr.detail.malloc_watermark(dr.JitBackend.CUDA)
    print("\n" + json.dumps(peak | {"card": backend.start().device}))
    sys.exit(code)


def peaks(arguments: list[str]) -> dict:
    with tempfile.TemporaryDirectory(prefix="isas-memory-") as folder:
        command = [sys.executable, __file__, "--child", *arguments, f"hydra.run.dir={folder}/run"]
        given = {**os.environ, "ISAS_CACHE_DIR": folder}  # targets are rendered, not read
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=given)
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", type=int, default=[1024, 2048, 4096])
    parser.add_argument("--sampler", default="uniform")
    chosen = parser.parse_args()
    sampler = f"sampler={chosen.sampler}"
    base = peaks(["size=tiny", sampler])
    rows = []
    for size in chosen.sizes:
        own = [f"scene.arguments.resolution={size}", f"scene.arguments.texture={size}", sampler]
        found, held = peaks(own), (size * size + size * size // 2) * 12
        row = {"pixels": size * size, "held_mb": held / 1e6, "sampler": chosen.sampler}
        for where in ("host", "device"):
            if where in found:
                more = found[where] - base[where]
                row |= {f"{where}_mb": more / 1e6, f"{where}_times": more / held}
        row |= {"card": found["card"], "day": datetime.date.today().isoformat()}
        rows.append(row)
        print(pandas.DataFrame([row]).to_string(index=False), flush=True)
    _contest.write(RESULTS, pandas.DataFrame(rows), ("pixels", "sampler", "card"))
    pages.write()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2:])
    else:
        main()
