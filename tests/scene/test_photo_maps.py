"""The object's base colour from a file, and maps of what its surface is: what is unknown, where it
lies, what cannot be."""

import mitsuba as mi
import numpy as np
import OpenImageIO as oiio
import photo_sets
import plates
import pytest
from photo_sets import POSES, Files
from PIL import Image

from isas_cli.config import schema
from isas_cli.config.compose import compose, translate
from isas_cli.engine import assemble
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime import backend, images, streams
from isas_cli.runtime.errors import InputError
from isas_cli.scene import export
from isas_cli.scene.photos import photographs

BRDF = "object.bsdf.brdf_0"
# Of two rows: red, green; blue, white.
FOUR = np.array([[[200, 30, 30], [30, 200, 30]], [[30, 30, 200], [220, 220, 220]]], np.uint8)


@pytest.fixture
def shown(tmp_path) -> list[str]:
    """A set whose object is a plate with texture coordinates, and a file for its base colour."""
    photo_sets.transforms(Files(tmp_path, POSES))
    plates.obj(tmp_path / "plate.obj")
    Image.fromarray(FOUR).save(tmp_path / "four.png")
    images.write_exr(tmp_path / "sky.exr", np.ones((16, 32, 3), np.float32), [*"RGB"], {})
    lines = [x for x in (tmp_path / "plate.obj").read_text().splitlines() if x[:2] != "vt"]
    bare = [x if x[0] != "f" else "f " + " ".join(y[0] for y in x.split()[1:]) for x in lines]
    (tmp_path / "bare.obj").write_text("\n".join(bare))
    return ["scene=photos", f"photos.path={tmp_path}", f"photos.mesh={tmp_path / 'plate.obj'}"]


def built(settings: list[str]):
    cfg = schema.typed(compose(translate(settings))).scene
    return cfg, *assemble.bare(cfg)[:2]


def file(shown: list[str], name: str) -> str:
    return shown[1].removeprefix("photos.path=") + f"/{name}"


def test_the_first_row_of_the_picture_is_the_highest(tmp_path, shown):
    """Of a plate seen upright, whose v goes up and u to the right, as Mitsuba's own reader of OBJ
    files has it."""
    Image.fromarray(FOUR).save(tmp_path / "four.png")
    mesh = plates.obj(tmp_path / "plate.obj")
    true = plates.laid(images.srgb_decode(FOUR / 255))
    material = {"type": "principled", "base_color": true, "roughness": 0.5}
    settings = plates.written(tmp_path, material, mesh, eyes=[(0, 0, 2.5), (0.5, 0.4, 2.4)])
    settings += ["scene=photos", f"photos.mesh={mesh}", f"photos.texture={tmp_path / 'four.png'}"]
    _, made, taken = built([*settings, "photos.roughness=true"])
    np.testing.assert_allclose(taken.colour, images.srgb_decode(FOUR / 255), atol=1e-6)
    found = Renderer(made).range(0, made.views.total, 256, lambda s: streams.seed(1, s, "frame"))
    width, height = plates.SIZE
    found = found.reshape(2, height, width, 3)
    for number, photograph in enumerate(taken.shown):
        apart = np.abs(found[number] - photograph.image).mean()
        over = np.abs(found[number][::-1] - photograph.image).mean()
        assert apart < 0.03 < 0.1 < over, (apart, over)
    corner = taken.shown[0].image[height // 2 - 10, width // 2 - 10]
    assert corner[0] > 3 * corner[1]  # red


@pytest.mark.parametrize(
    "settings, wanted",
    [
        ([], {f"{BRDF}.base_color.data": (8, 8, 3), "sky.data": (4, 8, 3)}),
        (["texture"], {"sky.data": (4, 8, 3)}),
        (["texture", "sky", "photos.roughness=true"], {f"{BRDF}.roughness.value": (1,)}),
        (["texture", "sky", "photos.metallic=true"], {f"{BRDF}.metallic.value": (1,)}),
        (["texture", "sky", "photos.roughness=map"], {f"{BRDF}.roughness.data": (256, 256, 1)}),
        (
            ["sky", "photos.roughness=map", "photos.texels=4"],
            {f"{BRDF}.base_color.data": (8, 8, 3), f"{BRDF}.roughness.data": (4, 4, 1)},
        ),
        (
            ["sky", "photos.roughness=map", "photos.metallic=map"],
            {
                f"{BRDF}.base_color.data": (8, 8, 3),
                f"{BRDF}.roughness.data": (8, 8, 1),
                f"{BRDF}.metallic.data": (8, 8, 1),
            },
        ),
        (
            ["sky", "photos.normals=map", "photos.roughness=true"],
            {
                f"{BRDF}.nested_bsdf.base_color.data": (8, 8, 3),
                f"{BRDF}.nested_bsdf.roughness.value": (1,),
                f"{BRDF}.normalmap.data": (8, 8, 3),
            },
        ),
        # What one names oneself takes the colour's and the light's place, not that of the rest.
        (
            ["texture", "photos.metallic=true", 'scene.unknowns={"sky.data": {"start": 2}}'],
            {"sky.data": (4, 8, 3), f"{BRDF}.metallic.value": (1,)},
        ),
    ],
)
def test_what_is_unknown(shown, settings, wanted):
    files = {"texture": "photos.texture=" + file(shown, "four.png")}
    files["sky"] = "photos.environment=" + file(shown, "sky.exr")
    settings = [files.get(each, each) for each in settings]
    light = [] if files["sky"] in settings else ["photos.sky=4"]
    _, made, _ = built([*shown, "photos.texture=8", *light, *settings])
    assert {u.key: u.start.shape for u in made.unknowns} == wanted
    for unknown in made.unknowns:
        if "normalmap" in unknown.key:
            np.testing.assert_array_equal(unknown.start, np.broadcast_to([0.5, 0.5, 1], (8, 8, 3)))


@pytest.mark.parametrize(
    "settings, told",
    [
        (["photos.texture=gone.png"], "photos.texture=gone.png: no such picture file; a number is"),
        (
            ["photos.texture={}/plate.obj"],
            "photos.texture=.*plate.obj: cannot be read as a picture",
        ),
        (["photos.texture={}/sky.exr", "photos.mesh={}/bare.obj"], "has no texture coordinates"),
        (["photos.texture={}/bright.exr"], "holds values from 0 to 3: a base colour lies between"),
        (
            ["photos.roughness=map", "photos.mesh={}/bare.obj"],
            "photos.roughness=map: .*bare.obj has no texture coord.*or take photos.roughness=true",
        ),
        (["photos.normals=map", "photos.mesh={}/bare.obj"], "unwrap it$"),
        (
            ["photos.texture={}/four.png", "photos.environment={}/sky.exr"],
            "four.png and photos.environment=.* nothing else is unknown: photos",
        ),
        (["photos.texels=4"], "photos.texels=4: of maps, and none is asked for"),
        (["photos.texture=0"], "photos.texture=0: at least 1"),
        (["photos.texture=2.5"], "photos.texture=2.5: texels a side, such as 256, or the picture"),
        (["photos.texture=true"], "photos.texture=True: texels a side"),
        (["photos.roughness=yes_please"], "photos.roughness=yes_please: valid: false, true, map"),
        (["photos.metallic=1"], "photos.metallic=1: valid: false, true, map"),
        (["photos.normals=true"], "photos.normals=True: valid: false, map"),
    ],
)
def test_what_cannot_be_is_one_line(shown, settings, told):
    folder = shown[1].removeprefix("photos.path=")
    bright = np.zeros((4, 4, 3), np.float32)
    bright[0, 0] = 3
    images.write_exr(f"{folder}/bright.exr", bright, [*"RGB"], {})
    with pytest.raises(InputError, match=told) as error:
        built([*shown, *(each.format(folder) for each in settings)])
    assert "\n" not in str(error.value)


def test_what_images_hardly_tell_apart_is_said_once(shown):
    """With what stays as it is."""
    settings = ["photos.texture=8", "photos.roughness=map", "photos.metallic=map"]
    (told,) = [w for w in built([*shown, *settings])[1].warnings if "images hardly tell" in w]
    assert "metallic from base colour, roughness from light, which are unknown together" in told
    assert told.endswith("fixed: normals (the mesh's)") and "photos.texture=FILE" in told
    bare = f"photos.mesh={file(shown, 'bare.obj')}"
    (told,) = [
        w for w in built([*shown, bare, "photos.metallic=true"])[1].warnings if " hardly tell" in w
    ]
    assert "photos.texture" not in told, "which a mesh without texture coordinates cannot take"
    known = ["photos.texture=" + file(shown, "four.png"), "photos.normals=map"]
    (told,) = [w for w in built([*shown, *known])[1].warnings if "images hardly tell" in w]
    assert "tell normals from light" in told and "base colour (" in told and "four.png" in told
    assert "roughness (0.5), metallic (0)" in told
    lit = "photos.environment=" + file(shown, "sky.exr")
    warnings = built([*shown, *known, lit, "photos.roughness=map"])[1].warnings
    assert not any("images hardly tell" in each for each in warnings)


def test_maps_that_share_texels_are_said_in_one_line(shown, tmp_path):
    """Both triangles of the plate on the same half of the picture."""
    text = (tmp_path / "plate.obj").read_text().replace("f 1/1 3/3 4/4", "f 1/1 3/2 4/3")
    (tmp_path / "plate.obj").write_text(text)
    warnings = built([*shown, "photos.texture=8", "photos.roughness=map"])[1].warnings
    (told,) = [each for each in warnings if "a compromise there" in each]
    assert f"'{BRDF}.base_color.data', '{BRDF}.roughness.data' are a compromise there" in told


def test_one_picture_on_several_materials(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES))
    Image.fromarray(FOUR).save(tmp_path / "four.png")
    plate = plates.obj(tmp_path / "plate.obj").read_text().splitlines()
    settings = {"path": str(tmp_path), "mesh": str(tmp_path / "plate.obj")}
    settings |= {"texture": str(tmp_path / "four.png"), "roughness": True}
    for last, number in (("f 1/1 3/3 4/4", 0), ("f 1/1 3/2 4/3", 1)):
        lines = [*plate[:-2], "usemtl a", plate[-2], "usemtl b", last]
        (tmp_path / "plate.obj").write_text("\n".join(lines))
        taken = photographs.load(schema.PhotosConfig(**settings))
        told = [each for each in taken.warnings if "lies on all 2 materials" in each]
        assert len(told) == number and len(taken.parts) == 2


def test_maps_leave_as_mitsubas_scene(shown, tmp_path, rng):
    settings = ["photos.roughness=map", "photos.metallic=map", "photos.normals=map"]
    known = "photos.texture=" + file(shown, "four.png")
    lit = "photos.environment=" + file(shown, "sky.exr")
    cfg, made, _ = built([*shown, known, lit, *settings])
    arrays = {u.key: rng.uniform(0.3, 0.6, u.start.shape).astype(np.float32) for u in made.unknowns}
    path, _ = export.write(cfg, arrays, tmp_path / "result")
    with backend.loading():
        params = mi.traverse(mi.load_file(str(path), optimize=False))
    for key, array in arrays.items():
        np.testing.assert_allclose(params[key], array, atol=1e-6)
    colour = np.array(params[f"{BRDF}.nested_bsdf.base_color.data"])
    np.testing.assert_allclose(colour, images.srgb_decode(FOUR / 255), atol=1e-6)
    assert (tmp_path / "result/painted/object.png").is_file()
    spec = oiio.ImageInput.open(str(tmp_path / f"result/{BRDF}.normalmap.data.exr")).spec()
    assert spec.get_string_attribute("oiio:ColorSpace") == "data"


def test_a_file_is_found_from_elsewhere(shown, tmp_path):
    """A relative name is of where the run was started; a number stays one."""
    from isas_cli.config import paths

    cfg = compose(translate([*shown, "photos.texture=four.png"]))
    paths.locate(cfg, str(tmp_path))
    assert cfg.scene.photos.texture == str(tmp_path / "four.png")
    cfg = compose(translate([*shown, "photos.texture=16"]))
    paths.locate(cfg, str(tmp_path))
    assert cfg.scene.photos.texture == 16
