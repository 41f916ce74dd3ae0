#!/usr/bin/python3
"""The light of a test in `imic3d loop`: images of an elastic strip made here, of a speckle and a motion that are formulas, integrated over pixels, with noise, rounded
to 8 bits. Nothing, a gain that drifts, a patch of foreign speckle, over-exposure, a flickering lamp: what the loop says of the grey levels that the correlation leaves.

Usage: light.py EXECUTABLE [--few]      --few: without over-exposure and lamp
"""
import io
import json
import sys

import numpy
from PIL import Image

from runs import bar, end, require, run, workspace

CASE = """
title: Strip, {name}
specimen: {{mesh: strip.msh, kinematics: plane_stress, thickness: 2, held: bottom, loaded: top}}
cameras:
  - {{name: front, pixel_size: {pixel}, place: {{origin: [{column}, {row}]}}, images: '{name}/*.png', reference: 0-1}}
loads: {{file: loads.csv, image: frame, time: time, force: force, noise: 10}}
material: {{law: elastic, parameters: {{E: 200e3, nu: 0.3}}}}
dic: {{low_pass: 1.0, border: 3}}
identify: {{functional: displacement_driven, {held_out}stages: [{{free: [E, nu]}}]}}
loop: {{draws: 40, modes: 20, additions: 2, rivals: 2, starts: [1.0]}}
output: {name}/run
"""
PIXEL, WIDTH, HEIGHT = 0.05, 180, 400
STATIC, FRAMES = 2, 9
E, NU, STRAIN, NOISE = 200e3, 0.3, 2e-3, 2.0


def speckle(seed):
    """Blobs of 3 px as a function of the position in pixels: 3 x 3 points of a pixel make its mean."""
    random = numpy.random.default_rng(seed)
    at = random.uniform([-20, -20], [WIDTH + 20, HEIGHT + 20], size=(int((WIDTH + 40) * (HEIGHT + 40) / 10), 2))
    sign = random.choice([-1.0, 1.0], size=len(at))

    def grey(x, y):
        total = numpy.zeros_like(x)
        for (bx, by), s in zip(at, sign):
            # The motion is small: a window of the image about the blob.
            rows, columns = slice(max(0, int(by) - 12), max(0, int(by) + 13)), slice(max(0, int(bx) - 12), max(0, int(bx) + 13))
            total[rows, columns] += s * numpy.exp(-((x[rows, columns] - bx)**2 + (y[rows, columns] - by)**2) / (2 * 1.8**2))
        return total / numpy.sqrt(1 + total**2)
    return grey


def photograph(texture, strain):
    """The texture on a strip under tension along the rows, about the image's middle; the specimen moves by a third of a pixel beside."""
    rows, columns = numpy.mgrid[:HEIGHT, :WIDTH].astype(float)
    total = numpy.zeros((HEIGHT, WIDTH))
    for dy in (-1 / 3, 0, 1 / 3):
        for dx in (-1 / 3, 0, 1 / 3):
            x = (columns + dx - 0.5 * (WIDTH - 1) - 0.3 * strain / STRAIN) / (1 - NU * strain) + 0.5 * (WIDTH - 1)
            y = (rows + dy - 0.5 * (HEIGHT - 1) - 0.4 * strain / STRAIN) / (1 + strain) + 0.5 * (HEIGHT - 1)
            total += texture(x, y) / 9
    return 120 + 65 * total


def main():
    program = sys.argv[1]
    folder = workspace("light")
    bar(folder / "strip.msh", -9.0, 9.0, 18, columns=7, half_width=3.5)
    strains = STRAIN * numpy.linspace(0, 1, FRAMES + 1)[1:]
    texture = speckle(1)
    rest = photograph(texture, 0.0)
    clean = [rest] * STATIC + [photograph(texture, strain) for strain in strains]
    foreign = 120 + 65 * speckle(2)(*numpy.mgrid[:HEIGHT, :WIDTH].astype(float)[::-1])
    random = numpy.random.default_rng(5)
    forces = numpy.concatenate([numpy.zeros(STATIC), E * strains * 7.0 * 2]) + 10 * random.normal(size=STATIC + FRAMES)
    (folder / "loads.csv").write_text("frame,time,force\n" + "".join(f"{k},{max(0, k - STATIC + 1)},{force:.3f}\n" for k, force in enumerate(forces)))
    rows, columns = numpy.mgrid[:HEIGHT, :WIDTH]

    def loop(name, seen, seed, held_out="", jpeg=0):
        """Images of which `seen(grey, frame)` is what the camera sees, frame from 1 after the reference; compressed with the quality `jpeg`."""
        noise = numpy.random.default_rng(seed)
        (folder / name).mkdir()
        for k, grey in enumerate(clean):
            levels = numpy.clip(numpy.rint(seen(grey, max(0, k - STATIC + 1)) + NOISE * noise.normal(size=grey.shape)), 0, 255)
            image = Image.fromarray(levels.astype(numpy.uint8))
            if jpeg:
                image.save(packed := io.BytesIO(), "JPEG", quality=jpeg)
                image = Image.open(packed)
            image.save(folder / name / f"{k:02}.png")
        (folder / f"{name}.yaml").write_text(CASE.format(name=name, pixel=PIXEL, column=0.5 * (WIDTH - 1), row=0.5 * (HEIGHT - 1), held_out=held_out))
        run(program, "loop", folder / f"{name}.yaml", 1)
        result = json.loads((folder / name / "run/result.json").read_text())
        page = (folder / name / "run/report.html").read_text()
        require("<h2>Light</h2>" in page, f"{name}: the page has a section on the light")
        print("        light: " + result["light"]["sentence"])
        print("        " + result["verdict"] + ": " + result["sentence"], flush=True)
        return result

    def size(model, name):
        one = model["parameters"][name]
        return one["value"], one["standard_deviation"]

    result = loop("nothing", lambda grey, t: grey, 11)
    light = result["light"]
    noise, deviation = size(light["after"], "noise")
    require(light["verdict"] == "nothing found" and "The light" not in result["sentence"] and "corrected" not in light and "doubts" not in result, "nothing is found in noise alone, and nothing is changed")
    candidates = lambda light: [one["name"] for one in light["before"]["candidates"]]
    require({"noise level", "aliasing"} <= set(candidates(light)), "noise level and aliasing are candidates")
    require(abs(noise - numpy.sqrt(NOISE**2 + 1 / 12)) < max(0.05 * NOISE, 3 * deviation), f"the noise is {noise:.3f} +- {deviation:.3f} grey levels, {NOISE} were put in")

    result = loop("gain", lambda grey, t: grey * (1 - 0.04 * t / FRAMES), 12)
    light = result["light"]
    require("light gain" in light["named"] + light["set"], f"a gain that drifts is named ({light['verdict']}: {light['named']}, {light['set']})")
    value, deviation = size(light["after"], "gain_drift")
    require(abs(value + 0.04) < 3 * deviation, f"by {value:.5f} +- {deviation:.5f}, -0.04 were put in")
    corrected = light["corrected"]
    require(corrected["option"] == "dic.brightness" and corrected["rms_after"] < corrected["rms_before"], f"the images are correlated again with the brightness fitted: {corrected['rms_before']:.3f} -> {corrected['rms_after']:.3f} grey levels")
    require(corrected["after"]["verdict"] == "nothing found", f"and nothing is left ({corrected['after']['sentence']})")
    last = corrected["after"]["cameras"]["front"]["gain"][-1]
    require(abs(last * 0.96 - 1) < 2e-3, f"in the last frame the correlation fits a gain of {last:.4f}, 1/0.96 = {1 / 0.96:.4f}")
    require("The light" in result["sentence"], "the sentence that comes first says it")
    true = abs(result["before"]["parameters"]["nu"]["value"] - NU)
    require(true < 0.02, f"nu is off by {true:.4f}")

    centre, radius, onset = (70, 150), 11, 5
    patch = (columns - centre[0])**2 + (rows - centre[1])**2 < radius**2
    result = loop("patch", lambda grey, t: numpy.where(patch & (t >= onset), foreign, grey), 13, jpeg=90)
    light = result["light"]
    require("JPEG" in result["doubts"][0] and "were compressed" in light["sentence"], "these images were compressed, which is doubted and said")
    require(not {"noise level", "aliasing"} & set(candidates(light)), "and what compression leaves is neither noise level nor aliasing")
    require("speckle debonding" in light["named"] + light["set"], f"a patch of foreign speckle is named ({light['verdict']})")
    places = {name: one["value"] for name, one in light["after"]["parameters"].items() if name.startswith("loose_")}
    # The twelve places of the mesh, 7 x 18 mm: 2 columns, 6 rows, from the lower left.
    x, y = (centre[0] - 0.5 * (WIDTH - 1)) * PIXEL, (0.5 * (HEIGHT - 1) - centre[1]) * PIXEL
    place = 1 + int((x + 3.5) // 3.5) + 2 * int((y + 9) // 3)
    largest = max(places, key=places.get)
    area = numpy.pi * (radius * PIXEL)**2 / (3.5 * 3)
    require(largest == f"loose_{place}" and 0.4 * area < places[largest] < 2.5 * area, f"where it is ({largest}): {places[largest]:.3f} of the place, {area:.3f} are the patch")
    require("speckle no more" in result["doubts"][-1] and result["verdict"] == "nothing found", f"the motion does without it: {result['doubts'][-1]}")
    require(int(result["doubts"][-1].split()[0]) <= 6, "without no more than the patch has spoilt")
    off = max(abs(one["value"] - true) / one["standard_deviation"] for true, one in ((E, result["before"]["parameters"]["E"]), (NU, result["before"]["parameters"]["nu"])))
    require(off < 3.5, f"E and nu are off by {off:.1f} standard deviations at most")
    require(abs(light["map"]["frame"] - onset) <= FRAMES, "the map says where and when something is left")

    if "--few" in sys.argv:
        return end()

    # Frames that are held out at the end, behind all that is fitted, take no part.
    result = loop("exposed", lambda grey, t: 1.55 * grey, 14, held_out=f'held_out: "5,{STATIC + FRAMES - 2}-{STATIC + FRAMES - 1}", ')
    light = result["light"]
    require(result["held_out"] == [5] and light["held_out"] == [5] and result["frames"][-1] == STATIC + FRAMES - 3, f"held out: {result['held_out']}, of the light {light['held_out']}; the last frame is {result['frames'][-1]}")
    reference = numpy.asarray(Image.open(folder / "exposed/00.png"))[25:-25, 25:-25]
    share = numpy.mean(reference == 255)
    require("saturation" in light["named"] + light["set"], f"over-exposure is named ({light['verdict']})")
    value, deviation = size(light["after"], "saturated")
    require(share > 0.01 and abs(value - share) < max(3 * deviation, 0.1 * share), f"saturated are {value:.4f} +- {deviation:.4f} of the pixels, counted {share:.4f}")

    flicker = numpy.concatenate([[0.0], 0.02 * random.normal(size=FRAMES)])
    result = loop("flicker", lambda grey, t: grey * (1 + flicker[t]), 15)
    light = result["light"]
    require(light["verdict"] != "nothing found" and light["share_of_gain_and_offset"] > 0.9, f"of a flickering lamp {100 * light['share_of_gain_and_offset']:.1f} % are a gain and an offset of each frame")
    require(light["corrected"]["after"]["verdict"] == "nothing found", "with which nothing is left")
    end()


main()
