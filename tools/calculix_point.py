#!/usr/bin/env python3
"""One element in CalculiX: uniaxial tension and simple shear under the law of Eq. 18 tied by Eq. 19.

Says which finite-strain theory CalculiX uses, and leaves two tables against which another program's material point can
be compared. Beside CalculiX's stress the tables hold that of a plain integration, written here, of imic3d's theory
(Hencky elasticity, exponential map, yield function in Kirchhoff stress): the difference of the theories is a number.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

import calculix as cx

CUBE = np.array(cx.C3D20, float) / 2.0


def element_deck(law, boundary_of_step, steps, increments, theory="simo"):
    """A unit cube of one C3D20R element."""
    deck = cx.mesh_cards(CUBE, np.arange(20)[None, :]) + cx.material_cards(law, theory)
    x, y, z = CUBE.T
    for name, at in (("X0", x < .1), ("Y0", y < .1), ("Z0", z < .1), ("X1", x > .9)):
        deck += cx.set_cards("NSET", name, cx.where(at))
    output = ("*EL PRINT, ELSET=BODY, FREQUENCY=1000\nS, PEEQ\n*NODE PRINT, NSET=ALL, FREQUENCY=1000\nU\n"
              "*NODE PRINT, NSET=X1, TOTALS=ONLY, FREQUENCY=1000\nRF\n")
    return deck + "".join(cx.step_cards(boundary_of_step(step), output, increments, 1e-7) for step in steps)


def tension(law, strains, increments, folder, theory="simo"):
    """Log strain -> (Cauchy stress, J, accumulated plastic strain) of CalculiX."""
    def boundary(strain):
        return f"*BOUNDARY\nX0, 1, 1\nY0, 2, 2\nZ0, 3, 3\nX1, 1, 1, {np.expm1(strain):.14g}\n"

    table, _ = cx.run(element_deck(law, boundary, strains, increments, theory), folder, "tension")
    u = table["displacements", "ALL"][:, :, 1:]
    lateral = 1.0 + u[:, 6, 1]  # node 7 is the corner (1, 1, 1)
    J = np.exp(strains) * lateral * (1.0 + u[:, 6, 2])
    force = table["total force", "X1"][:, 0, 0]
    stress = table["stresses", "BODY"][:, :, 2]
    assert np.ptp(stress, axis=1).max() < 1e-3, "the element is not uniform"
    cauchy = force / (lateral * (1.0 + u[:, 6, 2]))  # from the reaction: independent of what the program calls stress
    assert np.max(np.abs(cauchy / stress[:, 0] - 1.0)) < 1e-5, "CalculiX prints another stress than Cauchy's"
    return cauchy, J, table["equivalent plastic strain", "BODY"][:, 0, 2]


def shear(law, gammas, increments, folder):
    """Shear -> Cauchy stress (xx, yy, zz, xy) and accumulated plastic strain of CalculiX."""
    def boundary(gamma):
        rows = "".join(f"{n}, 1, 1, {gamma * y:.14g}\n" for n, y in enumerate(CUBE[:, 1], 1))
        return f"*BOUNDARY\n{rows}ALL, 2, 3\n"

    table, _ = cx.run(element_deck(law, boundary, gammas, increments), folder, "shear")
    return table["stresses", "BODY"][:, 0, 2:6], table["equivalent plastic strain", "BODY"][:, 0, 2]


def tension_closed_form(law, strains, yield_in):
    """Axial Cauchy stress and J. Hencky: eps = p + tau / E, J = exp(tau / 3K); the yield function decides what equals
    sigma_y(p): tau = J sigma ("kirchhoff") or sigma ("cauchy")."""
    def tau_of(p):
        stress = law.yield_stress(p)
        if yield_in == "kirchhoff":
            return stress
        tau = stress
        for _ in range(30):
            tau = stress * np.exp(tau / (3.0 * law.bulk))
        return tau

    result = []
    for strain in strains:
        low, high = 0.0, strain
        if law.E * strain <= tau_of(0.0):
            tau = law.E * strain
        else:
            for _ in range(200):
                p = 0.5 * (low + high)
                low, high = (p, high) if p + tau_of(p) / law.E < strain else (low, p)
            tau = tau_of(p)
        J = np.exp(tau / (3.0 * law.bulk))
        result.append((tau / J, J))
    return np.array(result).T


def hencky_path(law, gradients):
    """Cauchy stress along a path of deformation gradients: log strain, exponential map, yield in Kirchhoff stress."""
    Be, p, F_old, stresses, plastic = np.eye(3), 0.0, np.eye(3), [], []
    for F in gradients:
        f = F @ np.linalg.inv(F_old)
        values, n = np.linalg.eigh(f @ Be @ f.T)
        e = 0.5 * np.log(values)
        volume, dev = e.sum(), e - e.mean()
        trial = 2.0 * law.shear * np.sqrt(1.5) * np.linalg.norm(dev)
        step = 0.0
        if trial > law.yield_stress(p):
            low, high = 0.0, trial / (3.0 * law.shear)
            for _ in range(100):
                step = 0.5 * (low + high)
                low, high = ((step, high) if trial - 3 * law.shear * step > law.yield_stress(p + step) else (low, step))
            dev = dev * (1.0 - 3.0 * law.shear * step / trial)
        p += step
        Be = n @ np.diag(np.exp(2.0 * (dev + volume / 3.0))) @ n.T
        stresses.append(n @ np.diag(2.0 * law.shear * dev + law.bulk * volume) @ n.T / np.exp(volume))
        plastic.append(p)
        F_old = F
    return np.array(stresses), np.array(plastic)


def shear_gradient(gamma):
    F = np.eye(3)
    F[0, 1] = gamma
    return F


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=cx.HelpFormatter)
    cx.add_law_options(parser)
    parser.add_argument("--increments", type=int, default=40,
                        help="increments of CalculiX to a row (default %(default)d)")
    parser.add_argument("--folder", type=Path, help="keep CalculiX's files here (default: a temporary folder)")
    parser.add_argument("--output", type=Path, default=Path("."), help="folder of the two tables (default: here)")
    options = parser.parse_args()
    law = cx.law_of(options)
    folder = options.folder or Path(tempfile.mkdtemp(prefix="calculix_"))
    print(f"table: {cx.TABLE_ROWS} rows, largest relative error {cx.interpolation_error(law):.1e}")
    about = [f"E {law.E:g} MPa, nu {law.nu:g}, S_y {law.S_y:g} MPa, H {law.H:g} MPa, delta {law.delta:g}, "
             "eps0 by Eq. 19.",
             f"CalculiX 2.20: one C3D20R element (1 mm cube), NLGEOM, {options.increments} increments to a row",
             "made by: /usr/bin/python3 tools/calculix_point.py --output tests/cases/calculix"]

    strains = np.concatenate([[0.0005, 0.001, 0.0014, 0.0018, 0.0025, 0.0035, 0.005, 0.0075],
                              np.arange(1, 31) / 100.0])
    sigma, J, p = tension(law, strains, options.increments, folder)
    in_cauchy, _ = tension_closed_form(law, strains, "cauchy")
    in_kirchhoff, J_closed = tension_closed_form(law, strains, "kirchhoff")
    rows = [[f"{e:.6g}", f"{s:.4f}", f"{j * s:.4f}", f"{j:.7f}", f"{q:.7g}", f"{a:.4f}", f"{b:.4f}"]
            for e, s, j, q, a, b in zip(strains, sigma, J, p, in_cauchy, in_kirchhoff)]
    cx.write_table(options.output / "uniaxial.csv", ["Uniaxial tension, stresses in MPa. CalculiX, then closed forms.",
                   *about, "lateral faces free; cauchy_MPa = reaction over current area, kirchhoff_MPa = J times it",
                   "closed_*: Cauchy stress by the closed form with Hencky elasticity, the yield function written in",
                   "Cauchy stress (as CalculiX does) or in Kirchhoff stress (as imic3d does)"],
                   ["log_strain", "cauchy_MPa", "kirchhoff_MPa", "J", "plastic_strain", "closed_cauchy_MPa",
                    "closed_kirchhoff_MPa"], rows)
    yielded = p > 0
    for name, closed in (("Cauchy", in_cauchy), ("Kirchhoff", in_kirchhoff)):
        off = (sigma / closed - 1.0)[yielded]
        print(f"tension: CalculiX against the closed form with yield in {name} stress: {1e2 * off.min():+.4f} % to "
              f"{1e2 * off.max():+.4f} %")
    transformed, _, _ = tension(law, strains, options.increments, folder, "hencky")
    off = (transformed / in_kirchhoff - 1.0)[yielded]
    print("tension: with the transformed table (theory hencky) against yield in Kirchhoff stress: "
          f"{1e2 * off.min():+.4f} % to {1e2 * off.max():+.4f} %")
    print(f"tension: J at {strains[-1]:g}: {J[-1]:.6f} (Hencky, Kirchhoff: {J_closed[-1]:.6f})")

    gammas = np.concatenate([[0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015], np.arange(0.02, 0.5001, 0.02)])
    stress, p = shear(law, gammas, options.increments, folder)
    fine = np.concatenate([np.linspace(a, b, 51)[1:] for a, b in zip(np.r_[0, gammas], gammas)])
    plain, plain_p = hencky_path(law, [shear_gradient(g) for g in fine])
    plain, plain_p = plain[49::50], plain_p[49::50]
    components = ((0, 0), (1, 1), (2, 2), (0, 1))
    plain = np.array([[h[at] for at in components] for h in plain])
    rows = [[f"{g:.6g}", *(f"{v:.4f}" for v in s), f"{q:.7g}", *(f"{v:.4f}" for v in h), f"{r:.7g}"]
            for g, s, q, h, r in zip(gammas, stress, p, plain, plain_p)]
    cx.write_table(options.output / "simple_shear.csv", [
                   "Simple shear u_x = gamma y, all else zero; Cauchy stress in MPa.", *about,
                   "hencky_*: log strain, exponential map, yield in Kirchhoff stress; 50 increments to a row, numpy"],
                   ["gamma", "xx_MPa", "yy_MPa", "zz_MPa", "xy_MPa", "plastic_strain", "hencky_xx_MPa", "hencky_yy_MPa",
                    "hencky_zz_MPa", "hencky_xy_MPa", "hencky_plastic_strain"], rows)
    for k, name in enumerate(("xx", "yy", "zz", "xy")):
        print(f"shear: {name} at gamma {gammas[-1]:g}: CalculiX {stress[-1, k]:.3f}, Hencky {plain[-1, k]:.3f} MPa; "
              f"largest difference {np.abs(stress[:, k] - plain[:, k]).max():.3f} MPa")


if __name__ == "__main__":
    main()
