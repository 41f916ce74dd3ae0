#!/usr/bin/env python3
"""The plate with a hole in CalculiX: force, and displacement of the hole's edge, against mean strain.

The region between two ends a length apart is pulled by a uniform displacement of its ends: lateral motion of the ends
is free, or fixed with --clamped. One eighth is solved (mid-planes x = 0, y = 0, z = 0) with quadratic bricks, C3D20R.

Each history is made twice. "simo" is CalculiX with the law as written. "hencky" is CalculiX with its hardening table
transformed so that in uniaxial tension it equals log strain with the exponential map and a yield function in Kirchhoff
stress, the theory of imic3d (see docs/verification.md). The force differs by about 0.2 %.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

import calculix as cx

DENSITY = {  # around, outward, along, through
    "coarse": (6, 6, 2, 3),
    "fine": (9, 9, 3, 5),
}
QUANTITIES = ("force_N", "pole_y_mm", "equator_x_mm", "equator_z_mm")


def history(plate, law, strains, clamped, theory, largest_increment, folder):
    """Columns as in QUANTITIES, one row a frame."""
    deck, nodes, cells, _ = cx.plate_deck(plate, law, strains, clamped, theory, largest_increment)
    name = f"plate_{'clamped' if clamped else 'free'}_{theory}_{len(cells)}_{largest_increment:g}"
    table, seconds = cx.run(deck, folder, name)
    print(f"{name}: {len(cells)} elements, {len(nodes)} nodes, {seconds:.0f} s", flush=True)
    force = 4.0 * table["total force", "END"][:, 0, 1]
    equator = table["displacements", "EQUATOR"][:, 0]
    return np.column_stack([force, table["displacements", "POLE"][:, 0, 2], equator[:, 1], equator[:, 3]])


def difference(a, b):
    """For each quantity the largest |a / b - 1| over the frames where it is above a hundredth of its largest value."""
    result = []
    for u, v in zip(a.T, b.T):
        large = np.abs(v) > 1e-2 * np.abs(v).max()
        result.append(np.max(np.abs(u[large] / v[large] - 1.0)))
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=cx.HelpFormatter)
    size = cx.Plate()
    parser.add_argument("--width", type=float, default=size.width, help="[mm] (default %(default)g)")
    parser.add_argument("--thickness", type=float, default=size.thickness, help="[mm] (default %(default)g)")
    parser.add_argument("--hole", type=float, default=2 * size.radius, help="diameter [mm] (default %(default)g)")
    parser.add_argument("--length", type=float, default=size.length, help="between the ends [mm] (default %(default)g)")
    parser.add_argument("--clamped", action="store_true", help="no lateral motion of the ends (x and z)")
    parser.add_argument("--mesh", choices=DENSITY, default="fine", help="(default %(default)s)")
    parser.add_argument("--increment", type=float, default=0.1,
                        help="largest increment of mean strain [%%] (default %(default)g)")
    parser.add_argument("--convergence", action="store_true",
                        help="no history: compare meshes and increments, and write plate_convergence.csv")
    cx.add_law_options(parser)
    parser.add_argument("--folder", type=Path, help="keep CalculiX's files here (default: a temporary folder)")
    parser.add_argument("--output", type=Path, default=Path("."), help="folder of the table (default: here)")
    options = parser.parse_args()
    law, folder = cx.law_of(options), options.folder or Path(tempfile.mkdtemp(prefix="calculix_"))
    strains = cx.FRAMES_PERCENT / 100.0

    def plate(density):
        around, outward, along, through = DENSITY[density]
        return cx.Plate(options.width, options.thickness, options.length, options.hole / 2,
                        around, outward, along, through)

    if options.convergence:
        def case(density, percent):
            return history(plate(density), law, strains, options.clamped, "simo", percent / 100.0, folder)

        base, finer, shorter = case("coarse", 0.1), case("fine", 0.1), case("coarse", 0.025)
        rows = [[name, *(f"{100 * d:.4f}" for d in difference(a, b))] for name, a, b in
                (("mesh: coarse against fine", base, finer), ("increment: 0.1 % against 0.025 %", base, shorter))]
        cx.write_table(options.output / "plate_convergence.csv",
                       ["Convergence of the CalculiX plate: largest difference over the frames, in % of the value, on",
                        "frames where the value exceeds a hundredth of its largest.",
                        "made by: /usr/bin/python3 tools/calculix_plate.py --convergence --output "
                        "tests/cases/calculix"],
                       ["compared", *(f"{q.rsplit('_', 1)[0]}_percent" for q in QUANTITIES)], rows)
        for row in rows:
            print(*row)
        return

    both = [history(plate(options.mesh), law, strains, options.clamped, theory, options.increment / 100.0, folder)
            for theory in ("simo", "hencky")]
    end = strains * options.length
    rows = [[str(n), f"{e:.6g}", f"{u:.8g}", *(f"{v:.7g}" for v in (*a, *b))]
            for n, (e, u, a, b) in enumerate(zip(strains, end, *both), 1)]
    thin = "" if options.thickness == size.thickness else f"_{options.thickness:g}mm"
    name = f"plate_history{'_clamped' if options.clamped else ''}{thin}.csv"
    lateral = "u_x = u_z = 0 on both ends" if options.clamped else "lateral motion of the ends free (no shear traction)"
    command = "/usr/bin/python3 tools/calculix_plate.py" + (" --clamped" if options.clamped else "")
    command += f" --mesh {options.mesh}" + (f" --thickness {options.thickness:g}" if thin else "")
    cx.write_table(options.output / name, [
        f"Plate {options.width:g} x {options.thickness:g} mm, hole {options.hole:g} mm at the origin, between the ends "
        f"y = -{options.length / 2:g} and y = +{options.length / 2:g} mm; z = 0 is the mid-plane.",
        f"E {law.E:g} MPa, nu {law.nu:g}, S_y {law.S_y:g} MPa, H {law.H:g} MPa, delta {law.delta:g}, eps0 by Eq. 19.",
        "Ends: u_y = -end_mm / 2 on the lower and +end_mm / 2 on the upper, uniform over the section; " + lateral + ".",
        "If the lower end is held and the upper moved by end_mm, subtract end_mm / 2 from every u_y before comparing.",
        "Mean strain = end_mm / length. force_N: resultant of the reactions over one whole end section.",
        "pole_y_mm: u_y at (0, a, t/2); equator_x_mm, equator_z_mm: u_x, u_z at (a, 0, t/2); a radius, t thickness.",
        "z = +t/2 is the front face (z = 0 of an extruded imic3d mesh); u_z is relative to the mid-plane.",
        f"CalculiX 2.20, C3D20R, one eighth by symmetry, {options.mesh} mesh, increments of at most "
        f"{options.increment:g} %.",
        "Plain columns: CalculiX's own theory (Simo 1988, yield in Cauchy stress). hencky_*: hardening table",
        "changed to log strain with yield in Kirchhoff stress (imic3d's theory): compare with these. See "
        "docs/verification.md.",
        f"made by: {command} --output tests/cases/calculix"],
        ["frame", "mean_strain", "end_mm", *QUANTITIES, *(f"hencky_{q}" for q in QUANTITIES)], rows)
    print("largest difference between the theories [%]:",
          ", ".join(f"{q} {100 * d:.3f}" for q, d in zip(QUANTITIES, difference(*both))))


if __name__ == "__main__":
    main()
