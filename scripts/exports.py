#!/usr/bin/env python3
"""What independent readers say of the exports of a run.

    scripts/exports.py RUN [PROGRAM [TRUTH.ply]]

Exports the run in every format into a temporary folder and opens each with a reader that is not
ours: COLMAP's model with pycolmap, OBJ and STL with trimesh, LAS with laspy, DXF with ezdxf, USDZ
with usd-core, the map in colour with pyoctomap; the cameras of transforms.json are compared with
those of pycolmap, and read by nerfstudio where that is installed (`pip install nerfstudio`, which
brings PyTorch). mesh.glb goes through Khronos' validator where NODE_PATH leads to it (`npm install
gltf-validator`), and plan.dxf through ezdxf. With the true mesh: how far the surface is from it, and
how much of it is there. Needs `pip install pycolmap trimesh pillow scipy laspy ezdxf usd-core pyoctomap`.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import ezdxf
import laspy
import numpy
import pycolmap
import pyoctomap
import trimesh
from pxr import Usd, UsdGeom, UsdShade
from scipy.spatial import cKDTree


FORMATS = ("colmap", "nerf", "obj", "stl", "las", "dxf", "usdz", "ot")


def main():
    run = Path(sys.argv[1])
    program = sys.argv[2] if len(sys.argv) > 2 else "target/release/monogrid"
    with tempfile.TemporaryDirectory() as folder:
        out = {to: Path(folder) / f"out.{to}" for to in FORMATS}
        for to, path in out.items():
            command = [program, "export", run, "--to", to, "--out", path]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        model = pycolmap.Reconstruction(out["colmap"] / "sparse/0")
        errors = reprojection_errors(model)
        print(
            f"pycolmap: {len(model.images)} images, {len(model.points3D)} points, reprojection error "
            f"{errors.mean():.2f} px on average, {numpy.median(errors):.2f} px in the median"
        )
        assert errors.mean() < 1.0
        # the text says the same
        for name in ("cameras", "images", "points3D"):
            (out["colmap"] / f"sparse/0/{name}.bin").unlink()
        text = pycolmap.Reconstruction(out["colmap"] / "sparse/0")
        assert text.summary() == model.summary(), text.summary()
        compare_cameras(model, json.loads((out["nerf"] / "transforms.json").read_text()))
        read_by_nerfstudio(out["nerf"], len(model.images))
        original = trimesh.load(run / "mesh.ply", process=False)
        for to in ("obj", "stl"):
            mesh = trimesh.load(out[to], process=False)
            assert len(mesh.faces) == len(original.faces)
            # numbers of text and of binary files differ in their last digits
            assert numpy.allclose(mesh.bounds, original.bounds, atol=1e-4)
            picture = getattr(mesh.visual, "material", None) if to == "obj" else None
            if picture is not None:
                print(f"trimesh, obj: a picture of {picture.image.size} pixels")
            print(f"trimesh, {to}: {len(mesh.faces)} triangles, area {mesh.area:.3f} ({original.area:.3f} before)")
        cloud, points = trimesh.load(run / "cloud.ply"), laspy.read(out["las"])
        assert numpy.allclose(points.xyz, cloud.vertices, atol=1e-3)
        assert (numpy.stack([points.red, points.green, points.blue], 1) // 257 == cloud.colors[:, :3]).all()
        print(f"laspy: {len(points)} points")
        check_dxf(out["dxf"], original)
        check_usdz(out["usdz"], original)
        check_colours(out["ot"], run / "cells.ply")
    check_plan(run / "plan.dxf")
    check_glb(run / "mesh.glb")
    if len(sys.argv) > 3:
        compare_surface(original, trimesh.load(sys.argv[3], process=False))


def check_plan(file):
    document = ezdxf.readfile(file)
    assert not document.audit().has_errors
    layers = [line.dxf.layer for line in document.modelspace().query("LINE")]
    counts = {layer: layers.count(layer) for layer in sorted(set(layers))}
    print(f"ezdxf, plan: lines by layer {counts}")
    assert counts["obstacle"] > 0 and counts["path"] > 0


def check_glb(file):
    script = (
        "require('gltf-validator').validateBytes(new Uint8Array(require('fs')"
        f".readFileSync({json.dumps(str(file))}))).then((said) => console.log(JSON.stringify(said)))"
    )
    node = subprocess.run(["node", "-e", script], capture_output=True, text=True)
    if node.returncode != 0:
        print("gltf-validator: not installed, or NODE_PATH does not lead to it")
        return
    said = json.loads(node.stdout)
    issues, info = said["issues"], said["info"]
    size = file.stat().st_size / 1e6
    print(
        f"gltf-validator: {size:.1f} MB, {info['totalTriangleCount']} triangles, "
        f"{issues['numErrors']} errors, {issues['numWarnings']} warnings"
    )
    assert issues["numErrors"] == 0


def compare_surface(mesh, truth):
    places = trimesh.sample.sample_surface(mesh, 200_000, seed=0)[0]
    away = distances(places, truth)
    true_places = trimesh.sample.sample_surface(truth, 200_000, seed=0)[0]
    missing = distances(true_places, mesh)
    print(
        f"surface: {1e3 * away.mean():.1f} mm from the true one on average, "
        f"{1e3 * numpy.median(away):.1f} in the median, {1e3 * numpy.quantile(away, 0.9):.1f} for 90 %; "
        f"of the true one {(missing < 0.02).mean():.1%} within 2 cm, {(missing < 0.05).mean():.1%} within 5"
    )


def distances(places, mesh, near=6):
    """Of places from a mesh: from the nearest of the triangles of the samples nearest to each."""
    samples, triangles = trimesh.sample.sample_surface(mesh, 400_000, seed=1)
    found = cKDTree(samples).query(places, k=near)[1]
    away = [
        trimesh.triangles.closest_point(mesh.triangles[triangles[found[:, k]]], places) - places
        for k in range(near)
    ]
    return numpy.linalg.norm(away, axis=2).min(axis=0)


def read_by_nerfstudio(folder, count):
    try:
        from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig
    except ImportError as error:
        print(f"nerfstudio: not installed ({error})")
        return
    parser = NerfstudioDataParserConfig(data=folder, eval_mode="all", load_3D_points=True).setup()
    outputs = parser.get_dataparser_outputs(split="train")
    assert len(outputs.image_filenames) == len(outputs.cameras) == count
    points = outputs.metadata["points3D_xyz"]
    print(f"nerfstudio: {len(outputs.cameras)} cameras, {len(points)} points")


def check_dxf(file, mesh):
    document = ezdxf.readfile(file)
    assert not document.audit().has_errors
    faces = document.modelspace().query("3DFACE")
    corners = numpy.array([[face.dxf.vtx0, face.dxf.vtx1, face.dxf.vtx2] for face in faces])
    assert numpy.allclose(corners, mesh.vertices[mesh.faces], atol=1e-4)
    print(f"ezdxf: {len(faces)} faces")


def check_usdz(file, mesh):
    stage = Usd.Stage.Open(str(file))
    surface = UsdGeom.Mesh(stage.GetPrimAtPath("/map/surface"))
    assert numpy.allclose(surface.GetPointsAttr().Get(), mesh.vertices, atol=1e-4)
    indices = numpy.array(surface.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    assert (indices == mesh.faces).all()
    colours = UsdGeom.PrimvarsAPI(surface).GetPrimvar("displayColor").Get()
    assert len(colours) == len(mesh.vertices)
    look = UsdShade.MaterialBindingAPI(surface).ComputeBoundMaterial()[0]
    if look:
        picture = UsdShade.Shader(stage.GetPrimAtPath("/map/look/picture"))
        assert picture.GetInput("file").Get().resolvedPath, "the picture is not found"
        places = UsdGeom.PrimvarsAPI(surface).GetPrimvar("st").Get()
        assert len(places) == 3 * len(indices)
    print(f"usd-core: {len(indices)} triangles in colour, {'with' if look else 'without'} a picture")


def check_colours(file, cells):
    tree = pyoctomap.ColorOcTree(0.1).read(str(file))
    cloud = trimesh.load(cells)
    for place, colour in list(zip(cloud.vertices, cloud.colors))[:: max(1, len(cloud.vertices) // 500)]:
        node = tree.search(numpy.array(place, dtype=float))
        found = node.getColor()
        # a leaf of several cells has their mean
        assert node.getOccupancy() > 0.5 and numpy.abs(numpy.array(found) - colour[:3]).max() < 100
    print(f"pyoctomap: {tree.getNumLeafNodes()} leaves in colour")


def reprojection_errors(model):
    errors = []
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        for feature in image.points2D:
            if feature.has_point3D():
                place = model.points3D[feature.point3D_id].xyz
                at = camera.img_from_cam(image.cam_from_world() * place)
                errors.append(numpy.linalg.norm(at - feature.xy))
    return numpy.array(errors)


def compare_cameras(model, transforms):
    by_name = {image.name: image for image in model.images.values()}
    for frame in transforms["frames"]:
        image = by_name[Path(frame["file_path"]).name]
        # readers of transforms.json look along -z, with y up
        world_from_camera = numpy.array(frame["transform_matrix"]) @ numpy.diag([1, -1, -1, 1])
        expected = image.cam_from_world().inverse().matrix()
        assert numpy.allclose(world_from_camera[:3], expected, atol=1e-9)
    print(f"transforms.json: {len(transforms['frames'])} cameras as pycolmap reads them")


if len(sys.argv) < 2:
    sys.exit(__doc__)
main()
