#!/usr/bin/python3
"""Frames of the reference in which nothing should move, and the load cell should read zero: what speaks against that is doubted.

Usage: at_rest.py EXECUTABLE
"""
import csv
import json
import re
import subprocess
import sys

from runs import end, gmsh, require, run, workspace

CASE = """
title: Plate at rest
specimen: {{mesh: {mesh}.msh, thickness: 1, kinematics: plane_stress, element: quad4{more}, held: bottom, loaded: top}}
cameras:
  - {{name: front, pixel_size: 0.08, place: {{origin: [149.5, 164.5]}}{images}}}
material: {{law: elastic, parameters: {{E: {E}, nu: 0.3}}}}
"""


def main():
    program, folder = sys.argv[1], workspace("at_rest")
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.5, size_far=1.2)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=0.8, size_far=2.0)
    (folder / "virtual.yaml").write_text(CASE.format(mesh="fine", more=", refine: 1", images="", E=198e3) + """
simulate: {centred: true, value: [0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]}
virtual: {size: [300, 330], noise: 0.01, load_noise: 5, static_frames: 4, directory: made}
output: made
""")
    run(program, "virtual", folder / "virtual.yaml")
    with open(folder / "made/loads.csv") as file:
        rows = [(row["frame"], row["time_s"], float(row["force_N"])) for row in csv.DictReader(file)]

    def doubts(name, zero=0.0, reference="0-3"):
        (folder / f"{name}.csv").write_text("frame,time_s,force_N\n" + "".join(f"{frame},{time},{force + zero}\n" for frame, time, force in rows))
        images = f", images: 'made/images/*.png', reference: {reference}"
        (folder / f"{name}.yaml").write_text(CASE.format(mesh="coarse", more="", images=images, E=190e3) + f"""
loads: {{file: {name}.csv}}
identify: {{functional: displacement_driven, stages: [{{free: [E]}}]}}
output: {name}
""")
        run(program, "identify", folder / f"{name}.yaml")
        result = json.loads((folder / f"{name}/result.json").read_text())
        return [doubt for doubt in result.get("doubts", []) if "the reference" in doubt or ".reference" in doubt]

    found = doubts("rests")
    require(not found, f"at rest: {found}")
    # The parameters are there before the checks that take longest, should these be stopped.
    with subprocess.Popen([program, "identify", str(folder / "rests.yaml"), "--output", str(folder / "stopped")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        line = next((line for line in process.stdout if "what a finer mesh would change is computed" in line), None)
        process.kill()
    stopped, whole = (json.loads((folder / name / "result.json").read_text()) for name in ("stopped", "rests"))
    require(line and stopped["parameters"]["E"]["value"] == whole["parameters"]["E"]["value"] and "was not finished" in stopped["doubts"][0] and (folder / "stopped/report.html").exists(), f"a run that is stopped in its checks has its parameters: {stopped['doubts']}")
    of_E = whole["covariance"]
    require(of_E["parameters"] == ["E"] and abs(of_E["values"][0][0] ** 0.5 / whole["parameters"]["E"]["standard_deviation"] - 1) < 1e-9, f"the covariance is that of E: {of_E}")
    page = (folder / "rests/report.html").read_text()
    uses = re.findall(r'<td class="left">(fitted|held out|reference|)</td>', page[page.index("<th>use</th>"):])
    require(uses[:4] == ["reference"] * 4 and set(uses[4:]) == {"fitted"} and len(uses) > 6, f"the page tells the frames of the reference from those that are fitted: {uses}")
    found = doubts("zero", zero=400.0)
    read = re.search(r"the load record reads ([-.\d]+) \+- ([.\d]+) N while the reference was taken", " ".join(found))
    # Four readings with noise of 5 N: Student's t allows 17 standard deviations of their mean where 3.5 are allowed of a noise that is known.
    require(len(found) == 1 and read and abs(float(read[1]) - 400) < 15 and 6 < float(read[2]) < 60, f"four readings of 400 N: {found}")
    found = doubts("loaded", reference="0-5")
    require(any("the load record goes from" in doubt for doubt in found), f"frames under load in the reference: {found}")
    found = doubts("moves", reference="3-6")
    require(any("grey levels" in doubt and "did the specimen move" in doubt for doubt in found), f"frames that differ by more than noise: {found}")
    end()


main()
