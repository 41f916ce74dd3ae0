#!/usr/bin/python3
"""A uniform bar (J2, linear hardening) seen by two pinhole cameras that comes to lean by two degrees while it is pulled: stress, strain and images are
closed forms, nothing is simulated or interpolated. Identified by two functionals; the loop has to say that nothing is missing.

Usage: leaning_bar.py EXECUTABLE
"""
import json
import pathlib
import sys
import tempfile

import numpy

from plane_scene import BETAS, photograph, placement, save, turned, write_images
from runs import bar, end, require, run

TRUTH = {"E": 110e3, "S_y": 400.0, "H": 1200.0}
START = {"E": 100e3, "S_y": 430.0, "H": 1000.0}
NU, HALF_WIDTH, THICKNESS, STATIC = 0.32, 4.0, 1.5, 2
STRAIN = numpy.array([0, 0.0012, 0.0024, 0.0034, 0.008, 0.015, 0.025, 0.035, 0.045])  # logarithmic
CASE = """
title: Leaning bar
specimen: {{mesh: bar.msh, element: hex20, layers: 2, thickness: {thickness}, held: bottom, loaded: top, axis: y, place: {{points: {points}}}}}
cameras:
  - {{name: left, model: pinhole, calibration: cal.xml, images: "camera_0_*.png", reference: 0-1}}
  - {{name: right, model: pinhole, calibration: cal.xml, images: "camera_1_*.png", reference: 0-1}}
loads: {{file: loads.csv, noise: 4}}
material: {{law: j2, hardening: linear, parameters: {{E: {E}, nu: {nu}, S_y: {S_y}, H: {H}}}}}
identify:
  functional: {functional}
  stages: [{{free: [E, S_y, H], frames: "2-{last}"}}]
loop: {{draws: 60, rivals: 1, additions: 1, starts: [1.0]}}
output: {output}
"""


def judge(program, folder):
    stress = numpy.minimum(TRUTH["E"] * STRAIN, (TRUTH["S_y"] + TRUTH["H"] * STRAIN) / (1 + TRUTH["H"] / TRUTH["E"]))  # Kirchhoff
    across = -NU * stress / TRUTH["E"] - 0.5 * (STRAIN - stress / TRUTH["E"])
    frames, rows = [], "frame,time_s,force_N\n"
    random = numpy.random.default_rng(1)
    for number, state in enumerate([0] * (STATIC - 1) + list(range(len(STRAIN)))):
        stretch = numpy.array([[numpy.exp(across[state]), 0], [0, numpy.exp(STRAIN[state])], [0, 0]])
        frames.append((turned(0.25 * state, (0.6, 0.8, 0.0)) @ stretch, numpy.array([0.01, 0.02, -0.05]) * state))
        force = stress[state] * numpy.exp(-STRAIN[state]) * 2 * HALF_WIDTH * THICKNESS
        rows += f"{number},{number},{force + 4 * random.normal():.3f}\n"
    (folder / "loads.csv").write_text(rows)
    write_images(folder, frames)
    bar(folder / "bar.msh", -3.0, 3.0, 6, columns=8, half_width=HALF_WIDTH)
    points = placement(((-3.5, -2.5), (3.5, -2.5), (3.5, 2.5), (-3.5, 2.5)), 3)

    def case_of(output, functional, parameters):
        case = folder / f"{output}.yaml"
        case.write_text(CASE.format(thickness=THICKNESS, points=points, nu=NU, functional=functional, last=len(frames) - 1, output=output, **parameters))
        return case

    percents = {"E": 1.5, "S_y": 0.3, "H": 3.0}
    for functional in ("force_driven", "displacement_driven"):
        run(program, "identify", case_of(functional, functional, START))
        found = json.loads((folder / functional / "result.json").read_text())
        for parameter, truth in TRUTH.items():
            off, deviation = found["parameters"][parameter]["value"] / truth - 1, found["parameters"][parameter]["standard_deviation"] / truth
            require(abs(off) < percents[parameter] / 100, f"{functional}: {parameter} {100 * off:+.2f} % off (standard deviation {100 * deviation:.2f})")
        require("doubts" not in found, f"{functional}: nothing is doubted {found.get('doubts', '')}")
    # The right camera is pushed by 0.4 px across the epipolar lines: the images judge, on the refined mesh too, by what is no part of that.
    for number, motion in enumerate(frames):
        save(folder / f"pushed_1_{number:02}.png", photograph(BETAS[1], *motion, push=0.4 * (number > 4)))
    before = json.loads((folder / "displacement_driven/result.json").read_text())
    case = case_of("pushed", "displacement_driven", START)
    case.write_text(case.read_text().replace("camera_1_", "pushed_1_"))
    run(program, "identify", case)
    found = json.loads((folder / "pushed/result.json").read_text())
    for parameter, truth in TRUTH.items():
        was, now = before["parameters"][parameter], found["parameters"][parameter]
        deviation = was["standard_deviation"]
        require(abs(now["value"] - was["value"]) < 2 * deviation and now["standard_deviation"] < 1.2 * deviation, f"pushed: {parameter} {was['value']:.6g} -> {now['value']:.6g} ({deviation:.2g} -> {now['standard_deviation']:.2g})")
        require(abs(now["refined_mesh"]["change"] - was["refined_mesh"]["change"]) < 0.2 * deviation, f"pushed: a refined mesh would change {parameter} by {now['refined_mesh']['change']:.2g}, by {was['refined_mesh']['change']:.2g} before")
    require(len(found.get("doubts", [])) == 1 and "as if one of them was pushed" in found["doubts"][0], f"pushed: {found.get('doubts')}")
    run(program, "loop", case_of("loop", "displacement_driven", TRUTH))
    found = json.loads((folder / "loop/result.json").read_text())
    require(found["verdict"] == "nothing found", f"nothing is missing: {found['sentence']}")


def main(program):
    with tempfile.TemporaryDirectory(prefix="imic3d_leaning_bar_") as made:
        judge(program, pathlib.Path(made))
    end()


if __name__ == "__main__":
    main(sys.argv[1])
