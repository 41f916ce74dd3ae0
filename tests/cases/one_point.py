#!/usr/bin/python3
"""One integration point whose hourglass modes the images control (Sec. 3.4, `hex8r`), on noisy images at alpha = 0.01: every stage
converges, and the parameters of a plate made on finer hex20 are found.

Usage: one_point.py EXECUTABLE
"""
import json
import sys

from runs import end, gmsh, require, run, workspace

CASE = """
title: One point, held by the images
specimen: {{mesh: {mesh}.msh, element: {element}, thickness: 4, layers: 2, mid_plane_symmetry: true, held: bottom, loaded: top}}
cameras: [{{name: front, pixel_size: 0.05, place: {{origin: [224.5, 249.5]}}{images}}}]
material:
  hardening: power_linear
  tie_initial_modulus: true
  parameters: {{E: {E}, nu: 0.25, S_y: {S_y}, H: {H}, delta: 0.042}}
"""
VIRTUAL = """
simulate: {centred: true, value: [0, 0.008, 0.016, 0.024, 0.04, 0.06, 0.09, 0.14, 0.22, 0.35, 0.5, 0.7]}
virtual: {size: [450, 500], noise: 0.01, load_noise: 5, static_frames: 3, directory: made}
output: made
"""
IDENTIFY = """
loads: {file: made/loads.csv, noise: 5}
identify:
  alpha: 0.01
  stages:
    - {free: [E], frames: "3-5"}
    - {free: [S_y], frames: "3-10"}
    - {free: [S_y, H], frames: "3-13"}
output: identified
"""


def main():
    program = sys.argv[1]
    folder = workspace("one_point")
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.6, size_far=1.6)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=0.8, size_far=2.0)
    (folder / "virtual.yaml").write_text(CASE.format(mesh="fine", element="hex20", images="", E=198e3, S_y=284, H=1480) + VIRTUAL)
    (folder / "case.yaml").write_text(CASE.format(mesh="coarse", element="hex8r", images=", images: 'made/images/*.png', reference: 0-2", E=185e3, S_y=265, H=1600) +
                                      IDENTIFY)
    run(program, "virtual", folder / "virtual.yaml", 2)
    run(program, "identify", folder / "case.yaml", 2)
    result = json.loads((folder / "identified/result.json").read_text())
    for stage in result["stages"]:
        require(stage["converged"] and stage["iterations"] <= 5, f"{', '.join(stage['free'])} after {stage['iterations']} iterations")
    for name, truth, limit in (("E", 198e3, 0.015), ("S_y", 284.0, 0.01), ("H", 1480.0, 0.015)):
        error = result["parameters"][name]["value"] / truth - 1
        require(abs(error) < limit, f"{name} {100 * error:+.2f} %")
    end()


main()
