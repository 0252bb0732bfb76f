"""Composing the configuration with Hydra, and saying in one line what is wrong with it."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import yaml
from hydra import compose as hydra_compose
from hydra import initialize_config_dir, version
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, RangeSweep
from hydra.core.utils import JobRuntime
from hydra.errors import HydraException, OverrideParseException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

from ..runtime import allowed
from ..runtime.errors import InputError, nearest
from . import dropped, grammar, method, paths, presets, schema
from .grammar import literal, plain
from .method import options

# These take keys that no schema can list; '++' lets Hydra add them.
_UNKNOWNS = "scene.unknowns="
_NAMED = {_UNKNOWNS: schema.UnknownConfig, "scene.poses=": schema.PoseConfig}
_GROUPS = ("scene", "sampler", "estimator", "loss", "prior", "effects")
# Taken as they stand, whatever letters a path has.
_PATHS = (
    *("scene.path", "scene.external.command", "hydra.run.dir", "hydra.sweep.dir"),
    *(
        f"scene.photos.{name}"
        for name in ("path", "mesh", "cameras", "environment", "images", "masks")
    ),
)
# Of these several are several runs.
_SEVERAL = "scene.path", *(f"scene.photos.{name}" for name in ("path", "mesh", "environment"))
# Names of views in a list: numbers with _ or a point are names, too.
_VIEWS = "scene.photos.test", "scene.photos.without"
_ITEM = re.compile(r"""(['"]).*?(?<!\\)\1|(?<![^\[,])(\s*)(\d[\w.+-]*)(?=\s*(?:[\],]|$))""")
# Files in a list, or beside what is no file.
_FILES = "scene.targets", "scene.masks", "scene.photos.texture"
# photos.path is short for scene.photos.path.
_SHORT = "photos.", "external."
# Names of another renderer, which no schema can list.
_PARAMETERS = "scene.external.parameters="
# Of a scene's builder, which may have more than the scene's file says.
_ARGUMENT = "scene.arguments."
# The sampler that another goes around.
_BASE = "sampler.base"
# Choices within choices, as typed and as Hydra takes them.
_WITHIN = {_BASE: f"sampler@{_BASE}", "optimizer.filter": "filter@optimizer.filter"}
_CHOICES = ("sampler", "estimator", "loss", "prior", "effects", *_WITHIN)
# How Hydra says several names otherwise than with commas.
_SEVERAL_NAMES = re.compile(r"(choice|glob|shuffle|sort|tag)\(")
# Texts, which Hydra would take for numbers where they look like some.
_TEXTS = "name", "scene.name"
# Hydra's own, which are of jobs that Hydra runs.
_OF_JOBS = "env_set", "env_copy", "chdir"
_LONGEST = 2000  # of a message, which may quote what was typed
# What OmegaConf says of a value that does not fit; the second, of a number beyond all floats.
_REFUSALS = (OmegaConfBaseException, OverflowError)
_NO_WORDS = ("null", "true", "false", "nan", "inf")
_LABELS = tuple(f"{choice}.{label}" for choice in _CHOICES for label in ("name", "_target_"))


def translate(overrides: Iterable[str]) -> list[str]:
    """Overrides as typed → overrides as Hydra's grammar takes them.

    ``scene.unknowns={"a.b": {"start": 0.5}}`` is JSON, or as Python prints it, whose quoted keys
    Hydra's grammar does not know: it is rewritten with bare keys. Otherwise nothing can be added
    with '+', as what is not in the configuration has no effect, but for arguments of a builder, or
    removed with '~', as all that is in it is needed, but for unknowns, poses and what the scene
    takes by itself.
    """
    return [_translate(override) for override in presets.unpacked(list(overrides), _BASE)]


def _translate(override: str) -> str:
    bare = override.lstrip("+")
    if bare.startswith(_SHORT):
        bare = override = f"scene.{bare}"
    if bare.startswith(_PARAMETERS):
        return f"++{_PARAMETERS}{_unquoted(bare.removeprefix(_PARAMETERS))}"
    for setting, entry in _NAMED.items():
        if bare.startswith(setting):
            return _translate_named(bare, setting, entry)
    key, equals, value = bare.partition("=")
    for setting, entry in _NAMED.items():
        if key.startswith(setting.replace("=", ".")) and (inner := _inner(key, value, setting)):
            made = (_translate_named(setting + each, setting, entry) for each in inner)
            return f"++{setting}{','.join(each.partition('=')[2] for each in made)}"
    if key in _PATHS and value not in ("", "null") and value[0] not in "'\"":
        # A shell puts one's home in some places only.
        whole = Path(os.path.expanduser(value))
        several = key in _SEVERAL and "," in value and not paths.exists(whole)
        every = value.split(",") if several else [value]
        return f"{key}={','.join(literal(os.path.expanduser(each)) for each in every)}"
    if key in _FILES and "~" in value:  # a shell does not look into lists
        home = os.path.expanduser("~/")
        value = re.sub(r"(^|[\[,\s'\"])~/", lambda found: found.group(1) + home, value)
        bare = override = f"{key}={value}"
    if key in _VIEWS and value:
        bare = override = f"{key}={_ITEM.sub(_as_name, value)}"
    if key in _TEXTS and re.fullmatch(r"[\w.+-]+(,[\w.+-]+)*", value) and value != "null":
        return f"{key}={','.join(map(grammar.override, value.split(',')))}"
    if bare.startswith("hydra") or bare.startswith("~hydra"):
        return override
    if bare in ("~scene.method", "~scene.method=null"):  # the latter of a contestant
        return method.NONE
    if bare.startswith("~") and (removed := dropped.translated(bare)):
        return removed
    if bare.startswith("~"):
        raise InputError(
            f"{bare}: a setting cannot be removed, only changed: KEY=VALUE; unknowns can: "
            "~scene.unknowns.KEY, or all of them: ~scene.unknowns"
        )
    if not equals or not key:
        raise InputError(f"'{override}' is no setting: give KEY=VALUE, such as scene=pottery")
    if key.startswith("scene.method"):
        raise InputError(
            f"{bare}: is what the scene takes where nothing else is said: say sampler=NAME, "
            "estimator=NAME, …, or ~scene.method for none of it"
        )
    if key in _LABELS:
        raise InputError(
            f"{bare}: names a choice and makes none: say {key.rpartition('.')[0]}=NAME"
        )
    words = [] if _SEVERAL_NAMES.match(value) else map(str.strip, value.split(","))
    if key in (*_GROUPS, *_WITHIN) and not all(map(_may_be_a_name, words)):
        names = options(_WITHIN.get(key, key).partition("@")[0])
        raise InputError(f"{bare}: give one name; valid: {', '.join(names)}")
    if override.startswith("+") and key.startswith(_ARGUMENT):
        return f"++{bare}"  # one that has a default; the builder refuses others
    return f"{_WITHIN[key]}={value}" if key in _WITHIN else bare


def _as_name(found: re.Match) -> str:
    """One of ``_ITEM`` so that Hydra reads it as a name; quoted ones and whole numbers stay."""
    blank, word = found[2], found[3]
    return found[0] if word is None or word.isdigit() else f"{blank}{literal(word)}"


def _unquoted(text: str) -> str:
    """JSON as Hydra's grammar has it; what is none stays."""
    try:
        return literal(_read(text))
    except json.JSONDecodeError:
        return text


def _read(text: str):
    """JSON, or a dictionary as Python prints it. Raises JSONDecodeError for what is neither."""
    try:
        return json.loads(text, object_pairs_hook=_once)
    except json.JSONDecodeError:
        if text.startswith("{'"):
            with contextlib.suppress(ValueError, TypeError, SyntaxError, RecursionError):
                return json.loads(json.dumps(ast.literal_eval(text)))
        raise


def _once(pairs: list[tuple]) -> dict:
    """A JSON object, of which the last of two entries of a name would hide the first. Raises
    InputError for these."""
    found = dict(pairs)
    if len(found) < len(pairs):
        name = next(key for key, times in Counter(key for key, _ in pairs).items() if times > 1)
        raise InputError(f"'{name}' is given twice in one {{…}}")
    return found


def _inner(key: str, value: str, setting: str) -> list[str]:
    """A setting of one unknown or pose, as comparisons and ``--cfg job`` name it, in the form that
    takes several: ``scene.unknowns.KEY.lr=0.1``, of several values one each; none for what is
    none. A KEY has dots."""
    name, _, field = key.removeprefix(setting.replace("=", ".")).rpartition(".")
    fields, within = _NAMED[setting], setting == _UNKNOWNS and name.endswith(".blur")
    if within:
        name, fields = name.removesuffix(".blur"), schema.BlurConfig
    if not name or field not in [each.name for each in dataclasses.fields(fields)]:
        return []
    try:
        values = [json.loads(value)]
    except json.JSONDecodeError:
        try:
            read = OverridesParser.create().parse_override(f"x={value}")
            several = isinstance(read.value(), ChoiceSweep | RangeSweep)
            values = list(read.sweep_iterator()) if several else [read.value()]
        except (HydraException, ValueError):
            return []
        if read.is_sweep_override() and not several:
            return []
    entries = ({field: plain(each)} for each in values)
    return [json.dumps({name: {"blur": each} if within else each}) for each in entries]


def _may_be_a_name(word: str) -> bool:
    """Whether Hydra reads it as a word: not as a number, a list, or what stands for nothing."""
    return bool(re.fullmatch(r"[A-Za-z_][\w.()*-]{0,99}", word)) and word.lower() not in _NO_WORDS


def _translate_named(override: str, setting: str, entry_type: type) -> str:
    """``setting={name: entry, …}`` in JSON, each an ``entry_type``."""
    text = override[len(setting) :]
    try:
        parsed = _read(text)
    except json.JSONDecodeError as error:
        if re.match(r"\{\s*[\"']", text):
            raise InputError(f"{override}: no valid JSON: {error}") from error
        return "++" + override  # perhaps it is in Hydra's own notation
    entries = list(parsed.values()) if isinstance(parsed, dict) else []
    # Null: taken out.
    if not entries or not all(isinstance(entry, dict | None) for entry in entries):
        example = '{"key": {"start": 0.5}}: keys of the scene, each with a start and, if wanted, a '
        example += "range and an lr"
        if setting != _UNKNOWNS:
            example = '{"name": {"kind": "rotation", "objects": ["id"]}}: names of your own'
        raise InputError(f"{override}: give {example}")
    fields = [f.name for f in dataclasses.fields(entry_type)]
    for key, entry in parsed.items():
        if entry and isinstance(entry.get("start"), str):
            entry["start"] = os.path.expanduser(entry["start"])
        for name in entry or {}:
            if name not in fields:
                raise InputError(
                    f"{setting[:-1]}['{key}'].{name}: no such entry; {nearest(name, fields)}"
                )
        _check_entry(f"{setting[:-1]}['{key}']", entry_type, entry or {})
    return f"++{setting}{literal(parsed)}"


def _check_entry(where: str, entry_type: type, entry: dict) -> None:
    """Raises InputError for values of types that ``entry_type`` does not take."""
    blur = entry.get("blur")
    if blur is not None and not isinstance(blur, dict):
        raise InputError(f"{where}.blur={blur}: give {{start: …, end: …}}, widths in its unit")
    fields = [f.name for f in dataclasses.fields(schema.BlurConfig)]
    for name in blur or {}:
        if name not in fields:
            raise InputError(f"{where}.blur.{name}: no such entry; {nearest(name, fields)}")
    try:
        OmegaConf.merge(OmegaConf.structured(entry_type), entry)
    except _REFUSALS as error:
        key = getattr(error, "full_key", "")
        field = f".{key}" if key else ""
        raise InputError(f"{where}{field}: {str(error).splitlines()[0]}") from error


@contextlib.contextmanager
def initialized() -> Iterator[None]:
    """Within, Hydra composes as isas does. What a program that uses it as well had there is put
    back."""
    known, base = GlobalHydra.instance(), version.getbase()
    theirs, job = known.hydra, JobRuntime.instance().get("name")
    known.clear()
    try:
        with initialize_config_dir(schema.folder(), version_base="1.3", job_name="isas"):
            yield
    finally:
        known.hydra = theirs
        GlobalHydra.set_instance(known)
        JobRuntime.instance().set("name", job)
        if isinstance(base, version.Version):
            version.VersionBase.instance().setbase(base)


def compose(overrides: list[str], hydra: bool = False) -> DictConfig:
    """The composed configuration. Raises InputError, one line, when it cannot be."""
    schema.register()
    for group in (*_GROUPS, "filter"):
        options(group)  # of which no two may have one name
    overrides = complete(overrides)
    try:
        with initialized():
            cfg = hydra_compose("config", overrides, return_hydra_config=True)
            for name in _OF_JOBS:
                if cfg.hydra.job[name]:
                    raise InputError(
                        f"hydra.job.{name}: has no effect: set the environment, or the folder, "
                        "before isas begins"
                    )
            added = [o for o in overrides if o.startswith(f"++{_ARGUMENT}")]
            if added and cfg.scene.builder is None:
                raise InputError(f"{added[0][2:]}: the scene has no builder to take it")
            OmegaConf.resolve(cfg.scene)
            with open_dict(cfg):
                named(cfg, cfg.hydra.runtime.choices)
                if not hydra:
                    del cfg["hydra"]
    except (HydraException, *_REFUSALS, yaml.YAMLError, OSError, ValueError, KeyError) as error:
        text = explain(error, overrides)
        for typed, hydra_s in _WITHIN.items():
            text = text.replace(hydra_s, typed)
        raise InputError(text[:_LONGEST]) from error
    return dropped.settled(cfg)


def named(cfg: DictConfig, files: DictConfig) -> None:
    """Names each choice as its file, of ``files`` by group, is called. Raises InputError where that
    says another name: its runs would be taken for another choice's. A scene, known by its content,
    may have another."""
    if OmegaConf.is_missing(cfg.scene, "name"):
        cfg.scene.name = files.scene.removesuffix(".yaml")
    for choice in _CHOICES:
        file = files.get(_WITHIN.get(choice, choice))
        node = OmegaConf.select(cfg, choice)
        if file is None or node is None:  # such as the base of a sampler that goes around none
            continue
        name = file.removesuffix(".yaml")
        if (node.get("name") or name) != name:
            raise InputError(
                f"{choice}={name}: its file says name: {node.name}, or takes it from another: "
                f"write name: {name} there"
            )
        node.name = name


def complete(overrides: list[str]) -> list[str]:
    """Translated overrides with what the scene takes by itself, as Hydra composes them."""
    made = []
    for word in method.completed(dropped.expanded(overrides)):
        key, equals, value = word.partition("=")
        made.append(f"{_WITHIN[key]}={value}" if equals and key in _WITHIN else word)
    return made


def explain(error: Exception, overrides: list[str]) -> str:
    """One line for what Hydra or OmegaConf refuse about ``overrides``."""
    text = str(error)
    missing = re.search(r"Could not find '([^'/]+)/([^']+)'", text)
    if missing:
        group, name = missing.groups()
        within = (typed for typed, its in _WITHIN.items() if f"{its}={name}" in overrides)
        typed = next(within, group)
        return f"{typed}={name}: no such {group}; {nearest(name, options(group))}"
    unspecified = re.search(r"You must specify '(\w+)'", text)
    if unspecified:
        group = unspecified.group(1)
        return f"{group} is not given: say {group}=NAME; valid: {', '.join(options(group))}"
    unknown = re.search(r"Could not override '([^']+)'", text)
    if unknown:
        return _explain_key(unknown.group(1).split("@")[-1], overrides)
    size = re.search(r"Interpolation key 'scene\.sizes\.([^.]*)\.", text)
    if size:
        return f"size={size.group(1)}: {nearest(size.group(1), _sizes(overrides))}"
    if isinstance(error, OverrideParseException) and "Ambiguous" not in text:
        reason = " ".join(text.split("\n")[0].split())
        return (
            f"{error.override}: cannot be read ({reason}): put a value with any of "
            ", = : ( ) [ ] { } or quotes into quotes of its own: \"KEY='VALUE'\""
        )
    ambiguous = re.search(r"Ambiguous value for argument '([^']+)'", text)
    if ambiguous:
        return (
            f"{ambiguous.group(1)}: several values: add -m to sweep over them, "
            "or write a list as KEY=[A,B]"
        )
    merging = re.search(r"Error merging override (\S.*)", text)
    if merging:
        cause = " ".join(str(error.__cause__ or "does not fit").split("\n")[0].split())
        if "is not a ListConfig" in cause:
            cause = "must be a list: [A,B]"
        what = merging.group(1).lstrip("+")
        # As Hydra saw it, which is not as it was typed.
        named = next((setting for setting in _NAMED if what.startswith(setting)), None)
        return f"{named[:-1] if named else what}: {cause}"
    return " ".join(text.split("\nSee ")[0].split())


def _sizes(overrides: list[str]) -> list[str]:
    cfg = _raw([o for o in overrides if not o.startswith("size=")])
    return list(cfg.scene.sizes) if cfg is not None else []


def _explain_key(key: str, overrides: list[str]) -> str:
    cfg = _raw([o for o in overrides if o.split("=")[0].lstrip("+~").split("@")[-1] != key])
    *parents, last = key.split(".")
    node, found = cfg, []
    for parent in parents:
        if not isinstance(node, DictConfig) or parent not in node:
            last = parent
            break
        node = node._get_node(parent)
        found.append(parent)
    valid = [".".join([*found, str(k)]) for k in node] if isinstance(node, DictConfig) else []
    valid = [name for name in valid if name not in _LABELS]
    if within := [each for each in _WITHIN if each.rpartition(".")[2] == key]:
        return f"{key}: no such setting; say {within[0]}=NAME"
    return f"{key}: no such setting; {nearest('.'.join([*found, last]), valid)}"


def _raw(overrides: list[str]) -> DictConfig | None:
    """Composed without resolving anything, or None where that fails too."""
    try:
        with initialized():
            return hydra_compose("config", overrides)
    except (HydraException, OmegaConfBaseException):
        return None


def instantiate(node: DictConfig, where: str):
    """The object that a node's ``_target_`` names: a dataclass, its fields type-checked.

    ``name`` is the group option's own label and is not passed on. A field may be such a node
    again. Raises InputError naming the field for a value of the wrong type; the dataclass itself
    checks ranges.
    """
    plain = OmegaConf.to_container(node, resolve=True)
    target = allowed.named(plain.pop("_target_", ""), "isas_cli", f"{where}._target_")
    if not (isinstance(target, type) and dataclasses.is_dataclass(target)):
        raise InputError(f"{where}._target_={node._target_}: is no choice of settings")
    plain.pop("name", None)
    inner = [key for key, value in plain.items() if isinstance(value, dict) and "_target_" in value]
    parts = {key: instantiate(OmegaConf.create(plain.pop(key)), f"{where}.{key}") for key in inner}
    try:
        fields = OmegaConf.merge(_writable(OmegaConf.structured(target)), plain)
        for key, part in parts.items():
            fields[key] = part
        return OmegaConf.to_object(fields)
    except InputError as error:
        text = str(error)
        # A class that may be such a choice or another's names its fields as if at the top.
        if not text.startswith(where):
            text = text.replace(where.split(".")[0], where, 1)
        raise InputError(text) from error
    except _REFUSALS as error:
        message, key = str(error).split("\n")[0], getattr(error, "full_key", "")
        field = f"{where}.{key}" if key else where
        raise InputError(f"{field}: {message}") from error


def _writable(node: DictConfig) -> DictConfig:
    """Settings are frozen, which OmegaConf takes for values that cannot be set even once."""
    OmegaConf.set_readonly(node, None)
    for key in node:
        if isinstance(inner := node._get_node(key), DictConfig) and not inner._is_none():
            _writable(inner)
    return node
