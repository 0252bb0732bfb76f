"""`isas photos`: what it says of each picture, of many, and what to run."""

import shlex
import shutil

import numpy as np
import photo_sets
import pytest
import trimesh
from photo_sets import CENTRE, FOCAL, POSES, SIZE, Files
from PIL import Image

from isas_cli.cli import photo_tables
from isas_cli.cli.app import main
from isas_cli.config.compose import compose, translate
from isas_cli.scene.photos import exif
from isas_cli.scene.photos.lens import Lens


@pytest.fixture
def called(tmp_path, monkeypatch, capfd):
    """`isas photos` in an empty folder: its whole output, spaces as one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "220")

    def call(*arguments: str) -> list[str]:
        assert main(["photos", *arguments]) == 0
        return [" ".join(line.split()) for line in capfd.readouterr().out.splitlines()]

    return call


def jpeg(path, time=None, aperture=8.0, speed=100) -> None:
    """Grey, with how it was taken."""
    tags = Image.Exif()
    if time is not None:
        tags.get_ifd(0x8769).update({0x829A: time, 0x829D: aperture, 0x8827: speed})
    Image.new("RGB", SIZE, (128, 128, 128)).save(path, exif=tags)


def shots(folder, times) -> dict:
    content = photo_sets.transforms(Files(folder, POSES))
    for frame, time in zip(content["frames"], times):
        name = frame["file_path"].replace(".exr", ".jpg")
        jpeg(folder / name, time)
        frame["file_path"] = name
    return photo_sets.write(folder / "transforms.json", content)


def row(lines: list[str], begin: str) -> str:
    return next(line for line in lines if line.startswith(f"│ {begin}"))


def test_pictures_that_are_alike_are_one_row(called, tmp_path):
    content = shots(tmp_path, [1 / 125, 1 / 125, None])
    mask = np.full((*SIZE[::-1], 1), 255, np.uint8)
    Image.fromarray(mask[..., 0]).save(tmp_path / "mask.png")
    for frame in content["frames"][:2]:
        frame.update(mask_path="mask.png", camera_model="SIMPLE_RADIAL_FISHEYE", k1=0.02)
    photo_sets.write(tmp_path / "transforms.json", content)
    lines = called(".", "photos.sphere=[0,0,0,0.4]")
    both = row(lines, "2: view_0.jpg … view_1.jpg")
    assert "40×30 │ 55.0 │ fisheye, k1 0.02 │ file │ 1/125 s f/8 ISO 100" in both
    assert "40×30 │ 55.0 │ none │ none │ none" in row(lines, "view_2.jpg │ 40×30 │ 55.0 │ none")
    assert not any("exposed unlike" in line for line in lines)  # not known of all


def test_exposures_that_nothing_accounts_for(called, tmp_path):
    content = shots(tmp_path, [1 / 100, 1 / 250, 1 / 100])
    told = "up to 2.5 times: photos.exposure=scale"
    lines = called(".")
    assert any(told in line for line in lines)
    assert "1/100 s f/8 ISO 100 and 1 others, up to 2.5 times as bright" in row(lines, "3: view_0")
    assert not any(told in line for line in called(".", "photos.exposure=scale"))
    # A file that says so accounts for it.
    content["frames"][1]["exposure"] = 0.4
    photo_sets.write(tmp_path / "transforms.json", content)
    assert not any(told in line for line in called("."))


def test_what_pictures_say_of_themselves(tmp_path):
    jpeg(tmp_path / "a.jpg", 1 / 250, 2.8, 400)
    found = exif.read(tmp_path / "a.jpg")
    assert str(found) == "1/250 s f/2.8 ISO 400"
    assert found.exposure == pytest.approx(400 / 250 / 2.8**2)
    jpeg(tmp_path / "b.jpg", 2.0)
    assert str(exif.read(tmp_path / "b.jpg")).startswith("2 s f/8")
    jpeg(tmp_path / "c.jpg")
    jpeg(tmp_path / "d.jpg", 0)
    (tmp_path / "e.jpg").write_text("no picture")
    for name in ("c.jpg", "d.jpg", "e.jpg", "gone.jpg"):
        assert exif.read(tmp_path / name) is None


def test_a_heic_says_it_as_well(tmp_path):
    heif = pytest.importorskip("pillow_heif")
    jpeg(tmp_path / "a.jpg", 0.01)
    picture = Image.open(tmp_path / "a.jpg")
    for name, told in (("a.heic", picture.info["exif"]), ("none.heic", b"")):
        heif.from_pillow(Image.new("RGB", (64, 64))).save(tmp_path / name, exif=told or None)
    assert exif.read(tmp_path / "a.heic") == exif.read(tmp_path / "a.jpg") is not None
    assert exif.read(tmp_path / "none.heic") is None


def test_alpha_that_ends_the_object_is_named(called, tmp_path):
    (tmp_path / "set").mkdir()
    content = photo_sets.transforms(Files(tmp_path / "set", POSES))
    clear = np.full((*SIZE[::-1], 4), 120, np.uint8)
    clear[:, : SIZE[0] // 2, 3] = 255
    for number, frame in enumerate(content["frames"]):
        frame["file_path"] = f"{number}.png"
        Image.fromarray(clear).save(tmp_path / "set" / f"{number}.png")
    photo_sets.write(tmp_path / "set" / "transforms.json", content)
    trimesh.creation.icosphere(2, 0.4).export(tmp_path / "ball.ply")
    for background in ("black", "false"):
        lines = called("set", "photos.mesh=ball.ply", f"photos.background={background}")
        assert " alpha " in row(lines, "3: 0.png")


@pytest.mark.parametrize(
    "time, shown", [(0.4, "0.4"), (0.5, "0.5"), (0.3, "0.3"), (0.25, "1/4"), (1 / 125, "1/125")]
)
def test_times_as_cameras_show_them(time, shown):
    assert str(exif.Taken(time, 8.0, 100)) == f"{shown} s f/8 ISO 100"


def test_the_command_line_runs(called, tmp_path):
    """Its last line, word for word as a shell takes it, composes to the same settings."""
    folder = tmp_path / "my set"
    folder.mkdir()
    photo_sets.transforms(Files(folder, POSES))
    trimesh.creation.icosphere(2, 0.4).export(tmp_path / "a ball.ply")
    settings = ["photos.mesh=a ball.ply", "photos.test=[view_1.exr]", "photos.sky=4"]
    line = called("my set", *settings)[-1]
    words = shlex.split(line)
    assert words[:3] == ["isas", "run", "scene=photos"]
    photos = compose(translate(words[2:])).scene.photos
    assert photos.path.endswith("my set") and photos.mesh.endswith("a ball.ply")
    assert list(photos.test) == ["view_1.exr"] and photos.sky == 4
    assert called("my set")[-1] == "isas run scene=photos 'photos.path=my set' photos.mesh=FILE"


def test_many_pictures_stay_readable(called, tmp_path):
    """Those alike are told by their ranges; one that looks elsewhere stands out."""
    content = photo_sets.transforms(Files(tmp_path, POSES))
    away = np.array(content["frames"][0]["transform_matrix"]) @ np.diag([-1.0, 1, -1, 1])
    frames = []
    for number in range(90):
        frame = dict(content["frames"][number % 3])
        name = f"{number:03d}.exr"
        shutil.copy(tmp_path / frame["file_path"], tmp_path / name)
        frame.update(file_path=name, fl_x=55 + number / 100, fl_y=55 + number / 100)
        if number == 77:
            frame["transform_matrix"] = away.tolist()
        frames.append(frame)
    photo_sets.write(tmp_path / "transforms.json", {**content, "frames": frames})
    lines = called(".", "photos.sphere=[0,0,0,0.4]")
    assert len(lines) < 30
    assert "40×30 │ 55.0 to 55.9 │ none │ none │ none" in row(lines, "90: 000.exr … 089.exr")
    assert "│ 0% │" in row(lines, "077.exr")
    rest = row(lines, "89 views: 000.exr … 089.exr")
    assert "55.0 to 55.9" in rest and "100%" in rest
    assert any("sheet: " in line and "(60 of 90 views)" in line for line in lines)


def test_numbers_of_a_lens_as_ranges():
    from test_photo_cameras import lens

    cameras = [lens(radial=(k, 0, 0, 0), tangential=(0, 0)) for k in (0.1, 0.15)]
    assert photo_tables._lens(cameras) == "k1 0.1 to 0.15"
    assert photo_tables._lens(cameras[:1] * 2) == str(cameras[0].lens) == "k1 0.1"
    assert Lens().terms == {}


def test_a_sheet_loses_no_other(called, tmp_path):
    """Of two sets in folders of one name, and of a file that is none; its own is made anew."""
    for place in ("a", "b"):
        (tmp_path / place / "scan").mkdir(parents=True)
        photo_sets.transforms(Files(tmp_path / place / "scan", POSES))

    def sheet(folder: str) -> str:
        (line,) = [each for each in called(folder) if each.startswith("sheet: ")]
        return line.removeprefix("sheet: ")

    assert sheet("a/scan") == "photos-scan.png"
    first = (tmp_path / "photos-scan.png").read_bytes()
    assert sheet("b/scan") == "photos-scan-2.png"
    assert (tmp_path / "photos-scan.png").read_bytes() == first
    assert sheet("a/scan") == "photos-scan.png" and sheet("b/scan") == "photos-scan-2.png"
    (tmp_path / "photos-scan.png").write_text("mine")
    assert sheet("a/scan") == "photos-scan-3.png"
    assert (tmp_path / "photos-scan.png").read_text() == "mine"
    assert str(tmp_path).encode() not in first  # a picture that is given away tells no folder


def test_tables_fit_into_eighty_columns(tmp_path, monkeypatch, capfd):
    """With all columns that there are, and names of any length; numbers stay whole."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    content = photo_sets.transforms(Files(tmp_path, POSES))
    (tmp_path / "a_folder_of_pictures/the_second_camera").mkdir(parents=True)
    mask = np.full(SIZE[::-1], 255, np.uint8)
    mask[:3] = 0
    Image.fromarray(mask).save(tmp_path / "mask.png")
    for number, frame in enumerate(content["frames"]):
        name = f"a_folder_of_pictures/the_second_camera/picture_{number:06d}.jpg"
        jpeg(tmp_path / name, 1 / 125)
        frame.update(file_path=name, exposure=[1.25, 0.75, 1.5], mask_path="mask.png")
        focal = 1055.25 + number
        frame.update(fl_x=focal, fl_y=focal, k1=0.0123, k2=-0.0456, p1=0.00012)
    photo_sets.write(tmp_path / "transforms.json", content)
    assert main(["photos", ".", "photos.sphere=[0,0,0,0.4]"]) == 0
    out = capfd.readouterr().out
    table = [line for line in out.splitlines() if line[:1] in "┏┃┡│└├"]
    print(out)
    assert table and max(map(len, table)) <= 80
    for told in ("1055.2", "1056.2", "40×30", "120 masked by"):
        assert told in out


def test_pictures_of_unlike_brightness_are_told(called, tmp_path):
    """Of a ball with patches, seen by three cameras, one of which exposed less; EXIF says nothing
    of it."""
    from test_photo_checks import ball

    def patches(pose: np.ndarray, exposure: float) -> np.ndarray:
        """What a camera sees of a ball of 0.4 around the origin that is lit alike."""
        rows, columns = np.indices(SIZE[::-1]) + 0.5
        rays = np.stack(
            [(columns - CENTRE[0]) / FOCAL, (rows - CENTRE[1]) / FOCAL, np.ones(SIZE[::-1])], -1
        )
        rays = rays @ pose[:3, :3].T
        rays /= np.linalg.norm(rays, axis=2, keepdims=True)
        along = rays @ pose[:3, 3]
        inside = along**2 - (pose[:3, 3] @ pose[:3, 3] - 0.4**2)
        far = -along - np.sqrt(np.maximum(inside, 0))
        place = pose[:3, 3] + far[..., None] * rays
        colour = 0.3 + 0.15 * np.sin(9 * place)
        return (exposure * np.where(inside[..., None] > 0, colour, 0.05)).astype(np.float32)

    mesh = f"photos.mesh={ball(tmp_path)}"
    eyes = [(2.0, 1.0, 2.5), (2.4, 0.2, 2.0), (1.4, 1.6, 2.3)]
    poses = [photo_sets.look_at(eye, (0.0, 0.0, 0.0)) for eye in eyes]
    for exposures, found in (((1, 1, 1), False), ((1, 0.5, 1.1), True)):
        pictures = [patches(pose, e) for pose, e in zip(poses, exposures)]
        content = photo_sets.transforms(Files(tmp_path, poses, pictures))
        lines = " ".join(called(".", mesh))
        told = "times as bright in view_2.exr as in view_1.exr"
        assert (told in lines) == found, lines
        assert not found or abs(float(lines.partition("are up to ")[2].split()[0]) - 2.2) < 0.1
        assert "times as bright in" not in " ".join(called(".", mesh, "photos.exposure=scale"))
    for frame, exposure in zip(content["frames"], exposures):
        frame["exposure"] = exposure
    photo_sets.write(tmp_path / "transforms.json", content)
    assert "times as bright in" not in " ".join(called(".", mesh))
