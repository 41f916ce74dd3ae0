#!/usr/bin/python3
"""A virtual test with a telecentric camera on the front and two pinhole cameras on the back, on 2 ranks: images, correlation of both
faces, identification with all three cameras, and the share of the calibration in the standard deviations.

Usage: two_faces.py EXECUTABLE
"""
import json
import pathlib
import sys
import tempfile

import h5py
import numpy

from runs import end, gmsh, require, run

SPECIMEN = "{{mesh: {mesh}.msh, thickness: 4, layers: {layers}, mid_plane_symmetry: {half}, held: bottom, loaded: top{place}}}"
MATERIAL = """
material:
  hardening: power_linear
  tie_initial_modulus: true
  parameters: {{E: {E}, nu: 0.25, S_y: {S_y}, H: 1480, delta: 0.042}}
"""
VIRTUAL = """
title: Three cameras
specimen: """ + SPECIMEN + """
cameras:
  - {{name: mono, pixel_size: 0.08, place: {{origin: [149.5, 164.5]}}, size: [300, 330]}}
  - {{name: left, model: pinhole, face: back, size: [330, 350], view: {{focal: 5600, from: [-85, 0, -395], at: [0, 0, -4], distortion: [0.05, 0, 0.001]}}}}
  - {{name: right, model: pinhole, face: back, size: [330, 350], view: {{focal: 5600, from: [85, 4, -395], at: [0, 0, -4], roll: 1}}}}
""" + MATERIAL + """
simulate:
  centred: true
  value: [0, 0.006, 0.012, 0.018, 0.05, 0.1, 0.2]
virtual: {{load_noise: 5, static_frames: 2, directory: made}}
output: made
"""
IDENTIFY = """
title: Three cameras
specimen: """ + SPECIMEN + """
cameras:
{cameras}
loads: {{file: made/loads.csv, noise: 5}}
""" + MATERIAL + """
identify:
  functional: {functional}
  noise_draws: {draws}
  stages:
    - {{free: [E], frames: "2-4"}}
    - {{free: [S_y], frames: "2-7"}}
output: {output}
"""
MONO = "  - {{name: mono, pixel_size: {pixel:.8g}, place: {{origin: [149.5, 164.5]}}, images: 'made/images_mono/*.png', reference: 0-1{sd}}}\n"
BACK = "".join("  - {{name: %s, model: pinhole, face: back, calibration: {calibration}, images: 'made/images_%s/*.png', reference: 0-1{sd}}}\n" % (name, name)
               for name in ("left", "right"))


def main():
    program = sys.argv[1]
    folder = pathlib.Path(tempfile.mkdtemp(prefix="imic3d_two_faces_"))
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.7, size_far=1.8)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=0.8, size_far=2.0)
    (folder / "virtual.yaml").write_text(VIRTUAL.format(mesh="fine", layers=2, half="true", place="", E=198e3, S_y=284))
    run(program, "virtual", folder / "virtual.yaml", 2)
    for name in ("mono", "left", "right"):
        require(len(list((folder / f"made/images_{name}").glob("*.png"))) == 8, f"8 images of {name}")
    points = json.loads((folder / "made/truth.json").read_text())["place_points"]["left"]
    place = f", place: {{camera: left, points: {points}}}"

    def identify(output, cameras, functional="force_driven", draws=0, half="true", ranks=2, status=0):
        where = place if "pinhole" in cameras else ""
        case = folder / f"{output}.yaml"
        case.write_text(IDENTIFY.format(mesh="coarse", layers=1 if half == "true" else 2, half=half, place=where, cameras=cameras, E=185e3, S_y=265,
                                        functional=functional, draws=draws, output=f"{output}_{ranks}"))
        run(program, "identify", case, ranks, status=status)
        if status:
            return None
        result = json.loads((folder / f"{output}_{ranks}/result.json").read_text())
        return result

    def values(result):
        return numpy.array([result["parameters"][name]["value"] for name in ("E", "S_y")])

    mono, back = MONO.format(pixel=0.08, sd=""), BACK.format(calibration="made/calibration_back.yaml", sd="")
    truth = numpy.array([198e3, 284.0])
    one = identify("all", mono + back)
    # The coarse mesh of hex8 alone costs about 1 % of each, noise of three elastic frames 1 to 2 % of E.
    for name, result, limit in (("three cameras", one, (0.03, 0.015)),
                                ("three cameras, full thickness", identify("full", mono + back, half="false"), (0.03, 0.015)),
                                ("three cameras, displacement driven", identify("driven", mono + back, "displacement_driven"), (0.03, 0.02)),
                                ("stereo pair", identify("stereo", back), (0.03, 0.015))):
        error = values(result) / truth - 1
        require(abs(error[0]) < limit[0] and abs(error[1]) < limit[1], f"{name}: E {100 * error[0]:+.2f} %, S_y {100 * error[1]:+.2f} %")
    alone = values(identify("all", mono + back, ranks=1))
    require(numpy.max(numpy.abs(alone / values(one) - 1)) < 1e-8, "1 rank and 2 identify the same")
    noise = one["noise"]["cameras"]
    require(all(abs(noise[name]["value"] / 2.55 - 1) < 0.1 for name in noise), f"noise of each camera {[round(noise[name]['value'], 2) for name in noise]} (2.55)")

    # What the cameras see of the motion through the back against the simulation that made the images.
    with h5py.File(folder / "all_2/results.h5") as seen, h5py.File(folder / "made/results.h5") as made:
        nodes, u = seen["surface/nodes"][:], seen["dic/displacement"][7]
        back_nodes = nodes[:, 2] < -2
        volume, moved = made["mesh/nodes"][:], made["fields/displacement"][6]
        front = numpy.abs(volume[:, 2]) < 1e-9  # half the thickness was simulated: the back is the front's mirror image
        nearest = [numpy.argmin(numpy.linalg.norm(volume[front, :2] - x, axis=1)) for x in nodes[back_nodes, :2]]
        near = numpy.array([numpy.linalg.norm(volume[front, :2][k] - x) for k, x in zip(nearest, nodes[back_nodes, :2])]) < 0.3
        through, expected = u[back_nodes, 2][near], -moved[front, 2][nearest][near]
        expected = expected - expected.mean() + through.mean()  # where the specimen floats is the simulation's choice
        require(expected.max() - expected.min() > 0.015, f"the back thins by {1e3 * (expected.max() - expected.min()):.0f} um at the hole")
        rms = numpy.sqrt(numpy.mean((through - expected) ** 2))
        require(rms < 0.004, f"the stereo pair sees it within {1e3 * rms:.1f} um (rms, noise of a node about 3 um)")

    # The correlation alone, a folder for each face.
    run(program, "dic", folder / "all.yaml", 2, ["--output", str(folder / "dic")])
    strain = [json.loads((folder / f"dic/{face}/result.json").read_text())["frame_table"][-1]["mean_strain"][1] for face in ("front", "back")]
    require(abs(strain[0] / strain[1] - 1) < 0.01, f"both faces show the same mean strain {strain[0]:.5f}, {strain[1]:.5f}")
    require("back" in run(program, "check", folder / "all.yaml", 2), "check knows the faces")

    # Calibration: a pixel size that is wrong by 0.2 % moves the parameters as far as the share for that deviation says.
    deviation, draws = 2e-3, 24
    known = identify("known", MONO.format(pixel=0.08, sd=f", calibration_sd: {{pixel_size: {deviation}}}"), draws=draws)
    wrong = identify("wrong", MONO.format(pixel=0.08 * (1 + deviation), sd=""))
    for k, name in enumerate(("E", "S_y")):
        share = known["stages"][k]["standard_deviation"][name]["calibration"]
        moved = abs(values(wrong)[k] - values(known)[k])
        if k == 0:  # E is proportional to the scale; S_y moves with E and with the place of the mesh
            require(0.6 < share / moved < 1.5, f"share of the calibration {share:.4g}, moved by {moved:.4g} ({name})")
    # The same for the stereo pair's focal lengths, with a calibration file that is wrong in both; the share is that of two
    # independent errors, 1/sqrt(2) of it.
    text = (folder / "made/calibration_back.yaml").read_text()
    (folder / "wrong.yaml").write_text(text.replace("5600.", f"{5600 * (1 + deviation):.10g}"))
    require((folder / "wrong.yaml").read_text() != text, "the calibration file holds the focal lengths")
    stereo = identify("stereo_known", BACK.format(calibration="made/calibration_back.yaml", sd=f", calibration_sd: {{fx: {5600 * deviation}, fy: {5600 * deviation}}}"), draws=draws)
    wrong = identify("stereo_wrong", BACK.format(calibration="wrong.yaml", sd=""))
    share = stereo["stages"][0]["standard_deviation"]["E"]["calibration"]
    moved = abs(values(wrong)[0] - values(stereo)[0])
    require(0.6 < share / (moved / numpy.sqrt(2)) < 1.6, f"share of the focal lengths {share:.4g}, moved by {moved:.4g} with both wrong (E)")

    refused = identify("bad", MONO.format(pixel=0.08, sd=", calibration_sd: {fx: 1}"), draws=2, status=2)
    require(refused is None, "a telecentric camera has no fx")
    end()


main()
