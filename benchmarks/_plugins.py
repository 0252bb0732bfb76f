"""Mitsuba's plugins, as they are installed, and a scene that shows each.

``SCENES``: XML by name: a plugin's, or a plugin's, a hyphen, and what stands beside it. What is on
trial has the id ``thing``. ``write`` puts them and the files that they name into a folder.

    python benchmarks/_plugins.py FOLDER
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from _plugin_scenes import SCENES

# Plugins without a scene, and why.
REASONS = {
    "blackbody": "a spectrum that RGB variants do not load",
    "blender": "made by Blender's exporter from memory, never from a file",
    "irregular": "a spectrum that RGB variants turn into a colour when they load it",
    "measured_polarized": "its files hold spectra, which RGB variants refuse",
    "regular": "a spectrum that RGB variants turn into a colour when they load it",
    "flat_sensor": "the loader of rays makes it, in a loop written by hand",
}
# Types whose plugins say how pictures are made, not what is in them.
ASIDE = {
    "Film": "says how pictures are stored",
    "Integrator": "says how light is followed",
    "ReconstructionFilter": "says how samples make pixels",
    "Sampler": "makes random numbers",
}


def subject(name: str) -> str:
    """The plugin that the scene ``name`` is about."""
    return name.partition("-")[0]


def installed() -> dict[str, str]:
    """Type of every plugin of this installation, by name: libraries, and classes in Python, whose
    type is that of the function that registers them."""
    import mitsuba as mi

    folder = Path(mi.__file__).parent
    manager = mi.PluginManager.instance()
    names = {
        file.stem for kind in ("so", "dll", "dylib") for file in folder.glob(f"plugins/*.{kind}")
    }
    found = {name: manager.plugin_type(name).name for name in sorted(names)}
    types = {kind.lower(): kind for kind in ("BSDF", "Emitter", "Film", "Integrator", "Medium")}
    types |= {"phase": "PhaseFunction", "sampler": "Sampler", "sensor": "Sensor", "shape": "Shape"}
    types |= {"texture": "Texture", "volume": "Volume", "mesh": "Shape"}
    for file in sorted(folder.glob("python/**/*.py")):
        text = file.read_text(encoding="utf-8")
        for kind, name in re.findall(r"mi\.register_(\w+)\(\s*['\"](\w+)['\"]", text):
            found[name] = types.get(kind, kind)
    return found


def unclassified(plugins: dict[str, str]) -> list[str]:
    """Those of ``plugins``, type by name, that have neither a scene nor a reason to have none."""
    known = {subject(name) for name in SCENES} | set(REASONS)
    return [name for name, kind in plugins.items() if name not in known and kind not in ASIDE]


def write(folder: Path) -> dict[str, Path]:
    """Each scene's file, by its name. Mitsuba has to be started."""
    import _plugin_files

    folder.mkdir(parents=True, exist_ok=True)
    _plugin_files.write(folder)
    paths = {name: folder / f"{name}.xml" for name in SCENES}
    for name, path in paths.items():
        path.write_text(SCENES[name], encoding="utf-8")
    return paths


if __name__ == "__main__":
    from isas_cli.runtime import backend

    backend.start()
    write(Path(sys.argv[1]))
