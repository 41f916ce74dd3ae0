#!/usr/bin/python3
"""Plane stress from one end to the other: a small virtual test on a finer mesh of a longer specimen and of another element,
identified with 1 and 2 ranks and by two functionals; against CalculiX on a thin plate; results for ParaView.

Usage: plane_stress.py EXECUTABLE        (the table was made by tools/calculix_plate.py --thickness 0.1)
"""
import csv
import json
import sys
import xml.etree.ElementTree

import h5py
import numpy

from runs import SOURCE, end, gmsh, require, run, workspace

TRUTH = {"E": 198e3, "S_y": 284, "H": 1480, "delta": 0.042}
CASE = """
title: Small plate with a hole in plane stress
specimen: {{mesh: {mesh}.msh, kinematics: plane_stress, element: {element}, thickness: {thickness}, held: bottom, loaded: top{more}}}
cameras:
  - {{name: front, pixel_size: 0.045, place: {place}{images}}}
material:
  hardening: power_linear
  tie_initial_modulus: true
  parameters: {{E: {E}, nu: 0.25, S_y: {S_y}, H: {H}, delta: {delta}}}
"""
GENERATE = """
simulate:
  centred: true
  steps_per_frame: 8
  value: [0, 0.008, 0.016, 0.024, 0.032, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8]
virtual: {size: [520, 580], load_noise: 0, static_frames: 2, directory: made}
output: made
"""
IDENTIFY = """
loads: {{file: made/loads.csv, noise: 5}}
identify:
  functional: {functional}
  stages:
    - {{free: [E], frames: "2-5"}}
    - {{free: [S_y, H, delta], frames: "2-11"}}
output: {output}
"""


def virtual_test(program, folder):
    gmsh("plate_with_hole", folder / "fine.msh", length=28, size_hole=0.4, size_far=1.2)
    gmsh("plate_with_hole", folder / "coarse.msh", length=20, size_hole=0.8, size_far=2.0)
    (folder / "virtual.yaml").write_text(CASE.format(
        mesh="fine", element="quad4", thickness=4, more=", refine: 1", place="{origin: [259.5, 289.5]}", images="", **TRUTH) + GENERATE)
    run(program, "virtual", folder / "virtual.yaml", 2)
    start = {"E": 185e3, "S_y": 265, "H": 1330, "delta": 0.046}
    cases = {}
    for functional in ("force_driven", "displacement_driven"):
        cases[functional] = folder / f"{functional}.yaml"
        cases[functional].write_text(
            CASE.format(mesh="coarse", element="hex20", thickness=4, more=", layers: 3, mid_plane_symmetry: true",
                        place="{auto: outline}", images=", images: 'made/images/*.png', reference: 0-1", **start) +
            IDENTIFY.format(functional=functional, output=functional))
    plan = run(program, "check", cases["force_driven"], 2)
    require("quad8 in plane stress" in plan, "check says what is simulated")
    require("not used     layers, mid_plane_symmetry" in plan, "check names the keys without a use")
    run(program, "dic", cases["force_driven"], 2, ["--output", str(folder / "dic")])

    values = {}
    for ranks in (1, 2):
        run(program, "identify", cases["force_driven"], ranks, ["--output", str(folder / f"force_{ranks}")])
        values[ranks] = identified(folder / f"force_{ranks}")
    difference = numpy.max(numpy.abs(values[2] / values[1] - 1.0))
    require(difference < 1e-8, f"2 ranks and 1 identify the same ({difference:.1e})")
    # A coarse mesh and small images: the full size is tools/virtual_study.sh --plane-stress.
    judge("force_driven", values[1], [3, 1, 2, 3])
    run(program, "identify", cases["displacement_driven"], 2)
    judge("displacement_driven", identified(folder / "displacement_driven"), [3, 3, 5, 15])
    changed(program, folder, cases["displacement_driven"])
    text = (folder / "force_1/results.xdmf").read_text()
    xml.etree.ElementTree.fromstring(text)
    require("Quadrilateral" in text and "Hexahedron" not in text, "ParaView gets quadrilaterals")
    with h5py.File(folder / "force_1/results.h5") as file:
        u, stress = file["fields/displacement"][-1], file["fields/cauchy_stress"][-1]
        require(numpy.all(u[:, 2] == 0.0) and numpy.abs(u).max() > 0.1, "the displacement lies in the plane")
        require(numpy.abs(stress[:, [2, 4, 5]]).max() < 1e-9 * numpy.abs(stress).max(), "so does the stress")
        require(file["mesh/corners"].shape[1] == 4, "cells are shown by their corners")


def identified(folder):
    result = json.loads((folder / "result.json").read_text())
    return numpy.array([result["parameters"][name]["value"] for name in TRUTH])


def changed(program, folder, case):
    """What a run says of a mesh that is refined once, and of a simulation in space, is what such runs find."""
    text = case.read_text()
    before = json.loads((folder / "displacement_driven/result.json").read_text())
    # In space H is 18 % smaller, too far for one step to tell S_y and delta, too, which share the knee.
    for name, other, parameters, doubt in (("refined_mesh", text.replace("layers: 3", "layers: 3, refine: 1"), ("S_y", "H", "delta"), "the mesh is coarse"),
                                           ("in_space", text.replace("kinematics: plane_stress, ", "").replace("layers: 3", "layers: 2"), ("H",), "thick for plane stress")):
        (folder / f"{name}.yaml").write_text(other.replace("output: displacement_driven", f"output: {name}"))
        run(program, "identify", folder / f"{name}.yaml", 2)
        after = json.loads((folder / name / "result.json").read_text())
        for parameter in parameters:
            one = before["parameters"][parameter]
            said, found = one[name]["change"], after["parameters"][parameter]["value"] - one["value"]
            require(abs(said - found) < 0.3 * abs(found) + one["standard_deviation"], f"{name}: {parameter} {said:+.4g} said, {found:+.4g} found, standard deviation {one['standard_deviation']:.2g}")
        doubted = any(doubt in text for text in before.get("doubts", []))
        far = any(abs(one[name]["change"]) > one["standard_deviation"] for one in before["parameters"].values() if name in one)
        require(doubted == far, f"doubted where that is more than a standard deviation: {doubted}")


def judge(functional, values, limits):
    errors = 100 * (values / numpy.array(list(TRUTH.values())) - 1)
    require(numpy.all(numpy.abs(errors) < limits),
            f"{functional}: " + ", ".join(f"{name} {error:+.3f} %" for name, error in zip(TRUTH, errors)))


def thin_plate(program, folder):
    with open(SOURCE / "tests/cases/calculix/plate_history_0.1mm.csv") as file:
        table = list(csv.DictReader(line for line in file if not line.startswith("#")))
    column = lambda name: numpy.array([float(row[name]) for row in table])
    gmsh("plate_with_hole", folder / "plate.msh", length=24, size_hole=0.5, size_far=2.5)
    text = CASE.format(mesh="plate", element="quad8", thickness=0.1, more="", place="{origin: [0, 0]}", images="", **TRUTH)
    values = ", ".join(["0"] + [row["end_mm"] for row in table])
    (folder / "thin.yaml").write_text(text + f"simulate: {{clamped: false, centred: true, steps_per_frame: 4, value: [{values}]}}\noutput: thin\n")
    run(program, "simulate", folder / "thin.yaml", 1)
    with h5py.File(folder / "thin/results.h5") as file:
        nodes, u = file["mesh/nodes"][:], file["fields/displacement"][1:]
        force = file["frames/force_predicted"][1:]
    node = lambda x, y: numpy.argmin(numpy.linalg.norm(nodes[:, :2] - [x, y], axis=1))
    difference = numpy.abs(force / column("hencky_force_N") - 1)
    require(difference.max() < 0.005, f"load history: largest difference {100 * difference.max():.3f} % from CalculiX's thin plate")
    for name, ours in (("pole_y", u[:, node(0, 2.5), 1]), ("equator_x", u[:, node(2.5, 0), 0])):
        theirs = column(f"hencky_{name}_mm")
        part = numpy.max(numpy.abs(ours - theirs)) / numpy.max(numpy.abs(theirs))
        require(part < 0.01, f"hole's edge, {name}: largest difference {100 * part:.3f} % of its largest value")


def main():
    folder = workspace("plane_stress")
    thin_plate(sys.argv[1], folder)
    virtual_test(sys.argv[1], folder)
    end()


main()
