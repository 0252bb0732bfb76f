"""The visual hull of alpha or masks: where there is no mesh."""

import itertools
import json
import shlex
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from runs_for_tests import ran
from scipy.ndimage import binary_dilation
from test_photo_outline import FOCAL, HEIGHT, RADIUS, WIDTH, ball, covered, pose  # noqa: F401

from isas_cli.cli.app import main
from isas_cli.config.compose import compose, translate
from isas_cli.config.schema import PhotosConfig
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import hull, outlines, photographs


def around(folder, count: int = 14) -> None:
    """More views of the ball, from all sides: spread over a sphere."""
    content = json.loads((folder / "transforms.json").read_text())
    frames = []
    for number in range(count):
        y = 1 - 2 * (number + 0.5) / count
        angle = number * np.pi * (3 - np.sqrt(5))
        back = np.array([np.cos(angle) * np.sqrt(1 - y * y), y, np.sin(angle) * np.sqrt(1 - y * y)])
        right = np.cross([0, 1, 0], back)
        right /= np.linalg.norm(right)
        place = np.eye(4)
        place[:3, :3] = np.column_stack([right, np.cross(back, right), back])
        place[:3, 3] = 2.5 * back
        Image.open(folder / "0.png").save(folder / f"{number}.png")
        frames.append({"file_path": f"{number}.png", "transform_matrix": place.tolist()})
    (folder / "transforms.json").write_text(json.dumps(content | {"frames": frames}))


def aside(folder, chosen: slice, far: float) -> None:
    """Cameras of those views moved to their right."""
    content = json.loads((folder / "transforms.json").read_text())
    for frame in content["frames"][chosen]:
        place = np.array(frame["transform_matrix"])
        place[:3, 3] += far * place[:3, 0]
        frame["transform_matrix"] = place.tolist()
    (folder / "transforms.json").write_text(json.dumps(content))


def load(folder, **settings):
    return photographs.load(PhotosConfig(path=str(folder), **settings))


def mesh_of(taken) -> trimesh.Trimesh:
    return trimesh.Trimesh(taken.surface.vertices, taken.surface.faces)  # which it welds


def test_a_ball_from_all_sides(ball, quick):  # noqa: F811
    """A hull holds what it is of, and is little larger."""
    around(ball)
    for settings in ({}, {"start": "hull", "voxels": 32}):
        taken = load(ball, **settings)
        assert taken.settings.background == "black" and taken.settings.start == "hull"
        found = mesh_of(taken)
        radius = np.linalg.norm(found.vertices, axis=1)
        print("radius", radius.min(), radius.mean(), radius.max())
        assert found.is_watertight and found.volume > 0
        assert 0.97 * RADIUS < radius.min() and radius.max() < 1.12 * RADIUS
        assert 0.99 * RADIUS < radius.mean() < 1.05 * RADIUS


def test_large_pictures_are_made_smaller(ball, quick, monkeypatch):  # noqa: F811
    around(ball)
    monkeypatch.setattr(outlines, "_LARGE", WIDTH // 2)
    monkeypatch.setattr(hull, "_FORMAT", 0)  # none that is kept
    radius = np.linalg.norm(mesh_of(load(ball)).vertices, axis=1)
    print("radius", radius.min(), radius.mean(), radius.max())
    assert 0.95 * RADIUS < radius.mean() < 1.07 * RADIUS


def test_texture_coordinates_are_of_one_place_each(ball):  # noqa: F811
    around(ball)
    surface = load(ball).surface
    texcoords = surface.texcoords[surface.faces].astype(np.float64)
    a, b = texcoords[:, 1] - texcoords[:, 0], texcoords[:, 2] - texcoords[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2
    assert surface.texcoords.min() >= 0 and surface.texcoords.max() <= 1
    assert 0.3 < area < 1
    # Its triangles fill as many texels as they have area.
    filled = np.zeros((512, 512), bool)
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], 400)
    for corner in texcoords:
        place = weights @ corner
        filled[tuple(np.minimum(place * 512, 511).astype(int).T)] = True
    assert filled.mean() > 0.85 * area


def test_it_is_right_side_out_wherever_it_stands(ball, quick):  # noqa: F811
    """By a sum over its triangles around the world's origin every third such ball was inside
    out."""
    around(ball)
    content = json.loads((ball / "transforms.json").read_text())
    stood = [np.array(frame["transform_matrix"]) for frame in content["frames"]]
    rng, volumes = np.random.default_rng(0), []
    for _ in range(8):
        way = rng.standard_normal(3)
        for frame, place in zip(content["frames"], stood):
            there = place.copy()
            there[:3, 3] += 4 * RADIUS * way / np.linalg.norm(way)
            frame["transform_matrix"] = there.tolist()
        (ball / "transforms.json").write_text(json.dumps(content))
        volumes.append(mesh_of(load(ball, voxels=16)).volume)
    print(volumes)
    assert min(volumes) > 0


@pytest.mark.parametrize("unit", [1e-6, 1e4])
def test_any_unit_of_length(ball, quick, unit):  # noqa: F811
    """Of a set of another unit the hull is as large as that says, and unwrapped all the same."""
    around(ball)
    usual = load(ball, voxels=16).surface
    content = json.loads((ball / "transforms.json").read_text())
    for frame in content["frames"]:
        for row in frame["transform_matrix"][:3]:
            row[3] *= unit
    (ball / "transforms.json").write_text(json.dumps(content))
    surface = load(ball, voxels=16).surface
    assert surface.vertices.shape == usual.vertices.shape
    assert surface.vertices == pytest.approx(usual.vertices * unit, abs=0.02 * unit * RADIUS)
    assert surface.texcoords == pytest.approx(usual.texcoords, abs=0.02)


def test_what_does_not_enclose_it_is_refused(ball):  # noqa: F811
    content = json.loads((ball / "transforms.json").read_text())
    content["frames"] = content["frames"][:1]
    (ball / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="do not enclose the object: take views from more sides"):
        load(ball)


def test_outlines_without_a_common_place_are_refused(ball):  # noqa: F811
    around(ball)
    aside(ball, slice(None, None, 2), 3.0)
    with pytest.raises(InputError, match="photos.start=hull: no(thing| place) lies within"):
        load(ball)


def coherent(taken) -> list[str]:
    return [line for line in taken.warnings if line.startswith("photos.start=hull:")]


def test_a_view_that_contradicts_the_others_is_named(ball):  # noqa: F811
    """By what it takes away of the others' masks; without it nothing is said."""
    around(ball)
    assert not coherent(load(ball, voxels=16))
    aside(ball, slice(4, 5), 0.5 * RADIUS)
    (line,) = coherent(load(ball, voxels=16))
    assert "photos.start=hull: 4.png alone takes away" in line
    assert "photos.without=[4.png]" in line
    assert not coherent(load(ball, voxels=16, without=["4.png"]))


def test_two_views_that_contradict_the_others_are_named(ball):  # noqa: F811
    around(ball, 16)
    aside(ball, slice(3, 4), 0.5 * RADIUS)
    aside(ball, slice(9, 10), -0.5 * RADIUS)
    odd = {line.split()[1] for line in coherent(load(ball, voxels=16))}
    assert odd == {"3.png", "9.png"}


def test_a_view_so_far_off_that_nothing_is_left_is_named(ball):  # noqa: F811
    around(ball)
    aside(ball, slice(6, 7), 3.0 * RADIUS)
    with pytest.raises(InputError, match=r"6.png contradicts the others.*photos.without=\[6.png\]"):
        load(ball, voxels=16)


def test_a_real_set_names_its_wrong_camera():
    """13 photographs of a head, with the cameras of a structure-from-motion program, one of them
    registered wrongly, and masks as a program cut them. It cuts a part of the head away."""
    every = load("head")
    (odd, *_) = coherent(every)
    assert odd.startswith("photos.start=hull: image/000.jpg alone takes away")
    rest = load("head", without=["image/000.jpg"])
    assert not any("alone takes away" in line for line in coherent(rest))
    cut, whole = (abs(mesh_of(each).volume) for each in (every, rest))
    print("of the hull's volume it leaves", cut / whole)
    assert cut < 0.92 * whole


def test_one_view_alone_may_cut_much(ball):  # noqa: F811
    """A view from a side that no other has takes much away of what the others leave, rightly."""
    around(ball)
    content = json.loads((ball / "transforms.json").read_text())
    content["frames"] = [
        frame
        for frame in content["frames"]
        if abs(frame["transform_matrix"][1][3]) < 1.2 or frame["transform_matrix"][1][3] > 2.2
    ]
    assert len(content["frames"]) >= 6
    (ball / "transforms.json").write_text(json.dumps(content))
    assert not coherent(load(ball, voxels=16))


def test_a_mask_that_holds_more_than_the_object_is_named(ball):  # noqa: F811
    around(ball)
    pixels = np.array(Image.open(ball / "5.png"))
    pixels[:, : WIDTH // 5, 3] = 255
    Image.fromarray(pixels).save(ball / "5.png")
    (line,) = coherent(load(ball, voxels=16))
    assert "the masks of 1 of 14 views show what no other view leaves room for" in line
    assert "most of all 5.png (" in line and "hold more than the object" in line


@pytest.mark.parametrize("thin", ["sheet", "rods"])
def test_thin_objects_contradict_nothing(ball, thin):  # noqa: F811
    """A sheet, and rods, thinner than what is asked in steps of."""
    around(ball)
    line, zero = np.linspace(-RADIUS, RADIUS, 400), np.zeros(400)
    if thin == "sheet":
        x, y = (each.ravel() for each in np.meshgrid(line, line))
        points = np.column_stack([x, y, 0.3 * x])
    else:
        rods = ([line, zero, zero], [zero, line, zero], [line, line, line])
        points = np.concatenate([np.column_stack(rod) for rod in rods])
    for number, each in enumerate(load(ball, voxels=16).shown):
        place, _ = each.camera.project(points)
        pixels = np.array(Image.open(ball / f"{number}.png"))
        pixels[..., 3] = 0
        column, row = place.astype(int).T
        for down, right in itertools.product((-1, 0, 1), repeat=2):
            pixels[np.clip(row + down, 0, HEIGHT - 1), np.clip(column + right, 0, WIDTH - 1), 3] = (
                255
            )
        Image.fromarray(pixels).save(ball / f"{number}.png")
    assert not [line for line in coherent(load(ball, voxels=16)) if "pieces" not in line]


def test_labels_that_are_no_outline_are_named(ball):  # noqa: F811
    around(ball)
    (ball / "masks").mkdir()
    for number in range(14):
        picture = np.array(Image.open(ball / f"{number}.png"))
        label = np.where(picture[..., 3] > 127, 2, 1).astype(np.uint8)
        label[:2] = 0
        Image.fromarray(label).save(ball / f"masks/{number}.png")
        Image.fromarray(picture[..., :3]).save(ball / f"{number}.png")
    aside(ball, slice(None, None, 2), 3.0)
    with pytest.raises(InputError, match="png holds several values, as labels are"):
        load(ball)


def masked(folder, of) -> None:
    """Masks in place of alpha: ``of`` where the ball is."""
    (folder / "masks").mkdir()
    for number in range(14):
        picture = np.array(Image.open(folder / f"{number}.png"))
        made = of(picture[..., 3] > 127).astype(np.uint8)
        Image.fromarray(made).save(folder / f"masks/{number}.png")
        Image.fromarray(picture[..., :3]).save(folder / f"{number}.png")


def test_a_rim_that_nobody_labelled_is_not_the_object(ball):  # noqa: F811
    """PASCAL VOC's labels: 1, and 255 around it."""
    around(ball)
    masked(ball, lambda inside: np.where(inside ^ binary_dilation(inside), 255, inside))
    with pytest.raises(
        InputError, match=r"as labels are, and half .*\(1 of 255\): save the object"
    ):
        load(ball)


def test_inverted_masks_are_refused(ball):  # noqa: F811
    """Of what is around the object a hull can be made, too."""
    around(ball)
    masked(ball, lambda inside: 255 * ~inside)
    with pytest.raises(InputError, match="in 14 of 14 pictures, .* masks are inverted; save"):
        load(ball)


@pytest.mark.parametrize("step, said", [(16, True), (30, False)])
def test_views_of_one_side_are_said(ball, quick, step, said):  # noqa: F811
    content = json.loads((ball / "transforms.json").read_text())
    for number, frame in enumerate(content["frames"]):
        frame["transform_matrix"] = pose(np.radians(step * number)).tolist()
    (ball / "transforms.json").write_text(json.dumps(content))
    told = [line for line in load(ball).warnings if "look from one side, within 48 deg" in line]
    assert bool(told) == said


def test_pictures_without_an_end_of_the_object_are_no_hull(ball, monkeypatch):  # noqa: F811
    around(ball)
    for number in range(14):
        pixels = np.array(Image.open(ball / f"{number}.png"))
        pixels[..., 3] = 255
        Image.fromarray(pixels).save(ball / f"{number}.png")
    with pytest.raises(InputError, match="nothing says where it ends: save masks"):
        load(ball, start="hull")
    with pytest.raises(InputError, match="not given.*the alpha of all pictures is 1 everywhere"):
        load(ball)
    rest = np.array(Image.open(ball / "3.png"))
    rest[:5, :, 3] = 0  # in the others the object may well fill the picture
    Image.fromarray(rest).save(ball / "3.png")
    monkeypatch.setattr(hull, "made", lambda *_: pytest.fail("made"))
    with pytest.raises(pytest.fail.Exception, match="made"):
        load(ball)


def test_an_unknown_margin_ends_nothing(ball):  # noqa: F811
    """What a lens leaves empty at a picture's border says no more than the border itself."""
    around(ball)
    shown = load(ball).shown
    for each in shown:
        each.part[:] = np.roll(each.part, -HEIGHT // 2, axis=0)
        each.part[HEIGHT // 2 :] = 0
    before = hull.bounds(shown)
    for each in shown:
        each.part = np.pad(each.part, ((2, 0), (0, 0)), constant_values=-1)
        each.camera = replace(each.camera, height=each.camera.height + 2, cy=each.camera.cy + 2)
    np.testing.assert_allclose(hull.bounds(shown), before)


def test_specks_are_left_out_and_said(ball, quick):  # noqa: F811
    around(ball)
    rng = np.random.default_rng(0)
    for number in range(14):
        pixels = np.array(Image.open(ball / f"{number}.png"))
        pixels[2:4, 2:4, 3] = 255  # alike in all, so that some place is in all of them, or in none
        pixels[rng.integers(HEIGHT), rng.integers(WIDTH), 3] = 255
        Image.fromarray(pixels).save(ball / f"{number}.png")
    found = mesh_of(load(ball))
    assert len(found.split()) == 1
    assert np.linalg.norm(found.vertices, axis=1).max() < 1.15 * RADIUS


def test_without_masks_or_mesh_both_ways_out_are_named(ball, capsys):  # noqa: F811
    for number in range(4):
        Image.open(ball / f"{number}.png").convert("RGB").save(ball / f"{number}.png")
    with pytest.raises(InputError, match="photos.mesh is not given.*alpha or masks.*/0.png has"):
        load(ball)
    with pytest.raises(InputError, match="neither alpha nor a mask"):
        load(ball, start="hull")
    assert main(["photos", str(ball), f"output={ball / 'sheet.png'}"]) == 0
    assert "photos.mesh=FILE" in capsys.readouterr().out


def test_isas_photos_shows_what_no_hull_is_made_of(ball, capsys):  # noqa: F811
    """Where masks or poses are wrong they are to be looked at; and where alpha says nothing."""
    around(ball)
    aside(ball, slice(None, None, 2), 3.0)

    def shown(*settings: str) -> str:
        (ball / "sheet.png").unlink(missing_ok=True)
        assert main(["photos", str(ball), f"output={ball / 'sheet.png'}", *settings]) == 0
        assert (ball / "sheet.png").is_file()
        return " ".join(capsys.readouterr().out.split())

    told = shown("photos.start=hull", "photos.voxels=64", "photos.up=z")
    assert "lies within the object's outline in every view: poses do not fit" in told
    # A mesh is what is missing, beside which these say nothing.
    assert told.endswith("photos.up=z photos.mesh=FILE")
    for number in range(14):
        pixels = np.array(Image.open(ball / f"{number}.png"))
        pixels[..., 3] = 255
        Image.fromarray(pixels).save(ball / f"{number}.png")
    told = shown()
    assert "note: no hull is made of alpha or masks: there are no masks, and the alpha of" in told


def test_what_is_advised_can_be_typed(ball):  # noqa: F811
    """Whatever a picture is called."""
    around(ball)
    aside(ball, slice(6, 7), 3.0 * RADIUS)
    content, name = json.loads((ball / "transforms.json").read_text()), "2024_06 & é (6).png"
    (ball / "6.png").rename(ball / name)
    content["frames"][6]["file_path"] = name
    (ball / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(InputError) as error:
        load(ball, voxels=16)
    (word,) = shlex.split(str(error.value).partition("mend it, or ")[2])
    photos = compose(translate(["scene=photos", word])).scene.photos
    assert list(photos.without) == [name]


def test_a_mesh_and_a_hull_are_one_too_many():
    with pytest.raises(InputError, match="photos.mesh and photos.start: one shape alone"):
        PhotosConfig(mesh="a.obj", start="hull")
    with pytest.raises(InputError, match="photos.start=sphere: valid: null, hull"):
        PhotosConfig(start="sphere")


def test_one_command_finds_shape_colour_and_light(ball, quick, tmp_path):  # noqa: F811
    around(ball)
    out = tmp_path / "run"
    words = ["scene=photos", f"photos.path={ball}", "photos.texture=32", "photos.voxels=16"]
    words += ["budget.iterations=60", "frames.views=1", "frames.snapshots=0", "report=false"]
    summary = ran(out, *words, "estimator.batch=2048", "evaluation.count=2").summary
    assert summary["final"]["image_rmse"] < 0.5 * summary["start"]["image_rmse"]
    found = trimesh.load(out / "meshes/result_object.vertices.ply", process=False)
    radius = np.linalg.norm(found.vertices, axis=1)
    assert radius.mean() == pytest.approx(RADIUS, rel=0.05)
    config = (out / "config.yaml").read_text() if (out / "config.yaml").exists() else ""
    assert "silhouettes" in config or "silhouettes" in (out / "manifest.json").read_text()


def test_a_frame_that_alpha_leaves_out_ends_no_object(ball):  # noqa: F811
    """As undistortion leaves it in all pictures; a disk that fills them is an object."""
    around(ball)
    for number in range(14):
        pixels = np.array(Image.open(ball / f"{number}.png"))
        pixels[..., 3] = 0
        pixels[1:-1, 1:-1, 3] = 255
        Image.fromarray(pixels).save(ball / f"{number}.png")
    with pytest.raises(InputError, match="alpha of all pictures leaves out a frame along"):
        load(ball)
    down, across = np.mgrid[:60, :60] - 29.5
    assert not outlines.whole((np.hypot(down, across) < 30).astype(np.float32))


def test_an_object_that_goes_on_in_a_bent_margin_is_not_cut(ball):  # noqa: F811
    around(ball)
    (one, *_) = load(ball).shown
    one.part[:] = 0
    one.part[10:25, 5:30] = 1
    one.part[:, 0:3] = -1
    assert len(hull._planes([one])[0]) == 5  # all four sides, and what is before the camera
    one.part[10:12, :5] = -1  # there it may go on, and elsewhere it ends
    assert len(hull._planes([one])[0]) == 4


@pytest.mark.parametrize("word", ["background=true", "materials=one"])
def test_what_has_no_effect_on_a_hull_is_refused(ball, word):  # noqa: F811
    around(ball)
    name, _, value = word.partition("=")
    with pytest.raises(InputError, match=f"photos.{name}={value} has no effect on a hull"):
        load(ball, **{name: {"true": True}.get(value, value)})
