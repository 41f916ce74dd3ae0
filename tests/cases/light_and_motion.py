#!/usr/bin/python3
"""What the light finds, and what the motion makes of it: a thin plate (`imic3d virtual`, on a finer mesh in more increments) of which nothing is missing but in its grey levels.

- `aliasing`: the speckle is finer than the pixels resolve. The light says so, and the motion that interpolation errs; with a low pass both are next to nothing.
- `noise`: it doubles over the test. `burst`: three frames are twice as noisy, which no effect explains. The motion is judged by the noise of each frame: nothing is missing there.

Usage: light_and_motion.py EXECUTABLE
"""
import json
import sys

import numpy
from PIL import Image

from runs import end, gmsh, require, run, workspace

PLATE = """
title: Plate with a hole
specimen: {{mesh: {mesh}.msh, thickness: 0.4, kinematics: plane_stress, held: bottom, loaded: top}}
cameras:
  - {{name: front, pixel_size: 0.04, place: {{origin: [299.5, 329.5]}}{images}}}
material:
  hardening: linear
  parameters: {{E: 198e3, nu: 0.25, S_y: 284, H: 1480}}
{more}
output: {name}
"""
TRUTH = {"E": 198e3, "nu": 0.25, "S_y": 284, "H": 1480}
VIRTUAL = """
simulate: {{centred: true, steps_per_frame: 8, value: [0, 0.004, 0.008, 0.012, 0.016, 0.022, 0.03, 0.04, 0.05, 0.06, 0.08]}}
virtual: {{size: [600, 660], noise: 0.006, depth: 8, load_noise: 0.5, static_frames: 2, directory: {name}, declared_mesh: coarse.msh, speckle_size: 5}}
{effects}
"""
LOOP = """
loads: {{file: {made}/loads.csv, noise: 0.5}}
dic: {{low_pass: {low_pass}}}
identify:
  functional: displacement_driven
  stages:
    - {{free: [E, nu, S_y, H]}}
loop: {{draws: 40}}
"""


def main():
    program = sys.argv[1]
    folder = workspace("light")
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.25, size_far=0.8)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=1.0, size_far=2.5)

    def made(name, effects=""):
        (folder / f"{name}.yaml").write_text(PLATE.format(mesh="fine", images="", more=VIRTUAL.format(name=name, effects=effects), name=name))
        run(program, "virtual", folder / f"{name}.yaml", 1)

    def found(data, low_pass=1):
        name = f"{data}_{low_pass}"
        (folder / f"{name}.yaml").write_text(PLATE.format(mesh="coarse", images=f", images: '{data}/images/*.png', reference: 0-1", more=LOOP.format(made=data, low_pass=low_pass), name=name))
        run(program, "loop", folder / f"{name}.yaml", 1)
        result = json.loads((folder / name / "result.json").read_text())
        print(f"        {data}, low pass {low_pass}: {result['sentence']}")
        return result

    def attributed(light, name):
        require(light["verdict"] == "attributed" and {*light["named"], *light["set"]} == {name} and "corrected" not in light, f"the light is {name} alone ({light['named']}, {light['set']})")

    def parameters_are_right(result):
        for name, truth in TRUTH.items():
            its = result["after"]["parameters"][name]
            require(abs(its["value"] - truth) < 3 * its["standard_deviation"], f"{name} {its['value']:.6g} +- {its['standard_deviation']:.2g} ({truth:.6g})")

    made("aliasing", "effects: {aliasing: {aliased: 0.004}}")
    sharp = found("aliasing", 0)
    attributed(sharp["light"], "aliasing")
    size = sharp["light"]["after"]["parameters"]["aliased"]
    # Of waves of 0.65 per pixel cubic splines make 0.92 waves of -0.35 (test_light.cpp).
    require(abs(size["value"] - 0.92**2 * 0.004) < 3 * size["standard_deviation"] and size["standard_deviation"] < 0.0005, f"{size['value']:.5f} +- {size['standard_deviation']:.5f} of the variance, planted {0.92**2 * 0.004:.5f}")
    require(sharp["verdict"] == "attributed" and {*sharp["named"], *sharp["set"]} == {"sub-pixel interpolation"}, f"the motion is interpolation alone ({sharp['verdict']}: {sharp['named']}, {sharp['set']})")
    error = {when: abs(sharp[when]["parameters"]["E"]["value"] / TRUTH["E"] - 1) for when in ("before", "after")}
    require(error["after"] < 0.5 * error["before"], f"E is {100 * error['before']:.2f} % off before and {100 * error['after']:.2f} % after")
    parameters_are_right(sharp)
    smooth = found("aliasing", 1)
    size = smooth["light"]["after"]["parameters"]["aliased"]
    require(smooth["verdict"] == "nothing found" and size["value"] < 3e-4, f"with a low pass {size['value']:.6f} is left of it, and nothing of the motion ({smooth['verdict']})")

    made("noise", "effects: {noise_level: {noise_drift: 1.0}}")
    noisy = found("noise")
    attributed(noisy["light"], "noise level")
    levels = noisy["light"]["cameras"]["front"]["relative_noise"]
    expected = [1 + (k + 1) / len(levels) for k in range(len(levels))]
    require(all(abs(level / one - 1) < 0.1 for level, one in zip(levels, expected)), f"noise of the frames {', '.join(f'{level:.2f}' for level in levels)}, planted {expected[0]:.2f} to {expected[-1]:.2f}")
    require(noisy["verdict"] == "nothing found", f"the motion: {noisy['verdict']}, chi {noisy['after']['chi']['fitted']:.2f} ({noisy['after']['chi']['null_fitted']:.2f})")
    parameters_are_right(noisy)

    made("burst")
    random = numpy.random.default_rng(12)
    for path in sorted((folder / "burst/images").glob("*.png"))[6:9]:
        levels = numpy.asarray(Image.open(path)) + random.normal(0, 3.0, Image.open(path).size[::-1])
        Image.fromarray(numpy.clip(numpy.rint(levels), 0, 255).astype(numpy.uint8)).save(path)
    burst = found("burst")
    require(burst["light"]["verdict"] == "unexplained", f"the light: {burst['light']['verdict']}")
    require(burst["verdict"] == "nothing found", f"the motion: {burst['verdict']}, chi {burst['after']['chi']['fitted']:.2f} ({burst['after']['chi']['null_fitted']:.2f})")
    parameters_are_right(burst)
    end()


main()
