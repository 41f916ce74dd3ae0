#!/usr/bin/env python3
"""A straight bar along y as quadrilaterals in Gmsh 2.2 format: width 12.5 mm, gauge length 25 mm, 2 x 4 cells. Groups `bottom`, `top`.

Usage: bar.py OUTPUT
"""
import sys

columns, rows, width, length = 2, 4, 12.5, 25.0
nodes = [(width * (i / columns - 0.5), length * (j / rows - 0.5)) for j in range(rows + 1) for i in range(columns + 1)]
number = lambda i, j: j * (columns + 1) + i + 1
elements = [f"1 2 {tag} {tag} {number(i, j)} {number(i + 1, j)}" for tag, j in ((1, 0), (2, rows)) for i in range(columns)]
elements += [f"3 2 3 3 {number(i, j)} {number(i + 1, j)} {number(i + 1, j + 1)} {number(i, j + 1)}" for j in range(rows) for i in range(columns)]
with open(sys.argv[1], "w") as out:
    out.write('$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n1 1 "bottom"\n1 2 "top"\n2 3 "specimen"\n$EndPhysicalNames\n')
    out.write(f"$Nodes\n{len(nodes)}\n" + "".join(f"{k} {x} {y} 0\n" for k, (x, y) in enumerate(nodes, 1)) + "$EndNodes\n")
    out.write(f"$Elements\n{len(elements)}\n" + "".join(f"{k} {element}\n" for k, element in enumerate(elements, 1)) + "$EndElements\n")
