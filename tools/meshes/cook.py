#!/usr/bin/env python3
"""Cook's membrane as one layer of n x n hexahedra in Gmsh 2.2 format.

Corners (0, 0), (48, 44), (48, 60), (0, 44) mm. Groups: `left` and `right` (faces), `corner` (the nodes at (48, 60)),
`specimen` (cells). Plane strain is the user's: u_z = 0 on every node.
"""

import argparse
from pathlib import Path

import numpy as np

CORNERS = np.array([[0.0, 0.0], [48.0, 44.0], [48.0, 60.0], [0.0, 44.0]])


def place(s, t):
    """Bilinear map of the unit square on the membrane."""
    a, b, c, d = CORNERS
    s, t = s[..., None], t[..., None]
    return a * (1 - s) * (1 - t) + b * s * (1 - t) + c * s * t + d * (1 - s) * t


def write(path, n, thickness):
    """Write the mesh; node (i, j, k) is 1 + i + (n + 1) (j + (n + 1) k)."""
    grid = np.linspace(0.0, 1.0, n + 1)
    T, S = np.meshgrid(grid, grid, indexing="ij")
    flat = place(S, T).reshape(-1, 2)
    nodes = np.vstack([np.column_stack([flat, np.full(len(flat), z)]) for z in (0.0, thickness)])
    layer = (n + 1) ** 2

    def node(i, j, k):
        return 1 + i + (n + 1) * j + layer * k

    elements = [f"15 2 4 4 {node(n, n, k)}" for k in (0, 1)]
    for tag, i in ((1, 0), (2, n)):
        for j in range(n):
            face = [node(i, j, 0), node(i, j + 1, 0), node(i, j + 1, 1), node(i, j, 1)]
            elements.append(f"3 2 {tag} {tag} " + " ".join(map(str, face if i else face[::-1])))
    for j in range(n):
        for i in range(n):
            ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            elements.append("5 2 3 3 " + " ".join(str(node(*at, k)) for k in (0, 1) for at in ring))
    names = '4\n0 4 "corner"\n2 1 "left"\n2 2 "right"\n3 3 "specimen"\n'
    with open(path, "w") as out:
        out.write("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n" + names + "$EndPhysicalNames\n")
        out.write(f"$Nodes\n{len(nodes)}\n")
        out.writelines(f"{m} {x:.16g} {y:.16g} {z:.16g}\n" for m, (x, y, z) in enumerate(nodes, 1))
        out.write(f"$EndNodes\n$Elements\n{len(elements)}\n")
        out.writelines(f"{m} {element}\n" for m, element in enumerate(elements, 1))
        out.write("$EndElements\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=16, help="elements along each side (default %(default)d)")
    parser.add_argument("--thickness", type=float, default=1.0, help="of the layer [mm] (default %(default)g)")
    parser.add_argument("--output", type=Path, default=Path("cook.msh"), help="file (default %(default)s)")
    options = parser.parse_args()
    write(options.output, options.n, options.thickness)


if __name__ == "__main__":
    main()
