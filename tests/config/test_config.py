"""The YAML files: each composes, instantiates, and says what the code says."""

import dataclasses
import importlib
import inspect
import re
import shlex
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from isas_cli.config import grammar, schema
from isas_cli.config.compose import compose, instantiate, options, translate
from isas_cli.runtime.errors import InputError

GROUPS = ("sampler", "estimator", "loss", "prior", "filter")
# Those that need a file, or another program.
GIVEN = ("file", "external", "photos", "chessboard")
SCENES = [name for name in options("scene") if name not in GIVEN]


def typed(*overrides: str) -> schema.Config:
    return OmegaConf.to_object(compose(translate(overrides)))


CHOICES = [(group, name) for group in GROUPS for name in options(group)]


@pytest.mark.parametrize("group, name", [*CHOICES, ("effects", "auto")])
def test_choices_instantiate_and_agree_with_their_classes(group, name):
    where = "optimizer.filter" if group == "filter" else group
    node = OmegaConf.select(compose(translate(["scene=pottery", f"{where}={name}"])), where)
    made = instantiate(node, where)
    default = type(made)()
    assert made == default, "the YAML says something else than the class"
    assert node.name == name and (group != "filter" or made.name == name)
    for key in set(node) - {"name", "_target_"}:
        assert hasattr(default, key)


@pytest.mark.parametrize("group", [*GROUPS, "effects", "scene"])
def test_every_choice_says_what_it_is(group):
    for name in options(group):
        path = Path(schema.folder()) / group / f"{name}.yaml"
        node = OmegaConf.load(path)
        assert node.name == name
        assert path.read_text().startswith("# ") or node.description


@pytest.mark.parametrize("name", SCENES)
def test_scenes_compose_at_each_size(name):
    listed = OmegaConf.load(Path(schema.folder()) / "scene" / f"{name}.yaml")
    assert list(listed.sizes) == ["tiny", "default", "paper"]
    scene = typed(f"scene={name}", "size=tiny").scene
    assert scene.unknowns
    module, _, function = scene.builder.rpartition(".")
    builder = getattr(importlib.import_module(module), function)
    for size, values in scene.sizes.items():
        # Composed once: Hydra's part is the same for each size, and takes most of the time.
        made = OmegaConf.create({"size": size, "scene": listed})
        arguments = OmegaConf.to_container(made, resolve=True)["scene"]["arguments"]
        assert arguments and arguments.items() <= values.items()
        assert set(arguments) == set(inspect.signature(builder).parameters)
        assert size != "tiny" or arguments == scene.arguments


def test_a_setting_has_one_default():
    """The schema's: config.yaml makes choices, and repeats no value."""
    listed = OmegaConf.load(Path(schema.folder()) / "config.yaml")
    assert set(listed) == {"defaults", "name", "hydra"}
    made = typed("scene=pottery")
    for field in dataclasses.fields(schema.Config):
        value = getattr(made, field.name)
        if field.name == "optimizer":  # which holds a choice
            value = dataclasses.replace(value, filter={})
        if field.name != "scene" and dataclasses.is_dataclass(value):
            assert value == type(value)()


@pytest.mark.parametrize(
    "override", ["optimizer.mask_updates=false", "estimator.batch=77", "budget.paths=1e6"]
)
def test_overrides_arrive(override):
    key, _, text = override.partition("=")
    value = typed("scene=pottery", override)
    for part in key.split("."):
        value = value[part] if isinstance(value, dict) else getattr(value, part)
    assert value == type(value)(text == "true" if text in ("true", "false") else float(text))


NAMES = ["view_0.exr", "a/000.jpg", "image (1).jpg", "é.png", "a&b.png", "20240101_120000", "1e5"]
NAMES += ["null", "it's.png", "a,b.png", "a b/$c.png", "[1].png", "-1", "1.", "TRUE", "x=y.png"]


@pytest.mark.parametrize("name", NAMES)
def test_a_list_that_is_advised_can_be_typed(name):
    """In a shell, whatever names are in it."""
    (word,) = shlex.split(grammar.listed("photos.without", ["first.png", name]))
    found = compose(translate(["scene=photos", word])).scene.photos.without
    assert list(found) == ["first.png", name]


@pytest.mark.parametrize("name", ["20240101_120000", "1e5", "12.50", "0001", "17"])
@pytest.mark.parametrize("setting", ["photos.test", "scene.photos.without"])
def test_views_are_called_by_numbers(setting, name):
    """As Android calls pictures, without quotes."""

    def found(value: str):
        photos = compose(translate(["scene=photos", f"{setting}={value}"])).scene.photos
        return photos[setting.rpartition(".")[2]]

    assert [str(each) for each in found(f"[first.png, {name}]")] == ["first.png", name]
    if setting == "photos.test":
        assert (str(found(name)), found("3"), found("null")) == (name, 3, None)


@pytest.mark.parametrize("name", ["12e4567", "2024_05_01", "1e5", "0001", "-1", "true", "mine"])
def test_a_run_is_called_as_it_is_typed(name):
    assert typed("scene=pottery", f"name={name}").name == name
    several = translate([f"name={name},1_0"])
    (override,) = OverridesParser.create().parse_overrides(several)
    assert list(map(grammar.plain, override.sweep_iterator())) == [name, "1_0"]


def test_a_long_list_says_that_it_is_longer():
    advice = grammar.listed("photos.without", [f"view_{n}.exr" for n in range(11)])
    assert advice.endswith(",view_7.exr]' and 3 more")


# Read by the command line, by the composition, or by the file itself.
ELSEWHERE = {"size", "name", "sizes", "description"}


def test_runs_that_begin_together_have_names_of_their_own():
    assert len({typed("scene=dodoco").name for _ in range(3)}) == 3


def test_every_field_is_read_somewhere():
    """Outside of the schema's files, which check it."""
    kinds = [
        each
        for each in vars(schema).values()
        if dataclasses.is_dataclass(each) and each.__module__.startswith("isas_cli.config")
    ]
    own = {Path(inspect.getfile(kind)) for kind in kinds}
    assert {path.name for path in own} == {"schema.py", "photographs.py"}
    package = Path(schema.__file__).parents[1]
    sources = [path.read_text() for path in package.rglob("*.py") if path not in own]
    for kind in kinds:
        for field in dataclasses.fields(kind):
            # Methods of others have such names, too.
            read = re.compile(rf"\.{field.name}\b(?!\()")
            used = any(map(read.search, sources))
            assert used or field.name in ELSEWHERE, f"{kind.__name__}.{field.name} has no effect"


def test_unknowns_in_json_and_in_hydras_notation():
    for text in (
        '{"a.b[0].data": {"start": [0.1, 0.2], "range": [0, 1]}, "c d": {"lr": 0.5}}',
        "{'a.b[0].data': {'start': [0.1, 0.2], 'range': (0, 1)}, 'c d': {'lr': 0.5}}",
        "{a.b\\[0\\].data: {start: [0.1, 0.2], range: [0, 1]}, c d: {lr: 0.5}}",
    ):
        unknowns = typed("scene=file", "scene.path=x.xml", f"scene.unknowns={text}").scene.unknowns
        assert unknowns == {
            "a.b[0].data": schema.UnknownConfig(start=[0.1, 0.2], range=[0.0, 1.0]),
            "c d": schema.UnknownConfig(lr=0.5),
        }


KEY = "jar.bsdf.base_color.data"


def test_a_setting_of_one_unknown_as_comparisons_name_it():
    usual = typed("scene=pottery").scene.unknowns[KEY]
    for field, value in (("lr", 0.05), ("range", [0.1, 0.9]), ("start", "a.png")):
        text = f"scene.unknowns.{KEY}.{field}={value}".replace(" ", "")
        found = typed("scene=pottery", text).scene.unknowns[KEY]
        assert found == dataclasses.replace(usual, **{field: value})
    (made,) = translate([f"scene.unknowns.{KEY}.blur.end=0.1"])
    assert made == translate([f'scene.unknowns={{"{KEY}": {{"blur": {{"end": 0.1}}}}}}'])[0]
    for text, value in ((".5", 0.5), ("'my start.png'", "my start.png"), ("[.1,.2,.3]", None)):
        found = typed("scene=pottery", f"scene.unknowns.{KEY}.start={text}").scene.unknowns[KEY]
        assert found.start == (value or [0.1, 0.2, 0.3])
    (several,) = translate([f"scene.unknowns.{KEY}.lr=0.1,0.2"])
    one, other = (translate([f"scene.unknowns.{KEY}.lr={lr}"])[0] for lr in (0.1, 0.2))
    assert several == f"{one},{other.partition('=')[2]}"
    ranged, named = (translate([f"scene.unknowns.{KEY}.lr={x}"]) for x in ("range(1,3)", "1,2"))
    assert ranged == named
    width = translate([f"scene.unknowns.{KEY}.blur={{start:1,end:0.1}}"])
    whole = '{"%s": {"blur": {"start": 1, "end": 0.1}}}' % KEY
    assert width == translate([f"scene.unknowns={whole}"])
    with pytest.raises(InputError, match="no such setting"):
        typed("scene=pottery", f"scene.unknowns.{KEY}.rate=0.05")


def test_a_slip_in_json_of_several_lines_is_one_in_json():
    with pytest.raises(InputError, match="no valid JSON"):
        translate(['scene.unknowns={\n  "a": {"start": 1},\n}'])
    with pytest.raises(InputError, match="no valid JSON"):
        translate(["scene.unknowns={'a': {'start': float32(0.5)}}"])


def test_a_path_may_be_none_or_several():
    photos = ["scene=photos", "photos.path=chessboard"]
    assert typed(*photos, "photos.environment=null").scene.photos.environment is None
    home = str(Path.home())
    assert translate(["photos.path=a,~/b c"]) == [f"scene.photos.path='a','{home}/b c'"]
    assert translate(["hydra.run.dir=a,b"]) == ["hydra.run.dir='a,b'"]


def test_an_argument_that_has_a_default_can_be_added():
    found = typed("scene=pottery", "+scene.arguments.extra=3", "+scene.arguments.views=2")
    assert (found.scene.arguments["extra"], found.scene.arguments["views"]) == (3, 2)


def test_start_may_be_a_file():
    text = 'scene.unknowns={"a": {"start": "it\'s, a \\\\ file.png"}}'
    unknowns = typed("scene=file", "scene.path=x.xml", text).scene.unknowns
    assert unknowns["a"].start == "it's, a \\ file.png"


@pytest.mark.parametrize(
    "path", ["a.xml", "a b.xml", "it's.xml", "a=b,c(d)[e]{f}.xml", "a\\b\\", "ä:#.xml"]
)
def test_paths_are_taken_as_they_stand(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path(path).touch()
    assert typed("scene=file", f"scene.path={path}").scene.path == path


def test_quoted_paths_are_hydras():
    assert typed("scene=file", "scene.path='a b.xml'").scene.path == "a b.xml"


def test_instantiating_names_the_field_of_a_wrong_type():
    cfg = compose(["scene=pottery", "sampler=ours"])
    cfg.sampler.stage1.spp = "many"
    with pytest.raises(InputError, match="sampler.stage1.spp: .*many"):
        instantiate(cfg.sampler, "sampler")
