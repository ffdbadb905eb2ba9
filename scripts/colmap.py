#!/usr/bin/env python3
"""What COLMAP, offline structure from motion, makes of a sequence in TUM layout: its ATE, to compare with.

    scripts/colmap.py SEQUENCE [--every N]

Images, every Nth one, with the calibration of the folder held fixed, SIFT on the processor, sequential matching and one
incremental reconstruction, all with the defaults of pycolmap. Prints the images, those with a pose, and the root mean
square of the errors of positions after alignment with scale, as `evo_ape -as`. Needs `pip install pycolmap numpy`.
"""
import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import pycolmap


def lines(path):
    return [line.split() for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]


def camera_of(folder):
    """Model and parameters as COLMAP names them."""
    values = [float(word) for word in lines(folder / "calibration.txt")[0]]
    lens = values[4:-2]
    if len(lens) not in (0, 4, 5):
        sys.exit(f"{folder}/calibration.txt has {len(values)} numbers, expected 6, 10 or 11")
    # the middle of the first pixel is (0.5, 0.5) there
    params = values[:2] + [values[2] + 0.5, values[3] + 0.5] + lens
    if len(lens) == 5:
        return "FULL_OPENCV", params + [0.0] * 3
    return ("OPENCV" if lens else "PINHOLE"), params


def aligned_error(estimated, truth):
    """Root mean square of the distances after the best similarity (Umeyama)."""
    mean_e, mean_t = estimated.mean(0), truth.mean(0)
    e, t = estimated - mean_e, truth - mean_t
    u, s, vt = np.linalg.svd(t.T @ e / len(e))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(sign) @ vt
    scale = (s * sign).sum() / (e**2).sum() * len(e)
    return float(np.sqrt((((t - scale * e @ rotation.T) ** 2).sum(1)).mean()))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("sequence", type=Path)
    parser.add_argument("--every", type=int, default=5)
    arguments = parser.parse_args()
    folder = arguments.sequence
    images = lines(folder / "rgb.txt")[:: arguments.every]
    truth = np.array([[float(word) for word in line[:4]] for line in lines(folder / "groundtruth.txt")])
    times = {Path(name).name: float(time) for time, name in images}
    model, params = camera_of(folder)
    with tempfile.TemporaryDirectory() as work:
        work = Path(work)
        database = work / "database.db"
        reader = pycolmap.ImageReaderOptions(camera_model=model, camera_params=",".join(map(str, params)))
        pycolmap.extract_features(
            database, folder / Path(images[0][1]).parent, [Path(name).name for _, name in images],
            camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader, device=pycolmap.Device.cpu,
        )
        pycolmap.match_sequential(database, device=pycolmap.Device.cpu)
        # a camera with k3 above 1 passes for a wrong one otherwise
        options = pycolmap.IncrementalPipelineOptions(
            ba_refine_focal_length=False, ba_refine_principal_point=False, ba_refine_extra_params=False,
            max_extra_param=10,
        )
        found = pycolmap.incremental_mapping(database, folder / Path(images[0][1]).parent, work, options)
    best = max(found.values(), key=lambda model: model.num_reg_images(), default=None)
    if best is None:
        print(f"{folder.name}: {len(images)} images, 0 with a pose")
        return
    estimated, reference = [], []
    for image in best.images.values():
        if not image.has_pose:
            continue
        time = times[image.name]
        nearest = np.abs(truth[:, 0] - time).argmin()
        if abs(truth[nearest, 0] - time) <= 0.02:
            estimated.append(image.projection_center())
            reference.append(truth[nearest, 1:4])
    error = aligned_error(np.array(estimated), np.array(reference))
    print(
        f"{folder.name}: {len(images)} images, {best.num_reg_images()} with a pose, "
        f"ATE {error:.2g} m over {len(estimated)} (pycolmap {pycolmap.__version__})"
    )


if __name__ == "__main__":
    main()
