#!/usr/bin/python3
"""Two stereo pairs of pinhole cameras, one on each face: the front's found on the specimen from points, the back's calibrated in the
specimen's frame. Images, correlation of both faces, identification with all four cameras.

Usage: two_rigs.py EXECUTABLE [--ranks 2]
"""
import json
import math
import sys

import h5py
import numpy
from scipy.interpolate import griddata

from runs import end, gmsh, ranks_of, require, run, workspace

SIZE, FOCAL = (420, 440), 7000.0
VIEWS = {"front_left": ("front", [-85, 0, 391], [0, 0, 0], 0.0), "front_right": ("front", [85, 4, 391], [0, 0, 0], 1.0),
         "back_left": ("back", [-85, 0, -395], [0, 0, -4], 0.0), "back_right": ("back", [85, 4, -395], [0, 0, -4], 1.0)}
CASE = """
title: Two rigs
specimen: {{mesh: {mesh}.msh, element: hex20, thickness: 4, layers: {layers}, mid_plane_symmetry: true, held: bottom, loaded: top{place}}}
cameras:
{cameras}
material:
  hardening: power_linear
  tie_initial_modulus: true
  parameters: {{E: {E}, nu: 0.25, S_y: {S_y}, H: 1480, delta: 0.042}}
"""
VIRTUAL = """
simulate: {centred: true, value: [0, 0.008, 0.016, 0.024, 0.05, 0.1, 0.2]}
virtual: {load_noise: 5, static_frames: 3, directory: made}
output: made
"""
IDENTIFY = """
loads: {{file: made/loads.csv, noise: 5}}
identify:
  stages:
    - {{free: [E], frames: "3-5"}}
    - {{free: [S_y], frames: "3-8"}}
output: {output}
"""


def pose(view):
    """Rotation and translation from the specimen's frame to a camera's (x to the right, y downwards, z along the view)."""
    _, origin, at, roll = view
    z = numpy.subtract(at, origin) / numpy.linalg.norm(numpy.subtract(at, origin))
    x = numpy.cross(z, [0, 1, 0])
    x /= numpy.linalg.norm(x)
    c, s = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    R = numpy.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ numpy.array([x, numpy.cross(z, x), z])
    return R, -R @ numpy.array(origin, float)


def calibration(names):
    """OpenCV's YAML of cameras in the specimen's frame."""
    matrix = lambda values: "!!opencv-matrix\n         rows: %d\n         cols: %d\n         dt: d\n         data: %s" % (
        *numpy.atleast_2d(values).shape, [float(v) for v in numpy.ravel(values)])
    K = [[FOCAL, 0, 0.5 * (SIZE[0] - 1)], [0, FOCAL, 0.5 * (SIZE[1] - 1)], [0, 0, 1]]
    text = "%YAML:1.0\n---\ncameras:\n"
    for name in names:
        R, t = pose(VIEWS[name])
        text += (f"   -\n      name: {name}\n      image_width: {SIZE[0]}\n      image_height: {SIZE[1]}\n      camera_matrix: {matrix(K)}\n"
                 f"      distortion_coefficients: {matrix([[0.0] * 5])}\n      rotation: {matrix(R)}\n      translation: {matrix(t.reshape(3, 1))}\n")
    return text


def main():
    program, ranks = sys.argv[1], ranks_of(sys.argv)
    folder = workspace("two_rigs")
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.7, size_far=1.8)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=1.4, size_far=3.2)
    views = "".join(f"  - {{name: {name}, model: pinhole, face: {face}, size: {list(SIZE)}, view: {{focal: {FOCAL}, from: {origin}, at: {at}, roll: {roll}}}}}\n"
                    for name, (face, origin, at, roll) in VIEWS.items())
    (folder / "virtual.yaml").write_text(CASE.format(mesh="fine", layers=2, place="", cameras=views, E=198e3, S_y=284) + VIRTUAL)
    run(program, "virtual", folder / "virtual.yaml", ranks)
    points = json.loads((folder / "made/truth.json").read_text())["place_points"]["front_left"]
    back = [name for name in VIEWS if VIEWS[name][0] == "back"]
    (folder / "back.yaml").write_text(calibration(back))

    def cameras(names, framed=True):
        return "".join("  - {name: %s, model: pinhole, face: %s, calibration: %s, images: 'made/images_%s/*.png', reference: 0-2%s}\n" % (
            name, VIEWS[name][0], "back.yaml" if name in back else "made/calibration_front.yaml", name,
            f", index: {back.index(name)}" + (", frame: specimen" if framed else "") if name in back else "") for name in names)

    def identify(output, names, framed=True, status=0):
        place = f", place: {{camera: front_left, points: {points}}}" if any(name not in back for name in names) else ""
        case = folder / f"{output}.yaml"
        case.write_text(CASE.format(mesh="coarse", layers=1, place=place, cameras=cameras(names, framed), E=185e3, S_y=265) +
                        IDENTIFY.format(output=output))
        said = run(program, "identify", case, ranks, status=status, errors=status != 0)
        return said if status else json.loads((folder / output / "result.json").read_text())

    # Errors against the truth: 0.5 % for the mesh, and four standard deviations of what the images' noise predicts.
    for label, names in (("both rigs", list(VIEWS)), ("back alone", back)):
        result = identify(label.replace(" ", "_"), names)
        for name, truth in (("E", 198e3), ("S_y", 284.0)):
            value, deviation = (result["parameters"][name][key] for key in ("value", "standard_deviation"))
            limit = 0.005 * truth + 4.0 * deviation
            require(abs(value - truth) < limit, f"{label}: {name} {100 * (value / truth - 1):+.2f} % (noise {100 * deviation / truth:.2f} %)")

    # Both pairs see the face thin towards the hole as the simulation that made the images did.
    run(program, "dic", folder / "both_rigs.yaml", ranks, ["--output", str(folder / "dic")])
    with h5py.File(folder / "made/results.h5") as made:
        volume, moved = made["mesh/nodes"][:], made["fields/displacement"][6, :, 2]
    face = numpy.abs(volume[:, 2] - volume[:, 2].max()) < 1e-9
    for name, sign in (("front", 1.0), ("back", -1.0)):
        noise = json.loads((folder / f"dic/{name}/result.json").read_text())["standard_deviation"]["out_of_plane"]["value"]
        with h5py.File(folder / f"dic/{name}/results.h5") as seen:
            nodes, through = seen["surface/nodes"][:], seen["dic/displacement"][8, :, 2]
        expected = sign * griddata(volume[face, :2], moved[face], nodes[:, :2])
        inside = numpy.isfinite(expected)
        gap = (through - expected)[inside]
        gap -= gap.mean()
        require(numpy.std(gap) < 1.3 * noise and numpy.corrcoef(through[inside], expected[inside])[0, 1] > 0.8,
                f"{name}: motion through the face within {1e3 * numpy.std(gap):.1f} um (rms; noise of a node {1e3 * noise:.1f} um), it thins by "
                f"{1e3 * numpy.ptp(expected[inside]):.0f} um")

    # specimen.place finds one rig only.
    said = identify("unplaced", list(VIEWS), framed=False, status=2)
    require("specimen.place places one rig" in said, "a second rig without a frame is refused")
    end()


main()
