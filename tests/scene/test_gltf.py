"""`isas export` as glTF: what the file says, read by its specification, is what Mitsuba shows."""

import json
import shutil
import subprocess

import drjit as dr
import glb
import mitsuba as mi
import numpy as np
import pytest
import trimesh
from xml_for_tests import camera, paths

from isas_cli.config.schema import SceneConfig, UnknownConfig
from isas_cli.runtime import images
from isas_cli.scene import export, gltf
from isas_cli.unknowns.parameters import held

pytestmark = pytest.mark.usefixtures("two_threads")

BOX = '<rfilter type="box"/>'
SCENE = f"""<scene version="3.0.0">{paths(2)}{camera("0,2.5,5", 48, 32, fov=50, film=BOX)}
  <emitter type="constant" id="sky"/>
  <emitter type="point" id="lamp"><point name="position" x="1" y="4" z="3"/>
    <rgb name="intensity" value="30, 25, 20"/></emitter>
  {{inside}}
</scene>"""
CABINET = """
  <bsdf type="twosided" id="paint"><bsdf type="principled">
    <texture type="bitmap" name="base_color"><string name="filename" value="paint.exr"/></texture>
    <texture type="bitmap" name="roughness"><string name="filename" value="rough.exr"/>
      <boolean name="raw" value="true"/></texture>
    <float name="metallic" value="0.3"/></bsdf></bsdf>
  <shape type="obj" id="sheet"><string name="filename" value="sheet.obj"/><ref id="paint"/>
    <transform name="to_world"><rotate x="1" angle="-40"/><translate x="-1.2" z="0.5"/></transform>
  </shape>
  <shape type="rectangle" id="floor"><ref id="paint"/>
    <transform name="to_world"><scale x="3" y="2"/><rotate x="1" angle="-90"/>
      <translate y="-1"/></transform></shape>
  <shape type="sphere" id="ball"><point name="center" x="0.9" y="0" z="1"/>
    <float name="radius" value="0.7"/>
    <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
      <string name="filename" value="other.exr"/><string name="wrap_mode" value="mirror"/>
      <transform name="to_uv"><scale x="2" y="1.5"/><rotate z="1" angle="25"/></transform>
    </texture></bsdf></shape>
  <shape type="cube" id="box"><transform name="to_world"><scale value="0.4"/>
      <translate x="-0.2" y="-0.5" z="2"/></transform>
    <bsdf type="principled"><rgb name="base_color" value="0.02,0.003,0.5"/>
      <float name="roughness" value="0.35"/><float name="metallic" value="0.8"/>
      <float name="specular" value="0.3"/></bsdf></shape>
"""
# One shape is called as other libraries call the root of a scene.
SHOWCASE = """
  <shape type="disk" id="coin"><bsdf type="twosided"><bsdf type="diffuse">
    <texture type="checkerboard" name="reflectance"><rgb name="color0" value="0.8,0.1,0.1"/>
      <rgb name="color1" value="0.1,0.6,0.3"/>
      <transform name="to_uv"><scale x="2" y="3"/></transform></texture></bsdf></bsdf></shape>
  <shape type="cylinder" id="can"><transform name="to_world"><scale value="0.5"/>
      <translate x="2"/></transform>
    <bsdf type="mask"><texture type="bitmap" name="opacity">
        <string name="filename" value="rough.exr"/><boolean name="raw" value="true"/>
        <string name="wrap_mode" value="clamp"/></texture>
      <bsdf type="diffuse"><rgb name="reflectance" value="0.7,0.2,0.1"/></bsdf></bsdf></shape>
  <shape type="ply" id="bare"><string name="filename" value="bare.ply"/>
    <transform name="to_world"><translate x="-3"/></transform>
    <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
      <string name="filename" value="paint.exr"/></texture></bsdf></shape>
  <shape type="obj" id="two"><string name="filename" value="sheet.obj"/>
    <transform name="to_world"><translate y="3"/></transform>
    <bsdf type="principled"><texture type="bitmap" name="base_color">
        <string name="filename" value="paint.exr"/><string name="filter_type" value="nearest"/>
        </texture>
      <texture type="bitmap" name="roughness"><string name="filename" value="rough.exr"/>
        <boolean name="raw" value="true"/>
        <transform name="to_uv"><scale x="3" y="2"/></transform></texture>
      <texture type="bitmap" name="metallic"><string name="filename" value="small.exr"/>
        <boolean name="raw" value="true"/>
        <transform name="to_uv"><scale x="3" y="2"/></transform></texture></bsdf></shape>
  <shape type="cube" id="world"><boolean name="flip_normals" value="true"/>
    <transform name="to_world"><translate x="6"/></transform>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.2"/></bsdf></shape>
"""


def sheet(path, mirrored: bool = False) -> None:
    """A bent one, with texture coordinates that leave a margin and run beyond it, and normals."""
    side = np.linspace(0, 1, 6)
    u, v = (each.ravel() for each in np.meshgrid(side, side))
    x, y = 2 * u - 1, 2 * v - 1
    lines = [f"v {a:.6f} {b:.6f} {0.3 * a * b:.6f}" for a, b in zip(x, y)]
    across = (1 - u if mirrored else u) * 1.1 + 0.03
    lines += [f"vt {a:.6f} {b:.6f}" for a, b in zip(across, 0.9 * v + 0.05)]
    for a, b in zip(x, y):
        n = np.array([-0.3 * b, -0.3 * a, 1]) / np.hypot(np.hypot(0.3 * b, 0.3 * a), 1)
        lines.append("vn {:.6f} {:.6f} {:.6f}".format(*n))
    for row in range(5):
        for column in range(5):
            a = 6 * row + column + 1
            for corners in ((a, a + 1, a + 7), (a, a + 7, a + 6)):
                lines.append("f " + " ".join(f"{i}/{i}/{i}" for i in corners))
    path.write_text("\n".join(lines))


@pytest.fixture
def folder(tmp_path, rng):
    for name, shape in (("paint", (5, 7, 3)), ("other", (6, 4, 3)), ("normal", (6, 6, 3))):
        images.write_exr(tmp_path / f"{name}.exr", rng.uniform(0.02, 0.9, shape), [*"RGB"], {})
    tilts = rng.uniform(-0.3, 0.3, (6, 6, 3))
    tilts[..., 2] = 1
    tilts /= np.linalg.norm(tilts, axis=2, keepdims=True)
    images.write_exr(tmp_path / "normals.exr", (tilts + 1) / 2, [*"RGB"], {})
    images.write_exr(tmp_path / "rough.exr", rng.uniform(0.1, 0.9, (5, 7, 1)), ["Y"], {})
    images.write_exr(tmp_path / "small.exr", rng.uniform(0.1, 0.9, (3, 7, 1)), ["Y"], {})
    trimesh.creation.icosphere(1, 0.5).export(tmp_path / "bare.ply")
    sheet(tmp_path / "sheet.obj")
    sheet(tmp_path / "mirrored.obj", mirrored=True)
    return tmp_path


def exported(folder, inside: str, **arrays) -> tuple[glb.Glb, mi.Scene, list[str]]:
    """The file, Mitsuba's scene beside it, and what was told, of ``arrays`` by key."""
    arrays = arrays or {"lamp.intensity.value": np.array([30, 25, 20], np.float32)}
    (folder / "scene.xml").write_text(SCENE.format(inside=inside))
    unknowns = {key: UnknownConfig(start=0.5) for key in arrays}
    config = SceneConfig(name="file", path=str(folder / "scene.xml"), unknowns=unknowns)
    path, told = export.write(config, arrays, folder / "result")
    assert glb.problems(path.with_suffix(".glb")) == []
    loaded = mi.load_file(str(path), optimize=False)
    return glb.Glb(path.with_suffix(".glb")), loaded, told


ROUGH = {"box.bsdf.roughness.value": np.array([0.35], np.float32)}


def points(part: glb.Part, rng, many: int = 400) -> tuple:
    """Random ones: of each its triangle, and the weights of that one's corners."""
    corners = part.attributes["POSITION"][part.faces].astype(np.float64)
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    chosen = rng.choice(len(area), many, p=area / area.sum())
    return chosen, rng.dirichlet(np.ones(3), many)


def between(part: glb.Part, name: str, chosen, weights) -> np.ndarray:
    return np.einsum("nc,nck->nk", weights, part.attributes[name][part.faces[chosen]])


def hits(scene: mi.Scene, name: str, place: np.ndarray, out: np.ndarray):
    """Where Mitsuba finds the shape ``name``, coming along -``out``, and whether it does."""
    (shape,) = (each for each in scene.shapes() if each.id() == name)
    ray = mi.Ray3f(mi.Point3f((place + 0.02 * out).T), mi.Vector3f(-out.T))
    si = scene.ray_intersect(ray)
    return si, np.array(si.is_valid() & (si.shape == mi.ShapePtr(shape))), shape.bsdf()


def texture(bsdf: mi.BSDF, name: str) -> mi.Texture | None:
    for each, thing in held(bsdf):
        if each == name:
            return thing
        if isinstance(thing, mi.BSDF) and (found := texture(thing, name)) is not None:
            return found
    return None


def fronts(part: glb.Part, chosen) -> np.ndarray:
    """Which side of triangles is seen, by the order of their corners."""
    a, b, c = np.moveaxis(part.attributes["POSITION"][part.faces[chosen]].astype(float), 1, 0)
    found = np.cross(b - a, c - a)
    return found / np.linalg.norm(found, axis=1, keepdims=True)


# Of each shape, the largest difference of nearly all points: 8 bits, and triangles for curves.
SHAPES = {
    "sheet": (CABINET, 0.005),
    "floor": (CABINET, 0.005),
    "ball": (CABINET, 0.006),
    "box": (CABINET, 1e-6),
    "coin": (SHOWCASE, 0.005),
    "can": (SHOWCASE, 0.004),
    "bare": (SHOWCASE, 0.005),
    "two": (SHOWCASE, 0.005),
}


@pytest.mark.parametrize("name", SHAPES)
def test_each_point_has_the_colour_and_the_gloss_that_mitsuba_gives_it(folder, rng, name):
    inside, within = SHAPES[name]
    file, scene, _ = exported(folder, inside)
    part = file.parts[name]
    chosen, weights = points(part, rng)
    uv = {each: between(part, each, chosen, weights) for each in part.attributes if "TEX" in each}
    out = fronts(part, chosen)
    si, valid, bsdf = hits(scene, name, between(part, "POSITION", chosen, weights), out)
    assert valid.mean() > 0.98
    inner, pictures = part.material["pbrMetallicRoughness"], glb.infos(part.material)
    colour = np.tile(inner["baseColorFactor"], (len(chosen), 1))
    if (info := pictures.get("baseColorTexture")) is not None:
        shown = file.look_up(info, uv, srgb=True)
        colour[:, : shown.shape[1]] *= shown
    both = np.tile([inner["roughnessFactor"], inner["metallicFactor"]], (len(chosen), 1))
    if (info := pictures.get("metallicRoughnessTexture")) is not None:
        both *= file.look_up(info, uv, srgb=False)[:, 1:3]
    name_of_colour = "base_color" if texture(bsdf, "base_color") else "reflectance"
    rows = np.ones((len(chosen), 6)) * [0, 0, 0, 1, 1, 0]
    rows[:, :3] = np.array(texture(bsdf, name_of_colour).eval(si)).T
    for column, what in enumerate(("opacity", "roughness", "metallic"), 3):
        if (found := texture(bsdf, what)) is not None:
            rows[:, column] = np.array(found.eval_1(si))
    apart = np.abs(np.hstack([colour, both]) - rows)[valid].max(axis=1)
    assert np.quantile(apart, 0.97) < within, np.quantile(apart, [0.5, 0.9, 0.97, 1])
    # It has been told apart.
    assert name == "box" or rows.std(axis=0).max() > 0.05


def test_numbers_are_neither_rounded_nor_lost(folder):
    file, _, told = exported(folder, CABINET, **ROUGH)
    box = file.parts["box"].material
    inner = box["pbrMetallicRoughness"]
    assert np.allclose(inner["baseColorFactor"], [0.02, 0.003, 0.5, 1], rtol=1e-5)
    assert np.allclose([inner["roughnessFactor"], inner["metallicFactor"]], [0.35, 0.8])
    assert np.isclose(box["extensions"]["KHR_materials_ior"]["ior"], 2 / (1 - 0.024**0.5) - 1)
    sheet, floor, ball = (file.parts[name].material for name in ("sheet", "floor", "ball"))
    assert sheet is floor and sheet["name"] == "paint" and sheet["doubleSided"]
    assert sheet["pbrMetallicRoughness"]["metallicFactor"] == pytest.approx(0.3)
    assert not ball["doubleSided"] and ball["extensions"] == {
        "KHR_materials_specular": {"specularFactor": 0.0}
    }
    assert told == ["scene.glb leaves out: the environment 'sky', the light 'lamp'"]


def test_shapes_that_share_a_material_share_its_pictures(folder, monkeypatch):
    made, own = [], gltf._material
    monkeypatch.setattr(gltf, "_material", lambda each: made.append(each.name) or own(each))
    exported(folder, CABINET)
    assert "paint" in made and len(made) == len(set(made))


def test_what_was_found_is_there(folder, rng):
    """A picture to 8 bits, in sRGB, its first row first."""
    colour = rng.random((5, 7, 3)).astype(np.float32)
    rough = rng.random((5, 7, 1)).astype(np.float32)
    keys = {"paint.brdf_0.base_color.data": colour, "paint.brdf_0.roughness.data": rough}
    file, _, _ = exported(folder, CABINET, **keys)
    material = file.parts["sheet"].material
    pictures = glb.infos(material)
    assert np.array_equal(file.image(pictures["baseColorTexture"]), images.to_display(colour))
    both = file.image(pictures["metallicRoughnessTexture"])
    assert np.array_equal(both[..., 1], np.rint(rough[..., 0] * 255))
    assert (both[..., [0, 2]] == 255).all()


def test_another_library_reads_the_same(folder):
    file, _, _ = exported(folder, CABINET)
    read = trimesh.load_scene(file.path, process=False)
    assert set(read.geometry) == {"sheet", "floor", "ball", "box"}
    for name, part in file.parts.items():
        mesh = read.geometry[name]
        assert np.array_equal(mesh.faces, part.faces)
        assert np.allclose(mesh.vertices, part.attributes["POSITION"])
        assert np.allclose(mesh.visual.uv * [1, -1] + [0, 1], part.attributes["TEXCOORD_0"])


def rebuilt(file: glb.Glb, beside: mi.Scene, turned: bool = False) -> mi.Scene:
    """By Mitsuba, from the file alone, under the lights ``beside``; ``turned``: v runs wrongly."""
    found = {"type": "scene", "integrator": beside.integrator(), "sensor": beside.sensors()[0]}
    found |= {f"light_{n}": light for n, light in enumerate(beside.emitters())}
    for name, part in file.parts.items():
        inner, pictures = part.material["pbrMetallicRoughness"], glb.infos(part.material)

        def numbers(values):
            values = np.ravel(values).tolist()
            return values[0] if len(values) == 1 else {"type": "rgb", "value": values}

        def shown(info, factors, channels, srgb, file=file):
            if info is None:
                return numbers(factors)
            texels = file.image(info)[..., channels] / 255.0
            texels = (images.srgb_decode(texels) if srgb else texels) * factors
            wraps = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
            sampler = file.tree["samplers"][file.tree["textures"][info["index"]]["sampler"]]
            pixels = mi.Bitmap(np.ascontiguousarray(texels, np.float32))
            wrap = wraps[sampler["wrapS"]]
            return {"type": "bitmap", "bitmap": pixels, "raw": True, "wrap_mode": wrap}

        colour = shown(
            pictures.get("baseColorTexture"), inner["baseColorFactor"][:3], slice(3), True
        )
        if "KHR_materials_specular" in part.material.get("extensions", {}):
            bsdf = {"type": "diffuse", "reflectance": colour}
        else:
            both = pictures.get("metallicRoughnessTexture")
            bsdf = {"type": "principled", "base_color": colour}
            bsdf["roughness"] = shown(both, [inner["roughnessFactor"]], [1], False)
            bsdf["metallic"] = shown(both, [inner["metallicFactor"]], [2], False)
            ior = part.material.get("extensions", {}).get("KHR_materials_ior")
            bsdf |= {} if ior is None else {"eta": ior["ior"]}
        if part.material["doubleSided"]:
            bsdf = {"type": "twosided", "bsdf": bsdf}
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict(bsdf)
        own = part.attributes
        mesh = mi.Mesh(
            name,
            len(own["POSITION"]),
            len(part.faces),
            has_vertex_normals="NORMAL" in own,
            has_vertex_texcoords="TEXCOORD_0" in own,
            props=properties,
        )
        values = mi.traverse(mesh)
        values["vertex_positions"], values["faces"] = own["POSITION"].ravel(), part.faces.ravel()
        if "NORMAL" in own:
            values["vertex_normals"] = own["NORMAL"].ravel()
        if "TEXCOORD_0" in own:
            uv = own["TEXCOORD_0"]
            values["vertex_texcoords"] = (uv * [1, -1] + [0, 1] if turned else uv).ravel()
        values.update()
        found[name] = mesh
    return mi.load_dict(found, optimize=False)


def test_it_is_rendered_as_mitsubas_file_is(folder):
    file, scene, _ = exported(folder, CABINET, **ROUGH)
    wanted, got, turned = (
        np.array(mi.render(each, spp=128, seed=3))
        for each in (scene, rebuilt(file, scene), rebuilt(file, scene, turned=True))
    )
    apart = np.abs(got - wanted).mean() / wanted.mean()
    assert apart < 0.004 < 0.1 < np.abs(turned - wanted).mean() / wanted.mean(), apart


BUMPS = """<shape type="obj" id="sheet"><string name="filename" value="{sheet}.obj"/>
  <bsdf type="normalmap"><texture type="bitmap" name="normalmap">
      <string name="filename" value="normals.exr"/><boolean name="raw" value="true"/></texture>
    <boolean name="use_shadowing_function" value="false"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></bsdf></shape>"""


@pytest.mark.parametrize("name", ["sheet", "mirrored"])
def test_a_normal_map_turns_normals_as_mitsuba_does(folder, rng, name):
    """By glTF's tangents: x where u grows, y where v falls."""
    file, scene, told = exported(folder, BUMPS.format(sheet=name))
    part = file.parts["sheet"]
    assert "normal map" not in " ".join(told)
    chosen, weights = points(part, rng)
    uv = {"TEXCOORD_0": between(part, "TEXCOORD_0", chosen, weights)}
    x, y, z = np.moveaxis(file.look_up(part.material["normalTexture"], uv, False) * 2 - 1, 1, 0)
    n = between(part, "NORMAL", chosen, weights)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    a, b, c = np.moveaxis(part.attributes["POSITION"][part.faces[chosen]].astype(float), 1, 0)
    s, t, r = np.moveaxis(part.attributes["TEXCOORD_0"][part.faces[chosen]].astype(float), 1, 0)
    (du1, dv1), (du2, dv2) = (t - s).T, (r - s).T
    scale = (1 / (du1 * dv2 - du2 * dv1))[:, None]
    right = ((b - a) * dv2[:, None] - (c - a) * dv1[:, None]) * scale
    up = -((c - a) * du1[:, None] - (b - a) * du2[:, None]) * scale
    right -= n * (n * right).sum(1, keepdims=True)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    other = np.cross(n, right)
    other *= np.sign((other * up).sum(1, keepdims=True))
    own = between(part, "TANGENT", chosen, weights)
    assert ((own[:, :3] * right).sum(axis=1) > 0.95).all()
    side = np.sign((np.cross(n, own[:, :3]) * up).sum(axis=1))
    assert np.allclose(own[:, 3], side)
    wanted = x[:, None] * right + y[:, None] * other + z[:, None] * n
    wanted /= np.linalg.norm(wanted, axis=1, keepdims=True)
    # What a matt surface reflects three ways tells its normal.
    si, valid, bsdf = hits(
        scene, "sheet", between(part, "POSITION", chosen, weights), fronts(part, chosen)
    )
    ways = [n + 0.3 * right, n + 0.3 * other, n - 0.3 * right - 0.2 * other]
    ways = [way / np.linalg.norm(way, axis=1, keepdims=True) for way in ways]
    cosines = [
        np.array(bsdf.eval(mi.BSDFContext(), si, si.to_local(mi.Vector3f(way.T)))).T[:, 0]
        for way in ways
    ]
    matrix = np.stack(ways, axis=1)
    got = np.linalg.solve(matrix, np.stack(cosines, axis=1)[..., None] * np.pi / 0.5)[..., 0]
    apart = np.linalg.norm(got - wanted, axis=1)[valid]
    assert valid.mean() > 0.98
    assert np.quantile(apart, 0.97) < 0.008, np.quantile(apart, [0.5, 0.9, 0.97, 1])
    assert np.linalg.norm(wanted - n, axis=1).mean() > 0.1


OTHERS = """
  <shape type="cube" id="gold"><bsdf type="roughconductor"><string name="material" value="Au"/>
    </bsdf></shape>
  <shape type="cube" id="toy"><bsdf type="plastic"><rgb name="diffuse_reflectance"
    value="0.1,0.5,0.2"/></bsdf></shape>
  <shape type="cube" id="glass"><bsdf type="dielectric"/></shape>
  <shape type="cube" id="silk"><bsdf type="principled"><float name="sheen" value="0.5"/>
    <float name="clearcoat" value="0"/></bsdf></shape>
  <shape type="cube" id="lit"><emitter type="area"><rgb name="radiance" value="3"/></emitter>
    <bsdf type="twosided"><bsdf type="diffuse"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.1"/></bsdf></bsdf></shape>
  <shape type="cube" id="mist"><bsdf type="null"/><medium type="homogeneous" name="interior"/>
    </shape>
  <shape type="rectangle" id="bumpy"><bsdf type="bumpmap"><texture type="bitmap" name="heights">
    <string name="filename" value="rough.exr"/><boolean name="raw" value="true"/></texture>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.3"/></bsdf></bsdf></shape>
  <shape type="shapegroup" id="group"><shape type="cube"/></shape>
  <shape type="instance" id="copy"><ref id="group"/></shape>
"""


def test_what_gltf_cannot_say_is_named_in_one_line(folder):
    file, scene, told = exported(folder, OTHERS)
    assert told == [
        "scene.glb leaves out: the environment 'sky', the light 'lamp', the light of 'lit', "
        "the volume in 'mist', the shape 'copy', all but colour and roughness of the "
        "'roughconductor' of 'gold', all but the colour of the 'plastic' of 'toy', the "
        "'dielectric', which is matt and grey there, of 'glass', 'sheen' of 'silk', the back of "
        "'lit', the bump map of 'bumpy'"
    ]
    assert set(file.parts) == {"gold", "toy", "glass", "silk", "lit", "bumpy"}
    toy = file.parts["toy"].material["pbrMetallicRoughness"]
    assert np.allclose(toy["baseColorFactor"], [0.1, 0.5, 0.2, 1])
    assert toy["roughnessFactor"] == 1 and toy["metallicFactor"] == 0
    gold, params = file.parts["gold"].material["pbrMetallicRoughness"], mi.traverse(scene)
    η, k = (np.ravel(params[f"gold.bsdf.{name}.value"]) for name in ("eta", "k"))
    index = [mi.Complex2f(float(a), float(b)) for a, b in zip(η, k)]
    reflected = [mi.fresnel_conductor(1.0, each)[0] for each in index]
    assert np.allclose(gold["baseColorFactor"], [*reflected, 1], atol=1e-4)
    assert gold["metallicFactor"] == 1 and gold["roughnessFactor"] == pytest.approx(0.1**0.5)


def test_an_opacity_that_is_left_at_its_mean_cuts_nothing_out(folder):
    """Its picture stands otherwise than the colour's: holes would be all of it or none."""
    holes = np.ones((4, 4, 1), np.float32)
    holes[1:] = 0
    images.write_exr(folder / "holes.exr", holes, ["Y"], {})
    leaf = """<shape type="rectangle" id="leaf"><bsdf type="mask">
      <texture type="bitmap" name="opacity"><string name="filename" value="holes.exr"/>
        <boolean name="raw" value="true"/><string name="wrap_mode" value="{wrap}"/></texture>
      <bsdf type="diffuse"><texture type="bitmap" name="reflectance">
        <string name="filename" value="paint.exr"/></texture></bsdf></bsdf></shape>"""
    for wrap, mode, told in (("repeat", "MASK", False), ("clamp", "BLEND", True)):
        file, _, said = exported(folder, leaf.format(wrap=wrap))
        assert file.parts["leaf"].material["alphaMode"] == mode
        assert any("but for its mean" in line for line in said) == told
        if told:
            alpha = file.parts["leaf"].material["pbrMetallicRoughness"]["baseColorFactor"][3]
            assert alpha == pytest.approx(0.25)


def test_a_flipped_shape_is_seen_from_within(folder):
    file, _, _ = exported(folder, SHOWCASE)
    part = file.parts["world"]
    every = np.arange(len(part.faces))
    middle = part.attributes["POSITION"][part.faces].mean(axis=1) - [6, 0, 0]
    assert ((fronts(part, every) * middle).sum(axis=1) < 0).all()
    assert ((part.attributes["NORMAL"][part.faces[:, 0]] * middle).sum(axis=1) < 0).all()
    for name in ("ball", "sheet"):
        file, _, _ = exported(folder, CABINET)
        part = file.parts[name]
        n = part.attributes["NORMAL"][part.faces[:, 0]]
        assert ((fronts(part, np.arange(len(part.faces))) * n).sum(axis=1) > 0.9).all()


VALIDATE = """const fs = require('fs'), bytes = new Uint8Array(fs.readFileSync(process.argv[1]))
require('gltf-validator').validateBytes(bytes).then(r => console.log(JSON.stringify(r.issues)))"""


@pytest.mark.parametrize("inside", ["cabinet", "showcase", "bumps", "others"])
def test_khronoss_validator_finds_nothing(folder, inside):
    """Where `node` finds it: npm install gltf-validator, and NODE_PATH."""
    node = shutil.which("node")
    asked = [node, "-e", "require('gltf-validator')"]
    if node is None or subprocess.run(asked, capture_output=True).returncode:
        pytest.skip("node does not find gltf-validator")
    scenes = {"cabinet": CABINET, "showcase": SHOWCASE, "others": OTHERS}
    scenes["bumps"] = BUMPS.format(sheet="mirrored")
    file, _, _ = exported(folder, scenes[inside])
    done = subprocess.run([node, "-e", VALIDATE, str(file.path)], capture_output=True, text=True)
    issues = json.loads(done.stdout)
    worst = [each for each in issues["messages"] if each["severity"] < 2]
    assert worst == [] and issues["numErrors"] == issues["numWarnings"] == 0


def test_vertices_have_the_colours_that_they_had(folder, rng):
    ball = trimesh.creation.icosphere(1, 0.5)
    mesh = mi.Mesh("ball", len(ball.vertices), len(ball.faces))
    values = mi.traverse(mesh)
    values["vertex_positions"] = ball.vertices.astype(np.float32).ravel()
    values["faces"] = ball.faces.astype(np.uint32).ravel()
    values.update()
    colours = rng.random((len(ball.vertices), 3)).astype(np.float32)
    mesh.add_attribute("vertex_tint", 3, colours.ravel())
    mesh.write_ply(str(folder / "tinted.ply"))
    dr.sync_thread()
    inside = """<shape type="ply" id="ball"><string name="filename" value="tinted.ply"/>
      <bsdf type="diffuse"><texture type="mesh_attribute" name="reflectance">
        <string name="name" value="vertex_tint"/></texture></bsdf></shape>"""
    file, _, _ = exported(folder, inside)
    part = file.parts["ball"]
    assert np.allclose(part.attributes["COLOR_0"], colours)
    assert part.material["pbrMetallicRoughness"]["baseColorFactor"] == [1, 1, 1, 1]
    mesh.add_attribute("face_tint", 3, rng.random(3 * len(ball.faces)).astype(np.float32))
    mesh.write_ply(str(folder / "tinted.ply"))
    file, _, told = exported(folder, inside.replace("vertex_tint", "face_tint"))
    part = file.parts["ball"]
    assert "the 'mesh_attribute' of the colour, which is 0.5 there, of 'ball'" in told[0]
    assert "COLOR_0" not in part.attributes
    assert np.allclose(part.material["pbrMetallicRoughness"]["baseColorFactor"], [0.5] * 3 + [1])
