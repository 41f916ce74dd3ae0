#!/usr/bin/env python3
"""Plastic Cook's membrane in CalculiX: vertical displacement of the top corner (48, 60) against the number of elements.

Plane strain (u_z = 0 on every node), one layer of quadratic bricks C3D20R, left side held, a vertical dead load of
tau times the undeformed area on the right side. E 206.9, nu 0.29, sigma_y 0.45, sigma_inf 0.715, saturation exponent
16.93, linear hardening 0.12924, tau 0.3125 (kN/mm^2): Simo and Armero 1992.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

import calculix as cx

sys.path.insert(0, str(Path(__file__).resolve().parent / "meshes"))
import cook  # noqa: E402  (a script in a folder, not a package)


def corner_history(n, tau, steps, increments, folder):
    """Load factor -> vertical displacement of the top corner [mm]; and CalculiX's seconds."""
    even = cx.stretched(n, 1.0)
    points = []
    cells = cx.brick20(points, even, even, np.array([0.0, 0.5, 1.0]), cook.place)
    nodes, cells = cx.merge(points[0], cells)
    x, y, z = nodes.T
    corner = cx.where((x > 48 - 1e-6) & (y > 60 - 1e-6))
    deck = cx.mesh_cards(nodes, cells) + cx.set_cards("NSET", "LEFT", cx.where(x < 1e-6))
    deck += cx.set_cards("NSET", "CORNER", corner) + cx.material_cards(cx.SaturationLaw())
    deck += "*BOUNDARY\nLEFT, 1, 2\nALL, 3, 3\n"

    # consistent load of an 8-node face: -1/12 of it on a corner, 1/3 on a middle
    shares = np.zeros(len(nodes))
    for cell in cells:
        on = cell[x[cell] > 48 - 1e-6]
        if len(on) == 8:
            along = (y[on] - 44.0) / 16.0 * n  # in elements
            ends = on[np.isin(z[on], (0.0, 1.0)) & np.isclose(along, np.rint(along))]
            assert len(ends) == 4
            shares[on] += 1.0 / 3.0
            shares[ends] -= 1.0 / 3.0 + 1.0 / 12.0
    shares *= tau * 16.0 / n
    assert abs(shares.sum() - 16.0 * tau) < 1e-12

    output = "*NODE PRINT, NSET=CORNER, FREQUENCY=1000\nU\n"
    factors = np.arange(1, steps + 1) / steps
    for factor in factors:
        loads = "*CLOAD\n" + "".join(f"{m}, 2, {factor * f:.14g}\n" for m, f in enumerate(shares, 1) if f)
        deck += cx.step_cards("", output, increments, 1e-5, loads)
    table, seconds = cx.run(deck, folder, f"cook_{n}_{increments}")
    return factors, table["displacements", "CORNER"][:, 0, 2], seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=cx.HelpFormatter)
    parser.add_argument("--n", type=int, nargs="+", default=[4, 8, 16, 32],
                        help="elements along a side (default 4 8 16 32)")
    parser.add_argument("--tau", type=float, default=0.3125, help="shear traction [kN/mm^2] (default %(default)g)")
    parser.add_argument("--steps", type=int, default=10, help="rows of the history (default %(default)d)")
    parser.add_argument("--increments", type=int, default=4, help="increments to a row (default %(default)d)")
    parser.add_argument("--folder", type=Path, help="keep CalculiX's files here (default: a temporary folder)")
    parser.add_argument("--output", type=Path, default=Path("."), help="folder of the table (default: here)")
    options = parser.parse_args()
    folder = options.folder or Path(tempfile.mkdtemp(prefix="calculix_"))
    columns = {}
    cases = [(n, options.increments) for n in options.n]
    if len(options.n) > 1:
        cases.append((options.n[-2], 4 * options.increments))
    for n, increments in cases:
        factors, vertical, seconds = corner_history(n, options.tau, options.steps, increments, folder)
        columns[f"n{n}_{options.steps * increments}"] = vertical
        print(f"n = {n}, {options.steps * increments} increments: {vertical[-1]:.4f} mm ({seconds:.0f} s)",
              flush=True)
    rows = [[f"{f:g}", *(f"{c[k]:.6g}" for c in columns.values())] for k, f in enumerate(factors)]
    cx.write_table(options.output / "cook.csv", [
        "Plastic Cook's membrane, plane strain: u_y [mm] of the corner (48, 60) against the load factor (1: tau "
        f"{options.tau:g}).",
        "Column nN_I: N x N C3D20R elements, I increments in all; CalculiX's own theory (docs/verification.md).",
        "made by: /usr/bin/python3 tools/calculix_cook.py --output tests/cases/calculix"],
        ["load_factor", *columns], rows)


if __name__ == "__main__":
    main()
