#!/usr/bin/env bash
# Looking at a parsed scene from Python makes Mitsuba accept its misspelt properties.
# One would guess: reading a property of mi.parser's nodes changes nothing; "alhpa", which
# mi.load_string refuses as unreferenced, is refused just as well afterwards.
# Seen with Mitsuba 3.9.1: after props["alhpa"], props.get("alhpa") or props.items() the scene loads
# without a word, with alpha's default. keys(), type(), as_string() and `in` do no such thing.
# Where: include/mitsuba/core/properties.h, get() and try_get() mark what they return as queried,
# the bit by which src/core/parser.cpp finds unused properties; src/core/python/properties.cpp
# calls them for the lookups of Python.
# Users of isas: a typo in a scene file would run, with another material. isas reads the fewest
# properties it can and sets them back with mark_queried(name, False).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
"${PYTHON:-python3}" -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip --disable-pip-version-check install --quiet mitsuba==3.9.1 drjit==1.5.0 numpy
cd "$folder"
cat > try.py <<'END'
import mitsuba as mi

mi.set_variant("scalar_rgb")
SCENE = """<scene version="3.0.0"><shape type="sphere"><bsdf type="roughconductor">
<float name="alhpa" value="0.3"/></bsdf></shape></scene>"""


def loads(look):
    """Whether the scene loads after ``look`` at the material's properties."""
    config = mi.parser.ParserConfig(mi.variant())
    state = mi.parser.parse_string(config, SCENE)
    for node in state.nodes:
        if node.props.plugin_name() == "roughconductor":
            look(node.props)
    mi.parser.transform_all(config, state)
    try:
        mi.parser.instantiate(config, state)
    except RuntimeError as error:
        if "unreferenced property" not in str(error):
            raise
        return False
    return True


def put_back(props):
    props.items()
    props.mark_queried("alhpa", False)


cases = {  # what is done, and whether Mitsuba 3.9.1 then loads the scene
    "nothing": (lambda props: None, False),
    'props["alhpa"]': (lambda props: props["alhpa"], True),
    'props.get("alhpa")': (lambda props: props.get("alhpa"), True),
    "props.items()": (lambda props: props.items(), True),
    "list(props)": (list, False),
    'props.type("alhpa")': (lambda props: props.type("alhpa"), False),
    "props.items(), then mark_queried(name, False)": (put_back, False),
}
print(f"mitsuba {mi.__version__}, {mi.variant()}")
for name, (look, described) in cases.items():
    seen = loads(look)
    print(f"{name}: expected refused, seen {'loaded' if seen else 'refused'}")
    if seen != described:
        raise SystemExit("changed: another answer than that of Mitsuba 3.9.1")
END
venv/bin/python try.py
