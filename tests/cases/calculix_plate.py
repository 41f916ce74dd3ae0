#!/usr/bin/python3
"""The plate with a hole against CalculiX (quadratic elements, mesh of its own): load history within 0.5 % up to 8 %
mean strain, displacement of the hole's edge within 1 % of each component's largest value.

Usage: calculix_plate.py EXECUTABLE        (the table was made by tools/calculix_plate.py)
"""
import csv
import sys

import h5py
import numpy

from runs import SOURCE, end, gmsh, require, run, workspace


def main():
    with open(SOURCE / "tests/cases/calculix/plate_history.csv") as file:
        table = list(csv.DictReader(line for line in file if not line.startswith("#")))
    column = lambda name: numpy.array([float(row[name]) for row in table])
    folder = workspace("calculix")
    gmsh("plate_with_hole", folder / "plate.msh", length=24, size_hole=0.5, size_far=2.5)
    values = ", ".join(["0"] + [row["end_mm"] for row in table])
    (folder / "case.yaml").write_text(f"""
title: Plate with a hole, ends free to contract
specimen: {{mesh: plate.msh, thickness: 8, layers: 4, layer_ratio: 1.6, element: hex20, mid_plane_symmetry: true, held: bottom, loaded: top}}
material:
  hardening: power_linear
  tie_initial_modulus: true
  parameters: {{E: 198e3, nu: 0.25, S_y: 284, H: 1480, delta: 0.042}}
simulate: {{clamped: false, centred: true, steps_per_frame: 2, value: [{values}]}}
output: results
""")
    run(sys.argv[1], "simulate", folder / "case.yaml", 1)
    with h5py.File(folder / "results/results.h5") as file:
        nodes, u = file["mesh/nodes"][:], file["fields/displacement"][1:]
        force = file["frames/force_predicted"][1:]
    node = lambda x, y: numpy.argmin(numpy.linalg.norm(nodes - [x, y, nodes[:, 2].max()], axis=1))
    difference = numpy.abs(force / column("hencky_force_N") - 1)
    print(f"last force {force[-1]:.1f} N, CalculiX {column('hencky_force_N')[-1]:.1f} N (its own theory {column('force_N')[-1]:.1f} N)")
    require(difference.max() < 0.005, f"load history: largest difference {100 * difference.max():.3f} %")
    pole, equator = node(0, 2.5), node(2.5, 0)
    for name, ours in (("pole_y", u[:, pole, 1]), ("equator_x", u[:, equator, 0]), ("equator_z", u[:, equator, 2])):
        theirs = column(f"hencky_{name}_mm")
        worst = numpy.max(numpy.abs(ours - theirs))
        part = worst / numpy.max(numpy.abs(theirs))
        require(part < 0.01, f"hole's edge, {name}: largest difference {worst:.5f} mm, {100 * part:.3f} % of its largest value")
    end()


main()
