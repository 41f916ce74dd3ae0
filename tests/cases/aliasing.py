#!/usr/bin/python3
"""A plate whose speckle is finer than the pixels resolve (`imic3d virtual`, on a finer mesh): the loop finds it in the light, and in the motion what it does to the interpolation of images.
With a low pass both are next to nothing.

Usage: aliasing.py EXECUTABLE
"""
import json
import pathlib
import shutil
import sys
import tempfile

from runs import end, gmsh, require, run

PLATE = """
title: Plate with a fine speckle
specimen: {{mesh: {mesh}.msh, thickness: 4, kinematics: plane_stress, held: bottom, loaded: top}}
cameras:
  - {{name: front, pixel_size: 0.04, place: {{origin: [299.5, 329.5]}}{images}}}
material:
  hardening: linear
  parameters: {{E: 198e3, nu: 0.25, S_y: 284, H: 1480}}
{more}
output: {name}
"""
VIRTUAL = """
simulate: {centred: true, value: [0, 0.004, 0.008, 0.012, 0.016, 0.022, 0.03, 0.04, 0.05, 0.06, 0.08]}
virtual: {size: [600, 660], noise: 0.006, depth: 8, load_noise: 5, static_frames: 2, directory: made, declared_mesh: coarse.msh, speckle_size: 5}
effects: {aliasing: {aliased: 0.004}}
"""
LOOP = """
loads: {{file: made/loads.csv, noise: 5}}
dic: {{low_pass: {low_pass}}}
identify:
  functional: displacement_driven
  stages:
    - {{free: [E, nu, S_y, H]}}
loop: {{draws: 40}}
"""


def main():
    program = sys.argv[1]
    folder = pathlib.Path(tempfile.mkdtemp(prefix="imic3d_aliasing_"))
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.8, size_far=2.0)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=1.0, size_far=2.5)
    (folder / "made.yaml").write_text(PLATE.format(mesh="fine", images="", more=VIRTUAL, name="made"))
    run(program, "virtual", folder / "made.yaml", 1)

    def found(low_pass):
        name = f"low_pass_{low_pass}"
        (folder / f"{name}.yaml").write_text(PLATE.format(mesh="coarse", images=", images: 'made/images/*.png', reference: 0-1", more=LOOP.format(low_pass=low_pass), name=name))
        run(program, "loop", folder / f"{name}.yaml", 1)
        result = json.loads((folder / name / "result.json").read_text())
        print(f"        low pass {low_pass}: {result['sentence']}")
        return result, result["light"]["after"]["parameters"]["aliased"]

    sharp, size = found(0)
    require(sharp["light"]["verdict"] == "attributed" and {*sharp["light"]["named"], *sharp["light"]["set"]} == {"aliasing"} and "corrected" not in sharp["light"], f"the light is aliasing alone ({sharp['light']['named']}, {sharp['light']['set']})")
    # Of waves of 0.65 per pixel cubic splines make 0.92 waves of -0.35 (test_light.cpp).
    require(abs(size["value"] - 0.92**2 * 0.004) < 3 * size["standard_deviation"] and size["standard_deviation"] < 0.0005, f"{size['value']:.5f} +- {size['standard_deviation']:.5f} of the variance, planted {0.92**2 * 0.004:.5f}")
    require("sub-pixel interpolation" in sharp["named"] + sharp["set"], f"the motion says that interpolation errs ({sharp['verdict']}: {sharp['named']}, {sharp['set']})")
    error = {when: abs(sharp[when]["parameters"]["E"]["value"] / 198e3 - 1) for when in ("before", "after")}
    require(error["after"] < 0.5 * error["before"], f"E is {100 * error['before']:.2f} % off before and {100 * error['after']:.2f} % after")
    smooth, size = found(1)
    require(smooth["verdict"] == "nothing found" and size["value"] < 3e-4, f"with a low pass {size['value']:.6f} is left of it, and nothing of the motion ({smooth['verdict']})")
    if not require.failed:
        shutil.rmtree(folder)
    end()


main()
