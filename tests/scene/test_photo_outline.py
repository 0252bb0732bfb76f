"""photos.background=black: alpha or masks say where the object ends, and shapes follow."""

import json

import numpy as np
import pytest
import trimesh
from PIL import Image
from runs_for_tests import QUIET, ran

from isas_cli.config.schema import PhotosConfig
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.scene.photos import outlines, photographs

WIDTH, HEIGHT, FOCAL, RADIUS = 40, 32, 45.0, 0.6
GREY = 128


def pose(angle: float) -> np.ndarray:
    """From a camera two and a half away, at the height of the middle, to the world; nerfstudio's
    axes: x right, y up, z back."""
    back = np.array([np.sin(angle), 0.0, np.cos(angle)])
    right = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    place = np.eye(4)
    place[:3, :3] = np.column_stack([right, [0, 1, 0], back])
    place[:3, 3] = 2.5 * back
    return place


def covered() -> np.ndarray:
    """How much of each pixel a ball in the middle fills, by 8 × 8 points each."""
    fine = 8
    x = (np.arange(WIDTH * fine) + 0.5) / fine - WIDTH / 2
    y = (np.arange(HEIGHT * fine) + 0.5) / fine - HEIGHT / 2
    ray = np.stack(
        [
            *np.broadcast_arrays(x[None] / FOCAL, y[:, None] / FOCAL),
        ],
        -1,
    )
    tangent = RADIUS / np.sqrt(2.5**2 - RADIUS**2)
    inside = np.hypot(*np.moveaxis(ray, -1, 0)) < tangent
    return inside.reshape(HEIGHT, fine, WIDTH, fine).mean(axis=(1, 3)).astype(np.float32)


@pytest.fixture
def ball(tmp_path):
    """Four views of a grey ball, with alpha over white, as Blender writes them."""
    frames = []
    pixels = np.full((HEIGHT, WIDTH, 4), 255, np.uint8)
    pixels[covered() > 0, :3] = GREY
    pixels[..., 3] = np.rint(255 * covered())
    for number in range(4):
        Image.fromarray(pixels).save(tmp_path / f"{number}.png")
        place = pose(number * np.pi / 2).tolist()
        frames.append({"file_path": f"{number}.png", "transform_matrix": place})
    size = {"w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2}
    (tmp_path / "transforms.json").write_text(json.dumps(size | {"frames": frames}))
    return tmp_path


def load(folder, **settings):
    own = {"path": str(folder), "sphere": [0.0, 0.0, 0.0, 0.5]}
    return photographs.load(PhotosConfig(**own | settings)).shown


def test_alpha_ends_the_object(ball):
    grey = images.srgb_decode(np.float32(GREY / 255))
    for each in load(ball, background="black"):
        assert np.allclose(each.image, (grey * covered())[..., None], atol=3e-3)
        assert each.mask.all()  # nor is white that is transparent saturated
    for each in load(ball):
        assert np.array_equal(each.mask > 0, covered() > 0.999)


def test_masks_end_it_where_there_is_no_alpha(ball):
    with pytest.raises(InputError, match="neither alpha nor a mask"):
        for number in range(4):
            Image.open(ball / f"{number}.png").convert("RGB").save(ball / f"{number}.png")
        load(ball, background="black", saturated=None)
    (ball / "masks").mkdir()
    for white in (255, 1):
        for number in range(4):
            mask = np.uint8(white * (covered() > 0.5))
            Image.fromarray(mask).save(ball / f"masks/{number}.png")
        for each in load(ball, background="black", saturated=None):
            assert each.mask.all() and each.image[covered() == 0].max() < 1e-5
            assert (each.image[covered() == 1] > 0.2).all()


def test_colours_that_are_multiplied_already_stay(ball):
    content = json.loads((ball / "transforms.json").read_text())
    for number, frame in enumerate(content["frames"]):
        frame["file_path"] = f"{number}.exr"
        layers = np.dstack([covered() * 0.3] * 3 + [covered()]).astype(np.float32)
        images.write_exr(ball / frame["file_path"], layers, ["R", "G", "B", "A"], {})
    (ball / "transforms.json").write_text(json.dumps(content))
    for each in load(ball, background="black"):
        assert np.allclose(each.image, 0.3 * covered()[..., None], atol=1e-5)


@pytest.mark.parametrize("background", ["white", 1, 0.0, None])
def test_what_it_may_be_is_said(background):
    with pytest.raises(InputError, match="valid: true, false, black"):
        PhotosConfig(background=background)


def run(ball, *settings: str) -> dict:
    mesh = ball / "small.obj"
    trimesh.creation.icosphere(subdivisions=3, radius=0.8 * RADIUS).export(mesh)
    Image.new("RGB", (16, 8), (255, 255, 255)).save(ball / "white.png")
    words = ["scene=photos", f"photos.path={ball}", f"photos.mesh={mesh}"]
    words += [f"photos.environment={ball / 'white.png'}", "estimator=silhouettes", "sampler=ours"]
    words += ["scene.unknowns={object.vertices: {}, object.bsdf.brdf_0.base_color.value: {}}"]
    words += ["evaluation.count=1", "estimator.batch=4096", "overwrite=true", *QUIET]
    return ran(ball / "run", *words, *settings).summary


def test_a_shape_grows_into_its_outline(ball):
    """With its colour unknown, from four fifths of its size."""
    summary = run(ball, "photos.background=black", "budget.iterations=300")
    found = trimesh.load(ball / "run/meshes/result_object.vertices.ply", process=False)
    radius = np.linalg.norm(found.vertices, axis=1)
    poles = np.abs(found.vertices[:, 1]) > 0.5 * RADIUS  # near the outline in all four views
    print("radius over the truth", radius[poles].mean() / RADIUS)
    assert radius[poles].mean() == pytest.approx(RADIUS, rel=0.06)
    assert summary["final"]["image_rmse"] < 0.25 * summary["start"]["image_rmse"]


def test_what_transparent_pixels_do_not_tell_is_said(ball):
    for background, told in (("false", True), ("black", False)):
        summary = run(ball, f"photos.background={background}", "budget.iterations=1")
        said = [each for each in summary["warnings"] if "photos.background=black" in each]
        assert bool(said) == told


def test_a_start_in_another_order_is_refused(ball, capsys):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.8 * RADIUS)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(mesh.vertices))
    faces = rng.permutation(np.argsort(order)[mesh.faces])
    trimesh.Trimesh(mesh.vertices[order], faces, process=False).export(ball / "other.ply")
    words = f"scene.unknowns={{object.vertices: {{start: {ball / 'other.ply'}}}}}"
    with pytest.raises(AssertionError):
        run(ball, "photos.background=black", "budget.iterations=1", words)
    assert "in another order" in capsys.readouterr().err.replace("\n", " ")


def rewrite(ball, number: int, alpha: np.ndarray) -> None:
    """Another alpha of a view, over a bright wall."""
    pixels = np.full((HEIGHT, WIDTH, 4), 230, np.uint8)
    pixels[covered() > 0, :3] = GREY
    pixels[..., 3] = np.rint(255 * alpha)
    Image.fromarray(pixels).save(ball / f"{number}.png")


def told(folder, **settings) -> list[str]:
    own = {"path": str(folder), "sphere": [0.0, 0.0, 0.0, RADIUS]}
    lines = photographs.load(PhotosConfig(**own | settings)).warnings
    return [line for line in lines if "has no texture coordinates" not in line]


def test_outlines_that_fit_are_passed_without_a_word(ball):
    assert told(ball, background="black") == told(ball) == []


def test_a_mesh_of_few_corners_is_asked_all_over(ball):
    """The corners of a box lie beyond what masks show."""
    mesh = ball / "box.obj"
    trimesh.creation.box(extents=[1.6 * RADIUS] * 3).export(mesh)
    assert told(ball, background="black", sphere=None, mesh=str(mesh)) == []


@pytest.mark.parametrize(
    "factor, words",
    [
        (0.5, "1.9 times as small"),
        (2.2, "times as large"),
        (1e3, "more than 100 times as large"),  # the cameras stand inside it
        (1e-3, "more than 100 times as small"),
    ],
)
def test_a_mesh_in_other_units_is_told_by_its_outline(ball, factor, words):
    """Of a beginning, which may have any size, nothing is said."""
    mesh = ball / "ball.obj"
    trimesh.creation.icosphere(subdivisions=3, radius=factor * RADIUS).export(mesh)
    lines = told(ball, background="black", sphere=None, mesh=str(mesh))
    (said,) = (line for line in lines if "the cameras' units" in line)
    assert words in said and "the cameras' units; photos.pose=true finds" in said
    assert told(ball, background="black", sphere=[0.0, 0.0, 0.0, 0.6 * RADIUS]) == []


def test_what_lies_elsewhere_is_no_matter_of_units(ball):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
    mesh.apply_translation([0, 60, 0])
    mesh.export(ball / "ball.obj")
    said = told(ball, background="black", sphere=None, mesh=str(ball / "ball.obj"))
    assert not any("the cameras' units" in line for line in said)


def test_inverted_alpha_and_masks_are_doubted(ball):
    for number in range(4):
        rewrite(ball, number, 1 - covered())
    assert "masks look inverted" in told(ball, background="black")[0]
    (ball / "masks").mkdir()
    for number in range(4):
        Image.open(ball / f"{number}.png").convert("RGB").save(ball / f"{number}.png")
        mask = np.uint8(255 * (covered() < 0.5))
        Image.fromarray(mask).save(ball / f"masks/{number}.png")
    assert "masks look inverted" in told(ball, background="black", saturated=None)[0]
    assert "masks look inverted" in told(ball, saturated=None)[0]


def test_an_alpha_that_says_nothing_is_doubted_or_refused(ball):
    rewrite(ball, 1, np.ones((HEIGHT, WIDTH)))
    (said,) = told(ball, background="black")
    assert "fills all of 1 of 4 pictures" in said and "1.png" in said
    rewrite(ball, 1, np.zeros((HEIGHT, WIDTH)))
    with pytest.raises(InputError, match="1.png: by its alpha or mask it shows nothing"):
        told(ball, background="black")


def test_an_alpha_of_ones_leaves_the_word_to_masks(ball):
    """As programs write it that know of no alpha."""
    (ball / "masks").mkdir()
    for number in range(4):
        rewrite(ball, number, np.ones((HEIGHT, WIDTH)))
        Image.fromarray(np.uint8(255 * (covered() > 0.5))).save(ball / f"masks/{number}.png")
    for each in load(ball, background="black"):
        assert 0.5 < each.part.sum() / covered().sum() < 1.5


def test_smaller_pictures_keep_their_outline(ball):
    """Where object and wall are patterns, a border pixel's share is not told by its colour."""
    rng = np.random.default_rng(2)
    (ball / "masks").mkdir()
    for number in range(4):
        inside = np.kron(covered(), np.ones((4, 4))) > 0.5
        colours = np.where(inside[..., None], 60, 190) + rng.integers(-50, 50, (*inside.shape, 1))
        Image.fromarray(np.uint8(np.repeat(colours, 3, axis=2))).save(ball / f"{number}.png")
        Image.fromarray(np.uint8(255 * inside)).save(ball / f"masks/{number}.png")
    content = json.loads((ball / "transforms.json").read_text())
    for name in ("w", "h", "fl_x", "cx", "cy"):
        content[name] *= 4
    (ball / "transforms.json").write_text(json.dumps(content))
    whole, small = (load(ball, background="black", width=w)[0].part for w in (None, WIDTH))
    assert (whole < 0).any() and not (small < 0).any()
    assert small.sum() == pytest.approx(covered().sum(), rel=0.05)


def test_an_environment_that_is_not_there_is_refused_at_once(ball):
    with pytest.raises(InputError, match="photos.environment=gone.exr: no such picture file"):
        told(ball, environment="gone.exr")


@pytest.mark.parametrize("least", [0.5, 0.99, 0.01])
def test_masks_of_two_values_end_as_finely_as_the_picture_does(ball, least):
    """Whatever share of a pixel makes it white: from the picture's mixtures of object and wall."""
    (ball / "masks").mkdir()
    wall = images.srgb_decode(np.float32(230 / 255))
    light = images.srgb_decode(np.float32(GREY / 255)) * covered() + wall * (1 - covered())
    for number in range(4):
        shown = np.uint8(np.rint(255 * images.srgb_encode(light)))
        Image.fromarray(np.dstack([shown] * 3)).save(ball / f"{number}.png")
        Image.fromarray(np.uint8(255 * (covered() > least))).save(ball / f"masks/{number}.png")
    each = load(ball, background="black", saturated=None)[0]
    rounded = (covered() > least).mean()
    print("area", covered().mean(), "rounded", rounded, "found", each.part.mean())
    assert each.part.mean() == pytest.approx(covered().mean(), rel=2e-3)
    assert np.abs(each.part - covered()).max() < 0.03
    grey = images.srgb_decode(np.float32(GREY / 255))
    assert np.abs(each.image - (grey * covered())[..., None]).max() < 0.01


def test_where_the_wall_is_here_and_there_like_the_object_nothing_is_said(ball):
    (ball / "masks").mkdir()
    wall = np.full((HEIGHT, WIDTH), images.srgb_decode(np.float32(230 / 255)))
    wall[: HEIGHT // 2] = images.srgb_decode(np.float32(GREY / 255))
    light = images.srgb_decode(np.float32(GREY / 255)) * covered() + wall * (1 - covered())
    for number in range(4):
        shown = np.uint8(np.rint(255 * images.srgb_encode(light)))
        Image.fromarray(np.dstack([shown] * 3)).save(ball / f"{number}.png")
        Image.fromarray(np.uint8(255 * (covered() > 0.99))).save(ball / f"masks/{number}.png")
    each = load(ball, background="black", saturated=None)[0]
    told = each.part >= 0
    beside = np.abs(np.arange(HEIGHT) - HEIGHT // 2) > 4  # of where the wall changes
    assert np.abs(each.part - covered())[told & beside[:, None]].max() < 0.03
    upper = ~told[: HEIGHT // 2]
    assert upper.any() and not (~told[HEIGHT // 2 + 2 :]).any()
    assert not each.mask[~told].any() and each.mask[told].all()


def test_where_object_and_wall_are_alike_the_mask_counts(ball):
    (ball / "masks").mkdir()
    for number in range(4):
        Image.new("RGB", (WIDTH, HEIGHT), (GREY,) * 3).save(ball / f"{number}.png")
        Image.fromarray(np.uint8(255 * (covered() > 0.5))).save(ball / f"masks/{number}.png")
    each = load(ball, background="black", saturated=None)[0]
    assert np.array_equal(each.part, covered() > 0.5)


@pytest.mark.parametrize(
    "factor, said", [(1.0, ""), (1.02, ""), (1.12, "larger"), (0.88, "smaller")]
)
@pytest.mark.parametrize("background", [False, "black"])
def test_a_mesh_of_another_size_than_its_outline_by_some_percent(ball, factor, said, background):
    """In all views, in width and height alike: a focal length, or the mesh itself. Not where that
    is to be found, and not where it is of another shape."""
    mesh = ball / "ball.obj"
    trimesh.creation.icosphere(subdivisions=4, radius=factor * RADIUS).export(mesh)
    given = {"sphere": None, "mesh": str(mesh), "background": background}
    lines = told(ball, **given)
    assert [line.split(" than alpha")[0].split()[-1] for line in lines] == [said] * bool(said)
    assert told(ball, **given, lens=["focal"]) == told(ball, **given, pose=True) == []
    tall = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    tall.apply_scale([1, factor, 1])
    tall.export(mesh)
    assert told(ball, **given) == []


def test_an_alpha_that_leaves_out_a_frame_leaves_the_word_to_masks(ball):
    """As of pictures that were undistorted: what lies beyond is not known. One that ends an object
    in the middle ends it."""
    (ball / "masks").mkdir()
    frame = np.zeros((HEIGHT, WIDTH))
    frame[4:-4, 3:-3] = 1
    for number in range(4):
        rewrite(ball, number, frame)
        Image.fromarray(np.uint8(255 * (covered() > 0.5))).save(ball / f"masks/{number}.png")
    for each in load(ball, background="black", saturated=None):
        assert 0.5 < (each.part * (each.part > 0)).sum() / covered().sum() < 1.5
        assert ((each.part < 0) >= (frame == 0)).all() and not each.mask[frame == 0].any()
        assert each.box is not None and outlines.box(frame) is None
    for each in load(ball, background="black", saturated=None, width=WIDTH // 2):
        assert (each.part[[0, 1, -2, -1]] < 0).all() and (each.part[2:-2, 2:-2] >= 0).all()
    for each in load(ball, saturated=None):
        assert ((each.mask > 0) == (covered() > 0.5) & (frame > 0)).all()
    for number in range(4):
        rewrite(ball, number, covered())
        Image.fromarray(np.uint8(255 * (covered() > 0))).save(ball / f"masks/{number}.png")
    for each in load(ball, background="black", saturated=None):
        assert np.allclose(each.part, covered(), atol=3e-3)


def test_alpha_ends_a_close_object_whose_mask_leaves_a_glare_out():
    alpha, given = np.zeros((30, 40)), np.ones((30, 40))
    alpha[3:-3, 4:-4], given[12:18, 15:25] = 1, 0
    assert not outlines.framed(alpha, given)
    assert outlines.framed(alpha, given * alpha)


def test_what_lies_behind_a_soft_mask_is_taken_away():
    """A dark object on a bright wall: half of the rim's light is the wall's."""
    part = np.clip((np.arange(24) - 9) / 4, 0, 1)[None].repeat(8, 0).astype(np.float32)
    image = part[..., None] * np.float32(0.1) + (1 - part[..., None]) * np.float32(0.9)
    image = np.repeat(image, 3, axis=2)
    found = outlines.over_black(image, part)
    np.testing.assert_allclose(found, np.repeat(part[..., None] * 0.1, 3, axis=2), atol=1e-6)


@pytest.mark.parametrize("soft", (False, True))
def test_borders_are_mixed_in_pieces_as_in_the_whole_picture(soft, monkeypatch):
    rng = np.random.default_rng(0)
    down, right = np.mgrid[:70, :90]
    depth = 25 - np.hypot(down - 34, right - 45) + 3 * np.sin(right / 3)
    part = np.clip(depth / 4 + 0.5, 0, 1).astype(np.float32)
    image = part[..., None] * (0.6 + 0.1 * rng.random((70, 90, 3)))
    image = np.float32(image + (1 - part[..., None]) * 0.1 * rng.random((70, 90, 3)))
    part = part if soft else np.float32(part > 0.5)

    def ended() -> tuple[np.ndarray, ...]:
        return (outlines.over_black(image, part),) if soft else outlines.softened(image, part)

    whole, given = ended(), part.copy()
    monkeypatch.setattr(outlines, "_PIECE", 32)
    pieces = ended()
    assert (part == given).all() and not np.allclose(whole[0], image * part[..., None])
    for one, other in zip(whole, pieces, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


def test_masks_of_jpeg_are_black_and_white(ball):
    """But for its noise: they end the object as finely as the picture does."""
    (ball / "masks").mkdir()
    for number in range(4):
        Image.open(ball / f"{number}.png").convert("RGB").save(ball / f"{number}.png")
        mask = Image.fromarray(np.uint8(255 * (covered() > 0.5)))
        mask.save(ball / f"masks/{number}.jpg", quality=70)
    for each in load(ball, background="black", saturated=None):
        beside = each.part[covered() == 0]
        assert (beside <= 0.5).all() and (beside == 0).mean() > 0.9
        assert (each.part[covered() == 1] == 1).mean() > 0.9
