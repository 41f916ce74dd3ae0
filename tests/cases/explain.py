#!/usr/bin/python3
"""In reverse: sets of parameters that a force zero, or a gain, would make out of a bar's true ones are computed here, by the formulas
of a bar; imic3d explain names the effect and its size.

Usage: explain.py EXECUTABLE
"""
import json
import subprocess
import sys

import numpy
from scipy.optimize import least_squares

from runs import SOURCE, end, left_behind, require, run, same_page, workspace

# nu near 0.5, so that the driven ends contract as they should whatever share of the strain is plastic: the stress stays uniform.
TRUTH = {"E": 198e3, "nu": 0.49, "S_y": 284.0, "H": 1480.0}
FREE = ("E", "S_y", "H")
AREA, LENGTH = 12.5 * 4.0, 25.0
VALUE = numpy.array([0, 0.008, 0.014, 0.02, 0.026, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0])
CASE = f"""
title: Bar
specimen: {{mesh: bar.msh, thickness: 4, kinematics: plane_stress, held: bottom, loaded: top}}
material: {{hardening: linear, parameters: {{E: 198e3, nu: 0.49, S_y: 284, H: 1480}}}}
simulate: {{clamped: false, value: [{", ".join(map(str, VALUE))}]}}
identify:
  stages:
    - {{free: [E], frames: "1-4"}}
    - {{free: [S_y, H], frames: "1-11"}}
output: out
"""


def stretches(force, E, S_y, H):
    """Of the bar under a force, along and across: Kirchhoff stress F l/A, logarithmic strain, linear hardening."""
    along = numpy.ones_like(force)
    for _ in range(200):
        stress = force * along / AREA
        plastic = numpy.maximum(0.0, stress - S_y) / H
        along = numpy.exp(stress / E + plastic)
    return along, numpy.exp(-TRUTH["nu"] * stress / E - 0.5 * plastic)


def true_force():
    strain = numpy.log(1 + VALUE[1:] / LENGTH)
    E, S_y, H = (TRUTH[name] for name in FREE)
    plastic = numpy.maximum(0.0, E * strain - S_y) / (E + H)
    return E * (strain - plastic) * AREA / numpy.exp(strain)


def identified(recorded):
    """E from the first four frames, then S_y and H from all: images of the bar under the recorded force against those of the true one."""
    along, across = stretches(true_force(), *(TRUTH[name] for name in FREE))
    y2 = numpy.average((LENGTH * numpy.linspace(-0.5, 0.5, 5)) ** 2, weights=[1, 2, 2, 2, 1])  # nodes by their area
    x2 = numpy.average((12.5 * numpy.linspace(-0.5, 0.5, 3)) ** 2, weights=[1, 2, 1])

    def apart(values, frames):
        a, b = stretches(recorded[:frames], *values)
        return 1e6 * numpy.concatenate([(a - along[:frames]) * numpy.sqrt(y2), (b - across[:frames]) * numpy.sqrt(x2)])

    start = [TRUTH[name] for name in FREE]
    E = least_squares(lambda x: apart([x[0] * start[0], *start[1:]], 4), [1.0], xtol=1e-12, ftol=1e-14).x[0] * start[0]
    rest = least_squares(lambda x: apart([E, x[0] * start[1], x[1] * start[2]], len(VALUE)), [1.0, 1.0], xtol=1e-12, ftol=1e-14).x
    return {"E": E, "S_y": rest[0] * start[1], "H": rest[1] * start[2]}


def main():
    program = sys.argv[1]
    folder = workspace("explain")
    subprocess.run([sys.executable, str(SOURCE / "tools/meshes/bar.py"), str(folder / "bar.msh")], check=True)
    (folder / "case.yaml").write_text(CASE)

    def write(name, values):
        (folder / f"{name}.json").write_text(json.dumps({"title": name, "parameters": {key: {"value": value} for key, value in values.items()}}))
        return folder / f"{name}.json"

    truth = write("truth", TRUTH)
    force, offset, gain = true_force(), 1500.0, 1.08
    for name, recorded, quantity, size in (("force zero", force + offset, "force_offset", offset), ("force gain", force * gain, "force_gain", gain - 1)):
        values = identified(recorded)
        print(name + ": " + ", ".join(f"{key} {100 * (value / TRUTH[key] - 1):+.2f} %" for key, value in values.items()))
        print(run(program, "explain", folder / "case.yaml", 1, ["--from", str(truth), "--to", str(write(name, values)), "--tolerance", "0.002"]))
        result = json.loads((folder / "out/explain/result.json").read_text())
        effects = {one["name"]: one for one in result["effects"]}
        found = effects[name]
        twins = {"force gain": {"thickness"}}.get(name, set())
        ahead = {other for other, one in effects.items() if one["rank"] < found["rank"]}
        require(found["fits"] and found["chi_squared"] < 1.0 and ahead <= twins, f"{name} explains it, first (chi^2 {found['chi_squared']:.2g})")
        require(all(effects[twin]["fits"] for twin in twins), f"and so does {', '.join(twins) or 'nothing of the same pattern'}")
        of = found["sizes"][0]
        require(of["quantity"] == quantity and abs(of["size"] / size - 1) < 0.01, f"with {quantity} {of['size']:+.5g} {of['unit']}, made with {size:g}")
        left = max(abs(x) for x in found["left_percent"].values())
        require(left < 0.05, f"and leaves at most {left:.3f} % of a parameter")
        other = effects["force gain" if name == "force zero" else "force zero"]
        require(not other["fits"] and other["p"] < 1e-6, f"{other['name']} does not (chi^2 {other['chi_squared']:.0f})")
        require("hypothesis" in result["sentence"] and name in result["sentence"], result["sentence"])
        require("hole radius" not in effects, "a bar has no hole")
        require(all(one["degrees"] > 0 or not one["fits"] for one in result["effects"]), "an effect with as many sizes as parameters is not judged")
        if name == "force zero":
            straight = of["tangent_percent_per_unit"]["E"] * of["size"]
            require(abs(straight / found["explained_percent"]["E"] - 1) > 0.02, f"its tangent alone would say {straight:.2f} % of E")

    left_behind(folder / "out/explain", folder / "case.yaml", "explain", ("fields/displacement", "frames/force_predicted"))
    page = (folder / "out/explain/report.html").read_text()
    require(result["sentence"] in page and "<strong>fits</strong>" in page and f"{result['difference_percent']['S_y']:+.2f}" in page, "the page has the answer and the differences")
    same_page(program, folder / "out/explain")

    # E down, S_y up, H twice as large: no effect does that.
    other = write("other", {"E": 178e3, "S_y": 320.0, "H": 2960.0})
    said = run(program, "explain", folder / "case.yaml", 1, ["--from", str(truth), "--to", str(other), "--tolerance", "0.002"])
    require("none fits" in said, "a difference that no effect makes is not explained")
    short = write("short", {"E": 178e3})
    said = run(program, "explain", folder / "case.yaml", 1, ["--from", str(truth), "--to", str(short)], status=2, errors=True)
    require("no parameter S_y" in said, "a set that lacks a parameter is refused")
    other_law = write("other_law", {**TRUTH, "delta": 0.04})
    said = run(program, "explain", folder / "case.yaml", 1, ["--from", str(truth), "--to", str(other_law), "--tolerance", "0.002"], errors=True)
    require("fits</strong>" not in (folder / "out/explain/report.html").read_text(), "of sets that do not differ the page says of no effect that it fits")
    require("delta is not the same in both sets, and takes no part" in said, "a parameter that the case does not identify is said to take no part")
    # A measured test has more frames than are simulated.
    (folder / "images").mkdir()
    for frame in range(15):
        (folder / f"images/{frame:02}.png").touch()
    cameras = 'cameras: [{name: front, pixel_size: 0.1, place: {origin: [60, 170]}, images: "images/*.png"}]'
    for frames, said_of in (('frames: "1-14"', "1-14"), (None, "0-14")):
        text = CASE.replace("identify:", cameras + "\nidentify:")
        text = text.replace(', frames: "1-11"', ", " + frames if frames else "")
        (folder / "longer.yaml").write_text(text)
        said = run(program, "explain", folder / "longer.yaml", 1, ["--from", str(truth), "--to", str(other)], status=2, errors=True)
        require(f"identify.stages[1].frames: {said_of}; allowed: frames of simulate, 1-11, for imic3d explain" in said, f"frames that are not simulated are refused: {said.strip()}")
    end()


main()
