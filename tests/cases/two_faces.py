#!/usr/bin/python3
"""A virtual test with a telecentric camera on the front and two pinhole cameras on the back: images, correlation of both
faces, identification with all three cameras, and the share of the calibration in the standard deviations; on 2 ranks as on 1.

Usage: two_faces.py EXECUTABLE [--ranks 2]
"""
import json
import sys

import h5py
import numpy
from scipy.interpolate import griddata

from runs import end, gmsh, ranks_of, require, run, workspace

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
    program, all_ranks = sys.argv[1], ranks_of(sys.argv)
    folder = workspace("two_faces")
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.7, size_far=1.8)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=0.8, size_far=2.0)
    (folder / "virtual.yaml").write_text(VIRTUAL.format(mesh="fine", layers=2, half="true", place="", E=198e3, S_y=284))
    run(program, "virtual", folder / "virtual.yaml", all_ranks)
    for name in ("mono", "left", "right"):
        require(len(list((folder / f"made/images_{name}").glob("*.png"))) == 8, f"8 images of {name}")
    points = json.loads((folder / "made/truth.json").read_text())["place_points"]["left"]
    place = f", place: {{camera: left, points: {points}}}"

    def identify(output, cameras, functional="force_driven", draws=0, half="true", ranks=all_ranks, status=0, E=True):
        where = place if "pinhole" in cameras else ""
        case = folder / f"{output}.yaml"
        text = IDENTIFY if E else IDENTIFY.replace("    - {{free: [E], frames: \"2-4\"}}\n", "")
        case.write_text(text.format(mesh="coarse", layers=1 if half == "true" else 2, half=half, place=where, cameras=cameras, E=185e3 if E else 198e3, S_y=265,
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
                                ("three cameras, displacement driven", identify("driven", mono + back, "displacement_driven"), (0.03, 0.03)),
                                ("stereo pair", identify("stereo", back), (0.03, 0.015))):
        error = values(result) / truth - 1
        require(abs(error[0]) < limit[0] and abs(error[1]) < limit[1], f"{name}: E {100 * error[0]:+.2f} %, S_y {100 * error[1]:+.2f} %")
    if all_ranks > 1:
        alone = values(identify("all", mono + back, ranks=1))
        require(numpy.max(numpy.abs(alone / values(one) - 1)) < 1e-8, f"1 rank and {all_ranks} identify the same")
    noise = one["noise"]["cameras"]
    require(all(abs(noise[name]["value"] / 2.55 - 1) < 0.1 for name in noise), f"noise of each camera {[round(noise[name]['value'], 2) for name in noise]} (2.55)")

    # The correlation alone, a folder for each face, and what it sees of the motion through the back against the simulation that made
    # the images: half the thickness, of which the back is the mirror image; where it floats is the simulation's choice.
    run(program, "dic", folder / "all.yaml", all_ranks, ["--output", str(folder / "dic")])
    strain = [json.loads((folder / f"dic/{face}/result.json").read_text())["frame_table"][-1]["mean_strain"][1] for face in ("front", "back")]
    require(abs(strain[0] / strain[1] - 1) < 0.01, f"both faces show the same mean strain {strain[0]:.5f}, {strain[1]:.5f}")
    noise = json.loads((folder / "dic/back/result.json").read_text())["standard_deviation"]["out_of_plane"]["value"]
    with h5py.File(folder / "dic/back/results.h5") as seen, h5py.File(folder / "made/results.h5") as made:
        nodes, through = seen["surface/nodes"][:], seen["dic/displacement"][7, :, 2]
        volume, moved = made["mesh/nodes"][:], made["fields/displacement"][6, :, 2]
    front = numpy.abs(volume[:, 2]) < 1e-9
    expected = -griddata(volume[front, :2], moved[front], nodes[:, :2])
    gap = through - expected - numpy.mean(through - expected)
    require(numpy.ptp(expected) > 0.03, f"the back thins by {1e3 * numpy.ptp(expected):.0f} um at the hole")
    require(numpy.std(gap) < 1.3 * noise and numpy.corrcoef(through, expected)[0, 1] > 0.8,
            f"the stereo pair sees it within {1e3 * numpy.std(gap):.1f} um (rms; predicted noise of a node {1e3 * noise:.1f} um)")
    require("back" in run(program, "check", folder / "all.yaml", all_ranks), "check knows the faces")

    # Calibration: numbers that are wrong by their standard deviation move S_y (E known) as far as the share says, apart from the
    # noise of images that are met at other places.
    text = (folder / "made/calibration_back.yaml").read_text()
    (folder / "wrong.yaml").write_text(text.replace("5600.", "5656.", 2))
    require((folder / "wrong.yaml").read_text().count("5656.") == 2, "the left camera's focal lengths are wrong by 1 %")
    left, right = back.splitlines(keepends=True)
    for name, known, wrong in (("pixel size", MONO.format(pixel=0.08, sd=", calibration_sd: {pixel_size: 0.01}"), MONO.format(pixel=0.0808, sd="")),
                               ("focal length", left.replace("0-1}", "0-1, calibration_sd: {fx: 56, fy: 56}}") + right,
                                BACK.format(calibration="wrong.yaml", sd=""))):
        name_of = name.split()[0]
        sure_of = identify(f"known_{name_of}", known, draws=6, E=False)
        moved = abs(values(identify(f"wrong_{name_of}", wrong, E=False))[1] - values(sure_of)[1])
        share = sure_of["stages"][0]["standard_deviation"]["S_y"]["calibration"]
        require(0.6 < share / moved < 1.5, f"share of the {name} {share:.3f}, moved by {moved:.3f} MPa (S_y)")

    refused = identify("bad", MONO.format(pixel=0.08, sd=", calibration_sd: {fx: 1}"), draws=2, status=2)
    require(refused is None, "a telecentric camera has no fx")
    end()


main()
