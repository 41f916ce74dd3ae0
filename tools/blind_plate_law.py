#!/usr/bin/python3
"""What CalculiX's plate is in terms of imic3d's law: the change of E, S_y, H and delta with which `imic3d simulate` (plane stress, fine mesh, the same ends) makes CalculiX's force and front face best, without noise.
A blind trial is not expected to find its parameters closer than that.

Usage: blind_plate_law.py OUT/calculix/radius_2.50000_nu_0.25000.npz [--imic3d PROGRAM]        OUT: the folder of tools/blind_plate.py, without --waist
"""
import argparse
import subprocess
import tempfile
from pathlib import Path

import h5py
import numpy as np
from scipy.interpolate import griddata

from blind_plate import DECLARED_LENGTH, LENGTH, LOAD_NOISE, RADIUS, THICKNESS, TRUTH, make_mesh
from calculix_virtual import STATIC

CHANGE, DISPLACEMENT = 0.02, 2e-3  # of a parameter; of a node's displacement as the images tell it [mm]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("made", type=Path)
    parser.add_argument("--imic3d", type=Path, default=Path("build/release/imic3d"))
    options = parser.parse_args()
    known = np.load(options.made)
    nodes, u, force = known["nodes"], known["displacement"][STATIC:], known["force"][STATIC:]
    pulled = 2 * u[:, nodes[:, 1] > LENGTH / 2 - 1e-6, 1].mean(1)
    looked_at = np.flatnonzero((np.abs(nodes[:, 1]) < DECLARED_LENGTH / 2) & (np.hypot(*nodes.T) > RADIUS + 0.05))[::7]
    folder = Path(tempfile.mkdtemp(prefix="imic3d_law_"))
    make_mesh(folder / "mesh.msh", False, length=LENGTH, size_hole=0.35, size_far=0.8)

    def simulated(**changed):
        values = ", ".join(f"{name}: {value!r}" for name, value in {**TRUTH, **changed}.items())
        (folder / "case.yaml").write_text(
            f"title: plate\nspecimen: {{mesh: mesh.msh, kinematics: plane_stress, element: quad8, thickness: {THICKNESS}, held: bottom, loaded: top}}\n"
            f"material: {{law: j2, hardening: power_linear, tie_initial_modulus: true, parameters: {{nu: 0.25, {values}}}}}\n"
            f"simulate: {{clamped: true, centred: true, steps_per_frame: 8, value: {[0.0, *pulled.tolist()]}}}\noutput: run\n")
        subprocess.run([options.imic3d.resolve(), "simulate", folder / "case.yaml"], check=True, capture_output=True)
        with h5py.File(folder / "run/results.h5") as file:
            x, U, F = file["mesh/nodes"][:, :2], file["fields/displacement"][1:, :, :2], file["frames/force_predicted"][1:]
        there = np.stack([griddata(x, field, nodes[looked_at], method="cubic") for field in U])
        return np.concatenate([there.ravel() / DISPLACEMENT, F / LOAD_NOISE])

    here = simulated()
    columns = np.stack([(simulated(**{name: (1 + CHANGE) * value}) - here) / (100 * CHANGE) for name, value in TRUTH.items()], 1)
    wanted = np.concatenate([u[:, looked_at, :2].ravel() / DISPLACEMENT, force / LOAD_NOISE]) - here
    good = np.isfinite(wanted) & np.isfinite(columns).all(1)
    found = np.linalg.lstsq(columns[good], wanted[good], rcond=None)[0]
    frames = len(force)
    print("force of CalculiX over imic3d's, less 1 [%]: " + ", ".join(f"{100 * d * LOAD_NOISE / f:+.3f}" for d, f in zip(wanted[-frames:], force)))
    print("front face, rms of the difference in the last frame [um]: " + f"{1e3 * DISPLACEMENT * np.sqrt(np.nanmean(wanted[:-frames].reshape(frames, -1)[-1] ** 2)):.3f}")
    print("CalculiX's plate is that of " + ", ".join(f"{name} {change:+.2f} %" for name, change in zip(TRUTH, found)))


if __name__ == "__main__":
    main()
