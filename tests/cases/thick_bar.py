#!/usr/bin/python3
"""Displacement fields of a tapered bar that is simulated in space (another mesh, a longer bar) and declared in plane stress, for which it is too thick: nothing is missing, and the
parameters are those of the simulation, since what a simulation in space shows beyond that of plane stress is learned and taken off.

Usage: thick_bar.py EXECUTABLE
"""
import json
import sys

import h5py
import numpy

from runs import bar, end, require, run, workspace

TRUTH = {"E": 200e3, "S_y": 284.0, "H": 1480.0}
NOISE, LOAD_NOISE, REST, THICKNESS = 4e-4, 4.0, 3, 1.5
TRUE = """
title: the bar
specimen: {{mesh: true.msh, thickness: {thickness}, layers: 2, mid_plane_symmetry: true, element: hex20, held: bottom, loaded: top}}
material: {{law: j2, hardening: linear, parameters: {{E: {E}, nu: 0.3, S_y: {S_y}, H: {H}}}}}
simulate: {{clamped: true, centred: true, steps_per_frame: 8, value: {value}}}
output: simulated
"""
DECLARED = f"""
title: thick bar
specimen: {{mesh: declared.msh, thickness: {THICKNESS}, kinematics: plane_stress, element: quad8, held: bottom, loaded: top}}
fields: {{files: points/*.csv, at_rest: 1-{REST}}}
loads: {{file: loads.csv, image: frame, time: time, force: force, noise: {LOAD_NOISE}}}
material: {{law: j2, hardening: linear, parameters: {{E: 190e3, nu: 0.3, S_y: 278, H: 1400}}}}
identify: {{functional: displacement_driven, stages: [{{free: [E, S_y, H]}}]}}
loop: {{draws: 60, additions: 1, rivals: 2, starts: [1.0]}}
output: run
"""


def tapered(path, half_length, rows, columns):
    """A bar whose width goes from 9 to 5.8 mm: with straight edges, which every mesh has."""
    bar(path, -half_length, half_length, rows, columns)
    lines = path.read_text().splitlines()
    first = lines.index("$Nodes") + 2
    for i in range(first, lines.index("$EndNodes")):
        number, x, y, z = map(float, lines[i].split())
        lines[i] = f"{number:.0f} {x * (1 - 0.02 * y):.9g} {y:g} {z:g}"
    path.write_text("\n".join(lines) + "\n")


def main():
    program, folder = sys.argv[1], workspace("thick_bar")
    tapered(folder / "true.msh", 14.0, 28, 8)
    tapered(folder / "declared.msh", 9.0, 14, 6)
    value = [0.0, *numpy.linspace(0.009, 0.045, 5), *numpy.linspace(0.055, 0.4, 9)]
    (folder / "true.yaml").write_text(TRUE.format(thickness=THICKNESS, value=[float(v) for v in value], **TRUTH))
    run(program, "simulate", folder / "true.yaml")
    with h5py.File(folder / "simulated/results.h5") as file:
        at, U, force = file["mesh/nodes"][:], file["fields/displacement"][1:], file["frames/force_predicted"][1:]
    seen = (at[:, 2] > at[:, 2].max() - 1e-9) & (abs(at[:, 1]) < 9.6)
    random = numpy.random.default_rng(5)
    (folder / "points").mkdir()
    reference = NOISE * random.normal(size=(seen.sum(), 2))
    rows = ["frame,time,force"]
    for number in range(1, 1 + REST + len(force)):
        t = number - 1 - REST
        u = (U[t][seen, :2] if t >= 0 else 0.0) + reference + NOISE * random.normal(size=reference.shape)
        numpy.savetxt(folder / f"points/{number:02}.csv", numpy.column_stack([at[seen, :2], u]), delimiter=",", header="x,y,u,v", comments="", fmt="%.5f")
        rows.append(f"{number},{number},{(force[t] if t >= 0 else 0.0) + LOAD_NOISE * random.normal():.2f}")
    (folder / "loads.csv").write_text("\n".join(rows) + "\n")
    case = folder / "case.yaml"
    case.write_text(DECLARED)
    run(program, "loop", case)
    result = json.loads((folder / "run/result.json").read_text())
    print(result["sentence"])
    before, after = result["before"], result["after"]
    require(result["verdict"] == "nothing found", f"{result['verdict']}: {result['named']}")
    off = [text for text in result.get("doubts", []) if "thick for plane stress" in text]
    require(off and "H by +" in off[0], f"what is taken off is said: {off}")
    for name, true in TRUTH.items():
        was, now = (one["parameters"][name] for one in (before, after))
        require(abs(now["value"] - true) < 3 * now["standard_deviation"] < 0.06 * true, f"{name} {was['value']:.6g} -> {now['value']:.6g} +- {now['standard_deviation']:.2g}, true {true:g}")
    H = after["parameters"]["H"]["value"]
    require(abs(H / TRUTH["H"] - 1) < 0.015, f"what plane stress errs by, 3 % of H, is taken off: {H:.0f}")
    end()


main()
